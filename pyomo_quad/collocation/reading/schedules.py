"""Rules that branch on time, as data over time for compiled equations.

A rule that branches on its time, or looks up numbers by it, is called at many times. Its results
have the same form if only numbers in them differ. The compiled equations contain all forms. Data at
each collocation point select the form that applies, and give the numbers that vary between results
of one form. Bisection finds the times at which these data jump.

Declared times are the members of the continuous set. A pickle stores piecewise polynomials of time
instead of the rule.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections import OrderedDict
from dataclasses import dataclass, field
from itertools import pairwise
from math import ceil, floor
from typing import TYPE_CHECKING, Any, TypeVar

import casadi
import numpy as np
from numpy.polynomial import chebyshev
from pyomo.core.expr.numvalue import native_types

from pyomo_quad.collocation.errors import TranscriptionError
from pyomo_quad.collocation.reading.symbols import Slot

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from pyomo_quad.collocation.mesh import FloatArray
    from pyomo_quad.collocation.reading.clock import PhaseTimes

# Number of times, besides the declared ones, at which a rule is called before compilation.
_PROBES = 64
# Number of forms above which a rule is taken to return a different expression at every time.
_MOST_FORMS = 24
# Width, as a fraction of the horizon, within which a jump is bracketed.
_RESOLUTION = 1e-14
#: Distance from a jump, as a fraction of the horizon, that is clearly on one side of it.
BESIDE = 2e-12
# A change that bisection reduces to no less than this fraction, above rounding, is a jump.
_UNDIMINISHED = 0.75
# Change of a number, relative to the number, below which bisection does not search a jump.
_ROUNDING = 1e-9
# Number of times for which a schedule caches its readings.
_REMEMBERED = 100_000
T = TypeVar("T")


def _remembered(known: OrderedDict[float, T], time: float, of: Callable[[float], T]) -> T:
    """Return the value of the function `of` at a time, from the cache `known` if possible.

    The cache keeps the 100,000 latest times.
    """
    if time not in known:
        if len(known) >= _REMEMBERED:
            known.popitem(last=False)
        known[time] = of(time)
    return known[time]


@dataclass(frozen=True, kw_only=True)
class Statement:
    """Result of calling the rule of a component at one time.

    Attributes
    ----------
    parts : tuple
        Pyomo expressions. For a constraint: lower bound, body and upper bound, with None for an
        absent bound. For an expression over time: the expression alone.
    is_equality : bool
        Whether the constraint is an equality.
    """

    parts: tuple[Any, ...]
    is_equality: bool = False

    @property
    def is_skipped(self) -> bool:
        """Whether the rule skipped the constraint, so that it has no bound."""
        if len(self.parts) == 1:
            return False
        lower, body, upper = self.parts
        return lower is None and upper is None and body.__class__ in native_types


@dataclass(frozen=True)
class Reading:
    """Form and numbers of a rule's result at one time.

    Two results have the same form if their expressions differ in numbers only.

    Attributes
    ----------
    key : hashable
        Identifies the form: the structure of the returned expressions without their numbers.
    numbers : tuple of float
        The numbers in the expressions.
    """

    key: Any
    numbers: tuple[float, ...]


@dataclass(kw_only=True)
class _Form:
    """Form of a rule's results: expressions that differ in some of their numbers only."""

    # The rule's result at the first time at which the result has this form, and its numbers.
    statement: Statement
    numbers: tuple[float, ...]
    # Positions in `numbers`, from 0, of the numbers that vary between results of this form.
    varying: list[int] = field(default_factory=list)

    def compare(self, numbers: tuple[float, ...]) -> None:
        """Record which numbers in the form vary, by comparison with a further result."""
        for k, (first, number) in enumerate(zip(self.numbers, numbers, strict=True)):
            if number != first and k not in self.varying:
                # Such numbers are data over time in the compiled equations. All others are
                # constants.
                self.varying.append(k)


