"""Named infeasibility, on a car that must go 1 m from rest to rest with a bounded force.

With |u| <= L the shortest time is 2 / sqrt(L); in time T the least bound is 4 / T^2.
"""

import pytest
from pyomo.dae import ContinuousSet, DerivativeVar, Integral
from pyomo.environ import ConcreteModel, Constraint, Objective, Var, units

from pyomo_quad import collocation
from pyomo_quad.collocation import Mesh, Status, TranscriptionError, diagnose, solve

MESH = Mesh.uniform(8, 3)


def car(duration, limit=1.0):
    m = ConcreteModel()
    m.t = ContinuousSet(bounds=(0, duration))
    m.x = Var(m.t, units=units.m)
    m.v = Var(m.t, units=units.m / units.s)
    m.u = Var(m.t, units=units.m / units.s**2)
    m.dx_dt = DerivativeVar(m.x, wrt=m.t, units=units.m / units.s)
    m.dv_dt = DerivativeVar(m.v, wrt=m.t, units=units.m / units.s**2)
    m.motion = Constraint(m.t, rule=lambda m, t: m.dx_dt[t] == m.v[t])
    m.force = Constraint(m.t, rule=lambda m, t: m.dv_dt[t] == m.u[t])
    m.strongest = Constraint(m.t, rule=lambda m, t: (-limit, m.u[t], limit))
    for at, x in ((0, 0), (duration, 1)):
        m.x[at].fix(x)
        m.v[at].fix(0)
    m.effort = Integral(m.t, wrt=m.t, rule=lambda m, t: m.u[t] ** 2 / 2)
    m.objective = Objective(expr=m.effort)
    return m


@pytest.fixture(scope="module")
def failed():
    solution = collocation.compile(car(duration=1.0)).solve(mesh=MESH)
    assert solution.status is not Status.CONVERGED
    return solution


def test_impossible_mission_is_infeasible_by_the_elastic_program(failed):
    diagnosis = diagnose(failed)
    assert diagnosis.is_infeasible
    assert diagnosis.least_violation > 0.1


def test_one_limit_alone_gives_way_by_its_closed_form(failed):
    # The control is sampled at the points of a mesh: its bound exceeds 4 a little.
    (relaxation,) = diagnose(failed, families=frozenset({"strongest"})).relaxations
    assert relaxation.name == "strongest"
    assert relaxation.unit == "m/s**2"
    assert relaxation.limit + relaxation.amount == pytest.approx(4.0, rel=0.03)


def test_residuals_name_equation_element_time_and_unit(failed):
    residuals = diagnose(failed).residuals
    assert 1 <= len(residuals) <= 10
    worst = residuals[0]
    assert worst.name in {"motion", "force"}
    assert 0.0 <= worst.time <= 1.0
    assert 0 <= worst.element < MESH.elements
    assert worst.unit in {"m/s", "m/s**2"}
    assert str(worst).startswith(f"{worst.name} at ")


def test_possible_mission_gets_a_point_that_keeps_every_limit():
    problem = collocation.compile(car(duration=2.5))
    solution = problem.solve(mesh=MESH)
    diagnosis = diagnose(solution)
    assert not diagnosis.is_infeasible
    assert diagnosis.least_violation < 1e-5
    again = problem.solve(mesh=MESH, guess=diagnosis.feasible_point)
    assert again.status is Status.CONVERGED
    assert again.objective == pytest.approx(solution.objective, rel=1e-7)


def test_active_limits_are_listed_with_their_value():
    # Just above the shortest time nearly the whole flight is at the limit.
    solution = collocation.compile(car(duration=2.05)).solve(mesh=MESH)
    active = {limit.name: limit for limit in diagnose(solution).active}
    assert abs(active["strongest"].limit) == pytest.approx(1.0)
    assert 0.5 < active["strongest"].share <= 1.0


def test_both_sides_of_an_equality_are_one_active_limit():
    model = car(duration=1.0)
    for variable in (model.x, model.v):
        variable[1.0].unfix()
    model.link = Constraint(expr=model.x[1.0] - model.x[0.0] == 1.0)
    model.rest = Constraint(expr=model.v[1.0] - model.v[0.0] == 0.0)
    active = {limit.name: limit for limit in diagnose(solve(model, mesh=MESH)).active}
    assert active["rest"].share == 1.0
    assert all(limit.share <= 1.0 for limit in active.values())


def test_family_without_limits_is_refused(failed):
    with pytest.raises(TranscriptionError, match="weakest: has no limits that could be relaxed"):
        diagnose(failed, families=frozenset({"weakest"}))
