"""Plans with a stated risk: margins for what turbulence and unknowns do, found by planning again.

A plan is made with margins, the spread of flights along it gives the margins that the risk needs,
and so on until they agree; then flights that meet turbulence judge it, and where they break a limit
more often than they may, its margin grows.  See docs/theory/risk.md, eqs. (7) to (9).
"""

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pyomo_quad.collocation import Progress
from pyomo_quad.flight.baselines import reference_path
from pyomo_quad.flight.breaching import AT_HOLD, Approach, approaches, missing
from pyomo_quad.flight.covariance import Spread, spread_along
from pyomo_quad.flight.ensemble import Squadron
from pyomo_quad.flight.flight import HELD_BREACH, POSITION_STATES
from pyomo_quad.flight.limit_words import limit_words
from pyomo_quad.flight.margins import (
    AUTHORITY,
    HOLD,
    RiskTaken,
    greatest_margin,
    passing_times,
    tightened,
)
from pyomo_quad.flight.plan import Plan
from pyomo_quad.flight.planning import Planner
from pyomo_quad.flight.weather import as_expected, draw
from pyomo_quad.model import build_model
from pyomo_quad.scenario import Scenario
from pyomo_quad.scenario.tables import Reference
from pyomo_quad.scenario.wind import Intensity, Turbulence

FloatArray = NDArray[np.float64]

# Meets a plan with a risk where the scenario states no turbulence.
_USUAL_TURBULENCE = Turbulence(intensity=Intensity.LIGHT)
# Flights that a calibration flies, and their seed; those that judge the plan have the next.
_FLIGHTS, _SEED = 300, 20_260_515
# Plans for margins of the covariance, and again for those that flights ask for.
_PLANS, _CALIBRATIONS = 4, 3
# Margins that agree with those asked for within this share, or within this share of the limit.
_AGREED, _AGREED_OF_LIMIT = 0.1, 2e-3
# A flight without gusts that ends farther off than this [m] had not the rotors to follow the plan.
_ASTRAY_M = 0.1
# Shares of the way from hover to a limit that such a plan leaves, one after the other.
_RESERVES = (0.05, 0.1, 0.2, 0.35)
_GROWTH = 1.5
# s, by how much earlier each plan is at a hold than the last one, and at most.
_EARLIER_S, _EARLIEST_S = 0.3, 1.5


def risk_asked(scenario: Scenario) -> float:
    """Return the risk that a scenario asks for, 1 where it asks for none."""
    return 1.0 if scenario.mission.risk is None else scenario.mission.risk


def plan_at_risk(
    scenario: Scenario, planner: Planner, *, progress: Progress | None = None, **solve: Any
) -> Plan:
    """Return the plan of a scenario that keeps the risk which the scenario asks for.

    Parameters
    ----------
    **solve
        Of `Planner.solve`, for the plan without margins.

    Returns
    -------
    Plan
        With `risk`; of a scenario that asks for none the plan of `Planner.solve`.  Where the risk
        cannot be had, or the user stops the search, the plan of the least risk found.
    """
    with planner.until_stopped() as is_stopped:
        paper = planner.solve(scenario, progress=progress, **solve)
        is_own = planner.builder is not build_model
        if risk_asked(scenario) >= 1.0 or not paper.is_verified or is_own:
            return paper
        return _Search(scenario, planner, paper, progress, is_stopped).best()


@dataclass(frozen=True, kw_only=True)
class _Tried:
    """A plan with margins, and what is known of its flights."""

    plan: Plan
    margins: Mapping[str, float]
    spread: Spread
    near: tuple[Approach, ...]
    missed: Mapping[str, float]

    @property
    def predicted(self) -> float:
        """Probability that a flight breaks any limit, by Boole's inequality."""
        held = [self.margins.get(approach.field, 0.0) for approach in self.near]
        by_limits = sum(a.probability(m, m) for a, m in zip(self.near, held, strict=True))
        return float(min(by_limits + sum(self.missed.values()), 1.0))

    @property
    def astray(self) -> float:
        """How far from its plan the flight without gusts ends [m]."""
        columns = [self.spread.dynamics.state_names.index(name) for name in POSITION_STATES]
        goal = np.array(self.plan.scenario.mission.goal.position)
        return float(np.linalg.norm(self.spread.states[-1, columns] - goal))


