"""Limits made stricter where a simulated flight breaks them, and solved again.

A solution keeps its limits at the collocation points. Between them its path may cut the corner of a
zone, or sink below the floor. With a limit that is stricter by the violation, the path between the
points just keeps the limit of the mission. The energy that this costs is known: the solution within
the original limits is the optimum of a problem that allows more. See docs/theory/tracking.md, eq.
(6).
"""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from pyomo_quad.flight.limit_words import excess
from pyomo_quad.scenario.accuracy import FIGURES, Accuracy

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping

    from pyomo_quad.collocation import Mesh, Solution
    from pyomo_quad.flight.mission_problem import MissionProblem
    from pyomo_quad.flight.plan import Plan

# Parameters of limits, and the sign of the change that makes the limit stricter, by the name of the
# limit without its index. A parameter with braces has the index of the limit; one that ends with a
# comma stands for all parameters whose names begin so.
_FLOOR, _CEILING = "airspace.floor", "airspace.ceiling"
_STRICTER = {
    "airspace.ceiling_limit": (_CEILING, -1.0),
    "airspace.floor_limit": (_FLOOR, 1.0),
    "airspace.keep_out": ("airspace.radius[{},", 1.0),
    "limits.pitch_limit": ("limits.pitch_max", -1.0),
    "limits.roll_limit": ("limits.roll_max", -1.0),
    "limits.speed_limit": ("limits.speed_max", -1.0),
    "limits.thrust_limit": ("limits.thrust_max", -1.0),
    "mission.hold_distance": ("mission.passing_radius[{}]", -1.0),
    "mission.passing_near": ("mission.passing_radius[{}]", -1.0),
    "mission.passing_speed": ("mission.passing_speed_max[{}]", -1.0),
    "mission.yaw_keeping": ("mission.turning_max", -1.0),
}
# Parameters of the heights at which a mission starts and ends.
_ENDS = ("mission.start_z", "mission.goal_z")
# Violation of a limit, relative to the larger of 1 and the limit, above which a stricter limit is
# not tried; and the change of the limit relative to the violation, since the violation between the
# points of another mesh may be somewhat larger.
_SLIGHT, _MORE = 0.5, 1.2
# Number of parts into which an element is split if the flight violated a limit in it.
_PARTS = 4
# Largest share of a positive limit, such as a radius, by which it becomes stricter.
_MOST = 0.5


def _opts(o):
    import os, json

    e = json.loads(os.environ.get("TIGHT", "{}"))
    return replace(o, extra=(*o.extra, *e.items()))


def within_limits(
    mission: MissionProblem,
    relaxed: Solution,
    plan: Plan,
    accuracy: Accuracy,
    fly: Callable[[Solution], Plan],
) -> Iterator[Plan]:
    """Yield plans that keep the limits which the simulated flight of a plan breaks slightly.

    Each is solved on one mesh with limits that are stricter by the violations found so far. The
    elements in which the flight broke a limit are split.

    Parameters
    ----------
    mission : MissionProblem
    relaxed : Solution
        Solution of the plan.
    plan : Plan
        Plan with the result of its simulation.
    accuracy : Accuracy
        Accuracy whose tolerance on limits is asked for.
    fly : callable
        Takes a solution; returns its plan with the result of the simulation.

    Yields
    ------
    Plan
        Plans whose solutions have the parameters of the mission; none if a solve fails, if the
        package knows no parameter of a broken limit, or if no limit is broken.
    """
    numbers = dict(mission.arguments["parameters"] or {})
    changes: Counter[str] = Counter()
    last = relaxed
    while True:
        more = stricter_limits(plan, accuracy, numbers)
        if not more:
            return
        changes.update(more)
        broken = elements_with_breaches(plan, last.mesh_in_time, accuracy)
        found = mission.solve(
            _changed(numbers, changes),
            tolerance=None,
            options=_opts(mission.arguments["options"]),
            mesh=split_elements(last.mesh, broken),
            warm_start=last,
        )
        if not found.status.is_solved:
            return
        last = found
        # The finer mesh has the errors of the mesh of the relaxed solution at most.
        own = replace(
            found,
            instance=relaxed.instance,
            history=relaxed.history,
            error_estimate=relaxed.error_estimate,
        )
        plan = fly(own)
        yield plan


def stricter_limits(
    plan: Plan, accuracy: Accuracy, numbers: Mapping[str, float]
) -> dict[str, float]:
    """Return the changes of parameters that make the limits broken by a plan's flight stricter.

    Parameters
    ----------
    plan : Plan
        Plan with the result of its simulation.
    accuracy : Accuracy
        Accuracy whose tolerance on limits is asked for.
    numbers : mapping
        Full name of a parameter -> value, for the mission.

    Returns
    -------
    dict
        Full name of a parameter -> change to add. It is empty if the flight breaks no limit, if a
        violation is large, or if the package knows no parameter of a broken limit.
    """
    if plan.flown is None:
        return {}
    flown, changes = plan.flown, dict[str, float]()
    for breach in plan.dynamics.violations(flown.t, flown.states, flown.controls):
        if breach.relative <= FIGURES[accuracy].breach:
            continue
        limit, _, index = breach.name.partition("[")
        if breach.relative > _SLIGHT or limit not in _STRICTER:
            return {}
        parameter, sign = _STRICTER[limit]
        name = parameter.format(index.removesuffix("]"))
        names = [n for n in numbers if n == name or (name.endswith(",") and n.startswith(name))]
        if not names:
            return {}
        change = sign * _MORE * excess(breach, plan.dynamics.unit(breach.name))[0]
        for name in names:
            changes[name] = max(changes.get(name, 0.0), change, key=abs)
    return changes


def _changed(numbers: Mapping[str, float], changes: Mapping[str, float]) -> dict[str, float]:
    """Return parameters with changes added, such that start and goal stay within the airspace."""
    found = dict(numbers)
    for name, change in changes.items():
        least = -_MOST * abs(numbers[name])
        found[name] = numbers[name] + (change if change > 0.0 else max(change, least))
    ends = [numbers[name] for name in _ENDS if name in numbers]
    for name, choose in ((_FLOOR, min), (_CEILING, max)):
        if name in found and ends:
            found[name] = choose(found[name], *ends)
    return found


def elements_with_breaches(plan: Plan, mesh: Mesh, accuracy: Accuracy) -> tuple[int, ...]:
    """Return the elements of a mesh in which the simulated flight of a plan violates limits.

    Parameters
    ----------
    plan : Plan
        Plan with the result of its simulation; without one, no element is returned.
    mesh : Mesh
        Mesh whose boundaries are fractions of the plan's horizon in time.
    accuracy : Accuracy
        Sets the tolerated violation.
    """
    if plan.flown is None:
        return ()
    flown = plan.flown
    breaches = plan.dynamics.violations(flown.t, flown.states, flown.controls)
    times = [breach.time for breach in breaches if breach.relative > FIGURES[accuracy].breach]
    return tuple(sorted(set(mesh.locate(plan.trajectories.fractions(np.array(times))).tolist())))


def split_elements(mesh: Mesh, elements: Iterable[int]) -> Mesh:
    """Return a mesh with some elements, given by index, split into `_PARTS` equal parts."""
    return mesh.with_breakpoints(
        mesh.breakpoints[e] + mesh.widths[e] * part / _PARTS
        for e in elements
        for part in range(1, _PARTS)
    )
