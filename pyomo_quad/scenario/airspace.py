"""Table `airspace` of a scenario: height limits, fence, keep-out zones and terrain.

Each keep-out zone is the intersection of balls. A ball is the set of places whose distance from a
centre is at most a radius (see `Ball`). The distance is measured in x, y and z for a sphere, and in
x and y for a vertical cylinder. For a slab, the space between two parallel planes, it is measured
in the coordinate normal to the planes.

zone | balls
sphere | one sphere
cylinder | a cylinder, and a slab in z
box | a slab in x, in y and in z
prism over a convex polygon | for each edge a slab along its normal, and a slab in z
"""

from collections.abc import Iterator, Sequence
from enum import StrEnum
from functools import lru_cache
from itertools import pairwise
from math import hypot
from typing import TYPE_CHECKING, Any, NamedTuple, Self

from pydantic import model_validator

from pyomo_quad.scenario.fields import Number, Part, Sound, Text, Triple, late_quantity, quantity
from pyomo_quad.scenario.packed_arrays import unpacked

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from pyomo_quad.arrays import FloatArray
    from pyomo_quad.scenario.surfaces import Surface


_FAR = Sound(-1e5, 1e5, "coordinates lie within 100 km of the origin")
_WIDE = Sound(1e-2, 1e5, "sizes of obstacles")
_ZONE_PATTERN = r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,63}$"
_MOST_ZONES = 64


class Shape(StrEnum):
    """Shape of a keep-out zone: cylinder, sphere, box, or prism over a convex polygon."""

    CYLINDER = "cylinder"
    SPHERE = "sphere"
    BOX = "box"
    POLYGON = "polygon"


class Ball(NamedTuple):
    """Sphere, infinite vertical cylinder, or slab: every keep-out zone is an intersection of these.

    A ball is the set of places whose distance from a centre is at most a radius.

    Attributes
    ----------
    axes : tuple of int
        Coordinates that count: 0 for x, 1 for y, 2 for z.
    centre : tuple of float
        Centre [m].
    radius : float
        Radius, or half the thickness of a slab [m].
    normal : tuple of float or None
        Horizontal unit vector normal to a polygon's edge; None for all other balls.
    """

    # Empty for a slab along the normal of a polygon's edge.
    axes: tuple[int, ...]
    # For a slab along a normal, the coordinate along this normal.
    centre: tuple[float, ...]
    radius: float
    normal: tuple[float, float] | None = None

    def coordinates(self, places: "ArrayLike") -> "FloatArray":
        """Return the coordinates of places in which the distance to the centre is measured [m].

        `places` hold x, y, z [m], shape (..., 3). The result has shape (..., n): n is 3 for a
        sphere, 2 for a cylinder, 1 for a slab.
        """
        import numpy as np  # noqa: PLC0415  reading a scenario does without it

        held = np.asarray(places, dtype=float)
        if self.normal is None:
            return held[..., self.axes]
        return np.asarray(held[..., :2] @ np.array(self.normal))[..., None]

    def depth(self, places: "ArrayLike") -> "FloatArray":
        """Return the depth of places inside the ball [m], negative outside.

        Depth = radius - distance from the centre, in the coordinates of `Ball.coordinates`.
        `places` have shape (..., 3).
        """
        import numpy as np  # noqa: PLC0415  see `coordinates`

        away = np.linalg.norm(self.coordinates(places) - self.centre, axis=-1)
        return np.asarray(self.radius - away)


#: A corner of a polygon, x and y [m].
Corner = tuple[Number, Number]
_FEWEST_CORNERS, MOST_CORNERS = 3, 32
#: Top of a zone without upper end, and minus the bottom of a zone without lower end [m]; no flight
#: reaches these heights.
ENDLESS_M = 1e5
# Area, or turn between two edges, that counts as rounding error, relative to the square of the
# polygon's extent.
_STRAIGHT = 1e-9


def turns_of(corners: Sequence[tuple[float, float]]) -> list[float]:
    """Return twice the signed area [m²] of the triangle that each corner forms with its neighbours.

    A left turn at a corner gives a positive area. A convex polygon in counter-clockwise order has
    no negative area.
    """
    count = len(corners)
    found = []
    for k in range(count):
        (x0, y0), (x1, y1), (x2, y2) = (corners[(k + step) % count] for step in (-1, 0, 1))
        found.append((x1 - x0) * (y2 - y1) - (y1 - y0) * (x2 - x1))
    return found


