"""Layout of the unknowns, sparsity patterns of the derivatives, and scattering of values.

The compact form: see docs/theory/transcription.md, eq. (4).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from pyomo_quad.collocation.mesh import FloatArray, interpolation_matrix, radau_rule

if TYPE_CHECKING:
    from pyomo_quad.collocation.mesh import Mesh
    from pyomo_quad.collocation.program.compiled import CompiledModel
    from pyomo_quad.collocation.reading.symbols import Declarations, PointSymbol

IndexArray = NDArray[np.intp]
# Ipopt's integer type; it halves the memory of large meshes.
Places = NDArray[np.int32]


@dataclass(frozen=True, kw_only=True)
class Elements:
    """The elements of one degree; each repeats the pattern of the first.

    An index of theirs is a pair: its value at node 0, and its increment from node to node.
    """

    degree: int
    first_nodes: Places
    widths: FloatArray

    def everywhere(self, places: Places) -> Places:
        """Return the indices of all elements, shape (n_elements, n), from pairs, shape (n, 2)."""
        return places[:, 0] + self.first_nodes[:, None] * places[:, 1]


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

    @property
    def stride(self) -> int:
        """Increment of a column from node to node: number of states and algebraic variables."""
        return self.n_states + self.n_algebraics

    @cached_property
    def state_columns(self) -> IndexArray:
        """Columns of the states at the nodes, shape (n_points + 1, n_states)."""
        if self.mesh is None:
            return np.zeros((0, 0), dtype=np.intp)
        starts = self.stride * np.arange(self.points + 1)
        return (starts[:, None] + np.arange(self.n_states)[None, :]).astype(np.intp)

    @cached_property
    def algebraic_columns(self) -> IndexArray:
        """Columns of the algebraic variables at the points, shape (n_points, n_algebraics)."""
        if self.mesh is None:
            return np.zeros((0, 0), dtype=np.intp)
        starts = self.n_states + self.stride * np.arange(self.points)
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
    def elements(self) -> tuple[Elements, ...]:
        """The elements by degree."""
        if self.mesh is None:
            return ()
        firsts, degrees = np.asarray(self.mesh.first_node), np.asarray(self.mesh.degrees)
        return tuple(
            Elements(
                degree=degree,
                first_nodes=firsts[:-1][degrees == degree].astype(np.int32),
                widths=self.mesh.widths[degrees == degree],
            )
            for degree in np.unique(degrees).tolist()
        )

    @cached_property
    def slope_matrix(self) -> csr_matrix:
        """Matrix from states at the nodes to rates at the points."""
        parts = [
            tuple(
                array.ravel()
                for array in np.broadcast_arrays(
                    radau_rule(e.degree).differentiation / e.widths[:, None, None],
                    (e.first_nodes[:, None] + np.arange(e.degree))[:, :, None],
                    (e.first_nodes[:, None] + np.arange(e.degree + 1))[:, None, :],
                )
            )
            for e in self.elements
        ]
        slopes, points, nodes = _joined(parts, 3)
        return csr_matrix((slopes, (points, nodes)), shape=(self.points, self.points + 1))

    def states_in(self, elements: Elements, states: IndexArray) -> Places:
        """Return the columns of states at the nodes of elements, shape (degree + 1, n, 2)."""
        nodes = np.arange(elements.degree + 1)[:, None]
        return _places(self.stride * nodes + states, self.stride)

    def variables_in(self, elements: Elements, variables: IndexArray) -> Places:
        """Return the columns of states, algebraics and statics at points, shape (degree, n, 2)."""
        points = np.arange(elements.degree)[:, None]
        nodes = points + (variables < self.n_states)
        is_static = variables >= self.stride
        first_static = self.unknowns - self.n_statics
        return _places(
            np.where(is_static, first_static - self.stride, self.stride * nodes) + variables,
            np.where(is_static, 0, self.stride),
        )

    @cached_property
    def _met(self) -> dict[int, NDArray[np.bool_]]:
        """Whether other elements or conditions may share an element's columns, by degree."""
        met = np.zeros(self.unknowns, dtype=bool)
        met[self.point_values.indices] = True
        for elements in self.elements:
            ends = elements.first_nodes[:, None] + np.array([0, elements.degree])
            met[self.state_columns[ends]] = True
        return {
            elements.degree: np.any(
                met[
                    self.stride * elements.first_nodes[:, None]
                    + np.arange(elements.degree * self.stride + self.n_states)
                ],
                axis=0,
            )
            for elements in self.elements
        }

    def is_met(self, elements: Elements, places: Places) -> NDArray[np.bool_]:
        """Return whether columns, shape (..., 2), may be shared with other terms in any element."""
        is_static = places[..., 1] == 0
        met = self._met[elements.degree][np.where(is_static, 0, places[..., 0])]
        return np.where(is_static, True, met)

    @cached_property
    def point_values(self) -> csr_matrix:
        """Matrix from the unknowns to the values that appear in conditions and objective."""
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


