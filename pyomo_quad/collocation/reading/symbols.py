"""CasADi symbols of a Pyomo model's components, and the model as expressions of these symbols.

A clone of the model has an additional interior time in its continuous set, the template time. The
member of a constraint at this time is translated to CasADi, and imposed at every collocation point.

The declared times are the members of the set in the user's own model. A declared time is usually a
physical time. A free time is a declared time whose physical time is a static variable (variable
without time). Free times inside the horizon divide it into phases. The fraction of the horizon is 0
at the first and 1 at the last declared time.
"""

from __future__ import annotations

import operator
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Self

import casadi
from pyomo.common.numeric_types import RegisterNumericType
from pyomo.core import ConcreteModel, Param, value
from pyomo.dae import DerivativeVar

from pyomo_quad.collocation.errors import TranscriptionError
from pyomo_quad.collocation.reading.clock import PhaseTimes, index_tuple
from pyomo_quad.collocation.reading.rules import rule_of

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from pyomo.dae import ContinuousSet

    from pyomo_quad.collocation.reading.copy import WorkingCopy
    from pyomo_quad.collocation.reading.tables import TableUse


class TimeSymbol:
    """Symbol for time that is passed to a rule of the model, so that one call serves all times.

    - As an index, it equals the time `template`.
    - In arithmetic, it is the Pyomo parameter `parameter` for physical time.
    - In a comparison by <, <=, > or >=, it is `number`, by default `template`.

    Attributes
    ----------
    is_read : bool
        Whether the rule read `number`, so that the rule's result may not hold at other times. A
        comparison with one of the times `declared` leaves the attribute unchanged. Its result is
        the same at all times between two neighbouring declared times. Callers that give `declared`
        call the rule separately for each declared time, or for each interval between them.
    """

    def __init__(
        self,
        template: float,
        parameter: Any,
        declared: tuple[float, ...] = (),
        number: float | None = None,
    ) -> None:
        self.template = template
        self.parameter = parameter
        self.is_read = False
        self._declared = declared
        self._number = template if number is None else number

    def __hash__(self) -> int:
        return hash(self.template)

    def __eq__(self, other: object) -> bool:
        return self.template == other

    def _compare(self, relation: Callable[[Any, Any], Any], other: Any) -> bool:
        """Return the result of comparing the number of this symbol with another number in a rule.

        If `other` is a number and no declared time, `is_read` becomes True.
        """
        # Pyomo compares two symbols when an Integral sorts its times.
        if isinstance(other, TimeSymbol):
            return bool(relation(self._number, other._number))  # noqa: SLF001
        if other not in self._declared:
            # The result of the rule then does not hold at all times.
            self.is_read = True
        return bool(relation(self._number, other))

    def __lt__(self, other: Any) -> bool:
        return self._compare(operator.lt, other)

    def __le__(self, other: Any) -> bool:
        return self._compare(operator.le, other)

    def __gt__(self, other: Any) -> bool:
        return self._compare(operator.gt, other)

    def __ge__(self, other: Any) -> bool:
        return self._compare(operator.ge, other)

    def __float__(self) -> float:
        self.is_read = True
        return self._number

    def __call__(self, *, exception: bool = True) -> float:
        """Return the number that the symbol has in comparisons, and record that it was read.

        Pyomo's function `value` calls its argument to obtain a number. The argument `exception` has
        no effect.
        """
        del exception
        return float(self)

    def __bool__(self) -> bool:
        return bool(float(self))

    def __int__(self) -> int:
        return int(float(self))

    def __sub__(self, other: Any) -> Any:
        # Two symbols meet only as the ends of a trapezoid in an Integral: a width of one
        # turns that trapezoid into the integrand itself.
        return 1.0 if isinstance(other, TimeSymbol) else self.parameter - other

    def is_numeric_type(self) -> bool:
        """Return False, so that Pyomo calls the method `as_numeric` to obtain a Pyomo parameter."""
        return False

    def as_numeric(self) -> Any:
        """Return the Pyomo parameter that stands for physical time.

        Pyomo calls this method where the symbol is part of an expression.
        """
        return self.parameter


def _of_parameter(operation: str) -> Callable[..., Any]:
    """Return a method of `TimeSymbol` that applies an operation to the symbol's `parameter`.

    `operation` is the name of a method of this Pyomo parameter, such as ``__add__``.
    """

    def operate(symbol: TimeSymbol, *others: Any) -> Any:
        return getattr(symbol.parameter, operation)(*others)

    return operate


