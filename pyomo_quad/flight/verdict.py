"""Functions that make plans from solutions of the optimal control problem, and verify the plans.

A solution consists of the variables of the discretised problem. A plan adds the scenario, the
energy and a status. To verify a plan, its controls are simulated without feedback.

The controls of a coarse solution are first corrected by feedback: a simulated vehicle follows the
planned path (`flight.tracking`). If this flight breaks limits, the path is changed, and the next
flight follows the changed path.

argument | meaning
accuracy | required accuracy level, which sets the tolerances
wanted | final states that the flight should reach, shape (n_states,)
least_energy | estimate of the mission's least energy [J], to compare with a flight's energy
demands | changes of the path that a flight under feedback follows
previous | preceding flight under feedback, whose deviations the next one anticipates
"""

from __future__ import annotations

import time
from dataclasses import replace
from math import isfinite
from typing import TYPE_CHECKING

import numpy as np

from pyomo_quad.collocation import SolveError, Status
from pyomo_quad.flight.displacement import limits_along, moves_in_hovers, pushes_out
from pyomo_quad.flight.flight import HELD_BREACH, Flown
from pyomo_quad.flight.limit_words import percent
from pyomo_quad.flight.plan import (
    LEAST_ENERGY_J,
    Plan,
    PlanStatus,
    Trajectories,
    trajectories_of,
)
from pyomo_quad.flight.state_shifts import shifts_within_limits
from pyomo_quad.flight.tracking import NO_DEMANDS, Demands, can_be_tracked, tracked
from pyomo_quad.flight.verification import (
    Verification,
    compared,
    samples_of_path,
    verify_controls,
    wind_lacking,
)
from pyomo_quad.scenario.accuracy import FIGURES, Accuracy
from pyomo_quad.scenario.mission import Aim

if TYPE_CHECKING:
    from pyomo_quad.arrays import FloatArray
    from pyomo_quad.collocation import Solution
    from pyomo_quad.scenario import Scenario

# Violation of a limit, relative to the larger of 1 and the limit, above which corrections of the
# controls are not tried; that above which they are not tried again after a flight that anticipates
# deviations; and largest number of simulated flights in which they are improved.
_HOPELESS, _STILL_HOPELESS, _MOST_FLIGHTS = 1.5, 0.2, 5
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

    Its status is `SOLVED`, or that of the failed solve. `timings` has the computing times so far
    [s] by phase. `hover_energy` is that of hovering in still air for the same duration [J].
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
    """Return start and end time of a scenario's flight [s], or None if the end time is free."""
    return None if scenario.mission.is_free else (0.0, scenario.mission.fixed_duration)


def energy_of(scenario: Scenario, solution: Solution) -> float:
    """Return the energy of the flight in a solution [J], without other terms of the objective.

    Other possible terms are the price of time, multiplied by the duration, and the energy lost
    inside the battery.
    """
    if not scenario.mission.is_free and scenario.mission.aim is Aim.ENERGY:
        return solution.objective
    return float(solution.running_objective[-1])


