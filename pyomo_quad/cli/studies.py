"""Commands that run a study and write its report.

The studies are the experiments of Yacef et al., whose model the package implements; steady flight
(`polar`, `reach`); flights in the simulator RotorPy; and the fit of vehicle models to measured
flights.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from pyomo_quad.cli.endings import ExitCode, raise_on_interrupt
from pyomo_quad.cli.terminal import (
    FigureChoice,
    Output,
    Overrides,
    Quiet,
    ReportFolder,
    ScenarioFile,
    complain,
    error_console,
    option,
)
from pyomo_quad.identification.columns import wanted_columns
from pyomo_quad.report import Figures
from pyomo_quad.report.folder import output_file, output_folder, refuse_output_folder
from pyomo_quad.scenario import Scenario, ScenarioError, load_scenario
from pyomo_quad.scenario.messages import printable

if TYPE_CHECKING:
    import pandas as pd

    from pyomo_quad.identification.fitting import FittedParameter, IdentifiedParameter
    from pyomo_quad.identification.validation import Scores

_PAPER_FOLDER = Path("reports/paper")
_OUTSIDE_FOLDER = Path("reports/outside_plant")

Quick = Annotated[bool, typer.Option("--quick", help="Use fewer and coarser meshes.")]


def paper(
    *,
    out: ReportFolder = _PAPER_FOLDER,
    quick: Quick = False,
    figures: FigureChoice = Figures.SVG,
    quiet: Quiet = False,
) -> int:
    """Reproduce and examine Yacef et al.: every experiment, table, figure and equation."""
    refuse_output_folder(out)
    # A second to import, and not needed to refuse a misspelt option.
    from pyomo_quad.paper.report import write_paper_report  # noqa: PLC0415
    from pyomo_quad.paper.study import run_paper_study  # noqa: PLC0415

    with _report_folder(out, is_quiet=quiet) as (aside, _):
        with _follow(is_quiet=quiet) as step:
            study = run_paper_study(is_quick=quick, step=step)
        write_paper_report(aside, study, figures)
    return ExitCode.VERIFIED


@contextmanager
def _report_folder(folder: Path, *, is_quiet: bool) -> Iterator[tuple[Path, list[str]]]:
    """Context manager: write a report folder, and print the results at the end.

    It yields a temporary folder, which becomes the report folder, and a list for the lines to
    print.
    """
    lines: list[str] = []
    with output_folder(folder) as aside:
        yield aside, lines
    if not is_quiet:
        print(*lines, f"Written to {folder}.", sep="\n")


@contextmanager
def _follow(*, is_quiet: bool) -> Iterator[Callable[[str, int, int], None] | None]:
    """Context manager: show a progress bar of finished experiments on a terminal.

    Yields
    ------
    callable or None
        Function (name of the experiment, number finished, number of all); None if no bar is shown.
    """
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


def _steady_study(
    file: Path, overrides: list[str] | None, out: Path | None, study: str
) -> tuple[Scenario, Path]:
    """Load the scenario of a steady-flight study; return it with the report folder.

    Raises
    ------
    ScenarioError
        If the scenario names its own Python model builder, which these studies cannot use.
    """
    resolved = load_scenario(file, overrides or ())
    if resolved.model is not None:
        raise ScenarioError(f"{file}: model = {resolved.model!r}; {study} reads declared models.")
    folder = out or Path("reports") / f"{resolved.name}_{study}"
    refuse_output_folder(folder)
    return resolved, folder


def polar(
    scenario: ScenarioFile,
    *,
    out: Output = None,
    overrides: Overrides = None,
    figures: FigureChoice = Figures.SVG,
    quiet: Quiet = False,
) -> int:
    """Compute steady flight over airspeed, payload and wind: best speeds, range and endurance."""
    resolved, folder = _steady_study(scenario, overrides, out, "polar")
    from pyomo_quad.polar.polar import find_polar  # noqa: PLC0415  takes a second
    from pyomo_quad.polar.report import write_polar  # noqa: PLC0415

    with raise_on_interrupt(), _report_folder(folder, is_quiet=quiet) as (aside, lines):
        found = find_polar(resolved)
        write_polar(aside, found, figures)
        own = found.own
        slow, best = own.speed_of_least_power, own.best_over_ground()
        minutes = float(own.endurance(slow)) / 60.0
        lines.append(
            f"hover {own.powers[0]:.1f} W; least power {float(own.power(slow)):.1f} W at "
            f"{slow:.2f} m/s ({minutes:.1f} min); least energy per metre "
            f"{best.energy_per_metre:.2f} J/m at {best.ground_speed:.2f} m/s "
            f"({best.range_m / 1e3:.2f} km)"
        )
    return ExitCode.VERIFIED


def reach(
    scenario: ScenarioFile,
    *,
    has_return: Annotated[
        bool,
        typer.Option(
            "--return", help="Draw the places from which the battery still brings the vehicle back."
        ),
    ] = False,
    out: Output = None,
    overrides: Overrides = None,
    figures: FigureChoice = Figures.SVG,
    quiet: Quiet = False,
) -> int:
    """Draw the range of a vehicle on one battery charge in wind, one way or out and back."""
    resolved, folder = _steady_study(scenario, overrides, out, "reach")
    from pyomo_quad.polar.reach import find_reach, write_reach  # noqa: PLC0415  takes a second

    with raise_on_interrupt(), _report_folder(folder, is_quiet=quiet) as (aside, lines):
        told = write_reach(aside, find_reach(resolved, has_return=has_return), figures)
        lines.append(
            f"{told['least_reach_m'] / 1e3:.2f} to {told['greatest_reach_m'] / 1e3:.2f} km from "
            f"the start{' and back' if has_return else ''}, depending on the direction"
        )
        if resolved.mission.origin is None:
            lines.append("no GeoJSON: give mission.origin to place it on a map")
    return ExitCode.VERIFIED


def outside_plant(
    *,
    out: ReportFolder = _OUTSIDE_FOLDER,
    figures: FigureChoice = Figures.SVG,
    quiet: Quiet = False,
) -> int:
    """Simulate three vehicles in the simulator RotorPy, and compare with the package's model.

    One vehicle is the quadrotor of Yacef et al., and two are parameter sets of RotorPy.
    """
    refuse_output_folder(out)
    from pyomo_quad.flight.outside_plant import MULTIROTOR, rotorpy_module  # noqa: PLC0415  heavy

    rotorpy_module(MULTIROTOR)
    from pyomo_quad.simulators.report import write_outside_report  # noqa: PLC0415  heavy
    from pyomo_quad.simulators.study import run_outside_study  # noqa: PLC0415  heavy

    with _report_folder(out, is_quiet=quiet) as (aside, _):
        write_outside_report(aside, run_outside_study(), figures)
    return ExitCode.VERIFIED


def rotorpy_vehicle(
    name: Annotated[str, typer.Argument(metavar="NAME", help="hummingbird or crazyflie.")],
    *,
    out: Annotated[Path | None, option("--out", "FILE", "NAME.toml by default.")] = None,
    quiet: Quiet = False,
) -> int:
    """Write a vehicle file from a parameter set of RotorPy, each number with its source."""
    from pyomo_quad.simulators.vehicles import vehicle_file  # noqa: PLC0415  a second

    text = vehicle_file(name)
    path = out or Path(f"{name}.toml")
    with output_file(path) as aside:
        aside.write_text(text, encoding="utf-8")
    if not quiet:
        print(f'Written to {path}: vehicle.use = "{path.name}" in a scenario beside it.')
    return ExitCode.VERIFIED


# File of --flights: column that marks the flights to read, and its value for these flights.
_SPLIT, _READ = "split", "fit"

Logs = Annotated[
    list[Path] | None,
    typer.Argument(
        metavar="LOGS...",
        help="Flights: .parquet, .csv, PX4 .ulg or ArduPilot .BIN, one file or more. A table has "
        "about one row a second; " + wanted_columns() + ".",
    ),
]
Steady = Annotated[
    Path | None,
    option(
        "--steady",
        "CSV",
        "Measured points of steady flight in place of logs; hover alone is enough. Columns: "
        "power_W (or endurance_s on the vehicle's pack), and optionally airspeed_m_s, payload_kg, "
        "climb_m_s, air_density_kg_m3.",
    ),
]
Base = Annotated[str, option("--base", "VEHICLE", "Vehicle of the library, or its file.")]
Vehicle = Annotated[str, option("--vehicle", "VEHICLE", "Vehicle of the library, or its file.")]
NewFolder = Annotated[
    Path | None, option("--out", "DIR", "Output folder, named after the first log.")
]
Wanted = Annotated[
    list[str] | None, option("--fit", "FIELD", "Field of the vehicle to fit; repeatable.")
]
FlightList = Annotated[
    Path | None,
    option(
        "--flights",
        "CSV",
        f"Columns flight and {_SPLIT}: only flights with {_SPLIT} = {_READ} are read.",
    ),
]


def identify(
    logs: Logs = None,
    *,
    base: Base,
    steady: Steady = None,
    out: NewFolder = None,
    fit: Wanted = None,
    flights: FlightList = None,
    figures: FigureChoice = Figures.SVG,
    quiet: Quiet = False,
) -> int:
    """Fit a vehicle's power model to measured flights; write a vehicle file and its accuracy."""
    if bool(logs) is (steady is not None):
        raise ScenarioError("identify: give LOGS of flights, or --steady CSV of steady points.")
    source = logs[0] if logs else steady
    folder = out or Path("reports") / (source.stem if source is not None else "")
    refuse_output_folder(folder)
    from pyomo_quad.identification.fitting import (  # noqa: PLC0415  takes a second
        FITTABLE,
        FITTED,
        identify,
    )

    for name in fit or ():
        if name not in FITTABLE:
            raise ScenarioError(f"--fit {name[:60]}: must be one of {', '.join(FITTABLE)}.")
    if steady is not None:
        return _identify_steady(steady, base, folder, fit, figures, is_quiet=quiet)
    from pyomo_quad.identification.pack import identify_pack  # noqa: PLC0415
    from pyomo_quad.identification.report import write_identification  # noqa: PLC0415
    from pyomo_quad.identification.validation import scores  # noqa: PLC0415

    scenario, frame, voltages = _read(logs or [], base, flights)
    with raise_on_interrupt(), _report_folder(folder, is_quiet=quiet) as (aside, lines):
        found = identify(scenario, frame, fit or FITTED)
        pack = identify_pack(scenario, voltages)
        write_identification(aside, found, base, figures, pack)
        lines.extend(_parameter_lines(found.parameters, found.together))
        if pack is not None:
            lines.append(
                f"pack, cross-validated by flight: {pack.error_mV:.1f} mV per cell, "
                f"{len(pack.flights)} flights"
            )
        lines.append(f"cross-validated by flight: {_said(scores(frame, found.cross_validated))}")
        lines += [
            f"fitted on {t.fitted_on}, tried on {t.tried_on}: {_said(t.scores)}"
            for t in found.trials
        ]
    for caution in found.cautions:
        complain(f"identify: warning: {caution}")
    return ExitCode.VERIFIED


