"""Interrupts, kills and bad disks through the real command: a whole report, or the old one."""

import resource
import shutil
import signal
import time
from contextlib import nullcontext

import pandas as pd
import pytest

from pyomo_quad.cli import main, solving
from pyomo_quad.cli.exit_codes import ExitCode
from pyomo_quad.report.folder import output_folder
from tests.command import PAPER_CALM, QUICK, solve, start
from tests.scenario_files import write_scenario

PATIENCE_S = 120


def begin(folder, *arguments, **options):
    """Start a solve and wait until it has begun to work aside of its folder."""
    process = start("solve", PAPER_CALM, "--out", str(folder), *arguments, **options)
    deadline = time.monotonic() + PATIENCE_S
    while not list(folder.parent.glob(f".{folder.name}.new-*")):
        assert process.poll() is None, process.stderr.read()
        assert time.monotonic() < deadline
        time.sleep(0.01)
    return process


def content(folder):
    return {file.name: file.read_bytes() for file in folder.rglob("*") if file.is_file()}


def leftovers(folder):
    return [entry.name for entry in folder.parent.iterdir() if entry != folder]


def test_interrupt_keeps_the_best_iterate(tmp_path):
    folder = tmp_path / "report"
    process = begin(folder, *QUICK)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == ExitCode.INTERRUPTED
    assert (out, len(err.splitlines())) == (f"Written to {folder}.\n", 1)
    assert err.startswith("paper_calm: interrupted: ")
    assert set(pd.read_csv(folder / "plan.csv")["status"]) == {"interrupted"}
    assert (folder / "report.md").read_text().startswith("# Failed, interrupted: ")
    assert leftovers(folder) == []


def test_kill_leaves_the_old_report_and_the_next_run_cleans_up(tmp_path, calm):
    folder = tmp_path / "report"
    shutil.copytree(calm.folder, folder)
    process = begin(folder, *QUICK)
    process.kill()
    process.communicate()
    assert content(folder) == content(calm.folder)
    done = solve(folder, *QUICK, "--quiet")
    assert done.status == ExitCode.VERIFIED
    assert done.summary["scenario_resolved"]["mission"]["duration"] == 4.0
    assert leftovers(folder) == []


def test_full_disk_is_one_line_and_keeps_the_old_report(tmp_path, calm):
    def allow_small_files_only():
        resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))

    folder = tmp_path / "report"
    shutil.copytree(calm.folder, folder)
    process = begin(folder, *QUICK, preexec_fn=allow_small_files_only)
    out, err = process.communicate(timeout=PATIENCE_S)
    assert (process.returncode, out) == (ExitCode.FAULT, "")
    message = f"{folder}: cannot be written (File too large); free the place or choose another"
    assert err.startswith(message)
    assert len(err.splitlines()) == 1
    assert content(folder) == content(calm.folder)
    assert leftovers(folder) == []


@pytest.mark.parametrize("place", ["a_file/report", "/proc/report"])
def test_unwritable_folder_is_one_line(place, tmp_path, capsys):
    (tmp_path / "a_file").write_text("")
    assert main(["solve", PAPER_CALM, *QUICK, "--out", str(tmp_path / place)]) == ExitCode.FAULT
    said = capsys.readouterr()
    assert f"{place}: cannot be written" in said.err
    assert (said.out, len(said.err.splitlines())) == ("", 1)


def test_two_runs_do_not_mix(tmp_path, capsys):
    folder = tmp_path / "report"
    with output_folder(folder) as aside:
        assert main(["solve", PAPER_CALM, *QUICK, "--out", str(folder)]) == ExitCode.FAULT
        (aside / "mine.txt").write_text("mine")
    assert capsys.readouterr().err == (
        f"{folder}: another run is writing here; wait for it or choose another --out.\n"
    )
    assert [file.name for file in folder.glob("[!.]*")] == ["mine.txt"]


def test_folder_deleted_in_mid_run_is_one_line(tmp_path, capsys):
    (tmp_path / "own.py").write_text(
        "import pathlib, shutil\n"
        "from pyomo_quad import build_model\n"
        "def build(scenario):\n"
        "    for folder in pathlib.Path(__file__).parent.glob('.report.new-*'):\n"
        "        shutil.rmtree(folder)\n"
        "    return build_model(scenario)\n"
    )
    file = write_scenario(tmp_path, 'model = "own.py:build"')
    folder = tmp_path / "report"
    assert main(["solve", str(file), "--allow-code", "--out", str(folder)]) == ExitCode.FAULT
    said = capsys.readouterr()
    assert "report: cannot be written (" in said.err
    assert (said.out, len(said.err.splitlines())) == ("", 1)
    assert not (tmp_path / "report").exists()


def test_error_inside_a_callback_is_one_line(tmp_path, capsys, monkeypatch):
    class Broken:
        is_requested = property(lambda _: 1 / 0)

    monkeypatch.setattr(solving, "stop_on_interrupt", lambda: nullcontext(Broken()))
    folder = tmp_path / "report"
    assert main(["solve", PAPER_CALM, *QUICK, "--out", str(folder)]) == ExitCode.FAULT
    said = capsys.readouterr()
    assert said.err.startswith("pyomo-quad: unexpected ZeroDivisionError: division by zero (at ")
    assert len(said.err.splitlines()) == 1
    assert list(tmp_path.iterdir()) == []
