"""Translation of Pyomo expressions to CasADi expressions.

Equations over time are translated at the template time, an interior time added to the continuous
set. The symbols in a translation stand for functions of time, so the translation holds at all
times.

The declared times are the members of the set in the user's own model. A declared time is usually a
physical time. For a free time, a static variable (variable without time) is the physical time,
which is unknown before the solve. A `Slot` is a scalar variable or parameter with its CasADi
symbol. An `Address` identifies a component's member by name, index without time, and time.
"""

from __future__ import annotations

import operator
from bisect import bisect_left
from dataclasses import replace
from functools import partial, reduce
from typing import TYPE_CHECKING, Any, NoReturn

import casadi
import numpy as np
from pyomo.common.log import LoggingIntercept
from pyomo.core import Constraint, Expression, Param, Var
from pyomo.core.base.constraint import ConstraintData
from pyomo.core.base.units_container import _PyomoUnit
from pyomo.core.expr import numeric_expr
from pyomo.core.expr.numvalue import NonNumericValue, NumericConstant, native_types
from pyomo.core.expr.visitor import StreamBasedExpressionVisitor
from pyomo.dae import DerivativeVar
from pyomo.dae import Integral as PyomoIntegral

from pyomo_quad.collocation.errors import TranscriptionError, raised
from pyomo_quad.collocation.reading.rules import bounds_rule_of, rule_of
from pyomo_quad.collocation.reading.schedules import BESIDE, Phases, Schedule, Statement
from pyomo_quad.collocation.reading.symbols import (
    AddressBook,
    Instant,
    Integral,
    PathEquation,
    SymbolTable,
    TimeSymbol,
    indexed_name,
    integrand,
    time_parameter,
)
from pyomo_quad.collocation.reading.tables import TableUse, external

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from pyomo_quad.collocation.reading.copy import WorkingCopy
    from pyomo_quad.collocation.reading.symbols import Address, Slot

# Number of points at which two expressions must agree to count as equal.
_COMPARED = 5

_UNARY: dict[str, Callable[[Any], Any]] = {
    name: getattr(casadi, name)
    for name in (
        *("sin", "cos", "tan", "asin", "acos", "atan"),
        *("sinh", "cosh", "tanh", "asinh", "acosh", "atanh"),
        *("exp", "log", "log10", "sqrt"),
    )
}


def _sum(*terms: Any) -> Any:
    """Return the sum of CasADi expressions."""
    return reduce(operator.add, terms)


_OPERATIONS: tuple[tuple[Any, Callable[..., Any]], ...] = (
    (numeric_expr.ProductExpression, operator.mul),
    (numeric_expr.SumExpression, _sum),
    (numeric_expr.LinearExpression, _sum),
    (numeric_expr.PowExpression, operator.pow),
    (numeric_expr.NegationExpression, operator.neg),
    (numeric_expr.DivisionExpression, operator.truediv),
    (numeric_expr.AbsExpression, casadi.fabs),
)


