"""The result of a run in plain words: energy, saving, duration, and the share of flights that hold.

The saving is against the autopilot tuned for least energy (`study.autopilot`).  A run without this
flight compares with the smooth baseline, or else with the cheapest flight that arrived within the
limits.
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from math import isfinite
from typing import TYPE_CHECKING, Any

from pyomo_quad.flight.baselines import OPEN_LOOP, baseline_name
from pyomo_quad.flight.replanning import replanned_name
from pyomo_quad.scenario.tables import Knowledge, Reference
from pyomo_quad.study.autopilot import TUNED_CRUISE
from pyomo_quad.study.comparison import FAIR_BASELINE, OPTIMAL, ComparisonColumn

if TYPE_CHECKING:
    import pandas as pd

    from pyomo_quad.flight.margins import RiskTaken
    from pyomo_quad.scenario.tables import CruiseSettings
    from pyomo_quad.study.ensemble import InTurbulence
    from pyomo_quad.study.run import RunResult

Row = Mapping[Any, Any]


@dataclass(frozen=True, kw_only=True)
class Headline:
    """What a run found.

    Attributes
    ----------
    energy_J, duration_s : float
        Of the plan.
    battery_percent : float or None
        Charge that the plan uses; None without a battery.
    rival : mapping or None
        Row of the comparison of the flight that the saving is against; None if no other flight
        arrived within the limits.
    settings : CruiseSettings or None
        Those of the tuned autopilot, if it is the rival.
    risk : RiskTaken or None
        The flights in turbulence that the plan was tried in.
    often : InTurbulence or None
        Many flights of the run in turbulence, which are named instead of those.
    """

    energy_J: float
    duration_s: float
    battery_percent: float | None
    rival: Row | None
    settings: "CruiseSettings | None"
    risk: "RiskTaken | None"
    often: "InTurbulence | None" = None

    @property
    def words(self) -> str:
        """The headline, in three or four sentences."""
        charge = ""
        if self.battery_percent is not None:
            charge = f" ({self.battery_percent:.2f} % of the battery)"
        plan = f"The plan takes {self.energy_J:.2f} J{charge} and {self.duration_s:.6g} s."
        return " ".join(filter(None, (plan, self._saving, self._share, self._price)))

    @property
    def summary(self) -> dict[str, Any]:
        """The words, and the numbers of the saving."""
        against = (
            {
                "flight": self.rival[ComparisonColumn.FLIGHT],
                "energy_J": settled_of(self.rival),
                "duration_s": float(self.rival[ComparisonColumn.DURATION]),
                "saving_percent": float(self.rival[ComparisonColumn.SAVING]),
            }
            if self.rival is not None
            else None
        )
        return {
            "words": self.words,
            "against": against,
            "autopilot": None if self.settings is None else asdict(self.settings),
        }

    @property
    def _saving(self) -> str:
        if self.rival is None:
            return "No other flight arrived within the limits, so no saving is known."
        spent, duration = settled_of(self.rival), float(self.rival[ComparisonColumn.DURATION])
        who = f"The controller on its own path ({self.rival[ComparisonColumn.FLIGHT]})"
        if self.settings is not None:
            who = f"An autopilot tuned for least energy, at {cruise_words(self.settings)},"
        saving = float(self.rival[ComparisonColumn.SAVING])
        found = f"saves {saving:.2f} %" if saving >= 0.0 else f"takes {-saving:.2f} % more"
        return f"{who} takes {spent:.2f} J and {duration:.4g} s: the plan {found}."

    @property
    def _share(self) -> str:
        if self.often is not None:
            return self.often.words
        if self.risk is None or not self.risk.flown:
            return "No flights in turbulence were flown."
        held = self.risk.flown - self.risk.failed
        return (
            f"Of {self.risk.flown} flights in turbulence {held} arrive and keep every limit "
            f"({100.0 * held / self.risk.flown:.1f} %)."
        )

    @property
    def _price(self) -> str:
        if self.risk is None:
            return ""
        joules, percent = self.risk.price(self.energy_J)
        return (
            f"The margins for a risk of {self.risk.asked:g} cost {joules:.3g} J ({percent:.2g} %)."
        )


def cruise_words(settings: "CruiseSettings") -> str:
    """Return the settings of an autopilot in words."""
    return (
        f"{settings.speed:.3g} m/s, {settings.acceleration:.3g} m/s² and {settings.jerk:.3g} m/s³"
    )


def headline_of(result: "RunResult") -> Headline | None:
    """Return the headline of a run; None without a plan, or with a plan for another wind."""
    told_otherwise = result.scenario.wind.forecast is not None
    if result.comparison.empty or told_otherwise or not result.plan.is_flyable:
        return None
    rows = {row[ComparisonColumn.FLIGHT]: row for row in result.comparison.to_dict("records")}
    used = float(rows[OPTIMAL][ComparisonColumn.BATTERY_USED])
    rival = rival_of(result.comparison)
    is_tuned = rival is not None and rival[ComparisonColumn.FLIGHT] == TUNED_CRUISE
    tuning = result.tuning if is_tuned else None
    return Headline(
        energy_J=result.plan.energy,
        duration_s=result.plan.duration_s,
        battery_percent=used if isfinite(used) else None,
        rival=rival,
        settings=None if tuning is None else tuning.settings,
        risk=result.plan.risk,
        often=result.often,
    )


def rival_of(comparison: "pd.DataFrame") -> Row | None:
    """Return the flight that savings are against, of those that arrived within the limits."""
    is_own = comparison[ComparisonColumn.FLIGHT].isin((OPTIMAL, OPEN_LOOP))
    rivals = comparison[comparison[ComparisonColumn.SAVING].notna() & ~is_own]
    by_name = {row[ComparisonColumn.FLIGHT]: row for row in rivals.to_dict("records")}
    cheapest = min(by_name.values(), key=settled_of, default=None)
    return by_name.get(TUNED_CRUISE) or by_name.get(FAIR_BASELINE) or cheapest


def settled_of(row: Row) -> float:
    """Return the energy of a flight plus its owed energy, by which flights are compared [J]."""
    return float(row[ComparisonColumn.HOVER_ENERGY] + row[ComparisonColumn.EXCESS_ENERGY])


_WORDS = {
    OPTIMAL: "the plan",
    OPEN_LOOP: "the plan's controls without feedback",
    TUNED_CRUISE: "an autopilot at the settings of least energy",
    baseline_name(Reference.PLAN): "the plan under feedback",
    baseline_name(Reference.QUINTIC): "a smooth straight path in the mission's time",
    baseline_name(Reference.MINIMUM_SNAP): "a smoother straight path in the mission's time",
    baseline_name(Reference.STEP): "the goal given at once",
    replanned_name(Knowledge.TOLD): "planned again in flight, told the wind",
    replanned_name(Knowledge.ESTIMATED): "planned again in flight, estimating the wind",
    replanned_name(Knowledge.UNTOLD): "planned again in flight, not told the wind",
}


def flight_words(name: str) -> str:
    """Return what a flight is, for a reader who does not know its name."""
    if name in _WORDS:
        return _WORDS[name]
    is_cruise = name.startswith(baseline_name(Reference.CRUISE))
    return "an autopilot at this speed" if is_cruise else "another flight"
