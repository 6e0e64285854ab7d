"""Solving a compiled problem again: other numbers, horizons, guesses, warm starts; giving up."""

import math
from dataclasses import replace
from itertools import chain

import numpy as np
import pytest
from pyomo.dae import ContinuousSet, DerivativeVar, Integral
from pyomo.environ import (
    ComponentMap,
    ConcreteModel,
    Constraint,
    Objective,
    Param,
    Var,
    cos,
    sin,
)

from pyomo_quad.collocation import (
    Mesh,
    RefinementOptions,
    SolverOptions,
    Status,
    Timeline,
    TranscriptionError,
    WarmStart,
    compile,
    solve,
)
from pyomo_quad.collocation.problem import Problem
from pyomo_quad.collocation.solving import within_budget
from pyomo_quad.collocation.starts import ColdStart, Start
from pyomo_quad.model import build_model, parameter_values
from pyomo_quad.scenario import load_scenario
from tests.problems import brachistochrone, goddard, hyper_sensitive, scalar_regulator
from tests.starts import assert_begins_at, noted_starts

MESH = Mesh.uniform(8, 5)


@pytest.fixture(scope="module")
def regulator():
    return compile(scalar_regulator.build())


@pytest.mark.parametrize("changes", [{}, {"a": -1.0}, {"q": 0.1, "r": 3.0}, {"x0": -2.0, "s": 0.0}])
def test_new_parameters_without_a_rebuild(regulator, changes):
    solution = regulator.solve(mesh=MESH, parameters=changes)
    assert solution.objective == pytest.approx(scalar_regulator.objective(**changes), rel=1e-8)


def test_parameters_by_component_and_from_the_model():
    m = scalar_regulator.build()
    problem = compile(m)
    by_component = problem.solve(mesh=MESH, parameters=ComponentMap([(m.q, 5.0)])).objective
    m.q.set_value(5.0)
    assert problem.solve(mesh=MESH).objective == pytest.approx(by_component, rel=1e-9)
    assert by_component == pytest.approx(scalar_regulator.objective(q=5.0), rel=1e-8)


def test_new_fixed_value_without_a_rebuild():
    m = hyper_sensitive.build()
    problem = compile(m)
    m.x[0].fix(-hyper_sensitive.START)
    m.x[hyper_sensitive.HORIZON].fix(-hyper_sensitive.END)
    assert problem.solve(tolerance=1e-8).objective == pytest.approx(
        hyper_sensitive.objective(), rel=1e-8
    )


def test_new_horizon(monkeypatch):
    problem = compile(hyper_sensitive.build())
    monkeypatch.setattr(hyper_sensitive, "HORIZON", 5.0)
    solution = problem.solve(tolerance=1e-8, horizon=(0.0, 5.0))
    assert solution.objective == pytest.approx(hyper_sensitive.objective(), rel=1e-8)
    assert solution.horizon == (0.0, 5.0)


def test_a_warm_start_begins_at_the_optimum():
    problem = compile(brachistochrone.build())
    cold = problem.solve(mesh=MESH)
    with noted_starts() as starts:
        warm = problem.solve(mesh=MESH, warm_start=cold)
    assert_begins_at(starts[0], cold)
    assert warm.status is Status.CONVERGED
    assert warm.objective == pytest.approx(cold.objective, rel=1e-9)


def test_warm_start_on_another_mesh():
    problem = compile(brachistochrone.build())
    coarse = problem.solve(mesh=Mesh.uniform(5, 3))
    fine = problem.solve(mesh=Mesh.uniform(9, 5), warm_start=coarse)
    assert fine.status is Status.CONVERGED
    assert fine.objective == pytest.approx(brachistochrone.objective(), rel=1e-8)


def residual(program, solution):
    """Return by how much a program's rows miss their bounds at a solution."""
    rows, bounds = program.constraints(solution.unknowns), solution.bounds
    return np.max(np.maximum(bounds.row_lower - rows, rows - bounds.row_upper))


def test_a_solution_keeps_the_numbers_it_was_solved_with(regulator):
    cases = ({}, {"a": -1.0, "q": 0.1, "x0": -2.0})
    solutions = [regulator.solve(mesh=MESH, parameters=changes) for changes in cases]
    programs = [solution.program for solution in solutions]
    for changes, solution, program in zip(cases, solutions, programs, strict=True):
        assert residual(program, solution) < 1e-9
        optimum = scalar_regulator.objective(**changes)
        assert program.user_objective(solution.unknowns) == pytest.approx(optimum, rel=1e-8)


