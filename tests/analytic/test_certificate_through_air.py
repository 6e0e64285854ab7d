"""The bound over pairs of thrust and airspeed against closed forms and steady flight."""

import numpy as np
import pytest

from pyomo_quad.flight.steady import MomentumDemand
from pyomo_quad.study.pairs import POWER_TOLERANCE, MotionPrices, Pairs
from tests.declared_model import scenario
from tests.flights import PLANNER, certified

M100 = {
    "vehicle": {"use": "dji_matrice_100"},
    "battery": {"use": "matrice_100_pack"},
    "power": {"model": "momentum"},
    "wind": {"use": "constant", "speed": 0.0, "coupling": "drag"},
}


def flying(goal, duration, head_wind=0.0):
    mission = {"goal": {"position": goal}, "duration": duration}
    wind = M100["wind"] | {"speed": head_wind, "direction": np.pi}
    return scenario(**(M100 | {"mission": mission, "wind": wind}))


@pytest.fixture(scope="module")
def pairs():
    planner, told = PLANNER, flying([100.0, 0.0, 0.0], 10.0)
    dynamics, steady = planner.dynamics(told), planner.steady_flight(told)
    standing = MomentumDemand(dynamics).thrust(0.0)
    most = float(steady.thrust(told.limits.rotor_speed_max))
    return Pairs(told, dynamics, standing, most), steady


def test_a_steady_flight_costs_what_its_trim_does(pairs):
    # Priced at nothing but its own power, no pair is cheaper than the cheapest sample of all.
    found, steady = pairs
    weight = found.standing[2]
    hover = steady.hover_power
    prices = MotionPrices(
        momentum=np.array([0.0, 0.0, 1.4 * hover / weight]),
        displacement=np.array([3.0, 0.0, weight]),
        motion=1.05,
    )
    for speed in (0.0, 8.0, 15.0):
        # In steady flight force and its power are nought on average: only the way is priced.
        least, _ = found.cheapest(prices, 1.0)
        assert least <= steady.trim([speed, 0.0, 0.0]).power_W - 3.0 * speed + 1e-6


def test_no_airspeed_is_beyond_that_of_full_thrust_and_weight_together(pairs):
    # 0.322 V + 0.038 V^2 = what all rotors and the weight pull.
    pulled = 4 * 3.7e-5 * 746.0**2 + 3.715 * 9.81
    by_hand = (-0.322 + np.sqrt(0.322**2 + 4 * 0.038 * pulled)) / (2 * 0.038)
    assert pairs[0].fastest == pytest.approx(by_hand, rel=1e-6)


@pytest.mark.slow
def test_what_is_proven_is_below_every_sample_and_near_the_least(pairs):
    found, steady = pairs
    generator, tolerance = np.random.default_rng(3), POWER_TOLERANCE * steady.hover_power
    for _ in range(3):
        prices = MotionPrices(
            momentum=np.array([1.0, 0.5, 16.0]) * generator.uniform(0.9, 1.1, 3),
            displacement=np.array([20.0, 5.0, 40.0]) * generator.uniform(0.8, 1.2, 3),
            motion=1.1,
        )
        sampled, _ = found.cheapest(prices, 1.0)
        proven = found.least(prices, 1.0, tolerance)
        assert sampled - 3 * tolerance <= proven <= sampled - 0.999 * tolerance


@pytest.mark.slow
@pytest.mark.parametrize(("head_wind", "gap"), [(0.0, 1.5e-2), (5.0, 1.5e-2), (12.0, 2e-2)])
def test_a_long_way_in_free_time_is_bounded_by_its_best_steady_speed(head_wind, gap):
    told = flying([1000.0, 0.0, 0.0], "free", head_wind)
    steady = PLANNER.steady_flight(told)
    speeds = np.arange(4.0, 22.0, 0.5)
    powers = [steady.trim([v + head_wind, 0.0, 0.0]).power_W for v in speeds]
    best = 1000.0 * np.min(np.array(powers) / speeds)
    found = certified(told).lower_bound_J
    assert found <= best
    assert found == pytest.approx(best, rel=gap)


@pytest.mark.slow
def test_a_given_time_is_bounded_by_the_steady_speed_it_asks_for():
    told = flying([0.0, 1000.0, 0.0], 80.0)
    cruise = 80.0 * PLANNER.steady_flight(told).trim([0.0, 12.5, 0.0]).power_W
    found = certified(told).lower_bound_J
    assert found <= cruise
    assert found == pytest.approx(cruise, rel=1e-2)


@pytest.mark.slow
def test_staying_in_place_may_be_circling_and_costs_least_power_at_least():
    told = flying([0.0, 0.0, 0.0], 10.0)
    steady = PLANNER.steady_flight(told)
    least = 10.0 * min(steady.trim([v, 0.0, 0.0]).power_W for v in np.arange(5.0, 11.0, 0.5))
    found = certified(told)
    assert found.lower_bound_J <= found.hover_energy_J
    assert found.lower_bound_J == pytest.approx(least, rel=2e-2)
    assert "proven by branch and bound" in found.reason
