"""`pyomo-quad fly` through the command's own entry: status, files, words."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from pyomo_quad.cli import main
from pyomo_quad.cli.endings import ExitCode
from pyomo_quad.flight import baselines
from pyomo_quad.flight.columns import COLUMNS, TIME
from pyomo_quad.flight.flight import ARRIVAL_DISTANCE_M, ARRIVAL_SPEED_M_PER_S
from pyomo_quad.flight.routes import SETTLINGS_S, speed_profile
from tests.command import IMPOSSIBLE, PAPER_CALM, QUICK


def test_a_quintic_is_flown_and_written(tmp_path, capsys):
    out = tmp_path / "flight"
    assert main(["fly", PAPER_CALM, *QUICK, "--out", str(out)]) == ExitCode.VERIFIED
    assert "paper_calm: adaptive/quintic arrived, " in capsys.readouterr().out
    frame = pd.read_csv(out / "flight.csv")
    assert list(frame) == [TIME, *(column.name for column in COLUMNS)]
    summary = json.loads((out / "summary.json").read_text())
    assert (summary["flight"], summary["arrived"]) == ("adaptive/quintic", True)
    assert frame["energy_J"].iloc[-1] == pytest.approx(summary["energy_J"], rel=1e-11)
    assert frame["x_m"].iloc[-1] == pytest.approx(1.0, abs=0.02)


@pytest.mark.lengthy
def test_a_cruise_waits_no_longer_than_until_it_has_arrived(tmp_path, capsys):
    # Brisk enough to overshoot; the time of the mission is over before the goal is reached.
    brisk = (
        "mission.duration=3.0",
        "baseline.cruise_speeds=[8.0]",
        "baseline.cruise_acceleration=8.0",
    )
    cruising = ["--reference", "cruise", *(f"--set={field}" for field in brisk), "--json"]
    command = ["fly", PAPER_CALM, *cruising, "--out", str(tmp_path / "flight")]
    assert main(command) == ExitCode.VERIFIED
    duration = json.loads(capsys.readouterr().out)["duration_s"]
    frame = pd.read_csv(tmp_path / "flight" / "flight.csv").set_index(TIME)
    off = np.linalg.norm(frame[["x_m", "y_m", "z_m"]] - [6.0, 7.0, 8.0], axis=1)
    moving = np.linalg.norm(frame[["vx_m_per_s", "vy_m_per_s", "vz_m_per_s"]], axis=1)
    has_arrived = (off <= ARRIVAL_DISTANCE_M) & (moving <= ARRIVAL_SPEED_M_PER_S)
    assert has_arrived[-1]
    waited = duration - speed_profile(149.0**0.5, 8.0, 8.0, 4.0).times[-1]
    assert 0.2 < waited <= SETTLINGS_S[-1] + 1e-9
    # Ended a little earlier, this same flight would not have been there.
    assert not has_arrived[np.searchsorted(frame.index, duration - 0.1)]


def test_the_plan_in_open_loop_as_json_in_a_folder_of_its_own(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    command = ["fly", PAPER_CALM, *QUICK, "--controller", "open_loop", "--json"]
    assert main(command) == ExitCode.VERIFIED
    summary = json.loads(capsys.readouterr().out)
    assert summary["flight"] == "open_loop/plan"
    assert summary["terminal_miss_m"] < 1e-4
    assert (tmp_path / "reports" / "paper_calm-open_loop-plan" / "flight.csv").is_file()


def test_open_loop_follows_no_reference(capsys):
    command = ["fly", PAPER_CALM, "--controller", "open_loop", "--reference", "step"]
    assert main(command) == ExitCode.BAD_INPUT
    assert "follows no --reference; leave it out" in capsys.readouterr().err


def test_an_unknown_reference_is_refused_with_what_is_allowed(capsys):
    assert main(["fly", PAPER_CALM, "--reference", "circle"]) == ExitCode.BAD_INPUT
    assert "minimum_snap" in capsys.readouterr().err


@pytest.mark.slow
def test_without_a_plan_nothing_is_written(tmp_path, capsys):
    out = tmp_path / "flight"
    command = ["fly", PAPER_CALM, *IMPOSSIBLE, "--reference", "plan", "--quiet"]
    assert main([*command, "--out", str(out)]) == ExitCode.NOT_SOLVED
    assert "paper_calm: no plan to follow, " in capsys.readouterr().err
    assert not out.exists()


def test_a_flight_out_of_control_is_one_line_and_writes_nothing(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(baselines, "_MOST_EVALUATIONS_PER_SECOND", 5)
    out = tmp_path / "flight"
    assert main(["fly", PAPER_CALM, *QUICK, "--out", str(out)]) == ExitCode.NOT_SOLVED
    said = capsys.readouterr()
    assert said.err.startswith("paper_calm: controlled flight: out of control at ")
    assert (said.err.count("\n"), out.exists()) == (1, False)


@pytest.mark.lengthy
def test_the_rest_of_the_mission_is_planned_again(tmp_path, capsys):
    out = tmp_path / "flight"
    command = ["fly", PAPER_CALM, *QUICK, "--controller", "mpc", "--knowledge", "told"]
    coarse = ["--set=baseline.mpc.interval=0.8", "--out", str(out)]
    assert main([*command, *coarse]) == ExitCode.VERIFIED
    assert "paper_calm: mpc/told arrived, " in capsys.readouterr().out
    solves = json.loads((out / "summary.json").read_text())["resolves"]
    assert [solve["t"] for solve in solves] == pytest.approx([0.8, 1.6, 2.4])
    assert all(solve["is_converged"] and not solve["is_late"] for solve in solves)


def test_planning_again_follows_no_reference(capsys):
    command = ["fly", PAPER_CALM, "--controller", "mpc", "--reference", "quintic"]
    assert main(command) == ExitCode.BAD_INPUT
    assert "follows no --reference; leave it out" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("setting", "found"),
    [
        ("baseline.mpc.interval=10.0", "interval = 10 s; must be below mission.duration = 10 s"),
        ("mission.duration=0.1", "interval = 0.2 s; must be below mission.duration = 0.1 s"),
    ],
)
def test_an_interval_beyond_the_mission_is_one_line_and_writes_nothing(
    setting, found, tmp_path, capsys
):
    out = tmp_path / "flight"
    command = ["fly", PAPER_CALM, "--controller", "mpc", f"--set={setting}"]
    assert main([*command, "--out", str(out)]) == ExitCode.BAD_INPUT
    said = capsys.readouterr().err
    assert f"baseline.mpc.{found}" in said
    assert (said.count("\n"), list(tmp_path.iterdir())) == (1, [])


@pytest.mark.lengthy
def test_a_flight_planned_again_says_why_it_is_not_confirmed(tmp_path, capsys, monkeypatch):
    # Planned again a hundred times a second, a flight misses the usual tolerance as this one does.
    monkeypatch.setattr(baselines, "_AGREEING", replace(baselines._AGREEING, energy=1e-15))
    command = ["fly", PAPER_CALM, *QUICK, "--controller", "mpc", "--knowledge", "told"]
    coarse = ["--set=baseline.mpc.interval=0.8", "--out", str(tmp_path / "out")]
    assert main([*command, *coarse]) == ExitCode.NOT_VERIFIED
    said = capsys.readouterr().out.splitlines()[0]
    doubt = json.loads((tmp_path / "out" / "summary.json").read_text())["doubt"]
    assert said.endswith(f"not confirmed by a second integrator: {doubt}.")
    assert " J in the energy spent; must be at most " in doubt
    assert "a longer baseline.mpc.interval makes fewer" in doubt


LIGHT = "--set=wind.turbulence.intensity=light"


@pytest.mark.lengthy
def test_a_plan_is_flown_many_times_from_its_report(tmp_path, capsys):
    plan, out = tmp_path / "plan", tmp_path / "flown"
    drag = "--set=wind.coupling=drag"
    solve = ["solve", PAPER_CALM, *QUICK, drag, "--figures", "none", "--quiet"]
    assert main([*solve, "--out", str(plan)]) == ExitCode.VERIFIED
    command = ["fly", str(plan), "--flights", "6", "--seed", "3", LIGHT, "--cruise", "2"]
    assert main([*command, "--figures", "png", "--out", str(out)]) == ExitCode.VERIFIED
    said = capsys.readouterr().out
    assert " of 6 flights arrived and kept every limit." in said
    assert "Saving against adaptive/cruise 2 m/s in the same winds: median " in said
    summary = json.loads((out / "summary.json").read_text())
    table = pd.read_csv(out / "flights.csv")
    assert summary["held"] == table["held"].sum()
    assert summary["energy_J"]["50_percent"] == pytest.approx(table["energy_J"].median())
    assert sorted(f.name for f in (out / "figures").iterdir()) == [
        "bands.png",
        "energy.png",
        "paths.png",
    ]
    assert "arrived and kept every limit" in (out / "report.md").read_text()


@pytest.mark.parametrize(
    ("options", "found"),
    [
        (["--flights", "5"], "all 5 flights would be the same, because nothing in the scenario is"),
        (
            ["--flights", "5", "--controller", "mpc"],
            "--flights simulates only the declared vehicle",
        ),
        (
            ["--flights", "5", "--reference", "step"],
            "--flights follows the plan and takes no other",
        ),
    ],
)
def test_flights_that_cannot_be_many_are_one_line(options, found, tmp_path, capsys):
    command = ["fly", PAPER_CALM, *QUICK, "--quiet", "--out", str(tmp_path / "out")]
    assert main([*command, *options]) == ExitCode.BAD_INPUT
    said = capsys.readouterr().err
    assert found in said
    assert said.count("\n") == 1


def test_a_scenario_file_with_another_ending_is_a_scenario_for_many_flights_too(tmp_path, capsys):
    told = tmp_path / "mission.txt"
    told.write_text(Path(PAPER_CALM).read_text())
    assert main(["fly", str(told), *QUICK, "--quiet", "--flights", "5"]) == ExitCode.BAD_INPUT
    assert "all 5 flights would be the same" in capsys.readouterr().err


def test_a_plan_needs_a_count_of_flights(tmp_path, capsys):
    assert main(["fly", str(tmp_path)]) == ExitCode.BAD_INPUT
    assert "is a plan, not a scenario; add --flights 1000" in capsys.readouterr().err
