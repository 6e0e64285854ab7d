"""Wind fields read from NetCDF, CSV and Parquet: units, order, gaps, and what is refused."""

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st

from pyomo_quad.scenario import ScenarioError, load_scenario, scenario_from_mapping
from pyomo_quad.scenario.description import shipped_scenarios
from pyomo_quad.scenario.wind import WindGrid
from pyomo_quad.scenario.wind_field import read_wind_field

X, Y = np.array([0.0, 10.0, 20.0]), np.array([0.0, 5.0])
U = np.arange(6.0).reshape(3, 2)
_MISSION = {"goal": {"position": [15.0, 2.0, 0.0]}, "duration": 10.0}


def rows(**changed):
    x, y = (axis.ravel() for axis in np.meshgrid(X, Y, indexing="ij"))
    columns = {"x_m": x, "y_m": y, "wind_x_m_per_s": U.ravel(), "wind_y_m_per_s": -U.ravel()}
    return pd.DataFrame(columns | changed)


def dataset(units="m s-1", names=("u", "v"), **axes):
    held = {"x": ("x", X, {"units": "m"}), "y": ("y", Y)} | axes
    fields = {n: (("x", "y"), s * U, {"units": units}) for n, s in zip(names, (1, -1), strict=True)}
    return xr.Dataset(fields, held)


def grid_of(file):
    return WindGrid.model_validate(read_wind_field(file, "wind.field"))


def test_netcdf_csv_and_parquet_of_one_wind_are_one_grid(tmp_path):
    dataset().to_netcdf(tmp_path / "w.nc")
    dataset().to_netcdf(tmp_path / "old.nc", format="NETCDF3_CLASSIC", engine="scipy")
    rows().to_csv(tmp_path / "w.csv", index=False)
    rows().sample(frac=1, random_state=0).to_parquet(tmp_path / "w.parquet")
    grids = [grid_of(tmp_path / name) for name in ("w.nc", "old.nc", "w.csv", "w.parquet")]
    assert all(grid == grids[0] for grid in grids)
    assert grids[0].components == pytest.approx(np.array([U, -U]))
    assert grids[0].axes == ((0.0, 10.0, 20.0), (0.0, 5.0))


def test_names_units_and_order_are_those_of_cf(tmp_path):
    knots = dataset(units="knots", names=("a", "b"), x=("x", X / 1000, {"units": "km"}))
    knots["a"].attrs["standard_name"] = "eastward_wind"
    knots["b"].attrs["standard_name"] = "northward_wind"
    times = np.array(["2026-05-01T00", "2026-05-01T01"], dtype="datetime64[ns]")
    cube = xr.concat([knots, 2 * knots], dim="time").assign_coords(time=times)
    for name in "ab":
        cube[name].attrs = knots[name].attrs
    cube = cube.isel(y=slice(None, None, -1)).transpose("y", "time", "x")
    cube.to_netcdf(tmp_path / "w.nc")
    grid = grid_of(tmp_path / "w.nc")
    assert grid.times == (0.0, 3600.0)
    assert grid.x == pytest.approx(X)
    assert grid.y == pytest.approx(Y)
    knot = 1852 / 3600
    assert grid.components[0] == pytest.approx(np.stack([U * knot, 2 * U * knot], axis=-1))


def test_rows_that_are_left_out_are_cells_without_wind(tmp_path):
    rows().drop(index=3).to_csv(tmp_path / "w.csv", index=False)
    grid = grid_of(tmp_path / "w.csv")
    assert np.isnan(grid.components[:, 1, 1]).all()
    places = [[10.0, 4.0, 9.0], [10.0, 2.0, 9.0], [16.0, 4.0, 9.0], [20.1, 0.0, 9.0]]
    assert grid.is_known(places, 0.0).tolist() == [False, True, True, False]


def test_a_record_of_a_scenario_holds_the_field(tmp_path):
    rows().to_csv(tmp_path / "w.csv", index=False)
    told = scenario_from_mapping(
        {"name": "w", "mission": _MISSION, "wind": {"field": "w.csv"}}, folder=tmp_path
    )
    again = type(told).model_validate(told.model_dump(mode="json"))
    assert again.wind.grid == told.wind.grid
    assert again.wind.grid.components == pytest.approx(told.wind.grid.components)
    assert (
        "grid"
        not in type(told)
        .model_validate(load_scenario({"name": "w", "mission": _MISSION}).model_dump(mode="json"))
        .model_dump()["wind"]
    )


@pytest.mark.parametrize("name", ["ridge", "street"])
def test_a_record_is_changed_from_any_folder(name, tmp_path, monkeypatch):
    scenario = load_scenario(shipped_scenarios()[name])
    monkeypatch.chdir(tmp_path)
    record = type(scenario).model_validate(scenario.model_dump(mode="json"))
    changed = record.with_values({"solver.accuracy": "proof"})
    assert changed.wind == scenario.wind
    assert changed.airspace == scenario.airspace


