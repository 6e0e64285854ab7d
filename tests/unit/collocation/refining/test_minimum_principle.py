"""Controls that are right for small changes only, on a problem with two valleys."""

from dataclasses import replace

import numpy as np
import pytest
from pyomo.dae import ContinuousSet, DerivativeVar, Integral
from pyomo.environ import ConcreteModel, Constraint, Objective, Var
from scipy.optimize import minimize_scalar

from pyomo_quad.collocation import Mesh, RefinementOptions, Status, compile
from pyomo_quad.collocation.refining import minimum_principle
from pyomo_quad.collocation.refining.minimum_principle import improved_controls
from pyomo_quad.collocation.refining.refinement import _Reached, _result_above_tolerance
from tests.problems import bang_bang, bryson_denham
from tests.problems.published.chemistry import oil_shale
from tests.problems.published.mechanics import singular_control


def two_valleys(first):
    """A control whose valleys near 1 and -1 are as deep at one time, then not any more."""
    m = ConcreteModel()
    m.t = ContinuousSet(bounds=(0, 1))
    m.x, m.u = Var(m.t), Var(m.t, bounds=(-1.5, 1.5), initialize=first)
    m.dx = DerivativeVar(m.x, wrt=m.t)
    m.law = Constraint(m.t, rule=lambda m, t: m.dx[t] == (m.u[t] ** 2 - 1) ** 2)
    m.x[0].fix(0)
    m.tilt = Integral(m.t, wrt=m.t, rule=lambda m, t: (t - 0.3) * m.u[t])
    m.cost = Objective(expr=m.x[1] + m.tilt)
    return m


def deepest():
    """Of each time on its own, by a search of both valleys, and the mean of it."""
    points, weights = np.polynomial.legendre.leggauss(20)

    def floor(t):
        valleys = [(-1.5, 0.0), (0.0, 1.5)]
        return min(
            minimize_scalar(
                lambda u: (u**2 - 1) ** 2 + (t - 0.3) * u,
                bounds=v,
                method="bounded",
                options={"xatol": 1e-12},
            ).fun
            for v in valleys
        )

    parts = ((0.0, 0.3), (0.3, 1.0))
    return sum(
        (b - a) / 2 * w * floor((a + b) / 2 + (b - a) / 2 * p)
        for a, b in parts
        for p, w in zip(points, weights, strict=True)
    )


@pytest.mark.parametrize("first", [-0.9, 0.9])
def test_a_control_finds_the_deeper_valley_from_either(first):
    solution = compile(two_valleys(first)).solve(tolerance=1e-6)
    assert solution.is_converged
    assert solution.objective == pytest.approx(deepest(), abs=2e-6)


def test_without_the_principle_it_would_stay_in_the_valley_it_began_in(monkeypatch):
    refinement = "pyomo_quad.collocation.refining.refinement.improved_controls"
    monkeypatch.setattr(refinement, lambda *_: None)
    solution = compile(two_valleys(0.9)).solve(tolerance=1e-6)
    assert solution.objective > deepest() + 0.1
    improved = improved_controls(solution, 1e-6)
    assert improved.trajectory.algebraics[-1, 0] < 0 < solution.trajectory.algebraics[-1, 0]


def test_what_could_not_be_improved_says_so(monkeypatch):
    limit = "pyomo_quad.collocation.refining.refinement.MOST_RESTARTS"
    monkeypatch.setattr(limit, 0)
    solution = compile(two_valleys(0.9)).solve(tolerance=1e-6)
    assert solution.status is Status.TOLERANCE_NOT_MET
    assert "another control improves the objective by more than the tolerance" in solution.message


@pytest.mark.parametrize("problem", [bang_bang, bryson_denham])
def test_nothing_is_better_than_an_optimum(problem):
    solution = compile(problem.build()).solve(tolerance=1e-6)
    assert improved_controls(solution, 1e-6) is None


def test_a_limit_broken_by_less_than_the_solver_allows_is_no_reason_to_move():
    m = two_valleys(0.9)
    m.cap = Constraint(m.t, rule=lambda m, t: m.u[t] ** 2 <= 0.8)
    solution = compile(m).solve(tolerance=1e-6)
    assert improved_controls(solution, 1e-6) is None
    unknowns = np.array(solution.unknowns)
    unknowns[solution.program.layout.algebraic_columns] *= 1.0 + 1e-8
    trajectory = replace(
        solution.trajectory, algebraics=(1.0 + 1e-8) * solution.trajectory.algebraics
    )
    beyond = replace(solution, unknowns=unknowns, trajectory=trajectory)
    assert improved_controls(beyond, 1e-6) is None


def test_a_control_that_an_equation_gives_is_not_moved():
    m = two_valleys(0.9)
    m.w = Var(m.t, bounds=(-1, 1))
    m.given = Constraint(m.t, rule=lambda m, t: m.w[t] == m.u[t] / 2)
    solution = compile(m).solve(refinement=RefinementOptions(max_meshes=1), tolerance=1e-2)
    program = solution.program
    columns = program.layout.algebraic_columns
    bounds = solution.bounds.lower[columns], solution.bounds.upper[columns]
    assert minimum_principle._free_controls(program, *bounds).size == 0


@pytest.mark.slow
def test_a_looser_tolerance_finds_the_same_optimum_of_the_oil_shale():
    problem = compile(oil_shale())
    loose, tight = (problem.solve(tolerance=tolerance) for tolerance in (1e-6, 1e-8))
    claimed = loose.error_estimate + tight.error_estimate
    assert abs(loose.objective - tight.objective) <= 2 * claimed


@pytest.mark.slow
@pytest.mark.parametrize("tolerance", [1e-5, 1e-6])
def test_restarts_that_earn_nothing_leave_what_was_reached(tolerance):
    solution = compile(singular_control()).solve(tolerance=tolerance)
    assert solution.is_converged
    assert solution.error_estimate <= tolerance
    finer = compile(singular_control()).solve(mesh=Mesh.uniform(120, 3))
    assert solution.objective <= finer.objective * (1.0 + 2.0 * tolerance)


def test_a_restart_that_earns_less_than_the_tolerance_is_the_last(monkeypatch):
    """Whatever is found the same once more is not started again."""
    refinement = "pyomo_quad.collocation.refining.refinement.improved_controls"
    asked = []
    monkeypatch.setattr(refinement, lambda found, _tolerance: asked.append(found) or found)
    solution = compile(bang_bang.build()).solve(tolerance=1e-6)
    assert solution.is_converged
    assert solution.objective == pytest.approx(bang_bang.objective(), rel=1e-6)
    assert len(asked) == 1


def test_a_lost_restart_refutes_only_by_a_better_solution():
    found = compile(bang_bang.build()).solve(tolerance=1e-4)
    unit, error = found.nominal_objective, 1e-3
    for earned, status in (
        (0.5 * error, Status.CONVERGED),
        (2.0 * error, Status.TOLERANCE_NOT_MET),
    ):
        reached = _Reached(found)
        reached.compare(replace(found, objective=found.objective - earned * unit), error)
        assert _result_above_tolerance(found, reached, 1e-4).status is status
    assert _result_above_tolerance(found, _Reached(found), 1e-4).status is Status.TOLERANCE_NOT_MET
