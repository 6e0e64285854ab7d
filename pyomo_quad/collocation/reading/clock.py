"""Declared times of a horizon, the free times among them, and the phases between free times.

A declared time is a member of the model's continuous set, and usually a physical time. A free time
is a declared time whose physical time is a static variable (variable without time). Free times
inside the horizon divide it into phases. The fraction of the horizon is 0 at the first and 1 at the
last declared time. In each phase, physical time is a linear function of this fraction.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any

from pyomo_quad.collocation.errors import TranscriptionError


def index_tuple(index: Any) -> tuple[Any, ...]:
    """Return a Pyomo index as a tuple: () for None, one item for a scalar."""
    if index is None:
        return ()
    return index if isinstance(index, tuple) else (index,)


def is_over(component: Any, time: Any) -> bool:
    """Return whether the continuous set `time` itself indexes a component.

    The result is False for an index by a different set, even if that set has the same members.
    """
    return component.is_indexed() and any(part is time for part in component.index_set().subsets())


# Least distance, as a fraction of the horizon, between two consecutive declared times if one of
# them is free.
LEAST_PHASE = 1e-6


@dataclass(frozen=True, kw_only=True)
class PhaseTimes:
    """Phases of a horizon: the declared times that bound them, and physical time in CasADi symbols.

    Attributes
    ----------
    name : str
        Name of the continuous set.
    declared : tuple of float
        Declared times that bound the phases, start and end included.
    times : tuple
        Their physical times, as CasADi expressions.
    fraction : SX
        Symbol of the fraction of the horizon.
    phases : tuple of SX
        One symbol per phase, 1 in this phase and 0 elsewhere; empty for a single phase.
    is_free : bool
        Whether any time is free.
    """

    name: str
    declared: tuple[float, ...]
    times: tuple[Any, ...]
    fraction: Any
    phases: tuple[Any, ...] = ()
    is_free: bool = False

    @property
    def fractions(self) -> tuple[float, ...]:
        """Declared times that bound the phases, as fractions of the horizon."""
        return tuple(self.fraction_of(time) for time in self.declared)

    def fraction_of(self, time: float) -> float:
        """Return a declared time as a fraction of the horizon."""
        return (time - self.declared[0]) / (self.declared[-1] - self.declared[0])

    @cached_property
    def _spans(self) -> list[Any]:
        """CasADi expressions for d (physical time) / d (fraction of the horizon), one per phase.

        The derivative is constant within a phase.
        """
        ends = zip(pairwise(self.times), pairwise(self.fractions), strict=True)
        return [(after - before) / (last - first) for (before, after), (first, last) in ends]

    @property
    def _phase_factors(self) -> tuple[Any, ...]:
        """One factor per phase: a CasADi symbol, 1 at times of the phase and 0 elsewhere.

        A single phase has the number 1 as its factor.
        """
        return self.phases or (1.0,)

    @cached_property
    def span(self) -> Any:
        """Derivative of physical time with respect to the fraction of the horizon.

        The result is a single CasADi expression for all phases, which contains the symbols
        `phases`.
        """
        return sum(p * span for p, span in zip(self._phase_factors, self._spans, strict=True))

    @cached_property
    def time(self) -> Any:
        """Physical time as a CasADi expression of the fraction of the horizon and free times."""
        return sum(
            holds * (start + span * (self.fraction - first))
            for holds, start, span, first in zip(
                self._phase_factors, self.times, self._spans, self.fractions, strict=False
            )
        )

    def span_at(self, time: float) -> Any:
        """Return d (physical time) / d (fraction of the horizon) just before a declared time.

        At the first declared time, the derivative just after it is returned. The result is a CasADi
        expression of free times and parameters.
        """
        return self._spans[self.phase_of(time)]

    def time_at(self, time: float) -> Any:
        """Return the physical time that corresponds to a declared time, as a CasADi expression."""
        k = self.phase_of(time)
        return self.times[k] + self._spans[k] * (self.fraction_of(time) - self.fractions[k])

    def phase_of(self, time: float) -> int:
        """Return the index, from 0, of the phase that contains a time.

        `time` is in the range of the continuous set, but need not be its member. A boundary of two
        phases belongs to the phase that ends there.
        """
        return bisect_left(self.declared[1:-1], time)

    def label(self, position: int) -> str:
        """Return a declared time as text for messages, such as ``t[2.5]``.

        `position` is the index of the time in the attribute `declared`.
        """
        return f"{self.name}[{self.declared[position]:g}]"

    def orders(self) -> list[tuple[str, Any]]:
        """Return constraints that give every phase of the horizon a positive duration.

        Each item is a name and a CasADi expression >= 0: the duration of the phase minus 1e-6 times
        the duration of the horizon. There are none for a single phase.
        """
        whole = LEAST_PHASE * (self.times[-1] - self.times[0])
        if not self.phases:
            return []
        return [
            (f"{self.label(k)} before {self.label(k + 1)}", after - before - whole)
            for k, (before, after) in enumerate(pairwise(self.times))
        ]


#: Declared time -> static variable that replaces it, for a model with one continuous set; or such a
#: mapping for each set, by the set's name.
FreeTimes = Mapping[Any, Any]


def free_times(
    sets: tuple[Any, ...], final_time: Any, times: FreeTimes | None
) -> dict[str, dict[float, Any]]:
    """Return the free times as {name of a continuous set: {declared time: static variable}}.

    `times` has the same form, or {declared time: variable} for a single set. `final_time` is the
    variable for the end.

    Raises
    ------
    TranscriptionError
        If a set or time is not declared, or a variable not static.
    """
    given: dict[str, dict[float, Any]] = {s.name: {} for s in sets}
    if final_time is not None:
        only = _only(sets, "final_time")
        given[only.name][float(only.last())] = final_time
    for key, named in (times or {}).items():
        if isinstance(named, Mapping):
            chosen = _set_named(sets, str(key))
            given[chosen.name] |= {_declared(chosen, at): v for at, v in named.items()}
        else:
            chosen = _only(sets, "times")
            given[chosen.name][_declared(chosen, key)] = named
    for time in sets:
        _refuse_unusable(time, sets, given[time.name])
    return given


def _only(sets: tuple[Any, ...], argument: str) -> Any:
    """Return the only continuous set; raise an error if there are none or several.

    The user's argument named `argument` requires a single continuous set.
    """
    if not sets:
        raise TranscriptionError(
            f"{argument}: the model has no ContinuousSet whose times could be free; leave it out."
        )
    if len(sets) > 1:
        names = ", ".join(s.name for s in sets)
        raise TranscriptionError(
            f"{argument}: the model has several ContinuousSets, {names}; name the set as in "
            f'times={{"{sets[0].name}": {{{sets[0].last():g}: m.T}}}}.'
        )
    return sets[0]


def _set_named(sets: tuple[Any, ...], name: str) -> Any:
    """Return the continuous set of the given name; raise an error if the model has none."""
    for time in sets:
        if time.name == name:
            return time
    known = ", ".join(s.name for s in sets)
    raise TranscriptionError(
        f"times: {name} is not a ContinuousSet of the model, which has {known or 'none'}; give "
        "its full name."
    )


def _declared(time: Any, at: Any) -> float:
    """Return the member of the set `time` that equals `at`; raise an error if none does."""
    found = [float(t) for t in time if t == at]
    if not found:
        known = ", ".join(f"{t:g}" for t in sorted(time))
        raise TranscriptionError(
            f"times: {at} is not a declared time of {time.name}, which are {known}; declare it "
            "with initialize=."
        )
    return found[0]


def _refuse_unusable(time: Any, sets: tuple[Any, ...], given: dict[float, Any]) -> None:
    """Raise an error if a variable cannot serve as the physical time of a declared time.

    `sets` has all continuous sets of the model. `given` maps declared times of `time` to variables.
    A variable is unusable if a set indexes it or `given` repeats it.
    """
    taken: dict[str, float] = {}
    for at, variable in given.items():
        is_static = getattr(variable, "is_variable_type", bool)() and not variable.is_indexed()
        if not is_static or any(is_over(variable.parent_component(), s) for s in sets):
            raise TranscriptionError(
                f"{getattr(variable, 'name', variable)}: {time.name}[{at:g}], a free time, must be "
                "a static variable, a Var that is not over time."
            )
        if variable.name in taken:
            raise TranscriptionError(
                f"times: {variable.name} is given for {time.name}[{taken[variable.name]:g}] and "
                f"{time.name}[{at:g}], which leaves no time between them; give each its own Var."
            )
        taken[variable.name] = at
