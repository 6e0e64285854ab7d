"""Cruise: are the limits kept, is the way done, and are the times those of the closed form?"""

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from pyomo_quad.flight.baselines import fly_baseline
from pyomo_quad.flight.routes import cruise, cruise_at, reached, speed_profile
from pyomo_quad.scenario import ScenarioError, scenario_from_mapping
from pyomo_quad.scenario.tables import CruiseSettings, Reference
from pyomo_quad.study import autopilot, run
from pyomo_quad.study.autopilot import TUNED_CRUISE, TriedCruise, fly_cruise, tune_cruise
from pyomo_quad.study.comparison import ComparisonColumn as Column
from pyomo_quad.study.comparison import has_arrived
from pyomo_quad.sweep.study_file import Study
from tests.flights import PLANNER

ROUNDING = 1e-9


def mission(baseline=None, **tables):
    hop = {"goal": {"position": [6.0, 3.0, 2.0], "yaw": 0.5}, "duration": 6.0}
    cruising = {"references": ["cruise"], "cruise_speeds": [5.0]} | (baseline or {})
    return scenario_from_mapping(
        {"name": "hop", "mission": hop | tables.pop("mission", {}), "baseline": cruising} | tables
    )


@settings(max_examples=60, deadline=None)
@given(*(st.floats(low, high) for low, high in ((0.01, 500), (0.1, 30), (0.1, 20), (0.1, 50))))
def test_a_profile_keeps_its_limits_and_does_its_distance(distance, speed, acceleration, jerk):
    profile = speed_profile(distance, speed, acceleration, jerk)
    lasting = np.diff(profile.times)
    assert (lasting >= 0).all()
    assert profile.speeds.max() <= speed * (1 + ROUNDING)
    assert np.abs(profile.accelerations).max() <= acceleration * (1 + ROUNDING)
    change = np.abs(np.diff(profile.accelerations))
    assert (change <= jerk * lasting + ROUNDING * acceleration).all()
    # Simpson's rule is exact for the parabolas of the speed.
    start, end = profile.speeds[:-1], profile.speeds[1:]
    middle = (start + end) / 2 - lasting / 8 * np.diff(profile.accelerations)
    done = np.sum(lasting * (start + 4 * middle + end) / 6)
    assert done == pytest.approx(distance, rel=1e-7)
    # Something is always at its limit: no faster profile is left out.
    is_short = profile.speeds.max() < speed * (1 - ROUNDING)
    assert not is_short or profile.times[4] - profile.times[3] <= ROUNDING * profile.times[-1]


@pytest.mark.parametrize(
    ("distance", "duration"),
    [
        (50.0, 50 / 5 + 5 / 3 + 3 / 4),  # all seven phases: d / v + v / a + a / j
        (2.0, (32 * 2.0 / 4) ** (1 / 3)),  # jerk alone: d = j T^3 / 32
    ],
)
def test_a_profile_takes_the_time_of_the_closed_form(distance, duration):
    assert speed_profile(distance, 5.0, 3.0, 4.0).times[-1] == pytest.approx(duration, rel=1e-12)


def test_a_cruise_stops_at_waypoints_holds_and_goes_round_a_zone():
    stop = {"position": [10.0, 0.0, 0.0], "hold": 2.0}
    mast = {"name": "mast", "shape": "cylinder", "centre": [5.0, 0.1], "radius": 1.0}
    mast |= {"bottom": -50.0, "top": 50.0}
    told = cruise_at(
        mission(
            mission={"waypoints": [stop], "duration": 60.0},
            airspace={"keep_out": [mast], "clearance": 0.2},
        ),
        4.0,
    )
    path, end = cruise(told), told.mission.fixed_duration
    times = np.linspace(0.0, end, 2001)
    points = [path(t) for t in times]
    places = np.array([point.place for point in points])
    assert np.hypot(places[:, 0] - 5.0, places[:, 1] - 0.1).min() >= 1.2
    reached = told.mission.waypoints[0].at
    for t in (reached, reached + 1.0, reached + 2.0):
        assert path(t).place[:3] == pytest.approx(stop["position"], abs=ROUNDING)
        assert path(t).rate == pytest.approx([0.0] * 4, abs=1e-6)
    assert places[-1] == pytest.approx([6.0, 3.0, 2.0, 0.5], abs=ROUNDING)
    speeds = np.linalg.norm([point.rate[:3] for point in points], axis=1)
    # The rates are the slopes of the places, and kept below the speed.
    moved = np.linalg.norm(np.diff(places[:, :3], axis=0), axis=1).sum()
    assert np.trapezoid(speeds, times) == pytest.approx(moved, rel=1e-3)
    assert speeds.max() <= 4.0 * (1 + ROUNDING)


