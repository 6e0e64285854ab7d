"""Several continuous sets in one model: phases, experiments and scenarios solved together."""

import math
import pickle
from dataclasses import replace

import numpy as np
import pytest
from pyomo.dae import ContinuousSet, DerivativeVar, Integral
from pyomo.environ import (
    Block,
    ConcreteModel,
    Constraint,
    Objective,
    Param,
    SolverFactory,
    Suffix,
    Var,
    exp,
    maximize,
)
from scipy.optimize import least_squares

from pyomo_quad.collocation import Mesh, TranscriptionError, compile, diagnose, solve
from pyomo_quad.collocation.program.coupling import CoupledProgram
from tests.starts import assert_begins_at, noted_starts


def leg(block, bounds, declared=(0, 1)):
    """A body that its control accelerates, over a horizon of its own."""
    block.t = ContinuousSet(initialize=declared)
    block.x, block.v = Var(block.t), Var(block.t)
    block.u = Var(block.t, bounds=bounds)
    block.dx_dt, block.dv_dt = (DerivativeVar(x, wrt=block.t) for x in (block.x, block.v))
    block.motion = Constraint(block.t, rule=lambda b, t: b.dx_dt[t] == b.v[t])
    block.force = Constraint(block.t, rule=lambda b, t: b.dv_dt[t] == b.u[t])
    block.effort = Integral(block.t, rule=lambda b, t: b.u[t] ** 2 / 2)


def two_legs(first=(None, None), second=(None, None)):
    """Rest to rest over 1 m in two legs, one after the other."""
    m = ConcreteModel()
    m.first, m.second = Block(), Block()
    leg(m.first, first)
    leg(m.second, second)
    for fixed, number in ((m.first.x, 0), (m.first.v, 0)):
        fixed[0].fix(number)
    for fixed, number in ((m.second.x, 1), (m.second.v, 0)):
        fixed[1].fix(number)
    m.same_place = Constraint(expr=m.first.x[1] == m.second.x[0])
    m.same_speed = Constraint(expr=m.first.v[1] == m.second.v[0])
    return m


def least_effort():
    m = two_legs()
    m.cost = Objective(expr=m.first.effort + m.second.effort)
    return m


def test_two_legs_are_one_flight():
    # The least effort from rest to rest over 1 m in 2 s is 12 / (2 * 2^3) = 0.75.
    m = least_effort()
    solution = solve(m, tolerance=1e-8)
    assert solution.is_converged
    assert solution.objective == pytest.approx(0.75, abs=1e-9)
    np.testing.assert_allclose(solution.value(m.first.u, [0.0, 1.0]), [1.5, 0.0], atol=1e-6)
    np.testing.assert_allclose(solution.value(m.second.u, [0.0, 1.0]), [0.0, -1.5], atol=1e-6)
    assert solution.value(m.first.effort) == pytest.approx(0.375, abs=1e-7)
    assert (m.first.x[1].value, m.second.x[0].value) == pytest.approx((0.5, 0.5), abs=1e-7)
    # p_x is the same all along, p_v without a jump: p_v = -u.
    at_end, at_start = solution.costate(m.first.x, 0.5), solution.costate(m.second.x, 0.5)
    assert (at_end, at_start) == pytest.approx((-1.5, -1.5), abs=1e-6)
    assert solution.on(m.second.v).costate("second.v", 1.0) == pytest.approx(1.5, abs=1e-6)


def test_each_leg_has_its_own_time_and_mesh():
    m = two_legs(first=(0, 1), second=(-2, 0))
    m.push, m.brake = Var(bounds=(0.1, 5)), Var(bounds=(0.1, 5))
    m.cost = Objective(expr=m.push + m.brake)
    times = {"first.t": {1: m.push}, "second.t": {1: m.brake}}
    solution = solve(m, times=times, tolerance=1e-6)
    assert solution.objective == pytest.approx(1.5 * math.sqrt(4 / 3), rel=1e-6)
    assert solution.horizons["first.t"].mesh != solution.horizons["second.t"].mesh
    assert solution.horizons["second.t"].horizon == pytest.approx((0.0, math.sqrt(1 / 3)), abs=1e-4)


def test_an_objective_that_is_no_sum_and_one_that_is_maximised():
    m = least_effort()
    m.del_component(m.cost)
    m.cost = Objective(expr=-((m.first.effort + m.second.effort) ** 2), sense=maximize)
    solution = solve(m, tolerance=1e-8)
    assert solution.objective == pytest.approx(-(0.75**2), abs=1e-8)


