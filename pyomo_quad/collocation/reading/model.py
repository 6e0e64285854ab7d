"""Reading of a Pyomo.DAE model: equations over time, conditions, integrals and objective.

A condition is a constraint at declared times (members of the continuous set) or without time. An
argument `instances` maps times to members of one constraint whose indices differ only in the time.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import casadi
from pyomo.core import Constraint, Expression, maximize, value
from pyomo.core.expr.numvalue import native_types
from pyomo.core.expr.visitor import identify_variables
from pyomo.dae import DerivativeVar
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import maximum_bipartite_matching

from pyomo_quad.collocation.errors import TranscriptionError
from pyomo_quad.collocation.reading.clock import FreeTimes, free_times
from pyomo_quad.collocation.reading.copy import continuous_sets, copies_with_template_times
from pyomo_quad.collocation.reading.model_source import declared_magnitudes
from pyomo_quad.collocation.reading.objectives import objective_of
from pyomo_quad.collocation.reading.rules import rule_of
from pyomo_quad.collocation.reading.symbols import (
    Declarations,
    PathEquation,
    PointCondition,
    PointSymbol,
    Slot,
    indexed_name,
)
from pyomo_quad.collocation.reading.writer import (
    TemplateWriter,
    is_unbounded,
    same_expression,
    symbol_names,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator


# Residual, relative to 1 + |body|, that rounding may leave in a constraint on fixed variables.
_MET = 1e-9


class RelationReader:
    """Reader of the constraints of a model, and of the values to which variables are fixed.

    Parameters
    ----------
    writer : TemplateWriter
        Translator of Pyomo expressions to CasADi expressions.
    """

    def __init__(self, writer: TemplateWriter) -> None:
        self._writer = writer
        self.copy = writer.copy
        self.addresses = writer.addresses
        self.symbols = writer.symbols

    def constraints(self) -> tuple[list[PathEquation], list[PointCondition]]:
        """Return the equations over time, and the conditions (constraints not imposed over time).

        Bounds of time derivatives are appended to the equations, as inequalities. If the model has
        several horizons (continuous sets), only constraints of the attribute `copy` are read
        (`WorkingCopy.takes`).

        Raises
        ------
        TranscriptionError
            If a constraint is not supported.
        """
        equations: list[PathEquation] = []
        conditions: list[PointCondition] = []
        for component in self.copy.model.component_objects(
            Constraint, active=True, descend_into=True
        ):
            if self.copy.other_of(component) is not None:
                continue
            groups: dict[tuple[Any, ...], dict[Any, Any]] = {}
            if rule_of(component) is not None:
                # A rule may skip its constraint at all declared times and impose it between them
                # only.
                for index in component.index_set():
                    groups.setdefault(self.addresses.split(component, index).index, {})
            for index, data in component.items():
                if self.copy.takes(component, data):
                    address = self.addresses.split(component, index)
                    groups.setdefault(address.index, {})[address.time] = data
            for index, instances in groups.items():
                active = {t: data for t, data in instances.items() if data.active}
                # The template is built anew and therefore active; drop it if the user deactivated
                # all others.
                declared = instances.keys() - {self.copy.template_time}
                if declared.isdisjoint(active) and declared:
                    continue
                self._group(component, index, active, equations, conditions)
            self._refuse_listed(component)
        return [*equations, *self._rate_limits()], conditions

    def _group(
        self,
        component: Any,
        index: tuple[Any, ...],
        instances: dict[Any, Any],
        equations: list[PathEquation],
        conditions: list[PointCondition],
    ) -> None:
        """Read the members of a constraint that differ in time only, and append them to the lists.

        `index` is their index without time, and `instances` maps each time to its member. Members
        that an equation over time does not cover become conditions.
        """
        template = instances.pop(self.copy.template_time, None) if self.copy.time else None
        equation = None
        if self.addresses.time_position(component) is not None:
            equation = self._writer.path_equation(component, index, template)
        if equation is None:
            if self.copy.time and instances.keys() == set(self.copy.declared_times):
                self._refuse_alike(component, list(instances.values()))
            conditions.extend(self._imposed(self._condition(data)) for data in instances.values())
            return
        equations.append(equation)
        conditions.extend(self._start_and_end(equation, instances))
        conditions.extend(self._between(equation, template, instances))

    def _refuse_alike(self, component: Any, instances: list[Any]) -> None:
        """Raise an error for a constraint without a rule if its members differ in time only.

        The constraint is probably meant for all times.
        """
        # Without a rule, the constraint can only be imposed at the declared times.
        if all(self._is_alike(instances[0], other) for other in instances[1:]):
            raise TranscriptionError(
                f"{component.name}: is the same at every declared time, but has no rule for the "
                "times between; give it one, or index it by a Set of the intended times."
            )

    def _refuse_listed(self, component: Any) -> None:
        """Raise an error for a ConstraintList that repeats one constraint at each declared time.

        The user probably means all times, but a list has no rule for the times between. Lists with
        states or variables without time are accepted as conditions at single times.
        """
        members = [data for data in component.values() if data.active]
        if self.copy.time is None or len(members) != len(self.copy.declared_times):
            return
        times = set()
        for data in members:
            held = [self.addresses.of(v) for v in identify_variables(data.body)]
            if any(a.time is None or a.component in self.symbols.derivatives for a in held):
                return
            times |= {a.time for a in held}
        if times == set(self.copy.declared_times):
            self._refuse_alike(component, members)

    def _relation(self, data: Any, name: str) -> tuple[Any, Any, Any]:
        """Return a constraint's member as CasADi expressions: body, lower and upper bound.

        For an equality, the body is the difference of both sides, and the bounds are zero.
        """
        lower, body, upper = data.to_bounded_expression()
        expression = casadi.SX(self._writer.write(body, name))
        if data.equality:
            return expression - self._writer.write(upper, name), casadi.SX(0), casadi.SX(0)
        return (
            expression,
            casadi.SX(-casadi.inf if lower is None else self._writer.write(lower, name)),
            casadi.SX(casadi.inf if upper is None else self._writer.write(upper, name)),
        )

    def _condition(self, data: Any) -> PointCondition:
        """Return a constraint's member at a single time as a `PointCondition`."""
        expression, lower, upper = self._relation(self._writer.at_instant(data), data.name)
        return PointCondition(name=data.name, expression=expression, lower=lower, upper=upper)

    def _imposed(self, condition: PointCondition) -> PointCondition:
        """Return a condition unchanged, if it contains no time-dependent parameter.

        Such a parameter is not supported at single times, and raises a `TranscriptionError`.
        """
        signals = {symbol.name() for symbol in self.symbols.signal_points.values()}
        read = signals & symbol_names(condition.expression)
        if read:
            raise TranscriptionError(
                f"{condition.name}: {min(read)}, a time-varying parameter at a single time, is not "
                "supported in a condition; use a parameter without time."
            )
        return condition

    def _start_and_end(
        self, equation: PathEquation, instances: dict[Any, Any]
    ) -> list[PointCondition]:
        """Return a constraint's members at start and end that `equation` does not impose.

        At the end, a member that differs from `equation` is returned. At the start, a member with
        states, but no rates or algebraic variables, is returned unless fixed values satisfy it.
        """
        added = []
        first, last = self.copy.declared_times[0], self.copy.declared_times[-1]
        # The collocation points include the end of the horizon but not its start. An equation with
        # rates or algebraic variables is not imposed at the start.
        # If all variables of the member at the start are fixed and satisfy it, it is not imposed.
        is_met = first in instances and _is_met_as_fixed(instances[first])
        if first in instances and self._states_only(equation) and not is_met:
            added.append(self._imposed(self._condition(instances[first])))
        if last in instances:
            condition = self._condition(instances[last])
            if not self._same_at(condition, equation, last):
                added.append(self._imposed(condition))
        return added

    def _between(
        self, equation: PathEquation, template: Any, instances: dict[Any, Any]
    ) -> list[PointCondition]:
        """Return a constraint's members at interior declared times that differ from its equation.

        `template` is the constraint's member at the template time, None if it has no such member.
        """
        added = []
        for time in self.copy.declared_times[1:-1]:
            data = instances.get(time)
            if data is None or (template is not None and self._is_alike(template, data)):
                continue
            condition = self._condition(data)
            if not any(self._same_at(condition, equation, time, side) for side in (-1, 1)):
                added.append(self._imposed(condition))
        return added

    def _is_alike(self, first: Any, second: Any) -> bool:
        """Return whether two members of a constraint are identical except for their times."""
        pairs = [(first.expr, second.expr)]
        while pairs:
            a, b = pairs.pop()
            are_numbers = [member.__class__ in native_types for member in (a, b)]
            if any(are_numbers):
                if not all(are_numbers) or a != b:
                    return False
            elif a.is_expression_type() and not a.is_named_expression_type():
                if type(a) is not type(b) or a.nargs() != b.nargs():
                    return False
                pairs.extend(zip(a.args, b.args, strict=True))
            elif not self._is_member_alike(a, b):
                return False
        return True

    def _is_member_alike(self, a: Any, b: Any) -> bool:
        """Return whether two variables or parameters are identical except for their times.

        The result is True if both belong to one Pyomo component, and their indices differ at most
        in the time.
        """
        if a is b:
            return True
        owners = [getattr(member, "parent_component", lambda: None)() for member in (a, b)]
        if owners[0] is None or owners[0] is not owners[1]:
            return False
        return self.addresses.of(a).index == self.addresses.of(b).index

    def _states_only(self, equation: PathEquation) -> bool:
        """Return whether an equation over time has states, but no rates or algebraic variables."""
        names = symbol_names(equation.expression)
        table = self.symbols
        rates = {s.rate.name() for s in table.states.values()}
        return bool(names & set(table.states)) and not names & (rates | set(table.algebraics))

    def _same_at(
        self, condition: PointCondition, equation: PathEquation, time: float, side: int = -1
    ) -> bool:
        """Return whether a condition equals an equation over time, evaluated at a declared time.

        Rules that branch on time are evaluated just before (`side` = -1) or just after (1) this
        time.
        """
        # A condition that equals its equation need not be imposed separately.
        table = self.symbols
        clock = table.clock
        fraction = clock.fraction_of(time)
        old, new = [clock.fraction], [casadi.SX(fraction)]
        for (name, at, is_rate), point in table.points.items():
            if at == fraction:
                slot = table.states.get(name) or table.algebraics[name]
                old.append(slot.rate if is_rate else slot.symbol)
                new.append(point.symbol)
        for name, slot in table.signals.items():
            parameter = self.copy.model.find_component(slot.component)
            number = value(parameter[self.addresses.join(parameter, slot.index, time)])
            old.append(slot.symbol)
            new.append(table.signal_points.get((name, fraction), casadi.SX(number)))
        # Pyomo has folded the declared times into the condition, so compare at these numbers.
        old.extend(clock.times)
        new.extend(casadi.SX(t) for t in clock.declared)
        numbers = self._writer.scheduled_beside(time, side)
        sides = [(e.expression, e.lower, e.upper) for e in (equation, condition)]
        moved = casadi.substitute(
            [casadi.SX(part) for side in sides for part in side],
            [*old, *(symbol for symbol, _ in numbers.values())],
            [*new, *(number for _, number in numbers.values())],
        )
        # A rule that branches on time may return one number exactly at the declared time, and
        # another one just beside it.
        is_scheduled = self._writer.is_scheduled(equation.name)
        if is_scheduled and symbol_names(moved[0]) == symbol_names(moved[3]):
            return True
        return all(same_expression(moved[k], moved[k + 3]) for k in range(3))

    def values_at_points(self, conditions: list[PointCondition]) -> list[tuple[str, float]]:
        """Return which states are fixed at which times, and append other restrictions.

        The result has (state name, fraction of the horizon). Fixed values of other variables, and
        bounds assigned at single declared times, are appended to `conditions`. If a variable is
        fixed without a value, a TranscriptionError is raised.
        """
        # The values of fixed states are read at each solve.
        fixed = []
        table = self.symbols
        for slot in (*table.states.values(), *table.algebraics.values(), *self._rates()):
            variable = self.copy.model.find_component(slot.component)
            is_changed = self._writer.changed_bounds(slot) is not None
            for time in self.copy.declared_times:
                data = variable[self.addresses.join(variable, slot.index, time)]
                if data.fixed and data.value is None:
                    raise TranscriptionError(f"{data.name}: is fixed without a value; give it one.")
                if data.fixed and slot.rate is not None:
                    fixed.append((slot.name, table.clock.fraction_of(time)))
                elif data.fixed:
                    conditions.append(self._fixing_condition(data))
                elif not is_changed and data.bounds != self._writer.declared_bounds(data):
                    conditions.append(
                        PointCondition(
                            name=data.name,
                            expression=casadi.SX(self._writer.write(data, data.name)),
                            lower=self._writer.bound(data.lower, -casadi.inf, data.name),
                            upper=self._writer.bound(data.upper, casadi.inf, data.name),
                        )
                    )
        return fixed

    def _rates(self) -> Iterator[Slot]:
        """Yield the derivatives with respect to time, with their bounds, as `Slot` objects."""
        for derivative in self.copy.model.component_objects(DerivativeVar, descend_into=True):
            for position, data in derivative.items():
                address = self.addresses.split(derivative, position)
                if self.copy.time and address.time == self.copy.template_time:
                    yield Slot(
                        name=address.name,
                        component=derivative.name,
                        index=address.index,
                        symbol=None,
                        lower=data.lower,
                        upper=data.upper,
                    )

    def _rate_limits(self) -> Iterator[PathEquation]:
        """Yield the bounds of derivatives with respect to time as inequalities over time."""
        for slot in self._rates():
            lower, upper = self._writer.bounds_over_time(slot)
            if not is_unbounded(lower, upper):
                derivative = self.copy.model.find_component(slot.component)
                yield PathEquation(
                    name=slot.name,
                    expression=self._writer.write_at_template(derivative, slot.index),
                    lower=lower,
                    upper=upper,
                    is_equality=False,
                )

    def _fixing_condition(self, data: Any) -> PointCondition:
        """Return the constraint that a variable equals its fixed value at one time.

        `data` is the variable's member at that time. Its fixed value is a parameter in the
        constraint.
        """
        number = self.symbols.fixed_value(data)
        expression = casadi.SX(self._writer.write(data, data.name)) - number
        return PointCondition(
            name=data.name, expression=expression, lower=casadi.SX(0), upper=casadi.SX(0)
        )


