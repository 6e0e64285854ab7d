"""A mass moved 1 m in 1 s from rest to rest with the least effort.

    minimise    1/2 int_0^1 u^2 dt
    subject to  x' = v,  v' = u,  x(0) = v(0) = 0,  x(1) = 1,  v(1) = 0

Source: any text on optimal control, for instance Bryson and Ho (1975), section 5.2.
Closed form: u = 6 - 12 t, optimum 6, costates linear in time.
"""

import numpy as np
from pyomo.dae import ContinuousSet, DerivativeVar, Integral
from pyomo.environ import ConcreteModel, Constraint, Objective, Var, minimize

KINKS = ()


def build():
    m = ConcreteModel(name="double integrator, least effort")
    m.t = ContinuousSet(bounds=(0, 1))
    m.x = Var(m.t)
    m.v = Var(m.t)
    m.u = Var(m.t)
    m.dx_dt = DerivativeVar(m.x, wrt=m.t)
    m.dv_dt = DerivativeVar(m.v, wrt=m.t)

    @m.Constraint(m.t)
    def motion(m, t):
        return m.dx_dt[t] == m.v[t]

    @m.Constraint(m.t)
    def force(m, t):
        return m.dv_dt[t] == m.u[t]

    m.x[0].fix(0)
    m.v[0].fix(0)
    m.arrival = Constraint(expr=m.x[1] == 1)
    m.rest = Constraint(expr=m.v[1] == 0)
    m.effort = Integral(m.t, wrt=m.t, rule=lambda m, t: m.u[t] ** 2 / 2)
    m.objective = Objective(expr=m.effort, sense=minimize)
    return m


def objective():
    return 6.0


def state(t):
    return {"x": 3 * t**2 - 2 * t**3, "v": 6 * t - 6 * t**2}


def control(t):
    return {"u": 6 - 12 * t}


def costate(t):
    return {"x": np.full_like(t, -12.0), "v": 12 * t - 6}
