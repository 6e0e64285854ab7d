"""Between the thrust as a vector and the vehicle's attitude: the columns of eq. (6).

Yaw-pitch-roll order, world axes z up; thrust acts along the body's z axis.
"""

from collections.abc import Sequence
from math import asin, atan2, cos, hypot, inf, sin, sqrt, tan

from pyomo_quad.flight.saturation import bend

__all__ = ["ThrustEnvelope", "thrust_direction", "tilt_toward"]

# Share of the weight that the thrust must keep carrying: a falling quadrotor cannot steer.
_LEAST_SUPPORT = 0.3


def thrust_direction(roll: float, pitch: float, yaw: float) -> tuple[float, float, float]:
    """Return the unit vector along the thrust, eq. (6) rows 1 to 3.

    Parameters
    ----------
    roll, pitch, yaw : float
        Attitude, rad.

    Returns
    -------
    tuple of three floats
        In world axes.
    """
    ahead, aside = cos(roll) * sin(pitch), sin(roll)
    return (
        ahead * cos(yaw) + aside * sin(yaw),
        ahead * sin(yaw) - aside * cos(yaw),
        cos(roll) * cos(pitch),
    )


def tilt_toward(force: Sequence[float], yaw: float) -> tuple[float, float]:
    """Return the roll and pitch that point the thrust along a force.

    Parameters
    ----------
    force : sequence of three floats
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
    return asin(aside / hypot(*force)), atan2(ahead, force[2])


class ThrustEnvelope:
    """Accelerations, without gravity, that thrust and tilt can give.

    Parameters
    ----------
    gravity : float
        m/s^2.
    acceleration_max : float
        Largest thrust over mass, above gravity, m/s^2.
    tilt_max : float
        Largest tilt of the thrust, rad.
    """

    def __init__(self, *, gravity: float, acceleration_max: float, tilt_max: float) -> None:
        self._gravity = gravity
        self._reserve = acceleration_max**2 - gravity**2
        self._slope = tan(tilt_max)

    def limited(self, acceleration: Sequence[float]) -> tuple[float, float, float]:
        """Shorten an acceleration, smoothly, to what thrust and tilt allow.

        Parameters
        ----------
        acceleration : sequence of three floats
            Wanted, without gravity, m/s^2.

        Returns
        -------
        tuple of three floats
            Parallel to it and inside the envelope.
        """
        ax, ay, az = acceleration
        size = hypot(ax, ay, az)
        if size == 0.0:
            return 0.0, 0.0, 0.0
        share = bend(size, self._reach(hypot(ax, ay) / size, az / size)) / size
        return share * ax, share * ay, share * az

    def _reach(self, along: float, upward: float) -> float:
        """Return the largest acceleration along a unit vector, given by its two parts."""
        rising = self._gravity * upward
        by_thrust = sqrt(rising**2 + self._reserve) - rising
        leaning = along - self._slope * upward
        by_tilt = self._slope * self._gravity / leaning if leaning > 0 else inf
        by_fall = (1 - _LEAST_SUPPORT) * self._gravity / -upward if upward < 0 else inf
        return min(by_thrust, by_tilt, by_fall)
