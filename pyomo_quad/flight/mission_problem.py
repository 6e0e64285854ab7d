"""Compiled optimal control problem of a mission, and its solution by continuation.

Without regeneration, a rotor that brakes returns no energy: a negative power counts as zero. This
kink of the power makes the problem hard to solve. The model smooths the kink over the width
`power.smoothing` [W], a parameter. Continuation solves easier problems with larger widths first.
Each solution is the initial point of the next solve.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from math import nan
from typing import TYPE_CHECKING, Any

from pyomo_quad.collocation import (
    Allowance,
    Mesh,
    RefinementOptions,
    SolveError,
    SolverOptions,
    Status,
)
from pyomo_quad.flight.flight import HELD_BREACH
from pyomo_quad.flight.plan import PlanStatus, trajectories_of
from pyomo_quad.flight.routes import journeys_of, with_plain_passages
from pyomo_quad.flight.steady import SteadyFlight
from pyomo_quad.flight.stricter_limits import within_limits
from pyomo_quad.flight.verdict import energy_of, horizon_of, plan_of, verified
from pyomo_quad.model.power import wider_smoothings
from pyomo_quad.scenario.accuracy import FIGURES, USABLE, Accuracy

if TYPE_CHECKING:
    from collections.abc import Iterator

    from pyomo_quad.collocation import Solution, Trajectory
    from pyomo_quad.flight.plan import Plan
    from pyomo_quad.flight.problems import Problems
    from pyomo_quad.flight.routes import Journey
    from pyomo_quad.flight.search import Search
    from pyomo_quad.scenario import Scenario

# Tolerance and number of meshes of the first solve, whose power is rounded most widely at zero.
_ROUGHLY = {"tolerance": 1e-2, "refinement": RefinementOptions(max_meshes=5)}
# Number of times that the continuation is repeated from the widest rounding, on the refined mesh on
# which it failed.
_MOST_RETURNS = 6
# Error estimate of a mesh relative to the tolerances on the simulated flight.
_ESTIMATED = 0.5
# Error of states relative to the tolerance, and violation of a limit between points relative to the
# tolerance on it, up to which feedback and stricter limits make a solution flyable
# (measured: docs/decisions/speed.md).
_FOLLOWED, _CUT = 20.0, 20.0
# Error estimate of a first mesh above which its solution is not flown: the flight would fail.
_COARSE = 0.1


class MissionProblem:
    """Solver of one mission, which uses its compiled optimal control problem.

    Parameters
    ----------
    problems : Problems
        Compiler of scenarios.
    told : Scenario
        The mission in the wind that the optimiser assumes (the forecast).
    search : Search, optional
        Progress callback, which stores usable plans.

    Attributes
    ----------
    timings : mapping
        Time spent on "build" and "compile" [s].
    easier : tuple of mapping
        Parameter values for continuation, the easiest first; empty with regeneration.
    """

    def __init__(self, problems: Problems, told: Scenario, search: Search | None = None) -> None:
        self.problems, self.told, self.search = problems, told, search
        self.problem, self.timings = problems.problem_for(told)
        held = {p.name for p in self.problem.compiled.declared.parameters}
        self.easier = tuple(n for n in wider_smoothings(told) if n.keys() <= held)

    @property
    def has_routes(self) -> bool:
        """Whether there may be several routes, past keep-out zones or through a wind field.

        The mission is then solved along several routes. For a user's own model this is False.
        """
        return self.problems.has_routes(self.told)

    @cached_property
    def arguments(self) -> dict[str, Any]:
        """Keyword arguments with which `Problem.solve` solves the mission.

        They are parameter values, first mesh, tolerances, options of Ipopt and of the mesh
        refinement, and the progress callback.
        """
        told, settings = self.told, self.told.solver
        options = SolverOptions(max_iterations=settings.max_iterations)
        is_crowded = bool(told.mission.waypoints or told.airspace.keep_out)
        limits_move = told.mission.is_free or is_crowded
        if is_crowded and not told.mission.is_free:
            options = options.from_afar()
        return {
            "mesh": Mesh.uniform(settings.elements, settings.degree),
            "tolerance": settings.tolerance,
            "parameters": self.problems.parameters(told),
            "horizon": horizon_of(told),
            "options": options.for_moving_limits() if limits_move else options,
            "refinement": RefinementOptions(
                first_elements=settings.elements,
                first_degree=settings.degree,
                max_meshes=settings.max_refinements + 1,
                allowance=self.allowance,
                limits_move=limits_move,
                on_mesh=None if self.search is None else self.keep_usable,
            ),
            "progress": self.search,
        }

    @property
    def allowance(self) -> Allowance:
        """Tolerances of the mesh refinement on errors between the collocation points.

        Such errors are violations of limits and errors of the states. The tolerances are tight if
        the requested accuracy is `proof`, or if the model is a user's own.
        """
        figures = FIGURES[self.told.solver.accuracy]
        # With wide tolerances, a coarse mesh suffices. `flight.tracking` then corrects the controls
        # by feedback before the simulation, and `flight.stricter_limits` tightens the limits that
        # the simulated flight breaks.
        if self.told.solver.accuracy is not Accuracy.PROOF and self.problems.is_declared:
            return Allowance(
                control_breach=HELD_BREACH,
                limit_breach=_CUT * figures.breach,
                state_error=_FOLLOWED * self.told.solver.tolerance,
            )
        return Allowance(
            control_breach=HELD_BREACH,
            limit_breach=_ESTIMATED * figures.breach,
            final_miss=_ESTIMATED * figures.miss,
        )

    def stricter_refinement(self, share: float) -> RefinementOptions:
        """Return the options of the mesh refinement with two of its tolerances reduced.

        The tolerances on errors of the states and on violations of limits are multiplied by
        `share`. If the options have no tolerance on the states, they are returned unchanged.
        """
        refinement: RefinementOptions = self.arguments["refinement"]
        allowed = refinement.allowance
        if allowed.state_error is None:
            return refinement
        stricter = replace(
            allowed,
            limit_breach=share * allowed.limit_breach,
            state_error=share * allowed.state_error,
        )
        return replace(refinement, allowance=stricter)

    def solve(self, numbers: dict[str, float] | None = None, **chosen: Any) -> Solution:
        """Solve the mission's problem, with refinement of the mesh but without continuation.

        `numbers` maps full names of parameters to values that replace those of the mission. The
        keywords ``chosen`` replace entries of the property `arguments`, the default arguments of
        the solve. The result may not have converged.
        """
        arguments = self.arguments | chosen
        if numbers:
            arguments["parameters"] = (arguments["parameters"] or {}) | numbers
            # A solution for other parameter values makes no usable plan of this mission.
            arguments["refinement"] = replace(arguments["refinement"], on_mesh=None)
        return self.problem.solve(**arguments)

    def solve_roughly(self, **chosen: Any) -> Solution:
        """Solve the mission on one mesh, with the first parameter values of `easier`, if any.

        The keywords ``chosen`` replace entries of the property `arguments`, the default arguments
        of the solve.
        """
        return self.solve(next(iter(self.easier), None), **{"tolerance": None} | chosen)

    def solve_from(self, guess: Any = None, mesh: Mesh | None = None) -> Solution:
        """Solve the mission from an initial guess, by continuation from easier problems.

        The last solve has the mission's own parameter values, and refines the mesh. If it fails on
        a refined mesh, the continuation is repeated on that mesh. The defaults are the model's
        guess and the scenario's mesh.
        """
        solution, easiest = self._by_way_of(self.easier, guess, mesh or self.arguments["mesh"])
        for _ in range(_MOST_RETURNS):
            if easiest is None or not solution.status.has_failed or solution.mesh == easiest.mesh:
                break
            # The solve of the mission may fail on a refined mesh. The continuation is then repeated
            # on that mesh, from a solution of the easiest problem.
            again = self.solve_roughly(mesh=solution.mesh, guess=easiest.trajectory)
            if not again.status.is_solved:
                break
            easiest = again
            solution, _ = self._by_way_of(self.easier[1:], None, solution.mesh, again)
        return solution

    def _by_way_of(
        self,
        easier: tuple[dict[str, float], ...],
        guess: Any,
        mesh: Mesh,
        reached: Solution | None = None,
    ) -> tuple[Solution, Solution | None]:
        """Solve the mission by continuation: with easier parameter values first, then with its own.

        The results are the last solution, and the first converged one with easier values or None. A
        given `reached` counts as the latter, and replaces `guess` and `mesh`.
        """
        first = reached
        for numbers in easier:
            if reached is None:
                tried = self.solve(numbers, **_ROUGHLY, mesh=mesh, guess=guess)
            else:
                tried = self.solve(numbers, tolerance=None, mesh=reached.mesh, warm_start=reached)
            if tried.status is Status.INTERRUPTED:
                return self._as_far_as(tried), first
            if tried.status.is_solved:
                reached = tried
                first = first or reached
        if reached is None:
            return self.solve(mesh=mesh, guess=guess), None
        return self.solve(mesh=reached.mesh, warm_start=reached), first

    def _as_far_as(self, stopped: Solution) -> Solution:
        """Return the last iterate of an interrupted solve, evaluated with the mission's parameters.

        `stopped` is the result of the interrupted solve, which had easier parameter values.
        """
        read = self.unsolved(mesh=stopped.mesh, warm_start=stopped)
        return replace(read, status=stopped.status, message=stopped.message)

    def unsolved(self, **chosen: Any) -> Solution:
        """Return the initial point of a solve as a solution that is not converged.

        It stands for a mission that is not solved, or whose solve is interrupted. The keywords
        ``chosen`` replace entries of the property `arguments`, the default arguments of the solve.
        """
        options = SolverOptions(max_iterations=0)
        return self.solve(**{"tolerance": None, "options": options, "progress": None} | chosen)

    @staticmethod
    def in_own_variables(other: Solution, own: Solution) -> Trajectory:
        """Convert a solution of another problem to the variables of the mission's problem.

        Variables that `other` lacks come from ``own``, any solution of the mission's problem. So do
        static variables (constant in time), if the problems have different ones. The mesh is that
        of `other`.
        """
        mine, held = own.problem.compiled.declared, other.problem.compiled.declared
        path, found, mesh = own.trajectory, other.trajectory, other.mesh
        states = path.states_at(mesh.node_fractions)
        algebraics = path.algebraics_at(mesh.point_fractions)
        for values, slots, given, known in (
            (states, mine.states, found.states, held.states),
            (algebraics, mine.algebraics, found.algebraics, held.algebraics),
        ):
            columns = {slot.name: k for k, slot in enumerate(known)}
            for k, slot in enumerate(slots):
                # A minimum-time problem, for example, lacks the battery's charge.
                if slot.name in columns:
                    values[:, k] = given[:, columns[slot.name]]
        is_same = [slot.name for slot in mine.statics] == [slot.name for slot in held.statics]
        statics = found.statics if is_same else path.statics
        return replace(path, mesh=mesh, states=states, algebraics=algebraics, statics=statics)

    @cached_property
    def past_waypoints(self) -> MissionProblem | None:
        """Problem of a mission that is easier to solve, exactly through waypoints at any speed.

        It lacks the inequalities on distance and speed at waypoints, which make a first solve
        difficult. None if no waypoint has a radius or a speed limit.
        """
        plain = with_plain_passages(self.told)
        return None if plain is None else MissionProblem(self.problems, plain, self.search)

    @cached_property
    def journeys(self) -> tuple[Journey, ...]:
        """Journeys of the mission round keep-out zones, the shortest first.

        A journey is a sequence of routes, one for each leg from one waypoint to the next.

        Raises
        ------
        NoRouteError
            If zones block every route of a leg.
        """
        return journeys_of(self.told)

    @cached_property
    def steady(self) -> SteadyFlight:
        """Calculator of steady flight (hover, cruise) of the vehicle in the wind of the mission."""
        flown = {name: self.arguments[name] for name in ("parameters", "horizon")}
        return SteadyFlight(self.told, self.problem.dynamics(**flown).without_iterations())

    def hover_energy(self, solution: Solution) -> float:
        """Return the energy of hovering in still air for the duration of a solution [J].

        The result is NaN if the vehicle cannot hover.
        """
        held = trajectories_of(solution)
        known = dict(zip(held.state_names, held.states[0].tolist(), strict=True))
        try:
            power = self.problems.steady_flight(self.told, known).hover_power
        except SolveError:
            return nan
        start, end = held.horizon
        return power * (end - start)

    def go_on(self, flown: Solution, **changed: Any) -> Solution:
        """Continue the mesh refinement from a converged solution, without a new solve on its mesh.

        The keywords ``changed`` replace attributes of the mission's `RefinementOptions`. The result
        may not have converged.
        """
        refinement = replace(self.arguments["refinement"], known=flown, **changed)
        return self.solve(mesh=flown.mesh, warm_start=flown, refinement=refinement)

    def keep_usable(self, finished: Solution) -> None:
        """Try to make a usable plan from `finished`, the solution on one mesh of the refinement.

        A plan is usable if simulation confirms it at lower accuracy than requested. The best one is
        stored in `search`, and is the result if the search is stopped.
        """
        search = self.search
        if search is None:
            return

        def fly(solution: Solution, least_energy: float | None = None) -> Plan:
            timings = {"build": 0.0, "compile": 0.0, "solve": search.spent_s}
            plan = plan_of(self.told, solution, timings, self.hover_energy(solution))
            found = verified(plan, solution, Accuracy.QUICK, least_energy, is_rough=True)
            return replace(found, status=PlanStatus.SOLVED)

        def flown() -> Iterator[Plan]:
            plan = fly(finished)
            yield plan
            yield from within_limits(self, finished, plan, USABLE, fly)

        is_coarse = len(finished.history) == 1 and finished.error_estimate > _COARSE
        # The final plan is simulated next.
        is_last = finished.error_estimate <= self.arguments["tolerance"]
        is_patient = self.told.solver.accuracy is Accuracy.PROOF
        search.finished(
            energy_of(self.told, finished),
            flown,
            points=finished.mesh.points,
            is_skipped=is_coarse or is_last or (is_patient and search.is_early),
        )