# All other arithmetic is that of the parameter.
for _operation in (
    *("__add__", "__radd__", "__rsub__", "__mul__", "__rmul__", "__truediv__", "__rtruediv__"),
    *("__pow__", "__rpow__", "__neg__", "__abs__"),
):
    setattr(TimeSymbol, _operation, _of_parameter(_operation))


class Instant(float):
    """Number that a rule receives as its time; as an index, it selects the template time.

    In arithmetic, and in a comparison by <, <=, > or >=, its value is `time`, any physical time in
    the horizon. The clone has no variables at undeclared physical times. As an index, as in
    ``m.x[t]``, the number therefore equals `template`, the template time. Pyomo looks up an index
    by equality, so ``t == 2`` compares `template` with 2.
    """

    __slots__ = ("template",)
    template: float

    def __new__(cls, time: float, template: float) -> Self:
        """Return a number with the value `time` that selects variables at the time `template`."""
        made = super().__new__(cls, time)
        made.template = template
        return made

    def __hash__(self) -> int:
        return hash(self.template)

    def __eq__(self, other: object) -> bool:
        return self.template == other

    def __ne__(self, other: object) -> bool:
        return not self == other

    def __sub__(self, other: Any) -> Any:
        # As with two symbols: the ends of an Integral's trapezoid are one unit apart.
        return 1.0 if isinstance(other, Instant) else float(self) - other


RegisterNumericType(Instant)


class _TrapezoidProbe:
    """Stand-in for the block of an integral: its continuous set consists of two equal times.

    The rule of a `pyomo.dae.Integral` sums trapezoids between these times. Both times are `symbol`,
    whose class defines its difference from itself as 1. The trapezoid's area is therefore the
    integrand.
    """

    def __init__(self, block: Any, continuous_set: Any, symbol: TimeSymbol | Instant) -> None:
        self._block = block
        self._set_name = continuous_set.local_name
        self._symbol = symbol

    def find_component(self, name: str) -> Any:
        """Return two equal times for the name of the continuous set, else the block's component."""
        if name == self._set_name:
            return [self._symbol, self._symbol]
        return self._block.find_component(name)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._block, name)


def time_parameter() -> Any:
    """Return a mutable Pyomo parameter without value that stands for physical time."""
    owner = ConcreteModel()
    owner.time = Param(mutable=True)
    return owner.time


def integrand(integral: Any, index: Any, symbol: TimeSymbol | Instant) -> Any:
    """Return the integrand of a `pyomo.dae.Integral` at a time, as a Pyomo expression.

    `index` is the integral's index, None without one. The variables in the result are those at the
    template time, which stand for functions of time. `symbol` takes the place of time in the
    integral's rule. If it is a `TimeSymbol`, the result holds at all times. If it is an `Instant`,
    numbers that the rule computes from time are those at this instant.
    """
    # `pyomo.dae.Integral` keeps no integrand, only a rule that sums trapezoids between times. The
    # rule is called for a single trapezoid: both ends are `symbol`, and its width is defined as 1.
    # Its area is therefore the integrand.
    probe = _TrapezoidProbe(integral.parent_block(), integral.get_continuousset(), symbol)
    return integral._rule(probe, index)  # noqa: SLF001


@dataclass(frozen=True)
class Address:
    """Identification of a member of a Pyomo component.

    Attributes
    ----------
    component : str
        Full name of the component.
    index : tuple
        Index of the member, from which the time is left out.
    time : float or None
        Time of the member; None if the component is not indexed by time.
    """

    component: str
    index: tuple[Any, ...]
    time: float | None

    @property
    def name(self) -> str:
        """Name of the component with its index but without the time: ``rotors.omega[1]``."""
        return indexed_name(self.component, self.index)


def indexed_name(component: str, index: tuple[Any, ...]) -> str:
    """Return the name of a component's member with its index in brackets, as ``omega[1]``.

    If the index is (), the result is the name of the component alone.
    """
    return f"{component}[{','.join(str(i) for i in index)}]" if index else component


