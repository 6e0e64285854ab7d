"""Least duration of a mission, and plans of least energy close to it."""

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

_MESH = (10, 4)
_OPTIONS = SolverOptions(max_iterations=300)
# Meshes that give the least time to a small part of the share of it that counts as close.
_FEW_MESHES = 3
_CLOSE = 2e-3
# The multiples of the mission's duration between which the shortest flight is looked for, and
# the slow, easy one that the search starts from.
_RANGE = (0.01, 100.0)
_SLOW = 4.0
# To what share of it the least time is known where it is what is asked for: a limit broken between
# the points counts by the time it saves, and the damping has the price that it has by default.
_TIME_TOLERANCE = 1e-4
_TIMED = RefinementOptions(damping=1.0, allowance=Allowance(limit_breach=inf))
# How much longer than the least time flights are that come closer and closer to it: the last is
# bang-bang, and hard to prove.  A step closer ends after so many times the effort of the first.
_ABOVE_LEAST = (1e-2, 3e-3, 1e-3, 3e-4)
_MOST_EFFORT = 3.0


def shortest_flight(
    model: Any, scenario: Scenario, progress: Progress | None, *, is_exact: bool = False
) -> Solution | None:
    """Solve for the least duration of a mission.

    A few meshes do unless the mission's duration is close to what they give: then they are
    refined to the mission's own tolerance, for a time that is asked for to `_TIME_TOLERANCE`.

    Parameters
    ----------
    model : ConcreteModel
        Model of the scenario; its objective is replaced.
    scenario : Scenario
    progress : callable or None
        Called at each iteration; returning False stops the solve.
    is_exact : bool, optional
        Refine the time wherever it lies.

    Returns
    -------
    Solution or None
        Its objective is the time [s]; None when the solve failed.
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
            # It goes on with what it began: what the beginning took says nothing of the rest.
            warm_start=None if start is None else replace(start.warm_start, cold_start=None),
            options=_OPTIONS,
            refinement=replace(refinement, max_meshes=meshes),
            progress=progress,
        )
        if not solution.status.is_solved:
            break
        shortest = start = solution
        if abs(solution.objective - duration) > _CLOSE * duration:
            break
    return shortest


def declared_free_times(model: Any, scenario: Scenario) -> dict[float, Any]:
    """Return the variables of a model that hold its free times, by declared time.

    Raises
    ------
    ScenarioError
        If a model of the user's own lacks one.
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
    shortest : Solution
        The flight of the least time.
    solve : callable
        Solves a scenario from a solution.
    search : Search
    """

    scenario: Scenario
    shortest: Solution
    solve: Callable[[Scenario, Solution | None, Search], Plan]
    search: Search
    plans: list[Plan] = field(default_factory=list)
    _most: float = inf

    @property
    def durations(self) -> tuple[float, ...]:
        """Durations of the sequence, within the mission's limits [s]."""
        least, greatest = self.scenario.mission.duration_limits
        above = ((1 + share) * self.shortest.objective for share in _ABOVE_LEAST)
        return tuple(dict.fromkeys(min(max(time, least), greatest) for time in above))

    def goes_on(self) -> bool:
        """Return whether to try a shorter duration: no plan yet, or the last one is verified."""
        return not self.plans or self.plans[-1].is_verified

    def fly(self, lasting: float) -> str:
        """Solve the mission in a duration, starting from the last plan, with limited effort."""
        start = self.plans[-1].solution if self.plans else self.shortest
        self.search.begin_effort(self._most)
        self.plans.append(self.solve(self.scenario.lasting(lasting), start, self.search))
        self._most = min(self._most, _MOST_EFFORT * self.search.effort)
        self.search.begin_effort(inf)
        return self.plans[-1].status.value

    @property
    def closest(self) -> Plan:
        """Verified plan of the shortest duration; the first plan if none is verified."""
        best = next((plan for plan in reversed(self.plans) if plan.is_verified), self.plans[0])
        message = (
            f"{best.message} It takes {best.duration_s:.6g} s, where the least time is "
            f"{self.shortest.objective:.6g} s."
        )
        return replace(best, scenario=self.scenario, message=message)
