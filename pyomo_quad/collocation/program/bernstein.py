"""Bounds on variables between the collocation points, through Bernstein coefficients.

A polynomial lies in the convex hull of its coefficients in Bernstein's basis [1]_: if the
coefficients satisfy a bound, the whole polynomial does. The converse is false, so bounding the
coefficients restricts the solution more than necessary. The multipliers give the cost of this
restriction: see docs/theory/transcription.md, eqs. (6) and (7).

.. [1] Farouki, "The Bernstein polynomial basis: a centennial retrospective", Computer Aided
   Geometric Design 29 (2012).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.sparse import csr_array
from scipy.special import comb

from pyomo_quad.collocation.mesh import radau_rule
from pyomo_quad.collocation.program.bounds import Bounds, ChangedProgram, Scaling
from pyomo_quad.collocation.program.ipopt import barrier_gap

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pyomo_quad.collocation.mesh import FloatArray
    from pyomo_quad.collocation.program.ipopt import IpoptResult, Multipliers
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
class BoundedProgram(ChangedProgram):
    """A program with additional linear rows: bounded coefficients in some elements.

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

    @property
    def n_rows(self) -> int:
        """Number of rows."""
        return self.program.n_rows + self.lower.size

    def constraints(self, z: FloatArray) -> FloatArray:
        """Return the value of every row."""
        return np.concatenate([self.program.constraints(z), self.coefficients @ z])

    def jacobianstructure(self) -> tuple[Any, Any]:
        """Return rows and columns of the Jacobian's nonzeros."""
        own, below = self.program.jacobianstructure(), self.coefficients.tocoo()
        return (
            np.concatenate([own[0], self.program.n_rows + below.row]),
            np.concatenate([own[1], below.col]),
        )

    def jacobian(self, z: FloatArray) -> FloatArray:
        """Return the Jacobian's nonzeros."""
        return np.concatenate([self.program.jacobian(z), self.coefficients.data])

    def hessian(self, z: FloatArray, multipliers: FloatArray, factor: float) -> FloatArray:
        """Return the nonzeros of the Lagrangian's Hessian, to which linear rows add nothing."""
        return self.program.hessian(z, multipliers[: self.program.n_rows], factor)

    def bounds(self, own: Bounds) -> Bounds:
        """Return the bounds of a program, extended by those of its coefficients."""
        return replace(
            own,
            row_lower=np.concatenate([own.row_lower, self.lower]),
            row_upper=np.concatenate([own.row_upper, self.upper]),
        )

    def scaling(self, own: Scaling) -> Scaling:
        """Return the scaling of a program, extended by scales of its Bernstein coefficients."""
        rows = self.coefficients
        entries = np.abs(rows.data) / own.unknowns[rows.indices]
        sizes = np.maximum.reduceat(entries, rows.indptr[:-1])
        return replace(own, rows=np.concatenate([own.rows, 1.0 / sizes]))

    def multipliers(self, own: Multipliers) -> Multipliers:
        """Return the multipliers of a program, extended by zeros for its coefficients."""
        return replace(own, rows=np.concatenate([own.rows, np.zeros(self.lower.size)]))

    def without(self, result: IpoptResult) -> IpoptResult:
        """Return a result without the multipliers of the coefficients."""
        rows = result.multipliers.rows[: self.program.n_rows]
        return replace(result, multipliers=replace(result.multipliers, rows=rows))

    def restraint(self, result: IpoptResult, bounds: Bounds, elements: int) -> Restraint:
        """Return the cost of bounding the coefficients, and the barrier's gap, for a result."""
        pull = result.multipliers.rows[self.program.n_rows :]
        beyond = self.coefficients @ result.z - self.values @ result.z
        cost = np.zeros(elements)
        np.add.at(cost, self.elements, np.maximum(pull * beyond, 0.0))
        return Restraint(cost=cost, gap=barrier_gap(self, bounds, result.z, result.multipliers))


@dataclass(frozen=True, kw_only=True)
class Restraint:
    """Effect on the objective of bounding the polynomial between the points, in its unit.

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
) -> BoundedProgram | None:
    """Return a program with bounds between its points where a trajectory is near its bounds.

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
    BoundedProgram or None
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
    return BoundedProgram(
        program=program,
        coefficients=_assembled([(at, rule.coefficients) for _, at, rule, _, _ in found], z.size),
        values=_assembled([(at, rule.values) for _, at, rule, _, _ in found], z.size),
        lower=lower - breach * np.maximum(1.0, np.abs(lower)),
        upper=upper + breach * np.maximum(1.0, np.abs(upper)),
        elements=np.repeat([held[0] for held in found], sizes),
    )


def _limits(bounds: Bounds, columns: NDArray[np.intp]) -> tuple[float, float]:
    """Return the bounds of a variable in an element, infinite where they vary in it."""
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
