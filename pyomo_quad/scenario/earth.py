"""Geodetic positions: the origin of a mission on earth, and places by latitude and longitude.

The frame of a mission is east-north-up ("enu"): x is east, y north and z up from the origin [m].
The plane z = 0 is tangent to the earth, which lies below it: by 8 cm at 1 km from the origin, and
by 8 m at 10 km. Latitude and longitude are in WGS 84.
"""

from collections.abc import Mapping
from enum import StrEnum
from typing import TYPE_CHECKING, Any

from pyomo_quad.scenario.fields import Number, Part, is_number, quantity
from pyomo_quad.scenario.messages import ScenarioError, shown

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from pyomo_quad.arrays import FloatArray


#: Least value, greatest value and unit of each coordinate on the globe, by name.
GLOBE = {
    "latitude": (-90.0, 90.0, "deg"),
    "longitude": (-180.0, 180.0, "deg"),
    # From below the shore of the Dead Sea to above the highest summit.
    "altitude": (-500.0, 9000.0, "m"),
}
_LATITUDE, _LONGITUDE, _ALTITUDE = GLOBE
_HEIGHT = "height"


class Frame(StrEnum):
    """Orientation of the world axes on earth. `ENU` means x east, y north and z up."""

    ENU = "enu"


def _degrees(name: str, meaning: str) -> Any:  # noqa: ANN401  a declaration of pydantic's
    low, high, _ = GLOBE[name]
    return quantity("deg", meaning, ge=low, le=high)


class GeodeticOrigin(Part):
    """Position on earth of the point x = y = z = 0 of a mission.

    The position is given by latitude and longitude (WGS 84, degrees) and by the altitude above the
    sea [m].
    """

    latitude: Number = _degrees(_LATITUDE, "latitude of the origin, north of the equator")
    longitude: Number = _degrees(_LONGITUDE, "longitude of the origin, east of Greenwich")
    # All altitudes of a mission must have one reference level, usually the sea.
    altitude: Number = quantity(
        "m",
        "altitude of the origin, above the sea",
        0.0,
        ge=GLOBE[_ALTITUDE][0],
        le=GLOBE[_ALTITUDE][1],
    )

    def geodetic(self, place: "FloatArray") -> "FloatArray":
        """Convert places from metres, shape (n, 3), to latitude and longitude.

        The result holds latitude [deg], longitude [deg] and height above the origin's altitude [m].
        """
        import numpy as np  # noqa: PLC0415  reading a scenario does without it

        longitude, latitude, altitude = self._topocentric().transform(
            *np.transpose(place), direction="INVERSE"
        )
        return np.column_stack([latitude, longitude, altitude - self.altitude])

    def local(self, globe: "ArrayLike") -> "FloatArray":
        """Convert places from latitude and longitude to metres, shape (n, 3).

        `globe` holds latitude [deg], longitude [deg] and height above the origin's altitude [m].
        """
        import numpy as np  # noqa: PLC0415  see `geodetic`

        latitude, longitude, height = np.transpose(np.asarray(globe, dtype=float))
        return np.column_stack(
            self._topocentric().transform(longitude, latitude, height + self.altitude)
        )

    def _topocentric(self) -> Any:  # noqa: ANN401  pyproj has no types that mypy reads here
        from pyproj import Transformer  # noqa: PLC0415  for places on the globe alone

        # A conversion by PROJ, followed by its inverse, moves a place by at most 0.01 mm.
        return Transformer.from_pipeline(
            "+proj=pipeline +step +proj=unitconvert +xy_in=deg +xy_out=rad "
            "+step +proj=cart +ellps=WGS84 +step +proj=topocentric +ellps=WGS84 "
            f"+lat_0={self.latitude!r} +lon_0={self.longitude!r} +h_0={self.altitude!r}"
        )


def local_place(
    written: Mapping[str, Any], where: str, origin: GeodeticOrigin | None, count: int
) -> list[float]:
    """Convert a place of a scenario file from latitude and longitude [deg] to metres.

    `count` is the number of coordinates, 2 or 3. The third is `altitude` above the sea or `height`
    above the origin [m]. Raises ScenarioError, which begins with `where`, if the place is not
    valid or `origin` is None.
    """
    keys = (_LATITUDE, _LONGITUDE, *((_ALTITUDE, _HEIGHT) if count == 3 else ()))
    strange = next((key for key in written if key not in keys), None)
    has_height = count == 2 or (_ALTITUDE in written) != (_HEIGHT in written)
    if strange is not None or not has_height or not {_LATITUDE, _LONGITUDE} <= set(written):
        upward = ", and altitude (above the sea) or height (above the origin)"
        raise ScenarioError(
            f"{where} = {_spelled(written)}; a place on earth has latitude and longitude"
            f"{upward if count == 3 else ''}, and nothing else."
        )
    if origin is None:
        raise ScenarioError(
            f"{where} has a latitude, which needs the position of x = y = 0; give mission.origin = "
            "{ latitude, longitude, altitude }."
        )
    for key, number in written.items():
        low, high, unit = GLOBE.get(key, (-1e5, 1e5, "m"))
        if not is_number(number) or not low <= number <= high:
            raise ScenarioError(
                f"{where}.{key} = {shown(number)}; must be a number from {low:g} to {high:g} "
                f"{unit}."
            )
    height = written.get(_HEIGHT, written.get(_ALTITUDE, origin.altitude) - origin.altitude)
    place = origin.local([[written[_LATITUDE], written[_LONGITUDE], height]])[0]
    return [float(coordinate) for coordinate in place[:count]]


def _spelled(written: Mapping[str, Any]) -> str:
    return "{ " + ", ".join(shown(key)[1:-1] for key in written) + " }" if written else "{}"
