"""The first solve: other first points, and a second try where a warm start misled."""

from dataclasses import replace

import numpy as np
import pytest
from pyomo.dae import ContinuousSet, DerivativeVar
from pyomo.environ import ConcreteModel, Constraint, Objective, Var, sin

from pyomo_quad.collocation import (
    Mesh,
    RefinementOptions,
    SolverOptions,
    Status,
    TranscriptionError,
    compile,
)
from pyomo_quad.collocation.problem import Problem
from pyomo_quad.collocation.program.elastic import priced
from pyomo_quad.collocation.refining.refinement import refine
from pyomo_quad.collocation.starts import AT_THE_MODEL, Start
from pyomo_quad.flight.verification import fly_controls
from tests.problems import bryson_denham, double_integrator
from tests.problems.published.flight import f8
from tests.problems.published.geometry import geodesic
from tests.problems.published.mechanics import alp_rider
from tests.starts import noted_starts


def two_valleys():
    """Valleys at -1 and 2, of which the right one, farther from the first point, is deeper."""
    m = ConcreteModel()
    m.x = Var(bounds=(-3, 3), initialize=-0.9)
    m.cost = Objective(expr=(m.x + 1) ** 2 * (m.x - 2) ** 2 - m.x / 2)
    return m


def test_more_starts_find_the_deeper_valley():
    problem = compile(two_valleys())
    assert problem.solve().value("x") < 0
    best = problem.solve(starts=6)
    assert best.is_converged
    assert best.value("x") == pytest.approx(2.0, abs=0.1)
    assert best.objective < problem.solve().objective
    with pytest.raises(TranscriptionError, match=r"starts: 0; must be at least 1\."):
        problem.solve(starts=0)


def test_random_starts_keep_what_is_fixed_and_the_bounds():
    problem = compile(double_integrator.build())
    assert problem.solve(starts=3).objective == pytest.approx(6.0, rel=1e-6)


@pytest.mark.slow
def test_more_starts_find_the_quickest_manoeuvre():
    problem = compile(f8())
    assert problem.solve().objective > 5
    assert problem.solve(starts=6).objective == pytest.approx(3.78086, abs=1e-5)


def failing_where(monkeypatch, fails, status=Status.NOT_CONVERGED):
    """Let solves on a mesh fail where the arguments say so; return those of all."""
    solve_on_mesh, seen = Problem.solve_on_mesh, []

    def stubbed(self, mesh, start=AT_THE_MODEL, *rest, **arguments):
        solution = solve_on_mesh(self, mesh, start, *rest, **arguments)
        arguments["start"] = start
        seen.append((mesh, arguments))
        return replace(solution, status=status) if fails(mesh, arguments) else solution

    monkeypatch.setattr(Problem, "solve_on_mesh", stubbed)
    return seen


def test_where_the_first_mesh_fails_others_are_tried(monkeypatch):
    first = RefinementOptions().first_mesh
    failing_where(monkeypatch, lambda mesh, _: mesh == first)
    solution = compile(bryson_denham.build()).solve()
    assert solution.is_converged
    assert solution.history[0].elements > first.elements
    assert solution.objective == pytest.approx(4.0, rel=2e-6)


@pytest.mark.parametrize("most", [0, 15])
def test_a_solve_of_few_iterations_is_not_tried_again(monkeypatch, most):
    seen = failing_where(monkeypatch, lambda *_: True)
    options = SolverOptions(max_iterations=most)
    solution = compile(bryson_denham.build()).solve(mesh=Mesh.uniform(10, 4), options=options)
    assert solution.status is Status.NOT_CONVERGED
    assert len(seen) == 1


def test_a_guess_is_put_on_an_equation_among_states_and_its_controls_follow():
    """A chord lies inside the spheroid; without help the search ends in zigzags."""
    solution = compile(geodesic()).solve(mesh=Mesh.uniform(10, 4))
    assert solution.is_converged
    assert solution.objective == pytest.approx(5.5496819, abs=5e-8)


