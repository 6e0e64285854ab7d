"""Output folders appear whole or not at all, also when the process is killed."""

import errno
import os
import random
import signal
import subprocess
import sys
import textwrap
import time

import pytest

from pyomo_quad.report import folder as folder_module
from pyomo_quad.report.folder import MANIFEST_NAME, output_folder, recover_folder
from pyomo_quad.scenario import OutputError

FILE_COUNT = 20


def write_generation(path, generation):
    with output_folder(path) as aside:
        for index in range(FILE_COUNT):
            (aside / f"file_{index}.txt").write_text(str(generation))


def fail_half_way(path, error):
    with output_folder(path) as aside:
        (aside / "half.txt").write_text("half")
        raise error


def generations_in(path):
    return {file.read_text() for file in path.glob("file_*.txt")}


def hidden_siblings(path):
    return [entry.name for entry in path.parent.iterdir() if entry.name.startswith(".")]


@pytest.fixture(params=["exchange", "no exchange"])
def _swap_kind(request, monkeypatch):
    if request.param == "no exchange":
        monkeypatch.setattr(folder_module, "exchange_folders", lambda *_: False)


@pytest.mark.usefixtures("_swap_kind")
def test_new_report_takes_the_place_of_the_old_one(tmp_path):
    final = tmp_path / "deep" / "report"
    write_generation(final, "old")
    write_generation(final, "new")
    assert generations_in(final) == {"new"}
    assert len(list(final.glob("file_*"))) == FILE_COUNT
    assert hidden_siblings(final) == []


def test_failure_keeps_the_old_report(tmp_path):
    final = tmp_path / "report"
    write_generation(final, "old")
    with pytest.raises(ZeroDivisionError):
        fail_half_way(final, ZeroDivisionError())
    assert generations_in(final) == {"old"}
    assert not (final / "half.txt").exists()
    assert hidden_siblings(final) == []


def test_manifest_lists_the_files(tmp_path):
    with output_folder(tmp_path / "report") as aside:
        (aside / "figures").mkdir()
        (aside / "figures" / "path.svg").write_text("")
        (aside / "plan.csv").write_text("")
    names = (tmp_path / "report" / MANIFEST_NAME).read_text().splitlines()
    assert names == ["figures/path.svg", "plan.csv"]


def test_foreign_files_are_never_replaced(tmp_path):
    (tmp_path / "thesis.tex").write_text("years of work")
    with pytest.raises(OutputError, match=r"holds 'thesis.tex', which no run wrote; move it away"):
        write_generation(tmp_path, "new")
    assert (tmp_path / "thesis.tex").read_text() == "years of work"


def test_file_in_place_of_the_folder_is_refused(tmp_path):
    (tmp_path / "report").write_text("")
    with pytest.raises(OutputError, match=r"report: is a file; choose a folder for --out\."):
        write_generation(tmp_path / "report", "new")


def test_unwritable_place_is_one_line(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match=r"cannot be written \(.*\); free the place") as caught:
        write_generation(tmp_path / "file" / "report", "new")
    assert "\n" not in str(caught.value)


def test_full_disk_is_one_line_and_leaves_nothing(tmp_path):
    full = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    with pytest.raises(OutputError, match=r"No space left on device"):
        fail_half_way(tmp_path / "report", full)
    assert list(tmp_path.iterdir()) == []


def test_second_run_to_one_folder_is_refused(tmp_path):
    final = tmp_path / "report"
    with output_folder(final) as aside:
        (aside / "file_0.txt").write_text("first")
        with pytest.raises(OutputError, match=r"another run is writing here; wait for it"):
            write_generation(final, "second")
    assert generations_in(final) == {"first"}


def test_half_done_swap_is_finished_by_the_reader(tmp_path):
    final = tmp_path / "report"
    write_generation(tmp_path / ".report.ready", "new")
    final.mkdir()
    (final / "file_0.txt").write_text("old")  # what is left of the old report
    recover_folder(final)
    assert generations_in(final) == {"new"}


@pytest.mark.parametrize("can_exchange", [True, False])
def test_sigkill_at_any_moment_leaves_one_whole_report(tmp_path, can_exchange):
    final = tmp_path / "report"
    program = textwrap.dedent(f"""
        import itertools
        from pathlib import Path
        from pyomo_quad.report import folder
        if not {can_exchange}:
            folder.exchange_folders = lambda *_: False
        for generation in itertools.count():
            with folder.output_folder({str(final)!r}) as aside:
                for index in range({FILE_COUNT}):
                    (aside / f"file_{{index}}.txt").write_text(str(generation))
            print(generation, flush=True)
    """)
    chance = random.Random(1)
    for _ in range(8):
        with subprocess.Popen(
            [sys.executable, "-c", program], stdout=subprocess.PIPE, text=True
        ) as process:
            process.stdout.readline()
            time.sleep(chance.uniform(0.0, 0.02))
            process.send_signal(signal.SIGKILL)
        if can_exchange and sys.platform.startswith("linux"):
            assert len(list(final.glob("file_*"))) == FILE_COUNT
        recover_folder(final)
        assert len(list(final.glob("file_*"))) == FILE_COUNT
        assert len(generations_in(final)) == 1
    write_generation(final, "last")
    assert hidden_siblings(final) == []
