"""A rule's time means what it says: compared, looked up, or put into any function of a number.

For x' = u f(t) from 0 to 1 with the least integral of u^2/2 the optimum is 1 / (2 int f^2 dt),
whatever f is.
"""

import math
import pickle

import numpy as np
import pytest
from pyomo.dae import ContinuousSet, DerivativeVar, Integral
from pyomo.environ import (
    Block,
    ConcreteModel,
    Constraint,
    Expression,
    Objective,
    Param,
    Set,
    Suffix,
    Var,
    value,
)
from scipy.integrate import quad
from scipy.optimize import minimize_scalar

from pyomo_quad.collocation import Mesh, TranscriptionError, compile, solve
from pyomo_quad.collocation.reading import schedules
from pyomo_quad.flight.verification import fly_controls

SWITCHED = 1 / (2 * (0.5 * 1 + 0.5 * 4))


def switch(t):
    return 1 if t < 0.5 else 2


def mover(rate, times=(0, 1), integrand=lambda m, t: m.u[t] ** 2 / 2, **control):
    """Move x from 0 to 1 by dx/dt = rate(m, t)."""
    m = ConcreteModel()
    m.t = ContinuousSet(initialize=times)
    m.x, m.u = Var(m.t, initialize=0.0), Var(m.t, initialize=0.0, **control)
    m.dx = DerivativeVar(m.x, wrt=m.t)
    m.x[times[0]].fix(0)
    m.x[times[-1]].fix(1)
    m.motion = Constraint(m.t, rule=lambda m, t: m.dx[t] == rate(m, t))
    m.effort = Integral(m.t, rule=integrand)
    m.cost = Objective(expr=m.effort)
    return m


def plain(m, t):
    return m.u[t]


def scaled(factor, times=(0, 1)):
    return mover(lambda m, t: m.u[t] * factor(t), times)


@pytest.mark.parametrize("times", [(0, 0.5, 1), (0, 1)])
@pytest.mark.parametrize("factor", [switch, lambda t: 1 if t <= 0.5 else 2])
def test_a_switch_is_exact_on_either_side_and_declared_or_not(factor, times):
    solution = solve(scaled(factor, times))
    assert solution.objective == pytest.approx(SWITCHED, rel=1e-12)
    # On the first mesh already: an element that ends at the switch holds each side.
    assert solution.history[0].error < 1e-9


STEPS = {0: 1.0, 1: 2.0, 2: 0.5, 3: 3.0}
FACTORS = {
    "math": (lambda t: math.sin(6 * t), ()),
    "numpy": (lambda t: np.exp(-t), ()),
    "polynomial": (lambda t: np.polyval([1.0, 0.0, 1.0], t), ()),
    "interpolation": (lambda t: np.interp(t, [0, 0.3, 0.6, 1], [1, 2, 0.5, 4]), (0.3, 0.6)),
    "absolute": (lambda t: abs(t - 0.3), (0.3,)),
    "larger": (lambda t: max(t, 0.5), (0.5,)),
    "smaller": (lambda t: min(t - 0.4, 0.2) + 1, (0.6,)),
    "table": (lambda t: STEPS[min(int(4 * t), 3)], (0.25, 0.5, 0.75)),
    "floor": (lambda t: 1 + math.floor(5 * t) / 2, (0.2, 0.4, 0.6, 0.8)),
    "remainder": (lambda t: 1 + (4 * t) % 1, (0.25, 0.5, 0.75)),
    "rounded": (lambda t: 1 + round(4 * t), (0.125, 0.375, 0.625, 0.875)),
    "pulse": (lambda t: 5.0 if 0.41 < t < 0.43 else 1.0, (0.41, 0.43)),
    "nothing first": (lambda t: 0 if t < 0.3 else t, (0.3,)),
    "truth": (lambda t: (1 if t else 2) + (t > 0.7), (0.7,)),
    "array": (lambda t: float(np.where(np.array([t]) > 0.2, 3, 1)[0]), (0.2,)),
}


@pytest.mark.parametrize("name", FACTORS)
def test_any_function_of_time(name):
    factor, kinks = FACTORS[name]
    total = quad(lambda t: factor(t) ** 2, 0, 1, points=kinks or None, epsabs=1e-12)[0]
    solution = solve(scaled(factor), tolerance=1e-8)
    assert solution.is_converged
    assert solution.objective == pytest.approx(1 / (2 * total), rel=1e-10)


