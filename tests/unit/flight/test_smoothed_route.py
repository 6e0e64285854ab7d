"""Smooth paths along routes: exact places, rests, and bounds on speed and acceleration."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from pyomo_quad.flight.smoothed_route import _AVERAGED_S, Pace, Stop, smoothed

PACE = Pace(speed=8.0, acceleration=2.0, turning=2.0)


def stops_at(*places, **asked):
    return [Stop(place=np.array(place, dtype=float), **asked) for place in places]


def at_rest(path, t):
    _, velocity, acceleration = path.at(np.array([t]))
    return np.abs(velocity).max() < 1e-3 and np.abs(acceleration).max() < 1e-2


def test_a_straight_path_takes_the_time_of_the_closed_form():
    path = smoothed(stops_at((0, 0, 2), (100, 0, 2)), PACE)
    # Accelerating and braking take as long as flying the distance v^2/a at the speed v twice.
    travelling = 100.0 / PACE.speed + PACE.speed / PACE.acceleration
    rested = path.duration - travelling
    assert rested == pytest.approx(sum(_AVERAGED_S) + 0.4, abs=1e-9)
    assert_allclose(path.at(np.array([0.5 * (path.duration - 0.4)]))[0], [[50, 0, 2]], atol=1e-3)
    assert np.linalg.norm(path.velocities, axis=1).max() == pytest.approx(PACE.speed, rel=1e-6)
    assert np.linalg.norm(path.accelerations, axis=1).max() == pytest.approx(2.0, rel=1e-3)


def test_a_corner_is_passed_exactly_at_the_acceleration_of_turning():
    # At this speed, a turn by a right angle has just the acceleration that is allowed.
    speed = 2.0 * _AVERAGED_S[0] / np.sqrt(2.0)
    corner = np.array([60.0, 0.0, 5.0])
    pace = Pace(speed=speed, acceleration=2.0, turning=2.0)
    path = smoothed(stops_at((0, 0, 5), corner, (60, 60, 5)), pace)
    reached, left = path.passings[1]
    assert reached == left
    place, velocity, acceleration = path.at(np.array([reached]))
    assert_allclose(place[0], corner, atol=1e-3)
    assert_allclose(velocity[0], [speed / 2, speed / 2, 0.0], atol=1e-2)
    assert_allclose(acceleration[0], np.array([-1.0, 1.0, 0.0]) * np.sqrt(2.0), atol=1e-2)


def test_a_hover_is_at_rest_at_its_place_for_as_long_as_it_is_to_last():
    stops = stops_at((0, 0, 2), (40, 10, 8), (20, -30, 4))
    stops[1] = Stop(place=stops[1].place, hold=3.0)
    path = smoothed(stops, PACE)
    reached, left = path.passings[1]
    assert left - reached == pytest.approx(3.0)
    during = np.linspace(reached, left, 50)
    place, velocity, _ = path.at(during)
    assert_allclose(place, np.tile(stops[1].place, (50, 1)), atol=1e-3)
    assert np.abs(velocity).max() < 1e-3


def test_a_given_duration_is_kept_or_refused():
    stops = stops_at((0, 0, 2), (100, 0, 2), (100, 50, 20))
    path = smoothed(stops, PACE, 60.0)
    assert path.duration == 60.0
    assert np.linalg.norm(path.velocities, axis=1).max() < PACE.speed
    assert smoothed(stops, PACE, 15.0) is None


def test_the_speed_of_a_waypoint_is_kept():
    stops = stops_at((0, 0, 2), (50, 0, 2), (100, 1, 2))
    stops[1] = Stop(place=stops[1].place, speed_max=1.5)
    path = smoothed(stops, PACE)
    velocity = path.at(np.array([path.passings[1][0]]))[1]
    # The mean over the time of passing is faster by the average acceleration in that time.
    assert np.linalg.norm(velocity) <= 1.5 + 0.5 * PACE.acceleration * sum(_AVERAGED_S)
    assert smoothed(stops, PACE).duration > smoothed([stops[0], stops[2]], PACE).duration


coordinate = st.floats(min_value=-80.0, max_value=80.0)


@settings(max_examples=40, deadline=None)
@given(
    places=st.lists(st.tuples(coordinate, coordinate, coordinate), min_size=2, max_size=5),
    speed=st.floats(min_value=1.0, max_value=15.0),
    turning=st.floats(min_value=0.2, max_value=4.0),
)
def test_paths_keep_speed_and_pass_all_places(places, speed, turning):
    stops = stops_at(*places)
    pace = Pace(speed=speed, acceleration=2.0, turning=turning)
    path = smoothed(stops, pace)
    assert np.linalg.norm(path.velocities, axis=1).max() <= speed * (1 + 1e-6)
    assert at_rest(path, 0.0)
    assert at_rest(path, path.duration)
    # Braking and a turn may coincide.
    most = pace.acceleration + turning
    assert np.linalg.norm(path.accelerations, axis=1).max() <= most * 1.05
    assert np.all(np.diff([t for pair in path.passings for t in pair]) >= -1e-12)
    for stop, (reached, _) in zip(stops, path.passings, strict=True):
        assert_allclose(path.at(np.array([reached]))[0][0], stop.place, atol=0.05)
