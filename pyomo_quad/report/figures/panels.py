"""What the panels of several figures have in common.

Panels are placed by inches and not by an automatic layout, which would take longer than drawing.
"""

from collections.abc import Iterable
from math import ceil

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from pyomo_quad.report.signals import TIME, Signal
from pyomo_quad.report.style import FULL_WIDTH, LineStyle

__all__ = [
    "LEGEND_COLUMNS",
    "TICK_STEPS",
    "draw_over_time",
    "keep_span",
    "label_time",
    "legend_below",
    "panel_grid",
]

_MARGIN = 0.06
_LEGEND_LINE = 0.2  # inches
TICK_STEPS = (1, 2, 5, 10)

LEGEND_COLUMNS = 4


def panel_grid(
    rows: int,
    columns: int,
    *,
    panel_height: float,
    gap: float = 0.6,
    left: float = 0.5,
    legend_entries: int = 1,
    share_time: bool = True,
) -> tuple[Figure, np.ndarray]:
    """Lay out a figure of equal panels with titles above them and a legend below.

    Parameters
    ----------
    rows, columns : int
        Number of panels.
    panel_height : float
        Inches.
    gap, left : float
        Inches between columns and left of the first, room for tick labels.
    legend_entries : int, default 1
        Number of entries of the legend below; a single one needs no legend.
    share_time : bool, default True
        Whether panels above each other have one horizontal axis.

    Returns
    -------
    figure : Figure
        The figure.
    panels : ndarray of Axes, shape (rows, columns)
        Its panels.
    """
    right, top = 0.12, 0.28
    gap_y = 0.36 if share_time else 0.72
    legend_lines = ceil(legend_entries / LEGEND_COLUMNS) if legend_entries > 1 else 0
    bottom = 0.5 + _LEGEND_LINE * legend_lines
    height = top + rows * panel_height + (rows - 1) * gap_y + bottom
    panel_width = (FULL_WIDTH - left - right - (columns - 1) * gap) / columns
    figure = Figure(figsize=(FULL_WIDTH, height))
    panels = figure.subplots(rows, columns, sharex=share_time, squeeze=False)
    figure.subplots_adjust(
        left=left / FULL_WIDTH,
        right=1 - right / FULL_WIDTH,
        top=1 - top / height,
        bottom=bottom / height,
        wspace=gap / panel_width,
        hspace=gap_y / panel_height,
    )
    return figure, panels


def draw_over_time(
    axes: Axes, frame: pd.DataFrame, signal: Signal, style: LineStyle, label: str
) -> None:
    """Draw one signal of one flight against time.

    Parameters
    ----------
    axes : Axes
        The panel.
    frame : DataFrame
        The flight.
    signal : Signal
        What to draw.
    style : LineStyle
        How the line looks.
    label : str
        The line's name in the legend.
    """
    axes.plot(TIME.of(frame), signal.of(frame), label=label, **style.line)


def keep_span(panels: Iterable[Axes], smallest_span: float) -> None:
    """Give panels one vertical scale, which does not blow up what hardly varies.

    Parameters
    ----------
    panels : iterable of Axes
        The panels, with their lines drawn.
    smallest_span : float
        Least difference between the ends of the axis, printed unit.
    """
    panels = tuple(panels)
    ends = np.array([axes.dataLim.intervaly for axes in panels])
    low, high = ends.min(), ends.max()
    middle, half = (low + high) / 2, max(high - low, smallest_span) / 2
    for axes in panels:
        axes.set_ylim(middle - half * (1 + _MARGIN), middle + half * (1 + _MARGIN))
        axes.yaxis.set_major_locator(MaxNLocator(nbins=5, steps=TICK_STEPS))


def label_time(panels: Iterable[Axes], duration: float) -> None:
    """Name the time axis of the lowest panels and end it with the flight.

    Parameters
    ----------
    panels : iterable of Axes
        The lowest panels.
    duration : float
        End of the flight, s.
    """
    for axes in panels:
        axes.set_xlabel(TIME.label)
        axes.set_xlim(0.0, duration)
        axes.xaxis.set_major_locator(MaxNLocator(nbins=6, steps=TICK_STEPS))


def legend_below(figure: Figure, axes: Axes) -> None:
    """Put one legend for the whole figure under its panels, if there is anything to tell apart.

    Parameters
    ----------
    figure : Figure
        A figure with room for the legend.
    axes : Axes
        A panel that holds every line to be named.
    """
    handles, labels = axes.get_legend_handles_labels()
    if len(labels) > 1:
        figure.legend(handles, labels, loc="lower center", ncols=min(LEGEND_COLUMNS, len(labels)))
