"""Flights by SciPy's integrators, begun anew wherever a parameter of the equations steps."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.integrate import solve_ivp

FloatArray = NDArray[np.float64]
Rates = Callable[[float, FloatArray], FloatArray]

# How far inside its piece a time at which it begins or ends is read, as a share of the piece.
_INSIDE = 1e-6
# s. A piece shorter than this is the rounding of two times that are one.
_SHORTEST = 1e-7


@dataclass(frozen=True, kw_only=True)
class Integrated:
    """States at the times asked for, shape (n_states, n_times), or why there are fewer of them."""

    y: FloatArray
    message: str
    stopped_at: float | None
    """When the integrator gave up [s]; None where it did not."""


def integrate(
    rates: Rates,
    span: tuple[float, float],
    start: ArrayLike,
    times: Sequence[float] | FloatArray,
    edges: Sequence[float],
    **options: Any,
) -> Integrated:
    """Integrate rates over a span, from edge to edge.

    An integrator that steps over a jump of its rates repeats steps until they are as short as its
    tolerance asks, hundreds of evaluations for each jump; one that begins anew needs a score.

    Parameters
    ----------
    times : sequence of float
        Rising times within the span at which states are returned.
    edges : sequence of float
        Rising times between which the rates are smooth; those outside the span are not read.
    **options
        Of `scipy.integrate.solve_ivp`.
    """
    wanted = np.asarray(times, dtype=float)
    inner = [edge for edge in edges if span[0] + _SHORTEST < edge < span[1] - _SHORTEST]
    state = np.asarray(start, dtype=float)
    found: list[FloatArray] = []
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
            return Integrated(y=_joined(found, state), message=flown.message, stopped_at=stopped)
        state = flown.y[:, -1]
        found.append(flown.y[:, : here.size])
    return Integrated(y=_joined(found, state), message="", stopped_at=None)


def _within(rates: Rates, first: float, last: float) -> Rates:
    """Return rates that read the equations of one piece at its ends too."""
    margin = _INSIDE * (last - first)

    def inside(t: float, y: FloatArray) -> FloatArray:
        return rates(min(max(t, first + margin), last - margin), y)

    return inside


def _joined(found: Sequence[FloatArray], state: FloatArray) -> FloatArray:
    return np.hstack(found) if found else np.zeros((state.size, 0))
