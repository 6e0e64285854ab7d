"""References: right at both ends, and derivatives that are derivatives."""

import numpy as np
import pytest

from pyomo_quad.flight.references import PlannedPath, SampledPath, minimum_snap, quintic, step
from pyomo_quad.scenario import ScenarioError
from tests import flights
from tests.declared_model import scenario

MISSION = flights.scenario("paper_calm", "mission.goal.yaw=0.5").mission
GOAL = [6.0, 7.0, 8.0, 0.5]


def slope(path, t, part, h=1e-4):
    after, before = getattr(path(t + h), part), getattr(path(t - h), part)
    return (np.array(after) - before) / (2 * h)


@pytest.mark.parametrize("make", [quintic, minimum_snap])
def test_ends_are_at_rest(make):
    path = make(MISSION)
    for t, place in ((0.0, [0.0] * 4), (10.0, GOAL), (-1.0, [0.0] * 4), (12.0, GOAL)):
        assert path(t).place == pytest.approx(place, abs=1e-12)
        assert path(t).rate == pytest.approx([0.0] * 4, abs=1e-12)
        assert path(t).acceleration == pytest.approx([0.0] * 4, abs=1e-12)


def test_minimum_snap_starts_without_jerk_and_the_quintic_does_not():
    assert slope(minimum_snap(MISSION), 1e-4, "acceleration") == pytest.approx(0.0, abs=1e-3)
    # jerk at the start is 60 s / T^3
    expected = 60 * np.array(GOAL) / 10.0**3
    assert slope(quintic(MISSION), 1e-4, "acceleration") == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize("make", [quintic, minimum_snap])
@pytest.mark.parametrize("t", [0.7, 5.0, 8.2])
def test_rates_are_the_derivatives(make, t):
    path = make(MISSION)
    assert path(t).rate == pytest.approx(slope(path, t, "place"), rel=1e-6)
    assert path(t).acceleration == pytest.approx(slope(path, t, "rate"), rel=1e-6, abs=1e-9)


def test_a_step_is_the_goal_at_all_times():
    for t in (0.0, 3.0, 11.0):
        assert step(MISSION)(t) == (GOAL, [0.0] * 4, [0.0] * 4, None)


def test_halfway_in_time_is_halfway_in_space():
    assert quintic(MISSION)(5.0).place == pytest.approx(np.array(GOAL) / 2)


def test_a_sampled_path_follows_a_quintic_exactly_and_stays_beyond_it():
    path, times = quintic(MISSION), np.linspace(0.0, 10.0, 6)
    rows = [path(t) for t in times]
    sampled = SampledPath(times, *([getattr(row, part) for row in rows] for part in row_parts()))
    for t in (0.0, 1.3, 4.0, 9.9):
        for part in row_parts():
            expected = getattr(path(t), part)
            assert getattr(sampled(t), part) == pytest.approx(expected, abs=1e-9)
    assert sampled(11.0).place == pytest.approx(GOAL)
    assert list(sampled(11.0).rate) == list(sampled(-1.0).rate) == [0.0] * 4


def test_a_planned_path_keeps_each_quantity_of_a_plan_that_obeys_its_equations_at_some_points():
    """Places that are 1 mm off make no acceleration; as derivatives they would make 0.6 m/s^2."""
    times = np.linspace(0.0, 1.0, 11)
    off = 1e-3 * np.array([[(-1) ** k, 0.0, 0.0, 0.0] for k in range(11)])
    steady = np.tile([0.3, -0.2, 0.0, 0.0], (11, 1))
    turning = np.column_stack([times**2, 1.0 - times])
    path = PlannedPath(times, off, 0.0 * off, steady, turning)
    for t in (0.05, 0.42, 1.0):
        found = path(t)
        assert found.acceleration == pytest.approx(steady[0])
        assert found.rate == pytest.approx([0.0] * 4)
        # Cubic splines keep parabolas.
        assert found.tilting == pytest.approx([t**2, 1.0 - t, 2.0 * t, -1.0])
    after = path(4.0)
    assert after.place == pytest.approx(off[-1])
    assert after.acceleration == pytest.approx(steady[0])
    assert (*after.rate, *after.tilting) == pytest.approx([0.0] * 8)


def row_parts():
    return ("place", "rate", "acceleration")


def test_a_spline_through_points_of_the_quintic_is_the_quintic():
    straight = scenario(mission={"duration": 4.0, "goal": {"position": [6.0, 7.0, 8.0]}}).mission
    times = (1.0, 2.5)
    on_the_way = [
        {"position": list(quintic(straight)(t).place[:3]), "at": t, "yaw": 0.0} for t in times
    ]
    told = scenario(
        mission={
            "duration": 4.0,
            "goal": {"position": [6.0, 7.0, 8.0]},
            "waypoints": on_the_way,
        }
    ).mission
    for t in (-1.0, 0.0, 0.3, 1.0, 1.7, 3.9, 4.0, 6.0):
        for found, known in zip(quintic(told)(t), quintic(straight)(t), strict=True):
            assert found == pytest.approx(known, abs=1e-9)


def test_a_path_with_a_hold_rests_there():
    stop = {"position": [1.0, 2.0, 3.0], "at": 2.0, "hold": 1.0}
    told = scenario(mission={"duration": 5.0, "waypoints": [stop]}).mission
    for reference in (quintic, minimum_snap):
        path = reference(told)
        for t in (2.0, 2.5, 3.0):
            assert path(t).place[:3] == pytest.approx([1.0, 2.0, 3.0], abs=1e-9)
            assert path(t).rate == pytest.approx(np.zeros(4), abs=1e-8)
        assert path(1.0).rate[0] > 0.1
    assert step(told)(2.9).place[:3] == [1.0, 2.0, 3.0]
    assert step(told)(3.1).place[:3] == [6.0, 7.0, 8.0]


def test_a_path_needs_the_times_of_its_waypoints():
    told = scenario(mission={"duration": 5.0, "waypoints": [{"position": [1.0, 2.0, 3.0]}]})
    with pytest.raises(ScenarioError, match=r"mission\.waypoints\[0\]\.at is missing; without a"):
        quintic(told.mission)
