"""A car driven 300 m from rest to rest in the least time: bang-bang control.

    minimise    T
    subject to  x' = v,  v' = u,  -2 <= u <= 1
                x(0) = v(0) = 0,  x(T) = 300,  v(T) = 0

The free final time T is a static variable that scales the equations on tau = t / T in [0, 1].
Source: Bryson and Ho (1975), section 3.9, with unequal limits so that the switch does not
fall on the middle.  Closed form: full acceleration for 20 s, full braking for 10 s.
"""

import numpy as np
from pyomo.dae import ContinuousSet, DerivativeVar
from pyomo.environ import ConcreteModel, Constraint, Objective, Var, minimize

DISTANCE, ACCELERATION, BRAKING = 300.0, 1.0, 2.0
TOP_SPEED = np.sqrt(2 * DISTANCE / (1 / ACCELERATION + 1 / BRAKING))
SWITCH = BRAKING / (ACCELERATION + BRAKING)
KINKS = (SWITCH,)


def build():
    m = ConcreteModel(name="bang-bang")
    m.tau = ContinuousSet(bounds=(0, 1))
    m.duration = Var(bounds=(1, 100), initialize=20)
    m.x = Var(m.tau)
    m.v = Var(m.tau)
    m.u = Var(m.tau, bounds=(-BRAKING, ACCELERATION))
    m.dx_dtau = DerivativeVar(m.x, wrt=m.tau)
    m.dv_dtau = DerivativeVar(m.v, wrt=m.tau)

    @m.Constraint(m.tau)
    def motion(m, t):
        return m.dx_dtau[t] == m.duration * m.v[t]

    @m.Constraint(m.tau)
    def force(m, t):
        return m.dv_dtau[t] == m.duration * m.u[t]

    m.x[0].fix(0)
    m.v[0].fix(0)
    m.arrival = Constraint(expr=m.x[1] == DISTANCE)
    m.rest = Constraint(expr=m.v[1] == 0)
    m.objective = Objective(expr=m.duration, sense=minimize)
    return m


def objective():
    return TOP_SPEED * (1 / ACCELERATION + 1 / BRAKING)


def control(t):
    return {"u": np.where(t < SWITCH, ACCELERATION, -BRAKING)}


def costate(t):
    """Return what follows from p . f = -1: the costate of v passes zero at the switch."""
    on_v = (t / SWITCH - 1) / ACCELERATION
    return {"x": np.full_like(t, -1 / TOP_SPEED), "v": on_v}
