"""The sweep itself: who solves the cases, and how they are handed out and committed.

A case is handed out when its parent is finished, and committed as it comes back.  Processes of this
machine or a Dask cluster solve it, each behind an Executor: `concurrent.futures` does the work.
What it leaves to its user is here: an executor that broke is made anew, and a case whose worker
died is tried again alone, so that one that kills its worker takes no other case with it.
"""

import logging
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    wait,
)
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from statistics import fmean
from typing import TYPE_CHECKING, Protocol

from pyomo_quad.scenario.messages import PyomoQuadError
from pyomo_quad.scenario.schema import Scenario
from pyomo_quad.study.processes import end_processes, environment_of_workers, pool_of
from pyomo_quad.sweep.case import CaseOutcome, CaseStatus, CaseTask, perform, worker_version
from pyomo_quad.sweep.design import Case, SweepDesign, expand
from pyomo_quad.sweep.store import STORE_NAME, ResultStore
from pyomo_quad.version import __version__

if TYPE_CHECKING:
    from distributed import Client


# One task waits behind each running one, so that no worker idles while its result travels.
_TASKS_PER_WORKER = 2
_CONNECT_SECONDS = 10.0
# How often a silent executor is asked whether it still lives, and how many workers it has.
_WATCH_SECONDS = 2.0
_DASK_LOGGERS = ("distributed", "tornado", "asyncio")


class ClusterError(PyomoQuadError, RuntimeError):
    """A Dask cluster cannot be reached or was lost; finished cases are kept."""


@dataclass(frozen=True, kw_only=True)
class Crew:
    """Where executors come from.

    Attributes
    ----------
    description : str
        Who works, for people.
    start : callable
        Makes an executor.
    stop : callable
        Ends one without waiting for what it runs.
    count : callable
        How many tasks run at a time now; raises ClusterError where nobody answers any more.
    """

    description: str
    start: Callable[[], Executor]
    stop: Callable[[Executor], None]
    count: Callable[[], int]


class Workers:
    """The cases under way on a crew's executor."""

    def __init__(self, crew: Crew) -> None:
        self.description = crew.description
        self._crew = crew
        self._executor: Executor | None = None
        self._under_way: dict[Future[CaseOutcome], CaseTask] = {}
        # Cases to try alone, and those of all that were in a worker's hands when one died.
        self._suspects: deque[CaseTask] = deque()
        self._accused: set[str] = set()
        self._is_alone = False

    @property
    def room(self) -> int:
        """How many more tasks are wanted now."""
        if self._suspects or self._is_alone:
            return 0
        # Without any worker, one task waits for the first to come.
        return max(1, _TASKS_PER_WORKER * self._crew.count()) - len(self._under_way)

    def submit(self, task: CaseTask) -> None:
        """Take a task."""
        if self._executor is None:
            self._executor = self._crew.start()
        try:
            self._under_way[self._executor.submit(perform, task)] = task
        except BrokenExecutor:
            self._suspects.append(task)
            self._suspect_all()

    def wait(self) -> list[CaseOutcome]:
        """Wait until at least one task has ended, and return all that have."""
        outcomes: list[CaseOutcome] = []
        while not outcomes:
            if self._suspects and not self._under_way:
                self._is_alone = True
                self.submit(self._suspects.popleft())
            done, _ = wait(self._under_way, _WATCH_SECONDS, FIRST_COMPLETED)
            if not done:
                self._crew.count()
            for future in [one for one in self._under_way if one in done]:
                outcomes += self._collect(future)
            self._is_alone = self._is_alone and bool(self._under_way)
        return outcomes

    def stop(self) -> list[CaseOutcome]:
        """Give up what is running, and return what had ended."""
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
        # `perform` raises nothing: whatever comes instead of an outcome says that a worker is gone.
        except Exception as error:  # noqa: BLE001
            return self._suspect(task, error)

    def _suspect(self, task: CaseTask, error: Exception) -> list[CaseOutcome]:
        # One that no worker ever had before may be tried alone a second time.
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
        """Set aside all cases under way on a broken executor: nobody can say which one broke it."""
        for future, task in list(self._under_way.items()):
            if not future.done() or future.exception() is not None:
                self._accuse(task)
                del self._under_way[future]
        self._abandon()

    def _abandon(self) -> None:
        if self._executor is not None:
            self._crew.stop(self._executor)
            self._executor = None


