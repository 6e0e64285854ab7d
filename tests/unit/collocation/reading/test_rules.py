"""Rules say the same wherever they keep the model, and members what was done to them since."""

from functools import partial

import numpy as np
import pytest
from pyomo.dae import ContinuousSet, DerivativeVar, Integral
from pyomo.environ import (
    Any,
    ConcreteModel,
    Constraint,
    Expression,
    NonNegativeReals,
    Objective,
    Var,
)

from pyomo_quad.collocation import TranscriptionError, compile, solve
from pyomo_quad.collocation.errors import raised

CAP = 1.2


def integrator(**control):
    """Move x from 0 to 1 with u as near t as a cap allows; the rules read their own block."""
    m = ConcreteModel()
    m.t = ContinuousSet(bounds=(0, 1))
    m.x, m.u = Var(m.t, initialize=0.0), Var(m.t, initialize=0.0, **control)
    m.dx_dt = DerivativeVar(m.x, wrt=m.t)
    m.x[0].fix(0.0)
    m.x[1].fix(1.0)
    m.ode = Constraint(m.t, rule=lambda b, t: b.dx_dt[t] == b.u[t])
    m.miss = Integral(m.t, wrt=m.t, rule=lambda b, t: (b.u[t] - t) ** 2)
    m.objective = Objective(expr=m.miss)
    return m


def by_block(m):
    return lambda b, t: b.u[t] <= CAP


def by_closure(m):
    return lambda _, t: m.u[t] <= CAP


def by_component(m):
    u = m.u
    return lambda _, t: u[t] <= CAP


def by_default(m):
    return lambda _, t, u=m.u: u[t] <= CAP


def by_helper(m):
    def excess(t):
        return m.u[t] - CAP

    return lambda _, t: excess(t) <= 0


def by_container(m):
    parts = {"controls": [m.u]}
    return lambda _, t: parts["controls"][0][t] <= CAP


def by_partial(m):
    return partial(lambda u, _, t: u[t] <= CAP, m.u)


def by_method(m):
    class Limits:
        def rule(self, b, t):
            return b.u[t] <= CAP

    return Limits().rule


def by_global(m):
    names = {"m": m, "CAP": CAP}
    exec("def rule(_, t):\n    return m.u[t] <= CAP", names)
    return names["rule"]


WAYS = (by_block, by_closure, by_component, by_default, by_helper, by_container, by_partial)


@pytest.fixture(scope="module")
def capped():
    m = integrator()
    m.cap = Constraint(m.t, rule=by_block(m))
    return solve(m).objective


@pytest.mark.parametrize("way", [*WAYS, by_method, by_global])
def test_every_way_to_hold_the_model_holds_the_limit(way, capped):
    m = integrator()
    m.cap = Constraint(m.t, rule=way(m))
    solution = solve(m)
    assert solution.value(m.u, 0.75) == pytest.approx(CAP, abs=1e-6)
    assert solution.objective == pytest.approx(capped, rel=1e-9)


def test_the_users_rules_stay_as_they_are():
    m = integrator()
    m.cap = Constraint(m.t, rule=by_closure(m))
    before = m.cap._rule._fcn
    solve(m)
    assert m.cap._rule._fcn is before


def cap_by_night(t):
    if t not in (0, 1):
        raise RuntimeError("no weather at night")
    return CAP


@pytest.mark.parametrize(
    "declare",
    [
        lambda m, cap: Constraint(m.t, rule=lambda b, t: b.u[t] <= cap(t)),
        lambda m, cap: Expression(m.t, rule=lambda b, t: b.u[t] * cap(t)),
        lambda m, cap: Var(m.t, bounds=lambda b, t: (0, cap(t))),
        lambda m, cap: Var(m.t, initialize=lambda b, t: cap(t)),
    ],
)
def test_what_a_rule_raises_is_told_with_its_type_and_the_rules_name(declare):
    m = integrator()
    m.made = declare(m, cap_by_night)
    told = r"^made: its rule fails at a time .*\(RuntimeError: no weather at night\)"
    with pytest.raises(TranscriptionError, match=told):
        solve(m)


def test_what_an_integrand_raises_is_told_with_its_type_and_name():
    m = integrator()
    m.made = Integral(m.t, wrt=m.t, rule=lambda b, t: b.u[t] * cap_by_night(t))
    m.objective.set_value(m.miss + m.made)
    told = r"^made: its rule fails at a time .*\(RuntimeError: no weather at night\)"
    with pytest.raises(TranscriptionError, match=told):
        solve(m)


def test_an_error_without_a_message_is_told_by_its_type():
    assert raised(AssertionError()) == "AssertionError"
    assert raised(KeyError(0.5)) == "KeyError: 0.5"


def test_a_rule_that_fails_between_declared_times_is_refused():
    m = integrator()
    table = {0: CAP, 1: CAP}
    m.cap = Constraint(m.t, rule=lambda b, t: b.u[t] <= table[t])
    with pytest.raises(TranscriptionError, match=r"cap: its rule fails at a time that the model"):
        solve(m)


@pytest.mark.parametrize("changed", [(0, 1), (0,), (1,)])
def test_a_member_changed_after_its_rule_is_refused(changed):
    m = integrator()
    m.doubled = Expression(m.t, rule=lambda b, t: 2 * b.u[t])
    m.cap = Constraint(m.t, rule=lambda b, t: b.doubled[t] <= 2 * CAP)
    for t in changed:
        m.doubled[t].set_value(3 * m.u[t])
    told = rf"doubled\[{changed[0]}\]: was changed after its rule"
    with pytest.raises(TranscriptionError, match=told):
        solve(m)