class ExpressionWriter:
    """Translator of Pyomo expressions to CasADi expressions; each named expression is written once.

    Parameters
    ----------
    leaf : callable
        Returns the symbol of a Pyomo variable or mutable parameter (data object).
    named : callable, optional
        Returns a CasADi or Pyomo expression that replaces a named Pyomo expression, or None to
        translate the named expression's definition.
    """

    def __init__(
        self, leaf: Callable[[Any], Any], named: Callable[[Any], Any] | None = None
    ) -> None:
        self._leaf = leaf
        self._replace = named or (lambda _expression: None)
        # Translations by id. The work grows with the text of the model, not with the number of
        # times that an expression is used.
        self._named: dict[int, Any] = {}
        self._owner = ""
        self.table_uses: list[TableUse] = []
        self._visitor = StreamBasedExpressionVisitor(
            beforeChild=self._before_child,
            exitNode=self._exit_node,
            initializeWalker=self._initialize,
        )

    def write(self, expression: Any, owner: str) -> Any:
        """Return the CasADi expression of a Pyomo expression or number.

        `owner` is the name of the component that contains the expression, for messages.

        Raises
        ------
        TranscriptionError
            If the expression contains a function without a smooth CasADi counterpart.
        """
        self._owner = owner
        return self._visitor.walk_expression(expression)

    def _initialize(self, expression: Any) -> tuple[bool, Any]:
        """Tell Pyomo's expression walker whether to descend into an expression.

        The result is (True, `expression`) to descend into it, else (False, translation).
        """
        go_on, value = self._before_child(None, expression, 0)
        return go_on, expression if go_on else value

    def _before_child(self, _parent: Any, child: Any, _index: int) -> tuple[bool, Any]:
        """Tell Pyomo's expression walker whether to descend into the argument of an operation.

        The result is (True, None) to descend into it, else (False, translation).
        """
        if child.__class__ in native_types:
            return False, child
        if not child.is_expression_type():
            return False, self._atom(child)
        if isinstance(child, numeric_expr.Expr_ifExpression):
            raise self._unsupported("Expr_if")
        if not child.is_named_expression_type():
            return True, None
        if id(child) not in self._named:
            replacement = self._replace(child)
            if replacement is None:
                return True, None
            if not isinstance(replacement, casadi.SX):
                replacement = self._visitor.walk_expression(replacement)
            self._named[id(child)] = replacement
        return False, self._named[id(child)]

    def _atom(self, child: Any) -> Any:
        """Return the CasADi symbol or number for an operand that is not itself an operation.

        A unit counts as the factor 1.
        """
        if isinstance(child, _PyomoUnit):
            return 1.0
        if isinstance(child, NonNumericValue) and isinstance(child.value, TimeSymbol):
            return self._leaf(child.value.as_numeric())
        return child.value if isinstance(child, NumericConstant) else self._leaf(child)

    def _exit_node(self, node: Any, arguments: list[Any]) -> Any:
        """Return the CasADi expression of an operation or named expression of Pyomo."""
        # Pyomo's expression walker calls this method after it has visited all arguments.
        if node.is_named_expression_type():
            self._named[id(node)] = arguments[0]
            return arguments[0]
        return self._apply(node, arguments)

    def apply(self, node: Any, arguments: list[Any], owner: str) -> Any:
        """Return the CasADi expression of a Pyomo operation applied to translated arguments.

        Parameters
        ----------
        node : Pyomo expression
            The operation.
        arguments : list of casadi.SX
            Arguments of the operation.
        owner : str
            Name of the component that contains the operation, for messages.
        """
        self._owner = owner
        return self._apply(node, arguments)

    def _apply(self, node: Any, arguments: list[Any]) -> Any:
        """Return the CasADi expression of a Pyomo operation applied to translated arguments.

        A `TranscriptionError` is raised for an operation without a smooth counterpart in CasADi.
        """
        for kind, operation in _OPERATIONS:
            if isinstance(node, kind):
                return operation(*arguments)
        if isinstance(node, numeric_expr.ExternalFunctionExpression):
            return external(node, arguments, self._owner, self.table_uses)
        if isinstance(node, numeric_expr.UnaryFunctionExpression) and node.name in _UNARY:
            return _UNARY[node.name](arguments[0])
        is_function = isinstance(node, numeric_expr.UnaryFunctionExpression)
        raise self._unsupported(node.name if is_function else type(node).__name__)

    def _unsupported(self, what: str) -> TranscriptionError:
        """Return the error for a function that cannot be translated; `what` is its name."""
        return TranscriptionError(
            f"{self._owner}: {what} is not supported; write it with smooth functions (for a "
            "switch: a tanh or sqrt smoothing)."
        )


