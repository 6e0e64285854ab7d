"""Particle steering: the quickest thrust of constant size to a height and a speed along it.

    minimise    T
    subject to  y' = vy,  vx' = a cos(u),  vy' = a sin(u),  |u| <= pi / 2
                all 0 at first;  y(T) = 5,  vx(T) = 45,  vy(T) = 0;  a = 100

Source: Dolan, More and Munson (2004), COPS 3.0, Argonne ANL/MCS-TM-273, after Bryson and Ho
(1975), section 2.4.  Closed form: the tangent of u falls linearly from c to -c; two integrals
give c and T.
"""

import numpy as np
from pyomo.dae import ContinuousSet, DerivativeVar
from pyomo.environ import ConcreteModel, Constraint, Objective, Var, cos, minimize, sin
from scipy.optimize import fsolve

THRUST, HEIGHT, SPEED = 100.0, 5.0, 45.0
KINKS = ()


def build():
    m = ConcreteModel(name="steering")
    m.tau = ContinuousSet(bounds=(0, 1))
    m.duration = Var(bounds=(0.1, 10), initialize=1)
    m.y = Var(m.tau, initialize=lambda _m, t: HEIGHT * t)
    m.vx, m.vy = Var(m.tau, initialize=lambda _m, t: SPEED * t), Var(m.tau, initialize=0)
    m.u = Var(m.tau, bounds=(-np.pi / 2, np.pi / 2), initialize=0)
    m.dy = DerivativeVar(m.y, wrt=m.tau)
    m.dvx, m.dvy = DerivativeVar(m.vx, wrt=m.tau), DerivativeVar(m.vy, wrt=m.tau)
    m.up = Constraint(m.tau, rule=lambda m, t: m.dy[t] == m.duration * m.vy[t])
    m.push = Constraint(m.tau, rule=lambda m, t: m.dvx[t] == m.duration * THRUST * cos(m.u[t]))
    m.lift = Constraint(m.tau, rule=lambda m, t: m.dvy[t] == m.duration * THRUST * sin(m.u[t]))
    for start in (m.y[0], m.vx[0], m.vy[0]):
        start.fix(0)
    m.y[1].fix(HEIGHT)
    m.vx[1].fix(SPEED)
    m.vy[1].fix(0)
    m.objective = Objective(expr=m.duration, sense=minimize)
    return m


def _law():
    """Return the tangent of u at the start, and the duration."""
    nodes, weights = np.polynomial.legendre.leggauss(60)
    t, w = (nodes + 1) / 2, weights / 2

    def misses(unknown):
        tangent, duration = unknown
        u = np.arctan(tangent * (1 - 2 * t))
        height = duration**2 * THRUST * (w @ ((1 - t) * np.sin(u)))
        return [duration * THRUST * (w @ np.cos(u)) - SPEED, height - HEIGHT]

    return fsolve(misses, [1.0, 0.5], xtol=1e-14)


def objective():
    return _law()[1]


def control(t):
    return {"u": np.arctan(_law()[0] * (1 - 2 * t))}
