"""`pyomo-quad plot`, shell completion and progress in a log."""

import subprocess
import sys
from xml.etree import ElementTree as ET

import pytest
from PIL import Image

from pyomo_quad.cli import main, terminal
from pyomo_quad.cli.endings import ExitCode
from pyomo_quad.collocation import Iteration
from pyomo_quad.flight.search import Stage, State
from tests.command import ENVIRONMENT, SCENARIOS

REPORT = SCENARIOS.parent / "reports" / "paper_wind"


@pytest.mark.lengthy
def test_a_figure_and_a_column_of_a_finished_run(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["plot", str(REPORT), "energy"]) == ExitCode.VERIFIED
    said = capsys.readouterr().out
    assert said.startswith("Written to paper_wind_energy.png. Others: path, states, controls, ")
    with Image.open(tmp_path / "paper_wind_energy.png") as picture:
        assert min(picture.size) > 300
    assert main(["plot", str(REPORT), "power_W", "--out", "power.svg"]) == ExitCode.VERIFIED
    assert ET.parse("power.svg").getroot().tag.endswith("svg")
    assert sorted(file.name for file in tmp_path.iterdir()) == [
        "paper_wind_energy.png",
        "power.svg",
    ]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ([str(REPORT), "fuel"], 'WHAT = "fuel"; must be one of path, states, controls, energy'),
        ([str(REPORT), "--out", "x.bmp"], "--out x.bmp: must end in .png, .svg, .pdf"),
        (["nowhere"], "nowhere/summary.json: cannot be read"),
        ([str(REPORT.parent / "paper")], "paper/summary.json: cannot be read"),
    ],
)
def test_what_cannot_be_drawn(tmp_path, monkeypatch, capsys, arguments, said):
    monkeypatch.chdir(tmp_path)
    assert main(["plot", *arguments]) == ExitCode.BAD_INPUT
    complaint = capsys.readouterr().err
    assert said in complaint
    assert complaint.count("\n") == 1
    assert not list(tmp_path.iterdir())


@pytest.mark.lengthy
@pytest.mark.parametrize(
    ("words", "offered"),
    [
        ("pyomo-quad exp", "export"),
        ("pyomo-quad export plan.npz --to cra", "crazyflie"),
        ("pyomo-quad init --from pap", "paper_wind"),
    ],
)
def test_a_shell_completes_commands_and_choices(words, offered):
    asked = {
        "_PYOMO_QUAD_COMPLETE": "complete_bash",
        "COMP_WORDS": words,
        "COMP_CWORD": str(len(words.split()) - 1),
    }
    done = subprocess.run(
        [sys.executable, "-m", "pyomo_quad"],
        env=ENVIRONMENT | asked,
        capture_output=True,
        text=True,
        check=False,
    )
    assert offered in done.stdout.split()
    assert done.stderr == ""


def test_a_log_gets_a_plain_line_every_few_seconds(monkeypatch, capsys):
    clock = iter([0.0, 1.0, 10.5, 12.0, 21.0])
    monkeypatch.setattr(terminal, "perf_counter", lambda: next(clock))
    now = State(
        stage=Stage.REFINING,
        energy_J=709.7,
        uncertainty=2e-4,
        spent_s=10.4,
        has_usable=True,
        iteration=Iteration(
            iteration=12,
            objective=710.0,
            infeasibility=1e-5,
            dual_infeasibility=1e-3,
            barrier=1e-4,
            elapsed_s=1.0,
            mesh_points=120,
        ),
    )
    with terminal.live_line(is_quiet=False) as follow:
        for _ in range(4):
            follow(now)
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 2
    assert "\x1b" not in "".join(lines)
    assert lines[0].startswith("refinement: best so far 709.70 J ± 0.02 %, usable; iteration 12")
    assert lines[0].endswith("10.4 s of the processor")
    with terminal.live_line(is_quiet=True) as follow:
        assert follow is None
