"""CasADi symbols for the variables and parameters that equations mention."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import casadi
from pyomo.dae import DerivativeVar
from pyomo.environ import value

from pyomo_quad.collocation.addresses import AddressBook, indexed_name
from pyomo_quad.collocation.declarations import PointSymbol, Slot
from pyomo_quad.collocation.errors import TranscriptionError
from pyomo_quad.collocation.rules import rule_of
from pyomo_quad.collocation.time_symbol import TimeSymbol, time_parameter

if TYPE_CHECKING:
    from pyomo_quad.collocation.working_copy import WorkingCopy

__all__ = ["SymbolTable"]


class SymbolTable:
    """Makes a symbol when a variable or parameter is first met, and keeps it.

    In a path equation a variable at the template time becomes a template symbol; anywhere
    else a variable at a time becomes a point symbol.
    """

    def __init__(self, copy: WorkingCopy, addresses: AddressBook, final_time: Any) -> None:
        self._copy = copy
        self._addresses = addresses
        self.states: dict[str, Slot] = {}
        self.algebraics: dict[str, Slot] = {}
        self.statics: dict[str, Slot] = {}
        self.parameters: dict[str, Slot] = {}
        self.signals: dict[str, Slot] = {}
        self.points: dict[tuple[str, float, bool], PointSymbol] = {}
        self.signal_points: dict[tuple[str, float], Any] = {}
        self.fraction = casadi.SX.sym("fraction")
        self._derivatives = {
            d.get_state_var().name: d
            for d in copy.model.component_objects(DerivativeVar, descend_into=True)
        }
        self.start = self._horizon("horizon.start", 0)
        self.end = self._end(final_time)
        self.span = self.end - self.start

    def _horizon(self, name: str, position: int) -> Any:
        if self._copy.time is None:
            return casadi.SX(position)
        symbol = casadi.SX.sym(name)
        self.parameters[name] = Slot(name=name, component=name, index=(position,), symbol=symbol)
        return symbol

    def _end(self, final_time: Any) -> Any:
        if final_time is None:
            return self._horizon("horizon.end", 1)
        if final_time.is_indexed() or not final_time.is_variable_type():
            raise TranscriptionError(
                f"{final_time.name}: the final time must be a static variable, a Var without index."
            )
        return self._static(self._copy.model.find_component(final_time.name))

    @property
    def horizon(self) -> tuple[Any, Any]:
        """Symbols of start and end."""
        return self.start, self.end

    @property
    def time(self) -> Any:
        """Physical time at the template point."""
        return self.start + self.span * self.fraction

    def leaf(self, data: Any) -> Any:
        """Return the symbol of a Pyomo variable or mutable parameter."""
        address = self._addresses.of(data)
        if data.is_variable_type():
            if address.time is None:
                return self._static(data)
            return self._varying(data, address)
        if address.time is None:
            return self._scalar(self.parameters, data, address.name)
        return self._signal(data, address)

    def _scalar(self, table: dict[str, Slot], data: Any, name: str, **more: Any) -> Any:
        if name not in table:
            address = self._addresses.of(data)
            table[name] = Slot(
                name=name,
                component=address.component,
                index=_whole_index(data),
                symbol=casadi.SX.sym(name),
                **more,
            )
        return table[name].symbol

    def fixed_value(self, data: Any) -> Any:
        """Return the symbol of a parameter that holds a fixed variable's value."""
        return self._scalar(self.parameters, data, f"{data.name} (fixed)")

    def _static(self, data: Any) -> Any:
        if data.fixed:
            return self._scalar(self.parameters, data, data.name)
        return self._scalar(self.statics, data, data.name, lower=data.lower, upper=data.upper)

    def _is_clock(self, data: Any) -> bool:
        """Say whether a parameter over time is time itself."""
        component, index = data.parent_component(), self._addresses.of(data).index
        is_time_where_declared = all(
            value(component[self._addresses.join(component, index, t)], exception=False) == t
            for t in self._copy.declared_times
        )
        rule = rule_of(component)
        if not is_time_where_declared or rule is None:
            return False
        symbol = TimeSymbol(self._copy.template_time, time_parameter())
        position = self._addresses.join(component, index, symbol)
        try:
            said = rule(component.parent_block(), position)
        except Exception:  # noqa: BLE001  the rule is the user's: it may raise anything
            return False
        return said is symbol

    def _signal(self, data: Any, address: Any) -> Any:
        if self._is_clock(data):
            return self._physical_time(address.time)
        name = address.name
        if address.time != self._copy.template_time:
            key = (name, self.fraction_of(address.time))
            return self.signal_points.setdefault(key, casadi.SX.sym(data.name))
        if name not in self.signals:
            self.signals[name] = Slot(
                name=name,
                component=address.component,
                index=address.index,
                symbol=casadi.SX.sym(name),
            )
        return self.signals[name].symbol

    def _physical_time(self, time: float) -> Any:
        if time == self._copy.template_time:
            return self.time
        return self.start + self.span * self.fraction_of(time)

    def fraction_of(self, time: float) -> float:
        """Return a declared time as a fraction of the declared horizon."""
        first, last = self._copy.declared_times[0], self._copy.declared_times[-1]
        return (time - first) / (last - first)

    def _varying(self, data: Any, address: Any) -> Any:
        component = data.parent_component()
        is_rate = component.ctype is DerivativeVar
        variable = component.get_state_var() if is_rate else component
        slot = self._slot(variable, address)
        if slot is None:
            first = self._addresses.join(variable, address.index, self._copy.declared_times[0])
            return self._scalar(self.parameters, variable[first], variable[first].name)
        if address.time == self._copy.template_time:
            return slot.rate / self.span if is_rate else slot.symbol
        key = (slot.name, self.fraction_of(address.time), is_rate)
        if key not in self.points:
            symbol = casadi.SX.sym(data.name)
            self.points[key] = PointSymbol(
                slot=slot.name, fraction=key[1], is_rate=is_rate, symbol=symbol
            )
        symbol = self.points[key].symbol
        return symbol / self.span if is_rate else symbol

    def _slot(self, variable: Any, address: Any) -> Slot | None:
        """Return the slot of a function of time, None if it is fixed throughout."""
        name = indexed_name(variable.name, address.index)
        for table in (self.states, self.algebraics):
            if name in table:
                return table[name]
        template = variable[self._addresses.join(variable, address.index, self._copy.template_time)]
        is_state = variable.name in self._derivatives
        if not is_state and self._is_fixed_throughout(variable, address.index):
            return None
        symbol = casadi.SX.sym(name)
        slot = Slot(
            name=name,
            component=variable.name,
            index=address.index,
            symbol=symbol,
            lower=template.lower,
            upper=template.upper,
            rate=casadi.SX.sym(f"d({name})") if is_state else None,
        )
        (self.states if is_state else self.algebraics)[name] = slot
        return slot

    def _is_fixed_throughout(self, variable: Any, index: tuple[Any, ...]) -> bool:
        return all(
            variable[self._addresses.join(variable, index, t)].fixed
            for t in self._copy.declared_times
        )


def _whole_index(data: Any) -> tuple[Any, ...]:
    index = data.index()
    if index is None:
        return ()
    return index if isinstance(index, tuple) else (index,)
