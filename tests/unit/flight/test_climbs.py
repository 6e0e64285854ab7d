"""Routes over terrain: raised legs clear the ground, with two corners at most."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pyomo_quad.flight.climbs import over_the_ground
from pyomo_quad.flight.routes import find_routes
from pyomo_quad.scenario.airspace import Airspace, TerrainGrid
from pyomo_quad.scenario.packed_arrays import packed

X, Y = np.arange(0.0, 201.0, 10.0), np.arange(0.0, 61.0, 10.0)
FLOOR = 4.0


def airspace(heights, **fields):
    ground = TerrainGrid(x=tuple(X), y=tuple(Y), heights=packed(heights))
    return Airspace(ground=ground, terrain="t.nc", floor=FLOOR, **fields)


def hills(seed):
    generator = np.random.default_rng(seed)
    found = np.zeros((X.size, Y.size))
    for _ in range(3):
        (east, north), high = generator.uniform(0, [200, 60]), generator.uniform(0, 40)
        off = (X[:, None] - east) ** 2 + (Y - north) ** 2
        found += high / (1 + off / 25.0**2) ** 1.5
    return found


def along(places, count=4000):
    steps = np.linalg.norm(np.diff(places, axis=0), axis=1)
    way = np.append(0.0, np.cumsum(steps))
    at = np.linspace(0.0, way[-1], count)
    return np.column_stack([np.interp(at, way, column) for column in places.T])


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10_000), up=st.floats(0.5, 60.0), more=st.floats(0.5, 60.0))
def test_a_raised_leg_clears_the_floor_and_has_two_corners_at_most(seed, up, more):
    space = airspace(hills(seed))
    ends = np.array([[5.0, 10.0, 0.0], [190.0, 50.0, 0.0]])
    ends[:, 2] = FLOOR + np.array([up, more]) - space.height_above_ground(ends)
    route = over_the_ground(ends, space)
    assert 2 <= len(route) <= 4
    assert route[[0, -1]] == pytest.approx(ends)
    assert space.height_above_ground(along(route)).min() >= FLOOR
    if space.height_above_ground(along(ends)).min() > FLOOR + 0.6:
        assert len(route) == 2


def test_a_cruise_goes_over_a_hill_and_over_flat_ground_straight():
    start, goal = (5.0, 30.0, 10.0), (195.0, 30.0, 10.0)
    bell = 30.0 / (1 + ((X[:, None] - 100.0) ** 2 + 0 * Y) / 30.0**2)
    (over,) = find_routes(airspace(bell), start, goal)
    assert over.places[:, 2].max() == pytest.approx(34.5, abs=5.0)
    (straight,) = find_routes(airspace(0 * bell), start, goal)
    assert straight.places == pytest.approx(np.array([start, goal]))
