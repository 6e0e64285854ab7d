"""Result of a solve: values, multipliers, costates, Hamiltonian, errors and history."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Self

import casadi
import numpy as np

from pyomo_quad.collocation.costates import Costates, costate_errors_of, costates_of
from pyomo_quad.collocation.dynamics import Dynamics
from pyomo_quad.collocation.errors import TranscriptionError
from pyomo_quad.collocation.guess import TIME_COLUMN
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
from pyomo_quad.collocation.program.ipopt import IpoptResult, Iteration, Status
from pyomo_quad.collocation.reading.clock import index_tuple
from pyomo_quad.collocation.reading.writer import symbol_names
from pyomo_quad.collocation.starts import ColdStart, WarmStart, warm_start_of

if TYPE_CHECKING:
    import pandas as pd

    from pyomo_quad.collocation.formulation import Formulation
    from pyomo_quad.collocation.program.bernstein import Restraint
    from pyomo_quad.collocation.program.compiled import CompiledModel
    from pyomo_quad.collocation.program.nonlinear import Bounds, Multipliers, Scaling
    from pyomo_quad.collocation.program.transcription import Transcription
    from pyomo_quad.collocation.reading.values import Instance

# Root mean square deviation, relative to the Hamiltonian's size, above which rounding and mesh
# error cannot explain it.
_SUSPICIOUS = 1e-2
# Shift of a point towards the start, as a fraction of the horizon: a point at the time of an
# interior condition then belongs to the part of the horizon that ends there.
_JUST_BEFORE = 1e-9


def hamiltonian_warnings(solution: Solution) -> tuple[str, ...]:
    """Return a warning if the Hamiltonian varies although nothing depends on time explicitly.

    The Hamiltonian is then constant along an optimum, except for jumps at interior conditions such
    as waypoints. The result is empty or has one line.
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
    # If mesh errors cannot explain the variation, the costates are wrong.
    if spread <= _SUSPICIOUS * size or compiled.declared.objective.is_constant():
        return ()
    between = " between its conditions" if conditions else ""
    warning = (
        f"Hamiltonian: varies by {spread:.2g} about {mean:.4g}{between} although nothing depends "
        "on time; solve to a tighter tolerance, or distrust the costates."
    )
    return (warning,)


def _reads_time(compiled: CompiledModel) -> bool:
    """Return whether an equation, integrand or limit of a model depends explicitly on time.

    `compiled` are the equations of the model as CasADi functions.
    """
    declared = compiled.declared
    parts = [part for e in declared.equations for part in (e.expression, e.lower, e.upper)]
    parts += [side for limit in compiled.limits for side in (limit.lower, limit.upper)]
    parts += [i.integrand for i in declared.integrals]
    read = symbol_names(casadi.vertcat(casadi.SX(0, 1), *parts))
    is_varying = declared.signals or len(declared.scheduled) > len(declared.clock.phases)
    return bool(is_varying) or declared.clock.fraction.name() in read


# Cap on the reference size of an objective that is taken from its scaling, in multiples of
# max(1, abs(objective)).
_STEEPEST = 10.0


@dataclass(frozen=True, kw_only=True)
class MeshRecord:
    """Record of one mesh of a refinement: size of the mesh, iterations, objective and error.

    Attributes
    ----------
    elements, points : int
        Numbers of elements and collocation points, over all horizons.
    iterations : int
        Iterations of Ipopt in the last solve on the mesh.
    objective : float
        Value of the objective as the Pyomo model declares it, whether minimised or maximised.
    error : float
        Largest estimated relative error of any kind (see
        `collocation.refining.error.ErrorEstimate`).
    wall_s : float
        Wall-clock time of Ipopt in the last solve on the mesh [s].
    """

    elements: int
    points: int
    iterations: int
    objective: float
    error: float
    wall_s: float