def is_convex(polygon: Any) -> bool:  # noqa: ANN401  shapely has no types that mypy reads here
    """Return whether a polygon (a shapely object) is convex, apart from rounding errors."""
    return bool(polygon.convex_hull.area - polygon.area <= _STRAIGHT * polygon.area)


def _refuse_folded(corners: Sequence[tuple[float, float]], what: str) -> None:
    """Raise ValueError if a list of corners x, y [m], in order, is not a convex polygon.

    `what` names the polygon at the beginning of the error message.
    """
    from shapely import Polygon  # noqa: PLC0415  for polygons alone

    polygon = Polygon(corners)
    is_flat = polygon.area <= _STRAIGHT * polygon.length**2
    if is_flat or not polygon.is_valid or not is_convex(polygon):
        raise ValueError(
            f"{what}; its corners must be those of a polygon that encloses an area of "
            f"{polygon.area:.3g} m^2 without crossing itself, in order; correct them"
        )


def _edges_of(
    corners: Sequence[tuple[float, float]],
) -> Iterator[tuple[tuple[float, float], float, float]]:
    """Yield, for each edge of a polygon, its unit normal and the polygon's extent along it.

    The extent is the least and the greatest coordinate along the normal [m]. The normal points
    outwards if `corners` are counter-clockwise.
    """
    for (x0, y0), (x1, y1) in pairwise((*corners, corners[0])):
        length = hypot(x1 - x0, y1 - y0)
        if length > 0.0:
            normal = (y1 - y0) / length, (x0 - x1) / length
            along = [normal[0] * x + normal[1] * y for x, y in corners]
            yield normal, min(along), max(along)


def _across_edges(corners: Sequence[tuple[float, float]]) -> Iterator[Ball]:
    """Yield, for each edge of a convex polygon, the slab between the edge and the farthest corner.

    The intersection of the slabs is the polygon. Two parallel edges give one slab.
    """
    seen: list[tuple[float, float]] = []
    for normal, low, high in _edges_of(corners):
        if all(abs(normal[0] * y - normal[1] * x) > _STRAIGHT for x, y in seen):
            seen.append(normal)
            yield Ball((), ((low + high) / 2,), (high - low) / 2, normal)


_FIELDS = {
    Shape.CYLINDER: ("centre", "radius", "bottom", "top"),
    Shape.SPHERE: ("centre", "radius"),
    Shape.BOX: ("low", "high"),
    Shape.POLYGON: ("corners", "bottom", "top"),
}
_COORDINATES = {Shape.CYLINDER: 2, Shape.SPHERE: 3}


