"""Functions of time kept as polynomials, so that they outlive the rules that give them."""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from numpy.polynomial import chebyshev

from pyomo_quad.collocation.errors import TranscriptionError
from pyomo_quad.collocation.reading.schedules import Reading

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from pyomo_quad.collocation.mesh import FloatArray

_DEGREE = 12
# Largest error, relative to the values of a piece, and the width that no piece is halved below.
_ACCURACY = 1e-13
_RESOLUTION = 1e-14
_MOST_PIECES = 20_000
_NODES = chebyshev.chebpts1(_DEGREE + 1)
_TO_COEFFICIENTS = np.linalg.inv(chebyshev.chebvander(_NODES, _DEGREE))
# Where a polynomial is compared with its function, on [-1, 1]: between its nodes.
_COMPARED = np.array([-0.97, -0.61, -0.28, 0.13, 0.52, 0.83, 0.99])


@dataclass(frozen=True, kw_only=True)
class Interpolant:
    """Numbers over time: Chebyshev coefficients between edges; of none, only why.

    The coefficients of a piece have shape (degree + 1, n_numbers); a jump is an edge, and
    belongs to the piece that it starts.
    """

    edges: tuple[float, ...]
    pieces: tuple[FloatArray, ...]
    refusal: str

    def row(self, time: float) -> list[float]:
        """Return the numbers at a time.

        Raises
        ------
        TranscriptionError
            If the time is outside the edges.
        """
        if not self.pieces or not self.edges[0] <= time <= self.edges[-1]:
            raise TranscriptionError(self.refusal)
        k = min(bisect_right(self.edges, time), len(self.pieces)) - 1
        start, end = self.edges[k], self.edges[k + 1]
        local = (2.0 * time - start - end) / (end - start)
        return np.asarray(chebyshev.chebval(local, self.pieces[k])).tolist()

    def reading(self, time: float) -> Reading:
        """Return the numbers at a time as what a rule says there."""
        return Reading(None, tuple(self.row(time)))

    def __call__(self, time: float) -> float:
        """Return the first number at a time."""
        return self.row(time)[0]


def interpolant(
    name: str,
    row: Callable[[float], Sequence[float]],
    horizon: tuple[float, float],
    jumps: Sequence[float],
) -> Interpolant:
    """Return what a function gives over a horizon; one that fails leaves its message.

    Between jumps, pieces are halved until a polynomial has their values: a kink is bracketed.
    """
    start, end = horizon
    refusal = (
        f"{name}: is known over [{start:g}, {end:g}] only, since its rule was not pickled; stay "
        "within these times, or compile the model again."
    )
    edges, pieces = [start], []
    waiting = list(pairwise([start, *(t for t in jumps if start < t < end), end]))[::-1]
    try:
        while waiting:
            first, last = waiting.pop()
            piece, is_accurate = _fitted(row, first, last)
            if is_accurate or last - first <= _RESOLUTION * (end - start):
                edges.append(last)
                pieces.append(piece)
                continue
            if len(pieces) > _MOST_PIECES:
                refusal = f"{name}: its rule is too rough to be pickled; compile the model again."
                return Interpolant(edges=(), pieces=(), refusal=refusal)
            middle = 0.5 * (first + last)
            waiting += [(middle, last), (first, middle)]
    except TranscriptionError as error:
        return Interpolant(edges=(), pieces=(), refusal=str(error))
    return Interpolant(edges=tuple(edges), pieces=tuple(pieces), refusal=refusal)


def _fitted(
    row: Callable[[float], Sequence[float]], first: float, last: float
) -> tuple[FloatArray, bool]:
    """Return the polynomial through a function at Chebyshev's nodes, and if it is the function."""
    local = np.concatenate([_NODES, _COMPARED])
    times = 0.5 * (first + last) + 0.5 * (last - first) * local
    values = np.array([row(float(t)) for t in times])
    if np.all(values == values[0]):
        return values[:1], True
    piece = _TO_COEFFICIENTS @ values[: len(_NODES)]
    errors = np.abs(chebyshev.chebval(_COMPARED, piece).T - values[len(_NODES) :])
    return piece, bool(np.all(errors <= _ACCURACY * np.abs(values).max(axis=0)))
