"""Interrupts, kills and bad disks through the real command: a whole report, or the old one."""

import json
import os
import re
import resource
import shlex
import signal
import subprocess
import sys
import time
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from pyomo_quad import Plan
from pyomo_quad.cli import main, solving
from pyomo_quad.cli.endings import ExitCode, Stopped, raise_on_interrupt
from pyomo_quad.collocation.program import ipopt
from pyomo_quad.report.folder import output_folder
from pyomo_quad.scenario import ScenarioError
from tests.command import COMMAND, ENVIRONMENT, PAPER_CALM, QUICK, start
from tests.scenario_files import write_scenario

PATIENCE_S = 300


def begin(folder, *arguments, **options):
    """Start a solve and wait until it has begun to work aside of its folder."""
    process = start("solve", PAPER_CALM, "--out", str(folder), *arguments, **options)
    deadline = time.monotonic() + PATIENCE_S
    while not list(folder.parent.glob(f".{folder.name}.new-*")):
        assert process.poll() is None, process.stderr.read()
        assert time.monotonic() < deadline
        time.sleep(0.01)
    return process


@pytest.fixture
def folder(tmp_path):
    """Give a folder with an older report, of which only that it stays is looked at."""
    with output_folder(tmp_path / "report") as aside:
        (aside / "report.md").write_text("# An older report\n")
        (aside / "figures").mkdir()
        (aside / "figures" / "path.svg").write_text("<svg/>")
    return tmp_path / "report"


def content(folder):
    return {file.name: file.read_bytes() for file in folder.rglob("*") if file.is_file()}


def leftovers(folder):
    return [entry.name for entry in folder.parent.iterdir() if entry != folder]


LINE = "pyomo-quad: interrupted; no report was written.\n"
ENDING = (signal.SIGINT, signal.SIGTERM)


def interrupt(process, number):
    """Send a signal; return status, output and complaints."""
    process.send_signal(number)
    out, err = process.communicate(timeout=PATIENCE_S)
    return process.returncode, out, err


def assert_interrupted(ended):
    status, out, err = ended
    assert (status, out) == (ExitCode.INTERRUPTED, "")
    assert len(err.splitlines()) == 1
    assert "interrupted; " in err


@pytest.mark.lengthy
@pytest.mark.parametrize(
    ("number", "delay_s"),
    [
        (signal.SIGINT, 0.0),
        (signal.SIGINT, 0.4),
        (signal.SIGINT, 1.0),
        (signal.SIGTERM, 0.2),
        (signal.SIGHUP, 0.2),
    ],
)
def test_a_signal_during_the_imports_ends_the_command(tmp_path, number, delay_s):
    process = start("run", PAPER_CALM, *QUICK, "--out", str(tmp_path / "report"))
    while not handles(process, number):
        assert process.poll() is None
    time.sleep(delay_s)
    assert_interrupted(interrupt(process, number))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.lengthy
def test_nohup_outlives_its_terminal(tmp_path):
    def ignore_the_terminal():
        signal.signal(signal.SIGHUP, signal.SIG_IGN)

    process = start("schema", "--out", str(tmp_path), preexec_fn=ignore_the_terminal)
    while not handles(process, signal.SIGTERM):
        assert process.poll() is None
    status, _, err = interrupt(process, signal.SIGHUP)
    assert (status, err) == (ExitCode.VERIFIED, "")
    assert (tmp_path / "README.md").is_file()


def test_sighup_keeps_the_best_iterate_as_other_signals_do(tmp_path, monkeypatch, capsys):
    hang_up = lambda _: signal.raise_signal(signal.SIGHUP)  # noqa: E731
    monkeypatch.setattr(solving, "live_line", lambda **_: nullcontext(hang_up))
    assert main(["solve", PAPER_CALM, "--out", str(tmp_path / "r")]) == ExitCode.INTERRUPTED
    assert capsys.readouterr().err == "paper_calm: interrupted; no report was written.\n"


def status_of(process):
    return Path(f"/proc/{process.pid}/status").read_text(encoding="utf-8")


