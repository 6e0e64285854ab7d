"""Between the thrust as a vector and the vehicle's attitude: the columns of eq. (6).

Yaw-pitch-roll order, world axes z up; thrust acts along the body's z axis.
"""

from math import asin, atan2, cos, inf, sin, sqrt, tan

import numpy as np
from numpy.typing import NDArray

from pyomo_quad.flight.saturation import bend

__all__ = ["ThrustEnvelope", "thrust_direction", "tilt_toward"]

FloatArray = NDArray[np.float64]

# Share of the weight that the thrust must keep carrying: a falling quadrotor cannot steer.
_LEAST_SUPPORT = 0.3


def thrust_direction(roll: float, pitch: float, yaw: float) -> FloatArray:
    """Return the unit vector along the thrust, eq. (6) rows 1 to 3.

    Parameters
    ----------
    roll, pitch, yaw : float
        Attitude, rad.

    Returns
    -------
    ndarray, shape (3,)
        In world axes.
    """
    ahead, aside = cos(roll) * sin(pitch), sin(roll)
    return np.array(
        (
            ahead * cos(yaw) + aside * sin(yaw),
            ahead * sin(yaw) - aside * cos(yaw),
            cos(roll) * cos(pitch),
        )
    )


def tilt_toward(force: FloatArray, yaw: float) -> tuple[float, float]:
    """Return the roll and pitch that point the thrust along a force.

    Parameters
    ----------
    force : ndarray, shape (3,)
        In world axes, its vertical part positive.
    yaw : float
        Present yaw, rad.

    Returns
    -------
    roll, pitch : float
        Inverse of `thrust_direction`, rad.
    """
    ahead = force[0] * cos(yaw) + force[1] * sin(yaw)
    aside = force[0] * sin(yaw) - force[1] * cos(yaw)
    return asin(aside / sqrt(float(force @ force))), atan2(ahead, force[2])


class ThrustEnvelope:
    """The accelerations that the position loop may ask for.

    A demand beyond them is shortened along its own direction, so that a far goal is still
    approached in a straight line.

    Parameters
    ----------
    gravity : float
        Acceleration of gravity, m/s^2.
    acceleration_max : float
        Largest thrust over mass, above gravity, m/s^2.
    tilt_max : float
        Largest tilt of the thrust, rad.
    """

    def __init__(self, *, gravity: float, acceleration_max: float, tilt_max: float) -> None:
        self._gravity = gravity
        self._reserve = acceleration_max**2 - gravity**2
        self._slope = tan(tilt_max)

    def limited(self, acceleration: FloatArray) -> FloatArray:
        """Shorten an acceleration, smoothly, to what thrust and tilt allow.

        Parameters
        ----------
        acceleration : ndarray, shape (3,)
            Wanted, without gravity, m/s^2.

        Returns
        -------
        ndarray, shape (3,)
            Parallel to it and inside the envelope.
        """
        size = sqrt(float(acceleration @ acceleration))
        if size == 0.0:
            return acceleration
        return acceleration * (bend(size, self._reach(acceleration / size)) / size)

    def _reach(self, direction: FloatArray) -> float:
        """Return the largest acceleration along a unit vector."""
        upward = float(direction[2])
        along = sqrt(float(direction[0] ** 2 + direction[1] ** 2))
        rising = self._gravity * upward
        by_thrust = sqrt(rising**2 + self._reserve) - rising
        leaning = along - self._slope * upward
        by_tilt = self._slope * self._gravity / leaning if leaning > 0 else inf
        by_fall = (1 - _LEAST_SUPPORT) * self._gravity / -upward if upward < 0 else inf
        return min(by_thrust, by_tilt, by_fall)
