"""What the engine refuses before Ipopt starts: one line each, naming the component."""

import pickle
import re

import pytest
from pyomo.dae import ContinuousSet, DerivativeVar, Integral
from pyomo.environ import (
    AbstractModel,
    Binary,
    Block,
    BooleanVar,
    ConcreteModel,
    Constraint,
    Expr_if,
    Integers,
    LogicalConstraint,
    Objective,
    Param,
    Piecewise,
    Set,
    SOSConstraint,
    Suffix,
    TransformationFactory,
    Var,
    log,
    maximize,
    minimize,
    sqrt,
)
from pyomo.gdp import Disjunct, Disjunction
from pyomo.mpec import Complementarity, complements
from pyomo.network import Arc, Port

from pyomo_quad.collocation import Mesh, TranscriptionError, compile, solve
from pyomo_quad.collocation.program import ipopt

MESH = Mesh.uniform(5, 3)


# What the added term is, and what the message says of it: its square root starts at zero.
INFINITE_SLOPES = {
    "integrand": r"objective: its derivative by u at time .* is inf at",
    "maximised integrand": r"objective: its derivative by u at time .* is -inf at",
    "end value": r"objective: its derivative by y at time 1 .* is inf at",
    "static variable": r"objective: its derivative by p is inf at",
    "function of an integral": r"objective: its derivative by work is inf at",
    "integral that is bounded": r"work: its derivative by u at time .* is -?inf at",
    "equation": r"balance at time .*: its derivative by u is -?inf at",
    "condition": r"gate: its derivative by p is inf at",
}


@pytest.fixture(autouse=True)
def _ipopt_must_not_start(monkeypatch):
    def refuse(*_args, **_options):
        pytest.fail("Ipopt was started")

    monkeypatch.setattr(ipopt.cyipopt, "Problem", refuse)


@pytest.fixture
def m():
    """A regulator x' = u - x with nothing wrong in it."""
    m = ConcreteModel()
    m.t = ContinuousSet(bounds=(0, 1))
    m.x = Var(m.t, initialize=1.0)
    m.u = Var(m.t, bounds=(-1, 1))
    m.dx_dt = DerivativeVar(m.x, wrt=m.t)
    m.balance = Constraint(m.t, rule=lambda m, t: m.dx_dt[t] == m.u[t] - m.x[t])
    m.x[0].fix(1)
    m.cost = Integral(m.t, wrt=m.t, rule=lambda m, t: m.u[t] ** 2 + m.x[t] ** 2)
    m.objective = Objective(expr=m.cost)
    return m


def refused(model, message, **arguments):
    with pytest.raises(TranscriptionError, match=message) as caught:
        solve(model, **({"mesh": MESH} | arguments))
    assert "\n" not in str(caught.value)


def test_two_objectives(m):
    m.other = Objective(expr=m.x[1])
    refused(m, r"objective: 2 active \(objective, other\); at most one is allowed; deactivate the")


SUMS = {
    "squares": lambda m: sum(m.u[t] ** 2 for t in m.t),
    "a multiple beside an end value": lambda m: 0.5 * sum(m.u[t] ** 2 for t in m.t) + m.x[1],
    "with states": lambda m: sum(m.x[t] ** 2 + m.u[t] ** 2 for t in m.t),
    "a rate": lambda m: sum(m.dx_dt[t] ** 2 for t in m.t),
}


@pytest.mark.parametrize("kind", SUMS)
def test_a_sum_of_a_control_over_the_declared_instants(m, kind):
    m.objective.set_value(SUMS[kind](m))
    name = "dx_dt" if kind == "a rate" else "u"
    refused(
        m, rf"objective: sums {name} over the 2 declared instants of t only.*declare an Integral"
    )


def test_a_sum_over_instants_that_is_a_fit_is_taken(m):
    seen = {0: 0.3, 1: 0.7}
    m.objective.set_value(sum((m.u[t] - seen[t]) ** 2 for t in m.t) + m.cost)
    compile(m)
    m.objective.set_value(sum(m.x[t] ** 2 for t in m.t))
    compile(m)


def test_a_model_scaled_before_it_is_discretised(m):
    m.scaling_factor = Suffix(direction=Suffix.EXPORT)
    m.scaling_factor[m.x] = 10.0
    scaled = TransformationFactory("core.scale_model").create_using(m)
    refused(
        scaled,
        r"scaled_balance: its rule no longer fits the model \(AttributeError.*core\.scale_model; "
        r"scale with the Suffix scaling_factor alone",
    )


