"""Command `pyomo-quad fly --flights N`: simulate a plan in N random winds, and report."""

from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path

from pyomo_quad.cli.endings import ExitCode
from pyomo_quad.cli.flying import make_flight, make_plan
from pyomo_quad.cli.solving import answer, planner_for, report_folder
from pyomo_quad.cli.terminal import Options, Stopwatch, is_plan
from pyomo_quad.exports.motion import ProvenPlan, read_proven
from pyomo_quad.flight import Planner
from pyomo_quad.flight.deadline import Deadline
from pyomo_quad.report.ensemble import write_ensemble
from pyomo_quad.report.folder import refuse_output_folder
from pyomo_quad.scenario import Scenario, ScenarioError
from pyomo_quad.scenario.loader import with_overrides
from pyomo_quad.study.ensemble import Ensemble, Saving, fly_cruise_often, fly_plan_often


def fly_many(
    path: Path, flights: int, *, seed: int, cruises: Sequence[float], options: Options
) -> ExitCode:
    """Simulate a plan many times, each time in a random wind, and write the report.

    `path` is a scenario file, a saved plan, or a report folder; see `is_plan`. An autopilot flies
    the mission in the same winds at the speeds `cruises` [m/s], for comparison.
    """
    plan, planner = _plan_of(path, options)
    mission = plan.mission
    _refuse_equal_flights(mission, flights)
    folder = options.out or Path("reports") / f"{mission.name}-{flights}-flights"
    refuse_output_folder(folder)
    watch = Stopwatch()
    often = partial(
        fly_plan_often, mission, plan.trajectories, planner=planner, flights=flights, seed=seed
    )
    asked = [mission.baseline.cruise_settings(speed) for speed in cruises]
    cruising = partial(fly_cruise_often, mission, planner=planner, flights=flights, seed=seed)
    with report_folder(folder) as aside:
        with watch.phase("fly"), Deadline(mission):
            flown = make_flight(mission, often)
            rivals = [make_flight(mission, partial(cruising, settings)) for settings in asked]
        savings = [Saving.of(flown, rival) for rival in rivals]
        summary = write_ensemble(aside, flown, savings, options.figures)
    answer(_lines(flown, savings), summary, folder, options)
    return ExitCode.VERIFIED


def _plan_of(path: Path, options: Options) -> tuple[ProvenPlan, Planner]:
    if is_plan(path):
        read = read_proven(path, is_code_allowed=options.allow_code)
        mission = with_overrides(read.mission, options.overrides or ())
        return ProvenPlan(mission=mission, trajectories=read.trajectories), planner_for(
            mission, options
        )
    scenario = options.load(path)
    planner = planner_for(scenario, options)
    with Deadline(scenario):
        plan = make_plan(planner, scenario)
    return ProvenPlan(mission=plan.mission_flown, trajectories=plan.trajectories), planner


def _refuse_equal_flights(mission: Scenario, flights: int) -> None:
    wind = mission.as_forecast().wind
    rough = (
        *(wind.speed_deviation, wind.direction_deviation, mission.vehicle.mass_deviation),
        mission.power.hover_power_deviation,
    )
    if flights > 1 and mission.wind.turbulence is None and not any(rough):
        raise ScenarioError(
            f"{mission.name}: all {flights} flights would be the same, because nothing in "
            "the scenario is random; add --set wind.turbulence.intensity=light, or a deviation "
            "such as wind.speed_deviation."
        )


def _lines(flown: Ensemble, savings: Sequence[Saving]) -> Iterator[str]:
    """Yield the lines that the command prints about the simulated flights of a plan.

    `savings` compare their energy with that of an autopilot in the same winds. There is one entry
    for each speed of the autopilot.
    """
    name, told = flown.scenario.name, flown.summary
    low, middle, high = flown.band("energy_J")
    yield f"{name}: {flown.succeeded} of {flown.count} flights arrived and kept every limit."
    yield f"Median energy {middle:.1f} J; 90 % of the flights take {low:.1f} to {high:.1f} J."
    if flown.broken:
        yield f"Limit broken most often: {told['limit broken most']}."
    for saving in savings:
        low, middle, high = saving.percent
        yield (
            f"Saving against {saving.rival.name} in the same winds: median {middle:.1f} %, "
            f"{low:.1f} to {high:.1f} % in 90 % of the winds; {saving.rival.succeeded} of its "
            "flights arrived and kept every limit."
        )
