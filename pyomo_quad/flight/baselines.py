"""Simulated flights that are compared with a plan, with or without feedback control.

With feedback, a controller (class `AdaptiveController`) steers the vehicle along a reference: a
path over time, such as the plan itself or a smooth path from start to goal. Without feedback (in
open loop), the plan's controls are applied as functions of time.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from math import inf, nan, sqrt
from time import perf_counter

import numpy as np

from pyomo_quad.arrays import FloatArray
from pyomo_quad.collocation import ClosedLoop, Dynamics, SolveError, Violation
from pyomo_quad.flight.columns import flight_frame
from pyomo_quad.flight.controller import (
    COMMAND_SIZE,
    CONTROLLER_STATES,
    MEASURED_STATES,
    AdaptiveController,
    feedback_law,
    mixer_matrix,
)
from pyomo_quad.flight.deadline import keep_time
from pyomo_quad.flight.flight import (
    AIR_FORCE,
    ARRIVAL_DISTANCE_M,
    ARRIVAL_SPEED_M_PER_S,
    HELD_BREACH,
    POSITION_STATES,
    VELOCITY_STATES,
    Flight,
    Flown,
    is_broken,
)
from pyomo_quad.flight.integration import integrate
from pyomo_quad.flight.limit_words import limit_words
from pyomo_quad.flight.plan import Plan, Trajectories
from pyomo_quad.flight.references import PlannedPath, ReferencePath, minimum_snap, quintic, step
from pyomo_quad.flight.routes import cruise
from pyomo_quad.flight.verification import (
    BALANCE_TOLERANCE,
    fly_controls,
    shares_lacking,
    voltage_lacking,
)
from pyomo_quad.model.battery import CHARGE_STATE
from pyomo_quad.model.battery_circuit import states_at_start
from pyomo_quad.model.mission import HOVERING_M, HOVERING_M_PER_S
from pyomo_quad.model.turbulence import FILTER_STATES
from pyomo_quad.scenario import Scenario, ScenarioError
from pyomo_quad.scenario.accuracy import FIGURES, Accuracy
from pyomo_quad.scenario.mission import Hover
from pyomo_quad.scenario.tables import Reference

# Names of components of the declared model, or their beginnings.
_RIGID_BODY = "rigid_body."
_ROTOR_SPEED = "rotors.omega["
_YAW = "rigid_body.psi"
_STATE_OF_CHARGE = "battery.state_of_charge"


def start_state(scenario: Scenario, dynamics: Dynamics, plan: Plan | None = None) -> FloatArray:
    """Return the initial state of a flight: the plan's or, without a plan, hover at the start.

    The order is that of `dynamics.state_names`. If the initial value of a state is unknown, as for
    a user's own model without a plan, a ScenarioError is raised.
    """
    if plan is not None:
        held = plan.trajectories
        known = dict(zip(held.state_names, held.states[0].tolist(), strict=True))
    else:
        known = declared_start(scenario, dynamics)
    known |= _filters_at_start(dynamics)
    unknown = next((name for name in dynamics.state_names if name not in known), None)
    if unknown is not None:
        raise ScenarioError(
            f"{scenario.name}: the initial value of state {unknown} of the model is unknown; fly "
            "it with a plan."
        )
    return np.array([known[name] for name in dynamics.state_names])


def _filters_at_start(dynamics: Dynamics) -> dict[str, float]:
    """Return the initial states of the filters that model turbulence: state name -> value.

    The Pyomo model gives the values. The result is empty if the equations include no turbulence.
    """
    if not set(FILTER_STATES) <= set(dynamics.state_names):
        return {}
    begun = dynamics.initial_states()
    return {name: begun[name] for name in FILTER_STATES}


def declared_start(scenario: Scenario, dynamics: Dynamics) -> dict[str, float]:
    """Return the initial states that the mission defines: state name -> value.

    In hover, velocity, body rates, roll and pitch are zero; the yaw is the heading at the start.
    Battery states are included if the model has them. Other states of a user's own model are left
    out.
    """
    known = _hovering(scenario, scenario.mission.start, dynamics)
    if CHARGE_STATE in dynamics.state_names and dynamics.has(_STATE_OF_CHARGE):
        known[CHARGE_STATE] = _charge_drawn(scenario, dynamics)
        known |= states_at_start(scenario)
    return known


def wanted_at_goal(scenario: Scenario, dynamics: Dynamics) -> dict[str, float]:
    """Return the values that the mission requires of the states at its end: hover at the goal.

    The result maps state names to values, without battery states. The rotor speeds are those of
    hover after the release of all payloads.
    """
    lighter = sqrt(scenario.mass_at_goal / scenario.vehicle.total_mass)
    return _hovering(scenario, scenario.mission.goal, dynamics, lighter)


def _hovering(
    scenario: Scenario, place: Hover, dynamics: Dynamics, slower: float = 1.0
) -> dict[str, float]:
    names = dynamics.state_names
    hover_speed = slower * scenario.vehicle.hover_speed(scenario.gravity)
    states = {name: 0.0 for name in names if name.startswith(_RIGID_BODY)}
    states |= {name: hover_speed for name in names if name.startswith(_ROTOR_SPEED)}
    return states | dict(zip((*POSITION_STATES, _YAW), (*place.position, place.yaw), strict=True))


def _charge_drawn(scenario: Scenario, dynamics: Dynamics) -> float:
    """Return the charge missing from the full battery at the start of the flight [A h]."""
    states = np.zeros((2, len(dynamics.state_names)))
    states[1, dynamics.state_names.index(CHARGE_STATE)] = 1.0
    controls = np.zeros((2, len(dynamics.control_names)))
    # The state of charge is a linear function of the missing charge.
    full, less = dynamics.evaluate(_STATE_OF_CHARGE, np.zeros(2), states, controls).tolist()
    # The missing charge at which the state of charge has its initial value.
    return (scenario.battery.initial_state_of_charge - full) / (less - full)


# Tolerance of the integrators, which gives energies to 1e-7 or better with either of them.
_TOLERANCE = 1e-7
# Longest step of the integrators [s], so that no step in smooth flight misses a gust or a change of
# the reference.
LONGEST_STEP = 0.1
# A controlled flight takes some 500 evaluations per second of flight. Ten times that number
# indicates a tumble, which would keep the integrator busy for hours.
_MOST_EVALUATIONS_PER_SECOND = 5000
# In turbulence, the integrator is restarted at each jump of the noise, every 0.02 s, and takes some
# 120 evaluations to the next one (measured). A few times that number are allowed in addition.
_MOST_EVALUATIONS_PER_JUMP = 400
# Rows of a flight's table per second of flight.
RATE_HZ = 100.0


class TumblingGuard:
    """Guard that stops the simulation of a tumbling vehicle.

    A tumbling vehicle needs far more evaluations of the equations than a controlled one. Too many
    evaluations raise an error.

    Parameters
    ----------
    flight : str
        Name of the flight, for the error message.
    duration : float
        Duration of the flight [s]. The limit rises with it.
    jumps : int, optional
        Number of jumps of an input, such as noise. Each of them raises the limit.
    """

    def __init__(self, flight: str, duration: float, jumps: int = 0) -> None:
        self.evaluations = 0
        self._flight = flight
        self._most = _MOST_EVALUATIONS_PER_SECOND * max(1.0, duration)
        self._most += _MOST_EVALUATIONS_PER_JUMP * jumps

    def evaluated(self, t: float) -> None:
        """Count an evaluation of the differential equations; raise an error if there are too many.

        `t` is the time in flight [s], for the message. A SolveError means that the vehicle tumbles.
        A TimeIsUpError is raised after the limit `solver.time_limit`.
        """
        keep_time()
        self.evaluations += 1
        if self.evaluations > self._most:
            raise SolveError(
                f"{self._flight}: out of control at {t:.4g} s, stopped after {self._most:g} "
                "evaluations; check the gains and limits of the scenario."
            )


class Integrator(StrEnum):
    """Integration methods of SciPy for simulated flights: `DOP853` and `LSODA`.

    The two methods share no code. A flight is verified only if it is simulated by both, and they
    agree on its final position and its energy.
    """

    RUNGE_KUTTA = "DOP853"
    MULTISTEP = "LSODA"


@dataclass(frozen=True, kw_only=True)
class ClosedLoopFlight:
    """Samples of the vehicle and of the controller over a simulated flight under feedback.

    Attributes
    ----------
    flown : Flown
        Samples of the vehicle's states, controls (rotor accelerations) and energy at n times.
    controller_states : ndarray, shape (n, 22)
        States of the controller at the same times, in the order of the names in
        `CONTROLLER_STATES`.
    evaluations : int
        Number of evaluations of the right-hand side by the integrator.
    """

    flown: Flown
    controller_states: FloatArray
    evaluations: int


def fly(
    *,
    dynamics: Dynamics,
    controller: AdaptiveController,
    reference: ReferencePath,
    initial_state: FloatArray,
    times: FloatArray,
    integrator: Integrator = Integrator.RUNGE_KUTTA,
    tolerance: float = _TOLERANCE,
    last: FloatArray | None = None,
    system: ClosedLoop | None = None,
) -> ClosedLoopFlight:
    """Simulate a vehicle whose adaptive controller follows a reference path.

    `last` has the controller's states after the previous part of the flight, if any. `system` is
    the compiled closed loop, by default the result of `closed_loop`. A SolveError is raised if the
    integration fails, the vehicle tumbles, or the time limit of the enclosing `Deadline` passes.
    """
    # Compiling takes about 0.1 s.
    if system is None:
        system = closed_loop(dynamics, controller)
    span = float(times[0]), float(times[-1])
    edges = dynamics.steps_between(*span)
    guard = TumblingGuard("controlled flight", span[1] - span[0], len(edges))
    loop = _Loop(system, dynamics, controller, reference, guard)
    rows = integrate(
        loop.rates,
        span,
        loop.started(times[0], initial_state, last),
        times,
        edges,
        flight="controlled flight",
        remedy="Check the gains and limits of the scenario.",
        method=integrator.value,
        rtol=tolerance,
        atol=tolerance,
        max_step=LONGEST_STEP,
    )
    return loop.flight(times, rows.T)


def closed_loop(dynamics: Dynamics, controller: AdaptiveController) -> ClosedLoop:
    """Return the compiled closed loop of a vehicle and its adaptive controller.

    Its states are the joint states of both. Controllers that differ only in the initial values of
    their states have the same closed loop.
    """
    law = feedback_law(controller, dynamics)
    return ClosedLoop(dynamics, law, n_command=COMMAND_SIZE, n_own=len(CONTROLLER_STATES))


class _Loop:
    """Closed loop of vehicle and controller as a system of differential equations.

    A joint state holds the states of the vehicle, those of the controller, and the energy spent.
    """

    def __init__(
        self,
        system: ClosedLoop,
        dynamics: Dynamics,
        controller: AdaptiveController,
        reference: ReferencePath,
        guard: TumblingGuard,
    ) -> None:
        self._system = system
        self._controller = controller
        self._reference = reference
        self._size = len(dynamics.state_names)
        self._body = [list(dynamics.state_names).index(name) for name in MEASURED_STATES]
        self._guard = guard

    def started(self, t: float, state: FloatArray, last: FloatArray | None) -> FloatArray:
        """Return the joint state at the initial time t [s].

        `state` is the initial state of the vehicle. `last` is the final state of the controller in
        the previous part of the flight, if any.
        """
        body, before = state[self._body].tolist(), None if last is None else last.tolist()
        own = self._controller.started(self._reference(t), body, before)
        return np.array([*state, *own, 0.0])

    def rates(self, t: float, joint: FloatArray) -> FloatArray:
        """Return the time derivative of the joint state of vehicle, controller and energy.

        `joint` is the joint state at time `t` [s], shape (n_joint,).
        """
        self._guard.evaluated(t)
        return self._system.rates(t, joint, self._controller.command(self._reference, t))

    def flight(self, times: FloatArray, rows: FloatArray) -> ClosedLoopFlight:
        """Return the simulated flight from the joint states `rows` at the given times [s]."""
        commands = np.array([self._controller.command(self._reference, t) for t in times.tolist()])
        return ClosedLoopFlight(
            flown=Flown(
                t=times,
                states=rows[:, : self._size],
                controls=self._system.controls(times, rows, commands),
                energy=rows[:, -1],
            ),
            controller_states=rows[:, self._size : -1],
            evaluations=self._guard.evaluations,
        )


#: Name of the flight that applies a plan's controls without feedback.
OPEN_LOOP = "open_loop/plan"

_PATHS = {
    Reference.STEP: step,
    Reference.QUINTIC: quintic,
    Reference.MINIMUM_SNAP: minimum_snap,
}
# Samples of the plan per second, between which the reference is interpolated.
_PLAN_RATE_HZ = 20.0
# Position and yaw, their rates and accelerations, by their names in the declared model.
_PLACE = (*POSITION_STATES, "rigid_body.psi")
_RATE = (*VELOCITY_STATES, "rigid_body.dpsi_dt")
_ACCELERATION = tuple(f"rigid_body.d{name}_dt" for name in ("vx", "vy", "vz", "r"))
_TILT_RATE = ("rigid_body.dphi_dt", "rigid_body.dtheta_dt")
_YAW_REACTION = "rotors.yaw_reaction"
# Step of the difference quotient of the planned yaw rate [s].
_INSTANT = 1e-4


def baseline_name(reference: Reference, speed: float | None = None) -> str:
    """Return the name of a flight under feedback, such as "adaptive/cruise 6 m/s".

    `reference` is the kind of path that the adaptive controller follows. `speed` is the speed of an
    autopilot's cruise [m/s], None for another path.
    """
    return f"adaptive/{reference.value}" + ("" if speed is None else f" {speed:g} m/s")


def fly_baseline(
    scenario: Scenario, reference: Reference, *, dynamics: Dynamics, plan: Plan | None = None
) -> Flight:
    """Simulate a mission under the adaptive controller along a reference, and verify the flight.

    The flight is verified if two integrators agree and the battery can supply the power. With a
    plan, it starts in the plan's initial state. For errors, see `fly`, `reference_path` and
    `refuse_other_vehicles`.
    """
    began = perf_counter()
    first = fly_reference(scenario, reference, dynamics=dynamics, plan=plan)
    second = fly_reference(
        scenario,
        reference,
        dynamics=dynamics,
        plan=plan,
        integrator=Integrator.MULTISTEP,
        rate_hz=0.0,
    )
    # For a cruise, `routes.cruise_at` has made the scenario.
    speeds = scenario.baseline.cruise_speeds if reference is Reference.CRUISE else None
    return assembled_flight(
        baseline_name(reference, *(speeds or ())),
        scenario,
        dynamics,
        ((first.flown, second.flown),),
        plan,
        began,
    )


def fly_reference(
    scenario: Scenario,
    reference: Reference,
    *,
    dynamics: Dynamics,
    plan: Plan | None = None,
    integrator: Integrator = Integrator.RUNGE_KUTTA,
    rate_hz: float = RATE_HZ,
    tolerance: float = _TOLERANCE,
) -> ClosedLoopFlight:
    """Simulate a mission once under the adaptive controller along a reference.

    Unlike `fly_baseline`, this function neither verifies nor tabulates the flight. With a plan, the
    flight starts in the plan's initial state. `Reference.PLAN` requires a plan, whose trajectory is
    the path. `rate_hz` is the number of samples per second; the first and the last time are always
    included. `tolerance` is that of the integrator. For errors, see `fly`, `reference_path` and
    `refuse_other_vehicles`.
    """
    refuse_other_vehicles(scenario, dynamics)
    duration = scenario.mission.fixed_duration
    return fly(
        dynamics=dynamics,
        controller=AdaptiveController(scenario, mixer_matrix(dynamics)),
        reference=reference_path(scenario, reference, plan),
        initial_state=start_state(scenario, dynamics, plan),
        times=even_times(0.0, duration, rate_hz),
        integrator=integrator,
        tolerance=tolerance,
    )


def reference_path(
    scenario: Scenario, reference: Reference, plan: Plan | None = None
) -> ReferencePath:
    """Return the reference path that the controller follows, for one kind of reference.

    The path takes a time [s] and returns the `Setpoint` to follow. If the reference is the plan but
    none is given, a ScenarioError is raised.
    """
    if reference in _PATHS:
        return _PATHS[reference](scenario.mission)
    if reference is Reference.CRUISE:
        return cruise(scenario)
    if plan is None:
        raise ScenarioError(
            f"{scenario.name}: reference {reference.value!r} needs a plan; solve the scenario "
            "first."
        )
    return path_of(plan.trajectories, plan.dynamics, plan.mission_flown)


def fly_open_loop(scenario: Scenario, plan: Plan, dynamics: Dynamics) -> Flight:
    """Simulate a vehicle that applies a plan's controls without feedback; verify the flight.

    The flight is verified if two integrators agree and the battery can supply the power. `scenario`
    is `plan.mission_flown`: the mission with the plan's duration and passing times of waypoints.
    `dynamics` are the vehicle's equations in the actual wind.
    """
    began = perf_counter()
    held = plan.trajectories
    start = start_state(scenario, dynamics, plan)
    first, second = (
        fly_controls(dynamics, held.mesh, held.controls, start, held.horizon, method=method.value)
        for method in Integrator
    )
    return assembled_flight(OPEN_LOOP, scenario, dynamics, ((first, second),), plan, began)


def assembled_flight(
    name: str,
    scenario: Scenario,
    dynamics: Dynamics,
    flown_twice: Sequence[tuple[Flown, Flown]],
    plan: Plan | None,
    began: float,
) -> Flight:
    """Join the simulated parts of a flight, verify them, and estimate the energy still needed.

    A flight has several parts if its plan is replaced in flight. `flown_twice` has each part,
    simulated by two integrators. `began` is `time.perf_counter` at the start. The energy from the
    final state to hover at the goal follows from the plan's costates. It is NaN without a plan, and
    with a wind forecast, because the costates are then those of another wind.
    """
    flown = _joined([part for part, _ in flown_twice])
    final = dict(zip(dynamics.state_names, flown.states[-1].tolist(), strict=True))
    # The differences between the integrators are summed over the parts.
    doubt = "; ".join(_doubts(dynamics, flown_twice, flown))
    is_told = scenario.wind.forecast is None
    flight = Flight.from_flown(
        name,
        dynamics,
        flown,
        wanted_at_goal(scenario, dynamics),
        flight_frame(dynamics, flown.t, flown.states, flown.controls, flown.energy),
        is_verified=not doubt,
        wall_s=perf_counter() - began,
        owed_energy_J=plan.owed_energy(final) if plan is not None and is_told else nan,
        allowed=_ALLOWED_UNDER_CONTROL,
        accuracy=scenario.solver.accuracy,
    )
    missed = tuple(missed.words for missed in _missed_waypoints(scenario, dynamics, flown))
    return replace(flight, broken_limits=(*flight.broken_limits, *missed), doubt=doubt)


# Tolerances within which two integrators must agree on a flight.
_AGREEING = FIGURES[Accuracy.PROOF]
# Tolerated violations of limits under feedback. A controlled flight may pass a waypoint, and hover
# there, with the distance and speed that are allowed on arrival; the limits of a hover are on
# squares. The limit that keeps the heading applies to plans only: feedback must be free to turn
# back to the heading, and the final heading is compared with the rest of the final state.
_ALLOWED_UNDER_CONTROL = {
    "mission.hold_distance": (HOVERING_M + ARRIVAL_DISTANCE_M) ** 2 - HOVERING_M**2,
    "mission.hold_speed": (HOVERING_M_PER_S + ARRIVAL_SPEED_M_PER_S) ** 2 - HOVERING_M_PER_S**2,
    "mission.yaw_keeping": inf,
}


def broken_under_control(
    scenario: Scenario, dynamics: Dynamics, flown: Flown, breaches: Sequence[Violation]
) -> dict[str, float]:
    """Return the limits that a flight under feedback violates: name in words -> relative amount.

    The amount is relative to the larger of 1 and the limit. Waypoints and hovers have additional
    tolerances: `ARRIVAL_DISTANCE_M` [m] and `ARRIVAL_SPEED_M_PER_S` [m/s].
    """
    broken = {
        limit_words(breach.name): breach.relative
        for breach in breaches
        if is_broken(breach, _ALLOWED_UNDER_CONTROL, FIGURES[scenario.solver.accuracy].breach)
    }
    missed = _missed_waypoints(scenario, dynamics, flown)
    return broken | {limit_words(miss.limit): miss.relative for miss in missed}


@dataclass(frozen=True, kw_only=True)
class _Missed:
    """Record of a waypoint that a flight passes too far away or too fast."""

    # Name of the violated constraint in the Pyomo model.
    limit: str
    # Violation relative to the larger of 1 and the limit.
    relative: float
    # Limit and actual distance [m] or speed [m/s], for the user.
    words: str


def _missed_waypoints(scenario: Scenario, dynamics: Dynamics, flown: Flown) -> Iterator[_Missed]:
    """Yield a record for each violated limit on distance or speed at a waypoint with a given time.

    The arrival tolerances `ARRIVAL_DISTANCE_M` [m] and `ARRIVAL_SPEED_M_PER_S` [m/s] are allowed.
    """
    states = [dynamics.state_names.index(name) for name in (*POSITION_STATES, *VELOCITY_STATES)]
    for k, waypoint in enumerate(scenario.mission.waypoints):
        if waypoint.at is None:
            continue
        then = int(np.argmin(np.abs(flown.t - waypoint.at)))
        place, velocity = np.split(flown.states[then, states], 2)
        off = float(np.linalg.norm(place - waypoint.position))
        near = max(waypoint.radius, HOVERING_M if waypoint.hold else 0.0)
        if off > near + ARRIVAL_DISTANCE_M:
            yield _Missed(
                limit=f"mission.passing_near[{k}]",
                relative=(off - near) / max(1.0, near),
                words=f"mission.waypoints[{k}].radius = {waypoint.radius:g} m passed "
                f"{off:.3g} m off",
            )
        speed, allowed = float(np.linalg.norm(velocity)), waypoint.speed_max
        if allowed is not None and speed > allowed + ARRIVAL_SPEED_M_PER_S:
            yield _Missed(
                limit=f"mission.passing_speed[{k}]",
                relative=(speed - allowed) / max(1.0, allowed),
                words=f"mission.waypoints[{k}].speed_max = {allowed:g} m/s passed at "
                f"{speed:.3g} m/s",
            )


def path_of(planned: Trajectories, dynamics: Dynamics, scenario: Scenario) -> PlannedPath:
    """Return a plan as a reference path for the controller, sampled at 20 Hz.

    The equations `dynamics` of the plan give velocities, accelerations and air forces for
    feedforward. `scenario` has the vehicle's mass and inertia, and the payloads that the mission
    releases.
    """
    vehicle, times = scenario.vehicle, even_times(*planned.horizon, _PLAN_RATE_HZ)
    controls = planned.controls_at(times, dynamics.control_limits(HELD_BREACH))
    flown = times, planned.states_at(times), controls
    keys = tuple((name, None) for name in (*_PLACE, *_RATE, *_ACCELERATION))
    rows = dynamics.table(keys, *flown)
    air = np.zeros((len(times), len(_PLACE)))
    if all(dynamics.has(name) for name in AIR_FORCE):
        forces = dynamics.table(tuple((name, None) for name in AIR_FORCE), *flown)
        released = np.array([*map(scenario.release_schedule(), times.tolist())])
        air[:, : len(AIR_FORCE)] = forces / (vehicle.total_mass - released)[:, None]
    values, rates, accelerations = np.split(rows, 3, axis=1)
    if dynamics.has(_YAW_REACTION):
        # The acceleration of the rotors turns the body more than their drag; the control law models
        # this effect only.
        reaction = dynamics.table(((_YAW_REACTION, None),), *flown)[:, 0]
        air[:, -1] = reaction / vehicle.Iz
        accelerations[:, -1] = _yaw_acceleration(dynamics, *flown)
    turning = dynamics.table(tuple((name, None) for name in _TILT_RATE), *flown)
    return PlannedPath(times, values, rates, accelerations - air, turning)


def _yaw_acceleration(
    dynamics: Dynamics, times: FloatArray, states: FloatArray, controls: FloatArray
) -> FloatArray:
    """Return the time derivative of the planned yaw rate by central differences [rad/s^2].

    `states` and `controls` are the plan's values at the n `times` [s]. The result has shape (n,).
    """
    steps = _INSTANT * np.array(
        [dynamics.rates(t, x, u) for t, x, u in zip(times.tolist(), states, controls, strict=True)]
    )
    key = ((_RATE[-1], None),)
    before, after = (dynamics.table(key, times, states + s * steps, controls) for s in (-1, 1))
    return np.asarray((after - before)[:, 0] / (2 * _INSTANT))


def _doubts(
    dynamics: Dynamics, flown_twice: Sequence[tuple[Flown, Flown]], flown: Flown
) -> Iterator[str]:
    """Yield the reasons, in words, why a simulated flight is not verified.

    A flight has several parts if its plan is replaced in flight. `flown_twice` has each part,
    simulated by two integrators. `flown` is the whole flight, simulated by the first of them.
    """
    columns = [dynamics.state_names.index(name) for name in POSITION_STATES]
    ends = np.array([[flown.states[-1, columns] for flown in pair] for pair in flown_twice])
    spent = np.array([[flown.energy[-1] for flown in pair] for pair in flown_twice])
    apart = float(np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1).sum())
    total, other = spent.sum(axis=0)
    allowed = _AGREEING.energy * max(1.0, abs(total))
    added = ""
    if len(flown_twice) > 1:
        added = (
            f", the sum over {len(flown_twice)} parts between plans, each with its own error; "
            "a longer baseline.mpc.interval makes fewer parts"
        )
    if not apart <= _AGREEING.miss:
        yield (
            f"two integrators end {apart:.2g} m apart; must be at most {_AGREEING.miss:g} m{added}"
        )
    if not abs(total - other) <= allowed:
        yield (
            f"two integrators differ by {abs(total - other):.2g} J in the energy spent; must be at "
            f"most {allowed:.2g} J{added}"
        )
    shares = {
        "power or charge that the flight needs": max(shares_lacking(dynamics, flown)),
        "voltage that the motors need to keep their speed": voltage_lacking(dynamics, flown),
    }
    for needed, lacking in shares.items():
        if not lacking <= BALANCE_TOLERANCE:
            yield (
                f"the pack lacks {100.0 * lacking:.3g} % of the {needed}; "
                f"must be at most {100.0 * BALANCE_TOLERANCE:g} %"
            )


def _joined(parts: Sequence[Flown]) -> Flown:
    """Join consecutive parts of a simulated flight into one flight.

    The energy of the result counts from the start of the flight, that of a part from its own start.
    """
    spent = np.cumsum([0.0, *(part.energy[-1] for part in parts)])
    # The sample that two parts share is included once.
    kept = [slice(0, None), *(slice(1, None) for _ in parts[1:])]
    return Flown(
        t=np.concatenate([part.t[k] for part, k in zip(parts, kept, strict=True)]),
        states=np.vstack([part.states[k] for part, k in zip(parts, kept, strict=True)]),
        controls=np.vstack([part.controls[k] for part, k in zip(parts, kept, strict=True)]),
        energy=np.concatenate(
            [e + part.energy[k] for e, part, k in zip(spent[:-1], parts, kept, strict=True)]
        ),
    )


def refuse_other_vehicles(scenario: Scenario, dynamics: Dynamics) -> None:
    """Raise a ScenarioError if the vehicle model lacks a state that the controller measures.

    `MEASURED_STATES` has the names of these states. The message names the first that is missing.
    """
    missing = next((name for name in MEASURED_STATES if name not in dynamics.state_names), None)
    if missing is not None:
        raise ScenarioError(
            f"{scenario.name}: the model has no state {missing}; the controller flies only models "
            "with the states of the declared quadrotor."
        )


def even_times(start: float, end: float, rate_hz: float) -> FloatArray:
    """Return equally spaced times from start to end, both included [s].

    `rate_hz` is the number of times per second. It is met approximately, because a whole number of
    equal steps must fit between `start` and `end`.
    """
    return np.linspace(start, end, max(2, round((end - start) * rate_hz) + 1))
