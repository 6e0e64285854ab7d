"""What each power model claims: non-negative, convex in alpha, convex in thrust."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.declared_model import Instant, scenario, steady

SPEED = st.floats(0.0, 1047.0)
ACCELERATION = st.floats(-3000.0, 3000.0)
AT = {
    model: Instant.of(power={"model": model})
    for model in ("motor", "efficiency", "shaft", "constant_efficiency", "motor_with_friction")
}


def power(model, omega, alpha):
    at = AT[model].set(omega=(omega,) * 4, alpha=(alpha,) * 4)
    return at.read("power.rotor_power", 1)


WITHOUT = {model: Instant.of(power={"model": model, "regeneration": False}) for model in AT}


@pytest.mark.parametrize("model", list(WITHOUT))
@settings(deadline=None, max_examples=60)
@given(omega=SPEED, alpha=ACCELERATION)
def test_braking_earns_nothing_without_regeneration(model, omega, alpha):
    at = WITHOUT[model].set(omega=(omega,) * 4, alpha=(alpha,) * 4)
    assert at.read("power.rotor_power", 1) >= 0.0


@pytest.mark.parametrize("model", list(WITHOUT))
def test_regeneration_pays_back_under_every_model(model):
    # Braked at 9000 rad/s^2 the rotor gives up 0.377 N m less 0.019 N m of drag: at hover's speed
    # some 327 W of shaft power, of which copper and friction leave 90 W.
    paid = Instant.of(power={"model": model, "regeneration": True})
    paid.set(omega=(912.0,) * 4, alpha=(-9000.0,) * 4)
    assert paid.read("power.rotor_power", 1) < 0.0
    WITHOUT[model].set(omega=(912.0,) * 4, alpha=(-9000.0,) * 4)
    assert WITHOUT[model].read("power.rotor_power", 1) == pytest.approx(0.0, abs=1e-3)


@pytest.mark.parametrize("model", list(WITHOUT))
def test_what_is_not_said_of_regeneration_follows_the_model(model):
    told = scenario(power={"model": model}).power
    assert told.regeneration == (model not in ("efficiency", "constant_efficiency"))
    other = scenario().with_values({"power.model": model}).power
    assert other.regeneration == told.regeneration


@pytest.mark.parametrize("model", ["motor", "shaft", "constant_efficiency", "motor_with_friction"])
@settings(deadline=None, max_examples=60)
@given(omega=SPEED, first=ACCELERATION, second=ACCELERATION, share=st.floats(0.0, 1.0))
def test_convex_in_alpha(model, omega, first, second, share):
    low, high = power(model, omega, first), power(model, omega, second)
    between = power(model, omega, share * first + (1 - share) * second)
    chord = share * low + (1 - share) * high
    assert between <= chord + 1e-9 * (1 + abs(low) + abs(high))


def test_the_efficiency_function_is_not_convex_in_alpha():
    # Below 858 rad/s the chord from coasting (no torque) to full acceleration passes below
    # steady flight; at hover speed the bound of 3000 rad/s^2 keeps it above.
    coasting = -2.2518e-8 * 700.0**2 / 4.1904e-5
    share = 3000.0 / (3000.0 - coasting)
    steady, idle, accelerating = (power("efficiency", 700.0, a) for a in (0.0, coasting, 3000.0))
    assert steady > 1.5 * (share * idle + (1 - share) * accelerating)


def test_the_efficiency_keeps_its_floor_where_the_polynomial_has_a_zero():
    # At 400 rad/s the polynomial vanishes at -0.046 N m, reached by braking at 1.2e3 rad/s^2.
    at = AT["efficiency"].set(omega=(400.0,) * 4, alpha=(-1200.0,) * 4)
    assert at.read("power.drive_efficiency", 1) >= 0.05
    assert at.read("power.map_torque", 1) >= 0.0


@pytest.mark.lengthy
@pytest.mark.parametrize("model", ["motor", "shaft", "constant_efficiency"])
def test_convex_and_increasing_in_thrust(model):
    flight = steady(scenario(power={"model": model}))
    powers = np.array([flight.power_at_thrust(thrust) for thrust in np.linspace(0.0, 16.8, 30)])
    assert np.all(np.diff(powers) > 0.0)
    assert np.all(np.diff(powers, 2) > -1e-9)


def test_friction_makes_the_first_newton_the_dearest():
    flight = steady(scenario(power={"model": "motor_with_friction"}))
    powers = np.array([flight.power_at_thrust(thrust) for thrust in np.linspace(0.0, 16.8, 30)])
    assert np.all(np.diff(powers) > 0.0)
    assert np.diff(powers, 2)[0] < 0.0
