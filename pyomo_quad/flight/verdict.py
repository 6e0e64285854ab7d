"""Plans made from solutions of the optimal control problem, and their verification."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import TYPE_CHECKING

from pyomo_quad.collocation import SolveError, Status
from pyomo_quad.flight.plan import Plan, PlanStatus, trajectories_of
from pyomo_quad.flight.verification import verify_controls, wind_lacking
from pyomo_quad.scenario.mission import Aim

if TYPE_CHECKING:
    from pyomo_quad.collocation import Solution
    from pyomo_quad.scenario import Scenario
    from pyomo_quad.scenario.accuracy import Accuracy

_STATUS = {
    Status.NOT_CONVERGED: PlanStatus.NOT_CONVERGED,
    Status.INFEASIBLE: PlanStatus.INFEASIBLE,
    Status.INTERRUPTED: PlanStatus.INTERRUPTED,
}


def plan_of(
    scenario: Scenario,
    solution: Solution,
    timings: dict[str, float],
    hover_energy: float,
) -> Plan:
    """Return an unverified plan made from a solution of the optimal control problem.

    Parameters
    ----------
    scenario : Scenario
        The scenario that was solved.
    solution : Solution
        Result of the collocation engine, of any status.
    timings : dict
        Computing time so far [s] by phase, such as "build" and "compile".
    hover_energy : float
        Energy of hovering for the same time [J].

    Returns
    -------
    Plan
        Plan with status `SOLVED`, or with the status and message of the failed solve.
    """
    return Plan(
        scenario=scenario,
        status=_STATUS.get(solution.status, PlanStatus.SOLVED),
        message=solution.message,
        energy=energy_of(scenario, solution),
        hover_energy_J=hover_energy,
        trajectories=trajectories_of(solution),
        verification=None,
        error_estimate=solution.error_estimate,
        history=solution.history,
        iterations=solution.iterations,
        timings=timings,
        warm_start=solution.warm_start,
        solution=solution,
        passing_times_s=tuple(
            solution.value("mission.passing_time", index=k)
            for k in range(len(scenario.mission.waypoints))
        ),
    )


def horizon_of(scenario: Scenario) -> tuple[float, float] | None:
    """Return start and end time of a scenario's flight [s]; None for a free end time."""
    return None if scenario.mission.is_free else (0.0, scenario.mission.fixed_duration)


def energy_of(scenario: Scenario, solution: Solution) -> float:
    """Return the energy of a solution [J], which may differ from the objective of the solve.

    The objective may also contain the price of time and the loss in the battery.
    """
    if not scenario.mission.is_free and scenario.mission.aim is Aim.ENERGY:
        return solution.objective
    return float(solution.running_objective[-1])


def verified(plan: Plan, solution: Solution, accuracy: Accuracy | None = None) -> Plan:
    """Verify a plan by simulating its controls; return the plan with the result.

    Parameters
    ----------
    plan : Plan
        A plan of a converged or nearly converged solution.
    solution : Solution
        The solution from which the plan was made.
    accuracy : Accuracy, optional
        Accuracy to confirm; by default the scenario's accuracy.

    Returns
    -------
    Plan
        The plan with `verification`, the simulated flight, and status `VERIFIED` or `SOLVED`.
    """
    started = time.perf_counter()
    held = plan.trajectories
    try:
        verification, flown = verify_controls(
            plan.dynamics,
            held.mesh,
            held.states,
            held.controls,
            held.horizon,
            plan.energy,
            plan.scenario.airspace,
            plan.passages,
            accuracy or plan.scenario.solver.accuracy,
        )
    except SolveError as error:
        return replace(plan, status=PlanStatus.SOLVED, message=str(error))
    timings = dict(plan.timings) | {"verify": time.perf_counter() - started}
    lost = wind_lacking(plan.scenario, plan.dynamics, flown)
    if lost:
        verification = replace(verification, is_verified=False, is_usable=False, reached=None)
    is_proven = verification.is_verified and solution.status is Status.CONVERGED
    return replace(
        plan,
        status=PlanStatus.VERIFIED if is_proven else PlanStatus.SOLVED,
        message=verification.shortfall or lost or plan.message,
        verification=verification,
        flown=flown,
        timings=timings,
    )
