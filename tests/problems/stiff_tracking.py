"""A stiff problem: a fast plant pushed onto a slow reference (Prothero-Robinson).

    minimise    1/2 int_0^1 ((x - r)^2 + u^2) dt,   r = cos(t)
    subject to  x' = -k (x - r) + r' + u,  x(0) = r(0) + 1,  k = 1000

Source: Prothero and Robinson (1974), Mathematics of Computation 28, 145-162, with a control.
Closed form: e = x - r is a linear regulator; with s = sqrt(k^2 + 1) and z = s (1 - t),
e ~ s cosh(z) + k sinh(z), p ~ sinh(z), u = -p, optimum p(0) e(0) / 2.
"""

import numpy as np
from pyomo.dae import ContinuousSet, DerivativeVar, Integral
from pyomo.environ import ConcreteModel, Objective, Var, cos, minimize, sin

STIFFNESS = 1000.0
RATE = np.hypot(STIFFNESS, 1.0)
KINKS = ()


def build():
    m = ConcreteModel(name="stiff tracking")
    m.t = ContinuousSet(bounds=(0, 1))
    m.x = Var(m.t)
    m.u = Var(m.t)
    m.dx_dt = DerivativeVar(m.x, wrt=m.t)

    @m.Constraint(m.t)
    def plant(m, t):
        return m.dx_dt[t] == -STIFFNESS * (m.x[t] - cos(t)) - sin(t) + m.u[t]

    m.x[0].fix(2)
    m.cost = Integral(m.t, wrt=m.t, rule=lambda m, t: ((m.x[t] - cos(t)) ** 2 + m.u[t] ** 2) / 2)
    m.objective = Objective(expr=m.cost, sense=minimize)
    return m


def _error_and_costate(t):
    """Return e and p, both hyperbolic functions of 1 - t divided by e at the start."""
    at_start = RATE * (1 + np.exp(-2 * RATE)) + STIFFNESS * (1 - np.exp(-2 * RATE))
    falling, rising = np.exp(-RATE * t), np.exp(-RATE * (2 - t))
    error = RATE * (falling + rising) + STIFFNESS * (falling - rising)
    return error / at_start, (falling - rising) / at_start


def objective():
    return float(_error_and_costate(0.0)[1]) / 2


def state(t):
    return {"x": np.cos(t) + _error_and_costate(t)[0]}


def control(t):
    return {"u": -_error_and_costate(t)[1]}


def costate(t):
    return {"x": _error_and_costate(t)[1]}
