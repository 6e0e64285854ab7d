"""`pyomo-quad check` and `library` through the command's own entry."""

import json
import subprocess
import sys

import pytest

from pyomo_quad.cli import main
from pyomo_quad.cli.endings import ExitCode
from pyomo_quad.scenario.tables import Solver
from pyomo_quad.version import __version__
from tests.scenario_files import write_scenario


@pytest.mark.lengthy
def test_check_shows_value_unit_and_origin(tmp_path, capsys):
    file = write_scenario(tmp_path, "vehicle.payload = 0.1")
    assert main(["check", str(file), "--set", "gravity=9.8"]) == ExitCode.VERIFIED
    rows = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert ["vehicle.payload", "0.1", "kg", "scenario"] in [row[:4] for row in rows]
    assert ["gravity", "9.8", "m/s^2", "--set"] in [row[:4] for row in rows]
    assert ["vehicle.mass", "1.3", "kg", "library", "dji_phantom_2"] in [row[:5] for row in rows]
    assert ["vehicle.payload", "0", "kg"] not in [row[:3] for row in rows]
    assert ["solver.max_iterations", str(Solver().max_iterations), "default"] in [
        row[:3] for row in rows
    ]


def test_check_counts_the_four_controls_and_checks_units(tmp_path, capsys):
    assert main(["check", str(write_scenario(tmp_path))]) == ExitCode.VERIFIED
    said = capsys.readouterr().out
    assert "Degrees of freedom over time (controls): 4." in said
    assert "Units: consistent in every declared relation." in said


@pytest.mark.lengthy
def test_check_estimates_the_effort_and_says_that_it_is_rough(tmp_path, capsys):
    file = str(write_scenario(tmp_path))
    main(["check", file])
    said = " ".join(capsys.readouterr().out.split())
    assert "Effort: roughly " in said
    assert "a guess from counts that may be off by a factor of 3" in said
    main(["check", file, "--json"])
    effort = json.loads(capsys.readouterr().out)["effort"]
    assert effort["seconds"] > max(effort["features"].values(), default=0.0)


@pytest.mark.lengthy
def test_check_warns_of_what_the_mission_must_break(tmp_path, capsys):
    file = write_scenario(tmp_path)
    assert main(["check", str(file), "--set", "mission.duration=0.3"]) == ExitCode.VERIFIED
    said = capsys.readouterr().out
    assert "Mission, impossible: mission.duration = 0.3 s: to reach the goal and stop needs" in said
    assert main(["check", str(file)]) == ExitCode.VERIFIED
    assert "Mission: no impossible demand and no doubtful value found." in capsys.readouterr().out


def test_check_as_json(tmp_path, capsys):
    assert main(["check", str(write_scenario(tmp_path)), "--json"]) == ExitCode.VERIFIED
    said = json.loads(capsys.readouterr().out)
    assert said["scenario_resolved"]["mission"]["goal"]["position"] == [1.0, 2.0, 3.0]
    assert said["provenance"]["mission.duration"] == "scenario"
    assert said["model"]["degrees_of_freedom"] == 4
    assert said["findings"] == []


def test_check_quietly(tmp_path, capsys):
    assert main(["check", str(write_scenario(tmp_path)), "--quiet"]) == ExitCode.VERIFIED
    assert capsys.readouterr().out == ""


def test_library_lists_names(capsys):
    assert main(["library"]) == ExitCode.VERIFIED
    said = capsys.readouterr().out
    (vehicles,) = (line for line in said.splitlines() if line.startswith("vehicles: "))
    assert {"dji_matrice_100", "dji_phantom_2"} <= set(vehicles[len("vehicles: ") :].split(", "))
    assert "winds: calm, constant, paper_table_2\n" in said


def test_library_shows_each_source(capsys):
    assert main(["library", "vehicles", "dji_phantom_2", "--json"]) == ExitCode.VERIFIED
    fields = json.loads(capsys.readouterr().out)["fields"]
    assert fields["vehicle.mass"] == {"value": 1.3, "unit": "kg", "source": "section 4"}
    assert "slip" in fields["vehicle.torque_constant"]["source"]
    assert main(["library", "winds", "paper_table_2"]) == ExitCode.VERIFIED
    assert "[0.1, 0.25, 0.3]" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["library", "cars"], "library: unknown kind 'cars'; must be one of vehicles, batteries"),
        (["library", "winds", "clam"], "did you mean calm?"),
        (["chek"], "pyomo-quad: No such command 'chek'"),
        (["check"], "pyomo-quad: Missing argument 'SCENARIO'"),
        (["check", "a.toml", "--colour"], "pyomo-quad: No such option: --colour"),
        (["check", "no.toml"], "no.toml: cannot be read (No such file or directory); give an exi"),
    ],
)
def test_bad_command_line_is_one_line(arguments, message, capsys):
    assert main(arguments) == ExitCode.BAD_INPUT
    said = capsys.readouterr()
    assert message in said.err
    assert len(said.err.splitlines()) == 1
    assert said.out == ""


def test_code_needs_to_be_allowed(tmp_path, capsys):
    (tmp_path / "own.py").write_text("raise SystemExit('ran')")
    file = write_scenario(tmp_path, 'model = "own.py:build"')
    assert main(["check", str(file)]) == ExitCode.BAD_INPUT
    assert "--allow-code" in capsys.readouterr().err


def test_version(capsys):
    assert main(["--version"]) == ExitCode.VERIFIED
    assert capsys.readouterr().out == f"pyomo-quad {__version__}\n"


@pytest.mark.lengthy
def test_bad_input_leaves_no_traceback_in_a_real_process(tmp_path):
    file = write_scenario(tmp_path, "mission.duration = -10")
    done = subprocess.run(
        [sys.executable, "-m", "pyomo_quad", "check", str(file)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == ExitCode.BAD_INPUT
    assert done.stderr == f"{file}: mission.duration = -10 s; must be > 0.\n"


@pytest.mark.lengthy
def test_listing_the_library_imports_no_solver():
    program = "import sys; from pyomo_quad.cli import main; main(['library']); print(*sys.modules)"
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    slow = {"pyomo", "casadi", "cyipopt", "scipy", "pandas", "matplotlib", "plotly", "numpy"}
    assert slow.isdisjoint(done.stdout.split())
