"""Compiled steps of order 8: closed forms, jumps, kinks of the controls, and SciPy's DOP853."""

import numpy as np
import pytest
from pyomo.environ import Param
from scipy.integrate import solve_ivp

from pyomo_quad.collocation import OpenLoopSteps, SolveError, Steps
from pyomo_quad.flight import Planner
from pyomo_quad.scenario import load_scenario
from tests.command import SCENARIOS
from tests.unit.collocation.test_feedback import DRAG, cart

TOLERANCE = 1e-10
AT_REST = np.zeros(3)


def carried(times, control, dynamics=None, tolerance=TOLERANCE):
    steps = OpenLoopSteps(dynamics or cart())
    return steps.carried(AT_REST, np.asarray(times), lambda t: control(t)[:, None], tolerance)


def speed(t):
    """Speed of the cart under the control cos t, from rest."""
    return (DRAG * np.cos(t) + np.sin(t) - DRAG * np.exp(-DRAG * t)) / (1.0 + DRAG**2)


def test_a_smooth_control_moves_the_cart_as_the_closed_form_says():
    times = np.linspace(0.0, 2.0, 5)
    found = carried(times, np.cos)
    assert found[:, 1] == pytest.approx(speed(times), abs=10 * TOLERANCE)
    # The effort is the integral of cos^2 / 2.
    effort = times / 4.0 + np.sin(2.0 * times) / 8.0
    assert found[:, 2] == pytest.approx(effort, abs=10 * TOLERANCE)


def test_a_long_step_is_halved_until_its_error_is_below_the_tolerance():
    end = 20.0
    found = carried([0.0, end], np.cos, dynamics=cart(end=end))
    assert found[-1, 1] == pytest.approx(speed(end), abs=1e3 * TOLERANCE)


def test_a_kink_of_the_control_is_followed():
    found = carried([0.0, 2.0], lambda t: np.clip(t - 0.7, 0.0, 0.4))
    # v' + DRAG v = u in three parts: none, a ramp, a constant.
    ramp = (0.4 - (1.0 - np.exp(-DRAG * 0.4)) / DRAG) / DRAG
    ending = 0.4 / DRAG + (ramp - 0.4 / DRAG) * np.exp(-DRAG * 0.9)
    assert found[-1, 1] == pytest.approx(ending, abs=1e2 * TOLERANCE)


def in_a_gust(m, t):
    if not hasattr(m, "gust"):
        m.gust = Param(m.t, default=0.0, mutable=True)
    return m.gust[t] - DRAG * m.v[t]


def test_a_jump_of_a_parameter_within_a_step_is_met_exactly():
    still = cart(in_a_gust)
    gust = Steps(start=-0.55, step=0.88, values=(0.0, 2.0, -1.0))
    dynamics = still._formulation.dynamics(parameters={"gust": gust})
    found = carried([0.0, 1.0, 2.0], np.zeros_like, dynamics)
    rising = 2.0 / DRAG * (1.0 - np.exp(-DRAG * 0.88))
    falling = -1.0 / DRAG + (rising + 1.0 / DRAG) * np.exp(-DRAG * 0.79)
    assert found[-1, 1] == pytest.approx(falling, abs=1e2 * TOLERANCE)
    assert len(found) == 3


def test_a_state_that_grows_without_bound_is_refused_with_what_to_do():
    runaway = cart(lambda m, t: m.u[t] + m.v[t] ** 2, end=4.0)
    with pytest.raises(SolveError, match="out of control there; use a finer mesh"):
        carried([0.0, 4.0], np.ones_like, runaway)


@pytest.mark.lengthy
@pytest.mark.parametrize("name", ["paper_calm", "parcel"])
def test_a_quadrotor_flies_as_by_scipy(name):
    # A parcel drone's induced velocities are implicit: here by Newton steps written out, in SciPy's
    # flight by CasADi's own Newton iteration.
    scenario = load_scenario(SCENARIOS / f"{name}.toml")
    planner = Planner()
    problem = planner.problem_for(scenario)[0]
    exact = problem.dynamics(parameters=planner.parameters(scenario), horizon=(0.0, 10.0))
    start = np.array([exact.initial_states()[name] for name in exact.state_names])
    amplitudes = np.array([1.0, -2.0, 0.5, 1.5])

    def control(t):
        return np.sin(np.multiply.outer(t, np.arange(1.0, 5.0))) * amplitudes

    found = OpenLoopSteps(exact).carried(
        np.append(start, 0.0), np.array([0.0, 0.4, 0.8]), control, TOLERANCE
    )
    flown = solve_ivp(
        lambda t, x: exact.rates(t, x, control(t)),
        (0.0, 0.8),
        start,
        method="LSODA",
        rtol=1e-12,
        atol=1e-12,
    )
    assert found[-1, :-1] == pytest.approx(flown.y[:, -1], rel=1e-8, abs=1e-8)
