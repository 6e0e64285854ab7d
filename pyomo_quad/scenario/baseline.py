"""The adaptive controller that the optimum is compared with."""

from enum import StrEnum

from pyomo_quad.scenario.fields import Flag, Number, Part, Sound, quantity

__all__ = ["Baseline", "Gains", "Reference"]


_MILLISECONDS = "no loop is faster than the milliseconds of motors and sensors"
_RATE = Sound(1e-3, 1e4, _MILLISECONDS)
_ADAPTATION = Sound(0, 1e6, _MILLISECONDS)
_FORCE = Sound(1e-3, 1e4, "a thousand times gravity tears a vehicle apart")


class Reference(StrEnum):
    """The trajectory that the controller follows."""

    STEP = "step"
    QUINTIC = "quintic"
    MINIMUM_SNAP = "minimum_snap"
    PLAN = "plan"


class Gains(Part):
    """Gains of the adaptive backstepping law, per unit of mass and of inertia.

    Dividing by mass and inertia makes the defaults serve vehicles of any size: they place the
    poles of the position error at 1.5 and 3 rad/s, of the tilt command at 12 rad/s, of the
    attitude error at 6 and 15 rad/s and of the rotors at 60 rad/s: each loop is at least twice as
    fast as the one around it, and a step settles in less than 3 s.
    """

    position: Number = quantity("1/s", "position error to velocity (k1)", 1.5, gt=0, sound=_RATE)
    velocity: Number = quantity(
        "1/s", "velocity error to acceleration (k2)", 3.0, gt=0, sound=_RATE
    )
    speed_max: Number = quantity(
        "m/s",
        "speed at which a far goal is approached",
        3.0,
        gt=0,
        sound=Sound(1e-3, 1e3, "nothing with rotors flies at the speed of sound"),
    )
    acceleration_max: Number = quantity(
        "m/s^2", "largest correcting acceleration", 2.0, gt=0, sound=_FORCE
    )
    tilt_max: Number = quantity(
        "rad",
        "largest tilt asked of the attitude loop",
        0.5,
        gt=0,
        lt=1.5,
        sound=Sound(1e-3, 1.5, "with less nothing is left to steer with"),
    )
    thrust_share: Number = quantity(
        "1",
        "share of the thrust beyond the weight left to the position loop",
        0.7,
        gt=0,
        le=1,
        sound=Sound(1e-3, 1, "with less nothing is left to steer with"),
    )
    tilt_command: Number = quantity(
        "1/s", "tilt error to tilt rate, of the filter", 6.0, gt=0, sound=_RATE
    )
    attitude: Number = quantity("1/s", "roll and pitch error to rate (k3)", 6.0, gt=0, sound=_RATE)
    attitude_rate: Number = quantity(
        "1/s", "their rate error to acceleration (k4)", 15.0, gt=0, sound=_RATE
    )
    yaw: Number = quantity("1/s", "yaw error to yaw rate (k3)", 1.0, gt=0, sound=_RATE)
    yaw_rate: Number = quantity(
        "1/s", "yaw rate error to acceleration (k4)", 2.5, gt=0, sound=_RATE
    )
    rotor: Number = quantity(
        "1/s", "rotor speed error to rotor acceleration", 60.0, gt=0, sound=_RATE
    )
    force_identification: Number = quantity(
        "1/s", "rate of the force identifier (kappa)", 20.0, gt=0, sound=_RATE
    )
    moment_identification: Number = quantity(
        "1/s", "rate of the moment identifier (kappa)", 10.0, gt=0, sound=_RATE
    )
    force_adaptation: Number = quantity(
        "1/s^2", "adaptation to a force (gamma)", 100.0, ge=0, sound=_ADAPTATION
    )
    force_max: Number = quantity(
        "m/s^2", "bound of that force over the mass", 4.0, gt=0, sound=_FORCE
    )
    moment_adaptation: Number = quantity(
        "1/s^2", "adaptation to a moment (gamma)", 25.0, ge=0, sound=_ADAPTATION
    )
    moment_max: Number = quantity(
        "rad/s^2",
        "bound of that moment over the inertia",
        1.0,
        gt=0,
        sound=Sound(1e-3, 1e8, "no airframe follows faster"),
    )


class Baseline(Part):
    """Which references are flown, and how the controller is set."""

    references: tuple[Reference, ...] = quantity(
        "", "trajectories to follow", tuple(Reference), max_length=len(Reference)
    )
    adaptation: Flag = quantity("", "whether the controller adapts", True)
    gains: Gains = quantity("", "controller gains", Gains())
