"""Figures of flights: states, controls, energy, battery, wind, mesh and others.

Each function `draw_...` makes a figure or draws into a panel. If an argument is a sequence of
flights, the first flight is the plan.
"""

from collections.abc import Sequence
from itertools import chain
from math import ceil, isfinite
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from pyomo_quad.flight.columns import ROTORS
from pyomo_quad.report.energy_bars import (
    annotate_bars,
    bar_look,
)
from pyomo_quad.report.signals import (
    ATTITUDE,
    BATTERY,
    BODY_RATE,
    CIRCUIT,
    ENERGY,
    MOTOR,
    POSITION,
    POWER,
    ROTOR_ACCELERATION,
    ROTOR_SPEED,
    STATE_GRID,
    TIME,
    VELOCITY,
    WIND,
)
from pyomo_quad.report.style import (
    FULL_WIDTH,
    INK,
    LEGEND_COLUMNS,
    MUTED,
    ROTOR_STYLES,
    SERIES_STYLES,
    LineStyle,
    StyledFlight,
    draw_over_time,
    draw_panels,
    flight_styles,
    full_width,
    have_equal_durations,
    keep_span,
    label_time,
    last_end,
    legend_below,
    panel_grid,
)
from pyomo_quad.study.comparison import (
    ERROR_WITH,
    ERROR_WITHOUT,
    ESTIMATED,
    FAIR_BASELINE,
    OPTIMAL,
    TRUE,
    LegColumn,
    leg_table,
    way_flown,
)
from pyomo_quad.study.front import FrontColumn

if TYPE_CHECKING:
    from pyomo_quad.collocation import Mesh, MeshRecord
    from pyomo_quad.scenario import Scenario

_CENTIMETRES = 100.0
_SMALLEST_ERROR = 1.0  # cm
_SMALLEST_DISTURBANCE = 0.1  # m/s^2
# The flight with an adaptive controller has the same style as in the other figures.
_WITH = flight_styles((FAIR_BASELINE,))[FAIR_BASELINE]
_WITHOUT = LineStyle(color=MUTED, dashes=(4.5, 1.6))


def draw_adaptation(study: pd.DataFrame) -> Figure:
    """Draw the effect of the controller's adaptation to the wind, in three panels.

    The panels show the distance from the reference path, and the acceleration by the wind along x
    and y with its estimate. The function `adaptation_study` returns the table `study`.
    """
    figure, (panels,) = panel_grid(1, 3, panel_height=1.8, legend_entries=2)
    error, *disturbances = panels
    time = TIME.of(study)
    for column, style, label in (
        (ERROR_WITH, _WITH, "with adaptation"),
        (ERROR_WITHOUT, _WITHOUT, "without"),
    ):
        error.plot(time, _CENTIMETRES * study[column].to_numpy(), label=label, **style.line)
    error.set_title("Distance from the reference (cm)")
    keep_span([error], _SMALLEST_ERROR)
    for axes, axis, estimated, true in zip(disturbances, "xy", ESTIMATED, TRUE, strict=False):
        _draw_disturbance(axes, time, study[true].to_numpy(), study[estimated].to_numpy())
        axes.set_title(f"Disturbance along ${axis}$ (m/s²)")
    keep_span(disturbances, _SMALLEST_DISTURBANCE)
    label_time(panels, float(time[-1]))
    legend_below(figure, error)
    return figure


def _draw_disturbance(
    axes: Axes, time: np.ndarray, true: np.ndarray, estimated: np.ndarray
) -> None:
    axes.plot(time, true, label="true", color=INK, linewidth=1.0, linestyle=(0, (1.2, 1.4)))
    axes.plot(time, estimated, label="estimated", **_WITH.line)
    axes.legend(loc="best")


def draw_battery(flights: Sequence[StyledFlight]) -> Figure:
    """Draw battery voltage, current and state of charge of flights over time.

    Further panels show the relaxation voltage (slow part of the voltage drop) and the temperature.
    Each is drawn only if the tables of all flights have its column.
    """
    further = [own for own in CIRCUIT if all(own.name in one.frame for one in flights)]
    figure, panels = panel_grid(
        2 if further else 1,
        3,
        panel_height=1.7,
        legend_entries=len(flights),
        share_time=not further,
    )
    shown = (*BATTERY, *further)
    for unused in panels.flat[len(shown) :]:
        unused.set_visible(False)
    draw_panels(panels.flat[: len(shown)], shown, flights)
    label_time(panels.flat, last_end(flights))
    legend_below(figure, panels[0, 0])
    return figure


