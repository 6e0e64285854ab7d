"""Geometry of keep-out zones near a leg: intersections, sides of passage, and points round a zone.

A leg is the line between two waypoints. A plane across the leg shows on which side a route passes a
zone. The plane is vertical, or horizontal if the leg is vertical. If the leg enters the zone, the
plane goes through the middle of the part inside. Otherwise, it goes through the point of the leg
nearest to the zone. A zone is enlarged by a clearance, the distance that a route keeps from it.
"""

from collections.abc import Sequence
from enum import StrEnum
from itertools import pairwise, product
from math import cos, inf, pi
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pyomo_quad.arrays import FloatArray
from pyomo_quad.scenario.airspace import Ball, KeepOut

#: Distance of route corners from a zone and its clearance [m]; a narrower gap counts as closed.
MARGIN_M = 0.15
# Corners of the polygon drawn round a disc: they are 3.5 % farther from its centre than its edge.
_CORNERS = 12
# The directions of a cube's corners, edges and faces are at most 54.8 degrees apart.
_DIRECTIONS = np.array([d for d in product((-1.0, 0.0, 1.0), repeat=3) if any(d)])
# Factor on a sphere's radius at which the lines between neighbouring directions clear the sphere.
_SPHERE_MARGIN = 1.0 / cos(54.8 / 2 * pi / 180)
#: Rounding error of a fraction of a line, and of a length [m].
ROUNDING = 1e-9


class Side(StrEnum):
    """Side on which a route passes a keep-out zone, as seen in the direction of flight.

    The sides are left, right, over and under.
    """

    LEFT = "left"
    RIGHT = "right"
    OVER = "over"
    UNDER = "under"


def zones_hit(zones: Sequence[KeepOut], places: FloatArray, clearance: float) -> list[KeepOut]:
    """Return the keep-out zones to which a path of straight lines comes closer than a clearance.

    `places` are the corners of the path in order, shape (n, 3) [m], and `clearance` is the distance
    to keep [m].
    """
    return [
        zone
        for zone in zones
        if any(
            are_blocked(zone, first[None, :], last[None, :], clearance)[0]
            for first, last in pairwise(places)
        )
    ]


def are_blocked(
    zone: KeepOut, starts: FloatArray, ends: FloatArray, clearance: float
) -> NDArray[np.bool_]:
    """Return which of n straight lines intersect a keep-out zone enlarged by a clearance [m].

    `starts` and `ends` are the ends of the lines [m], shape (n, 3). The result has shape (n,).
    """
    entered, left = _spans_inside(zone, starts, ends, clearance)
    return np.asarray(np.minimum(left, 1.0) - np.maximum(entered, 0.0) > ROUNDING)


def _spans_inside(
    zone: KeepOut, starts: FloatArray, ends: FloatArray, clearance: float
) -> tuple[FloatArray, FloatArray]:
    """Return the fractions of n lines at which they enter and leave a zone with its clearance.

    A fraction may be below 0 (before the start) or above 1 (beyond the end). If a line misses the
    zone, its exit is less than its entry.
    """
    entered, left = np.full(len(starts), -inf), np.full(len(starts), inf)
    for ball in zone.balls:
        first, last = _span_inside(ball, starts, ends, clearance)
        entered, left = np.maximum(entered, first), np.minimum(left, last)
    return entered, left


def _span_inside(
    ball: Ball, starts: FloatArray, ends: FloatArray, clearance: float
) -> tuple[FloatArray, FloatArray]:
    """Return the fractions of n lines at which they enter and leave a ball enlarged by a clearance.

    If a line misses the ball, its entry is 1 and its exit is 0.
    """
    away = ball.coordinates(starts) - ball.centre
    along = ball.coordinates(ends - starts)
    radius = ball.radius + clearance - ROUNDING
    a = np.sum(along**2, axis=1)
    b = np.sum(away * along, axis=1)
    c = np.sum(away**2, axis=1) - radius**2
    root = np.sqrt(np.maximum(b**2 - a * c, 0.0))
    moves = a > 0.0
    divisor = np.where(moves, a, 1.0)
    is_cut = np.where(moves, b**2 > a * c, c < 0.0)
    first = np.where(moves, (-b - root) / divisor, -inf)
    last = np.where(moves, (-b + root) / divisor, inf)
    return np.where(is_cut, first, 1.0), np.where(is_cut, last, 0.0)


