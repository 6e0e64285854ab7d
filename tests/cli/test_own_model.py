"""A user's own equations reach optimiser, verification and report together."""

import pandas as pd
import pytest

from pyomo_quad import load_scenario
from pyomo_quad import solve as solve_scenario
from pyomo_quad.cli.endings import ExitCode
from tests.command import PAPER_CALM, QUICK, SCENARIOS, run_here

# The force balance is declared anew with drag in it; nothing else is edited.
DRAG = 0.12
WITH_DRAG = f"""
from pyomo.environ import Constraint, cos, sin, units
from pyomo_quad import build_model

DRAG = {DRAG} * units.kg / units.s

def build(scenario):
    model = build_model(scenario)
    mass, thrust, body = model.vehicle.mass, model.rotors.total_thrust, model.rigid_body
    phi, theta, psi = body.phi, body.theta, body.psi

    def x_balance(b, t):
        share = cos(phi[t]) * sin(theta[t]) * cos(psi[t]) + sin(phi[t]) * sin(psi[t])
        return mass * b.dvx_dt[t] == share * thrust[t] - DRAG * b.vx[t]

    def y_balance(b, t):
        share = cos(phi[t]) * sin(theta[t]) * sin(psi[t]) - sin(phi[t]) * cos(psi[t])
        return mass * b.dvy_dt[t] == share * thrust[t] - DRAG * b.vy[t]

    def z_balance(b, t):
        upward = cos(phi[t]) * cos(theta[t]) * thrust[t]
        return mass * b.dvz_dt[t] == upward - mass * model.vehicle.gravity - DRAG * b.vz[t]

    for axis, rule in dict(x=x_balance, y=y_balance, z=z_balance).items():
        body.del_component(body.component(axis + "_momentum_balance"))
        body.add_component(axis + "_momentum_balance", Constraint(model.time, rule=rule))
    return model
"""


@pytest.fixture(scope="module")
def with_drag(tmp_path_factory):
    folder = tmp_path_factory.mktemp("drag")
    (folder / "drag.py").write_text(WITH_DRAG)
    scenario = folder / "paper_calm.toml"
    scenario.write_text((SCENARIOS / "paper_calm.toml").read_text())
    own = ('--set=model="drag.py:build"', "--allow-code", "--figures", "none")
    return run_here("solve", str(scenario), *QUICK, *own, out=folder / "report")


def energy_of(*overrides):
    """Return the optimum of the package's own declarations."""
    quick = [option.removeprefix("--set=") for option in QUICK]
    return solve_scenario(load_scenario(PAPER_CALM, [*quick, *overrides])).energy


@pytest.mark.lengthy
def test_the_optimum_changes_and_its_flight_confirms_it(with_drag):
    assert with_drag.status == ExitCode.VERIFIED
    assert with_drag.summary["energy_J"] > energy_of() + 0.01
    assert with_drag.summary["terminal_miss_m"] < 1e-4


def test_it_is_the_optimum_of_the_same_drag_declared_elsewhere(with_drag):
    linear = (f"vehicle.drag_linear={DRAG}", "vehicle.drag_quadratic=0.0")
    energy = energy_of('wind.coupling="drag"', *linear)
    assert with_drag.summary["energy_J"] == pytest.approx(energy, rel=1e-7)


def test_the_report_shows_the_flight_with_drag(with_drag):
    energy = with_drag.summary["energy_J"]
    assert f"{energy:.2f} J" in with_drag.read("report.md")
    frame = pd.read_csv(with_drag.folder / "plan.csv")
    assert frame["energy_J"].iloc[-1] == pytest.approx(energy, rel=1e-11)
