"""`pyomo-quad paper`: the paper's experiments, tables and figures from live solves."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from pyomo_quad.cli.endings import ExitCode
from pyomo_quad.cli.terminal import FigureChoice, Quiet, error_console
from pyomo_quad.report import Figures
from pyomo_quad.report.folder import output_folder, refuse_output_folder

_FOLDER = Path("reports/paper")

Folder = Annotated[
    Path, typer.Option("--out", metavar="DIR", help="Output folder, reports/paper by default.")
]
Quick = Annotated[bool, typer.Option("--quick", help="Coarse meshes, and fewer of them.")]


def paper(
    *,
    out: Folder = _FOLDER,
    quick: Quick = False,
    figures: FigureChoice = Figures.ALL,
    quiet: Quiet = False,
) -> int:
    """Reproduce and examine the paper: every experiment, table, figure and equation."""
    refuse_output_folder(out)
    # A second to import, and not needed to refuse a misspelt option.
    from pyomo_quad.paper.report import write_paper_report  # noqa: PLC0415
    from pyomo_quad.paper.study import run_paper_study  # noqa: PLC0415

    with output_folder(out) as aside:
        with _follow(is_quiet=quiet) as step:
            study = run_paper_study(is_quick=quick, step=step)
        write_paper_report(aside, study, figures)
    if not quiet:
        print(f"Written to {out}.")
    return ExitCode.VERIFIED


@contextmanager
def _follow(*, is_quiet: bool) -> Iterator[Callable[[str, int, int], None] | None]:
    """Show how many results there are while the block runs."""
    console = error_console()
    if is_quiet or not console.is_terminal:
        yield None
        return
    with Progress(
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TextColumn("{task.description}", markup=False),
        console=console,
        transient=True,
    ) as progress:
        bar = progress.add_task("the first results take a while", total=None)

        def step(name: str, done: int, total: int) -> None:
            progress.update(bar, completed=done, total=total, description=name)

        yield step
