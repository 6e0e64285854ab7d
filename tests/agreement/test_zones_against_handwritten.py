"""Flights round zones against programs written by hand, and against their own mirror images."""

import pytest

from pyomo_quad.scenario import load_scenario
from tests.benchmarks.handwritten import solve_by_hand
from tests.command import PAPER_CALM
from tests.flights import PLANNER

# On the straight line from (0, 0) to (6, 7), a little nearer to its right.
X, Y, RADIUS = 3.0, 3.4, 0.8
MAST = {"name": "mast", "shape": "cylinder", "radius": RADIUS, "bottom": -50, "top": 60}
AS_PRINTED = {"vehicle": {"attitude": "paper"}}


def solve(**tables):
    return PLANNER.solve(load_scenario(PAPER_CALM, AS_PRINTED | tables))


def past(x, y):
    return {"keep_out": [MAST | {"centre": [x, y]}]}


@pytest.mark.slow
def test_a_mast_on_the_straight_line_agrees_with_a_program_by_hand():
    plan = solve(airspace=past(X, Y))
    assert plan.is_verified
    left, right = (
        solve_by_hand(40, 4, mast=(X, Y, RADIUS), bow=bow).energy_J for bow in (1.5, -1.5)
    )
    assert plan.energy == pytest.approx(min(left, right), rel=1e-5)
    by_name = {route.name: route.energy_J for route in plan.routes}
    assert by_name["left of mast"] == pytest.approx(left, rel=3e-4)
    assert by_name["right of mast"] == pytest.approx(right, rel=3e-4)


@pytest.mark.slow
def test_a_mirror_image_flies_the_mirror_image_and_a_zone_never_saves():
    goal = {"goal": {"position": [8.0, 0.0, 3.0]}}
    free, one, other = (
        solve(mission=goal, airspace=zones) for zones in ({}, past(4.0, 0.3), past(4.0, -0.3))
    )
    assert one.is_verified
    assert other.is_verified
    assert one.energy == pytest.approx(other.energy, rel=2e-6)
    assert one.energy > free.energy * (1 - 1e-6)
    kept = [next(route.name for route in p.routes if route.is_kept) for p in (one, other)]
    assert kept == ["right of mast", "left of mast"]
    middle = one.at(5.0), other.at(5.0)
    assert middle[0]["y_m"] == pytest.approx(-middle[1]["y_m"], abs=1e-3)
    more = past(4.0, 0.3)
    more["keep_out"].append(MAST | {"name": "second", "centre": [6.0, -0.6]})
    assert solve(mission=goal, airspace=more).energy > one.energy * (1 - 1e-6)


@pytest.mark.slow
def test_in_free_time_every_way_is_begun_where_it_leads():
    one, other = (
        solve(
            mission={
                "duration": "free",
                "goal": {"position": [6.0, side * 7.0, 8.0]},
                "waypoints": [{"position": [3.0, side, 2.0]}],
            },
            airspace={"keep_out": [MAST | {"centre": [4.5, side * 4.0], "radius": 0.8}]},
        )
        for side in (1.0, -1.0)
    )
    assert one.is_verified
    assert other.is_verified
    # Within a way there are optima that lie as close; the longer way costs a tenth more.
    assert one.energy == pytest.approx(other.energy, rel=1e-3)
    assert [len(plan.routes) for plan in (one, other)] == [2, 2]
