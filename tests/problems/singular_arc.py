"""A second-order singular regulator: full braking, then a singular arc.

    minimise    1/2 int_0^5 (x^2 + v^2) dt
    subject to  x' = v,  v' = u,  |u| <= 1,  x(0) = 0,  v(0) = 1

The control enters linearly and not the cost, so on the arc stationarity does not give it.
Source: Aly (1978), International Journal of Control 28, 681-688.
Closed form: u = -1 until the switch s; then the costate of v is zero, hence p_x = -v and
u = x, and x = c cosh(5 - t), v = -c sinh(5 - t); s makes the two pieces meet.
"""

import numpy as np
from pyomo.dae import ContinuousSet, DerivativeVar, Integral
from pyomo.environ import ConcreteModel, Objective, Var, minimize
from scipy.optimize import brentq

HORIZON = 5.0


def _braking(t):
    """Return x and v while u = -1."""
    return t - t**2 / 2, 1 - t


def _mismatch(switch):
    x, v = _braking(switch)
    return v + x * np.tanh(HORIZON - switch)


SWITCH = brentq(_mismatch, 1.1, 1.9, xtol=1e-15)
SIZE = _braking(SWITCH)[0] / np.cosh(HORIZON - SWITCH)
KINKS = (SWITCH,)


def build():
    m = ConcreteModel(name="singular arc")
    m.t = ContinuousSet(bounds=(0, HORIZON))
    m.x = Var(m.t)
    m.v = Var(m.t)
    m.u = Var(m.t, bounds=(-1, 1))
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
    m.cost = Integral(m.t, wrt=m.t, rule=lambda m, t: (m.x[t] ** 2 + m.v[t] ** 2) / 2)
    m.objective = Objective(expr=m.cost, sense=minimize)
    return m


def objective():
    s = SWITCH
    braking = s**3 / 3 - s**4 / 4 + s**5 / 20 + (1 - (1 - s) ** 3) / 3
    return braking / 2 + SIZE**2 * np.sinh(2 * (HORIZON - s)) / 4


def state(t):
    x, v = _braking(t)
    on_arc = t >= SWITCH
    return {
        "x": np.where(on_arc, SIZE * np.cosh(HORIZON - t), x),
        "v": np.where(on_arc, -SIZE * np.sinh(HORIZON - t), v),
    }


def control(t):
    return {"u": np.where(t >= SWITCH, state(t)["x"], -1.0)}


def costate(t):
    """Return p_x' = -x and p_v' = -v - p_x, integrated backwards from the arc."""
    s = SWITCH
    on_arc = t >= s
    at_switch = SIZE * np.sinh(HORIZON - s)
    area = s**2 / 2 - s**3 / 6
    on_x = at_switch + area - (t**2 / 2 - t**3 / 6)
    travelled = (s - s**2 / 2) - (t - t**2 / 2)
    on_v = travelled + (at_switch + area) * (s - t) - (s**3 - t**3) / 6 + (s**4 - t**4) / 24
    return {
        "x": np.where(on_arc, SIZE * np.sinh(HORIZON - t), on_x),
        "v": np.where(on_arc, 0.0, on_v),
    }
