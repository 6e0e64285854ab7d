"""From a scenario to a plan: build, compile, solve, fly; with retries after a failure."""

from __future__ import annotations

import time
from collections.abc import Callable, Hashable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from math import inf, nan
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pyomo_quad.collocation import (
    Allowance,
    Dynamics,
    Mesh,
    Problem,
    Progress,
    RefinementOptions,
    Solution,
    SolveError,
    SolverOptions,
    Status,
    Trajectory,
    WarmStart,
    compile,
)
from pyomo_quad.flight.deadline import Deadline
from pyomo_quad.flight.flight import HELD_BREACH
from pyomo_quad.flight.plan import Plan, PlanStatus, trajectories_of
from pyomo_quad.flight.recent import Recent
from pyomo_quad.flight.rescue import (
    Effort,
    Rescuer,
    at_its_easiest,
    best_speed,
    by_way_of,
    declared_free_times,
    easier_numbers,
    fine_mesh,
    given_up,
    guess_of,
    is_long,
    rough_mesh,
    shortest_flight,
)
from pyomo_quad.flight.routes import (
    Journey,
    NoRouteError,
    Route,
    TriedRoute,
    best_of_journeys,
    find_journeys,
    guess_along,
    journey_as_flown,
    length_of,
    promising,
    with_plain_passages,
)
from pyomo_quad.flight.search import Search, State
from pyomo_quad.flight.steady import SteadyFlight
from pyomo_quad.flight.tour import cheapest, find_orders
from pyomo_quad.flight.usable import flyable_from
from pyomo_quad.flight.verdict import energy_of, horizon_of, plan_of, verified
from pyomo_quad.flight.verification import (
    BALANCE_TOLERANCE,
    shares_lacking,
)
from pyomo_quad.model import build_model, parameter_values, structure_key
from pyomo_quad.model.battery import GIVEN_SHARE
from pyomo_quad.model.build import guess_key
from pyomo_quad.model.limits import without_reserve
from pyomo_quad.model.wind import still_air
from pyomo_quad.scenario import Scenario
from pyomo_quad.scenario.accuracy import FIGURES, Accuracy
from pyomo_quad.scenario.mission import Aim, Order

Builder = Callable[[Scenario], Any]
FloatArray = NDArray[np.float64]

# How much longer than the least time flights are that come closer and closer to it: the last is
# bang-bang, and hard to prove.  A step closer ends after so many times the effort of the first.
_ABOVE_LEAST = (1e-2, 3e-3, 1e-3, 3e-4)
_MOST_EFFORT = 3.0
# How often, and by how much, the tolerance is tightened for a flight that went astray.
_TIGHTENINGS = 3
_TIGHTER = 0.1
# Fewest elements on which the flights along all routes are compared.
_ROUTE_ELEMENTS = 20
# Problems of the wind that the optimiser is told and of the wind that blows, and as many for a
# second planner beside.
_MOST_PROBLEMS = 4
# Steady flights in each of these winds.
_MOST_STEADY = 2
#: Problems compiled from the declared model, for all planners of the process: scenario and problem
#: by the scenario's structure.
PROBLEMS: Recent[tuple[Scenario, Problem]] = Recent(_MOST_PROBLEMS)
# Share of what a flight may miss or break that the error estimate of a mesh may.
_ESTIMATED = 0.5


