"""The result of a solve: values, costates, Hamiltonian, errors, history; and Pyomo's duals.

The duals, reduced costs and costates that a model imports are the change of the objective per unit
change of a limit.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import casadi
import numpy as np
from pyomo.core import Constraint, Var
from pyomo.core.base.suffix import active_import_suffix_generator

from pyomo_quad.collocation.costates import Costates, costate_errors_of, costates_of
from pyomo_quad.collocation.dynamics import Dynamics
from pyomo_quad.collocation.errors import TranscriptionError
from pyomo_quad.collocation.formulation import index_tuple
from pyomo_quad.collocation.guess import TIME_COLUMN, ColdStart, WarmStart, warm_start_of
from pyomo_quad.collocation.mesh import (
    FloatArray,
    Mesh,
    Summarised,
    Timeline,
    Trajectory,
    interpolate,
    interpolate_rates,
    radau_rule,
)
from pyomo_quad.collocation.program.bounds import limits_of
from pyomo_quad.collocation.program.compiled import CompiledModel, MappedFunction
from pyomo_quad.collocation.program.ipopt import IpoptResult, Iteration, Status
from pyomo_quad.collocation.reading.model_source import LiveModel
from pyomo_quad.collocation.reading.writer import symbol_names

if TYPE_CHECKING:
    from collections.abc import Callable

    import pandas as pd

    from pyomo_quad.collocation.formulation import Formulation
    from pyomo_quad.collocation.program.bernstein import Restraint
    from pyomo_quad.collocation.program.nonlinear import Bounds, Multipliers, Scaling
    from pyomo_quad.collocation.program.transcription import Transcription
    from pyomo_quad.collocation.reading.values import Instance

# Root mean square deviation, relative to the Hamiltonian's size, above which rounding and mesh
# error cannot explain it.
_SUSPICIOUS = 1e-2
# As a fraction of the horizon: a point at an interior condition belongs to the part that ends
# there.
_JUST_BEFORE = 1e-9


def hamiltonian_warnings(solution: Solution) -> tuple[str, ...]:
    """Return a warning if the Hamiltonian should be constant and is not.

    Parameters
    ----------
    solution : Solution
        Converged solution; a model that depends on time explicitly gets no warning.

    Returns
    -------
    tuple of str
        Empty or one line.
    """
    compiled = solution.problem.compiled
    if not compiled.declared.states or _reads_time(compiled):
        return ()
    held, weights = solution.costates.hamiltonian, solution.mesh.quadrature_weights
    # The Hamiltonian may jump where a condition holds at an interior time.
    conditions = solution.problem.required_breakpoints(solution.instance)
    part = np.searchsorted(conditions, solution.mesh.point_fractions - _JUST_BEFORE)
    length = np.bincount(part, weights)
    means = np.bincount(part, weights * held) / np.where(length > 0.0, length, 1.0)
    spread = float(np.sqrt(weights @ (held - means[part]) ** 2))
    mean = float(weights @ held)
    start, end = solution.horizon
    size = abs(mean) + abs(solution.objective) / (end - start)
    if spread <= _SUSPICIOUS * size or compiled.declared.objective.is_constant():
        return ()
    between = " between its conditions" if conditions else ""
    warning = (
        f"Hamiltonian: varies by {spread:.2g} about {mean:.4g}{between} although nothing depends "
        "on time; solve to a tighter tolerance, or distrust the costates."
    )
    return (warning,)


def _reads_time(compiled: CompiledModel) -> bool:
    """Return whether an equation, integrand or limit depends on time, other than by its phase."""
    declared = compiled.declared
    parts = [part for e in declared.equations for part in (e.expression, e.lower, e.upper)]
    parts += [side for b in compiled.simple_path_bounds for side in (b.lower, b.upper)]
    slots = (*declared.states, *declared.algebraics)
    parts += [side for slot in slots for side in (slot.lower, slot.upper)]
    parts += [i.integrand for i in declared.integrals]
    read = symbol_names(casadi.vertcat(casadi.SX(0, 1), *parts))
    is_varying = declared.signals or len(declared.scheduled) > len(declared.clock.phases)
    return bool(is_varying) or declared.clock.fraction.name() in read


# Multiplier over time, relative to objective / size of its equation, above which it counts as
# unbounded.
_UNBOUNDED = 1e12


def diverging_multipliers(solution: Solution) -> tuple[str, ...]:
    """Return the equations over time whose multipliers exceed any regular size."""
    program, scaling = solution.program, solution.scaling
    if not program.n_points:
        return ()
    rows = slice(0, program.first_condition_row)
    held = np.abs(solution.multipliers.rows[rows]) / scaling.rows[rows]
    density = held.reshape(program.n_points, -1) / solution.mesh.quadrature_weights[:, None]
    largest = density.max(axis=0) / solution.nominal_objective
    equations = program.compiled.declared.equations
    return tuple(e.name for e, size in zip(equations, largest, strict=True) if size > _UNBOUNDED)


# Fraction of a table's range by which an argument may leave it.
_RANGE_SLACK = 1e-6


def outside_tables(solution: Solution) -> str:
    """Return one line naming the argument farthest outside its table's range, or ""."""
    program, z = solution.program, solution.unknowns
    tables = program.compiled.tables
    found = []
    if tables.over_time and program.n_points:
        at_points = program.path_variables(z), program.data.at_points()
        mapped = MappedFunction(tables.path, program.n_points)
        found.append((tables.over_time, mapped(*at_points)[0]))
    if tables.in_conditions:
        once = program.point_variables(z), program.data.parameters[None, :]
        found.append((tables.in_conditions, MappedFunction(tables.points, 1)(*once)[0]))
    worst, line = _RANGE_SLACK, ""
    for uses, held in found:
        for use, arguments in zip(uses, held.T, strict=True):
            beyond = np.maximum(use.lower - arguments, arguments - use.upper)
            k = int(np.argmax(beyond))
            if beyond[k] > worst * (use.upper - use.lower):
                worst = beyond[k] / (use.upper - use.lower)
                when = f" at time {solution.times[k + 1]:.6g}" if len(arguments) > 1 else ""
                line = (
                    f"{use.name} is {arguments[k]:.6g}{when}, outside its range "
                    f"[{use.lower:g}, {use.upper:g}]; extend the table, or bound the variables "
                    "in its argument."
                )
    return line