def _identify_steady(
    points: Path,
    base: str,
    folder: Path,
    fit: list[str] | None,
    figures: Figures,
    *,
    is_quiet: bool,
) -> int:
    from pyomo_quad.identification.motion import vehicle_scenario  # noqa: PLC0415  takes a second
    from pyomo_quad.identification.steady import (  # noqa: PLC0415
        STEADY_FITTED,
        identify_steady,
        read_steady,
    )
    from pyomo_quad.identification.steady_report import write_steady  # noqa: PLC0415

    scenario = vehicle_scenario(base)
    table = read_steady(points, scenario)
    with raise_on_interrupt(), _report_folder(folder, is_quiet=is_quiet) as (aside, lines):
        found = identify_steady(scenario, table, fit or STEADY_FITTED)
        write_steady(aside, found, base, figures)
        lines.extend(_parameter_lines(found.parameters, found.together))
        lines.append(f"mean error of {len(found.points)} points: {found.error_percent:.1f} %")
    for caution in found.cautions:
        complain(f"identify: warning: {caution}")
    return ExitCode.VERIFIED


def _parameter_lines(
    parameters: "Sequence[FittedParameter | IdentifiedParameter]",
    together: Sequence[tuple[str, str]],
) -> Iterator[str]:
    """Yield a line to print for each parameter of a fit: name, value and standard deviation.

    `together` has pairs of names: a parameter that the measurements do not determine, and the
    parameter with the most similar effect on power. The second name may be "".
    """
    partners = dict(together)
    for one in parameters:
        edge = " (at the end of its range)" if one.is_at_bound and one.is_determined else ""
        # If the measurements do not determine a parameter, its value is the value before the fit.
        kept = "" if one.is_determined else " (kept: the measurements do not determine it"
        partner = partners.get(one.name, "")
        kept += (
            "" if one.is_determined else f", nor distinguish it from {partner})" if partner else ")"
        )
        yield f"vehicle.{one.name} = {one.value:.4g} +- {one.deviation:.2g}{kept}{edge}"


