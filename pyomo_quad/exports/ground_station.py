"""Export of verified plans as ground station missions: a few geodetic waypoints with speeds.

Waypoints are added to those of the scenario so that straight legs follow the curved path of the
plan. QGroundControl's file marks the added waypoints. `exports.ground_missions` leaves them out
when it converts the file back to a scenario.

Formats: QGroundControl's plan file (developer guide, Plan File Format: version 1, missions and
fences version 2), and MAVLink's text format QGC WPL 110 of Mission Planner.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pyomo_quad.arrays import FloatArray
from pyomo_quad.exports.motion import Motion
from pyomo_quad.flight.flight import POSITION_STATES
from pyomo_quad.report.folder import MARK
from pyomo_quad.scenario import Scenario, ScenarioError
from pyomo_quad.scenario.airspace import ENDLESS_M, KeepOut, Shape
from pyomo_quad.scenario.earth import GeodeticOrigin


class Command(IntEnum):
    """Numbers of the MAVLink commands that missions of ground stations use."""

    WAYPOINT = 16
    LOITER_UNLIMITED = 17
    LOITER_TURNS = 18
    LOITER_TIME = 19
    RETURN_TO_LAUNCH = 20
    LAND = 21
    TAKEOFF = 22
    SPLINE_WAYPOINT = 82
    VTOL_TAKEOFF = 84
    VTOL_LAND = 85
    DELAY = 93
    PAYLOAD_PLACE = 94
    DO_JUMP = 177
    DO_CHANGE_SPEED = 178
    DO_GRIPPER = 211


class Frame(IntEnum):
    """Numbers of MAVLink's coordinate frames.

    The frame of a command states from which level its altitude counts. `MISSION` is the frame of a
    command without a position.
    """

    GLOBAL = 0
    MISSION = 2
    GLOBAL_RELATIVE_ALTITUDE = 3
    GLOBAL_INT = 5
    GLOBAL_RELATIVE_ALTITUDE_INT = 6
    GLOBAL_TERRAIN_ALTITUDE = 10


# Least speed of a leg [m/s]. A slower leg becomes a hold, because autopilots cannot keep its speed.
_SLOWEST = 0.05
#: Number of mission items that PX4 stores on its smaller boards.
MOST_ITEMS = 500
_CHECKED = 4001  # samples of a flight at which the distance of the legs from the plan is checked
# Numbers of the autopilot and of the kind of vehicle in the file.
_PX4, _QUADROTOR = 12, 2
# First parameter of the command DO_CHANGE_SPEED for a speed over ground (MAVLink).
_GROUND_SPEED = 1
#: Second parameter of the command DO_GRIPPER that opens the gripper.
GRIPPER_OPENED = 0
_PLAN_VERSION, _MISSION_VERSION, _FENCE_VERSION, _RALLY_VERSION = 1, 2, 2, 2
#: Key that marks a waypoint which only shapes the path, and is no start, waypoint or goal of the
#: mission.
SHAPES_PATH = "shapesPath"
#: First line of Mission Planner's text format; 110 is the version of the format.
WAYPOINT_FILE_HEADER = "QGC WPL 110"


@dataclass(frozen=True, kw_only=True)
class Legs:
    """Straight legs at constant speed that approximate a plan.

    Attributes
    ----------
    times : ndarray, shape (n,)
        Times at which the legs begin and end [s].
    places : ndarray, shape (n, 3)
        Positions x, y, z at these times [m].
    is_of_mission : ndarray of bool, shape (n,)
        Whether each position is the mission's start, goal or a waypoint. Empty if all of them are.
    """

    times: FloatArray
    places: FloatArray
    is_of_mission: NDArray[np.bool_] = field(default_factory=lambda: np.array([], dtype=bool))

    def at(self, t: FloatArray) -> FloatArray:
        """Return the positions x, y, z [m] on the legs at times t [s], shape (n, 3)."""
        return np.column_stack([np.interp(t, self.times, axis) for axis in self.places.T])

    def shapes_path(self, number: int) -> bool:
        """Return whether a position is neither start, goal nor waypoint of the mission.

        Such a position has been added only to make the straight legs follow the plan's curved path.

        Parameters
        ----------
        number : int
            Index of the position in `places`.
        """
        return bool(self.is_of_mission.size) and not self.is_of_mission[number]


def thin(motion: Motion, path_error_m: float) -> Legs:
    """Approximate a plan by few straight legs, within `path_error_m` of the plan at all times.

    `path_error_m` limits the distance between plan and legs at the same time. Source: top-down
    time-ratio algorithm of Meratnia and de By (2004). If the plan's model does not have the states
    x, y and z of the position, a ScenarioError is raised.
    """
    motion.require(POSITION_STATES, "a QGroundControl mission")
    passed = _passing_times(motion)
    t = np.union1d(motion.samples(_CHECKED / motion.duration), passed)
    place = motion.position(t)
    # At first, each leg leads from one waypoint of the mission to the next.
    ends = sorted({0, len(t) - 1, *np.searchsorted(t, passed).tolist()})
    kept, spans = set(ends), list(pairwise(ends))
    while spans:
        first, last = spans.pop()
        share = ((t[first : last + 1] - t[first]) / (t[last] - t[first]))[:, None]
        straight = place[first] + share * (place[last] - place[first])
        far = np.linalg.norm(place[first : last + 1] - straight, axis=1)
        worst = first + int(np.argmax(far))
        # A leg with too large a deviation is split at the time of its largest deviation.
        if far.max() > path_error_m:
            kept.add(worst)
            spans += [(first, worst), (worst, last)]
    rows = sorted(kept)
    return Legs(times=t[rows], places=place[rows], is_of_mission=np.isin(rows, ends))


def _passing_times(motion: Motion) -> list[float]:
    """Return the ascending times [s] at which a plan reaches and leaves the mission's waypoints."""
    waypoints = motion.mission.mission.waypoints
    reached = [(w.at, w.hold) for w in waypoints if w.at is not None]
    times = [time for at, hold in reached for time in (at, at + hold)]
    return sorted({min(time, motion.duration) for time in times})


