"""Reading of a model's objective; an objective that sums a control over time is refused.

A control's value at a single time has no effect on the trajectory, so the user probably means an
integral.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import casadi
from pyomo.core import Objective
from pyomo.dae import DerivativeVar, Integral

from pyomo_quad.collocation.errors import TranscriptionError
from pyomo_quad.collocation.reading.symbols import AddressBook, indexed_name
from pyomo_quad.collocation.reading.writer import ExpressionWriter, same_expression, symbol_names

if TYPE_CHECKING:
    from pyomo_quad.collocation.reading.copy import WorkingCopy


def objective_of(copy: WorkingCopy) -> Any:
    """Return the active objective of a model, None if the model has no active objective.

    Raises
    ------
    TranscriptionError
        If the model has several active objectives, or its objective sums a control over the
        declared times (the members of the continuous set).
    """
    objectives = list(copy.model.component_data_objects(Objective, active=True, descend_into=True))
    if len(objectives) > 1:
        names = ", ".join(o.name for o in objectives)
        raise TranscriptionError(
            f"objective: {len(objectives)} active ({names}); at most one is allowed; "
            "deactivate the others."
        )
    if not objectives:
        return None
    for time in (copy.time, *copy.others):
        if time is not None:
            _refuse_sum(objectives[0], time, copy)
    return objectives[0]


def _refuse_sum(objective: Any, time: Any, copy: WorkingCopy) -> None:
    """Raise an error for an objective that sums a function of a control over the declared times."""
    addresses = AddressBook(time)
    states = {d.get_state_var().name for d in copy.model.component_objects(DerivativeVar)}
    symbols: dict[str, Any] = {}
    at_instants: dict[float, dict[tuple[str, Any], Any]] = {}

    def leaf(data: Any) -> Any:
        if data.name not in symbols:
            symbols[data.name] = casadi.SX.sym(data.name)
            address = addresses.of(data)
            if address.time is not None and data.is_variable_type():
                key = address.component, address.index
                at_instants.setdefault(address.time, {})[key] = symbols[data.name]
        return symbols[data.name]

    def named(expression: Any) -> Any:
        is_integral = expression.parent_component().ctype is Integral
        return casadi.SX.sym(expression.name) if is_integral else None

    cost = casadi.SX(ExpressionWriter(leaf, named).write(objective.expr, objective.name))
    # The set also holds the template time, at which no objective was declared.
    if not len(at_instants) == len(time) - 1 > 1:
        return
    first, *others = at_instants.values()
    for key in first:
        # A sum over a state is accepted: it may be a fit to data, or a cost at start and end of the
        # horizon.
        is_control = key[0] not in states
        if is_control and all(_is_alike(cost, key, first, other) for other in others):
            raise TranscriptionError(
                f"{objective.name}: sums {indexed_name(*key)} over the {len(at_instants)} declared "
                f"instants of {time.name} only, which are not the points of the solution; declare "
                f"an Integral over {time.name}, and use it in the objective."
            )


def _is_alike(cost: Any, key: Any, first: dict[Any, Any], other: dict[Any, Any]) -> bool:
    """Return whether the objective's derivatives with respect to a variable agree at two times.

    `first` and `other` have the symbols of all variables at these times.
    """
    if key not in other:
        return False
    slope, moved = casadi.gradient(cost, first[key]), casadi.gradient(cost, other[key])
    shared = [known for known in other if known in first]
    (moved,) = casadi.substitute(
        [moved], [other[known] for known in shared], [first[known] for known in shared]
    )
    return symbol_names(moved) == symbol_names(slope) and same_expression(moved, slope)
