"""Constraints far from their limits: left out of a warm start, and checked at the optimum."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from pyomo_quad.collocation import SolverOptions
from pyomo_quad.collocation.program.far_rows import ProgramOfRows, far_rows, run_without_far_rows
from pyomo_quad.collocation.program.ipopt import run
from pyomo_quad.collocation.program.nonlinear import Bounds, Multipliers, Scaling

# Least squares of z - AIM, within SLOPES z <= LIMITS: the first limit holds, the others are far.
AIM = np.array([3.0, 0.0])
SLOPES = np.array([[1.0, 0.0], *([[1.0, 1.0]] * 4)])
LIMITS = np.array([1.0, *([100.0] * 4)])
OPTIMUM, MULTIPLIERS = [1.0, 0.0], [2.0, *([0.0] * 4)]
BOUNDS = Bounds(
    lower=np.full(2, -np.inf),
    upper=np.full(2, np.inf),
    row_lower=np.full(LIMITS.size, -np.inf),
    row_upper=LIMITS,
)
SCALING = Scaling(objective=1.0, unknowns=np.ones(2), rows=np.ones(LIMITS.size))


class LeastSquares:
    n_rows, n_points, is_negated = LIMITS.size, 1, False

    def objective(self, z):
        return 0.5 * float((z - AIM) @ (z - AIM))

    def gradient(self, z):
        return z - AIM

    def constraints(self, z):
        return SLOPES @ z

    def jacobianstructure(self):
        return np.nonzero(np.ones_like(SLOPES))

    def jacobian(self, _z):
        return SLOPES.ravel()

    def hessianstructure(self):
        return np.arange(2), np.arange(2)

    def hessian(self, _z, _multipliers, factor):
        return np.full(2, factor)


def solved(start):
    """Return the solution from a warm start, and the numbers of rows of each solve."""
    sizes = []

    def counted(program, *arguments, **settings):
        sizes.append(program.n_rows)
        return run(program, *arguments, **settings)

    none = Multipliers(rows=np.zeros(LIMITS.size), lower=np.zeros(2), upper=np.zeros(2))
    found = run_without_far_rows(
        counted,
        LeastSquares(),
        BOUNDS,
        SCALING,
        np.array(start),
        multipliers=none,
        options=SolverOptions(tolerance=1e-10),
    )
    return found, sizes


@pytest.mark.parametrize(
    ("start", "rows"),
    [
        pytest.param([0.95, 0.0], [1], id="the active limit is near"),
        pytest.param([-5.0, 0.0], [0, 5], id="the active limit is far, and found violated"),
        pytest.param([0.95, 98.95], [5], id="all limits are near"),
    ],
)
def test_the_optimum_and_its_multipliers_are_those_of_all_constraints(start, rows):
    found, sizes = solved(start)
    assert found.is_converged
    assert sizes == rows
    assert_allclose(found.z, OPTIMUM, atol=1e-7)
    assert_allclose(found.multipliers.rows, MULTIPLIERS, atol=1e-6)


def test_equations_are_never_far():
    even = Bounds(lower=BOUNDS.lower, upper=BOUNDS.upper, row_lower=LIMITS, row_upper=LIMITS)
    assert not far_rows(LeastSquares(), even, SCALING, np.zeros(2)).any()


def test_a_part_of_a_program_has_the_chosen_rows():
    part, z = ProgramOfRows(LeastSquares(), np.array([0, 3])), np.array([0.3, -0.7])
    assert_allclose(part.constraints(z), (SLOPES @ z)[[0, 3]])
    dense = np.zeros((2, 2))
    dense[part.jacobianstructure()] = part.jacobian(z)
    assert_allclose(dense, SLOPES[[0, 3]])
    assert_allclose(part.of_all(np.array([1.0, 2.0])), [1.0, 0.0, 0.0, 2.0, 0.0])
