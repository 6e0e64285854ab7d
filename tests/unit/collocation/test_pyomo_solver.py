"""The engine as a Pyomo solver, on continuous, discretised and plain models."""

import itertools
import tempfile

import numpy as np
import pytest
from pyomo.dae import ContinuousSet, DerivativeVar, Integral
from pyomo.environ import (
    ConcreteModel,
    Constraint,
    Objective,
    RangeSet,
    Set,
    SolverFactory,
    TransformationFactory,
    Var,
    assert_optimal_termination,
    maximize,
    value,
)
from pyomo.opt import TerminationCondition

from pyomo_quad.collocation import RefinementOptions, Status, TranscriptionError, solve
from pyomo_quad.collocation.program import ipopt, linear_solvers
from tests.problems import bryson_denham, double_integrator, hyper_sensitive
from tests.starts import assert_begins_at, noted_starts


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


@pytest.fixture
def clock(monkeypatch):
    """Give a clock that moves by a second when it is asked."""
    ticks = itertools.count()
    monkeypatch.setattr(ipopt.time, "perf_counter", lambda: float(next(ticks)))


@pytest.mark.parametrize("limit", [{"timelimit": 2.0}, {"options": {"max_wall_time": 2.0}}])
def test_a_time_limit_ends_the_first_mesh(solver, clock, limit):
    results = solver.solve(bryson_denham.build(), **limit, tolerance=1e-8)
    assert results.solver.termination_condition is TerminationCondition.maxTimeLimit
    assert results.solver.message.startswith("stopped at the time limit of 2 s, on mesh 1;")


def test_a_time_limit_counts_on_from_mesh_to_mesh(solver, clock):
    whole = solver.solve(bryson_denham.build(), tolerance=1e-8).solution_on_mesh
    assert len(whole.history) > 1
    first = whole.history[0].iterations
    results = solver.solve(bryson_denham.build(), tolerance=1e-8, timelimit=2.0 * first + 6.0)
    assert results.solver.termination_condition is TerminationCondition.maxTimeLimit
    assert "on mesh 1;" not in results.solver.message


@pytest.mark.parametrize("limit", [0.0, -1.0])
def test_a_time_limit_that_is_no_time_is_refused(solver, limit):
    with pytest.raises(TranscriptionError, match=r"timelimit: .* s; must be above 0"):
        solver.solve(hock_schittkowski_71(), timelimit=limit)


def test_the_log_goes_to_a_file(solver, tmp_path, capsys):
    solver.solve(hock_schittkowski_71(), logfile=tmp_path / "solve.log")
    assert "infeasibility" in (tmp_path / "solve.log").read_text()
    assert capsys.readouterr().out == ""


