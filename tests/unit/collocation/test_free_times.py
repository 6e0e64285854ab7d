"""Declared times that static variables give: closed forms, a published value, a second writing."""

import math
import pickle

import casadi
import numpy as np
import pytest
from pyomo.dae import ContinuousSet, DerivativeVar, Integral
from pyomo.environ import ConcreteModel, Constraint, Objective, Param, SolverFactory, Var
from scipy.integrate import solve_ivp
from scipy.optimize import minimize_scalar

from pyomo_quad.collocation import Mesh, TranscriptionError, compile, solve
from pyomo_quad.flight.verification import fly_controls
from tests.problems import goddard
from tests.starts import assert_begins_at, noted_starts


def push_and_brake(declared=(0, 1, 2)):
    """Rest to rest over 1 m: at most 1 m/s2 until T1, at most 2 m/s2 against it from then on."""
    m = ConcreteModel()
    m.t = ContinuousSet(initialize=declared)
    switch, end = declared[1], declared[-1]
    m.x, m.v = Var(m.t), Var(m.t)
    m.u = Var(m.t, bounds=lambda _m, t: (0, 1) if t <= switch else (-2, 0))
    m.T1, m.T2 = Var(bounds=(0.1, 5)), Var(bounds=(0.1, 10))
    m.dx_dt, m.dv_dt = DerivativeVar(m.x, wrt=m.t), DerivativeVar(m.v, wrt=m.t)
    m.motion = Constraint(m.t, rule=lambda m, t: m.dx_dt[t] == m.v[t])
    m.force = Constraint(m.t, rule=lambda m, t: m.dv_dt[t] == m.u[t])
    for state, first, last in ((m.x, 0, 1), (m.v, 0, 0)):
        state[0].fix(first)
        state[end].fix(last)
    m.cost = Objective(expr=m.T2)
    return m


# Where the speed of one triangle, T1, is that of the other, 2 (T2 - T1), and their areas make 1.
SWITCH = math.sqrt(4 / 3)


@pytest.fixture(scope="module")
def pushed():
    m = push_and_brake()
    return m, solve(m, times={1: m.T1, 2: m.T2}, tolerance=1e-8)


def test_the_switch_of_a_minimum_time_problem(pushed):
    m, solution = pushed
    assert solution.objective == pytest.approx(1.5 * SWITCH, abs=1e-7)
    assert solution.horizon == pytest.approx((0.0, 1.5 * SWITCH), abs=1e-7)
    # The optimum is flat in the switch: its error is the root of the objective's.
    assert solution.value(m.T1) == pytest.approx(SWITCH, abs=1e-5)
    assert solution.timeline.times[1] == solution.value(m.T1)


def test_values_are_asked_for_in_the_time_that_was_found(pushed):
    m, solution = pushed
    t = np.linspace(0.0, 1.5 * SWITCH, 31)
    speed = np.where(t < SWITCH, t, 2 * (1.5 * SWITCH - t))
    np.testing.assert_allclose(solution.value(m.v, t.clip(*solution.horizon)), speed, atol=1e-6)
    frame = solution.to_frame()
    assert frame["time"].is_monotonic_increasing
    assert frame["v"].max() == pytest.approx(SWITCH, abs=1e-5)
    assert (m.x[1].value, m.v[1].value) == pytest.approx((SWITCH**2 / 2, SWITCH), abs=1e-5)


def test_costates_are_the_prices_of_the_ends(pushed):
    m, solution = pushed
    # T2 = sqrt(3 x(T2)) and H = 1 + p_x v + p_v u = 0 per second of cost T2.
    assert solution.costate(m.x, [0.5, 1.5]) == pytest.approx([-0.75 * SWITCH] * 2, rel=1e-4)
    assert solution.hamiltonian([0.2, 1.0, 1.3, 1.6]) == pytest.approx([-1.0] * 4, rel=1e-4)


