"""An implicit DAE: the derivative stands inside a nonlinear law, beside algebraic variables.

A damper that stiffens is pulled with force f; the estimate r of its rate obeys the same law.

    minimise    1/2 int_0^1 (x^2 + r^2) dt
    subject to  x' + x'^3 = f,  r + r^3 = f,  x(0) = 0,  x(1) = 1

Closed form: the law grows with its argument, so r = x' and the problem is x'' = x in disguise:
x = sinh(t) / sinh(1), f = x' + x'^3, optimum coth(1) / 2, costate -x'.
"""

import numpy as np
from pyomo.dae import ContinuousSet, DerivativeVar, Integral
from pyomo.environ import ConcreteModel, Objective, Var, minimize

KINKS = ()


def build():
    m = ConcreteModel(name="implicit DAE")
    m.t = ContinuousSet(bounds=(0, 1))
    m.x = Var(m.t)
    m.force = Var(m.t)
    m.rate = Var(m.t)
    m.dx_dt = DerivativeVar(m.x, wrt=m.t)

    @m.Constraint(m.t)
    def damper(m, t):
        return m.dx_dt[t] + m.dx_dt[t] ** 3 == m.force[t]

    @m.Constraint(m.t)
    def estimated_damper(m, t):
        return m.force[t] == m.rate[t] + m.rate[t] ** 3

    m.x[0].fix(0)
    m.x[1].fix(1)
    m.cost = Integral(m.t, wrt=m.t, rule=lambda m, t: (m.x[t] ** 2 + m.rate[t] ** 2) / 2)
    m.objective = Objective(expr=m.cost, sense=minimize)
    return m


def objective():
    return 0.5 / np.tanh(1.0)


def state(t):
    return {"x": np.sinh(t) / np.sinh(1.0)}


def control(t):
    rate = np.cosh(t) / np.sinh(1.0)
    return {"rate": rate, "force": rate + rate**3}


def costate(t):
    return {"x": -np.cosh(t) / np.sinh(1.0)}
