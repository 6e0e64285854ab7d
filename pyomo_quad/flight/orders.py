"""Cheapest orders of places from a table of leg costs, and a lower bound on the cost of any order.

A leg is the flight from one place to another. In the table `costs`, shape (n + 2, n + 2), a leg
begins at the place of its row and ends at that of its column: the start, n places, the goal. A leg
that is not allowed has infinite cost. An order lists the n places; index k stands for row and
column k + 1. A local change of an order exchanges two neighbouring blocks of places, or reverses
one block. Bound: docs/theory/orders.md, eqs. (2) to (5).
"""

from dataclasses import dataclass
from itertools import combinations
from math import inf

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from pyomo_quad.arrays import FloatArray

IntArray = NDArray[np.intp]
_Order = tuple[int, ...]

#: Number of places up to which the cheapest orders are exact; above it a search finds them.
MOST_EXACT = 12
# Number of further descents of the local search, each from a perturbed best order.
_KICKS = 30
# Number of block exchanges in a perturbation.
_EXCHANGES = 3
# Number of steps of the subgradient ascent to the bound.
_ASCENT_STEPS = 400
# Factor by which the step is reduced if the bound has not increased for `_PATIENCE` steps.
_SHRINK, _PATIENCE = 0.7, 10
# Relative gain below which two orders count as equal.
_ROUNDING = 1e-12


@dataclass(frozen=True, kw_only=True)
class OrderSearch:
    """Result of the search for the cheapest order of the waypoints of a mission.

    Attributes
    ----------
    order : tuple of int
        Indices of the waypoints, in the order of the plan.
    cost_J : float
        Cost of this order [J], the sum of the costs of its legs (flights from hover to hover). The
        cost of a leg is energy + price of time [W] x duration.
    bound_J : float
        Lower bound on the cost of every order [J], with optimistic costs of unsolved legs.
    solved, legs : int
        Number of solved legs, and of all legs that orders may use.
    """

    order: tuple[int, ...]
    cost_J: float
    bound_J: float
    solved: int
    legs: int

    @property
    def name(self) -> str:
        """Order of the waypoints in words, as in "waypoints in order 2, 0, 1"."""
        return f"waypoints in order {', '.join(str(k) for k in self.order)}"

    @property
    def gap(self) -> float:
        """Relative gap between the cost of the order found and the lower bound: cost / bound - 1.

        The lower bound, `bound_J`, holds for the cost of every order. The order found therefore
        costs at most this fraction more than the cheapest order.
        """
        return self.cost_J / self.bound_J - 1.0

    @property
    def line(self) -> str:
        """Summary of the search for the order of the waypoints, in one line.

        It states `gap`, the relative distance from the lower bound, and how many legs were solved.
        A leg is the flight from one place to the next.
        """
        return (
            f"order of {len(self.order)} waypoints: the energies of its legs, planned one by one, "
            f"add up to at most {self.gap:.2%} above the best order; {self.solved} of {self.legs} "
            "legs solved, the others predicted from these"
        )


def best_orders(costs: FloatArray, count: int) -> list[_Order]:
    """Return the cheapest orders of the places between start and goal, the cheapest first.

    The result is exact for at most 12 places (`MOST_EXACT`), otherwise from a local search. It has
    at most `count` orders. Orders with legs that are not allowed may follow after all others.
    """
    return (exact_orders if len(costs) - 2 <= MOST_EXACT else search_orders)(costs, count)


def cost_of(costs: FloatArray, order: _Order) -> float:
    """Return the cost of an order of places: the sum of the costs of its legs."""
    places = np.array([0, *(k + 1 for k in order), len(costs) - 1])
    return float(costs[places[:-1], places[1:]].sum())


def exact_orders(costs: FloatArray, count: int) -> list[_Order]:
    """Return the cheapest orders of places, the cheapest first, by dynamic programming [1]_.

    There are `count` orders, or fewer if fewer exist.

    .. [1] Held and Karp, "A dynamic programming approach to sequencing problems", SIAM J. 10
       (1962).
    """
    n = len(costs) - 2
    # A state of the recursion is the set of the places passed so far, and the place passed last.
    # For each state, the `count` cheapest orders of the places passed so far are kept.
    best = np.full((1 << n, n, count), inf)
    came_from = np.full((1 << n, n, count), -1, dtype=np.int32)
    for k in range(n):
        best[1 << k, k, 0] = costs[0, k + 1]
    for passed in range(1, (1 << n) - 1):
        left = [k for k in range(n) if not passed >> k & 1]
        # Each set of places with a last place has one predecessor set: the set without that place.
        reached = best[passed].reshape(-1, 1) + np.repeat(costs[1:-1, 1:-1], count, axis=0)[:, left]
        kept = np.argsort(reached, axis=0, kind="stable")[:count]
        for column, there in enumerate(left):
            rows = kept[:, column]
            best[passed | 1 << there, there, : len(rows)] = reached[rows, column]
            came_from[passed | 1 << there, there, : len(rows)] = rows
    every = (1 << n) - 1
    ended = (best[every] + costs[1:-1, -1:]).ravel()
    # Ranks without an order stay infinite and have no predecessor.
    begun = best[every].ravel() < inf
    ranked = [k for k in np.argsort(ended, kind="stable").tolist() if begun[k]][:count]
    return [_traced_back(came_from, every, row, count) for row in ranked]


