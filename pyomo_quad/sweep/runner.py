"""Run of a parameter sweep: schedule the cases on workers and store each result at once.

The cases form a tree. The children of a case are neighbouring cases: the solution of the parent is
the initial guess (warm start) of each child. A case is scheduled when its parent has ended.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import fmean
from typing import Protocol

from pyomo_quad.scenario.messages import PyomoQuadError
from pyomo_quad.scenario.schema import Scenario
from pyomo_quad.sweep.case import CaseOutcome, CaseStatus, CaseTask, perform
from pyomo_quad.sweep.design import Case, SweepDesign, expand
from pyomo_quad.sweep.store import STORE_NAME, ResultStore
from pyomo_quad.sweep.workers import ClusterError, Workers

FLIGHT_SOLVER = "pyomo_quad.sweep.case:solve_case"


class SweepListener(Protocol):
    """Interface of an object that follows the progress of a sweep, such as a progress bar.

    The methods of this base class do nothing.
    """

    def start(self, total: int, already_ended: int) -> None:
        """Receive the numbers of all cases and of those that finished or failed in earlier runs."""

    def case_ended(self, case: Case, outcome: CaseOutcome, done: int) -> None:
        """Receive a case whose result was stored.

        Parameters
        ----------
        case : Case
            The case.
        outcome : CaseOutcome
            The row of the case in the result table.
        done : int
            Number of cases that have ended in this run and in earlier runs.
        """


class SilentListener(SweepListener):
    """Listener that does nothing, for a sweep without progress display."""


@dataclass(frozen=True, kw_only=True)
class SweepSummary:
    """Numbers of solved, failed, lost and not yet ended cases at the end of a sweep's run.

    Attributes
    ----------
    total : int
        Number of cases of the sweep.
    already_finished : int
        Number of cases that were solved or failed in an earlier run, and were not solved again.
    finished, failed, lost : int
        Numbers of cases that ended in this run: solved and verified, failed, and lost because the
        worker process died.
    is_interrupted : bool
        Whether Ctrl-C ended the run early.
    """

    total: int
    already_finished: int
    finished: int
    failed: int
    lost: int
    is_interrupted: bool

    @property
    def missing(self) -> int:
        """Number of cases that have not ended, for example after Ctrl-C.

        Lost cases count as ended.
        """
        return self.total - self.already_finished - self.finished - self.failed - self.lost


class Sweep:
    """Run of a parameter sweep: solve each case that has no result, and store its row.

    Parameters
    ----------
    design : SweepDesign
        Specification of the sweep.
    base : Scenario
        Base scenario of the design.
    store : ResultStore
        Result store, open for writing. Cases that finished or failed in an earlier run are not
        solved again, with one exception. If a worker died, its lost case is solved again. The
        descendants of the lost case, which did not start from its solution, are then solved again
        too.
    listener : SweepListener
        Object that receives each row after the row was stored.
    solver : str, optional
        Function that solves one case, as ``module:function``.
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
        # Cases that finished or failed in an earlier run and are not solved again.
        self._kept = statuses.keys() - self._lost_before
        self._settled = set(self._kept)
        self._lost: set[str] = set()
        self._children = _children(self._cases)
        # Number of children of each case that still need its warm start, lost children included.
        self._waiting = {
            position: sum(self._cases[child].key not in self._settled for child in children)
            for position, children in self._children.items()
        }
        self._counts = dict.fromkeys(CaseStatus, 0)

    def run(self, workers: Workers) -> SweepSummary:
        """Solve all cases that have no result yet.

        Cases that an earlier run lost with their worker, and their descendants, are solved again.
        Ctrl-C ends the run early and stops the workers; the results so far are stored.

        Parameters
        ----------
        workers : Workers
            Processes of this machine or workers of a cluster.

        Returns
        -------
        SweepSummary
            Numbers of finished, failed and lost cases.

        Raises
        ------
        ClusterError
            If the cluster was lost; the results so far are stored.
        StoreError
            If a row cannot be written; the rows before it are stored.
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
        # Last in, first out: depth-first order keeps few warm starts in the store.
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
        """Return the cases that can be solved next: given cases, or descendants of given cases.

        A case that has ended is replaced by its children, and so on.
        """
        # A resumed sweep continues with cases whose parents ended in an earlier run.
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
        """Store the row of a case that ended, and return the cases that can be solved now.

        When all children of a case have finished or failed, the case's solution is deleted.
        """
        case = self._cases[outcome.position]
        is_settled = outcome.status is not CaseStatus.LOST
        outdated = self._forget_descendants(case) if is_settled else []
        self._store.add(
            outcome,
            case.overrides,
            is_parent=self._waiting.get(case.position, 0) > 0,
            # A later run solves a lost case again, and needs the solution of its parent.
            spent=self._spent_parent(case) if is_settled else "",
            outdated=outdated,
        )
        (self._settled if is_settled else self._lost).add(case.key)
        self._counts[outcome.status] += 1
        self._listener.case_ended(case, outcome, len(self._settled) + len(self._lost))
        return self._next_of(self._children_of(case))

    def _forget_descendants(self, case: Case) -> list[str]:
        """Forget the results of a case's descendants, and return their keys.

        Descendants are children, their children, and so on. If no earlier run lost `case` by the
        death of its worker, nothing is forgotten. The caller deletes the rows.
        """
        if case.key not in self._lost_before:
            return []
        # The children of a lost case started from the solution of its parent. Solved again, all
        # rows equal those of a sweep in which no worker died.
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
    """Make the input with which a worker solves one case of a sweep.

    `warm_start` is the packed solution of the case's parent. If the case's field values make the
    scenario invalid, the result is instead the row of a failed case.
    """
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
    return replace(task, scenario=scenario.model_dump_json())


def _children(cases: tuple[Case, ...]) -> Mapping[int, list[int]]:
    children: dict[int, list[int]] = {}
    for case in cases:
        if case.parent is not None:
            children.setdefault(case.parent, []).append(case.position)
    return children


@dataclass(frozen=True, kw_only=True)
class SweepEstimate:
    """Estimated time that a sweep still needs.

    Attributes
    ----------
    total, missing : int
        Number of all cases of the design, and number of cases without a result.
    seconds_per_case : float
        Mean solve time of a case on one worker, in s.
    """

    total: int
    missing: int
    seconds_per_case: float

    def seconds(self, workers: int) -> float:
        """Return the estimated remaining time [s] if `workers` workers are always busy."""
        return self.missing * self.seconds_per_case / workers


def estimate_sweep(
    design: SweepDesign, base: Scenario, folder: Path, solver: str = FLIGHT_SOLVER
) -> SweepEstimate:
    """Estimate the time that a sweep still needs, without storing any result.

    The time per case is the mean over the stored results. If there are none, one case is solved,
    and then a neighbour, if there is one that starts from the solution of the first case. The time
    of the last solve counts.

    Parameters
    ----------
    design : SweepDesign
        Specification of the sweep.
    base : Scenario
        Base scenario of the design.
    folder : Path
        Output folder of the sweep; need not exist.
    solver : str, optional
        Function that solves one case, as ``module:function``.

    Returns
    -------
    SweepEstimate
        Numbers of all and of missing cases, and the time per case.

    Raises
    ------
    StoreError
        If the result store in the folder cannot be read.

    Examples
    --------
    >>> from pyomo_quad.sweep import design_sweep, load_study
    >>> loaded = load_study("hop_study.toml")
    >>> estimate_sweep(design_sweep(loaded), loaded.base, Path("hop_study")).total
    2
    """
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
        # Like most cases of a sweep, it starts from the solution of a neighbour.
        outcome = _solved(design, base, child, solver, outcome.warm_start)
    return SweepEstimate(total=len(cases), missing=len(cases), seconds_per_case=outcome.seconds)


def _solved(
    design: SweepDesign, base: Scenario, case: Case, solver: str, warm_start: bytes | None
) -> CaseOutcome:
    task = case_task(design, base, case, solver, warm_start)
    return task if isinstance(task, CaseOutcome) else perform(task)
