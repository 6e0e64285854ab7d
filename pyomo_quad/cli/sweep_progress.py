"""How a sweep goes: a bar on a terminal, lines without one, and a line per case if asked."""

from collections.abc import Iterator
from contextlib import contextmanager
from time import monotonic

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeRemainingColumn,
)

from pyomo_quad.cli.consoles import error_console
from pyomo_quad.study.sweep.cases import Case
from pyomo_quad.study.sweep.runner import SweepListener
from pyomo_quad.study.sweep.task import CaseOutcome, CaseStatus

__all__ = ["follow_sweep"]

_SECONDS_BETWEEN_LINES = 10.0
# The time left is judged by so many seconds of the past: early cases wait for each other.
_SECONDS_OF_MEMORY = 60.0


@contextmanager
def follow_sweep(*, is_verbose: bool) -> Iterator[SweepListener]:
    """Show how a sweep goes on while the block runs.

    Parameters
    ----------
    is_verbose : bool
        Write a line for each case.

    Yields
    ------
    SweepListener
        For the sweep.
    """
    console = error_console()
    if not console.is_terminal:
        yield _Lines(console, is_verbose=is_verbose)
        return
    with Progress(
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[failed]} failed, {task.fields[rate]:.2f} cases/s, left"),
        TimeRemainingColumn(),
        console=console,
        speed_estimate_period=_SECONDS_OF_MEMORY,
    ) as progress:
        yield _Bar(progress, is_verbose=is_verbose)


class _Counter:
    """Counts cases, and writes a line for each if asked."""

    def __init__(self, console: Console, *, is_verbose: bool) -> None:
        self._console = console
        self._is_verbose = is_verbose
        self._began = monotonic()
        self.total = self.done = self.failed = self._solved = 0

    def start(self, total: int, already_ended: int) -> None:
        """Hear how many cases there are, and how many need not be solved any more."""
        self.total, self.done = total, already_ended

    def case_ended(self, case: Case, outcome: CaseOutcome, done: int) -> None:
        """Hear that a case's row has been committed, and how many cases are done now."""
        self.done = done
        self._solved += 1
        self.failed += outcome.status is not CaseStatus.FINISHED
        if self._is_verbose:
            self._console.print(_line(case, outcome), markup=False, soft_wrap=True)

    @property
    def rate(self) -> float:
        """Cases per second since the start."""
        return self._solved / max(monotonic() - self._began, 1e-9)


class _Bar(_Counter):
    def __init__(self, progress: Progress, *, is_verbose: bool) -> None:
        super().__init__(progress.console, is_verbose=is_verbose)
        self._progress = progress
        self._bar = progress.add_task("", total=None, failed=0, rate=0.0)

    def start(self, total: int, already_ended: int) -> None:
        super().start(total, already_ended)
        self._progress.update(self._bar, total=total, completed=already_ended)

    def case_ended(self, case: Case, outcome: CaseOutcome, done: int) -> None:
        super().case_ended(case, outcome, done)
        self._progress.update(self._bar, completed=done, failed=self.failed, rate=self.rate)


class _Lines(_Counter):
    _written_at = 0.0

    def start(self, total: int, already_ended: int) -> None:
        super().start(total, already_ended)
        self._write()

    def case_ended(self, case: Case, outcome: CaseOutcome, done: int) -> None:
        super().case_ended(case, outcome, done)
        is_due = monotonic() - self._written_at > _SECONDS_BETWEEN_LINES
        if is_due or self.done == self.total:
            self._write()

    def _write(self) -> None:
        self._written_at = monotonic()
        left = f", {(self.total - self.done) / self.rate:.0f} s left" if self.rate > 0.0 else ""
        self._console.print(
            f"{self.done} of {self.total} cases, {self.failed} failed, "
            f"{self.rate:.2f} cases/s{left}",
            soft_wrap=True,
        )


def _line(case: Case, outcome: CaseOutcome) -> str:
    fields = ", ".join(f"{path} = {value}" for path, value in case.overrides.items())
    ending = f"{outcome.status.value} in {outcome.seconds:.2f} s by {outcome.worker or 'nobody'}"
    return f"case {case.position}: {fields}: {ending}" + (
        f": {outcome.reason}" if outcome.reason else ""
    )
