"""What a rule says at different times: a few forms, which of them holds, and the numbers in it.

A rule that branches on its time, or looks numbers up by it, is no formula of time.  It is
called at many times; what it returns is sorted into forms, expressions alike but for their
numbers.  A form is compiled once; which form holds, and the numbers that differ, are signals:
data of every collocation point.  Where they jump is found by bisection.

As polynomials, between these jumps, such functions of time outlive the rules that give them.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections import OrderedDict
from dataclasses import dataclass, field
from itertools import pairwise
from math import ceil, floor
from typing import TYPE_CHECKING, Any

import casadi
import numpy as np
from numpy.polynomial import chebyshev
from pyomo.core.expr.numvalue import native_types

from pyomo_quad.collocation.errors import TranscriptionError
from pyomo_quad.collocation.reading.symbols import Slot

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from pyomo_quad.collocation.mesh import FloatArray
    from pyomo_quad.collocation.reading.copy import Clock

# Times, besides the declared ones, at which a rule is asked before anything is compiled.
_PROBES = 64
# Forms beyond which a rule is taken to say something else at every time.
_MOST_FORMS = 24
# Width, as a share of the horizon, within which a jump is bracketed.
_RESOLUTION = 1e-14
#: Distance from a jump, as a share of the horizon, that is one side of it and not the jump.
BESIDE = 2e-12
# A change that bisection leaves as large as this, and larger than rounding, is a jump.
_UNDIMINISHED = 0.75
_ROUNDING = 1e-9
# Times of which a schedule remembers what the rule said.
_REMEMBERED = 100_000


@dataclass(frozen=True, kw_only=True)
class Statement:
    """What a rule says at one time: Pyomo expressions, and whether they are an equality.

    Of a constraint these are lower bound, body and upper bound, None for no bound; of an
    expression over time it is one.
    """

    parts: tuple[Any, ...]
    is_equality: bool = False

    @property
    def is_silent(self) -> bool:
        """Whether it is a constraint that asks for nothing."""
        if len(self.parts) == 1:
            return False
        lower, body, upper = self.parts
        return lower is None and upper is None and body.__class__ in native_types


@dataclass(frozen=True)
class Reading:
    """The numbers that hold at one time, and a key of all else that does."""

    key: Any
    numbers: tuple[float, ...]


@dataclass(kw_only=True)
class _Form:
    """Statements that differ in numbers only: the first of them, and which numbers vary."""

    statement: Statement
    numbers: tuple[float, ...]
    varying: list[int] = field(default_factory=list)

    def meet(self, numbers: tuple[float, ...]) -> None:
        for k, (held, met) in enumerate(zip(self.numbers, numbers, strict=True)):
            if held != met and k not in self.varying:
                self.varying.append(k)


class Schedule:
    """What one rule says over time.

    Parameters
    ----------
    name : str
        Of the component, for messages and symbols.
    say : callable
        Time -> Statement.
    times : sequence of float
        Declared times; the rule is asked between them and on both sides of each.

    Attributes
    ----------
    slots : tuple of Slot
        The signals that the compiled forms read, in the order of `row`.

    Raises
    ------
    TranscriptionError
        If the rule has too many forms.
    """

    def __init__(
        self, name: str, say: Callable[[float], Statement], times: Sequence[float]
    ) -> None:
        self.name = name
        self._say = say
        self._forms: dict[Any, _Form] = {}
        self._is_compiled = False
        self._known: OrderedDict[float, Reading] = OrderedDict()
        for _ in jumps(self.reading, probes(times)):
            pass
        self._is_compiled = True
        self._known.clear()
        # One for a single form too: without any signal nobody would ask what holds at a time.
        self._chosen = [self._slot(f"form {k}") for k in range(max(len(self._forms) - 1, 1))]
        self._numbers = [
            [self._slot(f"form {k}, number {at}") for at in form.varying]
            for k, form in enumerate(self._forms.values())
        ]
        self.slots = (*self._chosen, *(s for slots in self._numbers for s in slots))

    def _slot(self, what: str) -> Slot:
        name = f"{self.name} ({what})"
        return Slot(name=name, component=self.name, index=(), symbol=casadi.SX.sym(name))

    @property
    def is_equality(self) -> bool:
        """Whether the rule states an equality at all times."""
        return all(f.statement.is_equality for f in self._forms.values())

    def reading(self, time: float) -> Reading:
        """Return what the rule says at a time.

        Raises
        ------
        TranscriptionError
            If it says what it said at none of the times asked before it was compiled.
        """
        if time not in self._known:
            statement = self._say(time)
            numbers: list[float] = []
            structure = tuple(_structure(part, numbers) for part in statement.parts)
            found = Reading((structure, statement.is_equality), tuple(numbers))
            self._sort(found, statement, time)
            if len(self._known) >= _REMEMBERED:
                self._known.popitem(last=False)
            self._known[time] = found
        return self._known[time]

    def _sort(self, found: Reading, statement: Statement, time: float) -> None:
        form = self._forms.get(found.key)
        if not self._is_compiled:
            if form is None:
                self._forms[found.key] = _Form(statement=statement, numbers=found.numbers)
            else:
                form.meet(found.numbers)
            if len(self._forms) > _MOST_FORMS:
                raise TranscriptionError(
                    f"{self.name}: its rule says something else at every time, more than "
                    f"{_MOST_FORMS} different things; let only numbers in it depend on time, or "
                    "declare a constraint for each part of the horizon."
                )
            return
        if form is None or any(
            held != met and k not in form.varying
            for k, (held, met) in enumerate(zip(form.numbers, found.numbers, strict=True))
        ):
            raise TranscriptionError(
                f"{self.name}: its rule says something at time {time:g} that it says at no time "
                "tried when the model was compiled; declare the times at which it changes in the "
                "ContinuousSet."
            )

    def row(self, time: float) -> list[float]:
        """Return the values of the slots at a time."""
        found = self.reading(time)
        row = [float(key == found.key) for key in list(self._forms)[: len(self._chosen)]]
        for key, form in self._forms.items():
            held = found.numbers if key == found.key else form.numbers
            row.extend(held[k] for k in form.varying)
        return row

    def written(self, write: Callable[[Any, Iterator[Any]], Any], absent: Sequence[Any]) -> Any:
        """Return the parts of the statement that holds, as CasADi expressions of the slots.

        `write` takes a part and what stands for its numbers, in their order; `absent` holds,
        part by part, what a missing one is.
        """
        forms = []
        for k, form in enumerate(self._forms.values()):
            symbols = {at: s.symbol for at, s in zip(form.varying, self._numbers[k], strict=True)}
            numbers = iter([symbols.get(at, held) for at, held in enumerate(form.numbers)])
            forms.append(
                [
                    casadi.SX(nothing if part is None else write(part, numbers))
                    for part, nothing in zip(form.statement.parts, absent, strict=False)
                ]
            )
        self._let_silent_ones_agree(forms)
        result = forms[-1]
        for k in reversed(range(len(forms) - 1)):
            holds = self._chosen[k].symbol
            result = [_either(holds, a, b) for a, b in zip(forms[k], result, strict=True)]
        return result

    def _let_silent_ones_agree(self, forms: list[list[Any]]) -> None:
        """Give forms without limits another's body: a limit on one variable remains a bound."""
        is_silent = [f.statement.is_silent for f in self._forms.values()]
        if any(is_silent) and not all(is_silent):
            body = forms[is_silent.index(False)][1]
            for parts, silent in zip(forms, is_silent, strict=True):
                if silent and _is_linear(body):
                    parts[1] = body


