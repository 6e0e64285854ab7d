"""Working copy of a user's model from which the templates are read, with its rules and times.

Between two declared times, which may be free, physical time is linear in the fraction of the
horizon.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import pairwise
from traceback import walk_tb
from types import CellType, CodeType, FunctionType, MethodType
from typing import TYPE_CHECKING, Any

from pyomo.core import (
    Block,
    ComponentUID,
    Constraint,
    ConstraintList,
    Expression,
    Model,
    Objective,
    Param,
    Piecewise,
    SOSConstraint,
    Suffix,
    Var,
)
from pyomo.core.base.component import ActiveComponent, Component, ComponentData
from pyomo.core.base.indexed_component import IndexedComponent
from pyomo.core.base.initializer import Initializer
from pyomo.core.expr.compare import compare_expressions
from pyomo.core.expr.visitor import identify_mutable_parameters, identify_variables
from pyomo.dae import ContinuousSet, DerivativeVar, Integral
from pyomo.dae.misc import expand_components
from pyomo.network import Port

from pyomo_quad.collocation.errors import TranscriptionError, raised

if TYPE_CHECKING:
    from collections.abc import Iterator

_RULES = ("_rule", "_rule_init", "_rule_bounds")
_FUNCTION = "_fcn"  # attribute in which Pyomo's initializers keep a function
_INNER = "_initializer"  # attribute in which a wrapping initializer keeps the wrapped one


def transfer_rules(model: Any, copy: Any) -> None:
    """Make the rules of a clone refer to the clone.

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
        if isinstance(component, DerivativeVar):
            # The equation with which a discretisation in space replaced the derivative.
            formula = translator.translate(component.get_derivative_expression())
            component.set_derivative_expression(formula)


def rule_of(component: Any) -> Any:
    """Return the rule that makes a component's members, None if there is none."""
    if isinstance(component, ConstraintList):
        return None  # Its rule counts its own calls and takes no index.
    rule = getattr(component, "_rule", None)
    if rule is None and isinstance(getattr(component, "_default_val", None), FunctionType):
        return Initializer(component._default_val)  # noqa: SLF001
    return None if rule is None or rule.constant() else rule


def bounds_rule_of(variable: Any) -> Any:
    """Return the rule that gives a variable's members their bounds, None if there is none."""
    rule = getattr(variable, "_rule_bounds", None)
    return None if rule is None or rule.constant() else rule


def initial_rule_of(variable: Any) -> Any:
    """Return the rule that initializes a variable's members, None if there is none."""
    rule = getattr(variable, "_rule_init", None)
    return None if rule is None or rule.constant() else rule


