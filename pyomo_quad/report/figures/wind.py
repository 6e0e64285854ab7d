"""The wind over time: the paper's figure 7."""

from matplotlib.figure import Figure

from pyomo_quad.report.figures.panels import keep_span, label_time, legend_below, panel_grid
from pyomo_quad.report.flights import StyledFlight
from pyomo_quad.report.signals import TIME, WIND
from pyomo_quad.report.style import INK, MUTED, LineStyle

__all__ = ["draw_wind", "is_calm"]

# The wind is no flight: it has none of their colours.
_WIND = LineStyle(color=INK, width=1.9)
_FORECAST = LineStyle(color=MUTED, dashes=(4.5, 1.6))


def draw_wind(told: StyledFlight, flown: StyledFlight | None = None) -> Figure:
    """Draw both components of the wind, and the forecast where one differs from it.

    Parameters
    ----------
    told : StyledFlight
        A flight in the wind that the optimiser was told.
    flown : StyledFlight, optional
        A flight in the real wind, when the optimiser was told another.

    Returns
    -------
    Figure
        One panel per axis.
    """
    figure, panels = panel_grid(1, 2, panel_height=1.5, legend_entries=0 if flown is None else 2)
    forecast = [] if flown is None else [("forecast", told, _FORECAST)]
    winds = [("wind", told if flown is None else flown, _WIND), *forecast]
    for axes, signal in zip(panels.flat, WIND, strict=True):
        for label, flight, style in winds:
            axes.plot(TIME.of(flight.frame), signal.of(flight.frame), label=label, **style.line)
        axes.axhline(0.0, color=MUTED, linewidth=0.6, zorder=1)
        axes.set_title(signal.title)
    keep_span(panels.flat, WIND[0].smallest_span)
    label_time(panels.flat, told.duration_s)
    if flown is not None:
        legend_below(figure, panels[0, 0])
    return figure


def is_calm(*flights: StyledFlight) -> bool:
    """Return whether no wind blows in any of the flights, so that there is nothing to draw."""
    return not any(signal.of(flight.frame).any() for flight in flights for signal in WIND)