def test_an_end_that_lies_on_an_equation_among_states_leaves_no_empty_row():
    problem = compile(geodesic())
    solution = problem.solve(mesh=Mesh.uniform(4, 3))
    rows, columns = solution.program.jacobianstructure()
    free = solution.bounds.lower < solution.bounds.upper
    held = np.isfinite(solution.bounds.row_lower)
    assert set(np.flatnonzero(held)) <= set(rows[free[columns]].tolist())


@pytest.mark.lengthy
@pytest.mark.parametrize(
    ("barrier", "is_scaled"), [("monotone", True), ("adaptive", False), ("monotone", False)]
)
def test_a_fixed_mesh_is_tried_again_with_other_settings(monkeypatch, barrier, is_scaled):
    def fails(_, arguments):
        chosen = dict(arguments["options"].extra).get("mu_strategy")
        return (chosen, arguments.get("is_scaled", True)) != (barrier, is_scaled)

    failing_where(monkeypatch, fails)
    solution = compile(bryson_denham.build()).solve(mesh=Mesh.uniform(12, 5))
    assert solution.is_converged
    assert solution.objective == pytest.approx(4.0, rel=1e-4)


def test_what_is_claimed_infeasible_but_can_be_met_begins_there(monkeypatch):
    def fails(_, arguments):
        return arguments["start"].guess is None

    failing_where(monkeypatch, fails, Status.INFEASIBLE)
    solution = compile(double_integrator.build()).solve(mesh=Mesh.uniform(5, 4))
    assert solution.is_converged
    assert solution.objective == pytest.approx(6.0, rel=1e-6)


def test_what_can_be_met_is_not_called_infeasible(monkeypatch):
    failing_where(monkeypatch, lambda *_: True, Status.INFEASIBLE)
    solution = compile(double_integrator.build()).solve(mesh=Mesh.uniform(5, 4))
    assert solution.status is Status.NOT_CONVERGED


def pumped_pendulum():
    """From hanging to upright in least time, with a torque of about half the weight's."""
    m = ConcreteModel()
    m.t = ContinuousSet(bounds=(0, 1))
    m.T = Var(bounds=(0.1, 50))
    m.angle, m.speed, m.torque = Var(m.t), Var(m.t), Var(m.t, bounds=(-5, 5))
    m.turning, m.pull = DerivativeVar(m.angle, wrt=m.t), DerivativeVar(m.speed, wrt=m.t)
    m.motion = Constraint(m.t, rule=lambda m, t: m.turning[t] == m.speed[t])
    m.force = Constraint(m.t, rule=lambda m, t: m.pull[t] == m.torque[t] - 9.81 * sin(m.angle[t]))
    for state, start, end in ((m.angle, 0, np.pi), (m.speed, 0, 0)):
        state[0].fix(start)
        state[1].fix(end)
    m.cost = Objective(expr=m.T)
    return compile(m, final_time=m.T)


@pytest.mark.slow
def test_where_every_mesh_fails_an_elastic_start_leads_on(monkeypatch):
    problem, solve_on_mesh, starts = pumped_pendulum(), Problem.solve_on_mesh, []

    def failing_from_cold(self, mesh, start=AT_THE_MODEL, *rest, **options):
        # Which cold starts fail hangs on the last digits of the linear algebra.
        solution = solve_on_mesh(self, mesh, start, *rest, **options)
        is_plain = start.warm is None and not start.is_elastic
        starts.append("plain" if is_plain else "led on")
        return replace(solution, status=Status.INFEASIBLE) if is_plain else solution

    monkeypatch.setattr(Problem, "solve_on_mesh", failing_from_cold)
    solution = problem.solve()
    assert solution.is_converged
    assert starts.index("led on") > 1
    monkeypatch.undo()
    assert solution.objective == pytest.approx(pumped_pendulum().solve().objective, rel=1e-6)
    flown = fly_controls(
        solution.dynamics,
        solution.mesh_in_time,
        solution.trajectory.algebraics,
        solution.trajectory.states[0],
        solution.horizon,
    )
    assert flown.states[-1] == pytest.approx([np.pi, 0.0], abs=1e-4)


