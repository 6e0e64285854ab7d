"""The sweep itself: hand out cases whose parent is finished, commit each as it comes back."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

from pyomo_quad.scenario.errors import PyomoQuadError
from pyomo_quad.scenario.schema import Scenario
from pyomo_quad.study.sweep.cases import Case, expand
from pyomo_quad.study.sweep.design import SweepDesign
from pyomo_quad.study.sweep.errors import ClusterError
from pyomo_quad.study.sweep.store import ResultStore
from pyomo_quad.study.sweep.task import CaseOutcome, CaseStatus, CaseTask
from pyomo_quad.study.sweep.workforce import Workforce

__all__ = ["FLIGHT_SOLVER", "SilentListener", "Sweep", "SweepListener", "SweepSummary", "case_task"]

FLIGHT_SOLVER = "pyomo_quad.study.sweep.flight_case:solve_case"


class SweepListener(Protocol):
    """Is told how a sweep goes on."""

    def start(self, total: int, already_finished: int) -> None:
        """Hear how many cases there are, and how many have a row already."""
        ...

    def case_ended(self, case: Case, outcome: CaseOutcome) -> None:
        """Hear that a case's row has been committed."""
        ...


class SilentListener:
    """Tells nobody."""

    def start(self, total: int, already_finished: int) -> None:
        """Take no notice."""

    def case_ended(self, case: Case, outcome: CaseOutcome) -> None:
        """Take no notice."""


@dataclass(frozen=True, kw_only=True)
class SweepSummary:
    """How a sweep ended.

    Attributes
    ----------
    total : int
        Cases of the design.
    already_finished : int
        Rows that were there before.
    finished, failed : int
        Rows added, by how their case ended.
    is_interrupted : bool
        Whether Ctrl-C ended it.
    """

    total: int
    already_finished: int
    finished: int
    failed: int
    is_interrupted: bool

    @property
    def missing(self) -> int:
        """Cases without a row."""
        return self.total - self.already_finished - self.finished - self.failed


class Sweep:
    """The cases of a design on their way into a store.

    Parameters
    ----------
    design : SweepDesign
        What is to be solved.
    base : Scenario
        The base scenario of the design.
    store : ResultStore
        Open for writing; cases that have a row are not solved again.
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
        self._finished = self._store.keys()
        self._children = _children(self._cases)
        self._waiting = {
            position: sum(self._cases[child].key not in self._finished for child in children)
            for position, children in self._children.items()
        }
        self._counts = dict.fromkeys(CaseStatus, 0)

    def run(self, workforce: Workforce) -> SweepSummary:
        """Solve all cases that have no row.

        Parameters
        ----------
        workforce : Workforce
            Who solves them.

        Returns
        -------
        SweepSummary
            Counts of rows.

        Raises
        ------
        ClusterError
            If the cluster was lost; finished cases are kept.
        StoreError
            If a row cannot be written; finished cases are kept.
        """
        before = len(self._finished)
        self._listener.start(len(self._cases), before)
        is_interrupted = False
        try:
            self._work_off(workforce)
        except KeyboardInterrupt:
            is_interrupted = True
            self._commit_all(workforce.drain())
        except ClusterError as error:
            missing = len(self._cases) - len(self._finished)
            raise ClusterError(
                f"{error} {len(self._finished)} of {len(self._cases)} cases are kept in "
                f"{self._store.file.parent}; run the same command again for the other {missing}, "
                f"without --scheduler to solve them on this machine."
            ) from error
        return SweepSummary(
            total=len(self._cases),
            already_finished=before,
            finished=self._counts[CaseStatus.FINISHED],
            failed=self._counts[CaseStatus.FAILED],
            is_interrupted=is_interrupted,
        )

    def _work_off(self, workforce: Workforce) -> None:
        # Last in, first out: going deep keeps few warm starts waiting.
        ready = [case for case in reversed(self._cases) if self._is_ready(case)]
        under_way = 0
        while ready or under_way:
            while ready and workforce.room > 0:
                case = ready.pop()
                task = self._task(case)
                if isinstance(task, CaseOutcome):
                    ready += self._commit(task)
                else:
                    workforce.submit(task)
                    under_way += 1
            if under_way:
                outcomes = workforce.wait()
                under_way -= len(outcomes)
                ready += self._commit_all(outcomes)

    def _is_ready(self, case: Case) -> bool:
        is_parent_finished = case.parent is None or self._cases[case.parent].key in self._finished
        return case.key not in self._finished and is_parent_finished

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
        spent = self._spent_parent(case)
        self._store.add(
            outcome, case.overrides, is_parent=self._waiting.get(case.position, 0) > 0, spent=spent
        )
        self._finished.add(case.key)
        self._counts[outcome.status] += 1
        self._listener.case_ended(case, outcome)
        children = [self._cases[child] for child in self._children.get(case.position, ())]
        return [child for child in children if child.key not in self._finished]

    def _spent_parent(self, case: Case) -> str:
        if case.parent is None:
            return ""
        self._waiting[case.parent] -= 1
        return self._cases[case.parent].key if self._waiting[case.parent] == 0 else ""


def case_task(
    design: SweepDesign, base: Scenario, case: Case, solver: str, warm_start: bytes | None
) -> CaseTask | CaseOutcome:
    """Spell out a case for a worker.

    Parameters
    ----------
    design : SweepDesign
        What is to be solved.
    base : Scenario
        The base scenario of the design.
    case : Case
        One of its cases.
    solver : str
        Case solver as ``module:function``.
    warm_start : bytes or None
        What the parent case left.

    Returns
    -------
    CaseTask or CaseOutcome
        A failed row at once where the case's values, each allowed by itself, ask together for the
        impossible.
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
    return task.for_scenario(scenario.model_dump_json())


def _children(cases: tuple[Case, ...]) -> Mapping[int, list[int]]:
    children: dict[int, list[int]] = {}
    for case in cases:
        if case.parent is not None:
            children.setdefault(case.parent, []).append(case.position)
    return children
