"""Reading a Pyomo.DAE model: its templates, conditions, integrals and objective."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import casadi
from pyomo.core.base.constraint import ConstraintData
from pyomo.dae import DerivativeVar, Integral as PyomoIntegral
from pyomo.environ import Constraint, Expression, Objective, Suffix, maximize

from pyomo_quad.collocation.addresses import AddressBook, indexed_name
from pyomo_quad.collocation.declarations import (
    Declarations,
    Integral,
    PathEquation,
    PointCondition,
    Slot,
)
from pyomo_quad.collocation.errors import TranscriptionError
from pyomo_quad.collocation.expressions import ExpressionWriter, same_expression, symbol_names
from pyomo_quad.collocation.symbols import SymbolTable
from pyomo_quad.collocation.time_symbol import TimeSymbol, integrand, time_parameter
from pyomo_quad.collocation.working_copy import WorkingCopy, copy_with_template_time

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
        self.addresses = AddressBook(copy.time)
        self.symbols = SymbolTable(copy, self.addresses, final_time)
        self._clock = time_parameter()
        self._template = TimeSymbol(copy.template_time, self._clock)
        self._writer = ExpressionWriter(self._leaf, self._named)
        self._integrals: dict[str, Integral] = {}
        self._in_path = False

    def read(self) -> Declarations:
        """Return the declarations of the model."""
        equations, conditions = self._constraints()
        objective = self._objective()
        cost = casadi.SX(self._writer.write(objective.expr, objective.name))
        self._require_dynamics(equations)
        fixed = self._values_at_points(conditions)
        self._read_expressions()
        table = self.symbols
        nominal = self._nominal_magnitudes()
        used = symbol_names(casadi.vertcat(cost, *[c.expression for c in conditions]))
        return Declarations(
            states=self._finished(table.states, nominal),
            algebraics=self._finished(self._used_algebraics(equations, cost), nominal),
            statics=self._finished(table.statics, nominal),
            signals=tuple(table.signals.values()),
            fraction=table.fraction,
            span=table.span,
            start=table.start,
            equations=tuple(equations),
            conditions=tuple(conditions),
            point_symbols=tuple(p for p in table.points.values() if p.symbol.name() in used),
            integrals=tuple(self._integrals.values()),
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
                        self.write_at_template(component, address.index)
        self._in_path = False

    def _used_algebraics(self, equations: list[PathEquation], cost: Any) -> dict[str, Slot]:
        """Return the algebraic variables that some equation or integrand holds."""
        parts = [part for e in equations for part in (e.expression, e.lower, e.upper)]
        parts += [i.integrand for i in self._integrals.values()]
        used = symbol_names(casadi.vertcat(cost, *parts))
        return {name: s for name, s in self.symbols.algebraics.items() if name in used}

    def write_at_template(self, component: Any, index: tuple[Any, ...]) -> Any:
        """Return a variable or expression over time, by name, in template symbols."""
        self._in_path = True
        position = self.addresses.join(component, index, self.copy.template_time)
        return casadi.SX(self._writer.write(component[position], component.name))

    def _leaf(self, data: Any) -> Any:
        if data is self._clock:
            return self.symbols.time
        symbol = self.symbols.leaf(data)
        address = self.addresses.of(data)
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
        if address.time != self.copy.template_time or not self._has_rule(component):
            return None
        return component._rule(  # noqa: SLF001
            component.parent_block(), self._template_index(component, address.index)
        )

    @staticmethod
    def _has_rule(component: Any) -> bool:
        return getattr(component, "_rule", None) is not None and not component._rule.constant()  # noqa: SLF001

    def _template_index(self, component: Any, index: tuple[Any, ...]) -> Any:
        return self.addresses.join(component, index, self._template)

    def _integral(self, component: Any, index: Any) -> Any:
        if self._in_path:
            raise TranscriptionError(
                f"{component.name}: an integral inside an equation over time is not supported; "
                "declare it as a state."
            )
        name = component.name if index is None else f"{component.name}[{index}]"
        if name not in self._integrals:
            expression = integrand(component, index, self._template)
            self._in_path = True
            symbol = casadi.SX.sym(name)
            density = casadi.SX(self._writer.write(expression, name)) * self.symbols.span
            self._in_path = False
            self._integrals[name] = Integral(name=name, symbol=symbol, integrand=density)
        return self._integrals[name].symbol

    def _constraints(self) -> tuple[list[PathEquation], list[PointCondition]]:
        equations: list[PathEquation] = []
        conditions: list[PointCondition] = []
        for component in self.copy.model.component_objects(
            Constraint, active=True, descend_into=True
        ):
            groups: dict[tuple[Any, ...], dict[Any, Any]] = {}
            for index, data in component.items():
                if data.active:
                    address = self.addresses.split(component, index)
                    groups.setdefault(address.index, {})[address.time] = data
            for index, instances in groups.items():
                self._group(component, index, instances, equations, conditions)
        return equations, conditions

    def _group(
        self,
        component: Any,
        index: tuple[Any, ...],
        instances: dict[Any, Any],
        equations: list[PathEquation],
        conditions: list[PointCondition],
    ) -> None:
        """Sort one constraint's instances into a path equation and point conditions."""
        template = instances.pop(self.copy.template_time, None) if self.copy.time else None
        if template is None:
            conditions.extend(self._condition(data) for data in instances.values())
            return
        equation = self._path(component, index, template)
        equations.append(equation)
        conditions.extend(self._start_and_end(equation, instances))

    def _path(self, component: Any, index: tuple[Any, ...], template: Any) -> PathEquation:
        data = template
        if self._has_rule(component):
            rule = component._rule  # noqa: SLF001
            data = ConstraintData(
                expr=rule(component.parent_block(), self._template_index(component, index))
            )
        self._in_path = True
        name = indexed_name(component.name, index)
        expression, lower, upper = self._relation(data, name)
        self._in_path = False
        return PathEquation(
            name=name,
            expression=expression,
            lower=lower,
            upper=upper,
            is_equality=bool(template.equality),
        )

    def _relation(self, data: Any, name: str) -> tuple[Any, Any, Any]:
        lower, body, upper = data.to_bounded_expression()
        write = self._writer.write
        expression = casadi.SX(write(body, name))
        if data.equality:
            return expression - write(upper, name), casadi.SX(0), casadi.SX(0)
        return (
            expression,
            casadi.SX(-casadi.inf if lower is None else write(lower, name)),
            casadi.SX(casadi.inf if upper is None else write(upper, name)),
        )

    def _condition(self, data: Any) -> PointCondition:
        expression, lower, upper = self._relation(data, data.name)
        return PointCondition(name=data.name, expression=expression, lower=lower, upper=upper)

    def _start_and_end(
        self, equation: PathEquation, instances: dict[Any, Any]
    ) -> list[PointCondition]:
        """Return what the end instances of a path equation add to it.

        The collocation points include the end but not the start.  At the start an equation
        among states only is imposed as a condition; one with rates or algebraic variables
        has no meaning there.  An end instance that reads otherwise is a condition of its own.
        """
        added = []
        first, last = self.copy.declared_times[0], self.copy.declared_times[-1]
        if first in instances and self._states_only(equation):
            added.append(self._condition(instances[first]))
        if last in instances:
            condition = self._condition(instances[last])
            if not self._same_at(condition.expression, equation.expression, last):
                added.append(condition)
        return added

    def _states_only(self, equation: PathEquation) -> bool:
        names = symbol_names(equation.expression)
        table = self.symbols
        rates = {s.rate.name() for s in table.states.values()}
        return bool(names & set(table.states)) and not names & (rates | set(table.algebraics))

    def _same_at(self, condition: Any, equation: Any, time: float) -> bool:
        """Say whether a condition is the path equation with its time put in."""
        table = self.symbols
        fraction = table.fraction_of(time)
        old, new = [table.fraction], [casadi.SX(fraction)]
        for (name, at, is_rate), point in table.points.items():
            if at == fraction:
                slot = table.states.get(name) or table.algebraics[name]
                old.append(slot.rate if is_rate else slot.symbol)
                new.append(point.symbol)
        moved = casadi.substitute([casadi.SX(equation)], old, new)[0]
        return same_expression(moved, condition)

    def _values_at_points(self, conditions: list[PointCondition]) -> list[tuple[str, float]]:
        """Return what is fixed at declared times; add bounds that hold only there."""
        fixed = []
        table = self.symbols
        for slot in (*table.states.values(), *table.algebraics.values()):
            variable = self.copy.model.find_component(slot.component)
            for time in self.copy.declared_times:
                data = variable[self.addresses.join(variable, slot.index, time)]
                if data.fixed and slot.rate is not None:
                    fixed.append((slot.name, table.fraction_of(time)))
                elif data.fixed:
                    conditions.append(self._held(data))
                elif data.bounds != self._template_bounds(variable, slot):
                    conditions.append(
                        PointCondition(
                            name=data.name,
                            expression=casadi.SX(self._writer.write(data, data.name)),
                            lower=self._bound(data.lower, -casadi.inf, data.name),
                            upper=self._bound(data.upper, casadi.inf, data.name),
                        )
                    )
        return fixed

    def _held(self, data: Any) -> PointCondition:
        """Return the condition that an algebraic variable keeps its fixed value at a time."""
        number = self.symbols.fixed_value(data)
        expression = casadi.SX(self._writer.write(data, data.name)) - number
        return PointCondition(
            name=data.name, expression=expression, lower=casadi.SX(0), upper=casadi.SX(0)
        )

    def _template_bounds(self, variable: Any, slot: Slot) -> tuple[Any, Any]:
        data = variable[self.addresses.join(variable, slot.index, self.copy.template_time)]
        return tuple(data.bounds)

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

    def _finished(self, table: dict[str, Slot], nominal: dict[str, float]) -> tuple[Slot, ...]:
        """Write the bounds of slots as CasADi expressions and give them their magnitudes."""
        return tuple(
            replace(
                slot,
                lower=self._bound(slot.lower, -casadi.inf, slot.name),
                upper=self._bound(slot.upper, casadi.inf, slot.name),
                nominal=nominal.get(slot.name, nominal.get(slot.component)),
            )
            for slot in table.values()
        )

    def _bound(self, bound: Any, otherwise: float, name: str) -> Any:
        return casadi.SX(otherwise if bound is None else self._writer.write(bound, name))