def handles(process, number):
    """Say whether the process handles this signal, and SIGALRM, which the command alone sets."""
    caught = int(re.search(r"SigCgt:\s*([0-9a-f]+)", status_of(process))[1], 16)
    return all(caught >> (n - 1) & 1 for n in (signal.SIGALRM, number))


@pytest.mark.lengthy
@pytest.mark.parametrize(
    "number", [signal.SIGHUP, *(pytest.param(n, marks=pytest.mark.slow) for n in ENDING)]
)
def test_a_signal_at_work_keeps_the_old_report(folder, number):
    before = content(folder)
    process = begin(folder, *QUICK)
    assert_interrupted(interrupt(process, number))
    assert content(folder) == before
    assert set(leftovers(folder)) <= {"report-interrupted"}


@pytest.mark.parametrize(("told", "lines"), [("", 1), ("endings.record_last_message()", 0)])
def test_a_timer_that_ends_a_command_repeats_no_line(told, lines):
    program = f"""
import signal
from pyomo_quad.cli import endings
endings.end_on_signals()
{told}
signal.raise_signal(signal.SIGALRM)
"""
    ended = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=False
    )
    assert ended.returncode == ExitCode.INTERRUPTED
    assert len(ended.stderr.splitlines()) == lines


def flying(folder):
    """Start a run and wait until a copy of it flies."""
    process = start("run", PAPER_CALM, *QUICK, "--out", str(folder))
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children")
    while not children.read_text(encoding="utf-8"):
        assert process.poll() is None, process.stderr.read()
        time.sleep(0.001)
    return process


@pytest.mark.lengthy
@pytest.mark.skipif(len(os.sched_getaffinity(0)) < 2, reason="needs two cores")
@pytest.mark.parametrize(
    "number", [signal.SIGTERM, pytest.param(signal.SIGINT, marks=pytest.mark.slow)]
)
def test_a_signal_in_flight_ends_the_copies_too(folder, number):
    before = content(folder)
    # A copy that went on would hold the output open, and this would wait for it.
    assert_interrupted(interrupt(flying(folder), number))
    assert content(folder) == before
    assert leftovers(folder) == []


@pytest.mark.lengthy
@pytest.mark.skipif(len(os.sched_getaffinity(0)) < 2, reason="needs two cores")
def test_a_run_that_is_killed_in_flight_leaves_the_folder_to_the_next(folder):
    before = content(folder)
    status, _, _ = interrupt(flying(folder), signal.SIGKILL)
    assert (status, content(folder)) == (-signal.SIGKILL, before)
    with output_folder(folder) as aside:
        (aside / "report.md").write_text("# A newer report\n")
    assert set(content(folder)) - {".pyomo_quad_files"} == {"report.md"}
    assert leftovers(folder) == []


@pytest.mark.lengthy
def test_a_signal_while_the_report_is_written_keeps_the_old_one(tmp_path, folder):
    before = content(folder)
    process = begin(folder, *QUICK)
    while not [file for file in tmp_path.glob(".report.new-*/*") if file.name[0] != "."]:
        assert process.poll() is None
        time.sleep(0.001)
    ended = interrupt(process, signal.SIGINT)
    assert_interrupted(ended)
    assert ended[2] == LINE
    assert content(folder) == before
    assert leftovers(folder) == []


def test_a_stopped_solve_leaves_its_best_iterate_beside_the_report(
    tmp_path, folder, monkeypatch, capsys
):
    def stop_when_it_is_good(now):
        if now.iteration.infeasibility < 1e-6:
            signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(solving, "live_line", lambda **_: nullcontext(stop_when_it_is_good))
    before = content(folder)
    assert main(["solve", PAPER_CALM, "--out", str(folder)]) == ExitCode.INTERRUPTED
    beside = tmp_path / "report-interrupted"
    assert capsys.readouterr() == (
        "",
        f"paper_calm: interrupted; its best iterate is in {beside}, and {folder} is unchanged.\n",
    )
    assert content(folder) == before
    assert set(pd.read_csv(beside / "plan.csv")["status"]) == {"interrupted"}
    assert Plan.load(beside / "plan.npz").energy > 0.0


