"""Reference paths: position and yaw as functions of time for the controller to follow.

reference | path | conditions at start and goal
step | constant position: each waypoint in turn, then the goal | none
quintic | polynomial of degree 5 | position, zero velocity and acceleration
minimum_snap | polynomial of degree 7 | position, zero velocity, acceleration and jerk
plan | the optimal plan, as cubic splines through its samples | the states of the plan
cruise | straight legs at a constant speed (module `routes`) | at rest, as at every corner

The plan includes the effect of the forecast wind on the vehicle. A controller that follows it
therefore adapts only to the error of the forecast. The other references ignore the wind.

The quintic minimises the integral of the squared jerk; the polynomial of degree 7 minimises the
integral of the squared snap [1]_. If the mission has waypoints, both are splines through these. Yaw
is a polynomial or spline of the same degree.

.. [1] Mellinger and Kumar, "Minimum snap trajectory generation and control for quadrotors", ICRA
   2011.
"""

from bisect import bisect_right
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import ArrayLike

from pyomo_quad.arrays import FloatArray
from pyomo_quad.scenario import ScenarioError
from pyomo_quad.scenario.mission import Mission

# Coefficients of rising powers of t/T, from 0 at t = 0 to 1 at t = T.
_QUINTIC = Polynomial((0, 0, 0, 10, -15, 6))
_MINIMUM_SNAP = Polynomial((0, 0, 0, 0, 35, -84, 70, -20))
_STEP = Polynomial((1,))


class Setpoint(NamedTuple):
    """Values of a reference path at one time: x, y, z and yaw with two time derivatives.

    If the reference path is a plan, `acceleration` excludes the part that the air is expected to
    cause. `tilting` then has the planned rates and accelerations of roll and pitch. Other reference
    paths ignore the air and the attitude: `tilting` is None.
    """

    place: Sequence[float]
    """Position in world axes, m, and yaw, rad."""
    rate: Sequence[float]
    """Velocity, m/s, and yaw rate, rad/s."""
    acceleration: Sequence[float]
    """Acceleration by the rotors, m/s^2 and rad/s^2: the derivative of the rate, less the
    acceleration that the reference expects from the air."""
    tilting: Sequence[float] | None = None
    """Rates of roll and pitch, rad/s, and their accelerations, rad/s^2, of a vehicle that is on the
    reference; None where the reference does not know the attitude."""


ReferencePath = Callable[[float], Setpoint]

# Rates and accelerations of x, y, z and yaw at rest.
_AT_REST = (0.0, 0.0, 0.0, 0.0)


class StraightPath:
    """Reference path on the straight line from start to goal, with a polynomial progress.

    Parameters
    ----------
    mission : Mission
        The mission, which gives start, goal and duration.
    progress : Polynomial
        Travelled fraction of the line, as a function of t / duration.
    """

    def __init__(self, mission: Mission, progress: Polynomial) -> None:
        self._start = (*mission.start.position, mission.start.yaw)
        goal = (*mission.goal.position, mission.goal.yaw)
        self._way = tuple(there - here for here, there in zip(self._start, goal, strict=True))
        self._duration = mission.fixed_duration
        self._progress, self._rate, self._acceleration = (
            tuple(progress.deriv(order).coef[::-1].tolist()) for order in range(3)
        )

    def __call__(self, t: float) -> Setpoint:
        """Return the setpoint at time t [s], constant before the start and after the end."""
        duration = self._duration
        elapsed = min(max(t / duration, 0.0), 1.0)
        done = _horner(self._progress, elapsed)
        rate = _horner(self._rate, elapsed) / duration
        acceleration = _horner(self._acceleration, elapsed) / duration**2
        return Setpoint(
            [here + done * way for here, way in zip(self._start, self._way, strict=True)],
            [rate * way for way in self._way],
            [acceleration * way for way in self._way],
        )


def quintic_progress(elapsed: FloatArray) -> FloatArray:
    """Return the travelled fraction of the way, for a motion from rest to rest.

    The fraction is a polynomial of degree 5 in time. `elapsed` holds elapsed fractions of the
    duration, from 0 to 1; the result has the same shape.
    """
    return np.asarray(_QUINTIC(elapsed))


def _horner(falling_coefficients: Sequence[float], x: float) -> float:
    value = 0.0
    for coefficient in falling_coefficients:
        value = value * x + coefficient
    return value


