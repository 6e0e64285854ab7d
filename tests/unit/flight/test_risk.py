"""Plans with a stated risk: probabilities against simulation, and margins against flights."""

import re
from collections import Counter
from contextlib import nullcontext
from dataclasses import replace
from functools import cache
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.special import ndtri

from pyomo_quad.cli.endings import ExitCode
from pyomo_quad.cli.solving import complain_about, exit_code_of
from pyomo_quad.flight import Plan, PlanStatus, margin_search
from pyomo_quad.flight.breaching import LimitDistance, Miss, _crossing
from pyomo_quad.flight.deadline import TimeIsUpError
from pyomo_quad.flight.limit_words import limit_words
from pyomo_quad.flight.margins import (
    AUTHORITY,
    DURATION,
    HOLD,
    RADIUS,
    SPEED,
    RiskTaken,
    greatest_margin,
    passing_times,
    tightened,
)
from pyomo_quad.flight.risk import plan_at_risk, risk_asked
from pyomo_quad.model import build_model
from pyomo_quad.scenario.tables import FASTER_GAINS
from tests.declared_model import scenario
from tests.flights import PLANNER

POST = {"name": "post", "shape": "cylinder", "centre": [3.0, 0.3], "radius": 0.6}
POST |= {"bottom": 0.0, "top": 30.0}


@cache
def mission(**more):
    return scenario(
        vehicle={"drag_linear": 0.3, "attitude": "euler"},
        wind={"use": "calm", "coupling": "drag", "turbulence": {"intensity": "light"}},
        mission={
            "start": {"position": [0.0, 0.0, 10.0]},
            "goal": {"position": [6.0, 0.0, 10.0]},
            "duration": 8.0,
        }
        | more,
        airspace={"keep_out": [POST]},
        solver={"tolerance": 1e-4},
    )


def search_from(paper):
    return margin_search.MarginSearch(paper, PLANNER, risk_asked(paper.scenario))


def smooth_process(paths, steps, h=0.02, rate=3.0):
    """Two lags in a row, in the long run at the start, over its standard deviation."""
    random = np.random.default_rng(5)
    first = np.sqrt(0.5) * random.standard_normal(paths)
    second = first / 2 + np.sqrt(1 / 8) * random.standard_normal(paths)
    decay, found = np.exp(-rate * h), []
    for _ in range(steps):
        found.append(2 * second)
        before = first
        kick = np.sqrt((1 - decay**2) / 2) * random.standard_normal(paths)
        first = decay * first + kick
        second = decay * second + (1 - decay) * (before + first) / 2
    return np.array(found)


@pytest.mark.lengthy
@pytest.mark.parametrize("beyond", [2.0, 3.0])
def test_the_probability_of_a_breach_bounds_that_of_simulated_flights_closely(beyond):
    flown = smooth_process(40_000, 250)
    seen = (flown > beyond).any(axis=0).mean()
    correlation = np.array([np.corrcoef(a, b)[0, 1] for a, b in pairwise(flown)])
    deviation = flown.std(axis=1)
    bound = _crossing(np.full(250, beyond), deviation, correlation)
    assert seen <= bound <= 1.5 * seen


def test_the_probability_of_passing_a_limit_once_bounds_that_of_simulated_flights_closely():
    """The mean comes near the limit and leaves it again, as past a corner of a zone."""
    flown = smooth_process(40_000, 250)
    correlation = np.array([np.corrcoef(a, b)[0, 1] for a, b in pairwise(flown)])
    room = 1.5 + 40.0 * np.linspace(-1.0, 1.0, 250) ** 2
    seen = (flown > room[:, None]).any(axis=0).mean()
    bound = _crossing(room, flown.std(axis=1), correlation)
    assert seen <= bound <= 1.5 * seen