@contextmanager
def process_workers(count: int) -> Iterator[Workers]:
    """Keep so many processes of this machine for the length of a block."""
    with environment_of_workers():
        workers = Workers(
            Crew(
                description=f"{count} worker process{'es' if count > 1 else ''}",
                start=lambda: pool_of(count),
                stop=end_processes,
                count=lambda: count,
            )
        )
        try:
            yield workers
        finally:
            workers.stop()


@contextmanager
def cluster_workers(address: str) -> Iterator[Workers]:
    """Stay connected to a Dask cluster for the length of a block.

    Dask itself gives the cases of a lost worker to another one, and gives a case up that was lost
    several times.  When the scheduler goes, nothing can be saved but what is committed.

    Raises
    ------
    ClusterError
        If it cannot be reached, or its workers cannot do this work.
    """
    client = _connect(address)
    try:
        _check_workers(client, address)
        threads = _Threads(client, address)
        workers = Workers(
            Crew(
                description=f"Dask cluster {address}",
                start=lambda: client.get_executor(pure=False),
                stop=lambda executor: executor.shutdown(wait=False),
                count=threads.count,
            )
        )
        yield workers
        workers.stop()
    finally:
        client.close(timeout=_WATCH_SECONDS)


def _silence_dask() -> None:
    """Let Dask log nothing: what it would when it is lost is said here in one line.

    Its loggers have levels of their own once it is imported, tracebacks among what they write.
    """
    for name in list(logging.root.manager.loggerDict):
        if name.partition(".")[0] in _DASK_LOGGERS:
            logging.getLogger(name).setLevel(logging.CRITICAL + 1)


class _Threads:
    """Counts the threads of a cluster's workers, but not at every question."""

    def __init__(self, client: "Client", address: str) -> None:
        self._client = client
        self._address = address
        self._found = 0
        self._counted_at = -_WATCH_SECONDS

    def count(self) -> int:
        if time.monotonic() - self._counted_at >= _WATCH_SECONDS:
            gone = ClusterError(f"Dask cluster {self._address}: no longer answers.")
            if self._client.status != "running":
                raise gone
            try:
                self._found = sum(self._client.nthreads().values())
            except (OSError, TimeoutError):
                raise gone from None
            self._counted_at = time.monotonic()
        return self._found


def _connect(address: str) -> "Client":
    try:
        from distributed import Client  # noqa: PLC0415  an extra that few users need
    except ImportError:
        raise ClusterError(
            "--scheduler needs dask.distributed; install it with: pip install "
            '"pyomo_quad[cluster]".'
        ) from None
    _silence_dask()
    try:
        return Client(address, timeout=_CONNECT_SECONDS, set_as_default=False)
    except (OSError, TimeoutError, ValueError) as error:
        reason = " ".join(str(error).split())[:120]
        raise ClusterError(
            f"--scheduler {address}: cannot be reached ({reason}); start it with `dask "
            f"scheduler`, or leave --scheduler out to use this machine."
        ) from None


def _check_workers(client: "Client", address: str) -> None:
    try:
        versions = client.run(worker_version)
    except Exception as error:  # noqa: BLE001  whatever a foreign worker raises, it cannot serve
        raise ClusterError(
            f"--scheduler {address}: a worker cannot run pyomo_quad ({type(error).__name__}: "
            f"{error}); install pyomo_quad {__version__} on all workers."
        ) from None
    for worker, version in versions.items():
        if version != __version__:
            raise ClusterError(
                f"--scheduler {address}: worker {worker} has pyomo_quad {version}, this is "
                f"{__version__}; install the same version on all workers."
            )


FLIGHT_SOLVER = "pyomo_quad.sweep.case:solve_case"


class SweepListener(Protocol):
    """Is told how a sweep goes on."""

    def start(self, total: int, already_ended: int) -> None:
        """Hear how many cases there are, and how many need not be solved any more."""
        ...

    def case_ended(self, case: Case, outcome: CaseOutcome, done: int) -> None:
        """Hear that a case's row has been committed, and how many cases are done now."""
        ...


class SilentListener:
    """Tells nobody."""

    def start(self, total: int, already_ended: int) -> None:
        """Take no notice."""

    def case_ended(self, case: Case, outcome: CaseOutcome, done: int) -> None:
        """Take no notice."""


