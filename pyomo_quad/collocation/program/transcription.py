"""Nonlinear program of a compiled model on one mesh, and names of its constraints and unknowns.

The unknowns are states at the nodes, algebraic variables at the collocation points, and static
variables (without time). The time derivatives of the states are linear combinations of the states
at the nodes: see docs/theory/transcription.md, eq. (4). Integrals over the horizon are weighted
sums over the collocation points (Radau quadrature), eq. (5).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from pyomo_quad.collocation.mesh import Mesh, Trajectory
from pyomo_quad.collocation.program.compiled import MappedFunction
from pyomo_quad.collocation.program.sparsity import (
    IndexArray,
    Layout,
    hessian_scatter,
    jacobian_scatter,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pyomo_quad.collocation.mesh import FloatArray
    from pyomo_quad.collocation.program.compiled import CompiledModel


@dataclass(frozen=True, kw_only=True)
class Place:
    """Name, time, element and collocation point of a constraint or unknown, for messages.

    Attributes
    ----------
    name : str
        Full name of the equation or variable.
    time : float, optional
        Time according to `Transcription.time_of`. None for a variable without time, and for a
        constraint other than a path equation.
    element, point : int, optional
        Index of the element, from 0, and number of the collocation point in the element, from 1.
    """

    name: str
    time: float | None = None
    element: int | None = None
    point: int | None = None

    def __str__(self) -> str:
        if self.time is None:
            return self.name
        where = f"{self.name} at time {self.time:.6g}"
        if self.element is None:
            return where
        return f"{where} (element {self.element + 1}, point {self.point})"


def _at_point(program: Transcription, name: str, point: int) -> Place:
    """Return the `Place` of an equation or variable at a collocation point."""
    mesh = program.mesh
    if mesh is None:
        return Place(name=name)
    element = int(mesh.element_of_point[point])
    return Place(
        name=name,
        time=program.time_of(float(mesh.point_fractions[point])),
        element=element,
        point=int(point - mesh.first_node[element] + 1),
    )


def row_place(program: Transcription, row: int) -> Place:
    """Return name, time, element and collocation point of the constraint with the index `row`.

    For constraints other than path equations, only the name is given.
    """
    compiled = program.compiled
    declared = compiled.declared
    if row < program.first_condition_row:
        point, equation = divmod(row, compiled.n_equations)
        return _at_point(program, declared.equations[equation].name, point)
    if row < program.first_integral_row:
        return Place(name=declared.conditions[row - program.first_condition_row].name)
    integral = list(compiled.static_of_integral)[row - program.first_integral_row]
    return Place(name=declared.integrals[integral].name)


def unknown_place(program: Transcription, column: int) -> Place:
    """Return name, time, element and collocation point of the unknown with the index `column`.

    A state at the start of the horizon has no element and point. A variable without time has only a
    name. If there is no such unknown, an IndexError is raised.
    """
    layout, declared = program.layout, program.compiled.declared
    if column >= layout.unknowns - layout.n_statics:
        return Place(name=declared.statics[column - (layout.unknowns - layout.n_statics)].name)
    for slots, columns, first in (
        (declared.states, layout.state_columns, -1),
        (declared.algebraics, layout.algebraic_columns, 0),
    ):
        found = np.argwhere(columns == column)
        if found.size:
            row, slot = (int(k) for k in found[0])
            point = row + first
            if point < 0:
                return Place(name=slots[slot].name, time=program.time_of(0.0))
            return _at_point(program, slots[slot].name, point)
    raise IndexError(column)


@dataclass(frozen=True, kw_only=True)
class Data:
    """Numbers in the equations: constant parameters, and time-dependent parameters at n points.

    Attributes
    ----------
    parameters : ndarray, shape (n_parameters,)
        Constant parameters.
    signals : ndarray, shape (n_points, 1 + n_signals)
        Fraction of the horizon, then the time-dependent parameters.
    """

    parameters: FloatArray
    signals: FloatArray

    def at_points(self) -> FloatArray:
        """Return the fraction of the horizon and all parameters, one row per point.

        Time-dependent parameters come before constant parameters.
        """
        n = self.signals.shape[0]
        return np.hstack(
            [self.signals, np.broadcast_to(self.parameters, (n, self.parameters.size))]
        )


class Transcription:
    """Nonlinear program of a model on one mesh, with derivatives, in the form Ipopt requires.

    The variables of a point are rates (derivatives of the states by the fraction of the horizon),
    states, algebraic and static variables. The constraints ("rows") are:

    - path equations (equalities and inequalities over time), at each collocation point in turn;
    - conditions (constraints without time, or at single members of the continuous set);
    - constraints that make static variables equal to integrals.

    Some integrals, the direct integrals, have no static variable. They appear in the objective
    itself.

    Parameters
    ----------
    compiled : CompiledModel
    mesh : Mesh or None
        None for a model without time.
    data : Data
    """

    def __init__(self, compiled: CompiledModel, mesh: Mesh | None, data: Data) -> None:
        self.compiled = compiled
        self.mesh = mesh
        self.layout = Layout(compiled.declared, mesh)
        self._sign = -1.0 if compiled.declared.maximise else 1.0
        self._jacobian = jacobian_scatter(compiled, self.layout)
        self._hessian = hessian_scatter(compiled, self.layout)
        n = max(self.layout.points, 1)
        path, points = self.compiled.path, self.compiled.points
        self._path = [MappedFunction(f, n) for f in (path.values, path.jacobian, path.hessian)]
        self._point = [
            MappedFunction(f, 1) for f in (points.values, points.jacobian, points.hessian)
        ]
        self._hold(data)

    def __reduce__(self) -> tuple[Any, ...]:
        """Return the constructor and its arguments, for a pickle."""
        return type(self), (self.compiled, self.mesh, self.data)

    def with_data(self, data: Data) -> Transcription:
        """Return a separate program on the same mesh with the parameter values `data`.

        It shares all parts that do not depend on the parameter values, such as sparsity patterns.
        """
        # Not `copy.copy`, which rebuilds all parts as unpickling does.
        other = object.__new__(type(self))
        vars(other).update(vars(self))
        other._hold(data)
        return other

    def _hold(self, data: Data) -> None:
        """Set the parameter values to `data`, and discard results cached for earlier values."""
        self.data = data
        self._path_data = data.at_points()
        self._point_data = data.parameters[None, :]
        self._rows = np.zeros((0, 0))
        self._sources = np.zeros(0)
        self._seen: FloatArray | None = None
        self._differentiated: FloatArray | None = None

    @property
    def n_rows(self) -> int:
        """Number of constraints."""
        return self.first_integral_row + len(self.compiled.static_of_integral)

    def trajectory(self, z: FloatArray) -> Trajectory:
        """Return the unknowns `z` as a trajectory: states, algebraic and static variables."""
        layout = self.layout
        return Trajectory(
            mesh=self.mesh or Mesh.uniform(1, 1),
            states=z[layout.state_columns],
            algebraics=z[layout.algebraic_columns],
            statics=z[layout.static_columns],
        )

    @property
    def n_points(self) -> int:
        """Number of collocation points."""
        return self.layout.points

    @property
    def is_negated(self) -> bool:
        """Whether the Pyomo model maximises its objective, so that the negative is minimised."""
        return self._sign < 0.0

    @property
    def first_condition_row(self) -> int:
        """Position of the first condition (constraint not imposed over time) among all constraints.

        The docstring of the class gives the order of the constraints.
        """
        return self.layout.points * self.compiled.n_equations

    @property
    def first_integral_row(self) -> int:
        """Position of the first constraint that sets a static variable equal to an integral."""
        return self.first_condition_row + len(self.compiled.declared.conditions)

    @property
    def horizon(self) -> tuple[float, float] | None:
        """Start and end of the horizon as physical times.

        The result is None for a model without time, or if a static variable gives start or end.
        """
        names = [p.name for p in self.compiled.declared.parameters]
        if not {"horizon.start", "horizon.end"} <= set(names):
            return None
        start, end = (names.index(f"horizon.{side}") for side in ("start", "end"))
        return float(self.data.parameters[start]), float(self.data.parameters[end])

    def time_of(self, fraction: float) -> float:
        """Return the physical time at a fraction of the horizon, for messages.

        The time is interpolated linearly between start and end of the horizon. It is therefore
        approximate if the solve also determines times inside the horizon. The result is `fraction`
        itself for a model without time, or if a static variable gives start or end.
        """
        start, end = self.horizon or (0.0, 1.0)
        return start + (end - start) * fraction

    def times(self, z: FloatArray) -> FloatArray:
        """Return the physical times that bound the phases of the horizon, at the unknowns `z`.

        These are the start of the horizon, the free times inside it (determined by the solve), and
        its end.
        """
        statics = z[self.layout.static_columns]
        return np.array(self.compiled.times(statics, self.data.parameters)).ravel()

    def path_variables(self, z: FloatArray) -> FloatArray:
        """Return the variables at the collocation points for the unknowns `z`, one row per point.

        The columns are rates, states, algebraic and static variables. Rates are derivatives of the
        states with respect to the fraction of the horizon.
        """
        layout = self.layout
        states = z[layout.state_columns]
        statics = np.broadcast_to(z[layout.static_columns], (layout.points, layout.n_statics))
        return np.hstack(
            [layout.slope_matrix @ states, states[1:], z[layout.algebraic_columns], statics]
        )

    def rows_at_points(self, z: FloatArray) -> FloatArray:
        """Return path equations, then integrands, at the collocation points for the unknowns `z`.

        The shape is (n_points, n_equations + n_integrals).
        """
        if self._seen is None or not np.array_equal(self._seen, z):
            if self.layout.points:
                self._rows = self._path[0](self.path_variables(z), self._path_data)[0]
            else:
                self._rows = np.zeros((0, self.compiled.path.values.numel_out(0)))
            self._seen = np.array(z)
        return self._rows

    def integrals(self, z: FloatArray) -> FloatArray:
        """Return the value of every integral, by Radau quadrature, shape (n_integrals,)."""
        densities = self.rows_at_points(z)[:, self.compiled.n_equations :]
        return self._weights() @ densities

    def objective_density(self, z: FloatArray) -> FloatArray:
        """Return the running cost of the objective at the collocation points, shape (n_points,).

        It is a density over the fraction of the horizon: the sum of ``slope * integrand`` over the
        integrals in the objective, with the slope d (objective to minimise) / d (integral).
        """
        densities = self.rows_at_points(z)[:, self.compiled.n_equations :]
        direct = densities[:, list(self.compiled.row_integrals)]
        return self._sign * direct @ self._objective_slopes(z)

    def objective_size(self, z: FloatArray) -> float:
        """Return the magnitude of the objective, as a reference for its relative errors.

        It is the larger of the objective's absolute value and the integral of
        ``abs(objective_density)``.
        """
        # Positive and negative parts of the running cost do not cancel here.
        parts = float(self._weights() @ np.abs(self.objective_density(z)))
        return max(abs(self.objective(z)), parts)

    def _objective_slopes(self, z: FloatArray) -> FloatArray:
        """Return the derivatives of the objective with respect to its direct integrals.

        Direct integrals are those without a static variable. The objective is not negated if the
        Pyomo model maximises it.
        """
        sources = self._point[1](self.point_variables(z), self._point_data)[0].ravel()
        return self._jacobian.objective_slopes(sources)

    def _weights(self) -> FloatArray:
        """Return the quadrature weights over the fraction of the horizon, shape (n_points,)."""
        return self.mesh.quadrature_weights if self.mesh else np.zeros(0)

    def point_variables(self, z: FloatArray) -> FloatArray:
        """Return the variables of conditions and objective for the unknowns `z`, as one row.

        They are values at members of the continuous set, static variables (without time), and the
        direct integrals of the objective.
        """
        layout = self.layout
        direct = self.integrals(z)[list(self.compiled.row_integrals)]
        values = layout.point_values @ z
        return np.concatenate([values, z[layout.static_columns], direct])[None, :]

    def user_objective(self, z: FloatArray) -> float:
        """Return the objective as the user declared it, not negated if it is maximised.

        `z` are the unknowns of the program.
        """
        return float(self._point[0](self.point_variables(z), self._point_data)[0][0, -1])

    def objective(self, z: FloatArray) -> float:
        """Return the objective to minimise at the unknowns `z`."""
        return self._sign * self.user_objective(z)

    def constraints(self, z: FloatArray) -> FloatArray:
        """Return the values of all constraints at the unknowns `z`, shape (n_rows,).

        The docstring of the class gives their order.
        """
        n = self.compiled.n_equations
        conditions = self._point[0](self.point_variables(z), self._point_data)[0][0, :-1]
        integrals = self.integrals(z)
        definitions = [
            z[self.layout.static_columns[s]] - integrals[i]
            for i, s in self.compiled.static_of_integral.items()
        ]
        return np.concatenate([self.rows_at_points(z)[:, :n].ravel(), conditions, definitions])

    def _derivative_sources(self, z: FloatArray) -> FloatArray:
        """Return the numbers from which Jacobian and gradient are assembled, cached for `z`.

        They are Jacobian nonzeros of path equations and integrands, then of conditions and
        objective. The last number is 1, the derivative of ``variable - integral = 0`` by the
        variable.
        """
        if self._differentiated is None or not np.array_equal(self._differentiated, z):
            path = np.zeros(0)
            if self.layout.points:
                path = self._path[1](self.path_variables(z), self._path_data)[0].ravel()
            point = self._point[1](self.point_variables(z), self._point_data)[0].ravel()
            self._sources = np.concatenate([path, point, [1.0]])
            self._differentiated = np.array(z)
        return self._sources

    def gradient(self, z: FloatArray) -> FloatArray:
        """Return the gradient of the objective to minimise at `z`, shape (n_unknowns,)."""
        sources = self._derivative_sources(z)
        slopes = self._jacobian.objective_slopes(sources[self._jacobian.n_path_sources :])
        return self._sign * self._jacobian.gradient(sources, slopes)

    def jacobianstructure(self) -> tuple[Any, Any]:
        """Return row and column indices of the nonzeros of the constraints' Jacobian."""
        return self._jacobian.rows.rows, self._jacobian.rows.columns

    def jacobian(self, z: FloatArray) -> FloatArray:
        """Return the nonzeros of the constraints' Jacobian at the unknowns `z`.

        Their order is that of `jacobianstructure`.
        """
        return self._jacobian.rows.values(self._derivative_sources(z))

    def hessianstructure(self) -> tuple[Any, Any]:
        """Return row and column indices of the nonzeros of the Lagrangian's Hessian.

        Only the lower triangle is given.
        """
        return self._hessian.rows, self._hessian.columns

    def hessian(self, z: FloatArray, multipliers: FloatArray, factor: float) -> FloatArray:
        """Return the nonzeros of the Hessian of factor * objective + multipliers . constraints.

        They are those of the lower triangle at the unknowns `z`, in the order of
        `hessianstructure`. `factor` multiplies the objective to minimise.
        """
        factor = self._sign * factor
        path = np.zeros(0)
        if self.layout.points:
            weights = self.path_weights(z, multipliers, factor)
            path = self._path[2](self.path_variables(z), self._path_data, weights)[0].ravel()
        conditions = multipliers[self.first_condition_row : self.first_integral_row]
        point_weights = np.append(conditions, factor)[None, :]
        point = self._point[2](self.point_variables(z), self._point_data, point_weights)[0]
        return self._hessian.values(np.concatenate([path, point.ravel()]))

    def path_weights(
        self, z: FloatArray, multipliers: FloatArray, factor: float | None = None
    ) -> FloatArray:
        """Return the factors of path equations, then integrands, in the Lagrangian at each point.

        The factor of a path equation is its multiplier. The factor of an integrand is the point's
        quadrature weight times the weight of the integral in the Lagrangian, which
        `integral_weights` computes at the unknowns `z`. `multipliers` are those of all constraints.
        `factor` multiplies the Pyomo model's objective; None means 1, or -1 if it is maximised. The
        shape is (n_points, n_equations + n_integrals).
        """
        n, points = self.compiled.n_equations, self.layout.points
        on_integral = self.integral_weights(z, multipliers, factor)
        densities = self._weights()[:, None] * on_integral[None, :]
        equations = multipliers[: points * n].reshape(points, n)
        return np.hstack([equations, densities])

    def integral_weights(
        self, z: FloatArray, multipliers: FloatArray, factor: float | None = None
    ) -> FloatArray:
        """Return the weight of each integral in the Lagrangian, shape (n_integrals,).

        - Integral in the objective itself: `factor` times the derivative of the Pyomo model's
          objective by the integral. The default is 1, or -1 if the objective is maximised.
        - Any other integral: minus the multiplier of ``variable - integral = 0``.
        """
        factor = self._sign if factor is None else factor
        weights = np.zeros(len(self.compiled.declared.integrals))
        weights[list(self.compiled.row_integrals)] = factor * self._objective_slopes(z)
        for row, integral in enumerate(self.compiled.static_of_integral):
            weights[integral] = -multipliers[self.first_integral_row + row]
        return weights

    def path_curvatures(self, z: FloatArray, multipliers: FloatArray) -> FloatArray:
        """Return the diagonals of the Hessians from `path_hessians`, shape (n_points, n_variables).

        Entry (i, j) is the Lagrangian's second derivative by variable j at point i, divided by the
        point's quadrature weight. `multipliers` are those of all constraints.
        """
        path = self.compiled.path
        held = self._path_hessian(z, multipliers)
        curvatures = np.zeros((self.layout.points, path.values.size1_in(0)))
        own = path.hessian_rows == path.hessian_columns
        curvatures[:, path.hessian_rows[own]] = held[:, own]
        return curvatures

    def path_hessians(self, z: FloatArray, multipliers: FloatArray) -> FloatArray:
        """Return the Lagrangian's Hessian by the variables of each point.

        The Lagrangian at a point is the sum of path equations and integrands, each times its factor
        from `path_weights`. The sum is divided by the point's quadrature weight.
        `z` are the unknowns, and `multipliers` those of all constraints. The shape is (n_points,
        n_variables, n_variables).
        """
        path = self.compiled.path
        held, n = self._path_hessian(z, multipliers), path.values.size1_in(0)
        hessians = np.zeros((self.layout.points, n, n))
        hessians[:, path.hessian_rows, path.hessian_columns] = held
        hessians[:, path.hessian_columns, path.hessian_rows] = held
        return hessians

    def _path_hessian(self, z: FloatArray, multipliers: FloatArray) -> FloatArray:
        """Return the nonzeros of the Hessians from `path_hessians`, shape (n_points, n_nonzeros).

        The nonzeros are those of the lower triangle. Each Hessian has the Lagrangian's second
        derivatives by the variables of one point. `multipliers` are those of all constraints.
        """
        weights = self.path_weights(z, multipliers)
        held = self._path[2](self.path_variables(z), self._path_data, weights)[0]
        return np.asarray(held / self._weights()[:, None])

    def path_slopes(
        self, variables: FloatArray, data: FloatArray, rows: IndexArray, columns: IndexArray
    ) -> FloatArray:
        """Return derivatives of chosen path equations by chosen variables, at each of n points.

        `rows` and `columns` are increasing positions of equations and variables. `variables` (in
        the order of the class docstring) and `data` (in that of `Data.at_points`) have one row per
        point. The shape is (n, n_rows, n_columns).
        """
        path, count = self.compiled.path, len(variables)
        mapped = self._path[1] if count == self.n_points else MappedFunction(path.jacobian, count)
        entries = mapped(variables, data)[0]
        chosen = np.isin(path.jacobian_rows, rows) & np.isin(path.jacobian_columns, columns)
        slopes = np.zeros((count, rows.size, columns.size))
        at_row = np.searchsorted(rows, path.jacobian_rows[chosen])
        at_column = np.searchsorted(columns, path.jacobian_columns[chosen])
        slopes[:, at_row, at_column] = entries[:, chosen]
        return slopes

    def lagrangian_density(self, z: FloatArray, multipliers: FloatArray) -> FloatArray:
        """Return the integrands' contribution to the Lagrangian at the points, shape (n_points,).

        It is the sum of all integrands times their `integral_weights`, the derivatives of the
        Lagrangian by the integrals. It is a density over the fraction of the horizon. `multipliers`
        are those of all constraints.
        """
        densities = self.rows_at_points(z)[:, self.compiled.n_equations :]
        return np.asarray(densities @ self.integral_weights(z, multipliers))


