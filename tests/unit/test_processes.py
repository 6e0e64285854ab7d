"""One job on many cores: what each task gives, in order, whatever becomes of the copies."""

import multiprocessing
import os
import signal
import subprocess
import sys
import time
from functools import partial

import pytest

from pyomo_quad import processes
from pyomo_quad.processes import side_by_side


@pytest.fixture(params=[1, 2, 3])
def cores(request, monkeypatch):
    monkeypatch.setattr(processes, "cores", lambda most, **_: min(request.param, most))
    return request.param


def all_of(tasks):
    with side_by_side(tasks) as finish:
        return finish()


def slow_square(number):
    time.sleep(0.01)
    return number**2, os.getpid()


@pytest.mark.usefixtures("cores")
@pytest.mark.parametrize("count", [0, 1, 7, 300])
def test_results_come_in_the_order_of_the_tasks(count):
    assert all_of([partial(pow, number, 2) for number in range(count)]) == tuple(
        number**2 for number in range(count)
    )


def test_all_cores_take_part(cores):
    squares, workers = zip(*all_of([partial(slow_square, n) for n in range(12)]), strict=True)
    assert squares == tuple(n**2 for n in range(12))
    assert len(set(workers)) == cores


def test_copies_work_before_they_are_waited_for(cores, tmp_path):
    with side_by_side([(tmp_path / name).touch for name in "ab"]) as finish:
        deadline = time.monotonic() + 20.0
        while cores > 1 and len(list(tmp_path.iterdir())) < 2 and time.monotonic() < deadline:
            time.sleep(0.005)
        assert len(list(tmp_path.iterdir())) == (2 if cores > 1 else 0)
        finish()
    assert len(list(tmp_path.iterdir())) == 2


def unpicklable():
    return lambda: "made"


@pytest.mark.usefixtures("cores")
def test_what_cannot_be_sent_back_is_done_here():
    assert [made() for made in all_of([unpicklable] * 4)] == ["made"] * 4


def dies_apart():
    if multiprocessing.parent_process() is not None:
        os.kill(os.getpid(), signal.SIGKILL)
    return "done"


@pytest.mark.usefixtures("cores")
def test_what_a_killed_copy_leaves_is_done_here():
    assert all_of([dies_apart] * 4) == ("done",) * 4


def fails():
    raise ValueError("too little air")


@pytest.mark.usefixtures("cores")
def test_a_fault_is_raised_here_and_leaves_no_copy(capfd):
    with pytest.raises(ValueError, match="too little air"):
        all_of([fails, partial(time.sleep, 0.0), fails])
    assert multiprocessing.active_children() == []
    assert capfd.readouterr().err == ""


@pytest.mark.usefixtures("cores")
def test_processes_of_the_caller_live_on():
    own = multiprocessing.get_context("spawn").Process(target=time.sleep, args=(60,))
    own.start()
    try:
        assert all_of([partial(pow, 2, 2)] * 4) == (4,) * 4
        assert own.is_alive()
    finally:
        own.kill()
        own.join()


@pytest.mark.usefixtures("cores")
def test_results_larger_than_a_pipe_arrive():
    assert [len(text) for text in all_of([partial(str.ljust, "", 10**6)] * 5)] == [10**6] * 5


@pytest.mark.usefixtures("cores")
def test_without_leave_to_fork_all_is_done_here(monkeypatch):
    def fork():
        raise BlockingIOError(11, "Resource temporarily unavailable")

    monkeypatch.setattr(os, "fork", fork)
    assert {worker for _, worker in all_of([partial(slow_square, 2)] * 4)} == {os.getpid()}


@pytest.mark.usefixtures("cores")
def test_what_a_copy_prints_is_not_lost(capfd):
    all_of([partial(print, "flown")] * 6)
    # Copies share the stream: a line may begin before another has ended.
    assert capfd.readouterr().out.count("flown") == 6


ABANDONED = """
import os, signal, time
from pathlib import Path
from pyomo_quad import processes

def begun_for_long():
    Path({begun!r}).touch()
    time.sleep(600)

processes.cores = lambda most, **_: 2
with processes.side_by_side([begun_for_long] * 2):
    while not Path({begun!r}).exists():
        time.sleep(0.01)
    os.kill(os.getpid(), signal.SIGKILL)
"""


def test_a_copy_ends_with_the_process_that_it_copies(tmp_path):
    # A copy holds the standard output that it inherited: as long as it lives, this waits.
    program = ABANDONED.format(begun=str(tmp_path / "begun"))
    command = [sys.executable, "-c", program]
    ended = subprocess.run(command, capture_output=True, timeout=60, check=False)
    assert ended.returncode == -signal.SIGKILL


@pytest.mark.parametrize(("threads", "most"), [("1", 2), ("2", 1), (None, 1)])
def test_a_process_whose_libraries_have_threads_is_not_copied(monkeypatch, threads, most):
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1})
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    if threads is not None:
        monkeypatch.setenv("OMP_NUM_THREADS", threads)
    assert processes.cores(8, use_blas=True) == most
    assert processes.cores(8, use_blas=False) == 2
    monkeypatch.setattr(multiprocessing, "parent_process", lambda: "a sweep")
    assert processes.cores(8, use_blas=False) == 1
