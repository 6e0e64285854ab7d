"""Rules of a model's components: functions that make the members of constraints and expressions.

A clone of a model keeps the rules of the original. This module makes these rules refer to the
clone's components, and checks that members still agree with their rules. The clone has an
additional time in each continuous set, the template time. Rules are also called at this and other
times that the user's model does not declare.
"""

from __future__ import annotations

from functools import partial
from types import CellType, CodeType, FunctionType, MethodType
from typing import TYPE_CHECKING, Any

from pyomo.common.errors import PyomoException
from pyomo.core import ComponentUID, Constraint, ConstraintList, Expression
from pyomo.core.base.component import Component, ComponentData
from pyomo.core.base.expression import NamedExpressionData
from pyomo.core.base.initializer import Initializer
from pyomo.core.expr.compare import PrefixVisitor
from pyomo.dae import DerivativeVar

from pyomo_quad.collocation.errors import TranscriptionError, raised
from pyomo_quad.collocation.reading.clock import index_tuple

if TYPE_CHECKING:
    from collections.abc import Iterator

# Attributes in which Pyomo's components keep their rules.
_RULES = ("_rule", "_rule_init", "_rule_bounds")
_FUNCTION = "_fcn"  # attribute in which Pyomo's initializers keep a function
_INNER = "_initializer"  # attribute in which a wrapping initializer keeps the wrapped one


def transfer_rules(model: Any, copy: Any) -> None:
    """Make the rules of a clone refer to the clone's components instead of the original's.

    Parameters
    ----------
    model : ConcreteModel
        The model that was cloned.
    copy : ConcreteModel
        Its clone, whose rules are changed.
    """
    translator = _Translator(model, copy)
    for component in copy.component_objects(descend_into=True):
        for name in _RULES:
            rule = _innermost(getattr(component, name, None))
            if hasattr(rule, _FUNCTION):
                setattr(rule, _FUNCTION, translator.translate(getattr(rule, _FUNCTION)))
        if isinstance(component, DerivativeVar):
            # The equation with which a discretisation in space replaced the derivative.
            formula = translator.translate(component.get_derivative_expression())
            component.set_derivative_expression(formula)


def _innermost(rule: Any) -> Any:
    """Return the innermost of nested Pyomo initializers, which holds the user's function."""
    while hasattr(rule, _INNER):
        rule = getattr(rule, _INNER)
    return rule


def function_of(component: Any) -> Any:
    """Return the user's function in a component's rule: (block, index) -> expression."""
    return getattr(_innermost(component._rule), _FUNCTION)  # noqa: SLF001


def rule_of(component: Any) -> Any:
    """Return the rule that makes the members of a component, as a Pyomo initializer, or None.

    The default function of a mutable parameter counts as a rule. A constant and a ConstraintList
    have no rule.
    """
    if isinstance(component, ConstraintList):
        return None  # Its rule counts its own calls and takes no index.
    rule = getattr(component, "_rule", None)
    if rule is None and isinstance(getattr(component, "_default_val", None), FunctionType):
        return Initializer(component._default_val)  # noqa: SLF001
    return None if rule is None or rule.constant() else rule


def bounds_rule_of(variable: Any) -> Any:
    """Return the rule that gives the members of a variable their bounds, or None.

    Constant bounds are no rule.
    """
    rule = getattr(variable, "_rule_bounds", None)
    return None if rule is None or rule.constant() else rule


def initial_rule_of(variable: Any) -> Any:
    """Return the rule that gives the members of a variable their initial values, or None.

    A constant initial value is no rule.
    """
    rule = getattr(variable, "_rule_init", None)
    return None if rule is None or rule.constant() else rule


def refuse_lost_members(copy: Any, template_time: float) -> None:
    """Raise an error for an indexed constraint or expression whose rule fails at the template time.

    Pyomo leaves out a member without notice if its rule raises a KeyError. `copy` is the clone of
    the user's model that has this time.

    Raises
    ------
    TranscriptionError
        If a rule fails; the message names the component.
    """
    for component, rule in _with_rules(copy):
        for index in component.index_set():
            # At the template time, a skipped member would remove the constraint from the nonlinear
            # program.
            if template_time not in index_tuple(index) or index in component:
                continue
            try:
                rule(component.parent_block(), index)
            except Exception as error:
                raise refusal(component.name, error) from error


def refuse_changed_members(copy: Any) -> None:
    """Raise an error for members that differ from the expression that their rule returns.

    Raises
    ------
    TranscriptionError
        If the member differs, or the rule fails.
    """
    # Equations over time are read by calling the rule again. The call would not show a change by
    # Pyomo's method `set_value`.
    for component, rule in _with_rules(copy):
        for index, member in component.items():
            try:
                stated = rule(component.parent_block(), index)
            except Exception as error:
                raise TranscriptionError(
                    f"{component.name}: its rule no longer fits the model ({raised(error)}), as "
                    "after core.scale_model; scale with the Suffix scaling_factor alone, which the "
                    "engine reads, or discretise the model before it is transformed."
                ) from error
            if component.ctype is Constraint:
                stated = type(member)(expr=stated).expr
            if not _is_same(member.expr, stated):
                raise TranscriptionError(
                    f"{member.name}: was changed after its rule made it; delete the "
                    "component and declare it anew with a rule that returns the changed expression."
                )