def _places(starts: Any, step: Any) -> Places:
    """Return indices as pairs: the value at node 0, and the increment to the next node."""
    return np.stack(np.broadcast_arrays(starts, step), axis=-1).astype(np.int32)


class Contributions:
    """Collects entries (row, column) += weight * source until a `Scatter` is made of them.

    Contributions that repeat in each element are sorted once.
    """

    def __init__(self) -> None:
        self._whole: list[tuple[NDArray[Any], ...]] = []
        self._repeated: dict[int, tuple[Elements, list[tuple[NDArray[Any], ...]]]] = {}

    def add(self, rows: Any, columns: Any, sources: Any, weights: FloatArray | float) -> None:
        """Add entries; the arrays broadcast against each other."""
        entries = np.broadcast_arrays(rows, columns, sources, weights)
        kept = entries[3] != 0.0
        places = (entry[kept].astype(np.int32) for entry in entries[:3])
        self._whole.append((*places, entries[3][kept]))

    def repeat(
        self,
        elements: Elements,
        rows: Places,
        columns: Places,
        sources: Places,
        weights: FloatArray,
        power: int,
        is_met: NDArray[np.bool_],
    ) -> None:
        """Add entries of each element, with weights times a power of its width.

        The arrays broadcast against each other. `is_met` marks entries that may coincide with those
        of other terms.
        """
        shape = np.broadcast_shapes(
            *(p.shape[:-1] for p in (rows, columns, sources)), weights.shape
        )
        places = [np.broadcast_to(p, (*shape, 2)).reshape(-1, 2) for p in (rows, columns, sources)]
        factors = np.broadcast_to(weights, shape).ravel()
        is_met = np.broadcast_to(is_met, shape).ravel() & (factors != 0.0)
        rows, columns, sources = (elements.everywhere(p[is_met]) for p in places)
        here = elements.widths[:, None] ** power * factors[is_met]
        self.add(rows, columns, sources, here)
        own = ~is_met & (factors != 0.0)
        parts = self._repeated.setdefault(elements.degree, (elements, []))[1]
        parts.append((*(p[own] for p in places), factors[own], np.full(own.sum(), power)))

    def scatter(self, n_columns: int, n_sources: int) -> Scatter:
        """Return the pattern and the map from sources to its values."""
        pieces = [_tiled(*held, n_columns) for held in self._repeated.values()]
        rows, columns, sources, weights = _joined(self._whole, 4)
        firsts, counts, order = _sorted(rows, columns, n_columns)
        pieces.append((rows[firsts], columns[firsts], counts, sources[order], weights[order]))
        rows, columns, counts, sources, weights = _joined(pieces, 5)
        starts = np.zeros(len(rows) + 1, dtype=np.int32)
        np.cumsum(counts, out=starts[1:], dtype=np.int32)
        matrix = csr_matrix((weights, sources, starts), shape=(len(rows), n_sources))
        return Scatter(rows=rows, columns=columns, matrix=matrix)


def _tiled(
    elements: Elements, parts: list[tuple[NDArray[Any], ...]], n_columns: int
) -> tuple[NDArray[Any], ...]:
    """Return rows, columns and number of sources of each nonzero, and the sources themselves."""
    rows, columns, sources, factors, powers = _joined(parts, 5)
    row, column = (elements.everywhere(places)[0] for places in (rows, columns))
    firsts, counts, order = _sorted(row, column, n_columns)
    widths = elements.widths[:, None] ** np.arange(-2, 2)
    found = (
        elements.everywhere(rows[firsts]),
        elements.everywhere(columns[firsts]),
        np.broadcast_to(counts, (len(elements.widths), counts.size)),
        elements.everywhere(sources[order]),
        widths[:, powers[order] + 2] * factors[order],
    )
    return tuple(entries.ravel() for entries in found)


