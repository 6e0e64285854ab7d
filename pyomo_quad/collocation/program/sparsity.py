"""Layout of the unknowns, sparsity patterns of derivatives, and assembly of their nonzeros.

The derivatives at a single collocation point have the same sparsity pattern at all points. Their
positions in the program's sparse matrices are computed once per mesh. The time derivatives of the
states are linear combinations of the states, not unknowns: see docs/theory/transcription.md,
eq. (4).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix, kron, vstack

from pyomo_quad.collocation.mesh import FloatArray, interpolation_matrix, radau_rule

if TYPE_CHECKING:
    from pyomo_quad.collocation.mesh import Mesh
    from pyomo_quad.collocation.program.compiled import CompiledModel
    from pyomo_quad.collocation.reading.symbols import Declarations, PointSymbol

IndexArray = NDArray[np.intp]
# Ipopt's integer type; it halves the memory of large meshes.
Places = NDArray[np.int32]


@dataclass(frozen=True)
class Layout:
    """Positions of the variables among the unknowns of the nonlinear program on one mesh.

    The order is: states at the start of the horizon; algebraic variables and states of each
    collocation point; static variables (without time). A position is also called a column.

    Attributes
    ----------
    declared : Declarations
        Variables of the model.
    mesh : Mesh or None
        None for a model without time.
    """

    declared: Declarations
    mesh: Mesh | None

    @property
    def points(self) -> int:
        """Number of collocation points, 0 for a model without time."""
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
        """Number of static variables (variables without time)."""
        return len(self.declared.statics)

    @property
    def stride(self) -> int:
        """Number of unknowns per collocation point: states and algebraic variables."""
        return self.n_states + self.n_algebraics

    @cached_property
    def state_columns(self) -> IndexArray:
        """Positions of the states among the program's unknowns, shape (n_points + 1, n_states).

        There is one row for the start of the horizon, then one for each collocation point.
        """
        if self.mesh is None:
            return np.zeros((0, 0), dtype=np.intp)
        starts = self.stride * np.arange(self.points + 1)
        return (starts[:, None] + np.arange(self.n_states)[None, :]).astype(np.intp)

    def state_column(self, name: str, fraction: float) -> int:
        """Return the position, among the unknowns, of a state at the node nearest to a given time.

        `fraction` is the time as a fraction of the horizon. The result is -1 if there is no state
        called `name`.
        """
        states = [slot.name for slot in self.declared.states]
        if self.mesh is None or name not in states:
            return -1
        node = int(np.argmin(np.abs(self.mesh.node_fractions - fraction)))
        return int(self.state_columns[node, states.index(name)])

    @cached_property
    def algebraic_columns(self) -> IndexArray:
        """Positions of the algebraic variables among the unknowns, shape (n_points, n_algebraics).

        There is one row per collocation point.
        """
        if self.mesh is None:
            return np.zeros((0, 0), dtype=np.intp)
        starts = self.n_states + self.stride * np.arange(self.points)
        return (starts[:, None] + np.arange(self.n_algebraics)[None, :]).astype(np.intp)

    @cached_property
    def static_columns(self) -> IndexArray:
        """Positions of the variables without time among the unknowns, shape (n_statics,)."""
        first = self.unknowns - self.n_statics
        return np.arange(first, self.unknowns, dtype=np.intp)

    @property
    def unknowns(self) -> int:
        """Number of unknowns of the nonlinear program."""
        varying = 0
        if self.mesh is not None:
            varying = self.n_states + self.points * (self.n_states + self.n_algebraics)
        return varying + self.n_statics

    @cached_property
    def slope_matrix(self) -> csr_matrix:
        """Differentiation matrix from a state at the nodes to its rate at the collocation points.

        Rates are derivatives with respect to the fraction of the horizon. The shape is (n_points,
        n_points + 1). The first node is the start of the horizon.
        """
        if self.mesh is None:
            return csr_matrix((0, 1))
        parts = [
            radau_rule(degree).differentiation.ravel() / width
            for degree, width in zip(self.mesh.degrees, self.mesh.widths, strict=True)
        ]
        element = self.mesh.element_of_point
        counts = np.asarray(self.mesh.degrees)[element] + 1
        starts = np.append(0, np.cumsum(counts))
        nodes = np.arange(starts[-1]) - np.repeat(starts[:-1], counts)
        nodes += np.repeat(self.mesh.first_node[element], counts)
        shape = (self.points, self.points + 1)
        return csr_matrix((np.concatenate(parts), nodes, starts), shape=shape)

    @cached_property
    def path_variables(self) -> csr_matrix:
        """Matrix that maps the unknowns to the variables of all collocation points, point by point.

        The variables of a point are rates (per fraction of the horizon), states, algebraic and
        static variables. The shape is (n_points * n_variables, n_unknowns).
        """
        slopes, n = self.slope_matrix, self.n_states
        rates = kron(slopes, np.eye(n)) @ _chosen(self.state_columns.ravel(), self.unknowns)
        statics = np.broadcast_to(self.static_columns, (self.points, self.n_statics))
        values = np.hstack([self.state_columns[1:], self.algebraic_columns, statics])
        chosen = _chosen(values.ravel(), self.unknowns)
        order = np.hstack(
            [
                np.arange(self.points * n).reshape(self.points, n),
                self.points * n + np.arange(values.size).reshape(values.shape),
            ]
        )
        return vstack([rates, chosen], format="csr")[order.ravel()]

    @cached_property
    def condition_variables(self) -> csr_matrix:
        """Matrix that maps the unknowns to the variables of conditions and objective.

        Conditions are constraints at single times or without time. The rows are the variables'
        values at these times, as in `point_values`, then one per static variable (without time).
        """
        statics = _chosen(self.static_columns, self.unknowns)
        return vstack([self.point_values, statics], format="csr")

    @cached_property
    def point_values(self) -> csr_matrix:
        """Matrix that maps the unknowns to values of variables or rates at single times.

        It has one row for each item of `Declarations.point_symbols`: a value that a condition
        (constraint not over time) or the objective contains. The times are members of the
        continuous set.
        """
        rows: list[int] = []
        columns: list[int] = []
        weights: list[float] = []
        for row, symbol in enumerate(self.declared.point_symbols):
            # Between nodes, the value is interpolated, with one weight per node of the element.
            found, factor = self._at_point(symbol)
            rows.extend([row] * len(found))
            columns.extend(found)
            weights.extend(factor)
        shape = (len(self.declared.point_symbols), self.unknowns)
        return csr_matrix((weights, (rows, columns)), shape=shape)

    def _at_point(self, symbol: PointSymbol) -> tuple[IndexArray, FloatArray]:
        """Return positions and weights of unknowns whose weighted sum is the value of `symbol`."""
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
    """Return the positions and weights whose weight is not zero."""
    kept = weights != 0.0
    return columns[kept], weights[kept]


def _chosen(columns: IndexArray, width: int) -> csr_matrix:
    """Return the 0-1 matrix that selects the unknowns at the positions `columns`.

    `width` is the number of all unknowns.
    """
    entries = np.ones(columns.size), columns, np.arange(columns.size + 1)
    return csr_matrix(entries, shape=(columns.size, width))


class Contributions:
    """Collector of contributions to the entries of a sparse matrix.

    A source is a number that a CasADi function returns at each evaluation. A contribution adds a
    weight times a source to the entry at (row, column) of the matrix.
    """

    def __init__(self) -> None:
        self._parts: list[tuple[NDArray[Any], ...]] = []

    def add(self, rows: Any, columns: Any, sources: Any, weights: Any) -> None:
        """Add contributions: the entry at (row, column) increases by weight times source.

        `sources` are positions among the values that CasADi returns. The arrays are broadcast
        against each other.
        """
        rows, columns, sources, weights = np.broadcast_arrays(rows, columns, sources, weights)
        kept = weights != 0.0
        places = (entry[kept].astype(np.int32) for entry in (rows, columns, sources))
        self._parts.append((*places, weights[kept]))

    def add_slopes(
        self, variables: csr_matrix, rows: Any, of: IndexArray, sources: Any, weights: Any
    ) -> None:
        """Add derivatives with respect to variables that are linear combinations of the unknowns.

        The variables are ``variables @ unknowns``, and `of` has the index of each derivative's
        variable. By the chain rule, a derivative contributes to the columns of all unknowns in its
        variable. For the other arguments, see `add`.
        """
        rows, of, sources, weights = (
            held.ravel() for held in np.broadcast_arrays(rows, of, sources, weights)
        )
        spread = variables[of].tocoo()
        k = spread.row
        self.add(rows[k], spread.col, sources[k], weights[k] * spread.data)

    def add_curvatures(
        self, variables: csr_matrix, first: IndexArray, second: IndexArray, sources: IndexArray
    ) -> None:
        """Add second derivatives with respect to pairs of variables, each pair given once.

        The variables are ``variables @ unknowns``. With i from `first`, j from `second` and the
        rows v_i, v_j of the matrix, a derivative h contributes ``h * outer(v_i, v_j)``, plus its
        transpose if i and j differ.
        """
        one = variables[first].tocoo()
        other = variables[second[one.row]].tocoo()
        pair = one.row[other.row]
        a, b = one.col[other.row], other.col
        weights = one.data[other.row] * other.data
        is_square = (first == second)[pair]
        # For i = j, the lower triangle is added. For other pairs, an entry above the diagonal is
        # added at its mirrored position, and entries on the diagonal are doubled.
        weights = np.where(
            is_square, np.where(a >= b, weights, 0.0), np.where(a == b, 2.0, 1.0) * weights
        )
        self.add(np.maximum(a, b), np.minimum(a, b), sources[pair], weights)

    def scatter(self, n_columns: int, n_sources: int) -> Scatter:
        """Return the sparsity pattern, and the map from CasADi's values to the matrix's nonzeros.

        Contributions to the same entry are added. `n_sources` is the number of values that CasADi
        returns.
        """
        empty = (np.zeros(0, dtype=np.int32),) * 3 + (np.zeros(0),)
        rows, columns, sources, weights = (
            np.concatenate(held) for held in zip(empty, *self._parts, strict=True)
        )
        keys = rows.astype(np.int64) * n_columns + columns
        places, positions = np.unique(keys, return_inverse=True)
        matrix = csr_matrix((weights, (positions, sources)), shape=(places.size, n_sources))
        own = np.divmod(places, n_columns)
        return Scatter(rows=own[0].astype(np.int32), columns=own[1].astype(np.int32), matrix=matrix)


@dataclass(frozen=True, kw_only=True)
class Scatter:
    """Assembly of a sparse matrix: its sparsity pattern, and a linear map to its nonzeros.

    The map computes the nonzeros from the sources, which are numbers that a CasADi function
    returns.

    Attributes
    ----------
    rows, columns : ndarray of int, shape (n_nonzeros,)
        Row and column of each nonzero in the sparse matrix.
    matrix : csr_matrix, shape (n_nonzeros, n_sources)
        The linear map.
    """

    rows: Places
    columns: Places
    matrix: csr_matrix

    def values(self, sources: FloatArray) -> FloatArray:
        """Return the values of the matrix's nonzeros, shape (n_nonzeros,).

        `sources` are the values that CasADi returned, shape (n_sources,).
        """
        return np.asarray(self.matrix @ sources, dtype=float)


@dataclass(frozen=True, kw_only=True)
class JacobianScatter:
    """Assembly of the constraints' Jacobian and objective's gradient from derivatives at points.

    A direct integral appears in the objective itself. Static variables (without time) stand for all
    other integrals. The inputs (sources) of the maps are derivatives of path equations (constraints
    over time) and integrands. Then follow those of conditions (constraints not over time) and
    objective: see `jacobian_scatter`.

    Attributes
    ----------
    rows : Scatter
        Map to the Jacobian of the constraints.
    objective : Scatter
        Map to the objective's gradient, without direct integrals.
    integrals : tuple of Scatter
        Map to each direct integral's gradient.
    slope_sources : ndarray of int
        Positions, among the sources of conditions and objective, of the objective's derivatives by
        direct integrals.
    slope_integrals : ndarray of int
        For each of these derivatives, the number of the direct integral, from 0.
    n_integrals : int
        Number of direct integrals.
    n_path_sources : int
        Number of sources of path equations and integrands.
    unknowns : int
        Number of unknowns of the nonlinear program.
    """

    rows: Scatter
    objective: Scatter
    integrals: tuple[Scatter, ...]
    # Positions among the sources of conditions and objective, without structural zeros.
    slope_sources: IndexArray
    slope_integrals: IndexArray
    n_integrals: int
    n_path_sources: int
    unknowns: int

    def objective_slopes(self, point_sources: FloatArray) -> FloatArray:
        """Return the objective's derivative with respect to each direct integral.

        The shape is (n_integrals,). `point_sources` are the nonzeros of the Jacobian of conditions
        (constraints not over time) and objective, as CasADi returned them.
        """
        slopes = np.zeros(self.n_integrals)
        slopes[self.slope_integrals] = point_sources[self.slope_sources]
        return slopes

    def gradient(self, sources: FloatArray, slopes: FloatArray) -> FloatArray:
        """Return the dense gradient of the Pyomo model's objective, shape (n_unknowns,).

        The gradient is not negated if the model maximises the objective. `slopes` come from
        `objective_slopes`.
        """
        dense = np.zeros(self.unknowns)
        dense[self.objective.columns] = self.objective.values(sources)
        for slope, scatter in zip(slopes, self.integrals, strict=True):
            dense[scatter.columns] += slope * scatter.values(sources)
        return dense


def jacobian_scatter(compiled: CompiledModel, layout: Layout) -> JacobianScatter:
    """Return the linear maps that assemble Jacobian and gradient from their sources.

    In order, the sources are

    - the nonzeros of the Jacobian of path equations and integrands, point by point;
    - the nonzeros of the Jacobian of conditions (constraints not over time) and objective;
    - the number 1, the derivative of ``variable - integral = 0`` by the variable.
    """
    path, points = compiled.path, compiled.points
    n_path = layout.points * len(path.jacobian_rows)
    n_sources = n_path + len(points.jacobian_rows) + 1
    n, n_conditions = compiled.n_equations, len(compiled.declared.conditions)
    first_condition_row = layout.points * n
    first_integral_row = first_condition_row + n_conditions
    rows, objective = Contributions(), Contributions()
    integrals = [Contributions() for _ in compiled.row_integrals]
    at, width = np.arange(layout.points)[:, None], path.values.size1_in(0)
    quadrature = layout.mesh.quadrature_weights[:, None] if layout.mesh else np.zeros((0, 1))

    def add(into: Contributions, entries: IndexArray, row: Any, weights: Any) -> None:
        of = width * at + path.jacobian_columns[entries]
        sources = len(path.jacobian_rows) * at + entries
        into.add_slopes(layout.path_variables, row, of, sources, weights)

    entries = np.flatnonzero(path.jacobian_rows < n)
    add(rows, entries, n * at + path.jacobian_rows[entries], 1.0)
    for position, (integral, static) in enumerate(compiled.static_of_integral.items()):
        at_row = first_integral_row + position
        add(rows, np.flatnonzero(path.jacobian_rows == n + integral), at_row, -quadrature)
        rows.add(at_row, layout.static_columns[[static]], n_sources - 1, 1.0)
    for into, integral in zip(integrals, compiled.row_integrals, strict=True):
        add(into, np.flatnonzero(path.jacobian_rows == n + integral), 0, quadrature)
    direct = layout.condition_variables.shape[0]
    is_direct, is_objective = (
        points.jacobian_columns >= direct,
        points.jacobian_rows == n_conditions,
    )
    for into, chosen in ((objective, is_objective), (rows, ~is_objective)):
        entries = np.flatnonzero(chosen & ~is_direct)
        row = np.where(into is objective, 0, first_condition_row + points.jacobian_rows[entries])
        of = points.jacobian_columns[entries]
        into.add_slopes(layout.condition_variables, row, of, n_path + entries, 1.0)
    return JacobianScatter(
        rows=rows.scatter(layout.unknowns, n_sources),
        objective=objective.scatter(layout.unknowns, n_sources),
        integrals=tuple(i.scatter(layout.unknowns, n_sources) for i in integrals),
        slope_sources=np.flatnonzero(is_direct),
        slope_integrals=points.jacobian_columns[is_direct] - direct,
        n_integrals=len(compiled.row_integrals),
        n_path_sources=n_path,
        unknowns=layout.unknowns,
    )


def hessian_scatter(compiled: CompiledModel, layout: Layout) -> Scatter:
    """Return the linear map to the lower triangle of the Lagrangian's Hessian.

    Its inputs are the nonzeros of the Hessians of path equations and integrands, point by point.
    Then follow those of conditions (constraints not over time) and objective.
    """
    into, path, points = Contributions(), compiled.path, compiled.points
    n_path, count = layout.points * len(path.hessian_rows), len(path.hessian_rows)
    first = path.values.size1_in(0) * np.arange(layout.points)[:, None]
    into.add_curvatures(
        layout.path_variables,
        (first + path.hessian_rows).ravel(),
        (first + path.hessian_columns).ravel(),
        np.arange(layout.points * count),
    )
    into.add_curvatures(
        layout.condition_variables,
        points.hessian_rows,
        points.hessian_columns,
        n_path + np.arange(len(points.hessian_rows)),
    )
    return into.scatter(layout.unknowns, n_path + len(points.hessian_rows))
