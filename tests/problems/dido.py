"""Dido's problem: the most land between a straight shore and a rope of given length.

    maximise    int_0^1 y ds
    subject to  y' = slope,  y(0) = y(1) = 0,  int_0^1 sqrt(1 + slope^2) ds = pi / 3

The independent variable is the distance s along the shore; the rope is an integral constraint.
Source: Kot (2014), A First Course in the Calculus of Variations, section 4.2.
Closed form: an arc of a circle; at this length its radius is 1 and the land is
pi / 6 - sqrt(3) / 4.  The costate is that of the minimum of minus the land.
"""

import numpy as np
from pyomo.dae import ContinuousSet, DerivativeVar, Integral
from pyomo.environ import ConcreteModel, Constraint, Objective, Var, maximize, sqrt

ROPE = np.pi / 3
KINKS = ()


def build():
    m = ConcreteModel(name="Dido")
    m.s = ContinuousSet(bounds=(0, 1))
    m.y = Var(m.s)
    m.slope = Var(m.s, bounds=(-5, 5))
    m.dy_ds = DerivativeVar(m.y, wrt=m.s)

    @m.Constraint(m.s)
    def course(m, s):
        return m.dy_ds[s] == m.slope[s]

    m.y[0].fix(0)
    m.y[1].fix(0)
    m.length = Integral(m.s, wrt=m.s, rule=lambda m, s: sqrt(1 + m.slope[s] ** 2))
    m.rope = Constraint(expr=m.length == ROPE)
    m.land = Integral(m.s, wrt=m.s, rule=lambda m, s: m.y[s])
    m.objective = Objective(expr=m.land, sense=maximize)

    for s in m.s:
        m.y[s].set_value(0.1 * s * (1 - s))
    return m


def objective():
    return np.pi / 6 - np.sqrt(3) / 4


def state(s):
    return {"y": np.sqrt(1 - (s - 0.5) ** 2) - np.sqrt(3) / 2}


def control(s):
    return {"slope": (0.5 - s) / np.sqrt(1 - (s - 0.5) ** 2)}


def costate(s):
    return {"y": s - 0.5}
