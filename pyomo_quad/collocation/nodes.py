"""Flipped Radau points and barycentric matrices on the unit interval.

The collocation points of an element are the Radau IIA points in (0, 1], the right end
included; the state polynomial passes through them and through the left end, 0.

| symbol | shape | meaning |
|---|---|---|
| points | (d,) | collocation points, last one exactly 1 |
| weights | (d,) | Radau weights, exact to polynomial degree 2d - 2, sum 1 |
| nodes | (d + 1,) | 0 and the collocation points: where the state is known |
| differentiation | (d, d + 1) | slope of the state polynomial at the points |
| slope_at_start | (d + 1,) | its slope at 0 |
| integration | (d, d) | inverse of the square part of `differentiation` (Radau IIA's A matrix) |

Sources: Garg et al. (2010), Automatica 46, 1843-1851; Berrut and Trefethen (2004),
SIAM Review 46, 501-517 for the barycentric formulas.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.special import roots_jacobi

from pyomo_quad.collocation.errors import TranscriptionError

__all__ = ["RadauRule", "barycentric_weights", "interpolation_matrix", "radau_rule"]

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class RadauRule:
    """Points, weights and matrices of one degree on the unit interval."""

    degree: int
    points: FloatArray
    weights: FloatArray
    nodes: FloatArray
    differentiation: FloatArray
    slope_at_start: FloatArray
    integration: FloatArray


def barycentric_weights(nodes: FloatArray) -> FloatArray:
    """Return the barycentric weights of distinct nodes on an interval of length 1.

    Differences are multiplied by 4, the inverse capacity of the interval, so that the
    products neither underflow nor overflow at high degree.
    """
    differences = 4.0 * (nodes[:, None] - nodes[None, :])
    np.fill_diagonal(differences, 1.0)
    return np.asarray(1.0 / np.prod(differences, axis=1), dtype=float)


def interpolation_matrix(nodes: FloatArray, targets: FloatArray) -> FloatArray:
    """Return the matrix that takes values at `nodes` to values at `targets`.

    Parameters
    ----------
    nodes : ndarray, shape (n,)
        Distinct nodes of the polynomial, in the unit interval.
    targets : ndarray, shape (m,)
        Where it is evaluated; a target equal to a node reproduces it exactly.

    Returns
    -------
    ndarray, shape (m, n)
    """
    weights = barycentric_weights(nodes)
    difference = targets[:, None] - nodes[None, :]
    exact = difference == 0.0
    difference[exact] = 1.0
    terms = weights[None, :] / difference
    hit = exact.any(axis=1)
    terms[hit] = exact[hit].astype(float)
    return np.asarray(terms / terms.sum(axis=1, keepdims=True), dtype=float)


def _square_differentiation(nodes: FloatArray) -> FloatArray:
    weights = barycentric_weights(nodes)
    difference = nodes[:, None] - nodes[None, :]
    np.fill_diagonal(difference, 1.0)
    matrix = weights[None, :] / weights[:, None] / difference
    np.fill_diagonal(matrix, 0.0)
    np.fill_diagonal(matrix, -matrix.sum(axis=1))
    return np.asarray(matrix, dtype=float)


@lru_cache(maxsize=256)
def radau_rule(degree: int) -> RadauRule:
    """Return the flipped Radau rule with `degree` collocation points.

    Parameters
    ----------
    degree : int
        Number of collocation points in the element, at least 1.

    Raises
    ------
    TranscriptionError
        If the degree is below 1.

    Notes
    -----
    The interior points are the zeros of the Jacobi polynomial P(1, 0) of degree d - 1.
    """
    if degree < 1:
        raise TranscriptionError(
            f"mesh: element degree = {degree}; must be at least 1, 3 to 12 is usual."
        )
    if degree == 1:
        points, weights = np.array([1.0]), np.array([1.0])
    else:
        interior, jacobi_weights = roots_jacobi(degree - 1, 1.0, 0.0)
        points = np.append(0.5 * (1.0 + interior), 1.0)
        weights = np.append(0.5 * jacobi_weights / (1.0 - interior), 1.0 / degree**2)
    nodes = np.concatenate(([0.0], points))
    square = _square_differentiation(nodes)
    rule = RadauRule(
        degree=degree,
        points=points,
        weights=weights,
        nodes=nodes,
        differentiation=square[1:],
        slope_at_start=square[0],
        integration=np.asarray(np.linalg.inv(square[1:, 1:]), dtype=float),
    )
    for array in (rule.points, rule.weights, rule.nodes, rule.differentiation):
        array.setflags(write=False)
    return rule