class Schedule:
    """Rule that branches on time, as a few compiled forms and their numbers over time.

    `say` maps a time to the rule's result. To find forms and jumps, it is called between the
    declared times `times`, and just before and after each. The result at a time t is
    ``say(place(t))``. By default, ``place(t)`` is t. If the result is constant between declared
    times, `place` may map all times between two of them to their midpoint, to call the rule once.

    Attributes
    ----------
    name : str
        Name of the component.
    slots : tuple of Slot
        Data that the compiled forms read: factors that select the form, then the numbers that vary.

    Raises
    ------
    TranscriptionError
        If the rule has too many forms.
    """

    def __init__(
        self,
        name: str,
        say: Callable[[float], Statement],
        times: Sequence[float],
        place: Callable[[float], float] = float,
    ) -> None:
        self.name = name
        self._say, self._place = say, place
        self._forms: dict[Any, _Form] = {}
        self._is_compiled = False
        self._known: OrderedDict[float, Reading] = OrderedDict()
        self._rows: OrderedDict[float, list[float]] = OrderedDict()
        for _ in jumps(self.reading, probes(times)):
            pass
        self._is_compiled = True
        self._known.clear()
        # A single form gets a signal too; without any signal the schedule would never be evaluated.
        self._chosen = [self._slot(f"form {k}") for k in range(max(len(self._forms) - 1, 1))]
        self._numbers = [
            [self._slot(f"form {k}, number {at}") for at in form.varying]
            for k, form in enumerate(self._forms.values())
        ]
        self.slots = (*self._chosen, *(s for slots in self._numbers for s in slots))

    def _slot(self, what: str) -> Slot:
        """Return a new `Slot` over time, whose name is "component (`what`)"."""
        name = f"{self.name} ({what})"
        return Slot(name=name, component=self.name, index=(), symbol=casadi.SX.sym(name))

    @property
    def is_equality(self) -> bool:
        """Whether the rule of the constraint returns an equality at all times."""
        return all(f.statement.is_equality for f in self._forms.values())

    def reading(self, time: float) -> Reading:
        """Return the form and the numbers of the rule's result at a time.

        Raises
        ------
        TranscriptionError
            If the form is not compiled, or a number that is compiled as a constant differs.
        """
        return _remembered(self._known, self._place(time), self._read)

    def _read(self, time: float) -> Reading:
        """Call the rule at a time, and return form and numbers of its result."""
        statement = self._say(time)
        numbers: list[float] = []
        structure = tuple(_structure(part, numbers) for part in statement.parts)
        found = Reading((structure, statement.is_equality), tuple(numbers))
        self._sort(found, statement, time)
        return found

    def _sort(self, found: Reading, statement: Statement, time: float) -> None:
        """Assign a rule's result to its form, or register a new form.

        `found` has form and numbers of `statement`, the result at `time`. A `TranscriptionError` is
        raised for too many forms; after compilation, for a new form or another value of a constant.
        """
        form = self._forms.get(found.key)
        if not self._is_compiled:
            if form is None:
                self._forms[found.key] = _Form(statement=statement, numbers=found.numbers)
            else:
                form.compare(found.numbers)
            if len(self._forms) > _MOST_FORMS:
                raise TranscriptionError(
                    f"{self.name}: its rule returns a different expression at every time, more "
                    f"than {_MOST_FORMS} forms; let only numbers in it depend on time, or "
                    "declare a constraint for each part of the horizon."
                )
            return
        if form is None or any(
            number != first and k not in form.varying
            for k, (first, number) in enumerate(zip(form.numbers, found.numbers, strict=True))
        ):
            raise TranscriptionError(
                f"{self.name}: its rule returns an expression at time {time:g} that it returned at "
                "no time tried when the model was compiled; declare the times at which it changes "
                "in the ContinuousSet."
            )

    def row(self, time: float) -> list[float]:
        """Return the values of `slots` at one time: first the factors, then the numbers.

        Each form except the last has a factor: 1 if the form applies at the time, else 0. The last
        form applies if all factors are 0. A single form has the factor 1.
        """
        return _remembered(self._rows, self._place(time), self._row)

    def _row(self, time: float) -> list[float]:
        """Return the values of `slots` at a time, by calling the rule, without a cache.

        The method `row` explains the values.
        """
        found = self._read(time)
        row = [float(key == found.key) for key in list(self._forms)[: len(self._chosen)]]
        for key, form in self._forms.items():
            held = found.numbers if key == found.key else form.numbers
            row.extend(held[k] for k in form.varying)
        return row

    def written(self, write: Callable[[Any, Iterator[Any]], Any], absent: Sequence[Any]) -> Any:
        """Return the parts of the rule's result, as CasADi expressions that hold at all times.

        The parts are lower bound, body and upper bound, or a single expression. Each part contains
        all forms of the rule's result, and factors that select the form that applies.

        Parameters
        ----------
        write : callable
            Translates a Pyomo expression to CasADi. Its second argument iterates over the numbers
            in the expression, in their order. Symbols replace the numbers that vary over time.
        absent : sequence
            For each part, the expression that replaces None.
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
        self._share_body_with_skipped(forms)
        result = forms[-1]
        for k in reversed(range(len(forms) - 1)):
            holds = self._chosen[k].symbol
            result = [_either(holds, a, b) for a, b in zip(forms[k], result, strict=True)]
        return result

    def _share_body_with_skipped(self, forms: list[list[Any]]) -> None:
        """Give forms that skip the constraint the body of another form, if this body is linear.

        `forms` has a list (lower bound, body, upper bound) for each form, and is changed in place.
        With equal bodies, the constraint can become a bound of a variable.
        """
        is_skipped = [f.statement.is_skipped for f in self._forms.values()]
        if any(is_skipped) and not all(is_skipped):
            # The body has no effect where the rule skips the constraint. A constraint on a single
            # variable can become a bound of the variable, but only if all forms have the same body.
            body = forms[is_skipped.index(False)][1]
            for parts, is_without in zip(forms, is_skipped, strict=True):
                if is_without and _is_linear(body):
                    parts[1] = body


class Phases:
    """Indicators of the phases of a horizon with free times, as data for compiled equations.

    An indicator is 1 at times of its phase and 0 elsewhere. Like a `Schedule`, the class has the
    attributes `name` and `slots` and the methods `reading` and `row`.
    """

    def __init__(self, clock: PhaseTimes) -> None:
        self.name = clock.name
        self.slots = tuple(
            Slot(name=phase.name(), component=clock.name, index=(), symbol=phase)
            for phase in clock.phases
        )
        self._clock = clock

    def reading(self, time: float) -> Reading:
        """Return the phase at a time as a `Reading`, for the function `jumps`.

        The key is the index of the phase, and there are no numbers.
        """
        return Reading(self._clock.phase_of(time), ())

    def row(self, time: float) -> list[float]:
        """Return the indicators of all phases at a time in the range of the continuous set."""
        phase = self._clock.phase_of(time)
        return [float(k == phase) for k in range(len(self.slots))]


def _is_linear(expression: Any) -> bool:
    """Return whether a CasADi expression is linear in all of its symbols together."""
    symbols = casadi.symvar(expression)
    return bool(casadi.is_linear(expression, casadi.vertcat(casadi.SX(0, 1), *symbols)))


def _either(holds: Any, first: Any, second: Any) -> Any:
    """Return the expression `first` where the factor `holds` is 1, and `second` where it is 0."""
    is_same = casadi.is_equal(first, second, 1_000)
    return first if is_same else casadi.if_else(holds, first, second)


def _structure(part: Any, numbers: list[float]) -> Any:
    """Return a hashable key of an expression's structure, and append its numbers to `numbers`."""
    if part is None:
        return None
    if part.__class__ in native_types:
        numbers.append(float(part))
        return "number"
    if not part.is_expression_type() or part.is_named_expression_type():
        return id(part)
    return type(part), part.getname(), *(_structure(a, numbers) for a in part.args)


