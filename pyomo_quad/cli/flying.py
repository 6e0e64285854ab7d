"""What `pyomo-quad fly` does once its scenario is read; imports the engine, as `solving` does."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pyomo_quad.cli.consoles import complain
from pyomo_quad.cli.exit_codes import ExitCode
from pyomo_quad.cli.solving import exit_code_of
from pyomo_quad.collocation import SolveError
from pyomo_quad.flight import Flight, Plan, Planner
from pyomo_quad.flight.baselines import fly_baseline, fly_open_loop
from pyomo_quad.report.flight_summary import flight_summary
from pyomo_quad.report.summary import write_summary
from pyomo_quad.report.table_file import write_table
from pyomo_quad.scenario import Scenario
from pyomo_quad.scenario.baseline import Reference
from pyomo_quad.study.comparison import has_arrived

__all__ = ["make_flight", "make_plan", "verdict", "write_flight"]

_FLIGHT_NAME = "flight.csv"


def make_plan(planner: Planner, scenario: Scenario) -> Plan | ExitCode:
    """Make the plan that a flight follows.

    Parameters
    ----------
    planner : Planner
        Of the scenario's model.
    scenario : Scenario
        The mission.

    Returns
    -------
    Plan or ExitCode
        The status to end with where there is no verified plan.
    """
    plan = planner.solve(scenario)
    status = exit_code_of(plan)
    if status is ExitCode.VERIFIED:
        return plan
    complain(f"{scenario.name}: no plan to follow, {plan.status.value}: {plan.message}")
    return status


def make_flight(
    planner: Planner, scenario: Scenario, reference: Reference | None, plan: Plan | None
) -> Flight | ExitCode:
    """Fly.

    Parameters
    ----------
    planner : Planner
        Of the scenario's model.
    scenario : Scenario
        The mission.
    reference : Reference or None
        What the adaptive controller follows; None flies the plan in open loop.
    plan : Plan or None
        Where the flight needs one.

    Returns
    -------
    Flight or ExitCode
        The status to end with where the flight is out of control.
    """
    dynamics = planner.dynamics(scenario)
    try:
        if reference is None and plan is not None:
            return fly_open_loop(scenario, plan, dynamics)
        return fly_baseline(scenario, reference or Reference.PLAN, dynamics=dynamics, plan=plan)
    except SolveError as error:
        complain(f"{scenario.name}: {error}")
        return ExitCode.NOT_SOLVED


def write_flight(
    folder: Path,
    planner: Planner,
    scenario: Scenario,
    flight: Flight,
    wall_s: Mapping[str, float],
) -> dict[str, Any]:
    """Write a flight's table and summary.

    Parameters
    ----------
    folder : Path
        An existing folder.
    planner : Planner
        Of the scenario's model.
    scenario : Scenario
        The mission flown.
    flight : Flight
        What to write.
    wall_s : mapping
        Seconds of each phase.

    Returns
    -------
    dict
        The summary.
    """
    summary = flight_summary(
        scenario,
        flight,
        hover_energy_J=planner.steady_flight(scenario).hover_power * scenario.mission.duration,
        arrived=has_arrived(flight),
        wall_s=wall_s,
    )
    write_table(flight.frame, folder / _FLIGHT_NAME)
    write_summary(folder, summary)
    return summary


def verdict(scenario: Scenario, flight: Flight) -> str:
    """Return what became of a flight in one sentence.

    Parameters
    ----------
    scenario : Scenario
        The mission flown.
    flight : Flight
        The flight.

    Returns
    -------
    str
        One line.
    """
    end = "arrived" if has_arrived(flight) else "did not arrive"
    confirmed = "confirmed" if flight.is_verified else "not confirmed"
    return (
        f"{scenario.name}: {flight.name} {end}, {flight.terminal_miss_m:.2g} m from the goal; "
        f"{flight.energy_J:.3f} J, {confirmed} by a second integrator."
    )
