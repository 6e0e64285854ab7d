"""`pyomo-quad sweep` and `sweep-report`: many cases of a scenario, and what they show together."""

import os
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pyomo_quad.cli.consoles import complain
from pyomo_quad.cli.exit_codes import ExitCode
from pyomo_quad.cli.interruption import raise_on_interrupt
from pyomo_quad.cli.options import positive_count
from pyomo_quad.report.folder import final_folder, output_folder, refuse_output_folder

if TYPE_CHECKING:
    from pyomo_quad.study.sweep import SweepDesign, SweepEstimate, SweepSummary, Workers
    from pyomo_quad.study.sweep.study_file import LoadedStudy

__all__ = ["sweep", "sweep_report"]

_REPORT_FOLDER = "report"

StudyFile = Annotated[Path, typer.Argument(metavar="STUDY", help="Study file (TOML).")]
WorkerCount = Annotated[
    int | None,
    typer.Option(
        "--workers", metavar="N", parser=positive_count, help="Processes, one per core by default."
    ),
]
Scheduler = Annotated[
    str | None,
    typer.Option("--scheduler", metavar="ADDRESS", help="Use the workers of a Dask cluster."),
]
SweepOutput = Annotated[
    Path | None,
    typer.Option("--out", metavar="DIR", help="Store and report, reports/NAME by default."),
]
DryRun = Annotated[bool, typer.Option("--dry-run", help="Only count cases and estimate time.")]
Fresh = Annotated[bool, typer.Option("--fresh", help="Discard the results that are there.")]
Yes = Annotated[bool, typer.Option("--yes", help="Many cases are meant.")]
Verbose = Annotated[bool, typer.Option("--verbose", help="A line for each case.")]
SweepFolder = Annotated[Path, typer.Argument(metavar="DIR", help="Output folder of a sweep.")]

ReportOutput = Annotated[
    Path | None,
    typer.Option("--out", metavar="DIR", help="Folder of the report, DIR/report by default."),
]


def sweep(
    study: StudyFile,
    *,
    workers: WorkerCount = None,
    scheduler: Scheduler = None,
    out: SweepOutput = None,
    dry_run: DryRun = False,
    fresh: Fresh = False,
    yes: Yes = False,
    verbose: Verbose = False,
) -> int:
    """Solve all cases of a study, or those still missing, and write the report."""
    if out is not None:
        refuse_output_folder(final_folder(out) / _REPORT_FOLDER)
    from pyomo_quad.study.sweep import design_sweep, load_study  # noqa: PLC0415  takes a second

    loaded = load_study(study)
    design = design_sweep(loaded, is_large_allowed=yes)
    folder = out or Path("reports") / design.name
    count = workers or len(os.sched_getaffinity(0))
    if dry_run:
        from pyomo_quad.study.sweep import estimate_sweep  # noqa: PLC0415

        print(_estimate_line(design, estimate_sweep(design, loaded.base, folder), count))
        return ExitCode.VERIFIED
    with raise_on_interrupt(), _workers(count, scheduler) as crew:
        summary = _run(loaded, design, folder, crew, is_fresh=fresh, is_verbose=verbose)
    print(_summary_line(design, summary, folder))
    if summary.is_interrupted:
        return ExitCode.INTERRUPTED
    sweep_report(folder)
    has_result = summary.already_finished + summary.finished > 0
    return ExitCode.VERIFIED if has_result else ExitCode.NOT_SOLVED


def sweep_report(folder: SweepFolder, *, out: ReportOutput = None) -> int:
    """Write tables and figures of a sweep from its store; nothing is solved."""
    from pyomo_quad.report.sweep import write_sweep_report  # noqa: PLC0415  takes a second
    from pyomo_quad.study.sweep import ResultStore, results_frame  # noqa: PLC0415

    with ResultStore.reading(folder) as store:
        design, frame = store.design, results_frame(store)
    if frame.empty:
        complain(f"{folder}: holds no finished case yet; run the sweep first.")
        return ExitCode.BAD_INPUT
    target = out or folder / _REPORT_FOLDER
    with output_folder(target) as aside:
        write_sweep_report(aside, design, frame)
    print(f"Report written to {target}.")
    return ExitCode.VERIFIED


def _workers(count: int, scheduler: str | None) -> AbstractContextManager["Workers"]:
    from pyomo_quad.study.sweep import cluster_workers, process_workers  # noqa: PLC0415

    return process_workers(count) if scheduler is None else cluster_workers(scheduler)


def _run(
    loaded: "LoadedStudy",
    design: "SweepDesign",
    folder: Path,
    workers: "Workers",
    *,
    is_fresh: bool,
    is_verbose: bool,
) -> "SweepSummary":
    from pyomo_quad.cli.sweep_progress import follow_sweep  # noqa: PLC0415
    from pyomo_quad.study.sweep import ResultStore, Sweep, adopt_design  # noqa: PLC0415

    with ResultStore.writing(folder, design, is_fresh=is_fresh) as store:
        for change in adopt_design(store, design):
            complain(f"{folder}: extended: {change}")
        complain(f"{design.name}: {design.case_count} cases on {workers.description}")
        with follow_sweep(is_verbose=is_verbose) as listener:
            return Sweep(design, loaded.base, store, listener).run(workers)


def _estimate_line(design: "SweepDesign", estimate: "SweepEstimate", workers: int) -> str:
    return (
        f"{design.name}: {estimate.total} cases, {estimate.missing} of them to solve; about "
        f"{estimate.seconds_per_case:.2g} s each, {estimate.seconds(workers):.0f} s on "
        f"{workers} worker{'s' if workers > 1 else ''}."
    )


def _summary_line(design: "SweepDesign", summary: "SweepSummary", folder: Path) -> str:
    kept = f", {summary.already_finished} were there" if summary.already_finished else ""
    lost = f", {summary.lost} lost with their worker" if summary.lost else ""
    ending = (
        f"; interrupted with {summary.missing} missing: the same command goes on"
        if summary.is_interrupted
        else "; the same command tries again what was lost"
        if summary.lost
        else ""
    )
    return (
        f"{design.name}: {summary.finished} cases finished, {summary.failed} failed{lost}{kept}; "
        f"results in {folder}{ending}."
    )
