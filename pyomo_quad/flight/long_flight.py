"""Initial guess and meshes for a long, straight flight that accelerates, cruises and brakes.

Elements are short at both ends, where the vehicle changes its attitude within a second, and grow
towards the middle.

The cruise speed of the guess follows from the duration. If the duration is free, it is the speed of
least cost per metre, or a higher speed if the greatest allowed duration requires it.
"""

from __future__ import annotations

from math import cos, inf, sin, sqrt
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.optimize import minimize_scalar

from pyomo_quad.collocation import Mesh, SolveError
from pyomo_quad.flight.flight import POSITION_STATES, VELOCITY_STATES
from pyomo_quad.flight.routes import speed_profile
from pyomo_quad.flight.steady import PITCH, ROLL

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike

    from pyomo_quad.arrays import FloatArray
    from pyomo_quad.flight.steady import SteadyFlight, Trim
    from pyomo_quad.scenario import Scenario
    from pyomo_quad.scenario.airspace import Airspace

# Length of equal elements [s] above which they do not resolve a change of attitude.
_LONGEST_S = 3.0
# Coarse and fine mesh: length of the first and last element [s], ratio of neighbouring elements
# towards the middle, and degree of the coarse elements.
_ROUGH, _FINE = (0.1, 1.25, 4), (0.04, 1.15)
# Elements longer than `_BENDING_S` [s] have a degree that is higher by `_MORE`, because changes of
# attitude within them affect position and velocity.
_BENDING_S, _MORE = 1.0, 2
# Acceleration and jerk of an initial guess, m/s^2 and m/s^3, and the range of its speeds, m/s.
_ACCELERATION, _JERK = 2.0, 4.0
_SPEEDS = 1.0, 30.0
# Tolerance of the cheapest speed [m/s], enough for a guess, and number of samples of the guess.
_SPEED_TOLERANCE = 0.1
_SAMPLES = 400


def is_long(scenario: Scenario) -> bool:
    """Return whether a straight flight to the goal is long compared with a change of attitude.

    It is long if each of `solver.elements` equal elements would last more than 3 s. In a mission
    with waypoints or keep-out zones, the result is always False.
    """
    airspace = scenario.airspace
    is_straight = not (scenario.mission.waypoints or airspace.keep_out)
    return is_straight and scenario.nominal_duration > _LONGEST_S * scenario.solver.elements


def rough_mesh(duration: float) -> Mesh:
    """Return a coarse mesh for the first solve of a long flight of given duration [s]."""
    return _graded(duration, *_ROUGH)


def fine_mesh(duration: float, degree: int) -> Mesh:
    """Return a mesh with fine elements at both ends, for a long flight of given duration [s].

    `degree` is the polynomial degree of short elements; long elements have a higher degree.
    """
    return _graded(duration, *_FINE, degree)


def _graded(duration: float, shortest: float, growth: float, degree: int) -> Mesh:
    """Return a mesh whose elements grow by a constant factor from both ends towards the middle.

    `shortest` [s] is the length of the first and last element, `growth` the factor. The degree of
    elements is `degree`, and higher by 2 for those longer than 1 s.
    """
    widths = [shortest]
    while 2 * sum(widths) < duration:
        widths.append(growth * widths[-1])
    half = np.cumsum(widths[:-1]) / duration
    breakpoints = (0.0, *half.tolist(), *(1.0 - half[::-1]).tolist(), 1.0)
    degrees = degree + _MORE * (duration * np.diff(breakpoints) > _BENDING_S)
    return Mesh(breakpoints=breakpoints, degrees=tuple(degrees.tolist()))


