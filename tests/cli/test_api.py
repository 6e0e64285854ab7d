"""The public names: what a script imports."""

import subprocess
import sys

import numpy as np
import pandas as pd
import pytest

import pyomo_quad
from tests.command import PAPER_CALM


@pytest.fixture(scope="module")
def plan():
    scenario = pyomo_quad.load_scenario(
        PAPER_CALM, ["mission.duration = 4.0", "mission.goal.position = [1.0, 0.0, 0.5]"]
    )
    return pyomo_quad.solve(scenario)


def test_plan_answers(plan):
    assert plan.is_verified
    assert plan.energy > plan.hover_energy_J
    assert plan.to_frame()["x_m"].iloc[-1] == pytest.approx(1.0, abs=1e-9)
    # Time reversed, the flight leads back: half the way at half the time, nearly.
    assert plan.at(2.0)["x_m"] == pytest.approx(0.5, abs=1e-2)
    row = plan.to_frame(rate_hz=1.0).iloc[2]
    pd.testing.assert_series_equal(plan.at(2.0), row, check_names=False, rtol=1e-12, atol=1e-12)


def test_plan_survives_its_file(plan, tmp_path):
    plan.save(tmp_path / "hop.npz")
    again = pyomo_quad.Plan.load(tmp_path / "hop.npz")
    assert (again.energy, again.status) == (plan.energy, plan.status)
    assert again.scenario == plan.scenario
    assert np.array_equal(again.trajectories.states, plan.trajectories.states)


def test_model_is_pyomo(plan):
    model = pyomo_quad.build_model(plan.scenario)
    assert model.rigid_body.roll_balance.is_constructed()


def test_a_path_is_a_scenario(tmp_path):
    with pytest.raises(pyomo_quad.scenario.ScenarioError, match=r"no\.toml: cannot be read"):
        pyomo_quad.solve(tmp_path / "no.toml")


def test_unknown_name():
    with pytest.raises(AttributeError, match="module 'pyomo_quad' has no attribute 'fly'"):
        _ = pyomo_quad.fly


def test_importing_the_package_imports_no_solver():
    program = "import sys, pyomo_quad; print(*sys.modules)"
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    slow = {"pyomo", "casadi", "cyipopt", "scipy", "pandas", "numpy", "pydantic"}
    assert slow.isdisjoint(done.stdout.split())
