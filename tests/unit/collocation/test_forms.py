"""Models in the forms of modellers' files: without objective, in lists, in space, in blocks."""

import numpy as np
import pytest
from pyomo.dae import ContinuousSet, DerivativeVar, Integral
from pyomo.environ import (
    Block,
    ConcreteModel,
    Constraint,
    ConstraintList,
    Objective,
    Param,
    RangeSet,
    Set,
    TransformationFactory,
    Var,
    exp,
    sin,
    value,
)
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.optimize import brentq, least_squares

from pyomo_quad.collocation import Status, TranscriptionError, compile, solve

RATE = 2.0


def decay():
    """Declare x' = -2 x from 1 over one unit of time, without an objective."""
    m = ConcreteModel()
    m.t = ContinuousSet(bounds=(0, 1))
    m.x = Var(m.t, initialize=1.0)
    m.dx = DerivativeVar(m.x, wrt=m.t)
    m.ode = Constraint(m.t, rule=lambda m, t: m.dx[t] == -RATE * m.x[t])
    m.x[0].fix(1)
    return m


# Without an objective


@pytest.mark.parametrize("constant", [None, 0, 1.5])
def test_a_simulation(constant):
    m = decay()
    if constant is not None:
        m.objective = Objective(expr=constant)
    solution = solve(m, tolerance=1e-8)
    assert solution.is_converged
    times = np.linspace(0, 1, 11)
    assert solution.value(m.x, times) == pytest.approx(np.exp(-RATE * times), abs=1e-8)
    assert value(m.x[1]) == pytest.approx(np.exp(-RATE), abs=1e-8)
    assert solution.objective == (constant or 0)
    assert solution.warnings == ()


def test_a_simulation_with_an_output_and_a_parameter_as_objective():
    m = decay()
    m.price = Param(initialize=3.0, mutable=True)
    m.area = Var(m.t, initialize=0.0)
    m.darea = DerivativeVar(m.area, wrt=m.t)
    m.filling = Constraint(m.t, rule=lambda m, t: m.darea[t] == m.x[t])
    m.area[0].fix(0)
    m.objective = Objective(expr=m.price)
    assert solve(m, tolerance=1e-8).objective == 3.0
    assert value(m.area[1]) == pytest.approx((1 - np.exp(-RATE)) / RATE, abs=1e-8)


def test_a_nonlinear_simulation_agrees_with_another_integrator():
    m = ConcreteModel()
    m.t = ContinuousSet(bounds=(0, 6))
    m.x, m.y = Var(m.t, initialize=1.0), Var(m.t, initialize=0.5)
    m.dx, m.dy = DerivativeVar(m.x, wrt=m.t), DerivativeVar(m.y, wrt=m.t)
    m.prey = Constraint(m.t, rule=lambda m, t: m.dx[t] == m.x[t] * (1 - m.y[t]))
    m.hunters = Constraint(m.t, rule=lambda m, t: m.dy[t] == m.y[t] * (m.x[t] - 1))
    m.x[0].fix(1)
    m.y[0].fix(0.5)
    flown = solve_ivp(
        lambda _t, z: [z[0] * (1 - z[1]), z[1] * (z[0] - 1)], (0, 6), [1, 0.5], rtol=1e-11
    )
    solve(m, tolerance=1e-8)
    assert [value(m.x[6]), value(m.y[6])] == pytest.approx(flown.y[:, -1], rel=1e-6)


def test_a_point_that_meets_the_equations():
    m = decay()
    m.u = Var(m.t, bounds=(-3, 3), initialize=0.0)
    m.del_component(m.ode)
    m.ode = Constraint(m.t, rule=lambda m, t: m.dx[t] == m.u[t] - m.x[t])
    m.x[1].fix(1.2)
    solution = solve(m)
    assert solution.is_converged
    # Variation of constants, by quadrature on the elements: a control may jump between them.
    times, weights = solution.times[1:], solution.mesh.quadrature_weights
    pushed = weights @ (np.exp(times - 1) * solution.value(m.u, times))
    assert np.exp(-1) + pushed == pytest.approx(1.2, abs=1e-6)