def guess_of(scenario: Scenario, steady: SteadyFlight) -> dict[str, Any] | None:
    """Return an initial guess for the solve of a long flight that accelerates, cruises and brakes.

    It has samples of states and of "time" [s]. If the duration is free, "time" has fractions, and
    "duration" [s] is added. None if start and goal coincide, or the vehicle cannot hover or cruise.
    """
    from scipy.interpolate import CubicHermiteSpline  # noqa: PLC0415  few flights are long

    mission = scenario.mission
    way = np.subtract(mission.goal.position, mission.start.position)
    distance = float(np.linalg.norm(way))
    if distance == 0.0:
        return None
    course = way / distance
    speed = _speed_for(distance, mission.longest.value)
    if mission.is_free:
        best = best_speed(steady, course, mission.price_of_time)
        speed = max(speed, min(best, scenario.limits.speed_max or inf))
    try:
        resting, cruising = (steady.held_in(steady.trim(v * course)) for v in (0.0, speed))
    except SolveError:
        return None
    profile = speed_profile(distance, speed, _ACCELERATION, _JERK)
    kept = np.diff(profile.times, append=inf) > 0.0
    times, *rows = (row[kept] for row in profile)
    when = np.linspace(0.0, times[-1], _SAMPLES)
    done = CubicHermiteSpline(times, *rows[:2])(when)
    speeds, accelerations = (np.interp(when, times, row) for row in rows[1:])
    share = speeds / speed
    guess = {name: resting[name] + share * (cruising[name] - resting[name]) for name in resting}
    guess |= _columns(POSITION_STATES, done, course, mission.start.position)
    guess |= _columns(VELOCITY_STATES, speeds, course)
    guess |= _over_the_ground(scenario.airspace, guess, when)
    heading = mission.start.yaw
    ahead, aside = (
        (course[0] * c + course[1] * s) * accelerations / scenario.gravity
        for c, s in ((cos(heading), sin(heading)), (-sin(heading), cos(heading)))
    )
    guess[PITCH] = guess[PITCH] + ahead
    guess[ROLL] = guess[ROLL] - aside
    # The guess for a free duration is a function of the fraction of the horizon.
    if not mission.is_free:
        return guess | {"time": when}
    return guess | {"time": when / times[-1], "duration": times[-1]}


def _over_the_ground(
    airspace: Airspace, guess: dict[str, Any], when: FloatArray
) -> dict[str, FloatArray]:
    """Return height and climb rate of an initial guess, raised above the terrain.

    `when` has the times of the samples [s]. The result is empty unless the airspace has both a
    terrain and a floor (least height above the ground).
    """
    places = np.column_stack([guess[name] for name in POSITION_STATES])
    if airspace.ground is None or airspace.floor is None:
        return {}
    lacking = np.maximum(0.0, airspace.floor - airspace.height_above_ground(places))
    raised = np.gradient(lacking, when)
    height, climb = POSITION_STATES[2], VELOCITY_STATES[2]
    return {height: guess[height] + lacking, climb: guess[climb] + raised}


def _columns(
    names: Sequence[str], along: FloatArray, course: FloatArray, start: ArrayLike = (0.0, 0.0, 0.0)
) -> dict[str, FloatArray]:
    return dict(zip(names, (np.asarray(start) + along[:, None] * course).T, strict=True))


def _speed_for(distance: float, duration: float) -> float:
    """Return the cruise speed [m/s] of a flight over a distance [m] in a duration [s].

    The flight starts and ends at rest. It has the acceleration `_ACCELERATION` and the jerk
    `_JERK`.
    """
    # Acceleration and braking take speed / acceleration longer than cruise, plus the time of the
    # jerk phases. If the duration T is too short for the distance, the result is a rough guess,
    # a (T - 0.5) / 2, which is negative for T < 0.5 s.
    left = duration - _ACCELERATION / _JERK
    room = left**2 - 4 * distance / _ACCELERATION
    return _ACCELERATION / 2 * (left - sqrt(max(room, 0.0)))


def best_speed(steady: SteadyFlight, course: FloatArray, price_of_time: float) -> float:
    """Return the approximate ground speed of least cost per metre along a direction [m/s].

    The cost is the energy plus `price_of_time` [W] times the duration. The speed is searched
    between 1 and 30 m/s. `course` is the unit vector of the direction.
    """
    near: Trim | None = None

    def cost(speed: float) -> float:
        nonlocal near
        try:
            near = steady.trim(course * speed, near)
        except SolveError:
            return inf
        return (near.power_W + price_of_time) / speed

    found = minimize_scalar(
        cost, bounds=_SPEEDS, method="bounded", options={"xatol": _SPEED_TOLERANCE}
    )
    return float(found.x)
