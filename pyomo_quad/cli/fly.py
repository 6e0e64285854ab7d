"""`pyomo-quad fly`: one flight of a scenario that is not the optimum, written down."""

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pyomo_quad.cli.consoles import complain
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
from pyomo_quad.report.folder import output_folder
from pyomo_quad.report.summary import summary_text, write_summary
from pyomo_quad.scenario import Scenario, load_scenario
from pyomo_quad.scenario.baseline import Reference

if TYPE_CHECKING:
    from pyomo_quad.flight import Flight, Plan, Planner

__all__ = ["Controller", "fly"]

_FLIGHT_NAME = "flight.csv"


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
    with watch.phase("import"):
        from pyomo_quad.cli import solving  # noqa: PLC0415  takes a second, see there
        from pyomo_quad.collocation import SolveError  # noqa: PLC0415
        from pyomo_quad.model import hover_power  # noqa: PLC0415
        from pyomo_quad.report.flight_summary import flight_summary  # noqa: PLC0415
        from pyomo_quad.report.table_file import write_table  # noqa: PLC0415
        from pyomo_quad.study.comparison import has_arrived  # noqa: PLC0415
    planner = solving.planner_for(resolved, is_code_allowed=allow_code)
    folder = folder_of(resolved, out or _default_folder(resolved, controller, followed))
    plan = None
    if followed is Reference.PLAN:
        with (
            watch.phase("solve"),
            solving.follow_solve(is_quiet=quiet or as_json) as (progress, interruption),
        ):
            plan = planner.solve(resolved, progress=progress)
        status = solving.exit_code_of(plan, interruption)
        if status is not ExitCode.VERIFIED:
            complain(f"{resolved.name}: no plan to follow: {plan.status.value}: {plan.message}")
            return status
    try:
        flight = _flown(resolved, controller, followed, planner, plan)
    except SolveError as error:
        complain(f"{resolved.name}: {error}")
        return ExitCode.NOT_SOLVED
    arrived = has_arrived(flight)
    summary = flight_summary(
        resolved,
        flight,
        hover_energy_J=hover_power(resolved) * resolved.mission.duration,
        arrived=arrived,
        wall_s=watch.seconds,
    )
    with output_folder(folder) as aside:
        write_table(flight.frame, aside / _FLIGHT_NAME)
        write_summary(aside, summary)
    if as_json:
        print(summary_text(summary), end="")
    elif not quiet:
        print(_verdict(resolved, flight, arrived=arrived))
        print(f"Written to {folder}.")
    return ExitCode.VERIFIED if flight.is_verified else ExitCode.NOT_VERIFIED


def _followed(controller: Controller, reference: Reference | None) -> Reference:
    if controller is Controller.ADAPTIVE:
        return reference or Reference.QUINTIC
    if reference not in {None, Reference.PLAN}:
        raise typer.BadParameter(
            f"--controller {controller.value} flies the plan's own controls, not --reference "
            f"{reference}; leave --reference out."
        )
    return Reference.PLAN


def _default_folder(scenario: Scenario, controller: Controller, followed: Reference) -> Path:
    # Not the folder of the scenario's own report, which this would replace.
    return Path("reports") / f"{scenario.name}-{controller.value}-{followed.value}"


def _flown(
    scenario: Scenario,
    controller: Controller,
    followed: Reference,
    planner: "Planner",
    plan: "Plan | None",
) -> "Flight":
    from pyomo_quad.flight.baselines import fly_baseline, fly_open_loop  # noqa: PLC0415  as above

    dynamics = planner.dynamics(scenario)
    if controller is Controller.OPEN_LOOP and plan is not None:
        return fly_open_loop(scenario, plan, dynamics)
    return fly_baseline(scenario, followed, dynamics=dynamics, plan=plan)


def _verdict(scenario: Scenario, flight: "Flight", *, arrived: bool) -> str:
    confirmed = "confirmed" if flight.is_verified else "not confirmed"
    end = "arrived" if arrived else "did not arrive"
    return (
        f"{scenario.name}: {flight.name} {end}, {flight.terminal_miss_m:.3g} m from the goal, "
        f"{flight.energy_J:.3f} J, {confirmed} by a second integrator."
    )