def test_warm_start_from_another_compilation_is_as_good():
    cold = compile(brachistochrone.build()).solve(mesh=MESH)
    problem = compile(brachistochrone.build())
    with noted_starts() as starts:
        for held in (cold, cold.warm_start):
            warm = problem.solve(mesh=MESH, warm_start=held)
            assert warm.objective == pytest.approx(cold.objective, rel=1e-9)
    for start in starts:
        assert_begins_at(start, cold)


def test_warm_start_is_small_frozen_and_survives_as_arrays():
    start = solve(brachistochrone.build(), mesh=MESH).warm_start
    again = WarmStart.from_arrays(start.arrays())
    for name, array in start.arrays().items():
        np.testing.assert_array_equal(again.arrays()[name], array)
    with pytest.raises(ValueError, match="read-only"):
        start.trajectory.states[0, 0] = 1.0
    with pytest.raises(AttributeError):
        start.trajectory = None


@pytest.mark.parametrize("other", [scalar_regulator, hyper_sensitive])
def test_warm_start_of_another_model_is_refused(other):
    start = solve(brachistochrone.build(), mesh=MESH).warm_start
    with pytest.raises(TranscriptionError, match="warm_start: the solution is of another model"):
        compile(other.build()).solve(mesh=MESH, warm_start=start)


@pytest.mark.lengthy
def test_guess_from_a_frame_and_from_functions():
    problem = compile(brachistochrone.build())
    cold = problem.solve(mesh=MESH)
    from_frame = problem.solve(mesh=MESH, guess=cold.to_frame())
    assert from_frame.objective == pytest.approx(cold.objective, rel=1e-8)
    functions = {"x": lambda t: 10 * t, "y": lambda t: 5 * t, "duration": 1.8}
    from_functions = problem.solve(mesh=MESH, guess=functions)
    assert from_functions.objective == pytest.approx(cold.objective, rel=1e-8)
    of_numbers = functions | {"y": lambda t: 5.0 if t > 0.9 else math.sin(t)}
    from_numbers = problem.solve(mesh=MESH, guess=of_numbers)
    assert from_numbers.objective == pytest.approx(cold.objective, rel=1e-8)


def test_a_frame_in_physical_time_begins_a_solve_in_free_time_along_it():
    model = slide(scaled=False)
    problem = compile(model, final_time=model.duration)
    found = problem.solve(mesh=MESH)
    frame = found.to_frame()
    assert frame["time"].iloc[-1] == pytest.approx(brachistochrone.objective(), rel=1e-4)
    guess = dict(frame) | {"duration": found.objective}
    again = problem.solve(mesh=MESH, guess=guess)
    assert again.objective == pytest.approx(found.objective, rel=1e-8)
    assert again.iterations[0].infeasibility < 1e-2
    assert problem.solve(mesh=MESH).iterations[0].infeasibility > 0.1


def slide(*, scaled):
    """The brachistochrone in physical time, with its end left to the helper, or scaled by hand."""
    m = ConcreteModel()
    m.t = ContinuousSet(bounds=(0, 1))
    m.duration = Var(bounds=(0.1, 10), initialize=2)
    m.x, m.y, m.v = Var(m.t), Var(m.t), Var(m.t, bounds=(0, None))
    m.theta = Var(m.t, bounds=(0, np.pi), initialize=0.8)
    m.dx, m.dy, m.dv = (DerivativeVar(s, wrt=m.t) for s in (m.x, m.y, m.v))
    span = m.duration if scaled else 1.0
    gravity = brachistochrone.GRAVITY
    m.across = Constraint(m.t, rule=lambda m, t: m.dx[t] == span * m.v[t] * sin(m.theta[t]))
    m.down = Constraint(m.t, rule=lambda m, t: m.dy[t] == span * m.v[t] * cos(m.theta[t]))
    m.fall = Constraint(m.t, rule=lambda m, t: m.dv[t] == span * gravity * cos(m.theta[t]))
    for start in (m.x[0], m.y[0], m.v[0]):
        start.fix(0)
    m.x[1].fix(brachistochrone.ACROSS)
    m.y[1].fix(brachistochrone.DOWN)
    m.objective = Objective(expr=m.duration)
    return m


