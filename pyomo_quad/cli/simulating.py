"""`pyomo-quad outside-plant` and `rotorpy-vehicle`: other people's dynamics, and their vehicles."""

from pathlib import Path
from typing import Annotated

import typer

from pyomo_quad.cli.endings import ExitCode
from pyomo_quad.cli.terminal import Quiet
from pyomo_quad.report.folder import output_file, output_folder, refuse_output_folder

_FOLDER = Path("reports/outside_plant")


def outside_plant(
    *,
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Output folder.")] = _FOLDER,
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
