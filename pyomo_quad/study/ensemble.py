"""Many simulated flights of a mission in random winds: rate of success, energy, charge.

A seed determines the winds. Flights along different reference trajectories, such as a plan and an
autopilot's cruise, thus meet the same winds. If the scenario states deviations of mass or hover
power, each flight also draws these. Without turbulence and without deviations of wind, mass or
hover power, all flights are equal.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, partial
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np

from pyomo_quad.arrays import FloatArray
from pyomo_quad.collocation import Summarised
from pyomo_quad.flight import Planner
from pyomo_quad.flight.baselines import baseline_name, path_of, reference_path
from pyomo_quad.flight.ensemble import TRACKS, Ending, EnsembleSimulation, FlownOften
from pyomo_quad.flight.plan import Plan, Trajectories
from pyomo_quad.flight.proof import in_order
from pyomo_quad.flight.references import ReferencePath
from pyomo_quad.flight.routes import SETTLINGS_S, cruise_at
from pyomo_quad.flight.weather import draw
from pyomo_quad.processes import side_by_side
from pyomo_quad.scenario import Scenario
from pyomo_quad.scenario.tables import CruiseSettings, Reference
from pyomo_quad.study.autopilot import TUNED_CRUISE
from pyomo_quad.version import __version__

if TYPE_CHECKING:
    import pandas as pd


#: Confidence level of the interval of a share.
CONFIDENCE = 0.95
#: Quantiles of a quantity over flights, in tables and figures.
BAND = (0.05, 0.5, 0.95)
# Flights that a process simulates together: many for vectorisation, few for use of every core.
_PIECE = 100
# Accuracy of the time for which an autopilot waits at the goal in all of its flights [s].
_WAIT_S = 0.1


@dataclass(frozen=True)
class Share:
    """Share of flights with a property, and its confidence interval.

    Attributes
    ----------
    count, of : int
        Number of flights with the property, and number of all flights.
    """

    count: int
    of: int

    @property
    def value(self) -> float:
        """Observed share: number of flights with the property over number of flights."""
        return self.count / self.of

    @property
    def interval(self) -> tuple[float, float]:
        """Confidence interval of the share, Clopper-Pearson at level `CONFIDENCE`.

        Equation: docs/theory/flights.md, eq. (2).
        """
        from scipy.special import betaincinv  # noqa: PLC0415  not for every run

        rest, k, n = 0.5 * (1.0 - CONFIDENCE), self.count, self.of
        low = float(betaincinv(k, n - k + 1, rest)) if k > 0 else 0.0
        high = float(betaincinv(k + 1, n - k, 1.0 - rest)) if k < n else 1.0
        return low, high

    def __str__(self) -> str:
        """Return the share with its confidence interval, as "98.7 % (97.8 to 99.3 %)"."""
        low, high = (100.0 * end for end in self.interval)
        return f"{100.0 * self.value:.1f} % ({low:.1f} to {high:.1f} %)"


@dataclass(frozen=True, kw_only=True, repr=False)
class Ensemble(Summarised):
    """Simulated flights of a mission along one reference trajectory, each in its own random wind.

    Attributes
    ----------
    scenario : Scenario
        The mission, with fixed duration and passing times.
    name : str
        Controller and reference, such as "adaptive/plan".
    seed : int
        Seed of the winds.
    flown : FlownOften
        Quantities over time, and result of each flight.
    planned : ndarray, shape (n_samples, 3)
        Reference positions at the times of `flown` [m].
    wall_s : float
        Wall-clock time [s].
    """

    scenario: Scenario
    name: str
    seed: int
    flown: FlownOften
    planned: FloatArray
    wall_s: float

    @property
    def count(self) -> int:
        """Number of flights."""
        return len(self.flown.endings)

    @property
    def succeeded(self) -> Share:
        """Share of flights that reached the goal and broke no limit."""
        return Share(sum(ending.has_succeeded for ending in self.flown.endings), self.count)

    @property
    def arrived(self) -> Share:
        """Share of flights that ended at the goal and at rest, whatever limits they broke."""
        return Share(sum(ending.has_arrived for ending in self.flown.endings), self.count)

    @property
    def broken(self) -> dict[str, Share]:
        """For each limit that a flight broke, the share of flights that broke it.

        The key is the limit in words. The limit with the largest share is first.
        """
        counts = Counter(name for ending in self.flown.endings for name in ending.broken)
        return {name: Share(count, self.count) for name, count in counts.most_common()}

    @property
    def worst(self) -> dict[str, float]:
        """Largest violation of each broken limit over all flights, by the limit in words.

        - Arrival: final distance [m] or final speed [m/s].
        - Battery: fraction of the required power or charge that is missing.
        - Any other limit: violation / max(1, limit).
        """
        return {
            name: max(ending.broken.get(name, 0.0) for ending in self.flown.endings)
            for name in self.broken
        }

    def of_flights(self, quantity: str) -> FloatArray:
        """Return one result, such as the energy, for every flight.

        `quantity` is the name of an attribute of `Ending`, the result of one flight. The result has
        one value for each flight, shape (count,).
        """
        return np.array([getattr(ending, quantity) for ending in self.flown.endings])

    def band(self, quantity: str) -> tuple[float, float, float]:
        """Return the 5, 50 and 95 % quantiles (`BAND`) of one result over the flights.

        `quantity` is the name of an attribute of `Ending`, such as the energy of the flight.
        """
        low, middle, high = np.quantile(self.of_flights(quantity), BAND).tolist()
        return low, middle, high

    @property
    def summary(self) -> dict[str, str]:
        """Summary of the flights, as a mapping from the name of a result to its value as text.

        The results include the share of successes, the energy, and the limit broken most often.
        """
        low, middle, high = self.band("energy_J")
        most = next(iter(self.broken.items()), None)
        return {
            "scenario": self.scenario.name,
            "flights": f"{self.count} of {self.name}, seed {self.seed}",
            "arrived and kept every limit": str(self.succeeded),
            "energy": f"{middle:.1f} J ({low:.1f} to {high:.1f} J in 90 % of flights)",
            "limit broken most": "none" if most is None else f"{most[0]}, in {most[1]}",
        }

    def table(self) -> "pd.DataFrame":
        """Return the results of the flights as a table with one row per flight.

        The columns are the number of the flight, the attributes of `Ending`, whether the flight
        succeeded ("held"), and the limits that it broke.
        """
        import pandas as pd  # noqa: PLC0415  0.3 s that a solve has no use for

        endings = self.flown.endings
        quantities = [name for name in Ending.__dataclass_fields__ if name != "broken"]
        return pd.DataFrame(
            {
                "flight": range(1, self.count + 1),
                **{name: self.of_flights(name) for name in quantities},
                "held": [ending.has_succeeded for ending in endings],
                "broken_limits": ["; ".join(ending.broken) or "none" for ending in endings],
            }
        )

    def bands(self) -> "pd.DataFrame":
        """Return a table of quantiles over the flights, with one row for each time.

        Each quantity of `TRACKS`, such as speed or energy, has three columns: its 5, 50 and 95 %
        quantiles (`BAND`).
        """
        import pandas as pd  # noqa: PLC0415  as above

        columns = {"time_s": self.flown.t}
        for name in TRACKS:
            quantiles = np.quantile(self.flown.tracks[name], BAND, axis=1)
            for share, values in zip(BAND, quantiles, strict=True):
                columns[f"{name}_{round(100 * share)}_percent"] = values
        return pd.DataFrame(columns)


def fly_plan_often(
    scenario: Scenario, held: Trajectories, *, planner: Planner, flights: int, seed: int
) -> Ensemble:
    """Simulate a plan many times under the adaptive controller, each time in a random wind.

    `scenario` has the duration and passing times of the plan (`Plan.mission_flown`). `held` has
    states and controls of the plan. The attribute `name` of the result is "adaptive/plan".
    """
    # The plan was made for the forecast wind or, without a forecast, for the actual wind without
    # turbulence.
    told = planner.dynamics(scenario.as_forecast())
    path = path_of(in_order(scenario, held, told), told, scenario)
    name = baseline_name(Reference.PLAN)
    return _flown(name, scenario, path, planner=planner, flights=flights, seed=seed)


def fly_cruise_often(
    scenario: Scenario,
    settings: CruiseSettings,
    *,
    planner: Planner,
    flights: int,
    seed: int,
    name: str = "",
    least_s: float = 0.0,
    arriving: float = 0.5,
) -> Ensemble:
    """Simulate many flights of an autopilot, straight between waypoints, in random winds.

    With the same seed, the winds are those of `fly_plan_often`. Every flight ends with the same
    wait at the goal. It is the shortest wait with which the share `arriving` of the flights ends at
    the goal and at rest. If no wait tried suffices, it is the one with most arrivals. Each flight
    lasts at least `least_s` [s]. `name` is the name of the result; the default states controller,
    reference and speed, as in "adaptive/cruise 6 m/s".
    """
    named = name or baseline_name(Reference.CRUISE, settings.speed)

    @cache
    def flown_with(settling_s: float) -> Ensemble:
        told = cruise_at(scenario.cruising(settings), settling_s=settling_s, least_s=least_s)
        path = reference_path(told, Reference.CRUISE)
        return _flown(named, told, path, planner=planner, flights=flights, seed=seed)

    def is_enough(settling_s: float) -> bool:
        # A flight that broke a limit can count as arrived: a longer wait would cost energy
        # without avoiding the violation.
        return flown_with(settling_s).arrived.count >= arriving * flights

    # Find the shortest wait to `_WAIT_S`: first the least sufficient one of `SETTLINGS_S`, then
    # bisection.
    enough = next(filter(is_enough, SETTLINGS_S), None)
    # No wait is long enough: the wait with most arrivals counts.
    if enough is None:
        return max(map(flown_with, SETTLINGS_S), key=lambda flown: flown.arrived.count)
    too_short = max((wait for wait in SETTLINGS_S if wait < enough), default=enough)
    while enough - too_short > _WAIT_S:
        between = (too_short + enough) / 2
        too_short, enough = (too_short, between) if is_enough(between) else (between, enough)
    return flown_with(enough)


def _flown(
    name: str,
    scenario: Scenario,
    path: ReferencePath,
    *,
    planner: Planner,
    flights: int,
    seed: int,
) -> Ensemble:
    began = perf_counter()
    dynamics, draws = draw(planner, scenario, flights, seed)
    simulation = EnsembleSimulation(scenario, dynamics, path, (*draws.numbers, *draws.noise))
    pieces = [draws.part(slice(k, k + _PIECE)) for k in range(0, flights, _PIECE)]
    with side_by_side([partial(simulation.fly, piece) for piece in pieces]) as finish:
        flown = finish()
    together = FlownOften(
        t=flown[0].t,
        tracks={
            name: np.concatenate([part.tracks[name] for part in flown], axis=1) for name in TRACKS
        },
        endings=tuple(ending for part in flown for ending in part.endings),
    )
    return Ensemble(
        scenario=scenario,
        name=name,
        seed=seed,
        flown=together,
        planned=np.array([path(t).place[:3] for t in together.t.tolist()]),
        wall_s=perf_counter() - began,
    )


@dataclass(frozen=True, kw_only=True)
class Saving:
    """Energy saving of flights along a plan compared with other flights in the same random winds.

    Attributes
    ----------
    rival : Ensemble
        The other flights, one in each wind.
    percent : (float, float, float)
        5, 50 and 95 % quantiles (`BAND`) of 100 (rival - plan) / rival over the winds, from the
        energies of both flights.
    both_succeeded : int
        Number of winds in which both flights arrived within all limits. The percentages cover all
        winds.
    """

    rival: Ensemble
    percent: tuple[float, float, float]
    both_succeeded: int

    @classmethod
    def of(cls, planned: Ensemble, rival: Ensemble) -> "Saving":
        """Return the energy saving of flights along a plan over rival flights in the same winds."""
        mine, other = (flown.of_flights("energy_J") for flown in (planned, rival))
        low, middle, high = np.quantile(100.0 * (other - mine) / other, BAND).tolist()
        pairs = zip(planned.flown.endings, rival.flown.endings, strict=True)
        both = sum(one.has_succeeded and two.has_succeeded for one, two in pairs)
        return cls(rival=rival, percent=(low, middle, high), both_succeeded=both)


@dataclass(frozen=True, kw_only=True)
class InTurbulence:
    """Simulated flights in turbulence: along a plan, and of an autopilot in the same winds.

    Attributes
    ----------
    flown : Ensemble
        Flights along the plan.
    saving : Saving or None
        Energy saving compared with the autopilot; None if no autopilot was simulated.
    autopilot : str
        The autopilot and its settings in words.
    """

    flown: Ensemble
    saving: Saving | None = None
    autopilot: str = ""

    @property
    def savings(self) -> tuple[Saving, ...]:
        """The energy saving over the autopilot, as a tuple of one item.

        The tuple is empty if no autopilot was simulated.
        """
        # Reports of ensembles read the savings as a tuple.
        return () if self.saving is None else (self.saving,)

    @property
    def words(self) -> str:
        """Sentences on the flights in turbulence: the share that succeed, and the energy saving.

        A flight succeeds if it arrives and breaks no limit. The saving is over an autopilot in the
        same winds.
        """
        held, most = self.flown.succeeded, next(iter(self.flown.broken.items()), None)
        broken = "" if most is None else f"; the limit broken most often: {most[0]}"
        found = (
            f"In turbulence, {held.count} of {held.of} simulated flights arrive and keep every "
            f"limit: {held}{broken}."
        )
        if self.saving is not None:
            low, middle, high = self.saving.percent
            rate = f"{abs(middle):.1f} % {'less' if middle >= 0.0 else 'more'} energy"
            rival = self.saving.rival
            found += (
                f" They take {rate} than {self.autopilot} in the same turbulence (median; "
                f"{low:.1f} to {high:.1f} % saved in 90 % of the winds). Each flight of the "
                f"autopilot takes {rival.scenario.mission.fixed_duration:.4g} s, and "
                f"{100.0 * rival.succeeded.value:.1f} % of them keep every limit."
            )
        return found


# Total simulated time [s] of the flights in turbulence of a run, which takes less than half a
# minute, and largest number of flights. Their number is this time over the plan's duration.
_FLOWN_S, _MOST_FLIGHTS = 10_000.0, 1000
# Seed of these flights. It differs from the seed of the flights from which the plan's margins were
# found.
_SEED = 1


def fly_in_turbulence(
    plan: Plan, cruise: CruiseSettings | None, *, is_tuned: bool = False, planner: Planner
) -> InTurbulence | None:
    """Simulate the flights of a plan, and of an autopilot, in the same random winds.

    If `cruise` is None, no autopilot is simulated. `is_tuned` says whether `cruise` has settings
    that were tuned for least energy; it only affects names. The result is None if the scenario has
    no turbulence, or if the plan must not be flown (`Plan.is_flyable`).
    """
    mission = plan.mission_flown
    if mission.wind.turbulence is None or not plan.is_flyable:
        return None
    flights = min(_MOST_FLIGHTS, round(_FLOWN_S / plan.duration_s) or 1)
    flown = fly_plan_often(mission, plan.trajectories, planner=planner, flights=flights, seed=_SEED)
    if cruise is None:
        return InTurbulence(flown=flown)
    least_s = 0.0 if plan.scenario.mission.is_free else plan.duration_s
    rival = fly_cruise_often(
        mission,
        cruise,
        planner=planner,
        flights=flights,
        seed=_SEED,
        name=TUNED_CRUISE if is_tuned else "",
        least_s=least_s,
    )
    tuned = " tuned for least energy" if is_tuned else ""
    words = f"an autopilot{tuned} (at most {cruise.words})"
    return InTurbulence(flown=flown, saving=Saving.of(flown, rival), autopilot=words)


def ensemble_summary(flown: Ensemble, savings: Sequence[Saving] = ()) -> dict[str, Any]:
    """Return the results of many flights in random winds as values for JSON.

    `savings` are the energy savings of the flights over other flights in the same winds.
    """
    worst = flown.worst
    return {
        **_facts(flown),
        "broken_limits": [
            {"limit": name, "share": share.value, "interval": share.interval, "worst": worst[name]}
            for name, share in flown.broken.items()
        ],
        "savings": [
            {
                "flight": saving.rival.name,
                **_facts(saving.rival),
                "saving_percent": dict(zip(_QUANTILES, saving.percent, strict=True)),
                "both_held": saving.both_succeeded,
            }
            for saving in savings
        ],
        "wall_s": {"fly": flown.wall_s + sum(saving.rival.wall_s for saving in savings)},
        "version": __version__,
        "scenario_resolved": flown.scenario.model_dump(mode="json"),
    }


_QUANTILES = tuple(f"{round(100 * share)}_percent" for share in BAND)
# Attributes of `Ending` whose distribution the summary gives.
_QUANTITIES = (
    "energy_J",
    "charge_used_percent",
    "miss_m",
    "end_speed_m_per_s",
    "largest_deviation_m",
)


def _facts(flown: Ensemble) -> dict[str, Any]:
    return {
        "scenario": flown.scenario.name,
        "flight": flown.name,
        "flights": flown.count,
        "seed": flown.seed,
        "duration_s": flown.scenario.mission.fixed_duration,
        "held": flown.succeeded.count,
        "held_share": flown.succeeded.value,
        "held_interval": flown.succeeded.interval,
        **{name: dict(zip(_QUANTILES, flown.band(name), strict=True)) for name in _QUANTITIES},
    }
