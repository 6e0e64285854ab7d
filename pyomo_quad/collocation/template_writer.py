"""Pyomo components as CasADi expressions in the symbols of the template point."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import casadi
from pyomo.core.base.constraint import ConstraintData
from pyomo.dae import Integral as PyomoIntegral

from pyomo_quad.collocation.addresses import AddressBook
from pyomo_quad.collocation.declarations import Integral
from pyomo_quad.collocation.errors import TranscriptionError
from pyomo_quad.collocation.expressions import ExpressionWriter
from pyomo_quad.collocation.rules import rule_of
from pyomo_quad.collocation.symbols import SymbolTable
from pyomo_quad.collocation.time_symbol import TimeSymbol, integrand, time_parameter

if TYPE_CHECKING:
    from pyomo_quad.collocation.working_copy import WorkingCopy

__all__ = ["TemplateWriter"]


class TemplateWriter:
    """Writes the components of one working copy, each named expression and integral once.

    Attributes
    ----------
    integrals : dict
        The integrals met so far, by name.
    """

    def __init__(self, copy: WorkingCopy, final_time: Any) -> None:
        self.copy = copy
        self.addresses = AddressBook(copy.time)
        self.symbols = SymbolTable(copy, self.addresses, final_time)
        self.integrals: dict[str, Integral] = {}
        self._clock = time_parameter()
        self._template = TimeSymbol(copy.template_time, self._clock)
        self._writer = ExpressionWriter(self._leaf, self._named)
        self._in_path = False

    def write(self, expression: Any, owner: str, *, over_time: bool = False) -> Any:
        """Return an expression in symbols; one over time may not read a single instant."""
        before, self._in_path = self._in_path, over_time
        try:
            return self._writer.write(expression, owner)
        finally:
            self._in_path = before

    def bound(self, bound: Any, otherwise: float, name: str) -> Any:
        """Return a bound that may be absent."""
        return casadi.SX(otherwise if bound is None else self.write(bound, name))

    def template_of(self, component: Any, index: tuple[Any, ...], instance: Any) -> Any:
        """Return a constraint's template: its rule called with time as a symbol, if it has one."""
        rule = rule_of(component)
        if rule is None:
            return instance
        return ConstraintData(
            expr=rule(component.parent_block(), self._template_index(component, index))
        )

    def write_at_template(self, component: Any, index: tuple[Any, ...]) -> Any:
        """Return a variable or expression over time, by name, in template symbols."""
        position = self.addresses.join(component, index, self.copy.template_time)
        return casadi.SX(self.write(component[position], component.name, over_time=True))

    def _leaf(self, data: Any) -> Any:
        if data is self._clock:
            return self.symbols.time
        symbol = self.symbols.leaf(data)
        address = self.addresses.of(data)
        if self._in_path and address.time not in (None, self.copy.template_time):
            raise TranscriptionError(
                f"{data.name}: a value at a fixed time inside an equation over time is not "
                "supported; introduce a static variable equal to it."
            )
        return symbol

    def _named(self, expression: Any) -> Any:
        component = expression.parent_component()
        if component is None:
            return None
        if component.ctype is PyomoIntegral:
            return self._integral(component, expression.index())
        address = self.addresses.split(component, expression.index())
        rule = rule_of(component)
        if address.time != self.copy.template_time or rule is None:
            return None
        return rule(component.parent_block(), self._template_index(component, address.index))

    def _template_index(self, component: Any, index: tuple[Any, ...]) -> Any:
        return self.addresses.join(component, index, self._template)

    def _integral(self, component: Any, index: Any) -> Any:
        if self._in_path:
            raise TranscriptionError(
                f"{component.name}: an integral inside an equation over time is not supported; "
                "declare it as a state."
            )
        name = component.name if index is None else f"{component.name}[{index}]"
        if name not in self.integrals:
            expression = integrand(component, index, self._template)
            symbol = casadi.SX.sym(name)
            density = casadi.SX(self.write(expression, name, over_time=True)) * self.symbols.span
            self.integrals[name] = Integral(name=name, symbol=symbol, integrand=density)
        return self.integrals[name].symbol
