"""Bad input through the real command: status 2, one line, nothing written; by file and by --set."""

import pytest

from pyomo_quad.cli import main
from pyomo_quad.cli.endings import ExitCode
from tests.command import run, start
from tests.scenario_files import write_scenario

# A line of the scenario, or a --set -> what the message says of it.
REFUSED = {
    "vehicle.mas = 1.0": "unknown key vehicle.mas; did you mean vehicle.mass?",
    'mission.duration = "ten"': 'mission.duration = "ten"; must be a number in s.',
    "mission.duration = 0": "mission.duration = 0 s; must be > 0.",
    "mission.goal.position = [1.0, inf, 2.0]": "mission.goal.position[1] = inf m; must be finite.",
    "vehicle.mass = 9.0": "hover needs 2400 rad/s per rotor, limits.rotor_speed_max is 1047 rad/s",
    'battery.use = "lead"': "no battery named 'lead'; there are paper_cell, phantom_2_pack",
}


def assert_refused(done, folder, message):
    assert done.status == ExitCode.BAD_INPUT
    assert message in done.err
    assert len(done.err.splitlines()) == 1
    assert done.out == ""
    assert not (folder / "reports").exists()


@pytest.mark.parametrize("line", REFUSED)
def test_refused_in_the_file(line, tmp_path):
    done = run("solve", str(write_scenario(tmp_path, line)), cwd=tmp_path)
    assert_refused(done, tmp_path, REFUSED[line])
    assert str(tmp_path / "hop.toml") in done.err


@pytest.mark.parametrize("line", REFUSED)
def test_refused_in_set(line, tmp_path):
    done = run("solve", str(write_scenario(tmp_path)), "--set", line, cwd=tmp_path)
    assert_refused(done, tmp_path, REFUSED[line])


def test_missing_file(tmp_path):
    done = run("solve", "no.toml", cwd=tmp_path)
    assert_refused(done, tmp_path, "no.toml: cannot be read (No such file or directory)")


def test_broken_toml(tmp_path):
    (tmp_path / "broken.toml").write_text('name = "hop\n')
    done = run("solve", "broken.toml", cwd=tmp_path)
    assert_refused(done, tmp_path, "broken.toml: not valid TOML")


def test_set_that_is_not_toml(tmp_path):
    done = run("solve", str(write_scenario(tmp_path)), "--set=mission.duration=[1", cwd=tmp_path)
    assert_refused(done, tmp_path, "--set: mission.duration = [1; must be a TOML value")


@pytest.mark.parametrize(
    "arguments",
    [
        ["solve", "hop.toml", "--rate=2_0"],
        ["solve", "hop.toml", "--rate=\u0662"],
        ["solve", "hop.toml", "--rate=0x10"],
        ["sweep", "study.toml", "--workers=1_0"],
        ["sweep", "study.toml", "--workers=\u0662"],
        ["sweep", "study.toml", "--workers=0"],
        ["sweep", "study.toml", "--workers=2.0"],
    ],
    ids=ascii,
)
def test_numbers_that_only_python_reads(arguments, capsys):
    assert main(arguments) == ExitCode.BAD_INPUT
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1
    option, found = arguments[-1].split("=")
    allowed = {"--rate": "must be a number, such as 50", "--workers": "must be a whole number >= 1"}
    assert f"'{option}': \"{found}\" {allowed[option]}" in lines[0]


def test_missing_file_named_in_set(tmp_path):
    file = write_scenario(tmp_path)
    done = run("solve", str(file), "--set", 'wind.file="no.csv"', cwd=tmp_path)
    assert_refused(done, tmp_path, '--set: wind.file = "no.csv"; cannot be read (No such file')


def test_code_needs_to_be_allowed(tmp_path):
    (tmp_path / "own.py").write_text("raise SystemExit('ran')")
    done = run("solve", str(write_scenario(tmp_path, 'model = "own.py:build"')), cwd=tmp_path)
    assert_refused(done, tmp_path, "model = 'own.py:build' runs code from a file; allow it with")


def test_reader_that_closes_the_pipe_gets_no_traceback():
    with start("library", "vehicles", "dji_phantom_2", "--json") as process:
        process.stdout.close()
        assert process.stderr.read() == ""
    assert process.returncode == ExitCode.FAULT