# Members changed since


def by_each_member(m):
    for t in m.t:
        m.u[t].setub(CAP)


def by_slice(m):
    m.u[:].setub(CAP)


def by_rate(m):
    for t in m.t:
        m.dx_dt[t].setub(CAP)


@pytest.mark.parametrize("change", [by_each_member, by_slice, by_rate, lambda m: m.u.setub(CAP)])
@pytest.mark.parametrize("declared", [None, (None, 9.0), lambda _m, t: (None, 9.0 - t)])
def test_bounds_given_to_every_member_hold_all_the_time(change, declared, capped):
    m = integrator(bounds=declared)
    change(m)
    assert solve(m).objective == pytest.approx(capped, rel=1e-6)


def test_bounds_of_a_derivative_hold_all_the_time(capped):
    m = integrator()
    m.y = Var(m.t)
    m.dy_dt = DerivativeVar(m.y, wrt=m.t, bounds=lambda _m, _t: (None, CAP))
    m.again = Constraint(m.t, rule=lambda m, t: m.dy_dt[t] == m.u[t])
    m.y[0].fix(0)
    assert solve(m).objective == pytest.approx(capped, rel=1e-6)


def test_a_domain_holds_beside_bounds_by_a_rule():
    # What u falls short of t - 1/2 by while that is below 0: the third of 1/8.
    m = integrator(domain=NonNegativeReals, bounds=lambda _m, t: (None, 9 + t))
    m.x[1].unfix()
    m.late = Integral(m.t, wrt=m.t, rule=lambda m, t: (m.u[t] - t + 0.5) ** 2)
    m.objective.set_value(m.late)
    assert solve(m).objective == pytest.approx(1 / 24, rel=1e-5)


def test_bounds_of_a_state_with_a_fixed_end_hold_all_the_time():
    m = integrator()
    m.x[1].unfix()
    m.x.setub(0.2)
    found = solve(m)
    assert found.value(m.x, np.linspace(0, 1, 101)).max() == pytest.approx(0.2, abs=1e-6)


def box(m, ends):
    for end in ends:
        m.x[end].unfix()
        m.x[end].setlb(0.7)


def test_bounds_that_may_be_meant_for_the_ends_alone_are_refused():
    m = integrator()
    box(m, (0, 1))
    with pytest.raises(
        TranscriptionError, match=r"^x: its bounds were changed at every declared t"
    ):
        solve(m)
    m = integrator()
    for t in m.t:
        m.u[t].setub(CAP + t)
    with pytest.raises(TranscriptionError, match=r"^u: its bounds were changed .* bounds= for all"):
        solve(m)


def test_bounds_of_one_end_stay_there():
    m = integrator()
    box(m, (0,))
    found = solve(m)  # From 0.7 on, u = t - 0.2.
    assert found.value(m.x, 0.0) == pytest.approx(0.7, abs=1e-6)
    assert found.objective == pytest.approx(0.04, rel=1e-5)


def test_what_is_deactivated_at_every_declared_time_is_not_imposed(capped):
    m = integrator()
    m.cap = Constraint(m.t, rule=by_block(m))
    m.cap[0].deactivate()
    assert solve(m).objective == pytest.approx(capped, rel=1e-9)
    m.cap[1].deactivate()
    assert solve(m).objective == pytest.approx(0.25, rel=1e-9)


def decay():
    m = ConcreteModel()
    m.t = ContinuousSet(bounds=(0, 1))
    m.x, m.u = Var(m.t, initialize=1.0), Var(m.t, initialize=0.0)
    m.dx_dt = DerivativeVar(m.x, wrt=m.t)
    m.ode = Constraint(m.t, rule=lambda m, t: m.dx_dt[t] == m.u[t] - m.x[t])
    return m


def test_a_rate_is_fixed_at_the_start():
    m = decay()
    m.u.fix(0.5)
    m.dx_dt[0].fix(-1.5)
    assert solve(m).value(m.x, 1.0) == pytest.approx(0.5 + 1.5 * np.exp(-1), rel=1e-6)


def test_a_control_fixed_to_other_numbers_at_other_times_is_refused():
    m = decay()
    m.x[0].fix(1)
    m.u.fix(0.5)
    problem = compile(m)
    assert problem.solve().value(m.x, 1.0) == pytest.approx(0.5 + 0.5 * np.exp(-1), rel=1e-6)
    m.u[1].fix(0.7)
    with pytest.raises(TranscriptionError, match=r"^u: is fixed to different values at different"):
        problem.solve()


@pytest.mark.parametrize("kind", [lambda m: Constraint(m.t), lambda _: Constraint(Any)])
def test_members_without_a_rule_that_are_alike_are_refused(kind):
    m = integrator()
    m.cap = kind(m)
    for t in m.t:
        m.cap[t] = m.u[t] <= CAP
    with pytest.raises(TranscriptionError, match=r"^cap: is the same at every declared time, but"):
        solve(m)


def test_a_variable_at_a_single_time_needs_no_equation():
    m = integrator()
    m.price = Var(m.t, bounds=(0.5, 2))
    m.objective.set_value(m.miss + m.price[1] ** 2)
    found = solve(m)
    assert found.objective == pytest.approx(0.5, rel=1e-5)
    assert m.price[1].value == pytest.approx(0.5, rel=1e-5)