def verified(
    plan: Plan,
    solution: Solution,
    accuracy: Accuracy | None = None,
    least_energy: float | None = None,
    *,
    is_rough: bool = False,
) -> Plan:
    """Verify a plan by simulation of its controls, and return it with the result.

    `plan` was made from `solution`. The status is `VERIFIED` if the solve converged and all checks
    succeed. Below the accuracy `proof`, the error estimate of the plan is also checked.

    At the accuracy `proof`, and for models without the states for feedback (see `can_be_tracked`),
    the planned controls are simulated without a correction. Otherwise, feedback first corrects the
    controls (docs/theory/tracking.md), unless the planned path is far beyond a limit. A plan far
    beyond a limit is neither corrected nor simulated.

    The default of `accuracy` is that of the scenario. The default of `least_energy` is the plan's
    energy. If `is_rough`, the corrections end at the first usable plan, which keeps the tolerances
    `scenario.accuracy.USABLE`.
    """
    started = time.perf_counter()
    asked = accuracy or plan.scenario.solver.accuracy
    wanted = trajectories_of(solution).states[-1]
    try:
        # A solution on a coarse mesh is inexact: with its controls, the vehicle would miss the
        # goal. For `proof`, the mesh is fine.
        if asked is not Accuracy.PROOF:
            verification, flown = _as_planned(plan, asked, wanted)
        # No simulation is needed if the planned path itself is far beyond a limit.
        if asked is Accuracy.PROOF or not can_be_tracked(plan.dynamics):
            verification, flown = _flown(plan, asked, wanted)
        elif verification.max_violation <= _HOPELESS:
            # The energy of a plan with stricter limits than the mission's exceeds the least energy.
            least = plan.energy if least_energy is None else least_energy
            plan, verification, flown = _corrected(plan, asked, wanted, least, is_rough=is_rough)
    except SolveError as error:
        return replace(plan, status=PlanStatus.SOLVED, message=str(error))
    timings = dict(plan.timings) | {"verify": time.perf_counter() - started}
    lost = wind_lacking(plan.scenario, plan.dynamics, flown)
    if lost:
        verification = replace(verification, is_verified=False, is_usable=False, reached=None)
    is_proven = verification.is_verified and solution.status is Status.CONVERGED
    is_optimal = asked is Accuracy.PROOF or plan.error_estimate <= FIGURES[asked].energy
    return replace(
        plan,
        status=PlanStatus.VERIFIED if is_proven and is_optimal else PlanStatus.SOLVED,
        message=verification.shortfall or lost or _why_not(plan, verification, asked),
        verification=verification,
        flown=flown,
        timings=timings,
    )


def _corrected(
    plan: Plan, accuracy: Accuracy, wanted: FloatArray, least_energy: float, *, is_rough: bool
) -> tuple[Plan, Verification, Flown]:
    """Correct a plan's controls by feedback, and simulate the corrected controls without feedback.

    At most five flights under feedback are tried, until one is verified (with `is_rough`, usable).
    The result is the last usable flight. Without one, it is the last flight, not simulated again.
    """
    demands = NO_DEMANDS
    previous: Trajectories | None = None
    found: list[tuple[Plan, Verification, Flown]] = []
    # A flight under feedback that misses its tolerances is repeated with changes of the path.
    while len(found) < _MOST_FLIGHTS:
        try:
            followed = _followed(plan, least_energy, demands, previous)
            goal = _attainable(followed, wanted)
            verification, path = _as_planned(followed, accuracy, goal)
        except SolveError:
            if not found:
                raise
            break
        found.append((followed, verification, path))
        is_enough = verification.is_verified or (is_rough and verification.is_usable)
        most = _HOPELESS if previous is None else _STILL_HOPELESS
        is_hopeless = verification.max_violation > most or followed is plan
        if is_enough or is_hopeless:
            break
        more = _more_demands(plan, demands, path, FIGURES[accuracy].breach)
        if previous is not None and more == demands:
            break
        # The next flight anticipates the deviations of this flight.
        demands, previous = more, followed.trajectories
    usable = [one for one in found if one[1].reached or one[1].is_usable]
    if not usable:
        return found[-1]
    corrected = usable[-1][0]
    return corrected, *_flown(corrected, accuracy, _attainable(corrected, wanted))


def _more_demands(plan: Plan, demands: Demands, path: Flown, allowed: float) -> Demands:
    """Return the changes of the path for the next flight under feedback, after one broke limits.

    That flight followed the changes `demands` and has the samples `path`. New changes are added to
    `demands`. `allowed` is the tolerated violation relative to max(1, abs(limit)).
    """
    # New changes are displacements out of zones, shifts away from limits on tilt, speed and rotor
    # speeds, and rest during all hovers if the flight moved during a hover.
    rests, limits = demands.rests, limits_along(plan.dynamics, path)
    if not rests and moves_in_hovers(path, limits, allowed):
        begun = zip(plan.scenario.mission.waypoints, plan.passing_times_s, strict=True)
        rests = tuple((start, start + w.hold) for w, start in begun if w.hold)
    shifts = shifts_within_limits(plan.dynamics.state_names, path, limits, allowed)
    return Demands(
        displacement=(*demands.displacement, *pushes_out(plan.dynamics, path, limits)),
        rests=rests,
        shifts=(*demands.shifts, *shifts),
    )


