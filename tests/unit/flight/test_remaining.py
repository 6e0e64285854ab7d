"""Re-plans of the remaining mission: they exist beyond a limit, and begin where a plan leads."""

from itertools import pairwise

import numpy as np
import pytest

from pyomo_quad.flight import remaining
from pyomo_quad.flight.controller import rotor_columns
from pyomo_quad.flight.flight import POSITION_STATES, VELOCITY_STATES
from pyomo_quad.flight.margins import greatest_margin
from pyomo_quad.flight.remaining import Belief, Replanner, breach_of
from pyomo_quad.scenario.tables import Knowledge
from tests import flights

FLOOR = -0.2
MISSION = (
    "mission.goal.position=[1.0, 0.5, 0.5]",
    "mission.duration=3.0",
    f"airspace.floor={FLOOR}",
)
MARGIN = 0.1


@pytest.fixture(scope="module")
def replanner():
    mission = flights.scenario("paper_calm", *MISSION)
    return Replanner(mission, Knowledge.TOLD, flights.PLANNER, {"airspace.floor": MARGIN})


@pytest.fixture(scope="module")
def course(replanner):
    first = replanner.first()
    replanner.prepare(first)
    return replanner.first_course(first)


DASH = (
    "mission.duration=6.0",
    "mission.goal.position=[50.0, 20.0, 10.0]",
    "mission.waypoints=[]",
    "vehicle.payload=0.0",
    "airspace.keep_out=[]",
)


@pytest.mark.lengthy
def test_angles_of_a_first_plan_are_the_integrals_of_their_rates():
    """The controller follows both: 0.2 rad apart, they took a flight beyond its pitch limit."""
    mission = flights.scenario("delivery", *DASH)
    plan = Replanner(mission, Knowledge.UNTOLD, flights.PLANNER).first()
    t = np.linspace(*plan.horizon, 6001)
    for angle, rate in (("phi", "p"), ("theta", "q")):
        turned, turning = (
            plan.states_at(t)[:, plan.state_names.index(f"rigid_body.{name}")]
            for name in (angle, rate)
        )
        steps = np.diff(t) * (turning[1:] + turning[:-1]) / 2
        assert turned[0] + np.cumsum(steps) == pytest.approx(turned[1:], abs=0.01)


def state_at(replanner, course, t):
    names = list(course.plan.state_names)
    columns = [names.index(name) for name in replanner.dynamics.state_names]
    return course.plan.states_at(np.array([t]))[0, columns]


def moved(replanner, state, **by):
    changed = state.copy()
    for name, change in by.items():
        changed[replanner.dynamics.state_names.index(f"rigid_body.{name}")] += change
    return changed


@pytest.mark.lengthy
def test_from_beyond_a_limit_a_plan_leads_back_and_breaks_it_by_no_more_than_it_is_broken(
    replanner, course
):
    state, below = state_at(replanner, course, 1.0), 0.3
    height = state[replanner.dynamics.state_names.index("rigid_body.z")]
    lowered = moved(replanner, state, z=FLOOR - below - height)
    found = replanner.solve(1.0, lowered, replanner.belief)
    assert found.is_converged
    # The margin is used up first.
    assert 0.0 < breach_of(found) <= below + MARGIN + 1e-5
    last = found.trajectory.states[-1]
    names = [slot.name for slot in found.problem.compiled.declared.states]
    goal = last[[names.index(name) for name in POSITION_STATES]]
    assert goal == pytest.approx([1.0, 0.5, 0.5], abs=1e-4)


