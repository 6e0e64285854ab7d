"""Search for the cheapest order of the waypoints of a mission, from the energies of its legs.

A leg is the flight from one place of the mission to another, from hover to hover. First, some legs
are solved as separate flights, for example those between neighbouring places. A model fitted to the
solved legs predicts the energies of the unsolved legs, docs/theory/orders.md, eq. (1). The unsolved
legs of the cheapest orders by this prediction are solved next, and the prediction is repeated.
Finally, the whole mission is solved for the few cheapest orders.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise, permutations
from math import inf, isinf
from typing import TYPE_CHECKING

import numpy as np

from pyomo_quad.collocation import Mesh
from pyomo_quad.flight.candidate import AlongShortest, Candidate
from pyomo_quad.flight.mission_problem import MissionProblem
from pyomo_quad.flight.orders import (
    MOST_EXACT,
    OrderSearch,
    best_orders,
    cost_of,
    least_cost,
    nearest_first,
)
from pyomo_quad.flight.route_flights import ON_FIRST, RouteFlights, guess_along
from pyomo_quad.flight.routes import find_routes
from pyomo_quad.flight.strategies import FIRST, carry_out
from pyomo_quad.scenario.mission import Hover, Order

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence

    from pyomo_quad.arrays import FloatArray
    from pyomo_quad.collocation import Solution
    from pyomo_quad.flight.candidate import Start
    from pyomo_quad.flight.plan import Plan
    from pyomo_quad.flight.problems import Problems
    from pyomo_quad.flight.routes import Route
    from pyomo_quad.flight.search import Search
    from pyomo_quad.scenario import Scenario

    LegSolver = Callable[[Scenario, Mesh, Route | None], Solution]
    _Leg = tuple[int, int]

#: Number of orders whose whole missions are solved, because energies of legs from hover to hover
#: ignore the saving of not stopping.
BEST_FEW = 3
# Mesh of the solves of legs: elements and degree; only the order of their energies matters.
_LEG_MESH = Mesh.uniform(8, 4)
# Number of legs up to which all are solved for: with few legs, predictions are inaccurate.
_FEW_LEGS = 30
# Number of nearest neighbours per place whose legs are solved for first, and of further legs of all
# lengths, so that the prediction does not extrapolate.
_NEAREST, _OF_ALL_LENGTHS = 3, 10
# Root mean square errors by which the predicted energy of an unsolved leg is lowered, so that the
# leg is solved for if it may lead to a cheaper order.
_OPTIMISM = 2.0
# Largest number of terms of the prediction; there are at most half as many as solved legs.
_TERMS = 12
# Regularisation of the prediction, relative to its features' largest values.
_RIDGE = 1e-3
# Rounds of solving the legs of the cheapest orders; an exact search ends when all are solved.
_MOST_ROUNDS = 6


def in_order(scenario: Scenario, order: Sequence[int]) -> Scenario:
    """Return a scenario with its waypoints in a given order.

    `order` holds the indices of the waypoints. The result prescribes its order (`Order.GIVEN`).
    """
    waypoints = tuple(scenario.mission.waypoints[k] for k in order)
    return scenario.with_mission(waypoints=waypoints, order=Order.GIVEN)


class LegTable:
    """Table of the costs of the flights from hover to hover (legs) between all places of a mission.

    Parameters
    ----------
    scenario : Scenario
        The mission.
    solve : callable
        Takes a scenario without waypoints, a mesh, and the shortest route round the zones (None if
        no zone is in the way). Returns the `Solution` of the leg.
    """

    def __init__(self, scenario: Scenario, solve: LegSolver) -> None:
        self._scenario = scenario
        self._solve = solve
        self._ways = _shortest_ways(scenario)
        self._count = len(scenario.mission.positions)
        # The tour that always continues to the nearest remaining place.
        usual = nearest_first(self.lengths)
        self._usual = cost_of(self.lengths, tuple(int(k) - 1 for k in usual))
        self._known: dict[_Leg, float] = {}
        self._failed: set[_Leg] = set()

    @property
    def legs(self) -> tuple[_Leg, ...]:
        """Legs (flights between two places) that an order may use and that zones leave open.

        Each leg is a pair of indices of places. The result is empty if zones leave no way to visit
        all places.
        """
        # Place 0 is the start, the last place is the goal.
        return () if isinf(self._usual) else tuple(self._ways)

    @property
    def solved(self) -> int:
        """Number of legs (flights between two places of the mission) solved so far."""
        return len(self._known)

    @property
    def lengths(self) -> FloatArray:
        """Lengths of the shortest routes between all places [m], shape (n_places, n_places).

        The start is first, the goal last. A leg that has no route, or that no order may use, has
        infinite length. An example is a leg from the goal.
        """
        return self._table({leg: way.length for leg, way in self._ways.items()})

    def costs(self) -> FloatArray:
        """Return the cost of each leg [J], shape (n_places, n_places).

        The cost is energy + price of time x duration. Unsolved legs have an optimistic prediction,
        docs/theory/orders.md, eq. (1). Legs (from row to column) that no order may use have
        infinite cost.
        """
        missing = [leg for leg in self.legs if leg not in self._known]
        if not missing:
            return self._table(self._known)
        # Before the first solve, lengths [m] take the place of costs.
        if not self._known:
            return self.lengths
        terms = max(1, min(_TERMS, len(self._known) // 2))
        features = np.array([self._features(leg)[:terms] for leg in self._known])
        energies = np.array(list(self._known.values()))
        scales = np.maximum(np.abs(features).max(axis=0), np.finfo(float).tiny)
        features /= scales
        normal = features.T @ features + _RIDGE * np.eye(terms)
        fit = np.linalg.solve(normal, features.T)
        # Leave-one-out error of a linear fit, from the fit with all legs.
        left_out = 1.0 - np.einsum("lf,fl->l", features, fit)
        errors = (features @ fit @ energies - energies) / left_out
        margin = _OPTIMISM * float(np.sqrt(np.mean(errors**2)))
        others = np.array([self._features(leg)[:terms] for leg in missing]) / scales
        # A leg that cannot be flown from hover to hover in its part of a fixed duration may still
        # be part of the mission, which passes the places without stops. Its part is in proportion
        # to its length.
        margins = np.array([0.0 if leg in self._failed else margin for leg in missing])
        predicted = np.maximum(others @ fit @ energies - margins, 0.0)
        return self._table(self._known | dict(zip(missing, predicted.tolist(), strict=True)))

    def solve_for(self, legs: Iterable[_Leg]) -> bool:
        """Solve the given legs that were not tried before; return whether there were such legs.

        A leg is the flight between two places of the mission, from hover to hover. It is given by
        the indices of the two places.
        """
        missing = [leg for leg in dict.fromkeys(legs) if leg not in self._known]
        missing = [leg for leg in missing if leg not in self._failed]
        for leg in missing:
            found = self._flown(leg)
            if found.status.is_solved:
                self._known[leg] = float(found.objective)
            else:
                self._failed.add(leg)
        return bool(missing)

    def _flown(self, leg: _Leg) -> Solution:
        mission, way = self._scenario.mission, self._ways[leg]
        ends = (Hover(position=mission.positions[k], yaw=mission.start.yaw) for k in leg)
        alone = self._scenario.with_mission(
            **dict(zip(("start", "goal"), ends, strict=True)), waypoints=(), order=Order.GIVEN
        )
        if not mission.is_free:
            alone = alone.lasting(way.length / self._usual * mission.fixed_duration)
        return self._solve(alone, _LEG_MESH, way if way.sides else None)

    def _features(self, leg: _Leg) -> list[float]:
        """Return the regressors that predict the energy of a leg (flight between two places).

        They are functions of length, direction, height and detour of the leg; see
        docs/theory/orders.md, eq. (1).
        """
        here, there = (np.array(self._scenario.mission.positions[k]) for k in leg)
        (dx, dy, dz), height = there - here, float(here[2] + there[2]) / 2.0
        length = self._ways[leg].length
        courses = [dx * dx / length, dy * dy / length, dx * dy / length, dz * dz / length]
        detour = length - float(np.linalg.norm(there - here))
        # The most informative features come first: with few solved legs only these are fitted.
        return [1.0, length, length**0.5, dx, dy, dz, height * length, *courses, detour]

    def _table(self, costs: Mapping[_Leg, float]) -> FloatArray:
        table = np.full((self._count, self._count), inf)
        for leg, cost in costs.items():
            table[leg] = cost
        return table


def find_orders(
    scenario: Scenario, solve: LegSolver, count: int = BEST_FEW
) -> tuple[OrderSearch, ...]:
    """Search for the cheapest orders of the waypoints of a mission; return at most `count` orders.

    The function `solve` (see `LegTable`) is called for every leg of the returned orders. The cost
    of any other leg, or of a leg whose solve fails, may be a prediction. If zones leave no way to
    visit all places, the result is only the scenario's own order, at infinite cost.
    """
    table = LegTable(scenario, solve)
    n = len(scenario.mission.waypoints)
    if not table.legs:
        return (OrderSearch(order=tuple(range(n)), cost_J=inf, bound_J=inf, solved=0, legs=0),)
    table.solve_for(table.legs if len(table.legs) <= _FEW_LEGS else _first_legs(table.lengths))
    rounds = 0
    while True:
        costs = table.costs()
        cheapest_orders = best_orders(costs, count)
        rounds += 1
        is_last = n > MOST_EXACT and rounds >= _MOST_ROUNDS
        # If the cheapest orders have no unsolved leg, every other order costs at least as much,
        # even by the optimistic predictions.
        if not table.solve_for(leg for order in cheapest_orders for leg in _legs_of(order)):
            break
        if is_last:
            costs = table.costs()
            break
    reached = cost_of(costs, cheapest_orders[0])
    bound = reached if n <= MOST_EXACT else least_cost(costs, reached)
    found = [
        OrderSearch(
            order=order,
            cost_J=cost_of(costs, order),
            bound_J=bound,
            solved=table.solved,
            legs=len(table.legs),
        )
        for order in cheapest_orders
    ]
    return tuple(sorted(found, key=lambda search: search.cost_J))


def legs_expected(waypoints: int) -> int:
    """Return the approximate number of legs that a search for the best order solves first.

    `waypoints` is the number of waypoints. The search may solve more legs later. The result serves
    to estimate its computing time.
    """
    every = waypoints * (waypoints + 1)
    first = _NEAREST * (waypoints + 1) + _OF_ALL_LENGTHS
    return every if every <= _FEW_LEGS else min(every, first)


def _legs_of(order: Sequence[int]) -> list[_Leg]:
    return list(pairwise((0, *(k + 1 for k in order), len(order) + 1)))


def _first_legs(lengths: FloatArray) -> list[_Leg]:
    """Return the legs (pairs of indices of places) that are solved first.

    These are legs to the nearest places, legs of the shortest order, and ten legs from the shortest
    to the longest. `lengths` is the matrix of all lengths [m], infinite for forbidden legs.
    """
    near = [(k, int(j)) for k, row in enumerate(lengths) for j in np.argsort(row)[:_NEAREST]]
    (shortest,) = best_orders(lengths, 1)
    by_length = np.argsort(lengths, axis=None)[: np.isfinite(lengths).sum()]
    spread = by_length[np.linspace(0, len(by_length) - 1, _OF_ALL_LENGTHS).astype(int)]
    others = [divmod(int(leg), len(lengths)) for leg in spread]
    return [leg for leg in (*near, *_legs_of(shortest), *others) if np.isfinite(lengths[leg])]


def _shortest_ways(scenario: Scenario) -> dict[_Leg, Route]:
    """Return the shortest route for each leg that an order of the waypoints may use.

    Legs for which zones block every route are left out.
    """
    places, ways = scenario.mission.positions, {}
    last = len(places) - 1
    for here, there in permutations(range(len(places)), 2):
        if there == 0 or here == last or (here, there) == (0, last):
            continue
        for way in find_routes(scenario.airspace, places[here], places[there], most=1):
            ways[here, there] = way
    return ways


class BestOrder:
    """Search for the cheapest order of a mission's waypoints, and for the plan in this order.

    Parameters
    ----------
    problems : Problems
        Compiler of scenarios, which caches compiled problems.
    scenario : Scenario
        The mission, whose waypoints may be visited in any order.
    search : Search
        Progress callback of all solves, which stops a solve when the time limit is reached.
    """

    def __init__(self, problems: Problems, scenario: Scenario, search: Search) -> None:
        self._problems, self._scenario, self._search = problems, scenario, search
        self._is_plain = False
        self._flown: list[tuple[float, OrderSearch, Solution | None]] = []

    def candidates(self) -> tuple[OrderSearch, ...]:
        """Return the at most three cheapest orders of the waypoints, by the costs of their legs.

        Each `OrderSearch` has one order. A leg is the flight between two places, from hover to
        hover.
        """
        return find_orders(self._scenario.as_forecast(), self._leg)

    def has_time(self) -> bool:
        """Return whether there is time to solve the mission for another order of the waypoints.

        There is time until the time limit of the search is reached. The first order is always
        solved.
        """
        return not self._flown or not self._search.deadline.is_over

    def fly(self, found: OrderSearch) -> str:
        """Solve the mission for one order of the waypoints on a coarse mesh, and keep the solution.

        `found`, one of the `candidates`, has the order. The result is a text with the cost [J], or
        with the status of a failed solve.
        """
        solution = self._roughly(in_order(self._scenario, found.order))
        is_flown = solution.status.is_solved
        cost = solution.objective if is_flown else inf
        self._flown.append((cost, found, solution if is_flown else None))
        return f"{cost:.6g} J on a first mesh" if is_flown else solution.status.value

    def finish(self, solve: Callable[[Scenario, Start | None, Search], Plan]) -> Plan:
        """Return the verified plan for the order of least cost on a coarse mesh.

        `solve` takes the scenario in this order, an initial guess from the coarse solution and the
        `Search`. It returns a verified plan. The guess is None if every coarse solve failed.
        """
        _, best, begun = min(self._flown, key=lambda entry: entry[0])
        ordered = in_order(self._scenario, best.order)
        start: Start | None = begun if begun is None or self._is_plain else begun.warm_start
        if begun is not None and self._problems.has_routes(ordered):
            start = AlongShortest(begun)
        self._search.restart_patience()
        plan = solve(ordered, start, self._search)
        return replace(plan, order_search=best if best.legs else None)

    def _leg(self, alone: Scenario, mesh: Mesh, route: Route | None) -> Solution:
        """Solve for the flight from one place of the mission to another, and return the solution.

        `alone` is the scenario of this flight. The initial guess follows `route`; without a route,
        it is a straight flight.
        """
        mission, guess = MissionProblem(self._problems, alone, self._search), None
        if route is not None:
            guess = guess_along((route,), alone.nominal_times, is_open=alone.mission.is_free)
        options = replace(mission.arguments["options"], tolerance=ON_FIRST)
        return mission.solve(mesh=mesh, tolerance=None, guess=guess, options=options)

    def _roughly(self, ordered: Scenario) -> Solution:
        """Return the solution of the mission on a coarse mesh, for one order of the waypoints.

        If the solve fails, it is the solution of a mission without the waypoints' radii and speed
        limits. Passing exact points at any speed is easier for the solver.
        """
        told = ordered.as_forecast()
        once = {"solver": told.solver.model_copy(update={"max_refinements": 0})}
        mission = MissionProblem(self._problems, told.model_copy(update=once), self._search)
        if mission.has_routes:
            return RouteFlights(mission).best(most=1)[0]
        candidate = Candidate(scenario=ordered, mission=mission, search=self._search)
        if not self._is_plain:
            carry_out(FIRST, candidate, self._search)
            if not candidate.found.status.has_failed:
                return candidate.found
        # A solve that fails for one order fails for all orders, so that all later orders start at
        # exact passages of the waypoints at once. This easier mission differs from the mission only
        # if a waypoint has a radius or a speed limit.
        past = mission.past_waypoints
        self._is_plain = past is not None
        return candidate.found if past is None else past.solve_roughly()
