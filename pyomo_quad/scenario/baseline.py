"""The adaptive controller that the optimum is compared with."""

from enum import StrEnum

from pyomo_quad.scenario.fields import Flag, Number, Part, quantity

__all__ = ["Baseline", "Gains", "Reference"]


class Reference(StrEnum):
    """The trajectory that the controller follows."""

    STEP = "step"
    QUINTIC = "quintic"
    MINIMUM_SNAP = "minimum_snap"
    PLAN = "plan"


class Gains(Part):
    """Gains of the adaptive backstepping law and bounds of its adaptation."""

    position: Number = quantity("1/s", "position error to velocity (K1)", 1.5, gt=0)
    velocity: Number = quantity("kg/s", "velocity error to force (K2)", 3.0, gt=0)
    attitude: Number = quantity("1/s", "attitude error to rate (k3)", 6.0, gt=0)
    rate: Number = quantity("kg*m^2/s", "rate error to moment (k4)", 1.2, gt=0)
    rotor: Number = quantity("1/s", "rotor speed error to acceleration", 60.0, gt=0)
    force_adaptation: Number = quantity("kg/s^2", "adaptation of the force (gamma_d)", 2.0, ge=0)
    moment_adaptation: Number = quantity(
        "kg*m^2/s^2", "adaptation of the moment (gamma_tau)", 0.2, ge=0
    )
    force_max: Number = quantity("N", "bound of the estimated disturbance force", 5.0, gt=0)
    moment_max: Number = quantity("N*m", "bound of the estimated disturbance moment", 0.2, gt=0)


class Baseline(Part):
    """Which references are flown, and how the controller is set."""

    references: tuple[Reference, ...] = quantity(
        "", "trajectories to follow", tuple(Reference), max_length=len(Reference)
    )
    adaptation: Flag = quantity("", "whether the controller adapts", True)
    gains: Gains = quantity("", "controller gains", Gains())
