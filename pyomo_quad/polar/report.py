"""Report of a vehicle's polar: tables, summary, figures and text.

The figures show power over airspeed, best speeds over the direction of the wind, and for each
course the greatest distance from which the vehicle returns on the same battery charge.
"""

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from pyomo_quad.polar.polar import (
    AIRSPEED,
    ANGLE,
    COURSE,
    ENERGY_PER_METRE,
    GROUND_SPEED,
    POWER,
    RANGE,
    REACH,
    WIND,
    GroundSpeed,
    Polar,
    SteadyCurve,
)
from pyomo_quad.report import Figures
from pyomo_quad.report.document import Drawing, write_study
from pyomo_quad.report.style import FULL_WIDTH, INK, MUTED, SERIES_STYLES, full_width
from pyomo_quad.version import __version__

_POLAR_NAME, _WIND_NAME, _REACH_NAME = "polar.csv", "wind.csv", "reach.csv"


def write_polar(folder: Path, polar: Polar, figures: Figures = Figures.SVG) -> None:
    """Write the report of a vehicle's polar: tables (CSV), `summary.json`, figures and text.

    `folder` must exist and be empty.
    """
    ends = polar.winds[polar.winds[ANGLE].isin((0.0, 90.0, 180.0))]
    write_study(
        folder,
        "polar/report.md.j2",
        tables={
            _POLAR_NAME: pd.concat(map(_table, polar.curves)),
            _WIND_NAME: polar.winds,
            _REACH_NAME: polar.reach,
        },
        summary=polar_summary(polar),
        drawings=polar_drawings(polar),
        figures=figures,
        polar=polar,
        curves=[_facts(curve) for curve in polar.curves],
        ends=ends.to_dict("records"),
        least=polar.reach.iloc[int(np.argmin(polar.reach[REACH]))].to_dict(),
        most=polar.reach.iloc[int(np.argmax(polar.reach[REACH]))].to_dict(),
        wind_columns=(WIND, ANGLE, GROUND_SPEED, AIRSPEED, POWER, ENERGY_PER_METRE, RANGE),
        REACH=REACH,
        COURSE=COURSE,
        WIND_NAME=_WIND_NAME,
    )


def polar_summary(polar: Polar) -> dict[str, Any]:
    """Return the main results of a polar as a dictionary for `summary.json`.

    The results are those of the scenario's own payload. The reach is the greatest distance [m] from
    which the vehicle returns on one battery charge.
    """
    facts = _facts(polar.own)
    best = facts.pop("best")
    price = polar.scenario.mission.price_of_time
    return {
        "scenario": polar.scenario.name,
        **facts,
        "best_speed_m_s": best.ground_speed,
        "best_power_W": best.power,
        ENERGY_PER_METRE: best.energy_per_metre,
        RANGE: best.range_m,
        "price_of_time_W": price,
        "speed_at_that_price_m_s": polar.own.best_over_ground(price_of_time=price).ground_speed,
        WIND: polar.wind_m_s,
        "wind_towards_deg": float(np.degrees(polar.wind_towards_rad)),
        f"least_{REACH}": float(polar.reach[REACH].min()),
        f"greatest_{REACH}": float(polar.reach[REACH].max()),
        "share_of_pack_used": polar.depth,
        "version": __version__,
    }


def _facts(curve: SteadyCurve) -> dict[str, Any]:
    slow = curve.speed_of_least_power
    best: GroundSpeed = curve.best_over_ground()
    return {
        "payload_kg": curve.payload_kg,
        "hover_power_W": float(curve.powers[0]),
        "hover_endurance_s": float(curve.endurances[0]),
        "least_power_speed_m_s": slow,
        "least_power_W": float(curve.power(slow)),
        "endurance_s": float(curve.endurance(slow)),
        "greatest_airspeed_m_s": float(curve.airspeeds[-1]),
        "best": best,
    }


def _table(curve: SteadyCurve) -> pd.DataFrame:
    moving = np.where(curve.airspeeds > 0.0, curve.airspeeds, np.nan)
    return pd.DataFrame(
        {
            "payload_kg": curve.payload_kg,
            AIRSPEED: curve.airspeeds,
            POWER: curve.powers,
            ENERGY_PER_METRE: curve.powers / moving,
            "endurance_s": curve.endurances,
            RANGE: curve.airspeeds * curve.endurances,
        }
    )


# Least airspeed at which the energy per metre is drawn; it grows without bound toward zero.
_SLOWEST_M_S = 2.0
_KILO = 1e-3


