"""The declared zones beside plain geometry: no place inside is allowed, few outside are not."""

import re

import numpy as np
import pytest
from pyomo.environ import value

from pyomo_quad.collocation import Problem
from pyomo_quad.flight import Planner
from pyomo_quad.model import airspace, build_model
from pyomo_quad.scenario import ScenarioError
from tests.declared_model import AIRSPACE, Instant, scenario

# Centre and half widths of what is looked at.
AROUND = {
    "mast": ((3.0, 5.0, 4.5), (0.9, 0.9, 6.0)),
    "balloon": ((1.0, 5.0, 7.0), (1.8, 1.8, 1.8)),
    "hall": ((5.0, 1.0, 1.5), (1.6, 1.6, 2.2)),
}
EDGE_MARGIN = {"mast": 0.0697, "balloon": 0.0, "hall": 0.1393}


def beyond(zone, clearance, places):
    """Distance beyond the face that is farthest behind, by the definition of each shape."""
    if zone["shape"] == "sphere":
        return np.linalg.norm(places - zone["centre"], axis=1) - zone["radius"] - clearance
    if zone["shape"] == "cylinder":
        low, high = (-np.inf, -np.inf, zone["bottom"]), (np.inf, np.inf, zone["top"])
        aside = np.linalg.norm(places[:, :2] - zone["centre"], axis=1) - zone["radius"]
    else:
        low, high, aside = zone["low"], zone["high"], np.full(len(places), -np.inf)
    faces = np.maximum(low - places, places - high).max(axis=1)
    return np.maximum(aside, faces) - clearance


@pytest.mark.parametrize("zone", AIRSPACE["keep_out"], ids=lambda zone: zone["name"])
def test_a_zone_is_what_its_shape_says(zone):
    """Inside nothing is allowed, outside all but a margin beside the edges."""
    at = Instant(build_model(scenario(airspace=AIRSPACE)))
    limit = at.model.airspace.keep_out[zone["name"], at.t]
    centre, widths = AROUND[zone["name"]]
    places = centre + np.random.default_rng(1).uniform(-1, 1, (600, 3)) * widths
    exact = beyond(zone, AIRSPACE["clearance"], places)
    declared = np.empty(len(places))
    for k, place in enumerate(places):
        at.set(body=(*place, *[0.0] * 9))
        declared[k] = value(limit.body)
    assert 60 < np.sum(exact < 0.0) < 540
    assert np.all(declared[exact < 0.0] < 0.0)
    margin = EDGE_MARGIN[zone["name"]]
    assert np.all(declared[exact > margin + 1e-12] > 0.0)
    # Near the surface the excess is a distance, to the rounding at the centre.
    near = np.abs(exact) < 0.05
    assert declared[near] == pytest.approx(exact[near], abs=margin + 1e-3)


def test_the_model_and_the_scenario_agree_on_what_is_inside():
    told = scenario(airspace=AIRSPACE)
    random = np.random.default_rng(2)
    places = random.uniform((-1, -1, -3), (7, 7, 12), (300, 3))
    for zone, plain in zip(told.airspace.keep_out, AIRSPACE["keep_out"], strict=True):
        depths = [zone.depth(place) for place in places]
        assert depths == pytest.approx(-beyond(plain, 0.0, places), abs=1e-12)


def test_speed_is_limited_over_ground():
    at = Instant(build_model(scenario(limits={"speed_max": 5.0})))
    at.set(body=(0, 0, 0, 3.0, -4.0, 12.0, *[0.0] * 6))
    limit = at.model.limits.speed_limit[at.t]
    assert value(limit.body) - value(limit.upper) == pytest.approx(8.0, abs=1e-6)


HALL = {"name": "hall", "shape": "box", "low": [0.0, -3.0, -5.0], "high": [2.5, 3.0, 6.0]}
TOWER = {
    "name": "tower",
    "shape": "cylinder",
    "centre": [3, 4],
    "radius": 2,
    "bottom": -9,
    "top": 9,
}


@pytest.mark.parametrize(
    ("zone", "clearance", "mission", "said"),
    [
        (HALL, 0.0, {}, "mission.start.position = [0.0, 0.0, 0.0] m touches keep-out hall: it is"),
        (
            TOWER | {"centre": [-3, -4], "radius": 4.0},
            1.0,
            {},
            "[0.0, 0.0, 0.0] m touches keep-out tower with its clearance of 1 m: it is 0 m from",
        ),
        (
            TOWER,
            0.0,
            {"waypoints": [{"position": [1.0, 4.0, 0.0]}]},
            "waypoints[0].position = [1.0, 4.0, 0.0] m touches keep-out tower: it is 0 m from the",
        ),
        (
            HALL | {"low": [0.02, -3.0, -0.3]},
            0.0,
            {},
            "it is 0.02 m from the wall, beside an edge, which is rounded outwards by up to 0.14 m",
        ),
        (HALL | {"low": [6.0, 6.0, -5.0], "high": [9.0, 7.0, 9.0]}, 0.0, {}, "mission.goal.pos"),
    ],
)
def test_a_place_on_the_wall_of_a_zone_is_told_before_anything_is_solved(
    monkeypatch, zone, clearance, mission, said
):
    monkeypatch.setattr(Problem, "solve", lambda *_, **__: pytest.fail("it is solved"))
    told = scenario(mission=mission, airspace={"keep_out": [zone], "clearance": clearance})
    with pytest.raises(ScenarioError, match=re.escape(said)) as caught:
        Planner().solve(told)
    assert len(str(caught.value).splitlines()) == 1


def test_a_place_beside_a_wall_has_room():
    """A tenth of a millimetre is enough, and so is a waypoint that may be passed at a distance."""
    build_model(scenario(airspace={"keep_out": [HALL | {"low": [1e-4, -3.0, -5.0]}]}))
    near = {"waypoints": [{"position": [1.0, 4.0, 0.0], "radius": 0.5}]}
    build_model(scenario(mission=near, airspace={"keep_out": [TOWER]}))


def test_a_place_has_the_room_that_the_constraint_says():
    told = scenario(airspace=AIRSPACE)
    at = Instant(build_model(told))
    places = np.random.default_rng(3).uniform((-1, -1, -3), (7, 7, 12), (50, 3))
    for zone in told.airspace.keep_out:
        for place in places:
            at.set(body=(*place, *[0.0] * 9))
            declared = value(at.model.airspace.keep_out[zone.name, at.t].body)
            room = airspace._smoothed_distance(zone, told.airspace.clearance, place)
            assert room == pytest.approx(declared, rel=1e-12, abs=1e-12)
