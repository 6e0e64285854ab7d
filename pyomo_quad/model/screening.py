"""Checks of a Pyomo model before it is discretised, and counts of its variables and equations.

The checks find missing scaling factors, controls without bounds, limits that contradict each other,
and inconsistent units.
"""

from collections import defaultdict
from collections.abc import Hashable, Iterator
from dataclasses import dataclass
from enum import StrEnum
from io import StringIO
from itertools import permutations
from math import inf
from typing import Any

from pyomo.common.log import LoggingIntercept
from pyomo.core import ConcreteModel, Constraint, Expression, Param, Suffix, Var, value
from pyomo.core.base.component import Component, ComponentData
from pyomo.core.base.constraint import ConstraintData
from pyomo.core.base.indexed_component import IndexedComponent
from pyomo.core.base.units_container import InconsistentUnitsError, UnitsError
from pyomo.core.base.var import VarData
from pyomo.dae import ContinuousSet, DerivativeVar, Integral
from pyomo.repn import generate_standard_repn


class Severity(StrEnum):
    """Severity of a finding, the result of a check of a model or scenario.

    - `IMPOSSIBLE`: no flight can satisfy the model or scenario.
    - `UNPHYSICAL`: numbers of the vehicle contradict physics.
    - `CAUTION`: the user should check a field of the scenario or a component of the model.
    """

    IMPOSSIBLE = "impossible"
    UNPHYSICAL = "unphysical"
    CAUTION = "caution"


@dataclass(frozen=True, kw_only=True)
class Finding:
    """Result of one check of a model or scenario, worded for the user.

    Attributes
    ----------
    severity : Severity
        Severity of the finding.
    subject : str
        Dotted path of a field of the scenario, or full name of a component of the model.
    message : str
        One line: the subject, what was found and, where there is one, the allowed range.
    """

    severity: Severity
    subject: str
    message: str

    def __str__(self) -> str:
        return self.message


@dataclass(frozen=True, kw_only=True)
class _Interval:
    """Interval of values that one declaration permits for a variable.

    `source` is "bounds of NAME" or the name of a constraint. An end without a limit is infinite.
    """

    source: str
    lower: float
    upper: float


def screen_model(model: ConcreteModel) -> tuple[Finding, ...]:
    """Return findings on the variables and limits of a continuous, not discretised model.

    The checks find missing scaling factors, controls without bounds, and limits of one variable
    that are never active or contradict each other. They also find equality constraints that set a
    variable to a value outside its limits.
    """
    intervals = _intervals(model)
    return (
        *_unscaled(model),
        *_unbounded_controls(model, intervals),
        *_conflicts(intervals),
        *_boundary_values(model, intervals),
    )


def _variables(model: ConcreteModel) -> Iterator[Var]:
    # A DerivativeVar has a type of its own, so this yields states and algebraic variables only.
    yield from model.component_objects(Var, active=True, descend_into=True)


def _scaled_names(model: ConcreteModel) -> set[str]:
    return {
        component.name
        for suffix in model.component_objects(Suffix, active=True, descend_into=True)
        if suffix.local_name == "scaling_factor"
        for component in suffix
    }


def _unscaled(model: ConcreteModel) -> Iterator[Finding]:
    scaled = _scaled_names(model)
    for variable in _variables(model):
        some = next(iter(variable.values()), None)
        if some is None or variable.name in scaled or some.name in scaled:
            continue
        yield Finding(
            severity=Severity.CAUTION,
            subject=variable.name,
            message=f"{variable.name}: has no scaling_factor, its magnitude is guessed; add "
            f"model.scaling_factor[model.{variable.name}] = 1 / usual magnitude.",
        )


def _unbounded_controls(
    model: ConcreteModel, intervals: dict[str, list[_Interval]]
) -> Iterator[Finding]:
    differentiated = {
        derivative.get_state_var().name
        for derivative in model.component_objects(DerivativeVar, descend_into=True)
    }
    for variable in _variables(model):
        free = (data for data in variable.values() if not data.fixed)
        data = next((d for d in free if not _is_enclosed(intervals.get(d.name, []))), None)
        sets = variable.index_set().subsets()
        is_control = any(isinstance(one, ContinuousSet) for one in sets)
        if data is None or variable.name in differentiated or not is_control:
            continue
        yield Finding(
            severity=Severity.CAUTION,
            subject=variable.name,
            message=f"{variable.name}: a control without a lower and an upper bound; an optimum "
            "may not exist, give it bounds.",
        )


def _is_enclosed(intervals: list[_Interval]) -> bool:
    lower = max((i.lower for i in intervals), default=-inf)
    upper = min((i.upper for i in intervals), default=inf)
    return lower > -inf and upper < inf


