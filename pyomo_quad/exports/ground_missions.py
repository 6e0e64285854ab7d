"""Import of a ground station's mission as a scenario.

The scenario has the mission's places, times of hover, headings, fence and rally points. The planner
chooses the speeds and the paths between the places. The module reads the file formats that
`exports.ground_station` writes. Files of Mission Planner have neither a fence nor rally points.

The argument `notes` of several functions collects what a scenario cannot represent: text -> number
of occurrences. The functions add to it.
"""

import json
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from math import cos, dist, isfinite, radians, remainder, sin, tau
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from pyomo_quad.exports.ground_station import (
    GRIPPER_OPENED,
    SHAPES_PATH,
    WAYPOINT_FILE_HEADER,
    Command,
    Frame,
)
from pyomo_quad.scenario import Scenario, ScenarioError, scenario_from_mapping
from pyomo_quad.scenario.airspace import ENDLESS_M, MOST_CORNERS, Shape
from pyomo_quad.scenario.earth import GLOBE, GeodeticOrigin
from pyomo_quad.scenario.fields import is_number
from pyomo_quad.scenario.messages import printable, shown
from pyomo_quad.scenario.toml_text import inline

_TAKEOFFS = {Command.TAKEOFF, Command.VTOL_TAKEOFF}
_LANDINGS = {Command.LAND, Command.VTOL_LAND}
# Commands that circle a place; the scenario only passes the centre.
_CIRCLED = {Command.LOITER_UNLIMITED, Command.LOITER_TURNS}
_PLACES = {
    *(Command.WAYPOINT, Command.SPLINE_WAYPOINT, Command.PAYLOAD_PLACE, Command.LOITER_TIME),
    *(*_TAKEOFFS, *_LANDINGS, *_CIRCLED),
}
# Frames whose altitudes count from home, and from the level of the sea (MAVLink).
_RELATIVE = {Frame.GLOBAL_RELATIVE_ALTITUDE, Frame.GLOBAL_RELATIVE_ALTITUDE_INT}
_ABOVE_SEA = {Frame.GLOBAL, Frame.GLOBAL_INT}
# Fields of a scenario's waypoint, with the values that need not be written.
_UNSTATED = {"position": None, "hold": 0.0, "radius": 0.0, "yaw": None, "release": 0.0}
# Distance up to which the places of two successive items are the same place [m].
_SAME_M = 1e-3
# Limits that separate missions from damaged files: size of a file, distance from home, one day of
# hover, and length of a scenario's name.
_LARGEST_BYTES = 20_000_000
_FURTHEST_M = 1e5
_LONGEST_S = 86_400.0
_NAME_LENGTH = 64


@dataclass(frozen=True, kw_only=True)
class ImportedMission:
    """Mission of a ground station, converted to a scenario.

    Attributes
    ----------
    scenario : Scenario
        The scenario.
    text : str
        Text of the scenario's file (TOML).
    left_out : tuple of str
        Contents of the mission file that a scenario cannot represent, in words.
    """

    scenario: Scenario
    text: str
    left_out: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class _Item:
    """MAVLink command of a ground station's mission, with its seven parameters."""

    # Name of file and command for error messages.
    where: str
    # MAVLink's numbers of the command, and of the frame that defines where altitudes count from.
    command: int
    frame: int
    # None for a parameter that the file does not give. The last one is normally the altitude [m].
    params: tuple[float | None, ...]
    # Altitude [m] in a separate entry of a QGroundControl file, used for altitudes above the
    # terrain.
    altitude: float | None = None

    def param(self, k: int) -> float:
        """Return the command's parameter number k (0 to 6), or zero if the file gives none."""
        return self.params[k] or 0.0


@dataclass(frozen=True, kw_only=True)
class _File:
    """Content of a ground station's mission file: home position, commands, fence, rally points."""

    # Heights are relative to the altitude of the home position.
    home: GeodeticOrigin
    items: tuple[_Item, ...]
    # Entry `geoFence` of a QGroundControl file; empty if the file has no fence.
    fence: Mapping[str, Any] = field(default_factory=dict)
    # Latitude [deg], longitude [deg] and height [m] of each rally point.
    rally: tuple[dict[str, float], ...] = ()


