"""Whether the rotors and the tilt allowed can make the flight, by bounds that hold for any flight.

A mission found impossible here is; one that passes may still be.  The bounds are on a point mass
whose thrust turns at once, so they know nothing of the time the attitude takes.
"""

from collections.abc import Iterator
from math import acos, atan2, cos, hypot, inf, pi, sin

import numpy as np

from pyomo_quad.flight import Planner
from pyomo_quad.flight.steady import MomentumDemand, SteadyFlight
from pyomo_quad.model.finding import Finding, Severity
from pyomo_quad.scenario import Scenario
from pyomo_quad.study.thrust_moments import ThrustMoments

__all__ = ["reach_findings"]

# Durations tried, in doublings and then in halvings, to say how long a mission needs.
_DOUBLINGS = 12
_HALVINGS = 8
# The bounds are computed to better than this, relative.
_MARGIN = 1e-3


def reach_findings(scenario: Scenario, planner: Planner) -> Iterator[Finding]:
    """Yield what rules the flight out for want of thrust, tilt, rotor speed or yaw moment.

    Parameters
    ----------
    scenario : Scenario
        The mission in the wind that the optimiser is told.
    planner : Planner
        Gives its vehicle.

    Yields
    ------
    Finding
        Each names the limit and what the mission needs.
    """
    steady = planner.steady_flight(scenario)
    if scenario.limits.rotor_speed_min > steady.hover_speed:
        yield _impossible(
            "limits.rotor_speed_min",
            f"{scenario.limits.rotor_speed_min:.4g} rad/s; must be at most the "
            f"{steady.hover_speed:.4g} rad/s of hover at start and goal.",
        )
        return
    yield from _yaw_findings(scenario, steady)
    demand = MomentumDemand(planner.dynamics(scenario))
    if demand.is_linear:
        yield from _thrust_findings(scenario, steady, demand)


def _impossible(subject: str, message: str) -> Finding:
    return Finding(severity=Severity.IMPOSSIBLE, subject=subject, message=f"{subject} = {message}")


def _available_thrust(scenario: Scenario, steady: SteadyFlight) -> tuple[str, float]:
    """Return the field that limits the thrust most, with its value, and that thrust."""
    limits = scenario.limits
    # Half way through the flight the rotors are furthest from the hover speed of both ends.
    gain = limits.rotor_acceleration_max * scenario.mission.duration / 2
    candidates = {
        f"limits.rotor_speed_max = {limits.rotor_speed_max:.4g} rad/s": float(
            steady.thrust(limits.rotor_speed_max)
        ),
        f"limits.thrust_max = {limits.thrust_max:.4g} N": limits.thrust_max,
        f"limits.rotor_acceleration_max = {limits.rotor_acceleration_max:.4g} rad/s^2": (
            float(steady.thrust(steady.hover_speed + gain))
        ),
    }
    return min(candidates.items(), key=lambda item: item[1])


def _moments(scenario: Scenario, demand: MomentumDemand, duration: float) -> ThrustMoments:
    mission = scenario.mission
    displacement = np.subtract(mission.goal.position, mission.start.position)
    return ThrustMoments(demand, displacement, duration)


def _thrust_findings(
    scenario: Scenario, steady: SteadyFlight, demand: MomentumDemand
) -> Iterator[Finding]:
    field, available = _available_thrust(scenario, steady)
    duration = scenario.mission.duration
    moments = _moments(scenario, demand, duration)
    against_wind = float(
        np.linalg.norm(moments.mean_thrust - demand.drag * _mean_velocity(scenario))
    )
    if against_wind > available * (1 + _MARGIN):
        yield _impossible(
            "wind.use",
            f"{scenario.wind.use}: holding against the mean wind needs {against_wind:.4g} N of "
            f"thrust, {field} allows {available:.4g} N; raise the limit or calm the wind.",
        )
        return
    needed = moments.least_peak()
    if needed > available * (1 + _MARGIN):
        yield _too_short(scenario, demand, field, available, needed)
        return
    yield from _tilt_findings(scenario, moments, available)


