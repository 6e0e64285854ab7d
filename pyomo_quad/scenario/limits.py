"""Limits of the flight, eq. (10), and of the battery."""

from math import pi

from pyomo_quad.scenario.fields import Number, Part, quantity
from pyomo_quad.scenario.vehicle import ROTOR_COUNT, Vehicle

__all__ = ["Limits", "derived_limits"]


class Limits(Part):
    """Bounds that the optimiser respects and the controller is clipped to."""

    roll_max: Number = quantity("rad", "largest roll angle, eq. (10)", gt=0, le=pi / 2)
    pitch_max: Number = quantity("rad", "largest pitch angle, eq. (10)", gt=0, le=pi / 2)
    rotor_speed_min: Number = quantity("rad/s", "smallest rotor speed, eq. (10)", ge=0)
    rotor_speed_max: Number = quantity("rad/s", "largest rotor speed, eq. (10)", gt=0, le=1e5)
    rotor_acceleration_max: Number = quantity("rad/s^2", "largest rotor acceleration", gt=0)
    thrust_max: Number = quantity("N", "largest total thrust, default of four rotors", gt=0)
    roll_moment_max: Number = quantity("N*m", "largest roll moment, default of one rotor", gt=0)
    pitch_moment_max: Number = quantity("N*m", "largest pitch moment, default of one rotor", gt=0)
    yaw_moment_max: Number = quantity("N*m", "largest yaw moment, default of two rotors", gt=0)
    state_of_charge_min: Number | None = quantity(
        "percent", "lowest state of charge, no limit when absent", None, ge=0, lt=100
    )
    battery_current_max: Number | None = quantity(
        "A", "largest pack current, no limit when absent", None, gt=0
    )
    battery_voltage_min: Number | None = quantity(
        "V", "lowest pack voltage, no limit when absent", None, gt=0
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
