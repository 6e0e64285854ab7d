"""The airspace: floor, ceiling, fence, borders of terrain and wind data, and keep-out zones.

A keep-out zone is a region that flights must avoid. A zone is the intersection of one or more
balls. A ball (the class `scenario.airspace.Ball`) contains the places within a radius of its
centre. If the distance from the centre is measured in one coordinate, the ball is an interval; in
two, it is a disk; in three, a sphere. These coordinates are the axes of the ball.

symbol | name | unit | meaning
c_k | centre[zone, ball, axis] | m | centre of ball k of a zone, on the axes of the ball
n_k | normal[zone, ball, axis] | - | direction across an edge of a polygon, of length one
R_k | radius[zone, ball] | m | radius of ball k
c | clearance | m | distance kept from every zone
d_k | beyond[zone, ball] | m | distance of the vehicle from ball k (negative inside), minus c
w | edge_width | m | width over which two faces of a zone are blended, 0.5 m

zone | balls
cylinder | a disk and an interval of height
box | three intervals
prism over a convex polygon | an interval across each edge, and an interval of height

A place is outside the zone if max(d_k) > 0. In the model, a smooth lower bound of this maximum must
not be negative. Every place inside the zone is thus forbidden. Beside an edge, where two of the d_k
differ by less than about w, some places outside the zone are forbidden, too. Their distance from
the zone is at most 0.14 w = 70 mm, and at the corners of a box at most 0.28 w = 140 mm. Near a
corner of a prism, more than two of the d_k may be nearly equal. If j of them are, the distance is
at most (j - 1) 0.14 w. Away from the edges, exactly the zone is forbidden. The clearance moves each
face outwards by the distance c, and leaves the edges between the faces sharp. Only the smooth bound
rounds them.

The fence (`keep_in`) is a convex polygon in x and y, which flights must not leave. Each of its
edges gives a linear limit of the position, which is exact, also at the corners. The clearance does
not apply to the fence.

Over terrain, floor and ceiling limit the height above the ground, which the module `model.ground`
declares. Flights stay within the edges of the terrain's grid, where the ground is known. They also
stay within the grid of a wind field, unless the scenario's `wind.beyond` is "hold". Bottom and top
of a zone are coordinates z, and not heights above the ground.

A start, goal or waypoint inside a zone or on its surface is an error: on the surface, even the
smallest deviation towards the zone would violate the limit. Waypoints with a radius are exempt.
"""

from collections.abc import Mapping, Sequence
from functools import partial, reduce
from typing import Any

import numpy as np
from pyomo.core import Block, ConcreteModel, Constraint, sqrt
from pyomo.core.base.units_container import units
from pyomo.core.expr import NumericExpression, RelationalExpression

from pyomo_quad.model.ground import height_above_ground
from pyomo_quad.model.parameters import (
    Parameter,
    declare_parameters,
    fields_of,
    parameters_in,
    saturated,
)
from pyomo_quad.model.rigid_body import PLACE
from pyomo_quad.scenario import Scenario, ScenarioError
from pyomo_quad.scenario.airspace import Ball, KeepOut
from pyomo_quad.scenario.messages import shown
from pyomo_quad.scenario.wind import Beyond

AXES = PLACE[:3]
EDGE_WIDTH_M = 0.5
# Largest distance outside a box's corners at which places are forbidden.
_EDGE_M = 0.28 * EDGE_WIDTH_M
# The distance from a centre is not differentiable there; this smoothing keeps the surface in place.
_ROUNDING_M = 1e-3
# Distance from a forbidden place below which a place counts as on the surface: half of the
# tolerance on a flight's position.
_TOUCHING_M = 5e-5


@parameters_in("airspace")
def parameters_of(scenario: Scenario) -> tuple[Parameter, ...]:
    """Return the parameters that the model of a scenario declares in its block `airspace`.

    They define floor, ceiling, fence, keep-out zones, and the borders of the terrain and wind data.
    """
    return _OF_ALL + (_OF_ZONES if scenario.airspace.keep_out else ())


def _fence_normals(scenario: Scenario) -> dict[tuple[int, str], float]:
    fence = scenario.airspace.keep_in
    edges = () if fence is None else fence.edges
    return {
        (number, axis): share
        for number, (normal, _) in enumerate(edges, start=1)
        for axis, share in zip(AXES[:2], normal, strict=True)
    }


def _fence_ends(scenario: Scenario) -> dict[int, float]:
    fence = scenario.airspace.keep_in
    edges = () if fence is None else fence.edges
    return {number: end for number, (_, end) in enumerate(edges, start=1)}


def _edges(scenario: Scenario) -> dict[str, tuple[int, float, float]]:
    ground = scenario.airspace.ground
    return {} if ground is None else ground.edges