def _traced_back(came_from: NDArray[np.int32], passed: int, row: int, count: int) -> _Order:
    order: list[int] = []
    while row >= 0:
        last, rank = divmod(row, count)
        order.append(last)
        row = int(came_from[passed, last, rank])
        passed &= ~(1 << last)
    return tuple(reversed(order))


def search_orders(costs: FloatArray, count: int) -> list[_Order]:
    """Return up to `count` orders of places that a local search finds, the cheapest first.

    A local change exchanges two neighbouring blocks of an order, or reverses a block [1]_. The
    result is the same in every call.

    .. [1] Kanellakis and Papadimitriou, "Local search for the asymmetric traveling salesman
       problem", Operations Research 28 (1980).
    """
    finite = _without_infinities(costs)
    neighbours, random = _neighbours(len(costs) - 2), np.random.default_rng(0)
    best = _descended(finite, neighbours, nearest_first(finite))
    found = {_named(best): _cost(finite, best[None])[0]}
    for _ in range(_KICKS):
        # Descents are repeated from random perturbations of the best order.
        kicked = best
        for exchange in random.integers(len(neighbours), size=_EXCHANGES):
            kicked = kicked[neighbours[exchange]]
        tried = _descended(finite, neighbours, kicked)
        found[_named(tried)] = _cost(finite, tried[None])[0]
        best = min(best, tried, key=lambda order: found[_named(order)])
    beside = best[neighbours]
    found |= zip(map(_named, beside), _cost(finite, beside), strict=True)
    return sorted(found, key=lambda order: (found[order], order))[:count]


def _without_infinities(costs: FloatArray) -> FloatArray:
    """Return a table of leg costs with a large number in place of infinite costs.

    The number exceeds the cost of every order that uses allowed legs only.
    """
    # The assignment and the local search need finite numbers.
    finite = costs[np.isfinite(costs)]
    large = 1.0 + len(costs) * float(np.max(np.abs(finite), initial=0.0))
    return np.where(np.isfinite(costs), costs, large)


def _neighbours(n: int) -> IntArray:
    """Return all orders that one local change makes from the order 0, 1, ..., n - 1.

    Each row is one of these orders. It is also the index array of its change: `order[row]` is
    `order` after the change.
    """
    every = np.arange(n)
    # An exchange of two blocks keeps the direction of flight within them.
    rows = [
        np.concatenate([every[:i], every[j:k], every[i:j], every[k:]])
        for i, j, k in combinations(range(n + 1), 3)
    ]
    rows += [
        np.concatenate([every[:i], every[i:k][::-1], every[k:]])
        for i, k in combinations(range(n + 1), 2)
        if k - i > 1
    ]
    return np.array(rows)


def _named(order: IntArray) -> _Order:
    return tuple(int(k) - 1 for k in order)


def _cost(costs: FloatArray, orders: IntArray) -> FloatArray:
    """Return the cost of each of several orders of places, shape (n_orders,).

    Each row of `orders` has the n places as row numbers in `costs`, 1 to n.
    """
    between = costs[orders[:, :-1], orders[:, 1:]].sum(axis=1)
    return np.asarray(costs[0, orders[:, 0]] + between + costs[orders[:, -1], -1])


def nearest_first(costs: FloatArray) -> IntArray:
    """Return the greedy order of places: the next place is always the cheapest one to reach.

    The result has the n places as row numbers in `costs`, 1 to n. `costs` may hold lengths.
    """
    order, left = [0], list(range(1, len(costs) - 1))
    while left:
        order.append(left.pop(int(np.argmin(costs[order[-1], left]))))
    return np.array(order[1:])


