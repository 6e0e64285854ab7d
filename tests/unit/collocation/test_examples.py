"""Models in the forms of Pyomo's own `examples/dae`, held against other answers."""

import numpy as np
import pytest
from pyomo.dae import ContinuousSet, DerivativeVar
from pyomo.environ import ConcreteModel, Constraint, ConstraintList, Objective, Param, Set, Var, sin
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.optimize import brentq

from pyomo_quad.collocation import solve

LENGTH, DRAG, THRUST, BRAKE = 100.0, 0.001, 1.0, 3.0


def car():
    """The quickest drive over a distance and to a stop, the time scaled by its own end."""
    m = ConcreteModel()
    m.R = Param(initialize=DRAG)
    m.L = Param(initialize=LENGTH)
    m.tau = ContinuousSet(bounds=(0, 1))
    m.time, m.x, m.v = Var(m.tau), Var(m.tau, bounds=(0, LENGTH + 50)), Var(m.tau, bounds=(0, None))
    m.a = Var(m.tau, bounds=(-BRAKE, THRUST), initialize=0)
    m.tf = Var(bounds=(1, None), initialize=20)
    m.dtime, m.dx = DerivativeVar(m.time), DerivativeVar(m.x)
    m.dv = DerivativeVar(m.v)
    m.obj = Objective(expr=m.tf)
    skip = Constraint.Skip
    m.ode1 = Constraint(m.tau, rule=lambda m, i: skip if i == 0 else m.dx[i] == m.tf * m.v[i])
    m.ode2 = Constraint(
        m.tau,
        rule=lambda m, i: skip if i == 0 else m.dv[i] == m.tf * (m.a[i] - m.R * m.v[i] ** 2),
    )
    m.ode3 = Constraint(m.tau, rule=lambda m, i: skip if i == 0 else m.dtime[i] == m.tf)

    def initial(m):
        yield m.x[0] == 0
        yield m.x[1] == m.L
        yield m.v[0] == 0
        yield m.v[1] == 0
        yield m.time[0] == 0

    m.initcon = ConstraintList(rule=initial)
    return m


def quickest_drive():
    """Full thrust to a speed from which full braking ends at the distance, by closed forms."""

    def ways(speed):
        up = -np.log(1 - DRAG * speed**2 / THRUST) / (2 * DRAG)
        down = np.log(1 + DRAG * speed**2 / BRAKE) / (2 * DRAG)
        return up + down

    speed = brentq(lambda v: ways(v) - LENGTH, 1, 30, xtol=1e-14)
    top, low = np.sqrt(THRUST / DRAG), np.sqrt(BRAKE / DRAG)
    accelerating = np.arctanh(speed / top) / np.sqrt(THRUST * DRAG)
    return accelerating + np.arctan(speed / low) / np.sqrt(BRAKE * DRAG)


def test_a_car_by_a_list_of_conditions_and_rules_that_skip_the_start():
    solution = solve(car())
    assert solution.is_converged
    assert solution.objective == pytest.approx(quickest_drive(), rel=2e-6)


def test_a_pendulum_as_the_simulator_takes_it():
    m = ConcreteModel()
    m.t = ContinuousSet(bounds=(0.0, 10.0))
    m.b, m.c = Param(initialize=0.25), Param(initialize=5.0)
    m.omega, m.theta = Var(m.t), Var(m.t)
    m.domegadt, m.dthetadt = DerivativeVar(m.omega, wrt=m.t), DerivativeVar(m.theta, wrt=m.t)
    m.omega[0].fix(0.0)
    m.theta[0].fix(3.14 - 0.1)
    m.diffeq1 = Constraint(
        m.t, rule=lambda m, t: m.domegadt[t] == -m.b * m.omega[t] - m.c * sin(m.theta[t])
    )
    m.diffeq2 = Constraint(m.t, rule=lambda m, t: m.dthetadt[t] == m.omega[t])
    solution = solve(m, tolerance=1e-8)
    flown = solve_ivp(
        lambda _t, s: (-0.25 * s[0] - 5 * np.sin(s[1]), s[0]),
        (0, 10),
        (0, 3.04),
        rtol=1e-11,
        atol=1e-12,
    )
    assert solution.value("theta", 10.0) == pytest.approx(flown.y[1, -1], abs=1e-6)


def test_reactions_indexed_by_sets_with_their_stoichiometry():
    m = ConcreteModel()
    m.species, m.reactions = Set(initialize=["A", "B", "C"]), Set(initialize=[1, 2])
    m.k = Param(m.reactions, initialize={1: 2.0, 2: 0.7})
    m.made = Param(
        m.species,
        m.reactions,
        initialize={("A", 1): -1, ("B", 1): 1, ("B", 2): -1, ("C", 2): 1},
        default=0,
    )
    m.eaten = Param(m.reactions, initialize={1: "A", 2: "B"}, within=m.species)
    m.t = ContinuousSet(bounds=(0, 3))
    m.c = Var(m.t, m.species, bounds=(0, None))
    m.rate = Var(m.t, m.reactions)
    m.dcdt = DerivativeVar(m.c, wrt=m.t)

    @m.Constraint(m.t, m.reactions)
    def kinetics(m, t, r):
        return m.rate[t, r] == m.k[r] * m.c[t, m.eaten[r]]

    @m.Constraint(m.t, m.species)
    def balance(m, t, s):
        return m.dcdt[t, s] == sum(m.made[s, r] * m.rate[t, r] for r in m.reactions)

    for species, first in (("A", 1), ("B", 0), ("C", 0)):
        m.c[0, species].fix(first)
    solution = solve(m, tolerance=1e-8)
    exact = expm(3 * np.array([[-2, 0, 0], [2, -0.7, 0], [0, 0.7, 0]])) @ [1, 0, 0]
    found = [solution.value("c", 3.0, index=s) for s in "ABC"]
    assert found == pytest.approx(exact.tolist(), abs=1e-8)
