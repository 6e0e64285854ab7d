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

    Parameters
    ----------
    planner : Planner
        Planner of the scenario.
    scenario : Scenario
        Mission and wind.

    Returns
    -------
    Plan
        A flyable plan.

    Raises
    ------
    Exit
        If the plan is not flyable. The plan's status and message give the reason; they are printed
        to standard error. The exit status follows from the plan's status.
    """
    plan = plan_at_risk(scenario, planner)
    if plan.is_flyable:
        return plan
    status = exit_code_of(plan)
    complain(f"{scenario.name}: no plan to follow, {plan.status.value}: {plan.message}")
    raise typer.Exit(status)


_Outcome = TypeVar("_Outcome")


def make_flight(scenario: Scenario, fly: Callable[[], _Outcome]) -> _Outcome:
    """Simulate flights by a call of the function `fly`, and return them.

    If a flight is impossible, `fly` raises `SolveError`. This function then prints the error's
    message to standard error, and ends the command.

    Parameters
    ----------
    scenario : Scenario
        Scenario of the flights. The printed message begins with the scenario's name.
    fly : callable
        Function without arguments that simulates and returns one flight or several.

    Returns
    -------
    flights
        The object that `fly` returns.

    Raises
    ------
    Exit
        If a flight is impossible. The exit status is `NOT_SOLVED`, a value of `ExitCode`.
    """
    try:
        return fly()
    except SolveError as error:
        complain(f"{scenario.name}: {error}")
        raise typer.Exit(ExitCode.NOT_SOLVED) from None


def fly_declared(
    planner: Planner, scenario: Scenario, reference: Reference | None, plan: Plan | None
) -> Flight:
    """Simulate a flight of the scenario's vehicle by the package's own equations of motion.

    Parameters
    ----------
    planner : Planner
        Source of the vehicle's equations of motion.
    scenario : Scenario
        Mission and wind.
    reference : Reference or None
        Reference trajectory that the adaptive controller follows. None applies the plan's controls
        without feedback. `Reference.CRUISE` flies like an autopilot, at the scenario's cruise
        speed.
    plan : Plan or None
        Plan of the scenario; None if the flight needs no plan.

    Raises
    ------
    ScenarioError
        For a cruise, if the scenario gives several cruise speeds. If it gives none, the speed is
        tuned; the error is also raised if no tuned flight arrives within the limits.
    """
    if reference is Reference.CRUISE:
        asked = scenario if plan is None else plan.scenario
        if asked.baseline.cruise_speeds is None:
            # Speed, acceleration and jerk are tuned for least energy.
            return tune_cruise(asked, plan, planner).flight
        return fly_cruise(asked, own_cruise(asked), plan, planner)
    dynamics = vehicle_flown(planner, scenario)
    if reference is None and plan is not None:
        return fly_open_loop(scenario, plan, dynamics)
    return fly_baseline(scenario, reference or Reference.PLAN, dynamics=dynamics, plan=plan)


def fly_mpc(planner: Planner, scenario: Scenario, knowledge: Knowledge) -> Flight:
    """Simulate a flight under model-predictive control.

    At regular intervals during the flight, the controller plans the rest of the mission again.

    Parameters
    ----------
    planner : Planner
        Planner of the repeated solves.
    scenario : Scenario
        Mission and wind.
    knowledge : Knowledge
        Information on the wind that is available to the repeated solves.
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

    Parameters
    ----------
    planner : Planner
        Planner with the scenario's compiled model. The model gives power, battery and wind; RotorPy
        computes the motion.
    scenario : Scenario
        Mission and wind.
    pilot : str
        Name of the controller: "adaptive" for the adaptive controller of this package, "se3" for
        RotorPy's geometric controller, or "open_loop" for the plan's controls without feedback.
    followed : Reference
        Reference trajectory.
    plan : Plan or None
        Plan, if the reference is a plan.
    """
    plant = OutsidePlant(scenario, planner.dynamics(scenario))
    return fly_outside(plant, Pilot(pilot), followed, plan)


def write_flight(
    folder: Path, planner: Planner, scenario: Scenario, flight: Flight, wall_s: Mapping[str, float]
) -> dict[str, Any]:
    """Write a flight's trajectory and summary into a folder, and return the summary.

    The file `flight.csv` has the trajectory as a table over time. The file `summary.json` has the
    summary: energy, duration and outcome of the flight.

    Parameters
    ----------
    folder : Path
        Existing empty folder.
    planner : Planner
        Planner that computes the power of hovering, for comparison.
    scenario : Scenario
        Mission that was flown.
    flight : Flight
        The flight.
    wall_s : mapping
        Wall time [s] of each phase of the command.
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
