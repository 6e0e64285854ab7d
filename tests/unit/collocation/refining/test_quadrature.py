"""Integrals that polynomials exact in the states get wrong, against closed forms."""

import numpy as np
import pytest
from pyomo.dae import ContinuousSet, DerivativeVar, Integral
from pyomo.environ import ConcreteModel, Constraint, Objective, Var, sqrt
from scipy.integrate import quad, solve_bvp

from pyomo_quad import collocation
from pyomo_quad.collocation import Mesh
from pyomo_quad.collocation.refining.error import estimate_error

CORNER, ROUNDING = 0.37, 1e-4


def moving_steadily(integrand):
    """A point that moves at speed 1 from 0 to 1, its rate free, and an integral beside the cost."""
    m = ConcreteModel()
    m.t = ContinuousSet(bounds=(0, 1))
    m.x = Var(m.t)
    m.u = Var(m.t)
    m.dx_dt = DerivativeVar(m.x, wrt=m.t)

    @m.Constraint(m.t)
    def motion(m, t):
        return m.dx_dt[t] == m.u[t]

    m.x[0].fix(0.0)
    m.x[1].fix(1.0)
    m.cost = Integral(m.t, wrt=m.t, rule=lambda m, t: m.u[t] ** 2)
    m.beside = Integral(m.t, wrt=m.t, rule=lambda m, t: integrand(m.x[t]))
    m.objective = Objective(expr=m.cost)
    m.enough = Constraint(expr=m.beside <= 10)
    return m


def rounded(x):
    return sqrt((x - CORNER) ** 2 + ROUNDING**2)


def runge(x):
    return 1 / (1 + 100 * (x - CORNER) ** 2)


@pytest.mark.parametrize("integrand", [rounded, runge])
def test_a_declared_integral_is_right_to_the_tolerance(integrand):
    tolerance = 1e-8
    solution = collocation.compile(moving_steadily(integrand)).solve(tolerance=tolerance)
    true, _ = quad(lambda x: float(integrand(x)), 0, 1, points=[CORNER], epsabs=1e-13, limit=200)
    assert solution.is_converged
    assert solution.value("beside") == pytest.approx(true, abs=tolerance)


def test_a_coarse_mesh_owns_up_to_a_corner_of_the_integrand():
    solution = collocation.compile(moving_steadily(rounded)).solve(mesh=Mesh.uniform(5, 4))
    true = (CORNER**2 + (1 - CORNER) ** 2) / 2
    off = abs(solution.value("beside") - true)
    error = estimate_error(solution)
    assert off > 1e-4
    assert error.states.max() < 1e-9
    assert error.largest >= off


def hyper_sensitive(end):
    """x' = -x^3 + u from 1.5 to 1 at the least integral of (x^2 + u^2) / 2."""
    m = ConcreteModel()
    m.t = ContinuousSet(bounds=(0, end))
    m.x = Var(m.t)
    m.u = Var(m.t)
    m.dx_dt = DerivativeVar(m.x, wrt=m.t)

    @m.Constraint(m.t)
    def motion(m, t):
        return m.dx_dt[t] == -(m.x[t] ** 3) + m.u[t]

    m.x[0].fix(1.5)
    m.x[end].fix(1.0)
    m.cost = Integral(m.t, wrt=m.t, rule=lambda m, t: (m.x[t] ** 2 + m.u[t] ** 2) / 2)
    m.objective = Objective(expr=m.cost)
    return m


def least_cost_by_shooting(end):
    """The same from the conditions of the optimum, solved as a boundary value problem."""

    def rates(_t, y):
        x, p, _ = y
        return np.array([-(x**3) - p, 3 * x**2 * p - x, (x**2 + p**2) / 2])

    def ends(first, last):
        return np.array([first[0] - 1.5, last[0] - 1.0, first[2]])

    t = np.linspace(0, end, 201)
    guess = np.array([1.5 * np.exp(-t) + np.exp(t - end), 0 * t, 0 * t])
    found = solve_bvp(rates, ends, t, guess, tol=1e-10, max_nodes=100_000)
    assert found.success
    return float(found.y[2, -1])


@pytest.mark.parametrize("tolerance", [1e-4, 1e-6, 1e-8, 1e-9])
def test_a_hyper_sensitive_cost_is_right_to_the_tolerance_claimed(tolerance):
    solution = collocation.compile(hyper_sensitive(50)).solve(tolerance=tolerance)
    assert solution.is_converged
    assert solution.objective == pytest.approx(1.3308069049, abs=tolerance)


def test_the_cost_is_that_of_the_conditions_of_the_optimum():
    solution = collocation.compile(hyper_sensitive(10)).solve(tolerance=1e-8)
    assert solution.objective == pytest.approx(least_cost_by_shooting(10), abs=1e-8)
