"""A time that can be both an index and a term of an equation.

The rules of a model are asked anew what they say over time.  Called with a `TimeSymbol`, which
hashes and compares equal like the template's instant, a rule finds the template's variables
while its arithmetic builds a Pyomo expression of a mutable parameter.  A rule that needs the
number itself, to compare it, to look it up, for `math.sin` or `numpy.interp`, is called with
an `Instant` instead, at every time that matters.
"""

from __future__ import annotations

import operator
from typing import TYPE_CHECKING, Any, Self

from pyomo.common.numeric_types import RegisterNumericType
from pyomo.environ import ConcreteModel, Param

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["Instant", "TimeSymbol", "integrand", "time_parameter"]


class TimeSymbol:
    """The template's instant as an index, and physical time as a parameter in arithmetic.

    Parameters
    ----------
    template : float
        The instant that it is equal to.
    parameter : Param
        What it is in arithmetic.
    declared : tuple of float, optional
        Times with which a rule may compare it.
    number : float, optional
        What it compares as; the template's instant by default.

    Attributes
    ----------
    is_read : bool
        Whether the rule asked for the number, other than to compare it with a declared time.
    """

    def __init__(
        self,
        template: float,
        parameter: Any,
        declared: tuple[float, ...] = (),
        number: float | None = None,
    ) -> None:
        self.template = template
        self.parameter = parameter
        self.is_read = False
        self._declared = declared
        self._number = template if number is None else number

    def __hash__(self) -> int:
        return hash(self.template)

    def __eq__(self, other: object) -> bool:
        return self.template == other

    def _compare(self, relation: Callable[[Any, Any], Any], other: Any) -> bool:
        """Return how the number compares with another, and take note of it."""
        # Two symbols are compared when an Integral sorts its times.
        if isinstance(other, TimeSymbol):
            return bool(relation(self._number, other._number))  # noqa: SLF001
        if other not in self._declared:
            self.is_read = True
        return bool(relation(self._number, other))

    def __lt__(self, other: Any) -> bool:
        return self._compare(operator.lt, other)

    def __le__(self, other: Any) -> bool:
        return self._compare(operator.le, other)

    def __gt__(self, other: Any) -> bool:
        return self._compare(operator.gt, other)

    def __ge__(self, other: Any) -> bool:
        return self._compare(operator.ge, other)

    def __float__(self) -> float:
        self.is_read = True
        return self._number

    def __call__(self, *, exception: bool = True) -> float:
        """Give Pyomo's `value` the number."""
        del exception
        return float(self)

    def __bool__(self) -> bool:
        return bool(float(self))

    def __int__(self) -> int:
        return int(float(self))

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

    def __abs__(self) -> Any:
        return abs(self.parameter)

    def is_numeric_type(self) -> bool:
        """Make Pyomo's functions ask for `as_numeric`."""
        return False

    def as_numeric(self) -> Any:
        """Give Pyomo's functions the parameter."""
        return self.parameter


class Instant(float):
    """A time as the number that it is, and as an index equal to the template's instant."""

    __slots__ = ("template",)
    template: float

    def __new__(cls, time: float, template: float) -> Self:
        """Return the number, equal to another."""
        made = super().__new__(cls, time)
        made.template = template
        return made

    def __hash__(self) -> int:
        return hash(self.template)

    def __eq__(self, other: object) -> bool:
        return self.template == other

    def __ne__(self, other: object) -> bool:
        return not self == other

    def __sub__(self, other: Any) -> Any:
        # As of two symbols: the ends of the trapezoid of an Integral are one unit apart.
        return 1.0 if isinstance(other, Instant) else float(self) - other


RegisterNumericType(Instant)


class _TrapezoidProbe:
    """A block that shows its continuous set as one trapezoid between equal times."""

    def __init__(self, block: Any, continuous_set: Any, symbol: TimeSymbol | Instant) -> None:
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
    """Return a mutable Pyomo parameter that stands for physical time, and has no value."""
    owner = ConcreteModel()
    owner.time = Param(mutable=True)
    return owner.time


def integrand(integral: Any, index: Any, symbol: TimeSymbol | Instant) -> Any:
    """Return an Integral's integrand at a time symbol or an instant.

    `pyomo.dae.Integral` keeps no integrand, only a rule that sums trapezoids; shown a single
    trapezoid of unit width between equal times, that rule returns the integrand.
    """
    probe = _TrapezoidProbe(integral.parent_block(), integral.get_continuousset(), symbol)
    return integral._rule(probe, index)  # noqa: SLF001
