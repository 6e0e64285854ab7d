"""Headline of a run: its main results in a few sentences.

The sentences state energy and duration of the plan, its energy saving, and the success of its
simulated flights in turbulence. The energy saving compares the plan with one other flight of the
run, the rival. The function `rival_of` chooses the rival.
"""

from collections.abc import Iterable, Mapping
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
    """Main results of a run, and their wording.

    Attributes
    ----------
    energy_J, duration_s : float
        Energy and duration of the plan.
    battery_percent : float or None
        Charge used, in per cent of the capacity; None without a battery.
    rival : mapping or None
        Row of the comparison table from `rival_of`; None if no flight qualifies.
    settings : CruiseSettings or None
        Settings of the tuned autopilot, if it is the rival.
    risk : RiskTaken or None
        Margins for the allowed risk of a broken limit, and results of simulated flights in
        turbulence that tested them; None without `mission.risk`.
    often : InTurbulence or None
        Flights in turbulence along the plan, and of an autopilot. If given, the headline states
        their success, not that of the flights in `risk`.
    is_compared : bool
        Whether the plan arrives and keeps all limits, so that flights can be compared with it.
    """

    energy_J: float
    duration_s: float
    battery_percent: float | None
    rival: Row | None
    settings: "CruiseSettings | None"
    risk: "RiskTaken | None"
    often: "InTurbulence | None" = None
    is_compared: bool = True

    @property
    def words(self) -> str:
        """The main results of a run as sentences.

        They state the plan's energy and duration, its saving over another flight, its success in
        turbulence, and the energy that its safety margins cost.
        """
        charge = ""
        if self.battery_percent is not None:
            charge = f" ({self.battery_percent:.2f} % of the battery)"
        plan = f"The plan takes {self.energy_J:.2f} J{charge} and {self.duration_s:.4g} s"
        # In turbulence many flights are compared: one flight is no fair comparison for a plan that
        # was made for the mean wind.
        if self.often is None or self.often.saving is None:
            plan = f"{plan}: {self._saving}"
        return " ".join(filter(None, (f"{plan}.", self._share, self._price)))

    @property
    def summary(self) -> dict[str, Any]:
        """The main results of a run as values for JSON.

        The values are the sentences of `words`, the rival and the saving over it, and the settings
        of a tuned autopilot.
        """
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
        if not self.is_compared:
            return "it ends too far from the goal, or breaks a limit, for a comparison"
        if self.rival is None:
            return "no other flight arrived within its limits to compare with"
        spent, duration = settled_of(self.rival), float(self.rival[ComparisonColumn.DURATION])
        who = f"a controller without the plan ({self.rival[ComparisonColumn.FLIGHT]}: "
        at_most = ""
        if self.settings is not None:
            who = "an autopilot tuned for least energy ("
            at_most = f", at most {self.settings.words}"
        saving = float(self.rival[ComparisonColumn.SAVING])
        found = f"{abs(saving):.2f} % {'less' if saving >= 0.0 else 'more'} energy"
        return f"{found} than {who}{spent:.2f} J, {duration:.4g} s{at_most})"

    @property
    def _share(self) -> str:
        if self.often is not None:
            return self.often.words
        if self.risk is None or not self.risk.flown:
            return "Flights in gusts were not simulated."
        held = self.risk.flown - self.risk.failed
        return (
            f"In turbulence, {held} of {self.risk.flown} simulated flights arrive and keep every "
            f"limit ({100.0 * held / self.risk.flown:.1f} %)."
        )

    @property
    def _price(self) -> str:
        risk = self.risk
        if risk is None:
            return ""
        joules, percent = risk.price(self.energy_J)
        cost = f"{joules:.3g} J ({percent:.2g} %)"
        asked = f"{100.0 * risk.asked:g} %"
        if not risk.is_satisfied:
            return f"A risk of {asked} was not reached; the margins cost {cost}."
        return f"Margins that keep the risk of a broken limit at or below {asked} cost {cost}."


def headline_of(result: "RunResult") -> Headline | None:
    """Return the headline of a run: its main results and their wording.

    The result is None if the plan must not be flown (neither `VERIFIED` nor `USABLE`), if it was
    made for a wind forecast, or if the comparison table is empty.
    """
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
        is_compared=all(
            rows[OPTIMAL][one] for one in (ComparisonColumn.ARRIVED, ComparisonColumn.LIMITS_KEPT)
        ),
    )


def rival_of(comparison: "pd.DataFrame") -> Row | None:
    """Choose the flight with which the plan is compared, and return its row in `comparison`.

    `comparison` is the table of `compare_flights`. A flight other than "optimal" and
    "open_loop/plan" qualifies if the saving in its row is not NaN. The first choice is the flight
    of an autopilot tuned for least energy (`TUNED_CRUISE`). The second choice is the flight under
    the controller along a smooth straight path ("adaptive/quintic"). The third choice is the flight
    of least energy. If no flight qualifies, the result is None.
    """
    # The flight of the plan, and the simulation of its rotor commands without feedback.
    is_own = comparison[ComparisonColumn.FLIGHT].isin((OPTIMAL, OPEN_LOOP))
    # Only flights that arrived and kept all limits have a saving.
    rivals = comparison[comparison[ComparisonColumn.SAVING].notna() & ~is_own]
    by_name = {row[ComparisonColumn.FLIGHT]: row for row in rivals.to_dict("records")}
    cheapest = min(by_name.values(), key=settled_of, default=None)
    return by_name.get(TUNED_CRUISE) or by_name.get(FAIR_BASELINE) or cheapest


def settled_of(row: Row) -> float:
    """Return the energy of a flight to the exact goal state, from its comparison row [J].

    An estimate of the energy from the flight's end state to the goal state is included.
    """
    return float(row[ComparisonColumn.HOVER_ENERGY] + row[ComparisonColumn.EXCESS_ENERGY])


_WORDS = {
    OPTIMAL: "the plan",
    OPEN_LOOP: "the plan's rotor commands without feedback",
    TUNED_CRUISE: "an autopilot on straight legs, tuned for least energy",
    baseline_name(Reference.PLAN): "a controller that follows the plan",
    baseline_name(Reference.QUINTIC): "the controller on a smooth straight path",
    baseline_name(Reference.MINIMUM_SNAP): "the controller on a straight path of minimum snap",
    baseline_name(Reference.STEP): "the controller, given only the goal",
    replanned_name(Knowledge.TOLD): "planned again during the flight, knowing the wind",
    replanned_name(Knowledge.ESTIMATED): "planned again during the flight, estimating the wind",
    replanned_name(Knowledge.UNTOLD): "planned again during the flight, without knowing the wind",
}
_CRUISE_WORDS = "an autopilot on straight legs at this speed"


def legend_of(rows: Iterable[Row]) -> list[tuple[list[str], str]]:
    """Return the legend of a comparison table, which describes each kind of flight in words.

    Each item has the names of the flights of one kind, and the description.
    """
    found: dict[str, list[str]] = {}
    for row in rows:
        name = row[ComparisonColumn.FLIGHT]
        is_cruise = name.startswith(baseline_name(Reference.CRUISE))
        words = _WORDS.get(name, _CRUISE_WORDS if is_cruise else "another flight")
        found.setdefault(words, []).append(name)
    return [(names, words) for words, names in found.items()]