def same_expression(first: Any, second: Any) -> bool:
    """Return whether two CasADi expressions are the same function of the same symbols.

    Expressions with different trees are compared by their values at five random points.
    """
    first, second = casadi.SX(first), casadi.SX(second)
    if casadi.is_equal(first, second, 1_000_000):
        return True
    # CasADi may have simplified constants in only one of the trees.
    symbols = casadi.symvar(casadi.vertcat(first, second))
    both = casadi.Function("both", [casadi.vertcat(casadi.SX(0, 1), *symbols)], [first, second])
    points = np.random.default_rng(seed=0).uniform(0.1, 0.9, (_COMPARED, len(symbols)))
    values = np.array([[float(v) for v in both(point)] for point in points])
    return bool(np.allclose(values[:, 0], values[:, 1], rtol=1e-9, atol=1e-12, equal_nan=True))


def symbol_names(expression: Any) -> frozenset[str]:
    """Return the names of the symbols in a CasADi expression."""
    # Converting an SX to an SX takes longer than finding its symbols.
    held = expression if isinstance(expression, casadi.SX) else casadi.SX(expression)
    return frozenset(s.name() for s in casadi.symvar(held))


# Defaults of a lower bound, a body and an upper bound that a rule does not return.
_ABSENT = (-casadi.inf, 0.0, casadi.inf)