def test_derivative_without_dynamics(m):
    m.balance.deactivate()
    refused(m, "dx_dt: no equation over time contains this derivative; declare its dynamics")


def test_derivative_of_an_indexed_state_without_dynamics(m):
    m.y = Var([1, 2], m.t)
    m.dy_dt = DerivativeVar(m.y, wrt=m.t)
    m.motion = Constraint(m.t, rule=lambda m, t: m.dy_dt[1, t] + 0 * m.y[2, t] == m.u[t])
    m.ends = Constraint([1, 2], rule=lambda m, k: m.y[k, 1] == 0)
    m.steady = Constraint(m.t, rule=lambda m, t: m.dy_dt[2, t] <= 1)
    refused(m, r"dy_dt\[2\]: no equation over time contains this derivative")


def test_fixed_ends_without_a_control(m):
    m.x[1].fix(2)
    m.still = Constraint(m.t, rule=lambda m, t: m.u[t] == 0.5 * m.x[t])
    refused(m, r"30 equations for 29 free unknowns; it is over-determined.*boundary.* of x")


def test_more_equations_than_unknowns(m):
    m.first = Constraint(m.t, rule=lambda m, t: m.u[t] + m.x[t] == 1)
    m.second = Constraint(m.t, rule=lambda m, t: m.u[t] - m.x[t] == 0)
    refused(m, "45 equations for 30 free unknowns")


def test_not_finite_at_the_guess(m):
    m.depth = Constraint(m.t, rule=lambda m, t: log(m.x[t] - 2 * t) >= -5)
    refused(m, r"depth at time 0\.52899 \(element 3, point 2\): is nan at the initial guess")


def test_integrand_not_finite_at_the_guess(m):
    m.objective.deactivate()
    m.loss = Integral(m.t, wrt=m.t, rule=lambda m, t: log(m.u[t] - 1))
    m.total = Objective(expr=m.loss)
    refused(m, "total: is (nan|-inf) at the initial guess")


def test_crossed_bounds_of_a_variable(m):
    m.w = Var(m.t, bounds=(3, 2))
    m.use = Constraint(m.t, rule=lambda m, t: m.w[t] + m.u[t] >= 0)
    refused(m, r"w at time .*: lower bound 3 is above upper bound 2; relax one of the two")


def test_bounds_crossed_by_a_path_limit(m):
    m.limit = Constraint(m.t, rule=lambda m, t: m.u[t] >= 4)
    refused(m, r"u at time .*: lower bound 4 is above upper bound 1")


def test_start_outside_a_limit(m):
    m.limit = Constraint(m.t, rule=lambda m, t: m.x[t] <= 0.5)
    refused(m, r"x at time 0: lower bound 1 is above upper bound 0\.5")


def test_degree_zero(m):
    with pytest.raises(TranscriptionError, match="element degree = 0; must be at least 1"):
        solve(m, mesh=Mesh.uniform(5, 0))


def test_partial_differential_equations(m):
    m.s = ContinuousSet(bounds=(0, 1))
    m.w = Var(m.t, m.s)
    m.dw_dt = DerivativeVar(m.w, wrt=m.t)
    m.dw_ds = DerivativeVar(m.w, wrt=m.s)
    m.wave = Constraint(m.t, m.s, rule=lambda m, t, s: m.dw_dt[t, s] == m.dw_ds[t, s])
    refused(m, "continuous sets t, s: partial differential equations are not supported")


def disjunction(m, b):
    b.low, b.high = Disjunct(), Disjunct()
    b.low.limit = Constraint(m.t, rule=lambda _b, t: m.x[t] <= 0.5)
    b.high.limit = Constraint(m.t, rule=lambda _b, t: m.x[t] >= 0.8)
    b.either = Disjunction(expr=[b.low, b.high])


def complementarity(m, b):
    b.contact = Complementarity(expr=complements(m.x[1] >= 0, m.u[1] <= 0))


def complementarities(m, b):
    b.contact = Complementarity(m.t, rule=lambda _b, t: complements(m.x[t] >= 0, m.u[t] <= 0))


def logic(m, b):
    b.is_on = BooleanVar()
    b.rule = LogicalConstraint(expr=b.is_on)


def arc(m, b):
    b.inlet, b.outlet = Port(initialize={"x": m.x}), Port(initialize={"x": m.u})
    b.pipe = Arc(source=b.inlet, destination=b.outlet)


def special_ordered_set(m, b):
    b.weight = Var([1, 2], bounds=(0, 1))
    b.one = SOSConstraint(var=b.weight, sos=1)