class AddressBook:
    """Splitter of the indices of Pyomo components into time and the other indices.

    For example, the index (1, 0.5) of a ``Var(rotor, time)`` is split into (1,) and the time 0.5.

    Parameters
    ----------
    time : ContinuousSet or None
        The set whose members are times; None if no component is indexed by time.
    """

    def __init__(self, time: ContinuousSet | None) -> None:
        self._time = time
        # Caching: Pyomo rebuilds a component's name at each access.
        self._known: dict[int, tuple[str, int | None]] = {}

    def time_position(self, component: Any) -> int | None:
        """Return the position of time in a component's index, None if the component has no time."""
        return self._name_and_position(component)[1]

    def _name_and_position(self, component: Any) -> tuple[str, int | None]:
        """Return a component's name and the position of time in its index, from a cache."""
        key = id(component)
        if key not in self._known:
            self._known[key] = component.name, self._find(component)
        return self._known[key]

    def _find(self, component: Any) -> int | None:
        """Return the position of time in a component's index, None if the component has no time.

        Raises
        ------
        TranscriptionError
            If the component is indexed by the continuous set twice.
        """
        if self._time is None or not component.is_indexed():
            return None
        offset, found = 0, None
        for subset in component.index_set().subsets():
            if subset is self._time:
                if found is not None:
                    raise TranscriptionError(
                        f"{component.name}: indexed twice by {self._time.name}; once is supported."
                    )
                found = offset
            offset += subset.dimen or 1
        return found

    def of(self, data: Any) -> Address:
        """Return the `Address` of a Pyomo data object: component, index without time, and time."""
        component = data.parent_component()
        return self.split(component, data.index())

    def split(self, component: Any, index: Any) -> Address:
        """Split a component's full index into the time and the remaining index, as an `Address`."""
        whole = index_tuple(index)
        name, position = self._name_and_position(component)
        if position is None:
            return Address(name, whole, None)
        rest = whole[:position] + whole[position + 1 :]
        return Address(name, rest, whole[position])

    def join(self, component: Any, index: tuple[Any, ...], time: Any) -> Any:
        """Return a component's full index at a time, the inverse of `split`.

        The given index is without time: (i,) for ``x[i, t]``. If the component is not indexed by
        time, `time` is ignored.
        """
        position = self.time_position(component)
        if position is None:
            return index[0] if len(index) == 1 else (index or None)
        whole = (*index[:position], time, *index[position:])
        return whole[0] if len(whole) == 1 else whole


@dataclass(frozen=True, kw_only=True)
class Slot:
    """Scalar variable or parameter of the model, with its CasADi symbol.

    Attributes
    ----------
    name : str
        Name with index but without time: ``rotors.omega[1]`` for ``rotors.omega[1, t]``.
    component : str
        Full name of the Pyomo component.
    index : tuple
        Index without time: (1,) in the example, () for ``x[t]`` and ``x``.
    symbol : casadi.SX
    lower, upper : casadi.SX
        Bounds, infinite by default.
    nominal : float, optional
        Declared magnitude, for scaling.
    rate : casadi.SX, optional
        Symbol of a state's derivative by the fraction of the horizon.
    """

    name: str
    component: str
    index: tuple[Any, ...]
    symbol: Any
    # Expressions of parameters and time. Until the whole model is read, the bounds of the Pyomo
    # variable, or None.
    lower: Any = field(default_factory=lambda: casadi.SX(-casadi.inf))
    upper: Any = field(default_factory=lambda: casadi.SX(casadi.inf))
    nominal: float | None = None
    rate: Any = None

    def scaled(self, magnitudes: Mapping[str, float]) -> Slot:
        """Return a copy of the variable, with its magnitude for scaling from a mapping.

        `magnitudes` maps the name of a variable or, with lower priority, of a component to a
        magnitude. Without either, the magnitude is None.
        """
        return replace(self, nominal=magnitudes.get(self.name, magnitudes.get(self.component)))


@dataclass(frozen=True, kw_only=True)
class PathEquation:
    """Constraint lower <= expression <= upper that is imposed at every collocation point.

    The CasADi expressions contain the variables at a collocation point and the parameters. They may
    also contain the fraction of the horizon, which is 0 at its start and 1 at its end.
    """

    name: str
    expression: Any
    lower: Any
    upper: Any
    is_equality: bool


