"""As many equations as unknowns, or more, where some of them follow from the others."""

import numpy as np
import pytest
from pyomo.dae import ContinuousSet, DerivativeVar
from pyomo.environ import ConcreteModel, Constraint, Objective, RangeSet, Var
from scipy.integrate import solve_ivp

from pyomo_quad.collocation import Mesh, Status, TranscriptionError, compile, solve


def oscillator():
    """Least time on a circle whose radius is conserved: at once, which is at T = 1."""
    m = ConcreteModel()
    m.t = ContinuousSet(bounds=(0, 1))
    m.T = Var(bounds=(1, 9), initialize=3)
    m.x, m.v = Var(m.t, initialize=1), Var(m.t)
    m.dx, m.dv = DerivativeVar(m.x, wrt=m.t), DerivativeVar(m.v, wrt=m.t)
    m.motion = Constraint(m.t, rule=lambda m, t: m.dx[t] == m.v[t])
    m.spring = Constraint(m.t, rule=lambda m, t: m.dv[t] == -m.x[t])
    m.x[0].fix(1)
    m.v[0].fix(0)
    m.cost = Objective(expr=m.T)
    return m


@pytest.mark.parametrize(
    "arguments",
    [{}, {"tolerance": 1e-8}, {"mesh": Mesh.uniform(10, 4)}, {"mesh": Mesh.uniform(10, 6)}],
    ids=["refined", "refined more", "fixed mesh", "fixed mesh of degree 6"],
)
def test_an_objective_counts_where_an_end_condition_is_met_anyway(arguments):
    m = oscillator()
    m.circle = Constraint(expr=m.x[1] ** 2 + m.v[1] ** 2 == 1)
    solution = solve(m, final_time=m.T, **arguments)
    assert solution.is_converged
    assert solution.objective == pytest.approx(1.0, abs=1e-6)


def test_a_square_program_that_leaves_no_choice_is_solved():
    m = oscillator()
    m.there = Constraint(expr=m.v[1] == -np.sin(1.25))
    m.T.setub(1.5)
    solution = solve(m, final_time=m.T, mesh=Mesh.uniform(10, 6))
    assert solution.is_converged
    assert solution.objective == pytest.approx(1.25, abs=1e-9)
    assert solution.warnings == ()


def test_an_end_that_contradicts_is_infeasible_although_its_size_is_right():
    m = oscillator()
    m.circle = Constraint(expr=m.x[1] ** 2 + m.v[1] ** 2 == 1.1)
    solution = solve(m, final_time=m.T, mesh=Mesh.uniform(4, 5))
    assert solution.status is Status.INFEASIBLE
    assert solution.message.startswith("infeasible: ")


def test_linear_equations_that_contradict_are_refused():
    m = oscillator()
    m.x[1].fix(0.3)
    m.v[1].fix(0.3)
    with pytest.raises(
        TranscriptionError, match=r"160 equations for 159 free unknowns.*over-determ"
    ):
        compile(m).solve(mesh=Mesh.uniform(20, 4))


# Three equal masses on a figure of eight: Chenciner and Montgomery (2000), Annals of Mathematics
# 152, 881-901, with the digits of C. Simo.
PERIOD = 6.32591398
PLACE, SPEED = np.array([0.97000436, -0.24308753]), np.array([-0.93240737, -0.86473146])
PLACES = np.array([PLACE, -PLACE, 0 * PLACE])
SPEEDS = np.array([-SPEED / 2, -SPEED / 2, SPEED])


def figure_eight():
    """Its closed orbit nearest to the published one, with each end condition written out.

    Two of the end conditions follow from the conserved momentum, two nearly do from energy and
    angular momentum.
    """
    m = ConcreteModel()
    m.t = ContinuousSet(bounds=(0, 1))
    m.T = Var(bounds=(5, 8), initialize=6.3)
    m.body, m.axis = RangeSet(0, 2), RangeSet(0, 1)
    m.q, m.p = Var(m.body, m.axis, m.t), Var(m.body, m.axis, m.t)
    m.dq, m.dp = DerivativeVar(m.q, wrt=m.t), DerivativeVar(m.p, wrt=m.t)

    @m.Constraint(m.body, m.axis, m.t)
    def motion(m, b, a, t):
        return m.dq[b, a, t] == m.p[b, a, t]

    @m.Constraint(m.body, m.axis, m.t)
    def gravity(m, b, a, t):
        def cubed(o):
            return sum((m.q[b, k, t] - m.q[o, k, t]) ** 2 for k in m.axis) ** 1.5

        others = (o for o in m.body if o != b)
        return m.dp[b, a, t] == sum((m.q[o, a, t] - m.q[b, a, t]) / cubed(o) for o in others)

    pairs = {"q": (m.q, PLACES), "p": (m.p, SPEEDS)}
    for name, (state, _) in pairs.items():
        closed = Constraint(m.body, m.axis, rule=lambda m, b, a, s=state: s[b, a, 1] == s[b, a, 0])
        m.add_component(f"closed_{name}", closed)
    m.phase = Constraint(expr=m.q[2, 0, 0] + m.q[2, 1, 0] == 0)
    for a in m.axis:
        m.q[0, a, 0].fix(PLACE[a])
    m.miss = Objective(
        expr=sum(
            (state[b, a, 0] - published[b, a]) ** 2
            for state, published in pairs.values()
            for b in m.body
            for a in m.axis
        )
    )
    return m


NAMES = [f"{s}[{b},{a}]" for s in "qp" for b in range(3) for a in range(2)]


def flown(start, duration):
    """Return the path of three bodies over shares of a duration."""

    def rates(_, y):
        q, a = y[:6].reshape(3, 2), np.zeros((3, 2))
        for b in range(3):
            for o in {0, 1, 2} - {b}:
                a[b] += (q[o] - q[b]) / np.linalg.norm(q[o] - q[b]) ** 3
        return np.concatenate([y[6:], a.ravel()])

    path = solve_ivp(rates, (0, duration), start, rtol=1e-9, atol=1e-9, dense_output=True).sol
    return lambda share: path(duration * share)


def orbit_guess():
    path = flown(np.concatenate([PLACES.ravel(), SPEEDS.ravel()]), PERIOD)
    of_time = {n: lambda t, k=k: 1.01 * path(t)[k] for k, n in enumerate(NAMES)}
    return of_time | {"T": 6.3}


@pytest.mark.slow
def test_end_conditions_that_follow_from_others_are_taken_with_a_warning():
    m = figure_eight()
    problem = compile(m, final_time=m.T)
    solution = problem.solve(mesh=Mesh.uniform(12, 6), guess=orbit_guess())
    assert solution.is_converged
    duration, states = solution.value("T"), solution.to_frame()[NAMES].to_numpy()
    assert 5 < duration < 8
    np.testing.assert_allclose(flown(states[0], duration)(1.0), states[0], atol=3e-3)
    assert solution.warnings[0].startswith("model: 877 equations for 875 free unknowns; ")
    assert "follow from the others and were left out of the solve" in solution.warnings[0]
