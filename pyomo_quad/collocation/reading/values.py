"""Numbers for the compiled equations, from the model or from the caller."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from pyomo.core import value
from pyomo.core.base.component import Component
from pyomo.core.expr.numvalue import NumericValue

from pyomo_quad.collocation.errors import TranscriptionError
from pyomo_quad.collocation.reading.model_source import as_reading
from pyomo_quad.collocation.reading.schedules import (
    BESIDE,
    Interpolant,
    Steps,
    interpolant,
    jumps,
    one_sided,
    probes,
)

if TYPE_CHECKING:
    from pyomo_quad.collocation.mesh import FloatArray
    from pyomo_quad.collocation.reading.model_source import LiveModel, ModelSnapshot
    from pyomo_quad.collocation.reading.symbols import Declarations, Slot

Overrides = Mapping[Any, float | Callable[[float], float]]


@dataclass(frozen=True, kw_only=True)
class Instance:
    """The numbers of one solve: parameters, horizon, fixed values and signals.

    `jumps` are the fractions of the horizon where a time-varying quantity may jump. `left_out`
    names the conditions that are not imposed because they follow from others.
    """

    parameters: FloatArray
    horizon: tuple[float, float]
    fixed: dict[tuple[str, float], float]
    overrides: Mapping[str, float | Callable[[float], float]]
    jumps: tuple[float, ...]
    left_out: frozenset[str] = frozenset()

    def __getstate__(self) -> dict[str, Any]:
        """Pickle functions of time as piecewise polynomials."""
        return vars(self) | {"overrides": {n: self._kept(n, v) for n, v in self.overrides.items()}}

    def __deepcopy__(self, memo: dict[int, Any]) -> Instance:
        """Return itself: it is immutable, and its functions are the caller's."""
        return self

    def _kept(
        self, name: str, given: float | Callable[[float], float]
    ) -> float | Interpolant | Steps:
        if not callable(given) or isinstance(given, Interpolant | Steps):
            return given
        start, end = self.horizon
        at = [start + (end - start) * fraction for fraction in self.jumps]
        return interpolant(name, lambda t: (float(given(t)),), self.horizon, at)


