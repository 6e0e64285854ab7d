"""The paths in space: the paper's figures 4 and 6, and the interactive view of the page.

The optimum is the first of the flights.
"""

import json
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d.axes3d import Axes3D  # type: ignore[import-untyped]
from plotly.offline import get_plotlyjs

from pyomo_quad.report.style import (
    FULL_WIDTH,
    INK,
    MUTED,
    PALE,
    POSITION,
    POWER,
    TICK_STEPS,
    TIME,
    VELOCITY,
    Signal,
    StyledFlight,
    legend_below,
)

_PROJECTIONS = ((0, 1, "from above"), (0, 2, "from the front"), (1, 2, "from the side"))
BEAT_COUNT = 5  # markers at equal times along each path: wide apart means fast
# As shares of the size of the optimum's path: nearer, two lines cannot be told apart; further, a
# flight leaves the picture.
COINCIDENT, ASTRAY = 0.02, 1.0
_MARGIN = 0.08
_MOST_TICKS = 9
_SMALLEST_SIDE = 0.2  # m


def distinct_paths(flights: Sequence[StyledFlight]) -> tuple[StyledFlight, ...]:
    """Leave out the flights that stay on the optimum's path all the time."""
    return (flights[0], *_further(flights, COINCIDENT))


def draw_path(flights: Sequence[StyledFlight]) -> Figure:
    """Draw all paths in space, and seen along each axis."""
    figure = Figure(figsize=(FULL_WIDTH, FULL_WIDTH))
    limits = _limits(flights)
    space: Axes3D = figure.add_axes((0.0, 0.53, 0.5, 0.46), projection="3d")
    draw_space(space, flights)
    boxes = ((0.575, 0.595, 0.405, 0.37), (0.075, 0.115, 0.405, 0.37), (0.575, 0.115, 0.405, 0.37))
    for (across, up, title), box in zip(_PROJECTIONS, boxes, strict=True):
        _draw_projection(figure.add_axes(box), flights, limits, (across, up), title)
    legend_below(figure, space)
    return figure


def draw_space(axes: Axes3D, flights: Sequence[StyledFlight]) -> None:
    """Draw all paths in space."""
    limits = _limits(flights)
    floor = limits[2, 0]
    for flight in flights:
        track, beats = (_inside(points, limits) for points in (_track(flight), _beats(flight)))
        shadow = np.full(len(track), floor)
        axes.plot(track[:, 0], track[:, 1], shadow, color=PALE, linewidth=1.0)
        axes.plot(*track.T, label=flight.name, **flight.style.line)
        axes.plot(*beats.T, **_marker(flight))
    for end, name, shape in _ends(flights[0]):
        axes.plot([end[0]] * 2, [end[1]] * 2, [floor, end[2]], color=MUTED, linewidth=0.6)
        axes.plot(*end[:, None], marker=shape, color=INK, markersize=6, linestyle="none")
        axes.text(*end, f"{name}  ", va="bottom", ha="right")
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
        axis.set_label_text(_axis_label(signal))
        axis.labelpad = -4
        axis.set_tick_params(pad=-2)
        axis._axinfo["grid"].update(color="#e4e4e4", linewidth=0.5)  # noqa: SLF001


def leaving_paths(flights: Sequence[StyledFlight]) -> tuple[StyledFlight, ...]:
    """Return the flights that go so far astray that showing all of them would hide the others."""
    return _further(flights, ASTRAY)


def _further(flights: Sequence[StyledFlight], share: float) -> tuple[StyledFlight, ...]:
    optimum, *others = flights
    time, track = TIME.of(optimum.frame), _track(optimum)
    allowed = share * max(float(np.linalg.norm(np.ptp(track, axis=0))), _SMALLEST_SIDE)
    return tuple(f for f in others if _distance(f, time, track) > allowed)


def _limits(flights: Sequence[StyledFlight]) -> np.ndarray:
    astray = leaving_paths(flights)
    points = np.concatenate([_track(flight) for flight in flights if flight not in astray])
    low, high = points.min(axis=0), points.max(axis=0)
    middle = (low + high) / 2
    half = np.maximum(high - low, _SMALLEST_SIDE) / 2 * (1 + 2 * _MARGIN)
    return np.column_stack([middle - half, middle + half])


def _track(flight: StyledFlight) -> np.ndarray:
    return np.column_stack([signal.of(flight.frame) for signal in POSITION])


def _distance(flight: StyledFlight, time: np.ndarray, track: np.ndarray) -> float:
    """Return the largest distance of two flights at one time, m."""
    own_time = TIME.of(flight.frame)
    own = np.column_stack([np.interp(time, own_time, axis) for axis in _track(flight).T])
    return float(np.linalg.norm(own - track, axis=1).max())


def _beats(flight: StyledFlight) -> np.ndarray:
    time = TIME.of(flight.frame)
    beats = np.linspace(time[0], time[-1], BEAT_COUNT + 1)[1:-1]
    return np.column_stack([np.interp(beats, time, axis) for axis in _track(flight).T])


