"""The lower bound on energy against arithmetic done by hand and against relaxed flights."""

from itertools import pairwise
from math import hypot

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from tests.declared_model import scenario, steady
from tests.flights import certified

# What lowering the samples of the power costs, relative.
SAMPLING = 2e-6
MASS, GRAVITY, KB, KAPPA = 1.3, 9.81, 3.8305e-6, 2.2518e-8
IN_PLACE = {"goal": {"position": [0.0, 0.0, 0.0]}, "duration": 10.0}


def shaft_power(thrust):
    """Four rotors, each kappa w^3 with kappa_b w^2 a quarter of the thrust."""
    return 4 * KAPPA * (thrust / (4 * KB)) ** 1.5


@pytest.mark.lengthy
@pytest.mark.parametrize("power", ["motor", "shaft", "constant_efficiency"])
def test_hovering_in_place_is_its_own_bound(power):
    found = certified(scenario(power={"model": power}, mission=IN_PLACE))
    assert found.applies
    assert found.lower_bound_J == pytest.approx(found.hover_energy_J, rel=1e-5)
    assert found.lower_bound_J <= found.hover_energy_J
    assert found.gap_percent(found.hover_energy_J) < 1e-3


def test_a_steady_wind_as_acceleration_by_hand():
    # The mean thrust carries the weight and the wind's 3 m/s^2: u = m sqrt(g^2 + 3^2).
    wind = {"use": "constant", "speed": 3.0, "direction": 0.7}
    found = certified(scenario(power={"model": "shaft"}, mission=IN_PLACE, wind=wind))
    expected = 10.0 * shaft_power(MASS * hypot(GRAVITY, 3.0))
    assert found.lower_bound_J == pytest.approx(expected, rel=SAMPLING)


