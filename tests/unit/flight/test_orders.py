"""Searched orders against exact ones, exact ones against all there are, and bounds below both."""

from itertools import permutations

import numpy as np
import pytest

from pyomo_quad.flight.orders import (
    OrderSearch,
    best_orders,
    cost_of,
    exact_orders,
    least_cost,
    search_orders,
)


def lopsided(places, seed):
    """Return costs of legs between random places in a wind and with climbs."""
    random = np.random.default_rng(seed)
    at = random.uniform(0.0, 1.0, (places + 2, 3))
    steps = at[None] - at[:, None]
    wind = 0.3 * random.normal(size=3)
    return np.linalg.norm(steps, axis=2) + 0.3 + steps @ wind + 0.2 * np.abs(steps[..., 0])


def anyhow(places, seed):
    return np.random.default_rng(seed).uniform(1.0, 9.0, (places + 2, places + 2))


@pytest.mark.parametrize("places", [1, 2, 5, 6])
def test_exact_orders_are_the_best_of_all(places):
    costs = anyhow(places, places)
    every = sorted(permutations(range(places)), key=lambda order: cost_of(costs, order))
    assert exact_orders(costs, 3) == every[:3]


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("places", [8, 10])
@pytest.mark.parametrize("drawn", [lopsided, anyhow])
def test_a_search_finds_the_exact_order_and_the_bound_is_below(drawn, places, seed):
    costs = drawn(places, seed)
    (best,), searched = exact_orders(costs, 1), search_orders(costs, 3)
    assert searched[0] == best
    assert len(set(searched)) == 3
    least = cost_of(costs, best)
    bound = least_cost(costs, least)
    assert 0.85 * least < bound <= least
    # It is a bound whatever the ascent aims at.
    assert least_cost(costs, 1.1 * least) <= least * (1 + 1e-12)


def test_thirty_places_have_an_order_within_two_percent_of_the_bound():
    costs = lopsided(30, 1)
    (order,) = best_orders(costs, 1)
    assert sorted(order) == list(range(30))
    assert 0.98 * cost_of(costs, order) < least_cost(costs, cost_of(costs, order))


def test_twelve_places_are_ordered_exactly():
    costs = anyhow(12, 3)
    assert best_orders(costs, 3) == exact_orders(costs, 3)


def test_potentials_leave_the_bound_as_it_is():
    """Head wind and climbs cancel along every order, and must not loosen the bound."""
    costs = lopsided(20, 4)
    height = np.random.default_rng(4).uniform(0.0, 5.0, 22)
    height[-1] = height[0]
    climbing = costs + height[None, :] - height[:, None]
    (order,) = search_orders(costs, 1)
    assert cost_of(climbing, order) == pytest.approx(cost_of(costs, order))
    level, tilted = (least_cost(table, cost_of(costs, order)) for table in (costs, climbing))
    assert tilted == pytest.approx(level, rel=5e-3)


def test_a_leg_that_leads_one_way_only_does_not_loosen_the_bound():
    costs = lopsided(20, 4)
    (order,) = search_orders(costs, 1)
    least = cost_of(costs, order)
    level = least_cost(costs, least)
    costs[order[3] + 1, order[2] + 1] = costs[order[9] + 1, order[8] + 1] = np.inf
    assert least_cost(costs, least) == pytest.approx(level, rel=5e-3)


def test_a_leg_that_none_can_fly_is_in_no_order_where_another_leads():
    costs = lopsided(9, 5)
    (best,) = exact_orders(costs, 1)
    costs[0, best[0] + 1] = np.inf
    for orders in (exact_orders(costs, 3), search_orders(costs, 3)):
        assert all(order[0] != best[0] for order in orders)
        assert np.isfinite(cost_of(costs, orders[0]))


def test_a_gap_is_a_share_of_the_bound():
    search = OrderSearch(order=(1, 0), cost_J=102.0, bound_J=100.0, solved=4, legs=6)
    assert search.gap == pytest.approx(0.02)