@pytest.mark.parametrize("name", ["numpy", "interpolation", "absolute", "table", "truth"])
def test_a_pickled_problem_keeps_what_rules_said_over_time(name):
    factor, kinks = FACTORS[name]
    total = quad(lambda t: factor(t) ** 2, 0, 1, points=kinks or None, epsabs=1e-12)[0]
    problem = compile(scaled(factor))
    restored = pickle.loads(pickle.dumps(problem))
    again = restored.solve(tolerance=1e-8)
    assert again.is_converged
    assert again.objective == pytest.approx(1 / (2 * total), rel=1e-10)
    if name not in ("numpy", "absolute"):  # which are formulas of time, and go on
        with pytest.raises(TranscriptionError, match=r"motion: is known over \[0, 1\] only, since"):
            restored.solve(horizon=(0, 2))


def test_a_pickled_problem_knows_a_rule_as_far_as_it_was_solved():
    problem = compile(scaled(switch))
    long = problem.solve(horizon=(0, 2))
    restored = pickle.loads(pickle.dumps(problem)).solve(horizon=(0, 2))
    assert restored.objective == pytest.approx(long.objective, rel=1e-12)


def test_a_rule_without_pattern_is_refused_when_a_pickled_problem_needs_it(monkeypatch):
    monkeypatch.setattr(schedules, "_MOST_PIECES", 20)
    problem = compile(scaled(lambda t: 1 + abs(math.sin(1000 * t))))
    restored = pickle.loads(pickle.dumps(problem))
    with pytest.raises(TranscriptionError, match="motion: its rule is too rough to be pickled; c"):
        restored.solve()


def test_a_switch_under_a_free_end_is_pickled():
    m = mover(lambda m, t: m.u[t] * (1 if t < 0.5 else 2), times=(0, 0.5, 1))
    m.cost.deactivate()
    m.T = Var(initialize=1.0, bounds=(0.1, 10))
    m.both = Objective(expr=m.effort + m.T)
    problem = compile(m, final_time=m.T)
    expected = problem.solve()
    restored = pickle.loads(pickle.dumps(expected))
    assert restored.problem.solve().objective == pytest.approx(expected.objective, rel=1e-9)
    # With effort E / T for the time T, the best T is sqrt(E).
    assert expected.objective == pytest.approx(2 * math.sqrt(SWITCHED), rel=1e-6)


def test_indexed_rules_switch_each_at_its_own_time():
    m = ConcreteModel()
    m.t, m.i, m.b = ContinuousSet(bounds=(0, 1)), Set(initialize=(1, 2)), Block()
    m.gain = Param(initialize=1.0, mutable=True)
    m.x, m.b.u = Var(m.i, m.t, initialize=0.0), Var(m.t, m.i, initialize=0.0)
    m.dx = DerivativeVar(m.x, wrt=m.t)

    @m.b.Constraint(m.i, m.t)
    def motion(b, i, t):
        return b.parent_block().dx[i, t] == m.gain * i * b.u[t, i] * (1 if t < 0.5 / i else 2)

    for i in m.i:
        m.x[i, 0].fix(0)
        m.x[i, 1].fix(1)
    m.efforts = Integral(
        m.i, m.t, wrt=m.t, rule=lambda m, i, t: m.b.u[t, i] ** 2 / 2 * (i if t < 0.6 else i + 1)
    )
    m.cost = Objective(expr=m.efforts[1] + m.efforts[2])

    def optimum(i):
        def density(t):
            return (i * (1 if t < 0.5 / i else 2)) ** 2 / (i if t < 0.6 else i + 1)

        return 1 / (2 * quad(density, 0, 1, points=[0.5 / i, 0.6], epsabs=1e-12)[0])

    problem = compile(m)
    for gain in (1.0, 2.0):
        solution = problem.solve(parameters={"gain": gain})
        assert solution.objective == pytest.approx((optimum(1) + optimum(2)) / gain**2, rel=1e-10)


def test_the_value_of_time():
    assert solve(scaled(lambda t: value(t) + 1)).objective == pytest.approx(3 / 14, rel=1e-10)


