"""A plan as few waypoints with speeds, on the globe: a mission of QGroundControl."""

from dataclasses import dataclass
from math import cos, radians, sin
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pyomo_quad.exports.motion import Motion
from pyomo_quad.flight.flight import POSITION_STATES
from pyomo_quad.scenario import ScenarioError
from pyomo_quad.scenario.fields import number_in_text
from pyomo_quad.scenario.messages import shown

FloatArray = NDArray[np.float64]

# WGS 84: equatorial radius [m] and flattening, as NIMA TR8350.2 defines them.
_EQUATOR = 6_378_137.0
_FLATTENING = 1.0 / 298.257223563
_ECCENTRICITY_2 = _FLATTENING * (2.0 - _FLATTENING)
_LATITUDE_STEPS = 6  # each gains more than two digits; near the ground three suffice

# Degrees, degrees, and metres from below the Dead Sea to above the highest summit.
_GLOBE = ((-90.0, 90.0), (-180.0, 180.0), (-500.0, 9000.0))

# Below, a leg is a pause: the autopilot is told to wait and not to creep [m/s].
_SLOWEST = 0.05
#: Items of a mission that PX4 holds on its smaller boards.
MOST_ITEMS = 500
_CHECKED = 4001
# MAVLink's commands and frame, and the autopilot and vehicle that the file names.
_NAV_WAYPOINT, _DO_CHANGE_SPEED = 16, 178
_GLOBAL_RELATIVE_ALTITUDE, _MISSION = 3, 2
_PX4, _QUADROTOR = 12, 2
_GROUND_SPEED = 1


@dataclass(frozen=True, kw_only=True)
class Origin:
    """Where on the globe the plan's origin lies: degrees on WGS 84, metres above the sea."""

    latitude: float
    longitude: float
    altitude: float

    def geodetic(self, place: FloatArray) -> FloatArray:
        """Return latitude [deg], longitude [deg] and height over the origin [m].

        Places are x east, y north and z up from the origin, shape (n, 3); so are the results.
        """
        latitude, longitude = radians(self.latitude), radians(self.longitude)
        up = np.array(
            [cos(latitude) * cos(longitude), cos(latitude) * sin(longitude), sin(latitude)]
        )
        east = np.array([-sin(longitude), cos(longitude), 0.0])
        axes = np.vstack([east, np.cross(up, east), up])
        normal = _normal_radius(np.array(latitude))
        centre = (normal + self.altitude - np.array([0, 0, normal * _ECCENTRICITY_2])) * up
        return _geodetic(centre + place @ axes) - np.array([0.0, 0.0, self.altitude])


@dataclass(frozen=True, kw_only=True)
class Legs:
    """Straight legs at even speed through places (n, 3) [m], each reached at its time (n,) [s]."""

    times: FloatArray
    places: FloatArray

    def at(self, t: FloatArray) -> FloatArray:
        """Return the places at times, shape (n, 3)."""
        return np.column_stack([np.interp(t, self.times, axis) for axis in self.places.T])


def thin(motion: Motion, path_error_m: float) -> Legs:
    """Return the legs of a plan: at no time is one further from it than the path error.

    The plan is split where it is furthest from where a flight at even speed would be at that time,
    until it is near enough everywhere (the top-down time-ratio algorithm of Meratnia and de By,
    2004).
    """
    motion.require(POSITION_STATES, "a QGroundControl mission")
    t = motion.samples(_CHECKED / motion.duration)
    place = motion.position(t)
    kept, spans = {0, len(t) - 1}, [(0, len(t) - 1)]
    while spans:
        first, last = spans.pop()
        share = ((t[first : last + 1] - t[first]) / (t[last] - t[first]))[:, None]
        straight = place[first] + share * (place[last] - place[first])
        far = np.linalg.norm(place[first : last + 1] - straight, axis=1)
        worst = first + int(np.argmax(far))
        if far.max() > path_error_m:
            kept.add(worst)
            spans += [(first, worst), (worst, last)]
    rows = sorted(kept)
    return Legs(times=t[rows], places=place[rows])


