"""Damping of linear controls, on the singular regulator of the gates and on a car."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import approx_fprime

from pyomo_quad import collocation
from pyomo_quad.collocation import Mesh, Status
from pyomo_quad.collocation.refining.refinement import damping_of
from tests.problems import bang_bang, double_integrator, singular_arc

WEIGHT = 1e-3
MESH = Mesh.uniform(6, 3)


@pytest.fixture(scope="module")
def solution():
    return collocation.compile(singular_arc.build()).solve(mesh=MESH)


@pytest.fixture(scope="module")
def damped(solution):
    finer = Mesh.uniform(9, 4)
    program = solution.problem.program(finer, solution.instance)
    return damping_of(solution, WEIGHT).applied_to(program)


def test_only_bounded_controls_that_enter_linearly_are_damped(solution):
    assert damping_of(solution, WEIGHT) is not None
    quadratic = collocation.compile(double_integrator.build()).solve(mesh=MESH)
    assert damping_of(quadratic, WEIGHT) is None
    assert damping_of(solution, 0.0) is None


def test_controls_a_whole_range_away_cost_the_weight_times_the_objective(solution, damped):
    z = np.zeros(damped.program.layout.unknowns)
    z[damped.columns] = damped.near + 2.0  # the control lies within -1 and 1
    added = damped.objective(z) - damped.program.objective(z)
    assert added == pytest.approx(WEIGHT * solution.nominal_objective, rel=1e-12)


def test_chatter_within_elements_is_no_part_of_the_course_that_controls_are_drawn_to(
    solution, damped
):
    held = solution.trajectory
    weights = MESH.quadrature_weights.reshape(MESH.elements, -1)
    chatter = np.zeros_like(weights)
    chatter[:, 0], chatter[:, 1] = 0.01 / weights[:, 0], -0.01 / weights[:, 1]
    algebraics = held.algebraics + chatter.reshape(-1, 1)
    chattering = replace(solution, trajectory=replace(held, algebraics=algebraics))
    drawn = damping_of(chattering, WEIGHT).applied_to(damped.program)
    assert np.abs(algebraics - held.algebraics).max() > 0.1
    assert drawn.near == pytest.approx(damped.near, abs=1e-12)


def test_derivatives_are_those_of_finite_differences(damped):
    z = np.random.default_rng(1).uniform(-1.0, 1.0, damped.program.layout.unknowns)
    differences = approx_fprime(z, damped.objective, 1e-6)
    assert damped.gradient(z) == pytest.approx(differences, abs=1e-5)
    rows, columns = damped.hessianstructure()
    values = damped.hessian(z, np.zeros(damped.n_rows), 1.0)
    lower = np.zeros((z.size, z.size))
    np.add.at(lower, (rows, columns), values)
    whole = lower + np.tril(lower, -1).T
    step = np.random.default_rng(2).normal(size=z.size)
    slopes = [damped.gradient(z + s * 1e-4 * step) for s in (1.0, -1.0)]
    assert whole @ step == pytest.approx((slopes[0] - slopes[1]) / 2e-4, abs=1e-7)


def test_damping_leaves_no_bias_in_a_refined_optimum():
    refined = collocation.compile(bang_bang.build()).solve(tolerance=1e-7)
    assert refined.status is Status.CONVERGED
    assert refined.objective == pytest.approx(bang_bang.objective(), rel=1e-7)
