"""Speed, torque, current and voltage of the four motors in one flight."""

from matplotlib.figure import Figure

from pyomo_quad.flight.columns import ROTORS
from pyomo_quad.report.figures.panels import (
    draw_over_time,
    keep_span,
    label_time,
    legend_below,
    panel_grid,
)
from pyomo_quad.report.flights import StyledFlight
from pyomo_quad.report.signals import MOTOR
from pyomo_quad.report.style import ROTOR_STYLES

__all__ = ["draw_rotors"]


def draw_rotors(flight: StyledFlight) -> Figure:
    """Draw the motors' mechanical and electrical quantities.

    Parameters
    ----------
    flight : StyledFlight
        The flight.

    Returns
    -------
    Figure
        One panel per quantity, four lines in each.
    """
    figure, panels = panel_grid(2, 2, panel_height=1.45, legend_entries=len(ROTORS))
    for axes, signals in zip(panels.flat, MOTOR, strict=True):
        for rotor, signal, style in zip(ROTORS, signals, ROTOR_STYLES, strict=True):
            draw_over_time(axes, flight.frame, signal, style, f"rotor {rotor}")
        axes.set_title(signals[0].label)
        keep_span([axes], signals[0].smallest_span)
    label_time(panels[-1], flight.duration_s)
    legend_below(figure, panels[0, 0])
    return figure
