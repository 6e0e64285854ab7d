"""One case as it travels to a worker and back.

A case is a pure function of its task: the same scenario and the same warm start give the same
numbers in every process.  What a worker keeps between cases (a compiled problem) only saves time.
"""

import importlib
import os
import socket
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from enum import StrEnum

from pyomo_quad.scenario.baseline import Reference
from pyomo_quad.version import __version__

__all__ = [
    "LARGEST_OUTPUT",
    "CaseOutcome",
    "CaseResult",
    "CaseSolver",
    "CaseStatus",
    "CaseTask",
    "StudyTask",
    "perform",
    "worker_version",
]

_LONGEST_REASON = 500
# Of any column, in its SI unit: beyond it no sum or square of a report overflows or means anything.
LARGEST_OUTPUT = 1e15


class StudyTask(StrEnum):
    """What is done in each case."""

    OPTIMISE = "optimise"
    FLY_PLAN = "fly_plan"


class CaseStatus(StrEnum):
    """How a case ended."""

    FINISHED = "finished"
    FAILED = "failed"
    LOST = "lost"


@dataclass(frozen=True, kw_only=True)
class CaseTask:
    """What a worker needs to solve one case.

    Attributes
    ----------
    position : int
        The case's place in the row order.
    key : str
        The case's key.
    solver : str
        The case solver as ``module:function``; it is chosen by the program, not by its input.
    scenario : str
        The complete scenario, JSON.
    base : str
        The complete base scenario, JSON.
    task : StudyTask
        What is done.
    baselines : tuple of Reference
        References that the controller flies.
    warm_start : bytes or None
        What the parent case left for its children.
    """

    position: int
    key: str
    solver: str
    scenario: str
    base: str
    task: StudyTask
    baselines: tuple[Reference, ...]
    warm_start: bytes | None = None

    def for_scenario(self, scenario: str) -> "CaseTask":
        """Return the task with a scenario filled in.

        Parameters
        ----------
        scenario : str
            The complete scenario, JSON.

        Returns
        -------
        CaseTask
            A copy.
        """
        return replace(self, scenario=scenario)


@dataclass(frozen=True, kw_only=True)
class CaseResult:
    """What a case solver returns.

    Attributes
    ----------
    values : mapping
        Column -> number.
    warm_start : bytes or None
        For the children of this case.
    reason : str
        Why the case failed, empty when it did not; the values are kept either way.
    """

    values: Mapping[str, float]
    warm_start: bytes | None = None
    reason: str = ""


CaseSolver = Callable[[CaseTask], CaseResult]


@dataclass(frozen=True, kw_only=True)
class CaseOutcome:
    """A case after its end: a row of the sweep.

    Attributes
    ----------
    position, key : int, str
        The case.
    status : CaseStatus
        Finished, failed by its numbers, or lost with its worker.
    reason : str
        Why it did not finish.
    values : mapping
        Column -> number.
    warm_start : bytes or None
        For the children of this case.
    seconds : float
        Wall time of the solve.
    worker : str
        Host and process that solved it.
    """

    position: int
    key: str
    status: CaseStatus
    reason: str = ""
    values: Mapping[str, float]
    warm_start: bytes | None = None
    seconds: float = 0.0
    worker: str = ""

    @classmethod
    def failure(cls, task: CaseTask, reason: str) -> "CaseOutcome":
        """Make the row of a case that gave no result.

        Parameters
        ----------
        task : CaseTask
            The case.
        reason : str
            One line.

        Returns
        -------
        CaseOutcome
            Children start from where this case started.
        """
        return cls(
            position=task.position,
            key=task.key,
            status=CaseStatus.FAILED,
            reason=" ".join(reason.split())[:_LONGEST_REASON],
            values={},
            warm_start=task.warm_start,
        )

    @classmethod
    def loss(cls, task: CaseTask) -> "CaseOutcome":
        """Make the row of a case whose worker died each time; it is tried again on resume."""
        reason = "its worker died, also when it was tried alone; run the same command to try again"
        return replace(cls.failure(task, reason), status=CaseStatus.LOST)


def perform(task: CaseTask) -> CaseOutcome:
    """Solve one case in the present process.

    Parameters
    ----------
    task : CaseTask
        The case.

    Returns
    -------
    CaseOutcome
        Its row; a case that cannot be solved is a failed row and never an exception.
    """
    started = time.perf_counter()
    try:
        result = _case_solver(task.solver)(task)
    except Exception as error:  # noqa: BLE001  a fault in one case must not end the sweep
        outcome = CaseOutcome.failure(task, f"{type(error).__name__}: {error}")
    else:
        status = CaseStatus.FAILED if result.reason else CaseStatus.FINISHED
        outcome = CaseOutcome(
            position=task.position,
            key=task.key,
            status=status,
            reason=" ".join(result.reason.split())[:_LONGEST_REASON],
            values=_finite(result.values),
            warm_start=result.warm_start if result.warm_start is not None else task.warm_start,
        )
    return replace(
        outcome,
        seconds=time.perf_counter() - started,
        worker=f"{socket.gethostname()}:{os.getpid()}",
    )


def worker_version() -> str:
    """Return the version of this package in the present process."""
    return __version__


def _finite(values: Mapping[str, float]) -> dict[str, float]:
    # A cell without a number stays empty: NaN is no answer, and JSON has none.
    return {name: float(held) for name, held in values.items() if abs(held) <= LARGEST_OUTPUT}


def _case_solver(name: str) -> CaseSolver:
    module, _, function = name.partition(":")
    solver: CaseSolver = getattr(importlib.import_module(module), function)
    return solver