class ModelValues:
    """Returns the numbers of a model in the order of its declarations."""

    def __init__(self, source: LiveModel | ModelSnapshot, declared: Declarations) -> None:
        self._source = source
        self._declared = declared
        # Cache of names looked up: parsing them again takes a tenth of a warm re-solve's time.
        self._known: set[str] = set()
        self._widest = self.declared_horizon

    @property
    def declared_horizon(self) -> tuple[float, float]:
        """Start and end of the continuous set."""
        times = self._source.times
        return (times[0], times[-1]) if times else (0.0, 1.0)

    def parameters(
        self, overrides: Overrides | None, horizon: tuple[float, float] | None
    ) -> FloatArray:
        """Return parameter values, shape (n_parameters,).

        Raises
        ------
        TranscriptionError
            If an override names no mutable parameter of the model, or a value is missing.
        """
        named = self.by_name(overrides)
        start, end = horizon or self.declared_horizon
        ends = {"horizon.start": start, "horizon.end": end}
        return np.array([self._parameter(slot, named, ends) for slot in self._declared.parameters])

    def by_name(self, overrides: Overrides | None) -> dict[str, Any]:
        """Return new values of parameters by full name."""
        named = {
            key.name
            if isinstance(key, Component) or hasattr(key, "parent_component")
            else str(key): float(value(v)) if isinstance(v, NumericValue) else v
            for key, v in (overrides or {}).items()
        }
        if self._declared.clock.is_free and any(callable(v) for v in named.values()):
            raise TranscriptionError(
                "parameters: a function of time cannot be given where the times are free, which "
                "moves it; declare it as the parameter's rule."
            )
        for name in named.keys() - self._known:
            if not self._source.has(name):
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
        return _present(slot.name, self._source.parameter(slot))

    def signals(self, instance: Instance) -> Callable[[float], list[float]]:
        """Return the time-varying data as a function of the fraction of the horizon.

        Raises
        ------
        TranscriptionError
            If a parameter over time has neither a rule nor an override. Raised by the function, if
            a rule returns a form that was not compiled.
        """
        start, end = self._rule_horizon(instance.horizon)
        found = self._signal_functions(instance.overrides)

        def at(fraction: float) -> list[float]:
            time = start + (end - start) * one_sided(fraction, instance.jumps)
            scheduled = (number for said in self._source.schedules for number in said.row(time))
            return [*(signal(time) for signal in found), *scheduled]

        return at

    def jumps(
        self, overrides: Overrides | None, horizon: tuple[float, float] | None
    ) -> tuple[float, ...]:
        """Return the fractions of the horizon at which signals may jump.

        These are the declared times and the times at which a rule or parameter is found to jump.
        """
        if not self._declared.has_signals:
            return ()
        start, end = self._rule_horizon(horizon or self.declared_horizon)
        declared = [t for t in self._source.times[1:-1] if start < t < end]
        asked = probes([start, *declared, end])
        readings = [s.reading for s in self._source.schedules] + [
            partial(as_reading, signal)
            for signal in self._signal_functions(overrides)
            if not isinstance(signal, Steps)  # flights begin anew at its steps
        ]
        found = {t for reading in readings for t in jumps(reading, asked)}
        fractions = sorted((t - start) / (end - start) for t in found.union(declared))
        return tuple(f for k, f in enumerate(fractions) if k == 0 or f - fractions[k - 1] > BESIDE)

    def _rule_horizon(self, horizon: tuple[float, float]) -> tuple[float, float]:
        """Return the horizon in the rules' time, which is the declared one if any time is free."""
        found = self.declared_horizon if self._declared.clock.is_free else horizon
        self._widest = min(self._widest[0], found[0]), max(self._widest[1], found[1])
        return found

    def _signal_functions(self, overrides: Overrides | None) -> list[Callable[[float], float]]:
        if not self._declared.signals:
            return []
        named = self.by_name(overrides)
        return [self._signal(slot, named) for slot in self._declared.signals]

    def _signal(self, slot: Slot, named: dict[str, Any]) -> Callable[[float], float]:
        if slot.name in named:
            given = named[slot.name]
            if isinstance(given, Steps):
                return given
            return (lambda t: float(given(t))) if callable(given) else (lambda _t: float(given))
        return self._source.signal(slot)

    def fixed(self) -> dict[tuple[str, float], float]:
        """Return the values a user fixed at declared times, by slot name and fraction."""
        first, last = self.declared_horizon
        slots = {s.name: s for s in self._declared.varying}
        found: dict[tuple[str, float], float] = {}
        for name, fraction in self._declared.fixed:
            time = self._declared_time(first, last, fraction)
            found[name, fraction] = _present(name, self._source.variable(slots[name], time))
        return found

    def _declared_time(self, first: float, last: float, fraction: float) -> float:
        wanted = first + (last - first) * fraction
        return min(self._source.times, key=lambda t: abs(t - wanted))

    def initial_values(self, slot: Slot) -> list[tuple[float, float]]:
        """Return the (fraction, value) pairs that the model's variable holds."""
        first, last = self.declared_horizon
        pairs = []
        for time in self._source.times:
            held = self._source.variable(slot, time)
            if held is not None:
                pairs.append(((time - first) / (last - first), held))
        return pairs

    def first_guesses(self, slot: Slot, fractions: FloatArray) -> FloatArray | None:
        """Return the values of the variable's `initialize` rule at fractions of the horizon.

        None where it has no rule or holds other values, and where the rule has values at the
        declared times only.
        """
        first, last = self.declared_horizon
        guess = self._source.first_guess(slot)
        if guess is None:
            return None
        try:
            found = np.array([guess(first + (last - first) * float(f)) for f in fractions])
        except TranscriptionError:
            return None
        return found if np.all(np.isfinite(found)) else None

    def static_value(self, slot: Slot) -> float | None:
        """Return the value a static variable holds, None if it has none."""
        return self._source.variable(slot)

    def declared_fractions(self) -> list[float]:
        """Return the declared times as fractions of the horizon."""
        first, last = self.declared_horizon
        return [(t - first) / (last - first) for t in self._source.times]

    def load(self, slot: Slot, fraction: float | None, number: float) -> None:
        """Put a solved value into the model's variable, unless a user fixed it there."""
        time = None
        if fraction is not None:
            time = self._declared_time(*self.declared_horizon, fraction)
        self._source.load(slot, time, number)

    def load_rates(self, fraction: float, rate: Callable[..., float]) -> None:
        """Put solved rates, by component and index, into the model's derivatives at a time."""
        self._source.load_rates(self._declared_time(*self.declared_horizon, fraction), rate)

    def load_integrals(self, totals: Mapping[str, float]) -> None:
        """Set the model's integrals, by full name, to their solved totals."""
        self._source.load_integrals(totals)

    def snapshot(self) -> ModelSnapshot:
        """Return the model's present values, over the widest horizon requested so far."""
        return self._source.snapshot(self._declared, self._widest)


def _present(name: str, number: float | None) -> float:
    if number is None:
        raise TranscriptionError(f"{name}: has no value; give it one before the solve.")
    return number