@dataclass(kw_only=True)
class _Place:
    """Place in a ground station's mission to which the vehicle flies, with its actions there."""

    # Latitude and longitude [deg], and height above the home position [m].
    position: dict[str, float]
    # Time of hover [s], and largest distance at which the place counts as passed [m].
    hold: float = 0.0
    radius: float = 0.0
    # Yaw [rad], counter-clockwise from east; None if it is free.
    yaw: float | None = None
    # Mass of the payload that is released [kg], and whether the mission opens a gripper.
    release: float = 0.0
    is_opened_at: bool = False


def read_mission(
    file: str | Path,
    *,
    name: str | None = None,
    vehicle: str = "dji_matrice_100",
    payload_kg: float = 0.0,
) -> ImportedMission:
    """Convert a mission file of QGroundControl (.plan) or Mission Planner to a scenario.

    The flight begins with hovering at the altitude of the take-off, and ends with hovering above
    the landing place. Its duration is free. The scenario has flat ground, no wind (`calm`) and the
    power model `momentum`. Altitudes above the terrain count as heights above the home position.
    Exclusion fences become keep-out zones without bottom and top. An inclusion circle becomes an
    inscribed polygon.

    Parameters
    ----------
    file : str or Path
        Mission file: QGroundControl's plan file, or the text format QGC WPL 110.
    name : str, optional
        Name of the scenario; by default derived from the name of the file.
    vehicle : str, optional
        A vehicle of the library, or a vehicle file.
    payload_kg : float, optional
        Mass of a payload [kg]. The vehicle releases the whole payload where the mission first opens
        a gripper or places a payload.

    Returns
    -------
    ImportedMission
        The scenario, its text, and the contents of the file that a scenario cannot represent.

    Raises
    ------
    ScenarioError
        If the file is no mission with at least two places, or the resulting scenario is invalid.
        Also if the file has several inclusion fences, a repetition (`DO_JUMP`) or an invalid value.

    Examples
    --------
    >>> from pyomo_quad import export_plan
    >>> made = export_plan(plan, "qgroundcontrol", "hop.plan", origin="47.4,8.5,488")
    >>> read_mission("hop.plan").scenario.name
    'hop'
    """
    path = Path(file)
    notes: Counter[str] = Counter()
    read = _read(path)
    places = list(_places(read, notes))
    if len(places) < 2:
        raise ScenarioError(
            f"{printable(str(path))}: the mission has {len(places)} places; must have at least a "
            "start and a goal; add waypoints in the ground station."
        )
    _release(places, payload_kg, notes)
    tables = {
        "name": name or _as_name(path.stem),
        "title": f"Mission of {_as_name(path.name)}",
        "vehicle": {"use": vehicle} | ({"payload": payload_kg} if payload_kg else {}),
        "wind": {"use": "calm"},
        "power": {"model": "momentum"},
        "mission": _mission(read, places, notes),
        "airspace": _airspace(read, printable(str(path))),
    }
    scenario = scenario_from_mapping(tables, printable(str(path)))
    said = tuple(note if n == 1 else f"{note} ({n} times)" for note, n in notes.items())
    return ImportedMission(scenario=scenario, text=_toml(tables, said), left_out=said)


def _refuse(where: str, reason: str) -> NoReturn:
    raise ScenarioError(f"{where}: {reason}.") from None


def _as_name(text: str) -> str:
    kept = "".join(c if c.isascii() and (c.isalnum() or c in "_.-") else "_" for c in text)
    return (kept if kept[:1].isalnum() else f"mission{kept}")[:_NAME_LENGTH]


