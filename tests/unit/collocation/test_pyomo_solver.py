"""The engine as a Pyomo solver, on continuous, discretised and plain models."""

import pytest
from pyomo.environ import (
    ConcreteModel,
    Constraint,
    Objective,
    RangeSet,
    SolverFactory,
    TransformationFactory,
    Var,
    assert_optimal_termination,
    maximize,
    value,
)
from pyomo.opt import TerminationCondition

import pyomo_quad.collocation  # noqa: F401  registers the solver
from tests.problems import double_integrator


@pytest.fixture
def solver():
    return SolverFactory("pyomo_quad")


def hock_schittkowski_71():
    """Problem 71 of Hock and Schittkowski (1981); its optimum is 17.0140172891."""
    m = ConcreteModel()
    m.i = RangeSet(4)
    m.x = Var(m.i, bounds=(1, 5), initialize={1: 1, 2: 5, 3: 5, 4: 1})
    m.product = Constraint(expr=m.x[1] * m.x[2] * m.x[3] * m.x[4] >= 25)
    m.sphere = Constraint(expr=sum(m.x[i] ** 2 for i in m.i) == 40)
    m.cost = Objective(expr=m.x[1] * m.x[4] * (m.x[1] + m.x[2] + m.x[3]) + m.x[3])
    return m


def test_continuous_model_is_solved_and_loaded(solver):
    m = double_integrator.build()
    results = solver.solve(m, tolerance=1e-8)
    assert_optimal_termination(results)
    assert results.solution_on_mesh.objective == pytest.approx(6.0, rel=1e-8)
    state = double_integrator.state(1.0)
    for name, expected in state.items():
        assert value(m.find_component(name)[1]) == pytest.approx(float(expected), abs=1e-8)


def test_model_discretised_by_pyomo_is_solved(solver):
    m = double_integrator.build()
    TransformationFactory("dae.collocation").apply_to(m, nfe=6, ncp=3, scheme="LAGRANGE-RADAU")
    results = solver.solve(m)
    assert_optimal_termination(results)
    # Pyomo's trapezoids on its own mesh, not the integral: that is what was asked for.
    assert value(m.objective) == pytest.approx(results.problem.upper_bound, rel=1e-9)
    # Pyomo's own residuals at the loaded values.
    worst = max(
        abs(value(data.body) - value(data.upper))
        for data in m.component_data_objects(Constraint, active=True)
        if data.equality
    )
    assert worst < 1e-7


def test_plain_nonlinear_program_is_solved(solver):
    m = hock_schittkowski_71()
    assert_optimal_termination(solver.solve(m))
    assert value(m.cost) == pytest.approx(17.0140172891, rel=1e-8)
    assert value(m.x[1]) == pytest.approx(1.0, abs=1e-7)


def test_maximum_is_found(solver):
    m = ConcreteModel()
    m.x = Var(bounds=(0, 3), initialize=1.0)
    m.gain = Objective(expr=m.x * (4 - m.x), sense=maximize)
    assert_optimal_termination(solver.solve(m))
    assert value(m.gain) == pytest.approx(4.0, rel=1e-9)


def test_infeasible_program_says_so(solver):
    m = ConcreteModel()
    m.x = Var(bounds=(0, 1), initialize=0.5)
    m.y = Var(initialize=0.5)
    m.circle = Constraint(expr=m.x**2 + m.y**2 == 1)
    m.far = Constraint(expr=m.x + m.y == 3)
    m.cost = Objective(expr=m.x)
    results = solver.solve(m)
    assert results.solver.termination_condition is TerminationCondition.infeasible


def test_values_are_left_alone_when_asked(solver):
    m = hock_schittkowski_71()
    solver.solve(m, load_solutions=False)
    assert value(m.x[2]) == 5


def test_ipopt_options_pass_through(solver):
    results = solver.solve(hock_schittkowski_71(), options={"max_iter": 1})
    assert results.solver.termination_condition is not TerminationCondition.optimal


def test_tee_prints_the_iterations(solver, capsys):
    solver.solve(hock_schittkowski_71(), tee=True)
    assert "infeasibility" in capsys.readouterr().out


def test_rates_are_loaded_too(solver):
    m = double_integrator.build()
    solver.solve(m, tolerance=1e-8)
    assert value(m.dv_dt[0]) == pytest.approx(6.0, abs=1e-6)
    assert value(m.dx_dt[1]) == pytest.approx(0.0, abs=1e-8)
