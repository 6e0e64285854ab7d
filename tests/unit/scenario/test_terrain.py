"""Terrain: its files, the surfaces above and below it, and what places over it are refused for."""

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import RegularGridInterpolator

from pyomo_quad.scenario import ScenarioError, scenario_from_mapping
from pyomo_quad.scenario.airspace import Airspace, TerrainGrid
from pyomo_quad.scenario.earth import GeodeticOrigin
from pyomo_quad.scenario.packed_arrays import packed
from pyomo_quad.scenario.surfaces import highest_on_ways, surface_of
from pyomo_quad.scenario.terrain_file import read_terrain

X, Y = np.array([0.0, 10.0, 20.0]), np.array([0.0, 5.0])
HEIGHTS = np.array([[0.0, 1.0], [4.0, 3.0], [2.0, 2.5]])
BERN = GeodeticOrigin(latitude=46.95, longitude=7.44, altitude=540.0)


def rows(**changed):
    x, y = (axis.ravel() for axis in np.meshgrid(X, Y, indexing="ij"))
    return pd.DataFrame({"x_m": x, "y_m": y, "height_m": HEIGHTS.ravel()} | changed)


def dataset(name="elevation", units="m"):
    held = {name: (("x", "y"), HEIGHTS, {"units": units})}
    return xr.Dataset(held, {"x": ("x", X, {"units": "m"}), "y": ("y", Y)})


def grid_of(file, origin=None):
    return TerrainGrid.model_validate(read_terrain(file, "airspace.terrain", origin))


def airspace(heights=HEIGHTS, **fields):
    """Return an airspace over heights at `X` and `Y`."""
    ground = {"x": tuple(X), "y": tuple(Y), "heights": packed(heights)}
    return Airspace.model_validate({"ground": ground, "terrain": "t.csv"} | fields)


@pytest.mark.lengthy
def test_netcdf_csv_and_parquet_of_one_terrain_are_one_grid(tmp_path):
    dataset().to_netcdf(tmp_path / "t.nc")
    turned = dataset("Band1", "km").transpose("y", "x").isel(x=slice(None, None, -1))
    turned["Band1"] = turned["Band1"].copy(data=turned["Band1"] / 1000)
    turned.to_netcdf(tmp_path / "turned.nc")
    rows().to_csv(tmp_path / "t.csv", index=False)
    rows().sample(frac=1, random_state=0).to_parquet(tmp_path / "t.parquet")
    names = ("t.nc", "t.csv", "t.parquet", "turned.nc")
    grids = [grid_of(tmp_path / name) for name in names]
    assert all(grid == grids[0] for grid in grids[:3])
    assert all(grid.elevations == pytest.approx(HEIGHTS) for grid in grids)
    assert grids[0].least_step == 5.0


def test_heights_are_altitudes_where_the_mission_has_a_place_on_earth(tmp_path):
    rows(height_m=540.0 + HEIGHTS.ravel()).to_csv(tmp_path / "t.csv", index=False)
    assert grid_of(tmp_path / "t.csv", BERN).elevations == pytest.approx(HEIGHTS, abs=1e-9)
    east, north = 7.44 + np.linspace(0.0, 0.02, 5), 46.95 + np.linspace(0.02, 0.0, 4)
    of = {"standard_name": "surface_altitude", "units": "m"}
    axes = {
        "lon": ("lon", east, {"units": "degrees_east"}),
        "lat": ("lat", north, {"units": "degrees_north"}),
    }
    flat = xr.Dataset({"a": (("lat", "lon"), np.full((4, 5), 600.0), of)}, axes)
    flat.to_netcdf(tmp_path / "t.nc")
    grid = grid_of(tmp_path / "t.nc", BERN)
    # The north-east corner is 2.7 km away, where the earth is half a metre lower.
    corner = BERN.local([[46.97, 7.46, 60.0]])[0]
    assert grid.elevations[-1, -1] == pytest.approx(corner[2], abs=1e-9)
    drop = (corner[0] ** 2 + corner[1] ** 2) / 2 / 6.37e6
    assert corner[2] == pytest.approx(60.0 - drop, abs=0.01)
    assert grid.x[-1] == pytest.approx(corner[0], abs=1.0)
    assert grid.y[0] == pytest.approx(0.0, abs=1.0)


axes = st.integers(2, 9).flatmap(
    lambda n: st.lists(st.integers(1, 40), min_size=n, max_size=n).map(np.cumsum)
)


