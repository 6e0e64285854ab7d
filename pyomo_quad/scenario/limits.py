"""Limits of the flight, eq. (10), and of the battery."""

from math import pi

from pyomo_quad.scenario.fields import Number, Part, Sound, quantity
from pyomo_quad.scenario.vehicle import ROTOR_COUNT, Vehicle

__all__ = ["FASTEST_ROTOR", "Limits", "derived_limits"]


#: rad/s.
FASTEST_ROTOR = 1e5
_ANGLE = Sound(1e-4, 2, "the angle is in radians")
_MOMENT = Sound(0, 1e8, "ten tonnes on an arm of a kilometre have 1e8")


class Limits(Part):
    """Bounds that the optimiser respects and the controller is clipped to."""

    roll_max: Number = quantity(
        "rad", "largest roll angle, eq. (10)", gt=0, le=pi / 2, sound=_ANGLE
    )
    pitch_max: Number = quantity(
        "rad", "largest pitch angle, eq. (10)", gt=0, le=pi / 2, sound=_ANGLE
    )
    rotor_speed_min: Number = quantity(
        "rad/s",
        "smallest rotor speed, eq. (10)",
        ge=0,
        sound=Sound(0, FASTEST_ROTOR, "the tips of the smallest rotors reach the speed of sound"),
    )
    rotor_speed_max: Number = quantity(
        "rad/s", "largest rotor speed, eq. (10)", gt=0, le=FASTEST_ROTOR
    )
    rotor_acceleration_max: Number = quantity(
        "rad/s^2",
        "largest rotor acceleration",
        gt=0,
        sound=Sound(1e-2, 1e8, "a rotor takes from a millisecond to minutes to reach its speed"),
    )
    thrust_max: Number = quantity(
        "N",
        "largest total thrust, default of four rotors",
        gt=0,
        sound=Sound(0, 1e7, "flying machines weigh at most ten tonnes"),
    )
    roll_moment_max: Number = quantity(
        "N*m", "largest roll moment, default of one rotor", gt=0, sound=_MOMENT
    )
    pitch_moment_max: Number = quantity(
        "N*m", "largest pitch moment, default of one rotor", gt=0, sound=_MOMENT
    )
    yaw_moment_max: Number = quantity(
        "N*m",
        "largest yaw moment, default of two rotors",
        gt=0,
        sound=_MOMENT,
    )
    state_of_charge_min: Number | None = quantity(
        "percent", "lowest state of charge, no limit when absent", None, ge=0, lt=100
    )
    battery_current_max: Number | None = quantity(
        "A",
        "largest pack current, no limit when absent",
        None,
        gt=0,
        sound=Sound(1e-3, 1e6, "packs for flight give from milliamperes to thousands of amperes"),
    )
    battery_voltage_min: Number | None = quantity(
        "V",
        "lowest pack voltage, no limit when absent",
        None,
        gt=0,
        sound=Sound(1e-3, 1e5, "packs for flight have from a volt to thousands of volts"),
    )


def derived_limits(vehicle: Vehicle, rotor_speed_max: float) -> dict[str, float]:
    """Return the thrust and moment limits that the rotor speed limit implies.

    Parameters
    ----------
    vehicle : Vehicle
        Gives arm and rotor coefficients.
    rotor_speed_max : float
        Largest rotor speed, rad/s.

    Returns
    -------
    dict
        Values of `thrust_max` (eq. 10) and of the three moment limits (eq. 7), SI.
    """
    rotor_thrust = vehicle.thrust_coefficient * rotor_speed_max**2
    rotor_drag_torque = vehicle.drag_torque_coefficient * rotor_speed_max**2
    return {
        "thrust_max": ROTOR_COUNT * rotor_thrust,
        "roll_moment_max": vehicle.arm_length * rotor_thrust,
        "pitch_moment_max": vehicle.arm_length * rotor_thrust,
        "yaw_moment_max": 2 * rotor_drag_torque,
    }
