"""Best tours against all tours there are, and a best order that wind makes lopsided."""

from itertools import pairwise, permutations
from math import asin, sqrt
from types import SimpleNamespace

import numpy as np
import pytest

from pyomo_quad import load_scenario
from pyomo_quad.collocation import Status
from pyomo_quad.flight import PlanStatus
from pyomo_quad.flight.planning import solve_scenario
from pyomo_quad.flight.tour import best_tours, in_order, leg_energies
from tests.command import PAPER_CALM
from tests.declared_model import scenario
from tests.flights import PLANNER

ON_ONE_MESH = {"elements": 10, "degree": 4, "max_refinements": 0}


def length(costs, tour):
    places = (0, *(k + 1 for k in tour), len(costs) - 1)
    return sum(costs[here, there] for here, there in pairwise(places))


@pytest.mark.parametrize("places", [1, 2, 5, 6])
def test_best_tours_are_the_best_of_all(places):
    costs = np.random.default_rng(places).uniform(1.0, 9.0, (places + 2, places + 2))
    every = sorted(permutations(range(places)), key=lambda tour: length(costs, tour))
    assert best_tours(costs, 3) == every[:3]


def test_a_leg_round_a_mast_is_as_long_as_tangents_and_arc_and_gets_that_share_of_the_time():
    """It was to be flown in the time of the straight line, through the mast, and not found."""
    mast = {"name": "mast", "shape": "cylinder", "centre": [5.0, 0.0], "radius": 2.0}
    told = scenario(
        mission={
            "start": {"position": [0.0, 0.0, 2.0]},
            "waypoints": [{"position": [10.0, 0.0, 2.0]}, {"position": [0.0, 6.0, 2.0]}],
            "goal": {"position": [0.0, 0.0, 3.0]},
            "order": "best",
            "duration": 20.0,
        },
        airspace={"keep_out": [mast | {"bottom": 0.0, "top": 50.0}], "ceiling": 40.0},
    )
    bent = []

    def solve(leg, _mesh, way, _known):
        ends = leg.mission.start.position, leg.mission.goal.position
        bent.extend([ends] * (way is not None))
        return SimpleNamespace(status=Status.CONVERGED, objective=leg.mission.fixed_duration)

    durations = leg_energies(told, solve)
    assert ((0.0, 0.0, 2.0), (10.0, 0.0, 2.0)) in bent
    assert ((0.0, 0.0, 2.0), (0.0, 6.0, 2.0)) not in bent
    tangents = 2.0 * sqrt(5.0**2 - 2.0**2)
    arc = 2.0 * 2.0 * asin(2.0 / 5.0)
    # The way keeps a little clear of the mast, along a polygon.
    assert durations[0, 1] / durations[0, 2] == pytest.approx((tangents + arc) / 6.0, rel=0.02)
    assert np.isinf(durations[0, 3])


def test_a_place_that_is_shut_in_leaves_no_order_and_is_named():
    walls = {"west": ([4, -3], [5, 3]), "east": ([8, -3], [9, 3])}
    walls |= {"north": ([4, 2], [9, 3]), "south": ([4, -3], [9, -2])}
    zones = ", ".join(
        f"{{name='{name}', shape='box', low={[*low, -9]}, high={[*high, 9]}}}"
        for name, (low, high) in walls.items()
    )
    settings = (
        "mission.waypoints=[{position=[6.5, 0, 2]}, {position=[1, 6, 2]}]",
        "mission.order='best'",
        "airspace.floor=0.0",
        "airspace.ceiling=8.5",
        "mission.start.position=[0, 0, 2]",
        f"airspace.keep_out=[{zones}]",
    )
    plan = solve_scenario(load_scenario(PAPER_CALM, settings))
    assert plan.status is PlanStatus.INFEASIBLE
    assert "west" in plan.message


def corners(order="best", mirrored=1.0):
    places = [(4.0, 3.0, 1.0), (1.0, 2.0, 1.0), (3.0, -1.0, 2.0)]
    return scenario(
        mission={
            "goal": {"position": [0.0, 0.0, 2.0]},
            "waypoints": [{"position": [x, mirrored * y, z]} for x, y, z in places],
            "order": order,
            "duration": 9.0,
        },
        solver=ON_ONE_MESH,
    )


@pytest.mark.slow
def test_the_best_order_is_the_cheapest_of_all_missions():
    planner = PLANNER
    plan = planner.solve(corners())
    others = [planner.solve(in_order(corners(), order)) for order in permutations(range(3))]
    best = min(others, key=lambda other: other.energy)
    assert plan.scenario.mission.waypoints == best.scenario.mission.waypoints
    # From a warm start bounds are kept between the points too, which shows on a mesh this coarse.
    again = planner.solve(best.scenario, warm_start=best)
    assert plan.energy == pytest.approx(again.energy, rel=1e-6)


@pytest.mark.slow
def test_a_mirror_image_mission_has_the_mirror_image_order():
    plan, image = (PLANNER.solve(corners(mirrored=side)) for side in (1.0, -1.0))
    ordered = [w.position for w in plan.scenario.mission.waypoints]
    assert [w.position for w in image.scenario.mission.waypoints] == [
        (x, -y, z) for x, y, z in ordered
    ]
