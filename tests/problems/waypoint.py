"""An interior-point condition: a mass goes out to a waypoint at t = 0.4 and comes back.

    minimise    1/2 int_0^1 u^2 dt
    subject to  x' = v,  v' = u,  x(0) = v(0) = x(1) = v(1) = 0,  x(0.4) = 1

Source: Bryson and Ho (1975), section 3.5.  Closed form: a cubic spline, which passes the
waypoint at v = 3 (1 / 0.4 - 1 / 0.6) / 2; the costate of x jumps there.
"""

import numpy as np
from pyomo.dae import ContinuousSet, DerivativeVar, Integral
from pyomo.environ import ConcreteModel, Constraint, Objective, Var, minimize

WAYPOINT_TIME = 0.4
BACK_TIME = 1 - WAYPOINT_TIME
SPEED = 1.5 * (1 / WAYPOINT_TIME - 1 / BACK_TIME)
KINKS = (WAYPOINT_TIME,)


def build():
    m = ConcreteModel(name="waypoint")
    m.t = ContinuousSet(initialize=[0, WAYPOINT_TIME, 1])
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

    for t in (0, 1):
        m.x[t].fix(0)
        m.v[t].fix(0)
    m.waypoint = Constraint(expr=m.x[WAYPOINT_TIME] == 1)
    m.effort = Integral(m.t, wrt=m.t, rule=lambda m, t: m.u[t] ** 2 / 2)
    m.objective = Objective(expr=m.effort, sense=minimize)
    return m


def _effort(duration):
    """Return the least effort between rest and the waypoint, passed at its best speed."""
    facing = SPEED if duration == WAYPOINT_TIME else -SPEED
    return 6 / duration**3 - 6 * facing / duration**2 + 2 * facing**2 / duration


def objective():
    return _effort(WAYPOINT_TIME) + _effort(BACK_TIME)


def _from_rest(since, duration, speed):
    """Return u and its slope on the cubic from rest to 1 at a speed."""
    slope = (6 * speed * duration - 12) / duration**3
    return (6 - 2 * speed * duration) / duration**2 + slope * since, slope


def control(t):
    out, _ = _from_rest(t, WAYPOINT_TIME, SPEED)
    back, _ = _from_rest(1 - t, BACK_TIME, -SPEED)
    return {"u": np.where(t < WAYPOINT_TIME, out, back)}


def costate(t):
    """Return p_v = -u and p_x = -p_v' = u'; the way back runs against time."""
    _, out = _from_rest(t, WAYPOINT_TIME, SPEED)
    _, back = _from_rest(1 - t, BACK_TIME, -SPEED)
    return {"x": np.where(t < WAYPOINT_TIME, out, -back), "v": -control(t)["u"]}
