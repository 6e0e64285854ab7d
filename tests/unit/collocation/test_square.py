"""As many equations as unknowns, or more, where some of them follow from the others."""

import re

import numpy as np
import pytest
from pyomo.dae import ContinuousSet, DerivativeVar
from pyomo.environ import ConcreteModel, Constraint, Objective, Var

from pyomo_quad.collocation import Mesh, Status, TranscriptionError, compile, solve
from tests.problems.published.mechanics import PERIOD, figure_eight, three_bodies


def oscillator():
    """Least time on a circle whose radius is conserved: at once, which is at T = 1."""
    m = ConcreteModel()
    m.t = ContinuousSet(bounds=(0, 1))
    m.T = Var(bounds=(1, 9), initialize=3)
    m.x, m.v = Var(m.t, initialize=1), Var(m.t)
    m.dx, m.dv = DerivativeVar(m.x, wrt=m.t), DerivativeVar(m.v, wrt=m.t)
    m.motion = Constraint(m.t, rule=lambda m, t: m.dx[t] == m.v[t])
    m.spring = Constraint(m.t, rule=lambda m, t: m.dv[t] == -m.x[t])
    m.x[0].fix(1)
    m.v[0].fix(0)
    m.cost = Objective(expr=m.T)
    return m


@pytest.mark.lengthy
@pytest.mark.parametrize(
    "arguments",
    [{}, {"tolerance": 1e-8}, {"mesh": Mesh.uniform(10, 4)}, {"mesh": Mesh.uniform(10, 6)}],
    ids=["refined", "refined more", "fixed mesh", "fixed mesh of degree 6"],
)
def test_an_objective_counts_where_an_end_condition_is_met_anyway(arguments):
    m = oscillator()
    m.circle = Constraint(expr=m.x[1] ** 2 + m.v[1] ** 2 == 1)
    solution = solve(m, final_time=m.T, **arguments)
    assert solution.is_converged
    assert solution.objective == pytest.approx(1.0, abs=1e-6)


def test_a_square_program_that_leaves_no_choice_is_solved():
    m = oscillator()
    m.there = Constraint(expr=m.v[1] == -np.sin(1.25))
    m.T.setub(1.5)
    solution = solve(m, final_time=m.T, mesh=Mesh.uniform(10, 6))
    assert solution.is_converged
    assert solution.objective == pytest.approx(1.25, abs=1e-9)
    assert solution.warnings == ()


@pytest.mark.lengthy
def test_an_end_that_contradicts_is_infeasible_although_its_size_is_right():
    m = oscillator()
    m.circle = Constraint(expr=m.x[1] ** 2 + m.v[1] ** 2 == 1.1)
    solution = solve(m, final_time=m.T, mesh=Mesh.uniform(4, 5))
    assert solution.status is Status.INFEASIBLE
    assert solution.message.startswith("infeasible: ")


def test_linear_equations_that_contradict_are_refused():
    m = oscillator()
    m.x[1].fix(0.3)
    m.v[1].fix(0.3)
    with pytest.raises(
        TranscriptionError, match=r"160 equations for 159 free unknowns.*over-determ"
    ):
        compile(m).solve(mesh=Mesh.uniform(20, 4))


NAMES = [f"{s}[{b},{a}]" for s in "qp" for b in range(3) for a in range(2)]


@pytest.mark.slow
@pytest.mark.parametrize(
    "arguments", [{}, {"tolerance": 1e-8}, {"mesh": Mesh.uniform(40, 6)}], ids=str
)
def test_end_conditions_that_follow_from_others_are_taken_with_a_warning(arguments):
    m = figure_eight()
    solution = compile(m, final_time=m.T).solve(**arguments)
    assert solution.is_converged
    assert solution.objective == pytest.approx(
        PERIOD, abs=1e-7 if "tolerance" in arguments else 1e-5
    )
    states = solution.to_frame()[NAMES].to_numpy()
    end = three_bodies(states[0], solution.objective)(1.0)
    np.testing.assert_allclose(end, states[0], atol=1e-4)
    assert re.match(r"model: \d+ equations for \d+ free unknowns; ", solution.warnings[0])
    assert "follow from the others and were left out of the solve" in solution.warnings[0]
