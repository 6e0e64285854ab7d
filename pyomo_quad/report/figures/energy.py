"""Power and energy over time, with what hovering for the same time would take."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pyomo_quad.report.figures.panels import (
    draw_over_time,
    keep_span,
    label_time,
    legend_below,
    panel_grid,
)
from pyomo_quad.report.flights import StyledFlight
from pyomo_quad.report.signals import ENERGY, POWER, TIME
from pyomo_quad.report.style import MUTED

__all__ = ["coinciding_flights", "cut_flights", "draw_above_hover", "draw_energy"]

_ABOVE_HOVER_TITLE = r"$E - P_\mathrm{hover}\,t$, energy above hovering (J)"
# Peaks are what a flight spends less than this share of its time in.
_PEAK_SHARE = 0.05
_WORTH_CUTTING = 2.0
_PEAK_MARGIN = 0.1
# Curves nearer than this share of their range cannot be told apart.
_COINCIDENT = 0.01
_HOVER_LINE: dict[str, Any] = {"color": MUTED, "linewidth": 1.0, "linestyle": (0, (1, 1))}


def draw_energy(flights: Sequence[StyledFlight], hover_energy_J: float) -> Figure:
    """Draw power, energy, and energy above hovering, over each other.

    Parameters
    ----------
    flights : sequence of StyledFlight
        The flights, the optimum first.
    hover_energy_J : float
        Energy of hovering for as long as the mission lasts, J.

    Returns
    -------
    Figure
        Three panels; in the last the hover line is subtracted.
    """
    figure, panels = panel_grid(3, 1, panel_height=1.5, legend_entries=1 + len(flights))
    duration = flights[0].duration_s
    hover_power = hover_energy_J / duration
    power, energy, above = panels[:, 0]
    power.axhline(hover_power, label="hovering", **_HOVER_LINE)
    energy.plot([0.0, duration], [0.0, hover_energy_J], **_HOVER_LINE)
    for flight in flights:
        draw_over_time(power, flight.frame, POWER, flight.style, flight.name)
        draw_over_time(energy, flight.frame, ENERGY, flight.style, flight.name)
    draw_above_hover(above, flights, hover_power)
    for axes, signal in ((power, POWER), (energy, ENERGY)):
        axes.set_title(signal.title)
        keep_span([axes], signal.smallest_span)
    _cut_peaks(power, flights)
    label_time(panels[-1], duration)
    legend_below(figure, power)
    return figure


def draw_above_hover(axes: Axes, flights: Sequence[StyledFlight], hover_power_W: float) -> None:
    """Draw the energy spent until each time, less what hovering until then takes.

    Parameters
    ----------
    axes : Axes
        Where to.
    flights : sequence of StyledFlight
        The flights, the optimum first.
    hover_power_W : float
        Power of hovering, W.
    """
    axes.axhline(0.0, **_HOVER_LINE)
    for flight in flights:
        time, energy = TIME.of(flight.frame), ENERGY.of(flight.frame)
        axes.plot(time, energy - hover_power_W * time, label=flight.name, **flight.style.line)
    axes.set_title(_ABOVE_HOVER_TITLE)
    keep_span([axes], ENERGY.smallest_span)


def cut_flights(flights: Sequence[StyledFlight]) -> tuple[StyledFlight, ...]:
    """Return the flights whose short peaks leave the panel of the power."""
    window = _power_window(flights)
    if window is None:
        return ()
    low, high = window
    powers = [POWER.of(flight.frame) for flight in flights]
    return tuple(
        flight
        for flight, power in zip(flights, powers, strict=True)
        if power.min() < low or power.max() > high
    )


def coinciding_flights(
    flights: Sequence[StyledFlight], hover_power_W: float
) -> tuple[StyledFlight, ...]:
    """Return the flights whose energy above hovering lies on that of the first."""
    first, *others = flights
    time = TIME.of(first.frame)
    curves = [
        np.interp(time, TIME.of(flight.frame), ENERGY.of(flight.frame)) - hover_power_W * time
        for flight in flights
    ]
    allowed = _COINCIDENT * max(float(np.ptp(curves)), ENERGY.smallest_span)
    return tuple(
        flight
        for flight, curve in zip(others, curves[1:], strict=True)
        if np.abs(curve - curves[0]).max() <= allowed
    )


def _power_window(flights: Sequence[StyledFlight]) -> tuple[float, float] | None:
    """Return what the panel of the power shows where a baseline's peaks would flatten all else."""
    optimum, *others = powers = [POWER.of(flight.frame) for flight in flights]
    ends = [optimum.min(), optimum.max()]
    for power in others:
        ends += list(np.quantile(power, (_PEAK_SHARE, 1.0 - _PEAK_SHARE)))
    low, high = float(min(ends)), float(max(ends))
    lowest = float(min(power.min() for power in powers))
    highest = float(max(power.max() for power in powers))
    if highest - lowest <= _WORTH_CUTTING * max(high - low, POWER.smallest_span):
        return None
    margin = _PEAK_MARGIN * (high - low)
    return max(lowest, low - margin), min(highest, high + margin)


def _cut_peaks(axes: Axes, flights: Sequence[StyledFlight]) -> None:
    """Let the short peaks of a baseline leave the panel, where they would flatten all else."""
    window = _power_window(flights)
    if window is not None:
        axes.set_ylim(*window)
        axes.set_title(f"{POWER.title}, short peaks cut off")
