"""A regulator whose every number is a mutable parameter, with a Mayer term.

    minimise    1/2 s x(T)^2 + 1/2 int_0^T (q x^2 + r u^2) dt
    subject to  x' = a x + b u,  x(0) = x0

Source: Bryson and Ho (1975), section 5.2.  Closed form: (x, p) obeys a linear system; its
matrix exponential from T back to t, on (1, s), gives both up to a factor; u = -b p / r and
the optimum is p(0) x0 / 2.
"""

import numpy as np
from pyomo.dae import ContinuousSet, DerivativeVar, Integral
from pyomo.environ import ConcreteModel, Objective, Param, Var, minimize
from scipy.linalg import expm

DURATION = 2.0
DEFAULTS = {"a": 0.5, "b": 1.0, "q": 2.0, "r": 0.5, "s": 3.0, "x0": 1.0}
KINKS = ()


def build():
    m = ConcreteModel(name="scalar regulator")
    m.t = ContinuousSet(bounds=(0, DURATION))
    for name, number in DEFAULTS.items():
        m.add_component(name, Param(initialize=number, mutable=True))
    m.x = Var(m.t)
    m.u = Var(m.t)
    m.dx_dt = DerivativeVar(m.x, wrt=m.t)

    @m.Constraint(m.t)
    def plant(m, t):
        return m.dx_dt[t] == m.a * m.x[t] + m.b * m.u[t]

    @m.Constraint()
    def start(m):
        return m.x[0] == m.x0

    m.cost = Integral(m.t, wrt=m.t, rule=lambda m, t: (m.q * m.x[t] ** 2 + m.r * m.u[t] ** 2) / 2)
    m.objective = Objective(expr=m.cost + m.s * m.x[DURATION] ** 2 / 2, sense=minimize)
    return m


def _pair(t, numbers):
    """Return x and p at times, shape (n, 2)."""
    a, b, q, r, s, x0 = (numbers[name] for name in DEFAULTS)
    hamiltonian = np.array([[a, -(b**2) / r], [-q, -a]])
    back = [expm(hamiltonian * (time - DURATION)) @ [1, s] for time in (0.0, *np.atleast_1d(t))]
    return np.array(back)[1:] * x0 / back[0][0]


def objective(**changes):
    numbers = DEFAULTS | changes
    return float(_pair(0.0, numbers)[0, 1]) * numbers["x0"] / 2


def state(t, **changes):
    return {"x": _pair(t, DEFAULTS | changes)[:, 0]}


def control(t, **changes):
    numbers = DEFAULTS | changes
    return {"u": -numbers["b"] / numbers["r"] * _pair(t, numbers)[:, 1]}


def costate(t, **changes):
    return {"x": _pair(t, DEFAULTS | changes)[:, 1]}
