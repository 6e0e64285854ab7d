"""Integration of differential equations by SciPy, and of linear systems by matrix exponentials.

For linear systems see docs/theory/risk.md, eq. (5), and docs/theory/tracking.md, eq. (2).
"""

from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from pyomo_quad.arrays import FloatArray
from pyomo_quad.collocation import SolveError

Rates = Callable[[float, FloatArray], FloatArray]

# Distance from a jump of the rates, relative to the time between two jumps, at which the rates at
# the jump are evaluated.
_INSIDE = 1e-6
# Time between two jumps [s] below which they are the same jump up to rounding.
_SHORTEST = 1e-7


def integrate(
    rates: Rates,
    span: tuple[float, float],
    start: ArrayLike,
    times: Sequence[float] | FloatArray,
    edges: Sequence[float],
    *,
    flight: str,
    remedy: str,
    **options: Any,
) -> FloatArray:
    """Integrate differential equations over a time span; return the states at given times.

    The integration is restarted at each time at which the rates jump (an edge).

    Parameters
    ----------
    rates : callable
        Right-hand side: time [s] and states -> time derivatives, shape (n_states,).
    span : (float, float)
        First and last time [s].
    start : array_like, shape (n_states,)
        States at the first time.
    times : sequence of float
        Increasing times within the span [s] at which states are returned.
    edges : sequence of float
        Increasing times [s] between which the rates are smooth; edges outside the span are ignored.
    flight, remedy : str
        Name of the flight, and advice to the user: the beginning and the end of the error message
        if the integration fails.
    **options
        Further options of `scipy.integrate.solve_ivp`.

    Returns
    -------
    ndarray, shape (n_states, n_times)
        States at `times`.

    Raises
    ------
    SolveError
        If the integrator stops before the end of the span.
    """
    wanted = np.asarray(times, dtype=float)
    inner = [edge for edge in edges if span[0] + _SHORTEST < edge < span[1] - _SHORTEST]
    state = np.asarray(start, dtype=float)
    found: list[FloatArray] = []
    # A restart takes about twenty evaluations. An integrator that steps over a jump takes hundreds,
    # because it repeats its steps until they are as short as its tolerance requires.
    for first, last in pairwise((span[0], *inner, span[1])):
        is_last = last == span[1]
        here = wanted[(wanted >= first) & ((wanted <= last) if is_last else (wanted < last))]
        flown = solve_ivp(
            _within(rates, first, last) if inner else rates,
            (first, last),
            state,
            t_eval=here if is_last and (here.size and here[-1] == last) else np.append(here, last),
            **options,
        )
        if not flown.success:
            stopped = float(flown.t[-1]) if np.size(flown.t) else first
            raise SolveError(
                f"{flight}: the integration stopped at {stopped:.4g} s: {flown.message} {remedy}"
            )
        state = flown.y[:, -1]
        found.append(flown.y[:, : here.size])
    return np.hstack(found)


def _within(rates: Rates, first: float, last: float) -> Rates:
    """Return a right-hand side that clips its time to the inside of the interval [first, last]."""
    # The rates may jump at the ends of the interval. Without these jumps, an integrator need not
    # shorten its steps.
    margin = _INSIDE * (last - first)

    def inside(t: float, y: FloatArray) -> FloatArray:
        return rates(min(max(t, first + margin), last - margin), y)

    return inside


def discrete(
    A: FloatArray, B: FloatArray, step: float | FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the transition and input matrices of a linear system, for steps of constant input.

    The matrices Phi and Gamma give the state at the end of a step (Van Loan, 1978): x_end = Phi
    x_start + Gamma u.

    Parameters
    ----------
    A, B : ndarray, shapes (n, n_x, n_x), (n, n_x, n_u)
        Matrices of dx/dt = A x + B u, constant over each of the n steps.
    step : float or ndarray, shape (n,)
        Length of each step [s].

    Returns
    -------
    ndarray, shape (n, n_x, n_x)
        Transition matrices Phi.
    ndarray, shape (n, n_x, n_u)
        Input matrices Gamma.
    """
    n, n_x, n_u = B.shape
    length = np.reshape(step, (-1, 1, 1))
    joined = np.zeros((n, n_x + n_u, n_x + n_u))
    joined[:, :n_x, :n_x], joined[:, :n_x, n_x:] = length * A, length * B
    exponential = expm(joined)
    return exponential[:, :n_x, :n_x], exponential[:, :n_x, n_x:]
