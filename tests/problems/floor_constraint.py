"""A first-order state constraint met head-on: go down, stay on the floor, come up.

    minimise    int_0^3 x dt
    subject to  x' = u,  |u| <= 1,  x >= 0,  x(0) = x(3) = 1

Source: Hartl, Sethi and Vickson (1995), SIAM Review 37, 181-218, in the manner of their
first examples.  Closed form: u = -1, 0, 1 on three stretches of length 1; optimum 1; the
costate falls at rate 1 on the first and the last and is zero on the floor.
"""

import numpy as np
from pyomo.dae import ContinuousSet, DerivativeVar, Integral
from pyomo.environ import ConcreteModel, Constraint, Objective, Var, minimize

KINKS = (1.0, 2.0)


def build():
    m = ConcreteModel(name="floor constraint")
    m.t = ContinuousSet(bounds=(0, 3))
    m.x = Var(m.t)
    m.u = Var(m.t, bounds=(-1, 1))
    m.dx_dt = DerivativeVar(m.x, wrt=m.t)

    @m.Constraint(m.t)
    def motion(m, t):
        return m.dx_dt[t] == m.u[t]

    @m.Constraint(m.t)
    def floor(m, t):
        return m.x[t] >= 0

    m.x[0].fix(1)
    m.return_to_start = Constraint(expr=m.x[3] == m.x[0])
    m.height = Integral(m.t, wrt=m.t, rule=lambda m, t: m.x[t])
    m.objective = Objective(expr=m.height, sense=minimize)
    return m


def objective():
    return 1.0


def state(t):
    return {"x": np.maximum(np.maximum(1 - t, t - 2), 0.0)}


def control(t):
    return {"u": np.where(t < 1, -1.0, np.where(t > 2, 1.0, 0.0))}


def costate(t):
    return {"x": np.where(t < 1, 1 - t, np.where(t > 2, 2 - t, 0.0))}
