"""The paper's missions against the same missions written by hand in CasADi, with its own Ipopt."""

import pytest

from pyomo_quad.collocation import Mesh, compile
from pyomo_quad.flight import Planner
from pyomo_quad.model import build_model
from pyomo_quad.scenario import load_scenario
from tests.benchmarks.handwritten import solve_by_hand

MISSIONS = [("paper_calm", False), ("paper_wind", True)]


@pytest.mark.parametrize(("name", "has_wind"), MISSIONS)
def test_same_optimum_on_the_same_mesh(name, has_wind):
    scenario = load_scenario(f"scenarios/{name}.toml")
    solution = compile(build_model(scenario)).solve(mesh=Mesh.uniform(12, 4))
    by_hand = solve_by_hand(12, 4, has_wind=has_wind)
    assert solution.objective == pytest.approx(by_hand.energy_J, rel=1e-9)


@pytest.mark.lengthy
@pytest.mark.parametrize(("name", "has_wind"), MISSIONS)
def test_the_plan_as_shipped_agrees_with_a_converged_mesh(name, has_wind):
    plan = Planner().solve(load_scenario(f"scenarios/{name}.toml"))
    by_hand = solve_by_hand(16, 6, has_wind=has_wind)
    assert plan.energy == pytest.approx(by_hand.energy_J, rel=1e-6)