UNKNOWN = {
    disjunction: r"(low|either): Disjunct(ion)? is not supported; write the choice with smooth",
    complementarity: r"contact: Complementarity is not supported; write it as inequalities: a >",
    complementarities: r"contact: Complementarity is not supported; write it as inequalities",
    logic: r"rule: LogicalConstraint is not supported; write it as a Constraint, or deactivate",
    arc: r"pipe: Arc is not supported; apply the transformation network.expand_arcs first, or",
    special_ordered_set: r"one: SOSConstraint is not supported; write it as a Constraint, or",
}


@pytest.mark.parametrize("declare", UNKNOWN)
@pytest.mark.parametrize("depth", [0, 1, 2])
def test_a_component_that_would_be_dropped(m, declare, depth):
    block, name = m, ""
    for _ in range(depth):
        block.part = Block([1])
        block, name = block.part[1], rf"{name}part\[1\]\."
    declare(m, block)
    refused(m, "^" + name + UNKNOWN[declare])


@pytest.mark.parametrize("declare", UNKNOWN)
def test_a_component_that_is_not_active_is_left_alone(m, declare):
    m.aside = Block()
    declare(m, m.aside)
    m.aside.deactivate()
    compile(m)


def test_integer_variable(m):
    m.count = Var(domain=Integers, initialize=1)
    m.use = Constraint(expr=m.x[1] <= m.count)
    refused(m, "count: domain Integers is not continuous")


def test_binary_variable_over_time(m):
    m.switch = Var(m.t, domain=Binary, initialize=1)
    m.use = Constraint(m.t, rule=lambda m, t: m.x[t] <= 2 * m.switch[t])
    refused(m, r"switch\[0\]: domain Binary is not continuous")


def test_a_switch_that_is_fixed_is_a_number(m):
    m.is_on = Var(domain=Binary)
    m.use = Constraint(m.t, rule=lambda m, t: m.u[t] <= m.is_on)
    m.is_on.fix(1)
    compile(m)


@pytest.mark.parametrize("kind", [{"pw_repn": "SOS2"}, {"pw_repn": "INC"}])
def test_a_function_by_pieces(m, kind):
    m.x.setlb(0)
    m.x.setub(3)
    m.y = Var(m.t, bounds=(-5, 5))
    m.drag = Piecewise(
        m.t, m.y, m.x, pw_pts=[0, 1, 3], f_rule=[0, 1, 2], pw_constr_type="EQ", **kind
    )
    refused(m, "^drag: Piecewise is not supported; give its points to a Table, which is a smooth")


def test_an_objective_at_every_time(m):
    m.objective.deactivate()
    m.each = Objective(m.t, rule=lambda m, t: m.u[t] ** 2)
    refused(
        m, "^each: Objective indexed by t is not supported; declare one Objective with an Integ"
    )
    m.each.deactivate()
    m.objective.activate()
    compile(m)


def test_a_block_at_every_time(m):
    m.part = Block(m.t)
    refused(m, "^part: Block indexed by t is not supported; index the variables and constraints")


@pytest.mark.parametrize("kind", [BooleanVar, Set])
def test_what_says_nothing_at_every_time_is_left_alone(m, kind):
    m.aside = kind(m.t)
    compile(m)


def test_what_is_no_model():
    m = ConcreteModel()
    m.part = Block()
    for wrong, name in ((m.part, "ScalarBlock"), ({"x": 1}, "dict")):
        with pytest.raises(TranscriptionError, match=rf"^model: a {name}; must be a ConcreteModel"):
            compile(wrong)
    with pytest.raises(
        TranscriptionError, match=r"^model: unknown is abstract; pass the model that"
    ):
        compile(AbstractModel())


def test_second_derivative(m):
    m.y = Var(m.t)
    m.d2y_dt2 = DerivativeVar(m.y, wrt=(m.t, m.t))
    m.motion = Constraint(m.t, rule=lambda m, t: m.d2y_dt2[t] == m.u[t])
    refused(m, "d2y_dt2: a derivative of order 2 is not supported; declare the first derivative")


def test_value_at_a_fixed_time_inside_an_equation(m):
    m.limit = Constraint(m.t, rule=lambda m, t: m.x[t] + m.u[t] <= m.x[0])
    refused(m, r"x\[0\]: a value at a fixed time inside an equation over time is not supported")


def test_integral_inside_an_equation(m):
    m.limit = Constraint(m.t, rule=lambda m, t: m.x[t] <= m.cost)
    refused(m, "cost: an integral inside an equation over time is not supported")