def sides_passed(
    zone: KeepOut, ends: FloatArray, clearance: float, starts: FloatArray, stops: FloatArray
) -> NDArray[np.intp]:
    """Return the side on which each of n straight lines passes a keep-out zone, shape (n,).

    A side is an index in `Side`, or -1 if the line does not cross the plane described in the
    module. If this plane goes through one of the `ends` of the leg, all are -1.

    Parameters
    ----------
    zone : KeepOut
        The zone.
    ends : ndarray, shape (2, 3)
        Start and goal of the leg [m].
    clearance : float
        Distance by which the zone is enlarged [m]. If the leg does not enter the enlarged zone,
        this function enlarges the zone further, until the leg enters it.
    starts, stops : ndarray, shape (n, 3)
        Ends of the lines [m].
    """
    section = _section(zone, ends, clearance)
    if section is None:
        return np.full(len(starts), -1)
    first, last = ((places - section.middle) @ section.along for places in (starts, stops))
    crosses = (first < 0.0) != (last < 0.0)
    share = np.where(crosses, first / np.where(crosses, first - last, 1.0), 0.0)
    across = starts + share[:, None] * (stops - starts) - section.middle
    aside, above = across @ section.left, across @ section.up
    wide, high = section.half_width, section.half_height
    beyond = np.array([aside - wide, -aside - wide, above - high, -above - high])
    return np.where(crosses, beyond.argmax(axis=0), -1)


class _Section(NamedTuple):
    """Cross-section of a keep-out zone with its clearance, in the plane that the module defines."""

    middle: FloatArray
    """Centre of the cross-section [m], shape (3,). The unit vectors `along` the horizontal course,
    to its `left` and `up` have the same shape."""
    along: FloatArray
    left: FloatArray
    up: FloatArray
    half_width: float
    """Distance from the middle to the left and to the right border [m]."""
    half_height: float
    """Distance from the middle to the upper and to the lower border [m]."""


def _section(zone: KeepOut, ends: FloatArray, clearance: float) -> _Section | None:
    """Return the cross-section of an enlarged keep-out zone in the plane that the module defines.

    `ends` are the ends of the leg, shape (2, 3) [m]. The result is None if the plane goes through
    one of them.
    """
    share, reach = _passage(zone, ends, clearance)
    if not ROUNDING < share < 1.0 - ROUNDING:
        return None
    along, left, up = _frame(ends)
    # Not the centre of the zone, which may lie before the start of the leg or beyond its goal: a
    # route need not cross a plane there.
    middle = ends[0] + share * (ends[1] - ends[0])
    middle, _ = _chord(zone, middle, left, reach)
    # This chord and the next are the longest ones, also in a round section.
    middle, half_height = _chord(zone, middle, up, reach)
    middle, half_width = _chord(zone, middle, left, reach)
    return _Section(middle, along, left, up, half_width, half_height)


def _passage(zone: KeepOut, ends: FloatArray, clearance: float) -> tuple[float, float]:
    """Return the fraction of a leg at which it passes a keep-out zone, and the clearance used [m].

    If the leg stays outside, the clearance is raised until the enlarged zone reaches the leg, and
    by `MARGIN_M` beyond.
    """

    def span(reach: float) -> tuple[float, float]:
        (first,), (last,) = _spans_inside(zone, ends[:1], ends[1:], reach)
        return max(float(first), 0.0), min(float(last), 1.0)

    short, reach = clearance, max(clearance, -float(zone.depth(ends[0]))) + MARGIN_M
    first, last = span(clearance)
    if last > first:
        return (first + last) / 2, clearance
    # Bisection for the clearance with which the enlarged zone touches the leg.
    while reach - short > ROUNDING * reach:
        middle = (short + reach) / 2
        first, last = span(middle)
        short, reach = (short, middle) if last > first else (middle, reach)
    first, last = span(reach)
    return (first + last) / 2, reach + MARGIN_M


