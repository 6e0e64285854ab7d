"""Reading of data on a rectilinear grid, such as wind or terrain, from NetCDF, CSV or Parquet.

The file may come from an untrusted source. It is therefore read as data only, its size is limited,
and its content is checked completely before use. The argument `place` is a text that names the
scenario field and the file. Error messages begin with it.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from pyomo_quad.arrays import FloatArray
from pyomo_quad.scenario.earth import GeodeticOrigin
from pyomo_quad.scenario.messages import printable, refuse, shown
from pyomo_quad.scenario.wind import LATEST_TIME

_LARGEST_BYTES = 200_000_000
_MOST_VALUES = 5_000_000
_FEWEST_PLACES = 2
_FARTHEST_M = 1e5
_NETCDF = (".nc", ".nc4", ".cdf", ".h5")
_PARQUET = (".parquet", ".pq")
_READERS = "*.nc (NetCDF), *.csv or *.parquet"

#: The axes of a grid, in the order of the arrays.
AXES = ("x", "y", "z", "time")
#: Horizontal axes, which every grid has.
PLACE_AXES = AXES[:2]
_AXIS_COLUMNS = dict(zip(AXES, ("x_m", "y_m", "z_m", "time_s"), strict=True))
_COLUMNS_ON_EARTH = ("longitude_deg", "latitude_deg")

# Names of coordinates in NetCDF: standard names of the CF conventions first, then names that are
# usual in files without standard names.
_AXIS_NAMES = {
    "x": ("projection_x_coordinate", "longitude", "x", "x_m", "lon"),
    "y": ("projection_y_coordinate", "latitude", "y", "y_m", "lat"),
    "z": ("height", "altitude", "height_above_mean_sea_level", "z", "z_m"),
    "time": ("time", "t", "time_s"),
}
LENGTHS = {"m": 1.0, "metre": 1.0, "meter": 1.0, "meters": 1.0, "metres": 1.0, "km": 1000.0}
_ANGLES = tuple(
    f"degree{plural}{of}" for plural in ("", "s") for of in ("", "_east", "_north", "_E", "_N")
)
_TIMES = {"s": 1.0, "second": 1.0, "seconds": 1.0, "min": 60.0, "h": 3600.0, "hours": 3600.0}

# Largest accepted deviation of a grid by latitude and longitude from straight lines in metres, as a
# share of the grid's least step.
_SKEW = 0.1


@dataclass(frozen=True, kw_only=True)
class Quantity:
    """Names and units by which files give a physical quantity on a grid, such as wind or height.

    Attributes
    ----------
    word : str
        Name of the quantity in messages.
    axes : tuple of str
        Permitted axes, from "x", "y", "z" and "time".
    names : tuple of tuple of str
        Names of each component in NetCDF.
    columns : tuple of str
        Column of each component in a CSV or Parquet table.
    needed : int
        Number of required components, from the first one on. The others are optional.
    units : mapping of str to float
        Factor from each unit to SI units.
    """

    word: str
    axes: tuple[str, ...]
    # The standard name of the CF conventions is the first.
    names: tuple[tuple[str, ...], ...]
    columns: tuple[str, ...]
    needed: int
    # The first unit is assumed for a variable without a unit.
    units: Mapping[str, float]


class Gridded(NamedTuple):
    """Data on a rectilinear grid.

    Attributes
    ----------
    axes : dict
        Ascending grid points of each axis, by name.
    components : ndarray, shape (n_components, ...)
        Values at the grid points. Further array axes are those of the grid.
    on_earth : tuple of str
        Horizontal axes in degrees: "x" for longitudes, "y" for latitudes.
    is_above_sea : bool
        Whether the heights of axis z are altitudes above the sea.
    """

    axes: dict[str, FloatArray]
    components: FloatArray
    on_earth: tuple[str, ...] = ()
    is_above_sea: bool = False


def read_gridded(file: Path, place: str, quantity: Quantity) -> Gridded:
    """Read a quantity on a rectilinear grid from a NetCDF, CSV or Parquet file, in SI units.

    NetCDF follows the CF conventions. A table has one row for each grid point. Longitudes and
    latitudes stay in degrees, and missing values are NaN. Raises ScenarioError, which begins with
    `place`, if the file is not valid.
    """
    suffix = file.suffix.lower()
    try:
        size = file.stat().st_size
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        refuse(place, f"cannot be read ({reason}); give an existing file, {_READERS}")
    if size > _LARGEST_BYTES:
        refuse(place, f"larger than {_LARGEST_BYTES} bytes; cut out the region that is flown")
    if suffix not in {*_NETCDF, *_PARQUET, ".csv"}:
        refuse(place, f"is of no known kind; must be {_READERS}")
    read = _from_netcdf if suffix in _NETCDF else _from_table
    return _rising(read(file, place, quantity), place)


def in_metres(field: Gridded, origin: GeodeticOrigin | None, place: str) -> Gridded:
    """Convert the axes of gridded data to metres from the mission's origin.

    Axes in degrees need `origin`. Without it, altitudes above the sea stay unchanged. Raises
    ScenarioError, which begins with `place`, if axes in degrees are not valid or the grid is too
    large for the conversion.
    """
    axes = dict(field.axes)
    if field.is_above_sea and origin is not None:
        axes["z"] = axes["z"] - origin.altitude
    if field.on_earth:
        axes |= _on_middle_lines(field, origin, place)
    return Gridded(axes, field.components)


def _on_middle_lines(
    field: Gridded, origin: GeodeticOrigin | None, place: str
) -> dict[str, FloatArray]:
    if set(field.on_earth) != set(PLACE_AXES):
        refuse(place, "has one coordinate in degrees and one in m; give both alike")
    if origin is None:
        refuse(place, "is by latitude and longitude; give mission.origin, or x and y in m")
    east, north = (field.axes[axis] for axis in PLACE_AXES)
    beyond = np.abs(east).max(initial=0.0) > 360.0 or np.abs(north).max(initial=0.0) > 90.0
    if beyond or not np.isfinite(np.concatenate([east, north])).all():
        refuse(place, "has a latitude beyond 90 or a longitude beyond 360 degrees; correct it")
    middle = float(np.median(east)), float(np.median(north))
    # Longitudes are converted at the grid's middle latitude, and latitudes at its middle longitude.
    x = origin.local([(middle[1], at, 0.0) for at in east])[:, 0]
    y = origin.local([(at, middle[0], 0.0) for at in north])[:, 1]
    steps = [np.abs(np.diff(axis)).min(initial=np.inf) for axis in (x, y)]
    # Away from the middle lines the conversion is approximate, because the meridians converge
    # toward the poles. The error is greatest at the corners of the grid.
    for row, column in ((0, 0), (0, -1), (-1, 0), (-1, -1)):
        corner = origin.local([(north[row], east[column], 0.0)])[0]
        off = np.abs(corner[:2] - (x[column], y[row]))
        if (off > _SKEW * np.array(steps)).any():
            refuse(
                place,
                f"spans so much of the earth that a corner is {off.max():.3g} m off its grid in "
                "metres; cut out the region that is flown",
            )
    return {"x": x, "y": y}


def _one_line(error: Exception) -> str:
    return printable(" ".join(f"{error}".split())[:120]) or type(error).__name__


def _from_netcdf(file: Path, place: str, quantity: Quantity) -> Gridded:
    import xarray  # noqa: PLC0415  for NetCDF alone

    try:
        with xarray.open_dataset(file) as opened:
            data = opened.load()
    except Exception as error:  # noqa: BLE001  readers raise many types for damaged files
        refuse(place, f"is not NetCDF that can be read ({_one_line(error)}); save it anew")
    axes, on_earth, is_above_sea = {}, [], False
    for axis in quantity.axes:
        variable = _named(data.coords, _AXIS_NAMES[axis])
        if variable is not None and variable.ndim == 1:
            axes[str(variable.dims[0])] = axis, _points(variable, axis, place)
            if axis in PLACE_AXES and variable.attrs.get("units") in _ANGLES:
                on_earth.append(axis)
            is_above_sea |= axis == "z" and _is_one_of(variable, _ALTITUDES)
    parts = [_named(data.data_vars, names) for names in quantity.names]
    for part, names in zip(parts[: quantity.needed], quantity.names, strict=False):
        if part is None:
            refuse(place, f"has no variable {names[0]}; name it so by its standard_name")
    given = [part for part in parts if part is not None]
    dimensions = [dimension for axis in AXES for dimension in axes if axes[dimension][0] == axis]
    read = []
    for part in given:
        alone = [str(d) for d in part.dims if d not in axes and part.sizes[d] == 1]
        unknown = [str(d) for d in part.dims if d not in axes and str(d) not in alone]
        if unknown:
            refuse(
                place,
                f"{shown(str(part.name))} has the dimension {shown(unknown[0])} without a "
                f"coordinate of {_listed(quantity.axes)}; give it a standard_name and units",
            )
        held = part.isel(dict.fromkeys(alone, 0))
        missing = [d for d in dimensions if d not in held.dims]
        held = held.expand_dims({d: axes[d][1].size for d in missing}).transpose(*dimensions)
        read.append(_factor(part, quantity.units, place) * _numbers(held, place))
    points = {axes[d][0]: axes[d][1] for d in dimensions}
    return Gridded(points, np.array(read), tuple(on_earth), is_above_sea)


_ALTITUDES = ("altitude", "height_above_mean_sea_level")


def _listed(axes: tuple[str, ...]) -> str:
    words = ["height" if axis == "z" else axis for axis in axes]
    return f"{', '.join(words[:-1])} or {words[-1]}"


def _named(variables: Mapping[Any, Any], names: tuple[str, ...]) -> Any:  # noqa: ANN401
    """Return the variable of a NetCDF file that has one of the given names, or None.

    Both the variable's name and its attribute `standard_name` are compared. Earlier `names` have
    precedence.
    """
    held = list(variables.values())
    for name in names:
        for variable in held:
            if _is_one_of(variable, (name,)):
                return variable
    return None


def _is_one_of(variable: Any, names: tuple[str, ...]) -> bool:  # noqa: ANN401
    own = variable.attrs.get("standard_name"), str(variable.name).lower()
    return any(name in own for name in names)


def _numbers(variable: Any, place: str) -> FloatArray:  # noqa: ANN401
    try:
        return np.asarray(variable.to_numpy(), dtype=float)
    except (ValueError, TypeError):
        refuse(place, f"{shown(str(variable.name))} holds something other than numbers; correct it")


def _points(variable: Any, axis: str, place: str) -> FloatArray:  # noqa: ANN401
    # Dates count from the first date in the file.
    if np.issubdtype(variable.dtype, np.datetime64):
        return np.asarray((variable.to_numpy() - variable.to_numpy()[0]) / np.timedelta64(1, "s"))
    if np.issubdtype(variable.dtype, np.timedelta64):
        return np.asarray(variable.to_numpy() / np.timedelta64(1, "s"))
    if axis in PLACE_AXES and variable.attrs.get("units") in _ANGLES:
        return _numbers(variable, place)
    known = _TIMES if axis == "time" else LENGTHS
    return _factor(variable, known, place) * _numbers(variable, place)


def _factor(variable: Any, known: Mapping[str, float], place: str) -> float:  # noqa: ANN401
    units = " ".join(str(variable.attrs.get("units", next(iter(known)))).split())
    if units not in known:
        refuse(
            place,
            f"{shown(str(variable.name))} has units = {shown(units)}; must be one of "
            f"{', '.join(known)}",
        )
    return known[units]


def _from_table(file: Path, place: str, quantity: Quantity) -> Gridded:
    is_parquet = file.suffix.lower() in _PARQUET
    try:
        frame = pd.read_parquet(file) if is_parquet else pd.read_csv(file, encoding="utf-8-sig")
    except Exception as error:  # noqa: BLE001  see `_from_netcdf`
        kind = "Parquet" if is_parquet else "CSV text"
        refuse(place, f"is not {kind} that can be read ({_one_line(error)}); save it anew")
    columns = [str(name).strip() for name in frame.columns]
    in_degrees = dict(zip(_COLUMNS_ON_EARTH, _AXIS_COLUMNS.values(), strict=False))
    on_earth = tuple(AXES[k] for k, name in enumerate(_COLUMNS_ON_EARTH) if name in columns)
    columns = [in_degrees.get(name, name) for name in columns]
    frame.columns = pd.Index(columns)
    _check_columns(columns, place, quantity)
    axes = [axis for axis in quantity.axes if _AXIS_COLUMNS[axis] in columns]
    keys = [_AXIS_COLUMNS[axis] for axis in axes]
    held = [name for name in quantity.columns if name in columns]
    try:
        numbers = frame[keys + held].to_numpy(dtype=float)
    except (ValueError, TypeError):
        refuse(place, "holds something other than numbers; remove it")
    if not np.isfinite(numbers[:, : len(keys)]).all():
        refuse(place, "has a place or time that is not finite; remove its row")
    sorted_points = [np.unique(numbers[:, k], return_inverse=True) for k in range(len(keys))]
    shape = tuple(points.size for points, _ in sorted_points)
    if not shape or np.prod(shape, dtype=float) > max(_MOST_VALUES, 1):
        refuse(place, f"has places on a grid of {shape}; they must share x, y, heights and times")
    where = tuple(places for _, places in sorted_points)
    cells = np.ravel_multi_index(where, shape)
    if np.unique(cells).size < len(numbers):
        refuse(place, f"gives the {quantity.word} of a place twice; leave one row out")
    components = np.full((len(held), *shape), np.nan)
    components.reshape(len(held), -1)[:, cells] = numbers[:, len(keys) :].T
    points = [points for points, _ in sorted_points]
    return Gridded(dict(zip(axes, points, strict=True)), components, on_earth)


def _check_columns(columns: list[str], place: str, quantity: Quantity) -> None:
    """Raise a ScenarioError if the columns of a table do not fit a quantity on a grid.

    The message begins with `place`. Unknown and repeated columns are errors, too.
    """
    here, beside = list(_AXIS_COLUMNS.values())[:2], quantity.columns[quantity.needed :]
    known = (*(_AXIS_COLUMNS[axis] for axis in quantity.axes), *quantity.columns)
    needed = (*here, *quantity.columns[: quantity.needed])
    lacking = [name for name in needed if name not in columns]
    others = [name for name in columns if name not in known]
    if lacking or others or len(set(columns)) < len(columns):
        said = f"no column {lacking[0]}" if lacking else f"a column {shown((others or columns)[0])}"
        more = [_AXIS_COLUMNS[axis] for axis in quantity.axes[2:]]
        perhaps = f", perhaps {' and '.join(more)}" if more else ""
        refuse(
            place,
            f"has {said}; must have {','.join(here)} (or {','.join(_COLUMNS_ON_EARTH)})"
            f"{perhaps}, then {','.join(quantity.columns[: quantity.needed])}"
            f"{''.join(f' and perhaps {name}' for name in beside)}, each once",
        )


def _rising(field: Gridded, place: str) -> Gridded:
    """Sort gridded data so that all axes ascend; drop axes of height or time with one point.

    Raises a ScenarioError if the axis x or y is missing, or if there are too many values. The
    message begins with `place`.
    """
    axes, components = dict(field.axes), field.components
    for lacking in (axis for axis in PLACE_AXES if axis not in axes):
        refuse(place, f"has no coordinate {lacking}; give one in m by its standard_name and units")
    if components.size > _MOST_VALUES:
        refuse(place, f"has {components.size} numbers; must have at most {_MOST_VALUES}; thin it")
    for number, (name, points) in enumerate(field.axes.items(), start=1):
        order = np.argsort(points, kind="stable")
        axes[name] = points[order]
        components = np.take(components, order, axis=number)
    for number, name in reversed(list(enumerate(field.axes, start=1))):
        if axes[name].size == 1 and name not in PLACE_AXES:
            del axes[name]
            components = np.take(components, 0, axis=number)
    is_above_sea = field.is_above_sea and "z" in axes
    return Gridded(axes, components, field.on_earth, is_above_sea)


def check_axes(axes: Mapping[str, FloatArray], place: str) -> None:
    """Raise an error if an axis of gridded data has too few, repeated or implausibly large values.

    `axes` maps the name of each axis to its points in ascending order. x, y and z are in m, time in
    s. The order is not checked. The ScenarioError begins with `place`.
    """
    for name, points in axes.items():
        most, unit = (LATEST_TIME, "s") if name == "time" else (_FARTHEST_M, "m")
        if not np.isfinite(points).all() or np.abs(points).max(initial=0.0) > most:
            refuse(place, f"has {name} beyond {most:g} {unit}; must be within")
        if name in PLACE_AXES and points.size < _FEWEST_PLACES:
            refuse(place, f"has {points.size} {name}; must have at least {_FEWEST_PLACES}")
        twice = np.flatnonzero(np.diff(points) == 0.0)
        if twice.size:
            refuse(place, f"has {name} = {points[twice[0]]:g} {unit} twice; give each once")
