"""Bryson-Denham: a mass that must turn round before a wall (second-order state constraint).

    minimise    1/2 int_0^1 u^2 dt
    subject to  x' = v,  v' = u,  x <= 1/9
                x(0) = 0, v(0) = 1,  x(1) = 0, v(1) = -1

Source: Bryson and Ho (1975), Applied Optimal Control, section 3.11, with the wall at l = 1/9.
Closed form for l <= 1/6: the mass touches the wall from t = 3 l to t = 1 - 3 l, the optimum is
4 / (9 l), and the costate of x jumps at both ends of the touch.
"""

import numpy as np
from pyomo.dae import ContinuousSet, DerivativeVar, Integral
from pyomo.environ import ConcreteModel, Constraint, Objective, Var, minimize

WALL = 1 / 9
KINKS = (3 * WALL, 1 - 3 * WALL)


def build():
    m = ConcreteModel(name="Bryson-Denham")
    m.t = ContinuousSet(bounds=(0, 1))
    m.x = Var(m.t, bounds=(None, WALL))
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
    m.v[0].fix(1)
    m.end_position = Constraint(expr=m.x[1] == 0)
    m.end_velocity = Constraint(expr=m.v[1] == -1)

    m.effort = Integral(m.t, wrt=m.t, rule=lambda m, t: m.u[t] ** 2 / 2)
    m.objective = Objective(expr=m.effort, sense=minimize)
    return m


def objective():
    return 4 / (9 * WALL)


def control(t):
    before = -2 / (3 * WALL) * (1 - t / (3 * WALL))
    after = -2 / (3 * WALL) * (1 - (1 - t) / (3 * WALL))
    return {"u": np.where(t < KINKS[0], before, np.where(t > KINKS[1], after, 0.0))}


def costate(t):
    slope = 2 / (9 * WALL**2)
    on_x = np.where(t < KINKS[0], slope, np.where(t > KINKS[1], -slope, 0.0))
    return {"x": on_x, "v": -control(t)["u"]}