def probes(times: Sequence[float]) -> list[float]:
    """Return the times inside the horizon at which a rule is called to find its forms and jumps.

    `times` are the declared times, including both ends of the horizon. The result has times just
    before and after each of them, and 64 times spread over the horizon, in rising order.
    """
    span = times[-1] - times[0]
    between = np.linspace(times[0], times[-1], _PROBES + 1)[:-1] + 0.618 * span / _PROBES
    sides = [t + sign * BESIDE * span for t in times for sign in (-1.0, 1.0)]
    inner = sorted({*between.tolist(), *sides})
    return [t for t in inner if times[0] < t < times[-1]]


def jumps(reading: Callable[[float], Reading], times: Sequence[float]) -> Iterator[float]:
    """Yield, in rising order, the times at which the results of `reading` jump.

    Each result has a key and numbers. A change of the key is a jump. A change of a number is a jump
    if halving the interval around it does not reduce the change. Jumps are searched between
    neighbouring `times`, which are in rising order.
    """
    for start, end in pairwise(times):
        resolution = _RESOLUTION * max(abs(times[0]), abs(times[-1]), times[-1] - times[0])
        yield from sorted(_jumps_between(reading, start, end, resolution))


def _jumps_between(
    reading: Callable[[float], Reading], start: float, end: float, resolution: float
) -> Iterator[float]:
    """Yield the times from `start` to `end` at which a reading jumps, to within `resolution`.

    `reading` returns form and numbers of a rule's result at a time. It jumps where the form changes
    or a number jumps.
    """
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
    """Yield the times from `start` to `end` at which a number jumps, to within `resolution`.

    `reading` returns form and numbers of a rule's result at a time. All numbers are searched. The
    form at `start` equals that at `end`.
    """
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
    """Return the fraction of the horizon at which to evaluate parameters for the point `fraction`.

    If a jump is within 2e-12 of the point, the result is 2e-12 before the jump. At the ends 0 and 1
    of the horizon, it is 2e-12 inside. Otherwise, it is `fraction` itself. `jumps_at` are fractions
    in rising order.
    """
    inside = min(max(fraction, BESIDE), 1.0 - BESIDE)
    nearest = bisect_left(jumps_at, inside - BESIDE)
    # A jump is on the boundary of two elements, which belongs to the element before it.
    if nearest < len(jumps_at) and jumps_at[nearest] <= inside + BESIDE:
        return jumps_at[nearest] - BESIDE
    return inside


