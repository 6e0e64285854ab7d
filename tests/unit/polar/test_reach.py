"""Reach on one pack against closed forms in a uniform wind, and against direct sums in a jet."""

import json
from functools import cache

import numpy as np
import pandas as pd
import pytest
from pyproj import Geod

from pyomo_quad.cli import main
from pyomo_quad.cli.endings import ExitCode
from pyomo_quad.flight import Planner
from pyomo_quad.polar.polar import COURSE, REACH, steady_curve
from pyomo_quad.polar.reach import EAST, IS_CUT, NORTH, boundary_geojson, find_reach
from pyomo_quad.scenario import load_scenario
from tests.command import SCENARIOS

PARCEL = SCENARIOS / "parcel.toml"
HOME = {"latitude": 47.0, "longitude": 8.0, "altitude": 400.0}


def curve_of(scenario):
    steady = Planner().steady_flight(scenario)
    return steady_curve(scenario, steady, 1.0 - scenario.limits.least_charge)


@cache
def uniform(*, has_return):
    return find_reach(load_scenario(PARCEL, {"mission.origin": HOME}), has_return=has_return)


@pytest.mark.lengthy
@pytest.mark.parametrize("has_return", [False, True])
def test_in_a_uniform_wind_the_boundary_is_that_of_the_wind_triangle(has_return):
    reach = uniform(has_return=has_return)
    scenario, boundary = reach.scenario, reach.boundary
    curve = curve_of(scenario)
    wind, towards = scenario.wind.speed, scenario.wind.direction
    for row in boundary.iloc[::18].itertuples():
        course = np.radians(getattr(row, COURSE))
        legs = [0.0, np.pi] if has_return else [0.0]
        ranges = [curve.best_over_ground(wind, towards - course + leg).range_m for leg in legs]
        expected = 1.0 / sum(1.0 / leg for leg in ranges)
        assert getattr(row, REACH) == pytest.approx(expected, rel=1e-3)


@pytest.mark.slow
def test_a_wall_on_the_way_takes_the_charge_of_one_climb_over_it(tmp_path):
    x, y = np.meshgrid(np.arange(-2e4, 2.1e4, 250.0), np.linspace(-2e4, 2e4, 4))
    heights = np.where(np.abs(x - 2000.0) < 1.0, 90.0, 0.0)
    columns = np.column_stack([axis.ravel() for axis in (x, y, heights)])
    file = tmp_path / "wall.csv"
    np.savetxt(file, columns, delimiter=",", header="x_m,y_m,height_m", comments="")
    climb = {"climb_rate": 2.0, "climb_current": 40.0}
    fields = {
        "wind.speed": 0.0,
        "airspace.terrain": str(file),
        "airspace.floor": 5.0,
        "airspace.ceiling": None,
        "airspace.keep_out": [],
        "mission.start.position": [0.0, 0.0, 20.0],
        "mission.goal.position": [100.0, 0.0, 20.0],
        "mission.return_flight": climb,
    }
    scenario = load_scenario(PARCEL, fields)
    reach = find_reach(scenario, has_return=True).boundary.set_index(COURSE)[REACH]
    one_way = curve_of(scenario).best_over_ground().range_m
    line = np.column_stack([np.linspace(0.0, 3000.0, 3001), np.zeros(3001), np.zeros(3001)])
    ahead = 5.0 - scenario.airspace.height_above_ground(line).min() - 20.0
    behind = 5.0 - scenario.airspace.height_above_ground(-5.0 * line).min() - 20.0
    usable = (1.0 - scenario.limits.least_charge) * Planner().steady_flight(scenario).pack_capacity
    lost = 40.0 / 2.0 / 3600.0 / usable
    assert ahead > 70.0
    for course, height in ((0.0, ahead), (180.0, max(behind, 0.0))):
        expected = (1.0 - lost * height) * one_way / 2.0
        assert reach[course] == pytest.approx(expected, rel=2e-3)


def jet(y):
    return 6.0 * np.exp(-(((y - 1500.0) / 900.0) ** 2))


