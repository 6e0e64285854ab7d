"""Induced velocity of the compiled equations against the closed forms of momentum theory."""

from math import pi, sqrt

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from pyomo_quad.flight import Planner
from tests.declared_model import scenario

DENSITY, RADIUS = 1.2, 0.1651
DISC_AREA = 4 * pi * RADIUS**2
# The norm of the airspeed is rounded at 1 cm/s: (0.01 / 2 v_i)^2 of a v_i above 1 m/s.
ROUNDED = 2.5e-5


@pytest.fixture(scope="module")
def dynamics():
    told = scenario(
        vehicle={"use": "dji_matrice_100", "rotor_radius": RADIUS},
        wind={"coupling": "drag"},
        power={"model": "momentum", "air_density": DENSITY},
    )
    return Planner().dynamics(told)


def reading(dynamics, name, velocity, speed=496.0, pitch=0.0):
    """A quantity with all rotors at one speed, in level flight unless pitched."""
    velocity = np.atleast_2d(np.asarray(velocity, dtype=float))
    names = list(dynamics.state_names)
    states = np.zeros((len(velocity), len(names)))
    for column, axis in enumerate(("vx", "vy", "vz")):
        states[:, names.index(f"rigid_body.{axis}")] = velocity[:, column]
    states[:, names.index("rigid_body.theta")] = pitch
    states[:, [k for k, held in enumerate(names) if held.startswith("rotors.omega")]] = speed
    controls = np.zeros((len(velocity), len(dynamics.control_names)))
    return dynamics.evaluate(name, np.zeros(len(velocity)), states, controls)


def in_hover(dynamics, speed=496.0):
    (thrust,) = reading(dynamics, "rotors.total_thrust", [0, 0, 0], speed)
    return sqrt(thrust / (2 * DENSITY * DISC_AREA))


def test_hover(dynamics):
    for speed in (100.0, 496.0, 700.0):
        found = reading(dynamics, "power.induced_velocity", [0, 0, 0], speed)[0]
        assert found == pytest.approx(in_hover(dynamics, speed), rel=ROUNDED)


def test_climb_along_the_axis(dynamics):
    v_h = in_hover(dynamics)
    climb = np.array([0.1, 1.0, 3.0, 10.0, 100.0]) * v_h
    found = reading(dynamics, "power.induced_velocity", [(0, 0, c) for c in climb])
    np.testing.assert_allclose(found, np.sqrt(climb**2 / 4 + v_h**2) - climb / 2, rtol=ROUNDED)


def test_fast_climb_approaches_thrust_over_mass_flow(dynamics):
    v_h = in_hover(dynamics)
    climb = v_h * np.array([10.0, 20.0, 40.0])
    found = reading(dynamics, "power.induced_velocity", [(0, 0, c) for c in climb])
    error = 1 - found / (v_h**2 / climb)
    # v_i (V + v_i) = v_h^2: the error is (v_h / V)^2 to first order.
    np.testing.assert_allclose(np.log2(error[:-1] / error[1:]), 2.0, atol=0.05)
    assert error[-1] == pytest.approx((v_h / climb[-1]) ** 2, rel=0.01)


def test_fast_forward_flight_approaches_that_of_a_wing(dynamics):
    v_h = in_hover(dynamics)
    speed = v_h * np.array([2.0, 4.0, 8.0])
    found = reading(dynamics, "power.induced_velocity", [(v, 0, 0) for v in speed])
    exact = np.sqrt(np.sqrt(speed**4 / 4 + v_h**4) - speed**2 / 2)
    np.testing.assert_allclose(found, exact, rtol=ROUNDED)
    error = 1 - found / (v_h**2 / speed)
    # The wing of the same span: v_i = v_h^2 / V, off by (v_h / V)^4 / 2.
    np.testing.assert_allclose(np.log2(error[:-1] / error[1:]), 4.0, atol=0.3)


def test_tilting_the_vehicle_is_tilting_the_air(dynamics):
    flow = np.array([6.0, 0.0, 2.0])
    tilt = 0.4
    turned = [
        flow[0] * np.cos(tilt) + flow[2] * np.sin(tilt),
        0,
        flow[2] * np.cos(tilt) - flow[0] * np.sin(tilt),
    ]
    level = reading(dynamics, "power.induced_velocity", flow)
    tilted = reading(dynamics, "power.induced_velocity", turned, pitch=tilt)
    np.testing.assert_allclose(tilted, level, rtol=1e-12)


def test_descent_follows_what_was_measured_of_sinking_rotors(dynamics):
    """Leishman (2006), eq. (2.96), for -2 <= V / v_h <= 0; smooth throughout, and one root."""
    v_h = in_hover(dynamics)
    descent = -np.linspace(0.0, 2.0, 81)
    found = reading(dynamics, "power.induced_velocity", [(0, 0, c * v_h) for c in descent]) / v_h
    measured = np.polyval([-0.655, -1.718, -1.372, -1.125, 1.0], descent)
    # Where the flights descend, within an eighth; on to the brink of the windmill, within 0.4.
    assert np.max(np.abs(found - measured)[descent >= -0.5]) < 0.13
    assert np.max(np.abs(found - measured)[descent >= -1.5]) < 0.40


def test_fast_descent_is_a_windmill(dynamics):
    v_h = in_hover(dynamics)
    descent = v_h * np.array([4.0, 8.0, 16.0])
    found = reading(dynamics, "power.induced_velocity", [(0, 0, -c) for c in descent])
    # v_i sqrt((V - v_i)^2 + tau V^2) = v_h^2 tends to v_h^2 / (V sqrt(1 + tau)).
    limit = v_h**2 / (descent * sqrt(1 + 1 / 7.67))
    np.testing.assert_allclose(found[-1], limit[-1], rtol=0.005)
    assert np.all(np.diff(np.abs(found / limit - 1)) < 0)


@given(st.floats(-40, 40), st.floats(-40, 40), st.floats(-40, 40), st.floats(20, 1000))
@settings(
    max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
def test_every_airspeed_has_an_induced_velocity(dynamics, x, y, z, speed):
    induced, along, across, thrust = (
        reading(dynamics, name, [x, y, z], speed)[0]
        for name in (
            "power.induced_velocity",
            "power.axial_airspeed",
            "power.in_plane_airspeed_squared",
            "rotors.total_thrust",
        )
    )
    flow = sqrt(across + (along + induced) ** 2 + min(along, 0.0) ** 2 / 7.67)
    assert 2 * DENSITY * DISC_AREA * flow * induced == pytest.approx(thrust, rel=0.01, abs=1e-3)
    assert induced > 0


def test_profile_power_scales_with_thrust_and_density(dynamics):
    at = [reading(dynamics, "power.total", [0, 0, 0], speed)[0] - 10.0 for speed in (300.0, 600.0)]
    # Everything but the electronics goes with T^1.5, that is with the cube of the rotor speed.
    assert at[1] / at[0] == pytest.approx(8.0, rel=ROUNDED)
