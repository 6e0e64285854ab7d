"""What a solve returns: values, costates, Hamiltonian, errors and history, at any time; and duals.

The duals, reduced costs and costates that a model imports say what moving a limit by one unit
would change in the objective.
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
from pyomo_quad.collocation.program.ipopt import IpoptResult, Iteration, Multipliers, Status
from pyomo_quad.collocation.reading.model_source import LiveModel
from pyomo_quad.collocation.reading.writer import symbol_names

if TYPE_CHECKING:
    from collections.abc import Callable

    import pandas as pd

    from pyomo_quad.collocation.formulation import Formulation
    from pyomo_quad.collocation.program.bernstein import Restraint
    from pyomo_quad.collocation.program.bounds import Bounds, Scaling
    from pyomo_quad.collocation.program.transcription import Transcription
    from pyomo_quad.collocation.reading.values import Instance

# Root mean square deviation, as a share of the Hamiltonian's size, that is no longer rounding
# and mesh error.
_SUSPICIOUS = 1e-2
# Of the horizon: a point at an interior condition belongs to the part that it ends.
_JUST_BEFORE = 1e-9


def hamiltonian_warnings(solution: Solution) -> tuple[str, ...]:
    """Return a warning if the Hamiltonian should be constant and is not.

    Parameters
    ----------
    solution : Solution
        Converged; a model that reads time is never warned of.

    Returns
    -------
    tuple of str
        Empty or one line.
    """
    compiled = solution.problem.compiled
    if not compiled.declared.states or _reads_time(compiled):
        return ()
    held, weights = solution.costates.hamiltonian, solution.mesh.quadrature_weights
    # It may jump where a condition holds at an interior time.
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
    """Say whether an equation, an integrand or a limit reads time, other than its phase."""
    declared = compiled.declared
    parts = [part for e in declared.equations for part in (e.expression, e.lower, e.upper)]
    parts += [side for b in compiled.simple_path_bounds for side in (b.lower, b.upper)]
    slots = (*declared.states, *declared.algebraics)
    parts += [side for slot in slots for side in (slot.lower, slot.upper)]
    parts += [i.integrand for i in declared.integrals]
    read = symbol_names(casadi.vertcat(casadi.SX(0, 1), *parts))
    is_varying = declared.signals or len(declared.scheduled) > len(declared.clock.phases)
    return bool(is_varying) or declared.clock.fraction.name() in read


# Of a multiplier, as a share of the objective for the size of its equation, over time.
_UNBOUNDED = 1e12


def diverging_multipliers(solution: Solution) -> tuple[str, ...]:
    """Return the equations over time whose multipliers are beyond anything regular."""
    program, scaling = solution.program, solution.scaling
    if not program.n_points:
        return ()
    rows = slice(0, program.first_condition_row)
    held = np.abs(solution.multipliers.rows[rows]) / scaling.rows[rows]
    density = held.reshape(program.n_points, -1) / solution.mesh.quadrature_weights[:, None]
    largest = density.max(axis=0) / solution.nominal_objective
    equations = program.compiled.declared.equations
    return tuple(e.name for e, size in zip(equations, largest, strict=True) if size > _UNBOUNDED)


# Of a table's range, by how much an argument may leave it.
_RANGE_SLACK = 1e-6


def outside_tables(solution: Solution) -> str:
    """Return one line that names the argument farthest outside its table's range, or nothing."""
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
                    f"[{use.lower:g}, {use.upper:g}]; give more of the table, or bound what "
                    "stands there."
                )
    return line


