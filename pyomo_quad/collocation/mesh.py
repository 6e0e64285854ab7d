"""The mesh: where the elements begin and end, and the degree of each."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from pyomo_quad.collocation.errors import TranscriptionError
from pyomo_quad.collocation.nodes import FloatArray, radau_rule
from pyomo_quad.collocation.trajectory import real_array

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from numpy.typing import NDArray

__all__ = ["Mesh"]

# Of a mesh that is read from a file; nodes of a higher degree take long to compute.
_HIGHEST_DEGREE = 100


@dataclass(frozen=True, kw_only=True)
class Mesh:
    """Elements of any widths and degrees on the horizon, measured as fractions from 0 to 1.

    Parameters
    ----------
    breakpoints : tuple of float, length n_elements + 1
        Element boundaries, from exactly 0 to exactly 1, strictly increasing.
    degrees : tuple of int, length n_elements
        Collocation points per element, each at least 1.

    Raises
    ------
    TranscriptionError
        If boundaries do not increase from 0 to 1, or a degree is below 1.
    """

    breakpoints: tuple[float, ...]
    degrees: tuple[int, ...]

    def __post_init__(self) -> None:
        if len(self.breakpoints) != len(self.degrees) + 1 or not self.degrees:
            raise TranscriptionError(
                f"mesh: {len(self.breakpoints)} breakpoints for {len(self.degrees)} degrees; "
                "there must be one more breakpoint than elements, and at least one element."
            )
        if self.breakpoints[0] != 0.0 or self.breakpoints[-1] != 1.0:
            raise TranscriptionError(
                f"mesh: breakpoints run from {self.breakpoints[0]} to {self.breakpoints[-1]}; "
                "they are fractions of the horizon and must run from 0 to 1."
            )
        if not np.all(np.diff(self.breakpoints) > 0.0):
            raise TranscriptionError("mesh: breakpoints must increase strictly.")
        for degree in set(self.degrees):
            if degree != int(degree):
                raise TranscriptionError(f"mesh: degree {degree}; must be a whole number.")
            radau_rule(degree)

    @classmethod
    def uniform(cls, elements: int, degree: int) -> Mesh:
        """Return a mesh of equal elements of one degree."""
        if elements < 1:
            raise TranscriptionError(f"mesh: {elements} elements; must be at least 1.")
        breakpoints = tuple(float(b) for b in np.arange(elements + 1) / elements)
        return cls(breakpoints=breakpoints, degrees=(degree,) * elements)

    @classmethod
    def from_arrays(cls, held: Mapping[str, NDArray[Any]]) -> Mesh:
        """Return the mesh of arrays "breakpoints" and "degrees" that may come from a stranger.

        Raises
        ------
        TranscriptionError
            If one is missing, is not of real or whole numbers, or they are no mesh.
        """
        breakpoints = real_array(held, "breakpoints", (None,))
        degrees = held.get("degrees")
        if degrees is None or degrees.dtype.kind != "i" or degrees.ndim != 1:
            raise TranscriptionError("degrees: must be a row of whole numbers.")
        if degrees.size and not 1 <= int(degrees.min()) <= int(degrees.max()) <= _HIGHEST_DEGREE:
            raise TranscriptionError(f"degrees: must be from 1 to {_HIGHEST_DEGREE}.")
        return cls(
            breakpoints=tuple(float(b) for b in breakpoints),
            degrees=tuple(int(d) for d in degrees),
        )

    def with_breakpoints(self, fractions: Iterable[float]) -> Mesh:
        """Return this mesh with further element boundaries, where it has none already."""
        breakpoints, degrees = list(self.breakpoints), list(self.degrees)
        for fraction in sorted(fractions):
            nearest = min(range(len(breakpoints)), key=lambda i: abs(breakpoints[i] - fraction))
            if abs(breakpoints[nearest] - fraction) < 1e-12:
                continue
            after = int(np.searchsorted(breakpoints, fraction))
            breakpoints.insert(after, float(fraction))
            degrees.insert(after, degrees[after - 1])
        return Mesh(breakpoints=tuple(breakpoints), degrees=tuple(degrees))

    @property
    def elements(self) -> int:
        """Number of elements."""
        return len(self.degrees)

    @cached_property
    def points(self) -> int:
        """Number of collocation points."""
        return int(sum(self.degrees))

    @cached_property
    def widths(self) -> FloatArray:
        """Element widths as fractions of the horizon, shape (n_elements,)."""
        return np.diff(self.breakpoints)

    @cached_property
    def first_node(self) -> NDArray[np.intp]:
        """Index of the node at the start of each element, shape (n_elements + 1,)."""
        return np.concatenate(([0], np.cumsum(self.degrees))).astype(np.intp)

    @cached_property
    def element_of_point(self) -> NDArray[np.intp]:
        """Element that each collocation point belongs to, shape (n_points,)."""
        return np.repeat(np.arange(self.elements), self.degrees)

    @cached_property
    def point_fractions(self) -> FloatArray:
        """Collocation points as fractions of the horizon, shape (n_points,)."""
        starts = np.asarray(self.breakpoints)
        fractions = np.concatenate(
            [starts[e] + self.widths[e] * radau_rule(d).points for e, d in enumerate(self.degrees)]
        )
        fractions[self.first_node[1:] - 1] = starts[1:]
        return fractions

    @cached_property
    def node_fractions(self) -> FloatArray:
        """State nodes as fractions of the horizon: 0 and the points, shape (n_points + 1,)."""
        return np.concatenate(([0.0], self.point_fractions))

    @cached_property
    def quadrature_weights(self) -> FloatArray:
        """Radau weights times element widths, sum 1, shape (n_points,)."""
        return np.concatenate(
            [self.widths[e] * radau_rule(d).weights for e, d in enumerate(self.degrees)]
        )

    def locate(self, fractions: FloatArray) -> NDArray[np.intp]:
        """Return the element of each fraction; a boundary belongs to the element it ends."""
        inner = np.asarray(self.breakpoints)[1:-1]
        return np.searchsorted(inner, fractions, side="left").astype(np.intp)
