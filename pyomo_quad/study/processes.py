"""Other processes of this machine: workers that are spawned, and copies that share one job."""

import multiprocessing
import os
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from typing import Any

# Read by numerical libraries and by Python when they start, so set before a worker does.  Python's
# own watcher of shared resources outlives a killed sweep, and would tell the terminal about it.
_WARNINGS = "PYTHONWARNINGS"
_ENVIRONMENT = {
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "VECLIB_MAXIMUM_THREADS": "1",
    _WARNINGS: "ignore:resource_tracker:UserWarning",
}


_PATIENCE_S = 600.0  # with a copy that says nothing; no task takes as long
_PLACES = 256  # a place in the queue is one byte


@contextmanager
def side_by_side(
    tasks: Sequence[Callable[[], Any]],
) -> Iterator[Callable[[], tuple[Any, ...]]]:
    """Let copies of this process, one per further core, begin tasks that it then helps to end.

    A copy has all libraries and data already. What it fails at, or cannot send back, is done here,
    where what goes wrong is raised.

    Yields
    ------
    callable
        Does what is left, and returns what each task gave, in their order.
    """
    queue, entrance = os.pipe()
    os.write(entrance, bytes(range(min(len(tasks), _PLACES))))
    os.close(entrance)
    done: dict[int, Any] = {}

    def work() -> None:
        while place := os.read(queue, 1):
            for at in range(place[0], len(tasks), _PLACES):
                done[at] = tasks[at]()

    def work_apart(answer: Connection) -> None:
        # What an interrupt leaves behind is for the first process to clear away.
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_DFL)
        with suppress(Exception):
            work()
        with suppress(Exception):
            answer.send(done)
        os._exit(0)

    def finish() -> tuple[Any, ...]:
        work()
        for _, answer in copies:
            with suppress(Exception):
                done.update(answer.recv() if answer.poll(_PATIENCE_S) else {})
        return tuple(done[at] if at in done else task() for at, task in enumerate(tasks))

    copies: list[tuple[BaseProcess, Connection]] = []
    try:
        copies.extend(_copy(work_apart) for _ in range(_cores(len(tasks)) - 1))
        yield finish
    finally:
        os.close(queue)
        for process, answer in copies:
            process.kill()
            process.join()
            answer.close()


def _copy(work: Callable[[Connection], None]) -> tuple[BaseProcess, Connection]:
    """Copy this process, and return the copy and the end of a pipe that it answers through."""
    context = multiprocessing.get_context("fork")
    ours, theirs = context.Pipe(duplex=False)
    process = context.Process(target=work, args=(theirs,))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of threads, which lie idle
        process.start()
    theirs.close()
    return process, ours


def _cores(most: int) -> int:
    """Return how many processes share a job: one alone where copies are unsafe or forbidden.

    A copy does not have the threads that BLAS or OpenMP wait for; a worker is one of many already.
    """
    is_safe = sys.platform == "linux" and os.environ.get("OMP_NUM_THREADS") == "1"
    if not is_safe or multiprocessing.parent_process() is not None:
        return 1
    return min(len(os.sched_getaffinity(0)), most)


@contextmanager
def process_pool(count: int) -> Iterator[Executor]:
    """Give a pool of processes, of which none is left after the block."""
    with environment_of_workers():
        pool = pool_of(count)
        try:
            yield pool
        finally:
            end_processes(pool)


class _SpawningPool(ProcessPoolExecutor):
    """Spawns its processes deaf to Ctrl-C, which is the parent's to hear."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:  # noqa: ANN401
        # A process inherits what is held back when it is spawned, so that it hears nothing while it
        # still imports; the parent hears of it right after.
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            return super().submit(fn, *args, **kwargs)
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)


def pool_of(count: int) -> Executor:
    """Return a pool of so many processes."""
    # Spawned, not forked: Ipopt and BLAS do not survive a fork with threads.
    context = multiprocessing.get_context("spawn")
    return _SpawningPool(count, mp_context=context, initializer=_end_with_parent)


def end_processes(pool: Executor) -> None:
    """End a pool and what it runs, now."""
    for process in multiprocessing.active_children():
        process.terminate()
    pool.shutdown(wait=True, cancel_futures=True)


@contextmanager
def environment_of_workers() -> Iterator[None]:
    """Let processes that start in this block find one thread for numerics, and be silent."""
    before = {name: os.environ.get(name) for name in _ENVIRONMENT}
    os.environ.update(_ENVIRONMENT)
    os.environ[_WARNINGS] = ",".join(filter(None, (before[_WARNINGS], _ENVIRONMENT[_WARNINGS])))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def _end_with_parent() -> None:
    threading.Thread(target=_follow_parent, daemon=True).start()


def _follow_parent() -> None:
    # Workers hold both ends of the pool's pipe: without this, a killed parent leaves them waiting.
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
