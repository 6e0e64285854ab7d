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

    A first solve uses at most three meshes. If its result is close to the prescribed duration, a
    second solve refines the mesh to the mission's tolerance.

    Parameters
    ----------
    model : ConcreteModel
        Model of the scenario; its objective is replaced.
    scenario : Scenario
        The mission, and the solver's settings.
    progress : callable or None
        Called at each Ipopt iteration; returning False stops the solve.
    is_exact : bool, optional
        Whether the least duration is itself the wanted result. If true, there is only one solve,
        which refines the mesh to the relative error `_TIME_TOLERANCE`.

    Returns
    -------
    Solution or None
        Solution whose objective is the least duration [s]. If only the second solve fails, it is
        the solution of the first. None if the first solve fails or is stopped.

    Raises
    ------
    ScenarioError
        If a user's own model lacks a variable for a free time of the mission.
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
        if not solution.status.is_solved:
            break
        shortest = start = solution
        # Only a result close to the prescribed duration must be accurate, to show whether that
        # duration is long enough.
        if abs(solution.objective - duration) > _CLOSE * duration:
            break
    return shortest


def declared_free_times(model: Any, scenario: Scenario) -> dict[float, Any]:
    """Return the variables of a model for the times that the solve is free to choose.

    These free times are the duration, if it is free, and for each waypoint the time at which the
    vehicle arrives and, after a hover, leaves.

    Parameters
    ----------
    model : ConcreteModel
        Model of the scenario.
    scenario : Scenario
        The mission.

    Returns
    -------
    dict
        Nominal value of each free time [s] -> Pyomo variable of this time. The nominal value is the
        scenario's value or estimate, and a point of the model's `ContinuousSet` of times. The
        constraints at a free time are declared at its nominal value.

    Raises
    ------
    ScenarioError
        If a user's own model lacks a variable for a free time.
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

    Each plan has the least energy for its duration. The sequence continues as long as simulation
    verifies each plan.

    Attributes
    ----------
    scenario : Scenario
        The mission, whose objective is the least time.
    shortest : Solution
        Solution of least duration.
    solve : callable
        Solves a scenario of fixed duration and returns a plan. Its arguments are the scenario, a
        solution to start from or None, and `search`.
    search : Search
        Progress callback of the solves. It measures the cost of a solve, and stops a solve that
        costs too much.
    plans : list of Plan
        Plans made so far, in order of decreasing duration.
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

        The solve starts from the previous plan, the first from the solution of least duration. It
        is stopped if its `Search.effort` exceeds three times that of the cheapest solve before.

        Returns
        -------
        str
            Status of the new plan in words, such as "verified" or "not_converged".
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

        It is a copy whose `scenario` is the mission of least time. Its `message` ends with its
        duration and the least duration of the mission.
        """
        best = next((plan for plan in reversed(self.plans) if plan.is_verified), self.plans[0])
        message = (
            f"{best.message} It takes {best.duration_s:.6g} s, where the least time is "
            f"{self.shortest.objective:.6g} s."
        )
        return replace(best, scenario=self.scenario, message=message)
