"""Pairs of places are drawn where a vehicle may be, random starts go round the buildings, and plans
that a random start beats are counted.
"""

from itertools import pairwise
from math import nan

import numpy as np
import pytest

from pyomo_quad.flight.zones import are_blocked
from tests.benchmarks.pairs import (
    DIRECTIONS,
    FARTHEST_M,
    NEAREST_M,
    Outcome,
    has_way,
    is_free,
    mission_of,
    missions,
    random_routes,
    tables,
    told_of,
)


@pytest.fixture(scope="module")
def told():
    return told_of(next(missions(1, DIRECTIONS[0])))


@pytest.mark.lengthy
def test_equal_directions_draw_equal_missions():
    one, other = (list(missions(2, direction)) for direction in DIRECTIONS[:2])
    assert one == list(missions(2, DIRECTIONS[0])) != other


def test_places_lie_free_and_as_far_apart_as_told(told):
    start, goal = told.mission.positions
    assert is_free(told, start)
    assert is_free(told, goal)
    assert NEAREST_M <= np.linalg.norm(np.subtract(goal, start)) <= FARTHEST_M
    house = np.mean(told.airspace.keep_out[0].corners, axis=0)
    assert not is_free(told, (*house, 15.0))


@pytest.mark.lengthy
def test_places_that_buildings_and_the_edge_of_the_field_part_are_no_pair(told):
    """Houses 10 and 12 and the field's edge close a yard; a place beside it is in the open."""
    yard = np.array([329.0, 215.8, 15.0])
    start, goal = (np.array(place) for place in told.mission.positions)

    def joins(one, other):
        return has_way(told_of(mission_of(DIRECTIONS[0], one, other)))

    assert joins(start, goal)
    assert joins(yard, yard - [1.0, 0.0, 0.0])
    assert not joins(yard, goal)


@pytest.mark.lengthy
def test_random_routes_differ_and_lead_from_start_to_goal_past_all_buildings(told):
    journeys = random_routes(told, 4, seed=1)
    assert len({journey[0].length for journey in journeys}) == 4
    for (route,) in journeys:
        np.testing.assert_allclose(route.places[[0, -1]], told.mission.positions)
        for zone in told.airspace.keep_out:
            lines = (np.array(ends) for ends in zip(*pairwise(route.places), strict=True))
            assert not are_blocked(zone, *lines, told.airspace.clearance - 1e-6).any()


def test_plans_that_a_random_start_beats_are_counted():
    settings = next(missions(1, DIRECTIONS[0]))

    def outcome(number, plan_J, best_J, energies_J, ended="verified", bound_J=None):
        numbers = plan_J, best_J, energies_J, bound_J
        return Outcome(DIRECTIONS[0], number, settings, ended, *numbers, 2, 8.0, 40.0)

    found = [
        outcome(0, 1006.0, 1000.0, (1000.0, 1000.5, 1200.0), bound_J=503.0),
        outcome(1, 990.0, 1000.0, (1000.0,), bound_J=1000.0),
        outcome(2, nan, 1000.0, ()),
        outcome(3, 700.0, 1000.0, (), "infeasible"),
    ]
    directions, each = tables(found)
    assert directions.rows[0][:6] == [DIRECTIONS[0], 4, 2, "0.60", 1, 1]
    # One plan is half above its bound, one below it: what none may be.
    assert directions.rows[0][6:8] == [1, "24"]
    assert directions.rows[-1][0] == "all"
    assert [row[9:11] for row in each.rows] == [
        ["3 of 20", 2],
        ["1 of 20", 1],
        ["0 of 20", 0],
        ["0 of 20", 0],
    ]