class WaypointPath:
    """Reference path along a spline through the waypoints at their times.

    The reference is at rest at the start, at the goal, and during hovers at waypoints.

    Parameters
    ----------
    mission : Mission
        Mission with a time for each waypoint and a fixed duration.
    derivatives : int
        Number n of derivatives (velocity, acceleration, ...) that are zero at rest. The spline of
        degree 2 n + 1 minimises the integral of the squared derivative of order n + 1.
    """

    def __init__(self, mission: Mission, derivatives: int) -> None:
        from scipy.interpolate import make_interp_spline  # noqa: PLC0415  not for every reference

        places, times = stops_of(mission)
        ends = [0, *(k + 1 for k, w in enumerate(mission.waypoints) if w.hold > 0), len(places) - 1]
        at_rest = [(order, np.zeros(len(_AT_REST))) for order in range(1, derivatives + 1)]
        self._splines = []
        for first, last in pairwise(ends):
            left = times[first] + (mission.waypoints[first - 1].hold if first > 0 else 0.0)
            knots = [left, *times[first + 1 : last + 1]]
            held = places[first : last + 1]
            spline = make_interp_spline(
                knots, held, k=2 * derivatives + 1, bc_type=(at_rest, at_rest)
            )
            self._splines.append((left, times[last], [spline.derivative(n) for n in range(3)]))

    def __call__(self, t: float) -> Setpoint:
        """Return the setpoint at time t [s], constant outside the flight and during hovers."""
        began = [spline for spline in self._splines if spline[0] <= t] or self._splines[:1]
        left, reached, derivatives = began[-1]
        held = min(max(t, left), reached)
        return Setpoint(*(derivative(held).tolist() for derivative in derivatives))


class _Steps:
    """Reference path that jumps from place to place: through the waypoints to the goal.

    It begins at the first waypoint. It leaves a waypoint at its passing time plus the duration of
    its hover.
    """

    def __init__(self, mission: Mission) -> None:
        self._places, self._times = stops_of(mission)
        holds = [waypoint.hold for waypoint in mission.waypoints]
        self._left = [at + hold for at, hold in zip(self._times[1:-1], holds, strict=True)]

    def __call__(self, t: float) -> Setpoint:
        place = self._places[1 + bisect_right(self._left, t)]
        return Setpoint(place, _AT_REST, _AT_REST)


def stops_of(mission: Mission) -> tuple[list[list[float]], list[float]]:
    """Return the places of a mission in order, and the times [s] at which to reach them.

    A place is x, y, z [m] and yaw [rad]. A yaw that is not prescribed is interpolated in time.
    Raises a ScenarioError if one of the times is free.
    """
    times = [0.0]
    for k, waypoint in enumerate(mission.waypoints):
        if waypoint.at is None:
            raise ScenarioError(
                f"mission.waypoints[{k}].at is missing; without a plan it must be a number in s; "
                "give one."
            )
        times.append(waypoint.at)
    times.append(mission.fixed_duration)
    yaws = {0.0: mission.start.yaw, times[-1]: mission.goal.yaw}
    yaws |= {w.at: w.yaw for w in mission.waypoints if w.at is not None and w.yaw is not None}
    known = sorted(yaws)
    headings = np.interp(times, known, [yaws[at] for at in known]).tolist()
    places = [[*place, yaw] for place, yaw in zip(mission.positions, headings, strict=True)]
    return places, times


def step(mission: Mission) -> ReferencePath:
    """Return the reference path that jumps to each waypoint of a mission in turn and to the goal.

    The path jumps when the vehicle is to leave a waypoint. If the mission has no waypoints, the
    path stays at the goal from the start.
    """
    return _Steps(mission) if mission.waypoints else StraightPath(mission, _STEP)


def quintic(mission: Mission) -> ReferencePath:
    """Return the reference path from rest to rest with the least integral of the squared jerk.

    It is a polynomial of degree 5 in time, or a spline of this degree through waypoints.
    """
    return WaypointPath(mission, 2) if mission.waypoints else StraightPath(mission, _QUINTIC)


def minimum_snap(mission: Mission) -> ReferencePath:
    """Return the reference path of a mission that minimises the integral of the squared snap.

    The path leads from rest at the start through the waypoints to rest at the goal. It consists of
    polynomials of degree 7 in time.
    """
    return WaypointPath(mission, 3) if mission.waypoints else StraightPath(mission, _MINIMUM_SNAP)