def test_a_goal_out_of_reach_is_infeasible():
    m = decay()
    m.u = Var(m.t, bounds=(-3, 3), initialize=0.0)
    m.del_component(m.ode)
    m.ode = Constraint(m.t, rule=lambda m, t: m.dx[t] == m.u[t] - m.x[t])
    m.x[1].fix(3.0)
    assert solve(m).status is not Status.CONVERGED


def test_a_parameter_from_an_end_value():
    m = decay()
    m.k = Var(initialize=1.0)
    m.del_component(m.ode)
    m.ode = Constraint(m.t, rule=lambda m, t: m.dx[t] == -m.k * m.x[t])
    m.seen = Constraint(expr=m.x[1] == 0.2)
    solve(m, tolerance=1e-8)
    assert value(m.k) == pytest.approx(-np.log(0.2), rel=1e-8)


def test_equations_without_time():
    m = ConcreteModel()
    m.x = Var(initialize=1.0)
    m.balance = Constraint(expr=exp(m.x) + m.x == 3)
    solve(m)
    assert value(m.x) == pytest.approx(brentq(lambda x: np.exp(x) + x - 3, 0, 2), rel=1e-9)


# Lists of constraints


def listed(m):
    m.start = ConstraintList()
    m.start.add(m.x[0] == 1)


def from_a_generator(m):
    m.start = ConstraintList(rule=(m.x[t] == 1 for t in m.t if t == 0))


def from_a_rule_that_yields(m):
    @m.ConstraintList()
    def start(m):
        yield m.x[0] == 1
        yield m.x[1] >= -5
        yield ConstraintList.End


def from_a_rule_that_counts(m):
    said = {1: m.x[0] == 1}
    m.start = ConstraintList(rule=lambda _m, k: said.get(k, ConstraintList.End))


def in_a_block(m):
    m.part = Block([1, 2])
    m.part[2].start = ConstraintList(rule=lambda _b: (m.x[0] == k for k in [1]))


def over_declared_times(m):
    listed(m)
    for t in m.t:
        m.start.add(m.x[t] <= 2)


@pytest.mark.parametrize(
    "conditions",
    [
        listed,
        from_a_generator,
        from_a_rule_that_yields,
        from_a_rule_that_counts,
        in_a_block,
        over_declared_times,
    ],
)
def test_conditions_in_a_list(conditions):
    m = decay()
    m.x[0].unfix()
    conditions(m)
    solve(m, tolerance=1e-8)
    assert value(m.x[1]) == pytest.approx(np.exp(-RATE), abs=1e-8)


def test_a_measurement_list_is_fitted():
    at, seen = np.array([0.0, 0.25, 0.5, 0.75, 1.0]), np.array([1.02, 0.55, 0.4, 0.21, 0.15])
    m = ConcreteModel()
    m.t = ContinuousSet(initialize=at.tolist())
    m.k, m.error = Var(initialize=1.0), Var(range(5), initialize=0.0)
    m.x = Var(m.t, initialize=1.0)
    m.dx = DerivativeVar(m.x, wrt=m.t)
    m.ode = Constraint(m.t, rule=lambda m, t: m.dx[t] == -m.k * m.x[t])
    m.misses = ConstraintList()
    for j, t in enumerate(at.tolist()):
        m.misses.add(m.error[j] == m.x[t] - seen[j])
    m.objective = Objective(expr=sum(m.error[j] ** 2 for j in range(5)))
    fit = least_squares(lambda p: p[0] * np.exp(-p[1] * at) - seen, [1.0, 1.0], xtol=1e-14)
    solve(m, tolerance=1e-8)
    assert [value(m.x[0]), value(m.k)] == pytest.approx(fit.x, rel=1e-6)


def test_dynamics_in_a_list_are_refused():
    m = decay()
    m.del_component(m.ode)
    m.ode = ConstraintList(rule=(m.dx[t] == -RATE * m.x[t] for t in m.t))
    with pytest.raises(
        TranscriptionError, match="dx: no equation over time contains this derivative"
    ):
        solve(m)


# Space discretised beforehand

CELLS = 8  # Pyomo rounds points to six decimals, which leaves eighths as they are
FRACTION = 0.05  # of a unit of time: later, little is left