@dataclass(frozen=True, kw_only=True)
class Linearised:
    """Partial derivatives of the differential equations with respect to rates and states.

    Rates are the derivatives of the states with respect to the fraction of the horizon.

    Attributes
    ----------
    rows : ndarray of int, shape (n_rows,)
        Positions of the differential equations among the path equations (constraints over time).
    by_rate, by_state : ndarray, shape (n_points, n_rows, n_states)
        Derivatives of these equations with respect to the rates and to the states.
    """

    rows: NDArray[np.intp]
    by_rate: FloatArray
    by_state: FloatArray


def linearised(program: Transcription, variables: FloatArray, data: FloatArray) -> Linearised:
    """Return the derivatives of the differential equations with respect to rates and states.

    An equality that contains a rate is a differential equation. `variables` and `data` have one row
    per point, with the columns of `Transcription.path_slopes`.
    """
    path, n = program.compiled.path, program.layout.n_states
    differential = np.zeros(path.values.numel_out(0), dtype=bool)
    differential[path.jacobian_rows[path.jacobian_columns < n]] = True
    rows = np.flatnonzero(
        differential[: program.compiled.n_equations] & program.compiled.is_equality
    )
    slopes = program.path_slopes(variables, data, rows, np.arange(2 * n))
    return Linearised(rows=rows, by_rate=slopes[:, :, :n], by_state=slopes[:, :, n:])


def rate_corrections(
    program: Transcription, variables: FloatArray, data: FloatArray, rows: FloatArray
) -> FloatArray:
    """Return the changes of the rates after which the differential equations are satisfied.

    They are Newton steps, shape (n_points, n_states), exact for equations linear in the rates. With
    fewer or more equations than rates, they are least-squares steps of least norm. Singular square
    equations raise a `numpy.linalg.LinAlgError`. `rows` are the values of all path equations at
    `variables` and `data` (see `Transcription.path_slopes`).
    """
    equations = linearised(program, variables, data)
    matrices, residuals = equations.by_rate, rows[:, equations.rows]
    if matrices.shape[1] == matrices.shape[2]:
        return np.asarray(-np.linalg.solve(matrices, residuals[:, :, None])[:, :, 0], dtype=float)
    return np.asarray(-np.einsum("kij,kj->ki", np.linalg.pinv(matrices), residuals), dtype=float)
