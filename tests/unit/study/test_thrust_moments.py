"""The thrust that a flight must reach at some time, against the bang-bang flight of a point."""

from math import sqrt

import numpy as np
import pytest

from pyomo_quad.study.certificate import ThrustMoments
from tests.declared_model import momentum_demand, scenario

MASS, WEIGHT = 1.3, 1.3 * 9.81


def moments(displacement, duration, **tables):
    demand = momentum_demand(scenario(**tables))
    return ThrustMoments(demand, np.array(displacement), duration)


@pytest.mark.parametrize(("height", "duration"), [(8.0, 1.0), (30.0, 4.0), (-20.0, 2.0)])
def test_least_peak_of_a_vertical_flight_by_hand(height, duration):
    # Full thrust up, then full thrust down: with a = (u - mg)/m and b = (u + mg)/m the height is
    # T^2 a b / 2 (a + b) = T^2 (u^2 - (mg)^2) / 4 m u.
    force = 4 * MASS * abs(height) / duration**2
    expected = force / 2 + sqrt((force / 2) ** 2 + WEIGHT**2)
    found = moments([0.0, 0.0, height], duration).least_peak()
    assert found == pytest.approx(expected, rel=1e-3)
    assert found <= expected * (1 + 2e-4)


def test_least_peak_in_place_is_the_mean_thrust():
    held = moments([0.0, 0.0, 0.0], 5.0, wind={"use": "constant", "speed": 4.0})
    np.testing.assert_allclose(held.mean_thrust, [-MASS * 4.0, 0.0, WEIGHT], rtol=1e-9)
    assert held.least_peak() == pytest.approx(np.hypot(MASS * 4.0, WEIGHT), rel=1e-9)


def test_drag_adds_its_share_of_the_mean_velocity():
    wind = {"use": "calm", "coupling": "drag"}
    held = moments([6.0, 0.0, 8.0], 10.0, wind=wind, vehicle={"drag_linear": 0.5})
    np.testing.assert_allclose(held.mean_thrust, [0.3, 0.0, WEIGHT + 0.4], atol=1e-12)