def _read(path: Path) -> _File:
    source = printable(str(path))
    try:
        if path.stat().st_size > _LARGEST_BYTES:
            _refuse(source, f"larger than {_LARGEST_BYTES} bytes; no mission is")
        text = path.read_text(encoding="utf-8-sig")
    except OSError as error:
        _refuse(source, f"cannot be read ({error.strerror or error}); give an existing file")
    except UnicodeDecodeError:
        _refuse(source, "is not text; give a .plan or .waypoints file")
    if text.startswith("QGC WPL"):
        return _waypoint_file(text, source)
    try:
        document = json.loads(text)
    except (ValueError, RecursionError):
        _refuse(source, f"is neither a .plan file (JSON) nor begins with {WAYPOINT_FILE_HEADER}")
    return _plan_file(document, source)


def _table(value: object) -> Mapping[str, Any]:
    return value if isinstance(value, Mapping) else {}


def _list(value: object) -> list[Any]:
    return value if isinstance(value, list) else []


def _number(value: object, where: str, low: float, high: float) -> float:
    if not is_number(value) or not low <= value <= high:
        _refuse(where, f"{shown(value)}; must be a number from {low:g} to {high:g}")
    return float(value)


def _on_globe(place: Sequence[object], where: str) -> tuple[float, float]:
    """Return latitude and longitude [deg] of a place, after a check of their ranges.

    Error messages begin with the text `where`.
    """
    if len(place) < 2:
        _refuse(where, "a place needs latitude and longitude")
    found = []
    for value, (coordinate, (low, high, _)) in zip(place, list(GLOBE.items())[:2], strict=False):
        found.append(_number(value, f"{where}, {coordinate}", low, high))
    return found[0], found[1]


def _home(written: object, where: str) -> GeodeticOrigin:
    place = list(written) if isinstance(written, list | tuple) else []
    latitude, longitude = _on_globe(place, where)
    low, high, _ = GLOBE["altitude"]
    altitude = 0.0 if len(place) < 3 or place[2] is None else place[2]
    return GeodeticOrigin(
        latitude=latitude,
        longitude=longitude,
        altitude=_number(altitude, f"{where}, altitude", low, high),
    )


def _plan_file(document: object, source: str) -> _File:
    held = _table(document)
    mission = _table(held.get("mission"))
    items = mission.get("items")
    if held.get("fileType") != "Plan" or not isinstance(items, list):
        _refuse(source, 'is no plan file; must have "fileType": "Plan" and a mission with items')
    home = _home(mission.get("plannedHomePosition"), f"{source}, plannedHomePosition")
    rally = []
    for k, point in enumerate(_list(_table(held.get("rallyPoints")).get("points"))):
        where = f"{source}, rally point {k + 1}"
        place = _list(point)
        latitude, longitude = _on_globe(place, where)
        height = _number(place[2] if len(place) > 2 else 0.0, where, -_FURTHEST_M, _FURTHEST_M)
        rally.append({"latitude": latitude, "longitude": longitude, "height": height})
    return _File(
        home=home,
        items=tuple(_plan_items(items, source)),
        fence=_table(held.get("geoFence")),
        rally=tuple(rally),
    )


def _plan_items(items: list[Any], source: str) -> Iterator[_Item]:
    """Yield the commands of a QGroundControl mission, except those that only shape a plan's path.

    An exported plan marks such waypoints with `SHAPES_PATH`. A complex item, such as a survey, is
    replaced by its commands. Error messages begin with the text `source`.
    """
    for k, written in enumerate(items, start=1):
        where, item = f"{source}, item {k}", _table(written)
        if item.get("type") == "ComplexItem":
            parts = _table(item.get("TransectStyleComplexItem")).get("Items")
            if not isinstance(parts, list):
                kind = shown(item.get("complexItemType"))
                _refuse(where, f"{kind} has no list of commands; convert it to waypoints")
            yield from _plan_items(parts, f"{where} ({shown(item.get('complexItemType'))})")
        elif not item.get(SHAPES_PATH):
            params = item.get("params")
            if not isinstance(params, list) or len(params) != 7:
                _refuse(where, "has no seven params")
            yield _item(where, item.get("command"), item.get("frame"), params, item.get("Altitude"))


