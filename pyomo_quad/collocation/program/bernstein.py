"""Bounds on variables between the collocation points, through Bernstein coefficients.

A polynomial lies in the convex hull of its coefficients in Bernstein's basis [1]_: if the
coefficients satisfy a bound, the whole polynomial does. The converse is false, so bounding the
coefficients restricts the solution more than necessary. The multipliers give the cost of this
restriction: see docs/theory/transcription.md, eqs. (6) and (7).

.. [1] Farouki, "The Bernstein polynomial basis: a centennial retrospective", Computer Aided
   Geometric Design 29 (2012).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from scipy.sparse import csr_array
from scipy.special import comb

from pyomo_quad.collocation.mesh import radau_rule
from pyomo_quad.collocation.program.nonlinear import ExtendedProgram

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pyomo_quad.collocation.mesh import FloatArray
    from pyomo_quad.collocation.program.ipopt import IpoptResult
    from pyomo_quad.collocation.program.nonlinear import Bounds, NonlinearProgram, Scaling
    from pyomo_quad.collocation.program.transcription import Transcription

# A coefficient of the first point is bounded if its distance from a bound is less than this
# fraction of its range or size.
_NEAR = 0.45


@dataclass(frozen=True, kw_only=True)
class BernsteinRule:
    """Matrices from an element's values to its coefficients, and to values at their abscissae.

    Both of shape (n_coefficients, n_values). Coefficients that equal nodal values are left out: the
    first and last of a state, the last of an algebraic variable.
    """

    coefficients: FloatArray
    values: FloatArray


@lru_cache(maxsize=64)
def bernstein_rule(degree: int, *, is_state: bool) -> BernsteinRule:
    """Return the rule for a state's values at the nodes, or another variable's at the points."""
    rule = radau_rule(degree)
    at = rule.nodes if is_state else rule.points
    kept = slice(int(is_state), -1)
    coefficients = np.asarray(np.linalg.inv(_basis(at, at.size - 1)), dtype=float)
    abscissae = np.linspace(0.0, 1.0, at.size)
    return BernsteinRule(
        coefficients=coefficients[kept],
        values=(_basis(abscissae, at.size - 1) @ coefficients)[kept],
    )


def _basis(places: FloatArray, order: int) -> FloatArray:
    """Return Bernstein's polynomials at places, shape (n_places, order + 1)."""
    k, t = np.arange(order + 1), places[:, None]
    return np.asarray(comb(order, k) * t**k * (1.0 - t) ** (order - k))


@dataclass(frozen=True, kw_only=True)
class BernsteinRows:
    """Bounded coefficients of some elements, as additional linear rows of a program.

    Attributes
    ----------
    coefficients, values : csr_array, shape (n_coefficients, n_unknowns)
        Matrices from the unknowns to the coefficients, and to the values at their abscissae.
    lower, upper : ndarray, shape (n_coefficients,)
    elements : ndarray of int, shape (n_coefficients,)
    """

    coefficients: csr_array
    values: csr_array
    lower: FloatArray
    upper: FloatArray
    elements: NDArray[np.intp]

    def added_to(self, program: NonlinearProgram) -> ExtendedProgram:
        """Return a program with these rows after its own."""
        rows = self.coefficients
        starts = np.append(np.zeros(program.n_rows, dtype=rows.indptr.dtype), rows.indptr)
        shape = (starts.size - 1, rows.shape[1])
        terms = csr_array((rows.data, rows.indices, starts), shape=shape)
        return ExtendedProgram(program=program, terms=terms)

    def scales(self, own: Scaling) -> FloatArray:
        """Return the scales of the rows, given the scaling of the unknowns."""
        rows = self.coefficients
        entries = np.abs(rows.data) / own.unknowns[rows.indices]
        return np.asarray(1.0 / np.maximum.reduceat(entries, rows.indptr[:-1]))

    def restraint(self, result: IpoptResult, gap: float, elements: int) -> Restraint:
        """Return by how much these rows raise the objective, at a result with a barrier gap."""
        pull = result.multipliers.rows[-self.lower.size :]
        beyond = self.coefficients @ result.z - self.values @ result.z
        cost = np.zeros(elements)
        np.add.at(cost, self.elements, np.maximum(pull * beyond, 0.0))
        return Restraint(cost=cost, gap=gap)


@dataclass(frozen=True, kw_only=True)
class Restraint:
    """Increase of the objective by the bounds that are imposed between the collocation points.

    Attributes
    ----------
    cost : ndarray, shape (n_elements,)
        Cost per element of bounding coefficients that lie outside the polynomial, to first order.
    gap : float
        Complementarity gap that the barrier leaves, over all bounds.
    """

    cost: FloatArray
    gap: float


def bounded(
    program: Transcription, bounds: Bounds, z: FloatArray, breach: float
) -> BernsteinRows | None:
    """Return bounds between the points of a program where a trajectory is near its bounds.

    Parameters
    ----------
    program : Transcription
    bounds : Bounds
        Bounds that change within an element are not imposed between its points.
    z : ndarray
        The trajectory, carried over from another mesh.
    breach : float
        Amount by which a coefficient may exceed a bound, relative to max(1, |bound|).

    Returns
    -------
    BernsteinRows or None
        None if the trajectory is near no bound.
    """
    mesh, layout, found = program.mesh, program.layout, []
    if mesh is None:
        return None
    for is_state, columns in ((True, layout.state_columns), (False, layout.algebraic_columns)):
        for e, degree in enumerate(mesh.degrees):
            rule = bernstein_rule(degree, is_state=is_state)
            for at in columns[mesh.first_node[e] : mesh.first_node[e + 1] + is_state].T:
                low, high = _limits(bounds, at[int(is_state) :])
                if _is_near(rule.coefficients @ z[at], low, high):
                    found.append((e, at, rule, low, high))
    sizes = [len(rule.coefficients) for _, _, rule, _, _ in found]
    if not sum(sizes):
        return None
    lower, upper = (np.repeat([held[k] for held in found], sizes) for k in (3, 4))
    return BernsteinRows(
        coefficients=_assembled([(at, rule.coefficients) for _, at, rule, _, _ in found], z.size),
        values=_assembled([(at, rule.values) for _, at, rule, _, _ in found], z.size),
        lower=lower - breach * np.maximum(1.0, np.abs(lower)),
        upper=upper + breach * np.maximum(1.0, np.abs(upper)),
        elements=np.repeat([held[0] for held in found], sizes),
    )


def _limits(bounds: Bounds, columns: NDArray[np.intp]) -> tuple[float, float]:
    """Return a variable's constant bounds in an element, infinite where a bound varies in it."""
    low, high = bounds.lower[columns], bounds.upper[columns]
    return (
        float(low[0]) if np.all(low == low[0]) else -np.inf,
        float(high[0]) if np.all(high == high[0]) else np.inf,
    )


def _is_near(values: FloatArray, low: float, high: float) -> bool:
    sides = [side for side in (low, high) if np.isfinite(side)]
    if not sides:
        return False
    room = _NEAR * (high - low if len(sides) == 2 else max(1.0, abs(sides[0])))
    return bool(np.any((values < low + room) | (values > high - room)))


def _assembled(parts: list[tuple[NDArray[np.intp], FloatArray]], width: int) -> csr_array:
    """Return one sparse matrix from blocks of rows with given columns."""
    data = np.concatenate([block.ravel() for _, block in parts])
    columns = np.concatenate([np.tile(at, len(block)) for at, block in parts])
    sizes = np.concatenate([np.full(len(block), at.size) for at, block in parts])
    return csr_array((data, columns, np.cumsum([0, *sizes])), shape=(sizes.size, width))
