"""Clone of a user's model with an additional time, the template time, in each continuous set.

The members of variables and constraints at this time serve as templates for all times.
"""

from __future__ import annotations

from dataclasses import dataclass
from traceback import walk_tb
from typing import Any

from pyomo.core import (
    Block,
    Constraint,
    Expression,
    Model,
    Objective,
    Param,
    Piecewise,
    SOSConstraint,
    Suffix,
    Var,
)
from pyomo.core.base.component import ActiveComponent, Component
from pyomo.core.base.indexed_component import IndexedComponent
from pyomo.core.expr.visitor import identify_mutable_parameters, identify_variables
from pyomo.dae import ContinuousSet, DerivativeVar, Integral
from pyomo.dae.misc import expand_components
from pyomo.network import Port

from pyomo_quad.collocation.errors import TranscriptionError
from pyomo_quad.collocation.reading.clock import is_over
from pyomo_quad.collocation.reading.rules import (
    refusal,
    refuse_changed_members,
    refuse_lost_members,
    transfer_rules,
)

# Position of the template time in the declared horizon: an irrational fraction, so that no declared
# time coincides with it.
_TEMPLATE_FRACTION = 0.3819660112501051


@dataclass(frozen=True, kw_only=True)
class WorkingCopy:
    """Clone of the user's model with the template time added to each continuous set.

    A model with several horizons has a working copy for each, and one for the coupling: constraints
    and objective that do not belong to a single horizon.

    Attributes
    ----------
    model : ConcreteModel
        The clone.
    time : ContinuousSet or None
        None for a model without time, and for the coupling.
    template_time : float
    declared_times : tuple of float
        The user's times, in rising order.
    others : tuple of ContinuousSet
        Sets of the other horizons.
    """

    model: Any
    time: Any = None
    template_time: float = 0.0
    declared_times: tuple[float, ...] = ()
    others: tuple[Any, ...] = ()

    def other_of(self, component: Any) -> Any:
        """Return another horizon's continuous set that indexes a component, None if none does."""
        return next((time for time in self.others if is_over(component, time)), None)

    def takes(self, component: Any, data: Any) -> bool:
        """Return whether a constraint's member `data` belongs to this horizon or coupling.

        A constraint over time belongs to the horizon of its continuous set. Any other belongs to a
        horizon if all its time-dependent variables and parameters do. If it has none, or if they
        belong to several horizons, it belongs to the coupling.
        """
        # With at most one horizon, every constraint belongs to the only working copy.
        if not self.others:
            return True
        if self.time is not None and is_over(component, self.time):
            return True
        held = [
            *identify_variables(data.expr, include_fixed=True),
            *identify_mutable_parameters(data.expr),
        ]
        owners = {
            id(time)
            for variable in held
            for time in (*self.others, self.time)
            if time is not None and is_over(variable.parent_component(), time)
        }
        return len(owners) != 1 if self.time is None else owners == {id(self.time)}


def _refuse_other_than_models(model: Any) -> None:
    """Raise an error for an argument that is not a constructed Pyomo model."""
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

    If there are several, the result leaves out

    - a set that indexes no variable;
    - a set in a deactivated block, unless an active constraint or objective contains a variable
      that the set indexes.

    Raises
    ------
    TranscriptionError
        If the argument is no constructed model, or two sets index one variable.
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
    sets = tuple(s for s in sets if id(s) in active or _is_used(model, s))
    used: set[int] = set()
    for component in model.component_objects((Var, DerivativeVar), descend_into=True):
        over = [s for s in sets if is_over(component, s)]
        if len(over) > 1:
            names = ", ".join(s.name for s in over)
            raise TranscriptionError(
                f"continuous sets {names}: partial differential equations are not supported, as "
                f"{component.name} over both is; discretise all but one of them first, for "
                "instance with dae.finite_difference."
            )
        used.update(id(s) for s in over)
    return tuple(s for s in sets if id(s) in used)


def _is_used(model: Any, time: Any) -> bool:
    """Return whether an active constraint or objective contains a variable indexed by `time`."""
    return any(
        is_over(variable.parent_component(), time)
        for data in model.component_data_objects((Constraint, Objective), active=True)
        for variable in identify_variables(data.expr)
    )


# Types of active components that the engine interprets; a Port only names variables.
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
    "Objective": "declare one Objective with an Integral over time, or values at single times",
}