class SampledPath:
    """Reference path through samples, interpolated by polynomials of degree 5.

    Position, velocity and acceleration are continuous, and equal the samples at their times.

    Parameters
    ----------
    times : array_like, shape (n,)
        Increasing times, s.
    values, rates, accelerations : array_like, shape (n, 4)
        Samples of x, y, z [m] and yaw [rad] in columns, and their first and second time
        derivatives.
    """

    def __init__(
        self, times: ArrayLike, values: ArrayLike, rates: ArrayLike, accelerations: ArrayLike
    ) -> None:
        from scipy.interpolate import BPoly, PPoly  # noqa: PLC0415  as above

        knots = np.asarray(times, dtype=float)
        samples = np.stack([np.asarray(rows, float) for rows in (values, rates, accelerations)], 1)
        place = PPoly.from_bernstein_basis(BPoly.from_derivatives(knots, samples))
        self._row = _Pieces(knots, [place.c, place.derivative().c, place.derivative(2).c])

    def __call__(self, t: float) -> Setpoint:
        """Return the setpoint at time t [s].

        Outside the samples, the setpoint has the position and acceleration of the nearest sample,
        and zero velocity. This suits samples that begin and end at rest.
        """
        row, is_inside = self._row(t)
        # A controller that looks ahead needs setpoints for times after the last sample.
        return Setpoint(row[:4], row[4:8] if is_inside else _AT_REST, row[8:])


class PlannedPath:
    """Plan as a reference path: a separate cubic spline through the samples of each quantity.

    Parameters
    ----------
    times : ndarray, shape (n,)
        Increasing times [s].
    values, rates, accelerations : ndarray, shape (n, 4)
        Samples of x, y, z [m] and yaw [rad] in columns, and their first and second time
        derivatives. `accelerations` exclude the part that the plan expects the air to cause, as in
        `Setpoint`.
    tilt_rates : ndarray, shape (n, 2)
        Rates of roll and pitch [rad/s].
    """

    def __init__(
        self,
        times: FloatArray,
        values: FloatArray,
        rates: FloatArray,
        accelerations: FloatArray,
        tilt_rates: FloatArray,
    ) -> None:
        from scipy.interpolate import CubicSpline  # noqa: PLC0415  as above

        # Differentiation of the position spline would amplify errors. A plan satisfies its
        # equations at the collocation points only. With samples h seconds apart, a position error
        # of d metres between them becomes an acceleration error of about 6 d/h^2.
        held = np.hstack([values, rates, accelerations, tilt_rates])
        tilt_accelerations = CubicSpline(times, tilt_rates).derivative()
        self._row = _Pieces(times, [CubicSpline(times, held).c, tilt_accelerations.c])

    def __call__(self, t: float) -> Setpoint:
        """Return the setpoint at time t [s].

        Before the first and after the last sample, the setpoint is a hover at this sample. All
        rates are zero, and so are the accelerations of roll and pitch. The setpoint has the
        sample's acceleration, which balances that caused by the air.
        """
        row, is_inside = self._row(t)
        moving = (row[4:8], row[12:]) if is_inside else (_AT_REST, _AT_REST)
        return Setpoint(row[:4], moving[0], row[8:12], moving[1])


class _Pieces:
    """Piecewise polynomials of several quantities over time, with common break times (knots).

    The quantities are position and yaw of a reference path, and their derivatives.
    """

    def __init__(self, knots: FloatArray, coefficients: Sequence[FloatArray]) -> None:
        self._knots: list[float] = knots.tolist()
        size = max(map(len, coefficients))
        rows = [np.pad(c, ((size - len(c), 0), (0, 0), (0, 0))) for c in coefficients]
        self._exponents = np.arange(size - 1, -1.0, -1.0)
        self._pieces = list(np.concatenate(rows, axis=2).swapaxes(0, 1))

    def __call__(self, t: float) -> tuple[list[float], bool]:
        """Return all quantities at time t [s], and whether t lies between the first and last knot.

        Outside the knots, the quantities have their values at the nearest knot.
        """
        held = min(max(t, self._knots[0]), self._knots[-1])
        k = min(bisect_right(self._knots, held), len(self._pieces)) - 1
        # One matrix product for all quantities takes hardly longer than for a single one.
        row = (held - self._knots[k]) ** self._exponents @ self._pieces[k]
        return row.tolist(), held == t
