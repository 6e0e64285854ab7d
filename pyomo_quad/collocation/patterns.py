"""Sparsity of the nonlinear program: where each derivative of a point goes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pyomo_quad.collocation.scatter import Contributions, Scatter

if TYPE_CHECKING:
    from pyomo_quad.collocation.compiled import CompiledModel
    from pyomo_quad.collocation.layout import Layout
    from pyomo_quad.collocation.nodes import FloatArray

__all__ = ["JacobianScatter", "hessian_scatter", "jacobian_scatter", "path_columns"]

IndexArray = NDArray[np.intp]


@dataclass(frozen=True, kw_only=True)
class JacobianScatter:
    """Scatters of the rows' Jacobian, of the objective's gradient and of the integrals'."""

    rows: Scatter
    objective: Scatter
    integrals: tuple[Scatter, ...]
    slope_sources: IndexArray
    slope_integrals: IndexArray
    n_integrals: int
    n_path_sources: int
    unknowns: int

    def objective_slopes(self, point_sources: FloatArray) -> FloatArray:
        """Return d objective / d integral for the integrals that enter it directly."""
        slopes = np.zeros(self.n_integrals)
        slopes[self.slope_integrals] = point_sources[self.slope_sources]
        return slopes

    def integral_slopes(self, sources: FloatArray) -> FloatArray:
        """Return the same from all derivative sources."""
        return self.objective_slopes(sources[self.n_path_sources :])

    def gradient(self, sources: FloatArray, slopes: FloatArray) -> FloatArray:
        """Return the dense gradient of the objective."""
        dense = np.zeros(self.unknowns)
        dense[self.objective.columns] = self.objective.values(sources)
        for slope, scatter in zip(slopes, self.integrals, strict=True):
            dense[scatter.columns] += slope * scatter.values(sources)
        return dense


def path_columns(layout: Layout) -> IndexArray:
    """Return the columns of a point's states, algebraics and statics, one row per point."""
    statics = np.broadcast_to(layout.static_columns, (layout.points, layout.n_statics))
    return np.hstack([layout.state_columns[1:], layout.algebraic_columns, statics])


def _add_path_row(
    into: Contributions,
    compiled: CompiledModel,
    layout: Layout,
    entry: int,
    row: IndexArray,
    weight: FloatArray,
) -> None:
    """Add one nonzero of the point Jacobian, at every point, to rows of the program."""
    columns = path_columns(layout)
    n_sources = len(compiled.path.jacobian_rows)
    column = int(compiled.path.jacobian_columns[entry])
    if column >= layout.n_states:
        points = np.arange(layout.points)
        into.add(row, columns[:, column - layout.n_states], points * n_sources + entry, weight)
        return
    points, nodes, slopes = layout.stencil
    into.add(
        row[points],
        layout.state_columns[nodes, column],
        points * n_sources + entry,
        slopes * weight[points],
    )


def jacobian_scatter(compiled: CompiledModel, layout: Layout) -> JacobianScatter:
    """Return where the derivatives of the points go in Jacobian and gradient.

    Sources are the nonzeros of the path Jacobian point by point, those of the conditions'
    Jacobian, and a final one.
    """
    n_path = layout.points * len(compiled.path.jacobian_rows)
    n_sources = n_path + len(compiled.points.jacobian_rows) + 1
    n, n_conditions = compiled.n_equations, len(compiled.declared.conditions)
    all_points = np.arange(layout.points)
    ones = np.ones(layout.points)
    quadrature = layout.mesh.quadrature_weights if layout.mesh else np.zeros(0)
    rows, objective = Contributions(), Contributions()
    integrals = [Contributions() for _ in compiled.row_integrals]
    first_integral_row = layout.points * n + n_conditions
    defined = list(compiled.static_of_integral)
    for entry, path_row in enumerate(compiled.path.jacobian_rows if layout.points else []):
        integral = int(path_row) - n
        if integral < 0:
            _add_path_row(rows, compiled, layout, entry, all_points * n + path_row, ones)
        elif integral in defined:
            row = np.full(layout.points, first_integral_row + defined.index(integral))
            _add_path_row(rows, compiled, layout, entry, row, -quadrature)
        else:
            target = integrals[compiled.row_integrals.index(integral)]
            _add_path_row(target, compiled, layout, entry, 0 * all_points, quadrature)
    for position, integral in enumerate(defined):
        column = layout.static_columns[compiled.static_of_integral[integral]]
        rows.add(np.array([first_integral_row + position]), column, np.array([n_sources - 1]), 1.0)
    slope_sources, slope_integrals = _add_conditions(
        compiled, layout, rows, objective, layout.points * n, n_path
    )
    return JacobianScatter(
        rows=rows.scatter(layout.unknowns, n_sources),
        objective=objective.scatter(layout.unknowns, n_sources),
        integrals=tuple(i.scatter(layout.unknowns, n_sources) for i in integrals),
        slope_sources=slope_sources,
        slope_integrals=slope_integrals,
        n_integrals=len(compiled.row_integrals),
        n_path_sources=n_path,
        unknowns=layout.unknowns,
    )


