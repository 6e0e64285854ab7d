"""Values on a mesh, and the collocation polynomials through them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from pyomo_quad.collocation.errors import TranscriptionError
from pyomo_quad.collocation.nodes import (
    FloatArray,
    barycentric_weights,
    interpolation_matrix,
    radau_rule,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from numpy.typing import NDArray

    from pyomo_quad.collocation.mesh import Mesh

__all__ = ["Trajectory", "control_polynomial", "interpolate", "interpolate_rates", "real_array"]


def real_array(
    held: Mapping[str, NDArray[Any]], name: str, shape: tuple[int | None, ...]
) -> FloatArray:
    """Return one of some arrays that may come from a stranger, checked.

    Parameters
    ----------
    held : mapping
        Name to array.
    name : str
    shape : tuple of int or None
        What is wanted; None where any length will do.

    Returns
    -------
    ndarray
        A copy.

    Raises
    ------
    TranscriptionError
        If there is no such array, or it is not of finite real numbers in that shape.
    """
    if name not in held:
        raise TranscriptionError(f"{name}: is missing.")
    array = held[name]
    wanted = " x ".join("n" if size is None else str(size) for size in shape)
    if array.dtype != np.float64:
        raise TranscriptionError(f"{name}: holds {array.dtype}; must be real numbers (float64).")
    if array.ndim != len(shape) or any(
        size not in (None, found) for size, found in zip(shape, array.shape, strict=True)
    ):
        found = " x ".join(map(str, array.shape)) or "a single number"
        raise TranscriptionError(f"{name}: has the shape {found}; must be {wanted}.")
    if not np.all(np.isfinite(array)):
        raise TranscriptionError(f"{name}: holds a number that is not finite.")
    return np.array(array)


@dataclass(frozen=True, kw_only=True)
class Trajectory:
    """States at the nodes, algebraic variables at the points, static variables.

    Shapes: states (n_points + 1, n_states), algebraics (n_points, n_algebraics),
    statics (n_statics,).
    """

    mesh: Mesh
    states: FloatArray
    algebraics: FloatArray
    statics: FloatArray

    def states_at(self, fractions: FloatArray) -> FloatArray:
        """Return the state polynomials at fractions of the horizon."""
        return interpolate(self.mesh, self.states, fractions, with_start=True)

    def rates_at(self, fractions: FloatArray) -> FloatArray:
        """Return d state / d fraction of the state polynomials."""
        return interpolate_rates(self.mesh, self.states, fractions)

    def algebraics_at(self, fractions: FloatArray) -> FloatArray:
        """Return the polynomials through the algebraic variables."""
        return interpolate(self.mesh, self.algebraics, fractions, with_start=False)


def _by_element(mesh: Mesh, fractions: FloatArray) -> list[tuple[int, np.ndarray, FloatArray]]:
    """Return (element, positions, local coordinates) for each element that is asked for."""
    elements = mesh.locate(fractions)
    starts = np.asarray(mesh.breakpoints)
    groups = []
    order = np.argsort(elements, kind="stable")
    boundaries = np.flatnonzero(np.diff(elements[order])) + 1
    for positions in np.split(order, boundaries):
        if positions.size:
            e = int(elements[positions[0]])
            local = (fractions[positions] - starts[e]) / mesh.widths[e]
            groups.append((e, positions, local))
    return groups


def interpolate(
    mesh: Mesh, values: FloatArray, fractions: FloatArray, *, with_start: bool
) -> FloatArray:
    """Evaluate element polynomials.

    Parameters
    ----------
    mesh : Mesh
    values : ndarray, shape (n_points + 1, k) or (n_points, k)
        At nodes if `with_start`, else at collocation points.
    fractions : ndarray, shape (n,)
    with_start : bool
        Whether each element's polynomial also passes through its left end.

    Returns
    -------
    ndarray, shape (n, k)
    """
    result = np.empty((len(fractions), values.shape[1]))
    for e, positions, local in _by_element(mesh, fractions):
        rule = radau_rule(mesh.degrees[e])
        first, last = mesh.first_node[e], mesh.first_node[e + 1]
        nodes = rule.nodes if with_start else rule.points
        held = values[first : last + 1] if with_start else values[first:last]
        result[positions] = interpolation_matrix(nodes, local) @ held
    return result


def interpolate_rates(mesh: Mesh, states: FloatArray, fractions: FloatArray) -> FloatArray:
    """Evaluate the slopes of the state polynomials, shape (n, n_states)."""
    result = np.empty((len(fractions), states.shape[1]))
    for e, positions, local in _by_element(mesh, fractions):
        rule = radau_rule(mesh.degrees[e])
        first, last = mesh.first_node[e], mesh.first_node[e + 1]
        slopes = np.vstack([rule.slope_at_start, rule.differentiation]) / mesh.widths[e]
        held = slopes @ states[first : last + 1]
        result[positions] = interpolation_matrix(rule.nodes, local) @ held
    return result


def control_polynomial(
    mesh: Mesh, values: FloatArray, element: int, start: float, end: float
) -> Callable[[float], FloatArray]:
    """Return one element's polynomial through values at its points, as a function of time.

    Parameters
    ----------
    mesh : Mesh
    values : ndarray, shape (n_points, k)
    element : int
    start, end : float
        Times of the element's ends.

    Returns
    -------
    callable
        t -> ndarray, shape (k,).
    """
    points = radau_rule(mesh.degrees[element]).points
    weights = barycentric_weights(points)
    held = values[mesh.first_node[element] : mesh.first_node[element + 1]]
    width = end - start

    def polynomial(t: float) -> FloatArray:
        difference = (t - start) / width - points
        nearest = int(np.argmin(np.abs(difference)))
        if difference[nearest] == 0.0:
            return np.asarray(held[nearest], dtype=float)
        terms = weights / difference
        return np.asarray(terms @ held / terms.sum(), dtype=float)

    return polynomial
