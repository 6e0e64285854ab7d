"""Rotor speeds for a thrust and moments: exact where they fit, in order of rank where not."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pyomo_quad.flight.controller import Allocation, mixer_matrix
from tests import flights

KB, KAPPA, ARM = 3.8305e-6, 2.2518e-8, 0.175
MIXER = np.array(
    [
        [KB, KB, KB, KB],
        [0.0, ARM * KB, 0.0, -ARM * KB],
        [-ARM * KB, 0.0, ARM * KB, 0.0],
        [KAPPA, -KAPPA, KAPPA, -KAPPA],
    ]
)
LIMITS = flights.scenario("paper_calm").limits
WEIGHT = 1.3 * 9.81


def achieved(thrust, moments, limits=LIMITS):
    speeds = np.array(Allocation(MIXER, limits).rotor_speeds(thrust, moments))
    assert (speeds >= limits.rotor_speed_min * (1 - 1e-12)).all()
    assert (speeds <= limits.rotor_speed_max * (1 + 1e-12)).all()
    return MIXER @ speeds**2


def test_the_mixer_is_that_of_equation_7():
    assert mixer_matrix(flights.vehicle("paper_calm")) == pytest.approx(MIXER, rel=1e-12)


def test_what_fits_is_given_exactly():
    wanted = (WEIGHT, 0.05, -0.08, 0.004)
    assert achieved(wanted[0], wanted[1:]) == pytest.approx(wanted, rel=1e-10)


moments = st.tuples(*[st.floats(-2.0, 2.0)] * 3)


@given(st.floats(-5.0, 60.0), moments)
def test_limits_are_never_left(thrust, wanted):
    achieved(thrust, wanted)


def test_tilting_comes_before_thrust():
    given_ = achieved(2 * LIMITS.thrust_max, (0.2, 0.1, 0.0))
    assert given_[1:3] == pytest.approx([0.2, 0.1], rel=1e-9)
    assert given_[0] < LIMITS.thrust_max


def test_thrust_comes_before_yaw():
    thrust = 0.99 * LIMITS.thrust_max
    given_ = achieved(thrust, (0.0, 0.0, 1.0))
    assert given_[0] == pytest.approx(thrust, rel=1e-9)
    assert 0.0 < given_[3] < LIMITS.yaw_moment_max


def test_declared_moment_limits_hold():
    tight = LIMITS.model_copy(update={"roll_moment_max": 0.01, "yaw_moment_max": 0.001})
    given_ = achieved(WEIGHT, (0.5, 0.0, -0.5), tight)
    assert given_[[1, 3]] == pytest.approx([0.01, -0.001], rel=1e-9)


def test_tilting_moment_at_hover_is_what_one_rotor_pair_has_left():
    most = Allocation(MIXER, LIMITS).tilting_moment_at(WEIGHT)
    spare = KB * LIMITS.rotor_speed_max**2 - WEIGHT / 4
    assert most == pytest.approx((2 * ARM * spare,) * 2, rel=1e-9)