@dataclass(frozen=True, kw_only=True)
class PointSymbol:
    """Value or derivative of a variable at a declared time, with its CasADi symbol.

    A declared time is a member of the continuous set.

    Attributes
    ----------
    slot : str
        Name of the variable.
    fraction : float
        Declared time as a fraction of the horizon.
    is_rate : bool
        Whether the symbol stands for the derivative with respect to the fraction of the horizon.
    symbol : casadi.SX
    """

    slot: str
    fraction: float
    is_rate: bool
    symbol: Any


@dataclass(frozen=True, kw_only=True)
class PointCondition:
    """Constraint lower <= expression <= upper, in CasADi, that is imposed only once.

    The expressions contain values at declared times (members of the continuous set), static
    variables and integrals.
    """

    name: str
    expression: Any
    lower: Any
    upper: Any


@dataclass(frozen=True, kw_only=True)
class Integral:
    """Integral over the horizon: its symbol in constraints and objective, and its integrand.

    The CasADi expression `integrand` is integrated over the fraction of the horizon from 0 to 1. It
    contains the factor d (physical time) / d (fraction of the horizon).
    """

    name: str
    symbol: Any
    integrand: Any

    @property
    def slot(self) -> Slot:
        """Variable without time that stands for the integral in the equations; it has no bounds."""
        return Slot(name=self.name, component=self.name, index=(), symbol=self.symbol)


@dataclass(frozen=True, kw_only=True)
class Declarations:
    """Continuous model in CasADi symbols, in the form that the transcription needs.

    Attributes
    ----------
    states, algebraics, statics : tuple of Slot
        Variables with a derivative, other variables over time, and variables without time.
    parameters, signals : tuple of Slot
        Parameters without time, and parameters over time.
    scheduled : tuple of Slot
        Other data over time: data of rules that branch on time, and for each phase of the horizon
        (part between free times) a factor, which is 1 in the phase and 0 elsewhere.
    clock : PhaseTimes
        Physical times of start, end and free times in CasADi symbols.
    equations : tuple of PathEquation
        Constraints over time.
    conditions : tuple of PointCondition
        Constraints at declared times (members of the continuous set) or without time.
    point_symbols : tuple of PointSymbol
        Values at declared times in conditions and objective.
    integrals : tuple of Integral
    objective : casadi.SX
    maximise : bool
    fixed : tuple of (str, float)
        Fixed states, as (name, fraction of the horizon).
    outputs, output_equations, output_starts : tuple
        States on which neither the objective nor other equations depend, with their equations and
        initial conditions.
    objective_name : str
        "" if there is no objective.
    has_horizon : bool
        Whether the model has a continuous set, and thus variables over time.
    table_uses : tuple of TableUse
    """

    states: tuple[Slot, ...]
    algebraics: tuple[Slot, ...]
    statics: tuple[Slot, ...]
    parameters: tuple[Slot, ...]
    signals: tuple[Slot, ...]
    scheduled: tuple[Slot, ...]
    clock: PhaseTimes
    equations: tuple[PathEquation, ...]
    conditions: tuple[PointCondition, ...]
    point_symbols: tuple[PointSymbol, ...]
    integrals: tuple[Integral, ...]
    objective: Any
    maximise: bool
    # The values of these states are read at each solve.
    fixed: tuple[tuple[str, float], ...] = ()
    outputs: tuple[Slot, ...] = ()
    output_equations: tuple[PathEquation, ...] = ()
    output_starts: tuple[PointCondition, ...] = ()
    objective_name: str = ""
    has_horizon: bool = True
    table_uses: tuple[TableUse, ...] = ()

    @property
    def has_signals(self) -> bool:
        """Whether data over time must be evaluated at each collocation point before a solve.

        These data are parameters over time, rules that branch on time, and phases of the horizon.
        """
        return bool(self.signals or self.scheduled)

    @property
    def varying(self) -> tuple[Slot, ...]:
        """All variables over time: states, output states, algebraic variables."""
        return (*self.states, *self.outputs, *self.algebraics)

    @property
    def path_data(self) -> tuple[Any, ...]:
        """Symbols of the data of a collocation point, in the order that compiled functions expect.

        The order is: fraction of the horizon, `signals`, `scheduled`, `parameters`.
        """
        slots = (*self.signals, *self.scheduled, *self.parameters)
        return (self.clock.fraction, *(s.symbol for s in slots))


