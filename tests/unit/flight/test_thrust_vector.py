"""Thrust as a vector, attitude, and what can be reached."""

from math import atan2, cos, hypot, sin, sqrt

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pyomo_quad.flight.controller import ThrustEnvelope, thrust_direction, tilt_toward

GRAVITY, MOST, TILT = 9.81, 12.0, 0.5
angles = st.floats(-1.2, 1.2)
accelerations = st.tuples(*[st.floats(-30.0, 30.0)] * 3)


def rotation(roll, pitch, yaw):
    """The columns of yaw-pitch-roll, multiplied out by NumPy."""
    about_x = np.array([[1, 0, 0], [0, cos(roll), -sin(roll)], [0, sin(roll), cos(roll)]])
    about_y = np.array([[cos(pitch), 0, sin(pitch)], [0, 1, 0], [-sin(pitch), 0, cos(pitch)]])
    about_z = np.array([[cos(yaw), -sin(yaw), 0], [sin(yaw), cos(yaw), 0], [0, 0, 1]])
    return about_z @ about_y @ about_x


@given(angles, angles, angles)
def test_direction_is_the_third_column_of_the_rotation(roll, pitch, yaw):
    expected = rotation(roll, pitch, yaw)[:, 2]
    assert thrust_direction(roll, pitch, yaw) == pytest.approx(expected, abs=1e-12)


@given(angles, angles, angles, st.floats(0.1, 50.0))
def test_tilt_is_the_inverse_of_direction(roll, pitch, yaw, size):
    force = [size * part for part in thrust_direction(roll, pitch, yaw)]
    assert tilt_toward(force, yaw) == pytest.approx((roll, pitch), abs=1e-7)


@given(accelerations)
def test_the_envelope_keeps_direction_thrust_tilt_and_support(wanted):
    given_ = ThrustEnvelope(gravity=GRAVITY, acceleration_max=MOST, tilt_max=TILT).limited(wanted)
    x, y, z = given_
    assert sqrt(x * x + y * y + (z + GRAVITY) ** 2) <= MOST * (1 + 1e-9)
    assert atan2(hypot(x, y), z + GRAVITY) <= TILT * (1 + 1e-9)
    assert z + GRAVITY >= 0.3 * GRAVITY * (1 - 1e-9)
    assert np.cross(wanted, given_) == pytest.approx(np.zeros(3), abs=1e-9)
    assert np.dot(wanted, given_) >= 0.0


def test_small_accelerations_pass_untouched():
    envelope = ThrustEnvelope(gravity=GRAVITY, acceleration_max=MOST, tilt_max=TILT)
    assert envelope.limited((0.3, -0.2, 0.5)) == pytest.approx((0.3, -0.2, 0.5), rel=1e-12)
    assert envelope.limited((0.0, 0.0, 0.0)) == (0.0, 0.0, 0.0)
