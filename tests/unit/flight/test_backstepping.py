"""The law's Lyapunov function along simulated motions: it must not rise, whatever is delivered."""

from math import inf, sqrt

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from pyomo_quad.flight.controller import BacksteppingLoop

K1, KAPPA, GAMMA = 1.5, 20.0, 100.0
DISTURBANCE = np.array([1.5, -0.7, 0.4])
ERROR = np.array([4.0, -2.0, 1.0])
# What the integrator may be off by in one step, relative to the state.
INTEGRATION = 1e-9


def loop(**changes):
    settings = {
        "outer": (K1,) * 3,
        "inner": (3.0,) * 3,
        "reach": 2.0,
        "identification": KAPPA,
        "effort_max": 2.0,
        "adaptation": GAMMA,
        "disturbance_max": 4.0,
    }
    return BacksteppingLoop(**settings | changes)


def move(
    law, delivered=lambda _t, demand: demand, disturbance=DISTURBANCE, *, span=8.0, start=None
):
    """Simulate e'' = delivered + d under the law; return times, e, e' and the loop's states."""

    def slope(t, y):
        # Python's own numbers: the law takes each by itself.
        error, rate, states = y[:3].tolist(), y[3:6].tolist(), y[6:].tolist()
        achieved = delivered(t, np.array(law(error, rate, (0, 0, 0), (0, 0, 0), states)[0]))
        rates = law(error, rate, (0, 0, 0), achieved.tolist(), states)[1]
        return [*rate, *(achieved + disturbance), *rates]

    states = law.started(ERROR, np.zeros(3)) if start is None else start
    times = np.linspace(0.0, span, 401)
    start = [*ERROR, 0.0, 0.0, 0.0, *states]
    flown = solve_ivp(
        slope, (0, span), start, t_eval=times, rtol=INTEGRATION, atol=1e-10, max_step=0.05
    )
    assert flown.success
    return times, flown.y[:3].T, flown.y[3:6].T, flown.y[6:].T


def sigma(error, reach):
    return error / np.sqrt(1 + (error**2).sum(axis=1, keepdims=True) / reach**2)


def lyapunov(error, rate, states, reach):
    compensated = error - states[:, :3]
    z = rate + K1 * sigma(error, reach) - states[:, 3:6]
    left = DISTURBANCE - states[:, 6:]
    size = (compensated**2).sum(axis=1)
    phi = reach**2 * (np.sqrt(1 + size / reach**2) - 1) if reach < inf else size / 2
    return K1**2 * phi + (z**2).sum(axis=1) / 2 + (left**2).sum(axis=1) / (2 * GAMMA)


def too_weak(_t, demand):
    return np.clip(demand, -1.6, 1.6)


def asleep_for_two_seconds(t, demand):
    return demand if t > 2.0 else np.zeros(3)


@pytest.mark.lengthy
@pytest.mark.parametrize("delivered", [lambda _t, demand: demand, too_weak, asleep_for_two_seconds])
@pytest.mark.parametrize("reach", [2.0, inf])
@pytest.mark.parametrize("is_initialised", [True, False])
def test_v_never_rises_and_the_disturbance_becomes_known(delivered, reach, is_initialised):
    law = loop(reach=reach)
    start = None if is_initialised else [0.0] * 9
    _, error, rate, states = move(law, delivered, start=start)
    v = lyapunov(error, rate, states, reach)
    assert np.diff(v).max() <= 1e-7
    assert states[-1, 6:] == pytest.approx(DISTURBANCE, abs=1e-3)


def test_started_v_is_that_of_the_disturbance_alone():
    law = loop()
    states = np.array([law.started(ERROR, [0.1, 0.2, 0.3])])
    v = lyapunov(ERROR[None, :], np.array([[0.1, 0.2, 0.3]]), states, 2.0)
    assert v[0] == pytest.approx(DISTURBANCE @ DISTURBANCE / (2 * GAMMA))


@pytest.mark.parametrize("delivered", [lambda _t, demand: demand, too_weak])
def test_the_error_vanishes(delivered):
    _, error, rate, _ = move(loop(), delivered, span=16.0)
    assert np.abs(error[-1]).max() < 1e-3
    assert np.abs(rate[-1]).max() < 1e-3


def test_a_far_goal_is_approached_at_the_speed_allowed_and_teaches_nothing():
    still = np.zeros(3)
    _, _, rate, states = move(loop(), disturbance=still)
    assert np.linalg.norm(rate, axis=1).max() <= K1 * 2.0
    assert np.abs(states[:, 6:]).max() < 1e-9


def test_the_estimate_stays_in_its_ball_when_the_truth_is_outside():
    states = move(loop(disturbance_max=1.0))[3]
    assert np.linalg.norm(states[:, 6:], axis=1).max() <= 1.0 + INTEGRATION


def test_without_adaptation_nothing_is_learnt():
    states = move(loop(adaptation=0.0))[3]
    assert np.abs(states[:, 6:]).max() == 0.0


def test_the_demand_near_the_reference_is_the_linear_law():
    error, rate = np.array([1e-6, 0, 0]), np.array([0, 2e-6, 0])
    demand, _ = loop()(error, rate, (0.1, 0, 0), (0, 0, 0), loop().started(error, rate))
    # a_r - k1 e' - k2 (e' + k1 e), the compensated error being zero at the start
    expected = [0.1 - 3.0 * K1 * 1e-6, -(K1 + 3.0) * 2e-6, 0.0]
    assert demand == pytest.approx(expected, rel=1e-9, abs=1e-15)


def test_the_correcting_acceleration_is_cut_off():
    far = (1e3, 0.0, 0.0)
    demand, _ = loop()(far, (50.0, 0.0, 0.0), (0, 0, 0), (0, 0, 0), loop().started(far, (50, 0, 0)))
    assert -2.0 < demand[0] < -1.99
    assert sqrt(demand[1] ** 2 + demand[2] ** 2) == 0.0
