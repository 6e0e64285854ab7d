"""What a singular arc leaves of the states, against closed forms."""

from math import sin

import numpy as np
import pytest
from pyomo.dae import ContinuousSet, DerivativeVar, Integral
from pyomo.environ import ConcreteModel, Constraint, Objective, Var
from scipy.optimize import brentq

from pyomo_quad.collocation import Mesh, Problem, RefinementOptions, solve
from pyomo_quad.collocation.refining.minimum_principle import singular_order
from tests.problems import double_integrator, singular_arc


def follower(course, start):
    """Return x' = u with |u| <= 1 that is to be where a course is."""
    m = ConcreteModel()
    m.t = ContinuousSet(bounds=(0, 3))
    m.x, m.u = Var(m.t), Var(m.t, bounds=(-1, 1))
    m.dx_dt = DerivativeVar(m.x, wrt=m.t)
    m.motion = Constraint(m.t, rule=lambda m, t: m.dx_dt[t] == m.u[t])
    m.x[0].fix(start)
    m.miss = Integral(m.t, wrt=m.t, rule=lambda m, t: (m.x[t] - course(t)) ** 2 / 2)
    m.objective = Objective(expr=m.miss)
    return m


def fuller():
    """Return Fuller's problem: x'' = u with |u| <= 1, the least integral of x^2."""
    m = ConcreteModel()
    m.t = ContinuousSet(bounds=(0, 3))
    m.x, m.v, m.u = Var(m.t), Var(m.t), Var(m.t, bounds=(-1, 1))
    m.dx_dt, m.dv_dt = DerivativeVar(m.x, wrt=m.t), DerivativeVar(m.v, wrt=m.t)
    m.motion = Constraint(m.t, rule=lambda m, t: m.dx_dt[t] == m.v[t])
    m.force = Constraint(m.t, rule=lambda m, t: m.dv_dt[t] == m.u[t])
    m.x[0].fix(0)
    m.v[0].fix(1)
    m.cost = Integral(m.t, wrt=m.t, rule=lambda m, t: m.x[t] ** 2 / 2)
    m.objective = Objective(expr=m.cost)
    return m


def chatter(times):
    """Return Fuller's optimum: u changes on x = -c v |v|, c as in Zelikin and Borisov (1994)."""
    c = np.sqrt((np.sqrt(33.0) - 1.0) / 24.0)
    states = np.zeros((len(times), 2))
    start, x, v, u = 0.0, 0.0, 1.0, -1.0
    while abs(v) > 1e-9:
        lasts = max(np.roots([u / 2 + c * u, v + 2 * c * v, x + c * u * v**2]).real)
        inside = (times >= start) & (times <= start + lasts)
        t = times[inside] - start
        states[inside] = np.column_stack([x + v * t + u * t**2 / 2, v + u * t])
        start, x, v, u = start + lasts, x + v * lasts + u * lasts**2 / 2, v + u * lasts, -u
    return states


def farthest(solution, names, expected):
    times = np.unique([*np.linspace(*solution.horizon, 301), *solution.times])
    found = np.column_stack([solution.value(name, times) for name in names])
    return np.max(np.abs(found - expected(times)))


@pytest.mark.lengthy
@pytest.mark.parametrize(
    ("case", "tolerance"),
    [
        ("rest", 1e-4),
        ("rest", 1e-5),
        ("wave", 1e-5),
        pytest.param("wave", 1e-4, marks=pytest.mark.slow),
        pytest.param("wave", 1e-6, marks=pytest.mark.slow),
    ],
)
def test_an_arc_of_order_1_is_no_wronger_than_twice_what_is_claimed(case, tolerance):
    course, start = {"rest": (lambda t: 0.0, 1.0), "wave": (lambda t: sin(t) / 2, 1.0)}[case]
    meets = brentq(lambda t: start - t - course(t), 0.0, 1.0 + 1e-9)
    solution = solve(follower(course, start), tolerance=tolerance)

    def expected(times):
        on_arc = np.array([course(t) for t in times.tolist()])
        return np.where(times < meets, start - times, on_arc)[:, None]

    off = farthest(solution, ["x"], expected)
    assert singular_order(solution) == 1
    assert solution.error_estimate < off <= 2 * solution.state_error


@pytest.mark.slow
@pytest.mark.parametrize("tolerance", [1e-4, 1e-5, 1e-6, 1e-7, 1e-8])
def test_an_arc_of_order_2_is_no_wronger_than_twice_what_is_claimed(tolerance):
    solution = solve(fuller(), tolerance=tolerance)
    assert farthest(solution, ["x", "v"], chatter) <= 2 * solution.state_error


@pytest.mark.slow
@pytest.mark.parametrize("tolerance", [1e-4, 1e-5, 1e-6, 1e-7])
def test_braking_onto_an_arc_is_no_wronger_than_twice_what_is_claimed(tolerance):
    solution = solve(singular_arc.build(), tolerance=tolerance)

    def expected(times):
        return np.column_stack(list(singular_arc.state(times).values()))

    assert farthest(solution, ["x", "v"], expected) <= 2 * solution.state_error


@pytest.mark.lengthy
def test_the_order_of_an_arc_is_found():
    few = RefinementOptions(max_meshes=3)
    orders = [
        singular_order(solve(model, tolerance=1e-9, refinement=few))
        for model in (fuller(), singular_arc.build(), double_integrator.build())
    ]
    assert orders == [2, 1, 0]


def test_the_summary_tells_of_states_and_costates_where_they_were_estimated():
    problem = Problem(double_integrator.build())
    assert "states within" not in repr(problem.solve(mesh=Mesh.uniform(4, 3)))
    told = problem.solve(tolerance=1e-6)
    assert f"states within: {told.state_error:.2g}, costates within:" in repr(told)
