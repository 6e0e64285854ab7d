"""Program `pyomo-quad`: its commands `fly`, `run`, `compare` and `solve`, and error handling.

An error ends a command with an exit status and a message on standard error, without a traceback.
The message is one line. For an invalid scenario, it has one line per invalid field.
"""

import sys
import traceback
from collections.abc import Sequence
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pyomo_quad.cli.campaigns import campaign
from pyomo_quad.cli.endings import ExitCode, Stopped, before_the_end
from pyomo_quad.cli.looking import check, init, library, plot, schema
from pyomo_quad.cli.missions import export, import_
from pyomo_quad.cli.own_vehicle import vehicle, vehicles
from pyomo_quad.cli.startup import import_scipy_alone
from pyomo_quad.cli.studies import (
    identify,
    outside_plant,
    paper,
    polar,
    predict,
    reach,
    rotorpy_vehicle,
)
from pyomo_quad.cli.sweeping import sweep, sweep_report
from pyomo_quad.cli.terminal import (
    Options,
    ScenarioFile,
    ScenarioFiles,
    Stopwatch,
    claim_streams,
    complain,
    folder_of,
    gives_up_output,
    is_plan,
    option,
    positive_count,
    real_number,
    with_options,
)
from pyomo_quad.report.folder import discard_unfinished, output_folder, refuse_output_folder
from pyomo_quad.report.tables import plan_summary, run_summary, write_summary
from pyomo_quad.scenario import Scenario
from pyomo_quad.scenario.messages import FeasibilityError, PyomoQuadError, ScenarioError
from pyomo_quad.scenario.tables import Knowledge, Reference
from pyomo_quad.version import __version__

if TYPE_CHECKING:
    from pyomo_quad.flight import Flight, Planner


class Controller(StrEnum):
    """Controller of a simulated flight.

    `ADAPTIVE` tracks a reference trajectory with adaptive feedback. `OPEN_LOOP` applies the
    plan's controls without feedback. `MPC` plans the rest of the mission again and again during the
    flight. `SE3` is the geometric controller that the simulator RotorPy contains.
    """

    ADAPTIVE = "adaptive"
    OPEN_LOOP = "open_loop"
    MPC = "mpc"
    SE3 = "se3"


class Plant(StrEnum):
    """Vehicle model of a simulated flight: the scenario's equations, or the simulator RotorPy."""

    DECLARED = "declared"
    ROTORPY = "rotorpy"


_Controller = Annotated[
    Controller,
    typer.Option(
        "--controller",
        help="Adaptive feedback, the plan's controls without feedback, re-planning in flight, or "
        "RotorPy's own.",
    ),
]
_Knowledge = Annotated[
    Knowledge, typer.Option("--knowledge", help="With mpc: what re-planning knows of the wind.")
]
_Plant = Annotated[
    Plant, typer.Option("--plant", help="Vehicle model: the declared equations, or RotorPy.")
]
_Reference = Annotated[
    Reference | None,
    typer.Option("--reference", help="Reference: quintic by default, the plan in open loop."),
]


_Flown = Annotated[
    Path,
    typer.Argument(
        metavar="SCENARIO|PLAN",
        help="Scenario file (TOML); with --flights also a file of Plan.save or a report folder.",
    ),
]
_Flights = Annotated[
    int | None,
    option("--flights", "N", "Fly the plan N times, each time in a random wind.", positive_count),
]
_Seed = Annotated[
    int,
    typer.Option("--seed", metavar="N", help="With --flights: seed of the random winds.", min=0),
]
_Cruises = Annotated[
    list[float] | None,
    option(
        "--cruise",
        "M/S",
        "With --flights: also fly an autopilot at this speed in the same winds; repeatable.",
        real_number,
    ),
]


