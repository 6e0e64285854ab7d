"""Search for the margins with which flights of a plan in turbulence keep an allowed risk.

The risk is the probability that a flight in turbulence breaks any limit. A margin is the amount by
which a plan tightens a limit. The covariance of flights about a plan gives the margins of the next
plan; simulated flights that break limits increase them. See docs/theory/risk.md, eqs. (7) to (9).
"""

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from pyomo_quad.arrays import FloatArray
from pyomo_quad.collocation import Progress, SolverOptions
from pyomo_quad.flight.baselines import reference_path
from pyomo_quad.flight.breaching import (
    LimitDistance,
    Miss,
    limit_distances,
    missing,
)
from pyomo_quad.flight.candidate import Candidate
from pyomo_quad.flight.covariance import Spread, spread_along
from pyomo_quad.flight.deadline import Deadline
from pyomo_quad.flight.ensemble import NOT_AT_REST, NOT_THERE, EnsembleSimulation
from pyomo_quad.flight.flight import HELD_BREACH, POSITION_STATES
from pyomo_quad.flight.limit_words import limit_words
from pyomo_quad.flight.margins import (
    AUTHORITY,
    DURATION,
    HOLD,
    KEPT_BY_CONTROLLER,
    RiskTaken,
    greatest_margin,
    passing_times,
    tightened,
)
from pyomo_quad.flight.mission_problem import MissionProblem
from pyomo_quad.flight.plan import Plan
from pyomo_quad.flight.planning import Planner
from pyomo_quad.flight.references import Setpoint
from pyomo_quad.flight.search import Search
from pyomo_quad.flight.strategies import FIRST, PROOF, carry_out
from pyomo_quad.flight.verdict import plan_of
from pyomo_quad.flight.weather import as_expected, draw
from pyomo_quad.scenario import Scenario
from pyomo_quad.scenario.mission import Aim
from pyomo_quad.scenario.tables import Reference
from pyomo_quad.scenario.wind import Intensity, Turbulence, WindCoupling

# Turbulence for which margins are found if the scenario states none.
_USUAL_TURBULENCE = Turbulence(intensity=Intensity.LIGHT)
# Number of simulated flights that test a plan, and seed of the first plan's; each plan is tested in
# other winds.
_FLIGHTS, _SEED = 200, 20_260_515
# Number of test flights after which a plan has failed its test if more of them have broken a limit
# than is allowed for all test flights together.
_FIRST_FLIGHTS = 50
# Largest number of plans until the margins agree with the covariance, of plans after that with
# margins increased because of the test flights, and of plans with smaller margins after a plan that
# passed its test at a price above `_FAIR_PRICE` (share of the energy without margins).
_PLANS, _CALIBRATIONS, _REDUCTIONS, _FAIR_PRICE = 3, 6, 1, 0.02
# Relative difference below which two margins agree, relative to the margin and to the limit.
_AGREED, _AGREED_OF_LIMIT = 0.1, 2e-3
# Distance from the goal [m] at the end of the flight without gusts above which the rotors were too
# weak to follow the plan.
_ASTRAY_M = 0.1
# Largest fraction of the risk that misses of the goal may use; above it, a plan leaves a reserve of
# thrust and tilt.
_SHARE_OF_GOAL = 0.3
# Options of a re-solve with other margins, whose warm start is close.
_ROUGHLY = SolverOptions(tolerance=1e-6, extra=(("mu_init", 1e-4),))
# Fractions of the range from hover to the limits of rotors and tilt that a plan leaves as a
# reserve. The search begins with the second and doubles its steps until flights can follow the
# plan, then bisects: most missions need a small reserve.
_RESERVES = (0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.58, 0.65, 0.72, 0.8)
_FIRST_RESERVE = 1
# Largest reserve of thrust and tilt in a plan of free duration; a larger reserve only makes its
# duration longer, since a plan with little thrust of its own cannot slow down in time.
_LARGEST_OF_FREE = 0.65
# Relative increase of a free duration per unit of this reserve: weaker braking alone is not enough
# where the rotors can lift many times the weight.
_LONGER = 0.75
# Factor by which margins grow after test flights, and least growth of a margin on the radius or the
# speed of a waypoint, as a share of it.
_GROWTH, _SHARE_OF_PLACE = 1.5, 0.2
# Increase of the reserve per share of test flights that miss the goal, its least and largest value,
# and the largest reserve with a free duration.
_RESERVE_PER_MISS, _LEAST_STEP, _LARGEST_STEP, _LARGEST_FREE = 0.5, 0.1, 0.4, 2.0
# Time by which each new plan starts a hover at a waypoint earlier than the last plan, and largest
# total [s].
_EARLIER_S, _EARLIEST_S = 0.3, 1.5
# Duration of a simulated hover at the goal [s], by the end of which the controller has adapted to
# the wind.
_HOVER_S = 8.0
# The risk is out of reach if gusts carry off more than `_TOO_MANY` times as many hovering vehicles
# as the risk allows; fewer may be an accident of the winds drawn. A plan is followed if its flights
# miss the goal at most `_LIKE_A_HOVER` times as often as hovering vehicles.
_TOO_MANY, _LIKE_A_HOVER = 2.0, 1.2
#: Reason for which a search for margins ends early.
STOPPED = "the search was stopped"