def _item(
    where: str, command: object, frame: object, params: Sequence[object], altitude: object = None
) -> _Item:
    numbers = [
        None if value is None else _number(value, f"{where}, param {k}", -1e9, 1e9)
        for k, value in enumerate(params, start=1)
    ]
    return _Item(
        where=where,
        command=int(_number(command, f"{where}, command", 0, 65_535)),
        frame=int(_number(frame, f"{where}, frame", 0, 255)),
        params=tuple(numbers),
        altitude=None if altitude is None else _number(altitude, where, -1e5, 1e5),
    )


def _waypoint_file(text: str, source: str) -> _File:
    header, *rows = (line.split() for line in text.splitlines() if line.strip())
    if " ".join(header) != WAYPOINT_FILE_HEADER:
        _refuse(source, f"begins with {shown(' '.join(header))}; must be {WAYPOINT_FILE_HEADER}")
    items, home = [], None
    for row in rows:
        where = f"{source}, row {shown(row[0])}"
        try:
            numbers = [float(word) for word in row]
        except ValueError:
            _refuse(where, "has a word that is no number")
        if len(numbers) != 12 or not all(map(isfinite, numbers)):
            _refuse(where, "must have twelve finite numbers")
        if home is None:
            home = _home(numbers[8:11], where)
            continue
        # The text format cannot leave a heading out; Mission Planner writes 0 for any heading.
        held: list[float | None] = [*numbers[4:11]]
        held[3] = held[3] or None
        items.append(_item(where, numbers[3], numbers[2], held))
    if home is None:
        _refuse(source, "has no rows; the first is the home")
    return _File(home=home, items=tuple(items))


def _places(read: _File, notes: Counter[str]) -> Iterator[_Place]:
    """Yield the places to which the vehicle flies in a ground station's mission, in order.

    The function adds to `notes` what a scenario cannot represent, with the number of occurrences.
    """
    last: _Place | None = None
    first: _Place | None = None
    for item in read.items:
        place = _place_of(item, read, first, last, notes)
        if place is None:
            if last is not None:
                _apply(item, last, notes)
            elif item.command != Command.DO_CHANGE_SPEED:
                notes[f"command {item.command}, before any place"] += 1
            continue
        if last is None or _apart(read.home, last, place) > _SAME_M:
            if last is not None:
                yield last
            first, last = first or place, place
        else:
            # Successive places at most a millimetre apart are one place with the heading and radius
            # of the first.
            last.hold += place.hold
            last.is_opened_at |= place.is_opened_at
        if item.command == Command.LOITER_UNLIMITED:
            notes["circling without end: the flight ends there"] += 1
            break
    if last is not None:
        yield last


def _apart(home: GeodeticOrigin, *places: _Place) -> float:
    rows = [list(place.position.values()) for place in places]
    return dist(*home.local(rows).tolist())


def _place_of(
    item: _Item, read: _File, first: _Place | None, last: _Place | None, notes: Counter[str]
) -> _Place | None:
    """Return the place to which the command `item` leads, or None if it leads to no place.

    `first` and `last` are the first and the previous place. Circles and altitudes above the terrain
    are added to `notes`. A `DO_JUMP` or an invalid value raises a ScenarioError.
    """
    if item.command == Command.RETURN_TO_LAUNCH and first is not None:
        return _Place(position=dict(first.position))
    if item.command == Command.DO_JUMP:
        _refuse(item.where, "repeats a part of the mission; write the repeated places out")
    if item.command not in _PLACES:
        return None
    latitude, longitude = item.params[4], item.params[5]
    if not latitude and not longitude:  # zeros stand for the vehicle's present position
        near = last.position if last is not None else None
        latitude = read.home.latitude if near is None else near["latitude"]
        longitude = read.home.longitude if near is None else near["longitude"]
    latitude, longitude = _on_globe([latitude, longitude], item.where)
    height = _height(item, read.home, notes)
    # The flight of a scenario ends in hover. A landing therefore leads to a place above the landing
    # point, at the height of the first place.
    if item.command in _LANDINGS and first is not None:
        height = first.position["height"]
    if item.command in _CIRCLED:
        notes[f"circles of command {item.command}, whose centre is passed"] += 1
    is_waypoint = item.command in {Command.WAYPOINT, Command.SPLINE_WAYPOINT}
    return _Place(
        position={"latitude": latitude, "longitude": longitude, "height": height},
        hold=_number(item.param(0), item.where, 0.0, _LONGEST_S)
        if is_waypoint or item.command == Command.LOITER_TIME
        else 0.0,
        radius=max(item.param(1), 0.0) if is_waypoint else 0.0,
        yaw=_towards(item.params[3]) if item.command == Command.WAYPOINT else None,
        is_opened_at=item.command == Command.PAYLOAD_PLACE,
    )


