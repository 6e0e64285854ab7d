"""Smooth limits and the projection."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from pyomo_quad.flight.controller import bend, braking_rate, project

numbers = st.floats(-50.0, 50.0)
vectors = arrays(float, 3, elements=numbers)


@given(numbers, st.floats(0.1, 10.0))
def test_bend_keeps_small_numbers_and_the_limit(magnitude, limit):
    bent = bend(magnitude, limit)
    assert abs(bent) <= limit
    assert bend(-magnitude, limit) == -bent
    if abs(magnitude) <= 0.8 * limit:
        assert bent == magnitude


def test_bend_is_smooth_where_it_begins():
    x = 0.8 + np.linspace(-1e-3, 1e-3, 5)
    slopes = np.diff([bend(v, 1.0) for v in x]) / np.diff(x)
    assert slopes == pytest.approx(np.ones(4), abs=1e-4)


@given(numbers, st.floats(0.1, 100.0), st.floats(0.1, 100.0))
def test_braking_rate_can_be_braked(error, gain, acceleration_max):
    rate = braking_rate(error, gain, acceleration_max)
    step = 1e-6 * max(abs(error), 1e-3)
    slope = (braking_rate(error + step, gain, acceleration_max) - rate) / step
    assert abs(rate * slope) <= 0.5 * acceleration_max * (1 + 1e-4)
    assert rate * error >= 0.0


@given(vectors, vectors, vectors, st.floats(0.5, 5.0))
def test_projection_never_raises_v_and_keeps_the_ball(direction, rate, truth, bound):
    norm = np.linalg.norm(direction)
    estimate = direction / norm * bound * 0.99 if norm > 1e-3 else np.zeros(3)
    truth = truth / max(1.0, np.linalg.norm(truth) / (0.9 * bound))
    applied = np.array(project(estimate, rate, bound))
    scale = 1.0 + np.linalg.norm(rate) * bound
    assert (estimate - truth) @ (applied - rate) <= 1e-9 * scale
    at_the_wall = estimate / 0.99
    assert at_the_wall @ np.array(project(at_the_wall, rate, bound)) <= 1e-9 * scale


def test_projection_leaves_the_inside_alone():
    assert project((0.1, 0.2, 0.3), (5.0, 6.0, 7.0), 1.0) == [5.0, 6.0, 7.0]
