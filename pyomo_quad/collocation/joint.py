"""Problems with several horizons: phases, experiments or scenarios, each with its own mesh."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import cached_property, partial
from math import inf
from typing import TYPE_CHECKING, Any

import numpy as np

from pyomo_quad.collocation.errors import TranscriptionError
from pyomo_quad.collocation.first_solve import FirstSolve
from pyomo_quad.collocation.formulation import Formulation
from pyomo_quad.collocation.guess import first_point, known_names
from pyomo_quad.collocation.mesh import Mesh, Summarised
from pyomo_quad.collocation.problem import Problem, load_values
from pyomo_quad.collocation.program.bounds import (
    bounds_of,
    refuse_not_finite,
    refuse_overdetermined,
    scaling_by,
)
from pyomo_quad.collocation.program.coupling import CoupledProgram, StateValue, Union, read_horizons
from pyomo_quad.collocation.program.elastic import least_violation
from pyomo_quad.collocation.program.ipopt import Status, run
from pyomo_quad.collocation.program.nonlinear import Scaling
from pyomo_quad.collocation.program.transcription import unknown_place
from pyomo_quad.collocation.reading.copy import continuous_sets
from pyomo_quad.collocation.refining.refinement import refine
from pyomo_quad.collocation.solution import Outcome, Solution, solution_from
from pyomo_quad.collocation.solving import carried_out
from pyomo_quad.collocation.starts import Start, transfer
from pyomo_quad.collocation.strategies import Scope, first_success
from pyomo_quad.collocation.verdicts import verdict, violation

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from pyomo_quad.collocation.mesh import FloatArray
    from pyomo_quad.collocation.program.ipopt import (
        IpoptResult,
        Progress,
        SolverOptions,
    )
    from pyomo_quad.collocation.program.nonlinear import Bounds, Multipliers
    from pyomo_quad.collocation.program.transcription import Transcription
    from pyomo_quad.collocation.reading.clock import FreeTimes
    from pyomo_quad.collocation.reading.values import Instance, Overrides
    from pyomo_quad.collocation.refining.damping import Damping
    from pyomo_quad.collocation.refining.remeshing import RefinementOptions
    from pyomo_quad.collocation.starts import WarmStart


# Attributes of an outcome that differ between the horizons.
_OWN = ("ipopt_code", "objective", "iterations", "wall_s")


@dataclass(frozen=True, kw_only=True, repr=False)
class JointSolution(Outcome):
    """Solution of a problem with several horizons; see `Outcome` for status and history.

    Attributes
    ----------
    horizons : dict
        Solution on each horizon, by the name of its continuous set.
    coupling : Solution
        Solution of the coupling: the variables that belong to no horizon, the objective, and the
        constraints that concern several horizons or no horizon.
    size : (int, int)
        Number of unknowns and of constraints of the joint nonlinear program.
    """

    horizons: dict[str, Solution]
    coupling: Solution
    size: tuple[int, int]

    @property
    def summary(self) -> dict[str, str]:
        """Status, objective, error estimate, mesh sizes and message, as text by label."""
        sizes = {name: part.mesh.summary for name, part in self.horizons.items()}
        return {
            "status": self.status.value,
            "objective": f"{self.objective:.10g}",
            "estimated error": f"{self.error_estimate:.2g}",
            **{n: f"{size['points']} points" for n, size in sizes.items()},
            "meshes": f"{len(self.history) or 1}",
            "message": self.message,
        }

    @cached_property
    def parts(self) -> tuple[Solution, ...]:
        """Solutions on the horizons, one per horizon.

        Each solution has the status, the error and the history of the joint solve.
        """
        shared = [f.name for f in fields(Outcome) if f.name not in _OWN]
        whole = {name: getattr(self, name) for name in shared}
        return tuple(part.updated(**whole) for part in self.horizons.values())

    def updated(self, **changes: Any) -> JointSolution:
        """Return a copy of the solution with changed attributes, such as `status` or `message`.

        The solutions on the horizons receive the same changes.

        Parameters
        ----------
        **changes
            New values of attributes, by name.
        """
        other = replace(self, **changes)
        horizons = zip(self.horizons, other.parts, strict=True)
        return replace(other, horizons=dict(horizons))

    @property
    def warm_start(self) -> tuple[WarmStart, ...]:
        """Warm start for another solve: one part per horizon, then one part for the coupling.

        Each part holds values of variables and multipliers of constraints. The coupling has the
        variables that belong to no horizon, and the constraints on several horizons or on no
        horizon.
        """
        return tuple(part.warm_start for part in (*self.horizons.values(), self.coupling))

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings about a converged solution, one line each, with the name of the horizon.

        An example is a Hamiltonian that varies over a horizon although no equation depends on time.
        There are no warnings if the solve did not converge.
        """
        found = ((name, line) for name, p in self.horizons.items() for line in p.warnings)
        return tuple(f"{name}: {line}" for name, line in found)

    def on(self, component: Any, index: Any = None) -> Solution:
        """Return the solution on the horizon that indexes a given component.

        Parameters
        ----------
        component : Var, DerivativeVar, Expression or str
            A component of the model over the horizon, or its full name.
        index : optional
            Index of the component without the time: i for ``x[i, t]``; omitted for ``x[t]``.

        Raises
        ------
        TranscriptionError
            If no horizon indexes the component.
        """
        name = component if isinstance(component, str) else component.name
        for part in self.horizons.values():
            if part.problem.evaluator.is_over_time(name, index):
                return part
        raise TranscriptionError(
            f"{name}: depends on the time of none of the horizons {', '.join(self.horizons)}; "
            "leave out the time."
        )

    def value(self, component: Any, t: Any = None, index: Any = None) -> Any:
        """Return the value of a variable or expression, at given times if it depends on time.

        Parameters
        ----------
        component : Var, DerivativeVar, Expression or str
            The component or its full name.
        t : float or array, optional
            Physical times; omitted for a variable without time or an integral.
        index : optional
            Index of the component without the time: i for ``x[i, t]``; omitted for ``x[t]``.

        Returns
        -------
        float or ndarray
            Values in the shape of `t`; a single number if `t` is omitted.

        Raises
        ------
        TranscriptionError
            If the model has no such component, or a time lies outside the component's horizon.
        """
        if t is not None:
            return self.on(component, index).value(component, t, index)
        for part in self.horizons.values():
            try:
                return part.value(component, index=index)
            except TranscriptionError:
                continue
        return self.coupling.value(component, index=index)

    def costate(self, state: Any, t: Any, index: Any = None) -> Any:
        """Return a state's costate: the derivative of the optimal cost with respect to the state.

        Parameters
        ----------
        state : Var or str
            The state or its full name.
        t : float or array
            Physical times on the horizon of the state.
        index : optional
            Index of the state without the time: i for ``x[i, t]``; omitted for ``x[t]``.

        Returns
        -------
        float or ndarray
            Costates in the shape of `t`. The cost is the objective or, if this is maximised, the
            negative objective.

        Raises
        ------
        TranscriptionError
            If the model has no such state, or a time lies outside the state's horizon.
        """
        return self.on(state, index).costate(state, t, index)