class Phases:
    """Which phase of a clock holds, read like a `Schedule`."""

    def __init__(self, clock: Clock) -> None:
        self.name = clock.name
        self.slots = tuple(
            Slot(name=phase.name(), component=clock.name, index=(), symbol=phase)
            for phase in clock.phases
        )
        self._clock = clock

    def reading(self, time: float) -> Reading:
        """Return which phase holds at a declared time."""
        return Reading(self._clock.phase_of(time), ())

    def row(self, time: float) -> list[float]:
        """Return the values of the slots at a declared time."""
        return [float(k == self._clock.phase_of(time)) for k in range(len(self.slots))]


def _is_linear(expression: Any) -> bool:
    symbols = casadi.symvar(expression)
    return bool(casadi.is_linear(expression, casadi.vertcat(casadi.SX(0, 1), *symbols)))


def _either(holds: Any, first: Any, second: Any) -> Any:
    is_same = casadi.is_equal(first, second, 1_000)
    return first if is_same else casadi.if_else(holds, first, second)


def _structure(part: Any, numbers: list[float]) -> Any:
    """Return a key of an expression without its numbers, and append these to a list."""
    if part is None:
        return None
    if part.__class__ in native_types:
        numbers.append(float(part))
        return "number"
    if not part.is_expression_type() or part.is_named_expression_type():
        return id(part)
    return type(part), part.getname(), *(_structure(a, numbers) for a in part.args)


