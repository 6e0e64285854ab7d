"""The power model that turns rotor motion into watts."""

from enum import StrEnum

from pyomo_quad.scenario.fields import Flag, Number, Part, quantity

__all__ = ["Power", "PowerModel"]


class PowerModel(StrEnum):
    """Which declared power the mission's energy integrates."""

    MOTOR = "motor"
    EFFICIENCY = "efficiency"
    SHAFT = "shaft"
    CONSTANT_EFFICIENCY = "constant_efficiency"
    MOTOR_WITH_FRICTION = "motor_with_friction"


class Power(Part):
    """Choice of the power model and the regularisation of the `efficiency` model."""

    model: PowerModel = quantity("", "power model", PowerModel.MOTOR)
    efficiency: Number = quantity("1", "drive efficiency of constant_efficiency", 0.75, gt=0, le=1)
    torque_floor: Number = quantity("N*m", "efficiency: smallest torque used in f_r", 0.0, ge=0)
    efficiency_floor: Number = quantity("1", "efficiency: smallest f_r", 0.05, gt=0, le=1)
    regeneration: Flag = quantity("", "whether braking earns energy back", False)
    smoothing: Number = quantity("W", "efficiency: width of the smooth floor at 0 W", 0.1, gt=0)
