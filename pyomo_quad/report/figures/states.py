"""The sixteen states over time: the paper's figures 3 and 5."""

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
from pyomo_quad.report.signals import STATE_GRID

__all__ = ["draw_states"]


def draw_states(flights: Sequence[StyledFlight]) -> Figure:
    """Draw all states, one panel each: rows for place, velocity, attitude and body rates.

    Parameters
    ----------
    flights : sequence of StyledFlight
        The flights to lay over each other, the optimum first.

    Returns
    -------
    Figure
        Sixteen panels.
    """
    figure, panels = panel_grid(
        4, 4, panel_height=1.15, gap=0.52, left=0.42, legend_entries=len(flights)
    )
    for row, signals in zip(panels, STATE_GRID, strict=True):
        for axes, signal in zip(row, signals, strict=True):
            for flight in flights:
                draw_over_time(axes, flight.frame, signal, flight.style, flight.name)
            axes.set_title(signal.title)
            keep_span([axes], signal.smallest_span)
    keep_span(panels[:, -1], STATE_GRID[0][-1].smallest_span)
    label_time(panels[-1], flights[0].duration_s)
    legend_below(figure, panels[0, 0])
    return figure