class SymbolTable:
    """Table of the CasADi symbols of a model's variables and parameters, each made at first use.

    The symbol of a variable at the template time stands for a function of time. The symbol at any
    other time stands for the value at that time. An `Address` identifies a member of a component by
    the component's name, the index without time, and the time.

    Parameters
    ----------
    copy : WorkingCopy
        Clone of the model with the template time.
    addresses : AddressBook
        Returns the `Address` of a component's member.
    free : mapping
        Free time (declared time whose physical time is unknown before the solve) -> static variable
        for its physical time.
    statics : dict
        Static variables by name, shared by several horizons; new ones are added.
    """

    def __init__(
        self,
        copy: WorkingCopy,
        addresses: AddressBook,
        free: Mapping[float, Any],
        statics: dict[str, Slot],
    ) -> None:
        self._copy = copy
        self._addresses = addresses
        self.states: dict[str, Slot] = {}
        self.algebraics: dict[str, Slot] = {}
        self.statics = statics
        self.parameters: dict[str, Slot] = {}
        self.signals: dict[str, Slot] = {}
        self.points: dict[tuple[str, float, bool], PointSymbol] = {}
        self.signal_points: dict[tuple[str, float], Any] = {}
        self.derivatives = {
            d.get_state_var().name: d
            for d in copy.model.component_objects(DerivativeVar, descend_into=True)
        }
        self.clock = self._clock(free)

    def _clock(self, free: Mapping[float, Any]) -> PhaseTimes:
        """Return start, end and free times of the horizon in CasADi symbols.

        `free` maps a declared time to the static variable that gives its physical time.
        """
        declared = self._copy.declared_times or (0.0, 1.0)
        ends = {declared[0]: "horizon.start", declared[-1]: "horizon.end"}
        times = tuple(sorted(ends.keys() | free.keys()))
        name = "" if self._copy.time is None else self._copy.time.name
        starts = times[:-1] if len(times) > 2 else ()
        return PhaseTimes(
            name=name,
            declared=times,
            times=tuple(
                self._static(self._copy.model.find_component(free[time].name))
                if time in free
                else self._horizon(ends[time], time)
                for time in times
            ),
            fraction=casadi.SX.sym("fraction"),
            phases=tuple(casadi.SX.sym(f"{name} from {start:g}") for start in starts),
            is_free=bool(free),
        )

    def _horizon(self, name: str, time: float) -> Any:
        """Return the symbol of a new parameter `name` for the physical start or end of the horizon.

        If the model has no continuous set, the result is the number `time` instead. Otherwise,
        `time` is not used.
        """
        if self._copy.time is None:
            return casadi.SX(time)
        symbol = casadi.SX.sym(name)
        self.parameters[name] = Slot(name=name, component=name, index=(), symbol=symbol)
        return symbol

    def leaf(self, data: Any) -> Any:
        """Return a Pyomo variable, time derivative or mutable parameter in CasADi symbols.

        If the component is indexed by the time of another horizon, an error is raised.
        """
        address = self._addresses.of(data)
        self._refuse_other_horizon(data)
        if data.is_variable_type():
            if address.time is None:
                return self._static(data)
            return self._varying(data, address)
        if address.time is None:
            return self._scalar(self.parameters, data, address.name)
        return self._signal(data, address)

    def _refuse_other_horizon(self, data: Any) -> None:
        """Raise an error if a variable or parameter is indexed by the time of another horizon."""
        other = self._copy.other_of(data.parent_component()) if self._copy.others else None
        if other is not None:
            raise TranscriptionError(
                f"{data.name}: a value over {other.name} cannot stand in a component over "
                f"{self._copy.time.name}; introduce a static variable equal to it."
            )

    def _scalar(self, table: dict[str, Slot], data: Any, name: str, **more: Any) -> Any:
        """Return the symbol of a variable or parameter without time, made at first use.

        A new `Slot` with the attributes `more` is added to `table` under `name`.
        """
        if name not in table:
            address = self._addresses.of(data)
            table[name] = Slot(
                name=name,
                component=address.component,
                index=index_tuple(data.index()),
                symbol=casadi.SX.sym(name),
                **more,
            )
        return table[name].symbol

    def fixed_value(self, data: Any) -> Any:
        """Return the symbol of a parameter that has the value of the fixed variable `data`.

        The parameter is made at first use.
        """
        # As a parameter, the value can change between solves without another compilation.
        return self._scalar(self.parameters, data, f"{data.name} (fixed)")

    def _static(self, data: Any) -> Any:
        """Return the symbol of a variable without time; a fixed variable becomes a parameter."""
        if data.fixed:
            return self._scalar(self.parameters, data, data.name)
        return self._scalar(self.statics, data, data.name, lower=data.lower, upper=data.upper)

    def _is_clock(self, data: Any) -> bool:
        """Return whether a parameter's rule returns its time, as ``lambda m, t: t``."""
        component, index = data.parent_component(), self._addresses.of(data).index
        is_time_where_declared = all(
            value(component[self._addresses.join(component, index, t)], exception=False) == t
            for t in self._copy.declared_times
        )
        rule = rule_of(component)
        if not is_time_where_declared or rule is None:
            return False
        symbol = TimeSymbol(self._copy.template_time, time_parameter())
        position = self._addresses.join(component, index, symbol)
        try:
            said = rule(component.parent_block(), position)
        except Exception:  # noqa: BLE001  the rule is the user's: it may raise anything
            return False
        return said is symbol

    def _signal(self, data: Any, address: Any) -> Any:
        """Return the CasADi symbol of `data`, a member of a parameter over time.

        `address` has index and time. The symbol stands for a function at the template time, for a
        value at a declared time. If the parameter's rule returns its time, the result is physical
        time.
        """
        if self._is_clock(data):
            return self._physical_time(address.time)
        name = address.name
        if address.time != self._copy.template_time:
            key = (name, self.clock.fraction_of(address.time))
            return self.signal_points.setdefault(key, casadi.SX.sym(data.name))
        if name not in self.signals:
            self.signals[name] = Slot(
                name=name,
                component=address.component,
                index=address.index,
                symbol=casadi.SX.sym(name),
            )
        return self.signals[name].symbol

    def _physical_time(self, time: float) -> Any:
        """Return the physical time that corresponds to a time in an index, as a CasADi expression.

        At the template time, it is a function of the fraction of the horizon.
        """
        return self.clock.time if time == self._copy.template_time else self.clock.time_at(time)

    def _varying(self, data: Any, address: Any) -> Any:
        """Return a variable over time, or its time derivative, in CasADi symbols.

        `data` is the member of the Pyomo variable or derivative, and `address` its index and time.
        An algebraic variable that is fixed at all declared times becomes a parameter.
        """
        component = data.parent_component()
        is_rate = component.ctype is DerivativeVar
        variable = component.get_state_var() if is_rate else component
        slot = self._slot(variable, address)
        if slot is None:
            first = self._addresses.join(variable, address.index, self._copy.declared_times[0])
            return self._scalar(self.parameters, variable[first], variable[first].name)
        if address.time == self._copy.template_time:
            return slot.rate / self.clock.span if is_rate else slot.symbol
        key = (slot.name, self.clock.fraction_of(address.time), is_rate)
        if key not in self.points:
            symbol = casadi.SX.sym(data.name)
            self.points[key] = PointSymbol(
                slot=slot.name, fraction=key[1], is_rate=is_rate, symbol=symbol
            )
        symbol = self.points[key].symbol
        return symbol / self.clock.span_at(address.time) if is_rate else symbol

    def _slot(self, variable: Any, address: Any) -> Slot | None:
        """Return the `Slot` (symbol and bounds) of a variable over time, made at first use.

        `variable` is the Pyomo component. Of `address`, only the index without time is used. The
        result is None for an algebraic variable that is fixed at all declared times.
        """
        name = indexed_name(variable.name, address.index)
        for table in (self.states, self.algebraics):
            if name in table:
                return table[name]
        template = variable[self._addresses.join(variable, address.index, self._copy.template_time)]
        is_state = variable.name in self.derivatives
        if not is_state and self._is_fixed_throughout(variable, address.index):
            return None
        symbol = casadi.SX.sym(name)
        slot = Slot(
            name=name,
            component=variable.name,
            index=address.index,
            symbol=symbol,
            lower=template.lower,
            upper=template.upper,
            rate=casadi.SX.sym(f"d({name})") if is_state else None,
        )
        (self.states if is_state else self.algebraics)[name] = slot
        return slot

    def _is_fixed_throughout(self, variable: Any, index: tuple[Any, ...]) -> bool:
        """Return whether a variable over time is fixed at all members of the continuous set."""
        return all(
            variable[self._addresses.join(variable, index, t)].fixed
            for t in self._copy.declared_times
        )