def _joined(parts: list[tuple[NDArray[Any], ...]], count: int) -> list[NDArray[Any]]:
    empty = np.zeros(0, dtype=np.int32)
    return [np.concatenate([part[k] for part in parts] or [empty]) for k in range(count)]


def _sorted(rows: Places, columns: Places, n_columns: int) -> tuple[IndexArray, Places, IndexArray]:
    """Return the first position of each entry, its number of occurrences, and the sort order."""
    keys = rows.astype(np.int64) * n_columns + columns
    order = np.argsort(keys, kind="stable")
    _, firsts, counts = np.unique(keys[order], return_index=True, return_counts=True)
    return order[firsts], counts.astype(np.int32), order


@dataclass(frozen=True, kw_only=True)
class Scatter:
    """A sparsity pattern and the matrix that takes source values to its nonzeros."""

    rows: Places
    columns: Places
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
        """Return d objective / d integral from all derivative sources."""
        return self.objective_slopes(sources[self.n_path_sources :])

    def gradient(self, sources: FloatArray, slopes: FloatArray) -> FloatArray:
        """Return the dense gradient of the objective."""
        dense = np.zeros(self.unknowns)
        dense[self.objective.columns] = self.objective.values(sources)
        for slope, scatter in zip(slopes, self.integrals, strict=True):
            dense[scatter.columns] += slope * scatter.values(sources)
        return dense


def _add_path_rows(
    compiled: CompiledModel,
    layout: Layout,
    elements: Elements,
    into: Contributions,
    entries: NDArray[np.intp],
    rows: Places,
    weights: FloatArray,
    power: int,
) -> None:
    """Add nonzeros of the point Jacobian, at every point, to rows of the program.

    The rows' shape is (degree, n_entries, 2), that of weights (degree,).
    """
    n_sources, slopes = (
        len(compiled.path.jacobian_rows),
        radau_rule(elements.degree).differentiation,
    )
    sources = _places(n_sources * np.arange(elements.degree)[:, None] + entries, n_sources)
    columns = compiled.path.jacobian_columns[entries]
    by_rate = columns < layout.n_states
    at = layout.variables_in(elements, columns[~by_rate] - layout.n_states)
    is_met = (rows[:, ~by_rate, 1] == 0) & layout.is_met(elements, at)
    into.repeat(
        elements, rows[:, ~by_rate], at, sources[:, ~by_rate], weights[:, None], power, is_met
    )
    at = layout.states_in(elements, columns[by_rate])[None]
    rows, sources = rows[:, None, by_rate], sources[:, None, by_rate]
    is_met = (rows[..., 1] == 0) & layout.is_met(elements, at)
    by_node = (slopes * weights[:, None])[:, :, None]
    into.repeat(elements, rows, at, sources, by_node, power - 1, is_met)