def probes(times: Sequence[float]) -> list[float]:
    """Return times between and on both sides of declared ones."""
    span = times[-1] - times[0]
    between = np.linspace(times[0], times[-1], _PROBES + 1)[:-1] + 0.618 * span / _PROBES
    sides = [t + sign * BESIDE * span for t in times for sign in (-1.0, 1.0)]
    inner = sorted({*between.tolist(), *sides})
    return [t for t in inner if times[0] < t < times[-1]]


def jumps(reading: Callable[[float], Reading], times: Sequence[float]) -> Iterator[float]:
    """Yield where what is read jumps between times, in rising order."""
    for start, end in pairwise(times):
        resolution = _RESOLUTION * max(abs(times[0]), abs(times[-1]), times[-1] - times[0])
        yield from sorted(_jumps_between(reading, start, end, resolution))


def _jumps_between(
    reading: Callable[[float], Reading], start: float, end: float, resolution: float
) -> Iterator[float]:
    while reading(start).key != reading(end).key:
        before, after = start, end
        while after - before > resolution:
            middle = 0.5 * (before + after)
            is_before = reading(middle).key == reading(start).key
            before, after = (middle, after) if is_before else (before, middle)
        yield after
        yield from _steps(reading, start, before, resolution)
        start = after
    yield from _steps(reading, start, end, resolution)


def _steps(
    reading: Callable[[float], Reading], start: float, end: float, resolution: float
) -> Iterator[float]:
    """Yield where a number of one form jumps: its change stays when the interval is halved."""
    for k, (first, last) in enumerate(
        zip(reading(start).numbers, reading(end).numbers, strict=True)
    ):
        before, after, change = start, end, abs(last - first)
        negligible = _ROUNDING * max(abs(first), abs(last))
        while change > negligible and after - before > resolution:
            middle = 0.5 * (before + after)
            if reading(middle).key != reading(start).key:
                break
            low, number, high = (reading(t).numbers[k] for t in (before, middle, after))
            changes = abs(number - low), abs(high - number)
            if max(changes) < _UNDIMINISHED * change:
                break
            is_before = changes[0] < changes[1]
            before, after = (middle, after) if is_before else (before, middle)
            change = max(changes)
        else:
            if change > negligible:
                yield after


def one_sided(fraction: float, jumps_at: Sequence[float]) -> float:
    """Return a fraction of the horizon; one at a jump is moved to just before it.

    As a boundary of elements belongs to the one that it ends, so does a jump there; the start
    and the end of the horizon are moved inside.
    """
    inside = min(max(fraction, BESIDE), 1.0 - BESIDE)
    nearest = bisect_left(jumps_at, inside - BESIDE)
    if nearest < len(jumps_at) and jumps_at[nearest] <= inside + BESIDE:
        return jumps_at[nearest] - BESIDE
    return inside


@dataclass(frozen=True, kw_only=True)
class Steps:
    """A number that is constant over each of many equal steps, and held after the last.

    Parameters
    ----------
    start : float
        Time at which the first step begins.
    step : float
        Duration of each.
    values : tuple of float
        One for each step.
    """

    start: float
    step: float
    values: tuple[float, ...]

    def __call__(self, time: float) -> float:
        """Return the number at a time."""
        step = int((time - self.start) / self.step)
        return self.values[min(max(step, 0), len(self.values) - 1)]

    def edges(self, start: float, end: float) -> list[float]:
        """Return where steps begin between two times."""
        first = floor((start - self.start) / self.step) + 1
        last = min(ceil((end - self.start) / self.step), len(self.values))
        return [self.start + k * self.step for k in range(max(first, 1), last)]