@with_options
def fly(
    scenario: _Flown,
    *,
    controller: _Controller = Controller.ADAPTIVE,
    reference: _Reference = None,
    knowledge: _Knowledge = Knowledge.ESTIMATED,
    plant: _Plant = Plant.DECLARED,
    flights: _Flights = None,
    seed: _Seed = 0,
    cruise: _Cruises = None,
    options: Options,
) -> int:
    """Simulate one flight under a given controller, or many flights of a plan in random winds."""
    if flights is not None or is_plan(scenario):
        _refuse_other_flights(scenario, flights, controller, plant, reference)
        import_scipy_alone()
        from pyomo_quad.cli.ensembles import fly_many  # noqa: PLC0415  takes seconds

        return fly_many(
            scenario,
            flights or 1,
            seed=seed,
            cruises=cruise or (),
            options=options,
        )
    watch = Stopwatch()
    followed = _followed(controller, reference)
    _refuse_unfit(controller, plant)
    resolved = options.load(scenario)
    if controller is Controller.MPC and resolved.baseline.mpc is None:
        resolved = resolved.with_values({"baseline.mpc": {}})
    flown = [plant] if plant is Plant.ROTORPY else []
    # The folder's name contains the controller, so that a flight does not replace the report of the
    # run in reports/NAME.
    name = "-".join((resolved.name, *flown, controller, followed or knowledge))
    folder = options.out or Path("reports") / name
    refuse_output_folder(folder)
    with watch.phase("import"):
        import_scipy_alone()
        from pyomo_quad.cli import flying, solving  # noqa: PLC0415  takes seconds
    if plant is Plant.ROTORPY:
        flying.refuse_outside(resolved)
    planner = solving.planner_for(resolved, options)
    resolved, flight = _flown(planner, resolved, controller, plant, followed, knowledge, watch)
    with output_folder(folder) as aside:
        summary = flying.write_flight(aside, planner, resolved, flight, watch.seconds)
    lines = [flying.verdict(resolved, flight)]
    solving.answer(lines, summary, folder, options)
    return ExitCode.VERIFIED if flight.is_verified else ExitCode.NOT_VERIFIED


def _refuse_other_flights(
    path: Path,
    flights: int | None,
    controller: Controller,
    plant: Plant,
    reference: Reference | None,
) -> None:
    if flights is None:
        raise typer.BadParameter(
            f"{path} is a plan, not a scenario; add --flights 1000, or give the scenario."
        )
    if controller is not Controller.ADAPTIVE or plant is not Plant.DECLARED:
        raise typer.BadParameter(
            "--flights simulates only the declared vehicle under --controller adaptive; leave "
            "--controller and --plant out."
        )
    if reference not in {None, Reference.PLAN}:
        raise typer.BadParameter(
            "--flights follows the plan and takes no other --reference; leave --reference out, or "
            "add --cruise."
        )


def _flown(
    planner: "Planner",
    scenario: Scenario,
    controller: Controller,
    plant: Plant,
    followed: Reference | None,
    knowledge: Knowledge,
    watch: Stopwatch,
) -> tuple[Scenario, "Flight"]:
    """Simulate the flight that the options of `fly` describe.

    Only model-predictive control uses `knowledge`; its `followed` is None. A plan is made if the
    flight follows it, the duration is free, or this controller lacks waypoint times. The returned
    scenario has the plan's times.

    Raises
    ------
    Exit
        If no flyable plan is found, or if the flight is impossible.
    """
    from pyomo_quad.cli import flying  # noqa: PLC0415  as above
    from pyomo_quad.flight.deadline import Deadline  # noqa: PLC0415

    is_untimed = any(waypoint.at is None for waypoint in scenario.mission.waypoints)
    is_replanned, plan = controller is Controller.MPC, None
    with Deadline(scenario):
        # A plan gives the reference trajectory, a free duration, and the waypoint times that
        # model-predictive control needs.
        if followed is Reference.PLAN or scenario.mission.is_free or (is_replanned and is_untimed):
            with watch.phase("solve"):
                plan = flying.make_plan(planner, scenario)
            scenario = plan.mission_flown
        # Model-predictive control follows no reference.
        if plant is Plant.ROTORPY and followed is not None:
            outside = scenario, controller.value, followed, plan
            make = partial(flying.fly_rotorpy, planner, *outside)
        elif is_replanned:
            make = partial(flying.fly_mpc, planner, scenario, knowledge)
        else:
            reference = followed if controller is Controller.ADAPTIVE else None
            make = partial(flying.fly_declared, planner, scenario, reference, plan)
        return scenario, flying.make_flight(scenario, make)


def _followed(controller: Controller, reference: Reference | None) -> Reference | None:
    if controller in {Controller.ADAPTIVE, Controller.SE3}:
        return reference or Reference.QUINTIC
    if controller is Controller.MPC and reference is not None:
        raise typer.BadParameter(
            "--controller mpc makes its own plans and follows no --reference; leave it out."
        )
    if controller is Controller.MPC:
        return None
    if reference not in {None, Reference.PLAN}:
        raise typer.BadParameter(
            f"--controller {controller.value} flies the plan's own controls and follows no "
            "--reference; leave it out."
        )
    return Reference.PLAN


def _refuse_unfit(controller: Controller, plant: Plant) -> None:
    if plant is Plant.DECLARED and controller is Controller.SE3:
        raise typer.BadParameter("--controller se3 is RotorPy's; add --plant rotorpy.")
    if plant is Plant.ROTORPY and controller is Controller.MPC:
        raise typer.BadParameter(
            "--plant rotorpy is flown by --controller adaptive, se3 or open_loop; choose one."
        )