def test_a_margin_is_the_least_that_keeps_its_share():
    n = 200
    near = LimitDistance(
        name="airspace.ceiling_limit",
        field="airspace.ceiling",
        distance=np.linspace(1.0, -0.01, n),
        planned=np.linspace(1.0, 0.0, n),
        deviation=np.full(n, 0.05),
        correlation=np.full(n - 1, 0.999),
    )
    margin = near.margin_for(1e-3, 0.0, 1.0)
    assert near.probability(0.0, margin) == pytest.approx(1e-3, rel=1e-3)
    assert near.probability(0.0, 0.99 * margin) > 1e-3
    assert near.margin_for(1e-3, 0.0, margin / 2) == pytest.approx(margin / 2)


def test_margins_move_every_limit_inwards():
    told = scenario(
        airspace={
            "floor": 0.0,
            "ceiling": 20.0,
            "clearance": 0.5,
            "keep_out": [{"name": "ball", "shape": "sphere", "centre": [3, 9, 5], "radius": 1}],
        },
        mission={
            "start": {"position": [0.0, 0.0, 2.0]},
            "goal": {"position": [6.0, 0.0, 2.0]},
            "duration": 10.0,
            "waypoints": [{"position": [3.0, 0.0, 4.0], "hold": 1.0, "at": 5.0}],
        },
    )
    margins = {
        "limits.pitch_max": 0.1,
        "airspace.floor": 0.2,
        "airspace.ceiling": 0.3,
        "airspace.clearance": 0.4,
        HOLD: 0.5,
    }
    held = tightened(told, margins)
    assert held.limits.pitch_max == pytest.approx(told.limits.pitch_max - 0.1)
    assert (held.airspace.floor, held.airspace.ceiling) == pytest.approx((0.2, 19.7))
    assert held.airspace.clearance == pytest.approx(0.9)
    (waypoint,) = held.mission.waypoints
    assert (waypoint.at, waypoint.hold) == pytest.approx((4.5, 1.5))
    assert passing_times(told, (4.5,), 0.5) == pytest.approx((5.0,))
    assert greatest_margin(told, "airspace.floor") < 2.0
    assert greatest_margin(told, "airspace.ceiling") < 16.0


def test_margins_narrow_waypoints_and_lengthen_a_free_duration():
    near = {"position": [3.0, 4.0, 9.0], "radius": 0.5, "speed_max": 2.0}
    told = mission.__wrapped__(duration="free", duration_min=4.0, waypoints=[near])
    held = tightened(told, {RADIUS: 0.2, SPEED: 0.3, DURATION: 1.5})
    (waypoint,) = held.mission.waypoints
    assert (waypoint.radius, waypoint.speed_max) == pytest.approx((0.3, 1.7))
    assert held.mission.duration_min == pytest.approx(5.5)
    (waypoint,) = tightened(told, {RADIUS: 9.0, SPEED: 9.0}).mission.waypoints
    assert 0.0 < waypoint.radius < 0.1
    assert 0.0 < waypoint.speed_max < 1.0


def test_the_excess_of_a_miss_is_what_must_be_nearer_for_its_probability():
    off = np.abs(np.random.default_rng(3).standard_normal((2, 20_000)))
    miss = Miss(words="distance from waypoint 1", field=RADIUS, off=off, within=1.0)
    excess = miss.excess(0.02)
    nearer = Miss(words=miss.words, field=RADIUS, off=off - excess, within=1.0)
    assert miss.probability > 0.3
    assert 0.018 < nearer.probability < 0.0201
    assert Miss(words="", field="", off=off, within=9.0).excess(0.02) == 0.0


def taken(**found):
    known = {"asked": 0.01, "predicted": 0.2, "failed": 31, "flown": 200, "is_satisfied": False}
    return RiskTaken(**known | {"paper_energy_J": 400.0} | found)


def test_a_risk_that_cannot_be_had_says_how_much_limits_it_and_what_would_help():
    said = taken(limiting=("speed at the end", "floor"), advice="weaker turbulence").words(410.0)
    assert said == (
        "A risk of 0.01 cannot be reached: with the plan of least risk, 31 of 200 test flights, "
        "which planning did not use, broke a limit, most often speed at the end; possible "
        "remedies: weaker turbulence; the margins cost 10 J (2.5 %)."
    )


