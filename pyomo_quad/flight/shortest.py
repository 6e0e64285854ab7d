"""The shortest flight: in how little time the limits let a mission be flown."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from pyomo_quad.collocation import Mesh, Progress, Solution, SolverOptions, Status, solve
from pyomo_quad.model import ask_for_least_time

if TYPE_CHECKING:
    from pyomo_quad.scenario import Scenario

__all__ = ["shortest_flight"]

_MESH = (10, 4)
_OPTIONS = SolverOptions(tolerance=1e-7, max_iterations=300)
# The multiples of the mission's duration between which the shortest flight is looked for, and
# the slow, easy one that the search starts from.
_RANGE = (0.01, 100.0)
_SLOW = 4.0


def shortest_flight(model: Any, scenario: Scenario, progress: Progress | None) -> Solution | None:
    """Fly the mission of a model in the least time.

    Parameters
    ----------
    model : ConcreteModel
        Of the scenario; its objective is replaced.
    scenario : Scenario
    progress : callable or None
        Called at each iteration; returning False stops the solve.

    Returns
    -------
    Solution or None
        Its objective is the time [s]; None when the solve failed.
    """
    duration = scenario.mission.duration
    bounds = (factor * duration for factor in _RANGE)
    solution = solve(
        model,
        final_time=ask_for_least_time(model, bounds, _SLOW * duration),
        mesh=Mesh.uniform(*_MESH),
        options=_OPTIONS,
        progress=progress,
    )
    return solution if solution.status is Status.CONVERGED else None