_COMPARISON_FOLDER = Path("reports") / "comparison"


@with_options
def run(scenario: ScenarioFile, *, options: Options) -> int:
    """Plan a scenario, compare the plan with simulated flights, bound the energy, and report."""
    watch = Stopwatch()
    resolved = options.load(scenario)
    folder = folder_of(resolved, options.out)
    refuse_output_folder(folder)
    with watch.phase("import"):
        import_scipy_alone()
        from pyomo_quad.cli import solving  # noqa: PLC0415  takes seconds
        from pyomo_quad.report.report import prepare_figures, write_run_report  # noqa: PLC0415
        from pyomo_quad.study.run import run_scenario  # noqa: PLC0415
    planner = solving.planner_for(resolved, options)
    with solving.report_folder(folder) as aside:

        def prepare() -> None:
            with watch.phase("import"):
                prepare_figures(options.figures)

        result = run_scenario(resolved, planner=planner, meanwhile=prepare)
        with watch.phase("report"):
            write_run_report(aside, result, options.figures)
        summary = run_summary(result, wall_s=watch.seconds)
        write_summary(aside, summary)
    solving.answer(solving.run_lines(result), summary, folder, options)
    solving.complain_about(result.plan, folder, result.warnings)
    return solving.exit_code_of(result.plan)


@with_options
def compare(scenarios: ScenarioFiles, *, options: Options) -> int:
    """Compare the flights of several scenarios in one table, with a figure and a page.

    If a scenario's report folder contains a finished run of the same scenario, the run is read from
    this folder, and the scenario is not solved again.
    """
    missions, out = [options.load(file) for file in scenarios], options.out or _COMPARISON_FOLDER
    refuse_output_folder(out)
    import_scipy_alone()
    from pyomo_quad.cli import solving  # noqa: PLC0415  takes seconds
    from pyomo_quad.report.report import RunRecord, find_run, write_compare_report  # noqa: PLC0415
    from pyomo_quad.study.comparison import combine  # noqa: PLC0415
    from pyomo_quad.study.run import run_scenario  # noqa: PLC0415

    planners = [solving.planner_for(mission, options) for mission in missions]
    status = ExitCode.VERIFIED
    with solving.report_folder(out) as aside:
        records = []
        for mission, planner in zip(missions, planners, strict=True):
            folder = folder_of(mission, None)
            record = find_run(folder, mission)
            if record is None:
                result = run_scenario(mission, planner=planner)
                solving.complain_about(result.plan, out, result.warnings)
                record = RunRecord.of(result)
                status = max(status, solving.exit_code_of(result.plan))
            elif not options.is_quiet:
                print(f"{mission.name}: read from {folder}, which holds the same run.")
            records.append(record)
        comparison = combine([record.comparison for record in records])
        write_compare_report(
            aside, comparison, is_good=status is ExitCode.VERIFIED, figures=options.figures
        )
        summary = {"runs": [record.summary for record in records]}
        write_summary(aside, summary)
    lines = [solving.comparison_table(comparison)]
    solving.answer(lines, summary, out, options)
    return status


Rate = Annotated[
    float | None,
    option(
        "--rate", "HZ", "Rows per second of plan.csv; by default one row per node.", real_number
    ),
]


Continued = Annotated[
    Path | None,
    option(
        "--continue",
        "RUN",
        "Continue a solve from its folder or plan file: refine until the required accuracy, or, "
        "if that is reached, the next higher accuracy; --set solver.accuracy chooses another.",
    ),
]


@with_options
def solve(
    scenario: Annotated[
        Path | None, typer.Argument(metavar="[SCENARIO]", help="Scenario file (TOML).")
    ] = None,
    *,
    run: Continued = None,
    rate: Rate = None,
    options: Options,
) -> int:
    """Solve a scenario, verify the plan by simulation, and write the report."""
    watch = Stopwatch()
    if (scenario is None) is (run is None):
        raise typer.BadParameter("give a SCENARIO, or --continue RUN.")
    begun = None
    if scenario is not None:
        resolved = options.load(scenario)
        refuse_output_folder(folder_of(resolved, options.out))
    with watch.phase("import"):
        import_scipy_alone()
        from pyomo_quad.cli import solving  # noqa: PLC0415  takes seconds
        from pyomo_quad.flight.deadline import Deadline  # noqa: PLC0415
        from pyomo_quad.flight.risk import plan_at_risk  # noqa: PLC0415
        from pyomo_quad.report.report import write_solve_report  # noqa: PLC0415
        from pyomo_quad.study.check import plan_cautions  # noqa: PLC0415
    if run is not None:
        begun, resolved = solving.plan_to_continue(run, options.overrides or ())
    folder = folder_of(resolved, options.out)
    refuse_output_folder(folder)
    planner = solving.planner_for(resolved, options, keeps_usable=True)
    with solving.report_folder(folder) as aside:
        with Deadline(resolved):
            plan = plan_at_risk(resolved, planner, warm_start=begun)
            cautions = plan_cautions(plan, planner=planner)
        with watch.phase("report"):
            write_solve_report(aside, plan, cautions, rate, options.figures)
        summary = plan_summary(plan, wall_s=watch.seconds, warnings=cautions)
        write_summary(aside, summary)
    solving.answer(solving.verdict_lines(plan), summary, folder, options)
    solving.complain_about(plan, folder, cautions)
    return solving.exit_code_of(plan)


