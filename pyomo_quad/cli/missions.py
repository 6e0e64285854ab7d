"""Commands `export` and `import`: exchange of missions with ground stations and autopilots."""

import json
from enum import StrEnum
from math import degrees
from pathlib import Path
from typing import Annotated

import typer

from pyomo_quad.cli.endings import ExitCode
from pyomo_quad.cli.looking import write_new
from pyomo_quad.cli.terminal import AllowCode, AsJson, Quiet, complain, option, real_number


class Reader(StrEnum):
    """Program that reads the file which `pyomo-quad export` writes.

    The members are those of `pyomo_quad.exports.Format`. They are repeated here because importing
    that package is slow.
    """

    QGROUNDCONTROL = "qgroundcontrol"
    MISSION_PLANNER = "missionplanner"
    PX4 = "px4"
    ROS2 = "ros2"
    CRAZYFLIE = "crazyflie"
    ROTORPY = "rotorpy"


def export(
    plan: Annotated[
        Path, typer.Argument(metavar="PLAN", help="File of Plan.save, or report folder of a run.")
    ],
    *,
    to: Annotated[Reader, typer.Option("--to", help="Program that reads the file.")],
    out: Annotated[
        Path | None, option("--out", "FILE", "File to write; for ros2 a folder.")
    ] = None,
    origin: Annotated[
        str | None,
        option(
            "--origin",
            "LAT,LON,ALT",
            "Position of the plan's origin (degrees, metres above the sea); the mission's own "
            "by default.",
        ),
    ] = None,
    path_error: Annotated[
        float | None,
        option(
            "--path-error",
            "M",
            "Largest distance of waypoints or pieces from the plan at any time.",
            real_number,
        ),
    ] = None,
    rate: Annotated[
        float | None, option("--rate", "HZ", "Setpoints per second, 50 by default.", real_number)
    ] = None,
    as_planned: Annotated[
        bool,
        typer.Option("--as-planned", help="Do not warn of a plan without margins (mission.risk)."),
    ] = False,
    quiet: Quiet = False,
    as_json: AsJson = False,
    allow_code: AllowCode = False,
) -> int:
    """Verify a plan again, and write it for an autopilot, a swarm or a simulator."""
    from pyomo_quad.exports import export_plan  # noqa: PLC0415  SciPy takes a second

    made = export_plan(
        plan,
        to.value,
        out,
        origin=origin,
        path_error_m=path_error,
        rate_hz=rate,
        is_code_allowed=allow_code,
    )
    if as_json:
        print(json.dumps(made.as_mapping(), indent=2))
    elif not quiet:
        yaw = made.yaw_error_rad
        turned = "" if yaw is None else f" and {degrees(yaw):.2g} degrees of yaw"
        print(
            f"Written to {made.path}: {made.parts} {made.what}, at most "
            f"{made.position_error_m:.2g} m{turned} from the plan."
        )
    if made.is_paper_plan and not as_planned:
        complain(
            f"{plan}: warning: the plan has no margins: it may fly exactly at its limits, and "
            "gusts would break them; solve it with mission.risk = 0.01, or give --as-planned to "
            "export it without this warning."
        )
    return ExitCode.VERIFIED


def import_(
    file: Annotated[
        Path,
        typer.Argument(
            metavar="FILE", help="QGroundControl's .plan, or Mission Planner's .waypoints."
        ),
    ],
    *,
    name: Annotated[
        str | None, option("--name", "NAME", "Name of the scenario and of its file.")
    ] = None,
    vehicle: Annotated[
        str, option("--vehicle", "NAME", "Vehicle of the library, or a vehicle file.")
    ] = "dji_matrice_100",
    payload: Annotated[
        float,
        option(
            "--payload",
            "KG",
            "Mass carried from the start and released where the mission opens a gripper.",
            real_number,
        ),
    ] = 0.0,
    quiet: Quiet = False,
) -> int:
    """Convert a ground station's mission file into a scenario, with fence and rally points."""
    from pyomo_quad.exports import read_mission  # noqa: PLC0415  SciPy takes a second

    read = read_mission(file, name=name, vehicle=vehicle, payload_kg=payload)
    out = Path(f"{read.scenario.name}.toml")
    write_new({out: read.text})
    if not quiet:
        mission, airspace = read.scenario.mission, read.scenario.airspace
        fence = "a fence" if airspace.keep_in is not None else "no fence"
        print(
            f"Written to {out}: start, {len(mission.waypoints)} waypoints, goal; {fence}, "
            f"{len(airspace.keep_out)} zones, {len(mission.rally)} rally points."
        )
        for note in read.left_out:
            print(f"Left out: {note}.")
        print(f"Fly it: pyomo-quad run {out}")
    return ExitCode.VERIFIED