def refuse_lost_members(copy: Any, template_time: float) -> None:
    """Refuse rules that fail at a time that the model does not declare.

    Pyomo reads a `KeyError` in a rule as a request to skip the member; an equation would be lost.

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
                raise _refusal(component.name, error) from error


def refuse_changed_members(copy: Any) -> None:
    """Refuse members that differ from the expression that their rule returns.

    The engine reads an equation over time from its rule, so it would overlook a member that was
    changed by `set_value` after the rule ran.

    Raises
    ------
    TranscriptionError
        Naming the member.
    """
    for component, rule in _with_rules(copy):
        for index in tuple(component)[-1:]:
            try:
                stated = rule(component.parent_block(), index)
            except Exception as error:
                raise TranscriptionError(
                    f"{component.name}: its rule no longer fits the model ({raised(error)}), as "
                    "after core.scale_model; scale with the Suffix scaling_factor alone, which the "
                    "engine reads, or discretise the model before it is transformed."
                ) from error
            if component.ctype is Constraint:
                stated = type(component[index])(expr=stated).expr
            if not _is_same(component[index].expr, stated):
                raise TranscriptionError(
                    f"{component[index].name}: was changed after its rule made it; delete the "
                    "component and declare it anew with a rule that returns the changed expression."
                )


def _is_same(held: Any, stated: Any) -> bool:
    """Compare expressions, by their text where an external function hides behind a number."""
    return bool(compare_expressions(held, stated)) or str(held) == str(stated)


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
        """Return the counterpart of a value on the clone."""
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
        is_foreign = isinstance(value, FunctionType) and (
            value.__globals__ is not function.__globals__
        )
        return value if is_foreign else self.translate(value)


def _global_names(code: CodeType) -> set[str]:
    inner = (constant for constant in code.co_consts if isinstance(constant, CodeType))
    return set(code.co_names).union(*(_global_names(part) for part in inner))


# An irrational fraction, so that no declared time coincides with the template time.
_TEMPLATE_FRACTION = 0.3819660112501051


@dataclass(frozen=True, kw_only=True)
class WorkingCopy:
    """A clone of the model with one additional time, whose instances serve as templates.

    Attributes
    ----------
    model, time : ConcreteModel, ContinuousSet or None
    template_time : float
    declared_times : tuple of float
    others : tuple of ContinuousSet
        The other horizons of the model, whose declarations are read elsewhere.
    """

    model: Any
    time: Any = None
    template_time: float = 0.0
    declared_times: tuple[float, ...] = ()
    others: tuple[Any, ...] = ()

    def other_of(self, component: Any) -> Any:
        """Return the other horizon that indexes a component, None if no other does."""
        if not component.is_indexed():
            return None
        return next((time for time in self.others if _is_over(component, time)), None)

    def takes(self, component: Any, data: Any) -> bool:
        """Return whether a constraint belongs to this horizon, or to the coupling of several.

        A constraint on values of one horizon only belongs to that horizon; every other constraint
        belongs to the coupling.
        """
        if not self.others:
            return True
        if self.time is not None and component.is_indexed() and _is_over(component, self.time):
            return True
        held = [
            *identify_variables(data.expr, include_fixed=True),
            *identify_mutable_parameters(data.expr),
        ]
        owners = {
            id(time)
            for variable in held
            for time in (*self.others, self.time)
            if time is not None
            and variable.parent_component().is_indexed()
            and _is_over(variable.parent_component(), time)
        }
        return len(owners) != 1 if self.time is None else owners == {id(self.time)}


def _refuse_other_than_models(model: Any) -> None:
    if not isinstance(model, Model):
        raise TranscriptionError(
            f"model: a {type(model).__name__}; must be a ConcreteModel of pyomo.environ as a whole."
        )
    if not model.is_constructed():
        raise TranscriptionError(
            f"model: {model.name} is abstract; pass the model that its create_instance() returns."
        )


def continuous_sets(model: Any) -> tuple[Any, ...]:
    """Return the model's continuous sets that are not discretised: its horizons.

    Raises
    ------
    TranscriptionError
        If the argument is no model, a component is indexed by two of the sets, or several sets
        exist of which one indexes no component.
    """
    _refuse_other_than_models(model)
    sets = tuple(
        s
        for s in model.component_objects(ContinuousSet, descend_into=True)
        if "scheme" not in s.get_discretization_info()
    )
    if len(sets) < 2:
        return sets
    active = {id(s) for s in model.component_objects(ContinuousSet, active=True)}
    sets = tuple(s for s in sets if id(s) in active or _is_asked_for(model, s))
    used: set[int] = set()
    for component in model.component_objects((Var, DerivativeVar), descend_into=True):
        over = [s for s in sets if component.is_indexed() and _is_over(component, s)]
        if len(over) > 1:
            names = ", ".join(s.name for s in over)
            raise TranscriptionError(
                f"continuous sets {names}: partial differential equations are not supported, as "
                f"{component.name} over both is; discretise all but one of them first, for "
                "instance with dae.finite_difference."
            )
        used.update(id(s) for s in over)
    return tuple(s for s in sets if id(s) in used)


def _is_asked_for(model: Any, time: Any) -> bool:
    """Return whether an active constraint or objective holds a variable indexed by a set."""
    return any(
        _is_over(variable.parent_component(), time)
        for data in model.component_data_objects((Constraint, Objective), active=True)
        for variable in identify_variables(data.expr)
    )


# Active components that the engine interprets; a port only names variables.
_UNDERSTOOD = (Block, Constraint, Objective, Suffix, Port)
# Replacement to suggest for a component type that is not supported.
_INSTEAD = {
    "Disjunction": "write the choice with smooth functions, or solve each case by itself",
    "Disjunct": "write the choice with smooth functions, or solve each case by itself",
    "Complementarity": "write it as inequalities: a >= 0, b >= 0 and a * b <= a small number",
    "Arc": "apply the transformation network.expand_arcs first",
}
_INSTEAD_OVER_TIME = {
    "Block": "index the variables and constraints inside one block by time",
    "Objective": "let one Objective hold an Integral over time, or values at single times",
}


def _refuse_unknown(model: Any) -> None:
    """Refuse every active component that the transcription would drop."""
    for block in model.block_data_objects(active=True, descend_into=True):
        for component in block.component_objects(active=True, descend_into=False):
            if isinstance(component, ActiveComponent) and component.ctype not in _UNDERSTOOD:
                kind = component.ctype.__name__
                instead = _INSTEAD.get(kind, "write it as a Constraint")
                raise TranscriptionError(
                    f"{component.name}: {kind} is not supported; {instead}, or deactivate it."
                )


def _is_over(component: Any, time: Any) -> bool:
    """Return whether a component is indexed by time itself, not by a set with equal members."""
    return any(part is time for part in component.index_set().subsets())


# Component types that gain a member at an added time, made by Pyomo or on access.
_EXPANDED = (Var, DerivativeVar, Param, Constraint, Expression, Integral, Suffix)


def _drop_unexpanded(copy: Any, time: Any) -> None:
    """Delete inactive components of unknown type that cannot be expanded to another time."""
    for component in list(copy.component_objects(descend_into=True)):
        is_unknown = isinstance(component, IndexedComponent) and component.ctype not in _EXPANDED
        if is_unknown and _is_over(component, time):
            component.parent_block().del_component(component)


def _refuse_piecewise(model: Any, times: tuple[Any, ...]) -> None:
    """Refuse piecewise functions that need integers or are indexed by time; the rest are linear."""
    for block in model.component_objects(Block, active=True, descend_into=True):
        if isinstance(block, Piecewise) and (
            any(_is_over(block, time) for time in times)
            or any(block.component_data_objects(SOSConstraint))
            or any(not v.is_continuous() for v in block.component_data_objects(Var))
        ):
            raise TranscriptionError(
                f"{block.name}: Piecewise is not supported; give its points to a Table, which is "
                "a smooth function of states."
            )


def _refuse_unsupported(model: Any, times: tuple[Any, ...]) -> None:
    _refuse_piecewise(model, times)
    _refuse_unknown(model)
    for variable in model.component_data_objects(Var, active=True, descend_into=True):
        if not variable.is_continuous() and not variable.fixed:
            raise TranscriptionError(
                f"{variable.name}: domain {variable.domain} is not continuous; integer variables "
                "are not supported unless they are fixed."
            )
    for component in model.component_objects((Block, Objective), active=True, descend_into=True):
        for time in times:
            if _is_over(component, time):
                kind = component.ctype.__name__
                instead = _INSTEAD_OVER_TIME[kind]
                raise TranscriptionError(
                    f"{component.name}: {kind} indexed by {time.name} is not supported; {instead}."
                )
    for derivative in model.component_objects(DerivativeVar, descend_into=True):
        sets = derivative.get_continuousset_list()
        if times and len(sets) > 1:
            raise TranscriptionError(
                f"{derivative.name}: a derivative of order {len(sets)} is not supported; declare "
                "the first derivative as a variable of its own."
            )


def _keep_parameters(copy: Any, time: Any) -> None:
    """Keep parameters over time as symbols in expressions, immutable ones too."""
    for parameter in copy.component_objects(Param, descend_into=True):
        if parameter.mutable or not _is_over(parameter, time):
            continue
        held = dict(parameter.items())
        parameter._mutable = True  # noqa: SLF001
        parameter.clear()
        for index, number in held.items():
            parameter[index] = number


def copies_with_template_times(model: Any) -> tuple[WorkingCopy, ...]:
    """Clone a model and add one interior time to each of its continuous sets.

    Returns
    -------
    tuple of WorkingCopy
        One per horizon, all of the same clone; a single one for a model without time.

    Raises
    ------
    TranscriptionError
        If the model declares something outside what the engine transcribes.
    """
    copy = model.clone()
    transfer_rules(model, copy)
    times = continuous_sets(copy)
    _refuse_unsupported(copy, times)
    if not times:
        return (WorkingCopy(model=copy),)
    refuse_changed_members(copy)
    copies = []
    for time in times:
        _drop_unexpanded(copy, time)
        _keep_parameters(copy, time)
        declared = tuple(float(t) for t in sorted(time))
        template = declared[0] + _TEMPLATE_FRACTION * (declared[-1] - declared[0])
        time.add(template)
        time.set_changed(True)
        copies.append(
            WorkingCopy(
                model=copy,
                time=time,
                template_time=template,
                declared_times=declared,
                others=tuple(other for other in times if other is not time),
            )
        )
    _expand(copy, copies)
    return tuple(copies)


def _refusal(name: str, error: Exception) -> TranscriptionError:
    return TranscriptionError(
        f"{name}: its rule fails at a time that the model did not declare ({raised(error)}); let "
        "it read nothing but its time and components of the model."
    )


def _culprit(error: Exception, copies: list[WorkingCopy]) -> str:
    """Return the component that Pyomo was building when a rule failed, else the horizons' names."""
    frames = [frame for frame, _ in walk_tb(error.__traceback__)]
    made = [frame.f_locals.get("self") for frame in frames]
    names = [held.name for held in made if isinstance(held, Component)]
    return names[-1] if names else ", ".join(horizon.time.name for horizon in copies)