def test_a_risk_that_gusts_alone_exceed_is_answered_by_that():
    said = taken(least=0.44, advice="weaker turbulence").words(410.0)
    assert "gusts carry 44 % of vehicles that only hover at the goal farther off" in said
    assert "with this plan, 31 of 200" in said


def test_a_search_that_was_stopped_does_not_say_that_the_risk_cannot_be_had():
    said = taken(stopped="the search was stopped").words(410.0)
    assert said.startswith("A risk of 0.01 is not reached: the search was stopped; 31 of 200")
    said = taken(flown=0, failed=0, stopped="given up after solver.time_limit = 9 s").words(400.0)
    assert said.startswith("No flight confirms a risk of 0.01: given up after solver.time_limit")


@pytest.mark.parametrize("status", [PlanStatus.VERIFIED, PlanStatus.USABLE])
def test_a_plan_without_the_risk_asked_for_has_a_status_of_its_own(status, capsys, tmp_path):
    plan = SimpleNamespace(
        scenario=mission(risk=0.01),
        status=status,
        is_verified=status is PlanStatus.VERIFIED,
        is_flyable=True,
        failure=None,
        message="stopped",
        risk=taken(advice="weaker turbulence"),
        risk_words="A risk of 0.01 cannot be reached",
    )
    assert exit_code_of(plan) == ExitCode.RISK_NOT_HAD
    complain_about(plan, tmp_path, ())
    assert "A risk of 0.01 cannot be reached" in capsys.readouterr().err
    # Nobody asked for the risk of a free duration.
    plan.scenario = mission(duration="free")
    assert exit_code_of(plan) == ExitCode.VERIFIED
    plan.scenario, plan.risk = mission(risk=0.01), taken(is_satisfied=True)
    assert exit_code_of(plan) == ExitCode.VERIFIED


@cache
def paper_plan():
    return PLANNER.solve(mission(risk=0.01))


def planner_of(builder=build_model, is_stopped=False):
    return SimpleNamespace(
        builder=builder,
        solve=lambda *_, **__: replace(paper_plan(), status=PlanStatus.USABLE),
        until_stopped=lambda: nullcontext(lambda: is_stopped),
    )


@pytest.mark.lengthy
def test_a_usable_plan_without_time_for_margins_says_so(monkeypatch):
    """Time ends while the first plan's flight without gusts is flown."""

    def give_up(*_):
        raise TimeIsUpError("given up after solver.time_limit = 9 s; allow more time.")

    monkeypatch.setattr(margin_search, "spread_along", give_up)
    plan = plan_at_risk(mission(risk=0.01), planner_of())
    assert plan.status is PlanStatus.USABLE
    assert not plan.risk.is_satisfied
    assert "No flight confirms a risk of 0.01: given up after" in plan.risk_words


def test_no_risk_is_looked_for_once_the_user_has_stopped_nor_in_a_model_of_ones_own():
    told, own = mission(risk=0.01), planner_of(lambda _: None)
    assert "No flight confirms a risk of 0.01: margins are" in plan_at_risk(told, own).risk_words
    assert plan_at_risk(mission(duration="free"), own).risk is None
    stopped = plan_at_risk(told, planner_of(is_stopped=True))
    assert stopped.risk.stopped == "the search was stopped"


@pytest.mark.parametrize("coupling", ["drag", "acceleration"])
def test_the_weaker_turbulence_advised_is_that_in_which_the_goal_is_met(coupling):
    """Of a normal distribution in one direction: quantiles tell by how much it must shrink."""
    told = mission(risk=0.1).with_values({"wind.coupling": coupling})
    off = np.abs(np.random.default_rng(3).standard_normal((1, 200_000)))
    within = 0.1
    missed = (Miss(words="speed at the end", field="", off=off, within=within),)
    search = search_from(SimpleNamespace(scenario=told))
    said = search._weaker(SimpleNamespace(missed=missed))
    # Three tenths of the risk are left to the goal.
    shrunk = within / ndtri(1 - 0.03 / 2)
    strength = told.wind.turbulence.strength
    found = float(re.search(r"of about (\S+) m/s instead of", said)[1])
    assert found == pytest.approx(shrunk * strength, rel=0.05)
    assert ("wind.coupling" in said) is (coupling == "acceleration")


