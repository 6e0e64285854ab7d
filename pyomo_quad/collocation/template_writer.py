"""Pyomo components as CasADi expressions in the symbols of the template point."""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

import casadi
from pyomo.common.log import LoggingIntercept
from pyomo.core.base.constraint import ConstraintData
from pyomo.core.expr.numvalue import native_types
from pyomo.dae import DerivativeVar
from pyomo.dae import Integral as PyomoIntegral
from pyomo.environ import Constraint, Expression, Param, Var

from pyomo_quad.collocation.addresses import AddressBook, indexed_name
from pyomo_quad.collocation.declarations import Integral, PathEquation
from pyomo_quad.collocation.errors import TranscriptionError
from pyomo_quad.collocation.expressions import ExpressionWriter
from pyomo_quad.collocation.rules import bounds_rule_of, rule_of
from pyomo_quad.collocation.schedules import BESIDE, Schedule, Statement
from pyomo_quad.collocation.symbols import SymbolTable
from pyomo_quad.collocation.time_symbol import Instant, TimeSymbol, integrand, time_parameter

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from pyomo_quad.collocation.addresses import Address
    from pyomo_quad.collocation.declarations import Slot
    from pyomo_quad.collocation.working_copy import WorkingCopy

__all__ = ["TemplateWriter"]

# What a lower bound, a body and an upper bound are that a rule does not give.
_ABSENT = (-casadi.inf, 0.0, casadi.inf)


