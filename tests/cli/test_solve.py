"""`pyomo-quad solve` through the real command: status, files and what they hold."""

import json
from math import sqrt

import pandas as pd
import pytest

from pyomo_quad.cli import main
from pyomo_quad.cli.endings import ExitCode
from pyomo_quad.flight.columns import COLUMNS, TIME
from tests.command import IMPOSSIBLE, PAPER_CALM, QUICK, run_here, solve

SUMMARY_KEYS = [
    "scenario",
    "status",
    "verified",
    "energy_J",
    "duration_s",
    "passing_times_s",
    "hover_energy_J",
    "terminal_miss_m",
    "max_violation",
    "solver",
    "mesh",
    "wall_s",
    "versions",
    "scenario_resolved",
]
# By hand, 8 m up: full thrust, 4 kb w^2 at 10 000 rpm, then free fall, at 9.81 m/s^2.
SHORTEST_WITH_INSTANT_ROTORS_S = sqrt(2 * 8 / 9.81 * (1 + 1 / ((1047.2 / 912.32) ** 2 - 1)))
# By hand: four motors at 912.32 rad/s with 1.802160 A at 9.830057 V, for 10 s.
HOVER_ENERGY_J = 4 * 1.8021601 * 9.8300573 * 10.0


@pytest.fixture(scope="module")
def calm(tmp_path_factory):
    """The paper's calm mission."""
    return run_here("solve", PAPER_CALM, out=tmp_path_factory.mktemp("calm") / "report")


@pytest.fixture(scope="module")
def impossible(tmp_path_factory):
    """A mission that cannot be flown: 8 m up in 0.3 s."""
    folder = tmp_path_factory.mktemp("impossible") / "report"
    return run_here("solve", PAPER_CALM, *IMPOSSIBLE, "--json", "--figures", "none", out=folder)


def test_paper_calm_is_verified(calm):
    assert (calm.status, calm.complaints) == (ExitCode.VERIFIED, [])
    summary = calm.summary
    assert set(SUMMARY_KEYS) <= set(summary)
    assert (summary["status"], summary["verified"]) == ("verified", True)
    assert summary["terminal_miss_m"] < 1e-4
    assert summary["hover_energy_J"] == pytest.approx(HOVER_ENERGY_J, rel=1e-6)
    assert summary["energy_J"] > summary["hover_energy_J"]
    assert f"{summary['energy_J']:.3f} J" in calm.out


@pytest.mark.lengthy
def test_a_free_duration_is_in_the_summary_and_its_price_is_not_in_the_energy(tmp_path):
    fields = ("duration='free'", "price_of_time=500.0", "goal.position=[0.0, 0.0, 2.0]")
    coarse = ("--set=solver.elements=12", "--set=solver.max_refinements=0")
    options = (*(f"--set=mission.{field}" for field in fields), *coarse, "--figures=none")
    assert main(["solve", PAPER_CALM, *options, "--out", str(tmp_path)]) == ExitCode.NOT_VERIFIED
    summary = json.loads((tmp_path / "summary.json").read_text())
    frame = pd.read_csv(tmp_path / "plan.csv")
    # Tables have twelve digits: half a unit of the last is up to 5e-12 of the number.
    assert frame[TIME].iloc[-1] == pytest.approx(summary["duration_s"], rel=5e-12)
    assert frame["energy_J"].iloc[-1] == pytest.approx(summary["energy_J"], rel=5e-12)
    assert summary["scenario_resolved"]["mission"]["duration"] == "free"
    assert "s, chosen for the least energy, hover to hover" in (tmp_path / "report.md").read_text()


def test_summary_tells_the_effort_and_the_input(calm):
    summary = calm.summary
    assert set(summary["wall_s"]) == {"import", "build", "compile", "solve", "verify", "report"}
    assert summary["solver"]["iterations"] > 0
    assert summary["solver"]["status"] == "converged"
    mesh = summary["mesh"]
    assert (len(mesh["degrees"]), sum(mesh["degrees"])) == (mesh["elements"], mesh["points"])
    assert {"pyomo_quad", "python", "pyomo", "casadi", "cyipopt"} <= set(summary["versions"])
    assert "unknown" not in summary["versions"].values()
    assert summary["scenario_resolved"]["mission"]["duration"] == 10.0


def test_plan_has_one_row_per_node_and_the_promised_columns(calm):
    frame = pd.read_csv(calm.folder / "plan.csv")
    assert list(frame.columns) == [TIME, *(column.name for column in COLUMNS)]
    assert len(frame) == calm.summary["mesh"]["points"] + 1
    # Tables have twelve digits.
    assert frame["energy_J"].iloc[-1] == pytest.approx(calm.summary["energy_J"], rel=5e-12)
    assert frame[["x_m", "y_m", "z_m"]].iloc[-1].tolist() == pytest.approx([6, 7, 8], abs=1e-9)