@pytest.mark.lengthy
def test_free_final_time_by_the_helper():
    m = slide(scaled=False)
    solution = solve(m, final_time=m.duration, tolerance=1e-8)
    assert solution.objective == pytest.approx(brachistochrone.objective(), rel=1e-8)
    assert solution.horizon == pytest.approx((0.0, brachistochrone.objective()), rel=1e-8)
    by_hand = solve(slide(scaled=True), mesh=solution.mesh)
    assert by_hand.value("theta", 0.5) == pytest.approx(
        solution.value("theta", solution.horizon[1] / 2), abs=1e-6
    )


def test_refinement_that_gives_up_says_so():
    solution = solve(
        hyper_sensitive.build(), tolerance=1e-10, refinement=RefinementOptions(max_meshes=2)
    )
    assert solution.status is Status.TOLERANCE_NOT_MET
    assert not solution.is_converged
    assert len(solution.history) == 2
    assert solution.error_estimate > 1e-10
    assert "refinement stopped after 2 meshes with an estimated error" in solution.message


def test_refinement_is_recorded():
    solution = solve(hyper_sensitive.build(), tolerance=1e-6)
    assert solution.is_converged
    errors = [record.error for record in solution.history]
    assert errors[-1] == solution.error_estimate <= 1e-6 < errors[0]
    assert solution.history[-1].points == solution.mesh.points


def test_fixed_mesh_is_not_refined():
    solution = solve(hyper_sensitive.build(), mesh=MESH)
    assert solution.mesh == MESH
    assert solution.history == ()


def test_too_few_iterations_are_reported():
    solution = solve(brachistochrone.build(), mesh=MESH, options=SolverOptions(max_iterations=2))
    assert solution.status is Status.NOT_CONVERGED
    assert not solution.is_converged


def test_stopped_by_the_caller():
    seen = []

    def stop_at_third(line):
        seen.append(line)
        return line.iteration < 3

    solution = solve(brachistochrone.build(), mesh=MESH, progress=stop_at_third)
    assert solution.status is Status.INTERRUPTED
    assert [line.iteration for line in seen] == [0, 1, 2, 3]


def two_experiments():
    """The same horizon twice, as two horizons."""
    m = ConcreteModel()
    m.a, m.b = hyper_sensitive.build(), hyper_sensitive.build()
    for part in (m.a, m.b):
        part.objective.deactivate()
    m.objective = Objective(expr=m.a.objective.expr + m.b.objective.expr)
    return m


@pytest.mark.parametrize("build", [hyper_sensitive.build, two_experiments])
def test_refinement_that_is_stopped_returns_its_last_finished_mesh(build):
    finished = []
    options = RefinementOptions(first_elements=3, on_mesh=finished.append)

    def stop_on_the_second_mesh(line):
        return not finished or line.iteration < 1

    found = compile(build()).solve(
        tolerance=1e-8, refinement=options, progress=stop_on_the_second_mesh
    )
    (first,) = finished
    assert found.status is Status.INTERRUPTED
    assert found.objective == first.objective
    assert 1e-8 < found.error_estimate == first.error_estimate < np.inf
    assert "; this is the solution of mesh 1, with an estimated error of " in found.message


def test_planner_that_has_seen_enough_ends_the_refinement():
    seen = []

    def enough(solution):
        seen.append(solution)
        return solution.error_estimate > 1e-3

    refinement = RefinementOptions(on_mesh=enough)
    found = solve(hyper_sensitive.build(), tolerance=1e-9, refinement=refinement)
    assert found.status is Status.INTERRUPTED
    assert 1e-9 < found.error_estimate == seen[-1].error_estimate <= 1e-3
    # Sharper than asked of the estimate: the closed form.
    assert found.objective == pytest.approx(hyper_sensitive.objective(), rel=1e-3)


def test_refinement_that_fails_returns_its_last_finished_mesh(monkeypatch):
    whole, finished = Problem.solve_on_mesh, []

    def failing(self, *arguments, **named):
        found = whole(self, *arguments, **named)
        return replace(found, status=Status.NOT_CONVERGED) if finished else found

    monkeypatch.setattr(Problem, "solve_on_mesh", failing)
    refinement = RefinementOptions(on_mesh=finished.append)
    found = solve(hyper_sensitive.build(), tolerance=1e-9, refinement=refinement)
    assert found.status is Status.NOT_CONVERGED
    assert found.error_estimate == finished[0].error_estimate < np.inf
    assert found.mesh == finished[0].mesh


def test_an_error_of_the_caller_is_not_lost():
    def fail(_line):
        raise ZeroDivisionError("mine")

    with pytest.raises(ZeroDivisionError, match="mine"):
        solve(brachistochrone.build(), mesh=MESH, progress=fail)


