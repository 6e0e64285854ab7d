"""`pyomo-quad fly`: one flight of a scenario that is not the optimum, written down."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from pyomo_quad.cli.exit_codes import ExitCode
from pyomo_quad.cli.options import (
    AllowCode,
    AsJson,
    Output,
    Overrides,
    Quiet,
    ScenarioFile,
    folder_of,
)
from pyomo_quad.cli.stopwatch import Stopwatch
from pyomo_quad.report.folder import output_folder, refuse_output_folder
from pyomo_quad.report.summary import summary_text
from pyomo_quad.scenario import Scenario, load_scenario
from pyomo_quad.scenario.baseline import Reference

__all__ = ["Controller", "fly"]


class Controller(StrEnum):
    """What moves the rotors."""

    ADAPTIVE = "adaptive"
    OPEN_LOOP = "open_loop"


_Controller = Annotated[
    Controller, typer.Option("--controller", help="Feedback, or the plan's controls without it.")
]
_Reference = Annotated[
    Reference | None,
    typer.Option("--reference", help="What to follow: quintic by default, the plan in open loop."),
]


def fly(
    scenario: ScenarioFile,
    *,
    controller: _Controller = Controller.ADAPTIVE,
    reference: _Reference = None,
    out: Output = None,
    overrides: Overrides = None,
    quiet: Quiet = False,
    as_json: AsJson = False,
    allow_code: AllowCode = False,
) -> int:
    """Fly a scenario under the adaptive controller, or its plan in open loop."""
    watch = Stopwatch()
    followed = _followed(controller, reference)
    resolved = load_scenario(scenario, overrides or ())
    folder = folder_of(resolved, out or _own_folder(resolved, controller, followed))
    refuse_output_folder(folder)
    with watch.phase("import"):
        from pyomo_quad.cli import flying, solving  # noqa: PLC0415  take a second, see there
    planner = solving.planner_for(resolved, is_code_allowed=allow_code, is_quiet=quiet or as_json)
    plan = None
    if followed is Reference.PLAN:
        with watch.phase("solve"):
            made = flying.make_plan(planner, resolved)
        if isinstance(made, ExitCode):
            return made
        plan = made
    reference = followed if controller is Controller.ADAPTIVE else None
    flight = flying.make_flight(planner, resolved, reference, plan)
    if isinstance(flight, ExitCode):
        return flight
    with output_folder(folder) as aside:
        summary = flying.write_flight(aside, planner, resolved, flight, watch.seconds)
    if as_json:
        print(summary_text(summary), end="")
    elif not quiet:
        print(flying.verdict(resolved, flight))
        print(f"Written to {folder}.")
    return ExitCode.VERIFIED if flight.is_verified else ExitCode.NOT_VERIFIED


def _followed(controller: Controller, reference: Reference | None) -> Reference:
    if controller is Controller.ADAPTIVE:
        return reference or Reference.QUINTIC
    if reference not in {None, Reference.PLAN}:
        raise typer.BadParameter(
            f"--controller {controller.value} flies the plan's own controls and follows no "
            "--reference; leave it out."
        )
    return Reference.PLAN


def _own_folder(scenario: Scenario, controller: Controller, followed: Reference) -> Path:
    # Not that of the scenario's report, which a single flight must not replace.
    return Path("reports") / f"{scenario.name}-{controller.value}-{followed.value}"
