"""Reading a Pyomo.DAE model: its templates, conditions, integrals and objective."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import casadi
from pyomo.dae import DerivativeVar
from pyomo.environ import Expression, Objective, Suffix, maximize

from pyomo_quad.collocation.addresses import indexed_name
from pyomo_quad.collocation.declarations import (
    Declarations,
    PathEquation,
    Slot,
)
from pyomo_quad.collocation.errors import TranscriptionError
from pyomo_quad.collocation.expressions import symbol_names
from pyomo_quad.collocation.relations import RelationReader
from pyomo_quad.collocation.template_writer import TemplateWriter
from pyomo_quad.collocation.working_copy import WorkingCopy, copy_with_template_time

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["ModelReader", "read_declarations"]


def read_declarations(model: Any, final_time: Any = None) -> tuple[Declarations, ModelReader]:
    """Read what a Pyomo model declares.

    Parameters
    ----------
    model : ConcreteModel
        With one ContinuousSet that is not discretised, or with none at all.
    final_time : Var, optional
        A static variable of the model that is to be the end of the horizon.

    Returns
    -------
    Declarations, ModelReader
        The declarations, and the reader, which can write further expressions of the model in
        the same symbols.

    Raises
    ------
    TranscriptionError
        If the model declares something unsupported or incomplete; the message names it.
    """
    reader = ModelReader(copy_with_template_time(model), final_time)
    return reader.read(), reader


class ModelReader:
    """Reads one working copy; one call to `read`."""

    def __init__(self, copy: WorkingCopy, final_time: Any) -> None:
        self.copy = copy
        self.writer = TemplateWriter(copy, final_time)
        self.addresses = self.writer.addresses
        self.symbols = self.writer.symbols

    def read(self) -> Declarations:
        """Return the declarations of the model."""
        relations = RelationReader(self.writer)
        equations, conditions = relations.constraints()
        objective = self._objective()
        cost = casadi.SX(self.writer.write(objective.expr, objective.name))
        self._require_dynamics(equations)
        fixed = relations.values_at_points(conditions)
        self._read_expressions()
        table = self.symbols
        nominal = self._nominal_magnitudes()
        used = symbol_names(casadi.vertcat(cost, *[c.expression for c in conditions]))
        return Declarations(
            states=self._finished(table.states, nominal, self.writer.bounds_over_time),
            algebraics=self._finished(
                self._used_algebraics(equations, cost), nominal, self.writer.bounds_over_time
            ),
            statics=self._finished(table.statics, nominal, self._bounds),
            signals=tuple(table.signals.values()),
            scheduled=tuple(slot for s in self.writer.schedules for slot in s.slots),
            fraction=table.fraction,
            span=table.span,
            start=table.start,
            equations=tuple(equations),
            conditions=tuple(conditions),
            point_symbols=tuple(p for p in table.points.values() if p.symbol.name() in used),
            integrals=tuple(self.writer.integrals.values()),
            objective=cost,
            fixed=tuple(fixed),
            maximise=objective.sense == maximize,
            objective_name=objective.name,
            has_horizon=self.copy.time is not None,
            # Last, because bounds may have brought in further parameters.
            parameters=tuple(table.parameters.values()),
        )

    def _read_expressions(self) -> None:
        """Meet the parameters of every expression over time, so that all can be evaluated."""
        for component in self.copy.model.component_objects(
            Expression, active=True, descend_into=True
        ):
            if self.addresses.time_position(component) is not None:
                for index in component:
                    address = self.addresses.split(component, index)
                    if address.time == self.copy.template_time:
                        self.writer.write_at_template(component, address.index)

    def _used_algebraics(self, equations: list[PathEquation], cost: Any) -> dict[str, Slot]:
        """Return the algebraic variables that some equation or integrand holds."""
        parts = [part for e in equations for part in (e.expression, e.lower, e.upper)]
        parts += [i.integrand for i in self.writer.integrals.values()]
        used = symbol_names(casadi.vertcat(cost, *parts))
        return {name: s for name, s in self.symbols.algebraics.items() if name in used}

    def _objective(self) -> Any:
        objectives = list(
            self.copy.model.component_data_objects(Objective, active=True, descend_into=True)
        )
        if len(objectives) != 1:
            names = ", ".join(o.name for o in objectives) or "none"
            raise TranscriptionError(
                f"objective: {len(objectives)} active ({names}); exactly one is needed; declare "
                "or activate one Objective."
            )
        return objectives[0]

    def _require_dynamics(self, equations: list[PathEquation]) -> None:
        used: set[str] = set()
        for equation in equations:
            if equation.is_equality:
                used |= symbol_names(equation.expression)
        for state in self.symbols.states.values():
            if state.rate.name() not in used:
                raise TranscriptionError(
                    f"{self._derivative_name(state)}: no equation over time holds this "
                    "derivative; declare its dynamics as an equality constraint."
                )

    def _derivative_name(self, state: Slot) -> str:
        for derivative in self.copy.model.component_objects(DerivativeVar, descend_into=True):
            if derivative.get_state_var().name == state.component:
                return indexed_name(derivative.name, state.index)
        return f"derivative of {state.name}"

    def _nominal_magnitudes(self) -> dict[str, float]:
        """Return nominal magnitudes from Suffix `scaling_factor`, by component or slot name."""
        nominal: dict[str, float] = {}
        for suffix in self.copy.model.component_objects(Suffix, descend_into=True):
            if suffix.local_name == "scaling_factor":
                for item, factor in suffix.items():
                    if item is not None and factor:
                        nominal[item.name] = 1.0 / float(factor)
        return nominal

    def _bounds(self, slot: Slot) -> tuple[Any, Any]:
        """Return the bounds of a static variable."""
        return (
            self.writer.bound(slot.lower, -casadi.inf, slot.name),
            self.writer.bound(slot.upper, casadi.inf, slot.name),
        )

    @staticmethod
    def _finished(
        table: dict[str, Slot],
        nominal: dict[str, float],
        bounds: Callable[[Slot], tuple[Any, Any]],
    ) -> tuple[Slot, ...]:
        """Write the bounds of slots as CasADi expressions and give them their magnitudes."""
        finished = []
        for slot in table.values():
            lower, upper = bounds(slot)
            magnitude = nominal.get(slot.name, nominal.get(slot.component))
            finished.append(replace(slot, lower=lower, upper=upper, nominal=magnitude))
        return tuple(finished)
