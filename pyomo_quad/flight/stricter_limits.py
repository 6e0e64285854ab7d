"""Solves with stricter limits, for plans whose simulated flight breaks limits of the mission.

A solution satisfies its limits at the collocation points. Between them its path may cut the corner
of a zone, or go below the floor. The problem is solved again with a limit that is stricter by the
violation. A stricter limit costs energy. The energy of the new plan is therefore compared with an
estimate of the least energy of the mission with its own limits; see docs/theory/tracking.md,
eq. (10).

The solution with the mission's own limits is called relaxed. Arguments `figures` are the tolerances
of an accuracy level, or the wider ones of a usable plan, `scenario.accuracy.USABLE`. A limit is
broken if its violation exceeds them. Arguments `numbers` map full names of parameters to their
values in the mission.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from math import ceil
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from pyomo_quad.collocation import TranscriptionError
from pyomo_quad.flight.flight import spans_where
from pyomo_quad.flight.limit_words import excess
from pyomo_quad.flight.verdict import energy_of
from pyomo_quad.flight.verification import beyond, tolerated
from pyomo_quad.scenario.accuracy import USABLE

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping

    from pyomo_quad.collocation import Mesh, Solution, Violation
    from pyomo_quad.flight.plan import Plan
    from pyomo_quad.scenario import Scenario
    from pyomo_quad.scenario.accuracy import Figures

# Name of a limit without its index -> the parameter that sets the limit, and the sign of the change
# that makes the limit stricter. Braces in the name of a parameter stand for the index of the limit.
# A name that ends with a comma stands for all parameters whose names begin with it.
_FLOOR, _CEILING = "airspace.floor", "airspace.ceiling"
_STRICTER = {
    "airspace.ceiling_limit": (_CEILING, -1.0),
    "airspace.floor_limit": (_FLOOR, 1.0),
    "airspace.keep_out": ("airspace.radius[{},", 1.0),
    "limits.pitch_limit": ("limits.pitch_max", -1.0),
    "limits.roll_limit": ("limits.roll_max", -1.0),
    "limits.speed_limit": ("limits.speed_max", -1.0),
    "mission.hold_distance": ("mission.hovering_distance_max", -1.0),
    "mission.hold_speed": ("mission.hovering_speed_max", -1.0),
    "mission.passing_near": ("mission.passing_radius[{}]", -1.0),
    "mission.passing_speed": ("mission.passing_speed_max[{}]", -1.0),
    "limits.rotor_speed_limit": ("limits.rotor_speed_max", -1.0),
    "limits.thrust_limit": ("limits.thrust_max", -1.0),
}
# Limits of which a margin of a thousandth costs about a thousandth of the energy.
_DEAR = ("limits.rotor_speed_limit", "limits.thrust_limit")
# Parameters of the heights at which a mission starts and ends.
_ENDS = ("mission.start_z", "mission.goal_z")
# Violation of a limit, relative to the larger of 1 and the limit, above which a stricter limit is
# not tried.
_SLIGHT = 0.5
# Violation of a limit that may remain after the next solve, relative to the tolerance. Change of a
# limit relative to the rest of its violation: above 1, because the violation between the points of
# another mesh may be larger. Factor on all changes if they cost more energy than the accuracy
# allows.
_ALLOWED, _MORE, _LESS = 0.5, 1.2, 0.5
# Factors by which the mesh is refined at the times at which a path cuts through a zone, and at the
# times at which a stricter limit on the distance from a zone costs too much energy.
_DENSER, _DENSEST = 3, 8
# Limits on the distance from zones, whose corners a path may cut between two collocation points.
_CORNERS = "airspace.keep_out"
# Shortest element of a refined mesh [s].
_SHORTEST_S = 1e-3
# Largest decrease of a parameter that makes its limit stricter, such as a radius, relative to it.
_MOST = 0.5


class Mission(Protocol):
    """Interface of an object that solves one mission, such as `mission_problem.MissionProblem`.

    The attribute `told` is the scenario of the mission with the forecast wind.
    """

    told: Scenario

    @property
    def arguments(self) -> dict[str, Any]:
        """Keyword arguments with which `Problem.solve` solves the mission."""

    def solve(self, numbers: dict[str, float], **chosen: Any) -> Solution:
        """Solve the mission with changed parameter values and further arguments of `Problem.solve`.

        `numbers` maps full names of parameters, changed or not, to values. The keyword arguments
        ``chosen`` replace those of the mission, which the property `arguments` returns.
        """


def within_limits(
    mission: Mission,
    relaxed: Solution,
    plan: Plan,
    figures: Figures,
    fly: Callable[[Solution, float], Plan],
) -> Iterator[Plan]:
    """Yield plans with stricter limits, for a plan whose simulated flight breaks limits slightly.

    `plan` was made from `relaxed`, the solution with the mission's own limits. A limit is broken if
    its violation exceeds the tolerances `figures`. `fly` takes a solution and the estimated least
    energy [J], and returns a simulated plan. The iteration ends when limits are kept or stricter
    limits do not help.
    """
    numbers = dict(mission.arguments["parameters"] or {})
    margins, cuts = dict[str, float](), dict[str, float]()
    last, has_relaxed = relaxed, False
    while True:
        strict = _changed(numbers, margins)
        windows = _windows(plan, figures, {name: strict[name] for name in margins})
        broken = broken_limits(plan, figures)
        denser = _DENSER
        # The limits are broken again after they were made less strict to save energy.
        if broken and has_relaxed:
            return
        if broken:
            found_now = _by_parameter(plan, broken, numbers, figures)
            for name, (violation, change) in found_now.items():
                cuts.setdefault(name, violation)
                margins[name] = margins.get(name, 0.0) + change
        elif margins and plan.error_estimate > figures.energy and figures is not USABLE:
            # The flight keeps limits that are too strict, at more energy than the accuracy allows.
            # The next solve has less strict limits and an even finer mesh.
            denser, has_relaxed = _DENSEST, True
            for name in margins:
                margins[name] *= _LESS
        else:
            return
        if not all(_helps(breach, figures) for breach in broken):
            return
        try:
            found = mission.solve(
                _changed(numbers, margins),
                tolerance=None,
                mesh=_denser_mesh(last, windows, denser),
                warm_start=last,
                options=mission.arguments["options"].for_other_limits(),
            )
        except TranscriptionError:
            # The stricter limits exclude the state at the start or at the goal.
            return
        if not found.status.is_solved:
            return
        last = found
        # The plan has the parameter values of the mission, without the stricter limits. The errors
        # on the finer mesh are at most those of the relaxed solution.
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
    """Estimate the least energy of a mission [J], by interpolation between two solutions.

    `margins` has the changes of limits in `strict`, by parameter, and `cuts` the violations in the
    flight of `relaxed`. Implements docs/theory/tracking.md, eq. (10).
    """
    low, high = (energy_of(mission.told, solution) for solution in (relaxed, strict))
    # The flight of `relaxed` breaks limits by `cuts`, so that its energy is too low. The energy of
    # `strict`, whose limits are stricter by `margins`, is too high. For several limits, the largest
    # share is used.
    shares = (abs(m) / max(abs(m) + abs(cuts[name]), 1e-300) for name, m in margins.items())
    return high - max(shares, default=0.0) * (high - low)


def broken_limits(plan: Plan, figures: Figures) -> tuple[Violation, ...]:
    """Return the violations of limits in a plan's simulated flight that exceed a tolerance.

    `figures` has the tolerances of an accuracy level. A plan that was not simulated gives an empty
    result.
    """
    if plan.flown is None:
        return ()
    flown = plan.flown
    found = plan.dynamics.violations(flown.t, flown.states, flown.controls)
    return beyond(found, figures)


def _helps(breach: Violation, figures: Figures) -> bool:
    """Return whether a stricter limit is worth trying for a violated limit.

    The result is True if a parameter sets the limit, and the violation is at most 0.5 max(1,
    abs(limit)). For thrust and rotor speed, it is False unless `figures` is `USABLE`.
    """
    name = breach.name.partition("[")[0]
    # Stricter limits on rotor speed and thrust cost more energy than any accuracy level tolerates.
    # Only the tolerances of a usable plan are wide enough.
    is_affordable = name not in _DEAR or figures is USABLE
    return name in _STRICTER and is_affordable and breach.relative <= _SLIGHT


def _by_parameter(
    plan: Plan, broken: Iterable[Violation], numbers: Mapping[str, float], figures: Figures
) -> dict[str, tuple[float, float]]:
    """Return the violation of each broken limit, and the change that makes the limit stricter.

    The keys are parameters in `numbers`, and the values have their units. The violation is
    positive, the change of either sign. `broken` has the violations in the flight of `plan`.
    """
    found = dict[str, tuple[float, float]]()
    for breach in broken:
        limit, _, index = breach.name.partition("[")
        parameter, sign = _STRICTER.get(limit, ("", 0.0))
        name = parameter.format(index.removesuffix("]"))
        size = excess(breach, plan.dynamics.unit(breach.name))[0]
        rest = 1.0 - _ALLOWED * tolerated(breach, figures) / breach.size
        for own in numbers:
            if name and (own == name or (name.endswith(",") and own.startswith(name))):
                found[own] = max(found.get(own, (0.0, 0.0)), (size, sign * _MORE * rest * size))
    return found


def _changed(numbers: Mapping[str, float], changes: Mapping[str, float]) -> dict[str, float]:
    """Return parameter values with changes added, for a solve with stricter limits.

    A parameter decreases by at most half. The floor rises at most to the lower of start and goal.
    The ceiling falls at most to the higher of the two.
    """
    found = dict(numbers)
    for name, change in changes.items():
        least = -_MOST * abs(numbers[name])
        found[name] = numbers[name] + (change if change > 0.0 else max(change, least))
    # The floor stays at or below start and goal, and the ceiling at or above them, so that the
    # mission stays feasible.
    ends = [numbers[name] for name in _ENDS if name in numbers]
    for name, choose in ((_FLOOR, min), (_CEILING, max)):
        if name in found and ends:
            found[name] = choose(found[name], *ends)
    return found


def mesh_where_broken(solution: Solution, plan: Plan, figures: Figures) -> Mesh:
    """Return the mesh of a solution, refined at the times at which its flight enters zones.

    The flight is the simulated flight of `plan`, made from the solution. `figures` has the
    tolerances.
    """
    return _denser_mesh(solution, _windows(plan, figures, {}), _DENSER)


def _denser_mesh(solution: Solution, windows: Iterable[tuple[float, float]], denser: int) -> Mesh:
    """Return the mesh of a solution with shorter elements during given windows of time [s].

    In a window, elements have at most 1 / `denser` of the old length.
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
    plan: Plan, figures: Figures, numbers: Mapping[str, float]
) -> list[tuple[float, float]]:
    """Return periods (start, end) [s] around the times at which a plan's flight enters zones.

    The mesh is refined in these periods. The flight is the simulated one. Here `numbers` has only
    the stricter limits with which `plan` was solved, by parameter.
    """
    if plan.flown is None:
        return []
    flown, dynamics, found = plan.flown, plan.dynamics, list[tuple[float, float]]()
    allowed = min(figures.breach, figures.intrusion)
    instants = dynamics.solved(flown.t, flown.states, flown.controls, numbers)
    for limit in dynamics.limits_of(instants):
        if not limit.name.startswith(_CORNERS):
            continue
        for first, after in spans_where(limit.relative_violations > allowed):
            start = float(flown.t[max(first - 1, 0)])
            end = float(flown.t[min(after, len(flown.t) - 1)])
            # The optimum on a finer mesh may pass the zone a little earlier or later.
            found.append((start - (end - start), end + (end - start)))
    return found