def laplacian(nodes):
    """Return the second difference on a unit interval with `nodes` inside, held at both ends."""
    ones = np.ones(nodes - 1)
    return (np.diag(ones, 1) + np.diag(ones, -1) - 2 * np.eye(nodes)) * (nodes + 1) ** 2


def profile(x):
    return x * (1 - x) * (2 + x)


@pytest.fixture
def bar():
    """A bar of a profile, cold at both ends; Pyomo's own example of a heat equation."""
    m = ConcreteModel()
    m.t, m.x = ContinuousSet(bounds=(0, FRACTION)), ContinuousSet(bounds=(0, 1))
    m.T = Var(m.x, m.t, initialize=0.5)
    m.dT_dt = DerivativeVar(m.T, wrt=m.t)
    m.initial = Constraint(
        m.x, rule=lambda m, x: m.T[x, 0] == profile(x) if 0 < x < 1 else Constraint.Skip
    )
    m.left = Constraint(m.t, rule=lambda m, t: m.T[0, t] == 0)
    m.right = Constraint(m.t, rule=lambda m, t: m.T[1, t] == 0)
    return m


def expected_bar():
    inside = np.arange(1, CELLS) / CELLS
    return expm(FRACTION * laplacian(CELLS - 1)) @ profile(inside)


def solved_bar(m):
    solve(m, tolerance=1e-8)
    return [value(m.T[x, FRACTION]) for x in list(m.x)[1:-1]]


def discretise(m, scheme, space=None):
    TransformationFactory("dae.finite_difference").apply_to(
        m, wrt=m.x if space is None else space, nfe=CELLS, scheme=scheme
    )


def test_a_second_derivative_by_central_differences(bar):
    bar.d2T_dx2 = DerivativeVar(bar.T, wrt=(bar.x, bar.x))
    bar.heat = Constraint(
        bar.x,
        bar.t,
        rule=lambda m, x, t: m.dT_dt[x, t] == m.d2T_dx2[x, t] if 0 < x < 1 else Constraint.Skip,
    )
    discretise(bar, "CENTRAL")
    assert solved_bar(bar) == pytest.approx(expected_bar(), abs=1e-7)


@pytest.mark.parametrize("start_too", [True, False])
def test_by_hand_over_a_set_of_nodes(start_too):
    m = ConcreteModel()
    m.t, m.x = ContinuousSet(bounds=(0, FRACTION)), RangeSet(0, CELLS)
    m.T = Var(m.x, m.t, initialize=0.5)
    m.dT_dt = DerivativeVar(m.T, wrt=m.t)

    @m.Constraint(m.x, m.t)
    def heat(m, x, t):
        if x in (0, CELLS) or (t == 0 and not start_too):
            return Constraint.Skip
        return m.dT_dt[x, t] == (m.T[x + 1, t] - 2 * m.T[x, t] + m.T[x - 1, t]) * CELLS**2

    for x in m.x:
        m.T[x, 0].fix(profile(x / CELLS))
    m.ends = Constraint([0, CELLS], m.t, rule=lambda m, x, t: m.T[x, t] == 0)
    assert solved_bar(m) == pytest.approx(expected_bar(), abs=1e-7)


def test_heating_is_optimised_through_a_discretised_bar(bar):
    # Least effort to a mean temperature: b' W^-1 b / 2 with the Gramian of the mean.
    bar.u = Var(bar.t, initialize=0.0)
    bar.d2T_dx2 = DerivativeVar(bar.T, wrt=(bar.x, bar.x))
    bar.heat = Constraint(
        bar.x,
        bar.t,
        rule=lambda m, x, t: (
            m.dT_dt[x, t] == m.d2T_dx2[x, t] + m.u[t] if 0 < x < 1 else Constraint.Skip
        ),
    )
    bar.effort = Integral(bar.t, wrt=bar.t, rule=lambda m, t: m.u[t] ** 2 / 2)
    bar.objective = Objective(expr=bar.effort)
    discretise(bar, "CENTRAL")
    inside = list(bar.x)[1:-1]
    bar.mean = Constraint(expr=sum(bar.T[x, FRACTION] for x in inside) == len(inside))
    ones, a = np.ones(CELLS - 1), laplacian(CELLS - 1)
    nodes, weights = np.polynomial.legendre.leggauss(30)
    at = FRACTION * (nodes + 1) / 2
    gramian = sum(
        w * FRACTION / 2 * (ones @ expm(a * t) @ ones) ** 2
        for t, w in zip(at, weights, strict=True)
    )
    missing = len(inside) - ones @ expected_bar()
    solution = solve(bar, tolerance=1e-8)
    assert solution.objective == pytest.approx(missing**2 / gramian / 2, rel=1e-8)


