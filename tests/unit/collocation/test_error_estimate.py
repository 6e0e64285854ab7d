"""What a breach of a limit between the points counts, on the wall of Bryson and Denham.

The optimum is 4 / (9 l) for a wall at l: moving the wall by d earns 4 / (9 l^2) d.
"""

import numpy as np
import pytest

from pyomo_quad import collocation
from pyomo_quad.collocation import Allowance, Mesh
from pyomo_quad.collocation.refining.error import estimate_error
from tests.problems.bryson_denham import WALL, build

EARNED_PER_METRE = 4 / (9 * WALL**2)


@pytest.fixture(scope="module")
def solution():
    return collocation.compile(build()).solve(mesh=Mesh.uniform(7, 3))


@pytest.fixture(scope="module")
def breach(solution):
    """The worst breach at many times, in metres; the wall is below 1, hence relative to 1."""
    return float(np.max(solution.value("x", np.linspace(0.0, 1.0, 20_001)))) - WALL


def test_a_breach_counts_as_it_is_unless_it_is_forgiven(solution, breach):
    assert breach > 1e-6
    assert estimate_error(solution).violation.max() >= 0.9 * breach


def test_a_forgiven_breach_counts_by_what_it_earns(solution, breach):
    forgiven = estimate_error(solution, allowance=Allowance(limit_breach=2.0 * breach)).violation
    relative = EARNED_PER_METRE * breach / solution.objective
    assert 0.0 < forgiven.sum() <= 1.01 * relative


def test_a_breach_above_what_is_forgiven_is_not(solution, breach):
    strict, lax = (
        estimate_error(solution, allowance=Allowance(limit_breach=b)) for b in (0.0, 0.5 * breach)
    )
    assert lax.violation.max() == pytest.approx(strict.violation.max())
