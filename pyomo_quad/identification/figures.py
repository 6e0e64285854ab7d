"""Figures of an identification: measured and computed energy, power and voltage of flights.

"Computed" is the result of the fitted vehicle model.
"""

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from pyomo_quad.flight import Planner
from pyomo_quad.identification.columns import CRUISE, DENSITY, FLIGHT, PAYLOAD, PHASE, POWER, TIME
from pyomo_quad.identification.fitting import Identification
from pyomo_quad.identification.pack import PackIdentification
from pyomo_quad.identification.steady import level_powers
from pyomo_quad.identification.validation import (
    ERROR,
    MEASURED_ENERGY,
    PREDICTED_ENERGY,
    cruise_speeds,
    energies,
)
from pyomo_quad.report.document import Drawing
from pyomo_quad.report.style import INK, MUTED, PALE, SERIES_STYLES, full_width

# Number of flights that are drawn over time.
_SHOWN = 3
# Greatest airspeed of the power curve, beyond which few flights have data.
_FASTEST_M_S = 17.0
# Least number of rows at an airspeed for a mean.
_FEWEST_ROWS = 20
_IN_KILOJOULES = 1e-3


def identification_drawings(
    found: Identification, pack: PackIdentification | None = None
) -> tuple[Drawing, ...]:
    """List the figures of an identification's report.

    Parameters
    ----------
    found : Identification
        Vehicle fitted to flights.
    pack : PackIdentification, optional
        Battery fitted to the same flights, if the logs have voltages.

    Returns
    -------
    tuple of Drawing
        Name, title, caption and drawing function of each figure.
    """
    drawings = (
        Drawing(
            name="energies",
            title="Energy of each flight",
            caption="Left: computed against measured energy, each flight by a fit without that "
            "flight. Right: the relative error over the measured energy, with the 2 % band.",
            draw=lambda: draw_energies(found),
        ),
        Drawing(
            name="power_over_time",
            title="Power over time",
            caption="Three flights, slow, usual and fast: measured power of each second, and "
            "computed by a fit without that flight. Cruise is between the dotted lines.",
            draw=lambda: draw_power(found),
        ),
        Drawing(
            name="power_curve",
            title="The power curve, with the data in it",
            caption="Lines: power of level, steady flight by the declared equations in the mean "
            "density of the flights. Dots: mean measured power of the seconds of cruise at each "
            "airspeed, gusts and turns included; the bar spans half of them.",
            draw=lambda: draw_curve(found),
        ),
    )
    if pack is None:
        return drawings
    voltages = Drawing(
        name="voltages",
        title="Voltage of the pack",
        caption="Left: voltage of a cell in three flights, from just before the load: "
        "measured, and computed by a fit without that flight; the resistance is read in "
        "the rows before the dotted line. Right: error of each flight over the factor on "
        "its pack's resistance, new and warm to old and cold.",
        draw=lambda: draw_voltages(found, pack),
    )
    return (*drawings, voltages)


def draw_energies(found: Identification) -> Figure:
    """Draw the computed over the measured energy of each flight, and the relative errors.

    Each flight's energy is computed with a model that was fitted to other flights.

    Parameters
    ----------
    found : Identification
        Vehicle fitted to flights.
    """
    table = energies(found.frame, found.cross_validated)
    payload = found.frame.groupby(FLIGHT, sort=False)[PAYLOAD].first().to_numpy()
    figure, (left, right) = full_width(3.3, (1, 2), top=0.92, bottom=0.15, wspace=0.28)
    measured = table[MEASURED_ENERGY] * _IN_KILOJOULES
    computed = table[PREDICTED_ENERGY] * _IN_KILOJOULES
    ends = [measured.min(), measured.max()]
    left.plot(ends, ends, color=MUTED, linewidth=0.8)
    right.axhspan(-2.0, 2.0, color=PALE, linewidth=0)
    for value, style in zip(np.unique(payload), SERIES_STYLES, strict=False):
        chosen = payload == value
        look = {"linestyle": "none", "marker": style.marker, "color": style.color}
        left.plot(measured[chosen], computed[chosen], label=f"{value:g} kg", markersize=3.5, **look)
        right.plot(measured[chosen], table[ERROR][chosen], markersize=3.5, **look)
    left.set(xlabel="Measured energy (kJ)", ylabel="Computed energy (kJ)", title="Energy")
    right.set(xlabel="Measured energy (kJ)", ylabel="Computed less measured (%)", title="Error")
    left.legend(title="Payload", frameon=False)
    return figure


def shown_flights(frame: pd.DataFrame) -> list[object]:
    """Return the names of a slow, an average and a fast flight of a log, from slow to fast.

    With fewer than three flights, the result has the names of all flights.
    """
    speeds = pd.Series(cruise_speeds(frame), index=frame[FLIGHT].to_numpy())
    each = speeds.groupby(level=0, sort=False).first().sort_values(kind="stable")
    places = np.linspace(0, len(each) - 1, min(_SHOWN, len(each))).round().astype(int)
    return [each.index[place] for place in places]