@pytest.mark.slow
def test_a_free_duration_takes_the_reserve_that_its_flights_need_to_arrive():
    told = mission(duration="free", risk=0.05).with_values({"airspace.keep_out": ()})
    paper = PLANNER.solve(told)
    search = search_from(paper)
    assert sum(1 for words in search._flown(search._tried(paper, {}), 7) if words) > 30
    plan = plan_at_risk(told, PLANNER)
    assert plan.is_verified
    assert plan.risk.is_satisfied
    assert plan.duration_s > paper.duration_s
    assert plan.risk.margins["limits.rotor_speed_max"] > 0.0


@cache
def plans():
    paper = plan_at_risk(mission(risk=1.0), PLANNER)
    held = plan_at_risk(mission(risk=0.05), PLANNER)
    return paper, held


@pytest.fixture(autouse=True)
def _few_flights(monkeypatch):
    monkeypatch.setattr(margin_search, "_FLIGHTS", 60)


@pytest.mark.slow
def test_a_plan_with_a_risk_leaves_the_margin_that_its_flights_need(tmp_path):
    paper, held = plans()
    assert paper.risk is None
    assert "No margins" in paper.risk_words
    assert held.is_verified
    taken = held.risk
    assert taken.is_satisfied
    assert taken.predicted <= 0.06
    margin = taken.margins["airspace.clearance"]
    nearest = []
    for plan in (paper, held):
        places = plan.to_frame(100.0)[["x_m", "y_m"]].to_numpy()
        nearest.append(np.linalg.norm(places - POST["centre"], axis=1).min())
    assert nearest[0] == pytest.approx(0.6, abs=2e-3)
    assert nearest[1] >= 0.6 + margin - 2e-3
    joules, percent = taken.price(held.energy)
    assert joules == pytest.approx(held.energy - paper.energy, abs=1e-2)
    assert 0.0 < percent < 5.0
    assert "Risk at most 0.05" in held.risk_words
    held.save(tmp_path / "plan.npz")
    assert Plan.load(tmp_path / "plan.npz").risk == taken


@pytest.mark.parametrize(
    ("failing", "flown", "whole"),
    [((), 200, 200), ((3, 120), 200, 200), ((3, 7, 9), 50, 200), ((60, 61, 62), 200, 200)],
)
def test_a_test_ends_with_the_first_flights_where_they_fail_it(monkeypatch, failing, flown, whole):
    """Two of 200 flights may break a limit at a risk of 0.01."""
    monkeypatch.setattr(margin_search, "_FLIGHTS", 200)
    broken = [("floor",) if k in failing else () for k in range(200)]
    search = search_from(SimpleNamespace(scenario=mission(risk=0.01)))
    monkeypatch.setattr(search, "_flown", lambda _tried, _seed, chosen: broken[chosen])
    found = search._tested(None, 7)
    assert (found.failed, found.flown) == (len(failing), flown)
    again = search._tested(None, 7, is_whole=True)
    assert (again.counts["floor"], again.flown) == (len(failing), whole)


def judged(tried, counts):
    return margin_search._Tested(tried=tried, seed=7, counts=Counter(counts), failed=9, flown=200)