# Base class of the errors of click, or of the copy of click that newer versions of typer contain.
_UsageError: type[Exception] = typer.BadParameter.__mro__[1]

app = typer.Typer(
    name="pyomo-quad",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    help="Minimum-energy quadrotor flight in wind: solve, verify, compare, report.",
)
for _command in (
    *(
        init,
        run,
        solve,
        compare,
        campaign,
        check,
        library,
        schema,
        fly,
        export,
        plot,
        identify,
        predict,
    ),
    *(polar, reach, vehicle, vehicles, outside_plant, rotorpy_vehicle, paper, sweep, sweep_report),
):
    app.command()(_command)
app.command("import")(import_)


def _print_version(is_wanted: bool) -> None:
    if is_wanted:
        print(f"pyomo-quad {__version__}")
        raise typer.Exit


@app.callback()
def _before_any_command(
    *,
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Version.")
    ] = False,
) -> None:
    """Handle the option `--version`, which is given without the name of a command."""


def _end_other_processes() -> None:
    loaded = sys.modules.get("multiprocessing")
    for process in loaded.active_children() if loaded is not None else ():
        process.kill()


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command, print any error without a traceback, and return the exit status.

    After an interruption, the status is `ExitCode.INTERRUPTED`.

    Parameters
    ----------
    arguments : sequence of str, optional
        Name and arguments of the command; by default the command-line arguments of the process.
    """
    if arguments is None:
        # The process runs only this command. A signal that ends it also ends its child processes.
        before_the_end(_end_other_processes)
        before_the_end(discard_unfinished)
        if not claim_streams():
            complain("pyomo-quad: standard output is closed; send it to a file or to /dev/null.")
            return ExitCode.FAULT
    try:
        status = app(
            args=None if arguments is None else list(arguments),
            prog_name="pyomo-quad",
            standalone_mode=False,
        )
        sys.stdout.flush()
    except (KeyboardInterrupt, Stopped, typer.Abort):
        complain("pyomo-quad: interrupted; no report was written.")
        return ExitCode.INTERRUPTED
    except Exception as error:  # noqa: BLE001  any other error becomes one line and a status
        return _explain(error)
    return int(status or 0)


# Messages of C++ libraries and of the dynamic loader when memory runs out.
_NO_MEMORY = ("std::bad_alloc", "Cannot allocate memory")


def _lacks_memory(error: BaseException | None) -> bool:
    """Return whether a lack of memory caused an error, directly or through other errors."""
    while error is not None:
        if isinstance(error, MemoryError) or any(said in str(error) for said in _NO_MEMORY):
            return True
        error = error.__cause__ or error.__context__
    return False


def _explain(error: Exception) -> ExitCode:
    if _lacks_memory(error):
        complain(
            "pyomo-quad: not enough memory; close other programs, solve on fewer elements or with "
            "fewer --workers, or give smaller files."
        )
        return ExitCode.FAULT
    if isinstance(error, ScenarioError | FeasibilityError):
        for line in str(error).splitlines():
            complain(line)
        return ExitCode.BAD_INPUT
    if isinstance(error, _UsageError):
        message = error.format_message()  # type: ignore[attr-defined]
        complain(f"pyomo-quad: {message} See pyomo-quad --help.")
        return ExitCode.BAD_INPUT
    if isinstance(error, OSError) and gives_up_output(error):
        if not isinstance(error, BrokenPipeError):  # the reader of the output has ended
            complain(f"pyomo-quad: standard output cannot be written ({error.strerror}).")
    elif isinstance(error, OSError | PyomoQuadError):
        complain(str(error))
    else:
        place = traceback.extract_tb(error.__traceback__)[-1]
        complain(
            f"pyomo-quad: unexpected {type(error).__name__}: {error} "
            f"(at {place.filename}:{place.lineno}); this is a bug, please report it with this line."
        )
    return ExitCode.FAULT
