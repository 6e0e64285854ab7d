"""Bar charts of the energies of flights: total, above hovering, and by scenario.

The energy above hovering is a flight's energy less the energy of hovering for the same time.
"""

from collections.abc import Sequence
from typing import Any

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pyomo_quad.report.style import (
    FULL_WIDTH,
    INK,
    MUTED,
    PALE,
    StyledFlight,
    flight_styles,
    have_equal_durations,
)
from pyomo_quad.study.certificate import SAME_TIME
from pyomo_quad.study.comparison import ComparisonColumn

_ROW, _EDGES = 0.32, 0.95  # inches
BAR_WIDTH = 0.62  # height of a bar, as a share of its row
_ABSENT = 0.35  # opacity of the bar of a flight that did not arrive
_TITLE = 0.35  # height of a panel's title, inches
_NUMBER_ROOM = 1.28  # the axis is longer than the longest bar, to fit the numbers beside the bars


def draw_energy_split(flights: Sequence[StyledFlight], hover_energy_J: float) -> Figure:
    """Draw two bar charts of flights: the total energies, and the energies above hovering.

    The first flight is the plan. If the durations differ, the right panel shows the energy of each
    flight less that of the plan. `hover_energy_J` is that of hovering for the plan's duration.
    """
    height = _EDGES + _ROW * len(flights)
    figure = Figure(figsize=(FULL_WIDTH, height))
    whole, apart = figure.subplots(1, 2, sharey=True)
    figure.subplots_adjust(
        left=0.24, right=0.97, top=1 - 0.3 / height, bottom=0.62 / height, wspace=0.07
    )
    longest = []
    for row, flight in enumerate(flights):
        hover = hover_energy_J * flight.duration_s / flights[0].duration_s
        whole.barh(row, hover, color=PALE, edgecolor=MUTED, linewidth=0.6, height=BAR_WIDTH)
        whole.barh(row, flight.energy_J - hover, left=hover, **bar_look(flight))
        longest.append(max(hover, flight.energy_J))
    _write_values(whole, [flight.energy_J for flight in flights], longest)
    _make_room(whole, longest)
    whole.set(title="Total energy; grey: hovering", xlabel="Energy (J)")
    least, title = hover_energy_J, "Above hovering"
    # Energies above hovering are comparable only between flights of equal duration.
    if not have_equal_durations(flights):
        least, title = flights[0].energy_J, f"More than {flights[0].name}"
    differences = [flight.energy_J - least for flight in flights]
    for row, (flight, difference) in enumerate(zip(flights, differences, strict=True)):
        apart.barh(row, difference, **bar_look(flight))
    annotate_bars(apart, differences)
    apart.set_yticks(range(len(flights)), [flight.name for flight in flights])
    apart.invert_yaxis()
    apart.set(title=title, xlabel="Energy (J)")
    return figure


def draw_energy_by_scenario(comparison: pd.DataFrame) -> Figure:
    """Draw the energy above hovering of each flight as a bar, in one panel for each scenario.

    If the flights of any scenario differ in duration, all bars show total energies instead. Bars of
    flights that missed the goal are pale. `comparison` has the columns of `ComparisonColumn`.
    """
    # Energies above hovering are comparable only between flights of equal duration.
    is_above = has_equal_durations(comparison)
    energies = comparison[ComparisonColumn.EXCESS_ENERGY].astype(float)
    if not is_above:
        energies = energies + comparison[ComparisonColumn.HOVER_ENERGY]
    scenarios = list(comparison.groupby(ComparisonColumn.SCENARIO, sort=False))
    counts = [len(rows) for _, rows in scenarios]
    height = _EDGES + _ROW * sum(counts) + _TITLE * len(counts)
    figure = Figure(figsize=(FULL_WIDTH, height))
    panels = figure.subplots(len(counts), 1, sharex=True, squeeze=False, height_ratios=counts)
    figure.subplots_adjust(
        left=0.24, right=0.99, top=1 - 0.3 / height, bottom=0.5 / height, hspace=0.35
    )
    for axes, (name, rows) in zip(panels.flat, scenarios, strict=True):
        names = tuple(rows[ComparisonColumn.FLIGHT])
        spent = energies[rows.index].to_numpy()
        arrived = rows[ComparisonColumn.ARRIVED].astype(bool)
        for row, style in enumerate(flight_styles(names).values()):
            opacity = 1.0 if arrived.iloc[row] else _ABSENT
            axes.barh(row, spent[row], color=style.color, height=BAR_WIDTH, alpha=opacity)
        axes.set_yticks(range(len(names)), names)
        axes.invert_yaxis()
        axes.set_title(str(name))
        _write_values(axes, spent.tolist(), spent.clip(min=0.0).tolist())
    _make_room(panels[-1, 0], energies.tolist())
    panels[-1, 0].set_xlabel("Energy above hovering (J)" if is_above else "Energy (J)")
    return figure


def has_equal_durations(comparison: pd.DataFrame) -> bool:
    """Return whether the flights of each scenario in a comparison table have equal durations.

    Durations are equal up to the relative tolerance `SAME_TIME`.
    """
    times = comparison.groupby(ComparisonColumn.SCENARIO)[ComparisonColumn.DURATION]
    return bool((times.max() <= times.min() * (1.0 + SAME_TIME)).all())


def bar_look(flight: StyledFlight) -> dict[str, Any]:
    """Return the keyword arguments of `Axes.barh` for a flight: its colour and hatch."""
    style = flight.style
    return {
        "color": style.color,
        "edgecolor": "white",
        "hatch": style.hatch,
        "linewidth": 0.0,
        "height": BAR_WIDTH,
    }


def annotate_bars(axes: Axes, values: Sequence[float]) -> None:
    """Print each value to the right of its horizontal bar, and extend the axis to fit the numbers.

    Parameters
    ----------
    axes : Axes
        Panel with the bars.
    values : sequence of float
        Lengths of the bars, from the top.
    """
    _write_values(axes, values, [max(value, 0.0) for value in values])
    _make_room(axes, values)


def _write_values(axes: Axes, values: Sequence[float], beside: Sequence[float]) -> None:
    axes.grid(visible=False, axis="y")
    axes.tick_params(axis="y", length=0)
    for row, (value, at) in enumerate(zip(values, beside, strict=True)):
        axes.annotate(
            f"{value:.1f}",
            (at, row),
            xytext=(4, 0),
            textcoords="offset points",
            va="center",
            color=INK,
        )


def _make_room(axes: Axes, values: Sequence[float]) -> None:
    low, high = min(0.0, *values), max(0.0, *values)
    axes.set_xlim(low * _NUMBER_ROOM, low + (high - low) * _NUMBER_ROOM)
    if low < 0.0:
        axes.axvline(0.0, color=MUTED, linewidth=0.6)