def _again(
    planner: Planner, plan: Plan, tight: Scenario, progress: Progress | None, *, is_rough: bool
) -> Plan:
    """Solve a plan's scenario with tightened limits, warm-started from the plan's solution.

    If `is_rough`, the solve uses the mesh of `plan`, without refinement and verification. A plan
    without a fitting warm start is always solved in full.
    """
    told, start = tight.as_forecast(), plan.warm_start
    with Deadline(told, progress) as deadline:
        search = Search(deadline)
        mission = MissionProblem(planner, plan.scenario.as_forecast(), search)
        if start is None or not start.fits(mission.problem.compiled):
            return planner.solve(tight, progress=progress)
        mission.told = told
        if is_rough:
            solution = mission.solve(
                mesh=start.mesh, tolerance=None, options=_ROUGHLY, warm_start=start
            )
            return plan_of(tight, solution, {}, mission.hover_energy(solution))
        candidate = Candidate(scenario=tight, mission=mission, search=search, start=plan)
        carry_out((*FIRST, *PROOF), candidate, search)
        return replace(candidate.plan, routes=plan.routes, order_search=plan.order_search)


@dataclass(frozen=True, kw_only=True)
class _Tried:
    """Plan with margins, and the predicted statistics of flights in turbulence that follow it.

    The scenario of `plan` has the original limits. `margins` maps fields to the amounts by which
    their limits were tightened.
    """

    plan: Plan
    margins: Mapping[str, float]
    # Normal distribution of the states of flights about the plan.
    spread: Spread
    # Statistics of the distance of flights from each limit over time.
    near: tuple[LimitDistance, ...]
    # For each limit at the goal or at a waypoint: random samples of the distance from the place, or
    # of the speed there.
    missed: tuple[Miss, ...]
    # Whether the mesh was refined for this plan and the plan was simulated, with or without
    # success.
    is_refined: bool = True

    @property
    def predicted(self) -> float:
        """Upper bound on the probability that a flight along the plan breaks any limit.

        It is the sum of the probabilities for the single limits (Boole's inequality), at most 1.
        """
        # The controller clips its commands to the limits on rotor speed and thrust, so that no
        # flight breaks them.
        by_limits = sum(
            limit.present_probability
            for limit in self.near
            if limit.field not in KEPT_BY_CONTROLLER
        )
        return float(min(by_limits + sum(miss.probability for miss in self.missed), 1.0))

    @property
    def missing_places(self) -> float:
        """Probability that a flight breaks a limit at the goal or a waypoint that has no margin.

        The value is an upper bound: the sum of the probabilities for each of these limits. An
        example is the limit on the distance from the goal.
        """
        # Every plan already reaches the goal exactly, so that no margin tightens these limits. A
        # plan that leaves the rotors a larger reserve of thrust breaks them less often.
        return sum(miss.probability for miss in self.missed if not miss.field)

    @property
    def astray(self) -> float:
        """Distance from the goal [m] at which a flight along the plan without gusts ends.

        A large distance shows that the rotors are too weak to follow the plan.
        """
        columns = [self.spread.dynamics.state_names.index(name) for name in POSITION_STATES]
        goal = np.array(self.plan.scenario.mission.goal.position)
        return float(np.linalg.norm(self.spread.states[-1, columns] - goal))


