"""`pyomo-quad export`: a plan on its way to autopilots, swarms, simulators and ROS."""

import json
from enum import StrEnum
from math import degrees
from pathlib import Path
from typing import Annotated

import typer

from pyomo_quad.cli.endings import ExitCode
from pyomo_quad.cli.terminal import AsJson, Quiet, real_number


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
