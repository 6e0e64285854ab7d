"""The table `airspace`: limits of the height of flight, and keep-out zones."""

from collections.abc import Iterator, Sequence
from enum import StrEnum
from typing import TYPE_CHECKING, NamedTuple, Self

from pydantic import model_validator

from pyomo_quad.scenario.fields import Number, Part, Sound, Text, Triple, quantity

if TYPE_CHECKING:
    from numpy import float64
    from numpy.typing import ArrayLike, NDArray

    FloatArray = NDArray[float64]

_FAR = Sound(-1e5, 1e5, "coordinates lie within 100 km of the origin")
_WIDE = Sound(1e-2, 1e5, "obstacles measure from 1 cm to 100 km")
_ZONE_PATTERN = r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,63}$"
_MOST_ZONES = 64


class Shape(StrEnum):
    """Shape of a zone."""

    CYLINDER = "cylinder"
    SPHERE = "sphere"
    BOX = "box"


class Ball(NamedTuple):
    """All places whose coordinates on some axes lie within a radius of a centre.

    Every shape is an intersection of balls: a cylinder of a disk in x and y and an interval of z, a
    sphere of one ball in all three axes, a box of one interval per axis.
    """

    axes: tuple[int, ...]
    centre: tuple[float, ...]
    radius: float

    def depth(self, places: "ArrayLike") -> "FloatArray":
        """Return the depth of places, shape (..., 3), inside the ball; negative outside [m]."""
        import numpy as np  # noqa: PLC0415  not needed to read a scenario

        held = np.asarray(places, dtype=float)[..., self.axes]
        return np.asarray(self.radius - np.linalg.norm(held - self.centre, axis=-1))


_FIELDS = {
    Shape.CYLINDER: ("centre", "radius", "bottom", "top"),
    Shape.SPHERE: ("centre", "radius"),
    Shape.BOX: ("low", "high"),
}
_COORDINATES = {Shape.CYLINDER: 2, Shape.SPHERE: 3}


class KeepOut(Part):
    """A keep-out zone; its shape determines its fields."""

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
    bottom: Number | None = quantity("m", "cylinder: height where it begins", None, sound=_FAR)
    top: Number | None = quantity("m", "cylinder: height where it ends", None, sound=_FAR)
    low: Triple | None = quantity("m", "box: corner of least x, y and z", None, sound=_FAR)
    high: Triple | None = quantity("m", "box: corner of largest x, y and z", None, sound=_FAR)

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
        for axis, ball in enumerate(self.balls):
            if ball.radius <= 0.0:
                ends = ("bottom", "top") if self.shape is Shape.CYLINDER else ("low", "high")
                place = "" if self.shape is Shape.CYLINDER else f"[{axis}]"
                raise ValueError(f"{what}; {ends[1]}{place} must be above {ends[0]}{place}")
        return self

    @property
    def balls(self) -> tuple[Ball, ...]:
        """The balls whose intersection is the zone."""
        if self.low is not None and self.high is not None:
            sides = enumerate(zip(self.low, self.high, strict=True))
            return tuple(_interval(axis, low, high) for axis, (low, high) in sides)
        centre, radius = self.centre or (), self.radius or 0.0
        round_part = Ball(tuple(range(len(centre))), centre, radius)
        if self.bottom is None or self.top is None:
            return (round_part,)
        return (round_part, _interval(2, self.bottom, self.top))

    def depth(self, places: "ArrayLike") -> "FloatArray":
        """Return the distance of places, shape (..., 3), to the nearest face, from inside [m].

        Negative outside: minus the distance beyond the face that the place is farthest beyond.
        """
        import numpy as np  # noqa: PLC0415  see `Ball.depth`

        return np.min([ball.depth(places) for ball in self.balls], axis=0)


def _interval(axis: int, low: float, high: float) -> Ball:
    return Ball((axis,), ((low + high) / 2,), (high - low) / 2)


class Airspace(Part):
    """The airspace of a flight."""

    floor: Number | None = quantity("m", "least height, none when absent", None, sound=_FAR)
    ceiling: Number | None = quantity("m", "largest height, none when absent", None, sound=_FAR)
    clearance: Number = quantity(
        "m",
        "distance kept from every keep-out",
        0.0,
        ge=0,
        sound=Sound(0, 1e4, "clearances are at most 10 km"),
    )
    keep_out: tuple[KeepOut, ...] = quantity("", "zones to keep out of", (), max_length=_MOST_ZONES)

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

    def complaints(self, place: Sequence[float]) -> Iterator[str]:
        """Yield the reasons why a place is not in the airspace, each with a remedy."""
        if self.floor is not None and place[2] < self.floor:
            yield f"is below airspace.floor = {self.floor:g} m; raise it or lower the floor"
        if self.ceiling is not None and place[2] > self.ceiling:
            yield f"is above airspace.ceiling = {self.ceiling:g} m; lower it or raise the ceiling"
        for zone in self.keep_out:
            depth = float(zone.depth(place)) + self.clearance
            if depth > 0.0:
                near = self.with_clearance(zone)
                yield f"is inside keep-out {near} by {depth:.3g} m; move one of them"

    def with_clearance(self, zone: KeepOut) -> str:
        """Return the name of a zone, with its clearance if there is one."""
        near = f" with its clearance of {self.clearance:g} m" if self.clearance else ""
        return f"{zone.name}{near}"