def test_margins_grow_where_test_flights_break_limits_and_the_reserve_where_they_miss_the_goal():
    told = mission.__wrapped__(duration="free", duration_min=4.0, risk=0.01)
    search = search_from(SimpleNamespace(scenario=told, duration_s=10.0))
    held = dict.fromkeys(AUTHORITY, 0.05) | {DURATION: 6.0}
    at_roll = SimpleNamespace(
        name="limits.roll", field="limits.roll_max", deviation=np.array([0.01, 0.06])
    )
    tried = SimpleNamespace(margins=held, near=[at_roll], missed=[])
    steeper = search._grown(judged(tried, {limit_words(at_roll.name): 7}))
    assert steeper == pytest.approx(held | {"limits.roll_max": 0.08})
    assert search._grown(judged(tried, {"distance from the goal at the end": 2})) == held
    missed = {"distance from the goal at the end": 30}
    grown = search._grown(judged(tried, missed))
    # A reserve of 0.1 of the four fifths of thrust beyond the weight.
    spare = told.limits.thrust_max - told.vehicle.total_mass * told.gravity
    assert grown["limits.thrust_max"] == pytest.approx(max(0.1 * 0.8 * spare, 0.05))
    assert grown[DURATION] == pytest.approx(1.075 * 10.0 - 4.0)
    again = search._grown(judged(SimpleNamespace(margins=grown, near=[], missed=[]), missed))
    assert again[DURATION] == pytest.approx(1.15 * 10.0 - 4.0)


def test_the_margin_of_a_waypoint_grows_by_a_part_of_its_radius_and_a_used_up_margin_as_a_reserve():
    ring = {"position": [3.0, 2.0, 10.0], "radius": 0.5}
    told = mission.__wrapped__(duration="free", duration_min=4.0, risk=0.01, waypoints=[ring])
    search = search_from(SimpleNamespace(scenario=told, duration_s=10.0))
    past = SimpleNamespace(field=RADIUS, words="distance from waypoint 1")
    tried = SimpleNamespace(margins={}, near=[], missed=[past])
    assert search._grown(judged(tried, {past.words: 30})) == pytest.approx({RADIUS: 0.1})
    # A vehicle that starts 2 cm above the floor has no room for a margin.
    low = told.with_values({"airspace.floor": 9.98})
    search = search_from(SimpleNamespace(scenario=low, duration_s=10.0))
    most = greatest_margin(low, "airspace.floor")
    at_floor = SimpleNamespace(
        name="airspace.floor_limit", field="airspace.floor", deviation=np.array([0.3])
    )
    tried = SimpleNamespace(margins={"airspace.floor": most}, near=[at_floor], missed=[])
    grown = search._grown(judged(tried, {limit_words(at_floor.name): 30}))
    assert grown["airspace.floor"] == most
    assert grown["limits.thrust_max"] > 0.0


def test_a_plan_that_flights_follow_is_not_replaced_by_one_that_they_do_not(monkeypatch):
    search = search_from(SimpleNamespace(scenario=mission(risk=0.01)))

    def planned(_, margins):
        return SimpleNamespace(margins=margins)

    def wanted(tried):
        return {RADIUS: tried.margins[RADIUS] + 1.0}

    monkeypatch.setattr(search, "_margins", wanted)
    monkeypatch.setattr(search, "_planned", planned)
    monkeypatch.setattr(search, "_is_followed", lambda tried: tried.margins[RADIUS] < 2.5)
    assert search._settled(planned(None, {RADIUS: 1.0})).margins == {RADIUS: 2.0}


@pytest.mark.parametrize("is_stated", [False, True])
def test_the_gains_change_only_where_flights_need_it_and_the_user_states_none(
    is_stated, monkeypatch
):
    """Flights with the default gains fail ten times, with the faster ones once."""
    searched = []

    def best(search):
        gains = search._scenario.baseline.gains
        searched.append(gains)
        failed = 1 if gains == FASTER_GAINS else 10
        return replace(
            search._paper, risk=taken(failed=failed, is_satisfied=failed < 2, limiting=())
        )

    monkeypatch.setattr(margin_search.MarginSearch, "best", best)
    told = mission(risk=0.01)
    if is_stated:
        told = told.with_values({"baseline.gains.position": 1.4})
    planner = planner_of()
    planner.solve = lambda *_, **__: replace(paper_plan(), scenario=told)
    monkeypatch.setattr(
        margin_search.MarginSearch, "is_beyond_the_controller", lambda search: False
    )
    plan = plan_at_risk(told, planner)
    assert searched == [told.baseline.gains, *([] if is_stated else [FASTER_GAINS])]
    assert plan.risk.is_satisfied is not is_stated
    assert plan.scenario.baseline.gains == searched[-1]
    assert ("baseline.gains = { position = 2, " in plan.risk_words) is not is_stated
    # Vehicles that cannot even hover with the default gains: no margin is searched for with them.
    searched.clear()
    monkeypatch.setattr(margin_search.MarginSearch, "is_beyond_the_controller", lambda search: True)
    plan_at_risk(told, planner)
    assert searched == [told.baseline.gains if is_stated else FASTER_GAINS]


