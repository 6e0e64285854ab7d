"""Measured orders of convergence of the engine on uniform meshes, against theory.

Flipped Radau collocation of degree K is of order 2K - 1 at element ends (superconvergence),
for states and objective, and of order K + 1 for the state polynomials between them.  Source:
Hairer and Wanner (1996), Solving Ordinary Differential Equations II, theorem IV.5.3.
"""

from functools import cache

import numpy as np
import pytest

from pyomo_quad.collocation import Mesh, SolverOptions, compile
from tests.problems import brachistochrone, hyper_sensitive

# Element counts per degree: as fine as errors a hundred times above rounding allow. At degrees 7
# and 8 that ends before the order has settled, so it is extrapolated from three meshes.
ELEMENTS = {
    2: (96, 128),
    3: (96, 128),
    4: (64, 96),
    5: (48, 64),
    6: (48, 64),
    7: (24, 28, 32),
    8: (20, 24, 28),
}
# Between the ends errors are larger, and finer meshes can be measured.
ELEMENTS_BETWEEN = ELEMENTS | {7: (48, 64), 8: (40, 48)}
SLACK = {2: 0.2, 3: 0.2, 4: 0.2, 5: 0.2, 6: 0.2, 7: 0.2, 8: 0.4}
# Tighter than usual, so that what is measured is the mesh's error.
EXACT = SolverOptions(tolerance=1e-11)


@cache
def solved(problem, elements, degree):
    mesh = Mesh.uniform(elements, degree)
    return compile(problem.build()).solve(mesh=mesh, options=EXACT)


def order(error, problem, degree, counts):
    """Return the order between two meshes, or at no width, a line in its square through more."""
    errors = np.log([error(solved(problem, elements, degree)) for elements in counts])
    orders = -np.diff(errors) / np.diff(np.log(counts))
    squares = 1 / (np.array(counts[:-1]) * np.array(counts[1:]))
    return np.polyfit(squares, orders, len(orders) - 1)[-1]


def largest_at_element_ends(solution):
    ends = solution.mesh.first_node
    exact = hyper_sensitive.state(solution.times[ends])["x"]
    return np.max(np.abs(solution.trajectory.states[ends, 0] - exact))


def largest_between(solution):
    times = np.linspace(*solution.horizon, 4001)
    return np.max(np.abs(solution.value("x", times) - hyper_sensitive.state(times)["x"]))


def of_objective(problem):
    return lambda solution: abs(solution.objective - problem.objective())


@pytest.mark.parametrize("degree", ELEMENTS)
def test_states_superconverge_at_element_ends(degree):
    found = order(largest_at_element_ends, hyper_sensitive, degree, ELEMENTS[degree])
    assert found == pytest.approx(2 * degree - 1, abs=SLACK[degree])


@pytest.mark.parametrize("degree", ELEMENTS)
def test_objective_superconverges(degree):
    found = order(of_objective(hyper_sensitive), hyper_sensitive, degree, ELEMENTS[degree])
    assert found == pytest.approx(2 * degree - 1, abs=SLACK[degree] + 0.2)


@pytest.mark.parametrize("degree", ELEMENTS)
def test_state_polynomials_between_element_ends(degree):
    found = order(largest_between, hyper_sensitive, degree, ELEMENTS_BETWEEN[degree])
    assert degree + 1 - 0.5 - SLACK[degree] <= found


@pytest.mark.parametrize(("degree", "counts"), [(2, (16, 24)), (3, (12, 16)), (4, (3, 4))])
def test_objective_of_a_nonlinear_problem(degree, counts):
    found = order(of_objective(brachistochrone), brachistochrone, degree, counts)
    assert found == pytest.approx(2 * degree - 1, abs=0.2)


def test_degree_beats_elements_on_a_smooth_problem():
    by_degree = largest_at_element_ends(solved(hyper_sensitive, 32, 8))
    by_elements = largest_at_element_ends(solved(hyper_sensitive, 128, 2))
    assert by_degree < 1e-9 * by_elements