# Largest unit of the objective's scaling that counts, in units of the objective's size (at least
# 1).
_STEEPEST = 10.0


@dataclass(frozen=True, kw_only=True)
class MeshRecord:
    """One mesh of a refinement: its size, its solve and its error."""

    elements: int
    points: int
    iterations: int
    objective: float
    error: float
    wall_s: float


@dataclass(frozen=True, kw_only=True, repr=False)
class Solution(Summarised):
    """A solved (or failed) transcription.

    Attributes
    ----------
    program : Transcription
        The nonlinear program of the last mesh, with this solution's own data.
    status : Status
    ipopt_code : int
        Ipopt's own return code of the last solve.
    message : str
        Reason why the solve ended, in one sentence.
    objective : float
        Objective as declared, by the scheme's own quadrature.
    trajectory : Trajectory
        Unknowns on the mesh.
    error_estimate : float
        Largest relative error over elements and states; infinite if not estimated.
    state_error : float
        Estimated distance of the states from the optimal ones, relative to their magnitudes. It
        adds the errors of all elements, and is larger where limits become active or inactive, and
        where a singular arc leaves the states to a flat objective; infinite if not estimated.
    history : tuple of MeshRecord
        One record per mesh.
    cold_start : ColdStart or None
        Iterations without a warm start; after a warm start, the record that came with it.
    restraint : Restraint or None
        Effect on the objective of bounds between the points; None if none are imposed.
    notes : tuple of str
        Warnings of the solve itself, one line each.
    """

    problem: Formulation
    program: Transcription
    instance: Instance
    status: Status
    ipopt_code: int
    message: str
    objective: float
    trajectory: Trajectory
    multipliers: Multipliers
    unknowns: FloatArray
    bounds: Bounds
    scaling: Scaling
    iterations: tuple[Iteration, ...]
    wall_s: float
    error_estimate: float = np.inf
    state_error: float = np.inf
    history: tuple[MeshRecord, ...] = field(default=())
    cold_start: ColdStart | None = None
    restraint: Restraint | None = None
    notes: tuple[str, ...] = ()

    @property
    def mesh(self) -> Mesh:
        """The last mesh."""
        return self.trajectory.mesh

    @property
    def summary(self) -> dict[str, str]:
        """Status, objective, error and size."""
        size = {}
        if self.problem.has_horizon:
            size = {
                "estimated error": f"{self.error_estimate:.2g}",
                **self._errors_of_others(),
                "mesh": f"{self.mesh.points} points in {self.mesh.elements} elements",
                "meshes": f"{len(self.history) or 1}",
            }
        if self.problem.compiled.declared.clock.is_free:
            size["times"] = ", ".join(f"{time:.6g}" for time in self.timeline.times)
        return {
            "status": self.status.value,
            "objective": f"{self.objective:.10g}",
            **size,
            "message": self.message,
        }

    def _errors_of_others(self) -> dict[str, str]:
        """Return the estimated errors of states and costates, where available."""
        if not (np.isfinite(self.state_error) and self.problem.compiled.declared.states):
            return {}
        name, error = max(self.costate_errors.items(), key=lambda item: item[1])
        return {
            "states within": f"{self.state_error:.2g}",
            "costates within": f"{error:.2g} ({name})",
        }

    @property
    def parts(self) -> tuple[Solution, ...]:
        """The solution on each horizon: itself."""
        return (self,)

    @property
    def size(self) -> tuple[int, int]:
        """Number of unknowns and of rows."""
        return self.unknowns.size, self.program.n_rows

    def updated(self, **changes: Any) -> Solution:
        """Return this solution with other attributes."""
        return replace(self, **changes)

    @property
    def nominal_objective(self) -> float:
        """Reference size for changes of the objective: its own size, or the unit of its scaling.

        A penalty may make the slopes at the first point, and therefore the unit of the scaling, far
        larger than any slope that matters. That unit is therefore capped at a multiple of the
        objective's size.
        """
        size = abs(self.objective)
        return max(size, min(1.0 / self.scaling.objective, _STEEPEST * max(1.0, size)))

    @property
    def is_converged(self) -> bool:
        """Whether the solve converged, and the refinement if a tolerance was given."""
        return self.status is Status.CONVERGED

    @cached_property
    def timeline(self) -> Timeline:
        """Physical times of the free declared times, and of start and end."""
        return self.problem.timeline(self.trajectory.statics, self.instance)

    @property
    def horizon(self) -> tuple[float, float]:
        """Start and end in physical time, as solved for if they are free."""
        times = self.timeline.times
        return float(times[0]), float(times[-1])

    @cached_property
    def mesh_in_time(self) -> Mesh:
        """The mesh with its boundaries as fractions of the horizon in physical time.

        The trajectory's values on it define the same polynomials. It differs from `mesh` only if
        interior times are free.
        """
        if len(self.timeline.times) == 2:
            return self.mesh
        (start, end), times = self.horizon, self.timeline.time(np.array(self.mesh.breakpoints))
        shares = ((times[1:-1] - start) / (end - start)).tolist()
        return Mesh(breakpoints=(0.0, *shares, 1.0), degrees=self.mesh.degrees)

    @cached_property
    def warm_start(self) -> WarmStart:
        """Warm start for another solve, independent of this solution's problem."""
        return warm_start_of(self.program, self.unknowns, self.multipliers, self.cold_start)

    @cached_property
    def output_states(self) -> FloatArray:
        """Output states at the nodes, shape (n_points + 1, n_outputs).

        No other unknown depends on them, so they are solved for on demand.
        """
        program, outputs = self.program, self.problem.outputs
        if not len(outputs) or program.mesh is None:
            return np.zeros((program.layout.points + 1, len(outputs)))
        return outputs.solve(
            program.layout,
            outputs.start(self.instance.parameters, self.instance.fixed),
            program.path_variables(self.unknowns),
            program.data.at_points(),
        )

    @property
    def dynamics(self) -> Dynamics:
        """The right-hand side with the data of this solution."""
        return Dynamics(self.problem, self.instance, self.trajectory.statics)

    @cached_property
    def times(self) -> FloatArray:
        """Physical times of the nodes, shape (n_points + 1,)."""
        return np.asarray(self.timeline.time(self.mesh.node_fractions))

    def fractions(self, times: Any) -> FloatArray:
        """Return times as fractions of the horizon.

        Raises
        ------
        TranscriptionError
            If a time lies outside the horizon.
        """
        start, end = self.horizon
        fractions = self.timeline.fraction(np.asarray(times, dtype=float).ravel())
        slack = 1e-9
        if (
            np.any(fractions < -slack)
            or np.any(fractions > 1.0 + slack)
            or np.any(np.isnan(fractions))
        ):
            raise TranscriptionError(
                f"time: {np.asarray(times)} is outside the horizon [{start:g}, {end:g}]."
            )
        return np.clip(fractions, 0.0, 1.0)

    def value(self, component: Any, t: Any = None, index: Any = None) -> Any:
        """Return a variable's or expression's value.

        Parameters
        ----------
        component : Var, DerivativeVar, Expression or str
            A component of the model or its full name.
        t : float or array, optional
            Times; omitted for a static variable or an integral.
        index : optional
            The component's index beside time.

        Returns
        -------
        float or ndarray
            In the shape of `t`.
        """
        name = component if isinstance(component, str) else component.name
        if t is None:
            return self._static(name, index_tuple(index))
        fractions = self.fractions(t)
        values = self.problem.evaluator(((name, index),), *self._inputs(fractions))[:, 0]
        return float(values[0]) if np.ndim(t) == 0 else values.reshape(np.shape(t))

    def _static(self, name: str, index: tuple[Any, ...]) -> float:
        declared = self.problem.compiled.declared
        for slot, number in zip(declared.statics, self.trajectory.statics, strict=True):
            if (slot.component, slot.index) == (name, index) or slot.name == name:
                return float(number)
        for k, integral in enumerate(declared.integrals):
            if integral.name == name:
                return float(self.program.integrals(self.unknowns)[k])
        raise TranscriptionError(f"{name}: is not a static variable or integral; give a time t.")

    def _inputs(self, fractions: FloatArray) -> list[FloatArray]:
        """Return the inputs of an evaluated function at fractions of the horizon."""
        path, n = self.trajectory, len(fractions)
        states, rates = path.states_at(fractions), path.rates_at(fractions)
        if self.output_states.shape[1]:
            outputs = interpolate(self.mesh, self.output_states, fractions, with_start=True)
            states = np.hstack([states, outputs])
            rates = np.hstack([rates, interpolate_rates(self.mesh, self.output_states, fractions)])
        statics = np.broadcast_to(path.statics, (n, path.statics.size))
        data = self.problem.data_of(self.instance, fractions).at_points()
        return [rates, states, path.algebraics_at(fractions), statics, data]

    @cached_property
    def costates(self) -> Costates:
        """Costates per element and Hamiltonian at the points; see `collocation.costates`."""
        if not self.problem.compiled.declared.states or not self.problem.has_horizon:
            raise TranscriptionError("costate: the model has no states over time.")
        return costates_of(
            self.program,
            self.unknowns,
            self.multipliers,
            bounds=self.bounds,
            timeline=self.timeline,
            objective=self.nominal_objective,
        )

    def costate(self, state: Any, t: Any, index: Any = None) -> Any:
        """Return a state's costate at times: the derivative of the optimal cost by the state."""
        name = state if isinstance(state, str) else state.name
        slots = self.problem.compiled.declared.states
        wanted = (name, index_tuple(index))
        found = [k for k, s in enumerate(slots) if (s.component, s.index) == wanted]
        if not found:
            raise TranscriptionError(f"{name}: is not a state of the optimised model.")
        values = self.costates.at(self.fractions(t))[:, found[0]]
        return float(values[0]) if np.ndim(t) == 0 else values.reshape(np.shape(t))

    @cached_property
    def costate_errors(self) -> dict[str, float]:
        """Estimated largest error of each costate over the horizon, by the name of its state.

        Relative to the costate's largest magnitude. If a limit on a state becomes active or
        inactive inside an element, the error in that element is as large as a jump. Infinite if the
        errors of the states were not estimated.
        """
        own = costate_errors_of(
            self.program,
            self.unknowns,
            self.multipliers,
            bounds=self.bounds,
            costates=self.costates,
        )
        largest = np.maximum(own, self.state_error)
        slots = self.problem.compiled.declared.states
        return {slot.name: float(e) for slot, e in zip(slots, largest, strict=True)}

    @cached_property
    def warnings(self) -> tuple[str, ...]:
        """Warnings about a converged solution, one line each."""
        return (*self.notes, *hamiltonian_warnings(self)) if self.is_converged else ()

    def hamiltonian(self, t: Any) -> Any:
        """Return the Hamiltonian H = L + p . dx/dt at times."""
        held = self.costates.hamiltonian[:, None]
        values = interpolate(self.mesh, held, self.fractions(t), with_start=False)[:, 0]
        return float(values[0]) if np.ndim(t) == 0 else values.reshape(np.shape(t))

    @cached_property
    def running_objective(self) -> FloatArray:
        """Integral part of the objective accumulated until each node, shape (n_points + 1,)."""
        program, mesh = self.program, self.mesh
        density = program.objective_density(self.unknowns)
        sign = -1.0 if self.problem.compiled.declared.maximise else 1.0
        total = [0.0]
        for e, degree in enumerate(mesh.degrees):
            local = density[mesh.first_node[e] : mesh.first_node[e + 1]]
            inside = mesh.widths[e] * radau_rule(degree).integration @ local
            total.extend(total[-1] + sign * inside)
        return np.array(total)

    @cached_property
    def algebraic_limits(self) -> tuple[FloatArray, FloatArray]:
        """Constant lower and upper bounds of the algebraic variables."""
        return self.problem.algebraic_limits(self.instance)

    def to_frame(self, times: Any = None) -> pd.DataFrame:
        """Return states, outputs and algebraic variables as columns over the nodes' times.

        Column "time" comes first, then one column per slot, named as in ``rotors.omega[1]``. A
        variable of the model that is itself called time becomes "time (variable)".
        """
        import pandas as pd  # noqa: PLC0415  0.3 s that a solve has no use for

        at = self.times if times is None else np.atleast_1d(np.asarray(times, dtype=float))
        _, states, algebraics, _, _ = self._inputs(self.fractions(at))
        declared = self.problem.compiled.declared
        slots = (*declared.states, *declared.outputs, *declared.algebraics)
        names = [f"{s.name} (variable)" if s.name == TIME_COLUMN else s.name for s in slots]
        columns = np.hstack([states, algebraics])
        frame = pd.DataFrame(columns, columns=names)
        frame.insert(0, TIME_COLUMN, at)
        return frame