@pytest.mark.lengthy
def test_quiet_run_with_even_rows_in_the_default_folder(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    options = ("--quiet", "--rate", "50", "--set=battery.capacity=0.005", "--figures", "none")
    # A flight beyond an empty pack is solved, and cannot be flown.
    assert main(["solve", PAPER_CALM, *QUICK, *options]) == ExitCode.NOT_VERIFIED
    said = capsys.readouterr()
    assert said.out == ""
    verdict, warning = said.err.splitlines()
    assert verdict.startswith("paper_calm: solved, but not verified: ")
    assert warning.startswith("paper_calm: warning: battery phantom_2_pack, 3 x 1 cells: hovering")
    report = (tmp_path / "reports" / "paper_calm" / "report.md").read_text()
    assert "hovering for 4 s needs 0.0064" in report
    times = pd.read_csv(tmp_path / "reports" / "paper_calm" / "plan.csv")[TIME]
    assert len(times) == 4 * 50 + 1
    assert times.diff().dropna().to_numpy() == pytest.approx(1 / 50)


@pytest.mark.lengthy
def test_impossible_mission_is_infeasible(impossible):
    assert impossible.status == ExitCode.NOT_SOLVED
    assert impossible.summary["status"] == "infeasible"
    assert impossible.summary["verified"] is False
    assert impossible.summary["terminal_miss_m"] is None
    first, *_ = impossible.err.splitlines()
    assert first.startswith("paper_calm: infeasible: mission.duration = 0.3 s is 2.4")
    assert first.endswith(f"See {impossible.folder}.")


@pytest.mark.lengthy
def test_failure_is_explained_in_the_summary(impossible):
    failure = impossible.summary["failure"]
    assert failure["shortest_duration_s"] > SHORTEST_WITH_INSTANT_ROTORS_S
    assert len(failure["worst_equations"]) == 10
    assert failure["worst_equations"][0]["name"] == "rigid_body.z_kinematics"
    assert failure["worst_equations"][0]["unit"] == "m/s"
    assert all(cause in impossible.err for cause in failure["causes"])


@pytest.mark.lengthy
def test_json_is_the_summary(impossible):
    assert json.loads(impossible.out) == impossible.summary


@pytest.mark.lengthy
def test_best_iterate_of_a_failure_is_marked(impossible):
    frame = pd.read_csv(impossible.folder / "plan.csv")
    assert set(frame["status"]) == {"infeasible"}


def test_report_shows_the_flight(calm):
    report = calm.read("report.md")
    assert report.startswith("# Test 1 of the paper")
    assert f"{calm.summary['energy_J']:.2f} J" in report
    drawn = {file.name for file in (calm.folder / "figures").iterdir()}
    for figure in ("states", "controls", "path", "battery"):
        assert f"{figure}.svg" in drawn
    assert "wind.svg" not in drawn  # no wind blows


@pytest.mark.lengthy
def test_report_of_a_failure_is_headed_as_one(impossible):
    assert impossible.read("report.md").startswith("# Failed, infeasible: ")


@pytest.mark.slow
def test_refinement_that_gives_up_says_so(tmp_path, capsys):
    folder = tmp_path / "report"
    coarse = ("solver.elements=3", "solver.degree=3", "solver.max_refinements=0")
    options = (*QUICK, *(f"--set={field}" for field in coarse), "--out", str(folder))
    assert main(["solve", PAPER_CALM, *options]) == ExitCode.NOT_VERIFIED
    summary = json.loads((folder / "summary.json").read_text())
    assert (summary["status"], summary["verified"]) == ("solved", False)
    assert summary["solver"]["status"] == "tolerance_not_met"
    said = capsys.readouterr().err
    assert said.startswith("paper_calm: solved, but not verified: refinement stopped")


@pytest.mark.slow
def test_two_runs_write_the_same_tables_and_documents(tmp_path, calm):
    # Of all that is written only summary.json knows the time; this one has a process of its own.
    again = solve(tmp_path / "report", "--quiet")
    names = sorted(str(file.relative_to(calm.folder)) for file in calm.folder.rglob("*"))
    assert names == sorted(str(file.relative_to(again.folder)) for file in again.folder.rglob("*"))
    texts = [name for name in names if name.endswith((".csv", ".md", ".html", ".svg"))]
    assert {"plan.csv", "report.md", "figures/states.svg"} <= set(texts)
    for name in texts:
        assert again.read(name) == calm.read(name), name
