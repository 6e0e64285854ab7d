"""Reading of wind fields from NetCDF, CSV or Parquet: wind over places, heights and times.

The file may be untrusted: it is data only, bounded in size, and checked completely before use.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple, NoReturn

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from pyomo_quad.scenario.earth import GeodeticOrigin
from pyomo_quad.scenario.messages import ScenarioError, printable, shown
from pyomo_quad.scenario.wind import LARGEST_WIND, LATEST_TIME, STRONGEST_GUST, WindGrid

FloatArray = NDArray[np.float64]

_LARGEST_BYTES = 200_000_000
_MOST_VALUES = 5_000_000
_FEWEST_PLACES = 2
_FARTHEST_M = 1e5
_NETCDF = (".nc", ".nc4", ".cdf", ".h5")
_PARQUET = (".parquet", ".pq")
_READERS = "*.nc (NetCDF), *.csv or *.parquet"

_AXES = ("x", "y", "z", "time")
_AXIS_COLUMNS = ("x_m", "y_m", "z_m", "time_s")
_COLUMNS_ON_EARTH = ("longitude_deg", "latitude_deg")
_WIND_COLUMNS = ("wind_x_m_per_s", "wind_y_m_per_s", "wind_z_m_per_s")

# Names of CF, the standard ones first, then those usual in files that have none.
_AXIS_NAMES = {
    "x": ("projection_x_coordinate", "longitude", "x", "x_m", "lon"),
    "y": ("projection_y_coordinate", "latitude", "y", "y_m", "lat"),
    "z": ("height", "altitude", "height_above_mean_sea_level", "z", "z_m"),
    "time": ("time", "t", "time_s"),
}
_WIND_NAMES = (
    ("eastward_wind", "x_wind", "u", "wind_x", "wind_x_m_per_s"),
    ("northward_wind", "y_wind", "v", "wind_y", "wind_y_m_per_s"),
    ("upward_air_velocity", "w", "wind_z", "wind_z_m_per_s"),
)
_LENGTHS = {"m": 1.0, "metre": 1.0, "meter": 1.0, "meters": 1.0, "metres": 1.0, "km": 1000.0}
_ANGLES = tuple(
    f"degree{plural}{of}" for plural in ("", "s") for of in ("", "_east", "_north", "_E", "_N")
)
_TIMES = {"s": 1.0, "second": 1.0, "seconds": 1.0, "min": 60.0, "h": 3600.0, "hours": 3600.0}
_KNOT = 1852.0 / 3600.0
_SPEEDS = {
    "m s-1": 1.0,
    "m/s": 1.0,
    "m s^-1": 1.0,
    "m s**-1": 1.0,
    "km h-1": 1.0 / 3.6,
    "km/h": 1.0 / 3.6,
    "knot": _KNOT,
    "knots": _KNOT,
    "kt": _KNOT,
}


# Deviation in metres of a grid by latitude and longitude from straight lines, relative to its
# least step.
_SKEW = 0.1


class _Field(NamedTuple):
    """Points of each axis by name, and wind components with one array axis for each.

    `on_earth` names the axes, of x and y, that are longitudes and latitudes.
    """

    axes: dict[str, FloatArray]
    components: FloatArray
    on_earth: tuple[str, ...] = ()


def read_wind_field(file: Path, place: str, origin: GeodeticOrigin | None = None) -> dict[str, Any]:
    """Read and check a wind field.

    Parameters
    ----------
    file : Path
        NetCDF with CF names and units, or a table with one row for each place and time.
    place : str
        Start of messages: the field that names the file.
    origin : GeodeticOrigin, optional
        Position of x = y = 0, for a grid by latitude and longitude.

    Returns
    -------
    dict
        The fields of a `WindGrid`.

    Raises
    ------
    ScenarioError
        If the file cannot be read, is not a rectilinear grid, or has no wind; one line.
    """
    suffix = file.suffix.lower()
    try:
        size = file.stat().st_size
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        _refuse(place, f"cannot be read ({reason}); give an existing file, {_READERS}")
    if size > _LARGEST_BYTES:
        _refuse(place, f"larger than {_LARGEST_BYTES} bytes; cut out the region that is flown")
    if suffix in _NETCDF:
        field = _from_netcdf(file, place)
    elif suffix in {".csv", *_PARQUET}:
        field = _from_table(file, place)
    else:
        _refuse(place, f"is of no known kind; must be {_READERS}")
    if field.on_earth:
        field = _in_metres(field, origin, place)
    return _checked(field, place)


def _in_metres(field: _Field, origin: GeodeticOrigin | None, place: str) -> _Field:
    """Convert a field by longitude and latitude to metres along its middle lines.

    Meridians converge toward the poles; a region so large that its grid is skewed is refused.
    """
    if set(field.on_earth) != set(_AXES[:2]):
        _refuse(place, "has one coordinate in degrees and one in m; give both alike")
    if origin is None:
        _refuse(place, "is by latitude and longitude; give mission.origin, or x and y in m")
    east, north = (field.axes[axis] for axis in _AXES[:2])
    beyond = np.abs(east).max(initial=0.0) > 360.0 or np.abs(north).max(initial=0.0) > 90.0
    if beyond or not np.isfinite(np.concatenate([east, north])).all():
        _refuse(place, "has a latitude beyond 90 or a longitude beyond 360 degrees; correct it")
    middle = float(np.median(east)), float(np.median(north))
    x = origin.local([(middle[1], at, 0.0) for at in east])[:, 0]
    y = origin.local([(at, middle[0], 0.0) for at in north])[:, 1]
    steps = [np.abs(np.diff(axis)).min(initial=np.inf) for axis in (x, y)]
    for row, column in ((0, 0), (0, -1), (-1, 0), (-1, -1)):
        corner = origin.local([(north[row], east[column], 0.0)])[0]
        off = np.abs(corner[:2] - (x[column], y[row]))
        if (off > _SKEW * np.array(steps)).any():
            _refuse(
                place,
                f"spans so much of the earth that a corner is {off.max():.3g} m off its grid in "
                "metres; cut out the region that is flown",
            )
    return _Field(dict(field.axes) | {"x": x, "y": y}, field.components)


def _refuse(place: str, reason: str) -> NoReturn:
    raise ScenarioError(f"{place}; {reason}.") from None


def _told(error: Exception) -> str:
    return printable(" ".join(f"{error}".split())[:120]) or type(error).__name__


def _from_netcdf(file: Path, place: str) -> _Field:
    import xarray  # noqa: PLC0415  for NetCDF alone

    try:
        with xarray.open_dataset(file) as opened:
            data = opened.load()
    except Exception as error:  # noqa: BLE001  readers raise many types for damaged files
        _refuse(place, f"is not NetCDF that can be read ({_told(error)}); save it anew")
    axes, on_earth = {}, []
    for axis, names in _AXIS_NAMES.items():
        variable = _named(data.coords, names)
        if variable is not None and variable.ndim == 1:
            axes[str(variable.dims[0])] = axis, _points(variable, axis, place)
            if axis in _AXES[:2] and variable.attrs.get("units") in _ANGLES:
                on_earth.append(axis)
    parts = [_named(data.data_vars, names) for names in _WIND_NAMES]
    for part, names in zip(parts[:2], _WIND_NAMES, strict=False):
        if part is None:
            _refuse(place, f"has no variable {names[0]}; name it so by its standard_name")
    given = [part for part in parts if part is not None]
    dimensions = [dimension for axis in _AXES for dimension in axes if axes[dimension][0] == axis]
    read = []
    for part in given:
        alone = [str(d) for d in part.dims if d not in axes and part.sizes[d] == 1]
        unknown = [str(d) for d in part.dims if d not in axes and str(d) not in alone]
        if unknown:
            _refuse(
                place,
                f"{shown(str(part.name))} has the dimension {shown(unknown[0])} without a "
                "coordinate of x, y, height or time; give it a standard_name and units",
            )
        held = part.isel(dict.fromkeys(alone, 0))
        missing = [d for d in dimensions if d not in held.dims]
        held = held.expand_dims({d: axes[d][1].size for d in missing}).transpose(*dimensions)
        factor = _factor(part, _SPEEDS, "m s-1", place)
        read.append(factor * np.asarray(held, dtype=float))
    points = {axes[d][0]: axes[d][1] for d in dimensions}
    return _Field(points, np.array(read), tuple(on_earth))


def _named(variables: Mapping[Any, Any], names: tuple[str, ...]) -> Any:  # noqa: ANN401
    """Return the variable with one of some names, by its standard name or its own name."""
    held = list(variables.values())
    for name in names:
        for variable in held:
            if name in (variable.attrs.get("standard_name"), str(variable.name).lower()):
                return variable
    return None


def _points(variable: Any, axis: str, place: str) -> FloatArray:  # noqa: ANN401

    if np.issubdtype(variable.dtype, np.datetime64):
        return np.asarray((variable.to_numpy() - variable.to_numpy()[0]) / np.timedelta64(1, "s"))
    if np.issubdtype(variable.dtype, np.timedelta64):
        return np.asarray(variable.to_numpy() / np.timedelta64(1, "s"))
    if axis in _AXES[:2] and variable.attrs.get("units") in _ANGLES:
        return np.asarray(variable.to_numpy(), dtype=float)
    known, usual = (_TIMES, "s") if axis == "time" else (_LENGTHS, "m")
    return _factor(variable, known, usual, place) * np.asarray(variable.to_numpy(), dtype=float)


def _factor(
    variable: Any,  # noqa: ANN401
    known: Mapping[str, float],
    usual: str,
    place: str,
) -> float:
    units = " ".join(str(variable.attrs.get("units", usual)).split())
    if units not in known:
        _refuse(
            place,
            f"{shown(str(variable.name))} has units = {shown(units)}; must be one of "
            f"{', '.join(known)}",
        )
    return known[units]


def _from_table(file: Path, place: str) -> _Field:

    is_parquet = file.suffix.lower() in _PARQUET
    try:
        frame = pd.read_parquet(file) if is_parquet else pd.read_csv(file, encoding="utf-8-sig")
    except Exception as error:  # noqa: BLE001  see `_from_netcdf`
        kind = "Parquet" if is_parquet else "CSV text"
        _refuse(place, f"is not {kind} that can be read ({_told(error)}); save it anew")
    columns = [str(name).strip() for name in frame.columns]
    in_degrees = dict(zip(_COLUMNS_ON_EARTH, _AXIS_COLUMNS, strict=False))
    on_earth = tuple(_AXES[k] for k, name in enumerate(_COLUMNS_ON_EARTH) if name in columns)
    columns = [in_degrees.get(name, name) for name in columns]
    frame.columns = pd.Index(columns)
    keys = [name for name in _AXIS_COLUMNS if name in columns]
    speeds = [name for name in _WIND_COLUMNS if name in columns]
    needed = (*_AXIS_COLUMNS[:2], *_WIND_COLUMNS[:2])
    lacking = [name for name in needed if name not in columns]
    others = [name for name in columns if name not in (*_AXIS_COLUMNS, *_WIND_COLUMNS)]
    if lacking or others or len(set(columns)) < len(columns):
        said = f"no column {lacking[0]}" if lacking else f"a column {shown((others or columns)[0])}"
        _refuse(
            place,
            f"has {said}; must have {','.join(_AXIS_COLUMNS[:2])} (or "
            f"{','.join(_COLUMNS_ON_EARTH)}), perhaps z_m and time_s, then "
            f"{','.join(_WIND_COLUMNS[:2])} and perhaps {_WIND_COLUMNS[2]}, each once",
        )
    try:
        numbers = frame[keys + speeds].to_numpy(dtype=float)
    except (ValueError, TypeError):
        _refuse(place, "holds something other than numbers; remove it")
    if not np.isfinite(numbers[:, : len(keys)]).all():
        _refuse(place, "has a place or time that is not finite; remove its row")
    sorted_points = [np.unique(numbers[:, k], return_inverse=True) for k in range(len(keys))]
    shape = tuple(points.size for points, _ in sorted_points)
    if not shape or np.prod(shape, dtype=float) > max(_MOST_VALUES, 1):
        _refuse(place, f"has places on a grid of {shape}; they must share x, y, heights and times")
    where = tuple(places for _, places in sorted_points)
    cells = np.ravel_multi_index(where, shape)
    if np.unique(cells).size < len(numbers):
        _refuse(place, "gives the wind of a place twice; leave one row out")
    components = np.full((len(speeds), *shape), np.nan)
    components.reshape(len(speeds), -1)[:, cells] = numbers[:, len(keys) :].T
    names = [_AXES[_AXIS_COLUMNS.index(key)] for key in keys]
    points = [points for points, _ in sorted_points]
    return _Field(dict(zip(names, points, strict=True)), components, on_earth)


def _checked(field: _Field, place: str) -> dict[str, Any]:
    """Return the fields of a `WindGrid`: axes rise, and only x and y may have a single point."""
    axes, components = dict(field.axes), field.components
    for lacking in (axis for axis in _AXES[:2] if axis not in axes):
        _refuse(place, f"has no coordinate {lacking}; give one in m by its standard_name and units")
    if components.size > _MOST_VALUES:
        _refuse(place, f"has {components.size} numbers; must have at most {_MOST_VALUES}; thin it")
    for number, (name, points) in enumerate(field.axes.items(), start=1):
        order = np.argsort(points, kind="stable")
        axes[name] = points[order]
        components = np.take(components, order, axis=number)
        _check_axis(name, axes[name], place)
    for number, name in reversed(list(enumerate(field.axes, start=1))):
        if axes[name].size == 1 and name not in _AXES[:2]:
            del axes[name]
            components = np.take(components, 0, axis=number)
    has_wind = np.isfinite(components).all(axis=0)
    if not has_wind.any():
        _refuse(place, "has no place with wind; every cell is missing")
    strongest = float(np.abs(components[:, has_wind]).max())
    if strongest > LARGEST_WIND:
        _refuse(
            place,
            f"has a wind of {strongest:g} m/s; must be within {LARGEST_WIND:g} m/s: "
            f"{STRONGEST_GUST}",
        )
    held = {"times" if name == "time" else name: tuple(axes[name].tolist()) for name in axes}
    return {**held, "speeds": WindGrid.packed(components)}


def _check_axis(name: str, points: FloatArray, place: str) -> None:

    most, unit = (LATEST_TIME, "s") if name == "time" else (_FARTHEST_M, "m")
    if not np.isfinite(points).all() or np.abs(points).max(initial=0.0) > most:
        _refuse(place, f"has {name} beyond {most:g} {unit}; must be within")
    if name in _AXES[:2] and points.size < _FEWEST_PLACES:
        _refuse(place, f"has {points.size} {name}; must have at least {_FEWEST_PLACES}")
    twice = np.flatnonzero(np.diff(points) == 0.0)
    if twice.size:
        _refuse(place, f"has {name} = {points[twice[0]]:g} {unit} twice; give each once")