def test_parameter_without_a_value(m):
    m.ceiling = Param(mutable=True)
    m.limit = Constraint(expr=m.x[1] <= m.ceiling)
    refused(m, "ceiling: has no value; give it one before the solve")


def with_infinite_slope(m, kind):
    m.p = Var(bounds=(0, None), initialize=0)
    m.y = Var(m.t, initialize=0)
    m.dy_dt = DerivativeVar(m.y, wrt=m.t)
    m.climb = Constraint(m.t, rule=lambda m, t: m.dy_dt[t] == m.u[t])
    m.y[0].fix(0)
    is_root = kind.endswith("integrand") or kind == "integral that is bounded"
    m.work = Integral(m.t, wrt=m.t, rule=lambda m, t: sqrt(m.u[t]) if is_root else m.u[t] ** 2)
    m.del_component(m.objective)
    cost = m.cost + m.p**2 + m.y[1]
    if kind == "equation":
        m.del_component(m.balance)
        m.balance = Constraint(m.t, rule=lambda m, t: m.dx_dt[t] == sqrt(m.u[t]) - m.x[t])
    if kind == "condition":
        m.gate = Constraint(expr=sqrt(m.p) <= 1)
    if kind == "integral that is bounded":
        m.gate = Constraint(expr=m.work <= 1)
    extra = {
        "integrand": m.work,
        "maximised integrand": m.work,
        "end value": sqrt(m.y[1]),
        "static variable": sqrt(m.p),
        "function of an integral": sqrt(m.work),
    }.get(kind, 0)
    is_maximised = kind.startswith("maximised")
    sign, sense = (-1, maximize) if is_maximised else (1, minimize)
    m.objective = Objective(expr=sign * cost + extra, sense=sense)
    return m


@pytest.mark.parametrize("kind", INFINITE_SLOPES)
def test_slope_that_is_infinite_at_the_guess(m, kind):
    refused(with_infinite_slope(m, kind), INFINITE_SLOPES[kind], guess={"u": 0.0})


def test_unknown_parameter(m):
    refused(m, "parameters: 'ceiling' is not a component of the model", parameters={"ceiling": 1})


@pytest.mark.parametrize("is_pickled", [False, True])
def test_a_constant_parameter_takes_no_other_value(m, is_pickled):
    m.weight = Param(initialize=2.0)
    m.share = Param([1, 2], initialize=0.5)
    problem = compile(m)
    problem = pickle.loads(pickle.dumps(problem)) if is_pickled else problem
    for name in ("weight", "share[1]"):
        message = rf"parameters: '{re.escape(name)}' is a Param whose value is compiled"
        with pytest.raises(TranscriptionError, match=message):
            problem.solve(parameters={name: 3.0})


def test_horizon_that_ends_before_it_starts(m):
    refused(m, "horizon: end 0 is not after start 1", horizon=(1.0, 0.0))


def test_guess_that_is_not_a_number(m):
    refused(m, "balance at time .* is nan at the initial guess", guess={"x": float("nan")})


def test_expr_if(m):
    m.limit = Constraint(m.t, rule=lambda m, t: Expr_if(IF=m.x[t] >= 0, THEN=m.x[t], ELSE=0) <= 1)
    refused(m, "limit: Expr_if is not supported; write it with smooth functions")


def test_conditions_that_cross(m):
    m.x[1].setlb(3)
    m.x[1].setub(2)
    refused(m, "lower bound 3 is above upper bound 2")


def test_final_time_over_time(m):
    with pytest.raises(TranscriptionError, match=r"x: .*must be a static variable"):
        compile(m, final_time=m.x)


@pytest.mark.parametrize("tolerance", [0.0, -1e-6])
def test_tolerance(m, tolerance):
    refused(m, "tolerance: .*must be above 0", mesh=None, tolerance=tolerance)


def test_fixed_without_a_value(m):
    m.x[0].fix(None)
    refused(m, r"x\[0\.?0?\]: is fixed without a value")


def test_guess_of_unknown_name(m):
    refused(m, "guess: 'speed' is none of the model's variables", guess={"speed": 1.0})


def test_degree_that_is_not_whole():
    with pytest.raises(TranscriptionError, match="must be a whole number"):
        Mesh.uniform(3, 2.5)


def test_breakpoint_that_is_no_number():
    with pytest.raises(TranscriptionError, match="must increase strictly"):
        Mesh(breakpoints=(0.0, float("nan"), 1.0), degrees=(3, 3))