def draw_controls(flights: Sequence[StyledFlight]) -> Figure:
    """Draw the angular acceleration of each rotor over time, one panel per rotor, all to one scale.

    Parameters
    ----------
    flights : sequence of StyledFlight
        Flights to draw; the first is the plan.
    """
    figure, panels = panel_grid(2, 2, panel_height=1.25, legend_entries=len(flights))
    draw_panels(panels.flat, ROTOR_ACCELERATION, flights)
    for axes in panels.flat:
        axes.axhline(0.0, color=MUTED, linewidth=0.6, zorder=1)
    keep_span(panels.flat, ROTOR_ACCELERATION[0].smallest_span)
    label_time(panels[-1], last_end(flights))
    legend_below(figure, panels[0, 0])
    return figure


HAMILTONIAN = "hamiltonian"

_GROUPS = (
    (POSITION, "Position", "J/m", 1.0),
    (VELOCITY, "Velocity", "J s/m", 1.0),
    (ATTITUDE, "Attitude", "J/rad", 1.0),
    (BODY_RATE, "Body rates", "J s/rad", 1.0),
    (ROTOR_SPEED, "Rotors", "mJ s/rad", 1e3),
)
_SMALLEST_PRICE = 1e-2
# Legend of a panel, in the line of its title, where no curve runs.
_LEGEND: dict[str, Any] = {
    "loc": "lower right",
    "bbox_to_anchor": (1.0, 0.98),
    "borderaxespad": 0.0,
    "columnspacing": 0.9,
    "handlelength": 1.7,
    "handletextpad": 0.4,
    "ncols": 4,
}
_SMALLEST_POWER = 0.1  # W


#: Columns of the plan's table of costates that the figure shows.
COSTATES = (
    *(state.variable for group in _GROUPS for state in group[0]),
    HAMILTONIAN,
)


def draw_costates(costates: pd.DataFrame, duration: float) -> Figure:
    """Draw the costates (adjoint variables) of a plan, and its Hamiltonian, in six panels.

    `costates` is indexed by time [s] and has the columns `COSTATES`. The time axes end at
    `duration` [s].
    """
    figure, panels = panel_grid(3, 2, panel_height=1.4, legend_entries=0)
    time = costates.index.to_numpy()
    for axes, (states, title, unit, scale) in zip(panels.flat, _GROUPS, strict=False):
        for state, style in zip(states, ROTOR_STYLES, strict=False):
            price = costates[state.variable].to_numpy() * scale
            axes.plot(time, price, label=f"${state.symbol}$", **style.line)
        axes.set_title(f"{title} ({unit})")
        keep_span([axes], _SMALLEST_PRICE)
        axes.legend(**_LEGEND)
    last = panels[-1, -1]
    last.plot(time, costates[HAMILTONIAN].to_numpy(), **ROTOR_STYLES[0].line)
    last.set_title("Hamiltonian $H$ (W)")
    keep_span([last], _SMALLEST_POWER)
    label_time(panels[-1], duration)
    return figure


_ABOVE_HOVER_TITLE = r"$E - P_\mathrm{hover}\,t$, energy above hovering (J)"
# Powers in the lowest and the highest of these shares are peaks. The axis excludes peaks if they
# would make its range larger than this factor; the margin is a share of the range without peaks.
_PEAK_SHARE = 0.05
_WORTH_CUTTING = 2.0
_PEAK_MARGIN = 0.1
# Difference of two curves, relative to their range, below which they cannot be distinguished.
_COINCIDENT = 0.01
_HOVER_LINE: dict[str, Any] = {"color": MUTED, "linewidth": 1.0, "linestyle": (0, (1, 1))}


def draw_energy(flights: Sequence[StyledFlight], hover_energy_J: float) -> Figure:
    """Draw power, energy, and energy above hovering of flights over time, in three panels.

    `hover_energy_J` is the energy of hovering for the duration of the first flight. Short peaks of
    power may be cut off (see `cut_flights`).
    """
    figure, panels = panel_grid(3, 1, panel_height=1.5, legend_entries=1 + len(flights))
    hover_power, end = hover_energy_J / flights[0].duration_s, last_end(flights)
    power, energy, above = panels[:, 0]
    power.axhline(hover_power, label="hovering", **_HOVER_LINE)
    energy.plot([0.0, end], [0.0, hover_power * end], **_HOVER_LINE)
    draw_panels((power, energy), (POWER, ENERGY), flights)
    draw_above_hover(above, flights, hover_power)
    _cut_peaks(power, flights)
    label_time(panels[-1], end)
    legend_below(figure, power)
    return figure


