"""Output folders appear whole or not at all, also when the process is killed."""

import errno
import os
import random
import shutil
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import pytest

from pyomo_quad.report.folder import MANIFEST_NAME, output_folder, refuse_output_folder
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


def strangers_things(folder):
    """Put down what no run wrote under every name that a run uses beside its folder."""
    for name in (
        ".report.ready",
        ".report.new-7",
        ".report.new-notes",
        f".report.new-{os.getpid()}",
    ):
        (folder / name).mkdir()
        (folder / name / "thesis.tex").write_text("years of work")
    (folder / ".report.new-8").symlink_to(folder / ".report.ready")


def everything_in(folder):
    return {str(file.relative_to(folder)) for file in folder.rglob("*") if not file.is_dir()}


def test_a_left_over_swap_deletes_nothing_foreign(tmp_path):
    final = tmp_path / "report"
    write_generation(tmp_path / ".report.ready", "new")
    final.mkdir()
    (final / "notes.txt").write_text("years of work")
    before = everything_in(tmp_path)
    with pytest.raises(OutputError, match=r"report: holds 'notes.txt', which no run wrote; move"):
        write_generation(final, "newer")
    assert everything_in(tmp_path) == before


def test_strangers_folders_of_hidden_names_are_left_alone(tmp_path):
    strangers_things(tmp_path)
    before = everything_in(tmp_path)
    with pytest.raises(OutputError, match=r"report: cannot be written \(File exists\)"):
        write_generation(tmp_path / "report", "new")
    shutil.rmtree(tmp_path / f".report.new-{os.getpid()}")
    before = {name for name in before if str(os.getpid()) not in name}
    write_generation(tmp_path / "report", "new")
    assert {name for name in everything_in(tmp_path) if not name.startswith("report/")} == before


def test_a_strangers_lock_file_is_left_alone(tmp_path):
    (tmp_path / ".report.lock").write_text("years of work")
    with pytest.raises(OutputError, match=r"needs the name '.report.lock' in the same folder"):
        write_generation(tmp_path / "report", "new")
    assert (tmp_path / ".report.lock").read_text() == "years of work"


def test_a_link_in_the_folder_is_foreign(tmp_path):
    write_generation(tmp_path / "report", "old")
    (tmp_path / "report" / "link").symlink_to(tmp_path)
    with pytest.raises(OutputError, match=r"holds 'link', which no run wrote"):
        write_generation(tmp_path / "report", "new")


def test_a_damaged_manifest_makes_all_files_foreign(tmp_path):
    write_generation(tmp_path / "report", "old")
    (tmp_path / "report" / MANIFEST_NAME).write_bytes(b"\xff\xfe\x00")
    with pytest.raises(OutputError, match=r"holds 'file_\d+.txt', which no run wrote"):
        write_generation(tmp_path / "report", "new")


@pytest.mark.parametrize(
    ("place", "reason"),
    [
        ("/", r"/: is the root of all folders; choose another --out\."),
        ("loop/report", r"cannot be written \("),
        ("file/report", r"cannot be written \("),
        ("file", r"is a file; choose a folder for --out\."),
        ("n" * 300, r"cannot be written \(File name too long\)"),
        ("foreign", r"holds 'notes.txt', which no run wrote"),
    ],
)
def test_a_bad_folder_is_refused_beforehand_as_at_work(tmp_path, place, reason):
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    (tmp_path / "file").write_text("")
    (tmp_path / "foreign").mkdir()
    (tmp_path / "foreign" / "notes.txt").write_text("")
    before = everything_in(tmp_path)
    for refusing in (refuse_output_folder, lambda path: write_generation(path, "new")):
        with pytest.raises(OutputError, match=reason) as caught:
            refusing(tmp_path / place)
        assert "\n" not in str(caught.value)
    assert everything_in(tmp_path) == before


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


def test_an_interrupt_as_the_folder_is_made_leaves_nothing(tmp_path, monkeypatch):
    made = Path.mkdir

    def interrupted(folder, *arguments, **options):
        made(folder, *arguments, **options)
        if ".new-" in folder.name:
            raise KeyboardInterrupt

    monkeypatch.setattr(Path, "mkdir", interrupted)
    with pytest.raises(KeyboardInterrupt):
        write_generation(tmp_path / "report", "new")
    assert list(tmp_path.iterdir()) == []


def test_second_run_to_one_folder_is_refused(tmp_path):
    final = tmp_path / "report"
    with output_folder(final) as aside:
        (aside / "file_0.txt").write_text("first")
        with pytest.raises(OutputError, match=r"another run is writing here; wait for it"):
            write_generation(final, "second")
    assert generations_in(final) == {"first"}


@pytest.mark.parametrize("is_there", [True, False])
def test_a_swap_that_a_kill_cut_short_is_finished_by_the_next_run(tmp_path, is_there):
    final = tmp_path / "report"
    if is_there:
        write_generation(final, "old")
    write_generation(tmp_path / ".report.ready", "new")
    with pytest.raises(ZeroDivisionError):
        fail_half_way(final, ZeroDivisionError())
    assert generations_in(final) == {"new"}
    assert hidden_siblings(final) == []


@pytest.mark.slow
def test_sigkill_at_any_moment_leaves_one_whole_report(tmp_path):
    final = tmp_path / "report"
    program = textwrap.dedent(f"""
        import itertools
        from pathlib import Path
        from pyomo_quad.report import folder
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
        if final.exists():  # between two renames there is none; a part of one there never is
            assert len(list(final.glob("file_*"))) == FILE_COUNT
        with pytest.raises(ZeroDivisionError):
            fail_half_way(final, ZeroDivisionError())
        assert len(list(final.glob("file_*"))) == FILE_COUNT
        assert len(generations_in(final)) == 1
    write_generation(final, "last")
    assert hidden_siblings(final) == []
