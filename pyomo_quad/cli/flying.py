"""Steps of the command `pyomo-quad fly`: plan, simulate, write files, print the result."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

import typer

from pyomo_quad.cli.endings import ExitCode
from pyomo_quad.cli.solving import exit_code_of
from pyomo_quad.cli.terminal import complain
from pyomo_quad.collocation import SolveError
from pyomo_quad.flight import Flight, Plan, Planner
from pyomo_quad.flight.baselines import fly_baseline, fly_open_loop
from pyomo_quad.flight.outside_plant import (
    MULTIROTOR,
    OutsidePlant,
    Pilot,
    fly_outside,
    refuse_pushing_wind,
    rotorpy_module,
)
from pyomo_quad.flight.replanning import fly_replanned
from pyomo_quad.flight.risk import plan_at_risk
from pyomo_quad.flight.routes import own_cruise
from pyomo_quad.flight.weather import vehicle_flown
from pyomo_quad.report.tables import FLIGHT_NAME, flight_summary, write_summary, write_table
from pyomo_quad.scenario import Scenario
from pyomo_quad.scenario.tables import Knowledge, Reference
from pyomo_quad.study.autopilot import fly_cruise, tune_cruise
from pyomo_quad.study.comparison import has_arrived


def make_plan(planner: Planner, scenario: Scenario) -> Plan:
    """Plan the flight that is to be simulated; end the command if no flyable plan is found.

    A plan is flyable if its simulated flight without feedback arrives at the goal and keeps all
    limits.

    Raises
    ------
    Exit
        If the plan is not flyable.
    """
    plan = plan_at_risk(scenario, planner)
    if plan.is_flyable:
        return plan
    status = exit_code_of(plan)
    complain(f"{scenario.name}: no plan to follow, {plan.status.value}: {plan.message}")
    raise typer.Exit(status)


_Outcome = TypeVar("_Outcome")


def make_flight(scenario: Scenario, fly: Callable[[], _Outcome]) -> _Outcome:
    """Return the result of `fly`, a function that simulates flights; end the command if it fails.

    If `fly` raises `SolveError`, the error's message is printed with the name of the scenario. The
    exit status is then `ExitCode.NOT_SOLVED`.
    """
    try:
        return fly()
    except SolveError as error:
        complain(f"{scenario.name}: {error}")
        raise typer.Exit(ExitCode.NOT_SOLVED) from None


def fly_declared(
    planner: Planner, scenario: Scenario, reference: Reference | None, plan: Plan | None
) -> Flight:
    """Simulate a flight of the scenario's vehicle by the package's equations of motion.

    If `reference` is None, the controls of `plan` are applied without feedback. Otherwise, the
    adaptive controller follows the reference. If the scenario gives no speed for
    `Reference.CRUISE`, the cruise is tuned for least energy. `plan`, if given, sets the initial
    state. Only `Reference.PLAN` and None require it.

    Raises
    ------
    ScenarioError
        For `Reference.CRUISE`, if the scenario gives several speeds, or if no tuned flight arrives
        within the limits.
    """
    if reference is Reference.CRUISE:
        asked = scenario if plan is None else plan.scenario
        if asked.baseline.cruise_speeds is None:
            # Speed, acceleration and jerk are tuned.
            return tune_cruise(asked, plan, planner).flight
        return fly_cruise(asked, own_cruise(asked), plan, planner)
    dynamics = vehicle_flown(planner, scenario)
    if reference is None and plan is not None:
        return fly_open_loop(scenario, plan, dynamics)
    return fly_baseline(scenario, reference or Reference.PLAN, dynamics=dynamics, plan=plan)


def fly_mpc(planner: Planner, scenario: Scenario, knowledge: Knowledge) -> Flight:
    """Simulate a flight under model-predictive control.

    At regular intervals during the flight, the controller plans the rest of the mission again.
    `knowledge` states which information on the wind the repeated solves use.
    """
    dynamics = vehicle_flown(planner, scenario)
    return fly_replanned(scenario, knowledge, dynamics=dynamics, planner=planner)


def refuse_outside(scenario: Scenario) -> None:
    """Raise ScenarioError if the simulator RotorPy is missing or cannot simulate the scenario.

    RotorPy cannot simulate a wind that acts as an acceleration, as in eq. (9) of Yacef et al.
    """
    rotorpy_module(MULTIROTOR)
    # In RotorPy, wind acts through the drag.
    refuse_pushing_wind(scenario)


def fly_rotorpy(
    planner: Planner, scenario: Scenario, pilot: str, followed: Reference, plan: Plan | None
) -> Flight:
    """Simulate the scenario's vehicle in RotorPy, a simulator by other authors.

    RotorPy computes the motion. The planner's compiled model gives power, battery and wind. The
    controller `pilot`, a value of `Pilot`, follows the reference `followed`, if it has feedback.
    `plan`, if given, sets the initial state. Open loop and `Reference.PLAN` require a plan.
    """
    plant = OutsidePlant(scenario, planner.dynamics(scenario))
    return fly_outside(plant, Pilot(pilot), followed, plan)


def write_flight(
    folder: Path, planner: Planner, scenario: Scenario, flight: Flight, wall_s: Mapping[str, float]
) -> dict[str, Any]:
    """Write a flight's trajectory and summary into a folder, and return the summary.

    The file `flight.csv` has the trajectory as a table over time. The file `summary.json` has
    energy, duration and outcome. `wall_s` is the wall time [s] of each phase.
    """
    summary = flight_summary(
        scenario,
        flight,
        hover_energy_J=planner.steady_flight(scenario).hover_power * flight.duration_s,
        arrived=has_arrived(flight),
        wall_s=wall_s,
    )
    write_table(flight.frame, folder / FLIGHT_NAME)
    write_summary(folder, summary)
    return summary


def verdict(scenario: Scenario, flight: Flight) -> str:
    """Return a line of text about a simulated flight, for the terminal.

    The line states whether the flight arrived, how far from the goal it ended, its energy, and
    whether a simulation by a second integrator gives the same result.
    """
    end = "arrived" if has_arrived(flight) else "did not arrive"
    confirmed = "confirmed" if flight.is_verified else "not confirmed"
    why = f": {flight.doubt}" if flight.doubt else ""
    return (
        f"{scenario.name}: {flight.name} {end}, {flight.terminal_miss_m:.2g} m from the goal; "
        f"{flight.energy_J:.3f} J, {confirmed} by a second integrator{why}."
    )
