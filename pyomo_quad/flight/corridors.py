"""Corridors through a wind field: cheap routes that lie apart, found by a search on a grid.

The cost of a route is its energy plus the price of time [W] times its duration. A mission with free
duration states the price. Otherwise, the price makes the cheapest route take the fixed duration.

Dijkstra's method gives the cheapest route through every grid point: see docs/theory/routes.md,
"Corridors through a wind field". Lines join each grid point to its neighbours, and routes consist
of lines.

The argument `told` is the scenario of the mission in its forecast wind, which the planner assumes.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise, product
from math import inf

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from pyomo_quad.arrays import FloatArray
from pyomo_quad.collocation import SolveError
from pyomo_quad.flight.routes import Journey, Route
from pyomo_quad.flight.steady import SteadyFlight
from pyomo_quad.flight.zones import MARGIN_M, are_blocked
from pyomo_quad.model.wind_field import with_nearest_wind
from pyomo_quad.scenario import Scenario
from pyomo_quad.scenario.wind import Beyond, WindCoupling

# Largest number of corridors, their largest excess cost relative to the cheapest (the error of an
# estimate by straight legs in steady flight is a few per cent), and their separation relative to
# the distance of start and goal.
_MOST_CORRIDORS = 4
_DEARER = 0.03
_SEPARATION = 0.08
# Grid points along the longer side of the search grid, and its margin round start and goal relative
# to their distance.
_PLACES = 60
_MARGIN = 0.4
# Airspeeds of the table of powers, and ground speeds that are compared on a line [m/s].
_AIRSPEEDS = np.linspace(0.0, 24.0, 17)
_GROUND_SPEEDS = np.linspace(0.5, 30.0, 60)
# Halvings in the search for the price of time: it ends within 0.5 % of the power of hover.
_HALVINGS = 12
# Steps on the grid to half of the neighbours that a point is joined to; lines lead both ways.
_NEIGHBOURS = ((1, 0), (0, 1), (1, 1), (1, -1), (2, 1), (1, 2), (2, -1), (1, -2))
# Fractions of a line at which the wind along it is evaluated.
_SHARES = (0.0, 0.5, 1.0)


def steady_power(steady: SteadyFlight) -> Callable[[FloatArray], FloatArray]:
    """Return a function that gives the power of level flight in still air [W] for airspeeds [m/s].

    It interpolates a table up to 24 m/s, or up to the first airspeed without steady flight. Above
    the table, its value is infinite.
    """
    speeds, powers = [], []
    near = None
    for speed in _AIRSPEEDS.tolist():
        try:
            near = steady.trim((speed, 0.0, 0.0), near)
        except SolveError:
            break
        speeds.append(speed)
        powers.append(near.power_W)
    if not speeds:  # The vehicle cannot even hover.
        speeds, powers = [0.0], [inf]
    return lambda airspeed: np.interp(airspeed, speeds, powers, right=inf)


class WindMap:
    """Horizontal wind at any place and time, by linear interpolation in the data of a wind field.

    `told` is the mission in its forecast wind, which must be a wind field.
    """

    def __init__(self, told: Scenario) -> None:
        wind, grid = told.wind, told.wind.grid
        if grid is None:
            raise ValueError(f"{told.name} has no wind.field")
        self._grid, self._is_held = grid, wind.beyond is Beyond.HOLD
        self._scale, self._offset = wind.field_scale, wind.time_offset
        values = with_nearest_wind(grid) if self._is_held else grid.components
        values = np.moveaxis(values[:2], 0, -1)
        from scipy.interpolate import RegularGridInterpolator  # noqa: PLC0415  for fields alone

        # The Pyomo model represents the wind by a spline. The search for routes evaluates the wind
        # very often, and linear interpolation is faster.
        self._read = RegularGridInterpolator(
            grid.axes, np.where(np.isfinite(values), values, 0.0), bounds_error=False
        )

    def at(self, places: FloatArray, times: FloatArray) -> FloatArray:
        """Return the horizontal wind [m/s] at n places and times in flight, shape (n, 2).

        `places` has shape (n, 3), m, and `times` shape (n,), s. The wind is NaN where the field
        gives no value, unless `wind.beyond` is "hold".
        """
        grid, when = self._grid, times + self._offset
        columns = [*places[:, :2].T]
        columns += [places[:, 2]] if grid.z else []
        columns += [when] if grid.times else []
        # With "hold", the wind outside the field is that at its edge, and missing values of the
        # field are the nearest known wind.
        held = [np.clip(c, axis[0], axis[-1]) for c, axis in zip(columns, grid.axes, strict=True)]
        wind = self._scale * self._read(np.column_stack(held))
        if not self._is_held:
            wind[~grid.is_known(places, when)] = np.nan
        return np.asarray(wind)


@dataclass(frozen=True, kw_only=True)
class LineCosts:
    """Cost and time of steady flight along straight lines near one leg, in a wind field.

    Attributes
    ----------
    told : Scenario
        The mission in its forecast wind.
    wind : WindMap
        Wind at any place and time.
    power : callable
        Airspeeds [m/s] -> power of level flight [W].
    ends : ndarray, shape (2, 3)
        Start and end of the leg [m].
    duration : float
        Duration of the leg, or a guess [s].
    fastest : float
        Largest ground speed allowed [m/s], or infinite.
    """

    told: Scenario
    wind: WindMap
    power: Callable[[FloatArray], FloatArray]
    ends: FloatArray
    # The wind at a place is taken at the time at which a flight at constant speed passes there.
    duration: float
    fastest: float

    def of(
        self, starts: FloatArray, stops: FloatArray, price: float
    ) -> tuple[FloatArray, FloatArray]:
        """Return cost [J] and time [s] of steady flight along straight lines, shape (n,) each.

        The cost is the energy plus `price` [W] times the time. It is infinite if a line is blocked,
        its wind unknown, or steady flight impossible; ignore the time then.
        """
        way = stops - starts
        lengths = np.linalg.norm(way, axis=1)
        course = way[:, :2] / np.where(lengths > 0.0, lengths, 1.0)[:, None]
        speeds = _GROUND_SPEEDS[max(self.fastest, _GROUND_SPEEDS[0]) >= _GROUND_SPEEDS]
        costs, times = np.zeros(len(way)), np.zeros(len(way))
        for share in _SHARES:
            places = starts + share * way
            wind = self.wind.at(places, self._passed(places))
            air = course[:, None] * speeds[:, None] - wind[:, None]
            per_metre = (self.power(np.linalg.norm(air, axis=2)) + price) / speeds
            per_metre = np.where(np.isnan(per_metre), inf, per_metre)
            best = np.argmin(per_metre, axis=1)
            costs += np.min(per_metre, axis=1) * lengths / len(_SHARES)
            times += lengths / speeds[best] / len(_SHARES)
        costs[lengths == 0.0] = 0.0
        costs[self._is_blocked(starts, stops)] = inf
        return costs, times

    def _passed(self, places: FloatArray) -> FloatArray:
        """Return the time at which a flight along the leg at constant speed passes n places [s].

        For a place beside the leg, the nearest point of the leg is used.
        """
        way = self.ends[1] - self.ends[0]
        share = (places - self.ends[0]) @ way / max(way @ way, 1.0)
        return self.duration * np.clip(share, 0.0, 1.0)

    def _is_blocked(self, starts: FloatArray, stops: FloatArray) -> NDArray[np.bool_]:
        airspace = self.told.airspace
        blocked = np.zeros(len(starts), dtype=bool)
        for zone in airspace.keep_out:
            blocked |= are_blocked(zone, starts, stops, airspace.clearance + MARGIN_M)
        if airspace.keep_in is not None:
            blocked |= (
                np.minimum(airspace.keep_in.depth(starts), airspace.keep_in.depth(stops)) < 0.0
            )
        return blocked


def has_corridors(told: Scenario) -> bool:
    """Return whether the energy of a route depends on its horizontal position in the wind.

    The wind must be a wind field that acts through the airspeed (`wind.coupling = "drag"`). The
    field must differ between horizontal positions, or lack values at some grid points. Missing
    values count only if `wind.beyond` is not "hold": flights must then avoid these places.
    """
    if told.wind.grid is None or told.wind.coupling is not WindCoupling.DRAG:
        return False
    # Grid points without wind are NaN.
    values = told.wind.grid.components
    known = np.isfinite(values)
    if told.wind.beyond is not Beyond.HOLD and not known.all():
        return True
    least = np.where(known, values, inf).min(axis=(1, 2))
    greatest = np.where(known, values, -inf).max(axis=(1, 2))
    return bool(np.any(least < greatest))


def estimate_of(journey: Journey) -> float | None:
    """Return the energy of steady flight along a journey [J]; None if it is unknown.

    A journey has one route for each leg from waypoint to waypoint. Its energy is unknown if a route
    has no estimate.
    """
    known = [route.estimate_J for route in journey if route.estimate_J is not None]
    return sum(known) if len(known) == len(journey) else None


def corridor_journeys(
    told: Scenario, steady: SteadyFlight, shortest: Journey
) -> tuple[Journey, ...]:
    """Return journeys along cheap routes through a wind field, and the shortest journey.

    Up to four journeys through corridors come first, in order of increasing energy. The last is
    `shortest`, found regardless of the wind. A journey has one route for each leg, with its energy
    if that is known.
    """
    power = steady_power(steady)
    shares = np.array([max(route.length, 1e-9) for route in shortest])
    durations = told.nominal_duration * shares / shares.sum()
    found: list[list[Route]] = []
    straight = []
    for route, duration in zip(shortest, durations.tolist(), strict=True):
        corridors = Corridors(told, power, route.places[[0, -1]], duration)
        # A leg without a corridor keeps its route from `shortest`.
        found.append(corridors.routes() or [route])
        straight.append(replace(route, estimate_J=corridors.energy_of(route.places)))
    journeys = sorted(product(*found), key=lambda j: estimate_of(j) or inf)[:_MOST_CORRIDORS]
    # The grid may be too coarse for the search to find the shortest journey.
    return (*journeys, tuple(straight))


class Corridors:
    """Search for cheap routes that lie apart (corridors) between two waypoints in a wind field.

    Parameters
    ----------
    told : Scenario
        The mission in its forecast wind.
    power : callable
        Airspeeds [m/s] -> power of level flight in still air [W].
    ends : ndarray, shape (2, 3)
        The two waypoints [m].
    duration : float
        Duration of the flight between them, or a guess if it is free [s].
    """

    def __init__(
        self,
        told: Scenario,
        power: Callable[[FloatArray], FloatArray],
        ends: FloatArray,
        duration: float,
    ) -> None:
        self._way = float(np.linalg.norm(ends[1] - ends[0]))
        self._costs = LineCosts(
            told=told,
            wind=WindMap(told),
            power=power,
            ends=ends,
            duration=duration,
            fastest=told.limits.speed_max or inf,
        )
        grid = _grid(told, ends)
        price = told.mission.price_of_time
        if not told.mission.is_free:
            price = _price_of(self._costs, *grid, duration)
        self._price = price
        self._search = _Search(self._costs, *grid, price)

    def routes(self) -> list[Route]:
        """Return the corridors of the leg: cheap routes that lie apart, the cheapest first.

        A leg is the flight from one waypoint to the next. The result is empty if no route leads
        through the grid.
        """
        return [
            Route(
                places=places,
                sides=(),
                label=f"corridor {number}",
                estimate_J=self.energy_of(places),
            )
            for number, places in enumerate(self._search.corridors(_SEPARATION * self._way), 1)
        ]

    def energy_of(self, places: FloatArray) -> float | None:
        """Return the energy of steady flight along straight lines through places [J].

        `places` has shape (n, 3), m. The result is None if the cost of a line is infinite, for
        example in a keep-out zone or where the wind is unknown (see `LineCosts.of`).
        """
        pieces = [
            np.linspace(a, b, 2 + int(np.linalg.norm(b - a) / self._way * _PLACES))[:-1]
            for a, b in pairwise(places)
        ]
        fine = np.vstack([*pieces, places[-1:]])
        costs, times = self._costs.of(fine[:-1], fine[1:], self._price)
        energy = float(np.sum(costs) - self._price * np.sum(times))
        return energy if np.isfinite(energy) else None


def _grid(
    told: Scenario, ends: FloatArray
) -> tuple[FloatArray, NDArray[np.intp], NDArray[np.intp]]:
    """Return the points of the search grid about a leg, and the indices of both ends of each line.

    A line joins two neighbouring points. `ends` are start and goal of the leg, and the first two
    points. Points have shape (n, 3), in m.
    """
    margin = _MARGIN * float(np.linalg.norm(ends[1] - ends[0]))
    # Seen from above, the grid is a rectangle.
    low, high = ends[:, :2].min(axis=0) - margin, ends[:, :2].max(axis=0) + margin
    grid = told.wind.grid
    if grid is not None and told.wind.beyond is not Beyond.HOLD:
        low = np.maximum(low, [grid.x[0], grid.y[0]])
        high = np.minimum(high, [grid.x[-1], grid.y[-1]])
    step = float((high - low).max()) / (_PLACES - 1)
    counts = [int((h - b) / step) + 1 for b, h in zip(low, high, strict=True)]
    axes = [b + step * np.arange(n) for b, n in zip(low, counts, strict=True)]
    flat = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    way = ends[1] - ends[0]
    # A grid point has the height of the horizontally nearest point of the leg.
    share = (flat - ends[0, :2]) @ way[:2] / max(float(way[:2] @ way[:2]), 1e-9)
    heights = ends[0, 2] + np.clip(share, 0.0, 1.0) * way[2]
    places = np.vstack([ends, np.column_stack([flat, heights])])
    numbers = 2 + np.arange(len(flat)).reshape(counts)
    pairs = []
    for dx, dy in _NEIGHBOURS:
        down = slice(max(dy, 0), counts[1] + min(dy, 0))
        back = slice(max(-dy, 0), counts[1] + min(-dy, 0))
        pairs.append((numbers[: counts[0] - dx, back].ravel(), numbers[dx:, down].ravel()))
    # Start and goal are joined to the grid points near them.
    for end in (0, 1):
        near = 2 + np.flatnonzero(np.linalg.norm(flat - ends[end, :2], axis=1) <= 3.0 * step)
        pairs.append((np.full(len(near), end), near))
    first, last = (np.concatenate(part) for part in zip(*pairs, strict=True))
    # Both directions: a tail wind makes a line cheaper than a head wind.
    return places, np.concatenate([first, last]), np.concatenate([last, first])


def _price_of(
    costs: LineCosts,
    places: FloatArray,
    first: NDArray[np.intp],
    last: NDArray[np.intp],
    duration: float,
) -> float:
    """Return the price of time [W] at which the cheapest route takes a given duration [s].

    `places`, `first` and `last` are the search grid, as `_grid` returns it.
    """
    hover = float(costs.power(np.zeros(1))[0])
    low, high = -0.95 * hover, 20.0 * hover
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        search = _Search(costs, places, first, last, middle)
        low, high = (middle, high) if search.time_of_cheapest() > duration else (low, middle)
    return (low + high) / 2


class _Search:
    """Search for the cheapest routes from start to goal through each point of a grid.

    The arguments `places`, `first` and `last` are results of `_grid`. `price` is the price of time
    [W].
    """

    def __init__(
        self,
        costs: LineCosts,
        places: FloatArray,
        first: NDArray[np.intp],
        last: NDArray[np.intp],
        price: float,
    ) -> None:
        self._costs, self._places, self._price = costs, places, price
        lines, times = costs.of(places[first], places[last], price)
        is_open = np.isfinite(lines)
        shape = (len(places),) * 2
        lines = np.maximum(lines, np.finfo(float).tiny)
        graph = csr_array((lines[is_open], (first[is_open], last[is_open])), shape=shape)
        self._times = csr_array((times[is_open], (first[is_open], last[is_open])), shape=shape)
        self._ahead, self._before = dijkstra(graph, indices=0, return_predecessors=True)
        self._back, self._after = dijkstra(graph.T.tocsr(), indices=1, return_predecessors=True)

    def time_of_cheapest(self) -> float:
        """Return the duration of the cheapest route [s]; infinite if there is no route."""
        nodes = self._through(1)
        return sum(float(self._times[a, b]) for a, b in pairwise(nodes)) or inf

    def corridors(self, separation: float) -> list[FloatArray]:
        """Return the corridors: cheap routes that lie apart, the cheapest first.

        Each is an array of corners [m], shape (n, 3). For each route found before, some corner of a
        new route is at least `separation` [m] away from it.
        """
        through = self._ahead + self._back
        most = (1.0 + _DEARER) * through[1]
        found: list[tuple[float, FloatArray]] = []
        is_near = ~np.isfinite(through)
        while len(found) < _MOST_CORRIDORS:
            open_costs = np.where(is_near, inf, through)
            node = int(np.argmin(open_costs))
            if not np.isfinite(open_costs[node]) or open_costs[node] > most:
                break
            raw = self._places[self._through(node)]
            # For each further corridor, grid points near the routes found so far are excluded.
            is_near |= _distance(self._places, raw) < separation
            drawn = self._without_needless_corners(raw)
            if all(_distance(drawn, other).max() >= separation for _, other in found):
                found.append((self._cost(drawn), drawn))
                is_near |= _distance(self._places, drawn) < separation
        found.sort(key=lambda route: route[0])
        return [places for _, places in found]

    def _through(self, node: int) -> list[int]:
        """Return the indices of the points along the cheapest route through a grid point.

        The result is empty if there is no such route.
        """
        if not np.isfinite(self._ahead[node] + self._back[node]):
            return []
        nodes = [node]
        while nodes[0] != 0:
            nodes.insert(0, int(self._before[nodes[0]]))
        while nodes[-1] != 1:
            nodes.append(int(self._after[nodes[-1]]))
        return nodes

    def _cost(self, places: FloatArray) -> float:
        return float(self._costs.of(places[:-1], places[1:], self._price)[0].sum())

    def _without_needless_corners(self, places: FloatArray) -> FloatArray:
        """Return a route, an array of corners [m], without needless corners.

        A corner is needless if a straight line that leaves it out costs no more.
        """
        kept = [0]
        while kept[-1] < len(places) - 1:
            here = kept[-1]
            for there in range(len(places) - 1, here, -1):
                along = self._cost(places[here : there + 1])
                line = np.linspace(places[here], places[there], there - here + 1)
                if there == here + 1 or self._cost(line) <= along:
                    kept.append(there)
                    break
        return np.asarray(places[kept])


def _distance(places: FloatArray, route: FloatArray) -> FloatArray:
    """Return the distances [m] of n places from a route of straight lines, shape (n,).

    `route` has the corners of the route.
    """
    starts, way = route[:-1], np.diff(route, axis=0)
    lengths = np.maximum(np.sum(way**2, axis=1), np.finfo(float).tiny)
    away = places[:, None] - starts
    share = np.clip(np.einsum("nki,ki->nk", away, way) / lengths, 0.0, 1.0)
    return np.asarray(np.linalg.norm(away - share[..., None] * way, axis=2).min(axis=1))
