"""Optimal control problem on one horizon, compiled once and solved repeatedly with new data."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from itertools import pairwise
from math import inf
from typing import TYPE_CHECKING, Any

import numpy as np

from pyomo_quad.collocation.dynamics import Dynamics
from pyomo_quad.collocation.errors import TranscriptionError
from pyomo_quad.collocation.first_solve import FirstSolveOfOne
from pyomo_quad.collocation.formulation import Formulation, structural_index
from pyomo_quad.collocation.guess import first_point, initial_point
from pyomo_quad.collocation.mesh import Mesh, Summarised
from pyomo_quad.collocation.program.bernstein import bounded
from pyomo_quad.collocation.program.bounds import (
    bounds_of,
    refuse_unsolvable,
    scaling_of,
    without_settled_rows,
)
from pyomo_quad.collocation.program.elastic import elastic_point
from pyomo_quad.collocation.program.far_rows import run_without_far_rows
from pyomo_quad.collocation.program.ipopt import (
    Status,
    barrier_gap,
    run,
    run_past_the_barrier,
)
from pyomo_quad.collocation.refining.refinement import refine
from pyomo_quad.collocation.solution import Solution, solution_from
from pyomo_quad.collocation.solving import carried_out
from pyomo_quad.collocation.starts import AT_THE_MODEL, Start, transfer
from pyomo_quad.collocation.strategies import Scope, first_success
from pyomo_quad.collocation.suffixes import load_suffixes
from pyomo_quad.collocation.verdicts import verdict_on

if TYPE_CHECKING:
    from collections.abc import Callable

    from pyomo_quad.collocation.guess import Guess
    from pyomo_quad.collocation.mesh import FloatArray, Trajectory
    from pyomo_quad.collocation.program.ipopt import Progress, SolverOptions
    from pyomo_quad.collocation.program.nonlinear import Bounds
    from pyomo_quad.collocation.program.transcription import Transcription
    from pyomo_quad.collocation.reading.values import Instance, Overrides
    from pyomo_quad.collocation.refining.damping import Damping
    from pyomo_quad.collocation.refining.remeshing import RefinementOptions
    from pyomo_quad.collocation.starts import WarmStart

# Runge-Kutta steps between neighbouring nodes of the first mesh, in the simulation that provides an
# initial guess; and the magnitude to which its states are clipped, since it may diverge.
_SUBSTEPS, _LARGEST_STATE = 10, 1e12


class Problem(Summarised, Formulation):
    """Optimal control problem: a Pyomo.DAE model compiled for collocation.

    States without bounds that affect neither the objective nor other equations are output states.
    They are computed after the solution of the nonlinear program.

    A problem can be pickled. The pickle holds the parameter values, bounds and initial values that
    the Pyomo model has at that time. It does not hold the model itself. A restored problem can
    solve and evaluate.

    Parameters
    ----------
    model : ConcreteModel
        Model with one ContinuousSet that is not discretised, or with none.
    final_time : Var, optional
        Static variable of the model (variable without time) that becomes the end of the horizon.
        The end of the continuous set then only serves to declare boundary conditions.
    times : mapping, optional
        Physical times that the solve determines. For example, {1.0: m.T1} makes the static variable
        `m.T1` the physical time of all conditions declared at 1.0 in the continuous set. Declared
        times between two such times are mapped linearly.

    Raises
    ------
    TranscriptionError
        If the declarations are incomplete or unsupported; the message names the component.
    """

    @property
    def summary(self) -> dict[str, str]:
        """Objective, numbers of components, and structural index of the DAE, as text by label.

        Components are states, output states, algebraic variables, static variables, equations over
        time, conditions and parameters. Numbers equal to 0 and an index below 2 are left out.
        """
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
        """Whether the model's objective is to be maximised."""
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
        """Solve on a given mesh, or refine the mesh until the estimated error meets a tolerance.

        Parameters
        ----------
        mesh : Mesh, optional
            Mesh of the solve; only the initial mesh if a `tolerance` is given. Constraints at
            single times, single fixed values and jumps of parameters add element boundaries at
            their times. By default, the initial mesh is that of the warm start, or `first_mesh` of
            `refinement`.
        tolerance : float, optional
            Required relative error of the states; default 1e-6 if no mesh is given.
        parameters : mapping, optional
            New values of mutable parameters, by component or full name. The value of a parameter
            over time is a function of time.
        horizon : (float, float), optional
            Start and end of the horizon, in place of the ends of the continuous set.
        guess : mapping, optional
            Initial values by the name of a variable, such as ``rotors.omega[1]``: a function of
            time, a constant, or an array of samples. The key "time" gives the times of the samples.
            A `Trajectory` and the DataFrame of `Solution.to_frame` are accepted, too. If an end of
            the horizon is a variable, functions take the fraction of the horizon instead of the
            time, and samples are stretched over the whole horizon.
        warm_start : Solution or WarmStart, optional
            Solution of the same model on any mesh; its trajectory and multipliers are the initial
            point.
        options : SolverOptions, optional
            Settings of Ipopt.
        refinement : RefinementOptions, optional
            Settings of the mesh refinement.
        starts : int, default 1
            Number of initial points on the first mesh. One point is the guess or warm start; the
            others are random points between the bounds, drawn with fixed seeds. The best optimum is
            kept. A global optimum is not guaranteed.
        progress : callable, optional
            Called at each iteration of Ipopt with an `Iteration`; returning False stops the solve.

        Returns
        -------
        Solution
            The status shows whether the solve converged; a failed solve raises no exception.

        Raises
        ------
        TranscriptionError
            If an argument is invalid, bounds cross, a value is missing, linear equations contradict
            each other, or an equation is not finite at the guess.
        """
        if starts < 1:
            raise TranscriptionError(f"starts: {starts}; must be at least 1.")
        attempt = partial(
            self._attempt,
            mesh=mesh,
            starts=starts,
            instance=self.instance(parameters, horizon),
        )
        return carried_out(
            attempt,
            Start.of(warm_start, guess),
            tolerance=tolerance,
            has_mesh=mesh is not None,
            options=options,
            refinement=refinement,
            progress=progress,
            is_known=starts == 1,
        )

    def _attempt(
        self,
        start: Start,
        progress: Progress,
        options: SolverOptions,
        tolerance: float | None,
        refinement: RefinementOptions,
        *,
        mesh: Mesh | None,
        starts: int,
        instance: Instance,
    ) -> Solution:
        """Solve from a warm start or guess; refine the mesh if a tolerance is given.

        `mesh` is the first mesh, by default that of the warm start or `refinement`. If `starts` is
        above 1, that many initial points are tried. The best optimum replaces `start.warm`.
        """
        if self.has_horizon and tolerance is not None:
            options = options.suiting(tolerance)
        first = mesh
        if mesh is None and self.has_horizon:
            first = refinement.first_mesh if start.warm is None else start.warm.mesh
        solve_on = partial(
            self.solve_on_mesh,
            instance=instance,
            options=options,
            progress=progress,
            breach=refinement.breach_between_points,
        )
        if starts > 1:
            best = self._best_of(starts, partial(solve_on, first), start)
            start = start if best is None else replace(start, warm=best.warm_start)
        is_open = start.warm is None and tolerance is not None
        simulate = None
        # A simulation is the initial point only if the caller gave a tolerance, but neither a guess
        # nor a warm start.
        if is_open and start.guess is None and first is not None:
            simulate = partial(self._simulated, first, instance)

        def all_bounds(program: Transcription) -> Bounds:
            return bounds_of(program, self.data_at_starts(instance), instance.fixed)

        def finish(own: Callable[..., Solution], mesh: Mesh | None, start: Start) -> Solution:
            if mesh is None or tolerance is None:
                return own(mesh, start, is_gap_reduced=True)
            return _refined(own, mesh, start, tolerance, refinement)

        cut = first and first.with_breakpoints(self.required_breakpoints(instance))
        search = FirstSolveOfOne(
            solve=solve_on,
            finish=finish,
            judge=partial(verdict_on, options=options, progress=progress),
            mesh=first,
            start=start,
            options=options,
            bounds_of=all_bounds,
            simulate=simulate,
            instance=instance,
            progress=progress,
            is_overdetermined=all_bounds(self.program(cut, instance)).surplus > 0,
            is_mesh_free=mesh is None and is_open,
        )
        return first_success(Scope.FIRST, search)

    def _simulated(self, mesh: Mesh, instance: Instance) -> Trajectory | None:
        """Return a simulation of the model from its initial states as a guess, or None.

        The result is None if the simulation fails. It is also None if the model has controls,
        output states, or states with a free initial value. `instance` has parameter values.
        """
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
    def _best_of(starts: int, solve: Callable[..., Solution], first: Start) -> Solution | None:
        """Solve from the given start and from `starts` - 1 random points; return the best optimum.

        The result is None if no solve converged.
        """
        found = []
        for seed in range(starts):
            try:
                solution = solve(replace(first.cold, seed=seed) if seed else first)
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
        start: Start = AT_THE_MODEL,
        damping: Damping | None = None,
        *,
        instance: Instance,
        options: SolverOptions,
        is_scaled: bool = True,
        is_gap_reduced: bool = False,
        change: float | None = None,
        iteration_limit: float = inf,
        breach: float = inf,
        progress: Progress | None = None,
    ) -> Solution:
        """Solve the nonlinear program of one mesh once, without refinement.

        Parameters
        ----------
        mesh : Mesh or None
            None for a model without time. Constraints at single times, single fixed values and
            jumps of parameters add element boundaries at their times.
        start : Start, optional
            Initial point: a guess or a warm start; by default the values that the variables of the
            Pyomo model have.
        damping : Damping, optional
            Penalty on the distance of the controls from the controls of the previous mesh.
        instance : Instance
            Parameter values and horizon of this solve.
        options : SolverOptions
            Settings of Ipopt.
        is_scaled : bool, default True
            Whether Ipopt solves the scaled program; if False, Ipopt solves the unscaled program.
        is_gap_reduced : bool, default False
            Whether to continue until the complementarity gap (the sum of multipliers times slacks)
            is negligible relative to the objective.
        change : float, optional
            Expected change of the objective from its value at the warm start, in the objective's
            unit. It determines the initial barrier parameter. It is ignored if there is no warm
            start, or if `damping` penalises any controls.
        iteration_limit : float, optional
            Limit of Ipopt's iterations; the limit in `options` holds too.
        breach : float, optional
            Allowed violation of the variables' bounds between the collocation points, relative to
            max(1, abs(bound)). In elements where a warm start is near a bound, additional
            constraints impose this limit. Infinite by default: no such constraints.
        progress : callable, optional
            Called at each iteration; returning False stops the solve.

        Returns
        -------
        Solution

        Raises
        ------
        TranscriptionError
            If bounds cross, a value is missing, linear equations contradict each other, or an
            equation is not finite at the initial point.
        """
        if mesh is not None:
            mesh = mesh.with_breakpoints(self.required_breakpoints(instance))
        program = self.program(mesh, instance)
        at_start = self.data_at_starts(instance)
        bounds = bounds_of(program, at_start, instance.fixed, instance.left_out)
        multipliers, within = None, None
        if start.warm is None:
            z = first_point(program, bounds, self.values, start.guess, start.seed)
        else:
            z, multipliers = transfer(start.warm, program)
            within = bounded(program, bounds, z, breach) if np.isfinite(breach) else None
            z = np.clip(z, bounds.lower, bounds.upper)
        bounds = without_settled_rows(program, bounds, z)
        refuse_unsolvable(program, bounds, z)
        scaling = scaling_of(program, bounds, z)
        options = options.at_most(iteration_limit)
        if self.compiled.declared.clock.phases:
            options = options.for_phases()
        if start.is_elastic:
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
            # A small initial barrier parameter is not used with damping: controls on which the
            # objective hardly depends are determined again only from a larger parameter.
            options = options.for_a_change(change * scaling.objective, kept.sides)
        if damping is not None and damping.gap and start.warm is not None:
            parameter = damping.gap * scaling.objective / kept.sides
            options = options.on_central_path(parameter, damping.start_distance)
        solve = (
            partial(run_past_the_barrier, size=program.objective_size) if is_gap_reduced else run
        )
        settings: dict[str, Any] = {"options": options, "progress": progress}
        if multipliers is None:
            result = solve(changed, kept, scales, z, **settings)
        else:
            result = run_without_far_rows(
                solve, changed, kept, scales, z, multipliers=multipliers, **settings
            )
        own = result.part(slice(None), slice(program.n_rows))
        found = solution_from(self, program, instance, own, bounds=bounds, scaling=scaling)
        if within is None:
            return found
        gap = barrier_gap(changed, kept, result.z, result.multipliers)
        return replace(found, restraint=within.restraint(result, gap, found.mesh.elements))

    def dynamics(
        self,
        *,
        parameters: Overrides | None = None,
        horizon: tuple[float, float] | None = None,
        statics: FloatArray | None = None,
    ) -> Dynamics:
        """Return the explicit right-hand side dx/dt = f(t, x, u) of the model for a simulation.

        Parameters
        ----------
        parameters : mapping, optional
            New values of mutable parameters, by component or full name. The value of a parameter
            over time is a function of time.
        horizon : (float, float), optional
            Start and end of the horizon, in place of the ends of the continuous set.
        statics : ndarray, shape (n_statics,), optional
            Values of the static variables (variables without time); by default their values in the
            model, NaN where a variable has none.

        Returns
        -------
        Dynamics

        Raises
        ------
        TranscriptionError
            If an argument is invalid, or if the number of equations over time differs from the
            number of states and algebraic variables that are not controls.
        """
        declared = self.compiled.declared
        if statics is None:
            held = [self.values.static_value(s) for s in declared.statics]
            statics = np.array([np.nan if v is None else v for v in held])
        return Dynamics(self, self.instance(parameters, horizon), statics)

    def load(self, solution: Solution) -> None:
        """Load a solution's values into the variables of the Pyomo model.

        Variables over time receive values at the members of the continuous set. The imported
        suffixes `dual`, `rc` and `costate`, if declared, receive duals, reduced costs and costates.

        Parameters
        ----------
        solution : Solution

        Raises
        ------
        TranscriptionError
            If the problem of the solution was restored from a pickle, which contains no model.
        """
        load_values(solution)


