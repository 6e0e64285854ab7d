"""Bounds on variables between the collocation points, through Bernstein coefficients.

A polynomial lies in the convex hull of its coefficients in Bernstein's basis [1]_. If all
coefficients satisfy a bound, the whole polynomial satisfies it, too. The converse is false, so
bounds on coefficients restrict the solution more than necessary. For an estimate of the resulting
increase of the objective, see docs/theory/transcription.md, eqs. (6) and (7).

The abscissa of coefficient k of a polynomial of degree n is the fraction k / n of the element.

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

# Margin within which a coefficient counts as near a bound at the initial point; see `_is_near`.
_NEAR = 0.45


@dataclass(frozen=True, kw_only=True)
class BernsteinRule:
    """Linear maps from a variable's values in an element to its Bernstein coefficients.

    A coefficient at an end of the element is left out if the variable has a value there.

    Attributes
    ----------
    coefficients : ndarray, shape (n_coefficients, n_values)
        Matrix from the values to the coefficients.
    values : ndarray, shape (n_coefficients, n_values)
        Matrix from the values to the polynomial's values at the abscissae of the coefficients. They
        are compared with the coefficients. A coefficient that is left out has no row. The abscissae
        are k / (n_values - 1), where k counts all coefficients from 0.
    """

    coefficients: FloatArray
    values: FloatArray


@lru_cache(maxsize=64)
def bernstein_rule(degree: int, *, is_state: bool) -> BernsteinRule:
    """Return the maps from a variable's values in an element to its Bernstein coefficients.

    `degree` is the number of collocation points. A state also has a value at the left end of the
    element; an algebraic variable does not.
    """
    rule = radau_rule(degree)
    at = rule.nodes if is_state else rule.points
    # The first and the last coefficient are the values at the ends of the element. Those that are
    # unknowns of the program have bounds already.
    kept = slice(int(is_state), -1)
    coefficients = np.asarray(np.linalg.inv(_basis(at, at.size - 1)), dtype=float)
    abscissae = np.linspace(0.0, 1.0, at.size)
    return BernsteinRule(
        coefficients=coefficients[kept],
        values=(_basis(abscissae, at.size - 1) @ coefficients)[kept],
    )


def _basis(places: FloatArray, order: int) -> FloatArray:
    """Evaluate the Bernstein basis polynomials of degree `order` at points from 0 to 1.

    The result has one row per point, and one column per basis polynomial.
    """
    k, t = np.arange(order + 1), places[:, None]
    return np.asarray(comb(order, k) * t**k * (1.0 - t) ** (order - k))


@dataclass(frozen=True, kw_only=True)
class BernsteinRows:
    """Bounds on Bernstein coefficients in some elements, as linear constraints of a program.

    Attributes
    ----------
    coefficients, values : csr_array, shape (n_coefficients, n_unknowns)
        Matrices from the unknowns of the program to the coefficients, and to the values of the
        polynomials at the abscissae of the coefficients. Only the estimate `restraint` uses
        `values`.
    lower, upper : ndarray, shape (n_coefficients,)
        Bounds of the coefficients.
    elements : ndarray of int, shape (n_coefficients,)
        Index of the mesh element to which each coefficient belongs.
    """

    coefficients: csr_array
    values: csr_array
    lower: FloatArray
    upper: FloatArray
    elements: NDArray[np.intp]

    def added_to(self, program: NonlinearProgram) -> ExtendedProgram:
        """Return a nonlinear program that also imposes these bounds on Bernstein coefficients.

        The result has the unknowns and the constraints of `program`, followed by one linear
        constraint for each coefficient.
        """
        rows = self.coefficients
        starts = np.append(np.zeros(program.n_rows, dtype=rows.indptr.dtype), rows.indptr)
        shape = (starts.size - 1, rows.shape[1])
        terms = csr_array((rows.data, rows.indices, starts), shape=shape)
        return ExtendedProgram(program=program, terms=terms)

    def scales(self, own: Scaling) -> FloatArray:
        """Return scaling factors of the bounds on coefficients, shape (n_coefficients,).

        `own` is the scaling of the program to which the bounds are added. Each factor is 1 /
        largest absolute derivative of the constraint with respect to the scaled unknowns.
        """
        rows = self.coefficients
        entries = np.abs(rows.data) / own.unknowns[rows.indices]
        return np.asarray(1.0 / np.maximum.reduceat(entries, rows.indptr[:-1]))

    def restraint(self, result: IpoptResult, gap: float, elements: int) -> Restraint:
        """Estimate by how much the bounds on Bernstein coefficients raise the objective.

        The estimate is the sum of max(multiplier * (coefficient - value), 0): see
        docs/theory/transcription.md, eq. (7). The value is the polynomial's at the coefficient's
        abscissa. These bounds are the last constraints of `result`; `gap` is its complementarity
        gap. The argument `elements` is the mesh's number of elements.
        """
        pull = result.multipliers.rows[-self.lower.size :]
        beyond = self.coefficients @ result.z - self.values @ result.z
        cost = np.zeros(elements)
        np.add.at(cost, self.elements, np.maximum(pull * beyond, 0.0))
        return Restraint(cost=cost, gap=gap)


@dataclass(frozen=True, kw_only=True)
class Restraint:
    """Increase of the objective because bounds on Bernstein coefficients are too strict.

    The increase is relative to a program that bounds the polynomials' values instead.

    Attributes
    ----------
    cost : ndarray, shape (n_elements,)
        First-order estimate of the increase by the bounds in each element, in the unit of the
        objective.
    gap : float
        Complementarity gap that Ipopt's barrier leaves at the solution, in the unit of the
        objective: the sum of multipliers times slacks over all inequalities.
    """

    cost: FloatArray
    gap: float


def bounded(
    program: Transcription, bounds: Bounds, z: FloatArray, breach: float
) -> BernsteinRows | None:
    """Return bounds on Bernstein coefficients in those elements where a variable is near a bound.

    The bounds are those of the unknowns, whose values are `z`; see `_is_near`. They are widened by
    breach * max(1, abs(bound)). A bound that changes within an element is left out. The result is
    None if no variable is near a bound.
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
    """Return the lower and the upper bound of one variable in one element.

    `columns` are the positions of the variable's unknowns in the program. A bound that is not the
    same for all these unknowns is infinite in the result.
    """
    low, high = bounds.lower[columns], bounds.upper[columns]
    return (
        float(low[0]) if np.all(low == low[0]) else -np.inf,
        float(high[0]) if np.all(high == high[0]) else np.inf,
    )


def _is_near(values: FloatArray, low: float, high: float) -> bool:
    """Return whether a Bernstein coefficient of a variable violates a bound or is near it.

    A coefficient is near a bound if its distance is below 0.45 (high - low), or below
    0.45 max(1, abs(bound)) if only one bound is finite.
    """
    sides = [side for side in (low, high) if np.isfinite(side)]
    if not sides:
        return False
    room = _NEAR * (high - low if len(sides) == 2 else max(1.0, abs(sides[0])))
    return bool(np.any((values < low + room) | (values > high - room)))


def _assembled(parts: list[tuple[NDArray[np.intp], FloatArray]], width: int) -> csr_array:
    """Assemble a sparse matrix from dense blocks of rows, one block below the other.

    A part is (positions of the block's columns in the matrix, block).
    """
    data = np.concatenate([block.ravel() for _, block in parts])
    columns = np.concatenate([np.tile(at, len(block)) for at, block in parts])
    sizes = np.concatenate([np.full(len(block), at.size) for at, block in parts])
    return csr_array((data, columns, np.cumsum([0, *sizes])), shape=(sizes.size, width))
