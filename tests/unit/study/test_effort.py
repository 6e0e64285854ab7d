"""What `check` says of the effort: more to plan takes longer, and its cost is named."""

from dataclasses import replace

import numpy as np
import pytest

from pyomo_quad.scenario import load_scenario
from pyomo_quad.study.effort import Counts, counts_of, estimate_effort
from tests.declared_model import scenario

PLAIN = Counts(unknowns=20, elements=10, degree=4, tolerance=1e-4)
MORE = {
    "unknowns": 25,
    "elements": 40,
    "degree": 6,
    "tolerance": 1e-6,
    "waypoints": 3,
    "routes": 2,
    "legs": 40,
    "is_free": True,
    "has_wind_table": True,
    "has_wind_field": True,
    "cells": 50,
}
TOWER = {"name": "tower", "shape": "cylinder", "centre": [5.0, 0.0], "radius": 1.0}
TOWER |= {"bottom": 0.0, "top": 30.0}
PLACES = [{"position": [3.0, float(k), 2.0]} for k in range(1, 5)]


@pytest.mark.parametrize("name", MORE)
def test_more_of_anything_takes_longer(name):
    assert replace(PLAIN, **{name: MORE[name]}).seconds > PLAIN.seconds


@pytest.mark.parametrize(("fewer", "more"), [(1, 2), (2, 5), (10, 30)])
@pytest.mark.parametrize("name", ["waypoints", "routes", "legs"])
def test_each_further_one_takes_longer(name, fewer, more):
    few, many = (replace(PLAIN, **{name: count}).seconds for count in (fewer, more))
    assert many > few


def mission(**changes):
    told = {"start": {"position": [0.0, 0.0, 2.0]}, "goal": {"position": [10.0, 0.0, 2.0]}}
    return told | {"duration": 10.0} | changes


def test_counts_are_those_of_the_scenario():
    plain = counts_of(scenario(mission=mission()), 20)
    assert (plain.waypoints, plain.routes, plain.legs) == (0, 0, 0)
    zoned = scenario(mission=mission(), airspace={"keep_out": [TOWER]})
    assert counts_of(zoned, 20).routes > 1
    aside = {**TOWER, "centre": [5.0, 50.0]}
    assert counts_of(scenario(mission=mission(), airspace={"keep_out": [aside]}), 20).routes == 0
    ordered = mission(waypoints=PLACES, order="best", duration="free")
    counts = counts_of(scenario(mission=ordered), 20)
    assert counts.is_free
    assert counts.waypoints == 4
    assert counts.legs == 4 * 3 + 2 * 4


def test_the_dearest_feature_is_named_first_and_an_absent_one_not_at_all():
    plain = estimate_effort(scenario(mission=mission(), solver={"tolerance": 1e-3}), 20)
    assert plain.features == ()
    told = mission(waypoints=PLACES, duration="free")
    between = {**TOWER, "centre": [6.0, 2.3]}
    found = estimate_effort(scenario(mission=told, airspace={"keep_out": [between]}), 20)
    names, spent = zip(*found.features, strict=True)
    assert list(spent) == sorted(spent, reverse=True)
    assert any("round the zones" in name for name in names)
    assert "4 waypoints" in names
    assert not any("order" in name or "wind" in name for name in names)
    assert max(spent) < found.seconds
    assert found.seconds > plain.seconds


@pytest.mark.parametrize(
    ("name", "step"),
    [("street", 10.0), ("ridge", 40.0)],  # of the wind field, and of the terrain [m]
)
def test_a_wind_field_and_the_cells_of_a_real_place_take_longer(name, step):
    told = load_scenario(f"scenarios/{name}.toml")
    counts = counts_of(told, 26)
    start, goal = (np.array(place[:2]) for place in told.mission.positions)
    assert counts.cells == round(np.linalg.norm(goal - start) / step)
    effort = estimate_effort(told, 26)
    assert {"wind field", f"{counts.cells} cells of wind field or terrain"} <= dict(
        effort.features
    ).keys()
    calm = replace(counts, has_wind_field=False, cells=0)
    assert effort.seconds > 2.0 * calm.seconds