@settings(max_examples=30, deadline=None)
@given(x=axes, y=axes, seed=st.integers(0, 2**16), rough=st.sampled_from([0.0, 1e-3, 1.0, 300.0]))
def test_no_surface_crosses_the_ground_nor_leaves_it_further_than_it_says(x, y, seed, rough):
    generator = np.random.default_rng(seed)
    slope = 0.3 * x[:, None] - 0.2 * y
    heights = slope + rough * generator.choice([0.0, 1.0, 0.5], size=(x.size, y.size))
    ground = RegularGridInterpolator((x.astype(float), y.astype(float)), heights)
    at = np.column_stack([generator.uniform(a[0], a[-1], 300) for a in (x, y)])
    at = np.vstack([at, np.stack(np.meshgrid(x, y, indexing="ij"), -1).reshape(-1, 2)])
    for side in (1, -1):
        surface = surface_of(x, y, heights, side)
        off = side * (surface.at(at) - ground(at))
        assert off.min() >= 0.0
        assert off.max() <= surface.excess + 1e-9
    if rough == 0.0:  # a plane is its own surface
        assert surface.excess == pytest.approx(1e-6, abs=1e-8)


def test_the_excess_falls_with_the_square_of_the_step():
    excess = []
    for count in (11, 21, 41):
        x = np.linspace(-500.0, 500.0, count)
        bell = 60.0 / (1 + (x[:, None] ** 2 + x**2) / 200.0**2) ** 1.5
        excess.append(surface_of(x, x, bell, 1).excess)
    orders = np.log2(np.array(excess[:-1]) / excess[1:])
    assert orders.min() > 1.6
    assert excess[-1] < 1.0


def test_floor_and_ceiling_count_from_the_ground():
    told = airspace(floor=2.0, ceiling=30.0)
    ground = RegularGridInterpolator((X, Y), HEIGHTS)
    place = np.array([8.0, 3.0, 9.0])
    over = 9.0 - float(ground(place[:2])[0])
    assert told.height_above_ground(place) <= over <= told.height_above_ground(place, -1)
    assert list(told.complaints(place)) == []
    low, high, beyond = ([8.0, 3.0, z] for z in (3.0, 40.0, 9.0))
    beyond[0] = 21.0
    (line,) = told.complaints(low)
    assert "m above airspace.terrain, below airspace.floor = 2 m; raise it or lower" in line
    (line,) = told.complaints(high)
    assert "m above airspace.terrain, above airspace.ceiling = 30 m; lower it or raise" in line
    (line,) = told.complaints(beyond)
    assert line == (
        "is beyond the east edge of airspace.terrain at x = 20 m; move it, or give more of the "
        "terrain"
    )


def test_a_floor_over_terrain_is_the_clearance_unless_it_is_given(tmp_path):
    rows().to_csv(tmp_path / "t.csv", index=False)
    mission = {
        "start": {"position": [1.0, 1.0, 40.0]},
        "goal": {"position": [19.0, 4.0, 40.0]},
        "duration": 10.0,
    }

    def floor(**fields):
        tables = {"name": "t", "mission": mission, "airspace": {"terrain": "t.csv"} | fields}
        return scenario_from_mapping(tables, folder=tmp_path).airspace.floor

    assert floor() == 0.0
    assert floor(clearance=3.0) == 3.0
    assert floor(clearance=3.0, floor=1.0) == 1.0


@settings(max_examples=15, deadline=None)
@given(
    count=st.tuples(*[st.integers(2, 5)] * 2),
    seed=st.integers(0, 2**16),
    kind=st.sampled_from(["csv", "parquet", "nc"]),
)
def test_what_is_written_is_read_whatever_the_order(tmp_path_factory, count, seed, kind):
    generator = np.random.default_rng(seed)
    x, y = (np.sort(generator.choice(1000, n, replace=False)) / 8.0 for n in count)
    heights = generator.uniform(-400, 8000, size=count)
    file = tmp_path_factory.mktemp("terrain") / f"t.{kind}"
    if kind == "nc":
        data = xr.Dataset({"dem": (("x", "y"), heights)}, {"x": x, "y": y})
        order = {"x": generator.permutation(x.size), "y": generator.permutation(y.size)}
        data.isel(order).transpose(*generator.permutation(["x", "y"])).to_netcdf(file)
    else:
        at = np.stack(np.meshgrid(x, y, indexing="ij"), -1).reshape(-1, 2)
        names = np.array(["x_m", "y_m", "height_m"])
        frame = pd.DataFrame(np.column_stack([at, heights.ravel()]), columns=names)
        frame = frame[generator.permutation(names)].iloc[generator.permutation(len(frame))]
        frame.to_csv(file, index=False) if kind == "csv" else frame.to_parquet(file)
    grid = grid_of(file)
    assert grid.elevations == pytest.approx(heights, abs=1e-9)
    assert (grid.x, grid.y) == (tuple(x), tuple(y))


