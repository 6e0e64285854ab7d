"""No flight is below its bound: the paper's missions and missions drawn at random."""

from pathlib import Path

import numpy as np
import pytest

from pyomo_quad.flight.baselines import fly_baseline
from pyomo_quad.scenario import load_scenario
from pyomo_quad.scenario.tables import Reference
from tests.declared_model import ROTORS, scenario
from tests.flights import PLANNER, certified

SCENARIOS = Path(__file__).parents[2] / "scenarios"
# On one coarse mesh the controls, flown, come this near to the goal, m: near enough for an
# energy that is right to 1e-5, a tenth of the smallest gap.
GOAL_MISSED = 0.05
COARSE = {"elements": 25, "degree": 4, "max_refinements": 0}


@pytest.fixture(scope="module")
def planner():
    return PLANNER


@pytest.mark.lengthy
@pytest.mark.parametrize("name", ["paper_calm", "paper_wind"])
def test_the_paper_s_missions_are_within_one_per_cent(planner, name):
    told = load_scenario(SCENARIOS / f"{name}.toml")
    plan = planner.solve(told)
    found = certified(told)
    assert plan.is_verified
    assert found.lower_bound_J <= plan.energy
    assert found.gap_percent(plan.energy) < 1.0


def random_mission(generator, power, coupling):
    goal = generator.uniform(-10.0, 10.0, 3)
    # Long enough for the thrust that is left above the weight.
    duration = generator.uniform(2.5, 5.0) * np.sqrt(np.linalg.norm(goal)) + 1.0
    return scenario(
        solver=COARSE,
        power={"model": power},
        vehicle={"payload": generator.uniform(0.0, 0.15)},
        wind={
            "use": "paper_table_2",
            "coupling": coupling,
            "speed": generator.uniform(0.0, 3.0),
            "direction": generator.uniform(-np.pi, np.pi),
        },
        mission={
            "goal": {"position": goal.tolist(), "yaw": generator.uniform(-1.0, 1.0)},
            "duration": duration,
        },
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("power", "coupling", "count"),
    [("motor", "acceleration", 5), ("motor", "drag", 4), ("motor_with_friction", "drag", 1)],
)
def test_no_plan_of_a_random_mission_is_below_its_bound(planner, power, coupling, count):
    generator = np.random.default_rng([len(power), len(coupling)])
    for _ in range(count):
        told = random_mission(generator, power, coupling)
        plan = planner.solve(told)
        assert plan.verification.terminal_miss_m < GOAL_MISSED, told.mission
        found = certified(told)
        assert found.lower_bound_J <= plan.energy, told.mission
        assert found.gap_percent(plan.energy) < 1.0, told.mission
        for model in ("shaft", "constant_efficiency"):
            other = certified(told.with_values({"power.model": model}))
            assert other.lower_bound_J <= energy_under(model, plan), told.mission


@pytest.mark.lengthy
def test_the_plan_flown_under_feedback_is_not_below_the_bound(planner):
    # Of all controlled flights this one comes nearest to it.
    told = load_scenario(SCENARIOS / "paper_wind.toml")
    plan = planner.solve(told)
    flight = fly_baseline(told, Reference.PLAN, dynamics=planner.dynamics(told), plan=plan)
    assert certified(told).lower_bound_J <= flight.energy_J


@pytest.mark.lengthy
def test_a_controlled_flight_of_a_random_mission_is_not_below_its_bound(planner):
    told = random_mission(np.random.default_rng(5), "motor", "drag")
    flight = fly_baseline(told, Reference.QUINTIC, dynamics=planner.dynamics(told))
    assert certified(told).lower_bound_J <= flight.energy_J


def energy_under(model, plan):
    """Return what a plan for another power model costs under this one."""
    flown = plan.to_frame(200.0)
    shaft = [flown[f"motor_{j}_torque_N_m"] * flown[f"omega_{j}_rad_per_s"] for j in ROTORS]
    if model == "shaft":
        return np.trapezoid(sum(shaft), flown.index)
    floored = sum(power.clip(lower=0.0) for power in shaft)
    return np.trapezoid(floored, flown.index) / 0.75
