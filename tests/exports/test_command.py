"""`pyomo-quad export` through the command's own entry: one line for bad input, nothing written."""

import json
import sys

import numpy as np
import pytest

from pyomo_quad.cli import main
from pyomo_quad.cli.endings import ExitCode
from pyomo_quad.cli.missions import Reader
from pyomo_quad.exports import Format, Motion
from pyomo_quad.exports.formats import offboard, write_bag
from pyomo_quad.exports.ground_station import thin
from pyomo_quad.exports.motion import fit_pieces
from pyomo_quad.flight.flight import POSITION_STATES, VELOCITY_STATES
from pyomo_quad.scenario import ScenarioError, load_scenario
from tests.command import SCENARIOS

REPORT = str(SCENARIOS.parent / "reports" / "paper_calm")


def test_a_committed_report_is_exported_under_its_own_name(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["export", REPORT, "--to", "px4"]) == ExitCode.VERIFIED
    assert "Written to paper_calm_px4.csv: 501 setpoints, at most" in capsys.readouterr().out
    command = ["export", REPORT, "--to", "qgroundcontrol", "--origin", "-12,-77,150", "--json"]
    assert main(command) == ExitCode.VERIFIED
    said = json.loads(capsys.readouterr().out)
    assert (said["path"], said["what"]) == ("paper_calm.plan", "waypoints")
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "paper_calm.plan",
        "paper_calm_px4.csv",
    ]


def test_the_export_of_a_paper_plan_says_that_it_leaves_nothing_to_the_controller(
    tmp_path, capsys, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    assert main(["export", REPORT, "--to", "px4"]) == ExitCode.VERIFIED
    warned = capsys.readouterr().err.splitlines()
    assert len(warned) == 1
    assert "the plan has no margins: it may fly exactly at its limits" in warned[0]
    assert main(["export", REPORT, "--to", "px4", "--as-planned"]) == ExitCode.VERIFIED
    assert capsys.readouterr().err == ""


def test_the_command_names_every_format():
    assert [reader.value for reader in Reader] == [reader.value for reader in Format]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--to", "qgroundcontrol"], "needs --origin LAT,LON,ALT"),
        (
            ["--to", "qgroundcontrol", "--origin", "91,8,400"],
            "--origin: latitude = 91 deg; must be from -90 to 90 deg",
        ),
        (
            ["--to", "qgroundcontrol", "--origin", "47,-180.5,400"],
            "--origin: longitude = -180.5 deg; must be from -180 to 180 deg",
        ),
        (
            ["--to", "qgroundcontrol", "--origin", "47,8,1e6"],
            "--origin: altitude = 1e+06 m; must be from -500 to 9000 m",
        ),
        (["--to", "qgroundcontrol", "--origin", "47,8,nan"], "altitude = nan m"),
        (["--to", "qgroundcontrol", "--origin", "47,8"], 'origin "47,8": must be LAT,LON,ALT'),
        (["--to", "qgroundcontrol", "--origin", "a,b,c"], "must be LAT,LON,ALT"),
        (["--to", "px4", "--origin", "47,8,400"], "--origin is not an option of px4"),
        (["--to", "px4", "--path-error", "0.1"], "only of qgroundcontrol and missionplanner"),
        (["--to", "crazyflie", "--rate", "10"], "--rate is not an option of crazyflie"),
        (
            ["--to", "crazyflie", "--path-error", "1e-6"],
            "31 pieces of degree 7, the most that the format holds, come within",
        ),
        (["--to", "px4", "--rate", "2"], "PX4's offboard mode must have more than 2 Hz"),
        (["--to", "px4", "--rate", "nan"], "--rate = nan Hz"),
        (["--to", "ros2", "--rate", "0"], "--rate = 0 Hz; must be above 0"),
        (["--to", "rotorpy", "--path-error", "0"], "--path-error = 0 m; must be from 1e-06 to"),
        (["--to", "rotorpy", "--path-error", "nan"], "--path-error = nan m"),
        (["--to", "airsim"], "is not one of"),
    ],
)
def test_bad_input_is_one_line_and_nothing_written(tmp_path, capsys, monkeypatch, arguments, said):
    monkeypatch.chdir(tmp_path)
    assert main(["export", REPORT, *arguments]) == ExitCode.BAD_INPUT
    complaint = capsys.readouterr().err
    assert said in complaint
    assert complaint.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_the_extra_to_install_is_named(tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "rosbags.rosbag2", None)
    out = tmp_path / "bag"
    assert main(["export", REPORT, "--to", "ros2", "--out", str(out)]) == ExitCode.BAD_INPUT
    complaint = capsys.readouterr().err
    assert "rosbags is not installed; install it with pip install 'pyomo_quad[ros]'" in complaint
    assert complaint.count("\n") == 1
    assert not list(tmp_path.iterdir())


