"""The Hamiltonian of a model without time is constant, or a warning says that it is not."""

import pytest

from pyomo_quad.collocation import Mesh, solve
from tests.problems import double_integrator, hyper_sensitive, stiff_tracking


@pytest.mark.parametrize("problem", [double_integrator, hyper_sensitive])
def test_no_warning_where_it_is_constant(problem):
    assert solve(problem.build(), tolerance=1e-8).warnings == ()


def test_warning_where_a_coarse_mesh_breaks_it():
    (warning,) = solve(hyper_sensitive.build(), mesh=Mesh.uniform(4, 2)).warnings
    assert warning.startswith("Hamiltonian: varies by")


def test_no_warning_where_the_model_reads_time():
    assert solve(stiff_tracking.build(), mesh=Mesh.uniform(3, 2)).warnings == ()
