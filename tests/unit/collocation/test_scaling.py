"""Scaling of the rows of a program at its first point."""

import numpy as np
import pytest
from pyomo.dae import ContinuousSet, DerivativeVar, Integral
from pyomo.environ import ConcreteModel, Constraint, Objective, Var

from pyomo_quad.collocation import Mesh, compile

SLOWEST, FASTEST, MESH = 0.1, 2.0, Mesh.uniform(elements=4, degree=3)


def slow_start():
    """Return a cart that goes 1 m in 4 s and is slow, by its squared speed, for half a second."""
    m = ConcreteModel()
    m.t = ContinuousSet(initialize=(0.0, 0.5, 4.0))
    m.x, m.u = Var(m.t), Var(m.t, bounds=(-5.0, 5.0))
    m.v = Var(m.t, bounds=(-FASTEST, FASTEST))
    m.dx, m.dv = DerivativeVar(m.x, wrt=m.t), DerivativeVar(m.v, wrt=m.t)
    m.motion = Constraint(m.t, rule=lambda m, t: m.dx[t] == m.v[t])
    m.force = Constraint(m.t, rule=lambda m, t: m.dv[t] == m.u[t])
    m.ends = Constraint(expr=m.x[4.0] == 1.0)
    m.rest = Constraint(expr=m.v[4.0] == 0.0)
    m.x[0.0].fix(0.0)
    m.v[0.0].fix(0.0)
    m.slow = Constraint(
        m.t,
        rule=lambda m, t: m.v[t] ** 2 <= SLOWEST**2 if 0.0 < t <= 0.5 else Constraint.Skip,
    )
    m.effort = Integral(m.t, wrt=m.t, rule=lambda m, t: m.u[t] ** 2)
    m.objective = Objective(expr=m.effort)
    return m


@pytest.mark.parametrize("speed", [0.0, 1e-12, 1e-7])
def test_a_row_whose_slopes_vanish_at_the_first_point_is_not_scaled_without_end(speed):
    # The slope of v^2 over v in its magnitude V is 2 v V, and 2 V^2 where the speed is V: a
    # hundredth of that is the least that a row is scaled by.
    problem = compile(slow_start())
    guess = {"v": speed, "x": 0.0, "u": 0.0}
    solution = problem.solve(mesh=MESH, guess=guess)
    assert solution.is_converged
    assert solution.scaling.rows.max() <= 100 / (2 * FASTEST**2) * (1 + 1e-9)


def test_the_optimum_does_not_depend_on_how_slow_the_first_point_is():
    problem = compile(slow_start())
    found = [
        problem.solve(mesh=MESH, guess={"v": speed, "x": 0.0, "u": 0.0}).objective
        for speed in (1e-9, SLOWEST)
    ]
    assert np.ptp(found) <= 1e-8 * found[0]
