"""Reach of a vehicle on one battery charge in a wind, one way or out and back.

The vehicle flies straight and level at the ground speed of least energy per metre, in the wind at
the start time. It climbs where terrain requires it, and ignores keep-out zones.

The usable charge is that above the least allowed state of charge. If it lasts for R metres in the
local wind, each metre uses the fraction 1 / R. Climbs and the way back use further fractions. The
reach ends where the sum of all fractions is 1. It ends earlier if the terrain or the wind field
ends, or if the wind is too strong.
"""

import json
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.interpolate import RegularGridInterpolator

from pyomo_quad.arrays import FloatArray
from pyomo_quad.flight import Planner
from pyomo_quad.flight.return_flight import climb_current
from pyomo_quad.flight.steady import SteadyFlight
from pyomo_quad.model.wind_field import is_wind_known
from pyomo_quad.polar.polar import COURSE, REACH, SteadyCurve, steady_curve
from pyomo_quad.report import Figures
from pyomo_quad.report.document import Drawing, write_study
from pyomo_quad.report.style import FULL_WIDTH, INK, MUTED, SERIES_STYLES
from pyomo_quad.scenario import Scenario
from pyomo_quad.version import __version__

#: Files of a report.
TABLE_NAME, OUTLINE_NAME = "reach.csv", "reach.geojson"
#: Columns of `Reach.boundary`, beside `COURSE` and `REACH`.
EAST, NORTH, IS_CUT = "x_m", "y_m", "is_cut"
_COURSES = 72  # number of courses, every 5 degrees
_STEPS = 400  # steps along each course, in the integral of the battery's share
# Speeds and angles of the wind between which the share of the pack per metre is interpolated.
_WIND_STEP_M_S, _ANGLES = 0.5, 37
# Samples of the ground per step of its grid, under a course.
_LOOKS_PER_CELL = 4
_SECONDS_PER_HOUR = 3600.0
_KILO = 1e-3


@dataclass(frozen=True, kw_only=True)
class Reach:
    """Boundary of the places that a vehicle reaches from its start on one battery charge.

    Attributes
    ----------
    scenario : Scenario
        Scenario with vehicle, start and wind.
    has_return : bool
        Whether the charge must also suffice for the flight back to the start.
    boundary : DataFrame
        Course `COURSE` from x, counter-clockwise; distance `REACH` and position `EAST`, `NORTH` of
        the boundary. `IS_CUT` states whether wind field or terrain ends there, so that the vehicle
        could fly farther.
    depth : float
        Usable fraction of the battery's capacity.
    """

    scenario: Scenario
    has_return: bool
    boundary: pd.DataFrame
    depth: float


def find_reach(scenario: Scenario, *, has_return: bool) -> Reach:
    """Compute how far a vehicle flies on one battery charge, on each course from its start.

    If `has_return`, the charge must also suffice for the flight back. Raises SolveError if the
    vehicle cannot hover, fly at 0.5 m/s within its limits, or climb over terrain.
    """
    planner = Planner()
    depth, steady = 1.0 - scenario.limits.least_charge, planner.steady_flight(scenario)
    curve = steady_curve(scenario, steady, depth)
    courses = np.linspace(0.0, 2.0 * np.pi, _COURSES, endpoint=False)
    # An upper bound on the distance: greatest airspeed with a tail wind of the same speed, for the
    # longest endurance.
    farthest = float(2.0 * curve.airspeeds[-1] * curve.endurances.max())
    along = np.linspace(0.0, farthest, _STEPS)
    headings = np.column_stack([np.cos(courses), np.sin(courses), np.zeros(_COURSES)])
    start = np.array(scenario.mission.start.position)
    places = start + along[None, :, None] * headings[:, None, :]
    # After a climb the vehicle stays at the new height. It returns at the heights of the way out.
    places[..., 2] = _heights(scenario, along, headings)
    is_known = is_wind_known(scenario, 0.0, places.reshape(-1, 3)).reshape(_COURSES, _STEPS)
    is_known &= _is_within_terrain(scenario, places)
    winds = np.zeros((*is_known.shape, 2))
    winds[is_known] = planner.winds_at(scenario, places[is_known])
    share = _shares(curve, winds, courses[:, None], has_return=has_return)
    # A climb takes charge but brings no progress.
    climbed = _share_per_climb(scenario, steady, curve) * (places[..., 2] - start[2])
    rows = [
        _boundary_on(course, along, share[k], climbed[k], is_known[k], start)
        for k, course in enumerate(courses.tolist())
    ]
    return Reach(scenario=scenario, has_return=has_return, boundary=pd.DataFrame(rows), depth=depth)