@settings(max_examples=15, deadline=None)
@given(
    count=st.tuples(*[st.integers(2, 4)] * 4),
    seed=st.integers(0, 2**16),
    kind=st.sampled_from(["csv", "parquet"]),
)
def test_what_is_written_is_read_whatever_the_order(tmp_path_factory, count, seed, kind):
    generator = np.random.default_rng(seed)
    axes = [np.sort(generator.choice(1000, n, replace=False)) / 8.0 for n in count]
    speeds = generator.normal(size=(3, *count))
    places = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 4)
    names = ["x_m", "y_m", "z_m", "time_s", *(f"wind_{a}_m_per_s" for a in "xyz")]
    frame = pd.DataFrame(np.column_stack([places, *speeds.reshape(3, -1)]), columns=names)
    frame = frame[generator.permutation(names)].iloc[generator.permutation(len(frame))]
    file = tmp_path_factory.mktemp("field") / f"w.{kind}"
    frame.to_csv(file, index=False) if kind == "csv" else frame.to_parquet(file)
    grid = grid_of(file)
    assert grid.components == pytest.approx(speeds, abs=1e-15)
    assert grid.axes == tuple(map(tuple, axes))


@settings(max_examples=25, deadline=None)
@given(content=st.binary(max_size=200), name=st.sampled_from(["w.nc", "w.csv", "w.parquet"]))
def test_a_strangers_bytes_are_refused_in_one_line(tmp_path_factory, content, name):
    file = tmp_path_factory.mktemp("stranger") / name
    file.write_bytes(content)
    with pytest.raises(ScenarioError, match=r"^wind\.field; ") as caught:
        read_wind_field(file, "wind.field")
    assert "\n" not in str(caught.value)


def _no_file(file):
    return file.with_name("none.nc")


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


def _with_units(data):
    data["u"].attrs["units"] = "furlong per fortnight"
    return data


@pytest.mark.parametrize(
    ("write", "line"),
    [
        (_no_file, r"cannot be read \(No such file or directory\); give an existing file, \*\.nc"),
        (lambda file: _no_file(file).with_suffix(".grb"), "cannot be read"),
        (_frame(wind_x_m_per_s=np.full(6, 200.0)), "has a wind of 200 m/s; must be within 150"),
        (_frame(wind_x_m_per_s=np.full(6, np.nan)), "no place with wind; every cell is missing"),
        (_frame(x_m=[0, 0, 0, 0, 1, np.inf]), "a place or time that is not finite; remove its row"),
        (_frame(x_m=np.zeros(6)), "gives the wind of a place twice; leave one row out"),
        (_frame(y_m=list("abcdef")), "holds something other than numbers; remove it"),
        (_frame(y_m=np.full(6, 1.0), x_m=np.arange(6.0)), "has 1 y; must have at least 2"),
        (_frame(x_m=1e6 * np.arange(6.0)), "has x beyond 100000 m; must be within"),
        (_frame(gust=1.0), "a column .gust.; must have x_m,y_m .or longitude_deg"),
        (_netcdf(lambda d: d.drop_vars("v")), "no variable northward_wind; name it so by its"),
        (_netcdf(lambda d: d.drop_vars("x")), ".u. has the dimension .x. without a coordinate"),
        (_netcdf(_with_units), ".u. has units = .*; must be one of m s-1, m/s, "),
    ],
)
def test_fields_that_cannot_be_are_refused(tmp_path, write, line):
    with pytest.raises(ScenarioError, match=line) as caught:
        read_wind_field(write(tmp_path / "w"), "wind.field = 'w'")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("wind", "line"),
    [
        ({"field": "w.csv", "file": "t.csv"}, "file and field both give the wind; leave one out"),
        ({"field_scale": 2.0}, "field_scale is used only with wind.field; leave"),
        ({"beyond": "hold"}, "beyond is used only with wind.field; leave beyond out"),
        ({"field": "w.txt"}, "is of no known kind; must be .*parquet"),
        ({"grid": {"x": [0.0, 1.0]}}, "wind.grid.x is not set by hand; name a NetCDF, CSV or Par"),
    ],
)
def test_tables_of_fields_that_cannot_be_are_refused(tmp_path, wind, line):
    rows().to_csv(tmp_path / "w.csv", index=False)
    times = [f"{t},1,0" for t in range(12)]
    lines = ["time_s,wind_x_m_per_s,wind_y_m_per_s", *times]
    (tmp_path / "t.csv").write_text("\n".join(lines), encoding="utf-8")
    (tmp_path / "w.txt").write_text("x", encoding="utf-8")
    tables = {"name": "w", "mission": _MISSION, "wind": {"use": "calm"} | wind}
    with pytest.raises(ScenarioError, match=line):
        scenario_from_mapping(tables, folder=tmp_path)


def test_a_goal_without_wind_is_refused_before_anything_is_solved(tmp_path):
    rows().to_csv(tmp_path / "w.csv", index=False)
    tables = {"name": "w", "mission": _MISSION, "wind": {"field": "w.csv"}}
    far = {"mission.goal.position": (50.0, 2.0, 0.0)}
    told = scenario_from_mapping(tables, folder=tmp_path)
    line = r"mission\.goal\.position = \[50\.0, 2\.0, 0\.0\] m has no wind in wind\.field = .w\.csv"
    with pytest.raises(ScenarioError, match=line):
        told.with_values(far)
    assert told.with_values(far | {"wind.beyond": "hold"}).mission.goal.position[0] == 50.0