def test_dynamics_flown_by_scipy_arrive(pushed):
    _, solution = pushed
    flow = solution.dynamics
    state = np.zeros(2)
    for first, last, control in ((0.0, SWITCH, 1.0), (SWITCH, 1.5 * SWITCH, -2.0)):
        start = flow.just_after(first)
        flown = solve_ivp(
            lambda t, x, u=control: flow.rates(t, x, np.array([u])),
            (start, last),
            state,
            rtol=1e-10,
            atol=1e-12,
        )
        state = flown.y[:, -1]
    assert state == pytest.approx([1.0, 0.0], abs=1e-6)


def test_controls_flown_on_the_mesh_in_time_arrive():
    m = with_waypoint()
    solution = solve(m, times={1: m.T1}, tolerance=1e-8)
    start, end = solution.horizon
    nodes = start + (end - start) * solution.mesh_in_time.node_fractions
    np.testing.assert_allclose(nodes, solution.times, atol=1e-12)
    path = solution.trajectory
    flown = fly_controls(
        solution.dynamics, solution.mesh_in_time, path.algebraics, path.states[0], (start, end)
    )
    assert flown.states[-1] == pytest.approx([1.0, 0.0], abs=1e-6)
    assert flown.energy[-1] == pytest.approx(solution.objective, rel=1e-6)


@pytest.mark.lengthy
def test_declared_times_only_say_where_the_phases_meet():
    m = push_and_brake(declared=(0, 0.3, 7))
    solution = solve(m, times={"t": {0.3: m.T1, 7: m.T2}})
    assert solution.objective == pytest.approx(1.5 * SWITCH, rel=1e-6)


@pytest.mark.lengthy
def test_a_warm_start_and_a_pickle_honour_the_times():
    m = push_and_brake()
    problem = compile(m, times={1: m.T1, 2: m.T2})
    cold = problem.solve()
    with noted_starts() as starts:
        warm = pickle.loads(pickle.dumps(problem)).solve(warm_start=cold)
    assert_begins_at(starts[0], cold)
    assert warm.objective == pytest.approx(cold.objective, rel=1e-6)


def with_waypoint(price=0.0):
    """1 m of a unit mass for the least effort, through x = 0.7 at T1 of 2 s."""
    m = ConcreteModel()
    m.t = ContinuousSet(initialize=[0, 1, 2])
    m.x, m.v, m.u = Var(m.t), Var(m.t), Var(m.t)
    m.T1 = Var(bounds=(0.1, 1.9), initialize=0.5)
    m.cargo = Param(initialize=1.0, mutable=True)
    m.dx_dt, m.dv_dt = DerivativeVar(m.x, wrt=m.t), DerivativeVar(m.v, wrt=m.t)
    m.motion = Constraint(m.t, rule=lambda m, t: m.dx_dt[t] == m.v[t])

    @m.Constraint(m.t)
    def force(m, t):
        mass = 1 + m.cargo if t <= 1 else 1
        return mass * m.dv_dt[t] == m.u[t] - 0.3 * m.v[t] * m.v[t]

    for state, first, last in ((m.x, 0, 1), (m.v, 0, 0)):
        state[0].fix(first)
        state[2].fix(last)
    m.passes = Constraint(expr=m.x[1] == 0.7)
    m.effort = Integral(m.t, rule=lambda m, t: m.u[t] ** 2 / 2)
    m.cost = Objective(expr=m.effort + price * m.T1)
    return m


