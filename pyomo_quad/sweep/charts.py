"""Charts of a sweep: curves, Pareto fronts, heat maps, wind roses, tornado charts, histograms.

A quantity is an output column of the sweep, with its printed name and unit. A curve holds the cases
that differ in one scenario field only; all other fields are constant along the curve.
"""

from collections.abc import Sequence
from itertools import cycle
from math import ceil, degrees, isnan
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from pyomo_quad.report.style import (
    FULL_WIDTH,
    INK,
    MUTED,
    SERIES_STYLES,
    LineStyle,
    full_width,
    legend_below,
    panel_grid,
)
from pyomo_quad.sweep.case import DURATION_FIELD, HOVER_ENERGY
from pyomo_quad.sweep.quantities import Quantity, field_quantity, number, setting, settings_name
from pyomo_quad.sweep.statistics import Curve, Sensitivity, Spread, best_along, pareto_front

_PANEL_HEIGHT = 2.7  # inches
_STAR_SIZE = 11
# The panel with the Pareto front shows durations up to this multiple of the best duration.
FRONT_ZOOM = 1.6
_LINE_POINTS = 11  # distance between the lines of text in a panel
_BAR: dict[str, Any] = {"edgecolor": "white", "linewidth": 0.0}


def draw_front(curves: Sequence[Curve], quantity: Quantity, tried: Sequence[float]) -> Figure:
    """Draw an output quantity against the mission's duration, and its Pareto front.

    A case is on its curve's front if every shorter case has a larger quantity. A star marks the
    duration with the least quantity. `tried` has all durations of the sweep [s].
    """
    figure, panels = panel_grid(
        1,
        2,
        panel_height=_PANEL_HEIGHT,
        left=0.6,
        gap=0.7,
        legend_entries=len(curves) + 2,
        share_time=False,
    )
    # Left: all durations. Right: the front near the best duration.
    whole, front = panels[0]
    duration = field_quantity(DURATION_FIELD)
    for row, (curve, style) in enumerate(zip(curves, cycle(SERIES_STYLES), strict=False)):
        _plot(whole, curve.rows, (duration, quantity), style, label=settings_name(curve.fixed))
        _draw_front(front, curve, (duration, quantity), style)
        _name_best(front, curve, quantity, tried, (style, row))
    _draw_hover_floor(whole, curves[0], quantity)
    whole.set(title="All durations", xlabel=duration.label, ylabel=quantity.label)
    front.set(title="Pareto front (thick) and best duration (star)", xlabel=duration.label)
    legend_below(figure, whole)
    return figure


def draw_curves(curves: Sequence[Curve], field: str, quantities: Sequence[Quantity]) -> Figure:
    """Draw several output quantities against one scenario field, one panel for each quantity.

    Along each curve, only the field varies. The panels are arranged in two columns.
    """
    figure, panels = _pairs(
        len(quantities),
        panel_height=0.75 * _PANEL_HEIGHT,
        left=0.65,
        gap=0.75,
        legend_entries=len(curves),
    )
    along = field_quantity(field)
    for axes, quantity in zip(panels.flat, quantities, strict=False):
        for curve, style in zip(curves, cycle(SERIES_STYLES), strict=False):
            _plot(axes, curve.rows, (along, quantity), style, label=settings_name(curve.fixed))
        axes.set_title(quantity.label)
    for axes in panels[-1]:
        axes.set_xlabel(along.label)
        axes.xaxis.set_major_locator(MaxNLocator(nbins=6))
    legend_below(figure, panels.flat[0])
    return figure


def _pairs(count: int, **layout: Any) -> tuple[Figure, np.ndarray]:  # noqa: ANN401
    """Make a figure with `count` panels in two columns; hide an unused last panel.

    A single panel has one column. `layout` is passed to `panel_grid`.
    """
    columns = min(2, count)
    figure, panels = panel_grid(ceil(count / columns), columns, **layout)
    for axes in panels.flat[count:]:
        axes.set_visible(False)
    return figure, panels


