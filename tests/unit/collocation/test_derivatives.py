"""Derivatives on a mesh of several degrees, against differences of the values."""

import numpy as np
import pytest
from pyomo.dae import ContinuousSet, DerivativeVar, Integral
from pyomo.environ import ConcreteModel, Constraint, Objective, Var
from scipy.sparse import coo_array

from pyomo_quad.collocation import Mesh, compile


def model_where_all_meets():
    """Rates, states, controls and statics, each times each, in every kind of row."""
    m = ConcreteModel()
    m.t = ContinuousSet(initialize=[0, 0.25, 1])
    m.x, m.v = Var(m.t), Var(m.t)
    m.u, m.p = Var(m.t, bounds=(-9, 9)), Var(initialize=1.5, bounds=(1, 2))
    m.T = Var(initialize=1.0, bounds=(0.5, 2))
    m.half = Var(initialize=0.3, bounds=(0.1, 0.4))
    m.dx_dt, m.dv_dt = DerivativeVar(m.x, wrt=m.t), DerivativeVar(m.v, wrt=m.t)
    m.motion = Constraint(
        m.t, rule=lambda m, t: m.dx_dt[t] * (1 + m.dx_dt[t] ** 2 * m.p) == m.v[t] * m.p
    )
    m.force = Constraint(
        m.t, rule=lambda m, t: m.dv_dt[t] * (1 + m.dx_dt[t]) == m.u[t] * m.x[t] * m.p**2
    )
    m.x[0].fix(0)
    m.x[1].fix(1)
    m.end = Constraint(expr=m.v[0] ** 2 + m.u[0] * m.p + m.dv_dt[1] ** 2 * m.v[1] <= 5)
    m.effort = Integral(
        m.t, rule=lambda m, t: m.dv_dt[t] ** 2 + m.u[t] * m.dx_dt[t] + m.p * m.u[t] ** 2
    )
    m.work = Integral(m.t, rule=lambda m, t: m.dx_dt[t] ** 2 * m.v[t])
    m.cost = Objective(expr=m.effort + m.work**2 + m.dv_dt[1] ** 2)
    return m


@pytest.fixture(scope="module", params=["the end is free", "two times are free"])
def program(request):
    m = model_where_all_meets()
    interior = {0.25: m.half} if request.param == "two times are free" else {}
    problem = compile(m, times=interior | {1: m.T})
    mesh = Mesh(breakpoints=(0.0, 0.1, 0.25, 0.5, 0.6, 1.0), degrees=(3, 1, 5, 3, 1))
    return problem.program(mesh, problem.instance())


@pytest.fixture(scope="module")
def point(program):
    z = 1.0 + 0.1 * np.random.default_rng(5).normal(size=program.layout.unknowns)
    z[program.layout.static_columns[-1]] *= 0.3  # the earlier time, where it is one
    return z


def differences(function, z):
    """Return the slopes of a function by central differences, one column per unknown."""
    step = 1e-6
    moved = step * np.eye(z.size)
    return np.column_stack([(function(z + d) - function(z - d)) / (2 * step) for d in moved])


def filled(structure, values, shape):
    rows, columns = structure
    assert len(set(zip(rows.tolist(), columns.tolist(), strict=True))) == len(rows)
    return coo_array((values, (rows, columns)), shape=shape).toarray()


def assert_close(found, expected):
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-6 * np.abs(expected).max())


def test_jacobian_and_gradient_are_the_slopes(program, point):
    shape = program.n_rows, point.size
    found = filled(program.jacobianstructure(), program.jacobian(point), shape)
    assert_close(found, differences(program.constraints, point))
    assert_close(program.gradient(point), differences(program.objective, point)[0])


def test_hessian_is_the_slope_of_the_lagrangians_gradient(program, point):
    multipliers = np.random.default_rng(6).normal(size=program.n_rows)
    rows, columns = program.jacobianstructure()

    def gradient(z):
        held = np.bincount(columns, multipliers[rows] * program.jacobian(z), minlength=z.size)
        return 0.7 * program.gradient(z) + held

    structure = program.hessianstructure()
    assert np.all(structure[0] >= structure[1])
    shape = point.size, point.size
    lower = filled(structure, program.hessian(point, multipliers, 0.7), shape)
    assert_close(lower, np.tril(differences(gradient, point)))


def test_other_numbers_share_the_pattern_of_their_mesh(program):
    again = program.with_data(program.data)
    for shared, own in zip(
        (*again.jacobianstructure(), *again.hessianstructure()),
        (*program.jacobianstructure(), *program.hessianstructure()),
        strict=True,
    ):
        assert shared is own
