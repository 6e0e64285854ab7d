"""A plan is flown again before it is exported: what its file says of its own proof is nothing."""

import json
from dataclasses import replace
from shutil import copy

import numpy as np
import pandas as pd
import pytest

from pyomo_quad import Plan
from pyomo_quad.cli import main
from pyomo_quad.cli.endings import ExitCode
from pyomo_quad.exports import export_plan
from pyomo_quad.flight import solve_scenario
from pyomo_quad.model import build_model
from pyomo_quad.scenario import ScenarioError, load_scenario
from tests import flights
from tests.command import SCENARIOS
from tests.scenario_files import write_scenario

REPORTS = SCENARIOS.parent / "reports"
HOP = (
    "mission.goal.position=[1.0, 0.0, 0.5]",
    "mission.duration=4.0",
    "solver.elements=20",
)


def plan():
    return flights.plan("paper_calm", *HOP)


def with_states(change):
    """Return the plan with its states changed, and what it says of itself as it was."""
    held = plan().trajectories
    states = held.states.copy()
    change(states, held.state_names.index("rigid_body.x"), held.state_names.index("rigid_body.z"))
    return replace(plan(), trajectories=replace(held, states=states))


def moved(states, x, _z):
    states[:, x] += 5.0


def bent(states, x, _z):
    states[len(states) // 2, x] += 5.0


def sunk(states, _x, z):
    states[-1, z] -= 0.5


def with_controls(factor):
    held = plan().trajectories
    return replace(plan(), trajectories=replace(held, controls=factor * held.controls))


FORGED = {
    "moved by 5 m": (
        lambda: with_states(moved),
        r"at the start of the plan rigid_body.x = 5 m; must be 0 m, as in the mission",
    ),
    "bent by 5 m on the way": (
        lambda: with_states(bent),
        r"flown again, the plan is [\d.]+ m off in rigid_body.x at [\d.]+ s; must be at most",
    ),
    "another end": (
        lambda: with_states(sunk),
        r"at the end of the plan rigid_body.z = 0 m; must be 0.5 m, as in the mission",
    ),
    "a horizon of a nanosecond": (
        lambda: replace(plan(), trajectories=replace(plan().trajectories, horizon=(0.0, 1e-9))),
        r"horizon = 0 to 1e-09 s; must be 0 to 4 s, as in the mission",
    ),
    "other controls": (lambda: with_controls(1.1), r"flown again, the plan is [\d.]+"),
    "half the energy": (
        lambda: replace(plan(), energy=plan().energy / 2),
        r"flown again, the plan has a share of the energy not accounted for of 1; must be at most",
    ),
    "a limit that it breaks": (
        lambda: replace(plan(), scenario=flights.scenario("paper_calm", *HOP, *SLOW)),
        r"flown again, the plan has a breach of limits.rotor_speed_limit\[\d\] of [\d.]+; must be",
    ),
    "a waypoint without a time": (
        lambda: replace(plan(), scenario=flights.scenario("paper_calm", *HOP, WAYPOINT)),
        r"passing_times_s has 0 times; must have a time within the flight for each of 1 waypoints",
    ),
    "a waypoint that it does not pass": (
        lambda: replace(
            plan(),
            scenario=flights.scenario("paper_calm", *HOP, WAYPOINT),
            passing_times_s=(2.0,),
        ),
        r"has a distance in m by which a waypoint is missed of 1; must be at most 0.0001",
    ),
    "a waypoint at another time": (
        lambda: replace(
            plan(),
            scenario=flights.scenario("paper_calm", *HOP, WAYPOINT),
            passing_times_s=(1.0,),
        ),
        r"mission.waypoints\[0\] is passed at 1 s; must be 2 s, as in the mission",
    ),
}
SLOW = ("limits.rotor_speed_max=913.0",)
WAYPOINT = "mission.waypoints=[{ position = [0.5, 1.0, 0.25], at = 2.0 }]"


@pytest.mark.lengthy
@pytest.mark.parametrize("name", FORGED)
def test_a_forged_plan_file_is_refused(tmp_path, capsys, name):
    forge, said = FORGED[name]
    file, out = tmp_path / "plan.npz", tmp_path / "out.csv"
    forge().save(file)
    assert Plan.load(file).is_verified
    assert main(["export", str(file), "--to", "px4", "--out", str(out)]) == ExitCode.BAD_INPUT
    (line,) = capsys.readouterr().err.splitlines()
    with pytest.raises(ScenarioError, match=said):
        raise ScenarioError(line)
    assert line.endswith("solve the scenario again.")
    assert not out.exists()


def test_a_plan_as_it_was_saved_is_exported_as_it_was_solved(tmp_path):
    plan().save(tmp_path / "plan.npz")
    export_plan(tmp_path / "plan.npz", "px4", tmp_path / "loaded.csv")
    export_plan(plan(), "px4", tmp_path / "solved.csv")
    assert (tmp_path / "loaded.csv").read_bytes() == (tmp_path / "solved.csv").read_bytes()


def report_of(folder, name, change):
    """Write a committed report with its plan's table changed."""
    copy(REPORTS / name / "summary.json", folder)
    change(pd.read_csv(REPORTS / name / "plan.csv")).to_csv(folder / "plan.csv", index=False)
    return str(folder)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda f: f.assign(y_m=f.y_m + 5.0), "at the start of the plan rigid_body.y = 5 m; must"),
        (lambda f: f.assign(time_s=1e-10 * f.time_s), "horizon = 0 to 1e-09 s; must be 0 to 10 s"),
        (
            lambda f: f.assign(y_m=f.y_m + 5.0 * np.sin(np.pi * f.time_s / 10.0) ** 2),
            "off in rigid_body.y at",
        ),
        (
            lambda f: f.drop(columns="alpha_2_rad_per_s2"),
            "the plan has no rotors.alpha[2], without",
        ),
    ],
)
def test_a_forged_report_is_refused(tmp_path, capsys, change, said):
    folder = report_of(tmp_path, "paper_calm", change)
    out = tmp_path / "out.csv"
    assert main(["export", folder, "--to", "px4", "--out", str(out)]) == ExitCode.BAD_INPUT
    (line,) = capsys.readouterr().err.splitlines()
    assert said in line
    assert not out.exists()


