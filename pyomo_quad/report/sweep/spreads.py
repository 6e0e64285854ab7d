"""What matters most, as a tornado chart, and how a random quantity is distributed."""

from collections.abc import Sequence
from math import ceil

import pandas as pd
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from pyomo_quad.report.figures.panels import panel_grid
from pyomo_quad.report.style import FLIGHT_STYLES, FULL_WIDTH, INK, MUTED
from pyomo_quad.report.sweep.quantities import Quantity, field_quantity, setting
from pyomo_quad.study.sweep.views import Sensitivity

__all__ = ["draw_distributions", "draw_scatter", "draw_tornado"]

_ROW, _EDGES = 0.36, 0.85  # inches
_PANEL_HEIGHT = 2.0  # inches
_QUANTILES = (0.05, 0.5, 0.95)
_MOST_BINS = 24


def draw_tornado(found: Sequence[Sensitivity], quantity: Quantity) -> Figure:
    """Draw by how much a quantity swings with each field.

    Parameters
    ----------
    found : sequence of Sensitivity
        Largest swing first.
    quantity : Quantity
        What swings.

    Returns
    -------
    Figure
        One bar per field, with the field's ends at the bar's.
    """
    height = _EDGES + _ROW * len(found)
    figure = Figure(figsize=(FULL_WIDTH, height))
    axes = figure.subplots()
    figure.subplots_adjust(left=0.24, right=0.97, top=1 - 0.3 / height, bottom=0.5 / height)
    low_style, high_style = FLIGHT_STYLES[0], FLIGHT_STYLES[1]
    for row, one in enumerate(found):
        field = field_quantity(one.field)
        ends = (
            (one.least_at, one.least, low_style),
            (one.greatest_at, one.greatest, high_style),
        )
        middle = (one.least + one.greatest) / 2 * quantity.scale
        for value, reached, style in ends:
            end = reached * quantity.scale
            axes.barh(
                row,
                end - middle,
                left=middle,
                height=0.6,
                color=style.color,
                hatch=style.hatch,
                edgecolor="white",
                linewidth=0.0,
            )
            is_left = end < middle
            axes.annotate(
                setting(value * field.scale),
                (end, row),
                xytext=(-4 if is_left else 4, 0),
                textcoords="offset points",
                ha="right" if is_left else "left",
                va="center",
                color=INK,
            )
    axes.set_yticks(range(len(found)), [field_quantity(one.field).label for one in found])
    axes.invert_yaxis()
    axes.grid(visible=False, axis="y")
    axes.margins(x=0.14)
    axes.set(title="Range along each field, with where its ends are reached", xlabel=quantity.label)
    return figure


def draw_distributions(rows: pd.DataFrame, quantities: Sequence[Quantity]) -> Figure:
    """Draw histograms with the median and the middle nine tenths.

    Parameters
    ----------
    rows : DataFrame
        Finished cases.
    quantities : sequence of Quantity
        One panel each.

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
    style = FLIGHT_STYLES[0]
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
    rows : DataFrame
        Finished cases.
    fields : sequence of str
        Numeric fields, one column of panels each.
    quantities : sequence of Quantity
        One row of panels each.

    Returns
    -------
    Figure
        A grid of panels.
    """
    figure, panels = panel_grid(
        len(quantities),
        len(fields),
        panel_height=_PANEL_HEIGHT * 0.8,
        left=0.62,
        gap=0.62,
        share_time=False,
    )
    style = FLIGHT_STYLES[0]
    for line, quantity in zip(panels, quantities, strict=True):
        for axes, path in zip(line, fields, strict=True):
            field = field_quantity(path)
            axes.scatter(
                field.of(rows), quantity.of(rows), s=9, color=style.color, edgecolor=MUTED, lw=0.3
            )
            axes.set(title=quantity.label, xlabel=field.label)
            axes.xaxis.set_major_locator(MaxNLocator(nbins=6))
    return figure
