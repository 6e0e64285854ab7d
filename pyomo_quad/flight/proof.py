"""Verification of a plan that was read from a file, independent of the results in the file.

The horizon of the plan must agree with the mission. So must its initial and final state, unless the
model is a user's own. The controls, simulated by SciPy with the scenario's own equations, must
reproduce the states of the file.
"""

from dataclasses import replace
from math import inf, isfinite

import numpy as np

from pyomo_quad.arrays import FloatArray
from pyomo_quad.collocation import Dynamics, SolveError, TranscriptionError
from pyomo_quad.flight.baselines import declared_start, wanted_at_goal
from pyomo_quad.flight.flight import ARRIVAL_DISTANCE_M, Flown, terminal_miss_of
from pyomo_quad.flight.plan import Trajectories
from pyomo_quad.flight.planning import Builder, Planner
from pyomo_quad.flight.verification import (
    BALANCE_TOLERANCE,
    Passage,
    Verification,
    beyond,
    tolerated,
    verify_controls,
    wind_lacking,
)
from pyomo_quad.model import build_model, model_builder
from pyomo_quad.scenario import Scenario, ScenarioError
from pyomo_quad.scenario.accuracy import USABLE, Figures
from pyomo_quad.scenario.messages import shown

# Relative rounding error of a duration that a file stores in decimals.
_SAME_TIME = 1e-9
# Advice at the end of every message of this module.
_AGAIN = "solve the scenario again."


#: Tolerances for a plan read from the table of a report. The table has each control clipped to its
#: limits, and the polynomial through the clipped values differs from the planned one. If controls
#: are at their limits for a long time, flights of tables deviate by 2 cm, 1.4e-3 of a limit and
#: 2e-5 of the energy.
TABLE = replace(USABLE, miss=ARRIVAL_DISTANCE_M, breach=1e-2)


def refuse_unproven(
    scenario: Scenario,
    planned: Trajectories,
    energy: float,
    passing_times_s: tuple[float, ...],
    allowed: Figures,
    dynamics: Dynamics | None = None,
    *,
    is_code_allowed: bool = False,
) -> None:
    """Raise a ScenarioError if simulation with the mission's equations does not confirm a plan.

    The plan states `energy` [J] and `passing_times_s`. The tolerance `allowed.miss` applies to all
    states throughout the flight, and to waypoints. Without `dynamics`, the scenario is compiled; a
    user's own model then requires `is_code_allowed`.
    """
    _refuse_other_times(scenario, planned, passing_times_s)
    builder: Builder = build_model
    if dynamics is None:
        builder = model_builder(scenario, is_code_allowed=is_code_allowed)
        told = scenario.lasting(planned.horizon[1], passing_times_s).as_forecast()
        try:
            dynamics = Planner(builder).dynamics(told)
        except TranscriptionError as error:
            raise ScenarioError(f"{scenario.name}: {error}") from None
    ordered = in_order(scenario, planned, dynamics)
    states, controls = ordered.states, ordered.controls
    if builder is build_model and scenario.model is None:
        _refuse_other_ends(scenario, dynamics, states, allowed)
    waypoints = zip(scenario.mission.waypoints, passing_times_s, strict=True)
    passages = [Passage(time_s=t, position=w.position, radius=w.radius) for w, t in waypoints]
    plan = dynamics, planned.mesh, states, controls, planned.horizon, energy
    try:
        verification, flown = verify_controls(*plan, scenario.airspace, passages)
    except SolveError as error:
        raise ScenarioError(f"{scenario.name}: {error}") from None
    _refuse_astray(scenario, planned, dynamics, flown, allowed)
    lost = wind_lacking(scenario, dynamics, flown)
    if lost:
        raise ScenarioError(f"{scenario.name}: flown again, {lost}")
    _refuse_broken_limits(scenario, verification, allowed)
    _refuse_failed(scenario, verification, energy, allowed)


def _refuse_broken_limits(scenario: Scenario, verification: Verification, allowed: Figures) -> None:
    """Raise a ScenarioError if a plan's simulated flight breaks a limit by too much.

    The tolerances are those in `allowed`. On zones, floor, ceiling and fence, only the relative
    tolerance `allowed.breach` is applied, not the absolute one, `allowed.intrusion`.
    """
    # The absolute tolerance on zones, floor, ceiling and fence [m] is too strict for the rounded
    # controls of a plan that was read from a table.
    figures = replace(allowed, intrusion=inf)
    for breach in beyond(verification.breaches, figures):
        raise ScenarioError(
            f"{scenario.name}: flown again, the plan has a breach of {breach.name} of "
            f"{breach.size:.3g}; must be at most {tolerated(breach, figures):g}; {_AGAIN}"
        )


def _refuse_failed(
    scenario: Scenario, verification: Verification, energy: float, allowed: Figures
) -> None:
    """Raise a ScenarioError if a simulated flight fails on energy, waypoints or battery.

    `energy` is the energy that the plan states [J]. `allowed` has tolerances on energy and distance
    from waypoints. The battery must be able to give the flight's power and voltage.
    """
    share = abs(verification.energy_difference_J) / max(1.0, abs(energy))
    passed = max(verification.passing_misses_m, default=0.0)
    failings = (
        (share, allowed.energy, "share of the energy not accounted for"),
        (passed, allowed.miss, "distance in m by which a waypoint is missed"),
        (verification.battery_imbalance, BALANCE_TOLERANCE, "share that the pack cannot give"),
        (
            verification.voltage_lacking,
            BALANCE_TOLERANCE,
            "share of the voltage that the pack cannot give",
        ),
    )
    for found, most, words in failings:
        if not found <= most:
            raise ScenarioError(
                f"{scenario.name}: flown again, the plan has a {words} of {found:.3g}; must be at "
                f"most {most:g}; {_AGAIN}"
            )


