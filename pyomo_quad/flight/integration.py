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
    """Integrate differential equations; return the states at `times`, shape (n_states, n_times).

    `rates` takes time [s] and states. The integration restarts at `edges`, the times at which the
    rates jump. `options` are those of `solve_ivp`. If the integration stops early, a SolveError is
    raised; its message begins with `flight` and ends with `remedy`.
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
    """Return the right-hand side `rates` with its time clipped to the inside of [first, last].

    The clipped time keeps a distance of 1e-6 of the interval's length from both ends.
    """
    # The rates may jump at the ends of the interval. Without these jumps, an integrator need not
    # shorten its steps.
    margin = _INSIDE * (last - first)

    def inside(t: float, y: FloatArray) -> FloatArray:
        return rates(min(max(t, first + margin), last - margin), y)

    return inside


def discrete(
    A: FloatArray, B: FloatArray, step: float | FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return Phi and Gamma of x_end = Phi x_start + Gamma u, for n steps of dx/dt = A x + B u.

    The input u is constant in each step, of length `step` [s] (Van Loan, 1978). A and Phi have
    shape (n, n_x, n_x), B and Gamma (n, n_x, n_u).
    """
    n, n_x, n_u = B.shape
    length = np.reshape(step, (-1, 1, 1))
    joined = np.zeros((n, n_x + n_u, n_x + n_u))
    joined[:, :n_x, :n_x], joined[:, :n_x, n_x:] = length * A, length * B
    exponential = expm(joined)
    return exponential[:, :n_x, :n_x], exponential[:, :n_x, n_x:]
