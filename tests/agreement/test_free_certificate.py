"""The bound of all durations is the least of the bounds of each, and no flight is below it."""

import numpy as np
import pytest

from pyomo_quad.study.certificate import certify
from tests.declared_model import scenario
from tests.flights import PLANNER, certified


def free(**tables):
    mission = {"goal": {"position": [6.0, 7.0, 8.0]}, "duration": "free"}
    return scenario(mission=mission | tables.pop("mission", {}), **tables)


@pytest.mark.lengthy
@pytest.mark.parametrize(
    "mission", [{"goal": {"position": [30.0, -4.0, -2.0]}}, {"duration_min": 6.0}]
)
def test_the_bound_is_the_least_of_those_of_fixed_durations(mission):
    planner, told = PLANNER, free(mission=mission)
    least, _ = told.mission.duration_limits
    times = [max(least, t) for t in np.geomspace(0.2, 1.2, 11) * told.nominal_duration]
    fixed = [certify(told.lasting(t), planner=planner).lower_bound_J for t in times]
    found = certify(told, planner=planner)
    known = min(bound for bound in fixed if bound is not None)
    # The two searches end a hundred-millionth apart.
    assert found.lower_bound_J <= known * (1 + 1e-8)
    # Eleven durations leave the least between two of them.
    assert found.lower_bound_J == pytest.approx(known, rel=2e-2)


@pytest.mark.slow
def test_the_paper_s_mission_of_free_time_is_bounded():
    told = free(vehicle={"attitude": "paper"})
    plan, found = PLANNER.solve(told), certified(told)
    assert plan.is_verified
    assert found.lower_bound_J <= plan.energy


@pytest.mark.parametrize(
    ("tables", "reason"),
    [
        ({"wind": {"use": "paper_table_2"}}, "in a wind that changes with time"),
    ],
)
def test_where_no_bound_is_known_the_reason_is_given(tables, reason):
    found = certified(free(**tables))
    assert not found.applies
    assert reason in found.reason


@pytest.mark.parametrize(
    ("tables", "reason"),
    [
        ({"wind": {"use": "paper_table_2"}}, "changes in flight in a wind that changes with time"),
    ],
)
def test_where_a_mass_that_changes_has_no_bound_the_reason_is_given(tables, reason):
    parcel = {"position": [1.0, 1.0, 1.0], "release": 0.1}
    vehicle = {"vehicle": {"payload": 0.1}}
    found = certified(scenario(mission={"waypoints": [parcel]}, **(vehicle | tables)))
    assert found.lower_bound_J is None
    assert reason in found.reason


@pytest.mark.lengthy
@pytest.mark.parametrize(
    ("tables", "why"),
    [
        ({"wind": {"use": "paper_table_2"}}, "in a wind that changes with time"),
        pytest.param(
            {"wind": {"use": "calm", "coupling": "drag"}, "vehicle": {"drag_linear": 0.1}},
            "with drag",
            marks=pytest.mark.slow,
        ),
        ({"mission": {"order": "best"}}, "where their order is open"),
    ],
)
def test_waypoints_that_are_not_counted_leave_the_bound_without_them(tables, why):
    passed = [{"position": [1.0, 3.0, 1.0]}, {"position": [5.0, 6.0, 8.0]}]
    mission = tables.pop("mission", {})
    found = certified(scenario(mission={"waypoints": passed} | mission, **tables))
    assert found.lower_bound_J == pytest.approx(certified(scenario(**tables)).lower_bound_J)
    assert f"no bound is known that counts waypoints {why}, so these are left out" in found.reason


def test_what_is_counted_is_said():
    passed = [{"position": [1.0, 3.0, 1.0]}, {"position": [5.0, 6.0, 8.0]}]
    found = certified(free(mission={"waypoints": passed, "duration_max": 30.0}))
    assert found.reason.startswith("on each of 3 legs, their velocities at the passages free")
    assert "every duration from 0.001 to 30 s and all passing times" in found.reason
