"""Sweeps with the stand-in solver, in this process or as a program that a test can kill.

As a program: ``python -m tests.sweep.sweeping STUDY FOLDER WORKERS``.
"""

import signal
import sys
from collections.abc import Callable
from concurrent.futures import Executor, Future
from pathlib import Path

import pandas as pd

from pyomo_quad.sweep import (
    ResultStore,
    SilentListener,
    Sweep,
    SweepSummary,
    Workers,
    adopt_design,
    design_sweep,
    load_study,
    process_workers,
    results_frame,
)
from pyomo_quad.sweep.case import CaseOutcome
from pyomo_quad.sweep.design import Case
from tests.sweep.stand_in import SOLVER


class Here(Workers):
    """Solves in the calling process, one case at a time."""

    def __init__(self) -> None:
        self.solved: list[str] = []
        super().__init__(
            description="this process",
            begin=lambda: _InThisProcess(self.solved),
            end=lambda _: None,
            count=lambda: 1,
        )


class _InThisProcess(Executor):
    def __init__(self, solved: list[str]) -> None:
        self._solved = solved

    def submit(self, perform, /, task):
        future: Future = Future()
        future.set_result(perform(task))
        self._solved.append(task.key)
        return future


def press_ctrl_c() -> None:
    """Do to this process what Ctrl-C does, also if it was started in the background, deaf to it."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.raise_signal(signal.SIGINT)


class AfterCases(SilentListener):
    """Calls a function once, after so many cases."""

    def __init__(self, count: int, call: Callable[[], None]) -> None:
        self._left = count
        self._call = call

    def case_ended(self, case: Case, outcome: CaseOutcome, done: int) -> None:
        self._left -= 1
        if self._left == 0:
            self._call()


def sweep(
    study: Path,
    folder: Path,
    workers: Workers,
    listener: SilentListener | None = None,
    solver: str = SOLVER,
) -> SweepSummary:
    loaded = load_study(study)
    design = design_sweep(loaded)
    with ResultStore.writing(folder, design) as store:
        adopt_design(store, design)
        listener = listener or SilentListener()
        return Sweep(design, loaded.base, store, listener, solver).run(workers)


def rows(folder: Path) -> pd.DataFrame:
    with ResultStore.reading(folder) as store:
        return results_frame(store)


def main(study: str, folder: str, workers: str) -> None:
    with process_workers(int(workers)) as held:
        sweep(Path(study), Path(folder), held)


if __name__ == "__main__":
    main(*sys.argv[1:])
