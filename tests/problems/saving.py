"""A maximum with discounting: spend a growing fortune over ten years.

    maximise    int_0^10 exp(-d t) log(c) dt
    subject to  k' = g k - c,  k(0) = 1,  k(10) = 0.5,  c > 0

Source: Ramsey (1928), Economic Journal 38, 543-559, with constant growth g.
Closed form: consumption grows at the rate g - d from the value that spends the present
wealth; the costate, of the minimum of the negative, is -exp(-g t) / c(0).
"""

import numpy as np
from pyomo.dae import ContinuousSet, DerivativeVar, Integral
from pyomo.environ import ConcreteModel, Constraint, Objective, Param, Var, exp, log, maximize

GROWTH, DISCOUNT, YEARS = 0.05, 0.03, 10.0
START, LEGACY = 1.0, 0.5
KINKS = ()


def build():
    m = ConcreteModel(name="saving")
    m.t = ContinuousSet(bounds=(0, YEARS))
    m.year = Param(m.t, initialize=lambda m, t: t, mutable=True)
    m.capital = Var(m.t, bounds=(0, 10), initialize=1)
    m.consumption = Var(m.t, bounds=(1e-3, 10), initialize=0.1)
    m.dcapital_dt = DerivativeVar(m.capital, wrt=m.t)

    @m.Constraint(m.t)
    def account(m, t):
        return m.dcapital_dt[t] == GROWTH * m.capital[t] - m.consumption[t]

    m.capital[0].fix(START)
    m.legacy = Constraint(expr=m.capital[YEARS] == LEGACY)

    @m.Expression(m.t)
    def utility(m, t):
        return exp(-DISCOUNT * m.year[t]) * log(m.consumption[t])

    m.lifetime_utility = Integral(m.t, wrt=m.t, rule=lambda m, t: m.utility[t])
    m.objective = Objective(expr=m.lifetime_utility, sense=maximize)
    return m


_ANNUITY = (1 - np.exp(-DISCOUNT * YEARS)) / DISCOUNT
_FIRST_CONSUMPTION = (START - LEGACY * np.exp(-GROWTH * YEARS)) / _ANNUITY


def objective():
    delay = (1 - (1 + DISCOUNT * YEARS) * np.exp(-DISCOUNT * YEARS)) / DISCOUNT**2
    return np.log(_FIRST_CONSUMPTION) * _ANNUITY + (GROWTH - DISCOUNT) * delay


def control(t):
    return {"consumption": _FIRST_CONSUMPTION * np.exp((GROWTH - DISCOUNT) * t)}


def costate(t):
    return {"capital": -np.exp(-GROWTH * t) / _FIRST_CONSUMPTION}