def _expand(copy: Any, copies: list[WorkingCopy]) -> None:
    """Make the rules build the instances at the template times."""
    try:
        expand_components(copy)
    except Exception as error:
        for horizon in copies:
            refuse_lost_members(copy, horizon.template_time)
        raise _refusal(_culprit(error, copies), error) from error
    finally:
        for horizon in copies:
            horizon.time.set_changed(False)
    for horizon in copies:
        refuse_lost_members(copy, horizon.template_time)


# Least distance, as a fraction of the horizon, between two consecutive times of which one is free.
LEAST_PHASE = 1e-6


@dataclass(frozen=True, kw_only=True)
class PhaseTimes:
    """Phases of the horizon between times that may be free; flags select the phase that holds.

    Attributes
    ----------
    name : str
        Name of the continuous set.
    declared : tuple of float
        Declared times between which time runs evenly, the first and the last among them.
    times : tuple
        The same times in CasADi symbols.
    fraction : SX
        Symbol of the fraction of the declared horizon.
    phases : tuple of SX
        One symbol per phase, 1 where the phase holds and 0 elsewhere; none for a single phase.
    is_free : bool
        Whether any of the times is a static variable.
    """

    name: str
    declared: tuple[float, ...]
    times: tuple[Any, ...]
    fraction: Any
    phases: tuple[Any, ...] = ()
    is_free: bool = False

    @property
    def fractions(self) -> tuple[float, ...]:
        """Declared times as fractions of the declared horizon."""
        return tuple(self.fraction_of(time) for time in self.declared)

    def fraction_of(self, time: float) -> float:
        """Return a declared time as a fraction of the declared horizon."""
        return (time - self.declared[0]) / (self.declared[-1] - self.declared[0])

    @cached_property
    def _spans(self) -> list[Any]:
        """Derivative of time with respect to the fraction of the horizon, phase by phase."""
        ends = zip(pairwise(self.times), pairwise(self.fractions), strict=True)
        return [(after - before) / (last - first) for (before, after), (first, last) in ends]

    @property
    def _holds(self) -> tuple[Any, ...]:
        return self.phases or (1.0,)

    @cached_property
    def span(self) -> Any:
        """Derivative of time with respect to the fraction of the horizon at the template point."""
        return sum(p * span for p, span in zip(self._holds, self._spans, strict=True))

    @cached_property
    def time(self) -> Any:
        """Physical time at the template point."""
        return sum(
            holds * (start + span * (self.fraction - first))
            for holds, start, span, first in zip(
                self._holds, self.times, self._spans, self.fractions, strict=False
            )
        )

    def span_at(self, time: float) -> Any:
        """Return d time / d fraction of the horizon, just before a declared time."""
        return self._spans[self.phase_of(time)]

    def time_at(self, time: float) -> Any:
        """Return the physical time, in symbols, that a declared time maps to."""
        k = self.phase_of(time)
        return self.times[k] + self._spans[k] * (self.fraction_of(time) - self.fractions[k])

    def phase_of(self, time: float) -> int:
        """Return the position of the phase that holds at a declared time, or ends there."""
        return bisect_left(self.declared[1:-1], time)

    def label(self, position: int) -> str:
        """Return the name of one of the declared times."""
        return f"{self.name}[{self.declared[position]:g}]"

    def orders(self) -> list[tuple[str, Any]]:
        """Return, by name, the expressions that must be nonnegative to keep the phases in order."""
        whole = LEAST_PHASE * (self.times[-1] - self.times[0])
        if not self.phases:
            return []
        return [
            (f"{self.label(k)} before {self.label(k + 1)}", after - before - whole)
            for k, (before, after) in enumerate(pairwise(self.times))
        ]