class TemplateWriter:
    """Translator of a model's components to CasADi expressions, for all times.

    Some private methods have a parameter `say`, a function that calls the rule of a component. It
    maps a time, an `Instant` or a `TimeSymbol`, to the rule's result, a `Statement`. Their
    parameter `name` is the name of this component, for messages.

    Parameters
    ----------
    copy : WorkingCopy
    free, statics
        See `SymbolTable`.

    Attributes
    ----------
    integrals : dict
        Integrals found so far, by name.
    table_uses : list of TableUse
        Arguments of tables found so far.
    schedules : list of Schedule or Phases
        A `Schedule` for each rule that branches on time or looks up numbers by time. If free times
        divide the horizon into phases, the first item is a `Phases` object.
    """

    def __init__(
        self, copy: WorkingCopy, free: Mapping[float, Any], statics: dict[str, Slot] | None = None
    ) -> None:
        self.copy = copy
        self.addresses = AddressBook(copy.time)
        self.symbols = SymbolTable(copy, self.addresses, free, {} if statics is None else statics)
        self.integrals: dict[str, Integral] = {}
        clock = self.symbols.clock
        self.schedules: list[Schedule | Phases] = [Phases(clock)] if clock.phases else []
        self._by_rule: dict[str, Any] = {}
        self._clock = time_parameter()
        self._instants: dict[float, Any] = {}
        self._writer = ExpressionWriter(self.leaf, self.named)
        self.table_uses = self._writer.table_uses
        self._in_path = False

    def write(self, expression: Any, owner: str, *, over_time: bool = False) -> Any:
        """Return the CasADi expression of a Pyomo expression or number in the component `owner`.

        With `over_time`, the expression belongs to an equation over time, and a value at a declared
        time is an error.
        """
        before, self._in_path = self._in_path, over_time
        try:
            return self._writer.write(expression, owner)
        finally:
            self._in_path = before

    def bound(self, bound: Any, otherwise: float, name: str) -> Any:
        """Return the CasADi expression of a bound, or `otherwise` for an absent bound (None).

        `name` is the name of the component with the bound, for messages.
        """
        return casadi.SX(otherwise if bound is None else self.write(bound, name))

    def path_equation(
        self, component: Any, index: tuple[Any, ...], instance: Any
    ) -> PathEquation | None:
        """Return a constraint over time as a `PathEquation`: lower <= expression <= upper.

        `index` is without time. `instance` is the constraint's member with this index at the
        template time; None if it has none. The result is None if the rule skips all times between
        the declared ones. It is also None if the constraint has neither a rule nor this member.
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
        # The rule skips all times between the declared times.
        if body.is_constant() and is_unbounded(lower, upper):
            return None
        if is_equality:
            body, lower, upper = body - upper, casadi.SX(0), casadi.SX(0)
        return PathEquation(
            name=name, expression=body, lower=lower, upper=upper, is_equality=is_equality
        )

    def bounds_over_time(self, slot: Slot) -> tuple[Any, Any]:
        """Return lower and upper bound of the variable `slot` over time as CasADi expressions."""
        variable = self.copy.model.find_component(slot.component)
        rule, changed = bounds_rule_of(variable), self.changed_bounds(slot)
        if rule is None or changed is not None:
            lower, upper = changed or (slot.lower, slot.upper)
            return self.bound(lower, -casadi.inf, slot.name), self.bound(
                upper, casadi.inf, slot.name
            )
        block = variable.parent_block()

        def say(time: Any) -> Statement:
            lower, upper = rule(block, self.addresses.join(variable, slot.index, time))
            return Statement(parts=(lower, 0.0, upper))

        (lower, _, upper), _ = self._over_time(slot.name, say)
        lowest, highest = self._member(slot, self.copy.template_time).domain.bounds()
        return (
            lower if lowest is None else casadi.fmax(lower, lowest),
            upper if highest is None else casadi.fmin(upper, highest),
        )

    def changed_bounds(self, slot: Slot) -> tuple[Any, Any] | None:
        """Return a variable's bounds for all times, if a user changed the bounds after declaration.

        The result is None if at one or more of the declared times the bounds are unchanged. It is
        also None if a state has different changed bounds at these times: they apply there only. A
        state that is fixed at a declared time is treated like a variable that is no state.

        Raises
        ------
        TranscriptionError
            If the bounds were changed at every declared time: to the same bounds for a state, or
            to different bounds for another variable.
        """
        members = [self._member(slot, time) for time in self.copy.declared_times]
        if any(m.bounds == self.declared_bounds(m) for m in members):
            return None
        is_same = all(m.bounds == members[0].bounds for m in members)
        is_state = slot.rate is not None and not any(m.fixed for m in members)
        # For a state without a fixed member, it is unclear whether equal bounds apply between the
        # declared times.
        if is_same and not is_state:
            return members[0].lower, members[0].upper
        # Different bounds of a state apply at the declared times only.
        if is_state and not is_same:
            return None
        raise TranscriptionError(
            f"{slot.name}: its bounds were changed at every declared time, and are unknown between "
            "these; declare it with bounds= for all times, or write a Constraint for some times."
        )

    def declared_bounds(self, data: Any) -> tuple[float | None, float | None]:
        """Return a member's bounds according to the declaration of its variable, None if absent."""
        variable, address = data.parent_component(), self.addresses.of(data)
        rule = bounds_rule_of(variable)
        if rule is None:
            position = self.addresses.join(variable, address.index, self.copy.template_time)
            return tuple(variable[position].bounds)
        member = type(data)(variable)
        member.domain = data.domain
        member.bounds = rule(variable.parent_block(), data.index())
        return tuple(member.bounds)

    def _member(self, slot: Slot, time: float) -> Any:
        """Return the Pyomo data object of a variable over time at a declared time."""
        variable = self.copy.model.find_component(slot.component)
        return variable[self.addresses.join(variable, slot.index, time)]

    def _over_time(self, name: str, say: Callable[[Any], Statement]) -> tuple[list[Any], bool]:
        """Return the parts of a rule's result in CasADi, and whether it is an equality.

        The parts hold at all times: bounds and body of a constraint, or a single expression. `say`
        maps a time to the rule's result. `name` is the component's name.
        """
        symbol = TimeSymbol(self.copy.template_time, self._clock)
        statement = _attempt(say, symbol)
        if statement is not None and not symbol.is_read:
            parts = zip(statement.parts, _ABSENT, strict=False)
            return [self._part(p, name, absent) for p, absent in parts], statement.is_equality
        # The rule needs its time as a number, for example in a comparison, and is called at many
        # times. If times are free, it may depend only on the declared times before and after its
        # time.
        place = self._within if self.symbols.clock.is_free else float
        schedule = Schedule(
            name, partial(self._statement_at, name, say), self.copy.declared_times, place
        )
        self.schedules.append(schedule)

        def write(part: Any, numbers: Iterator[Any]) -> Any:
            return self._with_numbers(part, numbers, name)

        return schedule.written(write, _ABSENT), schedule.is_equality

    def _statement_at(self, name: str, say: Callable[[Any], Statement], time: float) -> Statement:
        """Call a component's rule at one time through `say`, and return the result of the rule.

        `say` receives an `Instant`, in a model with free times a `TimeSymbol`. A
        `TranscriptionError` is raised if the rule fails, or needs a `TimeSymbol` as a number.
        """
        template = self.copy.template_time
        if self.symbols.clock.is_free:
            declared = self.copy.declared_times
            index: Any = TimeSymbol(template, self._clock, declared, time)
        else:
            index = Instant(time, template)
        try:
            statement = _as_numeric(say(index))
        except TranscriptionError:
            raise
        except Exception as error:
            raise TranscriptionError(
                f"{name}: its rule fails at a time that the model did not declare, {time:g} "
                f"({raised(error)}); let it read nothing but its time and components of the model."
            ) from error
        if self.symbols.clock.is_free and index.is_read:
            _refuse_number(name)
        return statement

    def at_instant(self, data: Any) -> Any:
        """Return a constraint's member at a declared time, with the physical time as a symbol.

        For example, the member of ``m.x[t] == t`` then contains the symbol instead of a number. The
        member is returned unchanged if the constraint has no rule. It is also unchanged if the
        physical time depends on no free time, so that it is a known number.

        Raises
        ------
        TranscriptionError
            If the rule needs the time as a number although its physical time depends on a free
            time.
        """
        component, address = data.parent_component(), self.addresses.of(data)
        rule, clock = rule_of(component), self.symbols.clock
        if not clock.is_free or rule is None or address.time is None:
            return data
        if not symbol_names(clock.time_at(address.time)) & self.symbols.statics.keys():
            return data
        parameter = self._instants.setdefault(address.time, time_parameter())
        symbol = TimeSymbol(float(address.time), parameter, self.copy.declared_times)
        position = self.addresses.join(component, address.index, symbol)
        try:
            said = rule(component.parent_block(), position)
        except Exception as error:  # noqa: BLE001  the user's rule, which accepted a number
            _refuse_number(data.name, error)
        if symbol.is_read:
            _refuse_number(data.name)
        return ConstraintData(expr=said)

    def is_scheduled(self, name: str) -> bool:
        """Return whether the rule of a component branches on time or looks up numbers by time.

        `name` is the component's name with its index but without the time, such as ``limit[1]``.
        """
        return any(s.name == name for s in self.schedules)

    def scheduled_beside(self, time: float, side: int = -1) -> dict[str, tuple[Any, float]]:
        """Return the values of the data in `schedules`, just before or just after a given time.

        `side` is -1 before and 1 after `time`. The result maps the name of each symbol to (symbol,
        value).
        """
        first, last = self.copy.declared_times[0], self.copy.declared_times[-1]
        near = BESIDE * (last - first)
        beside = min(max(time + side * near, first + near), last - near)
        return {
            slot.name: (slot.symbol, number)
            for schedule in self.schedules
            for slot, number in zip(schedule.slots, schedule.row(beside), strict=True)
        }

    def _within(self, time: float) -> float:
        """Return the midpoint between the declared times before and after a given time."""
        declared = self.copy.declared_times
        after = min(max(bisect_left(declared, time), 1), len(declared) - 1)
        return 0.5 * (declared[after - 1] + declared[after])

    def _part(self, part: Any, name: str, absent: Any) -> Any:
        """Return the CasADi expression of a constraint's bound or body, or `absent` if it is None.

        `name` is the name of the constraint, for messages.
        """
        return casadi.SX(absent if part is None else self.write(part, name, over_time=True))

    def _with_numbers(self, part: Any, numbers: Iterator[Any], name: str) -> Any:
        """Translate a Pyomo expression to CasADi, with a replacement for each constant in it.

        `numbers` yields the replacements in the order of the constants. A number that varies with
        time is replaced by a symbol, any other by itself. `name` is the component's name.
        """
        if part.__class__ in native_types:
            return next(numbers)
        if not part.is_expression_type() or part.is_named_expression_type():
            return self.write(part, name, over_time=True)
        arguments = [self._with_numbers(a, numbers, name) for a in part.args]
        return self._writer.apply(part, arguments, name)

    def over_time(self, name: str, index: tuple[Any, ...]) -> Any:
        """Return a variable or expression over time as a CasADi expression that holds at any time.

        The index is without time: (i,) for ``x[i, t]``. The result is None if no component over
        time is called `name`. If the component has no such index, a KeyError is raised.
        """
        found = self.copy.model.find_component(name)
        if found is None or self.addresses.time_position(found) is None:
            return None
        return self.write_at_template(found, index)

    def components_over_time(self) -> Iterator[tuple[str, tuple[Any, ...]]]:
        """Yield the members of all variables, parameters and expressions over time.

        Each item is (name of the component, index without time), the arguments of `over_time`.
        """
        kinds = (Var, DerivativeVar, Param, Expression)
        for component in self.copy.model.component_objects(kinds, descend_into=True):
            if self.addresses.time_position(component) is not None:
                for position in component:
                    address = self.addresses.split(component, position)
                    if address.time == self.copy.template_time:
                        yield component.name, address.index

    def write_at_template(self, component: Any, index: tuple[Any, ...]) -> Any:
        """Return a variable or expression over time as a CasADi expression that holds at any time.

        Unlike in `over_time`, the component itself is given. `index` is without time.
        """
        position = self.addresses.join(component, index, self.copy.template_time)
        return casadi.SX(self.write(component[position], component.name, over_time=True))

    def leaf(self, data: Any) -> Any:
        """Return a Pyomo variable or parameter in CasADi symbols.

        A TranscriptionError is raised for a value at a declared time inside an equation over time.
        Declared times are the members of the user's continuous set.
        """
        if data is self._clock:
            return self.symbols.clock.time
        for time, parameter in self._instants.items():
            if data is parameter:
                return self.symbols.clock.time_at(time)
        address = self.addresses.of(data)
        if self.symbols.clock.is_free and data.is_parameter_type():
            return self._parameter_over_time(data, address)
        symbol = self.symbols.leaf(data)
        if self._in_path and address.time not in (None, self.copy.template_time):
            raise TranscriptionError(
                f"{data.name}: a value at a fixed time inside an equation over time is not "
                "supported; introduce a static variable equal to it."
            )
        return symbol

    def named(self, expression: Any) -> Any:
        """Return the CasADi expression that replaces a named Pyomo expression or an integral.

        An integral over the model's horizon is replaced by its symbol. A named expression at the
        template time is replaced by the translated result of its rule. The result is None if it has
        no rule, and in all other cases. The caller then translates the definition of the
        expression.
        """
        component = expression.parent_component()
        if component is None:
            return None
        if component.ctype is PyomoIntegral and component.get_continuousset() is self.copy.time:
            return self._integral(component, expression.index())
        address = self.addresses.split(component, expression.index())
        rule = rule_of(component)
        if address.time != self.copy.template_time or rule is None:
            return None
        return self._expression(component, address.index, rule)

    def _expression(self, component: Any, index: tuple[Any, ...], rule: Any) -> Any:
        """Return the CasADi expression of a named Pyomo expression over time, from its rule.

        The result is cached by name.
        """
        name, block = indexed_name(component.name, index), component.parent_block()
        if name in self._by_rule:
            return self._by_rule[name]

        def say(time: Any) -> Statement:
            return Statement(parts=(rule(block, self.addresses.join(component, index, time)),))

        self._by_rule[name] = self._over_time(name, say)[0][0]
        return self._by_rule[name]

    def _parameter_over_time(self, data: Any, address: Address) -> Any:
        """Return a parameter, in a model with free times, as a CasADi expression.

        `data` is a Pyomo data object. A parameter with a rule over time becomes a function of time.
        At a declared time in `address`, it becomes its value. Others become symbols.
        """
        component = data.parent_component()
        rule = rule_of(component)
        if rule is None or address.time is None:
            return self.symbols.leaf(data)
        # The value depends on the free times, so that its derivative with respect to time is
        # required.
        over_time = casadi.SX(self._expression(component, address.index, rule))
        if address.time == self.copy.template_time:
            return over_time
        numbers = self.scheduled_beside(address.time).values()
        clock = self.symbols.clock
        old = casadi.vertcat(clock.fraction, *(symbol for symbol, _ in numbers))
        new = [clock.fraction_of(address.time), *(number for _, number in numbers)]
        return casadi.substitute(over_time, old, casadi.SX(new))

    def _integral(self, component: Any, index: Any) -> Any:
        """Return the CasADi symbol of an integral, and store its integrand at first use.

        A `TranscriptionError` is raised for an integral inside an equation over time.
        """
        if self._in_path:
            raise TranscriptionError(
                f"{component.name}: an integral inside an equation over time is not supported; "
                "declare it as a state."
            )
        name = component.name if index is None else component[index].name
        if name not in self.integrals:

            def say(time: Any) -> Statement:
                return Statement(parts=(integrand(component, index, time),))

            (density,), _ = self._over_time(name, say)
            symbol = casadi.SX.sym(name)
            self.integrals[name] = Integral(
                name=name, symbol=symbol, integrand=density * self.symbols.clock.span
            )
        return self.integrals[name].symbol


