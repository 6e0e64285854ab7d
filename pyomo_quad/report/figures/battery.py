"""Voltage, current and state of charge of the battery: the paper's figure 2."""

from collections.abc import Sequence

from matplotlib.figure import Figure

from pyomo_quad.report.figures.panels import (
    draw_over_time,
    keep_span,
    label_time,
    legend_below,
    panel_grid,
)
from pyomo_quad.report.flights import StyledFlight
from pyomo_quad.report.signals import BATTERY

__all__ = ["draw_battery"]


def draw_battery(flights: Sequence[StyledFlight]) -> Figure:
    """Draw what the flights ask of the pack.

    Parameters
    ----------
    flights : sequence of StyledFlight
        The flights to lay over each other, the optimum first.

    Returns
    -------
    Figure
        One panel per quantity.
    """
    figure, panels = panel_grid(1, 3, panel_height=1.7, legend_entries=len(flights))
    for axes, signal in zip(panels.flat, BATTERY, strict=True):
        for flight in flights:
            draw_over_time(axes, flight.frame, signal, flight.style, flight.name)
        axes.set_title(signal.title)
        keep_span([axes], signal.smallest_span)
    label_time(panels.flat, flights[0].duration_s)
    legend_below(figure, panels[0, 0])
    return figure