def _towards(heading: float | None) -> float | None:
    """Convert a heading [deg], clockwise from north, to yaw [rad], counter-clockwise from east.

    If the mission gives no heading (None), the result is None, too.
    """
    return None if heading is None else remainder(radians(90.0 - heading), tau)


def _height(item: _Item, home: GeodeticOrigin, notes: Counter[str]) -> float:
    """Return the height above home [m] of the place to which the command `item` leads.

    A height above the terrain counts as above home, and is added to `notes`. An unknown frame or a
    missing altitude raises a ScenarioError.
    """
    written = item.params[6]
    if item.frame in _ABOVE_SEA and written is not None:
        return written - home.altitude
    if item.frame not in _RELATIVE or written is None:
        known = {*_ABOVE_SEA, *_RELATIVE, Frame.GLOBAL_TERRAIN_ALTITUDE}
        if item.frame not in known:
            _refuse(item.where, f"frame {item.frame}; must be one of {sorted(map(int, known))}")
        notes["terrain: altitudes over it count from the home's, as over flat ground"] += 1
        written = item.altitude if written is None else written
    if written is None:
        _refuse(item.where, "has no altitude; give one in the ground station")
    return written


def _apply(item: _Item, place: _Place, notes: Counter[str]) -> None:
    """Apply a command without a position, such as a delay, to the place where it is executed.

    Commands without effect in a scenario are added to `notes`.
    """
    if item.command == Command.DELAY:
        place.hold += _number(item.param(0), item.where, 0.0, _LONGEST_S)
    elif item.command == Command.DO_GRIPPER and item.param(1) == GRIPPER_OPENED:
        place.is_opened_at = True
    elif item.command == Command.DO_CHANGE_SPEED:
        notes["speeds, which the plan chooses"] += 1
    else:
        notes[f"command {item.command}"] += 1


def _release(places: list[_Place], payload_kg: float, notes: Counter[str]) -> None:
    """Set the release of the whole payload at the first place where the mission opens a gripper.

    Without a payload, or if this place is the start or the goal, a remark is added to `notes`
    instead.
    """
    opened = [place for place in places if place.is_opened_at]
    if opened and not payload_kg:
        notes["the release of a payload; give --payload KG"] += 1
    # A scenario allows no release at its start or goal.
    elif opened and any(opened[0] is end for end in (places[0], places[-1])):
        notes["the release of the payload at an end of the flight"] += 1
    elif opened:
        opened[0].release = payload_kg


def _mission(read: _File, places: list[_Place], notes: Counter[str]) -> dict[str, Any]:
    """Return the scenario's table `mission` (TOML): origin, start, goal, waypoints, rally points.

    What the table cannot represent is added to `notes`.
    """
    start, *between, goal = places
    # Start and goal of a scenario have no time of hover and no radius.
    for place in (start, goal):
        if place.hold:
            notes["the time of hover at an end of the flight"] += 1
        if place.radius:
            notes["the acceptance radius at an end of the flight"] += 1
    # If the file gives only one heading, both get it.
    # Start and goal of a scenario always have a heading. With equal headings, the vehicle need not
    # turn.
    yaws = [place.yaw for place in (start, goal) if place.yaw is not None]
    first, last = ({"yaw": yaws[0]}, {"yaw": yaws[-1]}) if yaws else ({}, {})
    return {
        "duration": "free",
        "origin": read.home.model_dump(),
        "start": {"position": start.position, **first},
        "goal": {"position": goal.position, **last},
        "waypoints": [
            {
                name: value
                for name, value in asdict(place).items()
                if name in _UNSTATED and value != _UNSTATED[name]
            }
            for place in between
        ],
        **({"rally": list(read.rally)} if read.rally else {}),
    }