def _is_same(held: Any, stated: Any) -> bool:
    """Return whether a member's expression equals the expression that its rule returns now."""
    parts = [_PrefixNotation().walk_expression(expression) for expression in (held, stated)]
    try:
        is_equal = parts[0] == parts[1]
    except (PyomoException, AttributeError):
        is_equal = False
    # Pyomo cannot compare external functions, so the texts are compared, too.
    return bool(is_equal) or str(held) == str(stated)


class _PrefixNotation(PrefixVisitor):
    """Visitor that writes a Pyomo expression in prefix notation, so that two can be compared.

    A named expression is written without its contents.
    """

    def enterNode(self, node: Any) -> Any:  # noqa: N802  Pyomo's name
        """Append an expression node to the prefix notation, and return its child nodes."""
        if isinstance(node, NamedExpressionData):
            # The contents are compared separately, with the result of the named expression's own
            # rule.
            self._result.append(node)
            return (), None
        return super().enterNode(node)


def _with_rules(copy: Any) -> Iterator[tuple[Any, Any]]:
    """Yield the clone's indexed constraints and expressions with a rule, and the rule."""
    for component in copy.component_objects((Constraint, Expression), descend_into=True):
        if component.is_indexed() and rule_of(component) is not None:
            yield component, rule_of(component)


class _Translator:
    """Translator of functions that refer to a model into functions that refer to its clone.

    A rule may refer to the model through its closure, global variables and default arguments.
    """

    def __init__(self, model: Any, copy: Any) -> None:
        self._model = model
        self._copy = copy
        self._functions: dict[FunctionType, FunctionType] = {}

    def translate(self, value: Any) -> Any:
        """Return a copy of a value that refers to the model's clone instead of the model.

        Components, functions and collections of them are translated; other values are returned
        unchanged.
        """
        if isinstance(value, Component | ComponentData):
            return self._component(value)
        if isinstance(value, FunctionType | MethodType | partial):
            return self._callable(value)
        if type(value) in (list, tuple, set):
            return type(value)(self.translate(item) for item in value)
        if type(value) is dict:
            return {key: self.translate(item) for key, item in value.items()}
        return value

    def _callable(self, value: Any) -> Any:
        """Return a copy of a function, method or partial that refers to the model's clone."""
        if isinstance(value, FunctionType):
            return self._function(value)
        if isinstance(value, MethodType):
            return MethodType(self.translate(value.__func__), self.translate(value.__self__))
        arguments, keywords = self.translate(value.args), self.translate(value.keywords)
        return partial(self.translate(value.func), *arguments, **keywords)

    def _component(self, component: Any) -> Any:
        """Return the component of the model's clone that corresponds to a component of the model.

        A component of a different model is returned unchanged.
        """
        if component is self._model:
            return self._copy
        if component.model() is not self._model:
            return component
        found = ComponentUID(component).find_component_on(self._copy)
        return component if found is None else found

    def _function(self, function: FunctionType) -> FunctionType:
        """Return a copy of a function that refers to the model's clone instead of the model."""
        if function in self._functions:
            return self._functions[function]
        cells = tuple(CellType() for _ in function.__closure__ or ())
        names = {**function.__globals__}
        translated = FunctionType(
            function.__code__, names, function.__name__, closure=cells or None
        )
        # Stored before its parts are translated, because functions may refer to each other.
        self._functions[function] = translated
        for cell, original in zip(cells, function.__closure__ or (), strict=True):
            cell.cell_contents = self.translate(original.cell_contents)
        for name in _global_names(function.__code__) & names.keys():
            names[name] = self._global(names[name], function)
        translated.__defaults__ = self.translate(function.__defaults__)
        translated.__kwdefaults__ = self.translate(function.__kwdefaults__)
        return translated

    def _global(self, value: Any, function: FunctionType) -> Any:
        """Return the value of a global variable of `function`, translated to refer to the clone.

        A value that is a function of another module than that of `function` is returned unchanged.
        """
        is_foreign = isinstance(value, FunctionType) and (
            value.__globals__ is not function.__globals__
        )
        return value if is_foreign else self.translate(value)


def _global_names(code: CodeType) -> set[str]:
    """Return the names of the global variables that a code object and its inner functions read."""
    inner = (constant for constant in code.co_consts if isinstance(constant, CodeType))
    return set(code.co_names).union(*(_global_names(part) for part in inner))


def refusal(name: str, error: Exception) -> TranscriptionError:
    """Return the error for a rule of the component `name` that fails at an undeclared time.

    The time is not a member of the continuous set in the user's model. The message has the
    exception of the rule.
    """
    return TranscriptionError(
        f"{name}: its rule fails at a time that the model did not declare ({raised(error)}); let "
        "it read nothing but its time and components of the model."
    )