def _attainable(plan: Plan, wanted: FloatArray) -> FloatArray:
    """Return the final states that the flight of a plan should reach, shape (n_states,).

    They are `wanted`, except for states that measure consumption, such as the charge drawn. Their
    final values are those of the plan.
    """
    used = set(plan.dynamics.states_used_up)
    is_used = np.array([name in used for name in plan.dynamics.state_names])
    # The mission does not prescribe the final consumption; it is that of the plan.
    return np.where(is_used, plan.trajectories.states[-1], wanted)


def _why_not(plan: Plan, found: Verification, accuracy: Accuracy) -> str:
    """Return the reason why a simulated plan does not reach the required accuracy, as a message.

    The reason is a violated limit, or an energy that may exceed the optimum by more than the
    tolerance. Otherwise, the message of the solve is kept.
    """
    excess = plan.error_estimate
    if accuracy is Accuracy.PROOF or (found.is_verified and excess <= FIGURES[accuracy].energy):
        return plan.message
    if found.broken_limits:
        return f"its simulated flight exceeds a limit: {found.broken_limits[0]}"
    if isfinite(excess) and excess > FIGURES[accuracy].energy:
        return f"it may spend up to {percent(excess)} more than the optimum"
    return plan.message


def _flown(plan: Plan, accuracy: Accuracy, wanted: FloatArray) -> tuple[Verification, Flown]:
    """Simulate a plan's controls in open loop, and compare the flight with the plan.

    Raises a SolveError if the integrator fails or the time limit passes.
    """
    held = plan.trajectories
    return verify_controls(
        plan.dynamics,
        held.mesh,
        held.states,
        held.controls,
        held.horizon,
        plan.energy,
        plan.scenario.airspace,
        plan.passages,
        accuracy,
        wanted,
    )


def _followed(
    plan: Plan,
    least_energy: float,
    demands: Demands,
    previous: Trajectories | None,
) -> Plan:
    """Correct a plan's controls by feedback; return `plan` if the vehicle cannot follow its path.

    The error estimate is max(e, abs(E - E_least) / E_least), docs/theory/tracking.md, eq. (5). Here
    e is the estimate of `plan`, E the corrected plan's energy, and E_least is `least_energy`.
    """
    followed = tracked(plan.dynamics, plan.trajectories, demands, previous)
    if followed is None:
        return plan
    energy = float(followed.energy[-1])
    excess = abs(energy - least_energy) / max(abs(least_energy), LEAST_ENERGY_J)
    return replace(
        plan,
        trajectories=followed,
        energy=energy,
        error_estimate=max(plan.error_estimate, excess),
    )


def _as_planned(plan: Plan, accuracy: Accuracy, wanted: FloatArray) -> tuple[Verification, Flown]:
    """Compare the planned states with goal, limits and battery, without a simulation.

    The returned `Flown` has samples of the planned path. `accuracy` also sets the spacing of the
    samples near keep-out zones.
    """
    path = path_of(plan, accuracy)
    return compared(plan.dynamics, path, plan.energy, wanted, plan.passages, accuracy), path


def path_of(plan: Plan, accuracy: Accuracy) -> Flown:
    """Return samples of a flight that follows the planned path exactly.

    The samples serve to check limits without a simulation. `accuracy` sets the spacing of the
    samples near keep-out zones. Elsewhere, each mesh element has at least eight samples.
    """
    held, spacing = plan.trajectories, FIGURES[accuracy].spacing
    shares = samples_of_path(plan.dynamics, held.mesh, held.states, plan.scenario.airspace, spacing)
    borders, widths = held.mesh.breakpoints, held.mesh.widths
    starts = zip(borders, widths, shares, strict=False)
    fractions = np.concatenate([[0.0], *(a + width * share for a, width, share in starts)])
    t = held.horizon[0] + (held.horizon[1] - held.horizon[0]) * fractions
    return Flown(
        t=t,
        states=held.states_at(t),
        controls=held.controls_at(t, plan.dynamics.control_limits(HELD_BREACH)),
        energy=held.energy_at(t),
    )
