"""Bad input through the command: status 2, one line, nothing written; by file and by --set."""

import pytest

from pyomo_quad.cli import main
from pyomo_quad.cli.endings import ExitCode
from tests.command import start
from tests.scenario_files import write_scenario

# A line of the scenario, or a --set -> what the message says of it.
REFUSED = {
    "vehicle.mas = 1.0": "unknown key vehicle.mas; did you mean vehicle.mass?",
    'mission.duration = "ten"': 'mission.duration = "ten"; must be a number in s or "free".',
    "mission.duration = 0": "mission.duration = 0 s; must be > 0.",
    "mission.goal.position = [1.0, inf, 2.0]": "mission.goal.position[1] = inf m; must be finite.",
    "vehicle.mass = 9.0": "hover needs 2400 rad/s per rotor, limits.rotor_speed_max is 1047 rad/s",
    'battery.use = "lead"': "no battery named 'lead'; there are ",
}


@pytest.fixture
def refused(tmp_path, monkeypatch, capsys):
    """Give a function that solves in a folder of its own and returns the one line of refusal."""
    monkeypatch.chdir(tmp_path)

    def solve(scenario, *arguments):
        assert main(["solve", str(scenario), *arguments]) == ExitCode.BAD_INPUT
        said = capsys.readouterr()
        assert (said.out, len(said.err.splitlines())) == ("", 1)
        assert not (tmp_path / "reports").exists()
        return said.err

    return solve


@pytest.mark.parametrize("line", REFUSED)
def test_refused_in_the_file(line, tmp_path, refused):
    said = refused(write_scenario(tmp_path, line))
    assert REFUSED[line] in said
    assert str(tmp_path / "hop.toml") in said


@pytest.mark.parametrize("line", REFUSED)
def test_refused_in_set(line, tmp_path, refused):
    assert REFUSED[line] in refused(write_scenario(tmp_path), "--set", line)


def test_missing_file(refused):
    assert "no.toml: cannot be read (No such file or directory)" in refused("no.toml")


def test_broken_toml(tmp_path, refused):
    (tmp_path / "broken.toml").write_text('name = "hop\n')
    assert "broken.toml: not valid TOML" in refused("broken.toml")


def test_set_that_is_not_toml(tmp_path, refused):
    said = refused(write_scenario(tmp_path), "--set=mission.duration=[1")
    assert "--set: mission.duration = [1; must be a TOML value" in said


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


def test_missing_file_named_in_set(tmp_path, refused):
    said = refused(write_scenario(tmp_path), "--set", 'wind.file="no.csv"')
    assert '--set: wind.file = "no.csv"; cannot be read (No such file' in said


def test_code_needs_to_be_allowed(tmp_path, refused):
    (tmp_path / "own.py").write_text("raise SystemExit('ran')")
    said = refused(write_scenario(tmp_path, 'model = "own.py:build"'))
    assert "model = 'own.py:build' runs code from a file; allow it with" in said


@pytest.mark.lengthy
def test_reader_that_closes_the_pipe_gets_no_traceback():
    with start("library", "vehicles", "dji_phantom_2", "--json") as process:
        process.stdout.close()
        assert process.stderr.read() == ""
    assert process.returncode == ExitCode.FAULT