def _refined(
    own: Callable[..., Solution],
    mesh: Mesh,
    start: Start,
    tolerance: float,
    refinement: RefinementOptions,
) -> Solution:
    """Solve with mesh refinement on one horizon.

    `own` solves on one mesh, with the arguments of `Problem.solve_on_mesh`.
    """

    def on_meshes(
        meshes: tuple[Mesh, ...],
        start: Start,
        dampings: tuple[Damping | None, ...],
        change: float | None = None,
        iteration_limit: float = inf,
    ) -> Solution:
        return own(meshes[0], start, dampings[0], change=change, iteration_limit=iteration_limit)

    def sharpen(dampings: tuple[Damping | None, ...], found: Solution) -> Solution:
        change = 0.0 if dampings[0] and dampings[0].gap else None
        at_found = replace(start, warm=found.warm_start)
        return own(found.mesh, at_found, dampings[0], is_gap_reduced=True, change=change)

    # `refine` accepts several horizons; tuples of one mesh stand for one horizon.
    return refine(
        on_meshes,
        meshes=(mesh,),
        tolerance=tolerance,
        refinement=refinement,
        start=start,
        past_the_barrier=sharpen,
    )


def march(
    rates: Callable[[float, FloatArray, FloatArray], FloatArray],
    times: FloatArray,
    start: FloatArray,
) -> FloatArray:
    """Integrate an ODE by the classical Runge-Kutta method, to compute an initial guess.

    Ten equal steps are taken between neighbouring `times`. `rates` is called as rates(t, x, u) with
    an empty control vector. If the integration diverges, some states are infinite or NaN.
    """
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


def load_values(*solutions: Solution) -> None:
    """Load the values of solutions into the Pyomo model to which they belong.

    With several horizons, there is one solution per horizon, and one for variables of no horizon.
    Variables and derivatives over time are loaded at declared times, the members of the continuous
    set. Integrals and suffixes are loaded, too.
    """
    for solution in solutions:
        declared, values = solution.problem.compiled.declared, solution.problem.values
        for slot, number in zip(declared.statics, solution.trajectory.statics, strict=True):
            values.load(slot, None, float(number))
        for fraction in values.declared_fractions():
            time = float(solution.timeline.time(np.float64(fraction)))
            _, *row = solution.to_frame([time]).iloc[0]
            for slot, number in zip(declared.varying, row, strict=True):
                values.load(slot, fraction, float(number))
            values.load_rates(fraction, partial(solution.value, t=time))
        totals = solution.program.integrals(solution.unknowns).tolist()
        names = [integral.name for integral in declared.integrals]
        values.load_integrals(dict(zip(names, totals, strict=True)))
    load_suffixes(*solutions)
