"""`pyomo-quad export` and `plot`: what is made of a finished report."""

import json
from enum import StrEnum
from math import degrees
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from pyomo_quad.cli.endings import ExitCode
from pyomo_quad.cli.terminal import AsJson, Quiet, real_number
from pyomo_quad.report.folder import output_file
from pyomo_quad.report.tables import (
    FLIGHT_NAME,
    PLAN_NAME,
    SUMMARY_NAME,
    read_front,
    read_report,
    refuse_report,
)
from pyomo_quad.scenario import Scenario
from pyomo_quad.scenario.messages import PyomoQuadError, ScenarioError, printable, shown

if TYPE_CHECKING:
    from pyomo_quad.report.style import StyledFlight


class Reader(StrEnum):
    """Who reads a plan; the formats of `pyomo_quad.exports`, which take a second to import."""

    QGROUNDCONTROL = "qgroundcontrol"
    PX4 = "px4"
    ROS2 = "ros2"
    CRAZYFLIE = "crazyflie"
    ROTORPY = "rotorpy"


def export(
    plan: Annotated[
        Path, typer.Argument(metavar="PLAN", help="File of Plan.save, or report folder of a run.")
    ],
    *,
    to: Annotated[Reader, typer.Option("--to", help="Who reads it.")],
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="FILE", help="What to write; for ros2 a folder."),
    ] = None,
    origin: Annotated[
        str | None,
        typer.Option(
            "--origin",
            metavar="LAT,LON,ALT",
            help="Where on the globe the plan's origin lies (degrees, metres above the sea).",
        ),
    ] = None,
    path_error: Annotated[
        float | None,
        typer.Option(
            "--path-error",
            metavar="M",
            parser=real_number,
            help="How far waypoints or pieces may leave the plan at any time.",
        ),
    ] = None,
    rate: Annotated[
        float | None,
        typer.Option(
            "--rate", metavar="HZ", parser=real_number, help="Of setpoints, 50 by default."
        ),
    ] = None,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> int:
    """Write a verified plan for an autopilot, a swarm, a simulator or ROS 2."""
    from pyomo_quad.exports import export_plan  # noqa: PLC0415  SciPy takes a second

    made = export_plan(plan, to.value, out, origin=origin, path_error_m=path_error, rate_hz=rate)
    if as_json:
        print(json.dumps(made.as_mapping(), indent=2))
    elif not quiet:
        yaw = made.yaw_error_rad
        turned = "" if yaw is None else f" and {degrees(yaw):.2g} degrees of yaw"
        print(
            f"Written to {made.path}: {made.parts} {made.what}, never more than "
            f"{made.position_error_m:.2g} m{turned} from the plan."
        )
    return ExitCode.VERIFIED


_ENDINGS = (".png", ".svg", ".pdf")


def plot(
    run: Annotated[
        Path, typer.Argument(metavar="RUN", help="Report folder of a run, a solve or a flight.")
    ],
    what: Annotated[
        str, typer.Argument(metavar="[WHAT]", help="A figure, or a column of the table.")
    ] = "path",
    *,
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="FILE", help="Ends in .png, .svg or .pdf; RUN_WHAT.png."),
    ] = None,
    quiet: Quiet = False,
) -> int:
    """Draw a figure of a finished run: path, states, energy, battery, ... or any column."""
    if out is not None and out.suffix not in _ENDINGS:
        raise ScenarioError(f"--out {out}: must end in {', '.join(_ENDINGS)}.")
    flight, hover_energy_J, mission = _flight(run)
    front = read_front(run)
    from pyomo_quad.report.gallery import (  # noqa: PLC0415
        column_drawing,
        flight_drawings,
        front_drawing,
    )
    from pyomo_quad.report.style import save_figure  # noqa: PLC0415  matplotlib takes a second

    offered = (
        *flight_drawings([flight], hover_energy_J, mission=mission),
        *(() if front is None else (front_drawing(front),)),
    )
    drawings = {drawing.name: drawing for drawing in offered}
    if what not in drawings and what not in flight.frame:
        raise ScenarioError(
            f"WHAT = {shown(what)}; must be one of {', '.join(drawings)}, or a column of the table:"
            f" {', '.join(map(str, flight.frame.columns))}."
        )
    drawing = drawings.get(what) or column_drawing(flight, what)
    path = out or Path(f"{run.resolve().name}_{what}.png")
    with output_file(path) as aside:
        save_figure(drawing.draw, {path.suffix.removeprefix("."): aside})
    if not quiet:
        print(f"Written to {path}. Others: {', '.join(name for name in drawings if name != what)}.")
    return ExitCode.VERIFIED


def _flight(run: Path) -> "tuple[StyledFlight, float, Scenario | None]":
    is_flight = (run / FLIGHT_NAME).is_file()
    summary, frame = read_report(run, FLIGHT_NAME if is_flight else PLAN_NAME)
    name, hover_energy_J = summary.get("flight", "optimal"), summary.get("hover_energy_J")
    if not isinstance(name, str) or not isinstance(hover_energy_J, int | float):
        refuse_report(run / SUMMARY_NAME, "is not the summary of a run, a solve or a flight")
    from pyomo_quad.report.style import flight_of_table  # noqa: PLC0415

    return flight_of_table(printable(name), frame), float(hover_energy_J), _mission(summary)


def _mission(summary: dict[str, Any]) -> Scenario | None:
    """Return the mission with its passing times, None where another version wrote it."""
    try:
        scenario = Scenario.model_validate(summary["scenario_resolved"])
        return scenario.lasting(summary["duration_s"], summary.get("passing_times_s", ()))
    except (PyomoQuadError, KeyError, TypeError, ValueError):
        return None
