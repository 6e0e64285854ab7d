"""Figures of flight paths in space and on a map, and the data of the interactive player.

The figures correspond to figures 4 and 6 of Yacef et al., "Energy-Efficiency Path Planning for
Quadrotor UAV Under Wind Conditions". If an argument is a sequence of flights, the first flight is
the plan.
"""

import json
from collections.abc import Sequence
from math import isfinite
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d.art3d import Poly3DCollection  # type: ignore[import-untyped]
from mpl_toolkits.mplot3d.axes3d import Axes3D  # type: ignore[import-untyped]

from pyomo_quad.flight.columns import Column
from pyomo_quad.report.labels import Label, write_labels
from pyomo_quad.report.relief import draw_relief
from pyomo_quad.report.signals import (
    ATTITUDE,
    BATTERY,
    BODY_RATE,
    ENERGY,
    MOTOR,
    POSITION,
    POWER,
    ROTOR_ACCELERATION,
    ROTOR_SPEED,
    TIME,
    VELOCITY,
    WIND,
)
from pyomo_quad.report.style import (
    FULL_WIDTH,
    INK,
    MUTED,
    PALE,
    TICK_STEPS,
    StyledFlight,
    legend_below,
)
from pyomo_quad.report.zones import ZONE_COLOR, box_around, faces, outline
from pyomo_quad.scenario import Scenario
from pyomo_quad.scenario.airspace import Airspace, KeepOut
from pyomo_quad.scenario.wind import WindGrid

_PROJECTIONS = ((0, 1, "from above"), (0, 2, "from the front"), (1, 2, "from the side"))
BEAT_COUNT = 5  # markers at equal times along each path: a larger distance means a higher speed
# Relative to the size of the plan's path: distance from the plan below which a path cannot be
# distinguished from it, and distance above which a path may extend beyond the figure.
COINCIDENT, ASTRAY = 0.02, 1.0
_MARGIN = 0.08
_MOST_TICKS = 9
# Ratio of the shortest to the longest side below which the label of the longest axis must move.
_FLAT = 0.3
_SMALLEST_SIDE = 0.2  # least range of each axis of a figure, m
_SEEN_THROUGH = 0.18  # opacity of a zone's faces in space, which overlap in pairs
# Margin around all paths, relative to their largest side. Parts of zones beyond are cut off.
_AROUND = 0.25
_UP = 2
_AT_LEFT: Any = ("axes fraction", "data")
_BESIDE: dict[str, Any] = {
    "xytext": (0, 4),
    "textcoords": "offset points",
    "annotation_clip": True,
    "fontsize": 7,
    "zorder": 5,
}
# Height of the map [inches], length of its wind arrow [inches], least wind with an arrow [m/s].
_MAP_HEIGHT, _ARROW, _CALM = 3.1, 0.55, 0.05
# Share of a map's height above its axes for the key of a wind field.
_ROOM_OF_KEY = 0.06
# Largest number of arrows of a wind field along each axis.
_MOST_ARROWS = 25
WIND_COLOR = "#3a6ea5"  # as in the page's view
# Distance of start and goal, relative to the path length, below which they share a marker.
_SAME_PLACE = 0.01


def distinct_paths(flights: Sequence[StyledFlight]) -> tuple[StyledFlight, ...]:
    """Return the plan and the flights whose paths differ visibly from the plan's path.

    Figures draw only these paths. The first of the given flights is the plan.
    """
    return (flights[0], *_further(flights, COINCIDENT))


def draw_path(flights: Sequence[StyledFlight], mission: Scenario | None = None) -> Figure:
    """Draw flight paths in space, and seen from above, from the front and from the side.

    The first flight is the plan. Zones, terrain, height limits and waypoints of `mission` are also
    drawn. The view from above shows the passing time of each waypoint that has one (see
    `Scenario.lasting`).
    """
    figure = Figure(figsize=(FULL_WIDTH, FULL_WIDTH))
    limits = _limits(flights, mission)
    space: Axes3D = figure.add_axes((0.0, 0.53, 0.5, 0.46), projection="3d")
    draw_space(space, flights, mission)
    boxes = ((0.575, 0.595, 0.405, 0.37), (0.075, 0.115, 0.405, 0.37), (0.575, 0.115, 0.405, 0.37))
    for (across, up, title), box in zip(_PROJECTIONS, boxes, strict=True):
        axes = figure.add_axes(box)
        labels = [] if mission is None else draw_mission(axes, mission, (across, up))
        _draw_projection(axes, flights, limits, (across, up), title)
        write_labels(axes, labels)
    legend_below(figure, space)
    return figure


