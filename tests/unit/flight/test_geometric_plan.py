"""First plans along routes: states by flatness, flights that keep limits, and what they cost."""

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose

from pyomo_quad.flight import Planner, PlanStatus, search
from pyomo_quad.flight.flight import POSITION_STATES, VELOCITY_STATES
from pyomo_quad.flight.geometric_plan import _along, _path, geometric_plan, smooth_flight
from pyomo_quad.flight.mission_problem import MissionProblem
from pyomo_quad.flight.routes import find_journeys
from pyomo_quad.flight.search import as_usable
from pyomo_quad.flight.smoothed_route import Pace
from pyomo_quad.scenario import load_scenario
from tests.command import PAPER_CALM

BOX = {"name": "hut", "shape": "box", "low": [6.0, -3.0, 0.0], "high": [9.0, 3.0, 30.0]}


def mission(**changed):
    """Return a mission of 15 m past a hut, with changes."""
    told = {
        "name": "first",
        "vehicle": {"use": "dji_phantom_2", "payload": 0.2},
        "battery": {"use": "phantom_2_pack"},
        "power": {"model": "motor"},
        "wind": {"use": "constant", "speed": 2.0, "direction": 1.0, "coupling": "drag"},
        "airspace": {"keep_out": [BOX], "clearance": 0.5},
        "mission": {
            "start": {"position": [0.0, 0.0, 5.0]},
            "goal": {"position": [15.0, 0.0, 6.0]},
            "duration": "free",
        },
    }
    told["mission"] |= changed
    return MissionProblem(Planner(), load_scenario(told))


@pytest.fixture(scope="module")
def past_a_hut():
    return mission()


def depth(plan):
    """Return how far the simulated flight enters the clearance of the hut [m]."""
    names = plan.dynamics.state_names
    columns = [names.index(f"rigid_body.{axis}") for axis in "xyz"]
    (zone,) = plan.scenario.airspace.keep_out
    return zone.depth(plan.flown.states[:, columns]).max() + plan.scenario.airspace.clearance


@pytest.mark.lengthy
def test_a_flight_along_the_route_arrives_and_keeps_all_limits(past_a_hut):
    plan = as_usable(geometric_plan(past_a_hut))
    assert plan.status is PlanStatus.USABLE
    assert plan.verification.is_usable
    assert plan.verification.terminal_miss_m <= 0.5
    assert depth(plan) <= 2e-3
    # The energy is that of the simulated flight.
    assert plan.energy == pytest.approx(plan.verification.flown_energy_J, rel=1e-6)
    assert "is not optimised" in plan.message
    assert "may save an estimated" in plan.message
    assert not plan.is_optimised


@pytest.mark.lengthy
def test_it_costs_more_than_the_optimum_but_no_more_than_it_says(past_a_hut):
    first = geometric_plan(past_a_hut)
    best = Planner().solve(past_a_hut.told)
    assert best.is_verified
    assert best.energy < first.energy <= best.energy * (1.0 + first.energy_uncertainty)


def test_the_states_of_a_path_satisfy_the_equations_of_motion(past_a_hut):
    told = past_a_hut.told
    journey = find_journeys(told.airspace, told.mission.positions)[0]
    path = _path(told, journey, Pace(speed=3.0, acceleration=1.0, turning=0.5), 3.0)
    plan, _ = _along(past_a_hut, journey, path)
    held, names = plan.trajectories, plan.dynamics.state_names
    velocity = [names.index(f"rigid_body.v{axis}") for axis in "xyz"]
    turning = [names.index(f"rigid_body.{name}") for name in ("phi", "theta", "psi")]
    angles = np.gradient(held.states[:, turning], held.node_times, axis=0)
    for k in range(5, len(held.controls) - 5, 7):
        t = float(held.node_times[k])
        rates = plan.dynamics.rates(t, held.states[k], held.controls[k - 1])
        assert_allclose(rates[velocity], path.at(np.array([t]))[2][0], atol=1e-2)
        assert_allclose(rates[turning], angles[k], atol=1e-2)


def test_a_smooth_flight_leads_from_rest_to_rest_along_the_journey(past_a_hut):
    told = past_a_hut.told
    journey = find_journeys(told.airspace, told.mission.positions)[0]
    guess = smooth_flight(past_a_hut, journey)
    places = np.array([guess[name] for name in POSITION_STATES])
    speeds = np.array([guess[name] for name in VELOCITY_STATES])
    assert_allclose(places[:, [0, -1]].T, told.mission.positions, atol=1e-9)
    assert_allclose(speeds[:, [0, -1]], 0.0, atol=1e-6)
    # The change of place is the integral of the velocity, here by trapezoids of some 0.1 s.
    passed = np.trapezoid(speeds, guess["duration"] * guess["time"], axis=1)
    assert_allclose(passed, np.diff(told.mission.positions, axis=0)[0], atol=0.02)
    # Half a metre from the walls, corners are cut by less.
    (zone,) = told.airspace.keep_out
    assert zone.depth(places.T).max() < 0.0


def test_there_is_no_smooth_flight_where_the_time_is_too_short():
    short = mission(duration_max=1.0)
    journey = find_journeys(short.told.airspace, short.told.mission.positions)[0]
    assert smooth_flight(short, journey) is None


@pytest.mark.lengthy
def test_a_fixed_duration_and_a_hover_with_a_release_are_kept():
    stop = {"position": [8.0, 8.0, 5.0], "hold": 2.0, "release": 0.2}
    plan = as_usable(geometric_plan(mission(waypoints=[stop], duration=25.0)))
    assert plan.status is PlanStatus.USABLE
    assert plan.duration_s == 25.0
    assert max(plan.verification.passing_misses_m) <= 0.1
    # Before and after the release, the rotors lift different masses.
    speeds = plan.trajectories.states_at(np.array([10.0, 24.5]))
    rotors = [k for k, n in enumerate(plan.trajectories.state_names) if n.startswith("rotors.")]
    assert speeds[1, rotors].mean() < 0.97 * speeds[0, rotors].mean()


@pytest.mark.lengthy
def test_there_is_no_first_plan_where_the_time_is_too_short_or_times_are_given():
    assert geometric_plan(mission(duration=2.0)) is None
    there = {"position": [8.0, 8.0, 5.0], "at": 6.0}
    assert geometric_plan(mission(waypoints=[there], duration=15.0)) is None


@pytest.mark.lengthy
def test_a_search_that_is_stopped_in_its_first_solve_returns_the_first_plan(monkeypatch):
    monkeypatch.setattr(search, "_PROMPT", 0.0)
    states = []
    stopped = Planner().solve(
        load_scenario(PAPER_CALM, ["solver.accuracy='standard'"]),
        progress=lambda _: not (states and states[-1].has_usable),
        show=states.append,
    )
    assert stopped.status is PlanStatus.USABLE
    assert len(states) == 1
    assert not math.isinf(stopped.energy_uncertainty)
    assert "may save an estimated" in stopped.message