@pytest.mark.parametrize("rival", ["limit", "equality"])
def test_an_integral_of_each_horizon_in_one_constraint(rival):
    m = least_effort()
    m.del_component(m.cost)
    # Effort split evenly is the best anyway; without the constraint the later one is free.
    bound = (
        m.first.effort == m.second.effort
        if rival == "equality"
        else m.first.effort - m.second.effort <= 0
    )
    m.fair = Constraint(expr=bound)
    m.cost = Objective(expr=m.first.effort + 1.0 * m.second.effort)
    assert solve(m, tolerance=1e-8).objective == pytest.approx(0.75, abs=1e-8)


def decay(measured):
    """Experiments of one reaction: x' = -k x from different starts, with one unknown k."""
    m = ConcreteModel()
    m.k = Var(initialize=1.0, bounds=(0.01, 10))

    @m.Block(range(len(measured)))
    def experiment(b, i):
        points = measured[i]
        b.t = ContinuousSet(initialize=[0.0, *points])
        b.x = Var(b.t, initialize=1.0)
        b.dx_dt = DerivativeVar(b.x, wrt=b.t)
        b.reaction = Constraint(b.t, rule=lambda b, t: b.dx_dt[t] == -m.k * b.x[t])
        b.miss = sum((b.x[t] - seen) ** 2 for t, seen in points.items())

    m.experiment[0].x[0].fix(2.0)
    m.experiment[1].x[0].fix(0.5)
    m.misfit = Objective(expr=sum(m.experiment[i].miss for i in m.experiment))
    return m


MEASURED = (
    {0.3: 1.47, 0.9: 0.86, 1.6: 0.35},
    {0.5: 0.31, 2.5: 0.05},
)


def test_experiments_share_a_parameter():
    def misses(k):
        return [
            x0 * math.exp(-k[0] * t) - seen
            for x0, points in zip((2.0, 0.5), MEASURED, strict=True)
            for t, seen in points.items()
        ]

    fitted = least_squares(misses, [1.0], xtol=1e-14, ftol=1e-14, gtol=1e-14)
    m = decay(MEASURED)
    solution = solve(m, tolerance=1e-8)
    assert solution.value(m.k) == pytest.approx(fitted.x[0], rel=1e-7)
    assert solution.objective == pytest.approx(2 * fitted.cost, rel=1e-7)
    assert set(solution.horizons) == {"experiment[0].t", "experiment[1].t"}


def rocket():
    """Goddard's rocket of `tests.problems.goddard`, with a continuous set for each phase."""
    m = ConcreteModel()
    gravity, exhaust, drag, height = 32.174, 1580.9425279876559, 5.49153484923381010e-5, 23_800.0

    def thrust_law(b, t, kind):
        if kind == "burn":
            return b.thrust[t] == 193.044
        if kind == "coast":
            return b.thrust[t] == 0
        mach, weight = b.v[t] / exhaust, b.m[t] * gravity
        slope = mach**2 * (exhaust**2 * (1 + mach) / (height * gravity) - 1) - 2 * mach
        arc = weight * slope / (mach**2 + 4 * mach + 2)
        return b.thrust[t] - b.drag[t] - weight == arc

    @m.Block(["burn", "arc", "coast"])
    def phase(b, kind):
        b.t = ContinuousSet(bounds=(0, 1))
        b.h = Var(b.t, bounds=(0, 30_000), initialize=0)
        b.v = Var(b.t, bounds=(0, 2_000), initialize=0)
        b.m = Var(b.t, bounds=(1, 3), initialize=3)
        b.thrust = Var(b.t, bounds=(0, 193.044), initialize=193.044)
        b.duration = Var(bounds=(1, 40), initialize=15)
        b.dh_dt, b.dv_dt, b.dm_dt = (DerivativeVar(x, wrt=b.t) for x in (b.h, b.v, b.m))

        @b.Expression(b.t)
        def drag(b, t):
            return 5.49153484923381010e-5 * b.v[t] ** 2 * exp(-b.h[t] / height)

        b.climb = Constraint(b.t, rule=lambda b, t: b.dh_dt[t] == b.v[t])
        b.force = Constraint(
            b.t,
            rule=lambda b, t: b.m[t] * b.dv_dt[t] == b.thrust[t] - b.drag[t] - b.m[t] * gravity,
        )
        b.consumption = Constraint(b.t, rule=lambda b, t: b.dm_dt[t] * exhaust == -b.thrust[t])
        b.law = Constraint(b.t, rule=lambda b, t: thrust_law(b, t, kind))

    burn, arc, coast = (m.phase[k] for k in ("burn", "arc", "coast"))
    for state, first in ((burn.h, 0), (burn.v, 0), (burn.m, 3)):
        state[0].fix(first)
    coast.m[1].fix(1)

    @m.Constraint(["burn", "arc"], ["h", "v", "m"])
    def goes_on(m, kind, state):
        after = arc if kind == "burn" else coast
        return getattr(m.phase[kind], state)[1] == getattr(after, state)[0]

    m.enters_the_arc = Constraint(
        expr=arc.m[0] * gravity
        == (1 + arc.v[0] / exhaust) * drag * arc.v[0] ** 2 * exp(-arc.h[0] / height)
    )
    m.height = Objective(expr=coast.h[1], sense=maximize)
    times = {f"phase[{k}].t": {1: m.phase[k].duration} for k in m.phase}
    return m, times


