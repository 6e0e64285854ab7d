"""What the controller knows of attitude: how the angles' rates follow from the body's.

As the controller's law, this is written with NumPy's functions of single numbers: it takes the
engine's symbols as well.
"""

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from pyomo_quad.scenario import Attitude

Vector = Sequence[float]


class AttitudeKinematics(Protocol):
    """Rates and accelerations of roll, pitch and yaw, from those about the body's axes and back."""

    def angle_rates(self, attitude: Vector, body_rates: Vector, /) -> Vector:
        """Return the rates of the angles, rad/s."""

    def angle_accelerations(
        self, attitude: Vector, body_rates: Vector, body_accelerations: Vector, /
    ) -> Vector:
        """Return the accelerations of the angles, rad/s^2."""

    def body_accelerations(
        self, attitude: Vector, body_rates: Vector, angle_accelerations: Vector, /
    ) -> Vector:
        """Return the accelerations about the body's axes that give those of the angles."""


class EquatedRates:
    """Eq. (9) of the paper: the rates of the angles are those of the body."""

    def angle_rates(self, _attitude: Vector, body_rates: Vector) -> Vector:
        """Return the body rates."""
        return body_rates

    def angle_accelerations(
        self, _attitude: Vector, _body_rates: Vector, body_accelerations: Vector
    ) -> Vector:
        """Return the accelerations about the body's axes."""
        return body_accelerations

    def body_accelerations(
        self, _attitude: Vector, _body_rates: Vector, angle_accelerations: Vector
    ) -> Vector:
        """Return the accelerations of the angles."""
        return angle_accelerations


class EulerRates:
    """Exact kinematics, Beard and McLain (2012), eq. (3.3), and their derivative by time."""

    def angle_rates(self, attitude: Vector, body_rates: Vector) -> Vector:
        """Return the Euler rates; they grow beyond bounds towards a pitch of 90 degrees."""
        roll, pitch, _ = attitude
        p, q, r = body_rates
        turning = q * np.sin(roll) + r * np.cos(roll)
        return (
            p + turning * np.tan(pitch),
            q * np.cos(roll) - r * np.sin(roll),
            turning / np.cos(pitch),
        )

    def angle_accelerations(
        self, attitude: Vector, body_rates: Vector, body_accelerations: Vector
    ) -> Vector:
        """Return what the body's accelerations and the turning of the axes add up to."""
        linear = self.angle_rates(attitude, body_accelerations)
        turning = self._turning(attitude, body_rates)
        return [a + b for a, b in zip(linear, turning, strict=True)]

    def body_accelerations(
        self, attitude: Vector, body_rates: Vector, angle_accelerations: Vector
    ) -> Vector:
        """Return the accelerations about the body's axes; defined at every attitude."""
        roll, pitch, _ = attitude
        turning = self._turning(attitude, body_rates)
        rolling, pitching, yawing = (
            a - b for a, b in zip(angle_accelerations, turning, strict=True)
        )
        level = yawing * np.cos(pitch)
        return (
            rolling - yawing * np.sin(pitch),
            pitching * np.cos(roll) + level * np.sin(roll),
            level * np.cos(roll) - pitching * np.sin(roll),
        )

    def _turning(self, attitude: Vector, body_rates: Vector) -> Vector:
        """Return the accelerations of the angles at constant body rates."""
        pitch = attitude[1]
        rolling, pitching, yawing = self.angle_rates(attitude, body_rates)
        return (
            pitching * (rolling * np.tan(pitch) + yawing / np.cos(pitch)),
            -rolling * yawing * np.cos(pitch),
            pitching * (rolling / np.cos(pitch) + yawing * np.tan(pitch)),
        )


KINEMATICS: dict[Attitude, AttitudeKinematics] = {
    Attitude.EULER: EulerRates(),
    Attitude.PAPER: EquatedRates(),
}