_DEGREE = 12
# Largest error, relative to the values of a piece, and the width that no piece is halved below.
_ACCURACY = 1e-13
_NARROWEST = 1e-14
_MOST_PIECES = 20_000
_NODES = chebyshev.chebpts1(_DEGREE + 1)
_TO_COEFFICIENTS = np.linalg.inv(chebyshev.chebvander(_NODES, _DEGREE))
# Where a polynomial is compared with its function, on [-1, 1]: between its nodes.
_COMPARED = np.array([-0.97, -0.61, -0.28, 0.13, 0.52, 0.83, 0.99])


@dataclass(frozen=True, kw_only=True)
class Interpolant:
    """Numbers over time: Chebyshev coefficients between edges; of none, only why.

    The coefficients of a piece have shape (degree + 1, n_numbers); a jump is an edge, and
    belongs to the piece that it starts.
    """

    edges: tuple[float, ...]
    pieces: tuple[FloatArray, ...]
    refusal: str

    def row(self, time: float) -> list[float]:
        """Return the numbers at a time.

        Raises
        ------
        TranscriptionError
            If the time is outside the edges.
        """
        if not self.pieces or not self.edges[0] <= time <= self.edges[-1]:
            raise TranscriptionError(self.refusal)
        k = min(bisect_right(self.edges, time), len(self.pieces)) - 1
        start, end = self.edges[k], self.edges[k + 1]
        local = (2.0 * time - start - end) / (end - start)
        return np.asarray(chebyshev.chebval(local, self.pieces[k])).tolist()

    def reading(self, time: float) -> Reading:
        """Return the numbers at a time as what a rule says there."""
        return Reading(None, tuple(self.row(time)))

    def __call__(self, time: float) -> float:
        """Return the first number at a time."""
        return self.row(time)[0]


def interpolant(
    name: str,
    row: Callable[[float], Sequence[float]],
    horizon: tuple[float, float],
    jumps: Sequence[float],
) -> Interpolant:
    """Return what a function gives over a horizon; one that fails leaves its message.

    Between jumps, pieces are halved until a polynomial has their values: a kink is bracketed.
    """
    start, end = horizon
    refusal = (
        f"{name}: is known over [{start:g}, {end:g}] only, since its rule was not pickled; stay "
        "within these times, or compile the model again."
    )
    edges, pieces = [start], []
    waiting = list(pairwise([start, *(t for t in jumps if start < t < end), end]))[::-1]
    try:
        while waiting:
            first, last = waiting.pop()
            piece, is_accurate = _fitted(row, first, last)
            if is_accurate or last - first <= _NARROWEST * (end - start):
                edges.append(last)
                pieces.append(piece)
                continue
            if len(pieces) > _MOST_PIECES:
                refusal = f"{name}: its rule is too rough to be pickled; compile the model again."
                return Interpolant(edges=(), pieces=(), refusal=refusal)
            middle = 0.5 * (first + last)
            waiting += [(middle, last), (first, middle)]
    except TranscriptionError as error:
        return Interpolant(edges=(), pieces=(), refusal=str(error))
    return Interpolant(edges=tuple(edges), pieces=tuple(pieces), refusal=refusal)


def _fitted(
    row: Callable[[float], Sequence[float]], first: float, last: float
) -> tuple[FloatArray, bool]:
    """Return the polynomial through a function at Chebyshev's nodes, and if it is the function."""
    local = np.concatenate([_NODES, _COMPARED])
    times = 0.5 * (first + last) + 0.5 * (last - first) * local
    values = np.array([row(float(t)) for t in times])
    if np.all(values == values[0]):
        return values[:1], True
    piece = _TO_COEFFICIENTS @ values[: len(_NODES)]
    errors = np.abs(chebyshev.chebval(_COMPARED, piece).T - values[len(_NODES) :])
    return piece, bool(np.all(errors <= _ACCURACY * np.abs(values).max(axis=0)))