@dataclass(frozen=True, kw_only=True, repr=False)
class Outcome(Summarised):
    """Base class of the results of a solve, on one horizon or several.

    Attributes
    ----------
    status : Status
        How the solve ended, for example converged.
    ipopt_code : int
        Ipopt's own return code of the last solve.
    message : str
        Reason why the solve ended, in one sentence.
    objective : float
        Value of the objective as declared, with integrals by Radau quadrature.
    iterations : tuple of Iteration
        Ipopt's progress in the last solve.
    wall_s : float
        Wall-clock time of the last solve [s].
    error_estimate : float
        Largest estimated relative error of any kind, infinite if not estimated. For the kinds, see
        `collocation.refining.error.ErrorEstimate`.
    state_error : float
        Estimated distance of the states from the optimal states, relative to their magnitudes;
        infinite if not estimated. See `collocation.refining.minimum_principle.state_error`.
    history : tuple of MeshRecord
        One record per mesh; empty without refinement.
    cold_start : ColdStart or None
        Numbers of iterations of the solve from a guess. A solve from a warm start copies them from
        the warm start.
    tried : tuple of str
        Name and status of each solution strategy, if more than one was tried on a mesh.
    """

    status: Status
    ipopt_code: int
    message: str
    objective: float
    iterations: tuple[Iteration, ...]
    wall_s: float
    error_estimate: float = np.inf
    state_error: float = np.inf
    history: tuple[MeshRecord, ...] = ()
    cold_start: ColdStart | None = None
    tried: tuple[str, ...] = ()

    @property
    def is_converged(self) -> bool:
        """Whether the solve converged, and the refinement met its tolerance if one was given."""
        return self.status is Status.CONVERGED

    @property
    @abstractmethod
    def parts(self) -> tuple[Solution, ...]:
        """Solutions on the individual horizons, one for each continuous set of the model.

        Each of these solutions has the status and the history of the whole solve.
        """

    @property
    @abstractmethod
    def warm_start(self) -> Any:
        """Warm start for another solve: trajectory and multipliers of this solution.

        The warm start contains no reference to the compiled problem that was solved.
        """

    def updated(self, **changes: Any) -> Self:
        """Return a copy of this solution with other values of the given attributes.

        Parameters
        ----------
        **changes
            New values of attributes by name, for example of `status` or `message`.
        """
        return replace(self, **changes)