def test_other_equations_at_other_times():
    m = mover(plain)
    m.del_component(m.motion)
    m.motion = Constraint(
        m.t,
        rule=lambda m, t: m.dx[t] == m.u[t] if t < 0.5 else m.dx[t] / 2 - m.u[t] == 0 * m.x[t],
    )
    assert solve(m).objective == pytest.approx(SWITCHED, rel=1e-12)


def test_an_expression_and_an_integrand_switch():
    m = mover(plain)
    m.del_component(m.motion)
    m.thrust = Expression(m.t, rule=lambda m, t: m.u[t] * switch(t))
    m.motion = Constraint(m.t, rule=lambda m, t: m.dx[t] == m.thrust[t])
    solution = solve(m)
    assert solution.objective == pytest.approx(SWITCHED, rel=1e-12)
    assert solution.value(m.thrust, [0.2, 0.49, 0.51]) == pytest.approx([0.4, 0.4, 1.6])
    assert solution.costate(m.x, [0.2, 0.8]) == pytest.approx([-0.4, -0.4])
    dear = mover(plain, integrand=lambda m, t: m.u[t] ** 2 / 2 * (1 if t < 0.5 else 4))
    assert solve(dear).objective == pytest.approx(0.5 / (0.5 + 0.5 / 4), rel=1e-12)


@pytest.mark.parametrize(
    "rule",
    [
        lambda m, t: m.u[t] <= (0.8 if t < 0.5 else 3),
        lambda m, t: m.u[t] <= 0.8 if t < 0.5 else Constraint.Skip,
        lambda m, t: Constraint.Feasible if t >= 0.5 else m.u[t] + 0 * m.x[t] <= 0.8,
        lambda m, t: (None, m.u[t], 0.8) if t < 0.5 else (-5, m.u[t], 3),
    ],
)
def test_a_limit_for_a_part_of_the_time(rule):
    # u = 0.8, then 1.2.
    m = mover(plain)
    m.limit = Constraint(m.t, rule=rule)
    assert solve(m, tolerance=1e-8).objective == pytest.approx(0.52, rel=1e-8)


def test_a_limit_between_the_declared_times_only():
    m = mover(plain)
    m.limit = Constraint(
        m.t, rule=lambda m, t: m.u[t] <= 0.8 if 0.5 < t < 0.95 else Constraint.Skip
    )
    rest = (1 - 0.45 * 0.8) ** 2 / 0.55
    assert solve(m, tolerance=1e-8).objective == pytest.approx(0.5 * (0.45 * 0.64 + rest), rel=1e-8)


@pytest.mark.parametrize(
    ("rule", "halfway"),
    [
        (lambda m, t: m.x[t] >= (0 if t < 0.5 else 0.8), 0.8),
        (lambda m, t: m.x[t] >= 0.8 if t >= 0.5 else Constraint.Skip, 0.8),
        (lambda m, t: m.x[t] <= (0.2 if t <= 0.5 else 3), 0.2),
    ],
)
def test_a_limit_on_a_state_holds_from_the_very_time(rule, halfway):
    m = mover(plain)
    m.limit = Constraint(m.t, rule=rule)
    solution = solve(m, tolerance=1e-8)
    assert solution.objective == pytest.approx(0.5 * (0.64 + 0.04) / 0.5, rel=1e-9)
    # At a constant speed on either side of it.
    assert solution.value(m.x, [0.25, 0.5, 0.75]) == pytest.approx(
        [halfway / 2, halfway, (1 + halfway) / 2], rel=1e-6
    )


def test_bounds_by_a_rule_over_time():
    m = mover(plain, bounds=lambda _m, t: (None, 0.8 if t < 0.5 else 3))
    assert solve(m, tolerance=1e-8).objective == pytest.approx(0.52, rel=1e-8)


@pytest.mark.parametrize("is_mutable", [True, False])
@pytest.mark.parametrize("keyword", ["initialize", "default"])
def test_a_parameter_by_a_rule_that_switches(is_mutable, keyword):
    m = mover(plain)
    m.del_component(m.motion)
    m.p = Param(m.t, mutable=is_mutable, **{keyword: lambda _m, t: switch(t)})
    m.motion = Constraint(m.t, rule=lambda m, t: m.dx[t] == m.u[t] * m.p[t])
    assert solve(m).objective == pytest.approx(SWITCHED, rel=1e-12)