def test_drag_against_a_steady_wind_by_hand():
    # Half a kilogram per second at 4 m/s: 2 N across, 12.753 N up.
    found = certified(
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
    found = certified(
        scenario(
            power={"model": "shaft"},
            mission=IN_PLACE,
            wind={"use": "paper_table_2", "x": axis | {"gust_amplitude": 0.0}, "y": calm},
        )
    )
    mean = 10.0 * shaft_power(MASS * hypot(GRAVITY, 1.0))
    # Being at rest at one place at both ends asks for a little more than the mean thrust.
    assert mean * (1 - SAMPLING) <= found.lower_bound_J <= mean * 1.002


@pytest.mark.lengthy
@pytest.mark.parametrize("coupling", ["acceleration", "drag"])
@pytest.mark.parametrize("power", ["motor", "shaft"])
def test_the_bound_is_all_but_reached_by_a_point_with_free_thrust(power, coupling):
    # A point mass whose thrust may turn at once, on a cubic path: a flight of the relaxed
    # problem, so never below the bound, and for gentle missions all but optimal in it.
    wind = {"use": "constant", "speed": 1.0, "coupling": coupling}
    told = scenario(power={"model": power}, wind=wind)
    found = certified(told).lower_bound_J
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
    found = certified(scenario(mission=fast))
    assert found.lower_bound_J > 1.02 * found.hover_energy_J


def test_friction_is_bounded_by_the_chord_over_the_rotor_speeds():
    # The power is concave in thrust nearly up to the greatest speed: no tangent but the chord
    # between a rotor at rest and one at full speed lies below it.
    found = certified(scenario(power={"model": "motor_with_friction"}, mission=IN_PLACE))
    resistance, kt, kv, full = 0.2, 0.0104, 96.342, 1047.1975511965977

    def rotor(omega):
        current = (KAPPA * omega**2 + 0.04 + 2e-4 * omega) / kt
        return (resistance * current + omega / kv) * current

    share = MASS * GRAVITY / (4 * KB * full**2)
    chord = 4 * ((1 - share) * rotor(0.0) + share * rotor(full))
    assert found.lower_bound_J == pytest.approx(10.0 * chord, rel=1e-4)


PASSED = np.array([[0.0, 0.0, 0.0], [2.0, 5.0, 2.0], [7.0, 6.0, 5.0], [6.0, 7.0, 8.0]])


def energy_of_spline(told, times):
    """What a point with free thrust spends on the path that bends least, at rest at both ends."""
    bend = CubicSpline(times, PASSED, bc_type="clamped").derivative(2)
    nodes, widths = np.polynomial.legendre.leggauss(12)
    flight, energy, weight = steady(told), 0.0, np.array([0.0, 0.0, GRAVITY])
    for begun, over in pairwise(times):
        for node, width in zip(nodes, widths, strict=True):
            force = MASS * (bend(begun + (over - begun) * (node + 1) / 2) + weight)
            power = flight.power_at_thrust(float(np.linalg.norm(force)))
            energy += (over - begun) / 2 * width * power
    return energy


def waypoints(**each):
    return [
        {"position": place.tolist()} | {k: v[n] for k, v in each.items()}
        for n, place in enumerate(PASSED[1:-1])
    ]


@pytest.mark.lengthy
def test_passages_at_given_times_are_bounded_by_the_spline_through_them():
    # Gentle, the power is nearly quadratic in the acceleration, of which splines have least.
    told = scenario(mission={"waypoints": waypoints(at=(6.0, 11.0)), "duration": 16.0})
    found, energy = certified(told).lower_bound_J, energy_of_spline(told, [0.0, 6.0, 11.0, 16.0])
    assert found <= energy
    assert found == pytest.approx(energy, rel=1e-4)
    assert found > certified(scenario(mission={"duration": 16.0})).lower_bound_J * 1.0005


@pytest.mark.slow
def test_free_passages_are_bounded_below_those_at_any_given_times():
    of = {"duration": 16.0}
    least = certified(scenario(mission=of | {"waypoints": waypoints()})).lower_bound_J
    times = ((5.0, 11.0), (6.3, 10.5), (7.0, 12.0))
    given = [scenario(mission=of | {"waypoints": waypoints(at=at)}) for at in times]
    found = [certified(told).lower_bound_J for told in given]
    assert least < min(found)
    assert least == pytest.approx(min(found), rel=1e-3)


@pytest.mark.lengthy
def test_passing_within_a_distance_is_never_dearer():
    missions = [{"waypoints": waypoints(radius=(r, r)), "duration": 9.0} for r in (0.0, 0.5)]
    exact, near = (certified(scenario(mission=m)).lower_bound_J for m in missions)
    assert exact > near


def test_a_parcel_left_while_hovering_lightens_the_rest_by_hand():
    # At 1 cm from where the flight starts and ends, for 4 s of 10.
    parcel = {"position": [0.01, 0.0, 0.0], "at": 4.0, "release": 0.3, "speed_max": 0.001}
    told = scenario(
        power={"model": "shaft"},
        mission=IN_PLACE | {"waypoints": [parcel]},
        vehicle={"payload": 0.3},
    )
    carried, left = (MASS + 0.3) * GRAVITY, MASS * GRAVITY
    expected = 4.0 * shaft_power(carried) + 6.0 * shaft_power(left)
    # What the rotors held, I_r omega^2 / 2, they give back.
    expected -= 4 * 4.1904e-5 / 2 * (carried - left) / (4 * KB)
    assert certified(told).lower_bound_J == pytest.approx(expected, rel=1e-4)


@pytest.mark.slow
def test_a_hover_on_the_way_adds_its_time_at_least():
    still = {"position": [6.0, 0.0, 0.0], "hold": 5.0}
    mission = {"goal": {"position": [12.0, 0.0, 0.0]}, "duration": "free", "waypoints": [still]}
    there = {"goal": {"position": [6.0, 0.0, 0.0]}, "duration": "free"}
    told = scenario(mission=mission)
    leg = certified(scenario(mission=there)).lower_bound_J
    hovering = 5.0 * steady(told).hover_power
    # Hovering may move by 5 cm at 0.1 m/s.
    assert certified(told).lower_bound_J <= 2 * leg + hovering
    assert certified(told).lower_bound_J == pytest.approx(2 * leg + hovering, rel=2e-2)
