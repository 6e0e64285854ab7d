"""Figures of terrain: contour lines on a map, hills in a side view, heights along a path."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pyomo_quad.report.flight_figures import way_flown
from pyomo_quad.report.signals import POSITION
from pyomo_quad.report.style import StyledFlight, legend_below, panel_grid
from pyomo_quad.report.zones import ZONE_COLOR
from pyomo_quad.scenario.airspace import Airspace, TerrainGrid

GROUND_COLOR = "#8a7a5c"
_FILL: dict[str, Any] = {"color": GROUND_COLOR, "alpha": 0.35, "linewidth": 0.0, "zorder": 0.5}
_CONTOURS = 8
_LIMIT_LINE: dict[str, Any] = {"color": ZONE_COLOR, "linewidth": 1.0, "linestyle": (0, (4, 2))}
_BELOW_END: dict[str, Any] = {
    "xytext": (0, -9),
    "textcoords": "offset points",
    "fontsize": 7,
    "zorder": 5,
}
_BELOW = 0.08  # space below the lowest ground, as a share of the range of heights
# Limits of height above the ground: field of the airspace, and side on which the smooth surface
# lies that stands for the terrain (1: nowhere below the terrain, -1: nowhere above).
_LIMITS = (("floor", 1), ("ceiling", -1))


def draw_relief(axes: Axes, ground: TerrainGrid | None, directions: tuple[int, int]) -> None:
    """Draw terrain into a figure of paths: contour lines from above, hills from a side.

    `directions` are the horizontal and the vertical axis of the panel: 0 for x, 1 for y, 2 for z.
    """
    if ground is None:
        return
    x, y, heights = np.array(ground.x), np.array(ground.y), ground.elevations
    if set(directions) == {0, 1}:
        levels = axes.contour(
            x, y, heights.T, _CONTOURS, colors=GROUND_COLOR, linewidths=0.6, zorder=0.5
        )
        axes.clabel(levels, fontsize=6, fmt="%g")
        return
    along, across = ((x, 1), (y, 0))[directions[0]]
    axes.fill_between(along, heights.max(axis=across), heights.min(), **_FILL)


def draw_heights(flights: Sequence[StyledFlight], airspace: Airspace) -> Figure:
    """Draw the height of flights over path length, with the ground below the first flight.

    The ground is the smooth surface of `Airspace.height_above_ground`. Dashed lines show the least
    and the greatest permitted height.
    """
    figure, ((axes,),) = panel_grid(
        1, 1, panel_height=2.1, legend_entries=1 + len(flights), share_time=False
    )
    first = flights[0].frame
    way = way_flown(first)
    places = np.column_stack([signal.of(first) for signal in POSITION])
    ground = places[:, 2] - airspace.height_above_ground(places)
    bottom = ground.min() - _BELOW * np.ptp([*ground, *places[:, 2]])
    axes.fill_between(way, ground, bottom, label="ground", **_FILL)
    for name, side in _LIMITS:
        height = getattr(airspace, name)
        if height is not None:
            surface = places[:, 2] - airspace.height_above_ground(places, side)
            axes.plot(way, surface + height, **_LIMIT_LINE)
            end = way[-1], surface[-1] + height
            axes.annotate(name, end, color=ZONE_COLOR, ha="right", **_BELOW_END)
    for flight in flights:
        height = POSITION[2].of(flight.frame)
        axes.plot(way_flown(flight.frame), height, label=flight.name, **flight.style.line)
    axes.set(xlabel="Way flown (m)", ylabel="z (m)", xlim=(0.0, None), ylim=(bottom, None))
    legend_below(figure, axes)
    return figure
