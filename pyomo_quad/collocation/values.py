"""Numbers for the compiled equations: read from the Pyomo model, or given by the caller."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from pyomo.core.base.component import Component
from pyomo.dae import DerivativeVar
from pyomo.environ import Var, value

from pyomo_quad.collocation.addresses import AddressBook
from pyomo_quad.collocation.errors import TranscriptionError
from pyomo_quad.collocation.rules import rule_of
from pyomo_quad.collocation.schedules import BESIDE, Reading, jumps, one_sided, probes

if TYPE_CHECKING:
    from pyomo_quad.collocation.declarations import Declarations, Slot
    from pyomo_quad.collocation.nodes import FloatArray
    from pyomo_quad.collocation.problem import Instance
    from pyomo_quad.collocation.schedules import Schedule

__all__ = ["ModelValues", "Overrides"]

Overrides = Mapping[Any, float | Callable[[float], float]]


class ModelValues:
    """Reads the current values of a Pyomo model in the order of its declarations.

    Parameters
    ----------
    model : ConcreteModel
        The user's model; values are read anew at every call.
    declared : Declarations
    time : ContinuousSet or None
        The model's continuous set.
    schedules : tuple of Schedule
        What gives the declarations' `scheduled` their values.
    """

    def __init__(
        self, model: Any, declared: Declarations, time: Any, schedules: tuple[Schedule, ...]
    ) -> None:
        self._model = model
        self._declared = declared
        self._time = time
        self._schedules = schedules
        self._addresses = AddressBook(time)
        # Names already looked up: parsing them again costs a warm re-solve a tenth of its time.
        self._known: set[str] = set()
        self._is_end_free = time is not None and all(
            p.name != "horizon.end" for p in declared.parameters
        )

    @property
    def declared_horizon(self) -> tuple[float, float]:
        """Start and end of the continuous set."""
        if self._time is None:
            return 0.0, 1.0
        times = sorted(self._time)
        return float(times[0]), float(times[-1])

    def parameters(
        self, overrides: Overrides | None, horizon: tuple[float, float] | None
    ) -> FloatArray:
        """Return parameter values, shape (n_parameters,).

        Raises
        ------
        TranscriptionError
            If an override names no mutable parameter of the model, or a value is missing.
        """
        named = self._by_name(overrides)
        start, end = horizon or self.declared_horizon
        ends = {"horizon.start": start, "horizon.end": end}
        return np.array([self._parameter(slot, named, ends) for slot in self._declared.parameters])

    def _by_name(self, overrides: Overrides | None) -> dict[str, Any]:
        named = {
            key.name
            if isinstance(key, Component) or hasattr(key, "parent_component")
            else str(key): v
            for key, v in (overrides or {}).items()
        }
        if self._is_end_free and any(callable(v) for v in named.values()):
            raise TranscriptionError(
                "parameters: a function of time cannot be given where the end time is free, which "
                "moves it; declare it as the parameter's rule."
            )
        for name in named.keys() - self._known:
            if self._model.find_component(name) is None:
                raise TranscriptionError(
                    f"parameters: {name!r} is not a component of the model; give the full name of "
                    "a mutable Param."
                )
            self._known.add(name)
        return named

    def _parameter(self, slot: Slot, named: dict[str, Any], ends: dict[str, float]) -> float:
        if slot.name in ends:
            return ends[slot.name]
        if slot.name in named:
            return float(value(named[slot.name]))
        found = value(self._data(slot), exception=False)
        if found is None:
            raise TranscriptionError(f"{slot.name}: has no value; give it one before the solve.")
        return float(found)

    def _data(self, slot: Slot, time: float | None = None) -> Any:
        component = self._model.find_component(slot.component)
        if time is not None:
            return component[self._addresses.join(component, slot.index, time)]
        if not slot.index:
            return component
        return component[slot.index if len(slot.index) > 1 else slot.index[0]]

    def signals(self, instance: Instance) -> Callable[[float], list[float]]:
        """Return what changes with time as a function of the fraction of the horizon.

        Raises
        ------
        TranscriptionError
            If a parameter over time has no rule and no override to evaluate it at any time; the
            function, if a rule says something that was not compiled.
        """
        start, end = self._rule_horizon(instance.horizon)
        found = self._signal_functions(instance.overrides)

        def at(fraction: float) -> list[float]:
            time = start + (end - start) * one_sided(fraction, instance.jumps)
            scheduled = (number for schedule in self._schedules for number in schedule.row(time))
            return [*(signal(time) for signal in found), *scheduled]

        return at

    def jumps(
        self, overrides: Overrides | None, horizon: tuple[float, float] | None
    ) -> tuple[float, ...]:
        """Return where signals may jump, as fractions of the horizon.

        These are the declared times, and where a rule or parameter is found to jump.
        """
        if not self._declared.has_signals:
            return ()
        start, end = self._rule_horizon(horizon or self.declared_horizon)
        declared = [float(t) for t in sorted(self._time)[1:-1] if start < t < end]
        asked = probes([start, *declared, end])
        readings = [s.reading for s in self._schedules] + [
            partial(_reading, signal) for signal in self._signal_functions(overrides)
        ]
        found = {t for reading in readings for t in jumps(reading, asked)}
        fractions = sorted((t - start) / (end - start) for t in found.union(declared))
        return tuple(f for k, f in enumerate(fractions) if k == 0 or f - fractions[k - 1] > BESIDE)

    def _rule_horizon(self, horizon: tuple[float, float]) -> tuple[float, float]:
        """Return the horizon in the time of rules: a free end stretches the declared times."""
        return self.declared_horizon if self._is_end_free else horizon

    def _signal_functions(self, overrides: Overrides | None) -> list[Callable[[float], float]]:
        if not self._declared.signals:
            return []
        named = self._by_name(overrides)
        return [self._signal(slot, named) for slot in self._declared.signals]

    def _signal(self, slot: Slot, named: dict[str, Any]) -> Callable[[float], float]:
        if slot.name in named:
            given = named[slot.name]
            return (lambda t: float(given(t))) if callable(given) else (lambda _t: float(given))
        component = self._model.find_component(slot.component)
        rule, block, join = rule_of(component), component.parent_block(), self._addresses.join
        held = [float(value(self._data(slot, t))) for t in self._time]
        if rule is None:
            if len(set(held)) == 1:
                return lambda _t: held[0]
            raise TranscriptionError(
                f"{slot.name}: a parameter over time needs a value at any time; declare it with "
                "initialize= a function of time."
            )

        def signal(t: float) -> float:
            try:
                return float(value(rule(block, join(component, slot.index, t))))
            except Exception as error:
                raise TranscriptionError(
                    f"{slot.name}: its rule fails at time {t:g} ({error}); a parameter over time "
                    "needs a value at any time: declare it with initialize= a function of time "
                    "that reads nothing but its time and parameters without time."
                ) from error

        if held != [signal(float(t)) for t in self._time]:
            raise TranscriptionError(
                f"{slot.name}: was changed after its rule made it; give parameters= a function of "
                "time, or declare it anew."
            )
        return signal

    def fixed(self) -> dict[tuple[str, float], float]:
        """Return the values a user fixed at declared times, by slot name and fraction."""
        first, last = self.declared_horizon
        slots = {s.name: s for s in self._every_slot()}
        return {
            (name, fraction): float(
                value(self._data(slots[name], self._declared_time(first, last, fraction)))
            )
            for name, fraction in self._declared.fixed
        }

    def _declared_time(self, first: float, last: float, fraction: float) -> float:
        wanted = first + (last - first) * fraction
        return float(min(self._time, key=lambda t: abs(t - wanted)))

    def _every_slot(self) -> tuple[Slot, ...]:
        d = self._declared
        return (*d.states, *d.algebraics, *d.outputs)

    def initial_values(self, slot: Slot) -> list[tuple[float, float]]:
        """Return the (fraction, value) pairs that the model's variable holds."""
        first, last = self.declared_horizon
        pairs = []
        for time in sorted(self._time):
            held = self._data(slot, time).value
            if held is not None:
                pairs.append(((time - first) / (last - first), float(held)))
        return pairs

    def static_value(self, slot: Slot) -> float | None:
        """Return the value a static variable holds, None if it has none."""
        component = self._model.find_component(slot.component)
        if component.ctype is not Var:
            return None
        held = self._data(slot).value
        return None if held is None else float(held)

    def declared_fractions(self) -> list[float]:
        """Return the declared times as fractions of the horizon."""
        if self._time is None:
            return []
        first, last = self.declared_horizon
        return [(float(t) - first) / (last - first) for t in sorted(self._time)]

    def load(self, slot: Slot, fraction: float | None, number: float) -> None:
        """Put a solved value into the model's variable, unless a user fixed it there."""
        if self._model.find_component(slot.component).ctype is not Var:
            return
        if fraction is None:
            data = self._data(slot)
        else:
            data = self._data(slot, self._declared_time(*self.declared_horizon, fraction))
        if not data.fixed:
            data.set_value(number, skip_validation=True)

    def load_rates(self, fraction: float, rate: Callable[..., float]) -> None:
        """Put solved rates, by component and index, into the model's derivatives at a time."""
        time = self._declared_time(*self.declared_horizon, fraction)
        for derivative in self._model.component_objects(DerivativeVar, descend_into=True):
            for position in derivative:
                address = self._addresses.split(derivative, position)
                if address.time == time:
                    number = rate(derivative.name, index=address.index)
                    derivative[position].set_value(number, skip_validation=True)


def _reading(signal: Callable[[float], float], time: float) -> Reading:
    return Reading(None, (signal(time),))
