"""The Hamiltonian of a model without time is constant, or a warning says that it is not."""

import pytest
from pyomo.environ import Constraint

from pyomo_quad.collocation import Mesh, solve
from tests.problems import double_integrator, hyper_sensitive, stiff_tracking, waypoint

COARSE = Mesh.uniform(4, 2)


@pytest.mark.parametrize("problem", [double_integrator, hyper_sensitive])
def test_no_warning_where_it_is_constant(problem):
    assert solve(problem.build(), tolerance=1e-8).warnings == ()


def test_warning_where_a_coarse_mesh_breaks_it():
    (warning,) = solve(hyper_sensitive.build(), mesh=COARSE).warnings
    assert warning.startswith("Hamiltonian: varies by")
    assert warning.endswith("or distrust the costates.")
    assert "between" not in warning


def test_no_warning_where_the_model_reads_time():
    assert solve(stiff_tracking.build(), mesh=Mesh.uniform(3, 2)).warnings == ()


def test_no_warning_of_a_jump_at_an_interior_condition():
    solution = solve(waypoint.build(), tolerance=1e-8)
    kink = waypoint.KINKS[0]
    before, after = solution.hamiltonian([kink - 0.1, kink + 0.1])
    assert abs(after - before) > 0.1 * solution.objective
    assert solution.warnings == ()


def test_warning_where_a_coarse_mesh_breaks_it_between_interior_conditions():
    m = hyper_sensitive.build()
    middle = m.t.at(-1) / 2
    m.t.add(middle)
    m.t.set_changed(True)
    m.x.add(middle)
    m.gate = Constraint(expr=m.x[middle] == 0.5)
    (warning,) = solve(m, mesh=COARSE).warnings
    assert "between its conditions although nothing depends on time" in warning


def by_inequality(m):
    m.gate = Constraint(m.t, rule=lambda m, t: m.v[t] <= 1.0 + 0.6 * t)


def by_mixed_limit(m):
    m.gate = Constraint(m.t, rule=lambda m, t: m.v[t] + 0.01 * m.u[t] <= 1.0 + 0.6 * t)


@pytest.mark.parametrize("limit", [by_inequality, by_mixed_limit])
def test_no_warning_where_a_limit_reads_time(limit):
    m = double_integrator.build()
    limit(m)
    assert solve(m, mesh=Mesh.uniform(6, 3)).warnings == ()
