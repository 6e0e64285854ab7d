"""Minimum-time problem of a mission, and plans of least energy in nearly the least duration."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from math import inf
from typing import TYPE_CHECKING, Any

from pyomo_quad.collocation import Allowance, Mesh, RefinementOptions, SolverOptions, compile
from pyomo_quad.model import ask_for_least_time
from pyomo_quad.model.mission import free_times
from pyomo_quad.scenario import ScenarioError

if TYPE_CHECKING:
    from collections.abc import Callable

    from pyomo_quad.collocation import Progress, Solution
    from pyomo_quad.flight.plan import Plan
    from pyomo_quad.flight.search import Search
    from pyomo_quad.scenario import Scenario

# First mesh of a solve for the least time (elements, degree), and its largest number of iterations.
_MESH = (10, 4)
_OPTIONS = SolverOptions(max_iterations=300)
# Number of meshes of a first estimate of the least time. The estimate suffices unless the mission's
# duration differs from it by less than the fraction `_CLOSE`.
_FEW_MESHES = 3
_CLOSE = 2e-3
# Range of the least time, as multiples of the mission's duration, and multiple at which the search
# starts: slow flights are easy.
_RANGE = (0.01, 100.0)
_SLOW = 4.0
# Relative tolerance of a least time that is itself the objective of the mission. Violations of
# limits between the collocation points then count by the time that they save, and the damping of
# controls keeps its default weight.
_TIME_TOLERANCE = 1e-4
_TIMED = RefinementOptions(damping=1.0, allowance=Allowance(limit_breach=inf))
# Durations of the flights that approach the least time, relative to it: the flight of least time is
# bang-bang and hard to verify.
_ABOVE_LEAST = (1e-2, 3e-3, 1e-3, 3e-4)
# Largest effort of a solve for one of these durations, relative to the cheapest solve before.
_MOST_EFFORT = 3.0


def shortest_flight(
    model: Any, scenario: Scenario, progress: Progress | None, *, is_exact: bool = False
) -> Solution | None:
    """Solve for the least duration in which a mission is possible.

    The duration is the objective of the result [s], and replaces the objective of `model`. If
    `is_exact`, its relative tolerance is 1e-4. Otherwise, the tolerance is `solver.tolerance`.
    In this case, refinement ends after three meshes unless the result is within 0.2 % of the
    nominal duration. The result is None if the first solve fails or is stopped. Raises
    the ScenarioError of `declared_free_times`.
    """
    duration, settings = scenario.nominal_duration, scenario.solver
    bounds = _RANGE[0] * duration, _RANGE[1] * duration
    free = declared_free_times(model, scenario)
    end = ask_for_least_time(model, bounds, _SLOW * duration)
    problem = compile(model, times=free | {scenario.nominal_duration: end})
    most = settings.max_refinements + 1
    tolerance = _TIME_TOLERANCE if is_exact else settings.tolerance
    refinement = _TIMED if is_exact else RefinementOptions()
    shortest, start = None, None
    for meshes in (most,) if is_exact else (_FEW_MESHES, most):
        solution = problem.solve(
            mesh=Mesh.uniform(*_MESH) if start is None else start.mesh,
            tolerance=tolerance,
            # Without the iteration count of the first meshes, above which a warm-started solve is
            # restarted cold: it does not predict the count on further meshes.
            warm_start=None if start is None else replace(start.warm_start, cold_start=None),
            options=_OPTIONS,
            refinement=replace(refinement, max_meshes=meshes),
            progress=progress,
        )
        # If only the second solve fails, the result is that of the first.
        if not solution.status.is_solved:
            break
        shortest = start = solution
        # Only a result close to the prescribed duration must be accurate, to show whether that
        # duration is long enough.
        if abs(solution.objective - duration) > _CLOSE * duration:
            break
    return shortest


def declared_free_times(model: Any, scenario: Scenario) -> dict[float, Any]:
    """Return nominal time [s] -> Pyomo variable, for each time that a solve is free to choose.

    These times are a free duration, and the arrival and (after a hover) departure at waypoints.
    The nominal time is an estimate, and a member of the model's time set. The constraints that the
    model declares at this member hold at the free time. Raises a ScenarioError if a user's own
    model lacks the variable "duration" or "mission.passing_time" that the mission needs.
    """
    mission = scenario.mission
    wanted = {"duration": mission.is_free, "mission.passing_time": bool(mission.waypoints)}
    for name, is_wanted in wanted.items():
        if is_wanted and model.find_component(name) is None:
            said = 'duration = "free"' if name == "duration" else "waypoints"
            raise ScenarioError(
                f"{scenario.name}: mission.{said}; the model of {scenario.model} must declare "
                f'a variable "{name}", as build_model does: add it or change the mission.'
            )
    return free_times(model, scenario)


@dataclass
class Approach:
    """Sequence of plans whose durations decrease towards the least duration of a mission.

    Attributes
    ----------
    scenario : Scenario
        The mission of least time.
    shortest : Solution
        Solution of least duration.
    solve : callable
        Takes a scenario of fixed duration, an initial solution (or None) and `search`; returns a
        plan.
    search : Search
        Progress callback, which stops expensive solves.
    plans : list of Plan
        Plans made so far, in order of decreasing duration, each of least energy for its duration.
    """

    scenario: Scenario
    shortest: Solution
    solve: Callable[[Scenario, Solution | None, Search], Plan]
    search: Search
    plans: list[Plan] = field(default_factory=list)
    _most: float = inf

    @property
    def durations(self) -> tuple[float, ...]:
        """Durations for which the mission is solved, in this order [s].

        They decrease towards the least duration, and are slightly above it. All are within the
        mission's limits on its duration.
        """
        least, greatest = self.scenario.mission.duration_limits
        above = ((1 + share) * self.shortest.objective for share in _ABOVE_LEAST)
        return tuple(dict.fromkeys(min(max(time, least), greatest) for time in above))

    def goes_on(self) -> bool:
        """Return whether to solve for the next duration.

        The result is True if there is no plan yet, or if the last plan is verified: a simulation
        confirms it to the accuracy that the mission requests.
        """
        return not self.plans or self.plans[-1].is_verified

    def fly(self, lasting: float) -> str:
        """Solve the mission for a duration of ``lasting`` [s], and append the plan to `plans`.

        The result is the status of the plan in words. The solve starts from the previous plan, or
        first from `shortest`. The solve is stopped at three times the `Search.effort` of the
        cheapest earlier solve.
        """
        start = self.plans[-1].solution if self.plans else self.shortest
        self.search.begin_effort(self._most)
        self.plans.append(self.solve(self.scenario.lasting(lasting), start, self.search))
        self._most = min(self._most, _MOST_EFFORT * self.search.effort)
        self.search.begin_effort(inf)
        return self.plans[-1].status.value

    @property
    def closest(self) -> Plan:
        """Verified plan of the shortest duration, or the first plan if none is verified.

        Its scenario is the attribute `scenario`, without the fixed duration of the solve. Its
        message ends with its duration and the least duration of the mission.
        """
        best = next((plan for plan in reversed(self.plans) if plan.is_verified), self.plans[0])
        message = (
            f"{best.message} It takes {best.duration_s:.6g} s, where the least time is "
            f"{self.shortest.objective:.6g} s."
        )
        return replace(best, scenario=self.scenario, message=message)