def _refuse_unknown(model: Any) -> None:
    """Raise an error for active components of types that the transcription cannot handle."""
    for block in model.block_data_objects(active=True, descend_into=True):
        for component in block.component_objects(active=True, descend_into=False):
            if isinstance(component, ActiveComponent) and component.ctype not in _UNDERSTOOD:
                kind = component.ctype.__name__
                instead = _INSTEAD.get(kind, "write it as a Constraint")
                raise TranscriptionError(
                    f"{component.name}: {kind} is not supported; {instead}, or deactivate it."
                )


# Component types for which Pyomo makes a member at an added time, at once or on access.
_EXPANDED = (Var, DerivativeVar, Param, Constraint, Expression, Integral, Suffix)


def _drop_unexpanded(copy: Any, time: Any) -> None:
    """Delete components over the set `time` that have no member at the template time."""
    # Pyomo cannot make members at an added time for some types of components, such as blocks.
    # The nonlinear program does not change: active blocks and objectives over time have been
    # refused before, and the other components contribute nothing.
    for component in list(copy.component_objects(descend_into=True)):
        is_unknown = isinstance(component, IndexedComponent) and component.ctype not in _EXPANDED
        if is_unknown and is_over(component, time):
            component.parent_block().del_component(component)


def _refuse_piecewise(model: Any, times: tuple[Any, ...]) -> None:
    """Raise an error for piecewise functions that use integer variables or are indexed by time.

    `times` are the continuous sets of the model.
    """
    # All other piecewise functions consist of linear constraints.
    for block in model.component_objects(Block, active=True, descend_into=True):
        if isinstance(block, Piecewise) and (
            any(is_over(block, time) for time in times)
            or any(block.component_data_objects(SOSConstraint))
            or any(not v.is_continuous() for v in block.component_data_objects(Var))
        ):
            raise TranscriptionError(
                f"{block.name}: Piecewise is not supported; give its points to a Table, which is "
                "a smooth function of states."
            )


def _refuse_unsupported(model: Any, times: tuple[Any, ...]) -> None:
    """Raise an error for declarations that cannot be transcribed to a nonlinear program.

    `times` are the continuous sets, which may not index active blocks or objectives.
    """
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
            if is_over(component, time):
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
    """Make the immutable parameters of `copy` that are indexed by the set `time` mutable."""
    # In a Pyomo expression, an immutable parameter appears as its number, but a mutable one as a
    # symbol. The symbol can be translated to a function of time.
    for parameter in copy.component_objects(Param, descend_into=True):
        if parameter.mutable or not is_over(parameter, time):
            continue
        held = dict(parameter.items())
        parameter._mutable = True  # noqa: SLF001
        parameter.clear()
        for index, number in held.items():
            parameter[index] = number


def copies_with_template_times(model: Any) -> tuple[WorkingCopy, ...]:
    """Clone a model, add a template time to each continuous set, and return the working copies.

    Each set has a working copy, and a model without time has a single one. All share one clone.

    Raises
    ------
    TranscriptionError
        If a declaration is unsupported, or a rule fails. It is also raised if a constraint or named
        expression over time differs from what its rule returns.
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


def _culprit(error: Exception, copies: list[WorkingCopy]) -> str:
    """Return the name of the component whose rule raised an error, from the traceback.

    If the traceback shows none, the result has the names of the continuous sets.
    """
    frames = [frame for frame, _ in walk_tb(error.__traceback__)]
    made = [frame.f_locals.get("self") for frame in frames]
    names = [held.name for held in made if isinstance(held, Component)]
    return names[-1] if names else ", ".join(horizon.time.name for horizon in copies)


def _expand(copy: Any, copies: list[WorkingCopy]) -> None:
    """Make the members of all components at the template times, by calling their rules.

    `copy` is the clone of the model, and `copies` has the template time of each continuous set. A
    `TranscriptionError` is raised if a rule fails at a template time.
    """
    try:
        expand_components(copy)
    except Exception as error:
        for horizon in copies:
            refuse_lost_members(copy, horizon.template_time)
        raise refusal(_culprit(error, copies), error) from error
    finally:
        for horizon in copies:
            horizon.time.set_changed(False)
    for horizon in copies:
        refuse_lost_members(copy, horizon.template_time)