@dataclass(frozen=True, kw_only=True)
class _Tested:
    """Result of simulated test flights of one plan in turbulence.

    `counts` maps the name of a limit in words to the number of flights that broke it. `failed` is
    the number of flights that broke any limit.
    """

    tried: _Tried
    seed: int
    counts: Counter[str]
    failed: int
    flown: int

    @property
    def share(self) -> float:
        """Fraction of the test flights that broke a limit, from 0 to 1."""
        return self.failed / self.flown


class MarginSearch:
    """Iterative search for the margins of one scenario, starting from its plan without margins.

    Each plan is tested by simulated flights in turbulence. A test flight fails if it breaks any
    limit. It misses the goal if it ends too far away or too fast. Margins on rotor
    speed, thrust and tilt leave a reserve of these to the controller.

    A `_Tried` is a plan with its margins, and with the predicted statistics of flights that follow
    it. A `_Tested` also has the results of its test flights.

    Parameters
    ----------
    paper : Plan
        Plan without margins.
    planner : Planner
        Planner that solves the scenario with tightened limits.
    risk : float
        Allowed risk, above 0 and below 1.
    progress : callable, optional
        Called at each Ipopt iteration.
    is_stopped : callable, optional
        Returns whether the user stopped the search.
    """

    def __init__(
        self,
        paper: Plan,
        planner: Planner,
        risk: float,
        *,
        progress: Progress | None = None,
        is_stopped: Callable[[], bool] = lambda: False,
    ) -> None:
        # The waypoints of the plan's scenario are in the order in which the plan passes them.
        self._scenario, self._planner, self._paper = paper.scenario, planner, paper
        self._progress, self._is_stopped = progress, is_stopped
        self._risk = risk
        self._least: Mapping[str, float] = {}
        self._reserved, self._hovering = 0.0, 0.0
        # The last flyable plan, and its margins.
        self._last: tuple[Plan, Mapping[str, float]] = (paper, {})
        self._in_turbulence = paper.scenario
        if self._in_turbulence.wind.turbulence is None:
            wind = self._in_turbulence.wind.model_copy(update={"turbulence": _USUAL_TURBULENCE})
            self._in_turbulence = self._in_turbulence.model_copy(update={"wind": wind})
        self._seed = _SEED - 1

    def is_beyond_the_controller(self) -> bool:
        """Return whether the controller is too weak for the allowed risk, whatever the margins.

        The result is True if two conditions hold. Flights along the plan without margins are
        predicted to miss the goal. Of simulated vehicles that hover at the goal in turbulence, at
        least the fraction `risk` miss it, too.
        """
        # Hovers are simulated only if flights along the plan without margins are predicted to miss
        # the goal. Such flights are expected to miss it at least as often as hovering vehicles.
        if not self._is_followed(self._begun):
            self._hovering = self._missed_by_hover
        return self._hovering >= self._risk

    @cached_property
    def _begun(self) -> _Tried:
        return self._tried(self._paper, {})

    def best(self) -> Plan:
        """Return a plan with margins that keeps the allowed risk, or else the plan of least risk.

        The risk is the probability that a flight in turbulence breaks any limit. The plan's
        attribute `risk` states the result of its test flights.
        """
        tried = self._settled(self._followed(self._begun))
        found: list[_Tested] = []
        # If flights miss the goal with any reserve, only a longer duration helps.
        is_free = self._scenario.mission.is_free
        is_hopeless = self._hovering > _TOO_MANY * self._risk or not (
            is_free or self._is_followed(tried)
        )
        last = 0 if is_hopeless else _CALIBRATIONS
        for k in range(last + 1):
            tested = self._examined(tried)
            found.append(tested)
            if k == last or self._has_passed(tested) or self._is_stopped():
                break
            grown = self._grown(tested)
            other = None if grown == tried.margins else self._planned(tested.tried, grown)
            if other is None:
                break
            tried = other
        best = min(found, key=lambda one: (one.share, one.tried.plan.energy))
        if self._has_passed(best):
            best = self._reduced(best, found[:-1])
        elif not best.tried.is_refined:
            best = self._tested(self._verified(best.tried), self._next_seed(), is_whole=True)
        if best.flown < _FLIGHTS:
            best = self._tested(best.tried, best.seed, is_whole=True)
        return self._stated(best.tried, best.counts, best.failed)

    def _examined(self, tried: _Tried) -> _Tested:
        """Test a plan by simulated flights, and test it again on a refined mesh if worthwhile.

        The second test is made if the mesh is not refined yet, and at most 200 * `risk` flights
        miss the goal.
        """
        tested = self._tested(tried, self._next_seed())
        missed = max(tested.counts[words] for words in (NOT_THERE, NOT_AT_REST))
        # A refinement takes longer than the test of another plan. If few flights miss the goal, the
        # coarse mesh may be the reason for the other broken limits.
        if tried.is_refined or missed > self._risk * _FLIGHTS:
            return tested
        return self._tested(self._verified(tried), self._next_seed())

    def _has_passed(self, tested: _Tested) -> bool:
        return tested.flown == _FLIGHTS and tested.failed <= self._risk * _FLIGHTS

    def _next_seed(self) -> int:
        self._seed += 1
        return self._seed

    def _reduced(self, best: _Tested, failed: list[_Tested]) -> _Tested:
        """Reduce margins that cost much energy, if test flights confirm it.

        `best` passed its test, and is the result if no cheaper plan passes. New margins are halfway
        to those of the last plan in `failed`, or halved if `failed` is empty.
        """
        low: Mapping[str, float] = failed[-1].tried.margins if failed else {}
        for _ in range(_REDUCTIONS):
            price = best.tried.plan.energy / self._paper.energy - 1.0
            is_wide = best.failed <= self._risk * _FLIGHTS / 2
            if price <= _FAIR_PRICE or not is_wide or self._is_stopped():
                break
            high = best.tried.margins
            # Halfway back to the margins of the last failed plan, or to no margins if none failed.
            middle = {name: (low.get(name, 0.0) + more) / 2 for name, more in high.items()}
            other = self._planned(best.tried, middle)
            tested = None if other is None else self._examined(other)
            if tested is None:
                break
            # Of several plans, one might pass the usual test by chance: half as many failures are
            # allowed.
            is_better = (
                self._has_passed(tested)
                and tested.failed <= self._risk * _FLIGHTS / 2
                and tested.tried.plan.is_flyable
                and tested.tried.plan.energy < best.tried.plan.energy
            )
            low, best = (low, tested) if is_better else (middle, best)
        return best

    def unfinished(self, why: str) -> Plan:
        """Return the last plan that simulation without turbulence confirmed.

        It is the result of a search that ended early, for the reason ``why``. The plan's record
        `risk` states this reason. The record counts no test flights, even if some were simulated.
        """
        plan, margins = self._last
        taken = RiskTaken(
            asked=self._risk,
            predicted=1.0,
            failed=0,
            flown=0,
            is_satisfied=False,
            margins=dict(margins),
            paper_energy_J=self._paper.energy,
            stopped=why,
        )
        return replace(plan, risk=taken)

    def _stated(self, tried: _Tried, counts: Counter[str], failed: int) -> Plan:
        """Return a plan with a record of its allowed risk, its margins and its test flights.

        `counts` maps names of limits to numbers of flights that broke them. `failed` is the number
        of flights that broke any limit.
        """
        is_satisfied = failed <= self._risk * _FLIGHTS
        limiting = tuple(word for word, _ in counts.most_common(3))
        taken = RiskTaken(
            asked=self._risk,
            predicted=tried.predicted,
            failed=failed,
            flown=_FLIGHTS,
            is_satisfied=is_satisfied,
            margins=dict(tried.margins),
            paper_energy_J=self._paper.energy,
            limiting=limiting,
            least=self._hovering,
            advice="" if is_satisfied else self._advice(tried, limiting),
            stopped=STOPPED if self._is_stopped() and not is_satisfied else "",
        )
        return replace(tried.plan, risk=taken)

    def _verified(self, tried: _Tried) -> _Tried:
        """Refine the mesh of a plan with margins, and return the new plan, checked by simulation.

        If the simulation confirms the new plan, it is stored for the method `unfinished`. A plan
        whose mesh is refined already is returned unchanged.
        """
        if tried.is_refined:
            return tried
        held = tightened(self._scenario, tried.margins)
        plan = _again(self._planner, tried.plan, held, self._progress, is_rough=False)
        if not plan.is_flyable:
            plan = self._planner.solve(held, progress=self._progress)
        owned = self._for_original_scenario(plan, tried.margins)
        if owned.is_flyable:
            self._last = owned, tried.margins
        return self._tried(owned, tried.margins)

    def _for_original_scenario(self, plan: Plan, margins: Mapping[str, float]) -> Plan:
        """Return a plan made with tightened limits as a plan of the original scenario.

        `margins` has the amounts of the tightening. The plan begins hovers early by the amount
        `HOLD` [s]; `passing_times_s` of the result states the required times.
        """
        times = passing_times(self._scenario, plan.passing_times_s, margins.get(HOLD, 0.0))
        return replace(plan, scenario=self._scenario, passing_times_s=times)

    def _tried(self, plan: Plan, margins: Mapping[str, float]) -> _Tried:
        flown = replace(plan, scenario=self._in_turbulence).mission_flown
        spread = spread_along(flown, plan, self._planner)
        near = tuple(limit_distances(spread, *_planned_at(plan, spread)))
        return _Tried(
            plan=plan, margins=margins, spread=spread, near=near, missed=missing(flown, spread)
        )

    def _planned(self, last: _Tried, margins: Mapping[str, float]) -> _Tried | None:
        """Solve the scenario with limits tightened by margins, with another plan as initial guess.

        `last` is the other plan. The result is None if the solve fails.
        """
        held = tightened(self._scenario, margins)
        if self._scenario.mission.aim is Aim.TIME:
            # The compiled problem of the last plan holds the least duration without margins. The
            # plan is therefore solved anew, with refinement of its mesh.
            plan = self._planner.solve(held, progress=self._progress)
        else:
            plan = _again(self._planner, last.plan, held, self._progress, is_rough=True)
        if plan.solution is None or not plan.solution.status.is_solved:
            return None
        own = self._tried(self._for_original_scenario(plan, margins), margins)
        return replace(own, is_refined=self._scenario.mission.aim is Aim.TIME)

    def _followed(self, tried: _Tried) -> _Tried:
        """Return a plan that leaves the controller enough thrust and tilt to follow it to the goal.

        The search starts from `tried`, and returns it if it leaves enough. Otherwise, the result is
        the cheapest such plan found, or that least likely to miss.
        """
        if self._is_followed(tried):
            return tried
        self._hovering = self._missed_by_hover
        found, failed, held = [(tried, 0.0)], -1, len(_RESERVES)
        chosen, step = _FIRST_RESERVE, 1
        while held - failed > 1 and not self._is_stopped():
            share = _RESERVES[chosen]
            other = self._planned(found[-1][0], self._reserve(share))
            if other is not None:
                found.append((other, share))
            if other is None or self._is_followed(other):
                held = chosen
            else:
                failed = chosen
            is_bracketed = held < len(_RESERVES)
            step *= 2
            ahead = min(failed + step, len(_RESERVES) - 1)
            chosen = (failed + held) // 2 if is_bracketed else ahead
        followed = [pair for pair in found if self._is_followed(pair[0])]
        key = _cost if followed else _missed_least
        # Later margins are never smaller than those with which the vehicle can follow its plan.
        best, self._reserved = min(followed or found, key=lambda pair: key(pair[0]))
        self._least = best.margins
        return best

    def _is_followed(self, tried: _Tried) -> bool:
        allowed = max(_SHARE_OF_GOAL * self._risk, _LIKE_A_HOVER * self._hovering)
        return tried.missing_places <= allowed and tried.astray <= _ASTRAY_M

    @cached_property
    def _missed_by_hover(self) -> float:
        """Fraction of hovering vehicles that gusts carry away from the goal, in a simulation."""
        mission = self._in_turbulence.mission
        there = mission.start.model_copy(
            update={"position": mission.goal.position, "yaw": mission.goal.yaw}
        )
        # The mission limits the distance from the goal and the speed at the end of a flight. A
        # vehicle that has just arrived is expected to break these limits at least as often as a
        # vehicle that has hovered.
        told = {"start": there, "waypoints": (), "duration": _HOVER_S}
        hover = self._in_turbulence.model_copy(update={"mission": mission.model_copy(update=told)})
        expected = as_expected(hover)
        place = (*mission.goal.position, mission.goal.yaw or 0.0)
        point = Setpoint(place=place, rate=(0.0,) * 4, acceleration=(0.0,) * 4)
        dynamics, draws = draw(self._planner, expected, _FLIGHTS, _SEED)
        simulation = EnsembleSimulation(
            expected, dynamics, lambda _: point, (*draws.noise, *draws.numbers)
        )
        endings = simulation.fly(draws.part(slice(0, _FIRST_FLIGHTS))).endings
        if not all(ending.has_arrived for ending in endings):
            endings = simulation.fly(draws).endings
        return sum(not ending.has_arrived for ending in endings) / len(endings)

    def _reserve(self, share: float) -> dict[str, float]:
        """Return margins with which a plan leaves a reserve of rotor speed, thrust and tilt.

        Each margin is ``share`` times the largest margin that leaves room for the mission.
        """
        mission = self._scenario.mission
        part = min(share, _LARGEST_OF_FREE) if mission.is_free else share
        # The controller needs the reserve to follow the plan in gusts.
        margins = {name: part * greatest_margin(self._scenario, name) for name in AUTHORITY}
        # A plan must stay within the largest tilt that the controller may command.
        for name, more in self._steeper_than_the_controller().items():
            margins[name] = max(margins[name], more)
        if mission.is_free:
            # A slower flight needs less thrust and tilt: the least duration gets a margin, too.
            least, greatest = mission.duration_limits
            longer = (1 + _LONGER * share) * self._paper.duration_s
            margins[DURATION] = max(min(longer, greatest) - least, 0.0)
        return margins

    def _steeper_than_the_controller(self) -> dict[str, float]:
        """Return by how much the scenario's limits on roll and pitch exceed the controller's [rad].

        The keys are "limits.roll_max" and "limits.pitch_max". The controller limits its tilt to
        `baseline.gains.tilt_max`; if this is None, the result is empty.
        """
        limits, most = self._scenario.limits, self._scenario.baseline.gains.tilt_max
        if most is None:
            return {}
        return {
            "limits.roll_max": limits.roll_max - most,
            "limits.pitch_max": limits.pitch_max - most,
        }

    def _settled(self, tried: _Tried) -> _Tried:
        """Solve repeatedly, with the margins that the last plan's covariance requires for the risk.

        The iteration starts from `tried`. It ends when these margins are close to those of the last
        plan, and after three solves at the latest. The result is the last plan.
        """
        for _ in range(_PLANS):
            # A plan with other margins has another covariance, and so requires other margins.
            wanted = self._margins(tried)
            if self._is_stopped() or self._agree(tried.margins, wanted):
                break
            other = self._planned(tried, wanted)
            # The new plan is rejected if its flights are predicted to miss the goal too often, and
            # those of the present plan are not. Test flights show later whether margins are large
            # enough.
            if other is None or (self._is_followed(tried) and not self._is_followed(other)):
                break
            tried = other
        return tried

    def _margins(self, tried: _Tried) -> dict[str, float]:
        """Return the margins that the allowed risk requires, from predicted statistics of flights.

        Implements docs/theory/risk.md, eq. (9).
        """
        held = tried.margins
        alone = {a: a.probability(held.get(a.field, 0.0), 0.0) for a in tried.near}
        # A limit that takes a hundredth of the risk needs no margin.
        least = 0.01 * self._risk
        pressed = [a for a, probability in alone.items() if probability > least]
        # Thrust at its limit would make the covariance wrong; a reserve already avoids that.
        reserved = set(KEPT_BY_CONTROLLER) & set(self._least)
        pressed = [a for a in pressed if a.field not in reserved]
        missed = [m for m in tried.missed if m.field and (m.field in held or m.probability > least)]
        taken = tried.missing_places
        taken += sum(
            p for a, p in alone.items() if p <= least and a.field not in KEPT_BY_CONTROLLER
        )
        # Each of the n other limits may be broken with the probability (r - p_goal - p_rare) / n.
        # Here r is the allowed risk, p_goal the probability of missing the goal, and p_rare that of
        # breaking a limit without margin.
        share = max(self._risk - taken, 0.1 * self._risk) / max(len(pressed) + len(missed), 1)
        margins = dict(self._least)
        for limit in pressed:
            most = greatest_margin(self._scenario, limit.field)
            needed = limit.margin_for(share, held.get(limit.field, 0.0), most)
            if needed > 0.0:
                margins[limit.field] = max(margins.get(limit.field, 0.0), needed)
        for miss in missed:
            more = miss.excess(share)
            if miss.field == HOLD:
                more = min(_EARLIER_S * (more > 0.0), _EARLIEST_S - held.get(HOLD, 0.0))
            wanted = held.get(miss.field, 0.0) + more
            margins[miss.field] = max(margins.get(miss.field, 0.0), wanted)
        return margins

    def _agree(self, kept: Mapping[str, float], wanted: Mapping[str, float]) -> bool:
        """Return whether the margins of a plan are close to those that the risk requires."""
        for name in {*kept, *wanted}:
            one, other = kept.get(name, 0.0), wanted.get(name, 0.0)
            table, _, key = name.partition(".")
            size = 0.0
            if table != "mission":
                size = abs(float(getattr(getattr(self._scenario, table), key)))
            if abs(one - other) > max(_AGREED * other, _AGREED_OF_LIMIT * size):
                return False
        return True

    def _tested(self, tried: _Tried, seed: int, *, is_whole: bool = False) -> _Tested:
        """Simulate test flights of a plan, and count the flights that break each limit.

        `seed` selects the random winds. Unless `is_whole`, the test ends after 50 of 200 flights if
        more than 200 * `risk` of them have failed.
        """
        first = slice(0, _FLIGHTS if is_whole else min(_FIRST_FLIGHTS, _FLIGHTS))
        broken = self._flown(tried, seed, first)
        if sum(map(bool, broken)) <= self._risk * _FLIGHTS and len(broken) < _FLIGHTS:
            broken += self._flown(tried, seed, slice(len(broken), _FLIGHTS))
        return _Tested(
            tried=tried,
            seed=seed,
            counts=Counter(word for words in broken for word in words),
            failed=sum(map(bool, broken)),
            flown=len(broken),
        )

    def _flown(
        self, tried: _Tried, seed: int, chosen: slice = slice(None)
    ) -> list[tuple[str, ...]]:
        """Simulate test flights of a plan in turbulence; return the limits that each flight breaks.

        The limits are given by their names in words. `seed` selects 200 random winds, and `chosen`
        those in which the plan is flown.
        """
        expected = as_expected(replace(tried.plan, scenario=self._in_turbulence).mission_flown)
        dynamics, draws = draw(self._planner, expected, _FLIGHTS, seed)
        path = reference_path(expected, Reference.PLAN, tried.plan)
        simulation = EnsembleSimulation(expected, dynamics, path, (*draws.noise, *draws.numbers))
        return [tuple(ending.broken) for ending in simulation.fly(draws.part(chosen)).endings]

    def _grown(self, tested: _Tested) -> dict[str, float]:
        """Return all margins, larger for the limits that test flights break too often.

        The result maps scenario fields to amounts. If such a limit has no margin, or already the
        largest possible one, the margins of the reserve grow instead.
        """
        tried, counts = tested.tried, tested.counts
        allowed = self._risk * tested.flown / max(len(counts), 1)
        fields: dict[str, int] = {}
        missed = 0
        for word, count in counts.items():
            if count > allowed:
                own = {a.field for a in tried.near if limit_words(a.name) == word}
                own |= {miss.field for miss in tried.missed if miss.words == word and miss.field}
                fields |= {name: max(fields.get(name, 0), count) for name in own}
                missed = max(missed, 0 if own else count)
        margins = dict(tried.margins)
        if HOLD in fields:
            margins[HOLD] = min(margins.get(HOLD, 0.0) + _EARLIER_S, _EARLIEST_S)
        for name in fields.keys() - {HOLD}:
            spreads = [float(a.deviation.max()) for a in tried.near if a.field == name]
            held = margins.get(name, 0.0)
            grown = max(_GROWTH * held, held + max(spreads, default=0.0) / 2)
            if name in {miss.field for miss in tried.missed}:
                margins[name] = max(grown, held + self._step_at_waypoints(name))
            else:
                margins[name] = min(grown, greatest_margin(self._scenario, name))
        # Some limits have no margin, such as the limit on the distance from the goal at the end.
        # Such a limit, and one whose margin cannot grow, is broken less often by a plan that is
        # easier to follow in gusts. All later plans keep the larger reserve.
        exhausted = [n for n in fields if margins[n] <= tried.margins.get(n, 0.0)]
        missed = max([missed, *(fields[name] for name in exhausted)])
        if missed:
            by_share = _RESERVE_PER_MISS * missed / tested.flown
            step = min(max(by_share, _LEAST_STEP), _LARGEST_STEP)
            largest = _LARGEST_FREE if self._scenario.mission.is_free else _RESERVES[-1]
            self._reserved = min(self._reserved + step, largest)
            self._least = self._reserve(self._reserved)
            for name, margin in self._least.items():
                margins[name] = max(margins.get(name, 0.0), margin)
        return margins

    def _step_at_waypoints(self, name: str) -> float:
        """Return the smallest step by which a margin at waypoints grows after a test [m or m/s].

        `name` is the field of the margin: "mission.radius" or "mission.speed_max". The step is 20 %
        of the smallest radius, or speed limit, of the waypoints.
        """
        # The predicted covariance is too small for vehicles whose thrust is at its limit.
        waypoints, key = self._scenario.mission.waypoints, name.partition(".")[2]
        return _SHARE_OF_PLACE * min(size for w in waypoints if (size := getattr(w, key)))

    def _advice(self, tried: _Tried, limiting: tuple[str, ...]) -> str:
        """Return advice to the user on how to change the mission so that flights keep its limits.

        It concerns the first limit in `limiting`, which test flights of the plan `tried` broke most
        often.
        """
        first = limiting[0] if limiting else ""
        if first.startswith(("keep-out", "floor", "ceiling")):
            return "start, waypoints and goal farther from it, or a lower limits.speed_max"
        if "waypoint" in first:
            return "a larger radius of the waypoint, or a later time to pass it"
        longer = "" if self._scenario.mission.is_free else "a longer mission.duration, or "
        return f"{longer}{self._weaker(tried)}"

    def _weaker(self, tried: _Tried) -> str:
        """Return advice to the user: the strongest turbulence in which few flights miss the goal.

        Few are at most 30 % of the failures that the allowed risk permits. The misses are predicted
        from the statistics in `tried`.
        """
        allowed = _SHARE_OF_GOAL * self._risk
        places = [miss for miss in tried.missed if not miss.field]
        low, high = 0.0, 1.0
        for _ in range(_HALVINGS):
            middle = (low + high) / 2
            missed = sum(miss.shrunk(middle).probability for miss in places)
            low, high = (middle, high) if missed <= allowed else (low, middle)
        turbulence = self._in_turbulence.wind.turbulence
        strength = 0.0 if turbulence is None else turbulence.strength
        if high == 1.0:
            return "weaker turbulence"
        found = (
            f"wind.turbulence.wind_at_6_m of about {low * strength:.2g} m/s instead of "
            f"{strength:.3g} m/s, and stated errors smaller by the same factor"
        )
        if self._scenario.wind.coupling is WindCoupling.ACCELERATION:
            found += (
                ', or wind.coupling = "drag": as "acceleration" a gust pushes at '
                f"{self._scenario.wind.acceleration_coefficient:g} m/s² for each m/s"
            )
        return found


# Bisection steps of the strength of turbulence: to a thousandth.
_HALVINGS = 10


def _cost(tried: _Tried) -> float:
    return tried.plan.cost


def _missed_least(tried: _Tried) -> tuple[float, float]:
    return tried.missing_places, tried.astray


def _planned_at(plan: Plan, spread: Spread) -> tuple[FloatArray, FloatArray]:
    """Return planned states and controls at the n times for which a covariance was computed.

    States that the plan lacks, such as those of the turbulence, are zero.
    """
    held, dynamics = plan.trajectories, spread.dynamics
    names = list(held.state_names)
    known = held.states_at(spread.t)
    states = np.zeros_like(spread.states)
    for column, name in enumerate(dynamics.state_names):
        if name in names:
            states[:, column] = known[:, names.index(name)]
    limits = dynamics.control_limits(HELD_BREACH)
    return states, held.controls_at(spread.t, limits)
