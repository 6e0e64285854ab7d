"""Jacobson and Lele's problem, as in Pyomo's own optimal control example.

    minimise    int_0^1 (x1^2 + x2^2 + 0.005 u^2) dt
    subject to  x1' = x2,  x2' = -x2 + u,  x2 <= 8 (t - 0.5)^2 - 0.5
                x1(0) = 0,  x2(0) = -1

The ceiling uses the time as a number.  Source: Jacobson and Lele (1969), IEEE Transactions on
Automatic Control 14, 457-464.  Semi-closed form: x2 follows the ceiling between two times,
before and after which states and costates obey a linear system; control and costates are
continuous at both, because the constraint is of first order.
"""

from functools import cache
from itertools import pairwise

import numpy as np
from numpy.polynomial import Polynomial
from pyomo.dae import ContinuousSet, DerivativeVar, Integral
from pyomo.environ import ConcreteModel, Objective, Var, minimize
from scipy.linalg import expm
from scipy.optimize import fsolve

WEIGHT = 0.005
CEILING = Polynomial([1.5, -8.0, 8.0])


def build():
    m = ConcreteModel(name="Jacobson and Lele")
    m.t = ContinuousSet(bounds=(0, 1))
    m.x1 = Var(m.t)
    m.x2 = Var(m.t)
    m.u = Var(m.t)
    m.dx1_dt = DerivativeVar(m.x1, wrt=m.t)
    m.dx2_dt = DerivativeVar(m.x2, wrt=m.t)

    @m.Constraint(m.t)
    def motion(m, t):
        return m.dx1_dt[t] == m.x2[t]

    @m.Constraint(m.t)
    def lag(m, t):
        return m.dx2_dt[t] == -m.x2[t] + m.u[t]

    @m.Constraint(m.t)
    def ceiling(m, t):
        return m.x2[t] <= 8 * (t - 0.5) ** 2 - 0.5

    m.x1[0].fix(0)
    m.x2[0].fix(-1)
    m.cost = Integral(
        m.t, wrt=m.t, rule=lambda m, t: m.x1[t] ** 2 + m.x2[t] ** 2 + WEIGHT * m.u[t] ** 2
    )
    m.objective = Objective(expr=m.cost, sense=minimize)
    return m


# Rates of (x1, x2, p1, p2) with u = -p2 / (2 WEIGHT), away from the ceiling.
_FREE = np.array(
    [[0, 1, 0, 0], [0, -1, 0, -1 / (2 * WEIGHT)], [-2, 0, 0, 0], [0, -2, -1, 1]], dtype=float
)
_ON_CEILING = CEILING.deriv() + CEILING  # u


def _along_ceiling(entry, at_entry):
    """Return x1 and p1 on the ceiling as polynomials that pass their values at the entry."""
    area = CEILING.integ()
    x1 = area - area(entry) + at_entry[0]
    fall = (-2 * x1).integ()
    return x1, fall - fall(entry) + at_entry[2]


def _pieces(unknowns):
    """Return the starts of the first and last piece, and the ceiling's polynomials."""
    p1, p2, entry, leave = unknowns
    first = np.array([0.0, -1.0, p1, p2])
    x1, on_x1 = _along_ceiling(entry, expm(_FREE * entry) @ first)
    last = np.array([x1(leave), CEILING(leave), on_x1(leave), -2 * WEIGHT * _ON_CEILING(leave)])
    return first, last, x1, on_x1


def _mismatch(unknowns):
    _, _, entry, leave = unknowns
    first, last, _, _ = _pieces(unknowns)
    at_entry = expm(_FREE * entry) @ first
    at_end = expm(_FREE * (1 - leave)) @ last
    return [
        at_entry[1] - CEILING(entry),
        at_entry[3] / (2 * WEIGHT) + _ON_CEILING(entry),
        at_end[2],
        at_end[3],
    ]


@cache
def _unknowns():
    found, _, code, message = fsolve(
        _mismatch, [-0.1, -0.12, 0.35, 0.7], xtol=1e-13, full_output=True
    )
    if code != 1:
        raise ArithmeticError(message)
    return tuple(found)


def __getattr__(name):
    """Find the kinks, which takes a second, where they are asked for."""
    if name == "KINKS":
        return _unknowns()[2:]
    raise AttributeError(name)


def _extended(t):
    """Return (x1, x2, p1, p2) at times, shape (n, 4)."""
    _, _, entry, leave = _unknowns()
    first, last, x1, on_x1 = _pieces(_unknowns())
    rows = []
    for time in np.atleast_1d(t):
        if time < entry:
            rows.append(expm(_FREE * time) @ first)
        elif time > leave:
            rows.append(expm(_FREE * (time - leave)) @ last)
        else:
            on_x2 = -2 * WEIGHT * _ON_CEILING(time)
            rows.append(np.array([x1(time), CEILING(time), on_x1(time), on_x2]))
    return np.array(rows)


def objective():
    """Integrate piece by piece with Gauss-Legendre points, to rounding."""
    points, weights = np.polynomial.legendre.leggauss(30)
    ends = (0.0, *_unknowns()[2:], 1.0)
    total = 0.0
    for start, end in pairwise(ends):
        times = start + (end - start) * (points + 1) / 2
        x1, x2, _, _ = _extended(times).T
        cost = x1**2 + x2**2 + WEIGHT * control(times)["u"] ** 2
        total += (end - start) / 2 * float(weights @ cost)
    return total


def state(t):
    x1, x2, _, _ = _extended(t).T
    return {"x1": x1, "x2": x2}


def control(t):
    return {"u": -_extended(t)[:, 3] / (2 * WEIGHT)}


def costate(t):
    _, _, p1, p2 = _extended(t).T
    return {"x1": p1, "x2": p2}
