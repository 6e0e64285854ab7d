"""Brachistochrone: the quickest slide from (0, 0) to a point 10 m across and 5 m down.

    minimise    T
    subject to  x' = v sin(theta),  y' = v cos(theta),  v' = g cos(theta)
                x(0) = y(0) = v(0) = 0,  x(T) = 10,  y(T) = 5

The free final time T is a static variable that scales the equations on tau = t / T in [0, 1].
Source: Bernoulli (1696); with these numbers, the first example of several collocation codes.
Closed form: a cycloid of radius R, turned at the rate sqrt(g / R), with theta half the turn;
T = 1.8016031224531 s.
"""

import numpy as np
from pyomo.dae import ContinuousSet, DerivativeVar
from pyomo.environ import ConcreteModel, Constraint, Objective, Var, cos, minimize, sin
from scipy.optimize import brentq

ACROSS, DOWN, GRAVITY = 10.0, 5.0, 9.80665
KINKS = ()


def build():
    m = ConcreteModel(name="brachistochrone")
    m.tau = ContinuousSet(bounds=(0, 1))
    m.duration = Var(bounds=(0.1, 10), initialize=2)
    m.x = Var(m.tau)
    m.y = Var(m.tau)
    m.v = Var(m.tau, bounds=(0, None))
    m.theta = Var(m.tau, bounds=(0, np.pi), initialize=0.8)
    m.dx_dtau = DerivativeVar(m.x, wrt=m.tau)
    m.dy_dtau = DerivativeVar(m.y, wrt=m.tau)
    m.dv_dtau = DerivativeVar(m.v, wrt=m.tau)

    @m.Constraint(m.tau)
    def horizontal_motion(m, t):
        return m.dx_dtau[t] == m.duration * m.v[t] * sin(m.theta[t])

    @m.Constraint(m.tau)
    def vertical_motion(m, t):
        return m.dy_dtau[t] == m.duration * m.v[t] * cos(m.theta[t])

    @m.Constraint(m.tau)
    def fall(m, t):
        return m.dv_dtau[t] == m.duration * GRAVITY * cos(m.theta[t])

    for start in (m.x[0], m.y[0], m.v[0]):
        start.fix(0)
    m.arrives_across = Constraint(expr=m.x[1] == ACROSS)
    m.arrives_down = Constraint(expr=m.y[1] == DOWN)
    m.objective = Objective(expr=m.duration, sense=minimize)
    return m


def _cycloid():
    """Return the cycloid's whole turn and its radius."""
    turn = brentq(lambda a: (a - np.sin(a)) * DOWN - (1 - np.cos(a)) * ACROSS, 1.0, 6.0, xtol=1e-15)
    return turn, DOWN / (1 - np.cos(turn))


def objective():
    turn, radius = _cycloid()
    return turn * np.sqrt(radius / GRAVITY)


def state(t):
    turn, radius = _cycloid()
    return {
        "x": radius * (turn * t - np.sin(turn * t)),
        "y": radius * (1 - np.cos(turn * t)),
        "v": 2 * np.sqrt(GRAVITY * radius) * np.sin(turn * t / 2),
    }


def control(t):
    return {"theta": _cycloid()[0] * t / 2}


def costate(t):
    """Return what follows from p . f = -1 and from the free velocity at the end."""
    turn, radius = _cycloid()
    speed = 2 * np.sqrt(GRAVITY * radius)
    on_x = -1 / speed
    on_y = on_x / np.tan(turn / 2)
    on_v = -(np.cos(turn * t / 2) + on_y * state(t)["v"]) / GRAVITY
    return {"x": np.full_like(t, on_x), "y": np.full_like(t, on_y), "v": on_v}
