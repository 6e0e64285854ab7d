"""The order in which waypoints are passed: leg energies, exact tours, and the best few flown."""

from __future__ import annotations

from dataclasses import replace
from math import inf
from typing import TYPE_CHECKING, Any

import numpy as np

from pyomo_quad.collocation import Mesh
from pyomo_quad.scenario.mission import Hover, Order

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from pyomo_quad.flight.plan import Plan
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
        Solve a scenario without waypoints on a mesh: (scenario, mesh, warm start) -> Solution.

    Returns
    -------
    ndarray, shape (n + 2, n + 2)
        From start, waypoints and goal, in rows, to the same, in columns [J]; beside it what the
        time costs.  Infinite where no flight was found, and where no tour goes.
    """
    places, mission = scenario.mission.positions, scenario.mission
    last = len(places) - 1
    costs = np.full((len(places), len(places)), inf)
    known = None
    for here in range(last):
        for there in range(1, len(places)):
            if here == there or (here == 0 and there == last):
                continue
            ends = (Hover(position=places[k], yaw=mission.start.yaw) for k in (here, there))
            leg = scenario.with_mission(
                **dict(zip(("start", "goal"), ends, strict=True)), waypoints=(), order=Order.GIVEN
            )
            if not mission.is_free:
                share = _length(leg) / _usual_length(scenario)
                leg = leg.lasting(share * mission.fixed_duration)
            found = solve(leg, _LEG_MESH, known)
            if found.status.is_solved:
                known = found
                costs[here, there] = found.objective
    return costs


def _length(scenario: Scenario) -> float:
    places = np.array(scenario.mission.positions)
    return float(np.linalg.norm(np.diff(places, axis=0), axis=1).sum())


def _usual_length(scenario: Scenario) -> float:
    """Return the length of the tour that always flies to the nearest place that is left."""
    start, *between, goal = (np.array(place) for place in scenario.mission.positions)
    here, length = start, 0.0
    while between:
        distances = [float(np.linalg.norm(place - here)) for place in between]
        nearest = int(np.argmin(distances))
        length += distances[nearest]
        here = between.pop(nearest)
    return length + float(np.linalg.norm(goal - here))


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
    roughly: Callable[[Scenario], Plan],
    solve: Callable[[Scenario, Plan], Plan],
) -> Plan:
    """Return the plan of the cheapest of some tours, each solved as a whole mission first."""
    attempts, plans = [], []
    for tour in tours:
        plan = roughly(in_order(scenario, tour))
        named = ", ".join(str(k) for k in tour)
        attempts.append(f"waypoints in order {named}: {plan.cost:.6g} J on a first mesh")
        plans.append(plan)
    best = min(plans, key=lambda plan: (plan.verification is None, plan.cost))
    plan = solve(best.scenario, best)
    return replace(plan, attempts=(*attempts, *plan.attempts))