class KeepOut(Part):
    """Keep-out zone of the airspace: cylinder, sphere, box or prism over a convex polygon."""

    name: Text = quantity(
        "",
        "name of the zone",
        pattern=_ZONE_PATTERN,
        allowed="1 to 64 letters, digits, '_', '-' or '.', starting with a letter or digit",
        example='"church"',
    )
    shape: Shape = quantity("", "shape of the zone", example='"cylinder"')
    centre: tuple[Number, ...] | None = quantity(
        "m",
        "cylinder: x, y of its axis; sphere: x, y, z",
        None,
        min_length=2,
        max_length=3,
        sound=_FAR,
    )
    radius: Number | None = quantity("m", "cylinder, sphere: radius", None, gt=0, sound=_WIDE)
    bottom: Number | None = quantity(
        "m", "cylinder, polygon: height of the bottom", None, sound=_FAR
    )
    top: Number | None = quantity("m", "cylinder, polygon: height of the top", None, sound=_FAR)
    low: Triple | None = quantity("m", "box: corner of least x, y and z", None, sound=_FAR)
    high: Triple | None = quantity("m", "box: corner of largest x, y and z", None, sound=_FAR)
    corners: tuple[Corner, ...] | None = late_quantity(
        "m",
        "polygon: x, y of its corners in order; a concave polygon is divided into several zones",
        None,
        min_length=_FEWEST_CORNERS,
        max_length=MOST_CORNERS,
    )

    @model_validator(mode="after")
    def _has_the_fields_of_its_shape(self) -> Self:
        wanted = _FIELDS[self.shape]
        fields = {name for names in _FIELDS.values() for name in names}
        given = {name for name in fields if getattr(self, name) is not None}
        what = f"{self.shape.value} {self.name} has {', '.join(wanted)}"
        for name in wanted:
            if name not in given:
                raise ValueError(f"{what}; give {name}")
        for name in sorted(given.difference(wanted)):
            raise ValueError(f"{what}; remove {name}")
        count = _COORDINATES.get(self.shape)
        if self.centre is not None and len(self.centre) != count:
            raise ValueError(f"{what}; its centre must be {count} numbers")
        if self.corners is not None:
            _refuse_folded(self.corners, what)
        for axis, ball in enumerate(self.balls):
            if ball.radius <= 0.0:
                is_box = self.shape is Shape.BOX
                ends = ("low", "high") if is_box else ("bottom", "top")
                place = f"[{axis}]" if is_box else ""
                raise ValueError(f"{what}; {ends[1]}{place} must be above {ends[0]}{place}")
        return self

    @property
    def balls(self) -> tuple[Ball, ...]:
        """Balls (sphere, infinite vertical cylinder, slabs) whose intersection is the zone."""
        if self.low is not None and self.high is not None:
            sides = enumerate(zip(self.low, self.high, strict=True))
            return tuple(_interval(axis, low, high) for axis, (low, high) in sides)
        if self.corners is not None and self.bottom is not None and self.top is not None:
            return (*_across_edges(self.corners), _interval(2, self.bottom, self.top))
        centre, radius = self.centre or (), self.radius or 0.0
        round_part = Ball(tuple(range(len(centre))), centre, radius)
        if self.bottom is None or self.top is None:
            return (round_part,)
        return (round_part, _interval(2, self.bottom, self.top))

    def ring(self, beyond: float = 0.0) -> "FloatArray":
        """Return the corners x, y of a prism's polygon in order, shape (n, 2) [m].

        Each edge is moved outwards by `beyond` [m]. Corners on the straight line between their
        neighbours are left out. The zone must be a prism.
        """
        import numpy as np  # noqa: PLC0415  see `Ball.coordinates`

        given = self.corners or ()
        # A corner that is given twice in a row is no edge.
        corners = tuple(one for k, one in enumerate(given) if one != given[k - 1])
        turns = turns_of(corners)
        edges = KeepIn(corners=corners).edges
        extent = max(map(abs, turns), default=0.0)
        # Two collinear edges have no unique intersection.
        kept = [k for k, turn in enumerate(turns) if abs(turn) > _STRAIGHT * extent]
        moved = []
        for k in kept:
            (before, first), (after, last) = edges[k - 1], edges[k]
            matrix = np.array([before, after])
            moved.append(np.linalg.solve(matrix, [first + beyond, last + beyond]))
        return np.array(moved)

    def depth(self, places: "ArrayLike") -> "FloatArray":
        """Return the depth of places inside the zone [m], negative outside.

        Inside, this is the distance to the nearest face. Outside, its magnitude is at most the
        distance from the zone. `places` have shape (..., 3).
        """
        import numpy as np  # noqa: PLC0415  see `Ball.depth`

        return np.min([ball.depth(places) for ball in self.balls], axis=0)


def _interval(axis: int, low: float, high: float) -> Ball:
    return Ball((axis,), ((low + high) / 2,), (high - low) / 2)