#: Declared time -> static variable that replaces it, for a model with one continuous set; or such a
#: mapping for each set, by the set's name.
FreeTimes = Mapping[Any, Any]


def free_times(
    sets: tuple[Any, ...], final_time: Any, times: FreeTimes | None
) -> dict[str, dict[float, Any]]:
    """Return the static variables that replace declared times, by continuous set.

    Raises
    ------
    TranscriptionError
        If a set or a time is not declared, or its replacement is not a static variable.
    """
    given: dict[str, dict[float, Any]] = {s.name: {} for s in sets}
    if final_time is not None:
        only = _only(sets, "final_time")
        given[only.name][float(only.last())] = final_time
    for key, named in (times or {}).items():
        if isinstance(named, Mapping):
            chosen = _called(sets, str(key))
            given[chosen.name] |= {_declared(chosen, at): v for at, v in named.items()}
        else:
            chosen = _only(sets, "times")
            given[chosen.name][_declared(chosen, key)] = named
    for time in sets:
        _refuse_unusable(time, sets, given[time.name])
    return given


def _only(sets: tuple[Any, ...], argument: str) -> Any:
    if not sets:
        raise TranscriptionError(
            f"{argument}: the model has no ContinuousSet whose times could be free; leave it out."
        )
    if len(sets) > 1:
        names = ", ".join(s.name for s in sets)
        raise TranscriptionError(
            f"{argument}: the model has several ContinuousSets, {names}; name the set as in "
            f'times={{"{sets[0].name}": {{{sets[0].last():g}: m.T}}}}.'
        )
    return sets[0]


