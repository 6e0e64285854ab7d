"""Places by latitude and longitude, angles in degrees, and where a wind comes from."""

from math import cos, pi, radians, sin

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from hypothesis import given
from hypothesis import strategies as st

from pyomo_quad.scenario import ScenarioError, load_scenario
from pyomo_quad.scenario.earth import GeodeticOrigin
from pyomo_quad.scenario.wind_field import read_wind_field

ZURICH = {"latitude": 47.3977, "longitude": 8.5456, "altitude": 488.0}
MISSION = {"goal": {"position": [6.0, 7.0, 8.0]}, "duration": 10.0}


def told(mission=None, overrides=(), **tables):
    return load_scenario({"name": "t", "mission": MISSION | (mission or {})} | tables, overrides)


@given(
    latitude=st.floats(-90, 90),
    longitude=st.floats(-180, 180),
    place=st.tuples(*[st.floats(-2e4, 2e4)] * 3),
)
def test_a_place_comes_back_from_the_globe(latitude, longitude, place):
    origin = GeodeticOrigin(latitude=latitude, longitude=longitude, altitude=300.0)
    globe = origin.geodetic(np.array([place]))
    assert origin.local(globe)[0] == pytest.approx(place, abs=1e-5)


def test_a_place_by_latitude_and_longitude_is_east_and_north_of_the_origin():
    # Radii of curvature of WGS 84 at this latitude: along the meridian and across it.
    sine2 = 0.00669437999014 * sin(radians(ZURICH["latitude"])) ** 2
    across = 6_378_137.0 / (1 - sine2) ** 0.5
    along = 6_378_137.0 * (1 - 0.00669437999014) / (1 - sine2) ** 1.5
    goal = {"latitude": 47.3977 + 1e-3, "longitude": 8.5456 + 1e-3, "altitude": 500.0}
    x, y, z = told({"origin": ZURICH, "goal": {"position": goal}}).mission.goal.position
    east = (across + 488.0) * cos(radians(goal["latitude"])) * radians(1e-3)
    assert x == pytest.approx(east, rel=1e-5)
    assert y == pytest.approx((along + 488.0) * radians(1e-3), rel=1e-5)
    # The earth falls away by half of the square of the distance over its radius.
    assert z == pytest.approx(12.0 - (x**2 / across + y**2 / along) / 2, abs=1e-5)
    above = {k: goal[k] for k in ("latitude", "longitude")} | {"height": 12.0}
    again = told({"origin": ZURICH, "goal": {"position": above}}).mission.goal.position
    assert again == pytest.approx((x, y, z), abs=1e-9)


def test_waypoints_and_zones_are_places_too():
    there = {"latitude": 47.3990, "longitude": 8.5470}
    mast = {"name": "mast", "shape": "cylinder", "radius": 2.0, "bottom": 0.0, "top": 30.0}
    ball = {"name": "ball", "shape": "sphere", "radius": 2.0}
    scenario = told(
        {"origin": ZURICH, "waypoints": [{"position": there | {"height": 9.0}, "yaw_deg": 90}]},
        airspace={
            "keep_out": [
                mast | {"centre": {"latitude": 47.4001, "longitude": 8.5470}},
                ball | {"centre": {"latitude": 47.4001, "longitude": 8.5470, "height": 50.0}},
            ]
        },
    )
    point = scenario.mission.waypoints[0]
    assert point.yaw == pytest.approx(pi / 2)
    assert point.position[1] == pytest.approx(144.55, abs=0.1)
    zones = scenario.airspace.keep_out
    assert zones[0].centre == pytest.approx(zones[1].centre[:2], abs=1e-2)
    assert scenario.with_values({"mission.duration": 12.0}).airspace == scenario.airspace


@pytest.mark.parametrize(
    ("comes_from", "towards"), [(270, (1, 0)), (0, (0, -1)), (90, (-1, 0)), (225, (0.5**0.5,) * 2)]
)
def test_a_wind_comes_from_where_meteorologists_say(comes_from, towards):
    wind = told(wind={"speed": 5.0, "from": comes_from}).wind
    assert (cos(wind.direction), sin(wind.direction)) == pytest.approx(towards, abs=1e-12)
    forecast = {"use": "calm", "speed": 4.0, "from": comes_from}
    assert told(wind={"forecast": forecast}).wind.forecast.direction == wind.direction
    set_so = told(overrides=[f"wind.from={comes_from}"])
    assert set_so.wind.direction == wind.direction
    assert set_so.provenance["wind.direction"] == "--set"


def test_every_angle_can_be_in_degrees():
    scenario = told({"start": {"position": [0.0, 0.0, 0.0], "yaw_deg": 30.0}})
    assert scenario.mission.start.yaw == pytest.approx(pi / 6)
    assert told(limits={"roll_max_deg": 20}).limits.roll_max == pytest.approx(pi / 9)
    assert told(wind={"direction_deg": 90.0, "speed": 1.0}).wind.direction == pytest.approx(pi / 2)