def draw_above_hover(axes: Axes, flights: Sequence[StyledFlight], hover_power_W: float) -> None:
    """Draw the energy above hovering of flights over time in a panel.

    Energy above hovering at a time t is the energy used until t, less that of hovering until t.
    """
    axes.axhline(0.0, **_HOVER_LINE)
    for flight in flights:
        time, energy = TIME.of(flight.frame), ENERGY.of(flight.frame)
        axes.plot(time, energy - hover_power_W * time, label=flight.name, **flight.style.line)
    axes.set_title(_ABOVE_HOVER_TITLE)
    keep_span([axes], ENERGY.smallest_span)


def cut_flights(flights: Sequence[StyledFlight]) -> tuple[StyledFlight, ...]:
    """Return the flights whose short peaks of power are cut off in a panel of power over time.

    Peaks are cut off if they would more than double the length of the axis. The power of the first
    flight is never cut off.
    """
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
    """Return the flights whose curve of energy above hovering coincides with the plan's curve.

    Curves of equal duration coincide if they differ by at most 1 % of their range. The first flight
    is the plan.
    """
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
        if have_equal_durations((first, flight)) and np.abs(curve - curves[0]).max() <= allowed
    )


def _power_window(flights: Sequence[StyledFlight]) -> tuple[float, float] | None:
    """Return the ends [W] of a vertical axis that leaves out short peaks of power.

    The axis shows the whole power of the plan, the first of `flights`. The result is None if no
    peak is cut off.
    """
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
    """Cut off short peaks in a panel of power over time, and say so in its title."""
    window = _power_window(flights)
    if window is not None:
        axes.set_ylim(*window)
        axes.set_title(f"{POWER.title}, short peaks cut off")


_ERROR_FLOOR = 1e-16  # drawn instead of an error of zero, which has no logarithm


def draw_mesh(
    history: "Sequence[MeshRecord]", mesh: "Mesh", tolerance: float, duration: float
) -> Figure:
    """Draw the refinement of a plan's mesh: the error estimate of each mesh, and the last mesh.

    `history` lists the meshes from the first to the last. Meshes without a finite estimate are not
    drawn. `tolerance` is the relative error to be reached, and `duration` that of the flight [s].
    """
    height = 2.6
    figure, (errors, elements) = full_width(
        height, (1, 2), right=0.985, top=1 - 0.3 / height, bottom=0.5 / height, wspace=0.24
    )
    _draw_errors(errors, history, tolerance)
    _draw_elements(elements, mesh, duration)
    return figure


def _draw_errors(axes: Axes, history: "Sequence[MeshRecord]", tolerance: float) -> None:
    estimated = [record for record in history if isfinite(record.error)]
    meshes = range(len(estimated))
    sizes = [max(record.error, _ERROR_FLOOR) for record in estimated]
    style = SERIES_STYLES[0]
    axes.plot(meshes, sizes, marker=style.marker, markersize=4.5, **style.line)
    axes.axhline(tolerance, color=MUTED, linewidth=1.0, linestyle=(0, (4, 2)))
    axes.annotate(
        f"tolerance {tolerance:.3g}",
        (0.02, tolerance),
        xycoords=("axes fraction", "data"),
        xytext=(0, 3),
        textcoords="offset points",
        color=INK,
    )
    axes.set_yscale("log")
    axes.set_ylim(min([*sizes, tolerance]) / 5, max([*sizes, tolerance]) * 5)
    axes.set_xticks(meshes, [str(record.points) for record in estimated])
    axes.set_xlim(-0.6, len(estimated) - 0.4)
    axes.tick_params(axis="y", which="minor", length=0)
    axes.set(title="Error estimate (relative)", xlabel="Collocation points of each mesh")