def _plot(
    axes: Axes, rows: pd.DataFrame, of: tuple[Quantity, Quantity], style: LineStyle, **look: object
) -> None:
    """Draw one quantity of a sweep against another into a panel, with a marker at each case.

    `of` holds the quantities on the horizontal and on the vertical axis. `look` has Matplotlib
    properties of the line, which replace those of `style`.
    """
    over, quantity = of
    marked = style.line | {"marker": style.marker, "markersize": 3.0}
    axes.plot(over.of(rows), quantity.of(rows), **(marked | look))


def _draw_front(axes: Axes, curve: Curve, of: tuple[Quantity, Quantity], style: LineStyle) -> None:
    duration, quantity = of
    front = pareto_front(curve.rows, DURATION_FIELD, quantity.column)
    best = front.iloc[[-1]]
    near = curve.rows[curve.rows[DURATION_FIELD] <= FRONT_ZOOM * best[DURATION_FIELD].iloc[0]]
    _plot(axes, near, of, style, linewidth=0.9)
    axes.plot(duration.of(front), quantity.of(front), color=style.color, linewidth=3.5)
    at, value = float(duration.of(best).iloc[0]), float(quantity.of(best).iloc[0])
    axes.plot(at, value, marker="*", markersize=_STAR_SIZE, color=style.color, mec=INK)


def _name_best(
    axes: Axes,
    curve: Curve,
    quantity: Quantity,
    tried: Sequence[float],
    place: tuple[LineStyle, int],
) -> None:
    """Print a curve's name, best mission duration and least quantity as a line in a panel.

    `tried` has all durations of the sweep [s]. "(at an edge)" is added if the next shorter or next
    longer one has no finished case. `place` has the curve's style and the number of the text line.
    """
    style, row = place
    best = best_along(curve, DURATION_FIELD, quantity.column, tried)
    said = f"{setting(best.at)} s, {number(best.value * quantity.scale)} {quantity.unit}"
    # At an edge, the next shorter or the next longer duration has no finished case.
    edge = "" if best.is_inside else " (at an edge)"
    axes.annotate(
        f"{settings_name(curve.fixed)}: {said}{edge}",
        (0.03, 0.97),
        xycoords="axes fraction",
        xytext=(0, -_LINE_POINTS * row),
        textcoords="offset points",
        va="top",
        color=style.color,
    )


def _draw_hover_floor(axes: Axes, curve: Curve, quantity: Quantity) -> None:
    if quantity.column.endswith("_J") and HOVER_ENERGY in curve.rows:
        axes.plot(
            curve.rows[DURATION_FIELD],
            curve.rows[HOVER_ENERGY],
            color=MUTED,
            linestyle=(0, (1, 1.5)),
            linewidth=1.0,
            label="hovering as long",
        )


# The colour map runs from dark to light when printed in grey, too.
_COLORS = "cividis"
_CELL, _EDGES = 0.34, 1.25  # inches
_MOST_PRINTED = 13
_HALF = 0.5
# A curve that varies by less than this share of the range of all curves has no star.
_SAME = 0.01
_RIM = 0.06  # space outside the largest value of a wind rose, as a share of the range
_STAR: dict[str, Any] = {
    "clip_on": False,
    "linestyle": "none",
    "marker": "*",
    "markeredgecolor": INK,
    "markersize": 11,
    "zorder": 5,
}


