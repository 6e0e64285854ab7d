"""The copy of a user's model that the engine reads its templates from."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from pyomo.dae import ContinuousSet, DerivativeVar
from pyomo.dae.misc import expand_components
from pyomo.environ import Block, Param, SOSConstraint, Var

from pyomo_quad.collocation.errors import TranscriptionError
from pyomo_quad.collocation.rules import (
    refuse_changed_members,
    refuse_lost_members,
    transfer_rules,
)

__all__ = ["WorkingCopy", "copy_with_template_time"]

# An irrational fraction: no declared time can be mistaken for it.
_TEMPLATE_FRACTION = 0.3819660112501051


@dataclass(frozen=True, kw_only=True)
class WorkingCopy:
    """A clone of the model with one more time, whose instances serve as templates."""

    model: Any
    time: Any
    template_time: float
    declared_times: tuple[float, ...]


def _continuous_set(model: Any) -> Any:
    """Return the model's one continuous set, or None for a model without time."""
    sets = [
        s
        for s in model.component_objects(ContinuousSet, descend_into=True)
        if "scheme" not in s.get_discretization_info()
    ]
    if len(sets) > 1:
        names = ", ".join(s.name for s in sets)
        raise TranscriptionError(
            f"continuous sets {names}: partial differential equations are not supported; "
            "discretise all but one of them first, for instance with dae.finite_difference."
        )
    return sets[0] if sets else None


def _refuse_unsupported(model: Any, time: Any) -> None:
    for constraint in model.component_objects(SOSConstraint, active=True, descend_into=True):
        raise TranscriptionError(f"{constraint.name}: SOS constraints are not supported.")
    for variable in model.component_data_objects(Var, descend_into=True):
        if not variable.is_continuous():
            raise TranscriptionError(
                f"{variable.name}: domain {variable.domain} is not continuous; integer variables "
                "are not supported."
            )
    for block in model.component_objects(Block, active=True, descend_into=True):
        if time is not None and block.is_indexed() and time in block.index_set().subsets():
            raise TranscriptionError(
                f"{block.name}: a block indexed by {time.name} is not supported; index the "
                "variables and constraints inside one block by time."
            )
    for derivative in model.component_objects(DerivativeVar, descend_into=True):
        sets = derivative.get_continuousset_list()
        if time is not None and len(sets) > 1:
            raise TranscriptionError(
                f"{derivative.name}: a derivative of order {len(sets)} is not supported; declare "
                "the first derivative as a variable of its own."
            )


def _keep_parameters(copy: Any, time: Any) -> None:
    """Let parameters over time enter expressions as themselves, immutable ones too."""
    for parameter in copy.component_objects(Param, descend_into=True):
        if time not in parameter.index_set().subsets() or parameter.mutable:
            continue
        held = dict(parameter.items())
        parameter._mutable = True  # noqa: SLF001
        parameter.clear()
        for index, number in held.items():
            parameter[index] = number


def copy_with_template_time(model: Any) -> WorkingCopy:
    """Clone a model and add one interior time to its continuous set.

    Raises
    ------
    TranscriptionError
        If the model declares something outside what the engine transcribes.
    """
    copy = model.clone()
    transfer_rules(model, copy)
    time = _continuous_set(copy)
    _refuse_unsupported(copy, time)
    if time is None:
        return WorkingCopy(model=copy, time=None, template_time=0.0, declared_times=())
    refuse_changed_members(copy)
    _keep_parameters(copy, time)
    declared = tuple(float(t) for t in sorted(time))
    template = declared[0] + _TEMPLATE_FRACTION * (declared[-1] - declared[0])
    time.add(template)
    time.set_changed(True)
    try:
        expand_components(copy)
    except Exception as error:
        refuse_lost_members(copy, template)
        raise TranscriptionError(
            f"{time.name}: a rule over it fails at a time that the model did not declare "
            f"({error}); let rules read nothing but their time and components of the model."
        ) from error
    finally:
        time.set_changed(False)
    refuse_lost_members(copy, template)
    return WorkingCopy(model=copy, time=time, template_time=template, declared_times=declared)
