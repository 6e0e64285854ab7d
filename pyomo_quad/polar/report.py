"""What `polar` writes: tables, a summary, figures and a report."""

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from pyomo_quad.polar.figures import polar_drawings
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
from pyomo_quad.report.gallery import save_drawings, wanted_drawings
from pyomo_quad.report.render import render_markdown
from pyomo_quad.report.report import REPORT_NAME
from pyomo_quad.report.tables import write_summary, write_table
from pyomo_quad.version import __version__

_NAMES = {"POLAR_NAME": "polar.csv", "WIND_NAME": "wind.csv", "REACH_NAME": "reach.csv"}


def write_polar(folder: Path, polar: Polar, figures: Figures = Figures.SVG) -> None:
    """Write tables (CSV), summary, figures and the report into an empty folder."""
    write_table(pd.concat(map(_table, polar.curves)), folder / _NAMES["POLAR_NAME"])
    write_table(polar.winds, folder / _NAMES["WIND_NAME"])
    write_table(polar.reach, folder / _NAMES["REACH_NAME"])
    write_summary(folder, polar_summary(polar))
    drawings = wanted_drawings(polar_drawings(polar), figures)
    save_drawings(drawings, folder)
    ends = polar.winds[polar.winds[ANGLE].isin((0.0, 90.0, 180.0))]
    text = render_markdown(
        "polar/report.md.j2",
        polar=polar,
        curves=[_facts(curve) for curve in polar.curves],
        ends=ends.to_dict("records"),
        least=polar.reach.iloc[int(np.argmin(polar.reach[REACH]))].to_dict(),
        most=polar.reach.iloc[int(np.argmax(polar.reach[REACH]))].to_dict(),
        wind_columns=(WIND, ANGLE, GROUND_SPEED, AIRSPEED, POWER, ENERGY_PER_METRE, RANGE),
        REACH=REACH,
        COURSE=COURSE,
        drawings=drawings,
        version=__version__,
        **_NAMES,
    )
    (folder / REPORT_NAME).write_text(text, encoding="utf-8")


def polar_summary(polar: Polar) -> dict[str, Any]:
    """Return the speeds, ranges and reaches of a polar, as only JSON can hold them."""
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