def jet_file(folder, half_m=6000.0):
    x, y = np.meshgrid(np.linspace(-half_m, half_m, 5), np.linspace(-half_m, half_m, 61))
    rows = {"x_m": x, "y_m": y, "wind_x_m_per_s": jet(y), "wind_y_m_per_s": 0.0 * y}
    frame = pd.DataFrame({name: held.ravel() for name, held in rows.items()})
    file = folder / "jet.csv"
    frame.to_csv(file, index=False)
    return file


@pytest.mark.lengthy
def test_a_wind_too_strong_ends_the_flight_where_it_begins(monkeypatch):
    begins_m = 3000.0
    scenario = load_scenario(PARCEL, {"wind.speed": 0.0})

    def winds(_self, _scenario, places):
        east = np.where(places[:, 0] > begins_m, -30.0, 0.0)
        return np.column_stack([east, np.zeros(len(places))])

    monkeypatch.setattr(Planner, "winds_at", winds)
    reach = find_reach(scenario, has_return=False).boundary.set_index(COURSE)[REACH]
    curve = curve_of(scenario)
    calm, start = curve.best_over_ground().range_m, scenario.mission.start.position[0]
    assert reach[180.0] == pytest.approx(calm, rel=1e-3)
    # The place at which the wind begins is exact to one of the 400 steps along the course.
    step = 2.0 * curve.airspeeds[-1] * curve.endurances.max() / 399
    assert step < begins_m / 3.0
    assert begins_m - start - step <= reach[0.0] <= begins_m - start < 0.5 * calm


def in_jet(folder, **fields):
    file = jet_file(folder, **fields)
    return load_scenario(PARCEL, {"wind.field": str(file), "wind.speed": 0.0})


@pytest.mark.slow
def test_in_a_jet_the_shares_of_the_pack_add_up_to_one(tmp_path):
    scenario = in_jet(tmp_path)
    reach = find_reach(scenario, has_return=True)
    assert not reach.boundary[IS_CUT].any()
    curve = curve_of(scenario)
    row = reach.boundary.loc[(reach.boundary[COURSE] - 60.0).abs().idxmin()]
    course = np.radians(row[COURSE])
    middles = (np.arange(60) + 0.5) * row[REACH] / 60
    used = 0.0
    for middle in middles:
        wind = jet(middle * np.sin(course))
        for leg in (0.0, np.pi):
            used += row[REACH] / 60 / curve.best_over_ground(wind, leg - course).range_m
    assert used == pytest.approx(1.0, rel=5e-3)


@pytest.mark.slow
def test_the_boundary_ends_with_the_field(tmp_path):
    boundary = find_reach(in_jet(tmp_path, half_m=1000.0), has_return=True).boundary
    assert boundary[IS_CUT].all()
    assert np.abs(boundary[[EAST, NORTH]].to_numpy()).max() <= 1000.0 + 1e-3


def test_the_outline_lies_at_its_distance_on_the_ellipsoid():
    reach = uniform(has_return=True)
    ((ring,),) = [f["geometry"]["coordinates"] for f in boundary_geojson(reach)["features"]]
    assert ring[0] == ring[-1]
    for (longitude, latitude), row in zip(ring, reach.boundary.itertuples(), strict=False):
        azimuth, _, far = Geod(ellps="WGS84").inv(8.0, 47.0, longitude, latitude)
        assert far == pytest.approx(getattr(row, REACH), rel=2e-4)
        turned = np.radians(azimuth - (90.0 - getattr(row, COURSE)))
        assert np.cos(turned) == pytest.approx(1.0, abs=1e-5)


@pytest.mark.lengthy
def test_the_command_writes_the_boundary(tmp_path, capsys):
    out = tmp_path / "reach"
    command = ["reach", str(PARCEL), "--return", "--figures", "none", "--out", str(out)]
    assert main(command) == ExitCode.VERIFIED
    told = capsys.readouterr().out
    assert "km from the start and back, depending on the direction" in told
    assert "no GeoJSON: give mission.origin" in told
    summary = json.loads((out / "summary.json").read_text())
    frame = pd.read_csv(out / "reach.csv")
    assert summary["greatest_reach_m"] == pytest.approx(frame[REACH].max())
