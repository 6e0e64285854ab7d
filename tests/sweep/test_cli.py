"""`pyomo-quad sweep` as it is typed: what it prints, writes and returns."""

import re
import signal
import time
from contextlib import nullcontext
from pathlib import Path

import pytest

from pyomo_quad.cli import sweeping
from pyomo_quad.cli.commands import main
from pyomo_quad.cli.endings import ExitCode
from pyomo_quad.sweep import estimate_sweep, runner
from tests.command import start
from tests.sweep.stand_in import SOLVER
from tests.sweep.studies import DURATION_AXIS, write_study
from tests.sweep.sweeping import Here, rows


@pytest.fixture
def study(tmp_path, monkeypatch):
    """Give a study that is solved by the stand-in."""
    monkeypatch.setattr(runner.Sweep.__init__, "__defaults__", (SOLVER,))
    monkeypatch.setattr(estimate_sweep, "__defaults__", (SOLVER,))
    return write_study(tmp_path, DURATION_AXIS)


@pytest.fixture
def quick(monkeypatch):
    """Solve in this process."""
    monkeypatch.setattr("pyomo_quad.sweep.process_workers", in_this_process)


def in_this_process(_count):
    return nullcontext(Here())


def rewrite(study: Path, before: str, after: str) -> None:
    study.write_text(study.read_text().replace(before, after))


def run(study: Path, folder: Path, *options: str) -> int:
    where = ["--workers", "1", "--out", str(folder)]
    return main(["sweep", str(study), *where, "--figures", "none", *options])


@pytest.mark.lengthy
def test_a_sweep_writes_store_tables_and_report_and_goes_on_when_run_again(
    study, tmp_path, capsys, monkeypatch
):
    folder = tmp_path / "out"
    assert run(study, folder, "--verbose") == 0
    shown = capsys.readouterr()
    assert "study: 10 cases finished, 0 failed; results in" in shown.out
    assert "10 cases on 1 worker process" in shown.err
    lines = re.findall(r"^case \d+: mission\.duration = .*: finished in ", shown.err, re.MULTILINE)
    assert len(lines) == 10
    assert (folder / "report" / "report.md").is_file()
    study.write_text(
        study.read_text().replace("last = 13.0, count = 10", "last = 14.0, count = 11")
    )
    monkeypatch.setattr("pyomo_quad.sweep.process_workers", in_this_process)
    assert run(study, folder) == 0
    shown = capsys.readouterr()
    assert "1 cases finished, 0 failed, 10 finished before" in shown.out
    assert "extended: axis mission.duration: 10 values 4.0 to 13.0 -> 11 values 4.0" in shown.err
    assert len(rows(folder)) == 11


@pytest.mark.usefixtures("quick")
def test_a_changed_study_needs_fresh(study, tmp_path, capsys):
    assert run(study, tmp_path / "out") == 0
    write_study(tmp_path, DURATION_AXIS, "fixed.vehicle.mass = 1.35")
    assert run(study, tmp_path / "out") == 1
    assert "scenario.vehicle.mass: 1.3 -> 1.35); start anew with --fresh" in capsys.readouterr().err
    assert run(study, tmp_path / "out", "--fresh") == 0
    assert "10 cases finished, 0 failed; results" in capsys.readouterr().out


@pytest.mark.usefixtures("quick")
def test_a_dry_run_counts_cases_measures_one_and_writes_nothing(study, tmp_path, capsys):
    assert run(study, tmp_path / "out", "--dry-run") == 0
    line = capsys.readouterr().out
    assert re.match(r"study: 10 cases, 10 of them to solve; about .* on 1 worker\.", line)
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
@pytest.mark.usefixtures("quick")
def test_too_many_cases_ask_for_yes(study, tmp_path, capsys):
    rewrite(study, "count = 10", "count = 5000")
    assert run(study, tmp_path / "out", "--dry-run") == 2
    assert "make 5000 cases, more than 1000" in capsys.readouterr().err
    assert run(study, tmp_path / "out", "--dry-run", "--yes") == 0


@pytest.mark.usefixtures("quick")
def test_a_scheduler_that_is_not_there_ends_the_command_in_one_line(
    study, tmp_path, capsys, monkeypatch
):
    pytest.importorskip("distributed")
    monkeypatch.setattr("pyomo_quad.sweep.cluster._CONNECT_SECONDS", 0.3)
    assert run(study, tmp_path / "out", "--scheduler", "tcp://127.0.0.1:9") == 1
    shown = capsys.readouterr().err.strip()
    assert "--scheduler tcp://127.0.0.1:9: cannot be reached" in shown
    assert "\n" not in shown


@pytest.mark.usefixtures("quick")
def test_a_sweep_in_which_nothing_finished_is_not_a_success(study, tmp_path, capsys):
    rewrite(study, "first = 4.0, last = 13.0", "first = 1.0, last = 2.0")
    assert run(study, tmp_path / "out") == 3
    assert "0 cases finished, 10 failed" in capsys.readouterr().out
    assert "is too short" in (tmp_path / "out" / "report" / "report.md").read_text()


@pytest.mark.usefixtures("quick")
def test_on_a_terminal_there_is_a_bar(study, tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setattr(sweeping, "_SECONDS_OF_MEMORY", 5.0)
    assert run(study, tmp_path / "out") == 0
    shown = capsys.readouterr().err
    assert "10/10" in shown
    assert "0 failed" in shown


@pytest.mark.lengthy
@pytest.mark.parametrize(
    "number", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.slow)]
)
def test_an_interrupted_sweep_ends_with_its_status_and_goes_on(number, tmp_path):
    study, folder = write_study(tmp_path, DURATION_AXIS), tmp_path / "out"
    process = start("sweep", str(study), "--workers=1", "--out", str(folder))
    while not list(folder.glob("*.sqlite")):
        assert process.poll() is None
        time.sleep(0.01)
    process.send_signal(number)
    out, err = process.communicate(timeout=60)
    assert process.returncode == ExitCode.INTERRUPTED
    assert "Traceback" not in err
    assert "leaked" not in err
    assert "run the same command to continue" in out or err.endswith("no report was written.\n")
