"""What multipliers and Hamiltonian say against a solution that is optimal for Ipopt."""

from dataclasses import replace

import pytest
from pyomo.dae import ContinuousSet, DerivativeVar, Integral
from pyomo.environ import ConcreteModel, Constraint, Objective, Var

from pyomo_quad.collocation import Mesh, Status, solve
from pyomo_quad.collocation.problem import Problem


def switching(smoothing):
    """Betts' complementarity problem, y' = 2 - sign(y), by products that a number limits."""
    m = ConcreteModel()
    m.t = ContinuousSet(bounds=(0, 2))
    m.y, m.sign = Var(m.t), Var(m.t, bounds=(-1, 1))
    m.below, m.above = (Var(m.t, bounds=(0, None)) for _ in range(2))
    m.dy_dt = DerivativeVar(m.y, wrt=m.t)
    m.law = Constraint(m.t, rule=lambda m, t: m.dy_dt[t] == 2 - m.sign[t])
    m.split = Constraint(m.t, rule=lambda m, t: m.y[t] == m.above[t] - m.below[t])
    m.if_below = Constraint(m.t, rule=lambda m, t: m.below[t] * (m.sign[t] + 1) <= smoothing)
    m.if_above = Constraint(m.t, rule=lambda m, t: m.above[t] * (1 - m.sign[t]) <= smoothing)
    m.y[0].fix(-1)
    m.way = Integral(m.t, wrt=m.t, rule=lambda m, t: m.y[t] ** 2)
    m.cost = Objective(expr=(m.y[2] - 5 / 3) ** 2 + m.way)
    return m


def test_products_that_must_vanish_are_not_converged_and_named(monkeypatch):
    """Their multipliers grow without bound, here for sure: how far they get hangs on rounding."""
    grown = {"if_below", "if_above"}

    def diverging(self, mesh, *rest, **options):
        found = solve_on_mesh(self, mesh, *rest, **options)
        names = [e.name for e in found.program.compiled.declared.equations]
        rows = found.multipliers.rows.copy()
        over_time = rows[: found.program.first_condition_row].reshape(-1, len(names))
        over_time[:, [name in grown for name in names]] *= 1e15
        warned = replace(found, multipliers=replace(found.multipliers, rows=rows))
        assert warned.warnings
        return warned

    solve_on_mesh = Problem.solve_on_mesh
    monkeypatch.setattr(Problem, "solve_on_mesh", diverging)
    solution = solve(switching(1e-2), mesh=Mesh.uniform(20, 3))
    assert solution.status is Status.TOLERANCE_NOT_MET
    assert solution.message.startswith("if_below, if_above: multipliers grow without bound")
    assert "Hamiltonian: varies by" in solution.message


@pytest.mark.lengthy
def test_products_that_may_be_small_are_converged():
    solution = solve(switching(1e-2), tolerance=1e-4)
    assert solution.is_converged, solution.message
