"""Sources of the values of parameters and variables: a Pyomo model, or a copy for pickling.

A compiled problem reads these values when it is solved: usually from the user's Pyomo model, and in
a pickled problem from a copy of the model's values at pickling. A `Slot` names a scalar variable or
parameter by its Pyomo component and its index without time. For a variable over time, the model has
values at the declared times, the members of the continuous set.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import partial
from itertools import product
from typing import TYPE_CHECKING, Any, NoReturn

from pyomo.core import Constraint, Param, Suffix, Var, value
from pyomo.core.base.units_container import UnitsError, units
from pyomo.dae import DerivativeVar, Integral

from pyomo_quad.collocation.errors import TranscriptionError, raised
from pyomo_quad.collocation.reading.rules import initial_rule_of, rule_of
from pyomo_quad.collocation.reading.schedules import (
    Interpolant,
    Reading,
    interpolant,
    jumps,
    probes,
)
from pyomo_quad.collocation.reading.symbols import AddressBook, indexed_name

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from pyomo_quad.collocation.reading.schedules import Phases, Schedule
    from pyomo_quad.collocation.reading.symbols import Declarations, Slot

# Names of derived units by size and dimension; moments come before energies.
_CALLED = {
    "N": units.N,
    "N*m": units.get_units(units.N * units.m),
    "W": units.W,
    "V": units.V,
    "A": units.A,
}
# Units of angle. Engineers omit the radians that Pyomo keeps in a squared rotor speed.
_ANGLES = (units.dimensionless, units.rad, units.rad**2)
# Largest difference from 1 of a conversion factor between two units that count as the same.
_ROUNDING = 1e-12
# Factor of radians in the text of a unit.
_ANGLE_FACTOR = re.compile(r"\*rad(\*\*[\d.]+)?")
_AT_ANY_TIME = (
    "; a parameter over time needs a value at any time: declare it with initialize= a function of "
    "time that reads nothing but its time and parameters without time"
)


def family_name(name: str) -> str:
    """Return the name of the component to which the name of a constraint or bound belongs.

    Index and time are removed from the name: ``omega[1] at time 2`` becomes ``omega``.
    """
    return name.split("[", 1)[0].split(" at time", 1)[0]


def declared_unit(model: Any, name: str) -> str:
    """Return the unit of a constraint's body or of a variable as a text, for example "m/s".

    The result is "" for an unknown name, and for a missing, dimensionless or inconsistent unit.
    """
    component = model.find_component(family_name(name))
    data: Any = None if component is None else next(iter(component.values()), None)
    try:
        unit = units.get_units(data if data.is_variable_type() else data.body)
    except (UnitsError, AttributeError):
        return ""
    return "" if unit is None or str(unit) == "dimensionless" else _spelled(unit)


def _spelled(unit: Any) -> str:
    """Return a Pyomo unit as an engineer writes it, for example N for the N*rad**2 of a thrust.

    Radians that multiply another unit are left out. A compound unit that equals a named unit gets
    the name.
    """
    text = str(unit)
    if "*" not in text and "/" not in text:
        return text
    for angle, (called, plain) in product(_ANGLES, _CALLED.items()):
        try:
            factor = units.convert_value(
                1.0, from_units=units.get_units(unit / angle), to_units=plain
            )
        except UnitsError:
            continue
        if abs(factor - 1.0) < _ROUNDING:
            return called
    return _ANGLE_FACTOR.sub("", text)


def declared_magnitudes(model: Any) -> dict[str, float]:
    """Return the magnitudes of variables according to the Suffix `scaling_factor`, by name.

    A name is that of a component or of a member. A magnitude is the inverse of a scaling factor.
    """
    magnitudes: dict[str, float] = {}
    for suffix in model.component_objects(Suffix, descend_into=True):
        if suffix.local_name == "scaling_factor":
            for item, factor in suffix.items():
                if item is not None and factor:
                    magnitudes[item.name] = 1.0 / float(factor)
    return magnitudes


class LiveModel:
    """The user's Pyomo model as the source of the values of parameters and variables.

    Each method reads current values from the model, or writes solved values into it.

    Parameters
    ----------
    model : ConcreteModel
    time : ContinuousSet or None
        The model's continuous set.
    schedules : tuple of Schedule or Phases
        Objects that compute the data of `Declarations.scheduled`: a `Schedule` for each rule that
        branches on time, and a `Phases` object for a horizon with several phases.
    """

    def __init__(self, model: Any, time: Any, schedules: tuple[Schedule | Phases, ...]) -> None:
        self.model = model
        self.schedules = schedules
        self._time = time
        self._addresses = AddressBook(time)
        self._units: dict[str, str] = {}

    def of(self, model: Any) -> LiveModel:
        """Return a `LiveModel` of another Pyomo model with the same declarations."""
        time = None if self._time is None else model.find_component(self._time.name)
        return LiveModel(model, time, self.schedules)

    @property
    def times(self) -> tuple[float, ...]:
        """Members of the continuous set (declared times), in rising order.

        The result is empty if the model has no continuous set.
        """
        return () if self._time is None else tuple(float(t) for t in sorted(self._time))

    def has(self, name: str) -> bool:
        """Return whether the model has a component of this name."""
        return self.model.find_component(name) is not None

    def is_constant(self, name: str) -> bool:
        """Return whether a component, given by its name or that of a member, is immutable."""
        component = self.model.find_component(family_name(name))
        return getattr(component, "ctype", None) is Param and not component.mutable

    def unit(self, name: str) -> str:
        """Return the unit of a constraint or variable by name, as a text; "" if it has none."""
        family = family_name(name)
        if family not in self._units:
            self._units[family] = declared_unit(self.model, family)
        return self._units[family]

    def parameter(self, slot: Slot) -> float | None:
        """Return the value of a parameter without time, or of a fixed variable; None if unset.

        For a variable over time that is fixed at all declared times, the result is its only value.

        Raises
        ------
        TranscriptionError
            If a variable over time is fixed at all declared times, but to different values.
        """
        component = self.model.find_component(slot.component)
        member = self._member(component, slot)
        if slot.name == member.name and self._addresses.of(member).time is not None:
            self._refuse_other_values(component, self._addresses.of(member).index)
        found = value(member, exception=False)
        return None if found is None else float(found)

    def _refuse_other_values(self, variable: Any, index: tuple[Any, ...]) -> None:
        """Raise an error for a variable that is fixed to different values at the declared times.

        `index` is the index of the variable without time.
        """
        held = {variable[self._addresses.join(variable, index, t)].value for t in self.times}
        if len(held) > 1:
            raise TranscriptionError(
                f"{indexed_name(variable.name, index)}: is fixed to different values at "
                "different declared times, and its value between them is unknown; make it a "
                "Param over time with initialize= a function of time."
            )

    def variable(self, slot: Slot, time: float | None = None) -> float | None:
        """Return a variable's value in the model, None if it is unset or the component is no Var.

        `time` is a member of the continuous set; None for a variable without time.
        """
        component = self.model.find_component(slot.component)
        if component.ctype is not Var:
            return None
        held = self._member(component, slot, time).value
        return None if held is None else float(held)

    def first_guess(self, slot: Slot) -> Callable[[float], float] | None:
        """Return a variable's `initialize` rule as a function of time, None if it is not usable.

        A usable rule returns the variable's current value at each declared time at which the
        variable is not fixed. The function raises a `TranscriptionError` where the rule fails.
        """
        component = self.model.find_component(slot.component)
        rule = initial_rule_of(component) if component.ctype is Var else None
        if rule is None:
            return None
        guess = self._guarded(component, slot, rule, "initialize rule")
        members = ((t, self._member(component, slot, t)) for t in self.times)
        held = [(t, member.value) for t, member in members if not member.fixed]
        try:
            is_as_made = all(number == guess(t) for t, number in held)
        except TranscriptionError:
            return None
        return guess if is_as_made else None

    def _guarded(
        self, component: Any, slot: Slot, rule: Any, kind: str, advice: str = ""
    ) -> Callable[[float], float]:
        """Return a component's rule, a callable (block, index) -> value, as a function of time.

        `slot` gives the index without time. If the rule fails, the function raises a
        `TranscriptionError`. Its message contains `kind`, which describes the rule, and `advice`.
        """
        block, join = component.parent_block(), self._addresses.join

        def said(t: float) -> float:
            try:
                return float(value(rule(block, join(component, slot.index, t))))
            except Exception as error:
                raise TranscriptionError(
                    f"{slot.name}: its {kind} fails at time {t:g} ({raised(error)}){advice}."
                ) from error

        return said

    def _member(self, component: Any, slot: Slot, time: float | None = None) -> Any:
        """Return the Pyomo data object of a variable or parameter at a declared time.

        `time` is None for a component that is not indexed by time.
        """
        if time is not None:
            return component[self._addresses.join(component, slot.index, time)]
        if not slot.index:
            return component
        return component[slot.index if len(slot.index) > 1 else slot.index[0]]

    def signal(self, slot: Slot) -> Callable[[float], float]:
        """Return a parameter over time as a function of time: its rule, or a constant.

        The returned function raises a `TranscriptionError` at times at which the rule fails.

        Raises
        ------
        TranscriptionError
            If a parameter without a rule is not constant; or if, at a declared time, the rule fails
            or does not return the model's value.
        """
        component = self.model.find_component(slot.component)
        rule = rule_of(component)
        held = [float(value(self._member(component, slot, t))) for t in self.times]
        # Without a rule, values between the declared times are known only if the parameter is
        # constant.
        if rule is None:
            if len(set(held)) == 1:
                return lambda _t: held[0]
            raise TranscriptionError(
                f"{slot.name}: a parameter over time needs a value at any time; declare it with "
                "initialize= a function of time."
            )

        signal = self._guarded(component, slot, rule, "rule", _AT_ANY_TIME)
        if held != [signal(t) for t in self.times]:
            raise TranscriptionError(
                f"{slot.name}: was changed after its rule made it; give parameters= a function of "
                "time, or declare it anew."
            )
        return signal

    def load(self, slot: Slot, time: float | None, number: float) -> None:
        """Set a variable of the Pyomo model at one time to its solved value.

        A fixed variable keeps its value. `time` is a member of the continuous set, or None for a
        variable without time.
        """
        component = self.model.find_component(slot.component)
        if component.ctype is Var:
            data = self._member(component, slot, time)
            if not data.fixed:
                data.set_value(number, skip_validation=True)

    def load_rates(self, time: float, rate: Callable[..., float]) -> None:
        """Set the model's derivatives at a declared time (member of the continuous set).

        `rate(name, index=...)` returns the solved value of a derivative, by its name and its index
        without the time: (i,) for ``x[i, t]``.
        """
        for derivative in self.model.component_objects(DerivativeVar, descend_into=True):
            for position in derivative:
                address = self._addresses.split(derivative, position)
                if address.time == time:
                    number = rate(derivative.name, index=address.index)
                    derivative[position].set_value(number, skip_validation=True)

    def load_integrals(self, totals: Mapping[str, float]) -> None:
        """Set the integrals of the Pyomo model to their solved values, given by full name."""
        for integral in self.model.component_objects(Integral, descend_into=True):
            for data in integral.values():
                if data.name in totals:
                    # The rule, which contains the integrand, remains unchanged.
                    data.set_value(totals[data.name])

    def load_suffix(
        self,
        suffix: Any,
        kind: type,
        over_time: Mapping[str, Callable[[float], float]],
        once: Mapping[str, float],
    ) -> None:
        """Write derivatives of the objective into a Pyomo suffix.

        `kind` is Constraint for derivatives by a constraint's constant side, and Var for
        derivatives by a variable's bound or a state. `over_time` maps names without the time, as
        ``omega[1]``, to functions of time. `once` maps full names of single members, as ``x[0]``,
        to numbers.
        """
        for component in self.model.component_objects(kind, active=True, descend_into=True):
            for index, data in component.items():
                address = self._addresses.split(component, index)
                if data.name in once:
                    suffix[data] = once[data.name]
                elif address.time is not None and address.name in over_time:
                    suffix[data] = over_time[address.name](address.time)

    def snapshot(self, declared: Declarations, horizon: tuple[float, float]) -> ModelSnapshot:
        """Return a copy of the model's current values that can be pickled.

        Parameters
        ----------
        declared : Declarations
            The model in CasADi symbols: its parameters and variables are those to be copied.
        horizon : (float, float)
            Start and end of the interval in which parameters over time and rules are approximated
            by polynomials of time.
        """
        components = list(self.model.component_objects(descend_into=True))
        limits = self.model.component_objects((Var, Constraint), descend_into=True)
        units = {name: self.unit(name) for name in {family_name(c.name) for c in limits}}
        asked = probes([horizon[0], *self.times[1:-1], horizon[1]]) if self.times else []
        return ModelSnapshot(
            times=self.times,
            names=frozenset(c.name for c in components),
            constants=frozenset(c.name for c in components if self.is_constant(c.name)),
            units={name: unit for name, unit in units.items() if unit},
            parameters={
                slot.name: self.parameter(slot)
                for slot in declared.parameters
                if self.has(slot.component)
            },
            variables={(s.name, None): self.variable(s) for s in declared.statics}
            | {(s.name, t): self.variable(s, t) for s in declared.varying for t in self.times},
            signals={
                slot.name: self._signal_as_interpolant(slot, horizon, asked)
                for slot in declared.signals
            },
            guesses={
                slot.name: _as_interpolant(slot, guess, horizon, asked)
                for slot in declared.varying
                if (guess := self.first_guess(slot)) is not None
            },
            schedules=tuple(
                interpolant(s.name, s.row, horizon, list(jumps(s.reading, asked)))
                for s in self.schedules
            ),
        )

    def _signal_as_interpolant(
        self, slot: Slot, horizon: tuple[float, float], asked: list[float]
    ) -> Interpolant:
        """Return a parameter over time as an `Interpolant` over `horizon`, for pickling.

        `slot` identifies the parameter. Jumps are searched between neighbouring times of `asked`,
        which are in rising order. If the approximation fails, the result has no pieces, and its
        `refusal` says why.
        """
        try:
            return _as_interpolant(slot, self.signal(slot), horizon, asked)
        except TranscriptionError as error:
            return Interpolant(edges=(), pieces=(), refusal=str(error))


def _as_interpolant(
    slot: Slot,
    function: Callable[[float], float],
    horizon: tuple[float, float],
    asked: list[float],
) -> Interpolant:
    """Return a function of time as an `Interpolant` over `horizon`, for pickling.

    `slot` names the function in messages. Jumps are searched between neighbouring times of `asked`,
    which are in rising order. If the approximation fails, the result has no pieces, and its
    `refusal` says why.
    """
    try:
        edges = list(jumps(partial(as_reading, function), asked))
    except TranscriptionError as error:
        return Interpolant(edges=(), pieces=(), refusal=str(error))
    return interpolant(slot.name, lambda t: (function(t),), horizon, edges)


@dataclass(frozen=True, kw_only=True)
class ModelSnapshot:
    """Values that a model had when its problem was pickled, with the interface of `LiveModel`.

    Attributes
    ----------
    times : tuple of float
        Members of the model's continuous set.
    names, constants : frozenset of str
        Names of all components, and of immutable parameters.
    units : dict
        Units by component name.
    parameters : dict
        Values by name; None if unset.
    variables : dict
        Values by (name, time or None); None if unset.
    signals, guesses : dict
        Parameters over time, and `initialize` rules, by name.
    schedules : tuple of Interpolant
        Data over time of rules that branch on time (`schedules.Schedule`), and of the horizon's
        phases (`schedules.Phases`). Each item has the values that the method `row` of such an
        object returned.
    """

    times: tuple[float, ...]
    names: frozenset[str]
    constants: frozenset[str]
    units: dict[str, str]
    parameters: dict[str, float | None]
    variables: dict[tuple[str, float | None], float | None]
    signals: dict[str, Interpolant]
    guesses: dict[str, Interpolant]
    schedules: tuple[Interpolant, ...]

    def _refuse(self, *_given: Any) -> NoReturn:
        """Raise an error for operations that need the Pyomo model, which is not pickled."""
        raise TranscriptionError(
            "model: a pickled problem keeps the model's equations and numbers, not the model; "
            "compile the model again to load values into it."
        )

    model = property(_refuse)
    of = load = load_rates = load_integrals = _refuse

    def has(self, name: str) -> bool:
        """Return whether the model had a component of this name when the problem was pickled."""
        return name in self.names or name.rpartition("[")[0] in self.names

    def is_constant(self, name: str) -> bool:
        """Return whether a component, given by its name or that of a member, is immutable."""
        return family_name(name) in self.constants

    def unit(self, name: str) -> str:
        """Return the unit of a constraint or variable by name, as a text; "" if it has none."""
        return self.units.get(family_name(name), "")

    def parameter(self, slot: Slot) -> float | None:
        """Return the value that a parameter had when the problem was pickled, or None."""
        return self.parameters[slot.name]

    def variable(self, slot: Slot, time: float | None = None) -> float | None:
        """Return the value that a variable had in the model when the problem was pickled, or None.

        `time` is a member of the continuous set; None for a variable without time.
        """
        return self.variables[slot.name, time]

    def first_guess(self, slot: Slot) -> Interpolant | None:
        """Return a variable's `initialize` rule as a function of time, from the pickle.

        The result is None if `LiveModel.first_guess` returned None.
        """
        return self.guesses.get(slot.name)

    def signal(self, slot: Slot) -> Interpolant:
        """Return a parameter over time as piecewise polynomials of time, from the pickle."""
        return self.signals[slot.name]

    def snapshot(self, declared: Declarations, horizon: tuple[float, float]) -> ModelSnapshot:  # noqa: ARG002
        """Return the snapshot itself; the arguments are unused (see `LiveModel.snapshot`)."""
        return self


def as_reading(signal: Callable[[float], float], time: float) -> Reading:
    """Return the value of the function `signal` at a time as a `Reading`, for `schedules.jumps`.

    A `Reading` holds numbers that depend on time; here, the value is the only number. The function
    `jumps` finds the times at which one of the numbers jumps.
    """
    return Reading(None, (signal(time),))
