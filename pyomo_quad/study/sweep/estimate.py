"""How long a sweep would take, judged by cases that were solved."""

from dataclasses import dataclass
from pathlib import Path
from statistics import fmean

from pyomo_quad.scenario.schema import Scenario
from pyomo_quad.study.sweep.cases import Case, expand
from pyomo_quad.study.sweep.design import SweepDesign
from pyomo_quad.study.sweep.runner import FLIGHT_SOLVER, case_task
from pyomo_quad.study.sweep.store import ResultStore
from pyomo_quad.study.sweep.store_file import STORE_NAME
from pyomo_quad.study.sweep.task import CaseOutcome, CaseStatus, perform

__all__ = ["SweepEstimate", "estimate_sweep"]


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
    """Estimate what is left of a sweep; nothing is written.

    Parameters
    ----------
    design : SweepDesign
        What is to be solved.
    base : Scenario
        Its base scenario.
    folder : Path
        Where its store is or would be: rows that are there tell how long a case takes.
    solver : str, optional
        Case solver; without rows, it solves the first case and one that starts from it.

    Returns
    -------
    SweepEstimate
        Measured, not guessed.
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
        outcome = _solved(design, base, child, solver, outcome.warm_start)
    return SweepEstimate(total=len(cases), missing=len(cases), seconds_per_case=outcome.seconds)


def _solved(
    design: SweepDesign, base: Scenario, case: Case, solver: str, warm_start: bytes | None
) -> CaseOutcome:
    task = case_task(design, base, case, solver, warm_start)
    return task if isinstance(task, CaseOutcome) else perform(task)
