"""Cruise: what an autopilot makes of a mission, one speed and straight legs with limited jerk.

Each straight leg is flown from rest to rest in the seven phases of [1]_: the jerk is j, 0, -j to
reach the speed, 0 along the leg, and -j, 0, j to stop.  On a leg too short for the speed the
cruise is left out and a lower speed reached; too short for the largest acceleration, that too.

The vehicle stops at every waypoint, holds there as long as the mission says, and stops at every
corner of the shortest clear way round keep-outs; at the goal it hovers.
Times that the mission gives are not kept: a cruise takes its own.

.. [1] Biagiotti and Melchiorri, "Trajectory Planning for Automatic Machines and Robots",
   Springer 2008, section 3.4.
"""

from itertools import pairwise
from math import sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pyomo_quad.flight.references import SampledPath, stops_of
from pyomo_quad.flight.routes import find_routes, no_way
from pyomo_quad.scenario import Scenario, ScenarioError

FloatArray = NDArray[np.float64]

#: s of hovering at the goal, of which a flight takes the first that suffices to arrive.
SETTLINGS_S = (0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 6.0)
# s; phases shorter than this are none.
_INSTANT = 1e-9


class SpeedProfile(NamedTuple):
    """Where phases of constant jerk begin and end, each of shape (n,)."""

    times: FloatArray
    """s from the first."""
    distances: FloatArray
    """m done."""
    speeds: FloatArray
    """m/s."""
    accelerations: FloatArray
    """m/s^2."""


def speed_profile(distance: float, speed: float, acceleration: float, jerk: float) -> SpeedProfile:
    """Return the fastest profile from rest to rest over a distance within three limits.

    Parameters
    ----------
    distance : float
        m, positive.
    speed, acceleration, jerk : float
        Largest magnitudes, m/s, m/s^2 and m/s^3.

    Returns
    -------
    SpeedProfile
        At the ends of its seven phases, n = 8; some may last no time.
    """
    peak = min(speed, _peak_speed(distance, acceleration, jerk))
    bending = min(acceleration / jerk, sqrt(peak / jerk))
    straight = max(peak / (jerk * bending) - bending, 0.0)
    cruising = max(distance / peak - (2 * bending + straight), 0.0)
    ramp = (bending, straight, bending)
    rows = [(0.0, 0.0, 0.0, 0.0)]
    jerks = (jerk, 0.0, -jerk, 0.0, -jerk, 0.0, jerk)
    for lasting, change in zip((*ramp, cruising, *ramp), jerks, strict=True):
        t, s, v, a = rows[-1]
        rows.append(
            (
                t + lasting,
                s + lasting * (v + lasting * (a / 2 + lasting * change / 6)),
                v + lasting * (a + lasting * change / 2),
                a + lasting * change,
            )
        )
    # At rest and there, but for rounding.
    rows[-1] = (rows[-1][0], distance, 0.0, 0.0)
    return SpeedProfile(*np.array(rows).T)


def _peak_speed(distance: float, acceleration: float, jerk: float) -> float:
    """Return the speed reached where nothing but the distance limits it."""
    unbent = acceleration / jerk
    reached = acceleration / 2 * (sqrt(unbent**2 + 4 * distance / acceleration) - unbent)
    if reached >= acceleration * unbent:
        return reached
    return float((distance**2 * jerk / 4) ** (1 / 3))


def cruise_at(scenario: Scenario, speed: float | None = None, settling_s: float = 0.0) -> Scenario:
    """Return a mission with the times that cruising takes, at a speed [m/s] or the one it has.

    At the goal it hovers for `settling_s`.

    Raises
    ------
    ScenarioError
        If a leg leads nowhere, or zones leave it no way.
    """
    told = scenario
    if speed is not None:
        baseline = scenario.baseline.model_copy(update={"cruise_speeds": (speed,)})
        told = scenario.model_copy(update={"baseline": baseline})
    holds = (*(waypoint.hold for waypoint in scenario.mission.waypoints), 0.0)
    reached, left = [], 0.0
    for pieces, hold in zip(_legs(told), holds, strict=True):
        reached.append(left + sum(float(profile.times[-1]) for _, profile in pieces))
        left = reached[-1] + hold
    return told.lasting(reached[-1] + settling_s, reached[:-1])


def cruise(scenario: Scenario) -> SampledPath:
    """Return the path of a mission that has the times of `cruise_at`."""
    stops, times = stops_of(scenario.mission)
    holds = (0.0, *(waypoint.hold for waypoint in scenario.mission.waypoints))
    knots: list[float] = []
    rows: list[FloatArray] = []
    for k, pieces in enumerate(_legs(scenario)):
        began, turn = times[k] + holds[k], stops[k + 1][-1] - stops[k][-1]
        length = sum(float(profile.distances[-1]) for _, profile in pieces)
        place = np.array(stops[k])
        for step, profile in pieces:
            way = np.append(step, turn * profile.distances[-1] / length)
            shares = np.array(profile[1:]) / profile.distances[-1]
            samples = shares[:, :, None] * way
            samples[0] += place
            rows.append(samples)
            knots += (began + profile.times).tolist()
            began, place = knots[-1], place + way
    duration = scenario.mission.fixed_duration
    if knots[-1] > duration:
        raise ScenarioError(
            f"{scenario.name}: mission.duration = {duration:g} s; reference cruise takes "
            f"{knots[-1]:g} s and keeps its own time; fly it by itself or in a run."
        )
    kept = np.diff(knots, append=np.inf) > _INSTANT
    return SampledPath(np.array(knots)[kept], *np.concatenate(rows, axis=1)[:, kept])


def _legs(scenario: Scenario) -> list[list[tuple[FloatArray, SpeedProfile]]]:
    """Return the straight pieces of each leg, as the step in m and how it is flown."""
    baseline, airspace = scenario.baseline, scenario.airspace
    if baseline.cruise_speeds is None or len(baseline.cruise_speeds) > 1:
        raise ScenarioError(
            f"{scenario.name}: baseline.cruise_speeds must be one speed for one flight along "
            "reference cruise; give one, as in baseline.cruise_speeds=[5.0]."
        )
    limits = (*baseline.cruise_speeds, baseline.cruise_acceleration, baseline.cruise_jerk)
    legs = []
    for start, goal in pairwise(scenario.mission.positions):
        if start == goal:
            raise ScenarioError(
                f"{scenario.name}: a leg of the mission ends where it starts, at {start} m; "
                "reference cruise needs a way to go; leave it out of baseline.references."
            )
        routes = find_routes(airspace, start, goal, most=1)
        if not routes:
            raise ScenarioError(f"{scenario.name}: {no_way(airspace, start, goal)}")
        steps = np.diff(routes[0].places, axis=0)
        lengths = np.linalg.norm(steps, axis=1).tolist()
        legs.append(
            [
                (step, speed_profile(length, *limits))
                for step, length in zip(steps, lengths, strict=True)
                if length > 0
            ]
        )
    return legs