def _said(scores: "Scores") -> str:
    return (
        f"{scores.mean_absolute_error_percent:.2f} % mean error of a flight's energy, bias "
        f"{scores.bias_percent:+.2f} %, {scores.power_rmse_W:.1f} W in a second, "
        f"{scores.flights} flights"
    )


def predict(
    logs: Logs = None, *, vehicle: Vehicle, out: NewFolder = None, quiet: Quiet = False
) -> int:
    """Compute the energy of flights from their measured motion, and compare with measurements."""
    if not logs:
        raise ScenarioError("predict: give LOGS, one file of measured flights or more.")
    folder = out or Path("reports") / f"{logs[0].stem}_predicted"
    refuse_output_folder(folder)
    from pyomo_quad.identification.motion import LoggedMotion  # noqa: PLC0415  takes a second
    from pyomo_quad.identification.report import write_predictions  # noqa: PLC0415

    scenario, frame, _ = _read(logs, vehicle, None)
    with raise_on_interrupt(), _report_folder(folder, is_quiet=quiet) as (aside, lines):
        lines.append(_said(write_predictions(aside, frame, LoggedMotion(scenario, frame).power())))
    return ExitCode.VERIFIED


def _read(
    logs: list[Path], vehicle: str, flights: Path | None
) -> "tuple[Scenario, pd.DataFrame, pd.DataFrame]":
    """Read measured flights, and the description of the vehicle that flew them.

    `vehicle` names a library vehicle or a vehicle file. `flights` is a CSV file with columns
    "flight" and "split"; only flights with the split "fit" are kept. If None, all are kept.

    Returns
    -------
    Scenario, DataFrame, DataFrame
        Vehicle, samples of the flights, and samples of their battery voltage.
    """
    import pandas as pd  # noqa: PLC0415

    from pyomo_quad.identification.logs import (  # noqa: PLC0415
        once_each,
        read_logs,
        read_voltages,
        refuse_wrong_units,
        together,
    )
    from pyomo_quad.identification.motion import vehicle_scenario  # noqa: PLC0415

    scenario = vehicle_scenario(vehicle)
    read = [(file, read_logs(file)) for file in logs]
    for file, frame in read:
        refuse_wrong_units(frame, scenario.vehicle.mass, str(file))
    frame, copies = once_each(together(read))
    for copy, flight in copies.items():
        complain(printable(f"logs: flight {copy} duplicates flight {flight}; it counts once."))
    if flights is not None:
        frame = _chosen(frame, flights)
    electric = [(file, read_voltages(file, flown)) for file, flown in read]
    # The voltages are used only if every file has them.
    if any(one.empty for _, one in electric):
        return scenario, frame, pd.DataFrame()
    voltages = together(electric)
    return scenario, frame, voltages[voltages["flight"].isin(frame["flight"])]


def _chosen(frame: "pd.DataFrame", flights: Path) -> "pd.DataFrame":
    import pandas as pd  # noqa: PLC0415

    from pyomo_quad.identification.logs import FLIGHT  # noqa: PLC0415

    try:
        listed = pd.read_csv(flights)
    except (OSError, ValueError):
        raise ScenarioError(f"{flights}: cannot be read; give a CSV of flights.") from None
    if not set(listed) >= {FLIGHT, _SPLIT}:
        raise ScenarioError(f"{flights}: needs the columns {FLIGHT} and {_SPLIT}.")
    wanted = listed.loc[listed[_SPLIT] == _READ, FLIGHT]
    chosen = frame[frame[FLIGHT].isin(wanted)].reset_index(drop=True)
    if chosen.empty:
        raise ScenarioError(f"{flights}: no flight of the log has {_SPLIT} = {_READ}.")
    return chosen