@pytest.mark.parametrize(
    "name",
    [
        "paper_free",
        "paper_wind",
        *(pytest.param(n, marks=pytest.mark.slow) for n in ("delivery", "inspection", "parcel")),
        *(pytest.param(n, marks=pytest.mark.slow) for n in ("ridge", "street", "wind_untold")),
    ],
)
def test_every_committed_report_is_confirmed(tmp_path, name):
    out = tmp_path / "out.csv"
    assert main(["export", str(REPORTS / name), "--to", "px4", "--out", str(out)]) == 0
    assert out.exists()


@pytest.mark.lengthy
def test_a_model_of_ones_own_is_flown_where_code_is_allowed(tmp_path, capsys):
    (tmp_path / "own.py").write_text(
        "from pyomo_quad import build_model\n"
        "def build(scenario):\n"
        "    return build_model(scenario)\n"
    )
    scenario = load_scenario(write_scenario(tmp_path, f'model = "{tmp_path}/own.py:build"'), HOP)
    solve_scenario(scenario, builder=build_model).save(tmp_path / "plan.npz")
    out = tmp_path / "out.csv"
    command = ["export", str(tmp_path / "plan.npz"), "--to", "px4", "--out", str(out)]
    assert main(command) == ExitCode.BAD_INPUT
    assert "runs code from a file; allow it with --allow-code." in capsys.readouterr().err
    assert not out.exists()
    assert main([*command, "--allow-code"]) == ExitCode.VERIFIED
    assert out.exists()


def test_a_summary_without_its_mission_is_refused(tmp_path):
    folder = report_of(tmp_path, "paper_calm", lambda frame: frame)
    summary = json.loads((tmp_path / "summary.json").read_text())
    summary["scenario_resolved"]["vehicle"]["mass"] = -1.0
    (tmp_path / "summary.json").write_text(json.dumps(summary))
    with pytest.raises(ScenarioError, match="has no mission with which to fly the plan again"):
        export_plan(folder, "px4", tmp_path / "out.csv")