def field_edges(scenario: Scenario) -> dict[str, tuple[int, float, float]]:
    """Return the edges of the wind field that flights must not cross, by name.

    Names are "west", "east", "south", "north" and, if the field varies with height, "bottom" and
    "top". Values are axis (0, 1, 2), side (-1 lower, 1 upper) and coordinate [m]. Without a field,
    or if flights may leave it, there are none.
    """
    wind = scenario.wind
    return {} if wind.grid is None or wind.beyond is Beyond.HOLD else wind.grid.edges


def _normals(scenario: Scenario) -> dict[tuple[str, int, str], float]:
    return {
        (zone.name, number, AXES[axis]): share
        for zone in scenario.airspace.keep_out
        for number, ball in enumerate(zone.balls, start=1)
        for axis, share in enumerate(ball.normal or ())
    }


def _centres(scenario: Scenario) -> dict[tuple[str, int, str], float]:
    return {
        (zone.name, number, AXES[axis]): coordinate
        for zone in scenario.airspace.keep_out
        for number, ball in enumerate(zone.balls, start=1)
        for axis, coordinate in zip(*_axes_and_centre(ball), strict=True)
    }


def _axes_and_centre(ball: Ball) -> tuple[tuple[int, ...], tuple[float, ...]]:
    """Return the axes in which a ball measures distances, and its centre on these axes [m].

    For an interval across a polygon's edge, the axes are x and y. The centre is s n, with the
    edge's unit normal n and the interval's middle s.
    """
    if ball.normal is None:
        return ball.axes, ball.centre
    (out,) = ball.centre
    return (0, 1), (out * ball.normal[0], out * ball.normal[1])


def _radii(scenario: Scenario) -> dict[tuple[str, int], float]:
    return {
        (zone.name, number): ball.radius
        for zone in scenario.airspace.keep_out
        for number, ball in enumerate(zone.balls, start=1)
    }


_OF_ALL = (
    *fields_of("airspace", "floor", "ceiling"),
    Parameter(
        name="fence_normal",
        units=units.dimensionless,
        value=_fence_normals,
        doc="outward direction across an edge of the fence",
    ),
    Parameter(
        name="fence_end",
        units=units.m,
        value=_fence_ends,
        doc="distance of an edge of the fence along its normal",
    ),
    Parameter(
        name="terrain_end",
        units=units.m,
        value=lambda s: {name: end for name, (_, _, end) in _edges(s).items()},
        doc="coordinate of an edge of the terrain",
    ),
    Parameter(
        name="field_end",
        units=units.m,
        value=lambda s: {name: end for name, (_, _, end) in field_edges(s).items()},
        doc="coordinate of an edge of the wind field",
    ),
)
_OF_ZONES = (
    *fields_of("airspace", "clearance"),
    Parameter(
        name="edge_width",
        units=units.m,
        value=lambda _s: EDGE_WIDTH_M,
        doc="width over which two faces of a zone are blended",
    ),
    Parameter(
        name="rounding",
        units=units.m,
        value=lambda _s: _ROUNDING_M,
        doc="distance from a centre below which the distance is smoothed",
    ),
    Parameter(
        name="centre",
        units=units.m,
        value=_centres,
        doc="centres of the balls that overlap in a zone",
    ),
    Parameter(
        name="radius", units=units.m, value=_radii, doc="radii of the balls that overlap in a zone"
    ),
    Parameter(
        name="normal",
        units=units.dimensionless,
        value=_normals,
        doc="directions across the edges of polygons",
    ),
)


def declare_airspace(m: ConcreteModel, scenario: Scenario) -> None:
    """Declare the limits of the airspace as path constraints in block `airspace`.

    Limits that the scenario does not set are left out. If start, goal or a waypoint without radius
    lies in or on a keep-out zone, a ScenarioError is raised.
    """
    _refuse_touching(scenario)
    b = m.airspace = Block(doc="airspace")
    declare_parameters(b, scenario)
    if scenario.airspace.floor is not None:

        @b.Constraint(m.time, doc="least height [m]")
        def floor_limit(b: Block, t: float) -> RelationalExpression:
            return height_above_ground(m, t) >= b.floor

    if scenario.airspace.ceiling is not None:

        @b.Constraint(m.time, doc="largest height [m]")
        def ceiling_limit(b: Block, t: float) -> RelationalExpression:
            return height_above_ground(m, t, -1) <= b.ceiling

    for of_grid, limit, parameter, doc in (
        (_edges(scenario), "terrain_edge", "terrain_end", "inside of the terrain [m]"),
        (field_edges(scenario), "field_edge", "field_end", "inside of the wind field [m]"),
    ):
        if of_grid:
            inside = partial(_inside, of_grid, parameter)
            b.add_component(limit, Constraint(list(of_grid), m.time, rule=inside, doc=doc))

    if scenario.airspace.keep_in is not None:

        @b.Constraint(list(_fence_ends(scenario)), m.time, doc="inside of the fence [m]")
        def keep_in(b: Block, edge: int, t: float) -> RelationalExpression:
            body = b.parent_block().rigid_body
            out = sum(b.fence_normal[edge, axis] * body.component(axis)[t] for axis in AXES[:2])
            return out <= b.fence_end[edge]

    if scenario.airspace.keep_out:
        _declare_keep_outs(b, m, scenario)