def test_a_kept_log_is_named(solver, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    solver.solve(hock_schittkowski_71(), keepfiles=True)
    (log,) = tmp_path.glob("*.log")
    assert capsys.readouterr().out == f"Solver log file: '{log}'\n"
    assert "infeasibility" in log.read_text()


def test_a_warm_start_begins_at_the_optimum_that_was_found(solver):
    m = bryson_denham.build()
    cold = solver.solve(m, tolerance=1e-6).solution_on_mesh
    with noted_starts() as starts:
        warm = solver.solve(m, tolerance=1e-6, warmstart=True).solution_on_mesh
    assert_begins_at(starts[0], cold)
    assert warm.objective == pytest.approx(cold.objective, rel=1e-6)


def test_options_of_the_factory():
    limited = SolverFactory("pyomo_quad", options={"max_iter": 1})
    assert limited.options == {"max_iter": 1}
    results = limited.solve(hock_schittkowski_71())
    assert results.solver.termination_condition is TerminationCondition.maxIterations


def test_what_pyomo_gives_every_solver_is_taken(solver):
    assert solver.available(False)
    solver.options.max_iter = 1
    results = solver.solve(hock_schittkowski_71(), symbolic_solver_labels=True)
    assert results.solver.termination_condition is TerminationCondition.maxIterations


def test_what_is_unknown_is_refused_by_name(solver):
    m = hock_schittkowski_71()
    with pytest.raises(TranscriptionError, match=r"^nlp: is no argument of solve, which takes fin"):
        solver.solve(m, nlp="cyipopt")
    for options in ({"max_iteration": 5}, {"max_iter": -3}):
        with pytest.raises(TranscriptionError, match=r"^options: Ipopt does not take max_iter"):
            solver.solve(m, options=options)


@pytest.mark.parametrize("name", ["pardiso", "ma97"])
def test_a_linear_solver_that_this_ipopt_lacks_is_refused(solver, monkeypatch, name):
    """Whether a library that Ipopt misses ends the process is seen in another process alone."""
    monkeypatch.setattr(linear_solvers, "_PROBE", "import os; os.abort()")
    linear_solvers._is_loaded.cache_clear()
    with pytest.raises(
        TranscriptionError, match=rf"^options: linear_solver = '{name}', which this"
    ):
        solver.solve(hock_schittkowski_71(), options={"linear_solver": name})


@pytest.mark.lengthy
def test_a_linear_solver_is_tried_in_a_process_of_its_own():
    linear_solvers._is_loaded.cache_clear()
    refuse = linear_solvers.refuse_absent_solver
    assert linear_solvers._is_loaded('{"linear_solver": "mumps"}')
    with pytest.raises(TranscriptionError, match="leave the option out for 'mumps'"):
        refuse({"linear_solver": "ma27", "hsllib": "/no/such/library.so"})


def test_a_mesh_that_is_too_coarse_ends_otherwise(solver):
    few = RefinementOptions(max_meshes=1)
    results = solver.solve(bryson_denham.build(), tolerance=1e-9, refinement=few)
    assert results.solver.termination_condition is TerminationCondition.other
    assert "refinement stopped after 1 meshes" in results.solver.message


def test_a_refinement_that_meets_its_tolerance_but_not_the_objective_says_so():
    few = RefinementOptions(max_meshes=1)
    m = double_integrator.build()
    m.u.setlb(-4.5)
    m.u.setub(4.5)
    solution = solve(m, tolerance=0.1, refinement=few)
    assert solution.status is Status.TOLERANCE_NOT_MET
    assert solution.history[-1].error <= 0.1
    assert "an objective that has not settled to the tolerance 0.1;" in solution.message


def test_an_integral_with_two_indices_is_loaded(solver):
    m = ConcreteModel()
    m.t = ContinuousSet(bounds=(0, 1))
    m.x = Var(m.t, initialize=1.0)
    m.dx = DerivativeVar(m.x, wrt=m.t)
    m.decay = Constraint(m.t, rule=lambda m, t: m.dx[t] == -m.x[t])
    m.x[0].fix(1.0)
    m.one, m.two = Set(initialize=[1]), Set(initialize=[2])
    m.total = Integral(m.one, m.two, m.t, wrt=m.t, rule=lambda m, _i, _j, t: m.x[t])
    m.objective = Objective(expr=m.total[1, 2])
    solver.solve(m, tolerance=1e-8)
    assert value(m.total[1, 2]) == pytest.approx(1.0 - np.exp(-1.0), rel=1e-8)


def test_states_without_effect_begin_at_their_own_initial_conditions():
    m = double_integrator.build()
    m.part = Set(initialize=[1, 2])
    m.seen = Var(m.part, m.t)
    m.seeing = DerivativeVar(m.seen, wrt=m.t)
    m.sight = Constraint(m.part, m.t, rule=lambda m, i, t: m.seeing[i, t] == i)
    m.begun = Constraint(m.part, rule=lambda m, i: m.seen[i, 0] == 3 * i)
    solution = solve(m)
    for i in (1, 2):
        assert solution.value(m.seen, 0.0, index=i) == pytest.approx(3.0 * i)
        assert solution.value(m.seen, 1.0, index=i) == pytest.approx(4.0 * i)


def test_an_unbounded_program_says_so(solver):
    m = ConcreteModel()
    m.x = Var(initialize=1.0)
    m.loss = Objective(expr=m.x)
    results = solver.solve(m)
    assert results.solver.termination_condition is TerminationCondition.unbounded


@pytest.mark.lengthy
@pytest.mark.parametrize("problem", [bryson_denham, hyper_sensitive])
def test_objective_and_integrals_are_worth_what_was_solved(solver, problem):
    m = problem.build()
    expected = problem.objective()
    for _ in range(2):
        solver.solve(m, tolerance=1e-8)
        assert value(m.objective) == pytest.approx(expected, rel=1e-7)
    (integral,) = m.component_objects(Integral)
    assert value(integral) == pytest.approx(expected, rel=1e-7)


def test_integrals_are_left_alone_when_asked(solver):
    m = hyper_sensitive.build()
    for t in m.t:
        m.x[t].set_value(1.0)
        m.u[t].set_value(0.0)
    before = value(m.objective)
    solver.solve(m, load_solutions=False)
    assert value(m.objective) == before


def test_a_loaded_model_can_be_discretised_by_pyomo(solver):
    m = double_integrator.build()
    solver.solve(m)
    TransformationFactory("dae.collocation").apply_to(m, nfe=6, ncp=3, scheme="LAGRANGE-RADAU")
    results = solver.solve(m)
    assert value(m.objective) == pytest.approx(results.problem.upper_bound, rel=1e-9)