def _heights(scenario: Scenario, along: FloatArray, headings: FloatArray) -> FloatArray:
    """Return the heights z [m] of a vehicle that climbs where it must and never descends.

    `along` holds distances in equal steps [m], shape (n_steps,), and `headings` unit vectors, shape
    (n_courses, 3). The result has shape (n_courses, n_steps).
    """
    start, airspace = np.array(scenario.mission.start.position), scenario.airspace
    found = np.full((len(headings), along.size), start[2])
    if airspace.ground is None:
        return found
    parts = int(np.ceil(_LOOKS_PER_CELL * (along[1] - along[0]) / airspace.ground.least_step))
    fine = np.linspace(0.0, along[-1], parts * (along.size - 1) + 1)
    under = start + fine[None, :, None] * headings[:, None, :]
    # The vehicle keeps the floor, the least allowed height above ground.
    needed = start[2] - airspace.height_above_ground(under) + (airspace.floor or 0.0)
    return np.maximum(found, np.maximum.accumulate(needed, axis=1)[:, ::parts])


def _is_within_terrain(scenario: Scenario, places: FloatArray) -> NDArray[np.bool_]:
    """Return whether each place lies over the terrain of the scenario.

    `places` holds positions [m], shape (..., 3). All results are True if the scenario has no
    terrain.
    """
    within, ground = np.ones(places.shape[:-1], dtype=bool), scenario.airspace.ground
    for axis, side, end in () if ground is None else ground.edges.values():
        within &= side * (places[..., axis] - end) <= 0.0
    return within


def _share_per_climb(scenario: Scenario, steady: SteadyFlight, curve: SteadyCurve) -> float:
    """Return the fraction of the usable battery charge that one metre of climb takes [1/m].

    If the scenario gives no current for climbs, `steady` computes it. The airspeed is then the one
    of least energy per metre, from `curve`. Without terrain, the result is 0.
    """
    # Without terrain the flight is level.
    if scenario.airspace.ground is None:
        return 0.0
    told = scenario.mission.return_flight
    # Without a given current, the current is computed at the airspeed of least energy per metre in
    # calm air.
    current = told.climb_current or climb_current(
        scenario, steady, curve.best_over_ground().airspeed
    )
    usable = (1.0 - scenario.limits.least_charge) * steady.pack_capacity
    return current / told.climb_rate / _SECONDS_PER_HOUR / usable


def _shares(
    curve: SteadyCurve, winds: FloatArray, courses: FloatArray, *, has_return: bool
) -> FloatArray:
    """Return the fraction of the usable battery charge per metre over ground [1/m].

    `winds` are horizontal winds [m/s] at places along each course, shape (n_courses, n_places, 2).
    `courses` [rad] has shape (n_courses, 1). If `has_return`, the fraction includes the flight back
    over the same metre.
    """
    speed = np.hypot(winds[..., 0], winds[..., 1])
    angle = np.arctan2(winds[..., 1], winds[..., 0]) - courses
    per_metre = _share_per_metre(curve, speed)
    there = per_metre(speed, angle)
    return there + per_metre(speed, angle + np.pi) if has_return else there