def damaged(folder, *, summary=None, table=None):
    """Write what looks like a report."""
    good = {"scenario": "hop", "status": "verified", "mesh": {"degrees": [1]}}
    rows = "time_s,x_m,y_m,z_m,vx_m_per_s,vy_m_per_s,vz_m_per_s\n"
    rows += "0,0,0,0,0,0,0\n4,1,0,0,0,0,0\n"
    folder.mkdir()
    (folder / "summary.json").write_text(json.dumps(good) if summary is None else summary)
    (folder / "plan.csv").write_text(rows if table is None else table)
    return str(folder)


@pytest.mark.parametrize(
    ("parts", "said"),
    [
        ({"summary": "{"}, "summary.json: is not valid JSON"),
        ({"summary": "[1]"}, "is not the summary of a solve"),
        ({"summary": '{"runs": []}'}, "is not the summary of a solve"),
        (
            {"summary": '{"scenario": "hop", "status": "infeasible", "mesh": {"degrees": [1]}}'},
            'hop: status = "infeasible"; must be verified',
        ),
        ({"table": "x_m\n0\n"}, "has no column time_s"),
        ({"table": "time_s,x_m\n0,a\n1,b\n"}, "has text among its numbers"),
        ({"table": "time_s,x_m\n0,0\n1,nan\n"}, "is not a flight with finite numbers"),
        ({"table": "time_s,x_m\n0,0\n0,1\n"}, "does not increase"),
        (
            {"table": "time_s,x_m\n0,0\n1,1\n2,2\n"},
            "has 3 rows instead of one for each of the mesh",
        ),
        ({"table": ""}, "is not a CSV table"),
        ({}, "summary.json: has no mission with which to fly the plan again; solve the scenario"),
    ],
)
def test_a_damaged_report_is_refused(tmp_path, capsys, parts, said):
    folder = damaged(tmp_path / "report", **parts)
    out = tmp_path / "x.plan"
    command = ["export", folder, "--to", "qgroundcontrol", "--origin", "1,2,3", "--out", str(out)]
    assert main(command) == ExitCode.BAD_INPUT
    complaint = capsys.readouterr().err
    assert said in complaint
    assert complaint.count("\n") == 1
    assert not out.exists()


@pytest.mark.parametrize(
    ("write", "lacking"),
    [
        (lambda bare, _: offboard(bare, 50.0), "rigid_body.psi, which PX4's offboard mode needs"),
        (lambda bare, out: write_bag(bare, 50.0, out), "rigid_body.phi, which a ROS 2 trajectory"),
        (lambda bare, _: fit_pieces(bare, 0.01, 31), "rigid_body.psi, which a polynomial needs"),
    ],
)
def test_a_plan_without_attitude_serves_formats_that_need_none(tmp_path, write, lacking):
    bare = Motion(
        name="hop",
        mission=load_scenario(SCENARIOS / "paper_calm.toml"),
        times=np.array([0.0, 4.0]),
        states=np.array([[0.0] * 6, [1.0] + [0.0] * 5]),
        names=(*POSITION_STATES, *VELOCITY_STATES),
        degrees=(1,),
    )
    assert len(thin(bare, 0.1).times) == 2
    with pytest.raises(ScenarioError, match=f"hop: the plan has no {lacking}"):
        write(bare, tmp_path / "out")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("place", ["nowhere", "nowhere/plan.npz"])
def test_a_plan_that_is_not_there(tmp_path, capsys, place):
    assert main(["export", str(tmp_path / place), "--to", "px4"]) == ExitCode.BAD_INPUT
    assert "cannot be read" in capsys.readouterr().err


def test_a_folder_is_no_file_to_write(tmp_path, capsys):
    assert main(["export", REPORT, "--to", "px4", "--out", str(tmp_path)]) == ExitCode.FAULT
    assert "cannot be written (Is a directory)" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
