"""Cautions about a plan that reads the efficiency function where it is not sound."""

from types import SimpleNamespace

import numpy as np
import pytest

from pyomo_quad.collocation import Mesh
from pyomo_quad.flight.deadline import TimeIsUpError
from pyomo_quad.scenario import load_scenario
from pyomo_quad.study.check import plan_cautions
from tests.command import PAPER_CALM
from tests.flights import PLANNER

BRAKING = -3000.0  # rad/s^2: far below the torque that holds a rotor's speed


def plan_with(acceleration, *overrides):
    """Return a plan that hovers but for the rotor accelerations of its last half."""
    scenario = load_scenario(PAPER_CALM, ["power.model = 'efficiency'", *overrides])
    dynamics = PLANNER.dynamics(scenario)
    mesh = Mesh.uniform(2, 2)
    states = np.zeros((mesh.points + 1, len(dynamics.state_names)))
    speeds = [name.startswith("rotors.omega") for name in dynamics.state_names]
    states[:, speeds] = scenario.vehicle.hover_speed(scenario.gravity)
    controls = np.zeros((mesh.points, 4))
    controls[2:] = acceleration
    held = SimpleNamespace(node_times=10.0 * mesh.node_fractions, states=states, controls=controls)
    return SimpleNamespace(
        scenario=scenario, dynamics=dynamics, trajectories=held, solution=None, verification=None
    )


@pytest.fixture(autouse=True)
def _plan_alone(monkeypatch):
    monkeypatch.setattr("pyomo_quad.study.check.check_mission", lambda *_, **__: ())


def test_half_the_plan_brakes_below_the_torque_floor():
    (caution,) = plan_cautions(plan_with(BRAKING))
    assert caution.startswith(
        "power.model efficiency: 50 % of the plan's rotor states lie outside the valid range of "
        "f_r (torque below 0 N m or f_r below 0.05)"
    )


def test_hover_is_sound():
    assert plan_cautions(plan_with(0.0)) == ()
    (caution,) = plan_cautions(plan_with(0.0, "power.efficiency_floor = 0.9"))
    assert "100 % of the plan's" in caution


def test_a_plan_that_no_time_was_left_to_fly_with_exact_attitude(monkeypatch):
    def time_is_up(*_):
        raise TimeIsUpError("the time limit of 1 s ended the flight")

    monkeypatch.setattr("pyomo_quad.study.check.fly_controls", time_is_up)
    plan = plan_with(0.0, "power.model = 'motor'", "vehicle.attitude = 'paper'")
    held = plan.trajectories
    held.state_names, held.mesh, held.horizon = plan.dynamics.state_names, None, None
    plan.mission_flown, plan.verification = plan.scenario, object()
    plan.solution = SimpleNamespace(warnings=())
    assert plan_cautions(plan, planner=PLANNER) == (
        "the plan could not be flown with exact attitude: the time limit of 1 s ended the flight",
    )