def by_hand(elements, degree):
    """Return the optimum and T1 of `with_waypoint`, written for CasADi's own Ipopt."""
    points = np.array(casadi.collocation_points(degree, "radau"))
    slopes, _, weights = casadi.collocation_coeff(points)
    slopes = np.array(slopes)
    opti = casadi.Opti()
    switch, cost = opti.variable(), 0
    opti.set_initial(switch, 0.5)
    x = casadi.DM([0, 0])
    for mass, span in ((2, switch), (1, 2 - switch)):
        width = span / elements
        for _ in range(elements):
            inner, u = opti.variable(2, degree), opti.variable(1, degree)
            rates = casadi.horzcat(x, inner) @ slopes / width
            opti.subject_to(rates[0, :] == inner[1, :])
            opti.subject_to(mass * rates[1, :] == u - 0.3 * inner[1, :] ** 2)
            cost += width * (u**2 / 2) @ weights
            x = inner[:, -1]
        opti.subject_to(x[0] == (0.7 if mass == 2 else 1))
    opti.subject_to(x[1] == 0)
    opti.minimize(cost)
    opti.solver("ipopt", {"print_time": False}, {"print_level": 0, "sb": "yes", "tol": 1e-12})
    found = opti.solve()
    return found.value(cost), found.value(switch)


def test_a_jump_of_mass_agrees_with_a_program_by_hand():
    m = with_waypoint()
    solution = compile(m, times={1: m.T1}).solve(mesh=Mesh.uniform(6, 4))
    objective, switch = by_hand(3, 4)
    assert solution.objective == pytest.approx(objective, rel=1e-9)
    assert solution.value(m.T1) == pytest.approx(switch, rel=1e-7)
    # A control at the time where it jumps is that of the phase that ends there.
    at, beside = solution.value(m.T1), 1e-6
    before, exactly, after = solution.value(m.u, [at - beside, at, at + beside])
    assert exactly == pytest.approx(before, rel=1e-4)
    assert abs(after - before) > 0.3 * abs(before)


def test_the_hamiltonian_is_the_same_on_both_sides_of_a_free_time():
    m = with_waypoint()
    solution = solve(m, times={1: m.T1}, tolerance=1e-9)
    before, after = solution.hamiltonian(solution.value(m.T1) + np.array([-1e-3, 1e-3]))
    assert before == pytest.approx(after, rel=1e-5)
    assert solution.warnings == ()


def test_three_phases_of_a_rocket():
    m = goddard.build()
    problem = compile(m, times=goddard.times(m))
    cold = problem.solve()
    assert cold.is_converged
    assert cold.objective == pytest.approx(goddard.objective(), rel=1e-7)
    assert "times: 0, 13.75" in repr(cold)
    # The thrust is on its bound for a phase, and so is the mass: there is no interior between the
    # bound and the equation, and yet the multipliers are of use.
    with noted_starts() as starts:
        warm = problem.solve(warm_start=cold)
    assert_begins_at(starts[0], cold)
    assert warm.objective == pytest.approx(goddard.objective(), rel=1e-7)
    assert np.all(warm.unknowns >= warm.bounds.lower)
    assert np.all(warm.unknowns <= warm.bounds.upper)


def test_time_itself_has_a_derivative_in_each_phase():
    # x' = t until T1, 0 then: x(T1) = T1^2 / 2, and T1 - T1^2 / 2 + (T2 - 3)^2 has its limits.
    m = ConcreteModel()
    m.t = ContinuousSet(initialize=[0, 1, 2])
    m.x, m.T1, m.T2 = Var(m.t), Var(bounds=(0.5, 2)), Var(bounds=(1, 9))
    m.dx_dt = DerivativeVar(m.x, wrt=m.t)
    m.motion = Constraint(m.t, rule=lambda m, t: m.dx_dt[t] == (t if t <= 1 else 2 * t))
    m.x[0].fix(0)
    m.cost = Objective(expr=(m.x[2] - 3) ** 2 + (m.T1 - 1) ** 2)
    solution = solve(m, times={1: m.T1, 2: m.T2}, tolerance=1e-9)
    # T1^2 / 2 + T2^2 - T1^2 = 3 with T1 = 1.
    assert (solution.value(m.T1), solution.value(m.T2)) == pytest.approx((1, math.sqrt(3.5)))


