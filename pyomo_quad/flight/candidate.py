"""Candidate plan of a mission, which the planning strategies improve step by step.

A candidate is the present solution in the search for a plan. A strategy is an action with a
condition; the table in `flight.strategies` lists them. Conditions and actions are methods of the
candidate. An action returns its outcome as text for the record, such as the solver's status, or
None if there is nothing to record.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from pyomo_quad.collocation import (
    Solution,
    Status,
    TranscriptionError,
    WarmStart,
    diagnose,
)
from pyomo_quad.flight.corridors import has_corridors
from pyomo_quad.flight.failure import Failure
from pyomo_quad.flight.least_time import shortest_flight
from pyomo_quad.flight.long_flight import fine_mesh, guess_of, is_long, rough_mesh
from pyomo_quad.flight.mission_problem import MissionProblem
from pyomo_quad.flight.plan import Plan
from pyomo_quad.flight.route_flights import RouteFlights
from pyomo_quad.flight.stricter_limits import broken_limits, mesh_where_broken, within_limits
from pyomo_quad.flight.verdict import energy_of, plan_of, verified
from pyomo_quad.flight.verification import BALANCE_TOLERANCE, shares_lacking, tolerated
from pyomo_quad.model.battery import GIVEN_SHARE
from pyomo_quad.model.mission import chosen_times
from pyomo_quad.scenario.accuracy import FIGURES, Accuracy

if TYPE_CHECKING:
    from collections.abc import Callable

    from pyomo_quad.collocation import Diagnosis, Relaxation, Trajectory
    from pyomo_quad.flight.routes import TriedRoute
    from pyomo_quad.flight.search import Search
    from pyomo_quad.scenario import Scenario

# Largest number of limits that a diagnosis relaxes one at a time, and the prefix of their names.
_MOST_REMEDIES = 3
_LIMITS = "limits."
# Factor by which the tolerance is tightened if a simulated flight does not confirm the solution.
_TIGHTER = 0.1
# Factor on the tolerances of `MissionProblem.allowance` after each simulation that does not confirm
# the solution: with the second factor, violations of limits in proportion to these tolerances would
# fall to half of what is allowed; the first is its least value.
_FINER, _HALF = 0.1, 0.5
# Largest number of solves with limits that become stricter and stricter.
_MOST_STRICTER = 4


@dataclass(frozen=True)
class AlongShortest:
    """Starting point of a search for a plan: the mission's solution along its shortest route.

    The search for the best order of the waypoints has found the solution `flight`, on a single
    coarse mesh.
    """

    flight: Solution


Start = Plan | WarmStart | Solution | AlongShortest


@dataclass(kw_only=True)
class Candidate:
    """Present solution of a mission in a search, with its plan and the diagnosis of failures.

    Attributes
    ----------
    scenario : Scenario
        The scenario to plan.
    mission : MissionProblem
        Compiled problem of the scenario in its forecast wind.
    search : Search
        Record of the strategies; as a progress callback, it stops solves at the time limit.
    start : Start or None
        Starting point of the search, such as a plan.
    solution : Solution or None
        Present solution, converged or not; None before the first solve.
    routes : tuple of TriedRoute
        Result for each route that was tried.
    is_closed : bool
        Whether keep-out zones block every route.
    diagnosis : Diagnosis or None
        Least violation of the limits after a failed solve.
    slower : Trajectory or None
        Trajectory of the mission with a duration longer than prescribed, for an initial guess.
    shortest : Solution or None
        Solution of least duration.
    failure : Failure or None
        Reason why all strategies failed.
    flown : Plan or None
        Plan made from the solution, with its simulation.
    tolerance : float
        Tolerance of the mesh refinement.
    """

    scenario: Scenario
    mission: MissionProblem
    search: Search
    start: Start | None = None
    # A first solve stores its result in any case, a retry only if it succeeds.
    solution: Solution | None = None
    routes: tuple[TriedRoute, ...] = ()
    is_closed: bool = False
    diagnosis: Diagnosis | None = None
    slower: Trajectory | None = None
    shortest: Solution | None = None
    failure: Failure | None = None
    flown: Plan | None = None
    tolerance: float = field(init=False)

    def __post_init__(self) -> None:
        self.tolerance = self.mission.told.solver.tolerance
        self._began = time.perf_counter()
        # Factor on the tolerances of `MissionProblem.allowance`.
        self._share = 1.0
        # The solution, unless it has stricter limits than the mission.
        self._known: Solution | None = None

    @property
    def found(self) -> Solution:
        """Solution of the mission found so far.

        Raises
        ------
        RuntimeError
            Before any strategy has made a solution.
        """
        if self.solution is None:
            raise RuntimeError("no strategy has solved the mission yet")
        return self.solution

    @property
    def plan(self) -> Plan:
        """Plan made from the solution found so far, verified or not.

        Raises
        ------
        RuntimeError
            Before any strategy has made a solution.
        """
        if self.flown is not None:
            return self.flown
        return replace(self.plan_of(self.found), routes=self.routes, failure=self.failure)

    def plan_of(self, solution: Solution) -> Plan:
        """Return a plan that is made from a solution and is not yet verified by simulation.

        `solution` is a solution of the mission's optimal control problem, converged or not.
        """
        seconds = time.perf_counter() - self._began
        timings = self.mission.timings | {"solve": seconds}
        return plan_of(self.scenario, solution, timings, self.mission.hover_energy(solution))

    # First solutions

    def has_routes(self) -> bool:
        """Return whether the search begins by comparing several routes.

        A mission with keep-out zones or a wind field may have several routes. They are compared
        unless the search starts from a plan, a warm start or the solution of a similar problem.
        """
        is_open = self.start is None or isinstance(self.start, AlongShortest)
        return is_open and self.mission.has_routes

    def fly_routes(self) -> str | None:
        """Solve the mission along each of its candidate routes and keep the best solution.

        The method sets `solution`, `routes` and `is_closed`. If the best solution failed, its
        status is returned.
        """
        known = self.start.flight if isinstance(self.start, AlongShortest) else None
        self.solution, self.routes = RouteFlights(self.mission, known).best()
        self.is_closed = not self.routes
        return self._outcome()

    def starts_at_flight(self) -> bool:
        """Return whether the search starts from a flight: the solution of a similar problem.

        An example is the solution of the same mission with another duration.
        """
        return isinstance(self.start, Solution)

    def from_flight(self) -> str | None:
        """Solve the mission from the solution of a similar problem, on the mesh of that solution.

        That solution, the attribute `start`, is the initial guess. The result becomes `solution`,
        even if it failed. The solver's status is returned after a failure only.
        """
        if not isinstance(self.start, Solution):
            return None
        path = self._in_order_of_mission(self.mission, self.start)
        self.solution = self.mission.solve_from(path, path.mesh)
        return self._outcome()

    @staticmethod
    def _in_order_of_mission(mission: MissionProblem, similar: Solution) -> Trajectory:
        """Return the trajectory of a similar problem, as an initial guess of the mission.

        Its static variables are sorted in the order of `mission`.
        """
        slots = similar.problem.compiled.declared.statics
        held = dict(zip((slot.name for slot in slots), similar.trajectory.statics, strict=True))
        statics = [held[slot.name] for slot in mission.problem.compiled.declared.statics]
        return replace(similar.trajectory, statics=np.array(statics))

    @property
    def _warm_start(self) -> WarmStart | None:
        start = self.start.warm_start if isinstance(self.start, Plan) else self.start
        return start if isinstance(start, WarmStart) else None

    def starts_warm(self) -> bool:
        """Return whether the user gave a warm start that fits the mission's problem.

        The earlier solve must have had the same variables and equations. A given plan contains its
        warm start.
        """
        start = self._warm_start
        return start is not None and start.fits(self.mission.problem.compiled)

    def from_warm_start(self) -> str | None:
        """Solve the mission from a warm start: variables and multipliers of an earlier solve.

        The result becomes `solution`, even if it failed, with one exception. If braking rotors
        return no energy, a result with the status `NOT_CONVERGED` is discarded. After any failure
        (`NOT_CONVERGED` or `INFEASIBLE`), the solver's status is returned.
        """
        # If no energy is returned, the electric power has a kink at zero. Other strategies are
        # better suited for it.
        # The first mesh is that of the warm start, or the mission's own if the start is discarded.
        solution = self.mission.solve(mesh=None, warm_start=self._warm_start)
        if self.mission.easier and solution.status is Status.NOT_CONVERGED:
            return solution.status.value
        self.solution = solution
        return self._outcome()

    def starts_at_plan(self) -> bool:
        """Return whether the search starts from a plan and no strategy has made a solution yet.

        The method `from_plan` then uses the plan's trajectory as an initial guess.
        """
        return self.solution is None and isinstance(self.start, Plan)

    def from_plan(self) -> str | None:
        """Solve the mission from the trajectory of a plan, on the mesh of that plan.

        The plan, the attribute `start`, is the initial guess. The result becomes `solution`, even
        if it failed. The solver's status is returned after a failure only.
        """
        if isinstance(self.start, Plan):
            start = self.start.warm_start
            mesh = self.start.mesh if start is None else start.mesh
            self.solution = self.mission.solve_from(guess_from(self.start, self.mission.told), mesh)
        return self._outcome()

    def is_long(self) -> bool:
        """Return whether the flight is so long that steady flight is a good initial guess.

        The result is False if a strategy has already made a solution, and for missions with
        waypoints or keep-out zones. It is False for a user's own model, and for rotors that return
        no energy when they brake.
        """
        # If no energy is returned, the electric power has a kink at zero, for which another guess
        # is better.
        mission = self.mission
        is_simple = self.solution is None and mission.problems.is_declared and not mission.easier
        # A long flight takes much longer than the vehicle needs to change its attitude.
        return is_simple and is_long(mission.told)

    def from_cruise(self) -> str | None:
        """Solve the mission with steady flight as initial guess.

        A rough mesh comes first and, if that succeeds, a fine mesh. The last result becomes
        `solution`, even if it failed. The solver's status is returned after a failure only.
        """
        mission, told = self.mission, self.mission.told
        guess = guess_of(told, mission.steady)
        duration = (guess or {}).get("duration", told.nominal_duration)
        # The vehicle accelerates and brakes at the ends of the flight. The meshes have short
        # elements there.
        rough = mission.solve(mesh=rough_mesh(duration), tolerance=None, guess=guess)
        self.solution = rough
        if rough.status.is_solved:
            self.solution = mission.solve(
                mesh=fine_mesh(rough.horizon[1], told.solver.degree),
                options=mission.arguments["options"].for_small_changes(),
                # Only one or two limits are active, for long times near the ends of the flight:
                # their few junctions are worth locating.
                refinement=replace(mission.arguments["refinement"], limits_move=False),
                warm_start=rough,
            )
        return self._outcome()

    def is_unsolved(self) -> bool:
        """Return whether no strategy has made a solution yet."""
        return self.solution is None

    def from_nothing(self) -> str | None:
        """Solve the mission from the default initial guess of the model.

        The result becomes `solution`, even if it failed. The solver's status is returned after a
        failure only.
        """
        self.solution = self.mission.solve_from()
        return self._outcome()

    def _outcome(self) -> str | None:
        """Return the solver's status as text if the last solve of the mission failed, else None."""
        status = self.found.status
        return status.value if status.has_failed else None

    # Retries of a solution that failed

    def has_failed(self) -> bool:
        """Return whether the mission's solve failed although a route to the goal exists.

        If keep-out zones block every route, the result is False, because solving again is useless.
        """
        return self.found.status.has_failed and not self.is_closed

    def has_failed_at_waypoints(self) -> bool:
        """Return whether the mission's solve failed and there is an easier mission to solve first.

        The easier mission passes exactly through the waypoints, at any speed. It is easier, because
        inequalities on distance and speed at waypoints make a first solve difficult. There is none
        if no waypoint has a radius or a speed limit.
        """
        return self.has_failed() and self.mission.past_waypoints is not None

    def past_waypoints(self) -> str | None:
        """Solve the failed mission again, starting from the solution of an easier mission.

        In the easier mission, the vehicle passes exactly through the waypoints, at any speed. A new
        solution is kept if its solve succeeds. The result is the solver's status, or None without a
        solution of the easier mission.
        """
        past = self.mission.past_waypoints
        plain = None if past is None else past.solve_roughly()
        if plain is None or not plain.status.is_solved:
            return None
        return self._retried(plain.trajectory)

    def restore(self) -> str | None:
        """Diagnose the failed solve by an elastic problem, and solve the mission again.

        The elastic problem minimises the violation of the limits. If no violation is left, its
        solution is the initial guess, and the solver's status is returned. Otherwise, the result is
        None. The method sets `diagnosis`.
        """
        self.diagnosis = diagnose(self.found, progress=self.search)
        feasible = self.diagnosis.feasible_point
        return None if feasible is None else self._retried(feasible)

    def may_be_slower(self) -> bool:
        """Return whether to search for a slower flight as initial guess for the failed mission.

        The result is False if the duration of the mission is free. It is also False if the
        diagnosis found the mission infeasible in its duration, so that no guess helps.
        """
        is_infeasible = self.diagnosis is not None and self.diagnosis.is_infeasible
        return self.has_failed() and not is_infeasible and not self.mission.told.mission.is_free

    def slow_down(self, by: float) -> str:
        """Solve the mission with its duration multiplied by ``by``; return the solver's status.

        If the solve succeeds, its trajectory becomes `slower`, from which `speed_up` starts.
        """
        longest = self.mission.told.mission.longest.value
        # The initial guess is the slower flight of the previous call, or the default guess of the
        # model.
        slow = self.mission.solve_roughly(horizon=(0.0, by * longest), guess=self.slower)
        if slow.status is Status.INTERRUPTED:
            self.solution = slow
        elif slow.status.is_solved:
            self.slower = slow.trajectory
        return slow.status.value

    def has_slower(self) -> bool:
        """Return whether the mission's solve failed, but a solution of longer duration is known."""
        return self.has_failed() and self.slower is not None

    def speed_up(self) -> str | None:
        """Solve the failed mission again, with the flight `slower` as initial guess.

        That flight lasts longer than prescribed. The result is the solver's status, or None if
        `slow_down` has found no such flight.
        """
        return None if self.slower is None else self._retried(self.slower)

    def find_shortest(self) -> str:
        """Solve for the least duration in which the mission can be flown within its limits.

        The solution becomes `shortest`, None if the solve failed. The result is the least duration
        as text, such as "12.3 s", or "none found".
        """
        mission = self.mission
        model = mission.problems.builder(mission.told)
        self.shortest = shortest_flight(model, mission.told, self.search)
        return "none found" if self.shortest is None else f"{self.shortest.objective:.4g} s"

    def has_shorter(self) -> bool:
        """Return whether the mission's solve failed although a flight of allowed duration is known.

        The known flight is that of least duration, which the method `find_shortest` finds. If it
        found no flight, the result is False.
        """
        longest = self.mission.told.mission.longest.value
        found = self.shortest
        return self.has_failed() and found is not None and found.objective <= longest

    def from_shortest(self) -> str | None:
        """Solve the failed mission again, starting from the solution of least duration.

        The result is the solver's status, or None if `find_shortest` found no solution.
        """
        if self.shortest is None:
            return None
        return self._retried(self.mission.in_own_variables(self.shortest, self.found))

    def _retried(self, trajectory: Trajectory) -> str:
        """Solve the failed mission again from a trajectory; keep the solution if this succeeds.

        The result is the solver's status.
        """
        # A flight found on a finer mesh may be infeasible on the first mesh.
        solution = self.mission.solve_from(trajectory, trajectory.mesh)
        if not solution.status.has_failed:
            self.solution = solution
        return solution.status.value

    def judge(self) -> None:
        """Record why the mission failed, and decide whether it is infeasible.

        The method sets `failure` and the status of the solution. Without a diagnosis, it changes
        nothing.
        """
        if self.diagnosis is None:
            return
        is_infeasible, doubt = self.diagnosis.is_infeasible, self._doubt()
        self.failure = Failure(
            longest=self.mission.told.mission.longest,
            shortest_duration_s=None if self.shortest is None else self.shortest.objective,
            diagnosis=self.diagnosis,
            remedies=self._remedies(self.diagnosis) if is_infeasible and not doubt else (),
            doubt=doubt,
        )
        # Without a doubt, the mission is infeasible if its allowed duration is below the least one.
        # It is also infeasible if the elastic problem still violates a limit, and no flight of
        # allowed duration is known.
        is_proven = self.failure.is_too_short or (is_infeasible and not self.has_shorter())
        status = Status.INFEASIBLE if is_proven and not doubt else Status.NOT_CONVERGED
        self.solution = replace(self.found, status=status)

    def _doubt(self) -> str:
        """Return a reason to believe that the mission is possible although all solves failed.

        The text is empty without a reason.
        """
        met = sum(route.energy_J is not None for route in self.routes)
        if met:
            flights = "flight keeps" if met == 1 else "flights keep"
            return (
                f"{met} {flights} all limits on a coarse mesh, of {len(self.routes)} routes tried, "
                "but none on a finer one, so the mission may be possible; raise "
                "solver.max_iterations or solver.elements, or leave more room between zones."
            )
        is_long_enough = self.shortest is None or self.has_shorter()
        # Each solve searches near one route only. Failed solves therefore cannot exclude a flight
        # along another route, provided that the duration is long enough.
        if has_corridors(self.mission.told) and is_long_enough:
            return (
                f"no flight was found (routes tried: {len(self.routes)}), but others may lead "
                "through the wind field; add a waypoint on a way that should be possible."
            )
        return ""

    def _remedies(self, diagnosis: Diagnosis) -> tuple[Relaxation, ...]:
        """Return the limits that make the mission feasible if one of them alone is relaxed.

        Each item has the necessary relaxation.
        """
        candidates = [r.name for r in diagnosis.relaxations] + [a.name for a in diagnosis.active]
        limits = [name for name in dict.fromkeys(candidates) if name.startswith(_LIMITS)]
        found: list[Relaxation] = []
        # The elastic problem is solved with one limit relaxed, for the first violated or active
        # limits.
        for name in limits[:_MOST_REMEDIES]:
            try:
                alone = diagnose(self.found, families=frozenset({name}), progress=self.search)
            except TranscriptionError:
                continue
            found.extend(alone.relaxations)
        return tuple(found)

    # Verification by a simulated flight

    def is_solved(self) -> bool:
        """Return whether the solver converged for the solution found so far.

        The controls of such a solution can be simulated, even if its mesh is not fine enough.
        """
        return self.found.status.is_solved

    def fly(self) -> None:
        """Simulate the controls of the solution, to verify the plan that is made from it.

        The plan, verified or not, becomes the attribute `flown`.
        """
        self.flown, self._known = verified(self.plan, self.found), self.found
        self.search.keep(self.flown)
        # The time of the solve does not include that of the simulation.
        self._began += self.flown.timings.get("verify", 0.0)

    def breaks_limits(self) -> bool:
        """Return whether stricter limits may turn the solution into a verified plan.

        The result is that of `is_astray`, but always False if `solver.accuracy` of the scenario is
        "proof". If the simulated flight breaks no limit, the method `keep_limits` solves nothing.
        """
        # Stricter limits cost energy, which the accuracy "proof" does not allow.
        return self.is_astray() and self.scenario.solver.accuracy is not Accuracy.PROOF

    def keep_limits(self) -> str | None:
        """Solve again with stricter values of the limits that the simulated flight breaks.

        At most four solves are tried until the flight keeps the mission's limits. The last plan
        becomes `flown`. The result is a text such as "2 solves", or None without a solution.
        """
        relaxed, asked, solves = self.found, self.scenario.solver.accuracy, 0

        def fly(solution: Solution, least_energy: float) -> Plan:
            plan = replace(self.plan_of(solution), routes=self.routes)
            return verified(plan, solution, asked, least_energy)

        for plan in within_limits(self.mission, relaxed, self.plan, FIGURES[asked], fly):
            self.flown, solves = plan, solves + 1
            self.search.keep(plan)
            if plan.is_verified or solves == _MOST_STRICTER:
                break
            # Stricter limits cannot reduce the energy of a global optimum. If they do, `relaxed` is
            # only a local one. The repetition then ends, and the search continues from the plan's
            # solution.
            if plan.solution is not None and self._is_better(plan, relaxed):
                self.solution, self._known = plan.solution, None
                break
        return f"{solves} solves" if solves else None

    def _is_better(self, plan: Plan, relaxed: Solution) -> bool:
        """Return whether a plan with stricter limits needs less energy than the solution `relaxed`.

        The result is True if the relative difference exceeds the solver's tolerance. In this case,
        `relaxed` is a local optimum and not the global one.
        """
        least, tolerance = energy_of(self.mission.told, relaxed), self.scenario.solver.tolerance
        return least - plan.energy > tolerance * abs(least)

    def is_astray(self) -> bool:
        """Return whether the simulated flight deviates from the plan although the solve converged.

        Examples are a wrong final state, a broken limit, or another energy than planned. The result
        is False after the time limit, or if the battery lacks power.
        """
        plan = self.flown
        is_over = self.search.deadline.is_over
        if plan is None or plan.is_verified or is_over or not self.found.is_converged:
            return False
        # A finer mesh does not help if the battery lacks power.
        return plan.verification is None or plan.verification.is_fed

    def tighten(self) -> str | None:
        """Solve again with smaller tolerances of the mesh refinement, and simulate the new plan.

        If the solve converges, `solution` and `flown` are replaced, and a text such as "tolerance
        1e-07" is returned. Otherwise, the result is None. The attribute `tolerance` may become
        smaller even then.
        """
        found, asked = self.found, self.scenario.solver.accuracy
        plan, figures = self.plan, FIGURES[asked]
        beyond = [b.size / tolerated(b, figures) for b in broken_limits(plan, figures)]
        # In a long flight without feedback, small errors of the mesh elements add up. The flight
        # may miss the goal although each element meets the tolerance.
        self._share *= max(_FINER, _HALF / max(beyond)) if beyond else _FINER
        # With corrected controls, a coarse mesh costs no more energy than estimated.
        if asked is Accuracy.PROOF or found.error_estimate > figures.energy:
            self.tolerance *= _TIGHTER
        # The present mesh, with shorter elements where the simulated flight entered keep-out zones.
        mesh = mesh_where_broken(found, plan, figures)
        tighter = self.mission.solve(
            tolerance=self.tolerance,
            mesh=mesh,
            warm_start=found,
            refinement=replace(self.mission.stricter_refinement(self._share), known=self._known),
        )
        if tighter.status is not Status.CONVERGED:
            return None
        self.solution, self.flown = tighter, None
        self.fly()
        return f"tolerance {self.tolerance:.0e}"

    def lacks_power(self) -> bool:
        """Return whether the battery can supply the plan's mean power but not its peak power.

        The peak power is that of the plan's simulated flight. If the result is True, a gentler
        flight with a lower peak power may be possible.
        """
        plan, mission, limits = self.flown, self.mission, self.scenario.limits
        if not mission.problems.is_declared or limits.battery_power_share_max is not None:
            return False
        if plan is None or plan.flown is None or self.found.status is not Status.CONVERGED:
            return False
        verdict = plan.verification
        if verdict is not None and verdict.battery_imbalance <= BALANCE_TOLERANCE:
            return False
        if shares_lacking(plan.dynamics, plan.flown)[0] <= BALANCE_TOLERANCE:
            return False
        greatest = mission.problems.steady_flight(mission.told).greatest_pack_power
        return plan.energy <= GIVEN_SHARE * greatest * plan.duration_s

    def hold_pack(self, carry_out: Callable[[Candidate], None]) -> str:
        """Plan the mission again with an upper limit on the power that the battery supplies.

        The limit is `GIVEN_SHARE` times the battery's greatest power. `carry_out` applies the
        planning strategies to a candidate. The new plan is kept if it is verified. The result is
        the solver's status for it.
        """
        limits = self.scenario.limits.model_copy(update={"battery_power_share_max": GIVEN_SHARE})
        within = self.mission.told.model_copy(update={"limits": limits})
        gentler = replace(
            self,
            mission=MissionProblem(self.mission.problems, within, self.search),
            start=self.plan,
            solution=None,
            flown=None,
        )
        carry_out(gentler)
        if gentler.plan.is_verified:
            self.solution, self.flown = gentler.solution, gentler.flown
        return gentler.found.status.value


def guess_from(plan: Plan, scenario: Scenario) -> dict[str, Any]:
    """Return a plan as an initial guess for a mission with the same waypoints.

    Names of states and controls map to values at the n nodes of the plan. Names of the mission's
    free times, such as its duration, map to their values in the plan [s]. "time" maps to the times
    of the nodes [s], rescaled between waypoints: the plan's passing times become the scenario's
    `nominal_times`.
    """
    held, times = plan.trajectories, plan.trajectories.node_times
    guess = dict(zip(held.state_names, held.states.T, strict=True))
    guess |= dict(zip(held.control_names, held.controls_at(times).T, strict=True))
    waypoints, reached = scenario.mission.waypoints, plan.passing_times_s
    if len(reached) != len(waypoints):
        return guess | {"time": times}
    passed = [t + hold for t, w in zip(reached, waypoints, strict=True) for hold in (0.0, w.hold)]
    nominal = np.interp(times, [0.0, *passed, times[-1]], [0.0, *scenario.nominal_times])
    return guess | chosen_times(scenario, reached, float(times[-1])) | {"time": nominal}
