"""Shares of flights with their intervals, and what a plan spares in the same winds."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import binom

from pyomo_quad.flight.routes import SETTLINGS_S, cruise_at
from pyomo_quad.report.ensemble import _beside
from pyomo_quad.report.gallery import drawings_of_run
from pyomo_quad.report.tables import run_summary
from pyomo_quad.scenario.tables import CruiseSettings
from pyomo_quad.study import ensemble
from pyomo_quad.study.ensemble import (
    CONFIDENCE,
    InTurbulence,
    Saving,
    Share,
    fly_cruise_often,
    fly_in_turbulence,
    fly_plan_often,
)
from pyomo_quad.study.headline import headline_of
from pyomo_quad.study.run import run_scenario
from tests import flights
from tests.command import QUICK

HOP = (
    *(option.removeprefix("--set=") for option in QUICK),
    'wind.coupling="drag"',
    'wind.turbulence.intensity="light"',
)


@pytest.mark.parametrize(("count", "of"), [(1, 12), (7, 12), (990, 1000), (3, 1000)])
def test_the_interval_is_where_the_binomial_tails_are_half_of_the_rest(count, of):
    low, high = Share(count, of).interval
    rest = 0.5 * (1 - CONFIDENCE)
    assert binom.sf(count - 1, of, low) == pytest.approx(rest, rel=1e-9)
    assert binom.cdf(count, of, high) == pytest.approx(rest, rel=1e-9)


def test_no_or_all_flights_have_an_interval_of_one_side():
    rest = 0.5 * (1 - CONFIDENCE)
    assert Share(0, 50).interval == (0.0, pytest.approx(1 - rest ** (1 / 50)))
    assert Share(50, 50).interval == (pytest.approx(rest ** (1 / 50)), 1.0)
    assert str(Share(50, 50)) == "100.0 % (92.9 to 100.0 %)"


def often(count, seed):
    plan = flights.plan("paper_calm", *HOP)
    return fly_plan_often(
        plan.mission_flown, plan.trajectories, planner=flights.PLANNER, flights=count, seed=seed
    )


@pytest.mark.lengthy
def test_a_seed_gives_the_same_winds_whatever_the_count():
    few, many, other = often(3, 1), often(6, 1), often(3, 2)
    assert many.of_flights("energy_J")[:3] == pytest.approx(few.of_flights("energy_J"), rel=1e-12)
    assert np.unique([*many.of_flights("energy_J"), *other.of_flights("energy_J")]).size == 9
    assert many.table()["flight"].tolist() == [1, 2, 3, 4, 5, 6]
    assert many.bands().iloc[-1]["energy_J_50_percent"] == pytest.approx(many.band("energy_J")[1])


@pytest.mark.lengthy
def test_errors_of_the_mass_are_drawn_with_their_deviation():
    heavy = ("vehicle.mass_deviation=0.05", "vehicle.mass=1.3")
    plan = flights.plan("paper_calm", *HOP[:-1], *heavy)
    flown = fly_plan_often(
        plan.mission_flown, plan.trajectories, planner=flights.PLANNER, flights=40, seed=0
    )
    # In calm air the power of hover grows with the mass to 3/2, and the plan is nearly hover.
    energy = flown.of_flights("energy_J")
    spread = np.std(np.log(energy)) / (1.5 * 0.05 / 1.3)
    assert spread == pytest.approx(1.0, abs=4 / np.sqrt(2 * 40))


def test_a_saving_compares_flights_of_one_wind():
    def flown(energies, held):
        ends = [SimpleNamespace(has_succeeded=kept) for kept in held]
        return SimpleNamespace(
            flown=SimpleNamespace(endings=ends), of_flights=lambda _name: np.array(energies)
        )

    saving = Saving.of(flown([80.0, 90.0], [True, True]), flown([100.0, 100.0], [True, False]))
    assert saving.percent == pytest.approx((10.5, 15.0, 19.5))
    assert saving.both_succeeded == 1


@pytest.mark.lengthy
def test_an_autopilot_waits_until_half_of_its_flights_have_arrived():
    mission = flights.scenario("paper_calm", *HOP, "limits.speed_max=0.3")
    settings = CruiseSettings(speed=2.0, acceleration=3.0, jerk=4.0)
    cruise = fly_cruise_often(
        mission,
        settings,
        planner=flights.PLANNER,
        flights=4,
        seed=0,
    )
    assert cruise.succeeded.count == 0
    assert cruise.arrived.count >= 2
    assert cruise.name == "adaptive/cruise 2 m/s"
    longest = cruise_at(mission.cruising(settings), settling_s=SETTLINGS_S[-1])
    assert cruise.scenario.mission.duration < longest.mission.duration - 3.0


@pytest.mark.parametrize(
    ("arriving_after", "share", "waited"),
    [
        ([0.0, 0.0, 0.0, 0.0], 0.5, 0.0),
        ([0.3, 0.62, 0.9, 9.0], 0.5, 0.62),
        ([0.3, 0.62, 0.9, 1.31], 1.0, 1.31),
        ([2.2, 9.0, 9.0, 9.0], 0.5, 2.5),
    ],
)
def test_an_autopilot_waits_for_the_shortest_time_with_which_the_share_or_most_arrive(
    monkeypatch, arriving_after, share, waited
):
    told = flights.scenario("paper_calm", *HOP)
    settings = CruiseSettings(speed=2.0, acceleration=3.0, jerk=4.0)
    shortest = cruise_at(told.cruising(settings)).mission.duration

    def flown(_name, scenario, _path, **_):
        wait = scenario.mission.duration - shortest
        count = sum(wait >= needed - 1e-9 for needed in arriving_after)
        return SimpleNamespace(arrived=Share(count, 4), waited=wait)

    monkeypatch.setattr(ensemble, "_flown", flown)
    found = fly_cruise_often(told, settings, planner=None, flights=4, seed=0, arriving=share)
    assert waited - 1e-9 <= found.waited <= waited + 0.1


def test_the_words_of_many_flights_give_share_interval_limit_and_saving():
    flown = SimpleNamespace(succeeded=Share(98, 100), broken={"floor": Share(2, 100)})
    told = SimpleNamespace(mission=SimpleNamespace(fixed_duration=12.25))
    rival = SimpleNamespace(succeeded=Share(90, 100), scenario=told)
    saving = SimpleNamespace(rival=rival, percent=(1.0, 4.5, 8.0))
    words = InTurbulence(flown=flown, saving=saving, autopilot="an autopilot").words
    assert "In turbulence, 98 of 100 simulated flights arrive" in words
    assert str(Share(98, 100)) in words
    assert "the limit broken most often: floor" in words
    assert "4.5 % less energy than an autopilot in the same turbulence (median; 1.0" in words
    assert words.endswith("takes 12.25 s, and 90.0 % of them keep every limit.")


def test_a_margin_is_drawn_at_its_distance_beside_the_path():
    angle = np.linspace(0.0, np.pi, 200)
    circle = 5.0 * np.column_stack([np.cos(angle), np.sin(angle)])
    assert np.linalg.norm(_beside(circle, 0.5), axis=1) == pytest.approx(4.5, abs=1e-3)
    assert np.linalg.norm(_beside(circle, -0.5), axis=1) == pytest.approx(5.5, abs=1e-3)


def test_without_turbulence_a_plan_is_not_flown_often():
    assert fly_in_turbulence(flights.plan("paper_calm", *HOP[:-1]), None, planner=None) is None


@pytest.mark.slow
def test_a_run_in_turbulence_tells_the_share_of_flights_that_held(monkeypatch):
    monkeypatch.setattr(ensemble, "_MOST_FLIGHTS", 40)
    told = flights.plan("paper_calm", *HOP).scenario
    result = run_scenario(told, planner=flights.PLANNER, baselines=())
    flown = result.often.flown
    assert flown.count == 40
    assert 0.9 < flown.succeeded.value <= 1.0
    assert result.summary["held"] == str(flown.succeeded)
    assert run_summary(result, wall_s={})["turbulence"]["held"] == flown.succeeded.count
    assert headline_of(result).words.endswith(result.often.words)
    names = [drawing.name for drawing in drawings_of_run(result)]
    assert {"turbulence_paths", "turbulence_energy", "turbulence_bands"} <= set(names)