@pytest.mark.lengthy
def test_three_phases_with_sets_of_their_own():
    m, times = rocket()
    problem = compile(m, times=times)
    cold = problem.solve(tolerance=1e-7)
    assert cold.objective == pytest.approx(18_550.87186, rel=1e-7)
    # Multipliers of each phase are kept, on its own mesh.
    with noted_starts() as starts:
        warm = problem.solve(tolerance=1e-7, warm_start=cold)
    assert_begins_at(starts[0], cold)
    assert warm.objective == pytest.approx(cold.objective, rel=1e-9)
    assert warm.cold_start == cold.cold_start
    first, *rest = warm.warm_start
    hasty = replace(first, cold_start=replace(first.cold_start, first=0))
    given_up = problem.solve(tolerance=1e-7, warm_start=(hasty, *rest))
    assert "The warm start was given up after" in given_up.message
    assert given_up.objective == pytest.approx(cold.objective, rel=1e-9)


def coupled_program():
    m = least_effort()
    m.length = Var(initialize=1.2, bounds=(0.5, 2))
    m.rule = Constraint(expr=m.length * m.first.v[1] <= m.second.effort**2 + m.second.u[0])
    m.del_component(m.cost)
    m.cost = Objective(expr=m.first.effort + m.second.effort * m.length + m.first.v[1] ** 3)
    problem = compile(m, times={"second.t": {1: m.length}})
    parts = [*problem.horizons.values(), problem.coupling]
    meshes = (Mesh.uniform(2, 2), Mesh.uniform(1, 3), None)
    union = problem.union(meshes, [part.instance() for part in parts])
    return CoupledProgram(union, union.programs)


def test_derivatives_of_the_whole_are_the_slopes():
    program = coupled_program()
    random = np.random.default_rng(4)
    z = 1.0 + 0.1 * random.normal(size=program.union.unknowns)
    multipliers = random.normal(size=program.n_rows)
    steps = 1e-6 * np.eye(z.size)

    def slopes(function):
        return np.column_stack([(function(z + d) - function(z - d)) / 2e-6 for d in steps])

    def dense(structure, values, shape):
        whole = np.zeros(shape)
        np.add.at(whole, structure, values)
        return whole

    jacobian = dense(program.jacobianstructure(), program.jacobian(z), (program.n_rows, z.size))
    np.testing.assert_allclose(jacobian, slopes(program.constraints), atol=1e-7)
    np.testing.assert_allclose(program.gradient(z), slopes(program.objective)[0], atol=1e-7)

    def gradient(z):
        rows = dense(program.jacobianstructure(), program.jacobian(z), jacobian.shape)
        return 0.7 * program.gradient(z) + multipliers @ rows

    hessian = dense(
        program.hessianstructure(), program.hessian(z, multipliers, 0.7), (z.size, z.size)
    )
    np.testing.assert_allclose(hessian, np.tril(slopes(gradient)), atol=1e-6)


def test_parameters_pickles_guesses_and_meshes():
    m = least_effort()
    m.goal = Param(initialize=1.0, mutable=True)
    m.second.x[1].unfix()
    m.arrival = Constraint(expr=m.second.x[1] == m.goal)
    problem = pickle.loads(pickle.dumps(compile(m)))
    meshes = {"first.t": Mesh.uniform(2, 3), "second.t": Mesh.uniform(3, 4)}
    solution = problem.solve(
        mesh=meshes, parameters={"goal": 2.0}, guess={"first.x": 0.1, "second.t": {"second.u": 1.0}}
    )
    assert solution.objective == pytest.approx(4 * 0.75, abs=1e-8)
    assert solution.horizons["second.t"].mesh == meshes["second.t"]


def test_as_a_pyomo_solver_with_suffixes():
    m = least_effort()
    m.dual, m.costate = Suffix(direction=Suffix.IMPORT), Suffix(direction=Suffix.IMPORT)
    results = SolverFactory("pyomo_quad").solve(m)
    assert str(results.solver.termination_condition) == "optimal"
    # What a metre's gap between the legs would change in 12 x^2 / (2 T^3).
    assert m.dual[m.same_place] == pytest.approx(1.5, abs=1e-5)
    assert m.costate[m.first.x[0]] == pytest.approx(-1.5, abs=1e-5)
    assert m.costate[m.second.x[0]] == pytest.approx(-1.5, abs=1e-5)


