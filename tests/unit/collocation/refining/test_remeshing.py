"""What becomes of an element in which a control jumps, or has a kink."""

import numpy as np
import pytest
from pyomo.dae import ContinuousSet, DerivativeVar, Integral
from pyomo.environ import ConcreteModel, Constraint, Objective, Var
from scipy.optimize import brentq

from pyomo_quad import collocation
from pyomo_quad.collocation import Mesh, RefinementOptions
from pyomo_quad.collocation.refining.activity import kinks
from pyomo_quad.collocation.refining.error import estimate_error
from pyomo_quad.collocation.refining.remeshing import Marks, refined_mesh
from tests.problems.bang_bang import SWITCH, build

TOLERANCE = 1e-6
HORIZON = 3.0


def refined(mesh, element):
    solution = collocation.compile(build()).solve(mesh=mesh)
    return refined_mesh(
        solution,
        estimate_error(solution),
        Marks(coarse=frozenset({element}), kept=frozenset(range(mesh.elements)) - {element}),
        TOLERANCE,
        RefinementOptions(),
    )


def test_a_jump_is_isolated_in_a_sliver():
    mesh = Mesh(breakpoints=(0.0, 0.3, 0.9, 1.0), degrees=(4, 4, 4))
    finer = refined(mesh, 1)
    assert finer.degrees == (4, 4, 1, 4, 4)
    start, end = finer.breakpoints[2:4]
    assert start < SWITCH < end
    assert end - start < 0.1 * (0.9 - 0.3)


def test_an_element_beside_a_sliver_is_split_by_thirds():
    mesh = Mesh(breakpoints=(0.0, 0.3, 0.302, 0.9, 1.0), degrees=(4, 1, 4, 4))
    finer = refined(mesh, 2)
    assert finer.degrees == (4, 1, 4, 4, 4, 4)
    assert np.diff(finer.breakpoints[2:6]) == pytest.approx(np.full(3, 0.598 / 3))


def saturated():
    """Bring x' = u to rest at the least integral of x^2 + u^2, with u >= -1, from x = 2."""
    m = ConcreteModel()
    m.t = ContinuousSet(bounds=(0.0, HORIZON))
    m.x, m.u = Var(m.t), Var(m.t, bounds=(-1.0, 1.0))
    m.dx = DerivativeVar(m.x, wrt=m.t)
    m.x[0].fix(2.0)
    m.law = Constraint(m.t, rule=lambda m, t: m.dx[t] == m.u[t])
    m.effort = Integral(m.t, wrt=m.t, rule=lambda m, t: m.x[t] ** 2 + m.u[t] ** 2)
    m.cost = Objective(expr=m.effort)
    return collocation.compile(m)


def test_a_kink_is_found_between_the_points_and_isolated():
    """The control leaves its bound where the free optimum, u = -x tanh(T - t), reaches it."""
    kink = brentq(lambda t: (2.0 - t) * np.tanh(HORIZON - t) - 1.0, 0.0, 1.5) / HORIZON
    mesh = Mesh(breakpoints=(0.0, 0.2, 0.7, 1.0), degrees=(5, 9, 5))
    solution = saturated().solve(mesh=mesh)
    (found,) = kinks(solution)
    spacing = np.diff(mesh.point_fractions)[np.searchsorted(mesh.point_fractions, kink) - 1]
    assert found == pytest.approx(kink, abs=0.1 * spacing)
    chosen = Marks(coarse=frozenset({1}), kept=frozenset({0, 2}), are_kinked=True)
    finer = refined_mesh(solution, estimate_error(solution), chosen, TOLERANCE, RefinementOptions())
    start, end = finer.breakpoints[2:4]
    assert start < kink < end
    assert end - start < 0.1 * (0.7 - 0.2)


def test_a_jump_is_no_kink():
    solution = collocation.compile(build()).solve(mesh=Mesh.uniform(7, 4))
    assert kinks(solution).size == 0