def _share_per_metre(
    curve: SteadyCurve, winds: FloatArray
) -> Callable[[FloatArray, FloatArray], FloatArray]:
    """Return a function for the fraction of the usable charge per metre over ground [1/m].

    It takes speed [m/s] and angle [rad] of the wind, as `SteadyCurve.best_over_ground` does. It is
    infinite if the wind is too strong.
    """
    # The table spans the wind speeds of all later calls.
    low, high = float(winds.min()), float(winds.max())
    count = max(2, int(np.ceil((high - low) / _WIND_STEP_M_S)) + 1)
    speeds = np.linspace(low, max(high, low + _WIND_STEP_M_S), count)
    angles = np.linspace(0.0, np.pi, _ANGLES)
    ranges = np.array(
        [[curve.best_over_ground(w, float(a)).range_m for a in angles] for w in speeds]
    )
    held = RegularGridInterpolator((speeds, angles), ranges)

    def share(speed: FloatArray, angle: FloatArray) -> FloatArray:
        # The range is an even function of the angle, tabulated from 0 to pi.
        folded = np.abs(np.remainder(angle + np.pi, 2.0 * np.pi) - np.pi)
        found = held(np.stack([speed, folded], axis=-1))
        return np.divide(1.0, found, out=np.full(found.shape, np.inf), where=found > 0.0)

    return share


def _boundary_on(
    course: float,
    along: FloatArray,
    share: FloatArray,
    climbed: FloatArray,
    is_known: NDArray[np.bool_],
    start: FloatArray,
) -> dict[str, Any]:
    """Return the row of `Reach.boundary` for one course.

    Parameters
    ----------
    course : float
        The course [rad].
    along : ndarray
        Distances along the course [m]; the next three arrays have a value for each.
    share : ndarray
        Fraction of the usable charge per metre [1/m], infinite if the wind is too strong.
    climbed : ndarray
        Fraction of the usable charge that the climbs so far take.
    is_known : ndarray of bool
        Whether wind and terrain are given at this distance.
    start : ndarray
        Start position [m].
    """
    # If the vehicle returns, `share` includes the flight back over the same metre.
    pieces = np.diff(along) * (share[1:] + share[:-1]) / 2.0
    used = climbed + np.concatenate([[0.0], np.cumsum(pieces)])
    # The wind stops the vehicle at the first place to which a metre takes an infinite charge.
    # Sums stay infinite from there on.
    is_passable = np.isfinite(used)
    reached = float(np.interp(1.0, used[is_passable], along[is_passable]))
    # The flight also ends where wind or ground is unknown.
    unknown = np.flatnonzero(~is_known)
    known_to = float(along[max(unknown[0] - 1, 0)]) if unknown.size else np.inf
    distance = min(reached, known_to)
    return {
        COURSE: float(np.degrees(course)),
        REACH: distance,
        EAST: float(start[0] + distance * np.cos(course)),
        NORTH: float(start[1] + distance * np.sin(course)),
        IS_CUT: known_to < reached,
    }


def boundary_geojson(reach: Reach) -> dict[str, Any] | None:
    """Return the boundary of the places within reach as a GeoJSON polygon.

    The result is None if the scenario has no `mission.origin`, the position of x = y = 0 on earth.
    """
    origin = reach.scenario.mission.origin
    if origin is None:
        return None
    height = reach.scenario.mission.start.position[2]
    local = [[x, y, height] for x, y in reach.boundary[[EAST, NORTH]].to_numpy().tolist()]
    ring = [[lon, lat] for lat, lon, _ in origin.geodetic(np.array(local)).tolist()]
    return {
        "type": "FeatureCollection",
        "features": [
            {
                "type": "Feature",
                "properties": {"name": reach.scenario.name, "has_return": reach.has_return},
                "geometry": {"type": "Polygon", "coordinates": [[*ring, ring[0]]]},
            }
        ],
    }


def write_reach(folder: Path, reach: Reach, figures: Figures = Figures.SVG) -> dict[str, Any]:
    """Write the report of a vehicle's reach: boundary (CSV, GeoJSON), figure and text.

    `folder` must exist and be empty. The result is the content of `summary.json`.
    """
    outline = boundary_geojson(reach)
    if outline is not None:
        (folder / OUTLINE_NAME).write_text(json.dumps(outline, indent=1), encoding="utf-8")
    boundary, summary = reach.boundary, reach_summary(reach)
    write_study(
        folder,
        "polar/reach.md.j2",
        tables={TABLE_NAME: boundary},
        summary=summary,
        drawings=(Drawing("reach", "Within reach", _CAPTION, partial(draw_reach_map, reach)),),
        figures=figures,
        reach=reach,
        outline=OUTLINE_NAME if outline is not None else None,
        least=boundary.iloc[int(boundary[REACH].argmin())].to_dict(),
        most=boundary.iloc[int(boundary[REACH].argmax())].to_dict(),
        columns=(COURSE, REACH, IS_CUT),
        is_cut=bool(boundary[IS_CUT].any()),
    )
    return summary


