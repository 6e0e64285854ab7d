"""What a continuous model declares, in CasADi symbols and free of Pyomo.

Everything is written over the unit horizon: `rate` symbols are derivatives with respect to
the fraction of the horizon, and physical time is `start + span * fraction`, where the span
is a parameter or, with a free final time, a static variable.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

__all__ = [
    "Declarations",
    "Integral",
    "PathEquation",
    "PointCondition",
    "PointSymbol",
    "Slot",
]


@dataclass(frozen=True, kw_only=True)
class Slot:
    """One scalar function of time (or static scalar): its name and its symbol.

    `bounds` are CasADi expressions of the parameters; `nominal` is a magnitude for scaling or
    None.
    """

    name: str
    component: str
    index: tuple[Any, ...]
    symbol: Any
    lower: Any = None
    upper: Any = None
    nominal: float | None = None
    rate: Any = None


@dataclass(frozen=True, kw_only=True)
class PathEquation:
    """A relation lower <= expression <= upper imposed at every collocation point."""

    name: str
    expression: Any
    lower: Any
    upper: Any
    is_equality: bool


@dataclass(frozen=True, kw_only=True)
class PointSymbol:
    """The value (or rate) of a slot at one declared time, as a fraction of the horizon."""

    slot: str
    fraction: float
    is_rate: bool
    symbol: Any


@dataclass(frozen=True, kw_only=True)
class PointCondition:
    """A relation among values at declared times, static variables and integrals."""

    name: str
    expression: Any
    lower: Any
    upper: Any


@dataclass(frozen=True, kw_only=True)
class Integral:
    """An integral over the horizon: its symbol in conditions and its integrand."""

    name: str
    symbol: Any
    integrand: Any


@dataclass(frozen=True, kw_only=True)
class Declarations:
    """A continuous model as the transcription needs it.

    `fixed` lists slots whose value a user fixed at a declared time, as (name, fraction); the
    value itself is read when the problem is solved.  `signals` are parameters over time,
    `scheduled` what else changes with time and is no formula of it, such as the numbers of a
    rule that looks them up.
    """

    states: tuple[Slot, ...]
    algebraics: tuple[Slot, ...]
    statics: tuple[Slot, ...]
    parameters: tuple[Slot, ...]
    signals: tuple[Slot, ...]
    scheduled: tuple[Slot, ...]
    fraction: Any
    span: Any
    start: Any
    equations: tuple[PathEquation, ...]
    conditions: tuple[PointCondition, ...]
    point_symbols: tuple[PointSymbol, ...]
    integrals: tuple[Integral, ...]
    objective: Any
    maximise: bool
    fixed: tuple[tuple[str, float], ...] = ()
    outputs: tuple[Slot, ...] = ()
    output_equations: tuple[PathEquation, ...] = ()
    output_starts: tuple[PointCondition, ...] = ()
    objective_name: str = ""
    has_horizon: bool = True

    @property
    def has_signals(self) -> bool:
        """Whether anything changes with time that is no formula of it."""
        return bool(self.signals or self.scheduled)

    @property
    def path_data(self) -> tuple[Any, ...]:
        """Symbols of the data of a point, in order: fraction, signals, schedules, parameters."""
        slots = (*self.signals, *self.scheduled, *self.parameters)
        return (self.fraction, *(s.symbol for s in slots))