@dataclass(frozen=True, kw_only=True)
class SweepSummary:
    """How a sweep ended.

    Attributes
    ----------
    total : int
        Cases of the design.
    already_finished : int
        Rows that were there before and still are.
    finished, failed, lost : int
        Rows added, by how their case ended.
    is_interrupted : bool
        Whether Ctrl-C ended it.
    """

    total: int
    already_finished: int
    finished: int
    failed: int
    lost: int
    is_interrupted: bool

    @property
    def missing(self) -> int:
        """Cases without a row."""
        return self.total - self.already_finished - self.finished - self.failed - self.lost


class Sweep:
    """The cases of a design on their way into a store.

    Parameters
    ----------
    design : SweepDesign
        What is to be solved.
    base : Scenario
        The base scenario of the design.
    store : ResultStore
        Open for writing; cases that finished or failed are not solved again, those that were lost
        with their worker are.
    listener : SweepListener
        Is told of each row.
    solver : str, optional
        Case solver as ``module:function``.
    """

    def __init__(
        self,
        design: SweepDesign,
        base: Scenario,
        store: ResultStore,
        listener: SweepListener,
        solver: str = FLIGHT_SOLVER,
    ) -> None:
        self._design = design
        self._base = base
        self._store = store
        self._listener = listener
        self._solver = solver
        self._cases = expand(design)
        statuses = store.statuses()
        self._lost_before = {key for key, held in statuses.items() if held is CaseStatus.LOST}
        # Those settled before this run, and not solved anew in it.
        self._kept = statuses.keys() - self._lost_before
        self._settled = set(self._kept)
        self._lost: set[str] = set()
        self._children = _children(self._cases)
        # How many children still need what a case left: those lost may be tried again.
        self._waiting = {
            position: sum(self._cases[child].key not in self._settled for child in children)
            for position, children in self._children.items()
        }
        self._counts = dict.fromkeys(CaseStatus, 0)

    def run(self, workers: Workers) -> SweepSummary:
        """Solve all cases that have no settled row.

        Raises
        ------
        ClusterError
            If the cluster was lost; finished cases are kept.
        StoreError
            If a row cannot be written; finished cases are kept.
        """
        self._listener.start(len(self._cases), len(self._settled))
        is_interrupted = False
        try:
            self._work_off(workers)
        except KeyboardInterrupt:
            is_interrupted = True
            self._commit_all(workers.stop())
        except ClusterError as error:
            missing = len(self._cases) - len(self._settled)
            raise ClusterError(
                f"{error} {len(self._settled)} of {len(self._cases)} cases are kept in "
                f"{self._store.file.parent}; run the same command again for the other {missing}, "
                f"without --scheduler to solve them on this machine."
            ) from error
        return SweepSummary(
            total=len(self._cases),
            already_finished=len(self._kept),
            finished=self._counts[CaseStatus.FINISHED],
            failed=self._counts[CaseStatus.FAILED],
            lost=self._counts[CaseStatus.LOST],
            is_interrupted=is_interrupted,
        )

    def _work_off(self, workers: Workers) -> None:
        # Last in, first out: going deep keeps few warm starts waiting.
        roots = [case for case in reversed(self._cases) if case.parent is None]
        ready = self._next_of(roots)
        under_way = 0
        while ready or under_way:
            while ready and workers.room > 0:
                case = ready.pop()
                task = self._task(case)
                if isinstance(task, CaseOutcome):
                    ready += self._commit(task)
                else:
                    workers.submit(task)
                    under_way += 1
            if under_way:
                outcomes = workers.wait()
                under_way -= len(outcomes)
                ready += self._commit_all(outcomes)

    def _next_of(self, cases: list[Case]) -> list[Case]:
        """Return the cases to solve next: these, or below those of them that have ended."""
        found, pending = [], list(reversed(cases))
        while pending:
            case = pending.pop()
            if case.key in self._settled or case.key in self._lost:
                pending += self._children_of(case)
            else:
                found.append(case)
        return found

    def _children_of(self, case: Case) -> list[Case]:
        return [self._cases[child] for child in self._children.get(case.position, ())]

    def _task(self, case: Case) -> CaseTask | CaseOutcome:
        warm_start = None
        if case.parent is not None:
            warm_start = self._store.warm_start(self._cases[case.parent].key)
        return case_task(self._design, self._base, case, self._solver, warm_start)

    def _commit_all(self, outcomes: list[CaseOutcome]) -> list[Case]:
        return [case for outcome in outcomes for case in self._commit(outcome)]

    def _commit(self, outcome: CaseOutcome) -> list[Case]:
        """Store a row and return the cases that can start now."""
        case = self._cases[outcome.position]
        is_settled = outcome.status is not CaseStatus.LOST
        outdated = self._forget_descendants(case) if is_settled else []
        self._store.add(
            outcome,
            case.overrides,
            is_parent=self._waiting.get(case.position, 0) > 0,
            spent=self._spent_parent(case) if is_settled else "",
            outdated=outdated,
        )
        (self._settled if is_settled else self._lost).add(case.key)
        self._counts[outcome.status] += 1
        self._listener.case_ended(case, outcome, len(self._settled) + len(self._lost))
        return self._next_of(self._children_of(case))

    def _forget_descendants(self, case: Case) -> list[str]:
        """Let go of rows that go back past a case which was lost then and is settled now.

        They started from where it had started: solved again from its own result, they are what
        they would have been had no worker died.
        """
        if case.key not in self._lost_before:
            return []
        keys, pending = [], [case]
        while pending:
            one = pending.pop()
            children = self._children_of(one)
            self._waiting[one.position] = len(children)
            keys += [child.key for child in children]
            pending += children
        self._settled.difference_update(keys)
        self._kept.difference_update(keys)
        return keys

    def _spent_parent(self, case: Case) -> str:
        if case.parent is None:
            return ""
        self._waiting[case.parent] -= 1
        return self._cases[case.parent].key if self._waiting[case.parent] == 0 else ""