def solution_from(
    problem: Formulation,
    program: Transcription,
    instance: Instance,
    result: IpoptResult,
    *,
    bounds: Bounds,
    scaling: Scaling,
) -> Solution:
    """Return the solution that corresponds to Ipopt's result."""
    z = result.z
    return Solution(
        problem=problem,
        program=program,
        instance=instance,
        status=result.status,
        ipopt_code=result.code,
        message=result.message,
        objective=program.user_objective(z),
        trajectory=program.trajectory(z),
        multipliers=result.multipliers,
        unknowns=z,
        bounds=bounds,
        scaling=scaling,
        iterations=result.history,
        wall_s=result.wall_s,
    )


@dataclass(frozen=True, kw_only=True)
class Sensitivities:
    """Sensitivities of the declared objective, by name: functions of declared time, and numbers."""

    over_time: dict[str, Callable[[float], float]] = field(default_factory=dict)
    once: dict[str, float] = field(default_factory=dict)

    def add(self, name: str, price: Callable[[float], float]) -> None:
        """Add a sensitivity over time to that of a name: both sides of a limit may be rows."""
        held = self.over_time.get(name)
        if held is None:
            self.over_time[name] = price
        else:
            self.over_time[name] = lambda time: held(time) + price(time)


def load_suffixes(*solutions: Solution) -> None:
    """Fill the suffixes `dual`, `rc` and `costate` of a model that imports them.

    They are the derivatives of the declared objective by the constant side of a constraint, by a
    bound of a variable, and by a state; over time, per unit of time. Several solutions are those of
    several horizons.
    """
    source = solutions[0].problem.source
    if not isinstance(source, LiveModel):
        return
    wanted = dict(active_import_suffix_generator(source.model))
    kinds = {"dual": Constraint, "rc": Var, "costate": Var}
    for name in wanted.keys() & kinds.keys():
        wanted[name].clear()
    for solution in solutions if wanted.keys() & kinds.keys() else ():
        for name, prices in _suffixes(solution).items():
            if name in wanted:
                own = solution.problem.source
                if isinstance(own, LiveModel):
                    own.load_suffix(wanted[name], kinds[name], prices.over_time, prices.once)


