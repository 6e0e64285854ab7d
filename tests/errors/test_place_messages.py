"""Files and numbers of a real place that cannot be, through the command: status 2 and one line.

The line names the file or the field, the value found, what is allowed, and the next thing to try.
"""

import json

import numpy as np
import pandas as pd
import pytest
import xarray as xr

from pyomo_quad.cli import main
from pyomo_quad.cli.endings import ExitCode
from tests.scenario_files import write_scenario

ORIGIN = "mission.origin = { latitude = 47.4, longitude = 8.5, altitude = 400.0 }"
RING = [[8.49, 47.39], [8.51, 47.39], [8.5, 47.41], [8.49, 47.39]]
X, Y = np.array([-10.0, 0.0, 30.0]), np.array([-10.0, 30.0])
AXES = {"x": ("x", X, {"units": "m"}), "y": ("y", Y, {"units": "m"})}


def rows(**values):
    x, y = (axis.ravel() for axis in np.meshgrid(X, Y, indexing="ij"))
    return pd.DataFrame({"x_m": x, "y_m": y} | values).to_csv(index=False)


def netcdf(**variables):
    held = {name: (("x", "y"), np.full((3, 2), value)) for name, value in variables.items()}
    return xr.Dataset(held, AXES)


def feature(ring, kind="Polygon", **properties):
    shape = {"type": kind, "coordinates": [ring]}
    return {"type": "Feature", "geometry": shape, "properties": properties}


def collection(*features):
    return json.dumps({"type": "FeatureCollection", "features": features})


ZONES, FIELD, GROUND = (
    'airspace.file = "z.geojson"',
    'wind.field = "w.{}"\nwind.coupling = "drag"',
    'airspace.terrain = "t.{}"',
)
POLYGON = 'airspace.keep_out = [{{name="yard",shape="polygon",corners={},bottom=0.0,top=9.0}}]'

# Lines of the scenario, content of the file that they name, and the parts of the message.
REFUSED = {
    "no GeoJSON": (ZONES, None, 'airspace.file = "z.geojson"; cannot be read (No such file or'),
    "GeoJSON that is no JSON": (ZONES, "{", '"z.geojson"; is not JSON; save it as GeoJSON'),
    "no collection": (ZONES, "{}", "is no FeatureCollection of GeoJSON; save it as one"),
    "no height": (ZONES, collection(feature(RING)), "feature 1; has no top; give top or height"),
    "a point": (
        ZONES,
        collection(feature(RING, "Point", top=9.0)),
        'feature 1; is "Point"; must be a Polygon or MultiPolygon',
    ),
    "latitude first": (
        ZONES,
        collection(feature([[47.4, 98.5], *RING[1:3], [47.4, 98.5]], top=9.0)),
        "has a corner beyond 90 degrees of latitude or 180 of longitude; GeoJSON gives longitude",
    ),
    "a bow tie of GeoJSON": (
        ZONES,
        collection(feature([[8, 47], [9, 48], [9, 47], [8, 48], [8, 47]], top=9.0)),
        "feature 1; has a polygon that crosses itself or encloses nothing; correct it",
    ),
    "a bow tie": (
        POLYGON.format("[[20, 20], [24, 24], [24, 20], [20, 24]]"),
        None,
        "must be those of a polygon that encloses an area of 0 m^2 without crossing itself",
    ),
    "two corners": (POLYGON.format("[[20, 20], [24, 24]]"), None, "corners"),
    "a folded fence": (
        "airspace.keep_in.corners = [[0, 0], [9, 9], [9, 0], [0, 9]]",
        None,
        "keep_in has corners; its corners must be those of a polygon",
    ),
    "a fence elsewhere": (
        "airspace.keep_in.corners = [[0.5, 0.5], [9.0, 0.5], [0.5, 9.0]]",
        None,
        "is outside the fence airspace.keep_in by ",
    ),
    "no NetCDF": (FIELD.format("nc"), None, 'wind.field = "w.nc"; cannot be read (No such file'),
    "damaged NetCDF": (FIELD.format("nc"), b"CDF\x01\x00", "is not NetCDF that can be read ("),
    "NetCDF without a wind": (
        FIELD.format("nc"),
        netcdf(u=1.0),
        "has no variable northward_wind; name it so by its standard_name",
    ),
    "a wind too strong": (
        FIELD.format("nc"),
        netcdf(u=900.0, v=0.0),
        "has a wind of 900 m/s; must be within 150 m/s",
    ),
    "a column too many": (
        FIELD.format("csv"),
        rows(wind_x_m_per_s=1.0, wind_y_m_per_s=0.0, gust=2.0),
        'has a column "gust"; must have x_m,y_m (or longitude_deg,latitude_deg)',
    ),
    "a wind elsewhere": (
        FIELD.format("csv"),
        rows(wind_x_m_per_s=1.0, wind_y_m_per_s=0.0).replace("-10.0", "2.0"),
        'move it, give more of the field, or set wind.beyond = "hold"',
    ),
    "no terrain": (GROUND.format("nc"), None, 'airspace.terrain = "t.nc"; cannot be read (No such'),
    "terrain of another kind": (
        GROUND.format("tif"),
        b"II*\x00",
        '"t.tif"; is of no known kind; must be *.nc (NetCDF), *.csv or *.parquet',
    ),
    "terrain with a hole": (
        GROUND.format("nc"),
        netcdf(elevation=np.nan),
        "has no height at x = -10, y = -10; fill the missing cells",
    ),
    "terrain of no height": (
        GROUND.format("nc"),
        netcdf(depth=3.0),
        "has no variable surface_altitude; name it so by its standard_name",
    ),
    "terrain with marks for holes": (
        GROUND.format("csv"),
        rows(height_m=-9999.0),
        "has a height of -9999 m; must be from -500 to 9000 m: fill missing cells, and give",
    ),
    "terrain above the start": (
        GROUND.format("csv"),
        rows(height_m=402.0),
        "m above airspace.terrain, below airspace.floor = 0 m; raise it or lower the floor",
    ),
    "a latitude beyond the pole": (
        "mission.goal.position = { latitude = 95.0, longitude = 8.5, height = 2.0 }",
        None,
        "mission.goal.position.latitude = 95; must be a number from -90 to 90 deg",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_of_a_place_is_told_in_one_line(case, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    lines, content, message = REFUSED[case]
    if content is not None:
        file = tmp_path / lines.split('"')[1]
        if isinstance(content, xr.Dataset):
            content.to_netcdf(file)
        else:
            file.write_bytes(content if isinstance(content, bytes) else content.encode())
    scenario = write_scenario(tmp_path, ORIGIN, *lines.splitlines())
    assert main(["check", str(scenario)]) == ExitCode.BAD_INPUT
    said = capsys.readouterr()
    assert message in said.err
    assert "hop.toml" in said.err
    assert (said.out, len(said.err.splitlines())) == ("", 1)


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        (ZONES, "is by latitude and longitude; give mission.origin"),
        (
            "mission.goal.position = { latitude = 47.4, longitude = 8.5, height = 2.0 }",
            "has a latitude, which needs the position of x = y = 0; give mission.origin",
        ),
    ],
)
def test_a_place_on_earth_needs_an_origin(lines, message, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "z.geojson").write_text(collection(feature(RING, top=9.0)))
    assert main(["check", str(write_scenario(tmp_path, lines))]) == ExitCode.BAD_INPUT
    said = capsys.readouterr().err
    assert message in said
    assert len(said.splitlines()) == 1
