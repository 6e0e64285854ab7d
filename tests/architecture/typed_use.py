"""What a user's own typed program may do with the public API: checked by `mypy --strict`."""

from pathlib import Path

import pandas as pd
from pyomo.environ import ConcreteModel

import pyomo_quad
from pyomo_quad.collocation import JointSolution, Solution, Status, solve
from pyomo_quad.exports import Export, Format, Motion, PolynomialTrajectory
from pyomo_quad.flight import Flight, Planner, PlanStatus, Verification
from pyomo_quad.scenario import Scenario, ScenarioError, library_names


def plan_of(file: Path, duration: float) -> pyomo_quad.Plan:
    scenario: Scenario = pyomo_quad.load_scenario(file, {"mission.duration": duration})
    plan: pyomo_quad.Plan = pyomo_quad.solve(scenario)
    return plan if plan.is_verified else Planner().solve(scenario)


def told(plan: pyomo_quad.Plan) -> tuple[float, str, pd.DataFrame, pd.Series]:
    verification: Verification | None = plan.verification
    miss = float("inf") if verification is None else verification.terminal_miss_m
    status: PlanStatus = plan.status
    flight: Flight = plan.flight()
    return miss + flight.energy_J, status.value, plan.to_frame(rate_hz=50.0), plan.at(0.5)


def along(plan: pyomo_quad.Plan) -> pd.DataFrame:
    return plan.at([1.0, 2.0, 3.0])


def optimum(model: ConcreteModel) -> float:
    found: Solution | JointSolution = solve(model, tolerance=1e-8, starts=2)
    return found.objective if found.status is Status.CONVERGED else float("nan")


def handed_over(plan: pyomo_quad.Plan, folder: Path) -> Export:
    motion: Motion = Motion.of(plan)
    trajectory = PolynomialTrajectory([motion.duration], [[[0.0]] * 4])
    trajectory.update(0.0)
    return pyomo_quad.export_plan(plan, Format.PX4, folder / "px4.csv", rate_hz=50.0)


def declared(plan: pyomo_quad.Plan) -> ConcreteModel:
    return pyomo_quad.build_model(plan.scenario)


def gap(scenario: Scenario) -> float | None:
    try:
        return pyomo_quad.run_scenario(scenario).gap_percent
    except ScenarioError:
        print(library_names("vehicles"))
        return None


def shown(plan: pyomo_quad.Plan, result: pyomo_quad.RunResult, folder: Path) -> list[Path]:
    picture: pyomo_quad.Picture = plan.plot("energy")
    result.save(folder / "run.nc")
    pages = [plan.report(folder / "plan", figures="png"), result.report(folder / "run")]
    return [picture.save(folder / "energy.svg"), result.plot().save(folder / "run.png"), *pages]


def slower(scenario: Scenario) -> Scenario:
    return scenario.replace({"mission": {"duration": 12.0}, "vehicle.payload": 0.2})
