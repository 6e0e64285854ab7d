"""How a share of the horizon becomes a time: straight lines between times that may be free."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any

from pyomo_quad.collocation.errors import TranscriptionError

# Of the whole horizon: the least that is left between two times of which one is free.
LEAST_PHASE = 1e-6


@dataclass(frozen=True, kw_only=True)
class Clock:
    """Phases of the horizon, each as long as its ends say; which one holds is data of a point.

    Attributes
    ----------
    name : str
        Of the continuous set.
    declared : tuple of float
        Declared times between which time runs evenly, the first and the last among them.
    times : tuple
        What they are, in CasADi symbols.
    fraction : SX
        Symbol of the share of the declared horizon.
    phases : tuple of SX
        A symbol for each phase, 1 where it holds and 0 elsewhere; none for a single phase.
    is_free : bool
        Whether any of the times is a static variable.
    """

    name: str
    declared: tuple[float, ...]
    times: tuple[Any, ...]
    fraction: Any
    phases: tuple[Any, ...] = ()
    is_free: bool = False

    @property
    def fractions(self) -> tuple[float, ...]:
        """Declared times as shares of the declared horizon."""
        return tuple(self.fraction_of(time) for time in self.declared)

    def fraction_of(self, time: float) -> float:
        """Return a declared time as a share of the declared horizon."""
        return (time - self.declared[0]) / (self.declared[-1] - self.declared[0])

    @cached_property
    def _spans(self) -> list[Any]:
        """Change of time with the share of the horizon, phase by phase."""
        ends = zip(pairwise(self.times), pairwise(self.fractions), strict=True)
        return [(after - before) / (last - first) for (before, after), (first, last) in ends]

    @property
    def _holds(self) -> tuple[Any, ...]:
        return self.phases or (1.0,)

    @cached_property
    def span(self) -> Any:
        """Change of time with the share of the horizon at the template point."""
        return sum(p * span for p, span in zip(self._holds, self._spans, strict=True))

    @cached_property
    def time(self) -> Any:
        """Physical time at the template point."""
        return sum(
            holds * (start + span * (self.fraction - first))
            for holds, start, span, first in zip(
                self._holds, self.times, self._spans, self.fractions, strict=False
            )
        )

    def span_at(self, time: float) -> Any:
        """Return the change of time with the share of the horizon just before a declared time."""
        return self._spans[self.phase_of(time)]

    def time_at(self, time: float) -> Any:
        """Return what a declared time becomes."""
        k = self.phase_of(time)
        return self.times[k] + self._spans[k] * (self.fraction_of(time) - self.fractions[k])

    def phase_of(self, time: float) -> int:
        """Return the position of the phase that holds at a declared time, or ends there."""
        return bisect_left(self.declared[1:-1], time)

    def label(self, position: int) -> str:
        """Return the name of one of the declared times."""
        return f"{self.name}[{self.declared[position]:g}]"

    def orders(self) -> list[tuple[str, Any]]:
        """Return what must not be negative for the phases to follow each other, by name."""
        whole = LEAST_PHASE * (self.times[-1] - self.times[0])
        if not self.phases:
            return []
        return [
            (f"{self.label(k)} before {self.label(k + 1)}", after - before - whole)
            for k, (before, after) in enumerate(pairwise(self.times))
        ]


#: Declared time -> the static variable that it is to be, of a model with one continuous set; or
#: that for each set, by its name.
FreeTimes = Mapping[Any, Any]


def free_times(
    sets: tuple[Any, ...], final_time: Any, times: FreeTimes | None
) -> dict[str, dict[float, Any]]:
    """Return by continuous set the static variables that its declared times are to be.

    Raises
    ------
    TranscriptionError
        If a set or a time is not declared, or what gives it is no static variable.
    """
    given: dict[str, dict[float, Any]] = {s.name: {} for s in sets}
    if final_time is not None:
        only = _only(sets, "final_time")
        given[only.name][float(only.last())] = final_time
    for key, named in (times or {}).items():
        if isinstance(named, Mapping):
            chosen = _called(sets, str(key))
            given[chosen.name] |= {_declared(chosen, at): v for at, v in named.items()}
        else:
            chosen = _only(sets, "times")
            given[chosen.name][_declared(chosen, key)] = named
    for time in sets:
        _refuse_unusable(time, sets, given[time.name])
    return given


def _only(sets: tuple[Any, ...], argument: str) -> Any:
    if not sets:
        raise TranscriptionError(
            f"{argument}: the model has no ContinuousSet whose times could be free; leave it out."
        )
    if len(sets) > 1:
        names = ", ".join(s.name for s in sets)
        raise TranscriptionError(
            f"{argument}: the model has several ContinuousSets, {names}; say of which by its "
            f'name, as in times={{"{sets[0].name}": {{{sets[0].last():g}: m.T}}}}.'
        )
    return sets[0]


def _called(sets: tuple[Any, ...], name: str) -> Any:
    for time in sets:
        if time.name == name:
            return time
    known = ", ".join(s.name for s in sets)
    raise TranscriptionError(
        f"times: {name} is not a ContinuousSet of the model, which has {known or 'none'}; give "
        "its full name."
    )


def _declared(time: Any, at: Any) -> float:
    found = [float(t) for t in time if t == at]
    if not found:
        known = ", ".join(f"{t:g}" for t in sorted(time))
        raise TranscriptionError(
            f"times: {at} is not a declared time of {time.name}, which are {known}; declare it "
            "with initialize=."
        )
    return found[0]


def _refuse_unusable(time: Any, sets: tuple[Any, ...], given: dict[float, Any]) -> None:
    """Refuse what is no static variable, and one that is given for two times."""
    taken: dict[str, float] = {}
    for at, variable in given.items():
        is_static = getattr(variable, "is_variable_type", bool)() and not variable.is_indexed()
        if not is_static or _is_over(variable.parent_component(), sets):
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


def _is_over(component: Any, sets: tuple[Any, ...]) -> bool:
    return component.is_indexed() and any(
        part is time for part in component.index_set().subsets() for time in sets
    )
