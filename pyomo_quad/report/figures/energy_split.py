"""The energy of each flight as a hover floor and what is spent above it."""

from collections.abc import Sequence
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pyomo_quad.report.flights import StyledFlight
from pyomo_quad.report.style import FULL_WIDTH, INK, MUTED, PALE

__all__ = ["draw_energy_split", "draw_excess"]

_ROW, _EDGES = 0.32, 0.95  # inches
_BAR = 0.62  # of the row
_NUMBER_ROOM = 1.28  # the axis goes on past the longest bar for the numbers beside the bars


def draw_energy_split(
    flights: Sequence[StyledFlight], hover_energy_J: float, absent: frozenset[str]
) -> Figure:
    """Draw the whole energy from zero, and beside it what lies above the hover floor.

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
        Two panels of horizontal bars, one bar per flight.
    """
    height = _EDGES + _ROW * len(flights)
    figure = Figure(figsize=(FULL_WIDTH, height))
    whole, above = figure.subplots(1, 2, sharey=True)
    figure.subplots_adjust(
        left=0.24, right=0.99, top=1 - 0.3 / height, bottom=0.62 / height, wspace=0.07
    )
    rows = range(len(flights))
    whole.barh(rows, hover_energy_J, color=PALE, edgecolor=MUTED, linewidth=0.6, height=_BAR)
    for row, flight in zip(rows, flights, strict=True):
        surplus = flight.energy_J - hover_energy_J
        whole.barh(row, surplus, left=hover_energy_J, **_look(flight))
    _annotate(whole, [flight.energy_J for flight in flights])
    whole.set(title="Whole: hover floor (grey) and the rest", xlabel="Energy (J)")
    draw_excess(above, flights, hover_energy_J, absent)
    above.set(title="Above the hover floor only", xlabel="Energy above hovering (J)")
    return figure


def draw_excess(
    axes: Axes, flights: Sequence[StyledFlight], hover_energy_J: float, absent: frozenset[str]
) -> None:
    """Draw one bar per flight for its energy above the hover floor, the first on top.

    Parameters
    ----------
    axes : Axes
        Where to.
    flights : sequence of StyledFlight
        The flights, the optimum first.
    hover_energy_J : float
        Energy of hovering for as long as the mission lasts, J.
    absent : frozenset of str
        Names of the flights that did not arrive.
    """
    excess = [flight.energy_J - hover_energy_J for flight in flights]
    for row, (flight, surplus) in enumerate(zip(flights, excess, strict=True)):
        axes.barh(row, surplus, **_look(flight))
    _annotate(axes, excess)
    labels = [f"{f.name}\n(did not arrive)" if f.name in absent else f.name for f in flights]
    axes.set_yticks(range(len(flights)), labels)
    axes.invert_yaxis()


def _look(flight: StyledFlight) -> dict[str, Any]:
    style = flight.style
    return {
        "color": style.color,
        "edgecolor": "white",
        "hatch": style.hatch,
        "linewidth": 0.0,
        "height": _BAR,
    }


def _annotate(axes: Axes, values: Sequence[float]) -> None:
    axes.grid(visible=False, axis="y")
    axes.tick_params(axis="y", length=0)
    for row, value in enumerate(values):
        axes.annotate(
            f"{value:.1f}",
            (max(value, 0.0), row),
            xytext=(4, 0),
            textcoords="offset points",
            va="center",
            color=INK,
        )
    low, high = min(0.0, *values), max(0.0, *values)
    axes.set_xlim(low * _NUMBER_ROOM, low + (high - low) * _NUMBER_ROOM)
    if low < 0.0:
        axes.axvline(0.0, color=MUTED, linewidth=0.6)
