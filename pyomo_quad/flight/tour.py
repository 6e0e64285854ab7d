"""The order in which waypoints are passed: leg energies, exact tours, and the best few flown."""

from __future__ import annotations

from dataclasses import replace
from itertools import permutations
from math import inf, isinf
from typing import TYPE_CHECKING, Any

import numpy as np

from pyomo_quad.collocation import Mesh
from pyomo_quad.flight.routes import find_routes
from pyomo_quad.scenario.mission import Hover, Order

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from pyomo_quad.collocation import Solution
    from pyomo_quad.flight.plan import Plan
    from pyomo_quad.flight.routes import Route
    from pyomo_quad.scenario import Scenario

#: Tours whose whole missions are solved: leg energies leave out what passing at speed saves.
BEST_FEW = 3
_LEG_MESH = Mesh.uniform(8, 4)
# Places passed and the last of them -> costs and orders.
_Tours = dict[tuple[int, int], list[tuple[float, tuple[int, ...]]]]


def in_order(scenario: Scenario, order: Sequence[int]) -> Scenario:
    """Return a scenario with its waypoints in an order that is given."""
    waypoints = tuple(scenario.mission.waypoints[k] for k in order)
    return scenario.with_mission(waypoints=waypoints, order=Order.GIVEN)


def leg_energies(scenario: Scenario, solve: Callable[..., Any]) -> np.ndarray:
    """Return what it costs to fly from each place to each other, hover to hover.

    Parameters
    ----------
    scenario : Scenario
    solve : callable
        Solve a scenario without waypoints on a mesh: (scenario, mesh, its shortest way round the
        zones or None where that is straight, warm start) -> Solution.

    Returns
    -------
    ndarray, shape (n + 2, n + 2)
        From start, waypoints and goal, in rows, to the same, in columns [J]; beside it what the
        time costs.  Infinite where no flight was found, and where no tour goes; everywhere, where
        zones shut a place in.
    """
    places, mission = scenario.mission.positions, scenario.mission
    ways = _shortest_ways(scenario)
    usual = _usual_length(len(places), ways)
    costs = np.full((len(places), len(places)), inf)
    known = None
    if isinf(usual):
        return costs
    for (here, there), way in ways.items():
        ends = (Hover(position=places[k], yaw=mission.start.yaw) for k in (here, there))
        leg = scenario.with_mission(
            **dict(zip(("start", "goal"), ends, strict=True)), waypoints=(), order=Order.GIVEN
        )
        if not mission.is_free:
            leg = leg.lasting(way.length / usual * mission.fixed_duration)
        found = solve(leg, _LEG_MESH, way if way.sides else None, known)
        if found.status.is_solved:
            known = found
            costs[here, there] = found.objective
    return costs


def _shortest_ways(scenario: Scenario) -> dict[tuple[int, int], Route]:
    """Return the shortest way of each leg that a tour may have and the zones leave open."""
    places, ways = scenario.mission.positions, {}
    last = len(places) - 1
    for here, there in permutations(range(len(places)), 2):
        if there == 0 or here == last or (here, there) == (0, last):
            continue
        for way in find_routes(scenario.airspace, places[here], places[there], most=1):
            ways[here, there] = way
    return ways


def _usual_length(count: int, ways: Mapping[tuple[int, int], Route]) -> float:
    """Return the length of the tour that always flies to the nearest place that is left."""
    lengths = np.full((count, count), inf)
    for leg, way in ways.items():
        lengths[leg] = way.length
    here, left, length = 0, set(range(1, count - 1)), 0.0
    while left:
        nearest = min(left, key=lambda there: lengths[here, there])
        length += lengths[here, nearest]
        left.remove(nearest)
        here = nearest
    return float(length + lengths[here, count - 1])


def best_tours(costs: np.ndarray, count: int) -> list[tuple[int, ...]]:
    """Return the cheapest orders of the places between the first and the last, cheapest first.

    Exact: dynamic programming over the places passed so far and the last of them [1]_, with the
    `count` best of each kept.

    .. [1] Held and Karp, "A dynamic programming approach to sequencing problems", SIAM J. 10
       (1962).
    """
    places = range(1, len(costs) - 1)
    goal = len(costs) - 1
    best: _Tours = {(1 << k, k): [(float(costs[0, k]), (k,))] for k in places}
    for _ in range(len(places) - 1):
        longer: _Tours = {}
        for (passed, here), found in best.items():
            for there in places:
                if passed >> there & 1:
                    continue
                key = (passed | 1 << there, there)
                step = float(costs[here, there])
                longer.setdefault(key, []).extend((c + step, (*tour, there)) for c, tour in found)
        best = {key: sorted(found)[:count] for key, found in longer.items()}
    ended = [(c + float(costs[here, goal]), tour) for (_, here), f in best.items() for c, tour in f]
    return [tuple(k - 1 for k in tour) for _, tour in sorted(ended)[:count]]


def cheapest(
    scenario: Scenario,
    tours: Sequence[Sequence[int]],
    roughly: Callable[[Scenario], Solution],
    solve: Callable[[Scenario, Solution | None], Plan],
) -> Plan:
    """Return the plan of the cheapest of some tours, each solved on one mesh as a whole first."""
    attempts: list[str] = []
    flown: list[tuple[float, Scenario, Solution | None]] = []
    for tour in tours:
        ordered = in_order(scenario, tour)
        solution = roughly(ordered)
        is_flown = solution.status.is_solved
        what = f"{solution.objective:.6g} J" if is_flown else solution.status.value
        named = ", ".join(str(k) for k in tour)
        attempts.append(f"waypoints in order {named}: {what} on a first mesh")
        cost = solution.objective if is_flown else inf
        flown.append((cost, ordered, solution if is_flown else None))
    _, best, begun = min(flown, key=lambda entry: entry[0])
    plan = solve(best, begun)
    return replace(plan, attempts=(*attempts, *plan.attempts))