def _is_met_as_fixed(data: Any) -> bool:
    """Return whether all variables in a constraint are fixed and the constraint is satisfied."""
    if not all(v.fixed and v.value is not None for v in identify_variables(data.body)):
        return False
    return bool(data.slack() >= -_MET * (1.0 + abs(value(data.body))))


def read_declarations(
    model: Any, final_time: Any = None, times: FreeTimes | None = None
) -> tuple[Declarations, ModelReader]:
    """Translate a Pyomo model to CasADi symbols; return its declarations and their reader.

    `model` has at most one horizon (continuous set that is not discretised). The docstring of
    `free_times` explains `final_time` and `times`. The reader can write further expressions in the
    same symbols.

    Raises
    ------
    TranscriptionError
        If the model declares something unsupported or incomplete.
    """
    sets = continuous_sets(model)
    free = free_times(sets, final_time, times)
    (copy,) = copies_with_template_times(model)
    reader = ModelReader(TemplateWriter(copy, free[copy.time.name] if sets else {}))
    objective = objective_of(copy)
    cost = casadi.SX(0)
    if objective is not None:
        cost = casadi.SX(reader.writer.write(objective.expr, objective.name))
    reader.require_all()
    return reader.declarations(cost, objective), reader


class ModelReader:
    """Reader of a model's declarations in CasADi symbols.

    The constructor reads the constraints. The method `declarations` returns them together with the
    variables and parameters in them.

    Parameters
    ----------
    writer : TemplateWriter
        Translator of Pyomo expressions to CasADi expressions.

    Attributes
    ----------
    equations : list of PathEquation
        Constraints over time.
    conditions : list of PointCondition
        Constraints at declared times (members of the continuous set) or without time.
    """

    def __init__(self, writer: TemplateWriter) -> None:
        self.copy = writer.copy
        self.writer = writer
        self.addresses = writer.addresses
        self.symbols = writer.symbols
        self._relations = RelationReader(writer)
        self.equations, self.conditions = self._relations.constraints()

    def require_all(self) -> None:
        """Raise an error for a model without a variable to solve for, or a state without dynamics.

        Dynamics are an equality over time that contains the state's derivative.
        """
        self._require_dynamics(self.equations)
        self._require_variables()

    def declarations(self, cost: Any, objective: Any) -> Declarations:
        """Return the model in CasADi symbols, with `cost` as the objective to optimise.

        `cost` is a CasADi expression, 0 without an objective. `objective` is the Pyomo objective,
        which gives sense and name, or None. Call the method once: it appends to `conditions` the
        fixed values, bounds at single times, and positive durations of phases.
        """
        conditions = self.conditions
        fixed = self._relations.values_at_points(conditions)
        conditions.extend(
            PointCondition(
                name=name, expression=order, lower=casadi.SX(0), upper=casadi.SX(casadi.inf)
            )
            for name, order in self.symbols.clock.orders()
        )
        self._read_expressions()
        table = self.symbols
        nominal = declared_magnitudes(self.copy.model)
        used = symbol_names(casadi.vertcat(cost, *[c.expression for c in conditions]))
        points = tuple(p for p in table.points.values() if p.symbol.name() in used)
        return Declarations(
            states=self._finished(table.states, nominal, self.writer.bounds_over_time),
            algebraics=self._finished(
                self._used_algebraics(points), nominal, self.writer.bounds_over_time
            ),
            statics=self._finished(table.statics, nominal, self._bounds),
            signals=tuple(table.signals.values()),
            scheduled=tuple(slot for s in self.writer.schedules for slot in s.slots),
            clock=table.clock,
            equations=tuple(self.equations),
            conditions=tuple(conditions),
            point_symbols=points,
            integrals=tuple(self.writer.integrals.values()),
            objective=cost,
            fixed=tuple(fixed),
            maximise=objective is not None and objective.sense == maximize,
            objective_name="" if objective is None else objective.name,
            has_horizon=self.copy.time is not None,
            table_uses=tuple(self.writer.table_uses),
            # Last, because writing the bounds may have added parameters.
            parameters=tuple(table.parameters.values()),
        )

    def _read_expressions(self) -> None:
        """Translate named expressions over time, to add their parameters to the declarations."""
        # A solution can then evaluate also those expressions that no equation contains.
        for component in self.copy.model.component_objects(
            Expression, active=True, descend_into=True
        ):
            if self.addresses.time_position(component) is not None:
                for index in component:
                    address = self.addresses.split(component, index)
                    if address.time == self.copy.template_time:
                        self.writer.write_at_template(component, address.index)

    def _used_algebraics(self, points: tuple[PointSymbol, ...]) -> dict[str, Slot]:
        """Return the algebraic variables in equations over time, integrands or `points`, by name.

        `points` are the values at declared times in conditions and objective.
        """
        parts = [part for e in self.equations for part in (e.expression, e.lower, e.upper)]
        parts += [i.integrand for i in self.writer.integrals.values()]
        used = symbol_names(casadi.vertcat(*parts)) | {point.slot for point in points}
        return {name: s for name, s in self.symbols.algebraics.items() if name in used}

    def _require_variables(self) -> None:
        """Raise an error if the model has no variable to solve for."""
        table = self.symbols
        if not (table.states or table.algebraics or table.statics):
            where = self.copy.time.name if self.copy.others else "model"
            raise TranscriptionError(
                f"{where}: nothing to solve for; declare a Var that is not fixed and an active "
                "Constraint or Objective that contains it."
            )

    def _require_dynamics(self, equations: list[PathEquation]) -> None:
        """Raise an error for a state whose time derivative appears in no equality over time."""
        read = [symbol_names(e.expression) for e in equations if e.is_equality]
        used = frozenset[str]().union(*read)
        states = self.symbols.states.values()
        still = [s for s in states if s.rate.name() not in used]
        moving = {s.component for s in states if s.rate.name() in used}
        said = self._determined_without_rates(still, read)
        for state in still:
            # A state is accepted without its rate if two conditions hold: the equations without
            # rates determine it, and the rate of another member of its Pyomo variable appears.
            # At the ends of a discretised space, an equation without a rate may determine the
            # variable.
            if state.component not in moving or state.name not in said:
                raise TranscriptionError(
                    f"{self._derivative_name(state)}: no equation over time contains this "
                    "derivative; declare its dynamics as an equality constraint."
                )

    def _determined_without_rates(
        self, states: list[Slot], read: list[frozenset[str]]
    ) -> frozenset[str]:
        """Return the names of variables that equations without time derivatives determine.

        The variables are `states`, whose rates no equation contains, and derivatives by a
        discretised coordinate. Each equation determines at most one of them. `read` has the symbol
        names of each equality over time.
        """
        rates = {s.rate.name() for s in self.symbols.states.values()}
        algebraic = [names for names in read if not names & rates]
        # For each derivative in space, the discretisation adds one equation that determines it. The
        # derivatives take part in the matching, so that no state takes up these equations by
        # mistake.
        in_space = {
            name
            for name, slot in self.symbols.algebraics.items()
            if isinstance(self.copy.model.find_component(slot.component), DerivativeVar)
        }
        wanted = sorted(in_space & frozenset[str]().union(*algebraic)) + [s.name for s in states]
        if not algebraic or not states:
            return frozenset()
        holds = csr_matrix([[name in names for names in algebraic] for name in wanted], dtype=int)
        # Each equation can determine one of its variables. The matching assigns a different
        # equation to each variable, as far as possible.
        found = maximum_bipartite_matching(holds, perm_type="column")
        return frozenset(name for name, row in zip(wanted, found, strict=True) if row >= 0)

    def _derivative_name(self, state: Slot) -> str:
        """Return the name of a state's Pyomo DerivativeVar, with the state's index without time."""
        for derivative in self.copy.model.component_objects(DerivativeVar, descend_into=True):
            if derivative.get_state_var().name == state.component:
                return indexed_name(derivative.name, state.index)
        return f"derivative of {state.name}"

    def _bounds(self, slot: Slot) -> tuple[Any, Any]:
        """Return lower and upper bound of a variable without time as CasADi expressions."""
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
        """Return the variables of `table` with final bounds, and with magnitudes for scaling.

        `bounds` returns a variable's lower and upper bound as CasADi expressions. `nominal` has
        magnitudes by name of a variable or component.
        """
        finished = []
        for slot in table.values():
            lower, upper = bounds(slot)
            finished.append(replace(slot, lower=lower, upper=upper).scaled(nominal))
        return tuple(finished)
