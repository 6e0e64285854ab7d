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
    """Read and check a wind field [m/s] over places, heights and times from NetCDF, CSV or Parquet.

    The result holds the fields of `wind.grid`. A grid by latitude and longitude needs `origin`.
    Raises ScenarioError, which begins with `place`, if the file is not valid.
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