def draw_heat_map(plane: pd.DataFrame, quantity: Quantity) -> Figure:
    """Draw an output quantity over two numeric scenario fields as a grid of coloured cells.

    `plane` holds the values of `quantity`, in the unit of its column. Index and columns are the
    values of the fields, named by the fields' dotted paths. A cross marks a failed case (NaN).
    """
    across, up = field_quantity(str(plane.columns.name)), field_quantity(str(plane.index.name))
    height = min(5.0, _EDGES + _CELL * len(plane.index))
    figure, axes = full_width(
        height, left=0.1, right=0.95, top=1 - 0.3 / height, bottom=0.5 / height
    )
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
    """Draw an output quantity against the wind direction, in polar coordinates.

    The centre is the least value of all curves, not zero. A star marks the worst direction of each
    curve (`Quantity.worst_row`). `field` is the dotted path of the direction that the wind blows
    to, in rad.
    """
    figure = Figure(figsize=(FULL_WIDTH, 4.2))
    axes = figure.add_axes((0.04, 0.07, 0.55, 0.76), projection="polar")
    least, greatest = rose_range(curves, quantity)
    angle = Quantity(column=field, name="direction", unit="rad")
    for curve, style in zip(curves, cycle(SERIES_STYLES), strict=False):
        name = settings_name(curve.fixed)
        if quantity.of(curve.rows).agg(np.ptp) > _SAME * (greatest - least):
            worst = quantity.worst_row(curve.rows)
            at, value = float(worst[field]), float(worst[quantity.column]) * quantity.scale
            axes.plot(at, value, color=style.color, **_STAR)
            name += f"\nworst toward {setting(degrees(at))}°: {number(value)} {quantity.unit}"
        _plot(axes, _closed(curve.rows, field), (angle, quantity), style, label=name)
    if greatest > least:
        axes.set_ylim(least, greatest + _RIM * (greatest - least))
    axes.set_title(f"{quantity.label} by where the wind blows to", loc="center", pad=22)
    axes.set_rlabel_position(112.5)  # type: ignore[attr-defined]
    axes.set_xticks(np.radians(range(0, 360, 45)))
    axes.set_xticklabels(["0° (+x)", "45°", "90° (+y)", "135°", "180°", "225°", "270°", "315°"])
    figure.legend(*axes.get_legend_handles_labels(), loc="center left", bbox_to_anchor=(0.66, 0.5))
    return figure


def rose_range(curves: Sequence[Curve], quantity: Quantity) -> tuple[float, float]:
    """Return the least and the greatest value of a quantity over all curves of a wind rose.

    The values are in the quantity's printed unit.
    """
    values = pd.concat([quantity.of(curve.rows) for curve in curves])
    return float(values.min()), float(values.max())


def _closed(rows: pd.DataFrame, field: str) -> pd.DataFrame:
    """Repeat the first direction's row at the end, so that the curve of a wind rose is closed.

    `field` is the column of directions [rad], ascending. If the gap from last to first direction
    exceeds 1.5 times the largest other gap, the curve stays open.
    """
    directions = rows[field].to_numpy(dtype=float)
    steps = np.diff(directions)
    around = directions[0] + 2 * np.pi
    if not steps.size or around - directions[-1] > 1.5 * steps.max():
        return rows
    return pd.concat([rows, rows.iloc[[0]].assign(**{field: around})])


_BAR_ROW, _BAR_EDGES = 0.36, 1.07  # inches
_QUANTILES = (0.05, 0.5, 0.95)
_MOST_BINS = 24
_LABEL_ROOM = 0.14  # space for labels on either side, as a share of the widest bar
_BELOW, _ABOVE = SERIES_STYLES[:2]


def draw_tornado(found: Sequence[Sensitivity], spread: Spread, quantity: Quantity) -> Figure:
    """Draw a tornado chart: the range of an output quantity as each scenario field varies alone.

    The first bar is the range over all cases, `spread`. Its ends are labelled with the numbers of
    the cases that have the least and the greatest value. Each other bar is the range along one
    field, from `found`. Its ends are labelled with the values of the field there.
    """
    height = _BAR_EDGES + _BAR_ROW * (1 + len(found))
    figure, axes = full_width(
        height, left=0.24, right=0.97, top=1 - 0.3 / height, bottom=0.72 / height
    )
    base = found[0].base * quantity.scale
    cases = (f"case {spread.least_case}", f"case {spread.greatest_case}")
    _draw_bar(axes, 0, (spread.least, spread.greatest), cases, base, quantity)
    for row, one in enumerate(found, start=1):
        field = field_quantity(one.field)
        reached = tuple(setting(at * field.scale) for at in (one.least_at, one.greatest_at))
        _draw_bar(axes, row, (one.least, one.greatest), reached, base, quantity)
    if not isnan(base):
        axes.axvline(base, color=INK, linewidth=1.0)
    labels = ["All cases", *(field_quantity(one.field).label for one in found)]
    axes.set_yticks(range(len(labels)), labels)
    axes.invert_yaxis()
    axes.grid(visible=False, axis="y")
    low, high = spread.least * quantity.scale, spread.greatest * quantity.scale
    if high > low:
        axes.set_xlim(low - _LABEL_ROOM * (high - low), high + _LABEL_ROOM * (high - low))
    axes.set(title="Range, with where its ends are reached", xlabel=quantity.label)
    patches = [
        Patch(facecolor=style.color, hatch=style.hatch, label=text, **_BAR)
        for style, text in ((_BELOW, "below the base case"), (_ABOVE, "above it"))
    ]
    at_base = Line2D([], [], color=INK, linewidth=1.0, label=f"base case, {number(base)}")
    handles = patches if isnan(base) else [*patches, at_base]
    figure.legend(handles=handles, loc="lower center", ncols=len(handles))
    return figure


