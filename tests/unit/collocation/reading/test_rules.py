"""Rules say the same wherever they keep the model: in a closure, a helper, a default, a list."""

from functools import partial

import pytest
from pyomo.dae import ContinuousSet, DerivativeVar, Integral
from pyomo.environ import ConcreteModel, Constraint, Expression, Objective, Var

from pyomo_quad.collocation import TranscriptionError, solve
from pyomo_quad.collocation.errors import raised

CAP = 1.2


def integrator():
    """Move x from 0 to 1 with u as near t as a cap allows; the rules read their own block."""
    m = ConcreteModel()
    m.t = ContinuousSet(bounds=(0, 1))
    m.x, m.u = Var(m.t, initialize=0.0), Var(m.t, initialize=0.0)
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


def test_a_member_changed_after_its_rule_is_refused():
    m = integrator()
    m.doubled = Expression(m.t, rule=lambda b, t: 2 * b.u[t])
    m.cap = Constraint(m.t, rule=lambda b, t: b.doubled[t] <= 2 * CAP)
    for t in m.t:
        m.doubled[t].set_value(3 * m.u[t])
    with pytest.raises(TranscriptionError, match=r"doubled\[1\]: was changed after its rule"):
        solve(m)
