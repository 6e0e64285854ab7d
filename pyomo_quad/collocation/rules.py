"""The rules of a cloned model, made to speak of the clone.

`clone` copies components but not functions: a rule such as ``lambda _, t: m.u[t] <= 1`` goes on
reading the model ``m`` that it was written for.  The engine calls rules on its working copy, so it
gives the copy's rules the copy's components, wherever the function holds them.
"""

from __future__ import annotations

from functools import partial
from types import CellType, CodeType, FunctionType, MethodType
from typing import TYPE_CHECKING, Any

from pyomo.core.base.component import Component, ComponentData
from pyomo.core.base.initializer import Initializer
from pyomo.core.expr.compare import compare_expressions
from pyomo.environ import ComponentUID, Constraint, Expression

from pyomo_quad.collocation.errors import TranscriptionError

if TYPE_CHECKING:
    from collections.abc import Iterator

__all__ = [
    "bounds_rule_of",
    "refuse_changed_members",
    "refuse_lost_members",
    "rule_of",
    "transfer_rules",
]

_RULES = ("_rule", "_rule_init", "_rule_bounds")
_FUNCTION = "_fcn"  # where Pyomo's initializers keep a function
_INNER = "_initializer"  # and where those that wrap another keep it


def transfer_rules(model: Any, copy: Any) -> None:
    """Let the rules of a clone refer to the clone.

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
            rule = getattr(component, name, None)
            while hasattr(rule, _INNER):
                rule = getattr(rule, _INNER)
            if hasattr(rule, _FUNCTION):
                setattr(rule, _FUNCTION, translator.translate(getattr(rule, _FUNCTION)))


def rule_of(component: Any) -> Any:
    """Return the rule that makes a component's members, None if there is none."""
    rule = getattr(component, "_rule", None)
    if rule is None and isinstance(getattr(component, "_default_val", None), FunctionType):
        return Initializer(component._default_val)  # noqa: SLF001
    return None if rule is None or rule.constant() else rule


def bounds_rule_of(variable: Any) -> Any:
    """Return the rule that gives a variable's members their bounds, None if there is none."""
    rule = getattr(variable, "_rule_bounds", None)
    return None if rule is None or rule.constant() else rule


def refuse_lost_members(copy: Any, template_time: float) -> None:
    """Refuse rules that fail at a time of which the model did not know.

    Pyomo takes a `KeyError` in a rule for a wish to skip the member; an equation would be lost.

    Raises
    ------
    TranscriptionError
        Naming the component.
    """
    for component, rule in _with_rules(copy):
        for index in component.index_set():
            if template_time not in _flat(index) or index in component:
                continue
            try:
                rule(component.parent_block(), index)
            except Exception as error:
                what = f"no member {error}" if isinstance(error, KeyError) else f"{error}"
                raise TranscriptionError(
                    f"{component.name}: its rule fails at a time that the model did not declare "
                    f"({what}); let it read nothing but its time and components of the model."
                ) from error


def refuse_changed_members(copy: Any) -> None:
    """Refuse members that no longer say what their rule says.

    The engine reads an equation over time from its rule; a member changed by `set_value` after
    the rule ran would be overlooked.

    Raises
    ------
    TranscriptionError
        Naming the member.
    """
    for component, rule in _with_rules(copy):
        for index in tuple(component)[-1:]:
            stated = rule(component.parent_block(), index)
            if component.ctype is Constraint:
                stated = type(component[index])(expr=stated).expr
            if not compare_expressions(component[index].expr, stated):
                raise TranscriptionError(
                    f"{component[index].name}: was changed after its rule made it; delete the "
                    "component and declare it anew with a rule that says what is meant."
                )


def _with_rules(copy: Any) -> Iterator[tuple[Any, Any]]:
    for component in copy.component_objects((Constraint, Expression), descend_into=True):
        if component.is_indexed() and rule_of(component) is not None:
            yield component, rule_of(component)


def _flat(index: Any) -> tuple[Any, ...]:
    return index if isinstance(index, tuple) else (index,)


class _Translator:
    """Replaces a model's components by those of its clone inside functions."""

    def __init__(self, model: Any, copy: Any) -> None:
        self._model = model
        self._copy = copy
        self._functions: dict[FunctionType, FunctionType] = {}

    def translate(self, value: Any) -> Any:
        """Return what stands for a value on the clone."""
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
        if isinstance(value, FunctionType):
            return self._function(value)
        if isinstance(value, MethodType):
            return MethodType(self.translate(value.__func__), self.translate(value.__self__))
        arguments, keywords = self.translate(value.args), self.translate(value.keywords)
        return partial(self.translate(value.func), *arguments, **keywords)

    def _component(self, component: Any) -> Any:
        if component is self._model:
            return self._copy
        if component.model() is not self._model:
            return component
        found = ComponentUID(component).find_component_on(self._copy)
        return component if found is None else found

    def _function(self, function: FunctionType) -> FunctionType:
        if function in self._functions:
            return self._functions[function]
        cells = tuple(CellType() for _ in function.__closure__ or ())
        names = {**function.__globals__}
        translated = FunctionType(
            function.__code__, names, function.__name__, closure=cells or None
        )
        # Known before its parts are translated: functions may refer to each other.
        self._functions[function] = translated
        for cell, original in zip(cells, function.__closure__ or (), strict=True):
            cell.cell_contents = self.translate(original.cell_contents)
        for name in _global_names(function.__code__) & names.keys():
            names[name] = self._global(names[name], function)
        translated.__defaults__ = self.translate(function.__defaults__)
        translated.__kwdefaults__ = self.translate(function.__kwdefaults__)
        return translated

    def _global(self, value: Any, function: FunctionType) -> Any:
        is_foreign = isinstance(value, FunctionType) and (
            value.__globals__ is not function.__globals__
        )
        return value if is_foreign else self.translate(value)


def _global_names(code: CodeType) -> set[str]:
    inner = (constant for constant in code.co_consts if isinstance(constant, CodeType))
    return set(code.co_names).union(*(_global_names(part) for part in inner))
