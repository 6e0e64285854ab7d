"""A hyper-sensitive problem: two boundary layers with a long quiet stretch between them.

    minimise    1/2 int_0^40 (x^2 + u^2) dt
    subject to  x' = -x + u,  x(0) = 1.5,  x(40) = 1

Source: Rao and Mease (2000), Optimal Control Applications and Methods 21, 1-19, in its linear
form.  Closed form: with u = -p the pair (x, p) obeys a linear system of eigenvalues
-sqrt(2) and sqrt(2), and the optimum is (p(0) x(0) - p(40) x(40)) / 2.
"""

import numpy as np
from pyomo.dae import ContinuousSet, DerivativeVar, Integral
from pyomo.environ import ConcreteModel, Objective, Var, minimize

START, END, HORIZON = 1.5, 1.0, 40.0
RATE = np.sqrt(2)
KINKS = ()


def build():
    m = ConcreteModel(name="hyper-sensitive")
    m.t = ContinuousSet(bounds=(0, HORIZON))
    m.x = Var(m.t)
    m.u = Var(m.t)
    m.dx_dt = DerivativeVar(m.x, wrt=m.t)

    @m.Constraint(m.t)
    def decay(m, t):
        return m.dx_dt[t] == -m.x[t] + m.u[t]

    m.x[0].fix(START)
    m.x[HORIZON].fix(END)
    m.cost = Integral(m.t, wrt=m.t, rule=lambda m, t: (m.x[t] ** 2 + m.u[t] ** 2) / 2)
    m.objective = Objective(expr=m.cost, sense=minimize)
    return m


def _layers(t):
    """Return the parts of x that decay from the start and grow towards the end."""
    gone = np.exp(-RATE * HORIZON)
    from_start = (START - END * gone) / (1 - gone**2)
    from_end = (END - START * gone) / (1 - gone**2)
    return from_start * np.exp(-RATE * t), from_end * np.exp(-RATE * (HORIZON - t))


def objective():
    first, last = costate(0.0)["x"], costate(HORIZON)["x"]
    return float(first * START - last * END) / 2


def state(t):
    decaying, growing = _layers(t)
    return {"x": decaying + growing}


def control(t):
    return {"u": -costate(t)["x"]}


def costate(t):
    decaying, growing = _layers(t)
    return {"x": (RATE - 1) * decaying - (RATE + 1) * growing}
