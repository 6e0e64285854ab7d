"""A time that can be both an index and a term of an equation.

A rule such as ``m.x[t] <= 8*(t - 0.5)**2`` uses its index as a number, which would freeze
the equation at the instant it was declared for.  Called again with a `TimeSymbol`, the rule
finds the same variables (the symbol hashes and compares as the number it stands for) while
its arithmetic builds a Pyomo expression of a mutable parameter.
"""

from __future__ import annotations

from typing import Any

from pyomo.environ import ConcreteModel, Param

__all__ = ["TimeSymbol", "integrand", "time_parameter"]


class TimeSymbol:
    """A declared time as an index, and physical time as a Pyomo parameter in arithmetic."""

    def __init__(self, instant: float, parameter: Any) -> None:
        self.instant = instant
        self.parameter = parameter

    def __hash__(self) -> int:
        return hash(self.instant)

    def __eq__(self, other: object) -> bool:
        return self.instant == other

    def __lt__(self, other: Any) -> bool:
        return bool(self.instant < other)

    def __le__(self, other: Any) -> bool:
        return bool(self.instant <= other)

    def __gt__(self, other: Any) -> bool:
        return bool(self.instant > other)

    def __ge__(self, other: Any) -> bool:
        return bool(self.instant >= other)

    def __add__(self, other: Any) -> Any:
        return self.parameter + other

    __radd__ = __add__

    def __sub__(self, other: Any) -> Any:
        # Two symbols meet only as the ends of a trapezoid in an Integral: a width of one
        # turns that trapezoid into the integrand itself.
        return 1.0 if isinstance(other, TimeSymbol) else self.parameter - other

    def __rsub__(self, other: Any) -> Any:
        return other - self.parameter

    def __mul__(self, other: Any) -> Any:
        return self.parameter * other

    __rmul__ = __mul__

    def __truediv__(self, other: Any) -> Any:
        return self.parameter / other

    def __rtruediv__(self, other: Any) -> Any:
        return other / self.parameter

    def __pow__(self, other: Any) -> Any:
        return self.parameter**other

    def __rpow__(self, other: Any) -> Any:
        return other**self.parameter

    def __neg__(self) -> Any:
        return -self.parameter

    def is_numeric_type(self) -> bool:
        """Make Pyomo's functions ask for `as_numeric`."""
        return False

    def as_numeric(self) -> Any:
        """Give Pyomo's functions the parameter."""
        return self.parameter


class _TrapezoidProbe:
    """A block that shows its continuous set as one trapezoid between two time symbols."""

    def __init__(self, block: Any, continuous_set: Any, symbol: TimeSymbol) -> None:
        self._block = block
        self._set_name = continuous_set.local_name
        self._symbol = symbol

    def find_component(self, name: str) -> Any:
        if name == self._set_name:
            return [self._symbol, self._symbol]
        return self._block.find_component(name)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._block, name)


def time_parameter() -> Any:
    """Return a mutable Pyomo parameter that stands for physical time."""
    owner = ConcreteModel()
    owner.time = Param(initialize=0.0, mutable=True)
    return owner.time


def integrand(integral: Any, index: Any, symbol: TimeSymbol) -> Any:
    """Return an Integral's integrand with the time symbol in place of the number.

    `pyomo.dae.Integral` keeps no integrand, only a rule that sums trapezoids; shown a single
    trapezoid of unit width between equal times, that rule returns the integrand.
    """
    probe = _TrapezoidProbe(integral.parent_block(), integral.get_continuousset(), symbol)
    return integral._rule(probe, index)  # noqa: SLF001
