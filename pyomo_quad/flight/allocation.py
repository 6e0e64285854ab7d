"""From thrust and moments to rotor speeds: the inverse of eq. (7), with priorities.

The mixer itself is not written here: its matrix is read off the declared equations.
"""

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
    """What the flight floor asks of compiled equations."""

    state_names: tuple[str, ...]
    control_names: tuple[str, ...]

    def rates(self, t: float, x: FloatArray, u: FloatArray) -> FloatArray:
        """Return dx/dt, shape (n_states,)."""

    def integrand(self, t: float, x: FloatArray, u: FloatArray) -> float:
        """Return the power, W."""

    def evaluate(
        self, component: str, t: FloatArray, X: FloatArray, U: FloatArray
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
        self._thrust_share = inverse[:, 0]
        self._tilting = inverse[:, 1:3]
        self._yawing = inverse[:, 3]
        self._tilting_max = np.array((limits.roll_moment_max, limits.pitch_moment_max))
        self._yawing_max = limits.yaw_moment_max
        self._thrust_max = limits.thrust_max
        self._lowest = limits.rotor_speed_min**2
        self._highest = limits.rotor_speed_max**2

    def rotor_speeds(self, thrust: float, moments: FloatArray) -> FloatArray:
        """Return the rotor speeds to command.

        Parameters
        ----------
        thrust : float
            Total thrust wanted, N.
        moments : ndarray, shape (3,)
            Roll, pitch and yaw moment wanted, N m.

        Returns
        -------
        ndarray, shape (4,)
            Speeds within the limits, rad/s.
        """
        tilting = self._tilting @ np.clip(moments[:2], -self._tilting_max, self._tilting_max)
        tilting *= min(1.0, (self._highest - self._lowest) / max(np.ptp(tilting), 1e-300))
        least = ((self._lowest - tilting) / self._thrust_share).max()
        most = ((self._highest - tilting) / self._thrust_share).min()
        fitting = max(least, min(most, thrust, self._thrust_max))
        squares = tilting + self._thrust_share * fitting
        yawing = self._yawing * min(max(moments[2], -self._yawing_max), self._yawing_max)
        squares += yawing * self._share_that_fits(squares, yawing)
        return np.sqrt(np.clip(squares, self._lowest, self._highest))

    def tilting_moment_at(self, thrust: float) -> FloatArray:
        """Return the largest roll and pitch moment that leave the thrust as it is.

        Parameters
        ----------
        thrust : float
            Total thrust, N, shared by the rotors without any moment.

        Returns
        -------
        ndarray, shape (2,)
            Each available on its own, N m.
        """
        shares = self._thrust_share * thrust
        room = np.minimum(self._highest - shares, shares - self._lowest)
        available = np.array([_step_to_bound(room, row) for row in np.abs(self._tilting.T)])
        return np.minimum(available, self._tilting_max)

    def _share_that_fits(self, squares: FloatArray, change: FloatArray) -> float:
        room = np.where(change > 0, self._highest - squares, squares - self._lowest)
        return min(1.0, max(0.0, _step_to_bound(room, np.abs(change))))


def _step_to_bound(room: FloatArray, direction: FloatArray) -> float:
    """Return how far one may go along a direction before the first room is used up."""
    moving = direction > 0
    return float((room[moving] / direction[moving]).min(initial=np.inf))
