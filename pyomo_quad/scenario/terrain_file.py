"""Reading of terrain (heights of the ground on a grid) from NetCDF, CSV or Parquet files."""

from pathlib import Path
from typing import Any

import numpy as np

from pyomo_quad.scenario.earth import GLOBE, GeodeticOrigin
from pyomo_quad.scenario.gridded import (
    LENGTHS,
    PLACE_AXES,
    Quantity,
    check_axes,
    in_metres,
    read_gridded,
)
from pyomo_quad.scenario.messages import refuse
from pyomo_quad.scenario.packed_arrays import packed

_HEIGHT = Quantity(
    word="height",
    axes=PLACE_AXES,
    names=(
        (
            "surface_altitude",
            "elevation",
            "altitude",
            "height",
            "dem",
            "topo",
            "z",
            "band1",
            "height_m",
        ),
    ),
    columns=("height_m",),
    needed=1,
    units=LENGTHS,
)
_MOST_HEIGHTS = 1_000_000
_LOWEST, _HIGHEST, _ = GLOBE["altitude"]


def read_terrain(file: Path, place: str, origin: GeodeticOrigin | None = None) -> dict[str, Any]:
    """Read and check the heights of the ground on a grid, from NetCDF, CSV or Parquet.

    The result holds the fields of `airspace.ground`. Heights in the file are above the sea with
    `origin`, else above z = 0. Raises ScenarioError if the file is not valid. Its message begins
    with `place`, a text that names the scenario field and the file.
    """
    read = read_gridded(file, place, _HEIGHT)
    field = in_metres(read, origin, place)
    x, y = (field.axes[axis] for axis in PLACE_AXES)
    check_axes(field.axes, place)
    (heights,) = field.components
    if heights.size > _MOST_HEIGHTS:
        refuse(
            place,
            f"has {heights.size} heights; must have at most {_MOST_HEIGHTS}; cut out the region "
            "that is flown, or thin it",
        )
    if not np.isfinite(heights).all():
        i, j = np.argwhere(~np.isfinite(heights))[0]
        where = ", ".join(
            f"{name} = {read.axes[name][k]:.7g}" for name, k in zip(PLACE_AXES, (i, j), strict=True)
        )
        refuse(place, f"has no height at {where}; fill the missing cells")
    extremes = heights.min(), heights.max()
    for extreme in extremes:
        if not _LOWEST <= extreme <= _HIGHEST:
            refuse(
                place,
                f"has a height of {extreme:g} m; must be from {_LOWEST:g} to {_HIGHEST:g} m: fill "
                "missing cells, and give the unit of the heights",
            )
    if origin is not None:
        heights = heights - origin.altitude
    if origin is not None and read.on_earth:
        # z counts from the tangent plane at the origin, below which the earth's surface drops.
        east, north = np.meshgrid(*(read.axes[axis] for axis in PLACE_AXES), indexing="ij")
        globe = np.column_stack([north.ravel(), east.ravel(), heights.ravel()])
        heights = origin.local(globe)[:, 2].reshape(heights.shape)
    return {"x": tuple(x.tolist()), "y": tuple(y.tolist()), "heights": packed(heights)}
