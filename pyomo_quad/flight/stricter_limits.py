"""Limits made stricter where a simulated flight breaks them, and solved again.

A solution keeps its limits at the collocation points. Between them its path may cut the corner of a
zone, or sink below the floor. With a limit that is stricter by the violation, the path between the
points just keeps the limit of the mission. The energy that this costs is known: the solution within
the original limits is the optimum of a problem that allows more. See docs/theory/tracking.md, eq.
(6).
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from math import ceil
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from pyomo_quad.flight.limit_words import excess
from pyomo_quad.flight.verdict import energy_of
from pyomo_quad.scenario.accuracy import FIGURES, Accuracy

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping

    from pyomo_quad.collocation import Mesh, Solution, Violation
    from pyomo_quad.flight.plan import Plan
    from pyomo_quad.scenario import Scenario

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
    "limits.rotor_speed_limit": ("limits.rotor_speed_max", -1.0),
    "limits.speed_limit": ("limits.speed_max", -1.0),
    "limits.thrust_limit": ("limits.thrust_max", -1.0),
    "mission.hold_distance": ("mission.hovering_distance_max", -1.0),
    "mission.hold_speed": ("mission.hovering_speed_max", -1.0),
    "mission.passing_near": ("mission.passing_radius[{}]", -1.0),
    "mission.passing_speed": ("mission.passing_speed_max[{}]", -1.0),
}
# Parameters of the heights at which a mission starts and ends.
_ENDS = ("mission.start_z", "mission.goal_z")
# Violation of a limit, relative to the larger of 1 and the limit, above which a stricter limit is
# not tried.
_SLIGHT = 0.5
# Part of the tolerance on a limit that violations may use up; change of a limit relative to the
# rest of its violation, somewhat more because the violation between the points of another mesh may
# be larger; and the factor on all changes if they cost more energy than the accuracy allows.
_ALLOWED, _MORE, _LESS = 0.5, 1.2, 0.5
# Factors by which points lie closer together in windows around zones that a path cuts, and around
# zones whose larger clearance costs too much.
_DENSER, _DENSEST = 3, 8
# The limit that has a lower bound as well, which its parameter does not change.
_ROTOR_SPEED = "limits.rotor_speed_limit"
# Limits whose corners paths cut.
_CORNERS = "airspace.keep_out"
# Shortest element of a window [s].
_SHORTEST_S = 1e-3
# Largest share of a positive limit, such as a radius, by which it becomes stricter.
_MOST = 0.5


class Mission(Protocol):
    """Solver of one mission; `flight.mission_problem` has the class."""

    told: Scenario

    @property
    def arguments(self) -> dict[str, Any]:
        """Arguments of `Problem.solve` for the mission, by name."""

    def solve(self, numbers: dict[str, float], **chosen: Any) -> Solution:
        """Solve the mission with other parameter values and arguments."""


def within_limits(
    mission: Mission,
    relaxed: Solution,
    plan: Plan,
    accuracy: Accuracy,
    fly: Callable[[Solution, float], Plan],
) -> Iterator[Plan]:
    """Yield plans that keep the limits which the simulated flight of a plan breaks slightly.

    Each plan is solved on one mesh, which is finer at the times of the violations found so far, and
    with limits that are stricter because of these violations. If a plan keeps all limits, but its
    stricter limits cost too much energy, they are relaxed again on a still finer mesh.

    Parameters
    ----------
    mission : Mission
    relaxed : Solution
        Solution of the plan.
    plan : Plan
        Plan with the result of its simulation.
    accuracy : Accuracy
        Accuracy whose tolerance on limits is asked for.
    fly : callable
        Takes a solution and an estimate of the least energy [J]; returns the solution's plan with
        the result of the simulation.

    Yields
    ------
    Plan
        Plans whose solutions have the parameters of the mission; none if a solve fails, if a limit
        is broken by a large amount or has no parameter, or if no limit is broken.
    """
    numbers = dict(mission.arguments["parameters"] or {})
    margins, cuts = dict[str, float](), dict[str, float]()
    last = relaxed
    while True:
        strict = _changed(numbers, margins)
        windows = _windows(plan, accuracy, {name: strict[name] for name in margins})
        broken = broken_limits(plan, accuracy)
        denser = _DENSER
        if broken:
            found_now = _by_parameter(plan, broken, numbers, accuracy)
            for name, (violation, change) in found_now.items():
                cuts.setdefault(name, violation)
                margins[name] = margins.get(name, 0.0) + change
        elif margins and plan.error_estimate > FIGURES[accuracy].energy:
            denser = _DENSEST
            for name in margins:
                margins[name] *= _LESS
        else:
            return
        if not all(_helps(breach) for breach in broken):
            return
        found = mission.solve(
            _changed(numbers, margins),
            tolerance=None,
            mesh=_denser_mesh(last, windows, denser),
            warm_start=last,
            options=mission.arguments["options"].for_other_limits(),
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
        plan = fly(own, _least_energy(mission, relaxed, found, margins, cuts))
        yield plan


def _least_energy(
    mission: Mission,
    relaxed: Solution,
    strict: Solution,
    margins: Mapping[str, float],
    cuts: Mapping[str, float],
) -> float:
    """Estimate the least energy of a mission [J] from two solutions on either side of its limits.

    The relaxed solution breaks limits between its points, by the amounts `cuts`; in the other
    solution they are stricter by `margins`. Between the two, the energy changes in proportion to
    the limits, to first order.
    """
    low, high = (energy_of(mission.told, solution) for solution in (relaxed, strict))
    shares = (abs(m) / max(abs(m) + abs(cuts[name]), 1e-300) for name, m in margins.items())
    return high - max(shares, default=0.0) * (high - low)


def broken_limits(plan: Plan, accuracy: Accuracy) -> tuple[Violation, ...]:
    """Return the violations of limits in a plan's flight that exceed an accuracy's tolerance."""
    if plan.flown is None:
        return ()
    flown, allowed = plan.flown, FIGURES[accuracy].breach
    found = plan.dynamics.violations(flown.t, flown.states, flown.controls)
    return tuple(breach for breach in found if breach.relative > allowed)


def _helps(breach: Violation) -> bool:
    """Return whether a stricter limit helps against a violation, and not only a finer mesh."""
    is_known = breach.name.partition("[")[0] in _STRICTER
    is_of_other_side = breach.name.startswith(_ROTOR_SPEED) and not breach.is_above
    return is_known and breach.relative <= _SLIGHT and not is_of_other_side


def _by_parameter(
    plan: Plan, broken: Iterable[Violation], numbers: Mapping[str, float], accuracy: Accuracy
) -> dict[str, tuple[float, float]]:
    """Return, by full name of a parameter, how far its limit is broken, and the change against it.

    Parameters
    ----------
    plan : Plan
    broken : iterable of Violation
        The broken limits.
    numbers : mapping
        Full name of a parameter -> value, for the mission.
    accuracy : Accuracy
        Sets the tolerated violation.
    """
    found = dict[str, tuple[float, float]]()
    for breach in broken:
        limit, _, index = breach.name.partition("[")
        parameter, sign = _STRICTER.get(limit, ("", 0.0))
        name = parameter.format(index.removesuffix("]"))
        size = excess(breach, plan.dynamics.unit(breach.name))[0]
        rest = 1.0 - _ALLOWED * FIGURES[accuracy].breach / breach.relative
        for own in numbers:
            if name and (own == name or (name.endswith(",") and own.startswith(name))):
                found[own] = max(found.get(own, (0.0, 0.0)), (size, sign * _MORE * rest * size))
    return found


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


def mesh_where_broken(solution: Solution, plan: Plan, accuracy: Accuracy) -> Mesh:
    """Return the mesh of a solution, finer at the times at which a simulated flight breaks limits.

    Parameters
    ----------
    solution : Solution
    plan : Plan
        Plan of the solution, with the result of its simulation.
    accuracy : Accuracy
        Sets the tolerated violation.
    """
    return _denser_mesh(solution, _windows(plan, accuracy, {}), _DENSER)


def _denser_mesh(solution: Solution, windows: Iterable[tuple[float, float]], denser: int) -> Mesh:
    """Return the mesh of a solution with short elements in given windows of time [s].

    Where a path cuts the corner of a zone, the depth of the cut is proportional to the distance
    between two points. In the windows, the distance is smaller by the factor `denser`; outside, the
    elements stay as they are.
    """
    mesh, cuts = solution.mesh, list[float]()
    for window in windows:
        first, last = np.clip(solution.timeline.fraction(np.array(window)), 0.0, 1.0)
        for e, (start, end) in enumerate(pairwise(mesh.breakpoints)):
            low, high = max(first, start), min(last, end)
            if low < high:
                parts = ceil(denser * (high - low) / mesh.widths[e])
                cuts.extend(np.linspace(low, high, parts + 1).tolist())
    shortest = _SHORTEST_S / (solution.horizon[1] - solution.horizon[0])
    known = np.asarray(mesh.breakpoints)
    kept: list[float] = []
    for cut in sorted(cuts):
        if np.abs(known - cut).min() > shortest and (not kept or cut - kept[-1] > shortest):
            kept.append(cut)
    return mesh.with_breakpoints(kept)


def _windows(
    plan: Plan, accuracy: Accuracy, numbers: Mapping[str, float]
) -> list[tuple[float, float]]:
    """Return start and end [s] of the windows in which a flight cuts through zones.

    Each window extends beyond the violation by its duration, since the optimum on a finer mesh may
    pass the zone a little earlier or later.

    Parameters
    ----------
    plan : Plan
        Plan with the result of its simulation.
    accuracy : Accuracy
        Sets the tolerated violation.
    numbers : mapping
        Parameters of stricter limits, by full name.
    """
    if plan.flown is None:
        return []
    flown, dynamics, found = plan.flown, plan.dynamics, list[tuple[float, float]]()
    instants = dynamics.solved(flown.t, flown.states, flown.controls, numbers)
    for limit in dynamics.limits_of(instants):
        if not limit.name.startswith(_CORNERS):
            continue
        is_beyond = limit.relative_violations > FIGURES[accuracy].breach
        edges = np.flatnonzero(np.diff(np.concatenate([[0], is_beyond.astype(int), [0]])))
        for first, after in zip(edges[::2], edges[1::2], strict=True):
            start = float(flown.t[max(first - 1, 0)])
            end = float(flown.t[min(after, len(flown.t) - 1)])
            found.append((start - (end - start), end + (end - start)))
    return found
