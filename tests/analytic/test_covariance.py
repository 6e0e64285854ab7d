"""Covariance of flights in turbulence: closed forms, a stationary hover, and flights one by one."""

from functools import cache

import numpy as np
import pytest
from scipy.linalg import solve_continuous_lyapunov

from pyomo_quad.collocation.program.compiled import MappedFunction
from pyomo_quad.flight.baselines import fly_reference
from pyomo_quad.flight.covariance import (
    _MeanFlight,
    propagated,
    spread_along,
    without_overflow,
)
from pyomo_quad.flight.integration import discrete
from pyomo_quad.flight.weather import problem_in_turbulence
from pyomo_quad.model import parameter_values
from pyomo_quad.model.turbulence import FILTER_STATES, NOISE, NOISE_STEP, Gusts
from pyomo_quad.scenario.tables import Reference
from tests.declared_model import scenario
from tests.flights import PLANNER

VEHICLE = {"drag_linear": 0.3, "attitude": "euler"}
WIND = {"use": "constant", "speed": 3.0, "direction": 0.4, "coupling": "drag"}
PLACES = ("rigid_body.x", "rigid_body.y", "rigid_body.z")
SPEEDS = ("rigid_body.vx", "rigid_body.vy", "rigid_body.vz")
TILTS = ("rigid_body.phi", "rigid_body.theta")


def mission(duration, place, turbulence, **more):
    ends = {"start": {"position": [0.0, 0.0, 10.0]}, "goal": {"position": place}}
    return scenario(
        vehicle=VEHICLE,
        wind=WIND | {"turbulence": turbulence} | more,
        mission=ends | {"duration": duration},
        solver={"tolerance": 1e-4},
    )


@cache
def planned(duration, place, strength):
    told = mission(duration, list(place), {"wind_at_6_m": strength})
    return told, PLANNER.solve(told)


def test_a_driven_decay_has_the_variance_of_its_closed_form():
    a, b, c, h, n = 0.7, 1.3, 0.4, 0.05, 60
    A, B = np.full((n, 1, 1), -a), np.tile([[b, c]], (n, 1, 1))
    transitions, driven = discrete(A, B, h)
    start = np.array([[0.2]])
    sums, onward = propagated(start, transitions, driven[:, :, :1] / np.sqrt(h), driven[:, :, 1:])
    t, decay = h * np.arange(n + 1), np.exp(-a * h)
    per_step = (b * (1 - decay) / a) ** 2 / h
    by_gusts = 0.2 * decay ** (2 * np.arange(n + 1)) + per_step * np.array(
        [sum(decay ** (2 * k) for k in range(m)) for m in range(n + 1)]
    )
    by_constant = (c * (1 - np.exp(-a * t)) / a) ** 2
    np.testing.assert_allclose(sums[:, 0, 0], by_gusts + by_constant, rtol=1e-12)
    answers = np.sqrt(by_constant)
    expected = decay * by_gusts[:-1] + answers[:-1] * answers[1:]
    np.testing.assert_allclose(onward[:, 0, 0], expected, rtol=1e-12)


@pytest.mark.lengthy
def test_a_long_hover_has_the_covariance_of_the_stationary_lyapunov_equation():
    told = mission(5.0, [0.0, 0.0, 10.0], {"wind_at_6_m": 7.7}, use="calm", speed=0.0)
    plan = PLANNER.solve(told)
    spread = spread_along(told, plan, PLANNER)
    mean = _MeanFlight(told, plan, PLANNER)
    joint, commands = mean.flown(np.array([0.0, 4.0, 5.0]))
    A, B = (m[1] for m in mean.slopes(np.array([0.0, 4.0, 5.0]), joint, commands))
    # Charge and energy never settle.
    names = spread.dynamics.state_names
    moving = np.array([*(not name.startswith("battery") for name in names), *(True,) * 22, False])
    ends = np.linalg.eigvals(A[np.ix_(moving, moving)])
    assert ends.real.max() < 0
    stationary = np.zeros_like(A)
    driven = B[moving, :3] @ B[moving, :3].T
    stationary[np.ix_(moving, moving)] = solve_continuous_lyapunov(
        A[np.ix_(moving, moving)], -driven
    )
    columns = [spread.dynamics.state_names.index(n) for n in (*PLACES, *SPEEDS, *TILTS)]
    expected = np.sqrt(np.diag(stationary)[columns])
    found = np.sqrt(np.diag(spread.covariance[-1])[columns])
    np.testing.assert_allclose(found, expected, rtol=0.02)