def _draw_elements(axes: Axes, mesh: "Mesh", duration: float) -> None:
    boundaries = np.asarray(mesh.breakpoints) * duration
    axes.step(boundaries[:-1], mesh.degrees, where="post", **SERIES_STYLES[0].line)
    axes.hlines(mesh.degrees[-1], boundaries[-2], boundaries[-1], **SERIES_STYLES[0].line)
    axes.plot(boundaries, np.zeros_like(boundaries), "|", color=INK, markersize=9, clip_on=False)
    axes.set_ylim(0, max(mesh.degrees) * 1.15)
    axes.set_xlim(0, duration)
    axes.yaxis.set_major_locator(MaxNLocator(nbins=6, integer=True))
    axes.set(
        title=f"Degree of the polynomials in {mesh.elements} elements",
        xlabel="Time (s), with the boundaries of the elements",
    )


def draw_power(flights: Sequence[StyledFlight], hover_energy_J: float) -> Figure:
    """Draw the power of flights over time, and the power of hovering as a dotted line.

    `hover_energy_J` is the energy of hovering for the duration of the first flight. Short peaks may
    be cut off (see `cut_flights`).
    """
    figure, ((axes,),) = panel_grid(1, 1, panel_height=1.9, legend_entries=1 + len(flights))
    axes.axhline(hover_energy_J / flights[0].duration_s, label="hovering", **_HOVER_LINE)
    draw_panels((axes,), (POWER,), flights)
    _cut_peaks(axes, flights)
    label_time([axes], last_end(flights))
    legend_below(figure, axes)
    return figure


_FRONT: dict[str, Any] = {"color": MUTED, "marker": "o", "markersize": 4, "linewidth": 1.0}
_WAY_HEIGHT = 2.3  # inches
_LEG_ROW = 0.2  # inches


def draw_way(flights: Sequence[StyledFlight], mission: "Scenario") -> Figure:
    """Draw the speed of flights over path length, and the plan's energy on each leg of the mission.

    A leg leads from one waypoint, start or goal to the next. The waypoints of `mission` must have
    times of passing (see `Scenario.lasting`).
    """
    # A hover at a waypoint is a leg of its own.
    optimum, legs = flights[0], leg_table(mission, flights[0].frame)
    below = 0.45 + 0.2 * ceil(len(flights) / LEGEND_COLUMNS)
    height = max(_WAY_HEIGHT, _LEG_ROW * len(legs) + 0.3 + below)
    figure = Figure(figsize=(FULL_WIDTH, height))
    room = {"top": 1 - 0.3 / height, "bottom": below / height}
    over_way = figure.add_gridspec(1, 5, left=0.075, right=0.985, wspace=1.2, **room)
    speeds = figure.add_subplot(over_way[0, : 3 if len(legs) else 5])
    for flight in flights:
        axes_of_speed = [signal.of(flight.frame) for signal in VELOCITY]
        speed = np.linalg.norm(axes_of_speed, axis=0)
        speeds.plot(way_flown(flight.frame), speed, label=flight.name, **flight.style.line)
    if mission.limits.speed_max is not None:
        speeds.axhline(mission.limits.speed_max, color=INK, linewidth=0.8, linestyle=(0, (4, 2)))
    times, way = TIME.of(optimum.frame), way_flown(optimum.frame)
    for number, waypoint in enumerate(mission.mission.waypoints, start=1):
        place = np.interp(times[-1] if waypoint.at is None else waypoint.at, times, way)
        speeds.axvline(place, color=MUTED, linewidth=0.8, linestyle=(0, (1, 1.5)), zorder=1)
        speeds.annotate(str(number), (place, 1.0), xycoords=("data", "axes fraction"), va="top")
    speeds.set(title="Speed (m/s)", xlabel="Path length (m)", xlim=(0.0, None), ylim=(0.0, None))
    if len(legs):
        _draw_legs(figure.add_subplot(over_way[0, 3:]), optimum, legs)
    legend_below(figure, speeds)
    return figure


def _draw_legs(axes: Axes, flight: StyledFlight, legs: pd.DataFrame) -> None:
    energies = legs[LegColumn.ENERGY].tolist()
    for row, energy in enumerate(energies):
        axes.barh(row, energy, **bar_look(flight))
    axes.set_yticks(range(len(legs)), legs[LegColumn.LEG])
    axes.invert_yaxis()
    annotate_bars(axes, energies)
    axes.set(title="Energy of each leg (J)")