def jacobian_scatter(compiled: CompiledModel, layout: Layout) -> JacobianScatter:
    """Return the map from the derivatives at the points to Jacobian and gradient.

    Sources are the nonzeros of the path Jacobian point by point, those of the conditions' Jacobian,
    and a final 1.
    """
    n_path = layout.points * len(compiled.path.jacobian_rows)
    n_sources = n_path + len(compiled.points.jacobian_rows) + 1
    n, n_conditions = compiled.n_equations, len(compiled.declared.conditions)
    rows, objective = Contributions(), Contributions()
    integrals = [Contributions() for _ in compiled.row_integrals]
    first_integral_row = layout.points * n + n_conditions
    defined = list(compiled.static_of_integral)
    for elements in layout.elements:
        add = partial(_add_path_rows, compiled, layout, elements)
        quadrature, points = (
            radau_rule(elements.degree).weights,
            np.arange(elements.degree)[:, None],
        )
        entries = np.flatnonzero(compiled.path.jacobian_rows < n)
        at = _places(n * points + compiled.path.jacobian_rows[entries], n)
        add(rows, entries, at, np.ones(elements.degree), 0)
        for integral in (*defined, *compiled.row_integrals):
            entries = np.flatnonzero(compiled.path.jacobian_rows == n + integral)
            is_row = integral in defined
            row = first_integral_row + defined.index(integral) if is_row else 0
            target = rows if is_row else integrals[compiled.row_integrals.index(integral)]
            at = _places(row + 0 * (points + entries), 0)
            add(target, entries, at, -quadrature if is_row else quadrature, 1)
    for position, integral in enumerate(defined):
        column = layout.static_columns[[compiled.static_of_integral[integral]]]
        rows.add(first_integral_row + position, column, n_sources - 1, 1.0)
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
    """Add derivatives of conditions and objective; return the positions of those by integrals."""
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
    """Return the map from the point Hessians to the lower triangle of the program's Hessian."""
    into = Contributions()
    n_path = layout.points * len(compiled.path.hessian_rows)
    n_sources = n_path + len(compiled.points.hessian_rows)
    for elements in layout.elements:
        _add_path_hessian(into, compiled, layout, elements)
    entries = zip(compiled.points.hessian_rows, compiled.points.hessian_columns, strict=True)
    for entry, (i, j) in enumerate(entries):
        first, first_weights = _expand(layout, int(i))
        second, second_weights = _expand(layout, int(j))
        a, b = (m.ravel() for m in np.meshgrid(first, second, indexing="ij"))
        weights = _in_triangle(
            a, b, np.outer(first_weights, second_weights).ravel(), is_square=i == j
        )
        into.add(np.maximum(a, b), np.minimum(a, b), n_path + entry, weights)
    return into.scatter(layout.unknowns, n_sources)


def _add_path_hessian(
    into: Contributions, compiled: CompiledModel, layout: Layout, elements: Elements
) -> None:
    """Add the nonzeros (i, j) of the point Hessian at every point, with i >= j.

    Rates come first among a point's variables, so j is a rate whenever i is one.
    """
    every_i, every_j = compiled.path.hessian_rows, compiled.path.hessian_columns
    n_sources, n = len(every_i), layout.n_states
    slopes = radau_rule(elements.degree).differentiation[:, :, None]
    # Loop over the number of rates in the pair: 0, 1 or 2, each with an axis of nodes.
    for power in range(3):
        entries = np.flatnonzero((every_i < n).astype(int) + (every_j < n) == power)
        i, j = every_i[entries], every_j[entries]
        sources = _places(n_sources * np.arange(elements.degree)[:, None] + entries, n_sources)
        if power == 0:
            a, b = (layout.variables_in(elements, k - n) for k in (i, j))
            weights = np.ones((elements.degree, 1))
        elif power == 1:
            a = layout.variables_in(elements, i - n)[:, None]
            b = layout.states_in(elements, j)[None]
            sources, weights = sources[:, None], slopes
        else:
            a = layout.states_in(elements, i)[None, :, None]
            b = layout.states_in(elements, j)[None, None]
            sources, weights = sources[:, None, None], slopes[:, :, None] * slopes[:, None]
        a, b = np.broadcast_arrays(a, b)
        # The order of two unknowns is the same in every element.
        first, second = (p[..., 0] + elements.first_nodes[0] * p[..., 1] for p in (a, b))
        is_lower = (first >= second)[..., None]
        into.repeat(
            elements,
            np.where(is_lower, a, b),
            np.where(is_lower, b, a),
            sources,
            _in_triangle(first, second, weights, is_square=i == j),
            -power,
            layout.is_met(elements, a) & layout.is_met(elements, b),
        )


def _in_triangle(
    a: NDArray[Any], b: NDArray[Any], weights: FloatArray, *, is_square: Any
) -> FloatArray:
    """Return the weight of the term h * variable_a * variable_b in the lower triangle.

    A square term lists every pair of unknowns twice, so half of them are dropped. A mixed term
    counts twice where it falls on the diagonal.
    """
    return np.where(is_square, np.where(a >= b, weights, 0.0), np.where(a == b, 2.0, 1.0) * weights)
