"""From thrust and moments to rotor speeds: the inverse of eq. (7), with priorities.

The mixer itself is not written here: its matrix is read off the declared equations.
"""

from collections.abc import Sequence
from math import inf, sqrt
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from pyomo_quad.scenario.limits import Limits

__all__ = ["Allocation", "VehicleDynamics", "mixer_matrix", "rotor_columns"]

FloatArray = NDArray[np.float64]

_MIXER_ROWS = (
    "rotors.total_thrust",
    "rotors.roll_moment",
    "rotors.pitch_moment",
    "rotors.yaw_moment",
)


class VehicleDynamics(Protocol):
    """What the controlled flight asks of compiled equations."""

    state_names: tuple[str, ...]
    control_names: tuple[str, ...]

    def rates_and_integrand(
        self, t: float, x: FloatArray, u: FloatArray, /
    ) -> tuple[FloatArray, float]:
        """Return dx/dt, shape (n_states,), and the power, W."""

    def evaluate(
        self, component: str, t: FloatArray, states: FloatArray, controls: FloatArray, /
    ) -> FloatArray:
        """Return a component at n points, shape (n,)."""


def rotor_columns(dynamics: VehicleDynamics) -> list[int]:
    """Return where the rotor speeds stand among the states, in the order of the controls.

    Parameters
    ----------
    dynamics : VehicleDynamics
        With states ``rotors.omega[j]`` for controls ``rotors.alpha[j]``.

    Returns
    -------
    list of int
        One column for each rotor.
    """
    names = list(dynamics.state_names)
    return [names.index(name.replace("alpha", "omega")) for name in dynamics.control_names]


def mixer_matrix(dynamics: VehicleDynamics) -> FloatArray:
    """Read the mixer, eq. (7), off the declared equations.

    Parameters
    ----------
    dynamics : VehicleDynamics
        Evaluated with one rotor at a time turning at 1 rad/s.

    Returns
    -------
    ndarray, shape (4, 4)
        Thrust, roll, pitch and yaw moment over the squared speeds of the rotors.
    """
    columns = rotor_columns(dynamics)
    X = np.zeros((len(columns), len(dynamics.state_names)))
    X[range(len(columns)), columns] = 1.0
    U = np.zeros((len(columns), len(columns)))
    times = np.zeros(len(columns))
    return np.array([dynamics.evaluate(row, times, X, U) for row in _MIXER_ROWS])


class Allocation:
    """Rotor speeds that give a thrust and moments, as far as the limits allow.

    When not everything fits, roll and pitch moment come first, then thrust, then yaw: a vehicle
    that keeps its attitude can recover the rest.

    Parameters
    ----------
    mixer : ndarray, shape (4, 4)
        Of `mixer_matrix`.
    limits : Limits
        Rotor speeds, thrust and moments allowed.
    """

    def __init__(self, mixer: FloatArray, limits: Limits) -> None:
        inverse = np.linalg.inv(mixer)
        # Equal on all rotors, since the moments' rows of the mixer each sum to zero.
        self._share = float(inverse[0, 0])
        self._roll, self._pitch, self._yaw = (tuple(column) for column in inverse.T[1:].tolist())
        self._roll_max, self._pitch_max = limits.roll_moment_max, limits.pitch_moment_max
        self._yaw_max = limits.yaw_moment_max
        self._thrust_max = limits.thrust_max
        self._lowest = limits.rotor_speed_min**2
        self._highest = limits.rotor_speed_max**2

    def rotor_speeds(self, thrust: float, moments: Sequence[float]) -> list[float]:
        """Return the rotor speeds to command.

        Parameters
        ----------
        thrust : float
            Total thrust wanted, N.
        moments : sequence of three floats
            Roll, pitch and yaw moment wanted, N m.

        Returns
        -------
        list of four floats
            Speeds within the limits, rad/s.
        """
        low, high = self._lowest, self._highest
        roll = min(max(moments[0], -self._roll_max), self._roll_max)
        pitch = min(max(moments[1], -self._pitch_max), self._pitch_max)
        yaw = min(max(moments[2], -self._yaw_max), self._yaw_max)
        tilting = [a * roll + b * pitch for a, b in zip(self._roll, self._pitch, strict=True)]
        span = max(tilting) - min(tilting)
        if span > high - low:
            tilting = [(high - low) / span * change for change in tilting]
        least, most = (low - min(tilting)) / self._share, (high - max(tilting)) / self._share
        equal = self._share * max(least, min(most, thrust, self._thrust_max))
        squares = [change + equal for change in tilting]
        yawing = [share * yaw for share in self._yaw]
        fitting = min(1.0, _step_within(squares, yawing, low, high))
        turned = (square + fitting * change for square, change in zip(squares, yawing, strict=True))
        return [sqrt(min(max(square, low), high)) for square in turned]

    def tilting_moment_at(self, thrust: float) -> tuple[float, float]:
        """Return the largest roll and pitch moment that leave the thrust as it is.

        Parameters
        ----------
        thrust : float
            Total thrust, N, shared by the rotors without any moment.

        Returns
        -------
        roll, pitch : float
            Each available on its own, N m.
        """
        squares = [self._share * thrust] * len(self._roll)
        roll = _step_within(squares, self._roll, self._lowest, self._highest)
        pitch = _step_within(squares, self._pitch, self._lowest, self._highest)
        return min(roll, self._roll_max), min(pitch, self._pitch_max)


def _step_within(
    values: Sequence[float], direction: Sequence[float], low: float, high: float
) -> float:
    """Return how far values may go along a direction before the first meets a bound."""
    rooms = (
        ((high - value) if change > 0 else (low - value)) / change
        for value, change in zip(values, direction, strict=True)
        if change != 0.0
    )
    return max(0.0, min(rooms, default=inf))