@pytest.mark.slow
def test_faster_gains_hold_vehicles_in_gusts_that_the_default_gains_do_not():
    """A Phantom 2 that hovers in moderate turbulence, with either gains."""
    told = mission(risk=0.01).with_values(
        {
            "vehicle.drag_linear": 0.43,
            "wind.use": "constant",
            "wind.speed": 4.5,
            "wind.turbulence.intensity": "moderate",
        }
    )
    missed = [
        search_from(SimpleNamespace(scenario=told.with_values(gains)))._missed_by_hover
        for gains in ({}, {"baseline.gains": FASTER_GAINS})
    ]
    assert missed[0] > 0.02
    assert missed[1] < missed[0] / 3


def distance(name, field, deviation=0.02):
    n = 100
    return LimitDistance(
        name=name,
        field=field,
        distance=np.full(n, 0.03),
        planned=np.full(n, 0.03),
        deviation=np.full(n, deviation),
        correlation=np.full(n - 1, 0.99),
    )


def test_tilt_gets_the_margin_of_its_covariance_beside_a_reserve_and_thrust_the_reserve():
    """Feedback cannot exceed the limits of thrust and rotor speed: it commands within them."""
    told = mission(risk=0.01)
    search = search_from(SimpleNamespace(scenario=told))
    search._least = {"limits.roll_max": 0.001, "limits.thrust_max": 0.02}
    roll = distance("limits.roll_limit", "limits.roll_max")
    thrust = distance("limits.thrust_limit", "limits.thrust_max")
    tried = margin_search._Tried(
        plan=None, margins=search._least, spread=None, near=(roll, thrust), missed=()
    )
    margins = search._margins(tried)
    assert margins["limits.thrust_max"] == 0.02
    shifted = replace(roll, distance=np.full(100, margins["limits.roll_max"]))
    assert shifted.present_probability == pytest.approx(0.01, rel=1e-3)
    assert tried.predicted == pytest.approx(roll.present_probability)


@pytest.mark.lengthy
@pytest.mark.parametrize("needed", [*margin_search._RESERVES, 0.9])
def test_the_reserve_found_is_the_least_with_which_flights_follow_the_plan(needed, monkeypatch):
    told = mission(risk=0.01)
    search = search_from(SimpleNamespace(scenario=told))

    def tried_with(share):
        return SimpleNamespace(
            margins={"share": share},
            plan=SimpleNamespace(cost=share),
            missing_places=0.0 if share >= needed else 1.0 - share,
            astray=0.0,
        )

    monkeypatch.setattr(search, "_missed_by_hover", 0.0)
    monkeypatch.setattr(search, "_reserve", lambda share: share)
    monkeypatch.setattr(search, "_planned", lambda _, share: tried_with(share))
    best = search._followed(tried_with(0.0))
    assert best.margins["share"] == min(needed, margin_search._RESERVES[-1])
    assert search._reserved == best.margins["share"]