@settings(max_examples=25, deadline=None)
@given(content=st.binary(max_size=200), name=st.sampled_from(["t.nc", "t.csv", "t.parquet"]))
def test_a_strangers_bytes_are_refused_in_one_line(tmp_path_factory, content, name):
    file = tmp_path_factory.mktemp("stranger") / name
    file.write_bytes(content)
    with pytest.raises(ScenarioError, match=r"^airspace\.terrain; ") as caught:
        read_terrain(file, "airspace.terrain")
    assert "\n" not in str(caught.value)


def _frame(**changed):
    def write(file):
        rows(**changed).to_csv(file.with_suffix(".csv"), index=False)
        return file.with_suffix(".csv")

    return write


def _netcdf(change):
    def write(file):
        change(dataset()).to_netcdf(file.with_suffix(".nc"))
        return file.with_suffix(".nc")

    return write


def _holed(data):
    data["elevation"][1, 0] = np.nan
    return data


@pytest.mark.parametrize(
    ("write", "line"),
    [
        (lambda file: file.with_suffix(".nc"), r"cannot be read \(No such file or directory\)"),
        (lambda file: _frame()(file).rename(file.with_suffix(".tif")), "is of no known kind; must"),
        (_frame(height_m=[*range(5), -32768.0]), "has a height of -32768 m; must be from -500 to"),
        (_frame(height_m=[*range(5), np.nan]), "has no height at x = 20, y = 5; fill the missing"),
        (_frame(wind=1.0), "a column .wind.; must have x_m,y_m .or longitude_deg,latitude_deg.,"),
        (_frame(x_m=np.zeros(6)), "gives the height of a place twice; leave one row out"),
        (_frame(x_m=5e5 + np.arange(6.0)), "has x beyond 100000 m; must be within"),
        (_netcdf(_holed), "has no height at x = 10, y = 0; fill the missing cells"),
        (_netcdf(lambda d: d.rename(elevation="depth")), "has no variable surface_altitude; name"),
        (_netcdf(lambda d: d.expand_dims(time=[0, 1])), "the dimension .time. without a coord.* x"),
        (_netcdf(lambda d: d.assign_coords(x=list("abc"))), ".x. holds something other than numb"),
    ],
)
def test_terrain_that_cannot_be_is_refused(tmp_path, write, line):
    with pytest.raises(ScenarioError, match=line) as caught:
        read_terrain(write(tmp_path / "t"), "airspace.terrain = 't'")
    assert "\n" not in str(caught.value)


def test_terrain_by_latitude_needs_an_origin(tmp_path):
    frame = rows().rename(columns={"x_m": "longitude_deg", "y_m": "latitude_deg"})
    frame.to_csv(tmp_path / "t.csv", index=False)
    with pytest.raises(ScenarioError, match=r"by latitude and longitude; give mission\.origin, or"):
        read_terrain(tmp_path / "t.csv", "airspace.terrain")


def test_the_ground_is_not_set_by_hand(tmp_path):
    tables = {"name": "t", "airspace": {"ground": {"x": [0.0, 1.0]}}}
    with pytest.raises(ScenarioError, match=r"airspace\.ground\.x is not set by hand; name a "):
        scenario_from_mapping(tables, folder=tmp_path)


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=20, deadline=None)
def test_the_surface_of_ways_is_nowhere_below_the_ground_on_the_way_home(seed):
    random = np.random.default_rng(seed)
    x, y = (np.cumsum(random.uniform(5.0, 20.0, n)) for n in (7, 6))
    heights = random.uniform(0.0, 60.0, (7, 6))
    ground = RegularGridInterpolator((x, y), heights)
    home = random.uniform([x[0], y[0]], [x[-1], y[-1]])
    bound = surface_of(x, y, highest_on_ways(x, y, heights, home), 1)
    places = random.uniform([x[0], y[0]], [x[-1], y[-1]], (40, 2))
    ways = places[:, None] + np.linspace(0.0, 1.0, 300)[:, None] * (home - places)[:, None]
    assert np.all(bound.at(places) >= ground(ways).max(axis=1))
    assert np.all(bound.at(places) <= heights.max() + bound.excess + 1e-9)


def test_on_level_ground_the_surface_of_ways_is_the_ground():
    bound = surface_of(X, Y, highest_on_ways(X, Y, np.full((3, 2), 7.0), (4.0, 1.0)), 1)
    assert bound.at([[3.0, 2.0], [19.0, 4.5]]) == pytest.approx(7.0, abs=1e-5)