def _called(sets: tuple[Any, ...], name: str) -> Any:
    for time in sets:
        if time.name == name:
            return time
    known = ", ".join(s.name for s in sets)
    raise TranscriptionError(
        f"times: {name} is not a ContinuousSet of the model, which has {known or 'none'}; give "
        "its full name."
    )


def _declared(time: Any, at: Any) -> float:
    found = [float(t) for t in time if t == at]
    if not found:
        known = ", ".join(f"{t:g}" for t in sorted(time))
        raise TranscriptionError(
            f"times: {at} is not a declared time of {time.name}, which are {known}; declare it "
            "with initialize=."
        )
    return found[0]


def _refuse_unusable(time: Any, sets: tuple[Any, ...], given: dict[float, Any]) -> None:
    """Refuse a replacement that is not a static variable, or that replaces two times."""
    taken: dict[str, float] = {}
    for at, variable in given.items():
        is_static = getattr(variable, "is_variable_type", bool)() and not variable.is_indexed()
        if not is_static or _is_over_any(variable.parent_component(), sets):
            raise TranscriptionError(
                f"{getattr(variable, 'name', variable)}: {time.name}[{at:g}], a free time, must be "
                "a static variable, a Var that is not over time."
            )
        if variable.name in taken:
            raise TranscriptionError(
                f"times: {variable.name} is given for {time.name}[{taken[variable.name]:g}] and "
                f"{time.name}[{at:g}], which leaves no time between them; give each its own Var."
            )
        taken[variable.name] = at


def _is_over_any(component: Any, sets: tuple[Any, ...]) -> bool:
    return component.is_indexed() and any(
        part is time for part in component.index_set().subsets() for time in sets
    )
