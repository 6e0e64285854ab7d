"""A quantity over two fields as a heat map, and over the wind's direction as a rose."""

from collections.abc import Sequence
from itertools import cycle
from math import degrees
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pyomo_quad.report.style import FULL_WIDTH, INK, MUTED, SERIES_STYLES
from pyomo_quad.report.sweep.quantities import (
    Quantity,
    field_quantity,
    number,
    setting,
    settings_name,
)
from pyomo_quad.study.sweep.views import Curve

__all__ = ["draw_heat_map", "draw_wind_rose", "rose_range"]

# Runs from dark to light in grey as well.
_COLORS = "cividis"
_CELL, _EDGES = 0.34, 1.25  # inches
_MOST_PRINTED = 13
_HALF = 0.5
# A curve that varies by less than this share of the picture has no worst direction to see.
_SAME = 0.01
_RIM = 0.06
_STAR: dict[str, Any] = {
    "clip_on": False,
    "linestyle": "none",
    "marker": "*",
    "markeredgecolor": INK,
    "markersize": 11,
    "zorder": 5,
}


def draw_heat_map(plane: pd.DataFrame, quantity: Quantity) -> Figure:
    """Draw a quantity over two numeric fields.

    Parameters
    ----------
    plane : DataFrame
        Index and columns are the two fields, named by their paths; NaN where no case finished.
    quantity : Quantity
        What the plane holds.

    Returns
    -------
    Figure
        One cell per case; cells without a result are crossed.
    """
    across, up = field_quantity(str(plane.columns.name)), field_quantity(str(plane.index.name))
    height = min(5.0, _EDGES + _CELL * len(plane.index))
    figure = Figure(figsize=(FULL_WIDTH, height))
    axes = figure.subplots()
    figure.subplots_adjust(left=0.1, right=0.95, top=1 - 0.3 / height, bottom=0.5 / height)
    values = plane.to_numpy(dtype=float) * quantity.scale
    picture = axes.imshow(values, origin="lower", aspect="auto", cmap=_COLORS)
    figure.colorbar(picture, ax=axes, pad=0.02, fraction=0.06)
    axes.grid(visible=False)
    axes.set_xticks(range(values.shape[1]), _ticks(plane.columns, across))
    axes.set_yticks(range(values.shape[0]), _ticks(plane.index, up))
    axes.set(title=quantity.label, xlabel=across.label, ylabel=up.label)
    _print_cells(axes, values)
    return figure


def _ticks(steps: pd.Index, field: Quantity) -> list[str]:
    return [setting(float(step)) for step in steps.to_numpy(dtype=float) * field.scale]


def _print_cells(axes: Axes, values: np.ndarray) -> None:
    middle = np.nanmin(values) + _HALF * (np.nanmax(values) - np.nanmin(values))
    are_printed = values.shape[1] <= _MOST_PRINTED
    for (row, column), value in np.ndenumerate(values):
        if np.isnan(value):
            axes.plot(column, row, marker="x", color=MUTED, markersize=7)
        elif are_printed:
            color = "white" if value < middle else INK
            axes.text(
                column, row, number(value), ha="center", va="center", color=color, fontsize=6.5
            )


def draw_wind_rose(curves: Sequence[Curve], field: str, quantity: Quantity) -> Figure:
    """Draw a quantity around the compass.

    Parameters
    ----------
    curves : sequence of Curve
        Along the wind's direction.
    field : str
        The direction, an angle in rad.
    quantity : Quantity
        The distance from the centre.

    Returns
    -------
    Figure
        A polar panel, +x to the right and +y up, whose centre is the least value of all curves;
        beside it a legend with the worst direction of each curve, which a star marks.
    """
    figure = Figure(figsize=(FULL_WIDTH, 4.2))
    axes = figure.add_axes((0.04, 0.07, 0.55, 0.76), projection="polar")
    least, greatest = rose_range(curves, quantity)
    for curve, style in zip(curves, cycle(SERIES_STYLES), strict=False):
        angles, values = _closed(curve.rows[field], quantity.of(curve.rows))
        look = style.line | {"marker": style.marker, "markersize": 3.0}
        name = settings_name(curve.fixed)
        if quantity.of(curve.rows).agg(np.ptp) > _SAME * (greatest - least):
            worst = quantity.worst_row(curve.rows)
            at, value = float(worst[field]), float(worst[quantity.column]) * quantity.scale
            axes.plot(at, value, color=style.color, **_STAR)
            name += f"\nworst toward {setting(degrees(at))}°: {number(value)} {quantity.unit}"
        axes.plot(angles, values, label=name, **look)
    if greatest > least:
        axes.set_ylim(least, greatest + _RIM * (greatest - least))
    axes.set_title(f"{quantity.label} by where the wind blows to", loc="center", pad=22)
    axes.set_rlabel_position(112.5)  # type: ignore[attr-defined]
    axes.set_xticks(np.radians(range(0, 360, 45)))
    axes.set_xticklabels(["0° (+x)", "45°", "90° (+y)", "135°", "180°", "225°", "270°", "315°"])
    figure.legend(*axes.get_legend_handles_labels(), loc="center left", bbox_to_anchor=(0.66, 0.5))
    return figure


def rose_range(curves: Sequence[Curve], quantity: Quantity) -> tuple[float, float]:
    """Return the least and the greatest value of all curves of a rose, in the printed unit."""
    values = pd.concat([quantity.of(curve.rows) for curve in curves])
    return float(values.min()), float(values.max())


def _closed(angles: pd.Series, values: pd.Series) -> tuple[np.ndarray, np.ndarray]:
    """Join the last direction to the first, unless a gap is left between them."""
    directions, distances = angles.to_numpy(dtype=float), values.to_numpy(dtype=float)
    steps = np.diff(directions)
    if not steps.size or directions[0] + 2 * np.pi - directions[-1] > 1.5 * steps.max():
        return directions, distances
    return np.append(directions, directions[0] + 2 * np.pi), np.append(distances, distances[0])
