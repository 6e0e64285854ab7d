"""Sweeps with the stand-in solver, in this process or as a program that a test can kill.

As a program: ``python -m tests.sweep.sweeping STUDY FOLDER WORKERS``.
"""

import sys
from collections.abc import Callable
from pathlib import Path

import pandas as pd

from pyomo_quad.study.sweep import (
    ProcessWorkforce,
    ResultStore,
    SilentListener,
    Sweep,
    SweepSummary,
    adopt_design,
    design_sweep,
    load_study,
    results_frame,
)
from pyomo_quad.study.sweep.cases import Case
from pyomo_quad.study.sweep.task import CaseOutcome, CaseTask, perform
from pyomo_quad.study.sweep.workforce import Workforce
from tests.sweep.stand_in import SOLVER


class Here:
    """Solves in the calling process, one case at a time."""

    room = 1
    description = "this process"

    def __init__(self) -> None:
        self._tasks: list[CaseTask] = []
        self.solved: list[str] = []

    def submit(self, task: CaseTask) -> None:
        self._tasks.append(task)

    def wait(self) -> list[CaseOutcome]:
        outcomes = [perform(task) for task in self._tasks]
        self.solved += [task.key for task in self._tasks]
        self._tasks = []
        return outcomes

    def drain(self) -> list[CaseOutcome]:
        return []


class AfterCases(SilentListener):
    """Calls a function once, after so many cases."""

    def __init__(self, count: int, call: Callable[[], None]) -> None:
        self._left = count
        self._call = call

    def case_ended(self, case: Case, outcome: CaseOutcome) -> None:
        self._left -= 1
        if self._left == 0:
            self._call()


def sweep(
    study: Path,
    folder: Path,
    workforce: Workforce,
    listener: SilentListener | None = None,
    solver: str = SOLVER,
) -> SweepSummary:
    loaded = load_study(study)
    design = design_sweep(loaded)
    with ResultStore.writing(folder, design) as store:
        adopt_design(store, design)
        listener = listener or SilentListener()
        return Sweep(design, loaded.base, store, listener, solver).run(workforce)


def rows(folder: Path) -> pd.DataFrame:
    with ResultStore.reading(folder) as store:
        return results_frame(store)


def main(study: str, folder: str, workers: str) -> None:
    with ProcessWorkforce.of(int(workers)) as workforce:
        sweep(Path(study), Path(folder), workforce)


if __name__ == "__main__":
    main(*sys.argv[1:])
