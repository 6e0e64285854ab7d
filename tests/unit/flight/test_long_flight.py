"""Where the search for a long flight starts: a mesh fine at both ends, and a cruise."""

import numpy as np
import pytest
from pyomo.dae import ContinuousSet, DerivativeVar, Integral
from pyomo.environ import ConcreteModel, Constraint, Objective, Var

from pyomo_quad.collocation import Mesh, compile
from pyomo_quad.collocation.mesh import radau_rule
from pyomo_quad.flight import Planner
from pyomo_quad.flight.long_flight import fine_mesh, guess_of, is_long
from pyomo_quad.flight.verification import fly_controls
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


def test_ripples_of_a_control_are_flown():
    # Too small for the integrator's own estimate of its error, which takes their square.
    duration = 60.0
    m = ConcreteModel()
    m.time = ContinuousSet(bounds=(0.0, duration))
    m.omega, m.alpha = Var(m.time), Var(m.time)
    m.rate = DerivativeVar(m.omega, wrt=m.time)
    m.motor = Constraint(m.time, rule=lambda m, t: m.rate[t] == m.alpha[t])
    m.heat = Integral(m.time, wrt=m.time, rule=lambda m, t: m.alpha[t] ** 2)
    m.cost = Objective(expr=m.heat)
    degree, width, rippled = 12, 0.0175, 20
    breakpoints = (0.0, *(width / duration * np.arange(1, rippled + 1)).tolist(), 1.0)
    mesh = Mesh(breakpoints=breakpoints, degrees=(*[degree] * rippled, 1))
    course = np.polyval([100.0, 200.0, -1400.0], radau_rule(degree).points)
    ripples = 1e-4 * np.random.default_rng(0).standard_normal((rippled, degree))
    alpha = np.append(course + ripples, 0.0)[:, None]
    dynamics = compile(m).dynamics()
    flown = fly_controls(dynamics, mesh, alpha, np.array([500.0]), (0.0, duration))
    exact = 500.0 + duration * mesh.quadrature_weights @ alpha[:, 0]
    # After a minute a place is off by 0.15 m for 1e-6 rad/s.
    assert flown.states[-1, 0] == pytest.approx(exact, abs=1e-9, rel=0.0)