@pytest.mark.lengthy
def test_infeasible_is_told_from_not_converged():
    m = brachistochrone.build()
    m.hurry = Constraint(expr=m.duration <= 1.5)
    solution = solve(m, mesh=MESH)
    assert solution.status is Status.INFEASIBLE


def swing_up():
    """A pendulum from near rest to one radian in two seconds with a bounded torque."""
    m = ConcreteModel()
    m.t = ContinuousSet(bounds=(0, 2))
    m.start = Param(initialize=0.0, mutable=True)
    m.angle, m.speed, m.torque = Var(m.t), Var(m.t), Var(m.t, bounds=(-5, 5))
    m.dangle, m.dspeed = DerivativeVar(m.angle, wrt=m.t), DerivativeVar(m.speed, wrt=m.t)
    m.motion = Constraint(m.t, rule=lambda m, t: m.dangle[t] == m.speed[t])
    m.swing = Constraint(m.t, rule=lambda m, t: m.dspeed[t] == m.torque[t] - sin(m.angle[t]))
    m.begin = Constraint(expr=m.angle[0] == m.start)
    m.speed[0].fix(0)
    m.angle[2].fix(1)
    m.effort = Integral(m.t, rule=lambda m, t: m.torque[t] ** 2)
    m.cost = Objective(expr=m.effort)
    return m


def wall_problem():
    """Bryson and Denham's mass before a wall, whose closed form is `wall_effort`."""
    m = ConcreteModel()
    m.t = ContinuousSet(bounds=(0, 1))
    m.wall = Param(initialize=0.2, mutable=True)
    m.x, m.v, m.u = (Var(m.t) for _ in range(3))
    m.dx, m.dv = DerivativeVar(m.x, wrt=m.t), DerivativeVar(m.v, wrt=m.t)
    m.motion = Constraint(m.t, rule=lambda m, t: m.dx[t] == m.v[t])
    m.force = Constraint(m.t, rule=lambda m, t: m.dv[t] == m.u[t])
    m.keep_out = Constraint(m.t, rule=lambda m, t: m.x[t] <= m.wall)
    for variable, time, number in ((m.x, 0, 0), (m.x, 1, 0), (m.v, 0, 1), (m.v, 1, -1)):
        variable[time].fix(number)
    m.effort = Integral(m.t, wrt=m.t, rule=lambda m, t: m.u[t] ** 2 / 2)
    m.objective = Objective(expr=m.effort)
    return compile(m)


def wall_effort(wall):
    """Return the least effort: no touch beyond 1/4, one from 1/6 on, a stretch along it below."""
    if wall < 1 / 6:
        return 4 / (9 * wall)
    return 2 + 6 * max(1 - 4 * wall, 0) ** 2


def ascent():
    m = goddard.build()
    return compile(m, times=goddard.times(m)), {}, {}


def moved_mission():
    here = load_scenario("scenarios/paper_calm.toml")
    there = here.with_values({"mission.start.position": [0.5, 0.0, 0.0]})
    return compile(build_model(here)), parameter_values(here), parameter_values(there)


@pytest.mark.lengthy
@pytest.mark.parametrize(
    "case",
    [
        ascent,
        moved_mission,
        lambda: (compile(hyper_sensitive.build()), {}, {}),
        lambda: (compile(swing_up()), {}, {"start": 0.02}),
    ],
    ids=["three phases", "a mission moved by 0.5 m", "hyper-sensitive", "swing-up"],
)
def test_a_warm_start_begins_at_the_last_optimum_and_ends_where_a_cold_one_does(case):
    problem, old, new = case()
    first = problem.solve(tolerance=1e-6, parameters=old)
    cold = problem.solve(tolerance=1e-6, parameters=new)
    with noted_starts() as starts:
        warm = problem.solve(tolerance=1e-6, parameters=new, warm_start=first)
    assert_begins_at(starts[0], first, is_the_same=new == old)
    assert warm.is_converged
    assert warm.objective == pytest.approx(cold.objective, rel=2e-6)


@pytest.mark.parametrize(
    ("before", "after"), [(0.2, 0.1), (0.1, 0.2), pytest.param(0.3, 0.08, marks=pytest.mark.slow)]
)
def test_a_warm_start_where_other_limits_hold_ends_at_the_optimum(before, after):
    problem = wall_problem()
    first = problem.solve(tolerance=1e-6, parameters={"wall": before})
    with noted_starts() as starts:
        warm = problem.solve(tolerance=1e-6, parameters={"wall": after}, warm_start=first)
    assert_begins_at(starts[0], first, is_the_same=False)
    assert warm.is_converged
    assert first.objective == pytest.approx(wall_effort(before), rel=1e-6)
    assert warm.objective == pytest.approx(wall_effort(after), rel=1e-6)