def _inside(
    edges: Mapping[str, tuple[int, float, float]], parameter: str, b: Block, edge: str, t: float
) -> RelationalExpression:
    """Return the constraint that keeps the vehicle inside one edge of a data grid, at time t [s].

    `edges` gives axis and side (-1 lower, 1 upper) of each edge by name. The coordinate [m] is that
    of the Pyomo parameter `parameter`, indexed by `edge`.
    """
    axis, side, _ = edges[edge]
    out = b.parent_block().rigid_body.component(AXES[axis])[t] - b.component(parameter)[edge]
    return side * out <= 0.0 * units.m


def _declare_keep_outs(b: Block, m: ConcreteModel, scenario: Scenario) -> None:
    @b.Expression(list(_radii(scenario)), m.time, doc="distance beyond a ball of a zone [m]")
    def beyond(b: Block, zone: str, ball: int, t: float) -> NumericExpression:
        body = b.parent_block().rigid_body
        axes = [axis for axis in AXES if (zone, ball, axis) in b.centre]
        off = {axis: body.component(axis)[t] - b.centre[zone, ball, axis] for axis in axes}
        normal = b.component("normal")
        if normal is not None and (zone, ball, AXES[0]) in normal:
            squared = sum(normal[zone, ball, axis] * off[axis] for axis in axes) ** 2
        else:
            squared = sum(off[axis] ** 2 for axis in axes)
        return _distance_outside(squared, b.radius[zone, ball] + b.clearance, b.rounding)

    # A named expression for each step: otherwise each step would repeat the one before twice.
    @b.Expression(list(_radii(scenario)), m.time, doc="largest distance so far, smoothed [m]")
    def largest(b: Block, zone: str, ball: int, t: float) -> NumericExpression:
        distance = b.beyond[zone, ball, t]
        if ball == 1:
            return distance
        return saturated(b.largest[zone, ball - 1, t], distance, b.edge_width)

    @b.Constraint(
        [zone.name for zone in scenario.airspace.keep_out], m.time, doc="outside of a zone [m]"
    )
    def keep_out(b: Block, zone: str, t: float) -> RelationalExpression:
        last = max(ball for name, ball in b.radius if name == zone)
        return b.largest[zone, last, t] >= 0


def _distance_outside(squared_distance: Any, radius: Any, rounding: Any) -> Any:
    """Return the distance of a place from the surface of a ball, negative inside the ball [m].

    The length `rounding` [m] makes the result differentiable at the centre; it does not move the
    surface.
    """
    return sqrt(squared_distance + rounding**2) - sqrt(radius**2 + rounding**2)


def _refuse_touching(scenario: Scenario) -> None:
    """Raise a ScenarioError if a start, goal or waypoint without radius touches a keep-out zone.

    The zone includes its clearance and its smoothed edges.
    """
    told, mission = scenario.airspace, scenario.mission
    # A waypoint with a radius may be passed away from the surface.
    is_exact = (True, *(waypoint.radius == 0.0 for waypoint in mission.waypoints), True)
    for (field, place), has_no_room in zip(mission.named_positions, is_exact, strict=True):
        for zone in told.keep_out if has_no_room else ():
            if _smoothed_distance(zone, told.clearance, place) < _TOUCHING_M:
                outside = max(0.0, -float(zone.depth(place)) - told.clearance)
                rounded = (
                    f", beside an edge, which is rounded outwards by up to {_EDGE_M:g} m"
                    if outside >= _TOUCHING_M
                    else ""
                )
                raise ScenarioError(
                    f"{scenario.name}: {field} = {shown(list(place))} m touches keep-out "
                    f"{told.with_clearance(zone)}: it is {outside:.3g} m from the wall{rounded}; "
                    "move one of them."
                )


def _smoothed_distance(zone: KeepOut, clearance: float, place: Sequence[float]) -> float:
    """Return the smoothed distance of a place from a zone, less the clearance [m].

    The result is negative where the path constraint `keep_out` forbids the place.
    """
    distances = [
        _distance_outside(
            float(np.sum((ball.coordinates(place) - ball.centre) ** 2)),
            ball.radius + clearance,
            _ROUNDING_M,
        )
        for ball in zone.balls
    ]
    return float(reduce(lambda one, other: saturated(one, other, EDGE_WIDTH_M), distances))
