"""Goddard's rocket in three phases: full thrust, a singular arc, a coast; all times are free.

    maximise    h(T3)
    subject to  h' = v,  v' = (F - D) / m - g,  m' = -F / c,  D = s v^2 exp(-h / H)
                F = 193.044 until T1, on the singular arc until T2, 0 until T3
                h = v = 0 and m = 3 at first, m = 1 at last

with the arc's condition on h, v, m that the switching function and its first two rates vanish.
Source: J. T. Betts, Practical Methods for Optimal Control and Estimation, 2nd ed. (2010),
section 4.14; English units.  YAPSS ships the same problem as an example of three phases.
"""

from pyomo.dae import ContinuousSet, DerivativeVar
from pyomo.environ import ConcreteModel, Constraint, Objective, Var, exp, maximize

THRUST, GRAVITY, EXHAUST = 193.044, 32.174, 1580.9425279876559
DRAG, SCALE_HEIGHT = 5.49153484923381010e-5, 23_800.0


def build():
    m = ConcreteModel(name="goddard")
    m.t = ContinuousSet(initialize=[0, 15, 22, 45])
    m.h = Var(m.t, bounds=(0, 30_000), initialize=0)
    m.v = Var(m.t, bounds=(0, 2_000), initialize=0)
    m.m = Var(m.t, bounds=(1, 3), initialize=3)
    m.thrust = Var(m.t, bounds=(0, THRUST), initialize=THRUST)
    m.burnt, m.coasting, m.top = (Var(bounds=(5, 45)) for _ in range(3))
    m.dh_dt, m.dv_dt, m.dm_dt = (DerivativeVar(x, wrt=m.t) for x in (m.h, m.v, m.m))

    @m.Expression(m.t)
    def drag(m, t):
        return DRAG * m.v[t] ** 2 * exp(-m.h[t] / SCALE_HEIGHT)

    @m.Constraint(m.t)
    def climb(m, t):
        return m.dh_dt[t] == m.v[t]

    @m.Constraint(m.t)
    def force(m, t):
        return m.m[t] * m.dv_dt[t] == m.thrust[t] - m.drag[t] - m.m[t] * GRAVITY

    @m.Constraint(m.t)
    def consumption(m, t):
        return m.dm_dt[t] * EXHAUST == -m.thrust[t]

    @m.Constraint(m.t)
    def thrust_law(m, t):
        if t <= 15:
            return m.thrust[t] == THRUST
        if t > 22:
            return m.thrust[t] == 0
        mach, weight = m.v[t] / EXHAUST, m.m[t] * GRAVITY
        slope = mach**2 * (EXHAUST**2 * (1 + mach) / (SCALE_HEIGHT * GRAVITY) - 1) - 2 * mach
        arc = weight * slope / (mach**2 + 4 * mach + 2)
        return m.thrust[t] - m.drag[t] - weight == arc

    m.enters_the_arc = Constraint(expr=m.m[15] * GRAVITY == (1 + m.v[15] / EXHAUST) * m.drag[15])
    for state, first in ((m.h, 0), (m.v, 0), (m.m, 3)):
        state[0].fix(first)
    m.m[45].fix(1)
    m.objective = Objective(expr=m.h[45], sense=maximize)
    return m


def times(m):
    return {15: m.burnt, 22: m.coasting, 45: m.top}


def objective():
    return 18_550.87186
