"""Damping of linear controls, on the singular regulator of the gates and on a car."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.polynomial.legendre import legval
from pyomo.environ import Constraint, inequality
from scipy.optimize import approx_fprime

from pyomo_quad import collocation
from pyomo_quad.collocation import Mesh, RefinementOptions, SolverOptions, Status
from pyomo_quad.collocation.mesh import radau_rule
from pyomo_quad.collocation.refining.damping import damping_of
from pyomo_quad.collocation.refining.refinement import refine
from pyomo_quad.collocation.starts import AT_THE_MODEL, Start
from tests.problems import bang_bang, bryson_denham, double_integrator, singular_arc

WEIGHT, GAP = 1e-3, 1e-6
MESH = Mesh.uniform(6, 3)


@pytest.fixture(scope="module")
def solution():
    return collocation.compile(singular_arc.build()).solve(mesh=MESH)


@pytest.fixture(scope="module")
def damped(solution):
    finer = Mesh.uniform(9, 4)
    program = solution.problem.program(finer, solution.instance)
    return damping_of(solution, WEIGHT).applied_to(program)


def test_only_bounded_controls_that_enter_linearly_are_damped(solution):
    assert damping_of(solution, WEIGHT) is not None
    quadratic = collocation.compile(double_integrator.build()).solve(mesh=MESH)
    assert damping_of(quadratic, WEIGHT) is None
    assert damping_of(solution, 0.0) is None


def test_controls_a_whole_range_away_cost_the_weight_times_the_objective(solution, damped):
    z = np.zeros(damped.program.layout.unknowns)
    z[damped.columns] = damped.near + 2.0  # the control lies within -1 and 1
    added = damped.objective(z) - damped.program.objective(z)
    assert added == pytest.approx(WEIGHT * solution.nominal_objective, rel=1e-12)


def test_chatter_within_elements_is_no_part_of_the_course_that_controls_are_drawn_to(
    solution, damped
):
    held = solution.trajectory
    weights = MESH.quadrature_weights.reshape(MESH.elements, -1)
    chatter = np.zeros_like(weights)
    chatter[:, 0], chatter[:, 1] = 0.01 / weights[:, 0], -0.01 / weights[:, 1]
    algebraics = held.algebraics + chatter.reshape(-1, 1)
    chattering = replace(solution, trajectory=replace(held, algebraics=algebraics))
    drawn = damping_of(chattering, WEIGHT).applied_to(damped.program)
    assert np.abs(algebraics - held.algebraics).max() > 0.1
    assert drawn.near == pytest.approx(damped.near, abs=1e-12)


def test_once_the_costs_have_settled_controls_are_drawn_to_where_they_jump(solution, damped):
    jump = np.where(np.arange(MESH.elements) < MESH.elements // 2, -0.8, 0.8)
    chatter = 0.2 * legval(2.0 * radau_rule(3).points - 1.0, [0.0, 0.0, 1.0])
    algebraics = (jump[:, None] + chatter).reshape(-1, 1)
    moved = replace(solution, trajectory=replace(solution.trajectory, algebraics=algebraics))
    drawn = damping_of(moved, WEIGHT, is_still=True).applied_to(damped.program)
    fractions = damped.program.mesh.point_fractions
    assert drawn.near == pytest.approx(np.where(fractions <= 0.5, -0.8, 0.8), abs=1e-12)


@pytest.mark.parametrize("weight", [WEIGHT, 0.0])
def test_the_barrier_leaves_as_much_as_it_shall(solution, weight):
    damping = damping_of(solution, weight, gap=GAP, is_still=True)
    arguments = {"instance": solution.instance, "options": SolverOptions()}
    found = solution.problem.solve_on_mesh(MESH, Start.of(solution), damping, **arguments)
    z, bounds = found.unknowns, found.bounds
    pulls = (found.multipliers.lower, z - bounds.lower), (found.multipliers.upper, bounds.upper - z)
    left = sum(pull[np.isfinite(slack)] @ slack[np.isfinite(slack)] for pull, slack in pulls)
    assert left == pytest.approx(GAP * solution.nominal_objective, rel=1e-2)


def test_derivatives_are_those_of_finite_differences(damped):
    z = np.random.default_rng(1).uniform(-1.0, 1.0, damped.program.layout.unknowns)
    differences = approx_fprime(z, damped.objective, 1e-6)
    assert damped.gradient(z) == pytest.approx(differences, abs=1e-5)
    rows, columns = damped.hessianstructure()
    values = damped.hessian(z, np.zeros(damped.n_rows), 1.0)
    lower = np.zeros((z.size, z.size))
    np.add.at(lower, (rows, columns), values)
    whole = lower + np.tril(lower, -1).T
    step = np.random.default_rng(2).normal(size=z.size)
    slopes = [damped.gradient(z + s * 1e-4 * step) for s in (1.0, -1.0)]
    assert whole @ step == pytest.approx((slopes[0] - slopes[1]) / 2e-4, abs=1e-7)


def test_damping_leaves_no_bias_in_a_refined_optimum():
    refined = collocation.compile(bang_bang.build()).solve(tolerance=1e-7)
    assert refined.status is Status.CONVERGED
    assert refined.objective == pytest.approx(bang_bang.objective(), rel=1e-7)


# A mass moved in 1 s with |u| <= 5 holds that until 1/2 - b, then falls to the other limit: of the
# speed it needs b^2 = 3 (1/4 - 1/5), of effort 25 (1/2 - 2 b / 3).
MOST = 5.0
EFFORT = MOST**2 * (1 / 2 - 2 / 3 * np.sqrt(3 * (1 / 4 - 1 / MOST)))


def limited_mass():
    m = double_integrator.build()
    m.most = Constraint(m.t, rule=lambda m, t: inequality(-MOST, m.u[t], MOST))
    return collocation.compile(m)


@pytest.mark.lengthy
def test_limits_that_move_leave_no_more_than_the_tolerance():
    problem, tolerance = limited_mass(), 1e-8
    for limits_move in (False, True):
        options = RefinementOptions(limits_move=limits_move)
        found = problem.solve(tolerance=tolerance, refinement=options)
        assert found.status is Status.CONVERGED
        assert found.objective == pytest.approx(EFFORT, rel=tolerance)


def searched(solution, *, iterations, by):
    """A solution as if a search had taken so long and moved its control at the fifth point."""
    held = solution.trajectory
    algebraics = np.array(held.algebraics)
    algebraics[4] += by
    line = replace(solution.iterations[-1], iteration=iterations)
    moved = replace(held, algebraics=algebraics)
    return replace(solution, trajectory=moved, iterations=(line,))


def refined_by(searches):
    return refine(
        lambda *_, **_settings: next(searches),
        meshes=(MESH,),
        tolerance=1e-9,
        refinement=RefinementOptions(max_meshes=4),
        start=AT_THE_MODEL,
    )


def test_long_searches_that_gain_nothing_end_and_say_what_still_moves(solution):
    told = ((180, 0.0), (200, 0.5), (300, 0.0), (9, 0.0))
    lost = refined_by(searched(solution, iterations=n, by=by) for n, by in told)
    assert lost.status is Status.TOLERANCE_NOT_MET
    assert len(lost.history) == 3
    time = solution.times[5]
    for words in (
        "the last two took 200 and 300 iterations without progress",
        f"u still changes, at time {time:.4g} by 25% of its range",
    ):
        assert words in lost.message


@pytest.mark.parametrize("iterations", [(180, 9, 300, 9), (180, 300, 9, 200)])
def test_a_long_search_by_itself_ends_nothing(solution, iterations):
    ended = refined_by(searched(solution, iterations=n, by=0.0) for n in iterations)
    assert len(ended.history) == 4


def test_a_warm_mesh_begins_with_a_barrier_that_leaves_what_the_objective_may_change():
    finished, tolerance = [], 1e-8
    refinement = RefinementOptions(on_mesh=finished.append)
    collocation.solve(bryson_denham.build(), tolerance=tolerance, refinement=refinement)
    assert len(finished) > 2
    for before, last, now in zip(finished, finished[1:], finished[2:], strict=False):
        left = now.iterations[0].barrier * now.bounds.sides / now.scaling.objective
        changed = abs(last.objective - before.objective)
        assert left <= 1.001 * max(changed, tolerance * abs(now.objective))


def test_a_refinement_continues_from_a_known_solution_without_solving_its_mesh_again():
    problem, mesh = collocation.compile(bryson_denham.build()), Mesh.uniform(3, 3)
    known = problem.solve(mesh=mesh)
    solved = []
    continued = problem.solve(
        mesh=mesh,
        warm_start=known,
        tolerance=1e-6,
        refinement=RefinementOptions(known=known),
        progress=lambda line: solved.append(line.mesh_points),
    )
    assert continued.status is Status.CONVERGED
    assert continued.objective == pytest.approx(4.0 / (9.0 * bryson_denham.WALL), rel=1e-5)
    first, *rest = continued.history
    assert (first.points, first.objective) == (mesh.points, known.objective)
    assert set(solved) == {record.points for record in rest}


def test_a_known_solution_within_the_tolerance_is_the_result():
    problem = collocation.compile(double_integrator.build())
    known = problem.solve(tolerance=1e-7)
    solved = []
    again = problem.solve(
        mesh=known.mesh,
        warm_start=known,
        tolerance=1e-5,
        refinement=RefinementOptions(known=known),
        progress=solved.append,
    )
    assert (again.objective, again.mesh) == (known.objective, known.mesh)
    assert not solved


def test_a_refinement_that_ended_above_its_tolerance_can_be_continued():
    problem = collocation.compile(bryson_denham.build())
    cut = problem.solve(
        mesh=Mesh.uniform(3, 3), tolerance=1e-6, refinement=RefinementOptions(max_meshes=1)
    )
    assert cut.status is Status.TOLERANCE_NOT_MET
    told = {"mesh": cut.mesh, "warm_start": cut, "tolerance": 1e-6}
    continued = problem.solve(**told, refinement=RefinementOptions(known=cut))
    assert continued.status is Status.CONVERGED
    assert continued.objective == pytest.approx(4.0 / (9.0 * bryson_denham.WALL), rel=1e-5)