class _Search:
    """The search for the margins of one scenario."""

    def __init__(
        self,
        scenario: Scenario,
        planner: Planner,
        paper: Plan,
        progress: Progress | None,
        is_stopped: Callable[[], bool],
    ) -> None:
        self._scenario, self._planner, self._paper = scenario, planner, paper
        self._progress, self._is_stopped = progress, is_stopped
        self._risk = risk_asked(scenario)
        self._least: Mapping[str, float] = {}
        self._told = scenario
        if scenario.wind.turbulence is None:
            wind = scenario.wind.model_copy(update={"turbulence": _USUAL_TURBULENCE})
            self._told = scenario.model_copy(update={"wind": wind})

    def best(self) -> Plan:
        """Return the plan that keeps the risk, or that of the least risk found."""
        tried = self._tried(self._paper, {})
        tried = self._followed(tried)
        for _ in range(_PLANS):
            wanted = self._margins(tried)
            if self._is_stopped() or self._agree(tried.margins, wanted):
                break
            other = self._planned(tried, wanted)
            if other is None:
                break
            tried = other
        return self._calibrated(tried)

    def _tried(self, plan: Plan, margins: Mapping[str, float]) -> _Tried:
        flown = replace(plan, scenario=self._told).mission_flown
        spread = spread_along(flown, plan, self._planner)
        near = tuple(approaches(spread, *_planned_at(plan, spread)))
        missed = missing(flown, spread)
        return _Tried(plan=plan, margins=margins, spread=spread, near=near, missed=missed)

    def _planned(self, last: _Tried, margins: Mapping[str, float]) -> _Tried | None:
        """Return a plan with margins, begun from another; None where there is none."""
        held = tightened(self._scenario, margins)
        plan = self._planner.solve(held, warm_start=last.plan, progress=self._progress)
        if not plan.is_flyable:
            plan = self._planner.solve(held, progress=self._progress)
        if not plan.is_flyable:
            return None
        times = passing_times(self._scenario, plan.passing_times_s, margins.get(HOLD, 0.0))
        own = replace(plan, scenario=self._scenario, passing_times_s=times)
        return self._tried(own, margins)

    def _followed(self, tried: _Tried) -> _Tried:
        """Return a plan that the flight without gusts follows, where margins can make one."""
        for share in _RESERVES:
            if tried.astray <= _ASTRAY_M or self._is_stopped():
                break
            margins = {name: share * greatest_margin(self._scenario, name) for name in AUTHORITY}
            for name, more in self._steeper_than_the_controller().items():
                margins[name] = max(margins[name], more)
            other = self._planned(tried, margins)
            if other is None:
                break
            # What lets the vehicle follow its plan at all is not given back.
            tried, self._least = other, margins
        return tried

    def _steeper_than_the_controller(self) -> dict[str, float]:
        """Return how much more plans may tilt than a controller with a limit of its own."""
        limits, most = self._scenario.limits, self._scenario.baseline.gains.tilt_max
        if most is None:
            return {}
        return {
            "limits.roll_max": limits.roll_max - most,
            "limits.pitch_max": limits.pitch_max - most,
        }

    def _margins(self, tried: _Tried) -> dict[str, float]:
        """Return the margins that the risk needs: equal shares for the limits that need any.

        What limits far from the plan take of the risk, and misses, is left out of the shares.
        """
        held = tried.margins
        taken = sum(p for words, p in tried.missed.items() if not words.startswith(AT_HOLD))
        alone = {a: a.probability(held.get(a.field, 0.0), 0.0) for a in tried.near}
        # A limit that takes a hundredth of the risk needs no margin.
        pressed = [a for a, probability in alone.items() if probability > 0.01 * self._risk]
        taken += sum(p for a, p in alone.items() if a not in pressed)
        share = max(self._risk - taken, 0.1 * self._risk) / max(len(pressed), 1)
        margins: dict[str, float] = {}
        for approach in pressed:
            most = greatest_margin(self._scenario, approach.field)
            needed = approach.margin_for(share, held.get(approach.field, 0.0), most)
            if needed > 0.0:
                margins[approach.field] = max(margins.get(approach.field, 0.0), needed)
        for name, least in self._least.items():
            margins[name] = max(margins.get(name, 0.0), least)
        at_holds = sum(p for words, p in tried.missed.items() if words.startswith(AT_HOLD))
        if at_holds > share or held.get(HOLD):
            earlier = _EARLIER_S if at_holds > share else 0.0
            margins[HOLD] = min(held.get(HOLD, 0.0) + earlier, _EARLIEST_S)
        return margins

    def _agree(self, held: Mapping[str, float], wanted: Mapping[str, float]) -> bool:
        """Say whether the margins of a plan are those that its flights need."""
        if held.get(HOLD) != wanted.get(HOLD):
            return False
        for name in {*held, *wanted} - {HOLD}:
            one, other = held.get(name, 0.0), wanted.get(name, 0.0)
            table, _, key = name.partition(".")
            size = abs(float(getattr(getattr(self._scenario, table), key)))
            if abs(one - other) > max(_AGREED * other, _AGREED_OF_LIMIT * size):
                return False
        return True

    def _calibrated(self, tried: _Tried) -> Plan:
        """Return the plan whose margins flights confirm, or that of the least risk found."""
        found: list[tuple[int, _Tried, Counter[str]]] = []
        for _ in range(_CALIBRATIONS + 1):
            broken = self._flown(tried, _SEED)
            failed = sum(1 for words in broken if words)
            counts = Counter(word for words in broken for word in words)
            found.append((failed, tried, counts))
            if failed <= self._risk * _FLIGHTS or self._is_stopped():
                break
            grown = self._grown(tried, counts)
            other = None if grown == tried.margins else self._planned(tried, grown)
            if other is None:
                break
            tried = other
        failed, tried, _ = min(found, key=lambda one: (one[0], one[1].plan.energy))
        is_had = failed <= self._risk * _FLIGHTS
        judged = self._flown(tried, _SEED + 1)
        counts = Counter(word for words in judged for word in words)
        limiting = tuple(word for word, _ in counts.most_common(3))
        taken = RiskTaken(
            asked=self._risk,
            predicted=tried.predicted,
            failed=sum(1 for words in judged if words),
            flown=_FLIGHTS,
            is_had=is_had,
            margins=dict(tried.margins),
            paper_energy_J=self._paper.energy,
            limiting=limiting,
            advice="" if is_had else self._advice(limiting),
        )
        return replace(tried.plan, risk=taken)

    def _flown(self, tried: _Tried, seed: int) -> list[tuple[str, ...]]:
        """Return the limits that each of many flights breaks, in words."""
        expected = as_expected(replace(tried.plan, scenario=self._told).mission_flown)
        dynamics, draws = draw(self._planner, expected, _FLIGHTS, seed)
        path = reference_path(expected, Reference.PLAN, tried.plan)
        squadron = Squadron(expected, dynamics, path, (*draws.noise, *draws.numbers))
        return [tuple(ending.broken) for ending in squadron.fly(draws).endings]

    def _grown(self, tried: _Tried, counts: Mapping[str, int]) -> dict[str, float]:
        """Return margins that are larger for the limits that flights break more than they may.

        A flight that misses a place lacks the authority to correct what a gust did to it.
        """
        allowed = self._risk * _FLIGHTS / max(len(counts), 1)
        fields: set[str] = set()
        for word, count in counts.items():
            if count > allowed:
                own = {a.field for a in tried.near if limit_words(a.name) == word}
                fields |= own or ({HOLD} if word.startswith(AT_HOLD) else set(AUTHORITY))
        margins = dict(tried.margins)
        if HOLD in fields:
            margins[HOLD] = min(margins.get(HOLD, 0.0) + _EARLIER_S, _EARLIEST_S)
            fields.remove(HOLD)
        for name in fields:
            deviation = max(
                (float(a.deviation.max()) for a in tried.near if a.field == name), default=0.0
            )
            most = greatest_margin(self._scenario, name)
            held = margins.get(name, 0.0)
            margins[name] = min(max(_GROWTH * held, held + deviation / 2), most)
        return margins

    def _advice(self, limiting: tuple[str, ...]) -> str:
        """Return what would help against the limit that is broken most."""
        first = limiting[0] if limiting else ""
        if first.startswith(("keep-out", "floor", "ceiling")):
            return "start, waypoints and goal farther from it, or a lower limits.speed_max"
        if "waypoint" in first or "hold place" in first:
            return "a larger radius of the waypoint, or a later time to pass it"
        if self._scenario.mission.is_free:
            return "a longer mission.duration_min, or weaker turbulence"
        return "a longer mission.duration, or weaker turbulence"


def _planned_at(plan: Plan, spread: Spread) -> tuple[FloatArray, FloatArray]:
    """Return states and controls of a plan at the times of a spread, in its order."""
    held, dynamics = plan.trajectories, spread.dynamics
    names = list(held.state_names)
    known = held.states_at(spread.t)
    states = np.zeros_like(spread.states)
    for column, name in enumerate(dynamics.state_names):
        if name in names:
            states[:, column] = known[:, names.index(name)]
    limits = dynamics.control_limits(HELD_BREACH)
    return states, held.controls_at(spread.t, limits)