def _intervals(model: ConcreteModel) -> dict[str, list[_Interval]]:
    """Return the intervals of values that a model permits for each variable, by its name.

    They come from the variable's bounds and from linear inequality constraints of this variable
    alone.
    """
    found = defaultdict[str, list[_Interval]](list)
    for variable in _variables(model):
        for data in variable.values():
            if data.has_lb() or data.has_ub():
                found[data.name].append(_bounds(data))
    for constraint in model.component_data_objects(Constraint, active=True, descend_into=True):
        if not constraint.equality:
            limited = _single_variable(constraint)
            if limited is not None:
                found[limited[0].name].append(limited[1])
    return found


def _bounds(data: VarData) -> _Interval:
    lower = -inf if data.lb is None else data.lb
    upper = inf if data.ub is None else data.ub
    return _Interval(source=f"bounds of {data.name}", lower=lower, upper=upper)


def _single_variable(constraint: ConstraintData) -> tuple[VarData, _Interval] | None:
    """Return the single variable of a linear constraint, and the interval that it permits.

    For a constraint that is nonlinear or has several variables, the result is None.
    """
    body = generate_standard_repn(constraint.body, quadratic=False)
    if len(body.linear_vars) != 1 or body.nonlinear_expr is not None:
        return None
    factor = value(body.linear_coefs[0])
    if factor == 0.0:
        return None
    constant = value(body.constant)
    lower = -inf if constraint.lb is None else (constraint.lb - constant) / factor
    upper = inf if constraint.ub is None else (constraint.ub - constant) / factor
    if factor < 0.0:
        # A negative factor exchanges the bounds; an absent bound stays infinite.
        lower, upper = (
            -inf if constraint.ub is None else upper,
            inf if constraint.lb is None else lower,
        )
    return body.linear_vars[0], _Interval(source=constraint.name, lower=lower, upper=upper)


# Limits that follow from the extent of a data file: no declaration that a user could remove.
_OF_DATA = {"airspace.terrain_edge", "airspace.field_edge"}


def _conflicts(intervals: dict[str, list[_Interval]]) -> Iterator[Finding]:
    reported: set[tuple[str, str]] = set()
    for name, held in intervals.items():
        lowest = max(held, key=lambda i: i.lower)
        highest = min(held, key=lambda i: i.upper)
        families = (_family(lowest.source), _family(highest.source))
        if lowest.lower > highest.upper and families not in reported:
            reported.add(families)
            yield Finding(
                severity=Severity.IMPOSSIBLE,
                subject=lowest.source,
                message=f"{lowest.source}: keeps {name} at or above {lowest.lower:.6g}, "
                f"{highest.source} at or below {highest.upper:.6g}; no value is allowed.",
            )
        for one, other in permutations(held, 2):
            families = (_family(one.source), _family(other.source))
            is_own = families[0] not in _OF_DATA
            if is_own and _never_binds(one, other) and families not in reported:
                reported.add(families)
                yield Finding(
                    severity=Severity.CAUTION,
                    subject=one.source,
                    message=f"{one.source}: is never active, {other.source} is tighter; remove it.",
                )


def _never_binds(one: _Interval, other: _Interval) -> bool:
    is_within = one.lower <= other.lower <= other.upper <= one.upper
    return is_within and (one.lower, one.upper) != (other.lower, other.upper)


def _family(name: str) -> str:
    return name.partition("[")[0]


def _boundary_values(
    model: ConcreteModel, intervals: dict[str, list[_Interval]]
) -> Iterator[Finding]:
    reported: set[tuple[str, str]] = set()
    for constraint in model.component_data_objects(Constraint, active=True, descend_into=True):
        held = _single_variable(constraint) if constraint.equality else None
        if held is None:
            continue
        variable, number = held[0], held[1].lower
        for limit in intervals.get(variable.name, ()):
            families = (_family(constraint.name), _family(limit.source))
            if limit.lower <= number <= limit.upper or families in reported:
                continue
            reported.add(families)
            yield Finding(
                severity=Severity.IMPOSSIBLE,
                subject=constraint.name,
                message=f"{constraint.name}: sets {variable.name} to {number:.6g}, {limit.source} "
                f"allows {_span(limit)}; change one of them.",
            )


def _span(interval: _Interval) -> str:
    if interval.lower == -inf:
        return f"at most {interval.upper:.6g}"
    if interval.upper == inf:
        return f"at least {interval.lower:.6g}"
    return f"{interval.lower:.6g} to {interval.upper:.6g}"


