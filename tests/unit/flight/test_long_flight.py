"""Where the search for a long flight starts: a mesh fine at both ends, and a cruise."""

import numpy as np
import pytest

from pyomo_quad.flight import Planner
from pyomo_quad.flight.long_flight import fine_mesh, guess_of, is_long
from tests.declared_model import scenario

DISTANCE_M = 1000.0


def told(**mission):
    goal = {"goal": {"position": [600.0, 800.0, 0.0]}, "duration": "free"}
    return scenario(
        vehicle={"use": "dji_matrice_100"},
        battery={"use": "matrice_100_pack"},
        wind={"use": "calm", "coupling": "drag"},
        power={"model": "momentum"},
        mission=goal | mission,
    )


@pytest.fixture(scope="module")
def steady():
    return Planner().steady_flight(told())


def test_elements_grow_from_both_ends_to_the_middle():
    widths = 70.0 * np.diff(fine_mesh(70.0, 4).breakpoints)
    half = widths[: len(widths) // 2]
    np.testing.assert_allclose(half[1:] / half[:-1], 1.15, rtol=1e-9)
    np.testing.assert_allclose(widths, widths[::-1], rtol=1e-9)
    assert widths[0] == pytest.approx(0.04)


def test_a_guess_of_a_free_duration_cruises_where_a_metre_costs_least(steady):
    guess = guess_of(told(), steady)
    course = np.array([0.6, 0.8, 0.0])
    middle = len(guess["time"]) // 2
    speed = float(np.hypot(guess["rigid_body.vx"], guess["rigid_body.vy"])[middle])
    costs = [steady.trim(course * (speed + off)).power_W / (speed + off) for off in (-1, 0, 1)]
    assert costs[1] == min(costs)
    trim = steady.held_in(steady.trim(course * speed))
    for name in ("rigid_body.phi", "rigid_body.theta", "rotors.omega[1]", "power.induced_velocity"):
        assert guess[name][middle] == pytest.approx(trim[name], rel=1e-6)


@pytest.mark.parametrize("duration", [50.0, 120.0])
def test_a_guess_goes_from_place_to_place_in_the_time_given(steady, duration):
    guess = guess_of(told(duration=duration), steady)
    assert guess["time"][-1] == pytest.approx(duration, rel=1e-2)
    assert [guess["rigid_body.x"][-1], guess["rigid_body.y"][-1]] == pytest.approx([600.0, 800.0])
    flown = np.hypot(np.gradient(guess["rigid_body.x"]), np.gradient(guess["rigid_body.y"])).sum()
    assert flown == pytest.approx(DISTANCE_M, rel=1e-2)


def test_a_flight_is_long_where_equal_elements_would_be():
    assert is_long(told())
    assert is_long(told(duration=31.0))
    assert not is_long(told(duration=30.0))
    assert not is_long(told(waypoints=[{"position": [300.0, 0.0, 0.0]}]))