def _descended(costs: FloatArray, neighbours: IntArray, order: IntArray) -> IntArray:
    """Return the locally optimal order that steepest descent finds from an initial order.

    Each row of `neighbours` is the index array of a local change, from `_neighbours`. `order` has
    the n places as row numbers in `costs`, 1 to n.
    """
    cost = _cost(costs, order[None])[0]
    while True:
        beside = order[neighbours]
        tried = _cost(costs, beside)
        best = int(np.argmin(tried))
        if tried[best] >= cost - _ROUNDING * abs(cost):
            return order
        order, cost = beside[best], tried[best]


def least_cost(costs: FloatArray, reached: float) -> float:
    """Return a lower bound on the cost of every order of the places between start and goal.

    There must be at least one place. The bound is the larger of two, by assignment and by spanning
    trees [1]_. `reached` is the cost of a known order. It sets the steps of the iteration for the
    trees, and a result above it is replaced by `reached`. See docs/theory/orders.md, eqs. (2) to
    (5).

    .. [1] Held and Karp, "The traveling-salesman problem and minimum spanning trees", Operations
       Research 18 (1970).
    """
    finite = _without_infinities(costs)
    successors = finite[:-1, 1:].copy()
    # A leg to the same place is not allowed, nor is a leg past all places.
    np.fill_diagonal(successors[1:], np.max(finite) * len(costs))
    successors[0, -1] = np.max(finite) * len(costs)
    assigned = float(successors[linear_sum_assignment(successors)].sum())
    return min(max(assigned, _tree_bound(_made_symmetric(costs, finite), reached)), reached)


def _made_symmetric(costs: FloatArray, finite: FloatArray) -> FloatArray:
    """Return leg costs that do not depend on direction: docs/theory/orders.md, eq. (3).

    `finite` is `costs` with large numbers in place of infinite costs.
    """
    potential = np.zeros(len(costs))
    # The potentials are computed from the legs that are allowed in both directions.
    is_both = np.isfinite(costs + costs.T)[1:-1, 1:-1]
    skew = np.where(is_both, (finite - finite.T)[1:-1, 1:-1], 0.0)
    potential[1:-1] = -skew.mean(axis=1) / 2.0
    level = finite + potential[:, None] - potential[None, :]
    symmetric = np.minimum(level, level.T)
    symmetric[0, :] = symmetric[:, 0] = level[0, :]
    symmetric[-1, :] = symmetric[:, -1] = level[:, -1]
    symmetric[0, -1] = symmetric[-1, 0] = inf
    return symmetric


def _tree_bound(costs: FloatArray, reached: float) -> float:
    """Return a lower bound on the cost of every order of places, by minimum spanning trees.

    `costs` is symmetric, as `_made_symmetric` returns it. `reached` is the cost of a known order.
    Implements docs/theory/orders.md, eq. (5).
    """
    # An order is a spanning tree in which each place between start and goal has exactly two legs.
    # The prices of places penalise other numbers of legs.
    degrees = np.full(len(costs), 2.0)
    degrees[[0, -1]] = 1.0
    prices, best, eager, idle = np.zeros(len(costs)), -inf, 1.0, 0
    for _ in range(_ASCENT_STEPS):
        tree, met = _least_tree(costs + prices[:, None] + prices[None, :])
        bound = tree - float(prices @ degrees)
        idle = 0 if bound > best else idle + 1
        best = max(best, bound)
        missing = met - degrees
        if not missing.any():
            break
        if idle > _PATIENCE:
            eager, idle = _SHRINK * eager, 0
        # The step length follows from the gap between the bound and the cost of a known order.
        prices += eager * max(reached - bound, 0.0) / float(missing @ missing) * missing
    return best


def _least_tree(costs: FloatArray) -> tuple[float, FloatArray]:
    """Return the cost of the minimum spanning tree, and the number of its legs at each place.

    The tree joins all places, including start and goal. `costs` is symmetric, shape (n + 2, n + 2).
    Implements docs/theory/orders.md, eq. (4), by Prim's method.
    """
    n = len(costs)
    degrees, nearest, by = np.zeros(n), costs[0].copy(), np.zeros(n, dtype=int)
    is_left = np.ones(n, dtype=bool)
    is_left[0] = False
    cost = 0.0
    for _ in range(n - 1):
        here = int(np.argmin(np.where(is_left, nearest, inf)))
        cost += float(nearest[here])
        degrees[[here, by[here]]] += 1.0
        is_left[here] = False
        closer = costs[here] < nearest
        nearest, by = np.where(closer, costs[here], nearest), np.where(closer, here, by)
    return cost, degrees
