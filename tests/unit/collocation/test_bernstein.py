"""Bounds kept between the points: no sample is beyond them, and what that costs is told."""

import numpy as np
import pytest
from pyomo.environ import Constraint, inequality
from scipy.interpolate import BPoly
from scipy.optimize import approx_fprime

from pyomo_quad import collocation
from pyomo_quad.collocation import Allowance, Mesh, RefinementOptions, Status
from pyomo_quad.collocation.mesh import radau_rule
from pyomo_quad.collocation.program.bernstein import bernstein_rule, bounded
from tests.problems import double_integrator

# A mass moved in 1 s with |u| <= 5 holds that until 1/2 - b, then falls to the other limit: of the
# speed it needs b^2 = 3 (1/4 - 1/5), of effort 25 (1/2 - 2 b / 3).
MOST = 5.0
EFFORT = MOST**2 * (1 / 2 - 2 / 3 * np.sqrt(3 * (1 / 4 - 1 / MOST)))
BREACH = 1e-4
ALLOWANCE = Allowance(control_breach=BREACH, limit_breach=BREACH)
COARSE = Mesh.uniform(4, 4)


@pytest.fixture(scope="module")
def problem():
    m = double_integrator.build()
    m.most = Constraint(m.t, rule=lambda m, t: inequality(-MOST, m.u[t], MOST))
    return collocation.compile(m)


def refined(problem, *, tolerance=1e-7, max_meshes=25, limits_move=True):
    options = RefinementOptions(
        allowance=ALLOWANCE, limits_move=limits_move, max_meshes=max_meshes, damping=0.0
    )
    return problem.solve(mesh=COARSE, tolerance=tolerance, refinement=options)


def most_between_points(found):
    return np.abs(found.trajectory.algebraics_at(np.linspace(0.0, 1.0, 20_001))).max()


@pytest.mark.parametrize("degree", range(2, 13))
@pytest.mark.parametrize("is_state", [False, True])
def test_coefficients_and_values_are_those_of_scipy(degree, is_state):
    radau = radau_rule(degree)
    at = radau.nodes if is_state else radau.points
    coefficients = np.random.default_rng(degree).normal(size=at.size)
    polynomial = BPoly(coefficients[:, None], [0.0, 1.0])
    rule, kept = bernstein_rule(degree, is_state=is_state), slice(int(is_state), -1)
    assert rule.coefficients @ polynomial(at) == pytest.approx(coefficients[kept], abs=1e-7)
    abscissae = np.linspace(0.0, 1.0, at.size)[kept]
    assert rule.values @ polynomial(at) == pytest.approx(polynomial(abscissae), abs=1e-7)


def test_no_control_is_beyond_its_bound_anywhere_on_the_second_mesh_already(problem):
    free, held = (refined(problem, max_meshes=2, limits_move=move) for move in (False, True))
    assert most_between_points(free) > (1.0 + 10 * BREACH) * MOST
    assert most_between_points(held) <= (1.0 + BREACH) * MOST


@pytest.mark.lengthy
def test_what_it_costs_is_told_and_refined_away(problem):
    coarse = refined(problem, max_meshes=2)
    excess = coarse.objective - EFFORT
    assert 0.1 * excess < coarse.restraint.cost.sum() < 10.0 * excess
    fine = refined(problem)
    assert fine.status is Status.CONVERGED
    assert fine.objective == pytest.approx(EFFORT, rel=1e-6)
    assert most_between_points(fine) <= (1.0 + BREACH) * MOST


def test_rows_are_linear_with_their_own_slopes(problem):
    solution = problem.solve(mesh=COARSE)
    rows = bounded(solution.program, solution.bounds, solution.unknowns, BREACH)
    program = rows.added_to(solution.program)
    z = np.random.default_rng(1).normal(size=solution.unknowns.size)
    rows, columns = program.jacobianstructure()
    dense = np.zeros((program.n_rows, z.size))
    np.add.at(dense, (rows, columns), program.jacobian(z))
    assert dense == pytest.approx(approx_fprime(z, program.constraints, 1e-7), abs=1e-5)