class Attempts:
    """Solves of given numbers of iterations, each of a warm start or a cold one, one mesh each."""

    def __init__(self, solution, *, warm, cold):
        self.solution, self.meshes, self.taken = solution, {True: warm, False: cold}, []

    def __call__(self, start, progress):
        is_warm = start.warm is not None
        self.taken.append((is_warm, 0))
        for k in chain.from_iterable(range(n + 1) for n in self.meshes[is_warm]):
            self.taken[-1] = (is_warm, self.taken[-1][1] + (k > 0))
            if progress(replace(self.solution.iterations[0], iteration=k)) is False:
                return replace(self.solution, status=Status.INTERRUPTED)
        return self.solution


@pytest.mark.parametrize(
    ("meshes", "taken"),
    [
        # The first mesh may take 3, all together 5; the iteration that ends a solve is one more.
        ((3, 2), [(True, 5)]),
        ((4, 0), [(True, 4), (False, 7)]),
        ((3, 3), [(True, 6), (False, 7)]),
    ],
)
def test_a_warm_start_may_take_what_the_cold_start_took(regulator, meshes, taken):
    solution = regulator.solve(mesh=MESH)
    attempts = Attempts(solution, warm=meshes, cold=(5, 2))
    known = ColdStart(first=3, iterations=5, tolerance=1e-6)
    start = Start.of(replace(solution.warm_start, cold_start=known))
    found = within_budget(attempts, start, 1e-6, None)
    assert attempts.taken == taken
    if len(taken) == 1:
        assert found.cold_start == known
    else:
        assert f"warm start was given up after {taken[0][1]} iterations, more than" in found.message
        assert found.cold_start == ColdStart(first=5, iterations=7, tolerance=1e-6)


def test_only_a_start_of_the_same_demand_is_given_up():
    problem = wall_problem()
    first = problem.solve(tolerance=1e-4, parameters={"wall": 0.2})
    warm = problem.solve(tolerance=1e-6, parameters={"wall": 0.1}, warm_start=first)
    assert warm.is_converged
    assert warm.cold_start is None
    assert "given up" not in warm.message


def test_what_a_cold_start_took_is_kept_through_warm_ones_and_in_arrays():
    problem = compile(hyper_sensitive.build())
    lines = []
    cold = problem.solve(tolerance=1e-6, progress=lines.append)
    took = sum(line.iteration > 0 for line in lines)
    warm = problem.solve(tolerance=1e-6, warm_start=cold)
    assert warm.cold_start == cold.cold_start
    kept = WarmStart.from_arrays(warm.warm_start.arrays()).cold_start
    assert (kept.iterations, kept.tolerance) == (took, 1e-6)


def test_a_count_that_is_none_is_refused():
    arrays = solve(brachistochrone.build(), mesh=MESH).warm_start.arrays()
    with pytest.raises(TranscriptionError, match="cold_start: has the shape 2; must be 3"):
        WarmStart.from_arrays(arrays | {"cold_start": np.zeros(2)})
    del arrays["cold_start"]
    assert WarmStart.from_arrays(arrays).cold_start is None


def test_what_is_left_of_an_optimum_starts_with_its_multipliers_in_time(regulator):
    """Bellman: from a state on the optimum, states and multipliers of the rest are as they were."""
    whole = scalar_regulator.DURATION
    first = regulator.solve(mesh=Mesh.uniform(8, 6))
    begin, mesh = 0.7, Mesh.uniform(5, 6)
    ends = np.array([0.0, 1.0])
    rest = Timeline(fractions=ends, times=np.array([begin, whole]))
    start = first.warm_start.continued(mesh, first.timeline, rest)
    numbers = {"x0": float(first.value("x", begin))}
    cold = regulator.solve(mesh=mesh, parameters=numbers, horizon=(begin, whole))
    np.testing.assert_allclose(start.equations, cold.warm_start.equations, rtol=1e-6)
    np.testing.assert_allclose(start.trajectory.states, cold.trajectory.states, rtol=1e-7)
    warm = regulator.solve(mesh=mesh, parameters=numbers, horizon=(begin, whole), warm_start=start)
    assert warm.objective == pytest.approx(cold.objective, rel=1e-9)