def polar_drawings(polar: Polar) -> tuple[Drawing, ...]:
    """List the figures of a polar's report, each with its caption and drawing function.

    They show power over airspeed, best ground speeds in wind, and the greatest distance of a flight
    out and back.
    """
    power = (
        "Level, steady flight in still air for each mass carried. The dots mark the speeds of "
        "least power, left, and of least energy per metre, right."
    )
    wind = (
        "Over the angle between the course and the direction the wind blows to (0 is a tail wind, "
        "180 a head wind), for each speed of the wind: the ground speed of least energy per metre "
        "over the ground, and that energy."
    )
    reach = (
        "Distance out and back on one charge on each course (km), each leg at its best speed, in "
        "the scenario's mean wind and in still air. The arrow points where the wind blows to; 0 "
        "degrees is along world x."
    )
    title = "Power and energy per metre over airspeed"
    return (
        Drawing("polar", title, power, partial(draw_polar, polar)),
        Drawing("wind", "The best speeds in wind", wind, partial(draw_winds, polar)),
        Drawing("reach", "The reach map", reach, partial(draw_reach, polar)),
    )


def draw_polar(polar: Polar) -> Figure:
    """Draw power and energy per metre of steady flight over airspeed, for each payload."""
    figure, (left, right) = full_width(3.1, (1, 2), top=0.9, bottom=0.16, wspace=0.25)
    for curve, style in zip(polar.curves, SERIES_STYLES, strict=False):
        speeds = np.linspace(0.0, curve.airspeeds[-1], 300)
        power = curve.power(speeds)
        left.plot(speeds, power, color=style.color, label=f"{curve.payload_kg:.2f} kg")
        slow = curve.speed_of_least_power
        left.plot(slow, curve.power(slow), "o", color=style.color, markersize=5)
        moving = speeds >= _SLOWEST_M_S
        right.plot(speeds[moving], power[moving] / speeds[moving], color=style.color)
        best = curve.best_over_ground()
        right.plot(best.ground_speed, best.energy_per_metre, "o", color=style.color, markersize=5)
    left.set(xlabel="Airspeed (m/s)", ylabel="Power (W)", title="Power")
    right.set(xlabel="Airspeed (m/s)", ylabel="Energy per metre (J/m)", title="Energy per metre")
    right.set_ylim(0.0, 4.0 * polar.own.best_over_ground().energy_per_metre)
    left.legend(title="Carried", frameon=False)
    return figure


def draw_winds(polar: Polar) -> Figure:
    """Draw the ground speed of least energy per metre, and this energy, over the wind's direction.

    Each curve is one wind speed. The horizontal axis is the angle between the course and the
    direction to which the wind blows.
    """
    figure, (left, right) = full_width(3.3, (1, 2), top=0.9, bottom=0.26, wspace=0.25)
    speeds = polar.winds[WIND].unique().tolist()
    for wind, style in zip(speeds, SERIES_STYLES, strict=False):
        rows = polar.winds[polar.winds[WIND] == wind]
        angles = rows[ANGLE]
        is_calm = len(rows) == 1
        for axes, name in ((left, GROUND_SPEED), (right, ENERGY_PER_METRE)):
            x, y = (angles, rows[name]) if not is_calm else ([0, 180], [rows[name].iloc[0]] * 2)
            axes.plot(x, y, label=f"{wind:g} m/s", **style.line)
    for axes in (left, right):
        axes.set_xticks(range(0, 181, 45))
        axes.set_xlabel("Angle between course and wind (°)")
    left.set(ylabel="Ground speed (m/s)", title="Best ground speed")
    right.set(ylabel="Energy per metre (J/m)", title="Energy per metre over the ground")
    handles, labels = left.get_legend_handles_labels()
    figure.legend(handles, labels, loc="lower center", ncols=7, frameon=False)
    return figure


def draw_reach(polar: Polar) -> Figure:
    """Draw how far from the start the vehicle can fly and return on one battery charge.

    The polar figure shows the greatest distance from the start (radius) over the course (angle).
    """
    figure = Figure(figsize=(FULL_WIDTH, 4.2))
    axes = figure.add_axes((0.25, 0.08, 0.5, 0.84), projection="polar")
    courses = np.radians(polar.reach[COURSE].to_numpy())
    reach = polar.reach[REACH].to_numpy() * _KILO
    closed = np.append(courses, courses[0] + 2 * np.pi), np.append(reach, reach[0])
    calm = 0.5 * polar.own.best_over_ground().range_m * _KILO
    axes.plot(
        np.linspace(0, 2 * np.pi, 181),
        np.full(181, calm),
        color=MUTED,
        linestyle="--",
        label="still air",
    )
    said = f"wind of {polar.wind_m_s:.1f} m/s"
    axes.plot(*closed, color=SERIES_STYLES[0].color, label=said)
    axes.fill(*closed, color=SERIES_STYLES[0].color, alpha=0.15, linewidth=0)
    most = 1.15 * max(calm, reach.max())
    axes.set_ylim(0.0, most)
    if polar.wind_m_s > 0.0:
        tip = (polar.wind_towards_rad, 0.35 * most)
        axes.annotate("", tip, (0.0, 0.0), arrowprops={"arrowstyle": "->", "color": INK})
    axes.legend(loc="lower left", bbox_to_anchor=(0.95, 0.0), frameon=False)
    return figure