@pytest.mark.lengthy
def test_an_error_of_the_forecast_moves_flights_as_a_flight_with_the_error_shows():
    still = {"wind_at_6_m": 0.0}
    told = mission(4.0, [4.0, 0.0, 10.0], still, speed_deviation=0.2)
    _, plan = planned(4.0, (4.0, 0.0, 10.0), 7.7)
    spread = spread_along(told, plan, PLANNER)
    ends = []
    for side in (1.0, -1.0):
        error = {
            "wind.error[x]": 0.2 * side * np.cos(0.4),
            "wind.error[y]": 0.2 * side * np.sin(0.4),
        }
        vehicle = problem_in_turbulence(told).dynamics(
            parameters=parameter_values(told) | {"wind.turbulence.wind_at_6_m": 0.0} | error,
            horizon=(0.0, 4.0),
        )
        flight = fly_reference(told, Reference.PLAN, dynamics=vehicle, plan=plan)
        ends.append(flight.flown.states[-1])
    columns = [spread.dynamics.state_names.index(n) for n in (*PLACES, *SPEEDS, *TILTS)]
    apart = (np.abs(ends[0] - ends[1]) / 2)[columns]
    found = np.sqrt(np.diag(spread.covariance[-1])[columns])
    np.testing.assert_allclose(found, apart, rtol=0.03, atol=1e-5)


# Parts of a step of the noise: the yaw loop has a rate of 270 1/s, at which the method is stable up
# to 2.78 / 270 s.
_PARTS = 3


def flights(told, plan, count):
    """Fly many times in steps of the classical Runge-Kutta method, each with noise of its own."""
    mean = _MeanFlight(told, plan, PLANNER)
    dynamics, end = mean.dynamics, told.mission.fixed_duration
    rates = MappedFunction(mean.loop.function, count)
    (start, _), _ = mean.flown(np.array([0.0, end]))
    joint = np.tile(start, (count, 1))
    gusts = [Gusts([11, k]) for k in range(count)]
    filters = [dynamics.state_names.index(name) for name in FILTER_STATES]
    joint[:, filters] = [list(gust.start.values()) for gust in gusts]
    noise = np.array([gust.noise(end) for gust in gusts])
    columns = [1 + dynamics.signal_names.index(name) for name in NOISE]
    steps = round(end / NOISE_STEP)
    step, kept = end / steps, [joint]

    def slope(t, x, held):
        moment = np.tile(dynamics.moment(t), (count, 1))
        moment[:, columns] = held
        command = np.tile(mean._controller.command(mean._reference, t), (count, 1))
        return rates(moment, x, command)[0]

    for k in range(steps):
        for part in range(_PARTS):
            h, held = step / _PARTS, noise[:, k]
            t = k * step + part * h
            a = slope(t, joint, held)
            b = slope(t + h / 2, joint + h / 2 * a, held)
            c = slope(t + h / 2, joint + h / 2 * b, held)
            d = slope(t + h, joint + h * c, held)
            joint = joint + h / 6 * (a + 2 * b + 2 * c + d)
        kept.append(joint)
    return np.array(kept)


def compare_with_flights(duration, place, count, within):
    told, plan = planned(duration, place, 7.7)
    spread = spread_along(told, plan, PLANNER)
    flown = flights(told, plan, count)
    instants = np.linspace(0.2, 1.0, 5) * (len(spread.t) - 1)
    for k in instants.round().astype(int):
        for names in (PLACES, SPEEDS, TILTS):
            columns = [spread.dynamics.state_names.index(name) for name in names]
            off = flown[k][:, columns] - spread.states[k, columns]
            seen = np.sqrt((off**2).mean(axis=0).sum())
            expected = np.sqrt(np.trace(spread.of(*names)[k]))
            assert expected == pytest.approx(seen, rel=within), (spread.t[k], names)


@pytest.mark.lengthy
def test_flights_in_light_turbulence_spread_as_the_linear_covariance_says():
    compare_with_flights(4.0, (4.0, 0.0, 10.0), count=40, within=0.4)


@pytest.mark.slow
def test_a_thousand_flights_in_light_turbulence_spread_within_15_percent():
    compare_with_flights(12.0, (30.0, 8.0, 12.0), count=1000, within=0.15)


def test_a_spread_that_grows_without_limit_stays_finite_and_is_lost():
    growing = np.full((60, 2, 2), 1e9) * np.eye(2)
    held = propagated(np.eye(2), growing, np.zeros((60, 2, 1)), np.zeros((60, 2, 1)))
    assert not np.isfinite(held[0]).all()
    covariance, onward = without_overflow(*held)
    assert np.isfinite(covariance).all()
    assert np.isfinite(onward).all()
    assert covariance[0] == pytest.approx(np.eye(2))
    assert np.linalg.eigvalsh(covariance[-1]) == pytest.approx([1e12, 1e12])


def test_a_spread_that_stays_bounded_is_left_as_it_is():
    steady = np.full((60, 2, 2), 0.5) * np.eye(2)
    held = propagated(np.eye(2), steady, np.ones((60, 2, 1)), np.zeros((60, 2, 1)))
    assert all(one is other for one, other in zip(without_overflow(*held), held, strict=True))