def _mean_velocity(scenario: Scenario) -> np.ndarray:
    mission = scenario.mission
    return np.subtract(mission.goal.position, mission.start.position) / mission.duration


def _too_short(
    scenario: Scenario, demand: MomentumDemand, field: str, available: float, needed: float
) -> Finding:
    subject, _, limit = field.partition(" = ")
    if subject == "limits.rotor_acceleration_max":
        return _impossible(
            subject,
            f"{limit}: the mission needs {needed:.4g} N of thrust, the rotors reach "
            f"{available:.4g} N by half time; raise the limit.",
        )
    least = _least_duration(scenario, demand, available)
    remedy = f"; allow more than {least:.3g} s" if least < inf else ""
    return _impossible(
        "mission.duration",
        f"{scenario.mission.duration:.4g} s: to reach the goal and stop needs {needed:.4g} N of "
        f"thrust, {field} allows {available:.4g} N{remedy}.",
    )


def _least_duration(scenario: Scenario, demand: MomentumDemand, available: float) -> float:
    """Return a duration in which the thrust available is not enough yet, inf if none is."""
    if scenario.wind.series is not None:
        return inf  # the wind beyond the mission is not known

    def is_enough(duration: float) -> bool:
        return _moments(scenario, demand, duration).least_peak() <= available

    short = long = scenario.mission.duration
    for _ in range(_DOUBLINGS):
        short, long = long, 2 * long
        if is_enough(long):
            break
    else:
        return inf
    for _ in range(_HALVINGS):
        middle = (short + long) / 2
        short, long = (short, middle) if is_enough(middle) else (middle, long)
    return short


def _tilt_findings(
    scenario: Scenario, moments: ThrustMoments, available: float
) -> Iterator[Finding]:
    limits = scenario.limits
    # Of all attitudes allowed, both angles at their limit tilt the thrust furthest.
    largest = acos(cos(limits.roll_max) * cos(limits.pitch_max))
    across, up = hypot(*moments.mean_thrust[:2]), float(moments.mean_thrust[2])
    tilt = atan2(across, up)
    subject = "limits.roll_max" if limits.roll_max < limits.pitch_max else "limits.pitch_max"
    limit = min(limits.roll_max, limits.pitch_max)
    allowed = f"{limit:.4g} rad: roll and pitch together tilt the thrust by {largest:.3g} rad"
    if tilt > largest * (1 + _MARGIN):
        yield _impossible(
            subject,
            f"{allowed}, the mean thrust of the mission must tilt by {tilt:.3g} rad; raise the "
            "limit or calm the wind.",
        )
        return
    sideways = moments.least_peak(axes=(0, 1))
    if largest < pi / 2 and sideways > available * sin(largest) * (1 + _MARGIN):
        yield _impossible(
            subject,
            f"{allowed}, so {available * sin(largest):.3g} N across at full thrust, the mission "
            f"needs {sideways:.3g} N; raise the limit or allow more time.",
        )


def _yaw_findings(scenario: Scenario, steady: SteadyFlight) -> Iterator[Finding]:
    vehicle, limits, mission = scenario.vehicle, scenario.limits, scenario.mission
    if vehicle.Ix != vehicle.Iy:
        return  # roll and pitch rates together turn the vehicle as well
    moment = min(
        limits.yaw_moment_max, steady.yaw_moment(limits.rotor_speed_max, limits.rotor_speed_min)
    )
    # Full moment one way for half of the time, the other way for the rest.
    reachable = moment / vehicle.Iz * mission.duration**2 / 4
    turn = abs(mission.goal.yaw - mission.start.yaw)
    if turn > reachable * (1 + _MARGIN):
        needed = 2 * (turn * vehicle.Iz / moment) ** 0.5
        yield _impossible(
            "mission.goal.yaw",
            f"{mission.goal.yaw:.4g} rad: in {mission.duration:.4g} s a yaw moment of "
            f"{moment:.3g} N m turns by at most {reachable:.3g} rad, the mission turns by "
            f"{turn:.3g} rad; turn less or allow more than {needed:.3g} s.",
        )
