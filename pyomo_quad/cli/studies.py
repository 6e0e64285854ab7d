"""`pyomo-quad paper`, `polar`, `outside-plant`, `rotorpy-vehicle`: studies that write a report."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from pyomo_quad.cli.endings import ExitCode, raise_on_interrupt
from pyomo_quad.cli.terminal import (
    FigureChoice,
    Output,
    Overrides,
    Quiet,
    ScenarioFile,
    error_console,
)
from pyomo_quad.report import Figures
from pyomo_quad.report.folder import output_file, output_folder, refuse_output_folder
from pyomo_quad.scenario import ScenarioError, load_scenario

_PAPER_FOLDER = Path("reports/paper")
_OUTSIDE_FOLDER = Path("reports/outside_plant")

PaperFolder = Annotated[
    Path, typer.Option("--out", metavar="DIR", help="Output folder, reports/paper by default.")
]
Quick = Annotated[bool, typer.Option("--quick", help="Coarse meshes, and fewer of them.")]


def paper(
    *,
    out: PaperFolder = _PAPER_FOLDER,
    quick: Quick = False,
    figures: FigureChoice = Figures.SVG,
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


def polar(
    scenario: ScenarioFile,
    *,
    out: Output = None,
    overrides: Overrides = None,
    figures: FigureChoice = Figures.SVG,
    quiet: Quiet = False,
) -> int:
    """Solve steady flight over airspeed, payload and wind: best speeds, range, endurance, reach."""
    resolved = load_scenario(scenario, overrides or ())
    folder = out or Path("reports") / f"{resolved.name}_polar"
    if resolved.model is not None:
        raise ScenarioError(f"{scenario}: model = {resolved.model!r}; polar reads declared models.")
    refuse_output_folder(folder)
    from pyomo_quad.polar.polar import find_polar  # noqa: PLC0415  takes a second
    from pyomo_quad.polar.report import write_polar  # noqa: PLC0415

    with raise_on_interrupt(), output_folder(folder) as aside:
        found = find_polar(resolved)
        write_polar(aside, found, figures)
    if not quiet:
        own = found.own
        slow, best = own.speed_of_least_power, own.best_over_ground()
        minutes = float(own.endurance(slow)) / 60.0
        print(
            f"hover {own.powers[0]:.1f} W; least power {float(own.power(slow)):.1f} W at "
            f"{slow:.2f} m/s ({minutes:.1f} min); least energy per metre "
            f"{best.energy_per_metre:.2f} J/m at {best.ground_speed:.2f} m/s "
            f"({best.range_m / 1e3:.2f} km)"
        )
        print(f"Written to {folder}.")
    return ExitCode.VERIFIED


def outside_plant(
    *,
    out: Annotated[
        Path, typer.Option("--out", metavar="DIR", help="Output folder.")
    ] = _OUTSIDE_FOLDER,
    quiet: Quiet = False,
) -> int:
    """Fly the paper's vehicle and two of RotorPy's in RotorPy, and report what differs and why."""
    refuse_output_folder(out)
    from pyomo_quad.flight.outside_plant import MULTIROTOR, rotorpy_module  # noqa: PLC0415  heavy

    rotorpy_module(MULTIROTOR)
    from pyomo_quad.simulators.study import (  # noqa: PLC0415  heavy
        run_outside_study,
        write_outside_report,
    )

    with output_folder(out) as aside:
        write_outside_report(aside, run_outside_study())
    if not quiet:
        print(f"Written to {out}.")
    return ExitCode.VERIFIED


def rotorpy_vehicle(
    name: Annotated[str, typer.Argument(metavar="NAME", help="hummingbird or crazyflie.")],
    *,
    out: Annotated[
        Path | None, typer.Option("--out", metavar="FILE", help="NAME.toml by default.")
    ] = None,
    quiet: Quiet = False,
) -> int:
    """Write a vehicle file of one of RotorPy's parameter sets, each number with its source."""
    from pyomo_quad.simulators.vehicles import vehicle_file  # noqa: PLC0415  a second

    text = vehicle_file(name)
    path = out or Path(f"{name}.toml")
    with output_file(path) as aside:
        aside.write_text(text, encoding="utf-8")
    if not quiet:
        print(f'Written to {path}: vehicle.use = "{path.name}" in a scenario beside it.')
    return ExitCode.VERIFIED
