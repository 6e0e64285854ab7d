"""Worker processes on this machine, from the standard library's pool.

Processes are spawned, not forked: Ipopt and BLAS do not survive a fork with threads.  Each has one
BLAS thread, dies with its parent however the parent dies, and leaves Ctrl-C to the parent.
"""

import multiprocessing
import os
import signal
import threading
from collections import deque
from collections.abc import Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager

from pyomo_quad.study.sweep.task import CaseOutcome, CaseTask, perform

__all__ = ["ProcessWorkforce", "one_thread_each", "prepare_worker"]

# Numerical libraries read these when they are loaded, so they are set before a worker starts.
_THREAD_VARIABLES = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
)
# One task waits behind each running one, so that no worker idles while its result is stored.
_TASKS_PER_WORKER = 2


class ProcessWorkforce:
    """A pool of worker processes that outlives the death of one of them.

    A process that dies takes the whole standard pool with it, and nobody can say which case it
    was.  All cases that were under way are then tried again one at a time in a new pool; the one
    that kills its process while alone becomes a failed row.

    Parameters
    ----------
    count : int
        Number of processes.
    """

    def __init__(self, count: int) -> None:
        self._count = count
        self._pool: ProcessPoolExecutor | None = None
        self._running: dict[Future[CaseOutcome], CaseTask] = {}
        self._suspects: deque[CaseTask] = deque()

    @classmethod
    @contextmanager
    def of(cls, count: int) -> Iterator["ProcessWorkforce"]:
        """Keep worker processes for the length of a block.

        Parameters
        ----------
        count : int
            Number of processes.

        Yields
        ------
        ProcessWorkforce
            Its processes start with the first task.
        """
        workforce = cls(count)
        with one_thread_each():
            try:
                yield workforce
            finally:
                workforce._close()

    @property
    def room(self) -> int:
        """How many more tasks it wants now."""
        if self._suspects:
            return 0
        return _TASKS_PER_WORKER * self._count - len(self._running)

    @property
    def description(self) -> str:
        """Who works, for people."""
        return f"{self._count} worker process{'es' if self._count > 1 else ''}"

    def submit(self, task: CaseTask) -> None:
        """Take a task.

        Parameters
        ----------
        task : CaseTask
            The case to solve.
        """
        if self._pool is None:
            self._pool = ProcessPoolExecutor(
                self._count,
                mp_context=multiprocessing.get_context("spawn"),
                initializer=prepare_worker,
            )
        try:
            self._running[self._pool.submit(perform, task)] = task
        except BrokenProcessPool:
            self._suspects.append(task)
            self._suspect_all_running()

    def wait(self) -> list[CaseOutcome]:
        """Wait until at least one task has ended.

        Returns
        -------
        list of CaseOutcome
            All that ended since the last call.
        """
        is_alone = False
        if self._suspects and not self._running:
            self.submit(self._suspects.popleft())
            is_alone = True
        done, _ = wait(self._running, return_when=FIRST_COMPLETED)
        outcomes = []
        for future in done:
            if isinstance(future.exception(), BrokenProcessPool):
                continue
            outcomes.append(future.result())
            del self._running[future]
        broken = [self._running[future] for future in done if future in self._running]
        if broken and is_alone:
            self._abandon_pool()
            return [CaseOutcome.failure(broken[0], "the worker process died in this case")]
        if broken:
            self._suspect_all_running()
        return outcomes or self.wait()

    def drain(self) -> list[CaseOutcome]:
        """Start nothing more, and wait for the tasks that are running.

        Returns
        -------
        list of CaseOutcome
            Those that ended well; tasks not started are forgotten.
        """
        self._suspects.clear()
        kept = [future for future in self._running if not future.cancel()]
        wait(kept)
        self._running.clear()
        return [future.result() for future in kept if future.exception() is None]

    def _suspect_all_running(self) -> None:
        self._suspects.extend(self._running.values())
        self._abandon_pool()

    def _abandon_pool(self) -> None:
        self._running.clear()
        if self._pool is not None:
            self._pool.shutdown(wait=True, cancel_futures=True)
            self._pool = None

    def _close(self) -> None:
        if self._pool is not None:
            self._pool.shutdown(wait=True, cancel_futures=True)


@contextmanager
def one_thread_each() -> Iterator[None]:
    """Let processes started in this block compute with one BLAS thread.

    Yields
    ------
    None
        The environment is as before at the end of the block.
    """
    before = {name: os.environ.get(name) for name in _THREAD_VARIABLES}
    os.environ.update(dict.fromkeys(_THREAD_VARIABLES, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def prepare_worker() -> None:
    """Leave Ctrl-C to the parent, and end with it however it ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_follow_parent, daemon=True).start()


def _follow_parent() -> None:
    # Workers hold both ends of the pool's pipe: without this, a killed parent leaves them waiting.
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
