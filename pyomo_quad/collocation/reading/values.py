"""Numerical values for the compiled equations, from the Pyomo model or from the caller."""

from __future__ import annotations

from bisect import bisect_left
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
    """Data of a single solve: parameters, horizon, fixed values and time-dependent parameters.

    Attributes
    ----------
    parameters : ndarray, shape (n_parameters,)
        Values of the parameters without time.
    horizon : (float, float)
        Start and end, as physical times.
    fixed : dict
        (Variable name, fraction of the horizon) -> fixed value.
    overrides : mapping
        Full name -> number or function of time, from the caller.
    jumps : tuple of float
        Fractions of the horizon at which a parameter may jump.
    left_out : frozenset of str
        Names of redundant conditions, which are not imposed.
    """

    parameters: FloatArray
    horizon: tuple[float, float]
    fixed: dict[tuple[str, float], float]
    overrides: Mapping[str, float | Callable[[float], float]]
    jumps: tuple[float, ...]
    left_out: frozenset[str] = frozenset()

    def __getstate__(self) -> dict[str, Any]:
        """Return the attributes that a pickle keeps.

        Piecewise polynomials replace functions of time, because a Python function may not be
        picklable.
        """
        return vars(self) | {
            "overrides": {n: self._picklable(n, v) for n, v in self.overrides.items()}
        }

    def __deepcopy__(self, memo: dict[int, Any]) -> Instance:
        """Return this object itself, since it is immutable."""
        return self

    def _picklable(
        self, name: str, given: float | Callable[[float], float]
    ) -> float | Interpolant | Steps:
        """Return a parameter's value from the caller in a form that can be pickled.

        Numbers, `Interpolant` and `Steps` objects are returned unchanged. Any other function of
        time becomes an `Interpolant` over the horizon.
        """
        if not callable(given) or isinstance(given, Interpolant | Steps):
            return given
        start, end = self.horizon
        at = [start + (end - start) * fraction for fraction in self.jumps]
        return interpolant(name, lambda t: (float(given(t)),), self.horizon, at)