class JointProblem(Summarised):
    """Pyomo.DAE model with several continuous sets, compiled for collocation.

    Parameters
    ----------
    model : ConcreteModel
        Model with several ContinuousSets that are not discretised. Each set is the horizon of the
        variables that the set indexes. Constraints on values at the ends of horizons, on integrals
        and on static variables may couple the horizons.
    times : mapping, optional
        Physical times that the solve determines, by the name of the continuous set. For example,
        {"flight": {1.0: m.T1}} makes the static variable `m.T1` the physical time of all conditions
        declared at 1.0 in the set "flight".

    Attributes
    ----------
    horizons : dict
        Name of a continuous set -> compiled declarations of the components over this horizon.
    coupling : Formulation
        The objective, and the declarations that concern several horizons or no horizon.

    Raises
    ------
    TranscriptionError
        If the declarations are incomplete or unsupported; the message names the component.
    """

    def __init__(self, model: Any, times: FreeTimes | None = None) -> None:
        read = read_horizons(model, times)
        self.horizons = {name: Formulation.of(model, *held) for name, held in read.horizons.items()}
        self.coupling = Formulation.of(model, *read.coupling)
        self._links = frozenset(read.links)
        names = list(self.horizons)
        self._states = {
            static: StateValue(program=names.index(name), state=point.slot, fraction=point.fraction)
            for static, (name, point) in read.states.items()
        }

    @property
    def summary(self) -> dict[str, str]:
        """Number of states on each horizon, as text by the name of its continuous set."""
        counts = {n: len(p.compiled.declared.states) for n, p in self.horizons.items()}
        return {name: f"{count} states" for name, count in counts.items()}

    @property
    def is_maximised(self) -> bool:
        """Whether the model's objective is to be maximised."""
        return self.coupling.compiled.declared.maximise

    def solve(
        self,
        *,
        mesh: Mesh | Mapping[str, Mesh] | None = None,
        tolerance: float | None = None,
        parameters: Overrides | None = None,
        horizon: tuple[float, float] | None = None,
        guess: Mapping[str, Any] | None = None,
        warm_start: JointSolution | tuple[WarmStart, ...] | None = None,
        options: SolverOptions | None = None,
        refinement: RefinementOptions | None = None,
        starts: int = 1,
        progress: Progress | None = None,
    ) -> JointSolution:
        """Solve on given meshes, or refine the meshes until the estimated errors meet a tolerance.

        Parameters
        ----------
        mesh : Mesh or mapping, optional
            One mesh for all horizons, or a mapping from the names of the continuous sets to meshes;
            only the initial meshes if a `tolerance` is given. Constraints at single times,
            single fixed values and jumps of parameters add element boundaries at their times. By
            default, the meshes of the warm start, or `first_mesh` of `refinement`.
        guess : mapping, optional
            Initial values by the name of a variable: a function of time, a constant, or an array of
            samples. The key "time" gives the times of the samples. The name of a continuous set
            maps to a guess for the variables over the set; it replaces all other initial values of
            these variables.
        warm_start : JointSolution or tuple of WarmStart, optional
            Solution of the same model on any meshes.
        horizon : None
            Must be None. Only problems with one horizon accept other values.
        starts : int, default 1
            Must be 1. Only problems with one horizon accept other values.
        tolerance : float, optional
            Required relative error of the states on all horizons; default 1e-6 if no mesh is given.
        parameters : mapping, optional
            New values of mutable parameters, by component or full name. The value of a parameter
            over time is a function of time.
        options : SolverOptions, optional
            Settings of Ipopt.
        refinement : RefinementOptions, optional
            Settings of the mesh refinement.
        progress : callable, optional
            Called at each iteration of Ipopt with an `Iteration`; returning False stops the solve.

        Returns
        -------
        JointSolution
            The status shows whether the solve converged; a failed solve raises no exception.

        Raises
        ------
        TranscriptionError
            If an argument is refused, bounds cross, a value is missing, or an equation is not
            finite at the guess.
        """
        self._refuse_of_one_horizon(horizon, starts)
        given = self._meshes(mesh)
        instances = [part.instance(parameters) for part in self._parts]

        def attempt(
            start: Start,
            progress: Progress,
            options: SolverOptions,
            tolerance: float | None,
            refinement: RefinementOptions,
        ) -> JointSolution:
            def finish(
                own: Callable[..., JointSolution], meshes: list[Mesh | None], start: Start
            ) -> JointSolution:
                if tolerance is None:
                    return own(meshes, start)
                return refine(
                    own,
                    meshes=tuple(mesh or refinement.first_mesh for mesh in meshes),
                    tolerance=tolerance,
                    refinement=refinement,
                    start=start,
                )

            if tolerance is not None:
                options = options.suiting(tolerance)
            is_warm = start.warm is not None and mesh is None
            search = FirstSolve(
                solve=partial(self._solve_on, instances=instances, progress=progress),
                finish=finish,
                judge=partial(self._judged, options=options, progress=progress),
                mesh=[part.mesh for part in start.warm[:-1]] if is_warm else given,
                start=start,
                options=options,
            )
            return first_success(Scope.FIRST, search)

        return carried_out(
            attempt,
            Start.of(warm_start, self._guesses(guess)),
            tolerance=tolerance,
            has_mesh=mesh is not None,
            options=options,
            refinement=refinement,
            progress=progress,
        )

    def _refuse_of_one_horizon(self, horizon: tuple[float, float] | None, starts: int) -> None:
        """Raise an error for arguments of `solve` that only problems with one horizon support.

        Here, `horizon` must be None, and `starts`, the number of initial points, must be 1.
        """
        names = ", ".join(self.horizons)
        if horizon is not None:
            raise TranscriptionError(
                f"horizon: the model has several, {names}; give their ends by static variables: "
                f'times={{"{next(iter(self.horizons))}": {{declared time: m.T}}}}.'
            )
        if starts != 1:
            raise TranscriptionError(
                f"starts: {starts}; must be 1 with several horizons, {names}; give guess= instead."
            )

    def _meshes(self, mesh: Mesh | Mapping[str, Mesh] | None) -> list[Mesh | None]:
        """Return the mesh of each horizon, or None for each horizon if `mesh` is None.

        A single `Mesh` is that of all horizons. A mapping has names of horizons as keys.

        Raises
        ------
        TranscriptionError
            If the names in the mapping are not exactly those of the horizons.
        """
        if mesh is None or isinstance(mesh, Mesh):
            return [mesh] * len(self.horizons)
        if mesh.keys() != self.horizons.keys():
            raise TranscriptionError(
                f"mesh: given for {', '.join(mesh)}; give one for each horizon, "
                f"{', '.join(self.horizons)}."
            )
        return [mesh[name] for name in self.horizons]

    @property
    def _parts(self) -> list[Formulation]:
        """Formulations of the horizons, followed by the formulation of the coupling.

        The coupling consists of the objective, and of the constraints on several horizons or on no
        horizon.
        """
        return [*self.horizons.values(), self.coupling]

    def _guesses(self, guess: Mapping[str, Any] | None) -> list[Any]:
        """Split the user's guess into one per horizon, and one for all other variables.

        An item with the name of a horizon replaces all other guesses for the horizon's variables.

        Raises
        ------
        TranscriptionError
            If a name is neither a horizon nor a variable.
        """
        guess = {} if guess is None else guess
        known = [known_names(part.compiled.declared) for part in self._parts]
        for name in guess:
            if name not in self.horizons and not any(name in names for names in known):
                raise TranscriptionError(
                    f"guess: {name!r} is none of the model's variables and none of its horizons, "
                    f"which are {', '.join(self.horizons)}."
                )
        own = [{n: guess[n] for n in guess if n in names} for names in known]
        return [guess.get(name, held) for name, held in zip([*self.horizons, ""], own, strict=True)]

    def union(self, meshes: Sequence[Mesh | None], instances: Sequence[Instance]) -> Union:
        """Join the nonlinear programs of all horizons and of the coupling in a `Union`.

        The coupling consists of the objective, and of the constraints on several horizons or on no
        horizon. A `Union` holds the positions of all unknowns and constraints in the joint program.

        Parameters
        ----------
        meshes : sequence of Mesh or None
            Mesh of each horizon, in the order of `horizons`, then None for the coupling.
        instances : sequence of Instance
            Data of the solve, such as parameter values, in the same order.
        """
        programs = [
            part.program(mesh, instance)
            for part, mesh, instance in zip(self._parts, meshes, instances, strict=True)
        ]
        return Union(programs, self._states)

    def _solve_on(
        self,
        meshes: Sequence[Mesh | None],
        start: Start,
        dampings: tuple[Damping | None, ...] = (),
        *,
        instances: list[Instance],
        options: SolverOptions,
        progress: Progress | None,
        is_scaled: bool = True,
        change: float | None = None,
        iteration_limit: float = inf,
    ) -> JointSolution:
        """Solve the joint nonlinear program once, with arguments as in `Problem.solve_on_mesh`.

        `meshes` and `dampings` have one entry per horizon. `instances` has one more, for the
        coupling.
        """
        parts = self._parts
        chosen = [
            mesh and mesh.with_breakpoints(part.required_breakpoints(instance))
            for part, mesh, instance in zip(parts, meshes, instances, strict=False)
        ]
        union = self.union([*chosen, None], instances)
        bounds = union.bounds(
            [
                bounds_of(program, part.data_at_starts(instance), instance.fixed)
                for program, part, instance in zip(union.programs, parts, instances, strict=True)
            ]
        )
        z, multipliers = self._first_point(union, bounds, start)
        self._refuse_unsolvable(union, bounds, z)
        program = CoupledProgram(union, union.programs)
        scaling = scaling_by(program, union.nominal(bounds, z), z)
        damped = tuple(
            own if damping is None else damping.applied_to(own)
            for own, damping in zip(union.programs, [*dampings, *[None] * len(parts)], strict=False)
        )
        is_damped = any(d is not None and d.controls.size > 0 for d in dampings)
        if change is not None and multipliers is not None and not is_damped:
            options = options.for_a_change(change * scaling.objective, bounds.sides)
        result = run(
            CoupledProgram(union, damped),
            bounds,
            scaling if is_scaled else scaling.none,
            z,
            options=options.at_most(iteration_limit).for_phases(),
            multipliers=multipliers,
            progress=progress,
        )
        return self._solution_from(union, instances, result, bounds, scaling)

    def _judged(
        self, failed: JointSolution, options: SolverOptions, progress: Progress | None
    ) -> JointSolution:
        """Return a failed solution with a verdict: whether its problem is infeasible.

        The verdict follows from the least sum of constraint violations near the last iterate.
        """
        parts = [*failed.horizons.values(), failed.coupling]
        union = Union([part.program for part in parts], self._states)
        scaling = Scaling(
            objective=parts[0].scaling.objective,
            unknowns=union.joined([part.scaling.unknowns for part in parts]),
            rows=np.concatenate([part.scaling.rows for part in parts]),
        )
        z = union.joined([part.unknowns for part in parts])
        if not np.all(np.isfinite(z)):
            return failed
        found = least_violation(
            CoupledProgram(union, union.programs),
            union.bounds([part.bounds for part in parts]),
            scaling,
            z,
            options=options.for_phases(),
            progress=progress,
        )
        if found.result.status is Status.INTERRUPTED:
            return failed.updated(status=Status.INTERRUPTED)
        if not found.is_positive:
            is_wrong = found.is_zero and failed.status is Status.INFEASIBLE
            return failed.updated(status=Status.NOT_CONVERGED) if is_wrong else failed
        violated = []
        for part, rows in zip(parts, union.rows, strict=True):
            violated += [
                (found.slacks[row], violation(part, row - rows.start, found.slacks[row]))
                for row in found.worst_rows.tolist()
                if rows.start <= row < rows.stop
            ]
        violated.sort(key=lambda pair: -pair[0])
        message = verdict([line for _, line in violated])
        return failed.updated(status=Status.INFEASIBLE, message=message)

    def _solution_from(
        self,
        union: Union,
        instances: list[Instance],
        result: IpoptResult,
        bounds: Bounds,
        scaling: Scaling,
    ) -> JointSolution:
        """Return the `JointSolution` of Ipopt's result, with a solution on each horizon."""
        found = [
            solution_from(
                part,
                union.programs[k],
                instances[k],
                union.part(result, k),
                bounds=union.part(bounds, k),
                scaling=union.part(scaling, k),
            )
            for k, part in enumerate(self._parts)
        ]
        total = sum(part.objective for part in found)
        found = [part.updated(objective=total) for part in found]
        return JointSolution(
            horizons=dict(zip(self.horizons, found, strict=False)),
            coupling=found[-1],
            status=result.status,
            ipopt_code=result.code,
            message=result.message,
            objective=total,
            iterations=result.history,
            size=(union.unknowns, bounds.row_lower.size),
            wall_s=result.wall_s,
        )

    def _first_point(
        self, union: Union, bounds: Bounds, start: Start
    ) -> tuple[FloatArray, Multipliers | None]:
        """Return the initial point of the joint program inside `bounds`, and its multipliers.

        `union` has the programs of all horizons, and the positions of their unknowns in the joint
        program. The multipliers are None if `start` has no warm start.
        """
        if start.warm is not None:
            starts = zip(start.warm, union.programs, strict=True)
            points, multipliers = zip(*[transfer(*pair) for pair in starts], strict=True)
            z = union.joined(points)
            return np.clip(z, bounds.lower, bounds.upper), union.multipliers(multipliers)
        parts = zip(union.programs, self._parts, start.guess, strict=True)
        guessed = [
            first_point(program, union.part(bounds, k), part.values, guess)
            for k, (program, part, guess) in enumerate(parts)
        ]
        z = union.joined(guessed)
        for places, program in zip(union.places, union.programs, strict=True):
            self._set_links(union, program, z, places)
        return np.clip(z, bounds.lower, bounds.upper), None

    def _set_links(self, union: Union, program: Transcription, z: FloatArray, places: Any) -> None:
        """Set the static variables in `z` that stand for values of one horizon in the coupling.

        An example is a state's derivative at the end. `places` are the positions in `z` of the
        unknowns of the horizon's `program`. `union` has those of the static variables.
        """
        if program.mesh is None:
            return
        conditions = [c.name for c in program.compiled.declared.conditions]
        rows = program.constraints(z[places])[program.first_condition_row :]
        for name, off in zip(conditions, rows, strict=False):
            if name in self._links:
                z[union.statics[name]] += off

    def _refuse_unsolvable(self, union: Union, bounds: Bounds, z: FloatArray) -> None:
        """Raise an error if the program is not finite at `z`, or has contradictory equations."""
        held = set()
        for k, program in enumerate(union.programs):
            refuse_not_finite(program, z[union.places[k]])
            own = union.part(bounds, k)
            fixed = np.flatnonzero(own.lower == own.upper)
            held |= {str(unknown_place(program, int(column)).name) for column in fixed}
        refuse_overdetermined(CoupledProgram(union, union.programs), bounds, z, held)

    def load(self, solution: JointSolution) -> None:
        """Load a solution's values into the variables of the Pyomo model.

        Variables over time receive values at the members of the continuous sets. The imported
        suffixes `dual`, `rc` and `costate`, if declared, receive duals, reduced costs and costates.

        Parameters
        ----------
        solution : JointSolution

        Raises
        ------
        TranscriptionError
            If the problem of the solution was restored from a pickle, which contains no model.
        """
        load_values(*solution.horizons.values(), solution.coupling)


def compiled_of(model: Any, final_time: Any = None, times: FreeTimes | None = None) -> Any:
    """Compile a model to a `Problem` or, with several continuous sets, to a `JointProblem`.

    `final_time` is the variable that becomes the end of the only horizon, as in `Problem`. `times`
    are the physical times that the solve determines, in the form that the returned class requires.

    Raises
    ------
    TranscriptionError
        If the declarations are unsupported, or `final_time` is given for several continuous sets.
    """
    names = [time.name for time in continuous_sets(model)]
    if len(names) < 2:
        return Problem(model, final_time, times)
    if final_time is not None:
        raise TranscriptionError(
            f"final_time: the model has several horizons, {', '.join(names)}; give "
            f'times={{"{names[0]}": {{declared time: {final_time}}}}}.'
        )
    return JointProblem(model, times)
