"""Ten states: five masses in a row, joined by springs, pushed at one end.

    minimise    1/2 int_0^T u^2 dt
    subject to  x_k' = v_k
                v_k' = x_(k-1) - 2 x_k + x_(k+1) + (u if k = 1),  x_0 = x_6 = 0
                all at rest in their places at 0; mass 5 held 1 m away at T, the others in line

Source: the minimum-energy transfer of a linear system, for instance Kailath (1980), Linear
Systems, section 9.2.  Closed form: with W the controllability Gramian and d the end state,
u = B' exp(A' (T - t)) W^-1 d, costate -exp(A' (T - t)) W^-1 d, optimum d' W^-1 d / 2.
"""

import numpy as np
from pyomo.dae import ContinuousSet, DerivativeVar, Integral
from pyomo.environ import ConcreteModel, Objective, RangeSet, Var, minimize
from scipy.linalg import expm

MASSES, DURATION = 5, 10.0
KINKS = ()


def build():
    m = ConcreteModel(name="chain of masses")
    m.t = ContinuousSet(bounds=(0, DURATION))
    m.mass = RangeSet(MASSES)
    m.x = Var(m.mass, m.t)
    m.v = Var(m.mass, m.t)
    m.u = Var(m.t)
    m.dx_dt = DerivativeVar(m.x, wrt=m.t)
    m.dv_dt = DerivativeVar(m.v, wrt=m.t)

    @m.Constraint(m.mass, m.t)
    def motion(m, k, t):
        return m.dx_dt[k, t] == m.v[k, t]

    @m.Constraint(m.mass, m.t)
    def force(m, k, t):
        left = m.x[k - 1, t] if k > 1 else 0
        right = m.x[k + 1, t] if k < MASSES else 0
        push = m.u[t] if k == 1 else 0
        return m.dv_dt[k, t] == left - 2 * m.x[k, t] + right + push

    for k in m.mass:
        m.x[k, 0].fix(0)
        m.v[k, 0].fix(0)

    @m.Constraint(m.mass)
    def end_position(m, k):
        return m.x[k, DURATION] == k / MASSES

    @m.Constraint(m.mass)
    def end_velocity(m, k):
        return m.v[k, DURATION] == 0

    m.effort = Integral(m.t, wrt=m.t, rule=lambda m, t: m.u[t] ** 2 / 2)
    m.objective = Objective(expr=m.effort, sense=minimize)
    return m


_SPRINGS = np.eye(MASSES, k=1) - 2 * np.eye(MASSES) + np.eye(MASSES, k=-1)
_NOTHING = np.zeros((MASSES, MASSES))
_DYNAMICS = np.block([[_NOTHING, np.eye(MASSES)], [_SPRINGS, _NOTHING]])
_INPUT = np.eye(2 * MASSES)[:, MASSES]
_END = np.concatenate([np.arange(1, MASSES + 1) / MASSES, np.zeros(MASSES)])


def _gramian(duration):
    """Return int_0^T exp(A t) B B' exp(A' t) dt from one exponential (Van Loan, 1978)."""
    n = 2 * MASSES
    block = np.block([[-_DYNAMICS, np.outer(_INPUT, _INPUT)], [np.zeros((n, n)), _DYNAMICS.T]])
    whole = expm(block * duration)
    return whole[n:, n:].T @ whole[:n, n:]


_WEIGHTS = np.linalg.solve(_gramian(DURATION), _END)


def objective():
    return float(_END @ _WEIGHTS) / 2


def _costates(t):
    times = np.atleast_1d(t)
    return np.array([-expm(_DYNAMICS.T * (DURATION - s)) @ _WEIGHTS for s in times])


def control(t):
    return {"u": -_costates(t) @ _INPUT}


def costate(t):
    values = _costates(t)
    on_x = {("x", k): values[:, k - 1] for k in range(1, MASSES + 1)}
    on_v = {("v", k): values[:, MASSES + k - 1] for k in range(1, MASSES + 1)}
    return on_x | on_v