class Planner:
    """Solves scenarios, and compiles a problem only where none that is kept fits.

    Planners of the declared model share `PROBLEMS`.  Guess and scales are those of the scenario at
    hand: no answer depends on what was solved before.

    Parameters
    ----------
    builder : callable, optional
        Makes the Pyomo model of a scenario; a builder of the user's own is called anew for
        every scenario, since only the declared model is known to keep all numbers in
        parameters.
    """

    def __init__(self, builder: Builder = build_model) -> None:
        self._builder = builder
        self._problems = PROBLEMS if builder is build_model else Recent(_MOST_PROBLEMS)
        self._steady: Recent[SteadyFlight] = Recent(_MOST_STEADY)

    @property
    def builder(self) -> Builder:
        """Function that builds the Pyomo model of a scenario."""
        return self._builder

    def problem_for(self, scenario: Scenario) -> tuple[Problem, dict[str, float]]:
        """Return a compiled problem for a scenario, and the seconds that took."""
        key = self._key(scenario)
        built_for, problem = self._problems.get(key) or (scenario, None)
        if problem is not None and guess_key(built_for) == guess_key(scenario):
            return problem, {"build": 0.0, "compile": 0.0}
        started = time.perf_counter()
        model = self._builder(scenario)
        built = time.perf_counter()
        if problem is None:
            problem = compile(model, times=declared_free_times(model, scenario))
        else:
            problem = problem.holding(model)
        self._problems.store(key, (scenario, problem))
        return problem, {"build": built - started, "compile": time.perf_counter() - built}

    def _key(self, scenario: Scenario) -> Hashable:
        return structure_key(scenario) if self._builder is build_model else scenario

    def model(self, scenario: Scenario) -> Any:
        """Return the Pyomo model of a scenario, with the scenario's own numbers in it."""
        built_for, problem = self._problems.get(self._key(scenario)) or (None, None)
        if problem is None or built_for != scenario:
            return self._builder(scenario)
        return problem.model

    def steady_flight(
        self, scenario: Scenario, known: Mapping[str, float] | None = None
    ) -> SteadyFlight:
        """Return the steady flight of a scenario's vehicle in still air, solved for once.

        `known` gives states at the start that only a plan knows.
        """
        steady = self._steady.get(scenario)
        if steady is None:
            problem, _ = self.problem_for(scenario)
            numbers = (self.parameters(scenario) or {}) | still_air(problem.model)
            still = problem.dynamics(parameters=numbers, horizon=horizon_of(scenario))
            steady = self._steady.store(scenario, SteadyFlight(scenario, still, known))
        return steady

    def parameters(self, scenario: Scenario) -> dict[str, float] | None:
        """Return the numbers a compiled problem is solved with."""
        return parameter_values(scenario) if self._builder is build_model else None

    def dynamics(self, scenario: Scenario) -> Dynamics:
        """Return the vehicle of a scenario in the scenario's own wind, ready to fly.

        Its limits are those of the controller, which has what plans leave as a reserve.
        """
        problem, numbers = self.problem_for(scenario)[0], self.parameters(scenario)
        return problem.dynamics(parameters=without_reserve(numbers), horizon=horizon_of(scenario))

    def solve(
        self,
        scenario: Scenario,
        *,
        warm_start: Plan | WarmStart | None = None,
        progress: Progress | None = None,
        show: Callable[[State], None] | None = None,
    ) -> Plan:
        """Solve a scenario and verify the result by flying it.

        Parameters
        ----------
        scenario : Scenario
        warm_start : Plan or WarmStart, optional
            A plan of a similar scenario, or what its file or a sweep kept of one: its trajectory,
            and its multipliers if they belong to the same equations, are the first point.
        progress : callable, optional
            Called at each Ipopt iteration; returning False stops the solve.
        show : callable, optional
            Called at each iteration with the stage of the search and the best energy so far.

        Returns
        -------
        Plan
            With its status; a failure of the numerics is a result, not an exception. A search that
            is stopped, fails late, or takes longer than `solver.time_limit` of processor time, the
            flight that checks its plan included, ends with the best usable plan so far; without
            one it is not converged and says so.  Nothing else depends on how fast the machine is.
        """
        solve = self._solve_quickest if scenario.mission.aim is Aim.TIME else self._solve
        with Deadline(scenario, progress) as deadline:
            search = Search(deadline, show)
            if scenario.mission.order is Order.BEST and scenario.mission.waypoints:
                plan = self._solve_in_best_order(scenario, solve, search)
            else:
                plan = solve(scenario, warm_start, search)
            return search.ended(given_up(plan, deadline))

    def _solve_in_best_order(
        self, scenario: Scenario, solve: Callable[..., Plan], progress: Progress
    ) -> Plan:
        """Return the plan of the order of waypoints that costs least."""

        def leg(alone: Scenario, mesh: Mesh, way: Route | None, known: Solution | None) -> Solution:
            problem, _ = self.problem_for(alone)
            arguments = self._arguments(alone, progress) | {"mesh": mesh, "tolerance": None}
            if way is not None:
                free = alone.mission.is_free
                guess = guess_along((way,), alone.nominal_times, is_open=free)
                return problem.solve(**arguments, guess=guess)
            fits = known is not None and known.warm_start.fits(problem.compiled)
            return problem.solve(**arguments, warm_start=known if fits else None)

        is_plain = False

        def roughly(ordered: Scenario) -> Solution:
            nonlocal is_plain
            once = {"solver": ordered.solver.model_copy(update={"max_refinements": 0})}
            told = ordered.as_forecast().model_copy(update=once)
            problem, _ = self.problem_for(told)
            if self._has_ways(told):
                return self._by_routes(problem, told, progress, most=1)[0]
            if not is_plain:
                solution = self._first_solve(problem, told, None, progress)
                if not solution.status.has_failed:
                    return solution
            # A difficulty of one order is one of all orders, so only the first is tried both ways.
            plain = self._plainly(told, self._arguments(told, progress) | {"tolerance": None}, None)
            is_plain = plain is not None
            return solution if plain is None else plain

        def finely(ordered: Scenario, begun: Solution | None) -> Plan:
            # Round zones the best way may be another than the shortest, which was flown so far.
            if begun is None or self._has_ways(ordered):
                return solve(ordered, None, progress)
            return solve(ordered, begun if is_plain else begun.warm_start, progress)

        return cheapest(scenario, find_orders(scenario.as_forecast(), leg), roughly, finely)

    def _has_ways(self, told: Scenario) -> bool:
        """Say whether a mission has ways round zones to choose from."""
        return bool(told.airspace.keep_out) and self._builder is build_model

    def _solve_quickest(
        self, scenario: Scenario, warm_start: Plan | WarmStart | None, progress: Progress
    ) -> Plan:
        """Return the flight of least energy among those of nearly the least time.

        The last to be verified of some that come closer and closer to it, each begun from the last.
        """
        told = scenario.as_forecast()
        started = time.perf_counter()
        shortest = shortest_flight(self._builder(told), told, progress, is_exact=True)
        least, greatest = scenario.mission.duration_limits
        spent = time.perf_counter() - started
        if shortest is None:
            plan = self._solve(scenario, warm_start, progress)
            line = f"no shortest flight was found, for mission.aim = {scenario.mission.aim.value}."
            return replace(plan, status=PlanStatus.NOT_CONVERGED, message=line)
        attempts = [f"shortest flight: {shortest.objective:.6g} s"]
        plans: list[Plan] = []
        start: Solution | None = shortest
        most = inf
        durations = (min(max((1 + a) * shortest.objective, least), greatest) for a in _ABOVE_LEAST)
        for duration in dict.fromkeys(durations):
            effort = Effort(progress, most)
            plans.append(self._solve(scenario.lasting(duration), start, effort))
            start = plans[-1].solution
            most = min(most, _MOST_EFFORT * effort.spent)
            spent += plans[-1].timings["solve"]
            attempts += [f"{duration:.6g} s: {plans[-1].status.value}", *plans[-1].attempts]
            if not plans[-1].is_verified:
                break
        best = next((plan for plan in reversed(plans) if plan.is_verified), plans[0])
        message = (
            f"{best.message} It takes {best.duration_s:.6g} s, where the least time is "
            f"{shortest.objective:.6g} s."
        )
        return replace(
            best,
            scenario=scenario,
            message=message,
            timings=dict(best.timings) | {"solve": spent},
            attempts=tuple(attempts),
        )

    def _solve(
        self, scenario: Scenario, warm_start: Plan | WarmStart | Solution | None, progress: Progress
    ) -> Plan:
        told = scenario.as_forecast()
        problem, timings = self.problem_for(told)
        started = time.perf_counter()
        routes: tuple[TriedRoute, ...] = ()
        has_ways = warm_start is None and self._has_ways(told)
        if has_ways:
            solution, routes = self._by_routes(problem, told, progress)
        else:
            solution = self._first_solve(problem, told, warm_start, progress)
        rescue = None
        is_closed = has_ways and not routes
        if not is_closed and solution.status.has_failed:
            rescue = self._rescuer(problem, told, progress)(solution)
            solution = rescue.solution
        timings["solve"] = time.perf_counter() - started
        plan = plan_of(scenario, solution, timings, self._hover_energy(told, solution))
        plan = replace(plan, routes=routes)
        if rescue is not None:
            plan = replace(plan, attempts=rescue.attempts, failure=rescue.failure)
        if not solution.status.is_solved:
            return plan
        plan = self._confirmed(verified(plan, solution), problem, told, progress)
        return self._fed(plan, progress)

    def _fed(self, plan: Plan, progress: Progress) -> Plan:
        """Return the plan or, if its pack lacks power, a plan within the pack's capability."""
        limits, flown = plan.scenario.limits, plan.flown
        is_own = self._builder is not build_model or limits.battery_power_share_max is not None
        is_met = plan.solution is not None and plan.solution.status is Status.CONVERGED
        if is_own or not is_met or flown is None:
            return plan
        if shares_lacking(plan.dynamics, flown)[0] <= BALANCE_TOLERANCE:
            return plan
        told = plan.scenario.as_forecast()
        greatest = self.steady_flight(told).greatest_pack_power
        if plan.energy > GIVEN_SHARE * greatest * plan.duration_s:
            return plan  # it lacks power for any flight
        held = limits.model_copy(update={"battery_power_share_max": GIVEN_SHARE})
        within = told.model_copy(update={"limits": held})
        started = time.perf_counter()
        problem, _ = self.problem_for(within)
        solution = self._first_solve(problem, within, plan, progress)
        timings = dict(plan.timings)
        timings["solve"] += time.perf_counter() - started
        share = f"{100.0 * GIVEN_SHARE:.0f} %"
        tried = f"pack held to {share} of its greatest power: {solution.status.value}"
        attempts = (*plan.attempts, tried)
        if solution.status.is_solved:
            fed = plan_of(plan.scenario, solution, timings, plan.hover_energy_J)
            fed = verified(replace(fed, attempts=attempts, routes=plan.routes), solution)
            fed = self._confirmed(fed, problem, within, progress)
            if fed.is_verified:
                return fed
        return replace(plan, attempts=attempts, timings=timings)

    def _confirmed(
        self, plan: Plan, problem: Problem, told: Scenario, progress: Progress | None
    ) -> Plan:
        """Return the plan, solved more tightly if it converged and its flight went astray.

        A long flight adds up what the mesh's tolerance leaves to each element.
        """
        tolerance = told.solver.tolerance
        for _ in range(_TIGHTENINGS):
            solution = plan.solution
            if plan.is_verified or solution is None or solution.status is not Status.CONVERGED:
                break
            if plan.verification is not None and not plan.verification.is_fed:
                break  # no mesh gives the pack the power that it lacks
            tolerance *= _TIGHTER
            started = time.perf_counter()
            tighter = problem.solve(
                **self._arguments(told, progress)
                | {
                    "tolerance": tolerance,
                    "mesh": plan.mesh_where_broken,
                    "warm_start": solution,
                }
            )
            if tighter.status is not Status.CONVERGED:
                break
            timings = dict(plan.timings)
            timings["solve"] += time.perf_counter() - started
            attempts = (*plan.attempts, f"flight astray: tolerance {tolerance:.0e}")
            tried = plan_of(plan.scenario, tighter, timings, plan.hover_energy_J)
            plan = verified(replace(tried, attempts=attempts, routes=plan.routes), tighter)
        return plan

    def _by_routes(
        self,
        problem: Problem,
        told: Scenario,
        progress: Progress | None,
        most: int | None = None,
    ) -> tuple[Solution, tuple[TriedRoute, ...]]:
        """Solve along every route round the zones, and return the best with all that were tried.

        At most so many are, the shortest first.

        No route at all is proof that there is no flight, which the solution's message tells.
        """
        arguments, easier = self._arguments(told, progress), easier_numbers(problem, told)
        try:
            journeys = self._journeys(problem, told, most)
        except NoRouteError as error:
            unsolved = {"tolerance": None, "options": SolverOptions(max_iterations=0)}
            closed = problem.solve(**arguments | unsolved | {"progress": None})
            return replace(closed, status=Status.INFEASIBLE, message=str(error)), ()
        mesh = Mesh.uniform(max(told.solver.elements, _ROUTE_ELEMENTS), told.solver.degree)
        easiest = at_its_easiest(arguments, easier)
        once = {"tolerance": None, "mesh": mesh}

        is_plain = False

        def fly(journey: Journey) -> Solution:
            nonlocal is_plain
            guess: Any = guess_along(journey, told.nominal_times, is_open=told.mission.is_free)
            if is_plain:
                begun = self._plainly(told, easiest | once, guess)
                guess = begun.trajectory if begun and begun.status.is_solved else guess
            rough = problem.solve(**easiest | once, guess=guess)
            if is_plain or not rough.status.has_failed or with_plain_passages(told) is None:
                return rough
            is_plain = True
            return fly(journey)

        keep = arguments["refinement"].on_mesh

        def refine(flown: Solution, meshes: int | None) -> Solution:
            if told.solver.max_refinements == 0 and not easier:
                return flown
            if keep is not None:
                keep(flown)
            on_mesh = arguments | {"mesh": flown.mesh}
            if meshes is None and easier:
                return by_way_of(easier, problem, on_mesh, flown.trajectory)
            if meshes is not None:
                few = replace(arguments["refinement"], max_meshes=meshes)
                on_mesh = easiest | {"mesh": flown.mesh, "refinement": few}
            return problem.solve(**on_mesh, warm_start=flown)

        return best_of_journeys(
            journeys, fly, refine, partial(energy_of, told), partial(journey_as_flown, told)
        )

    def _journeys(self, problem: Problem, told: Scenario, most: int | None) -> tuple[Journey, ...]:
        """Return the journeys to fly, the shortest first, at most so many: for a proof, all."""
        journeys = find_journeys(told.airspace, told.mission.positions)[:most]
        if told.solver.accuracy is Accuracy.PROOF or len(journeys) == 1:
            return journeys
        return promising(journeys, self._cost_per_metre(problem, told, journeys[0]))

    def _cost_per_metre(
        self, problem: Problem, told: Scenario, shortest: Journey
    ) -> Callable[[FloatArray], float]:
        """Return what a metre of steady flight costs along a direction, at one speed for all."""
        mission = told.mission
        horizon = (0.0, told.nominal_duration)
        dynamics = problem.dynamics(parameters=self.parameters(told), horizon=horizon)
        steady = SteadyFlight(told, dynamics)
        speed = length_of(shortest) / told.nominal_duration
        if mission.is_free:
            way = shortest[0].places[-1] - shortest[0].places[0]
            length = float(np.linalg.norm(way))
            course = way / length if length > 0.0 else np.array([1.0, 0.0, 0.0])
            speed = best_speed(steady, course, mission.price_of_time)
        speed = min(speed, told.limits.speed_max or inf)

        def cost(course: FloatArray) -> float:
            try:
                return (steady.trim(speed * course).power_W + mission.price_of_time) / speed
            except SolveError:
                return inf

        return cost

    def _plainly(self, told: Scenario, chosen: dict[str, Any], guess: Any) -> Solution | None:
        """Solve the mission past the waypoints themselves; None where it passes them anyway."""
        plain = with_plain_passages(told)
        if plain is None:
            return None
        problem, _ = self.problem_for(plain)
        own = chosen | {"parameters": self.parameters(plain)}
        return problem.solve(**at_its_easiest(own, easier_numbers(problem, plain)), guess=guess)

    def _first_solve(
        self,
        problem: Problem,
        told: Scenario,
        warm_start: Plan | WarmStart | Solution | None,
        progress: Progress | None,
    ) -> Solution:
        arguments, easier = self._arguments(told, progress), easier_numbers(problem, told)
        if isinstance(warm_start, Solution):
            path = replace(warm_start.trajectory, statics=_statics_for(problem, warm_start))
            return by_way_of(easier, problem, arguments | {"mesh": path.mesh}, path)
        start = warm_start.warm_start if isinstance(warm_start, Plan) else warm_start
        if start is not None and start.fits(problem.compiled):
            # Its mesh is the first, and the mission's own where the warm start is given up.
            solution = problem.solve(**arguments | {"mesh": None}, warm_start=start)
            if not easier or solution.status is not Status.NOT_CONVERGED:
                return solution
        if not isinstance(warm_start, Plan):
            if not easier and self._builder is build_model and is_long(told):
                return self._solve_long(problem, told, arguments)
            return by_way_of(easier, problem, arguments, None)
        on_mesh = arguments | {"mesh": warm_start.mesh}
        return by_way_of(easier, problem, on_mesh, warm_start.guess())

    def _solve_long(self, problem: Problem, told: Scenario, arguments: dict[str, Any]) -> Solution:
        """Solve a flight that is long beside a change of attitude, from a cruise."""
        flown = {name: arguments[name] for name in ("parameters", "horizon")}
        dynamics = problem.dynamics(**flown)
        guess = guess_of(told, SteadyFlight(told, dynamics))
        options = arguments["options"].for_small_changes()
        duration = (guess or {}).get("duration", told.nominal_duration)
        rough = problem.solve(
            **arguments | {"mesh": rough_mesh(duration), "tolerance": None},
            guess=guess,
        )
        if not rough.status.is_solved:
            return rough
        mesh = fine_mesh(rough.horizon[1], told.solver.degree)
        # One limit or two hold for long, at the ends: their junctions are few, and worth finding.
        refinement = replace(arguments["refinement"], limits_move=False)
        chosen = {"options": options, "mesh": mesh, "refinement": refinement}
        return problem.solve(**arguments | chosen, warm_start=rough)

    def _arguments(self, told: Scenario, progress: Progress | None) -> dict[str, Any]:
        settings, figures = told.solver, FIGURES[told.solver.accuracy]
        options = SolverOptions(max_iterations=settings.max_iterations)
        limits_move = bool(told.mission.is_free or told.mission.waypoints or told.airspace.keep_out)
        if limits_move:
            options = options.for_moving_limits()
        return {
            "mesh": Mesh.uniform(settings.elements, settings.degree),
            "tolerance": settings.tolerance,
            "parameters": self.parameters(told),
            "horizon": horizon_of(told),
            "options": options,
            "refinement": RefinementOptions(
                first_elements=settings.elements,
                first_degree=settings.degree,
                max_meshes=settings.max_refinements + 1,
                allowance=Allowance(
                    control_breach=HELD_BREACH,
                    limit_breach=_ESTIMATED * figures.breach,
                    final_miss=_ESTIMATED * figures.miss,
                ),
                limits_move=limits_move,
                on_mesh=self._keeper(told, progress),
            ),
            "progress": progress,
        }

    def _keeper(
        self, told: Scenario, progress: Progress | None
    ) -> Callable[[Solution], None] | None:
        """Return what keeps the usable plans among the meshes that a search finishes."""
        search = progress if isinstance(progress, Search) else None
        if search is None:
            return None

        def flown(solution: Solution) -> Plan:
            hovering = self._hover_energy(told, solution)
            timings = {"build": 0.0, "compile": 0.0, "solve": search.spent_s}
            plan = plan_of(told, solution, timings, hovering)
            return replace(verified(plan, solution, Accuracy.QUICK), status=PlanStatus.SOLVED)

        def flyable(solution: Solution) -> Iterator[Plan]:
            problem, _ = self.problem_for(told)
            arguments = self._arguments(told, progress)
            return map(flown, flyable_from(problem, arguments, solution, told.airspace))

        def keep(solution: Solution) -> None:
            search.finished(solution, energy_of(told, solution), flown, flyable)

        return keep

    def _rescuer(self, problem: Problem, told: Scenario, progress: Progress | None) -> Rescuer:
        arguments = self._arguments(told, progress)
        easier = easier_numbers(problem, told)
        easiest = at_its_easiest(arguments, easier)

        def slowly(duration: float, guess: Trajectory | None) -> Solution | None:
            if told.mission.is_free:
                return None
            other = easiest | {"horizon": (0.0, duration), "tolerance": None}
            return problem.solve(**other, guess=guess)

        return Rescuer(
            longest=told.mission.longest,
            # A flight found on a finer mesh may be infeasible on the first mesh.
            solve=lambda held: by_way_of(easier, problem, arguments | {"mesh": held.mesh}, held),
            solve_plainly=lambda: self._plainly(told, easiest | {"tolerance": None}, None),
            solve_slowly=slowly,
            solve_shortest=lambda: shortest_flight(self._builder(told), told, progress),
            progress=progress,
        )

    def _hover_energy(self, told: Scenario, solution: Solution) -> float:
        """Return the energy of hovering through the mission, NaN if the vehicle cannot hover."""
        held = trajectories_of(solution)
        known = dict(zip(held.state_names, held.states[0].tolist(), strict=True))
        try:
            power = self.steady_flight(told, known).hover_power
        except SolveError:
            return nan
        start, end = held.horizon
        return power * (end - start)


def _statics_for(problem: Problem, solution: Solution) -> np.ndarray:
    """Return a problem's static variables with their values in a similar problem's solution."""
    slots = solution.problem.compiled.declared.statics
    held = dict(zip((slot.name for slot in slots), solution.trajectory.statics, strict=True))
    return np.array([held[slot.name] for slot in problem.compiled.declared.statics])


def solve_scenario(
    scenario: Scenario,
    *,
    builder: Builder = build_model,
    warm_start: Plan | WarmStart | None = None,
    progress: Progress | None = None,
) -> Plan:
    """Solve one scenario with a planner of its own; see `Planner.solve`.

    Examples
    --------
    >>> solve_scenario(scenario, warm_start=plan).is_verified
    True
    """
    return Planner(builder).solve(scenario, warm_start=warm_start, progress=progress)