def draw_map(flights: Sequence[StyledFlight], mission: Scenario) -> Figure:
    """Draw a map of flight paths from above, with zones, waypoints and wind, true to scale.

    Arrows show the wind field at its lowest height and first time. Without a wind field, one arrow
    shows the mean wind along the first flight, the plan.
    """
    figure = Figure(figsize=(FULL_WIDTH, _MAP_HEIGHT))
    left, below, wide, high = 0.075, 0.21, 0.915, 0.76
    if mission.wind.grid is not None:
        high -= _ROOM_OF_KEY
    axes = figure.add_axes((left, below, wide, high))
    limits = _limits(flights, mission)[:2]
    room = np.array([wide * FULL_WIDTH, high * _MAP_HEIGHT])
    half = (np.ptp(limits, axis=1) / room).max() * room / 2
    (low_x, low_y), (high_x, high_y) = (limits.mean(axis=1) + way * half for way in (-1, 1))
    axes.set(xlim=(low_x, high_x), ylim=(low_y, high_y))
    labels = draw_mission(axes, mission, (0, 1))
    for flight in flights:
        axes.plot(*_track(flight)[:, :2].T, label=flight.name, **flight.style.line)
    for end, name, shape in _ends(flights[0]):
        axes.plot(*end[:2, None], marker=shape, color=INK, markersize=7, linestyle="none")
        labels.insert(0, Label(text=name, x=float(end[0]), y=float(end[1])))
    write_labels(axes, labels)
    if mission.wind.grid is None:
        _draw_mean_wind(axes, flights[0])
    else:
        _draw_wind_field(axes, mission.wind.grid, mission.wind.field_scale)
    axes.set_xlabel(axis_label(POSITION[0]))
    # So near, the label fits beside numbers such as -300.
    axes.set_ylabel(axis_label(POSITION[1]), labelpad=0.0)
    legend_below(figure, axes)
    return figure


def mean_wind_of(flight: StyledFlight) -> np.ndarray:
    """Return the x and y components of the mean wind along a flight [m/s].

    Both are zero if the flight's table has no columns of the wind.
    """
    known = [signal for signal in WIND if signal.name in flight.frame]
    if len(known) < len(WIND):
        return np.zeros(len(WIND))
    return np.array([float(signal.of(flight.frame).mean()) for signal in known])


def _draw_mean_wind(axes: Axes, flight: StyledFlight) -> None:
    """Draw the mean wind along a flight as an arrow in a corner of a panel, with its speed.

    Nothing is drawn in calm air.
    """
    wind = mean_wind_of(flight)
    speed = float(np.linalg.norm(wind))
    if speed < _CALM:
        return
    middle, (along, up) = np.array([0.93, 0.8]), _ARROW * wind / speed
    half = np.array([along / FULL_WIDTH, up / _MAP_HEIGHT]) / 2
    axes.annotate(
        "",
        xy=tuple(middle + half),
        xytext=tuple(middle - half),
        xycoords="axes fraction",
        arrowprops={"arrowstyle": "-|>", "color": WIND_COLOR, "linewidth": 2.0},
    )
    axes.annotate(
        f"wind {speed:.1f} m/s",
        (middle[0], 0.97),
        xycoords="axes fraction",
        ha="center",
        va="top",
        color=WIND_COLOR,
        fontsize=8,
    )