def test_a_parameter_over_time_takes_a_number_or_a_function_for_a_solve():
    m = mover(plain)
    m.p = Param(m.t, initialize=lambda _m, t: 1 + t, mutable=True)
    m.del_component(m.motion)
    m.motion = Constraint(m.t, rule=lambda m, t: m.dx[t] == m.u[t] * m.p[t])
    problem = compile(m)
    assert problem.solve(parameters={"p": 2}).objective == pytest.approx(1 / 8, rel=1e-10)
    switched = problem.solve(parameters={"p": switch})
    assert switched.objective == pytest.approx(SWITCHED, rel=1e-12)


def test_a_payload_dropped_on_the_way():
    # v' = u / mass, rest to rest over one unit: b' W^-1 b / 2 with the Gramian W of the end state.
    def mass(t):
        return 3.0 if t < 0.4 else 1.0

    m = mover(plain, times=(0, 0.4, 1))
    m.v = Var(m.t, initialize=0.0)
    m.dv = DerivativeVar(m.v, wrt=m.t)
    m.del_component(m.motion)
    m.motion = Constraint(m.t, rule=lambda m, t: m.dx[t] == m.v[t])
    m.force = Constraint(m.t, rule=lambda m, t: mass(t) * m.dv[t] == m.u[t])
    m.v[0].fix(0)
    m.v[1].fix(0)

    def moment(power):
        return quad(lambda t: (1 - t) ** power / mass(t) ** 2, 0, 1, points=[0.4], epsabs=1e-13)[0]

    gramian = np.array([[moment(2), moment(1)], [moment(1), moment(0)]])
    solution = solve(m, tolerance=1e-8)
    assert solution.objective == pytest.approx(0.5 * np.linalg.inv(gramian)[0, 0], rel=1e-9)


@pytest.mark.parametrize("factor", [switch, lambda t: math.sin(9 * t), lambda t: 2 - (t < 0.37)])
def test_a_flight_sees_the_same_time(factor):
    problem = compile(scaled(factor))
    solution = problem.solve(tolerance=1e-9)
    dynamics = problem.dynamics()
    for t in (0.123456, 0.49, 0.51, 0.9):
        rate = dynamics.rates(t, np.zeros(1), np.ones(1))
        assert rate == pytest.approx([factor(t)], rel=1e-13)
    controls = solution.trajectory.algebraics
    flown = fly_controls(dynamics, solution.mesh, controls, np.zeros(1), (0.0, 1.0))
    assert flown.states[-1, 0] == pytest.approx(1.0, abs=1e-9)
    assert flown.energy[-1] == pytest.approx(solution.objective, rel=1e-9)


def test_another_horizon_leaves_a_switch_at_its_time():
    # On [0, 2] the factor is 1 for 0.5 and 2 for 1.5.
    problem = compile(scaled(switch, (0, 0.5, 1)))
    longer = problem.solve(horizon=(0.0, 2.0))
    assert longer.objective == pytest.approx(1 / (2 * (0.5 + 1.5 * 4)), rel=1e-12)


def test_the_ends_of_the_horizon_have_no_length():
    assert solve(scaled(lambda t: 1 if t < 1 else 2)).objective == pytest.approx(0.5, rel=1e-12)
    assert solve(scaled(lambda t: 1 if t <= 0 else 2)).objective == pytest.approx(0.125, rel=1e-12)


def with_free_end(factor, times=(0, 0.5, 1), rule=None):
    """Minimise the end time and int u^2/2."""
    m = mover(lambda m, t: m.u[t], times)
    m.end = Var(bounds=(0.1, 10), initialize=1.0)
    m.p = Param(m.t, initialize=rule or (lambda _m, _t: 1.0), mutable=True)
    m.del_component(m.motion)
    m.motion = Constraint(m.t, rule=lambda m, t: m.dx[t] == m.u[t] * factor(m, t))
    m.cost.set_value(m.effort + m.end)
    return m


@pytest.mark.parametrize(
    "m",
    [
        with_free_end(lambda _m, t: switch(t)),
        with_free_end(lambda m, t: m.p[t], rule=lambda _m, t: switch(t)),
    ],
)
def test_a_free_end_stretches_the_declared_times(m):
    # int f^2 = 2.5 T and T + 1 / (5 T) is least at T = 1 / sqrt(5).
    solution = solve(m, final_time=m.end, tolerance=1e-8)
    assert solution.objective == pytest.approx(2 / math.sqrt(5), rel=1e-10)


