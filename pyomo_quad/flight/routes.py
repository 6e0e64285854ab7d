"""Shortest routes round keep-out zones and over terrain, and flights of an autopilot along a route.

Routes of one homotopy class pass every zone on the same side: left, right, over or under. A route
is the shortest path of its class in a graph of points round the zones. Murty's method finds routes
in order of length [1]_.

Cruise is the flight of an autopilot along straight lines at one speed, with limited jerk [2]_ and a
stop at every corner and waypoint. A leg leads from one waypoint to the next. A journey is a
sequence of routes, one for each leg.

.. [1] Murty, "An algorithm for ranking all the assignments in order of increasing cost", Operations
   Research 16 (1968).
.. [2] Biagiotti and Melchiorri, "Trajectory Planning for Automatic Machines and Robots", Springer
   2008, section 3.4.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from heapq import heappop, heappush
from itertools import pairwise
from math import sqrt
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from pyomo_quad.arrays import FloatArray
from pyomo_quad.flight.climbs import over_the_ground
from pyomo_quad.flight.references import SampledPath, stops_of
from pyomo_quad.flight.zones import (
    MARGIN_M,
    ROUNDING,
    Side,
    are_blocked,
    places_beside,
    sides_passed,
    zones_hit,
)
from pyomo_quad.model.airspace import field_edges
from pyomo_quad.scenario import Scenario, ScenarioError
from pyomo_quad.scenario.airspace import Airspace, KeepIn, KeepOut
from pyomo_quad.scenario.tables import CruiseSettings

Place = tuple[float, float, float]

#: Largest number of routes (each the shortest of its homotopy class), and their largest length
#: relative to the shortest route: a detour that doubles the length saves no energy.
MOST_ROUTES = 8
_LONGEST = 2.0


@dataclass(frozen=True, kw_only=True)
class Route:
    """Route of straight lines from a start to a goal.

    Attributes
    ----------
    places : ndarray, shape (n, 3)
        Corners, with start and goal [m].
    sides : tuple of (str, Side)
        Name of each zone passed, and the side.
    label : str
        Name of a route through a wind field, such as "corridor 1"; otherwise empty.
    estimate_J : float or None
        Energy of steady flight along the route, estimated in a wind field [J]; None if it was not
        estimated.
    """

    places: FloatArray
    sides: tuple[tuple[str, Side], ...]
    label: str = ""
    estimate_J: float | None = None

    @property
    def length(self) -> float:
        """Length of the route [m]."""
        return float(np.linalg.norm(np.diff(self.places, axis=0), axis=1).sum())

    @property
    def name(self) -> str:
        """Name of the route: its label, or the sides on which it passes the zones.

        Examples are "left of church", "over hill" and, without zones, "straight".
        """
        words = (
            f"{side.value} of {zone}" if side in _BESIDE else f"{side.value} {zone}"
            for zone, side in self.sides
        )
        return self.label or ", ".join(words) or "straight"

    def places_at(self, shares: FloatArray) -> FloatArray:
        """Return the points at n fractions of the route's length, shape (n, 3) [m].

        `shares` has the fractions, shape (n,), from 0 at the start to 1 at the goal.
        """
        steps = np.linalg.norm(np.diff(self.places, axis=0), axis=1)
        reached = np.concatenate([[0.0], np.cumsum(steps)])
        at = np.asarray(shares) * reached[-1]
        return np.column_stack([np.interp(at, reached, column) for column in self.places.T])


_BESIDE = (Side.LEFT, Side.RIGHT)


def find_routes(
    airspace: Airspace, start: Place, goal: Place, most: int = MOST_ROUTES
) -> tuple[Route, ...]:
    """Return the shortest route of each homotopy class between two places, the shortest first.

    The result is empty if zones block every way. Each corner is at least `airspace.clearance` plus
    `zones.MARGIN_M` from the zone round which it leads. Routes longer than twice the shortest are
    left out. Over terrain, `climbs.over_the_ground` raises routes to `airspace.floor`, the least
    height above the ground.
    """
    ends = np.array([start, goal], dtype=float)
    relevant = zones_hit(airspace.keep_out, ends, airspace.clearance)
    while True:
        graph = _Graph(airspace, ends, relevant)
        routes = tuple(route for route, _ in zip(graph.routes(), range(most), strict=False))
        more = [
            zone
            for route in routes
            for zone in zones_hit(airspace.keep_out, route.places, airspace.clearance)
        ]
        if not more:
            return tuple(
                replace(route, places=over_the_ground(route.places, airspace))
                for route in routes
                if route.length <= _LONGEST * routes[0].length
            )
        relevant = [zone for zone in airspace.keep_out if zone in relevant or zone in more]


def zones_that_block(airspace: Airspace, start: Place, goal: Place) -> tuple[str, ...]:
    """Return the names of the keep-out zones that block every route between two places.

    If the removal of a single zone opens a route, the result has every zone of this kind. Otherwise
    the result is a minimal set of zones that together block every route.
    """
    zones = airspace.keep_out

    def has_route(kept: Sequence[KeepOut]) -> bool:
        less = airspace.model_copy(update={"keep_out": tuple(kept)})
        return bool(find_routes(less, start, goal, most=1))

    single = tuple(z.name for z in zones if has_route([kept for kept in zones if kept is not z]))
    if single:
        return single
    # If there were only these zones, the removal of any one of them would open a route.
    needed = list(zones)
    for zone in zones:
        fewer = [kept for kept in needed if kept is not zone]
        if not has_route(fewer):
            needed = fewer
    return tuple(zone.name for zone in needed)


def no_way(airspace: Airspace, start: Place, goal: Place) -> str:
    """Return a message for the user that names the zones which block every route to a goal.

    `airspace` has the zones. `start` and `goal` are the two ends of the blocked routes [m].
    """
    names = zones_that_block(airspace, start, goal)
    told = [name for name in ("floor", "ceiling") if getattr(airspace, name) is not None]
    rooms = "".join(f", or move airspace.{name}" for name in told)
    zones, them = ("keep-out", "it") if len(names) == 1 else ("keep-outs", "one of them")
    leave = "leaves" if len(names) == 1 else "leave"
    return (
        f"no route: {zones} {', '.join(names)} with a clearance of {airspace.clearance:g} m "
        f"{leave} no way {MARGIN_M:g} m wide from {_spelled(start)} to {_spelled(goal)} m; "
        f"move {them}{rooms}."
    )


def _spelled(place: Place) -> str:
    return f"({', '.join(f'{number:g}' for number in place)})"


Journey = tuple[Route, ...]
"""A route for each leg, from the start to the first waypoint, ..., to the goal."""


def find_journeys(airspace: Airspace, stops: Sequence[Place]) -> tuple[Journey, ...]:
    """Return the shortest journeys through all stops of a mission, at most `MOST_ROUTES`.

    A journey is a sequence of routes, one for each leg from one stop to the next. Raises a
    NoRouteError if zones block a leg; the message names them.
    """
    journeys: list[Journey] = [()]
    for start, goal in pairwise(stops):
        routes = find_routes(airspace, start, goal)
        if not routes:
            raise NoRouteError(no_way(airspace, start, goal))
        longer = [(*journey, route) for journey in journeys for route in routes]
        journeys = sorted(longer, key=length_of)[:MOST_ROUTES]
    return tuple(journeys)


def journeys_of(told: Scenario) -> tuple[Journey, ...]:
    """Return the shortest journeys of a mission, the shortest first, as `find_journeys` does.

    `told` has the mission, its airspace and its wind. Journeys stay inside the fence, and inside
    the wind field unless the mission may leave it. Raises a NoRouteError if zones, or zones and the
    edges of the field, block a leg.
    """
    # There are edges only if the mission must stay in the wind field.
    airspace, edges = told.airspace, field_edges(told)
    if not edges:
        return find_journeys(airspace, told.mission.positions)
    west, east, south, north = (edges[name][2] for name in ("west", "east", "south", "north"))
    field = KeepIn(corners=((west, south), (east, south), (east, north), (west, north)))
    allowed = field if airspace.keep_in is None else _common(field, airspace.keep_in)
    fenced = airspace.model_copy(update={"keep_in": allowed})
    try:
        return find_journeys(fenced, told.mission.positions)
    except NoRouteError as error:
        # If the zones alone block every route, the message needs no field.
        find_journeys(airspace, told.mission.positions)
        raise NoRouteError(
            f"{error} A flight may not leave wind.field either, unless wind.beyond = 'hold'."
        ) from None


def _common(one: KeepIn, other: KeepIn) -> KeepIn:
    """Return the fence round the area that two overlapping fences have in common."""
    from shapely import Polygon  # noqa: PLC0415  for fences in wind fields alone

    common = Polygon(one.corners).intersection(Polygon(other.corners))
    # It is convex, and may have more corners than a scenario may state.
    return KeepIn.model_construct(corners=tuple(common.exterior.coords[:-1]))


def length_of(journey: Journey) -> float:
    """Return the length of a journey [m], the sum of the lengths of its routes.

    A journey is a sequence of routes, one for each leg from one waypoint to the next.
    """
    return sum(route.length for route in journey)


class NoRouteError(Exception):
    """Error raised if keep-out zones block every route between consecutive stops of a mission."""


def with_plain_passages(told: Scenario) -> Scenario | None:
    """Return a mission that is easier to solve: waypoints are passed exactly and at any speed.

    Limits on distance and speed at waypoints make a first solve difficult. The result is None if no
    waypoint has a radius or a speed limit.
    """
    # The model limits the squares of the distance from a waypoint and of the speed. Their gradient
    # vanishes where the distance or the speed is zero, which makes a first solve difficult.
    at_ease = {"radius": 0.0, "speed_max": None}
    waypoints = tuple(w.model_copy(update=at_ease) for w in told.mission.waypoints)
    if waypoints == told.mission.waypoints:
        return None
    mission = told.mission.model_copy(update={"waypoints": waypoints})
    return told.model_copy(update={"mission": mission})


class _Graph:
    """Visibility graph: points round keep-out zones, and the free straight lines between them.

    `ends` are start and goal, shape (2, 3) [m]. Only the zones in `relevant` belong to the graph.
    """

    def __init__(self, airspace: Airspace, ends: FloatArray, relevant: list[KeepOut]) -> None:
        # Lines may cross other zones of the airspace; the caller checks this.
        self._zones = relevant
        beside = [places_beside(zone, airspace.clearance, ends) for zone in relevant]
        places = np.vstack([ends, *beside])
        is_free = airspace.distance_to_height_limits(places) >= 0.0
        # A gap between two zones that is too narrow for a corner counts as closed.
        # Zones that are not relevant yet must not remove places: they become relevant only when a
        # route hits them, and their own places then lead round both zones.
        for zone in relevant:
            is_free &= zone.depth(places) + airspace.clearance <= ROUNDING
        if airspace.keep_in is not None:
            is_free &= airspace.keep_in.depth(places) >= 0.0
        is_free[:2] = True
        self._places = places[is_free]
        first, last = np.triu_indices(len(self._places), 1)
        is_open = np.ones(len(first), dtype=bool)
        lines = self._places[first], self._places[last]
        for zone in relevant:
            is_open &= ~are_blocked(zone, *lines, airspace.clearance)
        self._first, self._last = first[is_open], last[is_open]
        self._lengths = np.linalg.norm(self._places[self._first] - self._places[self._last], axis=1)
        starts, stops = self._places[self._first], self._places[self._last]
        self._crossings = [
            sides_passed(zone, ends, airspace.clearance, starts, stops) for zone in relevant
        ]

    def routes(self) -> Iterator[Route]:
        """Yield the shortest route of every homotopy class, the shortest first.

        Routes belong to the same class if they pass every zone on the same side.
        """
        every = frozenset(range(len(Side)))
        queue: list[tuple[float, int, list[int], tuple[frozenset[int], ...]]] = []
        pushed = 0

        def push(allowed: tuple[frozenset[int], ...]) -> None:
            nonlocal pushed
            found = self._shortest(allowed)
            if found is not None:
                pushed += 1
                heappush(queue, (found[0], pushed, found[1], allowed))

        push((every,) * len(self._zones))
        while queue:
            # The shortest route of all sets is the next result, and its set is divided in the same
            # way.
            _, _, nodes, allowed = heappop(queue)
            sides = self._sides_of(nodes)
            yield Route(
                places=self._places[nodes],
                sides=tuple(
                    (zone.name, list(Side)[side])
                    for zone, side in zip(self._zones, sides, strict=True)
                    if side >= 0
                ),
            )
            # The other routes are divided into disjoint sets, one for each zone. The routes in the
            # set of zone k pass zone k on another side, and zones 1 to k - 1 on the same sides.
            kept = list(allowed)
            for number, side in enumerate(sides):
                if side >= 0:
                    push((*kept[:number], allowed[number] - {side}, *allowed[number + 1 :]))
                    kept[number] = frozenset({side})

    def _shortest(self, allowed: tuple[frozenset[int], ...]) -> tuple[float, list[int]] | None:
        """Return length [m] and nodes of the shortest path that passes zones on allowed sides only.

        For each zone, `allowed` has indices into `Side`. The result is None if there is no path.
        """
        is_open = np.ones(len(self._first), dtype=bool)
        for crossings, sides in zip(self._crossings, allowed, strict=True):
            is_open &= np.isin(crossings, [-1, *sides])
        shape = (len(self._places),) * 2
        lines = (self._first[is_open], self._last[is_open])
        graph = csr_array((self._lengths[is_open], lines), shape=shape)
        lengths, before = dijkstra(graph, directed=False, indices=0, return_predecessors=True)
        if not np.isfinite(lengths[1]):
            return None
        nodes = [1]
        while nodes[-1] != 0:
            nodes.append(int(before[nodes[-1]]))
        return float(lengths[1]), nodes[::-1]

    def _sides_of(self, nodes: list[int]) -> list[int]:
        """Return the side on which a path passes each zone of the graph, as an index into `Side`.

        The entry is -1 if the path does not pass the zone.
        """
        number = {pair: k for k, pair in enumerate(zip(self._first, self._last, strict=True))}
        lines = [number[min(pair), max(pair)] for pair in pairwise(nodes)]
        sides = []
        for crossings in self._crossings:
            crossed = [int(crossings[k]) for k in lines if crossings[k] >= 0]
            sides.append(crossed[0] if crossed else -1)
        return sides


@dataclass(frozen=True, kw_only=True)
class TriedRoute:
    """Result of solving a mission along one of its candidate routes.

    Attributes
    ----------
    name : str
        Name of the route, from the sides of the zones.
    length_m : float
        Length of the straight lines of the initial guess [m].
    energy_J : float or None
        Energy of the flight [J]; None if the solve failed.
    is_refined : bool
        Whether the flight was solved to the mission's tolerance, not only on a coarse mesh.
    is_kept : bool
        Whether the plan is this flight.
    estimate_J : float or None
        Energy of steady flight along the route, estimated in a wind field [J]; None if it was not
        estimated.
    """

    name: str
    length_m: float
    energy_J: float | None
    is_refined: bool
    is_kept: bool
    estimate_J: float | None = None


#: Durations of hover at the goal [s], in order: an autopilot's flight waits for the first with
#: which the vehicle arrives.
SETTLINGS_S = (0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 6.0)
# Duration below which a phase of a speed profile is left out [s].
_INSTANT = 1e-9


class SpeedProfile(NamedTuple):
    """Samples of a motion from rest to rest along a straight line, in phases of constant jerk.

    The 8 samples are taken at the start and at the end of each of seven phases. All fields have the
    shape (8,).
    """

    times: FloatArray
    """Times from the start, s."""
    distances: FloatArray
    """Distances from the start, m."""
    speeds: FloatArray
    """Speeds along the line, m/s."""
    accelerations: FloatArray
    """Accelerations along the line, m/s^2."""


def speed_profile(distance: float, speed: float, acceleration: float, jerk: float) -> SpeedProfile:
    """Return the fastest motion from rest to rest over a positive distance [m], with limited jerk.

    `speed`, `acceleration` and `jerk` are the largest magnitudes allowed [m/s, m/s^2, m/s^3]. The
    result has seven phases of constant jerk. Over a short distance, some have zero duration.
    """
    # On a leg that is too short to reach the speed, the phase of constant speed has no duration. On
    # an even shorter leg, the peak acceleration is lower, too.
    peak = min(speed, _peak_speed(distance, acceleration, jerk))
    bending = min(acceleration / jerk, sqrt(peak / jerk))
    straight = max(peak / (jerk * bending) - bending, 0.0)
    cruising = max(distance / peak - (2 * bending + straight), 0.0)
    ramp = (bending, straight, bending)
    rows = [(0.0, 0.0, 0.0, 0.0)]
    jerks = (jerk, 0.0, -jerk, 0.0, -jerk, 0.0, jerk)
    for lasting, change in zip((*ramp, cruising, *ramp), jerks, strict=True):
        t, s, v, a = rows[-1]
        rows.append(
            (
                t + lasting,
                s + lasting * (v + lasting * (a / 2 + lasting * change / 6)),
                v + lasting * (a + lasting * change / 2),
                a + lasting * change,
            )
        )
    # Remove rounding errors at the end.
    rows[-1] = (rows[-1][0], distance, 0.0, 0.0)
    return SpeedProfile(*np.array(rows).T)


def _peak_speed(distance: float, acceleration: float, jerk: float) -> float:
    """Return the peak speed of the fastest motion from rest to rest over a distance [m/s].

    Only acceleration [m/s^2] and jerk [m/s^3] are limited.
    """
    unbent = acceleration / jerk
    reached = acceleration / 2 * (sqrt(unbent**2 + 4 * distance / acceleration) - unbent)
    if reached >= acceleration * unbent:
        return reached
    return float((distance**2 * jerk / 4) ** (1 / 3))


def cruise_at(
    scenario: Scenario,
    speed: float | None = None,
    settling_s: float = 0.0,
    least_s: float = 0.0,
) -> Scenario:
    """Return the mission with the passing times and the duration of an autopilot's cruise.

    `speed` [m/s] replaces the scenario's cruise speed. The vehicle hovers at the goal for
    `settling_s` [s], or longer if the mission would otherwise end before `least_s` [s].

    Raises a ScenarioError if zones block a leg, or if all places are the same. It is also raised if
    `speed` is None and the scenario has no cruise speed, or several.
    """
    told = scenario
    if speed is not None:
        told = scenario.cruising(scenario.baseline.cruise_settings(speed))
    holds = (*(waypoint.hold for waypoint in scenario.mission.waypoints), 0.0)
    reached, left = [], 0.0
    for pieces, hold in zip(_legs(told), holds, strict=True):
        reached.append(left + sum(float(profile.times[-1]) for _, profile in pieces))
        left = reached[-1] + hold
    return told.lasting(max(reached[-1] + settling_s, least_s), reached[:-1])


def cruise(scenario: Scenario) -> SampledPath:
    """Return the reference path of an autopilot's cruise: straight lines at one speed.

    Raises
    ------
    ScenarioError
        If the cruise takes longer than the mission's duration, or if a time of the mission is free.
        Also for the reasons of `cruise_at`.
    """
    stops, times = stops_of(scenario.mission)
    holds = (0.0, *(waypoint.hold for waypoint in scenario.mission.waypoints))
    knots: list[float] = []
    rows: list[FloatArray] = []
    for k, pieces in enumerate(_legs(scenario)):
        began, turn = times[k] + holds[k], stops[k + 1][-1] - stops[k][-1]
        length = sum(float(profile.distances[-1]) for _, profile in pieces)
        place = np.array(stops[k])
        for step, profile in pieces:
            way = np.append(step, turn * profile.distances[-1] / length)
            shares = np.array(profile[1:]) / profile.distances[-1]
            samples = shares[:, :, None] * way
            samples[0] += place
            rows.append(samples)
            knots += (began + profile.times).tolist()
            began, place = knots[-1], place + way
    duration = scenario.mission.fixed_duration
    if knots[-1] > duration:
        raise ScenarioError(
            f"{scenario.name}: mission.duration = {duration:g} s; reference cruise takes "
            f"{knots[-1]:g} s and keeps its own time; fly it by itself or in a run."
        )
    kept = np.diff(knots, append=np.inf) > _INSTANT
    return SampledPath(np.array(knots)[kept], *np.concatenate(rows, axis=1)[:, kept])


def _legs(scenario: Scenario) -> list[list[tuple[FloatArray, SpeedProfile]]]:
    """Return for each leg of the mission the straight lines of an autopilot's cruise.

    A leg has several lines if its route has corners. Each line has a displacement, shape (3,) [m],
    and a motion from rest to rest.
    """
    airspace, settings = scenario.airspace, own_cruise(scenario)
    limits = settings.speed, settings.acceleration, settings.jerk
    legs = []
    for start, goal in pairwise(scenario.mission.positions):
        routes = find_routes(airspace, start, goal, most=1)
        if not routes:
            raise ScenarioError(f"{scenario.name}: {no_way(airspace, start, goal)}")
        steps = np.diff(routes[0].places, axis=0)
        lengths = np.linalg.norm(steps, axis=1).tolist()
        legs.append(
            [
                (step, speed_profile(length, *limits))
                for step, length in zip(steps, lengths, strict=True)
                if length > 0
            ]
        )
    if not any(legs):
        raise ScenarioError(
            f"{scenario.name}: the mission stays at {scenario.mission.start.position} m; reference "
            "cruise needs a way to go; leave it out of baseline.references."
        )
    return legs


def reached(scenario: Scenario) -> CruiseSettings:
    """Return cruise settings with the largest speed and acceleration that a cruise really reaches.

    On short legs, they are smaller than those of the scenario, but give the same flight.
    """
    profiles = [profile for pieces in _legs(scenario) for _, profile in pieces]
    return CruiseSettings(
        speed=max(float(profile.speeds.max()) for profile in profiles),
        acceleration=max(float(np.abs(profile.accelerations).max()) for profile in profiles),
        jerk=scenario.baseline.cruise_jerk,
    )


def own_cruise(scenario: Scenario) -> CruiseSettings:
    """Return speed, acceleration and jerk of the cruise, for a scenario with a single cruise speed.

    Raises a ScenarioError if the scenario has no cruise speed, or several.
    """
    speeds = scenario.baseline.cruise_speeds or ()
    if len(speeds) != 1:
        raise ScenarioError(
            f"{scenario.name}: baseline.cruise_speeds must be one speed for one flight along "
            "reference cruise; give one, as in baseline.cruise_speeds=[5.0]."
        )
    return scenario.baseline.cruise_settings(*speeds)