def _draw_wind_field(axes: Axes, grid: WindGrid, scale: float) -> None:
    """Draw a gridded wind field at its lowest height and first time as horizontal arrows.

    `scale` multiplies the velocities. Nothing is drawn in calm air.
    """
    every_x, every_y = (1 + len(axis) // _MOST_ARROWS for axis in (grid.x, grid.y))
    components = grid.components[:2].reshape(2, len(grid.x), len(grid.y), -1)
    wind = scale * components[:, ::every_x, ::every_y, 0]
    speed = float(np.nanmax(np.hypot(*wind)))
    if speed < _CALM:
        return
    places = np.meshgrid(grid.x[::every_x], grid.y[::every_y], indexing="ij")
    arrows = axes.quiver(
        *places, *wind, color=WIND_COLOR, width=1.5e-3, alpha=0.6, zorder=0.5, pivot="mid"
    )
    text = f"wind of the field, up to {speed:.1f} m/s"
    axes.quiverkey(arrows, 0.86, 1.04, speed, text, labelpos="W", fontproperties={"size": 8})


def draw_space(
    axes: Axes3D, flights: Sequence[StyledFlight], mission: Scenario | None = None
) -> None:
    """Draw flight paths and keep-out zones in space, on one scale along all axes.

    The first flight is the plan.
    """
    limits = _limits(flights, mission)
    floor = limits[2, 0]
    for zone in () if mission is None else mission.airspace.keep_out:
        surface = faces(zone, limits)
        if len(surface):
            axes.add_collection3d(
                Poly3DCollection(surface, facecolor=ZONE_COLOR, alpha=_SEEN_THROUGH, linewidth=0.0)
            )
    for flight in flights:
        track, beats = (_inside(points, limits) for points in (_track(flight), _beats(flight)))
        shadow = np.full(len(track), floor)
        axes.plot(track[:, 0], track[:, 1], shadow, color=PALE, linewidth=1.0)
        axes.plot(*track.T, label=flight.name, **flight.style.line)
        axes.plot(*beats.T, **_marker(flight))
    for end, name, shape in _ends(flights[0]):
        axes.plot([end[0]] * 2, [end[1]] * 2, [floor, end[2]], color=MUTED, linewidth=0.6)
        axes.plot(*end[:, None], marker=shape, color=INK, markersize=6, linestyle="none")
        # In one line the two names would leave the figure.
        lines = name.replace(" and ", "  \nand ")
        axes.text(*end, f"{lines}  ", va="bottom", ha="right")
    axes.set(xlim=limits[0], ylim=limits[1], zlim=limits[2])
    axes.set_box_aspect(np.ptp(limits, axis=1), zoom=0.88)
    axes.view_init(elev=22, azim=-58)
    sides = np.ptp(limits, axis=1)
    for axis, signal, side in zip(
        (axes.xaxis, axes.yaxis, axes.zaxis), POSITION, sides, strict=True
    ):
        most = max(2, round(_MOST_TICKS * side / sides.max()))
        axis.set_major_locator(MaxNLocator(nbins=most, steps=TICK_STEPS))
        axis.set_pane_color("white")
        is_along = side == sides.max() and sides.min() < _FLAT * side
        axis.set_label_text("\n" * (2 * is_along) + axis_label(signal))
        axis.labelpad = -4
        axis.set_tick_params(pad=-2)
        axis._axinfo["grid"].update(color="#e4e4e4", linewidth=0.5)  # noqa: SLF001


def leaving_paths(flights: Sequence[StyledFlight]) -> tuple[StyledFlight, ...]:
    """Return the flights whose paths are too far from the plan to be drawn completely.

    The figure is not enlarged for these paths, and its edge may cut them off. The first flight is
    the plan. Let d be the diagonal of the box around its path. A path is too far if its greatest
    distance from the plan at equal times exceeds max(d, 0.2 m).
    """
    return _further(flights, ASTRAY)


def _further(flights: Sequence[StyledFlight], share: float) -> tuple[StyledFlight, ...]:
    optimum, *others = flights
    time, track = TIME.of(optimum.frame), _track(optimum)
    allowed = share * max(float(np.linalg.norm(np.ptp(track, axis=0))), _SMALLEST_SIDE)
    return tuple(f for f in others if _distance(f, time, track) > allowed)


def _limits(flights: Sequence[StyledFlight], mission: Scenario | None) -> np.ndarray:
    """Return the least and the greatest x, y and z [m] of a figure of paths, shape (3, 2).

    They cover all paths that stay near the plan, the first flight (see `leaving_paths`). With a
    `mission`, they also cover nearby zones, floor and ceiling.
    """
    astray = leaving_paths(flights)
    points = np.concatenate([_track(flight) for flight in flights if flight not in astray])
    low, high = points.min(axis=0), points.max(axis=0)
    middle = (low + high) / 2
    half = np.maximum(high - low, _SMALLEST_SIDE) / 2 * (1 + 2 * _MARGIN)
    limits = np.column_stack([middle - half, middle + half])
    return limits if mission is None else _with_airspace(limits, mission.airspace)


def _track(flight: StyledFlight) -> np.ndarray:
    return np.column_stack([signal.of(flight.frame) for signal in POSITION])


def _distance(flight: StyledFlight, time: np.ndarray, track: np.ndarray) -> float:
    """Return the largest distance [m] between a flight and another track at equal times.

    The other track has the positions `track`, shape (n, 3) [m], at the times `time` [s].
    """
    own_time = TIME.of(flight.frame)
    own = np.column_stack([np.interp(time, own_time, axis) for axis in _track(flight).T])
    return float(np.linalg.norm(own - track, axis=1).max())


def _beats(flight: StyledFlight) -> np.ndarray:
    time = TIME.of(flight.frame)
    beats = np.linspace(time[0], time[-1], BEAT_COUNT + 1)[1:-1]
    return np.column_stack([np.interp(beats, time, axis) for axis in _track(flight).T])


def _inside(points: np.ndarray, limits: np.ndarray) -> np.ndarray:
    """Replace points outside a figure's limits by NaN; `points` have shape (n, 3) [m].

    `limits` holds the least and the greatest x, y and z [m], shape (3, 2).
    """
    is_inside = np.all((limits[:, 0] <= points) & (points <= limits[:, 1]), axis=1)
    # 3-D axes do not clip curves.
    return np.where(is_inside[:, None], points, np.nan)


def _with_airspace(limits: np.ndarray, airspace: Airspace) -> np.ndarray:
    """Extend the limits of a figure of paths to show keep-out zones, floor and ceiling.

    Limits are least and greatest x, y and z [m], shape (3, 2). Each moves by at most a quarter of
    the longest side of the given `limits`.
    """
    room = _AROUND * float(np.ptp(limits, axis=1).max())
    # The extension is limited, so that distant zones do not make the paths small.
    furthest = limits + room * np.array([-1.0, 1.0])
    wanted = limits.copy()
    sides = [
        (axis, float(end + sign * airspace.clearance))
        for zone in airspace.keep_out
        for sign, corner in zip((-1.0, 1.0), box_around(zone), strict=True)
        for axis, end in enumerate(corner)
    ]
    beyond = _MARGIN * room
    ends = ((airspace.floor, -beyond), (airspace.ceiling, beyond))
    heights = [(_UP, height + margin) for height, margin in ends if height is not None]
    if airspace.ground is not None:
        heights = []  # heights above the ground
    # A floor or ceiling is shown only if it lies inside the widest permitted limits.
    sides += [side for side in heights if furthest[_UP, 0] <= side[1] <= furthest[_UP, 1]]
    for axis, place in sides:
        wanted[axis] = min(wanted[axis, 0], place), max(wanted[axis, 1], place)
    return np.column_stack(
        [np.maximum(wanted[:, 0], furthest[:, 0]), np.minimum(wanted[:, 1], furthest[:, 1])]
    )


def draw_mission(axes: Axes, mission: Scenario, directions: tuple[int, int]) -> list[Label]:
    """Draw terrain, zones, height limits and waypoints of a mission as seen along one axis.

    `directions` are the horizontal and the vertical axis of the panel: 0 for x, 1 for y, 2 for z.
    The caller must draw the returned labels with `write_labels`.
    """
    airspace = mission.airspace
    draw_relief(axes, airspace.ground, directions)
    names = []
    if airspace.keep_in is not None and set(directions) == {0, 1}:
        fence = [(c[directions[0]], c[directions[1]]) for c in airspace.keep_in.corners]
        axes.add_patch(Polygon(fence, fill=False, edgecolor=ZONE_COLOR, linewidth=1.0))
    for zone in airspace.keep_out:
        if airspace.clearance:
            grown = outline(zone, directions, airspace.clearance)
            grown.set(fill=False, edgecolor=ZONE_COLOR, linewidth=0.6, linestyle=(0, (2, 2)))
            axes.add_patch(grown)
        shape = outline(zone, directions)
        shape.set(facecolor=ZONE_COLOR, alpha=0.25, linewidth=0.0, zorder=1)
        axes.add_patch(shape)
        if directions[1] != _UP:
            x, y, _ = box_around(zone).mean(axis=0).tolist()
            names.append(Label(text=zone.name, x=x, y=y, color=ZONE_COLOR, is_centred=True))
    for name, height in (("floor", airspace.floor), ("ceiling", airspace.ceiling)):
        if height is not None and directions[1] == _UP and airspace.ground is None:
            axes.axhline(height, color=ZONE_COLOR, linewidth=1.0)
            axes.annotate(name, (0.0, height), xycoords=_AT_LEFT, color=ZONE_COLOR, **_BESIDE)
    passed: dict[tuple[float, float], list[str]] = {}
    for number, waypoint in enumerate(mission.mission.waypoints, start=1):
        place = waypoint.position[directions[0]], waypoint.position[directions[1]]
        if waypoint.radius:
            axes.add_patch(Circle(place, waypoint.radius, fill=False, ec=MUTED, linewidth=0.6))
        # Only the view from above shows passing times: from the side, a waypoint may hide another.
        has_time = waypoint.at is not None and directions[1] != _UP
        label = f"{number}: {waypoint.at:.1f} s" if has_time else str(number)
        passed.setdefault(place, []).append(label)
    for place in passed:
        axes.plot(*place, marker="x", color=INK, markersize=5, linestyle="none", zorder=4)
    places = [Label(text=", ".join(said), x=x, y=y) for (x, y), said in passed.items()]
    return [*places, *names]


def _draw_projection(
    axes: Axes,
    flights: Sequence[StyledFlight],
    limits: np.ndarray,
    directions: tuple[int, int],
    title: str,
) -> None:
    chosen = list(directions)
    for flight in flights:
        axes.plot(*_track(flight)[:, chosen].T, **flight.style.line)
        axes.plot(*_beats(flight)[:, chosen].T, **_marker(flight))
    for end, _, shape in _ends(flights[0]):
        axes.plot(*end[chosen, None], marker=shape, color=INK, markersize=6, linestyle="none")
    across, up = (POSITION[direction] for direction in directions)
    axes.set(xlabel=axis_label(across), ylabel=axis_label(up), title=f"Seen {title}")
    box = axes.get_position()  # the figure is square
    wide, high = np.ptp(limits[chosen], axis=1)
    scale = max(wide / box.width, high / box.height) / 2
    for set_limits, direction, size in (
        (axes.set_xlim, directions[0], box.width),
        (axes.set_ylim, directions[1], box.height),
    ):
        middle = limits[direction].mean()
        set_limits(middle - scale * size, middle + scale * size)


def _ends(optimum: StyledFlight) -> tuple[tuple[np.ndarray, str, str], ...]:
    """Return position [m], name and marker of the two ends of a plan's path, for figures.

    If start and goal nearly coincide (see `_SAME_PLACE`), the result has only one entry.
    """
    track = _track(optimum)
    way = np.linalg.norm(np.diff(track, axis=0), axis=1).sum()
    if np.linalg.norm(track[-1] - track[0]) <= _SAME_PLACE * way:
        return ((track[-1], "start and goal", "*"),)
    return (track[0], "start", "o"), (track[-1], "goal", "*")


def _marker(flight: StyledFlight) -> dict[str, Any]:
    style = flight.style
    return {
        "linestyle": "none",
        "marker": style.marker,
        "markersize": 4,
        "markerfacecolor": "white",
        "markeredgecolor": style.color,
        "markeredgewidth": 1.0,
    }


def axis_label(signal: Column) -> str:
    """Return the label of a coordinate axis: symbol and unit of a column of a flight's table.

    `signal` describes the column, such as the position along x.
    """
    return f"${signal.symbol}$ ({signal.unit})"


_SAMPLES = 201  # largest number of times of each flight in the player
_DIGITS = 6  # significant digits of the player's numbers
_SERIES = (
    ("Position", POSITION),
    ("Velocity", VELOCITY),
    ("Attitude", ATTITUDE),
    ("Body rates", BODY_RATE),
    ("Power and energy", (POWER, ENERGY)),
    ("Battery", BATTERY),
    ("Rotor speeds", ROTOR_SPEED),
    ("Rotor accelerations", ROTOR_ACCELERATION),
    ("Motors", tuple(signal for signals in MOTOR[1:] for signal in signals)),
    ("Wind", WIND),
)


def view_data(flights: Sequence[StyledFlight], airspace: Airspace, arm_m: float) -> dict[str, Any]:
    """Return the data of the HTML report's interactive player of flights, ready for JSON.

    The first flight is the plan. `arm_m` is the distance from the vehicle's centre to a rotor [m].
    """
    framed = [flight for flight in flights if flight not in leaving_paths(flights)]
    shown = [flight for flight in distinct_paths(flights) if flight in framed]
    optimum = flights[0].frame
    winds = np.array([signal.of(optimum) for signal in WIND if signal.name in optimum])
    return {
        "flights": [
            _played(flight, is_shown=flight in shown, is_framed=flight in framed)
            for flight in flights
        ],
        "groups": [
            (name, [_described(s, signals) for s in signals if s.name in optimum])
            for name, signals in _SERIES
            if any(signal.name in optimum for signal in signals)
        ],
        "zones": [
            {"name": zone.name, "shape": zone.shape.value, **_extent(zone), **_ring(zone)}
            for zone in airspace.keep_out
        ],
        "ends": [(name, _rounded(place)) for place, name, _ in _ends(flights[0])],
        "arm": arm_m,
        "fastest_wind": max(float(np.abs(winds).max(initial=0.0)), 1.0),
    }


def _played(flight: StyledFlight, *, is_shown: bool, is_framed: bool) -> dict[str, Any]:
    frame = flight.frame
    rows = np.unique(np.linspace(0, len(frame) - 1, _SAMPLES).round().astype(int))
    kept = frame.iloc[rows]
    played = {
        "name": flight.name,
        "color": flight.style.color,
        "dashes": [3.0 * length for length in flight.style.dashes],
        "visible": is_shown,
        "framed": is_framed,
        "t": _rounded(TIME.of(kept) - TIME.of(kept)[0]),
        **{axis: _rounded(signal.of(kept)) for axis, signal in zip("xyz", POSITION, strict=True)},
        "series": {
            signal.name: _rounded(signal.of(kept))
            for _, signals in _SERIES
            for signal in signals
            if signal.name in kept
        },
    }
    if all(signal.name in kept for signal in ATTITUDE):
        for angle, signal in zip(("phi", "theta", "psi"), ATTITUDE, strict=True):
            played[angle] = _rounded(kept[signal.name].to_numpy(dtype=float))
    if all(signal.name in kept for signal in WIND):
        played["wind"] = [_rounded(signal.of(kept)) for signal in WIND]
    return played


def _described(signal: Column, group: Sequence[Column]) -> dict[str, Any]:
    which = signal.index or signal.symbol.removeprefix("v_")
    is_alone = [other.words for other in group].count(signal.words) == 1
    return {
        "key": signal.name,
        "name": signal.words if is_alone else f"{signal.words} {which}",
        "unit": signal.unit,
        "span": signal.smallest_span,
    }


def _ring(zone: KeepOut) -> dict[str, Any]:
    corners = zone.corners or ()
    return {"corners": [{"x": x, "y": y} for x, y in corners]} if corners else {}


def _extent(zone: KeepOut) -> dict[str, dict[str, float]]:
    corners = zip(("low", "high"), box_around(zone).tolist(), strict=True)
    return {end: dict(zip("xyz", corner, strict=True)) for end, corner in corners}


def _rounded(values: np.ndarray) -> list[Any]:
    numbers = values.tolist()  # Python's floats are formatted three times faster
    return [float(f"{number:.{_DIGITS}g}") if isfinite(number) else None for number in numbers]


def script_json(value: object) -> str:
    """Return a value as JSON text that is safe inside an HTML script element.

    The characters ``<`` and ``>`` are escaped, so that no text can end the element. Raises
    ValueError for NaN and infinity.
    """
    return json.dumps(value, allow_nan=False).replace("<", "\\u003c").replace(">", "\\u003e")
