"""Suffixes `dual`, `rc` and `costate` against closed forms and against solves beside them."""

import numpy as np
import pytest
from pyomo.dae import ContinuousSet, DerivativeVar, Integral
from pyomo.environ import (
    ConcreteModel,
    Constraint,
    Objective,
    Param,
    SolverFactory,
    Suffix,
    Var,
    maximize,
)

from pyomo_quad.collocation import solve
from tests.problems import bryson_denham, double_integrator


def with_suffixes(m):
    for name in ("dual", "rc", "costate"):
        setattr(m, name, Suffix(direction=Suffix.IMPORT))
    return m


def plant(*, sense=1, supply=6.0, cap=3.0, floor=0.5):
    """Two products, a supply that binds, a cap written as a constraint, and a bound."""
    m = with_suffixes(ConcreteModel())
    m.supply, m.cap, m.floor = (Param(initialize=n, mutable=True) for n in (supply, cap, floor))
    m.x, m.y, m.z = Var(initialize=1), Var(initialize=1), Var(initialize=1)
    m.z.setlb(m.floor)
    m.used = Constraint(expr=m.x**2 + m.y + m.z == m.supply)
    m.most = Constraint(expr=2 * m.y <= m.cap)
    gain = 3 * m.x + 8 * m.y + 0.1 * m.z
    if sense == maximize:
        m.gain = Objective(expr=gain, sense=maximize)
    else:
        m.loss = Objective(expr=-gain)
    return m


@pytest.mark.parametrize("sense", [1, maximize])
def test_they_are_the_slopes_of_the_objective_as_declared(sense):
    m = plant(sense=sense)
    SolverFactory("pyomo_quad").solve(m)
    for key, item, suffix in (
        ("supply", m.used, m.dual),
        ("cap", m.most, m.dual),
        ("floor", m.z, m.rc),
    ):
        step, held = 1e-3, {"supply": 6.0, "cap": 3.0, "floor": 0.5}[key]
        moved = [solve(plant(sense=sense, **{key: held + s})).objective for s in (step, -step)]
        assert suffix[item] == pytest.approx((moved[0] - moved[1]) / (2 * step), rel=1e-4)
        assert abs(suffix[item]) > 0.1
    assert m.rc[m.x] == pytest.approx(0.0, abs=1e-8)


def test_over_time_they_are_densities_and_those_of_dynamics_are_costates():
    m = with_suffixes(double_integrator.build())
    solution = solve(m, tolerance=1e-8)
    known = double_integrator.costate(np.array([0.0, 1.0]))
    for state in ("x", "v"):
        for k, t in enumerate((0, 1)):
            assert m.costate[m.find_component(state)[t]] == pytest.approx(known[state][k], abs=1e-7)
    # Of v' = u, what a push on v would change.
    assert m.dual[m.force[0]] == pytest.approx(solution.costate("v", 0.0), rel=1e-9)


def test_a_limit_that_is_a_constraint_has_a_dual_and_a_bound_has_a_reduced_cost():
    def filling(*, cap=None, bound=None):
        m = with_suffixes(ConcreteModel())
        m.t = ContinuousSet(bounds=(0, 4))
        m.x, m.u = Var(m.t), Var(m.t, bounds=(0, bound))
        m.dx_dt = DerivativeVar(m.x, wrt=m.t)
        m.fill = Constraint(m.t, rule=lambda m, t: m.dx_dt[t] == m.u[t])
        if cap is not None:
            m.cap = Constraint(m.t, rule=lambda m, t: -2 * m.u[t] >= -2 * cap)
        m.x[0].fix(1)
        m.price = Integral(m.t, wrt=m.t, rule=lambda m, t: (1 + t) * m.u[t])
        m.gain = Objective(expr=10 * m.x[4] - m.price, sense=maximize)
        return m

    # Filling all the time earns 10 - (1 + t) per unit; -2 u >= -2 cap counts it half, reversed.
    m = filling(cap=0.5)
    solve(m, tolerance=1e-7)
    assert [m.dual[m.cap[t]] for t in (0, 4)] == pytest.approx([-4.5, -2.5], rel=1e-5)
    m = filling(bound=0.5)
    solve(m, tolerance=1e-7)
    assert [m.rc[m.u[t]] for t in (0, 4)] == pytest.approx([9.0, 5.0], rel=1e-5)
    assert m.costate[m.x[0]] == pytest.approx(10.0, rel=1e-6)


def test_a_model_without_suffixes_gets_none():
    m = bryson_denham.build()
    solve(m)
    assert not list(m.component_objects(Suffix))


def test_in_phases_of_free_length_they_are_per_unit_of_time_found():
    m = with_suffixes(ConcreteModel())
    m.t = ContinuousSet(initialize=[0, 1, 2])
    m.x, m.u = Var(m.t), Var(m.t)
    m.first, m.last = Var(bounds=(0.2, 5)), Var(bounds=(0.5, 9))
    m.dx_dt = DerivativeVar(m.x, wrt=m.t)
    m.law = Constraint(m.t, rule=lambda m, t: m.dx_dt[t] == m.u[t])
    m.split = Constraint(expr=m.first == m.last / 4)
    m.x[0].fix(0)
    m.x[2].fix(3)
    m.effort = Integral(m.t, wrt=m.t, rule=lambda m, t: m.u[t] ** 2)
    m.cost = Objective(expr=m.effort + m.last)
    solve(m, times={1: m.first, 2: m.last})
    # u = 1 all the time, for 3; a push on x saves 2 u of effort a unit.
    assert m.last.value == pytest.approx(3.0, rel=1e-6)
    assert [m.dual[m.law[t]] for t in (0, 1, 2)] == pytest.approx([-2.0] * 3, rel=1e-5)