def test_a_flux_and_an_integral_over_space(bar):
    # Backward and forward differences in turn make the same second difference.
    bar.q = Var(bar.x, bar.t, initialize=0.0)
    bar.dT_dx, bar.dq_dx = DerivativeVar(bar.T, wrt=bar.x), DerivativeVar(bar.q, wrt=bar.x)
    bar.flux = Constraint(
        bar.x, bar.t, rule=lambda m, x, t: m.q[x, t] == m.dT_dx[x, t] if x > 0 else Constraint.Skip
    )
    step = 1 / CELLS
    bar.heat = Constraint(
        bar.x,
        bar.t,
        rule=lambda m, x, t: (
            m.dT_dt[x, t] == (m.q[m.x.next(x), t] - m.q[x, t]) / step
            if 0 < x < 1
            else Constraint.Skip
        ),
    )
    bar.del_component(bar.dq_dx)
    bar.content = Integral(bar.x, bar.t, wrt=bar.x, rule=lambda m, x, t: m.T[x, t])
    bar.lost = Integral(bar.t, wrt=bar.t, rule=lambda m, t: m.content[t])
    discretise(bar, "BACKWARD")
    bar.objective = Objective(expr=bar.lost)
    a = laplacian(CELLS - 1)
    start = profile(np.arange(1, CELLS) / CELLS)
    lost = np.sum(np.linalg.solve(a, expected_bar() - start)) / CELLS
    solution = solve(bar, tolerance=1e-8)
    assert [value(bar.T[x, FRACTION]) for x in list(bar.x)[1:-1]] == pytest.approx(
        expected_bar(), abs=1e-7
    )
    assert solution.objective == pytest.approx(lost, rel=1e-8)


def is_edge(x, y):
    return x in (0, 1) or y in (0, 1)


@pytest.mark.lengthy
@pytest.mark.parametrize("by_pyomo", [True, False])
def test_two_dimensions_of_space(by_pyomo):
    m = ConcreteModel()
    m.t = ContinuousSet(bounds=(0, FRACTION))
    nodes = {"initialize": np.linspace(0, 1, 5).tolist()}
    kind, how = (ContinuousSet, {"bounds": (0, 1)}) if by_pyomo else (Set, nodes)
    m.x, m.y = kind(**how), kind(**how)
    m.T = Var(m.t, m.x, m.y, initialize=0.5)
    m.dT_dt = DerivativeVar(m.T, wrt=m.t)

    if by_pyomo:
        m.T_xx = DerivativeVar(m.T, wrt=(m.x, m.x))
        m.T_yy = DerivativeVar(m.T, wrt=(m.y, m.y))

    def curvature(m, t, x, y):
        if by_pyomo:
            return m.T_xx[t, x, y] + m.T_yy[t, x, y]
        across = m.T[t, m.x.next(x), y] + m.T[t, m.x.prev(x), y]
        along = m.T[t, x, m.y.next(y)] + m.T[t, x, m.y.prev(y)]
        return 16 * (across + along - 4 * m.T[t, x, y])

    @m.Constraint(m.t, m.x, m.y)
    def heat(m, t, x, y):
        if is_edge(x, y):
            return m.T[t, x, y] == 0
        return m.dT_dt[t, x, y] == curvature(m, t, x, y)

    @m.Constraint(m.x, m.y)
    def initial(m, x, y):
        return Constraint.Skip if is_edge(x, y) else m.T[0, x, y] == profile(x) * sin(y)

    if by_pyomo:
        for space in (m.x, m.y):
            TransformationFactory("dae.finite_difference").apply_to(
                m, wrt=space, nfe=4, scheme="CENTRAL"
            )
    inside = np.array([1, 2, 3]) / 4
    a = np.kron(laplacian(3), np.eye(3)) + np.kron(np.eye(3), laplacian(3))
    expected = expm(FRACTION * a) @ np.kron(profile(inside), np.sin(inside))
    solve(m, tolerance=1e-8)
    found = [value(m.T[FRACTION, x, y]) for x in list(m.x)[1:-1] for y in list(m.y)[1:-1]]
    assert found == pytest.approx(expected, abs=1e-7)