@dataclass(frozen=True, kw_only=True)
class Steps:
    """Piecewise constant function of time with steps of equal duration.

    Before the first step, it has the first value, and after the last step, the last value.

    Parameters
    ----------
    start : float
        Time at which the first step begins.
    step : float
        Duration of each step.
    values : tuple of float
        Value of each step.
    """

    start: float
    step: float
    values: tuple[float, ...]

    def __call__(self, time: float) -> float:
        """Return the value of the piecewise constant function at a time."""
        step = int((time - self.start) / self.step)
        return self.values[min(max(step, 0), len(self.values) - 1)]

    def edges(self, start: float, end: float) -> list[float]:
        """Return the times at which one step of the function ends and the next step begins.

        Parameters
        ----------
        start, end : float
            Only times between `start` and `end` are returned.

        Returns
        -------
        list of float
            In rising order.
        """
        first = floor((start - self.start) / self.step) + 1
        last = min(ceil((end - self.start) / self.step), len(self.values))
        return [self.start + k * self.step for k in range(max(first, 1), last)]


# Degree of the polynomials that replace functions of time in a pickle.
_DEGREE = 12
# Largest relative error of a piece, and the width below which no piece is halved, as a fraction of
# the horizon.
_ACCURACY = 1e-13
_NARROWEST = 1e-14
# Number of pieces above which a function counts as too rough to be pickled.
_MOST_PIECES = 20_000
_NODES = chebyshev.chebpts1(_DEGREE + 1)
_TO_COEFFICIENTS = np.linalg.inv(chebyshev.chebvander(_NODES, _DEGREE))
# Abscissae on [-1, 1], between the nodes, at which a polynomial is compared with its function.
_COMPARED = np.array([-0.97, -0.61, -0.28, 0.13, 0.52, 0.83, 0.99])


