"""The run at a glance: the paths, and what each flight spends above hovering."""

from collections.abc import Sequence

from matplotlib.figure import Figure

from pyomo_quad.report.figures.energy import draw_above_hover
from pyomo_quad.report.figures.energy_split import draw_excess
from pyomo_quad.report.figures.panels import label_time, legend_below
from pyomo_quad.report.figures.path import distinct_paths, draw_space
from pyomo_quad.report.flights import StyledFlight
from pyomo_quad.report.style import FULL_WIDTH

__all__ = ["draw_overview"]

_HEIGHT = 4.2  # inches


def draw_overview(
    flights: Sequence[StyledFlight], hover_energy_J: float, absent: frozenset[str]
) -> Figure:
    """Draw the paths in space beside the energy above hovering, over time and in total.

    Parameters
    ----------
    flights : sequence of StyledFlight
        The flights, the optimum first.
    hover_energy_J : float
        Energy of hovering for as long as the mission lasts, J.
    absent : frozenset of str
        Names of the flights that did not arrive.

    Returns
    -------
    Figure
        Three panels.
    """
    figure = Figure(figsize=(FULL_WIDTH, _HEIGHT))
    draw_space(figure.add_axes((0.0, 0.12, 0.46, 0.88), projection="3d"), distinct_paths(flights))
    over_time = figure.add_axes((0.52, 0.69, 0.46, 0.25))
    draw_above_hover(over_time, flights, hover_energy_J / flights[0].duration_s)
    label_time([over_time], flights[0].duration_s)
    in_total = figure.add_axes((0.66, 0.19, 0.32, 0.32))
    draw_excess(in_total, flights, hover_energy_J, absent)
    in_total.set_title("At the end (J)")
    legend_below(figure, over_time)
    return figure