def mission(
    legs: Legs, origin: GeodeticOrigin, motion: Motion, path_error_m: float
) -> dict[str, Any]:
    """Convert a plan to the content of a QGroundControl plan file, as nested mappings.

    `legs` come from `thin`, called with `motion` and `path_error_m`. `origin` becomes the home
    position; heights are relative to its altitude. If there are more mission items than PX4 can
    store, a ScenarioError is raised. Its message contains `path_error_m`.
    """
    items = _items(legs, origin, _releases(legs, motion.mission))
    if len(items) > MOST_ITEMS:
        raise ScenarioError(
            f"{motion.name}: --path-error {path_error_m:g} m takes {len(items)} mission items; "
            f"PX4 holds {MOST_ITEMS}; give a larger --path-error."
        )
    numbered = [item | {"doJumpId": number} for number, item in enumerate(items, start=1)]
    fastest = float(max(_speeds(legs).max(), _SLOWEST))
    return {
        "fileType": "Plan",
        "version": _PLAN_VERSION,
        # QGroundControl accepts any text here; it names the program that wrote the file.
        "groundStation": MARK,
        "geoFence": _fence(motion.mission, origin),
        "rallyPoints": {
            "points": _globe(motion.mission.mission.rally, origin),
            "version": _RALLY_VERSION,
        },
        "mission": {
            "version": _MISSION_VERSION,
            "firmwareType": _PX4,
            "vehicleType": _QUADROTOR,
            "cruiseSpeed": fastest,
            "hoverSpeed": fastest,
            "plannedHomePosition": [origin.latitude, origin.longitude, origin.altitude],
            "items": numbered,
        },
    }


def waypoint_file(mission_of_plan: Mapping[str, Any]) -> str:
    """Convert a QGroundControl plan to Mission Planner's text format of waypoints (QGC WPL 110).

    Fence and rally points are left out, because Mission Planner stores them in separate files.

    Parameters
    ----------
    mission_of_plan : mapping
        Content of a QGroundControl plan file, from `mission`.
    """
    held = mission_of_plan["mission"]
    home = [0.0, 0.0, 0.0, 0.0, *held["plannedHomePosition"]]
    rows = [(Frame.GLOBAL, Command.WAYPOINT, home)]
    rows += [(item["frame"], item["command"], item["params"]) for item in held["items"]]
    lines = [WAYPOINT_FILE_HEADER]
    for number, (frame, command, params) in enumerate(rows):
        numbers = "\t".join(f"{param or 0.0:.10f}" for param in params)
        lines.append(f"{number}\t{int(number == 0)}\t{int(frame)}\t{int(command)}\t{numbers}\t1")
    return "\n".join(lines) + "\n"