@dataclass(frozen=True, kw_only=True)
class ModelInspection:
    """Numbers of variables and equations of a continuous model, and its unit errors.

    A variable or constraint over time is counted once, and not for each time.

    Attributes
    ----------
    states, other_variables : tuple of str
        Names of the states, and names of the other variables over time (controls and algebraic
        variables).
    equations, path_limits : int
        Number of equality constraints over time, and number of inequality constraints over time.
    boundary_conditions, parameters : int
        Number of active constraints at single times, and number of parameters that are constant in
        time.
    unit_errors : tuple of str
        One line for each component with inconsistent units.
    """

    states: tuple[str, ...]
    other_variables: tuple[str, ...]
    equations: int
    path_limits: int
    boundary_conditions: int
    parameters: int
    unit_errors: tuple[str, ...]

    @property
    def degrees_of_freedom(self) -> int:
        """Number of functions of time that the equations leave free, such as the controls."""
        # Each state has a derivative, which the equations determine as well.
        return len(self.states) + len(self.other_variables) - self.equations

    @property
    def is_unit_consistent(self) -> bool:
        """Whether every declared relation has the same unit on both sides."""
        return not self.unit_errors


def inspect_model(model: ConcreteModel) -> ModelInspection:
    """Count variables, equations and parameters of a continuous model, and check its units.

    Parameters
    ----------
    model : ConcreteModel
        Model with one ContinuousSet, not discretised.

    Returns
    -------
    ModelInspection
        The counts and the unit errors.

    Examples
    --------
    >>> from pyomo_quad import build_model
    >>> inspection = inspect_model(build_model(scenario))
    >>> inspection.degrees_of_freedom, inspection.is_unit_consistent
    (4, True)
    """
    time = next(model.component_objects(ContinuousSet, descend_into=True))
    # Each component over time is counted at one time only.
    instant = sorted(time)[len(time) // 2]
    derivatives = list(model.component_objects(DerivativeVar, descend_into=True))
    differentiated = {derivative.get_state_var().name for derivative in derivatives}
    # A DerivativeVar has a type of its own, so this yields states and algebraic variables only.
    variables = [d for v in _over_time(model, Var, time) for d in instances(v, instant)]
    is_state = {d.name: d.parent_component().name in differentiated for d in variables}
    path = [d for c in _over_time(model, Constraint, time) for d in instances(c, instant)]
    whole = list(_over_time(model, Constraint, time))
    return ModelInspection(
        states=tuple(_without_time(d) for d in variables if is_state[d.name]),
        other_variables=tuple(_without_time(d) for d in variables if not is_state[d.name]),
        equations=sum(d.equality for d in path),
        path_limits=sum(not d.equality for d in path),
        boundary_conditions=sum(
            sum(row.active for row in c.values())
            for c in model.component_objects(Constraint, active=True, descend_into=True)
            if not any(c is other for other in whole)
        ),
        parameters=sum(
            len(p)
            for p in model.component_objects(Param, descend_into=True)
            if not is_over(p, time)
        ),
        unit_errors=unit_errors(model),
    )


def unit_errors(model: ConcreteModel) -> tuple[str, ...]:
    """Check the units of every active constraint and named expression.

    Integrals and objectives are not checked.

    Parameters
    ----------
    model : ConcreteModel
        Continuous: units cannot be checked after discretisation.

    Returns
    -------
    tuple of str
        One line per inconsistent component; empty if all are consistent.
    """
    kinds = (Constraint, Expression)
    from pyomo.util.check_units import assert_units_consistent  # noqa: PLC0415  has all of GDP

    found = []
    for component in model.component_objects(kinds, active=True, descend_into=True):
        if isinstance(component, Integral):
            continue  # a sum over a set without unit: its integrand is checked by itself
        try:
            # Pyomo logs the whole expression besides raising; the name and the units suffice.
            with LoggingIntercept(StringIO(), "pyomo"):
                assert_units_consistent(component)
        except (InconsistentUnitsError, UnitsError) as error:
            units = str(error).rsplit(": ", maxsplit=1)[-1]
            found.append(f"{component.name}: {units}")
    return tuple(found)


def is_over(component: Component, time: ContinuousSet) -> bool:
    """Return whether one of the index sets of a component is `time`, the set of times."""
    return component.is_indexed() and any(s is time for s in component.index_set().subsets())


def _over_time(model: ConcreteModel, kind: type, time: ContinuousSet) -> list[IndexedComponent]:
    components = model.component_objects(kind, active=True, descend_into=True)
    return [c for c in components if is_over(c, time)]


def instances(component: IndexedComponent, instant: float) -> list[ComponentData]:
    """Return the members of a time-indexed component whose time is `instant`.

    There may be several, such as one per rotor. Some components have no member at `instant`: a
    limit on the hover at a waypoint, for example, exists only at times of this hover. For these
    components, the members at the first time are returned.
    """
    at: set[Any] = {_as_tuple(index)[-1] for index in component}
    time = instant if instant in at else min(at, default=instant)
    return [d for index, d in component.items() if _as_tuple(index)[-1] == time]


def _as_tuple(index: Hashable) -> tuple[Hashable, ...]:
    return index if isinstance(index, tuple) else (index,)


def _without_time(data: ComponentData) -> str:
    rest = _as_tuple(data.index())[:-1]
    name = data.parent_component().name
    return f"{name}[{','.join(map(str, rest))}]" if rest else name
