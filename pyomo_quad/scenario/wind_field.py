"""Reading of wind fields (wind over places, heights and times) from NetCDF, CSV or Parquet."""

from pathlib import Path
from typing import Any

import numpy as np

from pyomo_quad.scenario.earth import GeodeticOrigin
from pyomo_quad.scenario.gridded import (
    AXES,
    Quantity,
    check_axes,
    in_metres,
    read_gridded,
)
from pyomo_quad.scenario.messages import refuse
from pyomo_quad.scenario.packed_arrays import packed
from pyomo_quad.scenario.wind import KNOT, LARGEST_WIND, STRONGEST_GUST

_WIND = Quantity(
    word="wind",
    axes=AXES,
    names=(
        ("eastward_wind", "x_wind", "u", "wind_x", "wind_x_m_per_s"),
        ("northward_wind", "y_wind", "v", "wind_y", "wind_y_m_per_s"),
        ("upward_air_velocity", "w", "wind_z", "wind_z_m_per_s"),
    ),
    columns=("wind_x_m_per_s", "wind_y_m_per_s", "wind_z_m_per_s"),
    needed=2,
    units={
        "m s-1": 1.0,
        "m/s": 1.0,
        "m s^-1": 1.0,
        "m s**-1": 1.0,
        "km h-1": 1.0 / 3.6,
        "km/h": 1.0 / 3.6,
        "knot": KNOT,
        "knots": KNOT,
        "kt": KNOT,
    },
)


def read_wind_field(file: Path, place: str, origin: GeodeticOrigin | None = None) -> dict[str, Any]:
    """Read and check a wind field: wind over places, heights and times.

    Parameters
    ----------
    file : Path
        NetCDF with names and units of the CF conventions, or a CSV or Parquet table with one row
        for each place and time.
    place : str
        Beginning of error messages: the scenario field that names the file.
    origin : GeodeticOrigin, optional
        Position of x = y = z = 0 on earth, for a grid by latitude and longitude or with altitudes.

    Returns
    -------
    dict
        Fields of the table `wind.grid`: grid points `x`, `y` and, if the file has them, `z` [m] and
        `times` [s], and wind velocities `speeds` [m/s], as text (see `packed`).

    Raises
    ------
    ScenarioError
        If the file cannot be read, or has no rectilinear grid, no wind or an implausibly strong
        wind. The message is a single line.
    """
    axes, components, *_ = in_metres(read_gridded(file, place, _WIND), origin, place)
    check_axes(axes, place)
    has_wind = np.isfinite(components).all(axis=0)
    if not has_wind.any():
        refuse(place, "has no place with wind; every cell is missing")
    strongest = float(np.abs(components[:, has_wind]).max())
    if strongest > LARGEST_WIND:
        refuse(
            place,
            f"has a wind of {strongest:g} m/s; must be within {LARGEST_WIND:g} m/s: "
            f"{STRONGEST_GUST}",
        )
    held = {"times" if name == "time" else name: tuple(axes[name].tolist()) for name in axes}
    return {**held, "speeds": packed(components)}