@pytest.mark.parametrize(
    ("failing", "word", "is_verified"),
    [(0, "", True), (9, "speed at the end", False), (50, "keep-out church", True)],
)
def test_a_plan_is_verified_only_if_its_flights_meet_the_goal(
    monkeypatch, failing, word, is_verified
):
    """A coarse mesh lets a path cut the corner of a zone, but hardly changes how flights end."""
    monkeypatch.setattr(margin_search, "_FLIGHTS", 200)
    search = search_from(SimpleNamespace(scenario=mission(risk=0.01)))
    broken = [(word,)] * failing + [()] * (200 - failing)
    monkeypatch.setattr(search, "_flown", lambda _tried, _seed, chosen: broken[chosen])
    monkeypatch.setattr(search, "_verified", lambda _: SimpleNamespace(is_refined=True))
    found = search._examined(SimpleNamespace(is_refined=False))
    assert found.tried.is_refined is is_verified


@pytest.mark.parametrize(("failed", "energy"), [(0, 105.0), (1, 105.0), (2, 110.0), (50, 110.0)])
def test_costly_margins_shrink_if_the_plan_with_smaller_ones_breaks_few_limits(
    monkeypatch, failed, energy
):
    monkeypatch.setattr(margin_search, "_FLIGHTS", 200)
    paper = SimpleNamespace(scenario=mission(risk=0.01), energy=100.0)
    search = search_from(paper)

    def tested_with(margin, broken):
        plan = SimpleNamespace(energy=100.0 + 10.0 * margin, is_flyable=True)
        tried = SimpleNamespace(margins={"airspace.clearance": margin}, plan=plan)
        return margin_search._Tested(
            tried=tried, seed=1, counts=Counter(), failed=broken, flown=200
        )

    monkeypatch.setattr(search, "_planned", lambda _, margins: margins["airspace.clearance"])
    monkeypatch.setattr(search, "_examined", lambda margin: tested_with(margin, failed))
    assert search._reduced(tested_with(1.0, 0), []).tried.plan.energy == energy
    # A cheap plan, or one that barely passed, stays.
    assert search._reduced(tested_with(0.1, 0), []).tried.plan.energy == 101.0
    assert search._reduced(tested_with(1.0, 2), []).tried.plan.energy == 110.0


@pytest.mark.slow
def test_flights_of_a_plan_miss_the_goal_no_more_seldom_than_vehicles_that_hover_there():
    """Turbulence as an acceleration carries hovering vehicles off; as drag it does not."""
    shares = {}
    for coupling in ("drag", "acceleration"):
        told = mission(risk=0.01).with_values({"wind.coupling": coupling, "airspace.keep_out": ()})
        paper = PLANNER.solve(told)
        search = search_from(paper)
        flown = search._flown(search._tried(paper, {}), 7)
        missed = sum(any(word.endswith("at the end") for word in words) for words in flown)
        shares[coupling] = search._missed_by_hover, missed / len(flown)
    assert shares["drag"][0] == 0.0
    assert 0.2 < shares["acceleration"][0] <= shares["acceleration"][1] + 0.1


@pytest.mark.slow
def test_flights_of_the_paper_plan_break_the_limit_that_it_flies_at():
    paper, held = plans()
    search = search_from(paper)
    broken = [search._flown(search._tried(plan, {}), 77) for plan in (paper, held)]
    shares = [sum(1 for words in flights if words) / 60 for flights in broken]
    assert shares[0] > 0.3
    assert shares[1] < 0.15


def test_a_free_duration_asks_for_a_risk_unless_it_is_the_papers():
    assert risk_asked(mission()) == 1.0
    free = mission(duration="free")
    assert risk_asked(free) == 0.01
    assert risk_asked(free.with_values({"mission.risk": 1.0})) == 1.0
    assert risk_asked(free.with_values({"vehicle.attitude": "paper"})) == 1.0
    assert risk_asked(mission(risk=0.2)) == 0.2


@pytest.mark.slow
def test_a_risk_that_cannot_be_had_is_answered_by_what_limits_it():
    told = mission(risk=0.001).with_values({"wind.turbulence.intensity": "severe"})
    plan = plan_at_risk(told, PLANNER)
    assert not plan.risk.is_satisfied
    assert plan.risk.limiting
    assert "cannot be reached" in plan.risk_words
    assert plan.risk.advice in plan.risk_words
