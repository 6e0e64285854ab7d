"""A sweep that is killed at any moment loses no finished case and solves none of them again."""

import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from pyomo_quad.sweep import ResultStore, StoreError
from tests.sweep import stand_in
from tests.sweep.studies import write_study
from tests.sweep.sweeping import Here, rows, sweep

REPOSITORY = Path(__file__).parents[2]
AXES = """
[[axis]]
path = "mission.duration"
linear = { first = 4.0, last = 23.0, count = 20 }

[[axis]]
path = "vehicle.payload"
linear = { first = 0.0, last = 0.2, count = 10 }
"""


def start(study: Path, folder: Path, log: Path) -> subprocess.Popen:
    environment = os.environ | {stand_in.SECONDS: "0.005", stand_in.LOG: str(log)}
    command = [sys.executable, "-m", "tests.sweep.sweeping", str(study), str(folder), "2"]
    return subprocess.Popen(command, cwd=REPOSITORY, env=environment)


def stored(folder: Path) -> set[str]:
    try:
        with ResultStore.reading(folder) as store:
            return set(store.statuses())
    except StoreError:
        return set()


def kill_after(process: subprocess.Popen, folder: Path, count: int, delay: float) -> set[str]:
    """Kill a sweep some moment after it has stored so many cases; return what is stored then."""
    while len(stored(folder)) < count and process.poll() is None:
        time.sleep(0.01)
    time.sleep(delay)
    assert process.poll() is None, "the sweep ended before it could be killed"
    process.send_signal(signal.SIGKILL)
    process.wait()
    return stored(folder)


@pytest.mark.slow
def test_three_kills_end_with_every_row_and_none_solved_twice(tmp_path):
    study, folder, log = write_study(tmp_path, AXES), tmp_path / "out", tmp_path / "log"
    moments = random.Random(20)
    kept: set[str] = set()
    for count in (moments.randint(0, 40), moments.randint(60, 90), moments.randint(110, 150)):
        solved_before = len(log.read_text().split()) if log.exists() else 0
        kept_now = kill_after(start(study, folder, log), folder, count, moments.random() * 0.02)
        time.sleep(0.1)  # a worker notices the death of its parent
        assert kept <= kept_now
        assert kept.isdisjoint(log.read_text().split()[solved_before:])
        kept = kept_now
    solved_before = len(log.read_text().split())
    assert start(study, folder, log).wait(timeout=300) == 0
    solved_last = log.read_text().split()[solved_before:]
    assert len(solved_last) == 200 - len(kept)
    assert kept.isdisjoint(solved_last)

    undisturbed = tmp_path / "undisturbed"
    sweep(study, undisturbed, Here())
    assert len(rows(folder)) == 200
    assert rows(folder).equals(rows(undisturbed))


@pytest.mark.lengthy
def test_an_ended_sweep_solves_nothing_more(tmp_path):
    study, folder = write_study(tmp_path), tmp_path / "out"
    sweep(study, folder, Here())
    again = Here()
    summary = sweep(study, folder, again)
    assert again.solved == []
    assert (summary.total, summary.already_finished, summary.missing) == (50, 50, 0)