def test_a_rule_is_called_once_for_all_times_that_are_the_same_to_it():
    calls = []

    def say(t):
        calls.append(t)
        return schedules.Statement(parts=(switch(t),))

    read = schedules.Schedule("p", say, (0.0, 0.5, 1.0), lambda t: 0.25 if t < 0.5 else 0.75)
    assert [read.row(t)[-1] for t in (0.1, 0.2, 0.6, 0.9)] == [1.0, 1.0, 2.0, 2.0]
    assert sorted(set(calls)) == [0.25, 0.75]


@pytest.mark.parametrize(
    "m",
    [
        with_free_end(lambda _m, t: 1 + t),
        with_free_end(lambda m, t: m.p[t], rule=lambda _m, t: 1 + t),
    ],
)
def test_time_has_a_derivative_where_the_end_is_free(m):
    def total(end):
        return end + 3 / (2 * ((1 + end) ** 3 - 1))

    least = minimize_scalar(total, bounds=(0.1, 5), method="bounded", options={"xatol": 1e-10})
    solution = solve(m, final_time=m.end, tolerance=1e-8)
    assert solution.objective == pytest.approx(least.fun, rel=1e-9)


@pytest.mark.parametrize(
    "m",
    [
        with_free_end(lambda _m, t: 1 if t < 0.4 else 2),
        with_free_end(lambda _m, t: math.sin(t)),
        with_free_end(lambda m, t: m.p[t], rule=lambda _m, t: math.sin(t)),
    ],
)
def test_a_number_is_refused_where_the_end_is_free(m):
    with pytest.raises(
        TranscriptionError, match="its rule reads its time as a number, which changes"
    ):
        solve(m, final_time=m.end)


def test_a_function_of_time_is_refused_where_the_end_is_free():
    m = with_free_end(lambda m, t: m.p[t], rule=lambda _m, t: 1 + t)
    problem = compile(m, final_time=m.end)
    with pytest.raises(TranscriptionError, match="a function of time is not allowed if times are"):
        problem.solve(parameters={"p": lambda t: t})


def test_what_was_not_seen_before_is_refused():
    m = scaled(lambda t: 1 if abs(t - 0.4444) > 1e-5 else 2)
    breakpoints = (0.0, 0.4444, 1.0)
    with pytest.raises(
        TranscriptionError, match=r"motion: its rule returns an expression at time 0\.4444 that it"
    ):
        solve(m, mesh=Mesh(breakpoints=breakpoints, degrees=(4, 4)))


def test_too_many_forms_are_refused():
    m = mover(lambda m, t: sum(m.u[t] for _ in range(1 + int(40 * t))))
    with pytest.raises(
        TranscriptionError, match="motion: its rule returns a different expression at every"
    ):
        solve(m)


def test_a_limit_that_cannot_be_met_later_is_refused():
    m = mover(plain)
    m.limit = Constraint(
        m.t,
        rule=lambda m, t: Constraint.Infeasible if 0.6 < t < 0.9 else m.u[t] <= 3,
    )
    with pytest.raises(
        TranscriptionError, match=r"limit: its rule returned Constraint\.Infeasible"
    ):
        solve(m)


def test_dynamics_for_a_part_of_the_time_are_refused():
    m = mover(plain)
    m.del_component(m.motion)
    m.motion = Constraint(m.t, rule=lambda m, t: m.dx[t] == m.u[t] if t < 0.5 else Constraint.Skip)
    with pytest.raises(
        TranscriptionError, match="dx: no equation over time contains this derivative"
    ):
        solve(m)


@pytest.mark.parametrize(
    ("initial", "message"),
    [
        ({0: 1, 1: 2}, "p: its rule fails at time .*needs a value at any time"),
        (lambda m, t: 2 * m.q[t], "p: its rule fails at time .*needs a value at any time"),
    ],
)
def test_a_parameter_without_a_value_between_declared_times_is_refused(initial, message):
    m = mover(plain)
    m.q = Param(m.t, initialize=lambda _m, t: 1 + t)
    m.p = Param(m.t, initialize=initial)
    m.limit = Constraint(m.t, rule=lambda m, t: m.u[t] <= 10 + m.p[t])
    with pytest.raises(TranscriptionError, match=message):
        solve(m)


