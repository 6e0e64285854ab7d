"""The two means of the thrust vector that every flight of a mission has in common.

See `study.certificate` for where (a) and (b) come from.
"""

from collections.abc import Iterator
from itertools import count

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import null_space
from scipy.optimize import minimize

from pyomo_quad.flight.steady import MomentumDemand

__all__ = ["ThrustMoments"]

FloatArray = NDArray[np.float64]

_GAUSS_NODES = 6
# For integrals of the price of thrust, which is smooth.
_PANELS = 16
# For those of the wind, doubled until they agree.
_FEWEST_PANELS = 2
_MOST_PANELS = 4096
_QUADRATURE_ERROR = 1e-10


class ThrustMoments:
    """Integrals of the thrust over the flight that the boundary conditions fix.

    Parameters
    ----------
    demand : MomentumDemand
        Linear in the velocity.
    displacement : ndarray, shape (3,)
        From start to goal, m.
    duration : float
        Duration of the flight, s.

    Attributes
    ----------
    widths : ndarray, shape (n,)
        Widths of a quadrature over the flight, s.
    weights : ndarray, shape (2, n, 3)
        Weights of (a) and of a combination of (a) and (b), at the nodes of the quadrature.
    demanded : ndarray, shape (2, 3)
        What the integrals of the weights times the thrust must be, N s.
    mean_thrust : ndarray, shape (3,)
        Mean thrust vector, N.
    """

    def __init__(self, demand: MomentumDemand, displacement: FloatArray, duration: float) -> None:
        rate = demand.drag / demand.mass
        times, self.widths = _gauss(duration, _PANELS)
        plain, lever = _weights(times, rate, duration)
        # Any basis of the two weights will do; in a centred one the second is of zero mean.
        middle = self.widths @ lever / duration
        self.weights = np.stack([plain, (lever - middle) / duration])
        standing, levered = _standing_moments(demand, rate, duration)
        total = demand.drag * displacement + standing
        moment = demand.mass * displacement + levered
        self.demanded = np.stack([total, (moment - middle * total) / duration])
        self.mean_thrust = total / duration

    def price(self, multipliers: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return size, shape (n,), and direction, shape (n, 3), of weighted multipliers."""
        vector = np.einsum("ki,kti->ti", multipliers, self.weights)
        size = np.linalg.norm(vector, axis=1)
        return size, vector / np.maximum(size, np.finfo(float).tiny)[:, None]

    def supplied(self, thrust: FloatArray) -> FloatArray:
        """Return the weighted integrals, shape (2, 3), of thrust vectors, shape (n, 3)."""
        return np.einsum("kti,ti->ki", self.weights, self.widths[:, None] * thrust)

    def least_peak(self, axes: tuple[int, ...] = (0, 1, 2)) -> float:
        """Return a thrust that every flight of the mission must reach at some time.

        Parameters
        ----------
        axes : tuple of int
            World axes of which the thrust's components count; all by default.

        Returns
        -------
        float
            Lower bound on the largest thrust along these axes together, N.

        Notes
        -----
        With thrust never above u, multipliers x give x.demanded <= u integral |price(x)|; of the
        multipliers with x.demanded = 1 those of least integral give the largest bound on u.
        Where full thrust reverses, |price| has a corner that costs the quadrature some 1e-4 of
        the result.
        """
        counted = np.zeros((2, 3), dtype=bool)
        counted[:, axes] = True
        demanded = self.demanded[counted]
        if not np.any(demanded):
            return 0.0
        one = demanded / (demanded @ demanded)
        free = null_space(demanded[None, :])

        def size(y: FloatArray) -> tuple[float, FloatArray]:
            multipliers = np.zeros((2, 3))
            multipliers[counted] = one + free @ y
            norm, direction = self.price(multipliers)
            return float(self.widths @ norm), free.T @ self.supplied(direction)[counted]

        found = minimize(size, np.zeros(free.shape[1]), jac=True, method="BFGS")
        return float(1.0 / found.fun)


def _gauss(duration: float, panels: int) -> tuple[FloatArray, FloatArray]:
    """Return nodes and widths of Gauss-Legendre quadrature on equal panels."""
    nodes, widths = np.polynomial.legendre.leggauss(_GAUSS_NODES)
    panel = duration / panels
    starts = panel * np.arange(panels)
    times = (starts[:, None] + panel * (nodes + 1) / 2).ravel()
    return times, np.tile(widths * panel / 2, panels)


def _weights(times: FloatArray, rate: FloatArray, duration: float) -> tuple[FloatArray, FloatArray]:
    """Return the weights of (a) and (b) at times, each of shape (n, 3)."""
    left = (duration - times)[:, None] * np.ones_like(rate)
    has_drag = rate > 0.0
    divisor = np.where(has_drag, rate, 1.0)
    return np.ones_like(left), np.where(has_drag, -np.expm1(-left * rate) / divisor, left)


def _standing_moments(
    demand: MomentumDemand, rate: FloatArray, duration: float
) -> tuple[FloatArray, FloatArray]:
    """Return the integrals over the flight of the standing force, plain and with the lever."""
    previous = None
    for panels in _panel_counts():
        times, widths = _gauss(duration, panels)
        standing = np.array([demand.thrust(float(t)) for t in times])
        moments = [widths @ (weight * standing) for weight in _weights(times, rate, duration)]
        found = np.stack(moments)
        if previous is not None:
            scale = np.max(np.abs(found), axis=1, keepdims=True)
            if np.all(np.abs(found - previous) <= _QUADRATURE_ERROR * scale):
                break
        previous = found
    return found[0], found[1]


def _panel_counts() -> Iterator[int]:
    for doubling in count():
        panels = _FEWEST_PANELS * 2**doubling
        yield panels
        if panels >= _MOST_PANELS:
            return