def _airspace(read: _File, source: str) -> dict[str, Any]:
    """Return the scenario's table `airspace` (TOML), with the fence of a ground station's mission.

    Error messages begin with `source`.
    """
    inside: list[list[dict[str, float]]] = []
    zones: list[dict[str, Any]] = []
    polygons = _list(read.fence.get("polygons"))
    if "polygon" in read.fence:  # a fence of version 1
        polygons = [{"inclusion": True, "polygon": read.fence["polygon"]}]
    for k, written in enumerate(polygons, start=1):
        where, polygon = f"{source}, fence polygon {k}", _table(written)
        ring = [_corner(corner, where) for corner in _list(polygon.get("polygon"))]
        if polygon.get("inclusion", True):
            inside.append(ring)
        else:
            zones.append({"name": f"polygon-{k}", "shape": Shape.POLYGON.value, "corners": ring})
    for k, written in enumerate(_list(read.fence.get("circles")), start=1):
        where, circle = f"{source}, fence circle {k}", _table(_table(written).get("circle"))
        centre = _corner(circle.get("center"), where)
        radius = _number(circle.get("radius"), f"{where}, radius", 0.01, _FURTHEST_M)
        if _table(written).get("inclusion", True):
            inside.append(_inscribed(read.home, centre, radius))
        else:
            shape = {"shape": Shape.CYLINDER.value, "centre": centre, "radius": radius}
            zones.append({"name": f"circle-{k}"} | shape)
    if len(inside) > 1:
        _refuse(source, f"has {len(inside)} fences to stay inside of; a scenario has one at most")
    ends = {"bottom": -ENDLESS_M, "top": ENDLESS_M}
    held: dict[str, Any] = {"keep_out": [zone | ends for zone in zones]}
    return held | ({"keep_in": {"corners": inside[0]}} if inside else {})


def _corner(written: object, where: str) -> dict[str, float]:
    latitude, longitude = _on_globe(_list(written), where)
    return {"latitude": latitude, "longitude": longitude}


def _inscribed(
    home: GeodeticOrigin, centre: Mapping[str, float], radius: float
) -> list[dict[str, float]]:
    """Return the corners of a regular polygon inscribed in a circle, as latitudes and longitudes.

    `centre` has the circle's latitude and longitude, in this order. `radius` is in m. The polygon
    is constructed in the axes x and y with the origin `home`.
    """
    (x, y, _), *_ = home.local([[*centre.values(), 0.0]]).tolist()
    angles = [tau * k / MOST_CORNERS for k in range(MOST_CORNERS)]
    ring = [[x + radius * cos(angle), y + radius * sin(angle), 0.0] for angle in angles]
    rows = home.geodetic(np.array(ring)).tolist()
    return [{"latitude": latitude, "longitude": longitude} for latitude, longitude, _ in rows]


def _toml(tables: Mapping[str, Any], left_out: Sequence[str]) -> str:
    """Return a scenario's tables as TOML text, with one comment for each item of `left_out`."""
    lines = ["#:schema ./scenario.schema.json"]
    lines += [f"# Not of the mission's file: {note}." for note in left_out]
    for name, value in tables.items():
        if not isinstance(value, Mapping):
            lines.append(f"{name} = {inline(value)}")
            continue
        plain = {key: held for key, held in value.items() if not _is_tables(key, held)}
        if plain:
            lines += ["", f"[{name}]", *(f"{key} = {inline(v)}" for key, v in plain.items())]
        for key, held in value.items():
            for row in held if _is_tables(key, held) else ():
                lines += ["", f"[[{name}.{key}]]"]
                lines += [f"{field} = {inline(v)}" for field, v in row.items()]
    return "\n".join(lines) + "\n"


def _is_tables(key: str, value: object) -> bool:
    return key in {"waypoints", "keep_out"} and isinstance(value, list)
