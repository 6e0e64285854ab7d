"""Worker processes of this machine: spawned, deaf to Ctrl-C, gone with their parent."""

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from contextlib import contextmanager
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