def _draw_bar(
    axes: Axes,
    row: int,
    ends: tuple[float, float],
    reached: tuple[str, ...],
    base: float,
    quantity: Quantity,
) -> None:
    """Draw one horizontal bar of a tornado chart, in two colours: below and above the base value.

    `ends` are in the unit of the column, `base` in the printed unit or NaN if it is unknown. The
    two texts `reached` label the ends.
    """
    low, high = (end * quantity.scale for end in ends)
    split = low if isnan(base) else min(max(base, low), high)
    for start, end, style in ((low, split, _BELOW), (split, high, _ABOVE)):
        look = _BAR | {"color": style.color, "hatch": style.hatch}
        axes.barh(row, end - start, left=start, height=0.6, **look)
    beside: dict[str, Any] = {"textcoords": "offset points", "va": "center", "color": INK}
    axes.annotate(reached[0], (low, row), xytext=(-4, 0), ha="right", **beside)
    axes.annotate(reached[1], (high, row), xytext=(4, 0), ha="left", **beside)


def draw_distributions(rows: pd.DataFrame, quantities: Sequence[Quantity]) -> Figure:
    """Draw a histogram of each output quantity over all cases, in two columns of panels.

    Lines mark the median and the 5 % and 95 % quantiles.
    """
    figure, panels = _pairs(len(quantities), panel_height=2.0, left=0.5, share_time=False)
    style = SERIES_STYLES[0]
    for axes, quantity in zip(panels.flat, quantities, strict=False):
        values = quantity.of(rows).dropna()
        bins = min(_MOST_BINS, max(5, ceil(len(values) ** 0.5)))
        axes.hist(values, bins=bins, color=style.color, edgecolor="white", linewidth=0.6)
        for share in _QUANTILES:
            at = float(values.quantile(share))
            dashes = "solid" if share == _QUANTILES[1] else (0, (3, 2))
            axes.axvline(at, color=INK, linewidth=1.0, linestyle=dashes)
        low, median, high = (f"{values.quantile(share):.3g}" for share in _QUANTILES)
        axes.set_title(f"Median {median}, nine tenths from {low} to {high}")
        axes.xaxis.set_major_locator(MaxNLocator(nbins=6))
        axes.set(xlabel=quantity.label, ylabel="Cases")
    return figure


def draw_scatter(
    rows: pd.DataFrame, fields: Sequence[str], quantities: Sequence[Quantity]
) -> Figure:
    """Draw scatter plots of output quantities against scenario fields whose values are random.

    Each dot is one case. A row of panels belongs to one quantity, a column of panels to one field.
    """
    figure, panels = panel_grid(
        len(quantities), len(fields), panel_height=1.6, left=0.62, gap=0.62, share_time=False
    )
    style = SERIES_STYLES[0]
    for line, quantity in zip(panels, quantities, strict=True):
        for axes, path in zip(line, fields, strict=True):
            field = field_quantity(path)
            axes.scatter(
                field.of(rows), quantity.of(rows), s=9, color=style.color, edgecolor=MUTED, lw=0.3
            )
            axes.set(title=quantity.label, xlabel=field.label)
            axes.xaxis.set_major_locator(MaxNLocator(nbins=6))
    return figure