def draw_front(front: pd.DataFrame) -> Figure:
    """Draw the energy-time front of a mission: least energy against duration.

    Each point is an optimal flight for one price of time [J/s = W], the energy that may be spent to
    shorten the flight by one second. A star marks the plan. `front` has the columns of
    `FrontColumn`.
    """
    figure, panels = panel_grid(1, 1, panel_height=2.4, legend_entries=2)
    (axes,) = panels.flat
    optimum, is_plan = flight_styles((OPTIMAL,))[OPTIMAL], front[FrontColumn.IS_PLAN].astype(bool)
    over = (FrontColumn.DURATION, FrontColumn.ENERGY)
    axes.plot(*(front[name] for name in over), label="other prices of time", **_FRONT)
    plan = [front.loc[is_plan, name] for name in over]
    axes.plot(*plan, label="the plan", color=optimum.color, marker="*", markersize=12, ls="none")
    for _, row in front.iterrows():
        price = row[FrontColumn.PRICE]
        if isfinite(price):
            place = (row[FrontColumn.DURATION], row[FrontColumn.ENERGY])
            axes.annotate(f"{price:.3g} W", place, xytext=(6, 4), textcoords="offset points")
    axes.set(title="Energy (J), and the price of a second at each point", xlabel="Duration (s)")
    axes.margins(0.1, 0.2)
    legend_below(figure, axes)
    return figure


def draw_rotors(flight: StyledFlight) -> Figure:
    """Draw speed, torque, current and voltage of a flight's motors over time.

    Each of the four quantities has a panel, with one curve for each motor.

    Parameters
    ----------
    flight : StyledFlight
        Flight to draw.
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


def draw_states(flights: Sequence[StyledFlight]) -> Figure:
    """Draw all sixteen states of flights, one panel each.

    The rows show position, velocity, attitude and body rates; the last column shows rotor speeds.

    Parameters
    ----------
    flights : sequence of StyledFlight
        Flights to draw; the first is the plan.
    """
    figure, panels = panel_grid(
        4, 4, panel_height=1.15, gap=0.52, left=0.42, legend_entries=len(flights)
    )
    draw_panels(panels.flat, chain(*STATE_GRID), flights)
    keep_span(panels[:, -1], STATE_GRID[0][-1].smallest_span)
    label_time(panels[-1], last_end(flights))
    legend_below(figure, panels[0, 0])
    return figure


def draw_column(flight: StyledFlight, column: str) -> Figure:
    """Draw one column of a flight's table against time, in the unit of the column.

    Parameters
    ----------
    flight : StyledFlight
        Flight to draw.
    column : str
        Name of the column.
    """
    figure, panels = panel_grid(1, 1, panel_height=2.6)
    (axes,) = panels.flat
    axes.plot(TIME.of(flight.frame), flight.frame[column], label=flight.name, **flight.style.line)
    axes.set_title(column)
    label_time([axes], flight.duration_s)
    return figure


# Wind curves have other colours than the curves of flights.
_WIND = LineStyle(color=INK, width=1.9)
_FORECAST = LineStyle(color=MUTED, dashes=(4.5, 1.6))


def draw_wind(planned: StyledFlight, flown: StyledFlight | None = None) -> Figure:
    """Draw the horizontal wind over time: the wind that the plan was made for, and the true wind.

    If the plan was made for a forecast, `flown` is a flight in the true wind.
    """
    figure, panels = panel_grid(1, 2, panel_height=1.5, legend_entries=0 if flown is None else 2)
    forecast = [] if flown is None else [("forecast", planned, _FORECAST)]
    winds = [("wind", planned if flown is None else flown, _WIND), *forecast]
    for axes, signal in zip(panels.flat, WIND, strict=True):
        for label, flight, style in winds:
            axes.plot(TIME.of(flight.frame), signal.of(flight.frame), label=label, **style.line)
        axes.axhline(0.0, color=MUTED, linewidth=0.6, zorder=1)
        axes.set_title(signal.title)
    keep_span(panels.flat, WIND[0].smallest_span)
    label_time(panels.flat, planned.duration_s)
    if flown is not None:
        legend_below(figure, panels[0, 0])
    return figure


def is_calm(*flights: StyledFlight) -> bool:
    """Return whether the wind is zero throughout all the given flights."""
    return not any(signal.of(flight.frame).any() for flight in flights for signal in WIND)
