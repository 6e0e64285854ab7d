"""Many loops in fixed steps: the matrix exponential, the method's order, and own numbers."""

import numpy as np
import pytest
from pyomo.environ import Param
from scipy.linalg import expm

from pyomo_quad.collocation import SolveError, SteppedLoops
from tests.unit.collocation.test_feedback import (
    DAMPING,
    DRAG,
    INTEGRATION,
    STIFFNESS,
    cart,
    proportional_integral,
)

START = np.array([[0.0, 0.0, 0.0, 0.0], [0.5, -1.0, 0.2, 0.0], [-2.0, 0.0, 0.0, 0.0]])


def flown(steps, end=2.0, start=START):
    loops = SteppedLoops(cart(), proportional_integral, n_command=1, n_own=1, varied=())
    times = np.linspace(0.0, end, steps + 1)
    return loops.fly(times, start, lambda _t: [1.0], [], sampled=np.ones(steps + 1, dtype=bool))


def exact(t):
    system = np.array(
        [
            [0.0, 1.0, 0.0, 0.0],
            [-STIFFNESS, -DAMPING - DRAG, -INTEGRATION, STIFFNESS],
            [1.0, 0.0, 0.0, -1.0],
            [0.0, 0.0, 0.0, 0.0],
        ]
    )
    begun = np.column_stack([START[:, :3], np.ones(len(START))])
    return (begun @ expm(t * system).T)[:, :3]


def test_every_vehicle_flies_from_its_own_start_as_the_matrix_exponential_says():
    many = flown(200)
    for k in (0, 77, 200):
        assert many.joint[k, :, :3] == pytest.approx(exact(many.t[k]), abs=1e-8)


def test_half_the_step_leaves_a_sixteenth_of_the_error():
    coarse, fine = (
        np.abs(flown(steps).joint[-1, :, :3] - exact(2.0)).max(axis=1) for steps in (10, 20)
    )
    assert np.log2(coarse / fine) == pytest.approx(4.0, abs=0.4)


def test_the_controls_are_those_that_the_law_applies():
    many = flown(10)
    law = -STIFFNESS * (many.joint[..., 0] - 1.0) - DAMPING * many.joint[..., 1]
    law -= INTEGRATION * many.joint[..., 2]
    assert many.controls[..., 0] == pytest.approx(law, abs=1e-12)


def in_a_wind(m, t):
    if not hasattr(m, "wind"):
        m.wind, m.gust = Param(initialize=0.0, mutable=True), Param(m.t, default=0.0, mutable=True)
    return m.wind + m.gust[t] - DRAG * m.v[t]


def test_vehicles_differ_in_parameters_and_in_those_over_time():
    steps, end = 40, 2.0
    loops = SteppedLoops(
        cart(in_a_wind),
        lambda _command, _x, _own: ([0.0], []),
        n_command=0,
        n_own=0,
        varied=("wind", "gust"),
    )
    times, wind = np.linspace(0.0, end, steps + 1), np.array([0.0, 0.7, -1.3])
    gust = np.random.default_rng(4).normal(size=(steps, 3))
    many = loops.fly(
        times, np.zeros((3, 3)), lambda _t: [], [wind, gust], sampled=np.arange(steps + 1) == steps
    )
    # v' = force - DRAG v over steps of constant force.
    speed, width = np.zeros(3), end / steps
    for force in gust + wind:
        speed = force / DRAG + (speed - force / DRAG) * np.exp(-DRAG * width)
    assert many.joint[-1, :, 1] == pytest.approx(speed, rel=1e-9)


def test_a_vehicle_that_leaves_all_numbers_is_refused_with_what_to_do():
    loops = SteppedLoops(
        cart(), lambda _command, x, _own: ([1e3 * x[0] ** 3], []), n_command=0, n_own=0, varied=()
    )
    sampled = np.ones(101, dtype=bool)
    with pytest.raises(SolveError, match="1 of 2 are no longer finite; take shorter steps"):
        loops.fly(
            np.linspace(0.0, 50.0, 101),
            np.array([[0.0] * 3, [5.0] * 3]),
            lambda _t: [],
            [],
            sampled=sampled,
        )


def test_newton_steps_written_out_solve_an_implicit_equation():
    # v' + v'^3 = force: v' by Cardano.
    vehicle = cart(slope=lambda rate: rate + rate**3)
    explicit = vehicle.without_iterations()
    for force in (-3.0, -0.2, 0.0, 0.4, 8.0):
        rates = explicit.rates(0.0, np.zeros(2), np.array([force]))
        root = np.cbrt(force / 2 + np.sqrt(force**2 / 4 + 1 / 27))
        assert rates[1] == pytest.approx(root - 1 / (3 * root), abs=1e-12)
        assert rates == pytest.approx(vehicle.rates(0.0, np.zeros(2), np.array([force])), abs=1e-12)