def _chord(
    zone: KeepOut, place: FloatArray, direction: FloatArray, reach: float
) -> tuple[FloatArray, float]:
    """Return the midpoint, shape (3,), and half the length [m] of a line's part inside a zone.

    The line goes in the direction of the unit vector `direction`, through the point `place` [m]
    inside the zone. The zone is enlarged by the clearance `reach` [m].
    """
    (first,), (last,) = _spans_inside(zone, place[None], (place + direction)[None], reach)
    return place + (first + last) / 2 * direction, float(last - first) / 2


def _frame(ends: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return three unit vectors for a leg: along its horizontal course, to its left, and up.

    A vertical leg has no horizontal course. Its first vector points up, and the other two are
    horizontal. Each has shape (3,).
    """
    upward = np.array([0.0, 0.0, 1.0])
    # Horizontal, so that a route beside a tall zone passes it on the left or right, even if the leg
    # is steep.
    along = (ends[1] - ends[0]) * (1.0, 1.0, 0.0)
    if np.linalg.norm(along) <= ROUNDING:
        along = upward if ends[1, 2] != ends[0, 2] else np.array([1.0, 0.0, 0.0])
    along = along / np.linalg.norm(along)
    left = np.cross(upward, along) if along[2] == 0.0 else np.array([0.0, 1.0, 0.0])
    return along, left, np.cross(along, left)


def _places_along(zone: KeepOut, reach: float, near: FloatArray) -> FloatArray:
    """Return points on the outline of a polygonal zone enlarged by ``reach`` [m], shape (m, 2) [m].

    They are its corners and, on each edge, the point nearest to each of the places ``near``.
    """
    ring = zone.ring(reach)
    following = np.roll(ring, -1, axis=0)
    along = following - ring
    shares = np.einsum("kni,ki->kn", near[None, :, :2] - ring[:, None], along)
    shares = np.clip(shares / np.sum(along**2, axis=1)[:, None], 0.0, 1.0)
    beside = ring[:, None] + shares[..., None] * along[:, None]
    return np.unique(np.vstack([ring, beside.reshape(-1, 2)]), axis=0)


def places_beside(zone: KeepOut, clearance: float, ends: FloatArray) -> FloatArray:
    """Return points round a keep-out zone, shape (n, 3) [m], as nodes of a graph of routes.

    Straight lines between neighbouring points keep the clearance from the zone. `ends` are start
    and goal of the leg, shape (2, 3) [m]. Straight sides of the zone also get points nearest to
    start and goal, and to the place at which the leg passes the zone.
    """
    reach = clearance + MARGIN_M
    share, _ = _passage(zone, ends, clearance)
    passing = ends[0] + share * (ends[1] - ends[0])
    choices = []
    if zone.corners is not None:
        choices.append(_places_along(zone, reach, np.vstack([ends, passing])))
    for ball in zone.balls:
        radius = ball.radius + reach
        if ball.normal is not None:
            continue
        if len(ball.axes) == 3:
            sizes = np.linalg.norm(_DIRECTIONS, axis=1, keepdims=True)
            choices.append(ball.centre + _SPHERE_MARGIN * radius * _DIRECTIONS / sizes)
        elif len(ball.axes) == 2:
            angles = 2 * pi * np.arange(_CORNERS) / _CORNERS
            circle = np.column_stack([np.cos(angles), np.sin(angles)])
            choices.append(ball.centre + radius / cos(pi / _CORNERS) * circle)
        else:
            # A shortest path may cross an edge anywhere, in particular a straight edge.
            (axis,) = ball.axes
            near = np.append(ends[:, axis], passing[axis])
            sides = ball.centre[0] + radius * np.array([-1.0, 1.0])
            choices.append(np.unique(np.append(sides, np.clip(near, *sides)))[:, None])
    return np.array([np.concatenate(parts) for parts in product(*choices)])