def _refuse_other_times(
    scenario: Scenario, held: Trajectories, passing_times_s: tuple[float, ...]
) -> None:
    mission, (start, end) = scenario.mission, held.horizon
    least, greatest = mission.duration_limits
    leeway = _SAME_TIME * greatest
    if abs(start) > leeway or not least - leeway <= end <= greatest + leeway:
        allowed = (
            f"0 to {least:g} s" if least == greatest else f"0 to from {least:g} to {greatest:g} s"
        )
        raise ScenarioError(
            f"{scenario.name}: horizon = {start:g} to {end:.9g} s; must be {allowed}, as in the "
            f"mission; {_AGAIN}"
        )
    ordered = np.diff([0.0, *passing_times_s, end])
    if len(passing_times_s) != len(mission.waypoints) or np.any(ordered < 0.0):
        raise ScenarioError(
            f"{scenario.name}: passing_times_s has {len(passing_times_s)} times; must have a time "
            f"within the flight for each of {len(mission.waypoints)} waypoints, rising; {_AGAIN}"
        )
    for k, (waypoint, time) in enumerate(zip(mission.waypoints, passing_times_s, strict=True)):
        if waypoint.at is not None and abs(waypoint.at - time) > leeway:
            raise ScenarioError(
                f"{scenario.name}: mission.waypoints[{k}] is passed at {time:g} s; must be "
                f"{waypoint.at:g} s, as in the mission; {_AGAIN}"
            )


def in_order(scenario: Scenario, planned: Trajectories, dynamics: Dynamics) -> Trajectories:
    """Return a plan whose states and controls are those of given equations, in their order.

    A state that the plan lacks gets the mission's initial value, and NaN after the start. Raises a
    ScenarioError if the mission lacks this value, or the plan lacks a control.
    """
    missing = set(dynamics.control_names) - set(planned.control_names)
    if missing:
        raise ScenarioError(
            f"{scenario.name}: the plan has no {shown(min(missing))[1:-1]}, without which it "
            "cannot be flown again; export the file of Plan.save."
        )
    start = declared_start(scenario, dynamics)
    states = np.full((len(planned.states), len(dynamics.state_names)), np.nan)
    for k, name in enumerate(dynamics.state_names):
        # A state that only the plan has is left out.
        if name in planned.state_names:
            states[:, k] = planned.states[:, planned.state_names.index(name)]
        elif name in start:
            states[0, k] = start[name]
        else:
            raise ScenarioError(
                f"{scenario.name}: the initial value of state {name} is unknown; export the file "
                "of Plan.save."
            )
    return replace(
        planned,
        state_names=dynamics.state_names,
        control_names=dynamics.control_names,
        states=states,
        controls=planned.controls[
            :, [planned.control_names.index(n) for n in dynamics.control_names]
        ],
    )


def _refuse_other_ends(
    scenario: Scenario, dynamics: Dynamics, states: FloatArray, allowed: Figures
) -> None:
    """Raise a ScenarioError if the initial or final state of a plan differs from the mission's.

    The tolerance of a state is allowed.miss * max(1, abs(its value in the mission)). States that
    the plan lacks (NaN) are not compared.
    """
    for end, wanted, found in (
        ("start", declared_start(scenario, dynamics), states[0]),
        ("end", wanted_at_goal(scenario, dynamics), states[-1]),
    ):
        known = {
            name: value
            for name, value in wanted.items()
            if isfinite(found[dynamics.state_names.index(name)])
        }
        miss = terminal_miss_of(dynamics, found, known)
        name = max(miss, key=lambda name: abs(miss[name]) / max(1.0, abs(known[name])))
        if not abs(miss[name]) <= allowed.miss * max(1.0, abs(known[name])):
            value, unit = known[name] + miss[name], dynamics.unit(name)
            raise ScenarioError(
                f"{scenario.name}: at the {end} of the plan {name} = {value:.6g} {unit}; must be "
                f"{known[name]:.6g} {unit}, as in the mission; {_AGAIN}"
            )


def _refuse_astray(
    scenario: Scenario, planned: Trajectories, dynamics: Dynamics, flown: Flown, allowed: Figures
) -> None:
    """Raise a ScenarioError if the simulated states deviate from the states of the plan.

    The tolerance of a state is allowed.miss * max(1, abs(planned value)).
    """
    expected = planned.states_at(flown.t)
    worst, when, which = 0.0, 0.0, ""
    for k, name in enumerate(planned.state_names):
        if name in dynamics.state_names:
            column = flown.states[:, dynamics.state_names.index(name)]
            off = np.abs(column - expected[:, k]) / np.maximum(1.0, np.abs(expected[:, k]))
            if not off.max() <= worst:
                worst, when, which = float(off.max()), float(flown.t[int(off.argmax())]), name
    if not worst <= allowed.miss:
        raise ScenarioError(
            f"{scenario.name}: flown again, the plan is {worst:.3g} {dynamics.unit(which)} off in "
            f"{which} at {when:.4g} s; must be at most {allowed.miss:g}, relative for values "
            f"above 1; {_AGAIN}"
        )