def _suffixes(solution: Solution) -> dict[str, Sensitivities]:
    """Return the contents of the suffixes by name."""
    problem = solution.problem
    dual, reduced = _sensitivities(solution)
    costates = Sensitivities()
    if problem.has_horizon and problem.compiled.declared.states:
        names = [s.name for s in problem.compiled.declared.states]
        sign = -1.0 if solution.program.is_negated else 1.0
        at = {name: _costate(solution, k, sign) for k, name in enumerate(names)}
        costates = Sensitivities(over_time=at)
    return {"dual": dual, "rc": reduced, "costate": costates}


def _costate(solution: Solution, state: int, sign: float) -> Callable[[float], float]:
    return lambda time: sign * float(solution.costates.at(_fraction(solution, time))[0, state])


def _function(solution: Solution, density: FloatArray) -> Callable[[float], float]:
    def at(time: float) -> float:
        fractions = _fraction(solution, time)
        return float(
            interpolate(solution.mesh, density[:, None], fractions, with_start=False)[0, 0]
        )

    return at


def _fraction(solution: Solution, time: float) -> FloatArray:
    first, last = solution.problem.values.declared_horizon  # noqa: PD011  no frame
    return np.array([(time - first) / (last - first)])


def _sensitivities(solution: Solution) -> tuple[Sensitivities, Sensitivities]:
    """Return the sensitivities to constraints and to bounds."""
    program, multipliers = solution.program, solution.multipliers
    declared = program.compiled.declared
    sign = -1.0 if program.is_negated else 1.0
    dual, reduced = Sensitivities(), Sensitivities()
    rows = -sign * multipliers.rows
    if program.mesh is not None:
        over_time = rows[: program.first_condition_row].reshape(program.n_points, -1)
        for equation, held in zip(declared.equations, over_time.T, strict=True):
            dual.add(equation.name, _function(solution, held / _widths(solution)))
    conditions = rows[program.first_condition_row : program.first_integral_row]
    for condition, held in zip(declared.conditions, conditions.tolist(), strict=True):
        dual.once[condition.name] = held
    _assign_bounds(solution, sign, dual, reduced)
    return dual, reduced


