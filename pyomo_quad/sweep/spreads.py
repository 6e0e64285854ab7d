"""What matters most, as a tornado chart, and how a random quantity is distributed."""

from collections.abc import Sequence
from math import ceil, isnan

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from pyomo_quad.report.style import FULL_WIDTH, INK, MUTED, SERIES_STYLES, panel_grid
from pyomo_quad.sweep.quantities import Quantity, field_quantity, number, setting
from pyomo_quad.sweep.views import Sensitivity, Spread

_ROW, _EDGES = 0.36, 1.07  # inches
_PANEL_HEIGHT = 2.0  # inches
_QUANTILES = (0.05, 0.5, 0.95)
_MOST_BINS = 24
_LABEL_ROOM = 0.14  # of the widest bar, on either side
_BELOW, _ABOVE = SERIES_STYLES[:2]


def draw_tornado(found: Sequence[Sensitivity], spread: Spread, quantity: Quantity) -> Figure:
    """Draw by how much a quantity swings over all cases, and with each field."""
    height = _EDGES + _ROW * (1 + len(found))
    figure = Figure(figsize=(FULL_WIDTH, height))
    axes = figure.subplots()
    figure.subplots_adjust(left=0.24, right=0.97, top=1 - 0.3 / height, bottom=0.72 / height)
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
        Patch(
            facecolor=style.color, hatch=style.hatch, edgecolor="white", linewidth=0.0, label=text
        )
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
    """Draw a range in two colours that meet at the base case, in one where that case failed."""
    low, high = (end * quantity.scale for end in ends)
    split = low if isnan(base) else min(max(base, low), high)
    for start, end, style in ((low, split, _BELOW), (split, high, _ABOVE)):
        axes.barh(
            row,
            end - start,
            left=start,
            height=0.6,
            color=style.color,
            hatch=style.hatch,
            edgecolor="white",
            linewidth=0.0,
        )
    for end, text, side, anchor in (
        (low, reached[0], -4, "right"),
        (high, reached[1], 4, "left"),
    ):
        axes.annotate(
            text,
            (end, row),
            xytext=(side, 0),
            textcoords="offset points",
            ha=anchor,
            va="center",
            color=INK,
        )


def draw_distributions(rows: pd.DataFrame, quantities: Sequence[Quantity]) -> Figure:
    """Draw histograms with the median and the middle nine tenths.

    Returns
    -------
    Figure
        Two panels in a row.
    """
    columns = min(2, len(quantities))
    figure, panels = panel_grid(
        ceil(len(quantities) / columns),
        columns,
        panel_height=_PANEL_HEIGHT,
        left=0.5,
        share_time=False,
    )
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
    for axes in panels.flat[len(quantities) :]:
        axes.set_visible(False)
    return figure


def draw_scatter(
    rows: pd.DataFrame, fields: Sequence[str], quantities: Sequence[Quantity]
) -> Figure:
    """Draw each quantity against each random field.

    Parameters
    ----------
    fields : sequence of str
        Numeric fields, one column of panels each.
    """
    figure, panels = panel_grid(
        len(quantities),
        len(fields),
        panel_height=_PANEL_HEIGHT * 0.8,
        left=0.62,
        gap=0.62,
        share_time=False,
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


def linear_note(spread: Spread) -> str:
    """Say how much of a spread the straight lines over the random fields account for.

    Begins with a semicolon; empty where no field is random.
    """
    if isnan(spread.linear_share):
        return ""
    return (
        "; of random fields the linear effect over the middle nine tenths of their draws, which "
        f"explains {100.0 * spread.linear_share:.3g} % of the variance"
    )
