"""What the barrier leaves of an objective that large slopes scale down."""

from dataclasses import replace

import pytest
from pyomo.dae import ContinuousSet, DerivativeVar, Integral
from pyomo.environ import ConcreteModel, Constraint, Objective, RangeSet, Var

from pyomo_quad.collocation import Mesh, SolverOptions, compile, solve
from pyomo_quad.collocation.program.ipopt import StartDistance
from pyomo_quad.collocation.refining.damping import damping_of
from pyomo_quad.collocation.refining.error import estimate_error
from tests.problems import bang_bang, double_integrator

LEAST = 1e-6


def test_a_steep_first_point_does_not_hide_what_many_bounds_cost():
    m = ConcreteModel()
    m.i = RangeSet(300)
    m.x = Var(m.i, bounds=(LEAST, None), initialize=1e-3)
    m.y = Var(initialize=1e3)
    m.cost = Objective(expr=sum(m.x[i] for i in m.i) + 100 * (m.y - 3) ** 2)
    solution = solve(m)
    assert solution.is_converged
    assert solution.objective == pytest.approx(300 * LEAST, rel=1e-6)


def tank():
    """What flows in costs next to nothing, and the first point costs a lot."""
    m = ConcreteModel()
    m.t = ContinuousSet(bounds=(0, 1))
    m.x, m.u = Var(m.t, initialize=1e4), Var(m.t, bounds=(LEAST, None), initialize=1)
    m.dx_dt = DerivativeVar(m.x, wrt=m.t)
    m.flow = Constraint(m.t, rule=lambda m, t: m.dx_dt[t] == m.u[t] - LEAST)
    m.price = Integral(m.t, wrt=m.t, rule=lambda m, t: m.u[t])
    m.cost = Objective(expr=m.price + 100 * m.x[1] ** 2)
    return m


def test_a_refinement_goes_on_to_what_the_scaling_hid():
    problem = compile(tank())
    options = SolverOptions(tolerance=1e-9)
    mesh, instance = Mesh.uniform(5, 3), problem.instance()
    hidden = problem.solve_on_mesh(mesh, instance=instance, options=options)
    assert hidden.objective > 2 * LEAST
    solution = problem.solve(tolerance=1e-6)
    assert solution.is_converged
    assert solution.objective == pytest.approx(LEAST, rel=1e-3)


def test_the_gap_is_part_of_the_error():
    problem = compile(double_integrator.build())
    loose = problem.solve(mesh=Mesh.uniform(5, 4), options=SolverOptions(tolerance=1e-2))
    assert estimate_error(loose).gap == pytest.approx(0.0, abs=1e-12)  # it has no bounds
    bounded = compile(bang_bang.build())
    solved = bounded.solve_on_mesh(
        Mesh.uniform(5, 4),
        instance=bounded.instance(),
        options=SolverOptions(tolerance=1e-4),
    )
    exact = bounded.solve(mesh=solved.mesh, options=SolverOptions(tolerance=1e-10))
    missed = abs(solved.objective / exact.objective - 1.0)
    assert 0.3 * missed <= estimate_error(solved).gap <= 30 * missed
    assert estimate_error(solved).largest >= estimate_error(solved).gap > 0.0


def test_the_farther_the_next_solution_the_larger_is_the_barrier_that_a_warm_start_begins_with():
    coarse = solve(double_integrator.build(), mesh=Mesh.uniform(2, 3))
    ways = {
        damping_of(replace(coarse, error_estimate=error), 0.0, gap=1e-6).start_distance: error
        for error in (1.0, 1e-4)
    }
    assert ways == {StartDistance.FAR: 1.0, StartDistance.SHORT: 1e-4}
    assert damping_of(coarse, 0.0, gap=1e-6, is_still=True).start_distance is StartDistance.NONE
    told = SolverOptions().for_moving_limits()
    chosen = [
        dict(told.on_central_path(1e-9, far).extra)
        for far in (StartDistance.NONE, StartDistance.SHORT, StartDistance.FAR)
    ]
    for name in ("mu_init", "warm_start_bound_push", "warm_start_slack_bound_push"):
        numbers = [options[name] for options in chosen]
        assert numbers == sorted(set(numbers))
    assert {options["mu_target"] for options in chosen} == {1e-9}


def test_a_first_point_far_from_its_limits_begins_with_a_large_barrier_and_a_warm_start_does_not():
    problem, mesh = compile(bang_bang.build()), Mesh.uniform(10, 4)
    usual = problem.solve(mesh=mesh)
    far = SolverOptions().from_afar()
    begun = []
    cold = problem.solve(mesh=mesh, options=far, progress=begun.append)
    assert begun[0].barrier == pytest.approx(0.1)
    assert cold.objective == pytest.approx(usual.objective, rel=1e-6)
    begun.clear()
    warm = problem.solve(mesh=mesh, options=far, warm_start=cold, progress=begun.append)
    assert begun[0].barrier < 1e-3
    assert warm.objective == pytest.approx(usual.objective, rel=1e-6)