@pytest.mark.slow
def test_each_speed_is_a_flight_that_ends_on_arrival_and_not_before_the_mission():
    told = mission(baseline={"cruise_speeds": [0.8, 3.0]}, solver={"elements": 10})
    table = run.run_scenario(told).comparison.set_index(Column.FLIGHT)
    optimum = table.loc["optimal"]
    for speed in (0.8, 3.0):
        row = table.loc[f"adaptive/cruise {speed:g} m/s"]
        duration, moving = row[Column.DURATION], speed_profile(7.0, speed, 3.0, 4.0).times[-1]
        assert row[Column.ARRIVED]
        assert row[Column.VERIFIED]
        assert duration >= max(moving, 6.0)
        if duration > 6.0:
            sooner = cruise_at(told, speed, duration - moving - 0.1)
            if duration - moving > 0.1:
                flown = fly_baseline(sooner, Reference.CRUISE, dynamics=PLANNER.dynamics(sooner))
                assert not has_arrived(flown)
        hover = optimum[Column.HOVER_ENERGY] * duration / 6.0
        assert row[Column.HOVER_ENERGY] == pytest.approx(hover, rel=1e-9)
        # The bound is one on flights of six seconds.
        assert np.isnan(row[Column.LOWER_BOUND]) == (duration > 6.0)
        saved = 1 - optimum[Column.ENERGY] / (row[Column.HOVER_ENERGY] + row[Column.EXCESS_ENERGY])
        assert row[Column.SAVING] == pytest.approx(100 * saved, abs=1e-3)
    tuned = table.loc[TUNED_CRUISE]
    assert tuned[Column.SAVING] <= table[table.index.str.contains("m/s")][Column.SAVING].min()
    assert tuned[Column.LOWER_BOUND] <= tuned[Column.ENERGY]


@pytest.mark.parametrize(
    ("baseline", "message"),
    [
        ({"cruise_speeds": [0.0]}, r"baseline.cruise_speeds\[0\] = 0 m/s; must be > 0"),
        ({"cruise_speeds": []}, "baseline.cruise_speeds"),
        ({"cruise_speeds": [5.0, 5.0]}, "cruise_speeds has 5 m/s twice"),
        ({"cruise_acceleration": 0.0}, "baseline.cruise_acceleration = 0 m/s\\^2; must be > 0"),
        ({"cruise_jerk": -1.0}, "baseline.cruise_jerk = -1 m/s\\^3; must be > 0"),
    ],
)
def test_bad_speeds_are_refused_in_one_line(baseline, message):
    table = {"references": ["cruise"], "cruise_speeds": [5]}
    with pytest.raises(ScenarioError, match=message) as refused:
        scenario_from_mapping(
            {
                "name": "hop",
                "mission": {"goal": {"position": [1.0, 0.0, 0.0]}, "duration": 3.0},
                "baseline": table | baseline,
            }
        )
    assert "\n" not in str(refused.value)


def test_a_mission_to_nowhere_and_several_speeds_for_one_flight_are_refused():
    with pytest.raises(ScenarioError, match=r"the mission stays at \(0.0, 0.0, 0.0\) m"):
        cruise_at(mission(mission={"goal": {"position": [0.0, 0.0, 0.0]}}), 5.0)
    with pytest.raises(ScenarioError, match="must be one speed for one flight"):
        cruise(mission(baseline={"cruise_speeds": [1.0, 2.0]}))
    with pytest.raises(ScenarioError, match=r"cruise takes 6.9.* s and keeps its own time"):
        cruise(mission(baseline={"cruise_speeds": [1.2]}))


def test_a_study_refuses_flights_of_another_time():
    with pytest.raises(ValidationError, match="baselines has cruise, which keeps its own time"):
        Study(
            name="s",
            scenario="s.toml",
            baselines=("cruise",),
            axis=({"path": "mission.duration", "values": [4.0, 5.0]},),
        )


@pytest.fixture(scope="module")
def tuned():
    told = mission(mission={"duration": "free"})
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(autopilot, "_FLIGHTS", 7)
        return told, tune_cruise(told, None, PLANNER)