class ModelValues:
    """Values of the parameters and variables in a Pyomo model, to read and to write.

    Methods that return a sequence of values use the order that the compiled equations expect. A
    free time is a member of the continuous set whose physical time is a variable. The argument
    `overrides` has the caller's parameter values, by component or full name. The argument `horizon`
    is the physical start and end of the horizon.

    Parameters
    ----------
    source : LiveModel or ModelSnapshot
        The Pyomo model, or the values that a pickle keeps.
    declared : Declarations
        The model in CasADi symbols, from which the equations are compiled.
    """

    def __init__(self, source: LiveModel | ModelSnapshot, declared: Declarations) -> None:
        self._source = source
        self._declared = declared
        # Cache of names looked up: parsing them again takes a tenth of a warm re-solve's time.
        self._known: set[str] = set()
        self._widest = self.declared_horizon

    @property
    def declared_horizon(self) -> tuple[float, float]:
        """Start and end of the continuous set; 0 and 1 for a model without time."""
        times = self._source.times
        return (times[0], times[-1]) if times else (0.0, 1.0)

    def parameters(
        self, overrides: Overrides | None, horizon: tuple[float, float] | None
    ) -> FloatArray:
        """Return the values of the parameters without time, shape (n_parameters,).

        Values in `overrides` replace those of the model. Start and end of the horizon are
        parameters, too, unless they are free times. `horizon` gives their values; by default, it is
        the range of the continuous set.

        Raises
        ------
        TranscriptionError
            If a parameter has no value, or if `by_name` raises the error for `overrides`.
        """
        named = self.by_name(overrides)
        start, end = horizon or self.declared_horizon
        # If a static variable is the start or the end, the model has no such parameter.
        ends = {"horizon.start": start, "horizon.end": end}
        return np.array([self._parameter(slot, named, ends) for slot in self._declared.parameters])

    def by_name(self, overrides: Overrides | None) -> dict[str, Any]:
        """Return the caller's parameter values by full name.

        The keys of `overrides` are full names or Pyomo components.

        Raises
        ------
        TranscriptionError
            If the model has no component of a given name, or this component is an immutable
            parameter. It is also raised if a value is a function of time although times are free.
        """
        named = {
            key.name
            if isinstance(key, Component) or hasattr(key, "parent_component")
            else str(key): float(value(v)) if isinstance(v, NumericValue) else v
            for key, v in (overrides or {}).items()
        }
        if self._declared.clock.is_free and any(callable(v) for v in named.values()):
            raise TranscriptionError(
                "parameters: a function of time is not allowed if times are free, because they "
                "move its values; declare the function as the parameter's rule."
            )
        # Overrides of other components than mutable parameters and fixed variables have no effect.
        for name in named.keys() - self._known:
            if not self._source.has(name):
                raise TranscriptionError(
                    f"parameters: {name!r} is not a component of the model; give the full name of "
                    "a mutable Param."
                )
            if self._source.is_constant(name):
                raise TranscriptionError(
                    f"parameters: {name!r} is a Param whose value is compiled into the equations; "
                    "declare it with mutable=True to solve for another value."
                )
            self._known.add(name)
        return named

    def _parameter(self, slot: Slot, named: dict[str, Any], ends: dict[str, float]) -> float:
        """Return the value of one parameter without time.

        `ends` has the values of the parameters ``horizon.start`` and ``horizon.end``. `named` has
        the caller's values by full name. The value comes from `ends`, `named` or the model, in this
        order.
        """
        if slot.name in ends:
            return ends[slot.name]
        if slot.name in named:
            return float(value(named[slot.name]))
        return _present(slot.name, self._source.parameter(slot))

    def signals(self, instance: Instance) -> Callable[[float], list[float]]:
        """Return the time-dependent data as a function of the fraction of the horizon.

        The data are the parameters over time, then the values of `Declarations.scheduled`. The
        latter are data of rules that branch on time, and indicators of the phases. At a jump, the
        values are those just before it. `instance` has the caller's parameter values and the
        horizon.

        Raises
        ------
        TranscriptionError
            If the caller gave no value for a parameter over time, and the model has no usable one.
            Usable are a constant, and a rule that returns the model's values. The returned function
            raises the error if a rule fails, or returns an expression that was not compiled.
        """
        start, end = self._rule_horizon(instance.horizon)
        found = self._signal_functions(instance.overrides)
        is_stepwise, members = self._declared.clock.is_free, self._source.times
        rows: dict[int, list[float]] = {}

        def scheduled(time: float) -> list[float]:
            return [number for said in self._source.schedules for number in said.row(time)]

        def at(fraction: float) -> list[float]:
            time = start + (end - start) * one_sided(fraction, instance.jumps)
            if not is_stepwise:
                return [*(signal(time) for signal in found), *scheduled(time)]
            # With free times, the results of rules change at declared times only.
            interval = bisect_left(members, time)
            if interval not in rows:
                rows[interval] = scheduled(time)
            return [*(signal(time) for signal in found), *rows[interval]]

        return at

    def jumps(
        self, overrides: Overrides | None, horizon: tuple[float, float] | None
    ) -> tuple[float, ...]:
        """Return the rising fractions of the horizon at which time-dependent data may jump.

        These include members of the continuous set inside the horizon. An override that is a
        `Steps` object, a piecewise constant function, contributes no jumps: simulations restart at
        its steps instead. Without time-dependent data, the result is empty. `horizon` is by default
        the range of the continuous set.
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
        """Return start and end of the range of times with which rules of the model are called.

        If some times are free (their physical times are variables), it is the range of the
        continuous set. Otherwise it is `horizon`.
        """
        # With free times, the physical times are unknown.
        found = self.declared_horizon if self._declared.clock.is_free else horizon
        # The smallest range that contains all ranges returned so far.
        # In a pickle, piecewise polynomials replace the rules over this range.
        self._widest = min(self._widest[0], found[0]), max(self._widest[1], found[1])
        return found

    def _signal_functions(self, overrides: Overrides | None) -> list[Callable[[float], float]]:
        """Return each parameter over time as a function of time.

        Values from the caller (`overrides`) take precedence over the rules in the model.
        """
        if not self._declared.signals:
            return []
        named = self.by_name(overrides)
        return [self._signal(slot, named) for slot in self._declared.signals]

    def _signal(self, slot: Slot, named: dict[str, Any]) -> Callable[[float], float]:
        """Return a parameter over time as a function of time.

        `slot` identifies the parameter. `named` has the caller's values by full name, which take
        precedence over the rules in the model.
        """
        if slot.name in named:
            given = named[slot.name]
            if isinstance(given, Steps):
                return given
            return (lambda t: float(given(t))) if callable(given) else (lambda _t: float(given))
        return self._source.signal(slot)

    def fixed(self) -> dict[tuple[str, float], float]:
        """Return the values of states that a user fixed at members of the continuous set.

        The keys are (variable name, fraction of the horizon). If a fixed state has no value, a
        TranscriptionError is raised.
        """
        first, last = self.declared_horizon
        slots = {s.name: s for s in self._declared.varying}
        found: dict[tuple[str, float], float] = {}
        for name, fraction in self._declared.fixed:
            time = self._declared_time(first, last, fraction)
            found[name, fraction] = _present(name, self._source.variable(slots[name], time))
        return found

    def _declared_time(self, first: float, last: float, fraction: float) -> float:
        """Return the member of the continuous set nearest to a fraction of the horizon.

        `first` and `last` are the first and the last member of the set.
        """
        wanted = first + (last - first) * fraction
        return min(self._source.times, key=lambda t: abs(t - wanted))

    def initial_values(self, slot: Slot) -> list[tuple[float, float]]:
        """Return a variable's values in the model, as pairs (fraction of the horizon, value).

        Members of the continuous set at which the variable has no value are left out.
        """
        first, last = self.declared_horizon
        pairs = []
        for time in self._source.times:
            held = self._source.variable(slot, time)
            if held is not None:
                pairs.append(((time - first) / (last - first), held))
        return pairs

    def first_guesses(self, slot: Slot, fractions: FloatArray) -> FloatArray | None:
        """Return the values of a variable's `initialize` rule at fractions of the horizon.

        The result is None if `LiveModel.first_guess` finds no usable rule. It is also None if the
        rule fails or is not finite at one of the fractions.
        """
        first, last = self.declared_horizon
        guess = self._source.first_guess(slot)
        if guess is None:
            return None
        try:
            found = np.array([guess(first + (last - first) * float(f)) for f in fractions])
        # The rule may look up values at members of the continuous set.
        except TranscriptionError:
            return None
        return found if np.all(np.isfinite(found)) else None

    def static_value(self, slot: Slot) -> float | None:
        """Return the value in the model of a variable without time, None if it has no value."""
        return self._source.variable(slot)

    def declared_fractions(self) -> list[float]:
        """Return the members of the continuous set (declared times) as fractions of the horizon."""
        first, last = self.declared_horizon
        return [(t - first) / (last - first) for t in self._source.times]

    def load(self, slot: Slot, fraction: float | None, number: float) -> None:
        """Set a variable of the Pyomo model at one time to its solved value.

        A fixed variable keeps its value. `fraction` is the time as a fraction of the horizon, None
        for a variable without time.
        """
        time = None
        if fraction is not None:
            time = self._declared_time(*self.declared_horizon, fraction)
        self._source.load(slot, time, number)

    def load_rates(self, fraction: float, rate: Callable[..., float]) -> None:
        """Set the model's derivatives at a declared time (a member of the continuous set).

        `fraction` is the time as a fraction of the horizon. `rate(name, index=...)` returns the
        solved value of a derivative; the index is (i,) for ``x[i, t]``.
        """
        self._source.load_rates(self._declared_time(*self.declared_horizon, fraction), rate)

    def load_integrals(self, totals: Mapping[str, float]) -> None:
        """Set the model's integrals to their solved values, given by full name."""
        self._source.load_integrals(totals)

    def snapshot(self) -> ModelSnapshot:
        """Return the model's current values, for a pickle.

        Functions of time become piecewise polynomials. Their range contains the continuous set and
        the horizons of all solves so far.
        """
        return self._source.snapshot(self._declared, self._widest)


def _present(name: str, number: float | None) -> float:
    """Return the value of a component, or raise an error if it has no value."""
    if number is None:
        raise TranscriptionError(f"{name}: has no value; give it one before the solve.")
    return number
