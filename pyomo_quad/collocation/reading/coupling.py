"""Reading a model with several horizons: each by itself, and what couples them.

A constraint over a continuous set, or of values on one alone, belongs to that horizon.  All other
constraints and the objective see a horizon through static variables that are equal to its values
at declared times and to its integrals.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import casadi
from pyomo.core import Var
from pyomo.dae import Integral as PyomoIntegral

from pyomo_quad.collocation.errors import TranscriptionError
from pyomo_quad.collocation.reading.clock import FreeTimes, free_times
from pyomo_quad.collocation.reading.copy import (
    WorkingCopy,
    continuous_sets,
    copies_with_template_times,
)
from pyomo_quad.collocation.reading.model import ModelReader
from pyomo_quad.collocation.reading.symbols import PointCondition, PointSymbol, Slot, index_of
from pyomo_quad.collocation.reading.writer import TemplateWriter, symbol_names

if TYPE_CHECKING:
    from pyomo_quad.collocation.reading.symbols import Declarations


@dataclass(frozen=True, kw_only=True)
class Link:
    """A static variable that is equal to a value of the horizon that `reader` reads.

    `state` is the value where it is one of a state, which is an unknown itself.
    """

    slot: Slot
    reader: ModelReader
    value: Any
    time: float
    state: PointSymbol | None

    @property
    def condition(self) -> PointCondition:
        """The condition, on the horizon, that they are equal."""
        zero, difference = casadi.SX(0), casadi.SX(self.value) - self.slot.symbol
        return PointCondition(name=self.slot.name, expression=difference, lower=zero, upper=zero)


class CouplingWriter(TemplateWriter):
    """Writes what couples horizons, in static variables that stand for their values.

    Attributes
    ----------
    links : dict
        Those variables, by the name of what they stand for.
    """

    def __init__(self, readers: list[ModelReader], statics: dict[str, Slot]) -> None:
        self._readers = readers
        self.links: dict[str, Link] = {}
        self._in_objective = False
        times = tuple(reader.copy.time for reader in readers)
        super().__init__(WorkingCopy(model=readers[0].copy.model, others=times), {}, statics)

    def write_objective(self, objective: Any) -> Any:
        """Return the objective, which may hold values at any declared time."""
        self._in_objective = True
        return casadi.SX(self.write(objective.expr, objective.name))

    def leaf(self, data: Any) -> Any:
        """Return the symbol of a variable or parameter."""
        over = self.copy.other_of(data.parent_component())
        if over is None:
            return super().leaf(data)
        if data.name not in self.links:
            reader = next(r for r in self._readers if r.copy.time is over)
            self._refuse_interior(reader, data)
            slot = _free_slot(
                f"{data.name} (coupled)", data.parent_component().name, index_of(data)
            )
            address, value = reader.addresses.of(data), reader.writer.leaf(data)
            table, time = reader.symbols, float(address.time or 0.0)
            key = address.name, table.clock.fraction_of(time), False
            is_state = address.name in table.states and data.parent_component().ctype is Var
            self.links[data.name] = Link(
                slot=slot,
                reader=reader,
                value=value,
                time=time,
                state=table.points[key] if is_state else None,
            )
        return self.links[data.name].slot.symbol

    def _refuse_interior(self, reader: ModelReader, data: Any) -> None:
        declared, name = reader.copy.declared_times, reader.copy.time.name
        is_end = reader.addresses.of(data).time in (declared[0], declared[-1])
        if not data.is_variable_type():
            raise TranscriptionError(
                f"{data.name}: a parameter over {name} at a single time cannot stand in what "
                "couples horizons; use a parameter without time."
            )
        if not is_end and not self._in_objective:
            raise TranscriptionError(
                f"{data.name}: couples horizons at a time that is no boundary of {name}, which "
                f"runs from {declared[0]:g} to {declared[-1]:g}; introduce a static variable "
                "equal to it."
            )

    def named(self, expression: Any) -> Any:
        """Return what to write for a named expression, None for its own expression."""
        component = expression.parent_component()
        if component is not None and component.ctype is PyomoIntegral:
            for reader in self._readers:
                if component.get_continuousset() is reader.copy.time:
                    return reader.writer.named(expression)
        return super().named(expression)


def _free_slot(name: str, component: str, index: tuple[Any, ...], symbol: Any = None) -> Slot:
    """Return a static variable without bounds."""
    return Slot(
        name=name,
        component=component,
        index=index,
        symbol=casadi.SX.sym(name) if symbol is None else symbol,
        lower=casadi.SX(-casadi.inf),
        upper=casadi.SX(casadi.inf),
    )


@dataclass(frozen=True, kw_only=True)
class CoupledDeclarations:
    """What a model with several horizons declares.

    Attributes
    ----------
    horizons : dict
        By the name of the continuous set: its declarations and their reader.
    coupling : Declarations, ModelReader
        The objective, and the conditions that hold values of several horizons or of none.
    states : dict
        Names of the coupling's static variables that are values of states: horizon and value.
    links : tuple of str
        Names of those that are other values, and of the conditions on horizons that say so.
    """

    horizons: dict[str, tuple[Declarations, ModelReader]]
    coupling: tuple[Declarations, ModelReader]
    states: dict[str, tuple[str, PointSymbol]]
    links: tuple[str, ...]


def read_horizons(model: Any, times: FreeTimes | None) -> CoupledDeclarations:
    """Read what a model with several continuous sets declares.

    Raises
    ------
    TranscriptionError
        If it declares something unsupported or incomplete; the message names it.
    """
    free = free_times(continuous_sets(model), None, times)
    statics: dict[str, Slot] = {}
    readers = [
        ModelReader(TemplateWriter(copy, free[copy.time.name], statics))
        for copy in copies_with_template_times(model)
    ]
    for reader in readers:
        reader.require_all()
    writer = CouplingWriter(readers, statics)
    coupling = ModelReader(writer)
    _refuse_gaps(coupling.conditions, list(writer.links.values()), free)
    objective = coupling.objective()
    cost = casadi.SX(0) if objective is None else writer.write_objective(objective)
    links = list(writer.links.values())
    held = casadi.vertcat(casadi.SX(0, 1), *[c.expression for c in coupling.conditions])
    horizons, integrals = {}, []
    states: dict[str, tuple[str, PointSymbol]] = {}
    for reader in readers:
        name, mine = reader.copy.time.name, [k for k in links if k.reader is reader]
        own, cost = _own_cost(reader, cost, symbol_names(held))
        others = [link for link in mine if link.state is None]
        reader.conditions.extend(link.condition for link in others)
        met = _integrals_in(reader, symbol_names(cost) | symbol_names(held))
        declared = reader.declarations(own, objective)
        points = {k.slot.name: k.state for k in mine if k.state is not None}
        new = tuple(p for p in points.values() if p not in declared.point_symbols)
        declared = replace(declared, point_symbols=(*declared.point_symbols, *new))
        horizons[name] = _with(declared, [k.slot for k in others] + met), reader
        integrals.extend(met)
        states |= {static: (name, point) for static, point in points.items()}
    declared = _with(
        coupling.declarations(cost, objective), [link.slot for link in links] + integrals
    )
    return CoupledDeclarations(
        horizons=horizons,
        coupling=(declared, coupling),
        states=states,
        links=tuple(link.slot.name for link in links if link.state is None),
    )


def _refuse_gaps(
    conditions: list[PointCondition], links: list[Link], free: dict[str, dict[float, Any]]
) -> None:
    """Refuse a value that goes on from the end of one horizon to a later start of another."""
    for condition in conditions:
        names = symbol_names(condition.expression)
        pair = [link for link in links if link.slot.name in names]
        is_equality = casadi.is_equal(condition.lower, condition.upper)
        if len(pair) != len(names) or len(pair) != 2 or not is_equality:
            continue
        before, after = sorted(pair, key=lambda link: link.time)
        ends = before.reader.copy.declared_times[-1], after.reader.copy.declared_times[0]
        sets = [link.reader.copy.time.name for link in (before, after)]
        is_fixed = all(at not in free[name] for name, at in zip(sets, ends, strict=True))
        if (before.time, after.time) == ends and ends[0] < ends[1] and is_fixed:
            raise TranscriptionError(
                f"{condition.name}: {sets[0]} ends at {ends[0]:g}, but {sets[1]} begins at "
                f"{ends[1]:g}, which leaves a gap; declare one of them to meet the other."
            )


def _own_cost(reader: ModelReader, cost: Any, in_conditions: frozenset[str]) -> tuple[Any, Any]:
    """Split the cost into integrals over one horizon, times numbers, and the rest."""
    own = casadi.SX(0)
    for integral in reader.writer.integrals.values():
        slope = casadi.jacobian(cost, integral.symbol)
        if slope.is_constant() and integral.symbol.name() not in in_conditions:
            own += slope * integral.symbol
            cost = casadi.substitute(cost, integral.symbol, casadi.SX(0))
    return own, cost


def _integrals_in(reader: ModelReader, names: frozenset[str]) -> list[Slot]:
    """Return static variables for the integrals that the coupling holds."""
    return [
        _free_slot(integral.name, integral.name, (), integral.symbol)
        for integral in reader.writer.integrals.values()
        if integral.symbol.name() in names
    ]


def _with(declared: Declarations, statics: list[Slot]) -> Declarations:
    return replace(declared, statics=(*declared.statics, *statics))