@dataclass(frozen=True, kw_only=True, repr=False)
class Solution(Outcome):
    """Solution on one horizon, converged or not; see `Outcome` for status, errors and history.

    Attributes
    ----------
    problem : Formulation
        Compiled problem that was solved.
    program : Transcription
        Nonlinear program of the last mesh, with the parameter values of this solution.
    instance : Instance
        Parameter values, horizon and fixed variables of the solve.
    trajectory : Trajectory
        States, algebraic variables and static variables on the mesh.
    multipliers : Multipliers
        Multipliers of the program's constraints and bounds, as Ipopt returns them.
    unknowns : ndarray, shape (n_unknowns,)
        Unknowns of the program.
    bounds : Bounds
        Bounds of the unknowns and constraints.
    scaling : Scaling
        Scaling factors of the program.
    restraint : Restraint or None
        Estimate of how much the bounds between the collocation points increase the objective, with
        one value for each element. None if bounds are imposed at the points only.
    notes : tuple of str
        Warnings of the solve itself, one line each.
    """

    problem: Formulation
    program: Transcription
    instance: Instance
    trajectory: Trajectory
    multipliers: Multipliers
    unknowns: FloatArray
    bounds: Bounds
    scaling: Scaling
    restraint: Restraint | None = None
    notes: tuple[str, ...] = ()

    @property
    def mesh(self) -> Mesh:
        """Mesh of the solution, the last mesh of a refinement."""
        return self.trajectory.mesh

    @property
    def summary(self) -> dict[str, str]:
        """Summary of the solution: status, objective, errors, size and message.

        The keys are the labels, the values the texts.
        """
        size = {}
        if self.problem.has_horizon:
            size = {
                "estimated error": f"{self.error_estimate:.2g}",
                **self._state_and_costate_errors(),
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

    def _state_and_costate_errors(self) -> dict[str, str]:
        """Return the lines of the summary on the errors of states and costates: label -> text.

        The result is empty if these errors were not estimated, or if the model has no states.
        """
        if not (np.isfinite(self.state_error) and self.problem.compiled.declared.states):
            return {}
        name, error = max(self.costate_errors.items(), key=lambda item: item[1])
        return {
            "states within": f"{self.state_error:.2g}",
            "costates within": f"{error:.2g} ({name})",
        }

    @property
    def parts(self) -> tuple[Solution, ...]:
        """Solution on the only horizon, as a tuple with one item."""
        return (self,)

    @property
    def size(self) -> tuple[int, int]:
        """Number of unknowns and of constraints of the nonlinear program."""
        return self.unknowns.size, self.program.n_rows

    @property
    def nominal_objective(self) -> float:
        """Reference magnitude for changes of the objective, in the unit of the objective.

        The value is max(abs(objective), min(1 / s, 10 max(1, abs(objective)))), where s is the
        scaling factor of the objective.
        """
        size = abs(self.objective)
        # 1 / s is the size of the objective's derivatives at the initial point. It is limited
        # because a penalty term may make the derivatives far larger there than near the solution.
        return max(size, min(1.0 / self.scaling.objective, _STEEPEST * max(1.0, size)))

    @cached_property
    def timeline(self) -> Timeline:
        """Mapping between fractions of the horizon and physical times of this solution."""
        return self.problem.timeline(self.trajectory.statics, self.instance)

    @property
    def horizon(self) -> tuple[float, float]:
        """Start and end of the horizon in physical time, from the solution if they are free."""
        times = self.timeline.times
        return float(times[0]), float(times[-1])

    @cached_property
    def mesh_in_time(self) -> Mesh:
        """Mesh of the solution, with element boundaries as fractions of the physical duration.

        The boundaries differ from those of `mesh` if the solve determines times inside the horizon.
        Values at the nodes of `mesh` are also the values at the nodes of this mesh.
        """
        if len(self.timeline.times) == 2:
            return self.mesh
        (start, end), times = self.horizon, self.timeline.time(np.array(self.mesh.breakpoints))
        # A phase may be half of the declared horizon but a third of the physical duration.
        shares = ((times[1:-1] - start) / (end - start)).tolist()
        return Mesh(breakpoints=(0.0, *shares, 1.0), degrees=self.mesh.degrees)

    @cached_property
    def warm_start(self) -> WarmStart:
        """Warm start for another solve: trajectory and multipliers of this solution.

        The warm start contains no reference to the compiled problem that was solved.
        """
        return warm_start_of(self.program, self.unknowns, self.multipliers, self.cold_start)

    @cached_property
    def output_states(self) -> FloatArray:
        """Values of the output states at the nodes, shape (n_points + 1, n_outputs).

        Neither the objective nor other equations depend on an output state. An example is an energy
        that is only reported. Output states are not unknowns of the program.
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
        """Right-hand side dx/dt = f(t, x, u) of the model, with the parameters of the solution."""
        return Dynamics(self.problem, self.instance, self.trajectory.statics)

    @cached_property
    def times(self) -> FloatArray:
        """Physical times of the nodes, shape (n_points + 1,).

        The nodes are the start of the horizon and the collocation points.
        """
        return np.asarray(self.timeline.time(self.mesh.node_fractions))

    def fractions(self, times: Any) -> FloatArray:
        """Return physical times as fractions of the horizon.

        Parameters
        ----------
        times : float or array
            Physical times.

        Returns
        -------
        ndarray, shape (n_times,)
            Flattened, whatever the shape of `times`.

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
        """Return the value of a variable or expression, at given times if it depends on time.

        Parameters
        ----------
        component : Var, DerivativeVar, Expression or str
            Component of the model, or its full name.
        t : float or array, optional
            Physical times; omitted for an integral or a variable without time.
        index : optional
            Index without the time: i for ``x[i, t]``; omitted for ``x[t]``.

        Returns
        -------
        float or ndarray
            In the shape of `t`.

        Raises
        ------
        TranscriptionError
            If the model has no such component, if a needed time is missing, or if a time lies
            outside the horizon.
        """
        name = component if isinstance(component, str) else component.name
        if t is None:
            return self._static(name, index_tuple(index))
        fractions = self.fractions(t)
        values = self.problem.evaluator(((name, index),), *self._inputs(fractions))[:, 0]
        return float(values[0]) if np.ndim(t) == 0 else values.reshape(np.shape(t))

    def _static(self, name: str, index: tuple[Any, ...]) -> float:
        """Return the value of a variable without time, or of an integral, by name and index."""
        declared = self.problem.compiled.declared
        for slot, number in zip(declared.statics, self.trajectory.statics, strict=True):
            if (slot.component, slot.index) == (name, index) or slot.name == name:
                return float(number)
        for k, integral in enumerate(declared.integrals):
            if integral.name == name:
                return float(self.program.integrals(self.unknowns)[k])
        raise TranscriptionError(f"{name}: is not a static variable or integral; give a time t.")

    def _inputs(self, fractions: FloatArray) -> list[FloatArray]:
        """Return the inputs of an `Evaluator`'s functions at given fractions of the horizon.

        They are rates (derivatives of the states with respect to the fraction), states, algebraic
        variables, static variables, and data: the fraction and the parameters. Each has one row per
        time.
        """
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
        """Costates and Hamiltonian at the collocation points; see `collocation.costates`.

        Raises
        ------
        TranscriptionError
            If the model has no states over time.
        """
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
        """Return a state's costate: the derivative of the optimal cost with respect to the state.

        If the objective is maximised, the cost is the negative of the objective.

        Parameters
        ----------
        state : Var or str
            The state or its full name.
        t : float or array
            Physical times.
        index : optional
            Index without the time: i for ``x[i, t]``; omitted for ``x[t]``.

        Returns
        -------
        float or ndarray
            In the shape of `t`.

        Raises
        ------
        TranscriptionError
            If the model has no such state, or a time lies outside the horizon.
        """
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

        Errors are relative to the largest magnitude of the costate.
        """
        # A costate may jump where a limit on a state becomes active or inactive.
        # The error is then as large as the jump. No error is below `state_error`.
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
        """Warnings about a converged solution, one line each; empty if it has not converged.

        They are the `notes` of the solve, for example that some equations follow from others, and a
        warning if a Hamiltonian that should be constant varies.
        """
        return (*self.notes, *hamiltonian_warnings(self)) if self.is_converged else ()

    def hamiltonian(self, t: Any) -> Any:
        """Return the Hamiltonian H = L + p . dx/dt at physical times.

        L is the integrand of the minimised objective, p the costates, and x the states.

        Parameters
        ----------
        t : float or array
            Physical times.

        Returns
        -------
        float or ndarray
            In the shape of `t`.

        Raises
        ------
        TranscriptionError
            If a time lies outside the horizon, or the model has no states.
        """
        held = self.costates.hamiltonian[:, None]
        values = interpolate(self.mesh, held, self.fractions(t), with_start=False)[:, 0]
        return float(values[0]) if np.ndim(t) == 0 else values.reshape(np.shape(t))

    @cached_property
    def running_objective(self) -> FloatArray:
        """Integral terms of the objective, integrated from the start of the horizon to each node.

        Shape (n_points + 1,), in the unit and with the sign of the declared objective.
        """
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
        """Constant lower and upper bounds of the algebraic variables, shape (n_algebraics,) each.

        A bound is infinite where none is declared, or where it varies with time.
        """
        return self.problem.algebraic_limits(self.instance)

    @property
    def algebraic_ranges(self) -> FloatArray:
        """Range of each algebraic variable, shape (n_algebraics,), in the variable's unit.

        The range is the upper minus the lower limit. If a variable lacks a limit, the range is the
        difference of its largest and smallest values in the solution.
        """
        lower, upper = self.algebraic_limits
        own = np.ptp(self.trajectory.algebraics, axis=0)
        return np.where(np.isfinite(upper - lower), upper - lower, own)

    def to_frame(self, times: Any = None) -> pd.DataFrame:
        """Return states, output states and algebraic variables as a table over time.

        For output states, see `output_states`.

        Parameters
        ----------
        times : array, optional
            Physical times of the rows; by default the times of the nodes.

        Returns
        -------
        DataFrame
            First the column "time", then one column per variable, named as in ``rotors.omega[1]``.
            A variable called "time" gets the column "time (variable)".

        Raises
        ------
        TranscriptionError
            If a time lies outside the horizon.
        """
        import pandas as pd  # noqa: PLC0415  0.3 s that a solve has no use for

        at = self.times if times is None else np.atleast_1d(np.asarray(times, dtype=float))
        _, states, algebraics, _, _ = self._inputs(self.fractions(at))
        slots = self.problem.compiled.declared.varying
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
    """Return the solution of a problem from Ipopt's result on the problem's nonlinear program.

    `instance` has the parameter values, the horizon and the fixed variables of the solve. `bounds`
    and `scaling` are those with which the program was solved.
    """
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
