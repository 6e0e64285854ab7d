"""Estimate of the processor time that planning a mission takes, and of its costly features.

A solve takes the time of Ipopt's iterations, which is proportional to the number of unknowns:
variables per collocation point, times points of the mesh, times the meshes, routes and orders that
are tried.  These numbers are known before the solve.  The constants were measured by
`python -m tests.benchmarks resolve missions`, whose tables compare estimates with measured times.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import log10
from typing import TYPE_CHECKING

from pyomo_quad.flight.routes import NoRouteError, find_journeys
from pyomo_quad.flight.tour import BEST_FEW, legs_expected
from pyomo_quad.scenario.mission import Order

if TYPE_CHECKING:
    from pyomo_quad.scenario import Scenario

#: Factor by which the estimate is usually off at most.
ROUGHLY = 3.0
# Seconds of a processor per unknown and iteration.
_PER_UNKNOWN_S = 9e-6
# Seconds to build, compile and fly the plan.
_BESIDE_S = 0.3
# Iterations per mesh: of a plain flight; of a flight with free times, waypoints or routes; and in
# addition for each waypoint.
_PLAIN, _MOVING, _PER_WAYPOINT = 8, 40, 3
# Average number of points of refined meshes, relative to the first mesh.
_FINER = 2.5
# Number of meshes: the first, and further meshes per decade of the tolerance.
_FIRST_MESHES, _PER_DECADE = 1.0, 0.8
# Least number of elements to compare routes, and largest number of routes that are refined.
_ROUTE_ELEMENTS, _MOST_REFINED = 20, 3
# Points and iterations of the solve of a single leg.
_LEG_POINTS, _LEG_ITERATIONS = 32, 20
# Relative increase of the time of an iteration by a wind table.
_TABLE = 0.5
# Tolerance of a quick solve, with which the cost of the required accuracy is compared.
_QUICK = 1e-3


@dataclass(frozen=True, kw_only=True)
class Counts:
    """Features of a scenario that determine its planning time.

    `unknowns` is the number per collocation point; `routes` is 0 without zones in the way; `legs`
    is the number of legs solved to find the order of the waypoints, 0 for a given order.
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

    @property
    def seconds(self) -> float:
        """Estimated processor time of planning, s."""
        is_moving = self.is_free or self.waypoints > 0 or self.routes > 0
        iterations = _MOVING + _PER_WAYPOINT * self.waypoints if is_moving else _PLAIN
        elements = max(self.elements, self.waypoints + 1, _ROUTE_ELEMENTS if self.routes > 0 else 0)
        each = _PER_UNKNOWN_S * self.unknowns * (1.0 + _TABLE * self.has_wind_table)
        rough = each * iterations * elements * self.degree
        meshes = _FIRST_MESHES + _PER_DECADE * max(0.0, -log10(self.tolerance))
        refined = min(max(self.routes, 1), _MOST_REFINED)
        coarse = self.routes + (BEST_FEW if self.legs else 0)
        alone = each * _LEG_ITERATIONS * _LEG_POINTS * self.legs
        return _BESIDE_S + rough * (_FINER * meshes * refined + coarse) + alone


@dataclass(frozen=True, kw_only=True)
class Effort:
    """Estimated processor time of planning, and the share of each feature in it.

    `features` are named as a user knows them, the dearest first; seconds of several together are
    less than their sum or more, for they multiply.
    """

    seconds: float
    features: tuple[tuple[str, float], ...]

    @property
    def line(self) -> str:
        """Estimate as a line of text."""
        said = (
            f"roughly {_rounded(self.seconds)} s of a processor, a guess from counts that may be "
            f"off by a factor of {ROUGHLY:g}"
        )
        if not self.features:
            return f"{said}."
        parts = ", ".join(f"{name} {_rounded(spent)} s" for name, spent in self.features)
        return f"{said}; dearest first: {parts}."


def _rounded(seconds: float) -> str:
    return f"{seconds:.1g}" if seconds < 10.0 else f"{seconds:.2g}"


def estimate_effort(scenario: Scenario, unknowns: int) -> Effort:
    """Estimate the processor time of planning a scenario, and the share of each feature.

    Parameters
    ----------
    scenario : Scenario
    unknowns : int
        Functions of time of its model: states and other variables.
    """
    counts = counts_of(scenario, unknowns)
    without = {
        f"{counts.routes} way{'s' * (counts.routes > 1)} round the zones": {"routes": 0},
        f"{counts.waypoints} waypoint{'s' * (counts.waypoints > 1)}": {"waypoints": 0, "legs": 0},
        f"order of the waypoints, {counts.legs} legs alone": {"legs": 0},
        "free duration": {"is_free": False},
        "wind table": {"has_wind_table": False},
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
    """Count the features of a scenario that determine its planning time."""
    mission, solver = scenario.mission, scenario.solver
    try:
        journeys = find_journeys(scenario.airspace, mission.positions)
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
    )
