"""The lower bound on energy against arithmetic done by hand and against relaxed flights."""

from math import hypot

import numpy as np
import pytest

from pyomo_quad.study.certificate import certify
from tests.declared_model import scenario, steady

# What lowering the samples of the power costs, relative.
SAMPLING = 2e-6
MASS, GRAVITY, KB, KAPPA = 1.3, 9.81, 3.8305e-6, 2.2518e-8
IN_PLACE = {"goal": {"position": [0.0, 0.0, 0.0]}, "duration": 10.0}


def shaft_power(thrust):
    """Four rotors, each kappa w^3 with kappa_b w^2 a quarter of the thrust."""
    return 4 * KAPPA * (thrust / (4 * KB)) ** 1.5


@pytest.mark.parametrize("power", ["motor", "shaft", "constant_efficiency"])
def test_hovering_in_place_is_its_own_bound(power):
    found = certify(scenario(power={"model": power}, mission=IN_PLACE))
    assert found.applies
    assert found.lower_bound_J == pytest.approx(found.hover_energy_J, rel=1e-5)
    assert found.lower_bound_J <= found.hover_energy_J
    assert found.gap_percent(found.hover_energy_J) < 1e-3


def test_a_steady_wind_as_acceleration_by_hand():
    # The mean thrust carries the weight and the wind's 3 m/s^2: u = m sqrt(g^2 + 3^2).
    wind = {"use": "constant", "speed": 3.0, "direction": 0.7}
    found = certify(scenario(power={"model": "shaft"}, mission=IN_PLACE, wind=wind))
    expected = 10.0 * shaft_power(MASS * hypot(GRAVITY, 3.0))
    assert found.lower_bound_J == pytest.approx(expected, rel=SAMPLING)


def test_drag_against_a_steady_wind_by_hand():
    # Half a kilogram per second at 4 m/s: 2 N across, 12.753 N up.
    found = certify(
        scenario(
            power={"model": "constant_efficiency", "efficiency": 0.5},
            mission=IN_PLACE,
            wind={"use": "constant", "speed": 4.0, "coupling": "drag"},
            vehicle={"drag_linear": 0.5},
        )
    )
    expected = 10.0 * shaft_power(hypot(MASS * GRAVITY, 0.5 * 4.0)) / 0.5
    assert found.lower_bound_J == pytest.approx(expected, rel=SAMPLING)


def test_the_mean_of_a_harmonic_wind_by_hand():
    # One harmonic over one whole period leaves the mean of 1 m/s.
    axis = {"amplitudes": [0.5, 0.0, 0.0], "frequencies": [2 * np.pi / 10.0, 1.0, 1.0]}
    calm = {"mean": 0.0, "amplitudes": [0.0, 0.0, 0.0], "gust_amplitude": 0.0}
    found = certify(
        scenario(
            power={"model": "shaft"},
            mission=IN_PLACE,
            wind={"use": "paper_table_2", "x": axis | {"gust_amplitude": 0.0}, "y": calm},
        )
    )
    mean = 10.0 * shaft_power(MASS * hypot(GRAVITY, 1.0))
    # Being at rest at one place at both ends asks for a little more than the mean thrust.
    assert mean * (1 - SAMPLING) <= found.lower_bound_J <= mean * 1.002


@pytest.mark.parametrize("coupling", ["acceleration", "drag"])
@pytest.mark.parametrize("power", ["motor", "shaft"])
def test_the_bound_is_all_but_reached_by_a_point_with_free_thrust(power, coupling):
    # A point mass whose thrust may turn at once, on a cubic path: a flight of the relaxed
    # problem, so never below the bound, and for gentle missions all but optimal in it.
    wind = {"use": "constant", "speed": 1.0, "coupling": coupling}
    told = scenario(power={"model": power}, wind=wind)
    found = certify(told).lower_bound_J
    flight, goal, duration, drag = steady(told), np.array([6.0, 7.0, 8.0]), 10.0, 0.43
    nodes, widths = np.polynomial.legendre.leggauss(24)
    energy = 0.0
    for share, width in zip((nodes + 1) / 2, widths / 2, strict=True):
        acceleration = goal * 6 * (1 - 2 * share) / duration**2
        velocity = goal * 6 * share * (1 - share) / duration
        force = MASS * (acceleration + np.array([0.0, 0.0, GRAVITY]))
        blowing = np.array([1.0, 0.0, 0.0])
        force += drag * (velocity - blowing) if coupling == "drag" else -MASS * blowing
        energy += width * duration * flight.power_at_thrust(float(np.linalg.norm(force)))
    assert found <= energy
    assert found == pytest.approx(energy, rel=3e-4)


def test_displacement_raises_the_bound_above_that_of_the_mean_thrust():
    # In calm air the mean thrust is that of hover, however far the goal.
    fast = {"goal": {"position": [6.0, 7.0, 8.0]}, "duration": 4.5}
    found = certify(scenario(mission=fast))
    assert found.lower_bound_J > 1.02 * found.hover_energy_J


def test_friction_is_bounded_by_the_chord_over_the_rotor_speeds():
    # The power is concave in thrust nearly up to the greatest speed: no tangent but the chord
    # between a rotor at rest and one at full speed lies below it.
    found = certify(scenario(power={"model": "motor_with_friction"}, mission=IN_PLACE))
    resistance, kt, kv, full = 0.2, 0.0104, 96.342, 1047.1975511965977

    def rotor(omega):
        current = (KAPPA * omega**2 + 0.04 + 2e-4 * omega) / kt
        return (resistance * current + omega / kv) * current

    share = MASS * GRAVITY / (4 * KB * full**2)
    chord = 4 * ((1 - share) * rotor(0.0) + share * rotor(full))
    assert found.lower_bound_J == pytest.approx(10.0 * chord, rel=1e-4)
