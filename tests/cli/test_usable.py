"""`pyomo-quad solve` that is stopped with a usable plan, and continued."""

import json
import math
import signal
from contextlib import nullcontext
from pathlib import Path

import pytest

from pyomo_quad.cli import main, solving
from pyomo_quad.cli.endings import ExitCode
from pyomo_quad.flight import Plan, PlanStatus, margin_search, search
from tests.command import PAPER_CALM

STRANGER = Path(__file__).parent / "stranger" / "stranger.toml"
NO_FIGURES = ("--figures", "none")


@pytest.mark.lengthy
def test_ctrl_c_leaves_a_usable_plan_that_is_refined_later(tmp_path, monkeypatch, capsys):
    def stop(state):
        if state.has_usable:
            signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(search, "_PATIENCE", 0.0)
    monkeypatch.setattr(search, "_SHARE", math.inf)  # else a flight puts off the next one
    folder, later = tmp_path / "report", tmp_path / "later"
    with monkeypatch.context() as stopped:
        stopped.setattr(solving, "live_line", lambda **_: nullcontext(stop))
        # From a coarse mesh, a finer one still has iterations to go when the first plan is usable.
        coarse = "--set=solver.elements=5"
        said = main(["solve", PAPER_CALM, coarse, "--out", str(folder), *NO_FIGURES])
    assert said == ExitCode.VERIFIED
    assert "paper_calm: usable: Flown in open loop" in capsys.readouterr().err
    summary = json.loads((folder / "summary.json").read_text())
    assert (summary["status"], summary["accuracy"]["asked"]) == ("usable", "proof")
    assert summary["terminal_miss_m"] <= 0.1
    assert "**Usable.**" in (folder / "report.md").read_text(encoding="utf-8")
    again = ["solve", "--continue", str(folder), "--out", str(later), *NO_FIGURES]
    assert main(again) == ExitCode.VERIFIED
    refined = json.loads((later / "summary.json").read_text())
    assert refined["accuracy"]["reached"] == "proof"
    assert refined["energy_J"] == pytest.approx(709.65279, rel=1e-6)
    capsys.readouterr()
    assert main(["solve", "--continue", str(later)]) == ExitCode.BAD_INPUT
    assert (
        "accuracy = proof was reached; --continue needs a higher accuracy"
        in capsys.readouterr().err
    )


def interrupted(monkeypatch, is_time):
    """Press Ctrl-C once when the state of a search says so."""
    states = []

    def stop(state):
        states.append(state)
        if is_time(states):
            signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(solving, "live_line", lambda **_: nullcontext(stop))


@pytest.mark.slow
def test_ctrl_c_while_a_risk_is_searched_for_leaves_the_plan_found_so_far(tmp_path, monkeypatch):
    planned = margin_search.MarginSearch._planned

    def stopped(*asked):
        signal.raise_signal(signal.SIGINT)
        return planned(*asked)

    monkeypatch.setattr(margin_search.MarginSearch, "_planned", stopped)
    monkeypatch.setattr(margin_search, "_FLIGHTS", 20)
    out = tmp_path / "report"
    hop = ("--set=mission.goal.position=[2.0, 0.0, 1.0]", "--set=mission.duration=4.0")
    asked = ["solve", PAPER_CALM, "--out", str(out), *NO_FIGURES, *hop, "--set=mission.risk=0.01"]
    assert main(asked) == ExitCode.RISK_NOT_HAD
    plan = Plan.load(out / "plan.npz")
    assert plan.status is PlanStatus.VERIFIED
    assert plan.risk.stopped == "the search was stopped"
    assert plan.risk.asked == 0.01
    assert plan.energy == pytest.approx(plan.risk.paper_energy_J)


@pytest.mark.slow
def test_ctrl_c_in_the_middle_of_a_mission_past_waypoints_leaves_a_usable_plan(
    tmp_path, monkeypatch
):
    interrupted(monkeypatch, lambda states: states[-1].has_usable)
    out = tmp_path / "report"
    assert main(["solve", str(STRANGER), "--out", str(out), *NO_FIGURES]) == ExitCode.VERIFIED
    plan = Plan.load(out / "plan.npz")
    assert plan.status is PlanStatus.USABLE
    assert len(plan.passing_times_s) == 3
    assert plan.verification.terminal_miss_m <= 0.5


def test_a_solve_needs_a_scenario_or_a_plan_and_not_both(tmp_path, capsys):
    assert main(["solve"]) == ExitCode.BAD_INPUT
    assert "give a SCENARIO, or --continue RUN." in capsys.readouterr().err
    assert main(["solve", PAPER_CALM, "--continue", str(tmp_path)]) == ExitCode.BAD_INPUT
    assert main(["solve", "--continue", str(tmp_path)]) == ExitCode.BAD_INPUT


@pytest.mark.slow
def test_a_strangers_delivery_stopped_after_20_s_is_usable(tmp_path):
    out = tmp_path / "report"
    command = ["solve", str(STRANGER), "--set=solver.time_limit=20", "--out", str(out), *NO_FIGURES]
    assert main(command) == ExitCode.VERIFIED
    summary = json.loads((out / "summary.json").read_text())
    assert summary["status"] == "usable"
    assert summary["terminal_miss_m"] <= 0.5
    assert "solver.time_limit = 20 s" in summary["solver"]["message"]
    assert "**Usable.**" in (out / "report.md").read_text(encoding="utf-8")
