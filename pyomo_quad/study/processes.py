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
from multiprocessing.reduction import ForkingPickler
from time import monotonic
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


# A copy is waited for so many times as long as this process was at the job, and a minute.
_PATIENCE = 10.0
_PLACES = 256  # a place in the queue is one byte
_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
# A terminal sends them to all processes of a command at once.
_OF_TERMINALS = {signal.SIGINT, signal.SIGHUP}


@contextmanager
def side_by_side(
    tasks: Sequence[Callable[[], Any]], *, use_blas: bool = True
) -> Iterator[Callable[[], tuple[Any, ...]]]:
    """Let copies of this process, one per further core, begin tasks that it then helps to end.

    A copy has all libraries and data already, and ends with this process. What it fails at, or
    cannot send back, is done here, where what goes wrong is raised. Where copies are not safe, as
    beside threads of BLAS that tasks would wait for, all is done here.

    Yields
    ------
    callable
        Does what is left, and returns what each task gave, in their order.
    """
    began = monotonic()
    queue, entrance = os.pipe()
    os.write(entrance, bytes(range(min(len(tasks), _PLACES))))
    os.close(entrance)

    def taken() -> Iterator[int]:
        while place := os.read(queue, 1):
            yield from range(place[0], len(tasks), _PLACES)

    def work_apart(answer: Connection) -> None:
        sent = {}
        for at in taken():
            with suppress(Exception):
                sent[at] = ForkingPickler.dumps(tasks[at]()).tobytes()
        answer.send(sent)

    def finish() -> tuple[Any, ...]:
        done = {at: tasks[at]() for at in taken()}
        deadline = monotonic() + 60.0 + _PATIENCE * (monotonic() - began)
        for _, answer in copies:
            with suppress(Exception):
                sent = answer.recv() if answer.poll(max(deadline - monotonic(), 0.0)) else {}
                done.update((at, ForkingPickler.loads(result)) for at, result in sent.items())
        return tuple(done[at] if at in done else task() for at, task in enumerate(tasks))

    copies: list[tuple[BaseProcess, Connection]] = []
    try:
        # What no copy can be made for is done here.
        with suppress(OSError):
            copies.extend(
                _copy(work_apart) for _ in range(_cores(len(tasks), use_blas=use_blas) - 1)
            )
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
    # A daemon, so that an end of this process which nobody foresaw is not held up by it.
    process = context.Process(target=_at_work, args=(work, theirs, ours), daemon=True)
    # A signal must not find the copy with the handlers of this process, which clear away after it.
    held = signal.pthread_sigmask(signal.SIG_BLOCK, _SIGNALS)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # of threads, which lie idle
            process.start()
    except OSError:
        ours.close()
        raise
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, held)
        theirs.close()
    return process, ours


def _at_work(
    work: Callable[[Connection], None], answer: Connection, others_end: Connection
) -> None:
    """Be a copy: work, answer, and end without what a process does at its end."""
    try:
        for number in _SIGNALS:
            if signal.getsignal(number) is not signal.SIG_IGN:
                signal.signal(number, signal.SIG_DFL)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, _SIGNALS)
        others_end.close()  # else nobody would tell it that the other end is gone
        _end_with_parent()
        work(answer)
        for stream in (sys.stdout, sys.stderr):
            stream.flush()
    finally:
        os._exit(0)


def _cores(most: int, *, use_blas: bool) -> int:
    """Return how many processes share a job: one alone where copies are unsafe or forbidden.

    A copy does not have the threads that BLAS or OpenMP wait for; a worker is one of many already.
    """
    is_safe = not use_blas or os.environ.get("OMP_NUM_THREADS") == "1"
    is_own = multiprocessing.parent_process() is None
    if sys.platform != "linux" or not (is_safe and is_own):
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
    """Spawns its processes deaf to what a terminal sends, which is the parent's to hear."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:  # noqa: ANN401
        # A process inherits what is held back when it is spawned, so that it hears nothing while it
        # still imports; the parent hears of it right after.
        before = signal.pthread_sigmask(signal.SIG_BLOCK, _OF_TERMINALS)
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