class KeepIn(Part):
    """Fence: a polygon in x and y, inside which the flight must stay at every height.

    The polygon is convex. A concave fence in a scenario file is replaced by its convex hull, and
    the parts of the hull outside of the fence become keep-out zones.
    """

    corners: tuple[Corner, ...] = quantity(
        "m",
        "x, y of the corners of the fence, in order",
        min_length=_FEWEST_CORNERS,
        max_length=MOST_CORNERS,
        example="[[0.0, 0.0], [90.0, 0.0], [90.0, 60.0]]",
    )

    @model_validator(mode="after")
    def _is_a_polygon(self) -> Self:
        _refuse_folded(self.corners, "keep_in has corners")
        return self

    @property
    def edges(self) -> tuple[tuple[tuple[float, float], float], ...]:
        """Outward unit normal of each edge, and the edge's coordinate along that normal [m]."""
        # The normals of `_edges_of` point outwards if the corners are in counter-clockwise order.
        is_left = sum(turns_of(self.corners)) > 0.0
        return tuple(
            (normal, high) if is_left else ((-normal[0], -normal[1]), -low)
            for normal, low, high in _edges_of(self.corners)
        )

    def depth(self, places: "ArrayLike") -> "FloatArray":
        """Return the distance of places to the nearest edge of the fence [m], negative outside.

        Outside, the magnitude is the greatest distance beyond the line of an edge. It is at most
        the distance from the fence. `places` have shape (..., 3).
        """
        import numpy as np  # noqa: PLC0415  see `Ball.coordinates`

        normals, ends = (np.array(part) for part in zip(*self.edges, strict=True))
        held = np.asarray(places, dtype=float)[..., :2]
        return np.asarray((ends - held @ normals.T).min(axis=-1))


class TerrainGrid(Part):
    """Heights of the ground on a rectilinear grid, read from the file named `airspace.terrain`."""

    x: tuple[Number, ...] = quantity("m", "places along world x, rising")
    y: tuple[Number, ...] = quantity("m", "places along world y, rising")
    heights: Text = quantity(
        "",
        "z of the ground at each place: doubles in the order of x, y, least byte first, compressed "
        "by zlib and written in base64",
    )

    @property
    def elevations(self) -> "FloatArray":
        """Heights z of the ground at the grid points, shape (len(x), len(y)) [m]."""
        return unpacked(self.heights).reshape(len(self.x), len(self.y))

    def surface(self, side: int) -> "Surface":
        """Return a smooth surface close to the ground, from which a height limit is measured.

        If `side` is 1, the surface is nowhere below the ground, and the floor is measured from it.
        If `side` is -1, it is nowhere above the ground, and the ceiling is measured from it.
        """
        return _surface(self, side)

    def surface_of_ways(self, home: tuple[float, float, float]) -> "Surface":
        """Return a smooth surface that clears the terrain on straight horizontal flights home.

        Each place of the surface is at least as high as all ground on the straight line to `home`,
        whose z is ignored.
        """
        return _surface_of_ways(self, home)

    @property
    def least_step(self) -> float:
        """Least distance between neighbouring grid lines in x or y [m]."""
        return min(after - at for axis in (self.x, self.y) for at, after in pairwise(axis))

    @property
    def edges(self) -> dict[str, tuple[int, float, float]]:
        """Position of the grid's four edges, by name ("west", "east", "south", "north").

        A position is (axis, end, coordinate [m]). Axis 0 is x, and 1 is y. The end is -1 at the
        lower and 1 at the upper end of the axis.
        """
        return {
            "west": (0, -1.0, self.x[0]),
            "east": (0, 1.0, self.x[-1]),
            "south": (1, -1.0, self.y[0]),
            "north": (1, 1.0, self.y[-1]),
        }


@lru_cache(maxsize=8)
def _surface(grid: TerrainGrid, side: int) -> "Surface":
    from pyomo_quad.scenario.surfaces import surface_of  # noqa: PLC0415  see `Ball.coordinates`

    return surface_of(grid.x, grid.y, grid.elevations, side)


@lru_cache(maxsize=8)
def _surface_of_ways(grid: TerrainGrid, home: tuple[float, float, float]) -> "Surface":
    from pyomo_quad.scenario.surfaces import (  # noqa: PLC0415  see `Ball.coordinates`
        highest_on_ways,
        surface_of,
    )

    return surface_of(grid.x, grid.y, highest_on_ways(grid.x, grid.y, grid.elevations, home), 1)


