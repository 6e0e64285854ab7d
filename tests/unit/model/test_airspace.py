"""The declared zones beside plain geometry: no place inside is allowed, few outside are not."""

import numpy as np
import pytest
from pyomo.environ import value

from pyomo_quad.model import build_model
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
