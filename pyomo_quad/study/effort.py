"""Estimate of the processor time that planning a mission takes, and of what makes it long.

Features of the mission that cost time are, for example, waypoints, keep-out zones and wind fields.
The estimate states how much time planning without each of them would save.

Ipopt's iterations take most of the time. The time of an iteration is proportional to the size of
the problem: variables per collocation point times points of the mesh. The solve may be repeated for
several meshes, routes and orders of the waypoints.

The constants were measured. The command `python -m tests.benchmarks resolve missions` compares
estimated with measured times.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from math import dist, inf, log10
from typing import TYPE_CHECKING

from pyomo_quad.flight.routes import NoRouteError, journeys_of
from pyomo_quad.flight.tour import BEST_FEW, legs_expected
from pyomo_quad.scenario.mission import Order

if TYPE_CHECKING:
    from pyomo_quad.scenario import Scenario

#: Factor by which estimated and measured time usually differ at most.
ROUGHLY = 3.0
# Processor time per unknown and iteration [s].
_PER_UNKNOWN_S = 9e-6
# Processor time to build and compile the model and to verify the plan [s].
_BESIDE_S = 0.3
# Ipopt iterations per mesh: of a flight of fixed duration from start to goal; of a flight with free
# times, waypoints or routes; and in addition for each waypoint.
_PLAIN, _MOVING, _PER_WAYPOINT = 8, 40, 3
# Average number of points of refined meshes, relative to the first mesh.
_FINER = 2.5
# Number of meshes: the first, and further meshes per decade of the tolerance.
_FIRST_MESHES, _PER_DECADE = 1.0, 0.8
# Least number of elements to compare routes, and largest number of routes that are refined.
_ROUTE_ELEMENTS, _MOST_REFINED = 20, 3
# Points and iterations of the solve of a single leg.
_LEG_POINTS, _LEG_ITERATIONS = 32, 20
# Relative increase of the time of an iteration by a wind table, and by a wind field.
_TABLE, _FIELD = 0.5, 0.8
# Tolerance of a quick solve, the reference for the extra time that a finer tolerance takes.
_QUICK = 1e-3


@dataclass(frozen=True, kw_only=True)
class Counts:
    """Features of a scenario that determine its planning time.

    Attributes
    ----------
    unknowns : int
        Variables per collocation point.
    elements, degree : int
        Elements of the first mesh, and polynomial degree.
    tolerance : float
        Relative error to which the mesh is refined.
    waypoints : int
        Number of waypoints.
    routes : int
        Routes round keep-out zones; 0 if no zone is in the way.
    legs : int
        Flights between two waypoints that are planned alone to find the best order; 0 for a given
        order.
    is_free, has_wind_table, has_wind_field : bool
        Whether the duration is free, the wind is a measured table, the wind is a field.
    cells : int
        Grid cells of wind field or terrain on the way, each with at least one element.
    """

    unknowns: int
    elements: int
    degree: int
    tolerance: float
    waypoints: int = 0
    routes: int = 0
    legs: int = 0
    is_free: bool = False
    has_wind_table: bool = False
    has_wind_field: bool = False
    cells: int = 0

    @property
    def seconds(self) -> float:
        """Estimated processor time of planning [s]."""
        is_moving = self.is_free or self.waypoints > 0 or self.routes > 0
        iterations = _MOVING + _PER_WAYPOINT * self.waypoints if is_moving else _PLAIN
        compared = _ROUTE_ELEMENTS if self.routes > 0 else 0
        elements = max(self.elements, self.waypoints + 1, compared, self.cells)
        slower = 1.0 + _TABLE * self.has_wind_table + _FIELD * self.has_wind_field
        each = _PER_UNKNOWN_S * self.unknowns * slower
        rough = each * iterations * elements * self.degree
        meshes = _FIRST_MESHES + _PER_DECADE * max(0.0, -log10(self.tolerance))
        refined = min(max(self.routes, 1), _MOST_REFINED)
        coarse = self.routes + (BEST_FEW if self.legs else 0)
        alone = each * _LEG_ITERATIONS * _LEG_POINTS * self.legs
        return _BESIDE_S + rough * (_FINER * meshes * refined + coarse) + alone


@dataclass(frozen=True, kw_only=True)
class Effort:
    """Estimated processor time of planning a scenario, and the contributions of its features.

    Attributes
    ----------
    seconds : float
        Estimated processor time of planning.
    features : tuple of (str, float)
        Costly features in words, each with the time that planning without this feature would save
        [s]. The feature with the largest time is first. The sum of the times differs from
        `seconds`, because the effects of the features multiply.
    """

    seconds: float
    features: tuple[tuple[str, float], ...]

    @property
    def line(self) -> str:
        """The estimate as one line of text."""
        said = (
            f"roughly {_rounded(self.seconds)} s of a processor, a guess from counts that may be "
            f"off by a factor of {ROUGHLY:g}"
        )
        if not self.features:
            return f"{said}."
        parts = ", ".join(f"{name} {_rounded(spent)} s" for name, spent in self.features)
        return f"{said}; longest first: {parts}."


def _rounded(seconds: float) -> str:
    return f"{seconds:.1g}" if seconds < 10.0 else f"{seconds:.2g}"


def estimate_effort(scenario: Scenario, unknowns: int) -> Effort:
    """Estimate the processor time of planning a scenario, and the contributions of its features.

    `unknowns` is the number of variables per collocation point.
    """
    counts = counts_of(scenario, unknowns)
    without = {
        f"{counts.routes} way{'s' * (counts.routes > 1)} round the zones": {"routes": 0},
        f"{counts.waypoints} waypoint{'s' * (counts.waypoints > 1)}": {"waypoints": 0, "legs": 0},
        f"order of the waypoints, {counts.legs} legs alone": {"legs": 0},
        "free duration": {"is_free": False},
        "wind table": {"has_wind_table": False},
        "wind field": {"has_wind_field": False},
        f"{counts.cells} cells of wind field or terrain": {"cells": 0},
        f"accuracy of {counts.tolerance:g}": {"tolerance": max(_QUICK, counts.tolerance)},
    }
    added = {
        name: counts.seconds - replace(counts, **fewer).seconds  # type: ignore[arg-type]
        for name, fewer in without.items()
    }
    dearest = sorted(added.items(), key=lambda entry: -entry[1])
    return Effort(
        seconds=counts.seconds,
        features=tuple((name, spent) for name, spent in dearest if spent > 0.0),
    )


def counts_of(scenario: Scenario, unknowns: int) -> Counts:
    """Count the features of a scenario that determine its planning time.

    `unknowns` is the number of variables per collocation point.
    """
    mission, solver = scenario.mission, scenario.solver
    try:
        journeys = journeys_of(scenario)
    except NoRouteError:
        journeys = ()
    is_between_zones = any(route.sides for journey in journeys for route in journey)
    is_open = mission.order is Order.BEST and bool(mission.waypoints)
    return Counts(
        unknowns=unknowns,
        elements=solver.elements,
        degree=solver.degree,
        tolerance=solver.tolerance,
        waypoints=len(mission.waypoints),
        routes=len(journeys) if is_between_zones else 0,
        legs=legs_expected(len(mission.waypoints)) if is_open else 0,
        is_free=mission.is_free,
        has_wind_table=scenario.wind.series is not None,
        has_wind_field=scenario.wind.grid is not None,
        cells=_cells(scenario),
    )


def _cells(scenario: Scenario) -> int:
    """Estimate how many grid cells of the wind field or of the terrain a mission's legs cross.

    The estimate is (horizontal length of all legs) / (least step of the grids), 0 without a grid.
    """
    field, ground = scenario.wind.grid, scenario.airspace.ground
    steps = [] if field is None else [after - at for at, after in pairwise(field.x)]
    steps += [] if field is None else [after - at for at, after in pairwise(field.y)]
    steps += [] if ground is None else [ground.least_step]
    way = sum(dist(start[:2], end[:2]) for start, end in pairwise(scenario.mission.positions))
    return round(way / min(steps, default=inf))