class TemplateWriter:
    """Writes the components of one working copy, each named expression and integral once.

    Attributes
    ----------
    integrals : dict
        The integrals met so far, by name.
    schedules : list
        What rules say that are no formula of time.
    """

    def __init__(self, copy: WorkingCopy, final_time: Any) -> None:
        self.copy = copy
        self.addresses = AddressBook(copy.time)
        self.symbols = SymbolTable(copy, self.addresses, final_time)
        self.integrals: dict[str, Integral] = {}
        self.schedules: list[Schedule] = []
        self._by_rule: dict[str, Any] = {}
        self._clock = time_parameter()
        self._is_end_free = final_time is not None
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

    def path_equation(
        self, component: Any, index: tuple[Any, ...], instance: Any
    ) -> PathEquation | None:
        """Return what a constraint imposes over time, None if its rule skips it there.

        `instance` is the constraint's own at the template, of which there may be none.
        """
        rule, name = rule_of(component), indexed_name(component.name, index)
        if rule is None and instance is None:
            return None
        block = component.parent_block()

        def say(time: Any) -> Statement:
            if rule is None:
                return _relation(instance.expr, name)
            return _relation(rule(block, self.addresses.join(component, index, time)), name)

        (lower, body, upper), is_equality = self._over_time(name, say)
        if body.is_constant() and _is_unbounded(lower, upper):
            return None
        if is_equality:
            body, lower, upper = body - upper, casadi.SX(0), casadi.SX(0)
        return PathEquation(
            name=name, expression=body, lower=lower, upper=upper, is_equality=is_equality
        )

    def bounds_over_time(self, slot: Slot) -> tuple[Any, Any]:
        """Return the bounds of a variable over time."""
        variable = self.copy.model.find_component(slot.component)
        rule = bounds_rule_of(variable)
        if rule is None:
            bounds = (slot.lower, -casadi.inf), (slot.upper, casadi.inf)
            return tuple(self.bound(b, otherwise, slot.name) for b, otherwise in bounds)
        block = variable.parent_block()

        def say(time: Any) -> Statement:
            lower, upper = rule(block, self.addresses.join(variable, slot.index, time))
            return Statement(parts=(lower, 0.0, upper))

        (lower, _, upper), _ = self._over_time(slot.name, say)
        return lower, upper

    def _over_time(self, name: str, say: Callable[[Any], Statement]) -> tuple[list[Any], bool]:
        """Return the parts of what a rule says as functions of time, and if they are an equality.

        The rule is called once with a symbol.  Where that does not do, because the rule reads
        the number, it is called at the times needed.
        """
        symbol = TimeSymbol(self.copy.template_time, self._clock)
        statement = _attempt(say, symbol)
        if statement is not None and not symbol.is_read:
            parts = zip(statement.parts, _ABSENT, strict=False)
            return [self._part(p, name, absent) for p, absent in parts], statement.is_equality
        schedule = Schedule(name, partial(self._said, name, say), self.copy.declared_times)
        self.schedules.append(schedule)

        def write(part: Any, numbers: Iterator[Any]) -> Any:
            return self._with_numbers(part, numbers, name)

        return schedule.written(write, _ABSENT), schedule.is_equality

    def _said(self, name: str, say: Callable[[Any], Statement], time: float) -> Statement:
        """Return what a rule says at one time."""
        template = self.copy.template_time
        if self._is_end_free:
            declared = self.copy.declared_times
            index: Any = TimeSymbol(template, self._clock, declared, self._within(time))
        else:
            index = Instant(time, template)
        try:
            statement = _as_numeric(say(index))
        except TranscriptionError:
            raise
        except Exception as error:
            what = f"no member {error}" if isinstance(error, KeyError) else f"{error}"
            raise TranscriptionError(
                f"{name}: its rule fails at a time that the model did not declare, {time:g} "
                f"({what}); let it read nothing but its time and components of the model."
            ) from error
        if self._is_end_free and index.is_read:
            raise TranscriptionError(
                f"{name}: its rule reads its time as a number, which a free end time moves; "
                "compare it with declared times only, and calculate with Pyomo's functions."
            )
        return statement

    def is_scheduled(self, name: str) -> bool:
        """Say whether a component's rule is no formula of time."""
        return any(s.name == name for s in self.schedules)

    def scheduled_before(self, time: float) -> dict[str, tuple[Any, float]]:
        """Return the symbols of all schedules and their numbers just before a declared time."""
        first, last = self.copy.declared_times[0], self.copy.declared_times[-1]
        before = max(time - BESIDE * (last - first), first + BESIDE * (last - first))
        return {
            slot.name: (slot.symbol, number)
            for schedule in self.schedules
            for slot, number in zip(schedule.slots, schedule.row(before), strict=True)
        }

    def _within(self, time: float) -> float:
        """Return the middle of the interval between declared times that holds a time."""
        declared = self.copy.declared_times
        after = min(max(bisect_left(declared, time), 1), len(declared) - 1)
        return 0.5 * (declared[after - 1] + declared[after])

    def _part(self, part: Any, name: str, absent: Any) -> Any:
        return casadi.SX(absent if part is None else self.write(part, name, over_time=True))

    def _with_numbers(self, part: Any, numbers: Iterator[Any], name: str) -> Any:
        """Write an expression with other numbers, given in the order of its own."""
        if part.__class__ in native_types:
            return next(numbers)
        if not part.is_expression_type() or part.is_named_expression_type():
            return self.write(part, name, over_time=True)
        arguments = [self._with_numbers(a, numbers, name) for a in part.args]
        return self._writer.apply(part, arguments, name)

    def over_time(self, name: str, index: tuple[Any, ...]) -> Any:
        """Return what a user names in template symbols, None if it is nothing over time.

        Raises
        ------
        KeyError
            If it has no such index.
        """
        found = self.copy.model.find_component(name)
        if found is None or self.addresses.time_position(found) is None:
            return None
        return self.write_at_template(found, index)

    def components_over_time(self) -> Iterator[tuple[str, tuple[Any, ...]]]:
        """Yield name and index of all that `over_time` can write."""
        kinds = (Var, DerivativeVar, Param, Expression)
        for component in self.copy.model.component_objects(kinds, descend_into=True):
            if self.addresses.time_position(component) is not None:
                for position in component:
                    address = self.addresses.split(component, position)
                    if address.time == self.copy.template_time:
                        yield component.name, address.index

    def write_at_template(self, component: Any, index: tuple[Any, ...]) -> Any:
        """Return a variable or expression over time, by name, in template symbols."""
        position = self.addresses.join(component, index, self.copy.template_time)
        return casadi.SX(self.write(component[position], component.name, over_time=True))

    def _leaf(self, data: Any) -> Any:
        if data is self._clock:
            return self.symbols.time
        address = self.addresses.of(data)
        if self._is_end_free and data.is_parameter_type():
            return self._parameter_over_time(data, address)
        symbol = self.symbols.leaf(data)
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
        return self._expression(component, address.index, rule)

    def _expression(self, component: Any, index: tuple[Any, ...], rule: Any) -> Any:
        """Return what an expression or parameter over time is by its rule, read once."""
        name, block = indexed_name(component.name, index), component.parent_block()
        if name in self._by_rule:
            return self._by_rule[name]

        def say(time: Any) -> Statement:
            return Statement(parts=(rule(block, self.addresses.join(component, index, time)),))

        self._by_rule[name] = self._over_time(name, say)[0][0]
        return self._by_rule[name]

    def _parameter_over_time(self, data: Any, address: Address) -> Any:
        """Return a parameter as a function of a time that has a derivative."""
        component = data.parent_component()
        rule = rule_of(component)
        if rule is None or address.time is None:
            return self.symbols.leaf(data)
        over_time = casadi.SX(self._expression(component, address.index, rule))
        if address.time == self.copy.template_time:
            return over_time
        numbers = self.scheduled_before(address.time).values()
        old = casadi.vertcat(self.symbols.fraction, *(symbol for symbol, _ in numbers))
        new = [self.symbols.fraction_of(address.time), *(number for _, number in numbers)]
        return casadi.substitute(over_time, old, casadi.SX(new))

    def _integral(self, component: Any, index: Any) -> Any:
        if self._in_path:
            raise TranscriptionError(
                f"{component.name}: an integral inside an equation over time is not supported; "
                "declare it as a state."
            )
        name = component.name if index is None else f"{component.name}[{index}]"
        if name not in self.integrals:

            def say(time: Any) -> Statement:
                return Statement(parts=(integrand(component, index, time),))

            (density,), _ = self._over_time(name, say)
            symbol = casadi.SX.sym(name)
            self.integrals[name] = Integral(
                name=name, symbol=symbol, integrand=density * self.symbols.span
            )
        return self.integrals[name].symbol