def case_task(
    design: SweepDesign, base: Scenario, case: Case, solver: str, warm_start: bytes | None
) -> CaseTask | CaseOutcome:
    """Spell out a case for a worker; one that asks for the impossible is a failed row at once."""
    task = CaseTask(
        position=case.position,
        key=case.key,
        solver=solver,
        scenario="",
        base=base.model_dump_json(),
        task=design.task,
        baselines=design.baselines,
        warm_start=warm_start,
    )
    try:
        scenario = base.with_values(case.overrides)
    except PyomoQuadError as error:
        return CaseOutcome.failure(task, str(error))
    return task.for_scenario(scenario.model_dump_json())


def _children(cases: tuple[Case, ...]) -> Mapping[int, list[int]]:
    children: dict[int, list[int]] = {}
    for case in cases:
        if case.parent is not None:
            children.setdefault(case.parent, []).append(case.position)
    return children


@dataclass(frozen=True, kw_only=True)
class SweepEstimate:
    """What is left of a sweep.

    Attributes
    ----------
    total, missing : int
        Cases of the design, and those without a row.
    seconds_per_case : float
        Of one worker.
    """

    total: int
    missing: int
    seconds_per_case: float

    def seconds(self, workers: int) -> float:
        """Return the time left with so many workers, if none of them waits."""
        return self.missing * self.seconds_per_case / workers


def estimate_sweep(
    design: SweepDesign, base: Scenario, folder: Path, solver: str = FLIGHT_SOLVER
) -> SweepEstimate:
    """Estimate what is left of a sweep; nothing is written."""
    cases = expand(design)
    if (folder / STORE_NAME).is_file():
        with ResultStore.reading(folder) as store:
            rows = store.rows()
        settled = {key for key, row in rows.items() if row.status is not CaseStatus.LOST}
        if settled:
            missing = sum(case.key not in settled for case in cases)
            seconds = fmean(rows[key].seconds for key in settled)
            return SweepEstimate(total=len(cases), missing=missing, seconds_per_case=seconds)
    first = next(case for case in cases if case.parent is None)
    child = next((case for case in cases if case.parent == first.position), None)
    outcome = _solved(design, base, first, solver, None)
    if child is not None:
        outcome = _solved(design, base, child, solver, outcome.warm_start)
    return SweepEstimate(total=len(cases), missing=len(cases), seconds_per_case=outcome.seconds)


def _solved(
    design: SweepDesign, base: Scenario, case: Case, solver: str, warm_start: bytes | None
) -> CaseOutcome:
    task = case_task(design, base, case, solver, warm_start)
    return task if isinstance(task, CaseOutcome) else perform(task)