@dataclass(frozen=True, kw_only=True)
class Interpolant:
    """Approximation of functions of time by piecewise Chebyshev polynomials.

    Attributes
    ----------
    edges : tuple of float, length n_pieces + 1
        Times that bound the pieces, in rising order, including all jumps. An edge belongs to the
        piece that starts there.
    pieces : tuple of ndarray, shape (degree + 1, n_functions)
        Chebyshev coefficients of each piece; empty if the approximation failed.
    refusal : str
        Error message for a time outside the edges, or the reason of the failure.
    """

    edges: tuple[float, ...]
    pieces: tuple[FloatArray, ...]
    refusal: str

    def row(self, time: float) -> list[float]:
        """Return the values of all interpolated functions at a time.

        Raises
        ------
        TranscriptionError
            If the time is outside the range of the polynomials, or there are no polynomials.
        """
        if not self.pieces or not self.edges[0] <= time <= self.edges[-1]:
            raise TranscriptionError(self.refusal)
        k = min(bisect_right(self.edges, time), len(self.pieces)) - 1
        start, end = self.edges[k], self.edges[k + 1]
        local = (2.0 * time - start - end) / (end - start)
        return np.asarray(chebyshev.chebval(local, self.pieces[k])).tolist()

    def reading(self, time: float) -> Reading:
        """Return the values at a time as a `Reading`, for the function `jumps`.

        The numbers are the values of all functions. The key is the same at all times.
        """
        return Reading(None, tuple(self.row(time)))

    def __call__(self, time: float) -> float:
        """Return the value at a time, for an interpolant of a single function."""
        return self.row(time)[0]


def interpolant(
    name: str,
    row: Callable[[float], Sequence[float]],
    horizon: tuple[float, float],
    jumps: Sequence[float],
) -> Interpolant:
    """Approximate functions of time, whose values `row` returns, by piecewise polynomials.

    A piece between two `jumps` is halved until polynomials of degree 12 reproduce each function to
    1e-13 of its largest magnitude there. If `row` raises a `TranscriptionError`, or more than
    20,000 pieces are needed, the result has no pieces.
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
            # Halving makes the pieces short near a kink.
            middle = 0.5 * (first + last)
            waiting += [(middle, last), (first, middle)]
    except TranscriptionError as error:
        return Interpolant(edges=(), pieces=(), refusal=str(error))
    return Interpolant(edges=tuple(edges), pieces=tuple(pieces), refusal=refusal)


def _fitted(
    row: Callable[[float], Sequence[float]], first: float, last: float
) -> tuple[FloatArray, bool]:
    """Fit polynomials of degree 12 to several functions of time, from `first` to `last`.

    The result has the Chebyshev coefficients, shape (degree + 1, n_functions), and whether the
    polynomials are accurate.
    """
    local = np.concatenate([_NODES, _COMPARED])
    times = 0.5 * (first + last) + 0.5 * (last - first) * local
    values = np.array([row(float(t)) for t in times])
    # For constant functions, the degree is 0.
    if np.all(values == values[0]):
        return values[:1], True
    piece = _TO_COEFFICIENTS @ values[: len(_NODES)]
    # The accuracy is tested between the nodes, relative to the largest magnitude of each function.
    errors = np.abs(chebyshev.chebval(_COMPARED, piece).T - values[len(_NODES) :])
    return piece, bool(np.all(errors <= _ACCURACY * np.abs(values).max(axis=0)))