def _attempt(say: Callable[[Any], Statement], symbol: TimeSymbol) -> Statement | None:
    """Return what a rule says of time as a symbol, None if it cannot do with one."""
    try:
        # What Pyomo logs of a failure that the rule's second reading mends would only mislead.
        with LoggingIntercept(None, "pyomo.core"):
            return _as_numeric(say(symbol))
    except Exception:  # noqa: BLE001  the rule is the user's: it may raise anything
        return None


def _as_numeric(statement: Statement) -> Statement:
    """Put the parameter for time itself where a rule returned its time as it is."""
    parts = (p.as_numeric() if isinstance(p, TimeSymbol) else p for p in statement.parts)
    return replace(statement, parts=tuple(parts))


def _is_unbounded(lower: Any, upper: Any) -> bool:
    sides = (lower, -casadi.inf), (upper, casadi.inf)
    return all(casadi.is_equal(side, casadi.SX(limit)) for side, limit in sides)


def _relation(said: Any, name: str) -> Statement:
    """Return what the rule of a constraint returned as lower bound, body and upper bound."""
    if said is Constraint.Skip or said is Constraint.Feasible or said is True:
        return Statement(parts=(None, 0.0, None))
    if said is Constraint.Infeasible or said is False:
        raise TranscriptionError(
            f"{name}: its rule says that it cannot be met; correct the rule or relax a limit in it."
        )
    data = ConstraintData(expr=said)
    return Statement(parts=data.to_bounded_expression(), is_equality=bool(data.equality))
