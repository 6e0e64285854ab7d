"""A compiled problem, solved as often as wanted without being built again."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from itertools import pairwise
from math import inf
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from pyomo_quad.collocation.attempts import FirstSolve
from pyomo_quad.collocation.dynamics import Dynamics
from pyomo_quad.collocation.errors import TranscriptionError
from pyomo_quad.collocation.formulation import Formulation, structural_index
from pyomo_quad.collocation.guess import (
    ColdStart,
    Guess,
    WarmStart,
    initial_point,
    on_path_equalities,
    scattered,
    transfer,
    with_consistent_algebraics,
)
from pyomo_quad.collocation.mesh import Mesh, Summarised
from pyomo_quad.collocation.program.bernstein import bounded
from pyomo_quad.collocation.program.bounds import (
    bounds_of,
    is_defined,
    refuse_unsolvable,
    scaling_of,
    without_settled_rows,
)
from pyomo_quad.collocation.program.elastic import elastic_point
from pyomo_quad.collocation.program.feasible import feasible_point
from pyomo_quad.collocation.program.ipopt import (
    TIME_LIMIT_CODE,
    Counter,
    Progress,
    SolverOptions,
    Status,
    WallClockLimit,
    barrier_gap,
    run,
    run_past_the_barrier,
)
from pyomo_quad.collocation.refining.refinement import Solved, refine
from pyomo_quad.collocation.refining.remeshing import RefinementOptions
from pyomo_quad.collocation.solution import (
    Solution,
    diverging_multipliers,
    hamiltonian_warnings,
    load_suffixes,
    outside_tables,
    solution_from,
)

if TYPE_CHECKING:
    from collections.abc import Callable

    from pyomo_quad.collocation.mesh import FloatArray, Trajectory
    from pyomo_quad.collocation.program.nonlinear import Bounds
    from pyomo_quad.collocation.program.transcription import Transcription
    from pyomo_quad.collocation.reading.values import Instance, Overrides
    from pyomo_quad.collocation.refining.refinement import Damping

# Steps between the nodes of a first mesh, and a state above which a simulation has diverged.
_SUBSTEPS, _LARGEST_STATE = 10, 1e12
#: Default of the required relative error.
DEFAULT_TOLERANCE = 1e-6


class Problem(Summarised, Formulation):
    """A Pyomo.DAE model compiled for collocation.

    It can be pickled.  The restored problem solves and evaluates as before, with the numbers that
    the model held when it was pickled; the model itself is not included.

    Parameters
    ----------
    model : ConcreteModel
        With one ContinuousSet that is not discretised, or none.
    final_time : Var, optional
        Static variable of the model that becomes the end of the horizon; the end of the continuous
        set then only defines where boundary conditions are declared.
    times : mapping, optional
        Declared time -> static variable that replaces it, as in {1.0: m.T1}; other declared times
        keep their fraction of the phase in which they lie.

    Raises
    ------
    TranscriptionError
        If the declarations are incomplete or unsupported; the message names the component.
    """

    @property
    def summary(self) -> dict[str, str]:
        """Number of components of each kind in the model."""
        declared = self.compiled.declared
        counts = {
            "states": declared.states,
            "outputs": declared.outputs,
            "algebraic variables": declared.algebraics,
            "static variables": declared.statics,
            "equations over time": declared.equations,
            "conditions": declared.conditions,
            "parameters": declared.parameters,
        }
        sense = "maximise" if declared.maximise else "minimise"
        name = declared.objective_name
        goal = {"objective": f"{sense} {name}" if name else "none"}
        sizes = {name: f"{len(held)}" for name, held in counts.items() if held}
        index = structural_index(declared).index
        return goal | sizes | ({"index of the DAE": f"{index}"} if index > 1 else {})

    @property
    def is_maximised(self) -> bool:
        """Whether the objective is maximised."""
        return self.compiled.declared.maximise

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
        starts: int = 1,
        progress: Progress | None = None,
    ) -> Solution:
        """Solve on a given mesh, or refine the mesh until the error meets a tolerance.

        Parameters
        ----------
        mesh : Mesh, optional
            Used unchanged if no `tolerance` is given; otherwise the initial mesh.
        tolerance : float, optional
            Required relative error of the states; default 1e-6 if no mesh is given.
        parameters : mapping, optional
            New values of mutable parameters, by component or full name; a function of time
            for a parameter over time.
        horizon : (float, float), optional
            Start and end of the horizon, in place of the continuous set's.
        guess : mapping, optional
            Initial values by slot name: functions of time, constants, or samples beside "time", for
            example a frame of `Solution.to_frame`.
        warm_start : Solution or WarmStart, optional
            On any mesh; its trajectory and multipliers are the initial point.
        options : SolverOptions, optional
        refinement : RefinementOptions, optional
        starts : int, default 1
            Number of initial points on the first mesh, all but one random between the bounds; the
            best optimum is kept. This does not guarantee a global optimum.
        progress : callable, optional
            Called at each iteration; returning False stops the solve.

        Returns
        -------
        Solution
            The result with its status; a failure of the numerics is a result, not an exception.

        Raises
        ------
        TranscriptionError
            If bounds cross, a value is missing, or an equation is not finite at the guess.
        """
        if starts < 1:
            raise TranscriptionError(f"starts: {starts}; must be at least 1.")
        instance = self.instance(parameters, horizon)
        start = warm_start.warm_start if isinstance(warm_start, Solution) else warm_start
        finished: list[Solution] = []
        chosen = keeping(finished, refinement or RefinementOptions())

        def solved(
            options: SolverOptions, progress: Progress | None, tolerance: float | None
        ) -> Solution:
            if self.has_horizon and tolerance is not None:
                options = options.suiting(tolerance)
            attempt = partial(
                self._attempt,
                options=options,
                mesh=mesh,
                guess=guess,
                starts=starts,
                tolerance=tolerance,
                refinement=chosen,
                instance=instance,
            )
            known = start.cold_start if start is not None and starts == 1 else None
            return within_budget(attempt, start, known, tolerance, progress)

        return limited(
            solved,
            options=options,
            progress=progress,
            tolerance=tolerance,
            has_mesh=mesh is not None,
            finished=finished,
        )

    def _attempt(
        self,
        start: WarmStart | None,
        progress: Progress,
        *,
        options: SolverOptions,
        mesh: Mesh | None,
        guess: Guess | None,
        starts: int,
        tolerance: float | None,
        refinement: RefinementOptions,
        instance: Instance,
    ) -> Solution:
        """Solve from a warm start or a cold one; see `solve`."""
        first = mesh
        if mesh is None and self.has_horizon:
            first = refinement.first_mesh if start is None else start.mesh
        breach = refinement.breach_between_points
        solve_on = partial(
            self.solve_on_mesh,
            instance=instance,
            options=options,
            guess=guess,
            progress=progress,
            breach=breach,
        )
        best = self._best_of(starts, partial(solve_on, first), start) if starts > 1 else None
        begun = start if best is None else best.warm_start
        simulate = None
        if begun is None and guess is None and first is not None and tolerance is not None:
            simulate = partial(self._simulated, first, instance)

        def all_bounds(program: Transcription) -> Bounds:
            return bounds_of(program, self.data_at_starts(instance), instance.fixed)

        cut = first and first.with_breakpoints(self.required_breakpoints(instance))

        def finish(
            own: Callable[..., Solution], mesh: Mesh | None, start: WarmStart | None
        ) -> Solution:
            if mesh is None or tolerance is None:
                return own(mesh, start, to_the_gap=True)
            return _refined(own, mesh, start, tolerance, refinement)

        return FirstSolve(
            solve_on=solve_on,
            finish=finish,
            bounds_of=all_bounds,
            is_overdetermined=all_bounds(self.program(cut, instance)).surplus > 0,
            simulate=simulate,
            mesh=first,
            warm_start=begun,
            instance=instance,
            options=options,
            progress=progress,
            is_mesh_free=mesh is None and begun is None and tolerance is not None,
        )()

    def _simulated(self, mesh: Mesh, instance: Instance) -> Trajectory | None:
        """Return the trajectory simulated from the first states, None if any variable is free."""
        mesh = mesh.with_breakpoints(self.required_breakpoints(instance))
        program, declared = self.program(mesh, instance), self.compiled.declared
        bounds = bounds_of(program, self.data_at_starts(instance), instance.fixed)
        start = program.layout.state_columns[0]
        guessed = program.trajectory(initial_point(program, bounds, self.values, None))
        try:
            dynamics = Dynamics(self, instance, guessed.statics)
        except TranscriptionError:
            return None
        is_open = bool(np.any(bounds.lower[start] < bounds.upper[start]))
        if is_open or dynamics.controls or declared.outputs:
            return None
        times = np.asarray(dynamics.timeline.time(mesh.node_fractions))
        states = march(dynamics.rates, times, guessed.states[0])
        if not np.all(np.isfinite(states)):
            return None
        none = np.zeros((mesh.points, 0))
        algebraics = [
            dynamics.evaluate(slot.component, times[1:], states[1:], none, index=slot.index)
            for slot in declared.algebraics
        ]
        return replace(
            guessed,
            states=np.clip(states, -_LARGEST_STATE, _LARGEST_STATE),
            algebraics=np.column_stack([none, *algebraics]),
        )

    @staticmethod
    def _best_of(
        starts: int, solve: Callable[..., Solution], first: WarmStart | None
    ) -> Solution | None:
        """Return the best optimum from a first point and random points, None without any."""
        found = []
        for seed in range(starts):
            try:
                solution = solve(first) if seed == 0 else solve(seed=seed)
            except TranscriptionError:
                if seed == 0:
                    raise
                continue  # At a random point an equation may be undefined.
            if solution.status is Status.INTERRUPTED:
                break
            if solution.is_converged:
                found.append(solution)
        return min(found, key=lambda s: s.program.objective(s.unknowns), default=None)

    def solve_on_mesh(
        self,
        mesh: Mesh | None,
        warm_start: WarmStart | None = None,
        damping: Damping | None = None,
        *,
        instance: Instance,
        options: SolverOptions,
        guess: Guess | None = None,
        seed: int = 0,
        is_elastic: bool = False,
        is_scaled: bool = True,
        to_the_gap: bool = False,
        change: float | None = None,
        breach: float = inf,
        progress: Progress | None = None,
    ) -> Solution:
        """Solve once on one mesh; see `solve` and `Damping` for the arguments.

        A `seed` above 0 starts at a random point between the bounds; `is_elastic` starts at the
        optimum of the elastic program; without `is_scaled` Ipopt solves the program as declared. If
        `to_the_gap` is true, the solve continues until the complementarity gap is negligible
        relative to the objective. `change` is the expected change of a warm start's objective,
        where known. A finite `breach` is the bound violation between collocation points that a
        warm start may have.
        """
        if mesh is not None:
            mesh = mesh.with_breakpoints(self.required_breakpoints(instance))
        program = self.program(mesh, instance)
        at_start = self.data_at_starts(instance)
        bounds = bounds_of(program, at_start, instance.fixed, instance.left_out)
        multipliers, within = None, None
        if warm_start is None:
            z = initial_point(program, bounds, self.values, guess)
            z = scattered(program, bounds, z, seed) if seed else z
            z = on_path_equalities(program, bounds, z)
            if not is_defined(program, z):
                z = with_consistent_algebraics(program, bounds, z)
        else:
            z, multipliers = transfer(warm_start, program)
            within = bounded(program, bounds, z, breach) if np.isfinite(breach) else None
            z = np.clip(z, bounds.lower, bounds.upper)
        bounds = without_settled_rows(program, bounds, z)
        refuse_unsolvable(program, bounds, z)
        scaling = scaling_of(program, bounds, z)
        if self.compiled.declared.clock.phases:
            options = options.for_phases()
        if is_elastic:
            z = elastic_point(program, bounds, scaling, z, options=options, progress=progress)
        changed: Any = program if damping is None else damping.applied_to(program)
        kept, scales = bounds, scaling if is_scaled else scaling.none
        if within is not None and multipliers is not None:
            changed = within.added_to(changed)
            kept = bounds.extended(rows=(within.lower, within.upper))
            scales = scales.extended(rows=within.scales(scales))
            multipliers = multipliers.extended(rows=within.lower.size)
        is_damped = damping is not None and damping.controls.size > 0
        if change is not None and multipliers is not None and not is_damped:
            # Controls that next to nothing holds are found again only from a larger barrier.
            options = options.for_a_change(change * scaling.objective / max(kept.sides, 1))
        if damping is not None and damping.gap and warm_start is not None:
            parameter = damping.gap * scaling.objective / kept.sides
            options = options.on_the_path(parameter, is_near=damping.is_still)
        solve = partial(run_past_the_barrier, size=program.objective_size) if to_the_gap else run
        result = solve(
            changed, kept, scales, z, options=options, multipliers=multipliers, progress=progress
        )
        own = result.part(slice(None), slice(program.n_rows))
        found = solution_from(self, program, instance, own, bounds=bounds, scaling=scaling)
        if within is None:
            return found
        gap = barrier_gap(changed, kept, result.z, result.multipliers)
        return replace(found, restraint=within.restraint(result, gap, found.mesh.elements))

    def flyable(
        self,
        near: Solution,
        mesh: Mesh,
        *,
        parameters: Overrides | None = None,
        horizon: tuple[float, float] | None = None,
        breach: float = 0.0,
        met: float = 1e-7,
        progress: Progress | None = None,
    ) -> Solution:
        """Return the first trajectory near a solution that obeys all equations on another mesh.

        No optimum: few iterations from a coarse mesh lead to what can be flown; see
        `program.feasible`.  Bounds may be broken by a relative `breach`, scaled
        equations by `met`.
        """
        instance = self.instance(parameters, horizon)
        program = self.program(mesh.with_breakpoints(self.required_breakpoints(instance)), instance)
        at_start = self.data_at_starts(instance)
        bounds = bounds_of(program, at_start, instance.fixed, instance.left_out)
        z = initial_point(program, bounds, self.values, near.trajectory)
        bounds = without_settled_rows(program, bounds, z)
        scaling = scaling_of(program, bounds, z)
        found = feasible_point(
            program, bounds, scaling, z, breach=breach, met=met, progress=progress
        )
        return solution_from(self, program, instance, found, bounds=bounds, scaling=scaling)

    def dynamics(
        self,
        *,
        parameters: Overrides | None = None,
        horizon: tuple[float, float] | None = None,
        statics: FloatArray | None = None,
    ) -> Dynamics:
        """Return the explicit right-hand side of the model for a simulation.

        Static variables take their values in the model unless given.
        """
        declared = self.compiled.declared
        if statics is None:
            held = [self.values.static_value(s) for s in declared.statics]
            statics = np.array([np.nan if v is None else v for v in held])
        return Dynamics(self, self.instance(parameters, horizon), statics)

    def load(self, solution: Solution) -> None:
        """Load a solution's values into the Pyomo model, at its declared times.

        Duals, reduced costs and costates are loaded into suffixes of these names, if the model has
        them.
        """
        load_values(solution)


def _refined(
    own: Callable[..., Solution],
    mesh: Mesh,
    start: WarmStart | None,
    tolerance: float,
    refinement: RefinementOptions,
) -> Solution:
    """Refine from a mesh, with solves as of `Problem.solve_on_mesh`."""

    def on_meshes(
        meshes: tuple[Mesh, ...],
        start: WarmStart | None,
        dampings: tuple[Damping | None, ...],
        change: float | None = None,
    ) -> Solution:
        return own(meshes[0], start, dampings[0], change=change)

    def sharpen(dampings: tuple[Damping | None, ...], found: Solution) -> Solution:
        change = 0.0 if dampings[0] and dampings[0].gap else None
        return own(found.mesh, found.warm_start, dampings[0], to_the_gap=True, change=change)

    return refine(
        on_meshes,
        meshes=(mesh,),
        tolerance=tolerance,
        refinement=refinement,
        warm_start=start,
        past_the_barrier=sharpen,
    )


def march(
    rates: Callable[[float, FloatArray, FloatArray], FloatArray],
    times: FloatArray,
    start: FloatArray,
) -> FloatArray:
    """Return states at times by the classical Runge-Kutta method, for an initial guess."""
    none, states = np.zeros(0), [start]
    with np.errstate(all="ignore"):
        for first, last in pairwise(times.tolist()):
            x, h = states[-1], (last - first) / _SUBSTEPS
            for k in range(_SUBSTEPS):
                t = first + k * h
                a = rates(t, x, none)
                b = rates(t + h / 2, x + h / 2 * a, none)
                c = rates(t + h / 2, x + h / 2 * b, none)
                d = rates(t + h, x + h * c, none)
                x = x + h / 6 * (a + 2 * b + 2 * c + d)
            states.append(x)
    return np.array(states)


S = TypeVar("S", bound=Solved)
W = TypeVar("W")


def within_budget(
    attempt: Callable[[W | None, Progress], S],
    start: W | None,
    known: ColdStart | None,
    tolerance: float | None,
    progress: Progress | None,
) -> S:
    """Solve from a warm start within the iterations of its cold start, else from a cold start.

    The first solve may take the iterations of the cold start's first mesh, and all solves together
    those of all its meshes, if they are known for the same tolerance; otherwise there is no limit.
    If the new cold start fails, the warm start is continued.
    """
    demand = tolerance or 0.0
    warm = None
    if start is not None:
        if known is None or known.tolerance != demand:
            return attempt(start, Counter(progress=progress))
        counter = Counter(limits=(known.first, known.iterations), progress=progress)
        warm = attempt(start, counter)
        if not counter.is_over:
            return warm.updated(cold_start=known)
        spent = counter.count
    counter = Counter(progress=progress)
    cold = attempt(None, counter)
    took = ColdStart(first=counter.first, iterations=counter.count, tolerance=demand)
    if warm is None:
        return cold.updated(cold_start=took if cold.status.is_solved else None)
    if cold.status.has_failed:
        return attempt(warm.warm_start, Counter(progress=progress))
    message = (
        f"{cold.message} The warm start was given up after {spent} iterations, more than its own "
        f"cold start had taken; a new cold start took {took.iterations}."
    )
    return cold.updated(cold_start=took, message=message)


def keeping(finished: list[S], refinement: RefinementOptions) -> RefinementOptions:
    """Return the refinement's options with a hook that keeps each finished mesh's solution."""

    def kept(solution: S) -> bool | None:
        finished.append(solution)
        return refinement.on_mesh and refinement.on_mesh(solution)

    return replace(refinement, on_mesh=kept)


def limited(
    solve: Callable[[SolverOptions, Progress | None, float | None], S],
    *,
    options: SolverOptions | None,
    progress: Progress | None,
    tolerance: float | None,
    has_mesh: bool,
    finished: list[S],
) -> S:
    """Solve, to a tolerance if one is given, within the time limit and the tables' ranges.

    If a refinement is interrupted or fails, the most accurate finished mesh is returned.
    """
    if tolerance is not None and not tolerance > 0.0:
        raise TranscriptionError(f"tolerance: {tolerance:g}; must be above 0.")
    options = options or SolverOptions()
    deadline = None
    if options.max_wall_s is not None:
        progress = deadline = WallClockLimit(limit_s=options.max_wall_s, progress=progress)
    if tolerance is None and not has_mesh:
        tolerance = DEFAULT_TOLERANCE
    solution = solve(options, progress, tolerance)
    solution = solution if deadline is None else _in_time(solution, deadline)
    solution = _finished_of(finished, solution)
    return _within_tables(_undoubted(_without_objective(solution)))


def load_values(*solutions: Solution) -> None:
    """Load the values of solutions into the Pyomo model, each over its own horizon."""
    for solution in solutions:
        declared, values = solution.problem.compiled.declared, solution.problem.values
        for slot, number in zip(declared.statics, solution.trajectory.statics, strict=True):
            values.load(slot, None, float(number))
        for fraction in values.declared_fractions():
            time = float(solution.timeline.time(np.float64(fraction)))
            slots = (*declared.states, *declared.outputs, *declared.algebraics)
            _, *row = solution.to_frame([time]).iloc[0]
            for slot, number in zip(slots, row, strict=True):
                values.load(slot, fraction, float(number))
            values.load_rates(fraction, partial(solution.value, t=time))
        totals = solution.program.integrals(solution.unknowns).tolist()
        names = [integral.name for integral in declared.integrals]
        values.load_integrals(dict(zip(names, totals, strict=True)))
    load_suffixes(*solutions)


def _without_objective(solution: S) -> S:
    """Return a solution with a message if there is no objective."""
    declared = solution.parts[0].problem.compiled.declared
    if declared.objective_name or solution.status is not Status.CONVERGED:
        return solution
    return solution.updated(
        message="no objective is declared: all equations and limits are met, and nothing is "
        "optimised; declare an active Objective to choose among such solutions."
    )


def _undoubted(solution: S) -> S:
    """Return a solution that is not converged if multipliers and Hamiltonian contradict it."""
    for part in solution.parts if solution.status is Status.CONVERGED else ():
        names, warnings = diverging_multipliers(part), hamiltonian_warnings(part)
        if names and warnings:
            line = (
                f"{', '.join(names)}: multipliers grow without bound, so that nothing vouches for "
                f"the optimum; where a product must vanish, let it be at most a small number. "
                f"{warnings[0]}"
            )
            return solution.updated(status=Status.TOLERANCE_NOT_MET, message=line)
    return solution


def _within_tables(solution: S) -> S:
    """Return a solution with a message if it reads a table beyond its range."""
    line = next(filter(None, map(outside_tables, solution.parts)), "")
    if not line:
        return solution
    if solution.status is not Status.CONVERGED:
        return solution.updated(message=f"{solution.message} {line}")
    return solution.updated(status=Status.NOT_CONVERGED, message=line)


def _finished_of(finished: list[S], ended: S) -> S:
    """Return the most accurate finished mesh's solution in place of an unconverged iterate."""
    whole = [solution for solution in finished if not solution.parts[0].instance.left_out]
    if not whole or ended.status not in (Status.INTERRUPTED, Status.NOT_CONVERGED):
        return ended
    best = min(whole, key=lambda solution: solution.parts[0].error_estimate)
    part, message = best.parts[0], ended.message.rstrip(".; ")
    message = (
        f"{message}; this is the solution of mesh {len(part.history)}, with an estimated error of "
        f"{part.error_estimate:.3g}."
    )
    return best.updated(status=ended.status, message=message, ipopt_code=ended.ipopt_code)


def _in_time(solution: S, deadline: WallClockLimit) -> S:
    """Return a solution with a message if the deadline ended its solve."""
    if not deadline.is_over or solution.status is not Status.INTERRUPTED:
        return solution
    message = (
        f"stopped at the time limit of {deadline.limit_s:g} s, on mesh "
        f"{len(solution.parts[0].history) or 1}; allow more time or a larger tolerance."
    )
    return solution.updated(ipopt_code=TIME_LIMIT_CODE, message=message)
