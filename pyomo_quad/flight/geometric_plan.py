"""First plan of a mission: a flight along its shortest route, without an optimisation.

The vehicle flies along the lines of the route, smoothed at corners. A simulation under feedback
turns this path into a flight that satisfies the equations of motion. The plan is not optimal, but
it is available before the first solve ends. See docs/theory/geometric_plan.md, eqs. (5) to (7).

A journey is a sequence of routes, one for each leg from one waypoint to the next. The argument
`told` is the scenario of the mission in its forecast wind, which the planner assumes.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from math import ceil, inf
from typing import TYPE_CHECKING, Any

import numpy as np

from pyomo_quad.collocation import Mesh, SolveError, interpolate_rates
from pyomo_quad.flight.flight import POSITION_STATES, VELOCITY_STATES
from pyomo_quad.flight.long_flight import best_speed
from pyomo_quad.flight.plan import Trajectories
from pyomo_quad.flight.references import quintic_progress
from pyomo_quad.flight.routes import NoRouteError
from pyomo_quad.flight.smoothed_route import Pace, SmoothPath, Stop, smoothed
from pyomo_quad.flight.steady import PITCH, ROLL
from pyomo_quad.flight.verdict import path_of, plan_of, verified
from pyomo_quad.flight.verification import is_of_airspace
from pyomo_quad.model.mission import chosen_times
from pyomo_quad.scenario.accuracy import Accuracy

if TYPE_CHECKING:
    from pyomo_quad.arrays import FloatArray
    from pyomo_quad.collocation import Dynamics, Solution, Violation
    from pyomo_quad.flight.mission_problem import MissionProblem
    from pyomo_quad.flight.plan import Plan
    from pyomo_quad.flight.routes import Journey
    from pyomo_quad.flight.steady import SteadyFlight
    from pyomo_quad.scenario import Scenario

# Paths that are tried: greatest acceleration [m/s^2], and fraction of the cheapest speed. With a
# fixed duration the speed follows from the duration, and a larger acceleration allows a lower
# speed.
_PACES = ((4.0, 1.0), (2.5, 1.0), (2.5, 0.75), (1.5, 0.75), (1.0, 0.75), (1.0, 0.5), (0.6, 0.4))
_PACES_IN_TIME = ((1.2, 1.0), (1.8, 1.0), (3.0, 1.0), (5.0, 1.0))
# Greatest acceleration of a smooth flight that is an initial guess [m/s^2].
_GUESSED = 2.5
# Greatest acceleration at corners of a path that leaves its lines by no more than some centimetres
# [m/s^2].
_NARROW = 0.2
# Fraction of the mission's greatest speed that the path uses, and greatest speed without a limit
# [m/s].
_SHARE_OF_LIMIT, _FASTEST = 0.95, 30.0
# Distance by which a path may enter a zone [m], so that a simulated flight is led out of it.
_LED_OUT_M = 0.1
# Violation of another limit, relative to the larger of 1 and the limit, which interpolation between
# samples and clipping of controls cause.
_EXACTLY = 1e-3
# Largest number of paths that are flown.
_MOST_FLOWN = 3
# Length of the elements of the plan's mesh [s], and their degree.
_ELEMENT_S, _DEGREE = 0.4, 3
# Ends of shorter elements after the start and after the end of a hover [s], in which the thrust
# follows the mass if a payload is released.
_AFTER_RELEASE_S = (0.04, 0.08, 0.16)
# Times that are nearer than this to one another are one boundary of elements [s].
_SAME_S = 1e-6
_YAW = "rigid_body.psi"
_P, _Q, _R = "rigid_body.p", "rigid_body.q", "rigid_body.r"
_ROTOR_SPEED, _ROTOR_ACCELERATION = "rotors.omega[", "rotors.alpha["


def geometric_plan(mission: MissionProblem) -> Plan | None:
    """Return a plan along the shortest route of a mission, made without an optimisation.

    Up to three paths of different speeds or accelerations are simulated, until a simulation
    confirms a plan. If none does, the result is the last simulated plan, or None if there is none.
    The result is also None for a user's own model, or if a waypoint has a prescribed time or
    heading.
    """
    told = mission.told
    if not mission.problems.is_declared or any(
        waypoint.at is not None or waypoint.yaw is not None for waypoint in told.mission.waypoints
    ):
        return None
    try:
        journey = mission.journeys[0]
        fastest = _fastest(told, journey, mission.steady)
        # The error estimate of the plan is the relative difference of its energy from this energy.
        least_energy = _energy_of_steady_flight(mission, journey, fastest)
        return _first_usable(mission, journey, fastest, least_energy)
    except (NoRouteError, SolveError):
        return None


def smooth_flight(mission: MissionProblem, journey: Journey) -> dict[str, Any] | None:
    """Return a flight along the routes of a journey with smooth corners, as an initial guess.

    The keys are "time" (fractions of the horizon), "duration" [s] and names of states. The result
    is None if the vehicle has no steady flight, or no allowed duration is long enough for the path.
    See docs/theory/geometric_plan.md, eqs. (5) and (6).
    """
    told = mission.told
    try:
        fastest = _fastest(told, journey, mission.steady)
        # The flight may break limits of the mission, as any initial guess may.
        pace = Pace(speed=fastest, acceleration=_GUESSED, turning=_GUESSED)
        path = _path(told, journey, pace, fastest)
        if path is None:
            return None
        held = _flat(told, mission.steady.dynamics, mission.steady, path)
    except SolveError:
        return None
    states = dict(zip(held.state_names, held.states.T, strict=True))
    return {"time": held.mesh.node_fractions} | states | {"duration": path.duration}


def _first_usable(
    mission: MissionProblem, journey: Journey, fastest: float, least_energy: float
) -> Plan | None:
    """Return the first plan along a journey that a simulation confirms as usable.

    At most three paths, with speeds up to `fastest` [m/s], are simulated. Error estimates compare
    energies with `least_energy` [J]. If none is confirmed, the result is the last simulated plan,
    if any.
    """
    found: Plan | None = None
    flown, is_free = 0, mission.told.mission.is_free
    for acceleration, share in _PACES if is_free else _PACES_IN_TIME:
        # The second path of a pace stays closer to the route at corners. It is tried if the first
        # path breaks limits of the airspace only, or if its simulation does not confirm it.
        for turning in (acceleration, _NARROW):
            pace = Pace(speed=share * fastest, acceleration=acceleration, turning=turning)
            path = _path(mission.told, journey, pace, fastest)
            if path is None:
                break
            plan, solution = _along(mission, journey, path)
            broken = _broken(plan)
            if not all(is_of_airspace(breach) for breach in broken):
                break
            if broken:
                continue
            # The tolerances are wide: a flight may end half a metre from the goal.
            found = verified(plan, solution, Accuracy.QUICK, least_energy, is_rough=True)
            checked = found.verification
            flown += 1
            if flown == _MOST_FLOWN or (checked is not None and checked.is_usable):
                return found
    return found


def _path(told: Scenario, journey: Journey, pace: Pace, fastest: float) -> SmoothPath | None:
    """Return a smooth path along a journey, with a duration that the mission allows.

    `pace` limits speed and accelerations. If the resulting duration is not allowed, `fastest` [m/s]
    replaces the speed in `pace`. The path then takes the nearest allowed duration. None if this is
    too short.
    """
    stops, mission = _stops(told, journey), told.mission
    least, greatest = mission.duration_limits
    path = smoothed(stops, pace) if mission.is_free else None
    if path is not None and least <= path.duration <= greatest:
        return path
    # The nearest allowed duration determines the speed, up to `fastest` [m/s]. Only the
    # accelerations of `pace` hold.
    lasting = greatest if path is None else min(max(path.duration, least), greatest)
    return smoothed(stops, replace(pace, speed=fastest), lasting)


def _stops(told: Scenario, journey: Journey) -> list[Stop]:
    """Return start, corners and goal of a journey, in the order of the flight.

    Corners are the waypoints, with their hovers and speed limits, and the bends of the routes.
    """
    stops = [Stop(place=journey[0].places[0])]
    for k, route in enumerate(journey):
        stops += [Stop(place=place) for place in route.places[1:]]
        if k < len(told.mission.waypoints):
            waypoint = told.mission.waypoints[k]
            stops[-1] = replace(
                stops[-1],
                hold=waypoint.hold or None,
                speed_max=inf if waypoint.speed_max is None else waypoint.speed_max,
            )
    return stops


def _fastest(told: Scenario, journey: Journey, steady: SteadyFlight) -> float:
    """Return the greatest speed allowed on paths along a journey [m/s].

    It is 95 % of the mission's speed limit, or 30 m/s without one. If the duration is free, it is
    at most the speed of least cost per metre along the longest leg.
    """
    # The cost is the energy plus the price of time [W] times the duration.
    limit = told.limits.speed_max
    greatest = _FASTEST if limit is None else _SHARE_OF_LIMIT * limit
    ways = [route.places[-1] - route.places[0] for route in journey]
    longest = max(ways, key=lambda way: float(np.linalg.norm(way)))
    length = float(np.linalg.norm(longest))
    if not told.mission.is_free or length == 0.0:
        return greatest
    return min(greatest, best_speed(steady, longest / length, told.mission.price_of_time))


def _along(mission: MissionProblem, journey: Journey, path: SmoothPath) -> tuple[Plan, Solution]:
    """Return a plan that follows a path exactly, and the solution with which to verify it.

    The solution is not optimised. The verification takes from it the equations, the required final
    states and the status.
    """
    told = mission.told
    ends = np.cumsum([len(route.places) - 1 for route in journey])[:-1]
    reached = tuple(path.passings[end][0] for end in ends)
    times = chosen_times(told, reached, path.duration)
    solution = mission.unsolved(mesh=mission.arguments["mesh"], guess=times)
    plan = plan_of(told, solution, dict(mission.timings), mission.hover_energy(solution))
    return (
        replace(
            plan,
            trajectories=_flat(told, solution.dynamics, mission.steady, path),
            passing_times_s=reached,
            error_estimate=0.0,
            history=(),
            iterations=(),
            message="it follows straight lines and is not optimised",
        ),
        solution,
    )


def _broken(plan: Plan) -> tuple[Violation, ...]:
    """Return the limits that a planned path violates too much to be worth a simulation.

    The tolerance is 0.1 m for limits of the airspace, and a relative 1e-3 for all others.
    """
    path = path_of(plan, Accuracy.QUICK)
    found = plan.dynamics.violations(path.t, path.states, path.controls)
    # The simulation can remove a violation of the airspace. Its feedback needs additional thrust
    # and tilt, so the path itself must keep other limits. The simulated flight is checked later,
    # with wider tolerances.
    return tuple(
        breach
        for breach in found
        if (breach.size > _LED_OUT_M if is_of_airspace(breach) else breach.relative > _EXACTLY)
    )


def _energy_of_steady_flight(mission: MissionProblem, journey: Journey, fastest: float) -> float:
    """Return the energy of steady flight along a journey [J], an estimate of the least energy.

    For a free duration, the speed is `fastest` [m/s], from `_fastest`. Otherwise, it is the mean
    speed. Implements docs/theory/geometric_plan.md, eq. (7). Raises a
    SolveError if there is no steady flight.
    """
    steady, told = mission.steady, mission.told.mission
    steps = [step for route in journey for step in np.diff(route.places, axis=0)]
    lengths = [float(np.linalg.norm(step)) for step in steps]
    holds = sum(waypoint.hold for waypoint in told.waypoints)
    speed = fastest
    if not told.is_free:
        speed = sum(lengths) / max(told.fixed_duration - holds, _SAME_S)
    hovering = holds if sum(lengths) > 0.0 else told.fixed_duration
    moving = sum(
        steady.trim(step * (speed / length)).power_W * length / speed
        for step, length in zip(steps, lengths, strict=True)
        if length > 0.0
    )
    return moving + (steady.trim().power_W * hovering if hovering else 0.0)


def _flat(
    told: Scenario, dynamics: Dynamics, steady: SteadyFlight, path: SmoothPath
) -> Trajectories:
    """Return states and controls of a vehicle on a path, by differential flatness.

    Implements docs/theory/geometric_plan.md, eqs. (5) and (6). Costates and energies are zero.
    """
    names, mesh = dynamics.state_names, _mesh(path)
    times = path.duration * mesh.node_fractions
    column = {name: k for k, name in enumerate(names)}
    place, velocity, acceleration = path.at(times)
    states = np.tile(steady.trim().states, (len(times), 1))
    states[:, [column[name] for name in POSITION_STATES]] = place
    states[:, [column[name] for name in VELOCITY_STATES]] = velocity
    rotors = [k for k, name in enumerate(names) if name.startswith(_ROTOR_SPEED)]
    yaw = _headings(told, path, times)
    upright = states.copy()
    upright[:, [*rotors, column[ROLL], column[PITCH]]] = 0.0
    # Acceleration that weight and air alone would cause. The thrust adds the rest. All rotors have
    # the same speed: moments are neglected here, and feedback adds them in the simulation.
    falling = _acceleration(dynamics, times, upright)
    needed = acceleration - falling
    size = np.linalg.norm(needed, axis=1)
    upright[:, rotors] = steady.hover_speed
    lifted = np.linalg.norm(_acceleration(dynamics, times, upright) - falling, axis=1)
    ahead, aside = (
        (needed[:, 0] * c + needed[:, 1] * s) / size
        for c, s in ((np.cos(yaw), np.sin(yaw)), (-np.sin(yaw), np.cos(yaw)))
    )
    roll, pitch = -np.arcsin(aside), np.arctan2(ahead, needed[:, 2] / size)
    speeds = steady.hover_speed * np.sqrt(size / lifted)
    rolling, pitching, turning = (np.gradient(row, times) for row in (roll, pitch, yaw))
    spinning = interpolate_rates(mesh, speeds[:, None], mesh.point_fractions) / path.duration
    for name, row in (
        (ROLL, roll),
        (PITCH, pitch),
        (_YAW, yaw),
        (_P, rolling - turning * np.sin(pitch)),
        (_Q, pitching * np.cos(roll) + turning * np.sin(roll) * np.cos(pitch)),
        (_R, turning * np.cos(roll) * np.cos(pitch) - pitching * np.sin(roll)),
    ):
        states[:, column[name]] = row
    states[:, rotors] = speeds[:, None]
    is_rotor = [name.startswith(_ROTOR_ACCELERATION) for name in dynamics.control_names]
    return Trajectories(
        mesh=mesh,
        horizon=(0.0, path.duration),
        state_names=names,
        control_names=dynamics.control_names,
        costate_names=names,
        states=states,
        controls=spinning * is_rotor,
        energy=np.zeros(len(times)),
        costates=np.zeros((mesh.points, len(names))),
        hamiltonian=np.zeros(mesh.points),
    )


def _acceleration(dynamics: Dynamics, times: FloatArray, states: FloatArray) -> FloatArray:
    """Return the acceleration of the vehicle in given states at n times [m/s^2], shape (n, 3).

    The columns are along world x, y and z. The rotor speeds in `states` determine the thrust.
    """
    # The controls, rotor accelerations, do not act on the translation. They are set to zero.
    none = np.zeros(len(dynamics.control_names))
    rows = zip(times.tolist(), states, strict=True)
    rates = np.array([dynamics.rates(t, row, none) for t, row in rows])
    return rates[:, [dynamics.state_names.index(name) for name in VELOCITY_STATES]]


def _mesh(path: SmoothPath) -> Mesh:
    """Return a mesh with element boundaries at a path's corners and at the ends of its hovers."""
    passed = [0.0, path.duration, *(t for pair in path.passings for t in pair)]
    hovered = [t for pair in path.passings for t in pair if pair[1] > pair[0]]
    passed += [t + after for t in hovered for after in _AFTER_RELEASE_S]
    ordered = np.unique(np.clip(passed, 0.0, path.duration))
    kept = ordered[np.diff(ordered, append=inf) > _SAME_S]
    borders = [0.0]
    for first, last in pairwise(kept.tolist()):
        borders += np.linspace(first, last, ceil((last - first) / _ELEMENT_S) + 1)[1:].tolist()
    fractions = np.array(borders) / path.duration
    fractions[-1] = 1.0
    return Mesh(breakpoints=tuple(fractions.tolist()), degrees=(_DEGREE,) * (len(fractions) - 1))


def _headings(told: Scenario, path: SmoothPath, times: FloatArray) -> FloatArray:
    """Return the yaw angle at n times of a path [rad], shape (n,).

    It changes smoothly from the mission's initial to its final heading, from rest to rest.
    """
    first, last = told.mission.start.yaw, told.mission.goal.yaw
    return first + (last - first) * quintic_progress(times / path.duration)