@pytest.mark.parametrize(
    ("overrides", "line"),
    [
        (
            ["wind.from=270", "wind.direction=1.0"],
            r"wind.direction and wind.from give",
        ),
        (["wind.from='west'"], r'wind.from = "west"; must be a number from .* degrees'),
        (["wind.speed_deg=3"], "unknown key wind.speed_deg"),
        (["mission.origin.latitude=95"], "mission.origin.latitude = 95 deg; must be <= 90"),
        (
            ["mission.goal.position={latitude=95.0,longitude=8,height=1}"],
            "mission.goal.position.latitude = 95; must be a number from -90 to 90 deg",
        ),
        (
            ["mission.goal.position={latitude=47.0,longitude=8}"],
            r"position = { latitude, longitude }; a place on earth has .* altitude .* or height",
        ),
        (["mission.frame='ned'"], r"mission.frame = .ned.; must be one of 'enu'"),
    ],
)
def test_places_and_angles_that_cannot_be_are_refused(overrides, line):
    with pytest.raises(ScenarioError, match=line) as caught:
        told({"origin": ZURICH}, overrides)
    assert "\n" not in str(caught.value)


def test_a_latitude_needs_an_origin():
    goal = {"position": ZURICH}
    with pytest.raises(ScenarioError, match=r"has a latitude, which needs .*mission.origin"):
        told({"goal": goal})


def test_a_wind_field_by_latitude_and_longitude_is_one_in_metres(tmp_path):
    origin = GeodeticOrigin.model_validate(ZURICH)
    east, north = 8.5456 + np.linspace(0, 2e-3, 4), 47.3977 + np.linspace(0, 1e-3, 5)
    u = np.arange(20.0).reshape(5, 4)
    named = {"units": "m s-1", "standard_name": "eastward_wind"}
    xr.Dataset(
        {
            "u": (("lat", "lon"), u, named),
            "v": (("lat", "lon"), 0 * u, named | {"standard_name": "northward_wind"}),
        },
        {
            "lat": ("lat", north, {"units": "degrees_north", "standard_name": "latitude"}),
            "lon": ("lon", east, {"units": "degrees_east", "standard_name": "longitude"}),
        },
    ).to_netcdf(tmp_path / "w.nc")
    grid = read_wind_field(tmp_path / "w.nc", "wind.field", origin)
    corner = origin.local([(north[-1], east[-1], 0.0)])[0]
    assert (grid["x"][-1], grid["y"][-1]) == pytest.approx(corner[:2], abs=0.05)
    places = np.stack(np.meshgrid(north, east, indexing="ij"), -1).reshape(-1, 2)
    columns = ["latitude_deg", "longitude_deg", "wind_x_m_per_s", "wind_y_m_per_s"]
    rows = np.column_stack([places, u.ravel(), 0 * u.ravel()])
    pd.DataFrame(rows, columns=columns).to_csv(tmp_path / "w.csv", index=False)
    table = read_wind_field(tmp_path / "w.csv", "wind.field", origin)
    assert table["speeds"] == grid["speeds"]
    assert table["x"] == pytest.approx(grid["x"])
    with pytest.raises(ScenarioError, match=r"is by latitude and longitude; give mission.origin"):
        read_wind_field(tmp_path / "w.csv", "wind.field")
    far = GeodeticOrigin(latitude=80.0, longitude=8.0)
    wide = pd.DataFrame(rows, columns=columns)
    wide["latitude_deg"] = 60 + 20 * (wide["latitude_deg"] - 47)
    wide["longitude_deg"] = 8 + 500 * (wide["longitude_deg"] - 8.5456)
    wide.to_csv(tmp_path / "wide.csv", index=False)
    with pytest.raises(ScenarioError, match="spans so much of the earth that a corner is"):
        read_wind_field(tmp_path / "wide.csv", "wind.field", far)


def test_heights_of_a_wind_field_above_the_sea_count_from_the_origin(tmp_path):
    origin = GeodeticOrigin.model_validate(ZURICH)
    axes = {"x": [0.0, 9.0], "y": [0.0, 9.0], "z": ZURICH["altitude"] + np.array([0.0, 20.0, 40.0])}
    held = {name: (("x", "y", "z"), np.ones((2, 2, 3)), {"units": "m s-1"}) for name in "uv"}
    data = xr.Dataset(held, axes)
    for standard_name, first in (("altitude", 0.0), ("height", ZURICH["altitude"])):
        data["z"].attrs = {"units": "m", "standard_name": standard_name}
        data.to_netcdf(tmp_path / "w.nc")
        grid = read_wind_field(tmp_path / "w.nc", "wind.field", origin)
        assert grid["z"] == pytest.approx(first + np.array([0.0, 20.0, 40.0]))