def test_an_elastic_start_gives_back_what_it_lent():
    problem = compile(bryson_denham.build())
    arguments = {"instance": problem.instance(), "options": SolverOptions()}
    with noted_starts() as starts:
        plain, elastic = (
            problem.solve_on_mesh(Mesh.uniform(5, 4), Start(is_elastic=is_elastic), **arguments)
            for is_elastic in (False, True)
        )
    assert elastic.objective == pytest.approx(plain.objective, rel=1e-8)
    # The last solve begins where the elastic program ended, with equations and limits kept.
    assert starts[0].infeasibility > 0.1
    assert starts[-1].infeasibility < 1e-6


def test_the_derivatives_of_an_elastic_program_are_the_slopes():
    solution = compile(bryson_denham.build()).solve(mesh=Mesh.uniform(2, 3))
    elastic = priced(solution.program, solution.scaling, solution.unknowns)
    slacks = np.random.default_rng(1).uniform(0.1, 1, elastic.prices.size)
    z = np.concatenate([solution.unknowns, slacks])
    steps = 1e-6 * np.eye(z.size)
    slopes = [(elastic.objective(z + d) - elastic.objective(z - d)) / 2e-6 for d in steps]
    np.testing.assert_allclose(elastic.gradient(z), slopes, rtol=1e-6, atol=1e-6)
    jacobian = np.zeros((elastic.n_rows, z.size))
    np.add.at(jacobian, elastic.jacobianstructure(), elastic.jacobian(z))
    moved = [(elastic.constraints(z + d) - elastic.constraints(z - d)) / 2e-6 for d in steps]
    np.testing.assert_allclose(jacobian, np.column_stack(moved), atol=1e-7)


def test_what_fails_on_every_mesh_is_told_of_the_first(monkeypatch):
    m = double_integrator.build()
    m.slow = Constraint(m.t, rule=lambda m, t: m.v[t] <= 0.5)  # half the way at most
    solve_on_mesh, meshes = Problem.solve_on_mesh, []
    few = SolverOptions(max_iterations=1)

    def failing(self, mesh, *rest, **options):
        # How Ipopt ends where nothing is feasible hangs on the last digits.
        meshes.append(mesh)
        solution = solve_on_mesh(self, mesh, *rest, **options | {"options": few})
        return replace(solution, status=Status.INFEASIBLE)

    monkeypatch.setattr(Problem, "solve_on_mesh", failing)
    solution = compile(m).solve()
    assert solution.status is Status.INFEASIBLE
    assert solution.mesh == RefinementOptions().first_mesh
    # The verdict is of the first mesh, though others were tried after it.
    assert any(mesh != solution.mesh for mesh in meshes)
    assert solution.message.startswith("infeasible: the point of least violation")
    assert any(f"{name} at time" in solution.message for name in ("motion", "force", "slow"))


def test_a_warm_start_that_ends_infeasible_is_tried_again_from_the_guess():
    problem = compile(double_integrator.build())
    first = problem.solve()
    tried = []

    def misled(meshes, start, dampings, change=None):
        del dampings, change
        tried.append(start.warm)
        solution = problem.solve(mesh=meshes[0])
        return solution if start.warm is None else replace(solution, status=Status.INFEASIBLE)

    solution = refine(
        misled,
        meshes=(first.mesh,),
        tolerance=1e-6,
        refinement=RefinementOptions(),
        start=Start.of(first),
    )
    assert [start is None for start in tried] == [False, True]
    assert solution.is_converged


@pytest.mark.slow
def test_a_curved_limit_does_not_hold_up_a_warm_start():
    problem = compile(alp_rider())
    coarse = problem.solve(mesh=Mesh.uniform(40, 4))
    finer = problem.solve(mesh=Mesh.uniform(80, 5), warm_start=coarse)
    assert finer.is_converged
    # A cold start may end at a local optimum that costs several times as much; Betts (2010) has
    # 2030.856 on a finer mesh.
    cold = problem.solve(mesh=finer.mesh)
    assert finer.objective <= (1 + 1e-6) * cold.objective
    assert finer.objective == pytest.approx(2030.856, rel=0.01)