def test_a_solve_stopped_early_leaves_nothing(tmp_path, monkeypatch, capsys):
    first = lambda _: signal.raise_signal(signal.SIGTERM)  # noqa: E731
    monkeypatch.setattr(solving, "live_line", lambda **_: nullcontext(first))
    assert main(["solve", PAPER_CALM, "--out", str(tmp_path / "r")]) == ExitCode.INTERRUPTED
    assert capsys.readouterr().err == "paper_calm: interrupted; no report was written.\n"
    assert list(tmp_path.iterdir()) == []


def cut_short():
    try:
        signal.raise_signal(signal.SIGINT)
    except KeyboardInterrupt as stop:
        raise ImportError("a library is not there") from stop


def test_what_a_library_makes_of_an_interrupt_is_an_interrupt():
    with pytest.raises(Stopped), raise_on_interrupt():
        cut_short()
    with pytest.raises(ImportError, match="no interrupt"), raise_on_interrupt():
        raise ImportError("no interrupt")


@pytest.mark.slow
def test_kill_leaves_the_old_report_and_the_next_run_cleans_up(folder):
    before = content(folder)
    process = begin(folder, *QUICK)
    process.kill()
    process.communicate()
    assert content(folder) == before
    assert main(["solve", PAPER_CALM, *QUICK, "--out", str(folder), "--quiet"]) == 0
    summary = json.loads((folder / "summary.json").read_text())
    assert summary["scenario_resolved"]["mission"]["duration"] == 4.0
    assert leftovers(folder) == []


@pytest.mark.slow
def test_full_disk_is_one_line_and_keeps_the_old_report(folder):
    def allow_small_files_only():
        resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))

    before = content(folder)
    process = begin(folder, *QUICK, preexec_fn=allow_small_files_only)
    out, err = process.communicate(timeout=PATIENCE_S)
    assert (process.returncode, out) == (ExitCode.FAULT, "")
    message = f"{folder}: cannot be written (File too large); free the place or choose another"
    assert err.startswith(message)
    assert len(err.splitlines()) == 1
    assert content(folder) == before
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


@pytest.mark.lengthy
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
    options = ("--allow-code", "--quiet", "--out", str(folder))
    assert main(["solve", str(file), *options]) == ExitCode.FAULT
    said = capsys.readouterr()
    assert "report: cannot be written (" in said.err
    assert (said.out, len(said.err.splitlines())) == ("", 1)
    assert not (tmp_path / "report").exists()


