"""Where each unknown and each derivative sits: layout, sparsity patterns, scattered values."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from pyomo_quad.collocation.mesh import FloatArray, interpolation_matrix, radau_rule

if TYPE_CHECKING:
    from pyomo_quad.collocation.mesh import Mesh
    from pyomo_quad.collocation.program.compiled import CompiledModel
    from pyomo_quad.collocation.reading.symbols import Declarations, PointSymbol

IndexArray = NDArray[np.intp]


@dataclass(frozen=True)
class Layout:
    """Index arithmetic of the unknowns on one mesh (None: a model without time)."""

    declared: Declarations
    mesh: Mesh | None

    @property
    def points(self) -> int:
        """Number of collocation points."""
        return self.mesh.points if self.mesh else 0

    @property
    def n_states(self) -> int:
        """Number of states."""
        return len(self.declared.states)

    @property
    def n_algebraics(self) -> int:
        """Number of algebraic variables."""
        return len(self.declared.algebraics)

    @property
    def n_statics(self) -> int:
        """Number of static variables."""
        return len(self.declared.statics)

    @cached_property
    def state_columns(self) -> IndexArray:
        """Columns of the states at the nodes, shape (n_points + 1, n_states)."""
        if self.mesh is None:
            return np.zeros((0, 0), dtype=np.intp)
        stride = self.n_states + self.n_algebraics
        starts = np.concatenate(([0], self.n_states + stride * np.arange(self.points)))
        return (starts[:, None] + np.arange(self.n_states)[None, :]).astype(np.intp)

    @cached_property
    def algebraic_columns(self) -> IndexArray:
        """Columns of the algebraic variables at the points, shape (n_points, n_algebraics)."""
        if self.mesh is None:
            return np.zeros((0, 0), dtype=np.intp)
        stride = self.n_states + self.n_algebraics
        starts = 2 * self.n_states + stride * np.arange(self.points)
        return (starts[:, None] + np.arange(self.n_algebraics)[None, :]).astype(np.intp)

    @cached_property
    def static_columns(self) -> IndexArray:
        """Columns of the static variables, shape (n_statics,)."""
        first = self.unknowns - self.n_statics
        return np.arange(first, self.unknowns, dtype=np.intp)

    @property
    def unknowns(self) -> int:
        """Number of unknowns."""
        varying = 0
        if self.mesh is not None:
            varying = self.n_states + self.points * (self.n_states + self.n_algebraics)
        return varying + self.n_statics

    @cached_property
    def stencil(self) -> tuple[IndexArray, IndexArray, FloatArray]:
        """Points, nodes and weights of the slope of the states: rate = sum weight * state."""
        if self.mesh is None:
            empty = np.zeros(0, dtype=np.intp)
            return empty, empty, np.zeros(0)
        points, nodes, weights = [], [], []
        firsts, degrees = self.mesh.first_node, np.asarray(self.mesh.degrees)
        for degree in np.unique(degrees):
            chosen = np.flatnonzero(degrees == degree)
            slope = radau_rule(int(degree)).differentiation
            row, column = np.indices(slope.shape)
            points.append((firsts[chosen][:, None, None] + row).ravel())
            nodes.append((firsts[chosen][:, None, None] + column).ravel())
            weights.append((slope[None] / self.mesh.widths[chosen][:, None, None]).ravel())
        return np.concatenate(points), np.concatenate(nodes), np.concatenate(weights)

    @cached_property
    def slope_matrix(self) -> csr_matrix:
        """Matrix from states at the nodes to rates at the points."""
        points, nodes, weights = self.stencil
        return csr_matrix((weights, (points, nodes)), shape=(self.points, self.points + 1))

    @cached_property
    def point_values(self) -> csr_matrix:
        """Matrix from the unknowns to the values that conditions and objective mention."""
        rows: list[int] = []
        columns: list[int] = []
        weights: list[float] = []
        for row, symbol in enumerate(self.declared.point_symbols):
            found, factor = self._at_point(symbol)
            rows.extend([row] * len(found))
            columns.extend(found)
            weights.extend(factor)
        shape = (len(self.declared.point_symbols), self.unknowns)
        return csr_matrix((weights, (rows, columns)), shape=shape)

    def _at_point(self, symbol: PointSymbol) -> tuple[IndexArray, FloatArray]:
        """Return the unknowns and weights that give one point value."""
        if self.mesh is None:
            return np.zeros(0, dtype=np.intp), np.zeros(0)
        element = int(self.mesh.locate(np.array([symbol.fraction]))[0])
        first, degree = self.mesh.first_node[element], self.mesh.degrees[element]
        width = self.mesh.widths[element]
        rule = radau_rule(degree)
        local = np.array([(symbol.fraction - self.mesh.breakpoints[element]) / width])
        local = np.where(abs(local - np.rint(local)) < 1e-9, np.rint(local), local)
        names = [s.name for s in self.declared.states]
        if symbol.slot in names:
            columns = self.state_columns[first : first + degree + 1, names.index(symbol.slot)]
            if not symbol.is_rate:
                return _nonzero(columns, interpolation_matrix(rule.nodes, local)[0])
            slopes = np.vstack([rule.slope_at_start, rule.differentiation])
            at = interpolation_matrix(rule.nodes, local)[0] @ slopes
            return columns, at / width
        position = [s.name for s in self.declared.algebraics].index(symbol.slot)
        columns = self.algebraic_columns[first : first + degree, position]
        return _nonzero(columns, interpolation_matrix(rule.points, local)[0])


def _nonzero(columns: IndexArray, weights: FloatArray) -> tuple[IndexArray, FloatArray]:
    kept = weights != 0.0
    return columns[kept], weights[kept]


class Contributions:
    """Collects entries (row, column) += weight * source until a `Scatter` is made of them."""

    def __init__(self) -> None:
        self._parts: list[tuple[IndexArray, IndexArray, IndexArray, FloatArray]] = []

    def add(
        self,
        rows: IndexArray,
        columns: IndexArray,
        sources: IndexArray,
        weights: FloatArray | float,
    ) -> None:
        """Add entries; the arrays broadcast against each other."""
        rows, columns, sources, weights = np.broadcast_arrays(rows, columns, sources, weights)
        self._parts.append((rows.ravel(), columns.ravel(), sources.ravel(), weights.ravel()))

    def scatter(self, n_columns: int, n_sources: int) -> Scatter:
        """Return the pattern and the map from sources to its values."""
        if not self._parts:
            empty = np.zeros(0, dtype=np.intp)
            return Scatter(rows=empty, columns=empty, matrix=csr_matrix((0, n_sources)))
        rows, columns, sources, weights = (
            np.concatenate([part[k] for part in self._parts]) for k in range(4)
        )
        keys, entries = np.unique(rows.astype(np.int64) * n_columns + columns, return_inverse=True)
        matrix = csr_matrix((weights, (entries, sources)), shape=(len(keys), n_sources))
        return Scatter(
            rows=(keys // n_columns).astype(np.intp),
            columns=(keys % n_columns).astype(np.intp),
            matrix=matrix,
        )


@dataclass(frozen=True, kw_only=True)
class Scatter:
    """A sparsity pattern and the matrix that takes source values to its nonzeros."""

    rows: IndexArray
    columns: IndexArray
    matrix: csr_matrix

    def values(self, sources: FloatArray) -> FloatArray:
        """Return the nonzeros for the given source values."""
        return np.asarray(self.matrix @ sources, dtype=float)


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
