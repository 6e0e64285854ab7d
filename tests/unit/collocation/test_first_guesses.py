"""First points from `initialize` rules, at any time, and from the equations of what has none."""

import pickle

import numpy as np
import pytest
from pyomo.dae import ContinuousSet, DerivativeVar
from pyomo.environ import ConcreteModel, Constraint, Objective, Var, exp
from scipy.integrate import solve_ivp
from scipy.optimize import fsolve

from pyomo_quad.collocation import Mesh, compile
from pyomo_quad.collocation.guess import initial_point
from pyomo_quad.collocation.program.bounds import bounds_of
from pyomo_quad.collocation.refining.error import estimate_error
from tests.problems.published.chemistry import reactor_of_rates

MESH = Mesh.uniform(10, 4)


def guessed_by(rule):
    m = ConcreteModel()
    m.t = ContinuousSet(bounds=(0, 2))
    m.x, m.u = Var(m.t, initialize=rule), Var(m.t, initialize=0)
    m.dx = DerivativeVar(m.x, wrt=m.t)
    m.law = Constraint(m.t, rule=lambda m, t: m.dx[t] == m.u[t])
    m.cost = Objective(expr=m.x[2])
    return m


def first_point(problem):
    instance = problem.instance()
    program = problem.program(MESH, instance)
    bounds = bounds_of(program, problem.data_at_starts(instance), instance.fixed)
    return program, initial_point(program, bounds, problem.values, None)


def first_states(problem):
    program, z = first_point(problem)
    return z[program.layout.state_columns[:, 0]]


def a_round(_m, t):
    return float(np.sin(np.pi * t))


def test_a_rule_is_asked_at_all_points():
    found = first_states(compile(guessed_by(a_round)))
    assert found == pytest.approx(np.sin(2 * np.pi * MESH.node_fractions), abs=1e-12)


def test_a_fixed_end_overrules_the_rule_there_alone():
    m = guessed_by(a_round)
    m.x[0].fix(0.5)
    found = first_states(compile(m))
    assert found[0] == 0.5
    assert found[1:] == pytest.approx(np.sin(2 * np.pi * MESH.node_fractions[1:]), abs=1e-12)


def test_a_pickled_problem_begins_where_the_rule_says():
    found = first_states(pickle.loads(pickle.dumps(compile(guessed_by(a_round)))))
    assert found == pytest.approx(np.sin(2 * np.pi * MESH.node_fractions), abs=1e-8)


def test_values_set_since_overrule_the_rule():
    m = guessed_by(a_round)
    m.x[2].set_value(3.0)
    assert first_states(compile(m)) == pytest.approx(3.0 * MESH.node_fractions, abs=1e-12)


def test_algebraic_variables_without_a_guess_take_it_from_their_equations():
    """One by another, with a free one, which no equation defines, in the middle of its bounds."""
    m = guessed_by(lambda _m, t: 1.0 + t)
    m.free, m.rate, m.twice = Var(m.t, bounds=(2, 4)), Var(m.t), Var(m.t)
    m.second = Constraint(m.t, rule=lambda m, t: m.twice[t] - m.rate[t] == m.x[t])
    m.first = Constraint(m.t, rule=lambda m, t: m.x[t] * exp(-1 / m.free[t]) == 2 * m.rate[t])
    m.used = Constraint(m.t, rule=lambda m, t: m.twice[t] <= 10)
    problem = compile(m)
    program, z = first_point(problem)
    names = [slot.name for slot in program.compiled.declared.algebraics]
    held = dict(zip(names, z[program.layout.algebraic_columns].T, strict=True))
    x = 1.0 + 2.0 * MESH.point_fractions
    assert held["free"] == pytest.approx(np.full(MESH.points, 3.0))
    assert held["rate"] == pytest.approx(0.5 * x * np.exp(-1 / 3), rel=1e-12)
    assert held["twice"] == pytest.approx(held["rate"] + x, rel=1e-12)


def shooting_yield():
    """The reactor by Pontryagin's conditions, backwards from the end.

    As the second rate is a multiple of the square of the first, the Hamiltonian is a parabola in
    the first: its summit, held between the rates at 298 and 398 K.
    """
    lowest, highest = (4e3 * np.exp(-2500 / kelvin) for kelvin in (298, 398))
    share = 6.2e5 / 4e3**2

    def rate(a, b, pa, pb):
        return np.clip((pb - pa) * a**2 / (2 * share * pb * max(b, 1e-12)), lowest, highest)

    def backwards(_t, y):
        a, b, pa, pb = y
        k1 = rate(*y)
        k2 = share * k1**2
        return [k1 * a**2, k2 * b - k1 * a**2, 2 * k1 * a * (pb - pa), -k2 * pb]

    def flown(unknown):
        a, b, duration = unknown
        return solve_ivp(backwards, (0, duration), [a, b, 0, 1], rtol=1e-11, atol=1e-12).y[:, -1]

    def misses(unknown):
        a, b, _ = unknown
        k1 = rate(a, b, 0.0, 1.0)
        start = flown(unknown)
        return [start[0] - 1, start[1], k1 * a**2 - share * k1**2 * b - 0.05]

    _, b, duration = fsolve(misses, [0.2, 0.65, 1.5], xtol=1e-12)
    return b - 0.05 * duration


@pytest.mark.lengthy
def test_rates_as_algebraic_variables_take_no_finer_mesh_than_substituted_ones():
    problems = [
        compile(m, final_time=m.T)
        for m in (reactor_of_rates(), reactor_of_rates(are_variables=False))
    ]
    by_equations, substituted = (problem.solve(tolerance=1e-6) for problem in problems)
    assert by_equations.is_converged
    assert by_equations.objective == pytest.approx(substituted.objective, rel=1e-6)
    assert by_equations.objective == pytest.approx(shooting_yield(), rel=1e-6)
    # On one mesh both are the same polynomials: what resolves one of them resolves the other.
    alike = problems[0].solve(mesh=substituted.mesh)
    assert alike.objective == pytest.approx(substituted.objective, rel=1e-8)
    assert estimate_error(alike, tolerance=1e-6).largest <= 1e-6