def test_error_inside_a_callback_is_one_line(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(solving, "live_line", lambda **_: nullcontext(lambda _: 1 / 0))
    folder = tmp_path / "report"
    assert main(["solve", PAPER_CALM, *QUICK, "--out", str(folder)]) == ExitCode.FAULT
    said = capsys.readouterr()
    assert said.err.startswith("pyomo-quad: unexpected ZeroDivisionError: division by zero (at ")
    assert len(said.err.splitlines()) == 1
    assert list(tmp_path.iterdir()) == []


def wrapped():
    raise ScenarioError("plan.npz: is not a plan") from MemoryError()


def no_memory():
    raise RuntimeError("Error in Function::call at function.cpp:361: std::bad_alloc")


def not_loaded():
    raise ImportError("libcasadi.so: failed to map segment: Cannot allocate memory")


@pytest.mark.parametrize("fail", [lambda: np.empty(10**15), wrapped, no_memory, not_loaded])
def test_lack_of_memory_is_told_as_such(tmp_path, capsys, monkeypatch, fail):
    monkeypatch.setattr(solving, "live_line", lambda **_: nullcontext(lambda _: fail()))
    folder = tmp_path / "report"
    assert main(["solve", PAPER_CALM, *QUICK, "--out", str(folder)]) == ExitCode.FAULT
    assert capsys.readouterr().err == (
        "pyomo-quad: not enough memory; close other programs, solve on fewer elements or with "
        "fewer --workers, or give smaller files.\n"
    )
    assert list(tmp_path.iterdir()) == []


class OutOfMemory(ipopt.cyipopt.Problem):
    """Ipopt on a machine whose memory does not hold its matrices."""

    def solve(self, *start, **_):
        return start[0], {"status": -102, "status_msg": b"Insufficient memory"}


def test_ipopt_without_memory_is_no_mission_that_does_not_converge(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(ipopt.cyipopt, "Problem", OutOfMemory)
    assert main(["solve", PAPER_CALM, *QUICK, "--out", str(tmp_path / "r")]) == ExitCode.FAULT
    assert capsys.readouterr().err.startswith("pyomo-quad: not enough memory; ")


LIBRARY = ("library", "vehicles", "dji_phantom_2")


def in_shell(line, *arguments, **changes):
    """Run the command from a shell; return its status and what it complained of."""
    command = shlex.join([*COMMAND, *arguments])
    done = subprocess.run(
        ["sh", "-c", f"{command} {line}"],
        env=ENVIRONMENT | changes,
        stderr=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        text=True,
        timeout=PATIENCE_S,
        check=False,
    )
    return done.returncode, done.stderr


@pytest.mark.lengthy
@pytest.mark.parametrize(
    ("line", "complaint"),
    [
        (">&-", "pyomo-quad: standard output is closed; send it to a file or to /dev/null.\n"),
        ("<&- >&-", "pyomo-quad: standard output is closed; send it to a file or to /dev/null.\n"),
        (
            ">/dev/full",
            "pyomo-quad: standard output cannot be written (No space left on device).\n",
        ),
        (">&- 2>&-", ""),
        (">/dev/full 2>/dev/full", ""),
        ("| true", ""),
    ],
)
def test_output_that_cannot_be_written_is_a_fault_in_one_line(line, complaint):
    status = "0" if line.startswith("|") else "1"
    assert in_shell(line, *LIBRARY) == (int(status), complaint)


@pytest.mark.lengthy
def test_closed_errors_do_not_spoil_an_answer():
    assert in_shell("2>&-", *LIBRARY)[0] == ExitCode.VERIFIED
    assert in_shell("2>/dev/full", "library", "nonsense")[0] == ExitCode.BAD_INPUT


@pytest.mark.slow
def test_names_that_the_terminal_cannot_encode(tmp_path):
    folder = tmp_path / os.fsdecode(b"bericht-\xff-\xc3\xbc")
    file = write_scenario(tmp_path, 'title = "Überflug"')
    file = file.rename(tmp_path / os.fsdecode(b"\xfc\xff.toml"))
    done = subprocess.run(
        [*COMMAND, "fly", file, "--out", folder],
        env=ENVIRONMENT | {"PYTHONIOENCODING": "ascii", "PYTHONUTF8": "0"},
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=False,
    )
    assert (done.returncode, done.stderr) == (ExitCode.VERIFIED, "")
    assert r"bericht-\udcff-\xfc" in done.stdout
    assert (folder / "summary.json").exists()


@pytest.mark.lengthy
def test_a_bad_folder_is_refused_before_the_engine_is_imported(tmp_path):
    (tmp_path / "a_file").write_text("")
    (tmp_path / "foreign").mkdir()
    (tmp_path / "foreign" / "notes.txt").write_text("")
    refused = [
        ("solve", PAPER_CALM, "--out", "/"),
        ("run", PAPER_CALM, "--out", str(tmp_path / "a_file")),
        ("compare", PAPER_CALM, "--out", str(tmp_path / "a_file" / "report")),
        ("fly", PAPER_CALM, "--out", str(tmp_path / "foreign")),
        ("paper", "--out", str(tmp_path / "foreign")),
        ("sweep", "study.toml", "--out", "/"),
        ("sweep", "study.toml", "--out", str(tmp_path / "a_file")),
    ]
    program = (
        "import sys; sys.modules['pyomo'] = sys.modules['casadi'] = None\n"
        "from pyomo_quad.cli import main\n"
        f"for arguments in {refused!r}: print(main(list(arguments)))"
    )
    done = subprocess.run(
        [sys.executable, "-c", program],
        env=ENVIRONMENT,
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=False,
    )
    assert done.stdout.split() == [str(ExitCode.FAULT.value)] * len(refused)
    complaints = done.stderr.splitlines()
    assert len(complaints) == len(refused)
    assert all("choose " in line for line in complaints)