def mission(legs: Legs, origin: Origin, name: str, path_error_m: float) -> dict[str, Any]:
    """Return a QGroundControl plan file: heights are over the origin, which is the home.

    Raises
    ------
    ScenarioError
        If the legs are more than an autopilot holds.
    """
    items: list[dict[str, Any]] = []
    globe = origin.geodetic(legs.places)
    lengths = np.linalg.norm(np.diff(legs.places, axis=0), axis=1)
    spans = np.diff(legs.times)
    items.append(_waypoint(globe[0]))
    for place, length, span in zip(globe[1:], lengths, spans, strict=True):
        if length / span < _SLOWEST:
            items.append(_waypoint(place, hold_s=float(span)))
        else:
            speed = float(length / span)
            items += [_item(_DO_CHANGE_SPEED, _MISSION, [_GROUND_SPEED, speed, -1, 0, 0, 0, 0])]
            items.append(_waypoint(place))
    if len(items) > MOST_ITEMS:
        raise ScenarioError(
            f"{name}: --path-error {path_error_m:g} m takes {len(items)} mission items; PX4 holds "
            f"{MOST_ITEMS}; give a larger --path-error."
        )
    numbered = [item | {"doJumpId": number} for number, item in enumerate(items, start=1)]
    fastest = float(max((lengths / spans).max(), _SLOWEST))
    return {
        "fileType": "Plan",
        "version": 1,
        "groundStation": "QGroundControl",
        "geoFence": {"circles": [], "polygons": [], "version": 2},
        "rallyPoints": {"points": [], "version": 2},
        "mission": {
            "version": 2,
            "firmwareType": _PX4,
            "vehicleType": _QUADROTOR,
            "cruiseSpeed": fastest,
            "hoverSpeed": fastest,
            "plannedHomePosition": [origin.latitude, origin.longitude, origin.altitude],
            "items": numbered,
        },
    }


def _waypoint(place: FloatArray, hold_s: float = 0.0) -> dict[str, Any]:
    latitude, longitude, height = (float(value) for value in place)
    # Yaw None: the autopilot's own.  Radii of 0 are those that the autopilot is set to.
    item = _item(
        _NAV_WAYPOINT, _GLOBAL_RELATIVE_ALTITUDE, [hold_s, 0, 0, None, latitude, longitude, height]
    )
    return item | {"Altitude": height, "AltitudeMode": 1, "AMSLAltAboveTerrain": None}


def _item(command: int, frame: int, params: list[Any]) -> dict[str, Any]:
    return {
        "type": "SimpleItem",
        "autoContinue": True,
        "command": command,
        "frame": frame,
        "params": params,
    }


def _normal_radius(latitude: FloatArray) -> FloatArray:
    """Return the radius of curvature across the meridian [m]; latitudes in radians."""
    return np.asarray(_EQUATOR / np.sqrt(1.0 - _ECCENTRICITY_2 * np.sin(latitude) ** 2))


def _geodetic(place: FloatArray) -> FloatArray:
    """Return latitude [deg], longitude [deg] and height over the ellipsoid [m] of earth-centred."""
    x, y, z = place.T
    across = np.hypot(x, y)
    latitude = np.arctan2(z, across * (1.0 - _ECCENTRICITY_2))
    for _ in range(_LATITUDE_STEPS):
        normal = _normal_radius(latitude)
        latitude = np.arctan2(z + normal * _ECCENTRICITY_2 * np.sin(latitude), across)
    normal = _normal_radius(latitude)
    # Of the two ways to the height that which does not divide by nothing at poles or equator.
    height = (
        across * np.cos(latitude)
        + z * np.sin(latitude)
        - normal * (1.0 - _ECCENTRICITY_2 * np.sin(latitude) ** 2)
    )
    return np.column_stack([np.degrees(latitude), np.degrees(np.arctan2(y, x)), height])


def origin_of(text: str) -> Origin:
    """Read LAT,LON,ALT in degrees and metres above the sea.

    Raises
    ------
    ScenarioError
        If it is not three numbers, or no place on the globe.
    """
    numbers = [_number(part) for part in text.split(",")]
    if len(numbers) != 3 or None in numbers:
        raise ScenarioError(
            f"--origin {shown(text)}: must be LAT,LON,ALT in degrees and metres above the sea, "
            "such as 47.3977,8.5456,488."
        )
    for name, value, (low, high), unit in zip(
        ("latitude", "longitude", "altitude"), numbers, _GLOBE, ("deg", "deg", "m"), strict=True
    ):
        if value is None or not low <= value <= high:
            raise ScenarioError(
                f"--origin: {name} = {value:g} {unit}; must be from {low:g} to {high:g} {unit}."
            )
    latitude, longitude, altitude = (float(value or 0.0) for value in numbers)
    return Origin(latitude=latitude, longitude=longitude, altitude=altitude)


def _number(text: str) -> float | None:
    try:
        return number_in_text(text)
    except ValueError:
        return None
