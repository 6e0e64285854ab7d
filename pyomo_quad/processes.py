"""Parallel work on this machine, in new (spawned) processes or in forked copies of this process."""

import multiprocessing
import os
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, Future, ProcessPoolExecutor, wait
from contextlib import contextmanager, suppress
from multiprocessing.reduction import ForkingPickler
from time import monotonic
from typing import Any

# Environment of a worker, which numerical libraries and Python read at its start. Python's resource
# tracker outlives a killed sweep and would print warnings on the terminal.
_WARNINGS = "PYTHONWARNINGS"
_ENVIRONMENT = {
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "VECLIB_MAXIMUM_THREADS": "1",
    _WARNINGS: "ignore:resource_tracker:UserWarning",
}


# Time limit for the forked copies: a minute plus this multiple of the time that this process has
# spent on the tasks.
_PATIENCE = 10.0
# Seconds between two checks of whether the tasks were stopped.
_MOMENT_S = 0.1
_PLACES = 256  # the place of a task in the queue is one byte
_SIGNALS = {signal.SIGINT, signal.SIGTERM, signal.SIGHUP}


@contextmanager
def side_by_side(
    tasks: Sequence[Callable[[], Any]],
    *,
    use_blas: bool = True,
    is_stopped: Callable[[], bool] | None = None,
) -> Iterator[Callable[[], tuple[Any, ...]]]:
    """Context manager: run tasks in parallel, in forked copies of this process and in this process.

    The `with` block receives a function that returns all results in order. A task that gives no
    result in a copy runs again in this process.

    Parameters
    ----------
    tasks : sequence of callable
        Functions without arguments.
    use_blas : bool, optional
        Whether tasks call BLAS; see `cores`.
    is_stopped : callable, optional
        Function that returns whether the work was stopped. After a stop, this process no longer
        waits for the copies, and calls their unfinished tasks itself. Each task must therefore
        check for the stop, and return at once after it.
    """
    began = monotonic()
    queue, entrance = os.pipe()
    os.write(entrance, bytes(range(min(len(tasks), _PLACES))))
    os.close(entrance)

    def taken() -> Iterator[int]:
        while place := os.read(queue, 1):
            yield from range(place[0], len(tasks), _PLACES)

    def work_apart() -> dict[int, bytes]:
        sent = {}
        for at in taken():
            with suppress(Exception):
                sent[at] = ForkingPickler.dumps(tasks[at]()).tobytes()
        sys.stdout.flush()
        return sent

    def finish() -> tuple[Any, ...]:
        # An error of a task in this process is raised here.
        done = {at: tasks[at]() for at in taken()}
        latest = monotonic() + 60.0 + _PATIENCE * (monotonic() - began)
        while not _have_ended(answers) and monotonic() < latest:
            if is_stopped is not None and is_stopped():
                break
        for answer in wait(answers, 0.0).done:
            with suppress(Exception):
                done.update(
                    (at, ForkingPickler.loads(sent)) for at, sent in answer.result().items()
                )
        # A task without a result failed in a copy, was not finished in time or at a stop, or has a
        # result that cannot be sent.
        return tuple(done[at] if at in done else task() for at, task in enumerate(tasks))

    copies = cores(len(tasks), use_blas=use_blas) - 1
    pool = _pool(max(copies, 1), "fork", work_apart)
    answers: list[Future[dict[int, bytes]]] = []
    try:
        with suppress(OSError):  # without memory or permission for a copy, all tasks run here
            answers += [pool.submit(_at_work) for _ in range(copies)]
        yield finish
    finally:
        os.close(queue)
        end_processes(pool)


def _have_ended(answers: Sequence[Future[Any]]) -> bool:
    """Wait at most a tenth of a second, and return whether all copies have ended their tasks."""
    return not wait(answers, _MOMENT_S).not_done


def cores(most: int, *, use_blas: bool) -> int:
    """Return the number of processes among which tasks are divided, at most ``most``.

    The result counts this process and its forked copies. It is 1 in a worker process, and where a
    fork is not safe. If the tasks call BLAS (`use_blas`), a fork is safe only if the environment
    variable OMP_NUM_THREADS is 1.
    """
    # A forked copy lacks the threads of BLAS.
    is_safe = not use_blas or os.environ.get("OMP_NUM_THREADS") == "1"
    # Worker processes already share the cores.
    is_own = multiprocessing.parent_process() is None
    if sys.platform != "linux" or not (is_safe and is_own):
        return 1
    return min(len(os.sched_getaffinity(0)), most)


@contextmanager
def process_pool(count: int) -> Iterator[Executor]:
    """Context manager: yield a pool of ``count`` new (spawned) processes.

    Each process uses one thread. All processes are killed at the end of the ``with`` block, even if
    they are still working. The block changes environment variables (see `environment_of_workers`).
    """
    with environment_of_workers():
        pool = pool_of(count)
        try:
            yield pool
        finally:
            end_processes(pool)


class _QuietPool(ProcessPoolExecutor):
    """Pool of processes that ignore Ctrl-C and SIGHUP, which the parent process handles.

    At its start, a process also ignores SIGTERM until it calls `_begin`.
    """

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:  # noqa: ANN401
        # A process inherits the signal mask with which it starts, so it neither ends during its
        # imports nor runs its parent's handlers. The parent receives the signals right after.
        before = signal.pthread_sigmask(signal.SIG_BLOCK, _SIGNALS)
        try:
            with warnings.catch_warnings():
                # Warns of a fork beside threads: `cores` allows a fork only where the threads are
                # idle.
                warnings.simplefilter("ignore", DeprecationWarning)
                return super().submit(fn, *args, **kwargs)
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _pool(count: int, method: str, work: Callable[[], Any] | None = None) -> Executor:
    context = multiprocessing.get_context(method)
    return _QuietPool(count, mp_context=context, initializer=_begin, initargs=(work,))


_work: Callable[[], Any] | None = None


def _begin(work: Callable[[], Any] | None) -> None:
    """Initialise a process of a pool, which calls this function once at its start.

    The process stores the function `work`, which `_at_work` calls; None in a pool that does not use
    `_at_work`. The process now ends if it receives SIGTERM, or if its parent process ends.
    """
    global _work  # noqa: PLW0603  a copy inherits its work, which cannot be pickled
    _work = work
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGTERM})
    threading.Thread(target=_follow_parent, daemon=True).start()


def _at_work() -> Any:  # noqa: ANN401  the answer of any work
    return _work() if _work is not None else None


def pool_of(count: int) -> Executor:
    """Return a pool of ``count`` new processes, which the caller must end with `end_processes`."""
    # Spawned, not forked: Ipopt and BLAS do not survive a fork with threads.
    return _pool(count, "spawn")


def end_processes(pool: Executor) -> None:
    """Kill the processes of a pool at once, even while they work, and shut the pool down."""
    # Python has a public method for this from 3.14 on.
    processes = list((getattr(pool, "_processes", None) or {}).values())
    for process in processes:
        process.kill()
    pool.shutdown(wait=True, cancel_futures=True)
    for process in processes:
        process.join()


@contextmanager
def environment_of_workers() -> Iterator[None]:
    """Context manager: processes started in the block use one thread.

    The processes also print no warnings of Python's resource tracker. The environment variables of
    this process are changed for the duration of the block.
    """
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


def _follow_parent() -> None:
    # Workers hold both ends of the pool's pipe; without this, they would wait for a killed parent.
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
