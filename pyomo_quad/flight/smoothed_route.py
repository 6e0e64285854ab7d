"""Smooth path along a route at prescribed speeds, without an optimisation.

A point moves along the straight lines of the route with bounded acceleration, and slowly past
corners. The smooth path is a moving average of this motion, with continuous velocity, acceleration
and jerk. The average cuts corners. The corners of the lines are therefore moved outwards, until the
path passes through the original corners. See docs/theory/geometric_plan.md, eqs. (1) to (4).

A `Stop` is the start, a corner or the goal, with the hover and the greatest speed there. A `Pace`
has the greatest speed and accelerations of the whole motion. Arguments `corners` are the positions
of the n stops after they were moved outwards, shape (n, 3) [m].
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import inf
from typing import TYPE_CHECKING

import numpy as np
from scipy.optimize import brentq

from pyomo_quad.flight.routes import Route

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pyomo_quad.arrays import FloatArray

# Durations of the three moving averages that follow one another [s]: the first, in which the
# velocity turns at a corner, and two short ones that bound the jerk. Their sum.
_AVERAGED_S = (1.2, 0.5, 0.5)
_SPAN_S = sum(_AVERAGED_S)
# Time between samples of the path [s].
_STEP_S = 0.02
# Time at rest before each hover and at the goal, in which deviations of a simulated flight vanish
# [s].
_SETTLING_S = 0.4
# Number of times that corners are moved outwards; the path then passes within millimetres of the
# places.
_MOVES = 3
# Least speed of a flight of given duration [m/s]; distance below which two places are equal [m];
# and duration below which a part of the motion is left out [s].
_SLOWEST, _SAME_M, _INSTANT_S = 0.05, 1e-6, 1e-9


@dataclass(frozen=True, kw_only=True)
class Stop:
    """Corner, start or goal of a route, with the hover and speed that the mission requires there.

    Attributes
    ----------
    place : ndarray, shape (3,)
        Position of the corner [m].
    hold : float or None
        Duration for which the vehicle hovers at the corner [s]; None if it passes without a stop.
    speed_max : float
        Greatest speed with which the vehicle may pass the corner [m/s].
    """

    place: FloatArray
    hold: float | None = None
    speed_max: float = inf


@dataclass(frozen=True, kw_only=True)
class Pace:
    """Greatest speed and accelerations of a motion along the straight lines of a route.

    Attributes
    ----------
    speed : float
        Greatest speed [m/s].
    acceleration : float
        Greatest acceleration along the lines between the corners [m/s^2].
    turning : float
        Greatest acceleration of the smooth path at the corners [m/s^2]. It limits the speed there.
    """

    speed: float
    acceleration: float
    turning: float


@dataclass(frozen=True, kw_only=True)
class SmoothPath:
    """Smooth path of a vehicle along a route, sampled at equally spaced times.

    Attributes
    ----------
    times : ndarray, shape (n,)
        Times of the samples [s]; the first is 0, the last is the duration.
    places, velocities, accelerations : ndarray, shape (n, 3)
        Position [m], velocity [m/s] and acceleration [m/s^2] at these times.
    passings : tuple of (float, float)
        For each corner of the route, the times at which it is reached and left [s].
    """

    times: FloatArray
    places: FloatArray
    velocities: FloatArray
    accelerations: FloatArray
    passings: tuple[tuple[float, float], ...]

    @property
    def duration(self) -> float:
        """Duration of the path [s]."""
        return float(self.times[-1])

    def at(self, times: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return position, velocity and acceleration at n times [s], each of shape (n, 3)."""
        found = (self.places, self.velocities, self.accelerations)
        place, velocity, acceleration = (
            np.column_stack([np.interp(times, self.times, column) for column in rows.T])
            for rows in found
        )
        return place, velocity, acceleration


@dataclass(frozen=True, kw_only=True)
class _Motion:
    """Motion along the straight lines of a route, in phases of constant acceleration.

    `times` [s], `distances` [m] and `speeds` [m/s] are given at the borders of the phases. For
    `passings`, see `SmoothPath`.
    """

    times: FloatArray
    distances: FloatArray
    speeds: FloatArray
    passings: tuple[tuple[float, float], ...]


def smoothed(
    stops: Sequence[Stop],
    pace: Pace,
    lasting: float | None = None,
) -> SmoothPath | None:
    """Return a smooth path through the corners of a route, from rest to rest.

    A duration `lasting` [s], if it is given, determines the speed; `pace` has the greatest speed.
    None if the path cannot be flown in this duration.
    """
    corners = np.array([stop.place for stop in stops])
    wanted = corners.copy()
    for _ in range(_MOVES):
        chosen = pace if lasting is None else _pace_for(stops, corners, pace, lasting)
        if chosen is None:
            return None
        motion = _motion(stops, corners, chosen)
        path = _averaged(motion, corners, lasting)
        at_corners = path.at(np.array([reached for reached, _ in path.passings]))[0]
        corners = corners + wanted - at_corners
    return path


def _pace_for(
    stops: Sequence[Stop], corners: FloatArray, fastest: Pace, lasting: float
) -> Pace | None:
    """Return the pace at which a motion along a route lasts a given duration `lasting` [s].

    It is `fastest` with a lower speed, at least 0.05 m/s; None if even `fastest` takes longer. If
    0.05 m/s is too fast, the motion ends early.
    """

    def excess(speed: float) -> float:
        found = _motion(stops, corners, replace(fastest, speed=speed))
        return float(found.times[-1]) - lasting

    if excess(fastest.speed) > 0.0:
        return None
    if excess(_SLOWEST) < 0.0:
        return replace(fastest, speed=_SLOWEST)
    speed = brentq(excess, _SLOWEST, fastest.speed, xtol=1e-9)
    return replace(fastest, speed=float(speed))


