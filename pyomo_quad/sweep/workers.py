"""Workers that solve the cases of a sweep: processes of this machine, or a Dask cluster.

Both offer an Executor of `concurrent.futures`. If a worker dies, for example for lack of memory,
`Workers` starts a new executor. Any running case may have killed the worker, so all of them are
solved again, one at a time. A case is given up if a worker dies again while the case runs.
"""

from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    wait,
)
from contextlib import contextmanager
from dataclasses import dataclass, field

from pyomo_quad.processes import end_processes, environment_of_workers, pool_of
from pyomo_quad.scenario.messages import PyomoQuadError
from pyomo_quad.sweep.case import CaseOutcome, CaseTask, perform

# Two tasks per worker: a second task waits, so that no worker idles while a result is transferred.
_TASKS_PER_WORKER = 2
# Seconds between two checks of a silent executor and its workers.
WATCH_SECONDS = 2.0


class ClusterError(PyomoQuadError, RuntimeError):
    """Error: a Dask cluster cannot be used, or was lost during a sweep.

    This machine needs the package `dask.distributed`. Each worker needs the same version of
    pyomo_quad as this machine.

    Results of cases that finished before the error remain in the result store.
    """


@dataclass(kw_only=True, eq=False)
class Workers:
    """Executor for the cases of a sweep that recovers from the death of worker processes.

    Attributes
    ----------
    description : str
        Name of the workers in messages.
    begin : callable
        Function that starts an executor and returns it.
    end : callable
        Function that stops an executor without waiting for its running tasks.
    count : callable
        Function that returns the number of tasks that can run at a time. The function raises
        ClusterError if the cluster is lost.
    """

    description: str
    begin: Callable[[], Executor]
    end: Callable[[Executor], None]
    count: Callable[[], int]
    _executor: Executor | None = None
    _under_way: dict[Future[CaseOutcome], CaseTask] = field(default_factory=dict)
    # Cases to solve again one at a time, and keys of all cases that ran when a worker died.
    _suspects: deque[CaseTask] = field(default_factory=deque)
    _accused: set[str] = field(default_factory=set)
    _is_alone: bool = False

    @property
    def room(self) -> int:
        """Number of further cases that may be submitted now.

        After a worker has died, the cases that were running are solved again, one at a time. Until
        all of them have ended, the number is 0.
        """
        if self._suspects or self._is_alone:
            return 0
        # Without any worker, one task waits for the first worker to connect.
        return max(1, _TASKS_PER_WORKER * self.count()) - len(self._under_way)

    def submit(self, task: CaseTask) -> None:
        """Submit a case to the executor, which is started if necessary.

        Parameters
        ----------
        task : CaseTask
            Input of the case solver.
        """
        if self._executor is None:
            self._executor = self.begin()
        try:
            self._under_way[self._executor.submit(perform, task)] = task
        except BrokenExecutor:
            self._suspects.append(task)
            self._suspect_all()

    def wait(self) -> list[CaseOutcome]:
        """Wait until at least one submitted case has ended.

        If no submitted case is running or waiting, the method never returns.

        Returns
        -------
        list of CaseOutcome
            Rows of all cases that have ended since the last call. A case whose worker process dies
            is solved again while no other case runs. If its worker process dies again, the case has
            the status `LOST`.

        Raises
        ------
        ClusterError
            If the cluster no longer answers.
        """
        outcomes: list[CaseOutcome] = []
        while not outcomes:
            if self._suspects and not self._under_way:
                self._is_alone = True
                self.submit(self._suspects.popleft())
            done, _ = wait(self._under_way, WATCH_SECONDS, FIRST_COMPLETED)
            if not done:
                self.count()
            for future in [one for one in self._under_way if one in done]:
                outcomes += self._collect(future)
            self._is_alone = self._is_alone and bool(self._under_way)
        return outcomes

    def stop(self) -> list[CaseOutcome]:
        """Stop the executor, and return the rows of cases that ended after the last call of `wait`.

        All other submitted cases are discarded.
        """
        outcomes = [
            future.result()
            for future in self._under_way
            if future.done() and not future.cancelled() and future.exception() is None
        ]
        self._under_way.clear()
        self._suspects.clear()
        self._abandon()
        return outcomes

    def _collect(self, future: Future[CaseOutcome]) -> list[CaseOutcome]:
        task = self._under_way.pop(future, None)
        if task is None:
            return []
        try:
            return [future.result()]
        except CancelledError:
            raise ClusterError(f"{self.description}: no longer answers.") from None
        # `perform` raises nothing, so an exception shows that a worker has died.
        except Exception as error:  # noqa: BLE001
            # The first death of a worker while a case runs, even alone, only makes it a suspect.
            is_lost = self._is_alone and task.key in self._accused
            if not is_lost:
                self._accuse(task)
            if isinstance(error, BrokenExecutor):
                self._suspect_all()
            return [CaseOutcome.loss(task)] if is_lost else []

    def _accuse(self, task: CaseTask) -> None:
        self._suspects.append(task)
        self._accused.add(task.key)

    def _suspect_all(self) -> None:
        """Queue all running cases of a broken executor, to be solved again one at a time.

        Any of them may have killed the worker process.
        """
        for future, task in list(self._under_way.items()):
            if not future.done() or future.exception() is not None:
                self._accuse(task)
                del self._under_way[future]
        self._abandon()

    def _abandon(self) -> None:
        if self._executor is not None:
            self.end(self._executor)
            self._executor = None


@contextmanager
def process_workers(count: int) -> Iterator[Workers]:
    """Context manager: run the cases of a sweep in worker processes of this machine.

    Parameters
    ----------
    count : int
        Number of processes, each of which solves one case at a time on one thread.

    Yields
    ------
    Workers
        Workers for `Sweep.run`. The processes are stopped on exit.

    Examples
    --------
    >>> from pyomo_quad.sweep import ResultStore, SilentListener, Sweep, design_sweep, load_study
    >>> loaded = load_study("hop_study.toml")
    >>> design = design_sweep(loaded)
    >>> with process_workers(2) as workers, ResultStore.writing("solved", design) as store:
    ...     summary = Sweep(design, loaded.base, store, SilentListener()).run(workers)
    >>> summary.finished
    2
    """
    with environment_of_workers():
        workers = Workers(
            description=f"{count} worker process{'es' if count > 1 else ''}",
            begin=lambda: pool_of(count),
            end=end_processes,
            count=lambda: count,
        )
        try:
            yield workers
        finally:
            workers.stop()
