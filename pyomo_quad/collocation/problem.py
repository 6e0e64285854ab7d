"""A compiled problem, solved as often as wanted without being built again."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import casadi
import numpy as np

from pyomo_quad.collocation.dynamics import Dynamics, Evaluator, OutputStates
from pyomo_quad.collocation.errors import TranscriptionError
from pyomo_quad.collocation.guess import Guess, WarmStart, initial_point, transfer
from pyomo_quad.collocation.interpolants import Interpolant, interpolant
from pyomo_quad.collocation.model_source import LiveModel, ModelSnapshot
from pyomo_quad.collocation.program.bounds import bounds_of, refuse_unsolvable, scaling_of
from pyomo_quad.collocation.program.compiled import CompiledModel, compile_declarations
from pyomo_quad.collocation.program.ipopt import Progress, SolverOptions, run
from pyomo_quad.collocation.program.transcription import Data, Transcription
from pyomo_quad.collocation.reading.model import read_declarations
from pyomo_quad.collocation.reading.schedules import BESIDE
from pyomo_quad.collocation.reading.values import ModelValues, Overrides
from pyomo_quad.collocation.refining.refinement import RefinementOptions, refine
from pyomo_quad.collocation.solution import Solution, solution_from

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from pyomo_quad.collocation.mesh import FloatArray, Mesh
    from pyomo_quad.collocation.refining.refinement import Damping

#: Largest relative error of a solution that is refined without a tolerance being asked for.
DEFAULT_TOLERANCE = 1e-6

_CACHED_MESHES = 4


@dataclass(frozen=True, kw_only=True)
class Instance:
    """The numbers of one solve: parameters, horizon, fixed values and signals.

    `jumps` are the fractions of the horizon where something that changes with time may jump.
    """

    parameters: FloatArray
    horizon: tuple[float, float]
    fixed: dict[tuple[str, float], float]
    overrides: Mapping[str, float | Callable[[float], float]]
    jumps: tuple[float, ...]

    def __getstate__(self) -> dict[str, Any]:
        """Pickle functions of time as polynomials."""
        return vars(self) | {"overrides": {n: self._kept(n, v) for n, v in self.overrides.items()}}

    def __deepcopy__(self, memo: dict[int, Any]) -> Instance:
        """Return itself: it never changes, and its functions are the caller's."""
        return self

    def _kept(self, name: str, given: float | Callable[[float], float]) -> float | Interpolant:
        if not callable(given) or isinstance(given, Interpolant):
            return given
        start, end = self.horizon
        at = [start + (end - start) * fraction for fraction in self.jumps]
        return interpolant(name, lambda t: (float(given(t)),), self.horizon, at)