@pytest.mark.lengthy
def test_the_tuned_autopilot_spends_least_of_all_that_were_tried(tuned):
    _, tuning = tuned
    kept = [one for one in tuning.tried if one.arrived and not one.broken]
    # A flight ends as it arrives, which the search, flown to 1e-4, sees a step sooner or later.
    assert tuning.flight.energy_J <= (1 + 1e-2) * min(one.energy_J for one in kept)
    # The search moves away from where it starts, PX4's settings.
    assert tuning.flight.energy_J < (1 - 1e-3) * tuning.tried[0].energy_J
    assert tuning.flight.is_verified
    assert has_arrived(tuning.flight)
    assert tuning.flight.name == TUNED_CRUISE


@pytest.mark.lengthy
def test_the_settings_told_are_those_that_the_flight_uses(tuned):
    told, tuning = tuned
    again = fly_cruise(told, tuning.settings, None, PLANNER)
    assert again.energy_J == pytest.approx(tuning.flight.energy_J, rel=1e-5)
    assert reached(told.cruising(tuning.settings)).speed == pytest.approx(tuning.settings.speed)
    assert tuning.settings.speed <= max(one.settings.speed for one in tuning.tried)


@pytest.mark.lengthy
def test_settings_that_break_a_limit_cost_more_than_their_energy():
    """From a hold the autopilot of 12 m/s^2 overshoots, the one of 1 m/s^2 does not."""
    hold = {"position": [3.0, 1.5, 1.0], "hold": 1.0}
    told = mission(mission={"duration": "free", "waypoints": [hold]})
    fast, slow = (
        autopilot._tried(
            told,
            CruiseSettings(speed=6.0, acceleration=rate, jerk=3 * rate),
            plan=None,
            planner=PLANNER,
        )
        for rate in (12.0, 1.0)
    )
    assert any("hover waypoint 1" in limit for limit in fast.broken)
    assert fast.cost_J > 1.5 * fast.energy_J
    assert slow.broken == ()
    assert all(one.reached.speed <= one.settings.speed for one in (slow, fast))
    assert slow.cost_J == slow.energy_J


@pytest.mark.lengthy
def test_an_autopilot_is_tuned_where_the_plan_knew_another_wind(monkeypatch):
    monkeypatch.setattr(autopilot, "_FLIGHTS", 4)
    blowing = {"use": "constant", "speed": 1.0, "forecast": {"use": "calm"}}
    told = mission(wind=blowing, solver={"accuracy": "quick"})
    plan = PLANNER.solve(told)
    tuning = tune_cruise(told, plan, PLANNER)
    assert has_arrived(tuning.flight)
    assert tuning.flight.broken_limits == ()
    # The costates of the plan are those of calm air.
    assert np.isnan(tuning.flight.owed_energy_J)


def test_an_autopilot_without_any_flight_within_the_limits_says_so(monkeypatch):
    settings = CruiseSettings(speed=6.0, acceleration=3.0, jerk=4.0)
    lost = TriedCruise(
        settings=settings,
        reached=settings,
        duration_s=9.0,
        energy_J=700.0,
        arrived=True,
        broken=("tilt",),
        cost_J=1e4,
    )
    monkeypatch.setattr(autopilot, "_tried", lambda *_, **__: lost)
    broken = SimpleNamespace(broken_limits=("tilt by 2 deg",))
    monkeypatch.setattr(autopilot, "fly_cruise", lambda *_: broken)
    with pytest.raises(ScenarioError, match="settings of the autopilot arrives within the limits"):
        tune_cruise(mission(), None, PLANNER)


@pytest.mark.lengthy
def test_long_legs_are_tuned_from_the_speed_of_steady_flight_and_each_setting_is_flown_once(
    monkeypatch,
):
    """A stub flight costs the energy of steady flight alone."""
    far = {"goal": {"position": [2000.0, 0.0, 2.0]}, "duration": "free"}
    told = mission(mission=far, limits={"speed_max": 9.0})
    steady, flown = PLANNER.steady_flight(told), []

    def flight(_told, settings, **_):
        flown.append(settings.speed)
        power = steady.trim((settings.speed, 0.0, 0.0)).power_W
        return SimpleNamespace(settings=settings, cost_J=2000.0 * power / settings.speed)

    monkeypatch.setattr(autopilot, "_tried", flight)
    tried = autopilot._search(told, None, PLANNER)
    assert len(flown) == len({one.settings for one in tried})
    speeds = np.linspace(1.0, 9.0, 17)
    per_metre = [steady.trim((speed, 0.0, 0.0)).power_W / speed for speed in speeds]
    assert tried[0].cost_J == pytest.approx(2000.0 * min(per_metre), rel=1e-3)
