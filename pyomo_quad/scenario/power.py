"""The power model that turns rotor motion into watts."""

from collections.abc import Mapping
from enum import StrEnum
from typing import Any

from pydantic import model_validator

from pyomo_quad.scenario.fields import Flag, Number, Part, Sound, quantity

__all__ = ["Power", "PowerModel"]


class PowerModel(StrEnum):
    """Which declared power the mission's energy integrates."""

    MOTOR = "motor"
    EFFICIENCY = "efficiency"
    SHAFT = "shaft"
    CONSTANT_EFFICIENCY = "constant_efficiency"
    MOTOR_WITH_FRICTION = "motor_with_friction"


# Their power is a balance that holds whichever way the energy flows; to divide a braking power by
# an efficiency would make braking earn more than it gave.
_REGENERATING = (PowerModel.MOTOR, PowerModel.SHAFT, PowerModel.MOTOR_WITH_FRICTION)


class Power(Part):
    """Choice of the power model and the regularisation of the `efficiency` model."""

    model: PowerModel = quantity("", "power model", PowerModel.MOTOR)
    efficiency: Number = quantity("1", "drive efficiency of constant_efficiency", 0.75, gt=0, le=1)
    torque_floor: Number = quantity(
        "N*m",
        "efficiency: smallest torque used in f_r",
        0.0,
        ge=0,
        sound=Sound(0, 100, "drag torques of rotors that fly are smaller"),
    )
    efficiency_floor: Number = quantity(
        "1",
        "efficiency: smallest f_r",
        0.05,
        gt=0,
        le=1,
        sound=Sound(1e-4, 1, "less would mean a power of thousands of times the useful one"),
    )
    regeneration: Flag = quantity(
        "", "whether braking earns energy back, default by power model", False
    )
    smoothing: Number = quantity(
        "W",
        "without regeneration: width of the smooth floor at 0 W",
        0.1,
        gt=0,
        sound=Sound(
            1e-6, 1e5, "it is to be small beside the power in flight, which is watts to megawatts"
        ),
    )

    @model_validator(mode="before")
    @classmethod
    def _regenerates_by_default(cls, given: Any) -> Any:  # noqa: ANN401  before validation
        if not isinstance(given, Mapping) or "regeneration" in given:
            return given
        return {**given, "regeneration": given.get("model", PowerModel.MOTOR) in _REGENERATING}
