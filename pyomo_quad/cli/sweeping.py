"""Commands `sweep` and `sweep-report`: solve the variants of a scenario, and write a report."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from pyomo_quad.cli.endings import ExitCode, raise_on_interrupt
from pyomo_quad.cli.terminal import (
    FigureChoice,
    Output,
    complain,
    error_console,
    option,
    positive_count,
)
from pyomo_quad.report import Figures
from pyomo_quad.report.folder import final_folder, output_folder, refuse_output_folder
from pyomo_quad.scenario.messages import OutputError

if TYPE_CHECKING:
    from pyomo_quad.sweep import SweepDesign, SweepEstimate, SweepListener, SweepSummary
    from pyomo_quad.sweep.case import CaseOutcome
    from pyomo_quad.sweep.design import Case

_REPORT_FOLDER = "report"

StudyFile = Annotated[Path, typer.Argument(metavar="STUDY", help="Study file (TOML).")]
WorkerCount = Annotated[
    int | None, option("--workers", "N", "Processes, one per core by default.", positive_count)
]
Scheduler = Annotated[
    str | None, option("--scheduler", "ADDRESS", "Use the workers of a Dask cluster.")
]
DryRun = Annotated[bool, typer.Option("--dry-run", help="Only count cases and estimate time.")]
Fresh = Annotated[bool, typer.Option("--fresh", help="Discard existing results.")]
Yes = Annotated[bool, typer.Option("--yes", help="Allow a large number of cases.")]
Verbose = Annotated[bool, typer.Option("--verbose", help="A line for each case.")]
SweepFolder = Annotated[Path, typer.Argument(metavar="DIR", help="Output folder of a sweep.")]

ReportOutput = Annotated[
    Path | None, option("--out", "DIR", "Folder of the report, DIR/report by default.")
]


def sweep(
    study: StudyFile,
    *,
    workers: WorkerCount = None,
    scheduler: Scheduler = None,
    out: Output = None,
    dry_run: DryRun = False,
    fresh: Fresh = False,
    yes: Yes = False,
    figures: FigureChoice = Figures.SVG,
    verbose: Verbose = False,
) -> int:
    """Solve all cases of a study file that have no stored result yet, and write the report."""
    if out is not None:
        report = final_folder(out) / _REPORT_FOLDER
        try:
            refuse_output_folder(report)
        except OutputError:
            if out.is_dir() and not os.access(out, os.W_OK):
                from pyomo_quad.sweep.store import refuse_kept_results  # noqa: PLC0415  a second

                refuse_kept_results(out)
            raise
    from pyomo_quad import sweep as sweeps  # noqa: PLC0415  takes a second

    loaded = sweeps.load_study(study)
    design = sweeps.design_sweep(loaded, is_large_allowed=yes)
    folder = out or Path("reports") / design.name
    count = workers or len(os.sched_getaffinity(0))
    if dry_run:
        print(_estimate_line(design, sweeps.estimate_sweep(design, loaded.base, folder), count))
        return ExitCode.VERIFIED
    crew = sweeps.process_workers(count) if scheduler is None else sweeps.cluster_workers(scheduler)
    writing = sweeps.ResultStore.writing(folder, design, is_fresh=fresh)
    with raise_on_interrupt(), crew as workforce, writing as store:
        for change in sweeps.adopt_design(store, design):
            complain(f"{folder}: extended: {change}")
        complain(f"{design.name}: {design.case_count} cases on {workforce.description}")
        with follow_sweep(is_verbose=verbose) as listener:
            summary = sweeps.Sweep(design, loaded.base, store, listener).run(workforce)
    print(_summary_line(design, summary, folder))
    if summary.is_interrupted:
        return ExitCode.INTERRUPTED
    sweep_report(folder, figures=figures)
    has_result = summary.already_finished + summary.finished > 0
    return ExitCode.VERIFIED if has_result else ExitCode.NOT_SOLVED


def sweep_report(
    folder: SweepFolder, *, out: ReportOutput = None, figures: FigureChoice = Figures.SVG
) -> int:
    """Write tables and figures of a sweep from its stored results, without solving."""
    from pyomo_quad import sweep as sweeps  # noqa: PLC0415

    with sweeps.ResultStore.reading(folder) as store:
        design, frame = store.design, sweeps.results_frame(store)
    if frame.empty:
        complain(f"{folder}: holds no finished case yet; run the sweep first.")
        return ExitCode.BAD_INPUT
    target = out or folder / _REPORT_FOLDER
    with output_folder(target) as aside:
        sweeps.write_sweep_report(aside, design, frame, figures)
    print(f"Report written to {target}.")
    return ExitCode.VERIFIED


def _estimate_line(design: "SweepDesign", estimate: "SweepEstimate", workers: int) -> str:
    return (
        f"{design.name}: {estimate.total} cases, {estimate.missing} of them to solve; about "
        f"{estimate.seconds_per_case:.2g} s each, {estimate.seconds(workers):.0f} s on "
        f"{workers} worker{'s' if workers > 1 else ''}."
    )


def _summary_line(design: "SweepDesign", summary: "SweepSummary", folder: Path) -> str:
    kept = f", {summary.already_finished} finished before" if summary.already_finished else ""
    lost = f", {summary.lost} lost with their worker" if summary.lost else ""
    ending = (
        f"; interrupted with {summary.missing} missing: run the same command to continue"
        if summary.is_interrupted
        else "; run the same command to retry the lost cases"
        if summary.lost
        else ""
    )
    return (
        f"{design.name}: {summary.finished} cases finished, {summary.failed} failed{lost}{kept}; "
        f"results in {folder}{ending}."
    )


_SECONDS_BETWEEN_LINES = 10.0
# The remaining time is estimated from the rate of the last minute, because the first cases are
# slower: other cases wait for their solutions.
_SECONDS_OF_MEMORY = 60.0


@contextmanager
def follow_sweep(*, is_verbose: bool) -> Iterator["SweepListener"]:
    """Context manager: show the progress of a sweep, as a bar on a terminal or as lines.

    It yields the display, to be passed to the sweep. If `is_verbose` is True, a line is printed for
    every finished case.
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