def test_a_condition_at_a_free_time_reads_the_time_that_is_found():
    # Least effort to meet at T1 what flees from 1 m at 0.5 m/s: 3 (1 + T / 2)^2 / (2 T^3) + T.
    m = with_waypoint()
    m.del_component(m.passes), m.del_component(m.force), m.del_component(m.cost)
    m.x[2].unfix()
    m.v[2].unfix()
    m.T1.setub(None)
    m.T2 = Var(bounds=(0.1, 9))
    m.force = Constraint(m.t, rule=lambda m, t: m.dv_dt[t] == m.u[t])
    m.meets = Constraint(
        m.t, rule=lambda m, t: m.x[t] == 1 + 0.5 * t if t == 1 else Constraint.Skip
    )
    m.cost = Objective(expr=m.effort + m.T1)
    solution = solve(m, times={1: m.T1, 2: m.T2}, tolerance=1e-8)
    best = minimize_scalar(
        lambda t: 1.5 * (1 + 0.5 * t) ** 2 / t**3 + t,
        bounds=(0.5, 5),
        method="bounded",
        options={"xatol": 1e-10},
    )
    assert solution.objective == pytest.approx(best.fun, rel=1e-8)
    assert solution.value(m.T1) == pytest.approx(best.x, rel=1e-5)


def test_a_condition_that_reads_a_free_time_as_a_number():
    m = push_and_brake()
    m.wave = Constraint(m.t, rule=lambda m, t: m.x[t] <= math.exp(t) if t == 1 else Constraint.Skip)
    refused(
        m,
        r"^wave\[1\]: its rule reads its time as a number, which changes with a free time; compare",
        {1: m.T1, 2: m.T2},
    )


def test_the_pyomo_solver_takes_the_times():
    m = push_and_brake()
    SolverFactory("pyomo_quad").solve(m, times={1: m.T1, 2: m.T2})
    assert m.T1.value == pytest.approx(SWITCH, abs=1e-5)


def test_a_free_start():
    m = push_and_brake()
    m.T0 = Var(bounds=(-1, 1))
    m.del_component(m.cost)
    m.cost = Objective(expr=m.T2 - m.T0 + m.T0**2)
    solution = solve(m, times={0: m.T0, 1: m.T1, 2: m.T2})
    assert solution.objective == pytest.approx(1.5 * SWITCH, rel=1e-6)
    assert solution.value(m.T0) == pytest.approx(0.0, abs=1e-4)


def refused(m, match, times):
    with pytest.raises(TranscriptionError, match=match):
        solve(m, times=times)


def test_times_that_cross():
    m = push_and_brake()
    m.T1.setlb(3)
    m.T2.setub(2)
    refused(
        m, r"^t\[2\]: is at most 2, but t\[1\] before it is at least 3; relax", {1: m.T1, 2: m.T2}
    )


def test_a_time_before_the_start():
    m = push_and_brake()
    m.T1.setlb(None)
    m.T1.setub(-1)
    refused(m, r"t\[1\]: is at most -1, but t\[0\] before it is at least 0", {1: m.T1, 2: m.T2})


def test_a_time_that_is_not_declared():
    m = push_and_brake()
    refused(m, "times: 1.5 is not a declared time of t, which are 0, 1, 2", {1.5: m.T1})


def test_a_time_over_time():
    m = push_and_brake()
    refused(m, r"x\[1\]: t\[1\], a free time, must be a static variable", {1: m.x[1]})
    refused(m, r"3.0: t\[1\], a free time, must be a static variable", {1: 3.0})


def test_one_variable_for_two_times():
    m = push_and_brake()
    refused(m, r"times: T1 is given for t\[1\] and t\[2\], which leaves no", {1: m.T1, 2: m.T1})


def test_times_of_another_set():
    m = push_and_brake()
    refused(
        m, "times: tau is not a ContinuousSet of the model, which has t; give", {"tau": {1: m.T1}}
    )