def test_a_horizon_that_is_deactivated_is_left_out():
    m = least_effort()
    m.first.deactivate()
    m.same_speed.deactivate()
    m.same_place.deactivate()
    m.second.x[0].fix(0)
    m.second.v[0].fix(0)
    m.cost.set_value(m.second.effort)
    assert solve(m).objective == pytest.approx(6.0, rel=1e-8)
    m.same_speed.activate()
    refused(m, "^first.t: nothing to solve for; declare a Var that is not fixed and an active Con")


def test_both_are_shown_in_one_short_line_and_a_table():
    problem = compile(least_effort())
    for shown, fact in ((problem, "first.t"), (problem.solve(), "status: converged")):
        assert repr(shown).startswith(f"<{type(shown).__name__} ")
        assert fact in repr(shown)
        assert "\n" not in repr(shown)
        assert shown._repr_html_().startswith("<table")


def test_what_needs_no_horizon_is_kept():
    m = least_effort()
    m.free = Var(bounds=(0, 9))
    m.floor = Constraint(expr=m.free >= 3)
    m.del_component(m.cost)
    m.cost = Objective(expr=m.first.effort + m.second.effort + m.free)
    assert solve(m).objective == pytest.approx(3.75, abs=1e-6)


def refused(m, match, **arguments):
    with pytest.raises(TranscriptionError, match=match):
        solve(m, **arguments)


def test_a_final_time_of_several():
    m = least_effort()
    m.T = Var()
    refused(
        m, "^final_time: the model has several horizons, first.t, second.t; give", final_time=m.T
    )
    refused(
        m, "^times: the model has several ContinuousSets, first.t, second.t; name", times={1: m.T}
    )
    refused(
        m, "^times: third is not a Con.* which has first.t, second.t", times={"third": {1: m.T}}
    )


def test_coupling_at_a_time_that_is_no_boundary():
    m = ConcreteModel()
    m.first, m.second = Block(), Block()
    leg(m.first, (None, None), declared=(0, 0.5, 1))
    leg(m.second, (None, None))
    m.halfway = Constraint(expr=m.first.x[0.5] == m.second.x[0])
    refused(
        m, r"^first.x\[0.5\]: couples horizons at a time inside first.t; must be at one of its ends"
    )


def test_a_value_of_another_horizon_over_time():
    m = least_effort()
    m.follow = Constraint(m.first.t, rule=lambda m, t: m.first.x[t] <= m.second.x[0])
    refused(m, r"^second.x\[0\]: a value over second.t cannot stand in a component over first.t")


def test_a_parameter_of_one_horizon_in_what_couples():
    m = least_effort()
    m.wind = Param(m.first.t, initialize=lambda m, t: t, mutable=True)
    m.odd = Constraint(expr=m.wind[1] * m.first.x[1] <= m.second.x[0])
    refused(
        m,
        r"^wind\[1\]: a parameter over first.t at a single time cannot appear in an equation",
    )


def test_phases_that_leave_a_gap():
    m = ConcreteModel()
    m.first, m.second = Block(), Block()
    leg(m.first, (None, None), declared=(0, 1))
    leg(m.second, (None, None), declared=(1.5, 2))
    m.goes_on = Constraint(expr=m.first.x[1] == m.second.x[1.5])
    refused(m, r"^goes_on: first.t ends at 1, but second.t begins at 1.5, which leaves a gap")


def test_a_mesh_for_one_of_several():
    refused(
        least_effort(), "^mesh: given for first.t; give one", mesh={"first.t": Mesh.uniform(1, 3)}
    )


def test_what_is_said_of_one_horizon_only():
    m = least_effort()
    refused(m, "^horizon: the model has several, first.t, second.t; give their", horizon=(0, 2))
    refused(m, "^starts: 3; must be 1 with several horizons, first.t, second.t; give", starts=3)


def test_a_guess_of_something_unknown():
    refused(least_effort(), "^guess: 'y' is none of the model's variables and none", guess={"y": 1})


def test_statics_whose_bounds_cross():
    m = least_effort()
    m.p = Var(bounds=(0, 1))
    m.use = Constraint(m.first.t, rule=lambda m, t: m.first.x[t] <= 9 + m.p)
    m.low = Constraint(expr=m.p >= 2)
    refused(m, "^p: lower bound 2 is above upper bound 1; relax one of the two")


def test_a_diagnosis_is_of_one_horizon():
    solution = solve(least_effort(), mesh=Mesh.uniform(1, 3))
    with pytest.raises(TranscriptionError, match="diagnose: the solution is of several horizons; "):
        diagnose(solution)
    assert not diagnose(solution.horizons["first.t"]).is_infeasible
