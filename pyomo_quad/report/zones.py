"""Shapes of keep-out zones for figures: outlines seen along an axis, and faces in space."""

from collections.abc import Iterator
from itertools import pairwise

import numpy as np
from matplotlib.patches import Circle, Patch, Polygon, Rectangle

from pyomo_quad.arrays import FloatArray
from pyomo_quad.scenario.airspace import KeepOut, Shape

ZONE_COLOR = "#a33a2a"  # as in the HTML report's player
_ROUND = 36  # corners of the polygon that is drawn for a circle


def outline(zone: KeepOut, directions: tuple[int, int], clearance: float = 0.0) -> Patch:
    """Return the outline of a keep-out zone as a matplotlib patch, seen along one axis.

    `directions` are the horizontal and the vertical axis of the panel: 0 for x, 1 for y, 2 for z.
    The outline is grown by `clearance` [m] on all sides.
    """
    if zone.corners is not None and set(directions) == {0, 1}:
        ring = zone.ring(clearance)
        return Polygon([(corner[directions[0]], corner[directions[1]]) for corner in ring])
    for ball in zone.balls:
        if set(directions) <= set(ball.axes):
            middle = [ball.centre[ball.axes.index(axis)] for axis in directions]
            return Circle((middle[0], middle[1]), ball.radius + clearance)
    low, high = box_around(zone)
    (left, below), (right, above) = low[list(directions)], high[list(directions)]
    return Rectangle(
        (left - clearance, below - clearance),
        right - left + 2 * clearance,
        above - below + 2 * clearance,
    )


def box_around(zone: KeepOut) -> FloatArray:
    """Return the two extreme corners of the smallest axis-parallel box around a zone.

    The result has shape (2, 3): least and greatest x, y and z [m].
    """
    sides = {
        axis: (centre - ball.radius, centre + ball.radius)
        for ball in zone.balls
        if ball.normal is None
        for axis, centre in zip(ball.axes, ball.centre, strict=True)
    }
    for axis, along in enumerate(zip(*(zone.corners or ()), strict=True)):
        sides[axis] = min(along), max(along)
    return np.array([sides[axis] for axis in range(3)]).T


def faces(zone: KeepOut, limits: FloatArray) -> FloatArray:
    """Return the surface of a keep-out zone as polygons, cut off at the limits of a figure.

    `limits` has shape (3, 2). The result holds corners [m], shape (n_faces, n_corners, 3); a
    polygon with fewer corners repeats its last corner.
    """
    cut = [face for face in (_clipped(face, limits) for face in _whole_faces(zone)) if len(face)]
    most = max(map(len, cut), default=0)
    # Matplotlib itself would pad short polygons with uninitialised memory, and then choose wrong
    # axis limits.
    padded = [np.vstack([face, np.repeat(face[-1:], most - len(face), axis=0)]) for face in cut]
    return np.reshape(padded, (len(cut), most, 3))


def _whole_faces(zone: KeepOut) -> Iterator[FloatArray]:
    """Yield the faces of a keep-out zone, not yet cut off at the limits of a figure.

    Each face holds the corners of a polygon [m], shape (n_corners, 3).
    """
    low, high = box_around(zone)
    middle, half = (low + high) / 2, (high - low) / 2
    if zone.shape is Shape.BOX:
        ring = np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)])
    elif zone.corners is not None:
        ring = (zone.ring() - middle[:2]) / half[:2]
    else:
        angles = np.linspace(0.0, 2 * np.pi, _ROUND, endpoint=False)
        ring = np.column_stack([np.cos(angles), np.sin(angles)])
    levels = np.array([(1.0, -1.0), (1.0, 1.0)])  # width of the ring, height
    if zone.shape is Shape.SPHERE:
        slopes = np.linspace(-np.pi / 2, np.pi / 2, _ROUND // 2 + 1)
        levels = np.column_stack([np.cos(slopes), np.sin(slopes)])
    rings = [
        middle + half * np.column_stack([width * ring, np.full(len(ring), height)])
        for width, height in levels
    ]
    if zone.shape is not Shape.SPHERE:
        # Bottom and top of the zone; those of a sphere are single points.
        yield rings[0]
        yield rings[-1]
    # Faces with four corners join neighbouring horizontal cross-sections of the zone.
    for below, above in pairwise(rings):
        for k in range(len(ring)):
            yield np.array([below[k - 1], below[k], above[k], above[k - 1]])


def _clipped(face: FloatArray, limits: FloatArray) -> FloatArray:
    """Clip a convex polygon to an axis-parallel box (algorithm of Sutherland and Hodgman).

    `face` and the result hold corners [m], shape (n, 3). `limits` has shape (3, 2). The result may
    be empty.
    """
    for axis, ends in enumerate(limits):
        for side, end in zip((1.0, -1.0), ends, strict=True):
            inside = side * (face[:, axis] - end)
            corners = []
            for k in range(len(face)):
                if inside[k - 1] * inside[k] < 0.0:
                    share = inside[k - 1] / (inside[k - 1] - inside[k])
                    corners.append(face[k - 1] + share * (face[k] - face[k - 1]))
                if inside[k] >= 0.0:
                    corners.append(face[k])
            face = np.reshape(corners, (-1, 3))
    return face
