"""What a solution says of a model without an objective, without a bottom, or without a solution."""

import re

import pytest
from pyomo.dae import ContinuousSet, DerivativeVar
from pyomo.environ import (
    ConcreteModel,
    Constraint,
    Objective,
    SolverFactory,
    Var,
    maximize,
    minimize,
)
from pyomo.opt import TerminationCondition

from pyomo_quad.collocation import Mesh, Status, compile, solve
from tests.problems import double_integrator

MESH = Mesh.uniform(5, 4)


def pushed(sense=minimize):
    """Place after one second under a force without limits."""
    m = double_integrator.build()
    for name in ("arrival", "rest", "objective"):
        m.component(name).deactivate()
    m.place = Objective(expr=m.x[1], sense=sense)
    return m


@pytest.mark.parametrize(
    ("sense", "way"), [(minimize, "falls"), (maximize, "grows")], ids=["least", "greatest"]
)
def test_an_objective_without_a_bound_is_called_unbounded(sense, way):
    solution = solve(pushed(sense), mesh=MESH)
    assert solution.status is Status.NOT_CONVERGED
    told = rf"unbounded: place {way} without bound while [uvx] diverges; bound"
    assert re.match(told, solution.message)
    ended = SolverFactory("pyomo_quad").solve(pushed(sense), mesh=MESH).solver
    assert ended.termination_condition is TerminationCondition.unbounded


def test_a_model_without_time_is_called_unbounded():
    m = ConcreteModel()
    m.x, m.y = Var(initialize=1), Var(bounds=(0, 1))
    m.cost = Objective(expr=m.y - m.x**2)
    assert solve(m).message.startswith("unbounded: cost falls without bound while x diverges")


def test_a_model_without_objective_says_that_nothing_is_optimised():
    m = double_integrator.build()
    m.component("objective").deactivate()
    solution = solve(m, mesh=MESH)
    assert solution.is_converged
    assert solution.message.startswith("no objective is declared: all equations and limits are met")


def test_a_model_without_solution_names_what_cannot_be_met():
    m = ConcreteModel()
    m.x, m.y = Var(bounds=(0, 1)), Var(bounds=(0, 1))
    m.enough = Constraint(expr=m.x + m.y >= 3)
    m.cost = Objective(expr=m.x)
    solution = compile(m).solve()
    assert solution.status is Status.INFEASIBLE
    assert solution.message.startswith("infeasible: the point of least violation")
    assert "violates enough by 1; relax" in solution.message


def test_one_of_several_horizons_without_solution_is_named():
    m = ConcreteModel()

    @m.Block(["first", "second"])
    def part(b, _name):
        b.t = ContinuousSet(bounds=(0, 1))
        b.x, b.u = Var(b.t), Var(b.t, bounds=(-1, 1))
        b.dx = DerivativeVar(b.x, wrt=b.t)
        b.motion = Constraint(b.t, rule=lambda b, t: b.dx[t] == b.u[t])

    m.part["first"].x[0].fix(0)
    m.part["second"].x[1].fix(3)
    m.joined = Constraint(expr=m.part["first"].x[1] == m.part["second"].x[0])
    m.cost = Objective(expr=m.part["first"].x[1])
    solution = solve(m, mesh=MESH)
    assert solution.status is Status.INFEASIBLE
    assert solution.message.startswith("infeasible: the point of least violation")
    assert "joined by 1" in solution.message or "motion at time" in solution.message