def reach_summary(reach: Reach) -> dict[str, Any]:
    """Return a vehicle's reach as a dictionary for `summary.json`.

    The dictionary holds the least and the greatest reach over all courses [m], and the fraction of
    the battery's capacity that is used.
    """
    return {
        "scenario": reach.scenario.name,
        "has_return": reach.has_return,
        f"least_{REACH}": float(reach.boundary[REACH].min()),
        f"greatest_{REACH}": float(reach.boundary[REACH].max()),
        "share_of_pack_used": reach.depth,
        "is_cut_by_field": bool(reach.boundary[IS_CUT].any()),
        "version": __version__,
    }


_CAPTION = (
    "The boundary of what one pack reaches from the start, flown straight at the height of the "
    "start, or higher where the ground demands it. Arrows show the wind there; a dotted edge is "
    "where the wind field or the terrain ends before the pack does."
)
_ARROWS = 9  # along each side of the map


def draw_reach_map(reach: Reach) -> Figure:
    """Draw a map of the places that a vehicle reaches on one battery charge, and of the wind.

    The arrows show the wind at the height of the start. The boundary is dotted where the wind field
    or the terrain ends.
    """
    figure = Figure(figsize=(FULL_WIDTH, 5.2))
    axes = figure.add_axes((0.12, 0.1, 0.84, 0.86))
    start = np.array(reach.scenario.mission.start.position)
    boundary = reach.boundary
    ring = boundary[[EAST, NORTH]].to_numpy()
    closed = np.vstack([ring, ring[:1]]) * _KILO
    style = SERIES_STYLES[0]
    axes.fill(*closed.T, color=style.color, alpha=0.12, linewidth=0)
    whole = np.append(boundary[IS_CUT], boundary[IS_CUT].iloc[0]).astype(bool)
    axes.plot(*np.where(whole[:, None], np.nan, closed).T, color=style.color, linewidth=2)
    axes.plot(*np.where(whole[:, None], closed, np.nan).T, ":", color=style.color, linewidth=2)
    axes.plot(*(start[:2] * _KILO), "o", color=INK, markersize=6)
    axes.annotate("start", tuple(start[:2] * _KILO), (6, 6), textcoords="offset points", color=INK)
    _draw_winds(axes, reach)
    axes.set_aspect("equal", adjustable="datalim")
    axes.set(xlabel="x, east (km)", ylabel="y, north (km)")
    return figure


def _draw_winds(axes: Any, reach: Reach) -> None:  # noqa: ANN401  matplotlib's axes
    low, high = reach.boundary[[EAST, NORTH]].min(), reach.boundary[[EAST, NORTH]].max()
    x, y = (np.linspace(low[name], high[name], _ARROWS) for name in (EAST, NORTH))
    at_x, at_y = (held.ravel() for held in np.meshgrid(x, y))
    height = reach.scenario.mission.start.position[2]
    places = np.column_stack([at_x, at_y, np.full(at_x.size, height)])
    places = places[is_wind_known(reach.scenario, 0.0, places)]
    winds = Planner().winds_at(reach.scenario, places)
    fastest = float(np.hypot(*winds.T).max(initial=0.0))
    if fastest > 0.0:
        scale = fastest / ((x[1] - x[0]) * _KILO)  # the longest arrow reaches the next one
        axes.quiver(
            *(places[:, :2] * _KILO).T,
            *winds.T,
            color=MUTED,
            width=2.5e-3,
            scale=scale,
            scale_units="xy",
            angles="xy",
            zorder=3,
        )
        axes.set_title(f"longest arrow: {fastest:.1f} m/s", fontsize="small", loc="right")