class Airspace(Part):
    """Space in which the flight must stay: height limits, fence, keep-out zones and terrain."""

    floor: Number | None = quantity(
        "m",
        "least height, none when absent; over terrain least height above the ground, clearance "
        "when absent",
        None,
        sound=_FAR,
    )
    ceiling: Number | None = quantity(
        "m",
        "largest height, none when absent; over terrain largest height above the ground",
        None,
        sound=_FAR,
    )
    clearance: Number = quantity(
        "m",
        "distance kept from every keep-out",
        0.0,
        ge=0,
        sound=Sound(0, 1e4, "a larger clearance leaves no airspace near the mission"),
    )
    keep_out: tuple[KeepOut, ...] = quantity("", "zones to keep out of", (), max_length=_MOST_ZONES)
    keep_in: KeepIn | None = late_quantity(
        "", "fence on the ground to stay inside of, none when absent", None
    )
    file: Text | None = late_quantity(
        "",
        "GeoJSON file of more zones to keep out of: polygons with the properties name, top (or "
        "height) and perhaps bottom, in m above mission.origin",
        None,
    )
    terrain: Text | None = late_quantity(
        "",
        "file of the heights of the ground, flat at z = 0 when absent: NetCDF with CF names and "
        "units, or CSV or Parquet with the columns x_m,y_m,height_m; altitudes above the sea where "
        "mission.origin is given",
        None,
    )
    ground: TerrainGrid | None = late_quantity("", "the ground read from terrain", None)

    @model_validator(mode="after")
    def _is_possible(self) -> Self:
        if self.floor is not None and self.ceiling is not None and self.floor >= self.ceiling:
            raise ValueError(
                f"floor = {self.floor:g} m; must be below ceiling = {self.ceiling:g} m"
            )
        names = [zone.name for zone in self.keep_out]
        twice = next((name for name in names if names.count(name) > 1), None)
        if twice is not None:
            raise ValueError(f"keep_out has two zones named {twice}; name each zone once")
        return self

    def height_above_ground(self, place: "ArrayLike", side: int = 1) -> "FloatArray":
        """Return the height of places above a smooth surface close to the ground [m].

        `side` is that of `TerrainGrid.surface`: 1 for the floor, -1 for the ceiling. Without
        terrain the surface is z = 0. `place` has shape (..., 3).
        """
        import numpy as np  # noqa: PLC0415  see `Ball.coordinates`

        held = np.asarray(place, dtype=float)
        if self.ground is None:
            return np.asarray(held[..., 2])
        return np.asarray(held[..., 2] - self.ground.surface(side).at(held))

    def distance_to_height_limits(self, places: "ArrayLike") -> "FloatArray":
        """Return the vertical distance of places to the nearer height limit [m], negative outside.

        The limits are floor and ceiling. If the airspace has neither, the distance is infinite.
        `places` have shape (..., 3).
        """
        import numpy as np  # noqa: PLC0415  see `Ball.coordinates`

        low = -np.inf if self.floor is None else self.floor
        high = np.inf if self.ceiling is None else self.ceiling
        over, under = (self.height_above_ground(places, side) for side in (1, -1))
        return np.minimum(over - low, high - under)

    def complaints(self, place: Sequence[float]) -> Iterator[str]:
        """Yield one message for each reason why a place x, y, z [m] is outside the airspace.

        The caller puts the name of the place before the message.
        """
        over, told = self.height_above_ground(place), ""
        if self.ground is not None:
            told = f"{over:.4g} m above airspace.terrain, "
            for name, (axis, side, end) in self.ground.edges.items():
                if side * (place[axis] - end) > 0.0:
                    yield (
                        f"is beyond the {name} edge of airspace.terrain at {'xy'[axis]} = "
                        f"{end:g} m; move it, or give more of the terrain"
                    )
        if self.floor is not None and over < self.floor:
            yield f"is {told}below airspace.floor = {self.floor:g} m; raise it or lower the floor"
        if self.ceiling is not None and self.height_above_ground(place, -1) > self.ceiling:
            yield (
                f"is {told}above airspace.ceiling = {self.ceiling:g} m; lower it or raise the "
                "ceiling"
            )
        outside = 0.0 if self.keep_in is None else -float(self.keep_in.depth(place))
        if outside > 0.0:
            yield f"is outside the fence airspace.keep_in by {outside:.3g} m; move one of them"
        for zone in self.keep_out:
            depth = float(zone.depth(place)) + self.clearance
            if depth > 0.0:
                near = self.with_clearance(zone)
                yield f"is inside keep-out {near} by {depth:.3g} m; move one of them"

    def with_clearance(self, zone: KeepOut) -> str:
        """Return the words by which messages name a zone, as in "mast with its clearance of 2 m".

        If the clearance is zero, only the zone's name is returned.
        """
        near = f" with its clearance of {self.clearance:g} m" if self.clearance else ""
        return f"{zone.name}{near}"