def _attempt(say: Callable[[Any], Statement], symbol: TimeSymbol) -> Statement | None:
    """Return the result of calling a rule with a symbol for time; None if it raises an exception.

    `say` maps a time, or a symbol for it, to the rule's result.
    """
    try:
        # Hide Pyomo's log of this failure: the second reading of the rule recovers from it.
        with LoggingIntercept(None, "pyomo.core"):
            return _as_numeric(say(symbol))
    except Exception:  # noqa: BLE001  the rule is the user's: it may raise anything
        return None


def _refuse_number(name: str, error: Exception | None = None) -> NoReturn:
    """Raise an error for a rule that uses its time as a number in a model with free times.

    `error` is the exception with which the rule failed, if it failed.
    """
    # Physical times are unknown when the rules are called. Only comparisons with declared times are
    # allowed.
    told = "" if error is None else f" ({raised(error)})"
    raise TranscriptionError(
        f"{name}: its rule reads its time as a number, which changes with a free time{told}; "
        "compare it with declared times only, and calculate with Pyomo's functions."
    ) from error


def _as_numeric(statement: Statement) -> Statement:
    """Return a rule's result, with each `TimeSymbol` in its tuple `parts` replaced by a parameter.

    A rule gets a `TimeSymbol` in place of a time. The Pyomo parameter stands for physical time.
    """
    # Inside expressions, Pyomo has already put the parameter in place of the symbol.
    # The symbol is no Pyomo object.
    parts = (p.as_numeric() if isinstance(p, TimeSymbol) else p for p in statement.parts)
    return replace(statement, parts=tuple(parts))


def is_unbounded(lower: Any, upper: Any) -> bool:
    """Return whether a lower and an upper CasADi bound are both absent (infinite)."""
    sides = (lower, -casadi.inf), (upper, casadi.inf)
    return all(casadi.is_equal(side, casadi.SX(limit)) for side, limit in sides)


def _relation(said: Any, name: str) -> Statement:
    """Return the result of a constraint's rule as lower bound, body and upper bound.

    A skipped constraint has no bounds. If the rule returns `Constraint.Infeasible`, a
    `TranscriptionError` is raised.
    """
    if said is Constraint.Skip or said is Constraint.Feasible or said is True:
        return Statement(parts=(None, 0.0, None))
    if said is Constraint.Infeasible or said is False:
        raise TranscriptionError(
            f"{name}: its rule returned Constraint.Infeasible; correct the rule or relax a limit "
            "in it."
        )
    data = ConstraintData(expr=said)
    return Statement(parts=data.to_bounded_expression(), is_equality=bool(data.equality))
