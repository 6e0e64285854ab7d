"""Closed loops: a law traced once and compiled with the vehicle is the law as written."""

import numpy as np
import pytest
from pyomo.dae import ContinuousSet, DerivativeVar, Integral
from pyomo.environ import ConcreteModel, Constraint, Objective, Var
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from pyomo_quad.collocation import ClosedLoop, TranscriptionError, compile

DRAG, STIFFNESS, DAMPING, INTEGRATION = 0.3, 4.0, 2.5, 0.7
# Of sums of a few terms, relative.
ROUNDING = 1e-12
PLACES = np.linspace(-2.0, 2.0, 41)


def cart(force=lambda m, t: m.u[t] - DRAG * m.v[t], slope=lambda rate: rate, end=2.0):
    """A cart pushed by u: x' = v, slope(v') = force, and the effort u^2/2 spent."""
    m = ConcreteModel()
    m.t = ContinuousSet(bounds=(0.0, end))
    m.x, m.v, m.u = Var(m.t), Var(m.t), Var(m.t)
    m.dx, m.dv = DerivativeVar(m.x, wrt=m.t), DerivativeVar(m.v, wrt=m.t)
    m.motion = Constraint(m.t, rule=lambda m, t: m.dx[t] == m.v[t])
    m.push = Constraint(m.t, rule=lambda m, t: slope(m.dv[t]) == force(m, t))
    m.x[0].fix(0)
    m.v[0].fix(0)
    # Held at the end as well, the place is no output: the states are (x, v).
    m.x[end].fix(1)
    m.effort = Integral(m.t, rule=lambda m, t: m.u[t] ** 2 / 2)
    m.cost = Objective(expr=m.effort)
    return compile(m).dynamics()


def proportional_integral(command, x, own):
    error = x[0] - command[0]
    return [-STIFFNESS * error - DAMPING * x[1] - INTEGRATION * own[0]], [error]


def closed(dynamics, law=proportional_integral, n_own=1):
    return ClosedLoop(dynamics, law, n_command=1, n_own=n_own)


def pushed_by(law):
    """Return what a law of the place x alone commands at `PLACES`."""
    loop = closed(cart(), lambda command, x, own: ([law(x[0])], []), n_own=0)
    joint = np.column_stack([PLACES, np.zeros((len(PLACES), 2))])
    n = len(PLACES)
    return loop.controls(np.zeros(n), joint, np.zeros((n, 1)))[:, 0]


def test_a_linear_loop_flies_as_the_matrix_exponential_says():
    loop = closed(cart())
    flown = solve_ivp(
        lambda t, joint: loop.rates(t, joint, [1.0]),
        (0.0, 2.0),
        np.zeros(4),
        rtol=1e-10,
        atol=1e-12,
    )
    # Of (x, v, own, 1): the command is 1.
    system = np.array(
        [
            [0.0, 1.0, 0.0, 0.0],
            [-STIFFNESS, -DAMPING - DRAG, -INTEGRATION, STIFFNESS],
            [1.0, 0.0, 0.0, -1.0],
            [0.0, 0.0, 0.0, 0.0],
        ]
    )
    expected = (expm(2.0 * system) @ [0.0, 0.0, 0.0, 1.0])[:3]
    assert flown.y[:3, -1] == pytest.approx(expected, rel=1e-8)


def test_the_last_rate_is_the_objectives_integrand_at_the_control_applied():
    loop, joint = closed(cart()), np.array([0.4, -0.2, 0.3, 5.0])
    control = loop.controls(np.array([0.7]), joint[None, :], np.array([[1.0]]))[0, 0]
    assert control == pytest.approx(proportional_integral([1.0], joint[:2], joint[2:3])[0][0])
    assert loop.rates(0.7, joint, [1.0])[-1] == pytest.approx(control**2 / 2, rel=ROUNDING)


def test_equations_read_the_time_of_the_call():
    # A rule that looks its time up is data of the moment, not a formula.
    loop = closed(cart(lambda m, t: m.u[t] + (1.0 if t < 0.5 else np.interp(t, (0.5, 2), (3, 6)))))
    pushes = [loop.rates(t, np.zeros(4), [0.0])[1] for t in (0.25, 1.0, 1.5)]
    assert pushes == pytest.approx([1.0, 4.0, 5.0], rel=1e-9)


def test_a_vehicle_implicit_in_its_slopes_is_closed_too():
    loop = closed(cart(slope=lambda rate: rate + rate**3))
    slope = loop.rates(0.0, np.zeros(4), [1.0])[1]
    assert slope + slope**3 == pytest.approx(STIFFNESS, rel=1e-9)


@pytest.mark.parametrize(
    "law",
    [
        lambda x: np.fmin(np.fmax(2 * x, -1.0), x**2),
        lambda x: np.tanh(x) / np.sqrt(1 + x * x) - np.abs(-x),
        lambda x: np.arctan2(np.sin(3 * x), 2.0 + np.cos(x)) + np.exp(-x) * np.arcsin(x / 3),
        lambda x: np.float64(2.0) * x - 1.0 / (np.float64(3.0) + x) + 2.0**x,
        lambda x: 7.0,
    ],
)
def test_functions_compiled_are_numpys(law):
    expected = np.array([law(x) for x in PLACES])
    assert pushed_by(law) == pytest.approx(expected, rel=ROUNDING, abs=ROUNDING)


def test_a_branch_on_a_state_is_refused():
    with pytest.raises(TranscriptionError, match=r"np\.greater cannot .* one formula of np\.fmin"):
        pushed_by(lambda x: 1.0 if x > 0 else -1.0)
    with pytest.raises(TranscriptionError, match="a branch on a number known in flight only"):
        pushed_by(lambda x: x or 1.0)


def test_a_function_that_cannot_be_compiled_is_named():
    with pytest.raises(TranscriptionError, match=r"np\.floor cannot be compiled; .* np\.arctan2"):
        pushed_by(np.floor)


def test_a_law_for_another_vehicle_is_refused():
    with pytest.raises(TranscriptionError, match=r"returns 2 controls and 0 rates .* has 1 c"):
        closed(cart(), lambda command, x, own: ([0.0, 0.0], []), n_own=1)