def _corner_speeds(stops: Sequence[Stop], steps: FloatArray, pace: Pace) -> FloatArray:
    """Return the speed of a motion along straight lines at each of n corners [m/s], shape (n,).

    `steps` are the displacements between corners, shape (n - 1, 3) [m]. Implements
    docs/theory/geometric_plan.md, eqs. (1) and (2).
    """
    lengths = np.linalg.norm(steps, axis=1)
    courses = steps / np.maximum(lengths, _SAME_M)[:, None]
    turned = np.linalg.norm(np.diff(courses, axis=0), axis=1)
    inner = np.minimum(pace.speed, pace.turning * _AVERAGED_S[0] / np.maximum(turned, _SAME_M))
    is_short = np.minimum(lengths[:-1], lengths[1:]) <= _SAME_M
    speeds = np.concatenate([[0.0], np.where(is_short, 0.0, inner), [0.0]])
    speeds = np.minimum(speeds, [0.0 if s.hold is not None else s.speed_max for s in stops])
    for order in (1, -1):
        walk = range(len(lengths)) if order > 0 else range(len(lengths) - 1, -1, -1)
        for k in walk:
            before, after = (k, k + 1) if order > 0 else (k + 1, k)
            reachable = np.sqrt(speeds[before] ** 2 + 2.0 * pace.acceleration * lengths[k])
            speeds[after] = min(speeds[after], reachable)
    return np.asarray(speeds)


def _motion(stops: Sequence[Stop], corners: FloatArray, pace: Pace) -> _Motion:
    """Return the motion along straight lines from corner to corner, with bounded acceleration.

    `stops` gives the hovers and greatest speeds at the corners, and `pace` the greatest speed and
    acceleration between them.
    """
    steps = np.diff(corners, axis=0)
    lengths = np.linalg.norm(steps, axis=1).tolist()
    at_corners = _corner_speeds(stops, steps, pace).tolist()
    acceleration = pace.acceleration
    rows = [(0.0, 0.0, 0.0)]
    passings = []

    def add(lasting: float, speed_after: float) -> None:
        t, s, v = rows[-1]
        if lasting > _INSTANT_S:
            rows.append((t + lasting, s + 0.5 * lasting * (v + speed_after), speed_after))

    add(0.5 * _SPAN_S, 0.0)
    # The motion rests for half of the span of the moving averages longer at the start and at the
    # goal, and for the whole span longer at a hover. The path then rests when it must.
    passings.append((0.0, 0.5 * _SPAN_S))
    for k, stop in enumerate(stops[1:]):
        first, last, length = at_corners[k], at_corners[k + 1], lengths[k]
        peak = min(pace.speed, np.sqrt(acceleration * length + 0.5 * (first**2 + last**2)))
        changing = (2.0 * peak**2 - first**2 - last**2) / (2.0 * acceleration)
        add((peak - first) / acceleration, peak)
        add(max(length - changing, 0.0) / peak if peak > 0.0 else 0.0, peak)
        add((peak - last) / acceleration, last)
        reached = rows[-1][0]
        if k == len(stops) - 2:
            add(0.5 * _SPAN_S + _SETTLING_S, 0.0)
            passings.append((rows[-1][0], rows[-1][0]))
        elif last == 0.0:
            hold = stop.hold or 0.0
            add(_SPAN_S + _SETTLING_S + hold, 0.0)
            rested = reached + 0.5 * _SPAN_S + _SETTLING_S
            passings.append((rested, rested + hold))
        else:
            passings.append((reached, reached))
    times, distances, speeds = np.array(rows).T
    return _Motion(times=times, distances=distances, speeds=speeds, passings=tuple(passings))


def _averaged(motion: _Motion, corners: FloatArray, lasting: float | None) -> SmoothPath:
    """Return the smooth path: the moving average over time of a motion along straight lines.

    `lasting` is the duration of the path [s], by default that of the motion. A longer path ends
    with rest at the last corner. Implements docs/theory/geometric_plan.md, eq. (3).
    """
    from scipy.interpolate import CubicHermiteSpline  # noqa: PLC0415  most searches end before

    end = float(motion.times[-1]) if lasting is None else lasting
    count = int(np.ceil(end / _STEP_S)) + 1
    times = np.linspace(0.0, end, count)
    travelled = CubicHermiteSpline(motion.times, motion.distances, motion.speeds)
    total = float(motion.distances[-1])
    # After the end of the motion, the path rests at the last corner.
    shares = travelled(np.minimum(times, motion.times[-1])) / max(total, _SAME_M)
    places = Route(places=corners, sides=()).places_at(np.clip(shares, 0.0, 1.0))
    step = float(times[1])
    for span in _AVERAGED_S:
        half = max(1, round(0.5 * span / step))
        weights = np.full(2 * half + 1, 1.0 / (2 * half))
        weights[[0, -1]] *= 0.5
        padded = np.pad(places, ((half, half), (0, 0)), mode="edge")
        places = np.column_stack([np.convolve(row, weights, mode="valid") for row in padded.T])
    velocities = np.gradient(places, step, axis=0)
    return SmoothPath(
        times=times,
        places=places,
        velocities=velocities,
        accelerations=np.gradient(velocities, step, axis=0),
        passings=motion.passings,
    )