def _add_conditions(
    compiled: CompiledModel,
    layout: Layout,
    rows: Contributions,
    objective: Contributions,
    first_row: int,
    first_source: int,
) -> tuple[IndexArray, IndexArray]:
    """Add the conditions' and the objective's derivatives; return those by integrals."""
    n_conditions = len(compiled.declared.conditions)
    n_values = len(compiled.declared.point_symbols)
    slope_sources, slope_integrals = [], []
    entries = zip(compiled.points.jacobian_rows, compiled.points.jacobian_columns, strict=True)
    for entry, (row, column) in enumerate(entries):
        is_objective = row == n_conditions
        target = objective if is_objective else rows
        at = np.array([0 if is_objective else first_row + row])
        if column >= n_values + layout.n_statics:
            slope_sources.append(entry)
            slope_integrals.append(column - n_values - layout.n_statics)
            continue
        columns, weights = _expand(layout, int(column))
        target.add(at, columns, np.array([first_source + entry]), weights)
    return np.array(slope_sources, dtype=np.intp), np.array(slope_integrals, dtype=np.intp)


def _expand(layout: Layout, column: int) -> tuple[IndexArray, FloatArray]:
    """Return the unknowns and weights behind one variable of the conditions."""
    n_values = len(layout.declared.point_symbols)
    if column >= n_values:
        return layout.static_columns[[column - n_values]], np.ones(1)
    matrix = layout.point_values
    span = slice(matrix.indptr[column], matrix.indptr[column + 1])
    return matrix.indices[span].astype(np.intp), matrix.data[span]


def hessian_scatter(compiled: CompiledModel, layout: Layout) -> Scatter:
    """Return where the point Hessians go in the lower triangle of the program's Hessian."""
    into = Contributions()
    n_path = layout.points * len(compiled.path.hessian_rows)
    n_sources = n_path + len(compiled.points.hessian_rows)
    entries = zip(compiled.path.hessian_rows, compiled.path.hessian_columns, strict=True)
    for entry, (i, j) in enumerate(entries if layout.points else []):
        _add_path_entry(into, compiled, layout, entry, int(i), int(j))
    entries = zip(compiled.points.hessian_rows, compiled.points.hessian_columns, strict=True)
    for entry, (i, j) in enumerate(entries):
        first, first_weights = _expand(layout, int(i))
        second, second_weights = _expand(layout, int(j))
        a, b = (m.ravel() for m in np.meshgrid(first, second, indexing="ij"))
        weights = np.outer(first_weights, second_weights).ravel()
        _add_symmetric(into, a, b, np.full(a.size, n_path + entry), weights, is_square=i == j)
    return into.scatter(layout.unknowns, n_sources)


def _add_path_entry(
    into: Contributions, compiled: CompiledModel, layout: Layout, entry: int, i: int, j: int
) -> None:
    """Add one nonzero (i >= j) of the point Hessian at every point.

    Rates come first among a point's variables, so j is a rate whenever i is one.
    """
    columns = path_columns(layout)
    n_sources = len(compiled.path.hessian_rows)
    states = layout.n_states
    if j >= states:
        points = np.arange(layout.points)
        a, b, weights = columns[:, i - states], columns[:, j - states], np.ones(layout.points)
    elif i >= states:
        points, nodes, weights = layout.stencil
        a, b = columns[points, i - states], layout.state_columns[nodes, j]
    else:
        points, a, b, weights = _rate_pairs(layout, i, j)
    _add_symmetric(into, a, b, points * n_sources + entry, weights, is_square=i == j)


def _rate_pairs(
    layout: Layout, i: int, j: int
) -> tuple[IndexArray, IndexArray, IndexArray, FloatArray]:
    """Return all pairs of nodes behind the rates i and j of each point."""
    matrix = layout.slope_matrix
    lengths = np.diff(matrix.indptr)
    points = np.repeat(np.arange(layout.points), lengths**2)
    first, second = [], []
    for point, length in enumerate(lengths):
        span = np.arange(matrix.indptr[point], matrix.indptr[point] + length)
        first.append(np.repeat(span, length))
        second.append(np.tile(span, length))
    p, q = np.concatenate(first), np.concatenate(second)
    a = layout.state_columns[matrix.indices[p], i]
    b = layout.state_columns[matrix.indices[q], j]
    return points, a, b, matrix.data[p] * matrix.data[q]


def _add_symmetric(
    into: Contributions,
    a: IndexArray,
    b: IndexArray,
    sources: IndexArray,
    weights: FloatArray,
    *,
    is_square: bool,
) -> None:
    """Add weight * h to the lower triangle for the term h * variable_a * variable_b.

    A square term lists every pair of unknowns twice, so half of them are kept; a mixed term
    that meets itself on the diagonal counts twice.
    """
    if is_square:
        kept = a >= b
        into.add(a[kept], b[kept], sources[kept], weights[kept])
        return
    doubled = np.where(a == b, 2.0 * weights, weights)
    into.add(np.maximum(a, b), np.minimum(a, b), sources, doubled)
