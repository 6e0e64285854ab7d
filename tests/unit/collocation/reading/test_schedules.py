"""Parameters over time that no formula gives: measured series, as a wind from a file."""

import pickle

import numpy as np
import pytest
from pyomo.dae import ContinuousSet, DerivativeVar, Integral
from pyomo.environ import ConcreteModel, Constraint, Objective, Param, Var

from pyomo_quad.collocation import TranscriptionError, compile, solve


def follower(rule):
    """Follow a series for free: x' = u, min int (x - series)^2 dt."""
    m = ConcreteModel()
    m.t = ContinuousSet(bounds=(0, 1))
    m.series = Param(m.t, initialize=rule, mutable=True)
    m.x = Var(m.t, initialize=0.0)
    m.u = Var(m.t)
    m.dx_dt = DerivativeVar(m.x, wrt=m.t)
    m.motion = Constraint(m.t, rule=lambda m, t: m.dx_dt[t] == m.u[t] + m.series[t])
    m.x[0].fix(0)
    m.x[1].fix(1)
    m.effort = Integral(m.t, rule=lambda m, t: m.u[t] ** 2 / 2)
    m.objective = Objective(expr=m.effort)
    return m


def test_series_in_an_equation_over_time_acts_at_every_point():
    # u is constant: 1 = u + int series = u + 1/3.
    solution = solve(follower(lambda m, t: t**2), tolerance=1e-9)
    assert solution.objective == pytest.approx((2 / 3) ** 2 / 2, rel=1e-9)


def test_series_at_an_instant_is_refused_in_a_condition():
    m = follower(lambda m, t: t**2)
    m.meeting = Constraint(expr=m.u[1] == m.series[1])
    with pytest.raises(TranscriptionError, match=r"meeting: series\[1.*single time"):
        solve(m)


def test_a_series_given_for_one_solve_is_pickled_with_its_solution():
    found = compile(follower(lambda m, t: t**2)).solve(
        tolerance=1e-9, parameters={"series": lambda t: 1.0 if t < 0.25 else 3.0 * t}
    )
    restored = pickle.loads(pickle.dumps(found))
    times = np.linspace(0, 1, 41)
    np.testing.assert_allclose(
        restored.value("dx_dt", times), found.value("dx_dt", times), atol=1e-12
    )
    series = 0.25 + 1.5 * (1 - 0.25**2)
    again = restored.problem.solve(tolerance=1e-9, parameters=restored.instance.overrides)
    assert again.objective == pytest.approx((1 - series) ** 2 / 2, rel=1e-9)
    own = restored.problem.solve(tolerance=1e-9)
    assert own.objective == pytest.approx((2 / 3) ** 2 / 2, rel=1e-9)


def test_a_series_that_fails_is_refused_after_pickling_as_before():
    m = follower({0: 1.0, 1: 2.0})
    for problem in (compile(m), pickle.loads(pickle.dumps(compile(m)))):
        with pytest.raises(TranscriptionError, match="series: its rule fails at time 2e-12"):
            problem.solve()