def _widths(solution: Solution) -> FloatArray:
    """Return the length of time that each collocation point represents."""
    mesh = solution.mesh
    return np.asarray(solution.timeline.span_at(mesh.point_fractions) * mesh.quadrature_weights)


def _assign_bounds(
    solution: Solution, sign: float, dual: Sensitivities, reduced: Sensitivities
) -> None:
    """Assign the multipliers of bounds to the variables and constraints that declare them."""
    program, bounds = solution.program, solution.bounds
    compiled = program.compiled
    simple = (*compiled.simple_path_bounds, *compiled.simple_point_bounds)
    slopes = {bound.name: bound.slope for bound in simple}
    # A variable bounded at one time only has a limit with that member's own name.
    find = solution.problem.model.find_component
    of_constraints = slopes.keys() - {
        b.name for b in compiled.simple_point_bounds if getattr(find(b.name), "ctype", None) is Var
    }
    left = {"lower": np.array(solution.multipliers.lower), "upper": -solution.multipliers.upper}
    start_data = solution.problem.data_at_starts(solution.instance)
    for limit in limits_of(program, start_data, solution.instance.fixed):
        total = np.zeros(limit.columns.size)
        for side, rest in left.items():
            # If two declarations impose the same bound, the first of them gets the multiplier.
            is_own = getattr(limit, side) == getattr(bounds, side)[limit.columns]
            total += np.where(is_own, rest[limit.columns], 0.0)
            rest[limit.columns[is_own]] = 0.0
        prices = sign * total / slopes.get(limit.name, 1.0)
        table = dual if limit.name in of_constraints else reduced
        if program.mesh is not None and prices.size >= program.n_points > 1:
            own = prices[-program.n_points :]
            table.add(limit.name, _function(solution, own / _widths(solution)))
        elif prices.size == 1:
            table.once[limit.name] = float(prices[0])