class _Listener:
    """Base class of displays of a sweep's progress; a case is one variant of the scenario."""

    total = done = failed = _solved = 0

    def __init__(self, console: Console, *, is_verbose: bool) -> None:
        self._console = console
        self._is_verbose = is_verbose
        self._began = monotonic()

    def start(self, total: int, already_ended: int) -> None:
        """Record the number of all cases, and the number of cases that ended in earlier runs."""
        self.total, self.done = total, already_ended
        self._show()

    def case_ended(self, case: "Case", outcome: "CaseOutcome", done: int) -> None:
        """Count a case that has ended, and show the progress of the sweep.

        `done` counts the cases that have ended in this run and in earlier runs.
        """
        self.done = done
        self._solved += 1
        self.failed += not outcome.is_finished
        if self._is_verbose:
            self._console.print(_line(case, outcome), markup=False, soft_wrap=True)
        self._show()

    @property
    def rate(self) -> float:
        """Number of cases per second that this run has ended, failed cases included."""
        return self._solved / max(monotonic() - self._began, 1e-9)

    def _show(self) -> None:
        raise NotImplementedError


class _Bar(_Listener):
    def __init__(self, progress: Progress, *, is_verbose: bool) -> None:
        super().__init__(progress.console, is_verbose=is_verbose)
        self._progress = progress
        self._bar = progress.add_task("", total=None, failed=0, rate=0.0)

    def _show(self) -> None:
        shown: dict[str, Any] = {"failed": self.failed, "rate": self.rate}
        self._progress.update(self._bar, total=self.total, completed=self.done, **shown)


class _Lines(_Listener):
    _next_at = 0.0

    def _show(self) -> None:
        if monotonic() < self._next_at and self.done < self.total:
            return
        self._next_at = monotonic() + _SECONDS_BETWEEN_LINES
        left = f", {(self.total - self.done) / self.rate:.0f} s left" if self.rate > 0.0 else ""
        self._console.print(
            f"{self.done} of {self.total} cases, {self.failed} failed, "
            f"{self.rate:.2f} cases/s{left}",
            soft_wrap=True,
        )


def _line(case: "Case", outcome: "CaseOutcome") -> str:
    fields = ", ".join(f"{path} = {value}" for path, value in case.overrides.items())
    ending = f"{outcome.status.value} in {outcome.seconds:.2f} s by {outcome.worker or 'no worker'}"
    return f"case {case.position}: {fields}: {ending}" + (
        f": {outcome.reason}" if outcome.reason else ""
    )
