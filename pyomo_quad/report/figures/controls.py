"""The four rotor accelerations over time: the controls in the paper's figures 3 and 5."""

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
from pyomo_quad.report.signals import ROTOR_ACCELERATION
from pyomo_quad.report.style import MUTED

__all__ = ["draw_controls"]


def draw_controls(flights: Sequence[StyledFlight]) -> Figure:
    """Draw the acceleration of each rotor in its own panel, all on one scale.

    Parameters
    ----------
    flights : sequence of StyledFlight
        The flights to lay over each other, the optimum first.

    Returns
    -------
    Figure
        Four panels.
    """
    figure, panels = panel_grid(2, 2, panel_height=1.25, legend_entries=len(flights))
    for axes, signal in zip(panels.flat, ROTOR_ACCELERATION, strict=True):
        for flight in flights:
            draw_over_time(axes, flight.frame, signal, flight.style, flight.name)
        axes.set_title(signal.title)
        axes.axhline(0.0, color=MUTED, linewidth=0.6, zorder=1)
    keep_span(panels.flat, ROTOR_ACCELERATION[0].smallest_span)
    label_time(panels[-1], flights[0].duration_s)
    legend_below(figure, panels[0, 0])
    return figure
