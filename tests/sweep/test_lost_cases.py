"""A case whose worker died is tried again, and leaves no trace in the rows of its neighbours."""

import os
import signal
import subprocess
import sys
import time
from collections import Counter
from concurrent.futures import Executor, Future
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path

import pytest

from pyomo_quad.sweep import Workers, design_sweep, load_study
from pyomo_quad.sweep.case import perform
from pyomo_quad.sweep.design import expand
from tests.sweep import stand_in
from tests.sweep.studies import write_study
from tests.sweep.sweeping import AfterCases, Here, press_ctrl_c, rows, sweep

REPOSITORY = Path(__file__).parents[2]


class DyingPool(Executor):
    """Solves at the end of each batch; a case with deaths left breaks it for all in the batch."""

    def __init__(self, deaths: Counter[str], solved: list[str]) -> None:
        self._deaths = deaths
        self._solved = solved
        self._batch: list[tuple[Future, object]] = []
        self._is_broken = False

    def submit(self, _, /, task):
        if self._is_broken:
            raise BrokenProcessPool
        future: Future = Future()
        self._batch.append((future, task))
        dying = self._deaths[task.key] > 0
        if dying:
            self._deaths[task.key] -= 1
            self._is_broken = True
        if dying or len(self._batch) == 3:
            self.finish()
        return future

    def finish(self) -> None:
        for future, task in self._batch:
            if self._is_broken:
                future.set_exception(BrokenProcessPool())
            else:
                self._solved.append(task.key)
                future.set_result(perform(task))
        self._batch.clear()


class Dying(Workers):
    """Workers of which one dies whenever it is given a case with deaths left."""

    def __init__(self, deaths: dict[str, int]) -> None:
        self.solved: list[str] = []
        self.pools: list[DyingPool] = []
        super().__init__(
            description="dying", begin=self._start, end=lambda _: None, count=self._count
        )
        self._deaths = Counter(deaths)

    def _start(self) -> DyingPool:
        self.pools.append(DyingPool(self._deaths, self.solved))
        return self.pools[-1]

    def _count(self) -> int:
        return 2

    def wait(self):
        for pool in self.pools:
            pool.finish()
        return super().wait()


class Alone(Dying):
    """The same, one case at a time."""

    def _start(self) -> DyingPool:
        pool = super()._start()
        submit = pool.submit

        def submit_and_finish(call, /, task):
            future = submit(call, task)
            pool.finish()
            return future

        pool.submit = submit_and_finish
        return pool


@pytest.fixture
def study(tmp_path):
    return write_study(tmp_path)


@pytest.fixture
def expected(study, tmp_path):
    sweep(study, tmp_path / "expected", Here())
    return rows(tmp_path / "expected")


@pytest.fixture
def keys(study):
    return [case.key for case in expand(design_sweep(load_study(study)))]


@pytest.fixture
def with_children(study):
    """Give the key of a case that has a parent and from which others start."""
    cases = expand(design_sweep(load_study(study)))
    parents = {case.parent for case in cases}
    return next(one.key for one in cases if one.parent is not None and one.position in parents)


@pytest.mark.lengthy
@pytest.mark.parametrize("step", [7, 1])
def test_workers_that_die_once_change_no_row(study, tmp_path, expected, keys, step):
    deaths = dict.fromkeys(keys[::step], 1)
    summary = sweep(study, tmp_path / "out", Alone(deaths))
    assert (summary.finished, summary.failed, summary.lost, summary.missing) == (50, 0, 0, 0)
    assert rows(tmp_path / "out").equals(expected)


@pytest.mark.lengthy
def test_a_case_is_lost_only_when_its_worker_dies_alone_too_and_resume_makes_up_for_it(
    study, tmp_path, expected, with_children
):
    folder = tmp_path / "out"
    summary = sweep(study, folder, Alone({with_children: 2}))
    assert (summary.finished, summary.failed, summary.lost, summary.missing) == (49, 0, 1, 0)
    (lost,) = rows(folder).query("status != 'finished'").to_dict("records")
    assert lost["status"] == "lost"
    assert lost["reason"].startswith("its worker died, also when it was tried alone; run the same")
    # What started from it goes back to its own parent meanwhile.
    assert (rows(folder)["lineage"] != expected["lineage"]).sum() > 1

    again = sweep(study, folder, Alone({with_children: 2}))
    assert (again.finished, again.lost, again.already_finished) == (0, 1, 49)

    healed = sweep(study, folder, Here())
    assert (healed.lost, healed.missing) == (0, 0)
    assert healed.already_finished + healed.finished == 50
    assert rows(folder).equals(expected)


@pytest.mark.lengthy
def test_resume_that_is_interrupted_amid_the_rows_made_again_heals_as_well(
    study, tmp_path, expected, with_children
):
    folder = tmp_path / "out"
    sweep(study, folder, Alone({with_children: 2}))
    interrupt = AfterCases(2, press_ctrl_c)
    assert sweep(study, folder, Here(), interrupt).is_interrupted
    sweep(study, folder, Here())
    assert rows(folder).equals(expected)


@pytest.mark.lengthy
def test_failures_of_the_numerics_stay(study, tmp_path):
    study.write_text(study.read_text().replace("first = 4.0", "first = 2.5"))
    sweep(study, tmp_path / "out", Here())
    again = Here()
    summary = sweep(study, tmp_path / "out", again)
    assert again.solved == []
    assert summary.already_finished == 50


def children_of(process: int) -> list[int]:
    found = []
    for status in Path("/proc").glob("[0-9]*/stat"):
        try:
            parent = int(status.read_text().rsplit(")", 1)[1].split()[1])
            command = (status.parent / "cmdline").read_text()
        except OSError:
            continue
        if parent == process and "spawn_main" in command:
            found.append(int(status.parent.name))
    return found


@pytest.mark.slow
def test_nothing_of_killed_processes_is_seen_on_the_terminal(study, tmp_path):
    log = tmp_path / "log"
    environment = os.environ | {stand_in.SECONDS: "0.05", stand_in.LOG: str(log)}
    command = [sys.executable, "-m", "tests.sweep.sweeping", study, tmp_path / "out", "2"]
    process = subprocess.Popen(
        command, cwd=REPOSITORY, env=environment, stderr=subprocess.PIPE, text=True
    )
    for signaled in (children_of, lambda parent: [parent]):
        count = len(log.read_text().split()) if log.exists() else 0
        while not log.exists() or len(log.read_text().split()) < count + 4:
            assert process.poll() is None
            time.sleep(0.01)
        os.kill(signaled(process.pid)[0], signal.SIGKILL)
    # It ends when the last process that holds it has ended.
    assert process.communicate(timeout=60)[1] == ""