def test_a_flight_near_its_plan_goes_on_from_it_and_one_farther_off_from_as_far_as_it_is_near(
    replanner, course
):
    now, later = 1.0, 1.06
    planned, to_come = (state_at(replanner, course, t) for t in (now, later))
    none = np.zeros(3)
    near = moved(replanner, planned, x=0.9 * replanner.tube)
    assert replanner.begun(course, now, later, near, none) == pytest.approx(to_come)
    far = moved(replanner, planned, x=0.5, vx=-0.2, phi=0.3)
    begun = replanner.begun(course, now, later, far, none) - to_come
    names = list(replanner.dynamics.state_names)
    places, speeds = (
        begun[[names.index(name) for name in group]] for group in (POSITION_STATES, VELOCITY_STATES)
    )
    share = 1.0 - replanner.tube / 0.5
    # The next plan begins at the tube's radius from the vehicle; its speed differs by the same
    # share, so that its distance from the last one shrinks meanwhile.
    assert places == pytest.approx([share * (0.5 - 0.2 * (later - now)), 0.0, 0.0])
    assert speeds == pytest.approx([share * -0.2, 0.0, 0.0])
    assert begun[names.index("rigid_body.phi")] == pytest.approx(0.0, abs=1e-12)


def test_a_plan_begins_with_the_lean_and_thrust_that_withstand_what_was_learnt(replanner, course):
    """Begun level, each plan lost the lean of the controller and leant anew: 2 % of the energy."""
    now, later = 1.0, 1.06
    planned, to_come = (state_at(replanner, course, t) for t in (now, later))
    unexplained = np.array([0.4, -0.3, 0.5])
    leaning = replanner.begun(course, now, later, planned, unexplained)
    states, controls = np.array([to_come, leaning]), np.zeros((2, 4))
    slopes = tuple((f"rigid_body.dv{axis}_dt", None) for axis in "xyz")
    before, after = replanner.dynamics.table(slopes, np.full(2, later), states, controls)
    # A path through samples of the plan gives its acceleration to about a thousandth.
    assert after - before == pytest.approx(-unexplained, abs=2e-3)


def test_a_plan_goes_on_only_within_the_margins(replanner, course):
    state = state_at(replanner, course, 1.0)
    within, beyond = (moved(replanner, state, z=-share * MARGIN) for share in (0.9, 1.1))
    assert not replanner.is_off(course, 1.0, within)
    assert replanner.is_off(course, 1.0, beyond)


def test_a_replan_uses_the_reserve_of_the_rotors_rather_than_miss_the_goal():
    """The plan's margin leaves too little for a vehicle that is a sixth heavier than planned."""
    mission = flights.scenario("paper_calm", *MISSION)
    margin = greatest_margin(mission, "limits.rotor_speed_max")
    planned = Replanner(mission, Knowledge.TOLD, flights.PLANNER)
    careful = Replanner(
        mission, Knowledge.TOLD, flights.PLANNER, {"limits.rotor_speed_max": margin}
    )
    first = planned.first()
    careful.prepare(first)
    state = state_at(careful, careful.first_course(first), 1.0)
    mass = 7.0 / 6.0 * mission.vehicle.total_mass
    state[rotor_columns(careful.dynamics)] = mission.limits.rotor_speed_max
    replan = careful.solve(1.0, state, Belief(mass=mass, unexplained=(0.0, 0.0)))
    assert replan.is_converged
    assert breach_of(replan) < 1e-3


def test_elements_are_short_at_both_ends_and_none_is_longer_than_the_longest():
    times = [0.0, *remaining._graded(0.0, 20.0), 20.0]
    widths = np.array([b - a for a, b in pairwise(times)])
    assert np.all(widths > 0.0)
    assert widths == pytest.approx(widths[::-1])
    assert widths[0] == pytest.approx(widths.min())
    assert widths.max() <= remaining._LONG_S


def test_plans_before_a_hold_end_inside_it_and_plans_behind_it_at_the_goal():
    way = (
        "mission.goal.position=[4.0, 2.0, 1.5]",
        "mission.duration=11.0",
        "mission.waypoints=[{position=[1.5, 1.5, 0.5], at=3.5, hold=1.0}]",
    )
    mission = flights.scenario("paper_calm", *way)
    before, behind = (remaining._ahead(mission, k) for k in range(2))
    assert 3.5 < before.mission.fixed_duration < 4.5
    assert before.mission.goal.position == (1.5, 1.5, 0.5)
    assert behind.mission.fixed_duration == 11.0
    assert behind.mission.goal.position == mission.mission.goal.position