def _inside(points: np.ndarray, limits: np.ndarray) -> np.ndarray:
    """Return points with those left out that a view in space would draw outside its axes."""
    is_inside = np.all((limits[:, 0] <= points) & (points <= limits[:, 1]), axis=1)
    return np.where(is_inside[:, None], points, np.nan)


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
    axes.set(xlabel=_axis_label(across), ylabel=_axis_label(up), title=f"Seen {title}")
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
    track = _track(optimum)
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


def _axis_label(signal: Signal) -> str:
    return f"${signal.symbol}$ ({signal.unit})"


VIEW_ELEMENT = "flight-view"

_SAMPLES = 201
_DECIMALS = 4
_HOVER_TEXT = (
    "<b>%{fullData.name}</b><br>t = %{customdata[0]:.2f} s<br>"
    "x, y, z = %{x:.2f}, %{y:.2f}, %{z:.2f} m<br>"
    "speed %{customdata[1]:.2f} m/s, power %{customdata[2]:.1f} W<extra></extra>"
)
_CONFIG = {
    "displaylogo": False,
    "modeBarButtons": [["toImage"], ["zoom3d", "pan3d", "tableRotation"], ["resetCameraDefault3d"]],
    "responsive": True,
    "scrollZoom": False,  # the wheel scrolls the page
}


def view_markup() -> str:
    """Return the element that the view is drawn into."""
    return (
        f'<div id="{VIEW_ELEMENT}" class="view screen" role="img" '
        'aria-label="Interactive view of the paths in space; the next figure shows the same '
        'paths."></div>'
        '<p class="note screen">Drag to turn, pinch or use the buttons to zoom; touch a path to '
        "read it, a name to show or hide it.</p>"
        "<noscript><p>The interactive view needs JavaScript; the next figure shows the same "
        "paths.</p></noscript>"
    )


def view_script(flights: Sequence[StyledFlight]) -> str:
    """Return the program that draws the view, with all that it needs."""
    shown = [f for f in distinct_paths(flights) if f not in leaving_paths(flights)]
    paths = [_path(flight, is_shown=flight in shown) for flight in flights]
    data = [*paths, *_end_marks(flights[0])]
    arguments = ", ".join(_json(part) for part in (VIEW_ELEMENT, data, _layout(), _CONFIG))
    return f"{get_plotlyjs()}\nPlotly.newPlot({arguments});"


def _path(flight: StyledFlight, *, is_shown: bool) -> dict[str, Any]:
    frame = flight.frame
    rows = np.unique(np.linspace(0, len(frame) - 1, _SAMPLES).round().astype(int))
    shown = frame.iloc[rows]
    speed = np.linalg.norm([signal.of(shown) for signal in VELOCITY], axis=0)
    said = np.column_stack([TIME.of(shown), speed, POWER.of(shown)])
    place = {axis: _rounded(signal.of(shown)) for axis, signal in zip("xyz", POSITION, strict=True)}
    return {
        "type": "scatter3d",
        "mode": "lines",
        "name": flight.name,
        "visible": True if is_shown else "legendonly",
        **place,
        "customdata": _rounded(said),
        "hovertemplate": _HOVER_TEXT,
        "line": {"color": flight.style.color, "width": 6, "dash": flight.style.dash_name},
    }


def _end_marks(optimum: StyledFlight) -> list[dict[str, Any]]:
    track = np.column_stack([signal.of(optimum.frame) for signal in POSITION])
    return [
        {
            "type": "scatter3d",
            "mode": "markers+text",
            "text": [name],
            "textposition": "top center",
            **{axis: _rounded(value[None]) for axis, value in zip("xyz", place, strict=True)},
            "hoverinfo": "skip",
            "showlegend": False,
            "marker": {"color": INK, "size": 5, "symbol": symbol},
        }
        for name, place, symbol in (("start", track[0], "circle"), ("goal", track[-1], "diamond"))
    ]


def _layout() -> dict[str, Any]:
    axes = {
        f"{axis}axis": {
            "title": {"text": f"{signal.symbol} ({signal.unit})"},
            "backgroundcolor": "white",
            "gridcolor": "#d0d0d0",
            "zerolinecolor": MUTED,
        }
        for axis, signal in zip("xyz", POSITION, strict=True)
    }
    return {
        "autosize": True,
        "font": {"color": INK, "size": 13},
        "legend": {"itemwidth": 46, "orientation": "h", "x": 0, "y": 0, "yanchor": "top"},
        "margin": {"l": 0, "r": 0, "t": 0, "b": 0},
        "paper_bgcolor": "white",
        "scene": {
            **axes,
            "aspectmode": "data",
            "camera": {
                "center": {"x": 0, "y": 0, "z": -0.12},
                "eye": {"x": 1.3, "y": -2.0, "z": 0.75},
            },
            "dragmode": "turntable",
        },
    }


def _rounded(values: np.ndarray) -> list[Any]:
    return np.round(values, _DECIMALS).tolist()


def _json(value: object) -> str:
    # No text can end the script or start a comment in it.
    return json.dumps(value, allow_nan=False).replace("<", "\\u003c").replace(">", "\\u003e")
