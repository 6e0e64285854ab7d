"""How a published problem is put: Pyomo.DAE components from states, controls and rates."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from pyomo.dae import ContinuousSet, DerivativeVar, Integral
from pyomo.environ import ConcreteModel, Constraint, Objective, Var, maximize, minimize


@dataclass(frozen=True, kw_only=True)
class Case:
    """A problem, its optimum, and where both stand.

    `published` is a text with the digits that the source vouches for, or a number where the optimum
    has a closed form.
    """

    name: str
    build: Callable[[], Any]
    published: str | float
    source: str
    times: Callable[[Any], Any] | None = None
    starts: int = 1

    @property
    def value(self):
        """The published optimum as a number."""
        return float(self.published)

    @property
    def resolution(self):
        """Half a unit of the last digit published."""
        if not isinstance(self.published, str):
            return 0.0
        mantissa, _, exponent = self.published.lower().partition("e")
        decimals = len(mantissa.partition(".")[2])
        return 0.5 * 10.0 ** (int(exponent or 0) - decimals)


def posed(name, states, controls, rates, *, end=1.0, free=None):
    """Return a model with its dynamics.

    Parameters
    ----------
    name : str
    states : dict
        By name (start, end), None for what is free, then optional bounds.
    controls : dict
        By name its bounds, and a first value if not their middle.
    rates : callable
        Of model and time: the rates by state.
    end : float
        Of the horizon.
    free : tuple, optional
        Bounds and first value of a duration `T` that the horizon, then of length 1, stands for.
    """
    m = ConcreteModel(name=name)
    m.t = ContinuousSet(bounds=(0, 1.0 if free else end))
    first, last = m.t.first(), m.t.last()
    if free:
        m.T = Var(bounds=free[:2], initialize=free[2])
    for key, (start, final, *bounds) in states.items():
        m.add_component(key, Var(m.t, bounds=tuple(bounds) or None))
        x = m.component(key)
        m.add_component(f"d{key}", DerivativeVar(x, wrt=m.t))
        for t, value in ((first, start), (last, final)):
            if value is not None:
                x[t].fix(value)
    for key, (lower, upper, *guess) in controls.items():
        m.add_component(key, Var(m.t, bounds=(lower, upper)))
        for t in m.t if guess else ():
            m.component(key)[t].set_value(guess[0])
    for key in states:

        def law(m, t, key=key):
            return m.component(f"d{key}")[t] == (m.T if free else 1) * rates(m, t)[key]

        m.add_component(f"{key}_law", Constraint(m.t, rule=law))
    return m


def guessed(m, **functions):
    """Give variables over time first values: functions of the share of the horizon."""
    end = m.t.last()
    for key, function in functions.items():
        for t in m.t:
            if not m.component(key)[t].fixed:
                m.component(key)[t].set_value(function(t / end))
    return m


def minimised(m, expression):
    """Let the model minimise an expression of its ends."""
    m.objective = Objective(expr=expression, sense=minimize)
    return m


def maximised(m, expression):
    """Let the model maximise an expression of its ends."""
    m.objective = Objective(expr=expression, sense=maximize)
    return m


def total(m, integrand):
    """Return the integral of an expression of model and time over the horizon."""
    m.integral = Integral(m.t, wrt=m.t, rule=integrand)
    return m.integral