# Of the objective's size, or of 1: the most that the unit of its scaling counts for.
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
        Why the solve ended, in one sentence.
    objective : float
        As declared, by the scheme's own quadrature.
    trajectory : Trajectory
        Unknowns on the mesh.
    error_estimate : float
        Relative, largest over elements and states; infinite when it was not estimated.
    state_error : float
        How far the states may be from the optimal ones, relative to their magnitudes: all
        elements together, more where limits begin or cease to hold, and more again where a
        singular arc leaves them to a flat objective; infinite when it was not estimated.
    history : tuple of MeshRecord
        One entry per mesh solved on.
    cold_start : ColdStart or None
        What it took without a warm start; from a warm one, what that had taken.
    restraint : Restraint or None
        What bounds that are kept between the points too do to the objective; None where none are.
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
        """Return what is known of states and costates where it was estimated."""
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
        """What changes of the objective are measured by: its size, or that of its scaling.

        A penalty may make the first slopes, and so the unit of the scaling, far steeper than any
        that matters: no more than some times the size counts.
        """
        size = abs(self.objective)
        return max(size, min(1.0 / self.scaling.objective, _STEEPEST * max(1.0, size)))

    @property
    def is_converged(self) -> bool:
        """Whether the solve, and the refinement if one was asked for, converged."""
        return self.status is Status.CONVERGED

    @cached_property
    def timeline(self) -> Timeline:
        """Physical times of the declared ones that are free, and of start and end."""
        return self.problem.timeline(self.trajectory.statics, self.instance)

    @property
    def horizon(self) -> tuple[float, float]:
        """Start and end in physical time, as solved for where they were free."""
        times = self.timeline.times
        return float(times[0]), float(times[-1])

    @cached_property
    def mesh_in_time(self) -> Mesh:
        """The mesh with its boundaries as shares of the horizon in physical time.

        The trajectory's values on it are the same polynomials; other than `mesh` only where
        interior times are free.
        """
        if len(self.timeline.times) == 2:
            return self.mesh
        (start, end), times = self.horizon, self.timeline.time(np.array(self.mesh.breakpoints))
        shares = ((times[1:-1] - start) / (end - start)).tolist()
        return Mesh(breakpoints=(0.0, *shares, 1.0), degrees=self.mesh.degrees)

    @cached_property
    def warm_start(self) -> WarmStart:
        """What another solve can start from, free of this solution's problem."""
        return warm_start_of(self.program, self.unknowns, self.multipliers, self.cold_start)

    @cached_property
    def output_states(self) -> FloatArray:
        """What nothing solved for depends on, solved for when it is asked for.

        Shape (n_points + 1, n_outputs), at the nodes.
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
        """The right-hand side with the numbers that this solution was found with."""
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
            Times; left out for a static variable or an integral.
        index : optional
            The component's index beside time.

        Returns
        -------
        float or ndarray
            Of the shape of `t`.
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
        """Return what an evaluated function reads, at fractions of the horizon."""
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
        """Return the costate of a state at times; p is the slope of the optimum in the state."""
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
        """Largest error of each costate anywhere, estimated, by the name of its state.

        Relative to the costate's largest magnitude.  It is as large as a jump where a limit on a
        state begins or ceases to hold within an element, in that element; infinite when the
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
        """What makes a converged solution doubtful, one line each."""
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

        Column "time" first, then one column per slot, named as ``rotors.omega[1]``; that of a
        variable of the model that is called time is "time (variable)".
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
    """Return the solution that Ipopt's result stands for."""
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
class Prices:
    """Slopes of the declared objective: functions of declared time, and single numbers, by name."""

    over_time: dict[str, Callable[[float], float]] = field(default_factory=dict)
    once: dict[str, float] = field(default_factory=dict)

    def add(self, name: str, price: Callable[[float], float]) -> None:
        """Add a price over time to those of a name: both sides of a limit may be rows."""
        held = self.over_time.get(name)
        if held is None:
            self.over_time[name] = price
        else:
            self.over_time[name] = lambda time: held(time) + price(time)


def load_suffixes(*solutions: Solution) -> None:
    """Fill the model's suffixes `dual`, `rc` and `costate`, where it imports them.

    They are the change of the objective, as declared, with a constraint's constant side, with a
    bound of a variable, and with a state; over time, per unit of time.  Several solutions are
    those of several horizons.
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


def _suffixes(solution: Solution) -> dict[str, Prices]:
    """Return what the suffixes of these names hold."""
    problem = solution.problem
    dual, reduced = _prices(solution)
    costates = Prices()
    if problem.has_horizon and problem.compiled.declared.states:
        names = [s.name for s in problem.compiled.declared.states]
        sign = -1.0 if solution.program.is_negated else 1.0
        at = {name: _costate(solution, k, sign) for k, name in enumerate(names)}
        costates = Prices(over_time=at)
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


def _prices(solution: Solution) -> tuple[Prices, Prices]:
    """Return the prices of constraints and those of bounds."""
    program, multipliers = solution.program, solution.multipliers
    declared = program.compiled.declared
    sign = -1.0 if program.is_negated else 1.0
    dual, reduced = Prices(), Prices()
    rows = -sign * multipliers.rows
    if program.mesh is not None:
        over_time = rows[: program.first_condition_row].reshape(program.n_points, -1)
        for equation, held in zip(declared.equations, over_time.T, strict=True):
            dual.add(equation.name, _function(solution, held / _widths(solution)))
    conditions = rows[program.first_condition_row : program.first_integral_row]
    for condition, held in zip(declared.conditions, conditions.tolist(), strict=True):
        dual.once[condition.name] = held
    _share_bounds(solution, sign, dual, reduced)
    return dual, reduced


def _widths(solution: Solution) -> FloatArray:
    """Return the time that each collocation point stands for."""
    mesh = solution.mesh
    return np.asarray(solution.timeline.span_at(mesh.point_fractions) * mesh.quadrature_weights)


def _share_bounds(solution: Solution, sign: float, dual: Prices, reduced: Prices) -> None:
    """Give the multipliers of bounds to the variables and constraints that state them."""
    program, bounds = solution.program, solution.bounds
    compiled = program.compiled
    simple = (*compiled.simple_path_bounds, *compiled.simple_point_bounds)
    slopes = {bound.name: bound.slope for bound in simple}
    # A variable that is bounded at one time only has a limit there of its own name.
    find = solution.problem.model.find_component
    of_constraints = slopes.keys() - {
        b.name for b in compiled.simple_point_bounds if getattr(find(b.name), "ctype", None) is Var
    }
    left = {"lower": np.array(solution.multipliers.lower), "upper": -solution.multipliers.upper}
    start_data = solution.problem.data_at_starts(solution.instance)
    for limit in limits_of(program, start_data, solution.instance.fixed):
        total = np.zeros(limit.columns.size)
        for side, rest in left.items():
            # Where two declarations say the same, the first has it all.
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
