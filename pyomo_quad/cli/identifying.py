"""`pyomo-quad identify` and `predict`: vehicles from their own flights."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pyomo_quad.cli.endings import ExitCode, raise_on_interrupt
from pyomo_quad.cli.terminal import FigureChoice, Quiet
from pyomo_quad.report import Figures
from pyomo_quad.report.folder import output_folder, refuse_output_folder
from pyomo_quad.scenario import Scenario, ScenarioError

if TYPE_CHECKING:
    import pandas as pd

# Of a list of flights, and what stands there for those that are read.
_SPLIT, _READ = "split", "fit"

Logs = Annotated[
    list[Path],
    typer.Argument(
        metavar="LOGS...", help="Flights: .parquet, .csv or PX4 .ulg, one file or more."
    ),
]
Base = Annotated[
    str, typer.Option("--base", metavar="VEHICLE", help="Vehicle of the library, or its file.")
]
Vehicle = Annotated[
    str, typer.Option("--vehicle", metavar="VEHICLE", help="Vehicle of the library, or its file.")
]
Output = Annotated[
    Path | None,
    typer.Option("--out", metavar="DIR", help="Output folder, named after the first log."),
]
Wanted = Annotated[
    list[str] | None,
    typer.Option("--fit", metavar="FIELD", help="Field of the vehicle to fit; repeatable."),
]
FlightList = Annotated[
    Path | None,
    typer.Option(
        "--flights",
        metavar="CSV",
        help=f"Columns flight and {_SPLIT}: only flights with {_SPLIT} = {_READ} are read.",
    ),
]


def identify(
    logs: Logs,
    *,
    base: Base,
    out: Output = None,
    fit: Wanted = None,
    flights: FlightList = None,
    figures: FigureChoice = Figures.SVG,
    quiet: Quiet = False,
) -> int:
    """Fit a vehicle's power to measured flights: a vehicle file, and how far to trust it."""
    folder = out or Path("reports") / logs[0].stem
    refuse_output_folder(folder)
    from pyomo_quad.identification.fitting import (  # noqa: PLC0415  takes a second
        FITTABLE,
        FITTED,
        identify,
        scores,
    )
    from pyomo_quad.identification.report import write_identification  # noqa: PLC0415

    for name in fit or ():
        if name not in FITTABLE:
            raise ScenarioError(f"--fit {name[:60]}: must be one of {', '.join(FITTABLE)}.")
    scenario, frame = _read(logs, base, flights)
    with raise_on_interrupt(), output_folder(folder) as aside:
        found = identify(scenario, frame, fit or FITTED)
        write_identification(aside, found, base, figures)
    if not quiet:
        for one in found.parameters:
            kept = "" if one.is_determined else " (kept: the flights do not determine it)"
            edge = " (at the end of its range)" if one.is_at_bound and one.is_determined else ""
            print(f"vehicle.{one.name} = {one.value:.4g} +- {one.deviation:.2g}{kept}{edge}")
        judged = [("cross-validated by flight", scores(frame, found.cross_validated))]
        judged += [
            (f"fitted on {t.fitted_on}, tried on {t.tried_on}", t.scores) for t in found.trials
        ]
        for words, trial in judged:
            print(
                f"{words}: {trial.mean_absolute_error_percent:.2f} % mean error of a flight's "
                f"energy, bias {trial.bias_percent:+.2f} %, {trial.power_rmse_W:.1f} W in a "
                f"second, {trial.flights} flights"
            )
        print(f"Written to {folder}.")
    return ExitCode.VERIFIED


def predict(logs: Logs, *, vehicle: Vehicle, out: Output = None, quiet: Quiet = False) -> int:
    """Compute the energy of measured flights from their motion, and compare."""
    folder = out or Path("reports") / f"{logs[0].stem}_predicted"
    refuse_output_folder(folder)
    from pyomo_quad.identification.motion import LoggedMotion  # noqa: PLC0415  takes a second
    from pyomo_quad.identification.report import write_predictions  # noqa: PLC0415

    scenario, frame = _read(logs, vehicle, None)
    with raise_on_interrupt(), output_folder(folder) as aside:
        found = write_predictions(aside, frame, LoggedMotion(scenario, frame).power())
    if not quiet:
        print(
            f"{found.flights} flights: {found.mean_absolute_error_percent:.2f} % mean error of a "
            f"flight's energy, bias {found.bias_percent:+.2f} %, {found.power_rmse_W:.1f} W in a "
            f"second. Written to {folder}."
        )
    return ExitCode.VERIFIED


def _read(logs: list[Path], vehicle: str, flights: Path | None) -> "tuple[Scenario, pd.DataFrame]":
    from pyomo_quad.identification.logs import (  # noqa: PLC0415
        read_logs,
        refuse_wrong_units,
        together,
    )
    from pyomo_quad.identification.motion import vehicle_scenario  # noqa: PLC0415

    scenario = vehicle_scenario(vehicle)
    read = [(file, read_logs(file)) for file in logs]
    for file, frame in read:
        refuse_wrong_units(frame, scenario.vehicle.mass, str(file))
    frame = together(read)
    if flights is not None:
        frame = _chosen(frame, flights)
    return scenario, frame


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