class Problem:
    """A Pyomo.DAE model compiled for collocation.

    It can be pickled.  What is restored solves and evaluates as before, with the numbers that the
    model held then; the model itself stays behind.

    Parameters
    ----------
    model : ConcreteModel
        With one ContinuousSet that is not discretised, or none.
    final_time : Var, optional
        A static variable of the model that is to be the end of the horizon; the continuous
        set's own end then only fixes where boundary conditions are declared.

    Raises
    ------
    TranscriptionError
        If the declarations are incomplete or unsupported; the message names the component.
    """

    def __init__(self, model: Any, final_time: Any = None) -> None:
        declared, reader = read_declarations(model, final_time)
        compiled = compile_declarations(declared)
        time = reader.copy.time
        own_time = None if time is None else model.find_component(time.name)
        source = LiveModel(model, own_time, tuple(reader.writer.schedules))
        self._hold(compiled, source, Evaluator.of(compiled, reader.writer))

    def _hold(
        self, compiled: CompiledModel, source: LiveModel | ModelSnapshot, evaluator: Evaluator
    ) -> None:
        self.compiled = compiled
        self.source = source
        self.evaluator = evaluator
        self.values = ModelValues(source, compiled.declared)
        self.outputs = OutputStates(compiled)
        declared = compiled.declared
        statics = casadi.vertcat(casadi.SX(0, 1), *[s.symbol for s in declared.statics])
        parameters = casadi.vertcat(casadi.SX(0, 1), *[s.symbol for s in declared.parameters])
        self._horizon = casadi.Function(
            "horizon", [statics, parameters], [declared.start, declared.start + declared.span]
        )
        self._programs: dict[Mesh | None, Transcription] = {}

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle equations and numbers; the Pyomo model stays behind."""
        return _restored, (self.compiled, self.values.snapshot(), self.evaluator)

    def __deepcopy__(self, memo: dict[int, Any]) -> Problem:
        """Copy the Pyomo model as well."""
        memo[id(self)] = other = object.__new__(type(self))
        vars(other).update(deepcopy(vars(self), memo))
        return other

    @property
    def model(self) -> Any:
        """The Pyomo model.

        Raises
        ------
        TranscriptionError
            If the problem was pickled, which leaves the model behind.
        """
        return self.source.model

    @property
    def has_horizon(self) -> bool:
        """Whether the model has a continuous set at all."""
        return self.compiled.declared.has_horizon

    def required_breakpoints(self, instance: Instance) -> tuple[float, ...]:
        """Return fractions of the horizon where an element must end: conditions and jumps."""
        declared = self.compiled.declared
        fractions = {p.fraction for p in declared.point_symbols} | {f for _, f in declared.fixed}
        return tuple(sorted(f for f in fractions.union(instance.jumps) if 0.0 < f < 1.0))

    def solve(
        self,
        *,
        mesh: Mesh | None = None,
        tolerance: float | None = None,
        parameters: Overrides | None = None,
        horizon: tuple[float, float] | None = None,
        guess: Guess | None = None,
        warm_start: Solution | WarmStart | None = None,
        options: SolverOptions | None = None,
        refinement: RefinementOptions | None = None,
        progress: Progress | None = None,
    ) -> Solution:
        """Solve on a given mesh, or refine the mesh until the error meets a tolerance.

        Parameters
        ----------
        mesh : Mesh, optional
            Solved on as it is when no `tolerance` is given; else the mesh to start from.
        tolerance : float, optional
            Largest relative error of the states wanted; default 1e-6 when no mesh is given.
        parameters : mapping, optional
            New values of mutable parameters, by component or full name; a function of time
            for a parameter over time.
        horizon : (float, float), optional
            Start and end of the horizon, in place of the continuous set's.
        guess : mapping, optional
            First values by slot name: functions of time, constants, or samples beside
            "time"; a frame from `Solution.to_frame` is one.
        warm_start : Solution or WarmStart, optional
            On any mesh: its trajectory and multipliers are the first point.
        options : SolverOptions, optional
        refinement : RefinementOptions, optional
        progress : callable, optional
            Called at each iteration; returning False stops the solve.

        Returns
        -------
        Solution
            With its status; a failure of the numerics is a result, not an exception.

        Raises
        ------
        TranscriptionError
            If bounds cross, a value is missing, or an equation is not finite at the guess.
        """
        if tolerance is not None and not tolerance > 0.0:
            raise TranscriptionError(f"tolerance: {tolerance:g}; must be above 0.")
        instance = self.instance(parameters, horizon)
        options = options or SolverOptions()
        start = warm_start.warm_start if isinstance(warm_start, Solution) else warm_start
        if tolerance is None and mesh is None:
            tolerance = DEFAULT_TOLERANCE
        if not self.has_horizon or tolerance is None:
            return self.solve_on_mesh(mesh, instance, options, guess, start, progress)
        return refine(
            self,
            instance,
            mesh=mesh or (start.mesh if start is not None else None),
            tolerance=tolerance,
            options=options,
            refinement=refinement or RefinementOptions(),
            guess=guess,
            warm_start=start,
            progress=progress,
        )

    def instance(
        self, parameters: Overrides | None = None, horizon: tuple[float, float] | None = None
    ) -> Instance:
        """Read the numbers of one solve from the model and the caller."""
        if horizon is not None and not horizon[1] > horizon[0]:
            raise TranscriptionError(
                f"horizon: end {horizon[1]:g} is not after start {horizon[0]:g}."
            )
        return Instance(
            parameters=self.values.parameters(parameters, horizon),
            horizon=horizon or self.values.declared_horizon,
            fixed=self.values.fixed(),
            overrides=self.values.by_name(parameters),
            jumps=self.values.jumps(parameters, horizon),
        )

    def signals(self, instance: Instance, fractions: FloatArray) -> FloatArray:
        """Return fraction and signals, one row per fraction."""
        if not self.compiled.declared.has_signals:
            return fractions[:, None]
        at = self.values.signals(instance)
        return np.array([[fraction, *at(fraction)] for fraction in fractions.tolist()])

    def data_of(self, instance: Instance, fractions: FloatArray) -> Data:
        """Return what the equations read at fractions of the horizon."""
        return Data(parameters=instance.parameters, signals=self.signals(instance, fractions))

    def data_at_starts(self, instance: Instance) -> FloatArray:
        """Return what the equations read at the start and just after each jump, row by row."""
        after = np.array(instance.jumps) + 2.0 * BESIDE
        return self.data_of(instance, np.concatenate([np.zeros(1), after])).at_points()

    def program(self, mesh: Mesh | None, instance: Instance) -> Transcription:
        """Return a nonlinear program on a mesh, made quickly where the mesh was used before."""
        data = self.data_of(instance, mesh.point_fractions if mesh else np.zeros(0))
        if mesh not in self._programs:
            if len(self._programs) >= _CACHED_MESHES:
                self._programs.pop(next(iter(self._programs)))
            self._programs[mesh] = Transcription(self.compiled, mesh, data)
        return self._programs[mesh].with_data(data)

    def solve_on_mesh(
        self,
        mesh: Mesh | None,
        instance: Instance,
        options: SolverOptions,
        guess: Guess | None = None,
        warm_start: WarmStart | None = None,
        progress: Progress | None = None,
        damping: Damping | None = None,
    ) -> Solution:
        """Solve once on one mesh; `solve` and `Damping` say what the arguments mean."""
        if mesh is not None:
            mesh = mesh.with_breakpoints(self.required_breakpoints(instance))
        program = self.program(mesh, instance)
        at_start = self.data_at_starts(instance)
        bounds = bounds_of(program, at_start, instance.fixed)
        multipliers = None
        if warm_start is None:
            z = initial_point(program, bounds, self.values, guess)
        else:
            z, multipliers = transfer(warm_start, program)
            z = np.clip(z, bounds.lower, bounds.upper)
        refuse_unsolvable(program, bounds, z)
        scaling = scaling_of(program, bounds, z)
        result = run(
            program if damping is None else damping.applied_to(program),
            bounds,
            scaling,
            z,
            options=options,
            multipliers=multipliers,
            progress=progress,
        )
        return solution_from(self, program, instance, result, bounds=bounds, scaling=scaling)

    def horizon_of(self, statics: FloatArray, instance: Instance) -> tuple[float, float]:
        """Return start and end of the horizon, the end from the statics where it is free."""
        start, end = self._horizon(statics, instance.parameters)
        return float(start), float(end)

    def dynamics(
        self,
        *,
        parameters: Overrides | None = None,
        horizon: tuple[float, float] | None = None,
        statics: FloatArray | None = None,
    ) -> Dynamics:
        """Return the explicit right-hand side of the model for a simulation.

        Static variables take the values they hold in the model unless given.
        """
        declared = self.compiled.declared
        if statics is None:
            held = [self.values.static_value(s) for s in declared.statics]
            statics = np.array([np.nan if v is None else v for v in held])
        return Dynamics(self, self.instance(parameters, horizon), statics)

    def load(self, solution: Solution) -> None:
        """Put a solution's values into the Pyomo model, at the times it declares."""
        declared = self.compiled.declared
        for slot, number in zip(declared.statics, solution.trajectory.statics, strict=True):
            self.values.load(slot, None, float(number))
        start, end = solution.horizon
        for fraction in self.values.declared_fractions():
            time = start + (end - start) * fraction
            frame = solution.to_frame([time]).iloc[0]
            for slot in (*declared.states, *declared.outputs, *declared.algebraics):
                self.values.load(slot, fraction, float(frame[slot.name]))
            self.values.load_rates(fraction, partial(solution.value, t=time))


def _restored(compiled: CompiledModel, source: ModelSnapshot, evaluator: Evaluator) -> Problem:
    problem = object.__new__(Problem)
    problem._hold(compiled, source, evaluator)
    return problem