def _speeds(legs: Legs) -> FloatArray:
    lengths = np.linalg.norm(np.diff(legs.places, axis=0), axis=1)
    return np.asarray(lengths / np.diff(legs.times))


def _releases(legs: Legs, scenario: Scenario) -> set[int]:
    """Return the indices of the positions in `legs.places` at which payload is released."""
    passed = [(w.at, w.hold) for w in scenario.mission.waypoints if w.release and w.at is not None]
    return {int(np.abs(legs.times - (at + hold)).argmin()) for at, hold in passed}


def _items(legs: Legs, origin: GeodeticOrigin, releases: set[int]) -> list[dict[str, Any]]:
    globe = origin.geodetic(legs.places)
    items = [_waypoint(globe[0])]
    spans, speeds = np.diff(legs.times), _speeds(legs)
    for number, (place, span, speed) in enumerate(zip(globe[1:], spans, speeds, strict=True), 1):
        shape = {SHAPES_PATH: True} if legs.shapes_path(number) else {}
        if speed < _SLOWEST:
            # A hold at a waypoint stays where it began, although the plan may drift a little.
            is_hold = not (legs.shapes_path(number - 1) or legs.shapes_path(number))
            held = globe[number - 1] if is_hold else place
            items.append(_waypoint(held, hold_s=float(span)) | shape)
        else:
            change = [_GROUND_SPEED, float(speed), -1, 0, 0, 0, 0]
            items.append(_item(Command.DO_CHANGE_SPEED, Frame.MISSION, change))
            items.append(_waypoint(place) | shape)
        if number in releases:
            items.append(_item(Command.DO_GRIPPER, Frame.MISSION, [1, GRIPPER_OPENED, *5 * [0]]))
    return items


def _waypoint(place: FloatArray, hold_s: float = 0.0) -> dict[str, Any]:
    latitude, longitude, height = (float(value) for value in place)
    # Yaw None: the autopilot chooses the heading. Radii of 0: the autopilot's settings apply.
    params = [hold_s, 0, 0, None, latitude, longitude, height]
    item = _item(Command.WAYPOINT, Frame.GLOBAL_RELATIVE_ALTITUDE, params)
    return item | {"Altitude": height, "AltitudeMode": 1, "AMSLAltAboveTerrain": None}


def _item(command: Command, frame: Frame, params: list[Any]) -> dict[str, Any]:
    return {
        "type": "SimpleItem",
        "autoContinue": True,
        "command": int(command),
        "frame": int(frame),
        "params": params,
    }


def _globe(places: Sequence[Sequence[float]], origin: GeodeticOrigin) -> list[list[float]]:
    """Convert positions x, y, z [m] to rows of latitude [deg], longitude [deg] and height [m].

    `origin` is the position of x = y = z = 0 on earth.
    """
    rows: list[list[float]] = origin.geodetic(np.reshape(places, (-1, 3))).tolist()
    return rows


def _fence(scenario: Scenario, origin: GeodeticOrigin) -> dict[str, Any]:
    """Return the geofence of a QGroundControl plan file, as nested mappings.

    It has the scenario's fence, and those keep-out zones that have neither a bottom nor a top.
    """
    airspace = scenario.airspace
    rings = [] if airspace.keep_in is None else [(True, airspace.keep_in.corners)]
    # The flight may pass below or above a zone with a bottom or a top.
    endless = [zone for zone in airspace.keep_out if _is_endless(zone)]
    rings += [(False, zone.corners) for zone in endless if zone.corners is not None]
    polygons = [
        {
            "inclusion": is_inside,
            "polygon": [place[:2] for place in _globe([(*c, 0.0) for c in corners], origin)],
            "version": 1,
        }
        for is_inside, corners in rings
    ]
    circles = [
        {
            "circle": {
                "center": _globe([(*zone.centre, 0.0)], origin)[0][:2],
                "radius": zone.radius,
            },
            "inclusion": False,
            "version": 1,
        }
        for zone in endless
        if zone.shape is Shape.CYLINDER and zone.centre is not None
    ]
    return {"circles": circles, "polygons": polygons, "version": _FENCE_VERSION}


def _is_endless(zone: KeepOut) -> bool:
    return zone.bottom == -ENDLESS_M and zone.top == ENDLESS_M