def test_a_parameter_changed_after_its_rule_is_refused():
    m = mover(plain)
    m.p = Param(m.t, initialize=lambda _m, t: 1 + t, mutable=True)
    m.limit = Constraint(m.t, rule=lambda m, t: m.u[t] <= m.p[t])
    m.p[1] = 7
    with pytest.raises(TranscriptionError, match="p: was changed after its rule made it; give"):
        solve(m)


def test_a_list_of_the_declared_times_is_refused():
    m = mover(plain)
    m.limit = Constraint(m.t, rule=lambda m, t: m.u[t] <= [3, 4][int(t == 1)] + (0, 1)[t])
    with pytest.raises(TranscriptionError, match="limit: its rule fails at a time that the model"):
        solve(m)


def through_the_middle(rule):
    """Rest to rest over 1 m in 1 s for the least effort, with something asked for half way."""
    m = ConcreteModel()
    m.t = ContinuousSet(initialize=[0, 0.5, 1])
    m.x, m.v, m.u = Var(m.t), Var(m.t), Var(m.t)
    m.dx_dt, m.dv_dt = DerivativeVar(m.x, wrt=m.t), DerivativeVar(m.v, wrt=m.t)
    m.motion = Constraint(m.t, rule=lambda m, t: m.dx_dt[t] == m.v[t])
    m.force = Constraint(m.t, rule=lambda m, t: m.dv_dt[t] == m.u[t])
    for state, start, end in ((m.x, 0, 1), (m.v, 0, 0)):
        state[0].fix(start)
        state[1].fix(end)
    m.asked = Constraint(m.t, rule=rule)
    m.effort = Integral(m.t, rule=lambda m, t: m.u[t] ** 2 / 2)
    m.cost = Objective(expr=m.effort)
    return m


@pytest.mark.parametrize(
    ("rule", "off"),
    [
        (lambda m, t: m.x[t] == 0.7 if t == 0.5 else m.x[t] <= 5, 0.2),
        (lambda m, t: m.x[t] == 0.7 if t == 0.5 else Constraint.Skip, 0.2),
        (lambda m, t: m.x[t] <= 0.4 if t in {0.25, 0.5} else m.x[t] <= 5, 0.1),
        (lambda m, t: m.x[t] <= 0.4 if t == 0.5 else m.x[t] <= 5 + t, 0.1),
        (lambda m, t: m.x[t] <= (3 if t <= 0.5 else 4), 0.0),
        (lambda m, t: m.x[t] <= (3 if t < 0.5 else 4), 0.0),
        (lambda m, t: m.x[t] <= 5 + t, 0.0),
    ],
)
def test_what_a_rule_asks_for_at_one_declared_time_is_kept(rule, off):
    # A way point that is `off` the middle costs 96 off^2 more than the 6 of the free flight.
    solution = solve(through_the_middle(rule), tolerance=1e-7)
    assert solution.objective == pytest.approx(6 + 96 * off**2, rel=1e-6)
    asked = [c.name for c in solution.problem.compiled.declared.conditions]
    asked += [b.name for b in solution.problem.compiled.simple_point_bounds]
    assert asked == (["asked[0.5]"] if off else [])
    assert solution.warnings == ()


# The limit, its form, and how far x' = u can get in two seconds under it.
TIMED_LIMITS = {
    "a state": (lambda m, t: m.x[t] <= t, 2.0),
    "a range of a state": (lambda m, t: (-t - 1, m.x[t], t), 2.0),
    "a number and the time": (lambda m, t: (-5, m.x[t], t), 2.0),
    "a power of time": (lambda m, t: m.x[t] <= 2 * t**2, 8.0),
    "a control": (lambda m, t: m.u[t] <= 20 - t, 38.0),
    "the other way round": (lambda m, t: 20 - t >= m.u[t], 38.0),
}


def pushed(limit, end, **bounds):
    m = ConcreteModel()
    m.t = ContinuousSet(bounds=(0, end))
    m.x, m.u = Var(m.t, **bounds), Var(m.t, bounds=(-1, 30))
    m.dx = DerivativeVar(m.x, wrt=m.t)
    m.motion = Constraint(m.t, rule=lambda m, t: m.dx[t] == m.u[t])
    m.limit = Constraint(m.t, rule=limit)
    m.x[0].fix(0)
    return m