def test_collocation_in_space(bar):
    # A parabola of Radau degree 2 in one element: T'' is constant in x.
    bar.del_component(bar.initial)
    bar.del_component(bar.right)
    bar.T_x = DerivativeVar(bar.T, wrt=bar.x)
    bar.transport = Constraint(
        bar.x,
        bar.t,
        rule=lambda m, x, t: m.dT_dt[x, t] == -m.T_x[x, t] + 1 if x > 0 else Constraint.Skip,
    )
    TransformationFactory("dae.collocation").apply_to(bar, wrt=bar.x, nfe=1, ncp=2)
    # From T = x, which the right-hand side keeps.
    for x in bar.x:
        bar.T[x, 0].fix(x)
    solve(bar, tolerance=1e-8)
    for x in bar.x:
        assert value(bar.T[x, FRACTION]) == pytest.approx(x, abs=1e-5)


def test_dynamics_forgotten_at_one_node_are_refused(bar):
    bar.d2T_dx2 = DerivativeVar(bar.T, wrt=(bar.x, bar.x))
    bar.heat = Constraint(
        bar.x,
        bar.t,
        rule=lambda m, x, t: m.dT_dt[x, t] == m.d2T_dx2[x, t] if 0 < x < 1 else Constraint.Skip,
    )
    bar.left.deactivate()
    discretise(bar, "CENTRAL")
    with pytest.raises(
        TranscriptionError, match=r"dT_dt\[0\]: no equation over time contains this"
    ):
        solve(bar)


# Blocks


def test_nested_and_indexed_blocks():
    rates = {"a": (1.0, 2.0), "b": (3.0, 0.5)}
    m = ConcreteModel()
    m.t = ContinuousSet(bounds=(0, 1))
    m.names = Set(initialize=list(rates))

    @m.Block(m.names)
    def plant(b, name):
        @b.Block([0, 1])
        def tank(tank, k):
            tank.k = Param(initialize=rates[name][k])
            tank.x = Var(m.t, initialize=1.0)
            tank.dx = DerivativeVar(tank.x, wrt=m.t)

            @tank.Constraint(m.t)
            def balance(tank, t):
                above = tank.parent_block().tank[0].x[t] * rates[name][0] if k else 0
                return tank.dx[t] == above - tank.k * tank.x[t]

            tank.x[0].fix(1 - k)

    m.total = Integral(
        m.t, wrt=m.t, rule=lambda m, t: sum(m.plant[n].tank[1].x[t] for n in m.names)
    )
    m.objective = Objective(expr=m.total)
    solution = solve(m, tolerance=1e-8)
    expected = 0.0
    for first, second in rates.values():
        a = np.array([[-first, 0, 0], [first, -second, 0], [0, 1, 0]])
        expected += (expm(a) @ [1, 0, 0])[2]
    assert solution.objective == pytest.approx(expected, rel=1e-9)
    assert value(m.plant["b"].tank[1].x[1]) == pytest.approx(
        solution.value("plant[b].tank[1].x", 1.0), rel=1e-12
    )


def test_a_block_that_is_not_active_says_nothing():
    m = decay()
    m.aside = Block()
    m.aside.wrong = Constraint(m.t, rule=lambda _b, t: m.x[t] == 5)
    m.aside.deactivate()
    solve(m)
    assert value(m.x[1]) == pytest.approx(np.exp(-RATE), abs=1e-6)


def test_a_model_with_nothing_to_find_is_refused():
    with pytest.raises(TranscriptionError, match="model: nothing to solve for; declare a Var"):
        compile(ConcreteModel())
