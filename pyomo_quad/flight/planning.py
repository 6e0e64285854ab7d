"""Planner, which makes a verified plan from a scenario.

The planner compiles the optimal control problem of the scenario. It tries several ways to solve the
problem: a first solve, and retries from other initial guesses (see `flight.strategies`). It then
verifies the plan by simulation.
"""

import time
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from functools import partial

from pyomo_quad.collocation import Progress, WarmStart
from pyomo_quad.flight.candidate import Candidate, Start
from pyomo_quad.flight.deadline import Deadline
from pyomo_quad.flight.geometric_plan import geometric_plan
from pyomo_quad.flight.least_time import Approach, shortest_flight
from pyomo_quad.flight.mission_problem import MissionProblem
from pyomo_quad.flight.plan import Plan, PlanStatus
from pyomo_quad.flight.problems import Builder, Problems
from pyomo_quad.flight.return_flight import with_return_flight
from pyomo_quad.flight.search import Search, State
from pyomo_quad.flight.strategies import MISSION, REFINING, ROUTES, Strategy, carry_out
from pyomo_quad.flight.tour import BestOrder
from pyomo_quad.model import build_model
from pyomo_quad.scenario import Scenario
from pyomo_quad.scenario.mission import Aim, Order

Solve = Callable[[Scenario, Start | None, Search], Plan]


class Planner(Problems):
    """Solver of scenarios, which makes verified plans and caches the compiled problems.

    Parameters
    ----------
    builder : callable, optional
        Takes a scenario and builds its Pyomo model; `build_model` by default.
    """

    def until_stopped(self) -> AbstractContextManager[Callable[[], bool]]:
        """Return a context manager for a series of solves that the user may stop together.

        The variable after ``as`` is a function that returns whether the user has stopped the
        series. In this class, the function always returns False. In the command line's subclass, it
        can return True after the user has pressed Ctrl-C.
        """
        return nullcontext(lambda: False)

    def solve(
        self,
        scenario: Scenario,
        *,
        warm_start: Plan | WarmStart | None = None,
        progress: Progress | None = None,
        show: Callable[[State], None] | None = None,
    ) -> Plan:
        """Solve a scenario for the flight of least energy, and verify it by simulation.

        Parameters
        ----------
        scenario : Scenario
            Mission, vehicle, wind and settings.
        warm_start : Plan or WarmStart, optional
            A plan of a similar scenario, or the initial point (warm start) that a plan file or a
            sweep has stored. The solve starts from its trajectory, and from its multipliers if both
            problems have the same equations. Candidate routes are then not compared. If the order
            of the waypoints is open, the warm start is ignored. If the mission asks for the least
            time, it is used only if the minimum-time problem fails. The planner then solves for the
            least energy.
        progress : callable, optional
            Called at each Ipopt iteration; returning False stops the solve.
        show : callable, optional
            Called at each iteration with the `State` of the solves, for a progress display.

        Returns
        -------
        Plan
            The plan with its status. If the solve fails, is stopped or exceeds its time limit, no
            exception is raised. The result is then the best usable plan: a plan that simulation
            confirms at lower accuracy than requested. If there is none, the result has a failed
            status.

            The time limit is `solver.time_limit` of the scenario, in processor time including
            verification. The result depends on the speed of the machine only if this limit is
            exceeded.

        Raises
        ------
        ScenarioError
            If a user's own model lacks a variable for a free time of the mission.
        SolveError
            If charge is reserved for a return flight that the vehicle cannot fly.
        """
        scenario = with_return_flight(self, scenario)
        solve = self._solve_quickest if scenario.mission.aim is Aim.TIME else self._solve
        began = time.perf_counter()
        with Deadline(scenario, progress) as deadline:
            search = Search(deadline, show)
            if scenario.mission.order is Order.BEST and scenario.mission.waypoints:
                search.stage = ROUTES
                plan = self._solve_in_best_order(scenario, solve, search)
            else:
                plan = solve(scenario, warm_start, search)
            others = sum(s for name, s in plan.timings.items() if name != "solve")
            timings = dict(plan.timings) | {"solve": time.perf_counter() - began - others}
            return search.ended(replace(plan, timings=timings))

    def _solve_in_best_order(self, scenario: Scenario, solve: Solve, search: Search) -> Plan:
        """Solve a mission whose waypoints may be visited in any order.

        The result is the plan that `solve` makes for the cheapest order found. `search` has the
        time limit, and records the progress of all solves.
        """
        orders = BestOrder(self, scenario, search)
        table = [
            Strategy(found.name, ROUTES, BestOrder.has_time, partial(BestOrder.fly, found=found))
            for found in orders.candidates()
        ]
        carry_out(table, orders, search)
        return orders.finish(solve)

    def _solve_quickest(self, scenario: Scenario, start: Start | None, search: Search) -> Plan:
        """Solve for a flight in nearly the least duration of the mission.

        If the minimum-time problem fails, the least energy is sought from the guess `start`. The
        result is then always marked "not converged". `search` has the time limit, and records
        progress.
        """
        told = scenario.as_forecast()
        shortest = shortest_flight(self.builder(told), told, search, is_exact=True)
        if shortest is None:
            plan = self._solve(scenario, start, search)
            line = f"no shortest flight was found, for mission.aim = {scenario.mission.aim.value}."
            return replace(plan, status=PlanStatus.NOT_CONVERGED, message=line)
        search.record.append(f"shortest flight: {shortest.objective:.6g} s")
        approach = Approach(scenario, shortest, self._solve, search)
        table = [
            Strategy(f"{t:.6g} s", REFINING, Approach.goes_on, partial(Approach.fly, lasting=t))
            for t in approach.durations
        ]
        carry_out(table, approach, search)
        return approach.closest

    def _solve(self, scenario: Scenario, start: Start | None, search: Search) -> Plan:
        mission = MissionProblem(self, scenario.as_forecast(), search)
        search.begin_with(partial(geometric_plan, mission))
        candidate = Candidate(scenario=scenario, mission=mission, search=search, start=start)
        carry_out(MISSION, candidate, search)
        return candidate.plan


def solve_scenario(
    scenario: Scenario,
    *,
    builder: Builder = build_model,
    warm_start: Plan | WarmStart | None = None,
    progress: Progress | None = None,
) -> Plan:
    """Solve one scenario with a new planner and verify the plan; see `Planner.solve`.

    Parameters
    ----------
    scenario : Scenario
        Mission, vehicle, wind and settings.
    builder : callable, optional
        Takes a scenario and builds its Pyomo model; `build_model` by default.
    warm_start : Plan or WarmStart, optional
        Initial point: a plan of a similar scenario, or what a plan file or a sweep has stored.
    progress : callable, optional
        Called at each Ipopt iteration; returning False stops the solve.

    Returns
    -------
    Plan
        The plan with its status.

    Examples
    --------
    >>> solve_scenario(scenario, warm_start=plan).is_verified
    True
    """
    return Planner(builder).solve(scenario, warm_start=warm_start, progress=progress)
