"""What a local error becomes at the end of a flight, against closed forms."""

import numpy as np
import pytest

from pyomo_quad import collocation
from pyomo_quad.collocation import Mesh
from pyomo_quad.collocation.refining.error import final_misses
from tests.problems import double_integrator, hyper_sensitive, implicit_dae

SIZE = 1e-3


def misses_of(problem, mesh):
    solution = collocation.compile(problem.build()).solve(mesh=mesh)
    states = solution.problem.compiled.declared.states
    errors = np.full((mesh.elements, len(states)), SIZE)
    return solution, [s.name for s in states], final_misses(solution, errors)


def test_an_error_of_speed_grows_with_the_time_that_is_left():
    mesh = Mesh(breakpoints=(0.0, 0.2, 0.7, 1.0), degrees=(3, 2, 4))
    _, names, misses = misses_of(double_integrator, mesh)
    left = 1.0 - np.array(mesh.breakpoints[1:])
    assert misses[:, names.index("x")] == pytest.approx(SIZE * (1.0 + left), rel=1e-10)
    assert misses[:, names.index("v")] == pytest.approx(np.full(3, SIZE), rel=1e-10)


def test_an_error_of_a_stable_state_decays():
    mesh = Mesh.uniform(40, 4)
    solution, _, misses = misses_of(hyper_sensitive, mesh)
    left = solution.horizon[1] * (1.0 - np.array(mesh.breakpoints[1:]))
    assert misses[:, 0] == pytest.approx(SIZE * np.exp(-left), rel=1e-3)


def test_a_rate_inside_a_nonlinear_equation_is_solved_for():
    # The force alone gives the rate: an error is neither damped nor amplified.
    _, _, misses = misses_of(implicit_dae, Mesh.uniform(3, 3))
    assert misses[:, 0] == pytest.approx(np.full(3, SIZE), rel=1e-10)