@pytest.mark.parametrize("kind", TIMED_LIMITS)
def test_a_limit_may_have_the_time_on_one_side_whether_the_end_is_fixed_or_free(kind):
    limit, distance = TIMED_LIMITS[kind]
    m = pushed(limit, 2)
    m.cost = Objective(expr=-m.x[2])
    assert solve(m).objective == pytest.approx(-distance, rel=2e-6)
    m = pushed(limit, 1)
    m.T = Var(bounds=(0.5, 9), initialize=3)
    m.x[1].fix(distance)
    m.cost = Objective(expr=m.T)
    assert solve(m, final_time=m.T).objective == pytest.approx(2.0, rel=2e-6)


def test_a_bound_by_a_rule_may_hold_a_free_time():
    m = pushed(plain_limit, 1, bounds=lambda m, t: (-1, 2 + t))
    m.T = Var(bounds=(0.5, 9), initialize=3)
    m.goal = Constraint(expr=m.x[1] == 4)
    m.cost = Objective(expr=m.T)
    assert solve(m, final_time=m.T).objective == pytest.approx(2.0, rel=2e-6)


# Limits of the first of two phases.
PHASE_LIMITS = {
    "an upper limit": lambda m, t: m.x[t] <= t if t <= 1 else Constraint.Skip,
    "a lower limit": lambda m, t: -t <= -m.x[t] if t <= 1 else Constraint.Skip,
    "a range": lambda m, t: (-t - 1, m.x[t], t) if t <= 1 else Constraint.Skip,
    "a range that loses a side": lambda m, t: (-t - 1, m.x[t], t if t <= 1 else None),
}


def two_phases(limit, **bounds):
    """A way of 5 at a speed of 3 at most, after a first phase of 1 at least."""
    m = ConcreteModel()
    m.t = ContinuousSet(initialize=[0, 1, 2])
    m.turn, m.T = Var(bounds=(1, 5), initialize=2), Var(bounds=(1, 9), initialize=4)
    m.x, m.u = Var(m.t, **bounds), Var(m.t, bounds=(-1, 3))
    m.dx = DerivativeVar(m.x, wrt=m.t)
    m.motion = Constraint(m.t, rule=lambda m, t: m.dx[t] == m.u[t])
    m.limit = Constraint(m.t, rule=limit)
    m.x[0].fix(0)
    m.goal = Constraint(expr=m.x[2] == 5)
    m.cost = Objective(expr=m.T)
    return compile(m, times={1: m.turn, 2: m.T}).solve(tolerance=1e-7)


@pytest.mark.parametrize("kind", PHASE_LIMITS)
def test_a_limit_with_the_time_on_one_side_may_be_skipped_in_a_free_phase(kind):
    assert two_phases(PHASE_LIMITS[kind]).objective == pytest.approx(1 + 4 / 3, rel=1e-6)


def test_a_bound_with_the_time_in_it_may_be_missing_in_a_free_phase():
    solution = two_phases(plain_limit, bounds=lambda m, t: (-1, t if t <= 1 else None))
    assert solution.objective == pytest.approx(1 + 4 / 3, rel=1e-6)


def plain_limit(m, t):
    return m.u[t] <= 30


def test_prices_of_a_limit_with_time_on_both_its_sides_are_those_of_the_side_that_holds():
    """A limit higher by c everywhere lets x = 2 be reached c earlier: its prices sum to -1."""
    prices = {}
    for kind in ("a state", "a range of a state", "a number and the time"):
        m = pushed(TIMED_LIMITS[kind][0], 1)
        m.T = Var(bounds=(0.5, 9), initialize=3)
        m.x[1].fix(2)
        m.cost = Objective(expr=m.T)
        m.dual = Suffix(direction=Suffix.IMPORT)
        solve(m, final_time=m.T)
        prices[kind] = m.dual[m.limit[1]]
    assert prices["a state"] < 0
    assert prices["a range of a state"] == pytest.approx(prices["a state"], rel=1e-3)
    assert prices["a number and the time"] == pytest.approx(prices["a state"], rel=1e-3)