def draw_power(found: Identification) -> Figure:
    """Draw the measured and the computed power of a slow, an average and a fast flight over time.

    Each flight's power is computed with a model that was fitted to other flights.
    """
    chosen = shown_flights(found.frame)
    size = 1.7 * len(chosen) + 0.6
    figure, panels = full_width(size, (len(chosen), 1), top=0.94, bottom=0.12, hspace=0.55)
    panels = np.atleast_1d(panels)
    speeds, color = cruise_speeds(found.frame), SERIES_STYLES[0].color
    for flight, panel in zip(chosen, panels, strict=True):
        is_own = (found.frame[FLIGHT] == flight).to_numpy()
        rows, computed = found.frame[is_own], found.cross_validated[is_own]
        times = rows[TIME] - rows[TIME].iloc[0]
        panel.plot(times, rows[POWER], color=MUTED, linewidth=0.9, label="measured")
        panel.plot(times, computed, color=color, linewidth=1.3, label="computed")
        cruise = times[(rows[PHASE] == CRUISE).to_numpy()]
        for edge in () if cruise.empty else (cruise.iloc[0], cruise.iloc[-1]):
            panel.axvline(edge, color=INK, linestyle=":", linewidth=0.8)
        title = f"Flight {flight}: {speeds[is_own][0]:g} m/s, {rows[PAYLOAD].iloc[0]:g} kg"
        panel.set(ylabel="Power (W)", title=title)
    panels[-1].set_xlabel("Time (s)")
    panels[0].legend(frameon=False, ncols=2, loc="lower center")
    return figure


def draw_voltages(found: Identification, pack: PackIdentification) -> Figure:
    """Draw measured and computed cell voltage of three flights, and the error of each flight.

    The left panel shows the voltages over time. The right panel has one point per flight:
    horizontally the resistance of its pack divided by that of the median pack, vertically the root
    mean square error [mV per cell].
    """
    figure, (left, right) = full_width(3.4, (1, 2), top=0.92, bottom=0.15, wspace=0.28)
    known = set(pack.flights[FLIGHT])
    shown = [flight for flight in shown_flights(found.frame) if flight in known]
    for flight, style in zip(shown, SERIES_STYLES, strict=False):
        rows = pack.rows[pack.rows[FLIGHT] == flight]
        left.plot(rows[TIME], rows["measured_V"], color=MUTED, linewidth=0.9)
        left.plot(rows[TIME], rows["computed_V"], label=f"flight {flight}", **style.line)
    left.axvline(pack.read_s, color=INK, linestyle=":", linewidth=0.8)
    left.set(xlabel="Time (s)", ylabel="Voltage of a cell (V)", title="Measured (grey), computed")
    left.legend(frameon=False)
    right.plot(
        pack.flights["resistance_factor"],
        pack.flights["error_mV"],
        linestyle="none",
        marker="o",
        markersize=3.5,
        color=SERIES_STYLES[0].color,
    )
    right.axhline(pack.error_mV, color=MUTED, linewidth=0.8)
    right.set(
        xlabel="Resistance over that of a middling pack",
        ylabel="Error (mV per cell)",
        title="Unseen flights; line: all",
        yscale="log",
    )
    return figure


def draw_curve(found: Identification) -> Figure:
    """Draw the power of steady level flight over airspeed for each payload, with measurements.

    The curves are computed with the fitted model at the mean air density. A dot is the mean
    measured power of the log's rows in cruise at one airspeed, rounded to 1 m/s. Airspeeds with
    fewer than 20 rows are left out.
    """
    is_cruise = (found.frame[PHASE] == CRUISE).to_numpy()
    frame, airspeed = found.frame[is_cruise], found.airspeeds[is_cruise]
    speeds = np.linspace(0.0, min(_FASTEST_M_S, float(airspeed.max())), 35)
    density = float(found.frame[DENSITY].mean())
    figure, axes = full_width(3.6, top=0.96, bottom=0.14)
    for place, payload in enumerate(np.unique(frame[PAYLOAD])[: len(SERIES_STYLES)]):
        style = SERIES_STYLES[place]
        loaded = {"vehicle.payload": float(payload), "power.air_density": density}
        power = level_powers(found.scenario.with_values(loaded), speeds.tolist(), Planner())
        axes.plot(speeds, power, color=style.color, label=f"{payload:g} kg")
        chosen = (frame[PAYLOAD] == payload).to_numpy()
        groups = frame[POWER][chosen].groupby(np.round(airspeed[chosen]))
        binned = groups.describe()[["mean", "25%", "75%"]][groups.size() >= _FEWEST_ROWS]
        mean, low, high = binned.to_numpy().T
        axes.errorbar(
            # The points of each payload are shifted sideways, so that none hides another.
            binned.index + 0.12 * (place - 1),
            mean,
            yerr=np.abs(np.stack([mean - low, high - mean])),
            linestyle="none",
            marker=style.marker,
            markersize=4,
            color=style.color,
            elinewidth=0.7,
        )
    axes.set(xlabel="Airspeed (m/s)", ylabel="Power (W)")
    axes.legend(title="Payload", frameon=False)
    return figure
