"""The interactive view of the paths in space, for the HTML report."""

import json
from collections.abc import Sequence
from typing import Any

import numpy as np
from plotly.offline import get_plotlyjs

from pyomo_quad.report.figures.path import distinct_paths, leaving_paths
from pyomo_quad.report.flights import StyledFlight
from pyomo_quad.report.signals import POSITION, POWER, TIME, VELOCITY
from pyomo_quad.report.style import INK, MUTED

__all__ = ["VIEW_ELEMENT", "view_markup", "view_script"]

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
    """Return the element that the view is drawn into.

    Returns
    -------
    str
        HTML, shown on a screen only.
    """
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
    """Return the program that draws the view, with all that it needs.

    Parameters
    ----------
    flights : sequence of StyledFlight
        The flights, the optimum first.

    Returns
    -------
    str
        JavaScript without any address to load from.
    """
    shown = [f for f in distinct_paths(flights) if f not in leaving_paths(flights)]
    paths = [_path(flight, is_shown=flight in shown) for flight in flights]
    data = [*paths, *_ends(flights[0])]
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


def _ends(optimum: StyledFlight) -> list[dict[str, Any]]:
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
