"""What a breach of a limit counts and what a local error becomes, against closed forms.

The optimum of Bryson and Denham is 4 / (9 l) for a wall at l: moving it by d earns 4 / (9 l^2) d.
"""

import numpy as np
import pytest
from pyomo.environ import Constraint, Var
from scipy.integrate import solve_ivp

from pyomo_quad import collocation
from pyomo_quad.collocation import Allowance, Mesh, control_polynomial
from pyomo_quad.collocation.refining.error import estimate_error, final_misses
from tests.problems import bang_bang, double_integrator, hyper_sensitive, implicit_dae
from tests.problems.bryson_denham import WALL, build

EARNED_PER_METRE = 4 / (9 * WALL**2)


@pytest.fixture(scope="module")
def solution():
    return collocation.compile(build()).solve(mesh=Mesh.uniform(7, 3))


@pytest.fixture(scope="module")
def breach(solution):
    """The worst breach at many times, in metres; the wall is below 1, hence relative to 1."""
    return float(np.max(solution.value("x", np.linspace(0.0, 1.0, 20_001)))) - WALL


def test_a_breach_counts_as_it_is_unless_it_is_forgiven(solution, breach):
    assert breach > 1e-6
    assert estimate_error(solution).violation.max() >= 0.9 * breach


def test_a_forgiven_breach_counts_by_what_it_earns(solution, breach):
    forgiven = estimate_error(solution, allowance=Allowance(limit_breach=2.0 * breach)).violation
    relative = EARNED_PER_METRE * breach / solution.objective
    assert 0.0 < forgiven.sum() <= 1.01 * relative


def test_a_breach_above_what_is_forgiven_is_not(solution, breach):
    strict, lax = (
        estimate_error(solution, allowance=Allowance(limit_breach=b)) for b in (0.0, 0.5 * breach)
    )
    assert lax.violation.max() == pytest.approx(strict.violation.max())


def test_a_limit_on_a_rate_counts_as_the_same_limit_on_the_control_that_it_equals():
    bounded, stated = bang_bang.build(), bang_bang.build()
    lower, upper = (getattr(bounded.u[0], side) for side in ("lb", "ub"))
    for t in stated.tau:
        stated.u[t].setlb(None)
        stated.u[t].setub(None)
    stated.most = Constraint(stated.tau, rule=lambda m, t: m.dv_dtau[t] / m.duration <= upper)
    stated.least = Constraint(stated.tau, rule=lambda m, t: m.dv_dtau[t] / m.duration >= lower)
    found = [
        estimate_error(collocation.compile(m).solve(mesh=Mesh.uniform(4, 4))).violation
        for m in (bounded, stated)
    ]
    assert found[0].max() > 1e-3
    assert found[1] == pytest.approx(found[0], rel=1e-3, abs=1e-6)


@pytest.mark.lengthy
@pytest.mark.parametrize("breach", [0.0, 0.01])
def test_a_control_held_to_its_limit_misses_what_its_flight_does(breach):
    # The switch lies inside an element, and the polynomial goes beyond both limits beside it.
    solution = collocation.compile(bang_bang.build()).solve(mesh=Mesh.uniform(4, 4))
    mesh, path = solution.mesh, solution.trajectory
    dynamics = solution.problem.dynamics(statics=path.statics)
    limits = dynamics.control_limits(breach)
    assert limits[0] == pytest.approx([-2.0 * (1.0 + breach)], abs=1e-12)
    assert limits[1] == pytest.approx([1.0 + breach], abs=1e-12)
    state = path.states[0]
    for e in range(mesh.elements):
        start, end = solution.times[mesh.first_node[[e, e + 1]]]
        held = control_polynomial(mesh, path.algebraics, e, start, end, limits)
        flown = solve_ivp(
            lambda t, x, held=held: dynamics.rates(t, x, held(t)),
            (start, end),
            state,
            max_step=(end - start) / 500,
        )
        state = flown.y[:, -1]
    missed = abs(dict(zip(dynamics.state_names, state, strict=True))["v"])
    assert missed > 0.5
    allowance = Allowance(control_breach=breach, final_miss=1.0)
    estimate = estimate_error(solution, tolerance=1.0, allowance=allowance)
    assert estimate.miss.max() == pytest.approx(missed, rel=0.05)
    assert estimate.violation.max() <= breach + 1e-12
    assert estimate_error(solution).violation.max() > 0.01


def test_a_limit_on_controls_together_counts_as_a_bound_does():
    bounded, together = bang_bang.build(), bang_bang.build()
    for t in together.tau:
        together.u[t].setlb(None)
        together.u[t].setub(None)
    together.idle = Var(together.tau, bounds=(0, 0), initialize=0)
    lower, upper = bounded.u[0].bounds
    together.limit = Constraint(together.tau, rule=lambda m, t: (lower, m.u[t] + m.idle[t], upper))
    found = [
        estimate_error(collocation.compile(m).solve(mesh=Mesh.uniform(7, 4))).violation
        for m in (bounded, together)
    ]
    assert found[0].max() > 1e-3
    assert found[1] == pytest.approx(found[0], abs=1e-6)


SIZE = 1e-3


def misses_of(problem, mesh):
    solution = collocation.compile(problem.build()).solve(mesh=mesh)
    states = solution.problem.compiled.declared.states
    errors = np.full((mesh.elements, len(states)), SIZE)
    return solution, [s.name for s in states], final_misses(solution, errors)


def test_an_error_of_speed_grows_with_the_time_that_is_left():
    mesh = Mesh(breakpoints=(0.0, 0.2, 0.7, 1.0), degrees=(3, 2, 4))
    _, names, misses = misses_of(double_integrator, mesh)
    left = 1.0 - np.array(mesh.breakpoints[1:])
    assert misses[:, names.index("x")] == pytest.approx(SIZE * (1.0 + left), rel=1e-10)
    assert misses[:, names.index("v")] == pytest.approx(np.full(3, SIZE), rel=1e-10)


def test_an_error_of_a_stable_state_decays():
    mesh = Mesh.uniform(40, 4)
    solution, _, misses = misses_of(hyper_sensitive, mesh)
    left = solution.horizon[1] * (1.0 - np.array(mesh.breakpoints[1:]))
    assert misses[:, 0] == pytest.approx(SIZE * np.exp(-left), rel=1e-3)


def test_a_rate_inside_a_nonlinear_equation_is_solved_for():
    # The force alone gives the rate: an error is neither damped nor amplified.
    _, _, misses = misses_of(implicit_dae, Mesh.uniform(3, 3))
    assert misses[:, 0] == pytest.approx(np.full(3, SIZE), rel=1e-10)
