"""Design of a parameter sweep: the values of each axis, and the cases.

An axis is a scenario field with the values that it takes. A dimension is one axis, or several axes
whose values change together. Each step of a dimension gives every one of its fields one value. The
cases are all combinations of steps; they form a grid. In their order, the last dimension varies
fastest.
"""

import hashlib
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from math import prod
from typing import Any, Self

import numpy as np
from pydantic import TypeAdapter, ValidationError, field_validator, model_validator
from scipy.special import ndtri

from pyomo_quad.scenario.fields import Number, Part, Text, WholeNumber, quantity
from pyomo_quad.scenario.messages import shown
from pyomo_quad.scenario.schema import Scenario
from pyomo_quad.scenario.tables import Reference
from pyomo_quad.sweep.case import StudyTask, unknown_column

_MOST_VALUES = 100_000
# Digits of an axis value. Values are stored, hashed and printed in decimal; twelve digits avoid
# 0.30000000000000004 for 0.3 and are finer than any tolerance of a solve.
_SIGNIFICANT_DIGITS = 12


class Spacing(Part):
    """First value, last value and number of the spaced values of a field that a sweep varies.

    The steps between the values are equal, or equal in ratio for a logarithmic spacing.
    """

    first: Number = quantity(
        "",
        "first value, in the unit of the field",
        other_names=("start", "begin", "from", "low", "min", "lower"),
    )
    last: Number = quantity(
        "",
        "last value, in the unit of the field",
        other_names=("stop", "end", "to", "high", "max", "upper"),
    )
    count: WholeNumber = quantity(
        "1",
        "number of values",
        ge=1,
        le=_MOST_VALUES,
        other_names=("n", "num", "number", "steps", "points", "size"),
    )


class UniformSpread(Part):
    """Uniform distribution of a scenario field between `low` and `high`."""

    low: Number = quantity(
        "",
        "lower end, in the unit of the field",
        other_names=("first", "start", "begin", "from", "min", "lower", "a"),
    )
    high: Number = quantity(
        "",
        "upper end, in the unit of the field",
        other_names=("last", "stop", "end", "to", "max", "upper", "b"),
    )

    def at(self, probabilities: np.ndarray) -> np.ndarray:
        """Return the quantiles of the uniform distribution at probabilities between 0 and 1."""
        return self.low + (self.high - self.low) * probabilities


class NormalSpread(Part):
    """Normal distribution of a scenario field, by mean and standard deviation."""

    mean: Number = quantity(
        "",
        "mean, in the unit of the field",
        other_names=("mu", "average", "center", "centre", "loc"),
    )
    standard_deviation: Number = quantity(
        "",
        "standard deviation, in the unit of the field",
        gt=0,
        other_names=("std", "stdev", "sigma", "sd", "deviation", "scale"),
    )

    def at(self, probabilities: np.ndarray) -> np.ndarray:
        """Return the quantiles of the normal distribution at probabilities between 0 and 1.

        At 0 and 1 the quantile is infinite.
        """
        return self.mean + self.standard_deviation * ndtri(probabilities)


_KINDS = ("values", "linear", "logarithmic", "uniform", "normal")


class Axis(Part):
    """Scenario field that a sweep varies, and its values: listed, spaced or drawn at random."""

    path: Text = quantity("", "dotted path of a scenario field", min_length=1, max_length=200)
    group: Text | None = quantity("", "axes of one group advance together", None, max_length=60)
    values: tuple[Any, ...] | None = quantity("", "list of values", None, min_length=1)
    linear: Spacing | None = quantity("", "equal steps", None)
    logarithmic: Spacing | None = quantity("", "equal ratios", None)
    uniform: UniformSpread | None = quantity("", "drawn from a uniform distribution", None)
    normal: NormalSpread | None = quantity("", "drawn from a normal distribution", None)

    @field_validator("values")
    @classmethod
    def _plain_values(cls, values: tuple[Any, ...] | None) -> tuple[Any, ...] | None:
        if any(kind_of(value) is None for value in values or ()):
            raise ValueError("must hold finite numbers, texts, booleans or lists of these")
        return values

    @model_validator(mode="after")
    def _given_once(self) -> Self:
        given = [kind for kind in _KINDS if getattr(self, kind) is not None]
        if len(given) != 1:
            raise ValueError(f"must have exactly one of {', '.join(_KINDS)}")
        ratio = self.logarithmic
        if ratio is not None and not (ratio.first > 0 and ratio.last > 0):
            raise ValueError("a logarithmic axis must have first and last > 0")
        if self.uniform is not None and not self.uniform.low < self.uniform.high:
            raise ValueError("a uniform axis must have low < high")
        if self.is_random and self.group is not None:
            raise ValueError("random axes are drawn together and must have no group")
        return self

    @property
    def is_random(self) -> bool:
        """Whether the values are drawn from a distribution instead of listed or spaced."""
        return self.uniform is not None or self.normal is not None

    @property
    def count(self) -> int:
        """Number of values of an axis that is not random; 0 for a random axis."""
        spacing = self.linear or self.logarithmic
        return spacing.count if spacing is not None else len(self.values or ())

    def spaced_values(self) -> tuple[Any, ...]:
        """Return the listed, equally spaced or logarithmically spaced values of the axis.

        The result is empty for a random axis. For a random axis, use `drawn_values`.
        """
        if self.linear is not None:
            spacing = self.linear
            return rounded(np.linspace(spacing.first, spacing.last, spacing.count))
        if self.logarithmic is not None:
            spacing = self.logarithmic
            return rounded(np.geomspace(spacing.first, spacing.last, spacing.count))
        return self.values or ()

    def drawn_values(self, probabilities: np.ndarray) -> tuple[float, ...]:
        """Return the values of a random axis: quantiles of its distribution.

        The probabilities lie strictly between 0 and 1. If the axis is not random, the result is
        empty.
        """
        spread = self.uniform or self.normal
        return rounded(spread.at(probabilities)) if spread is not None else ()


def rounded(numbers: np.ndarray) -> tuple[float, ...]:
    """Round numbers to twelve significant digits, the precision of a sweep's field values."""
    return tuple(float(f"{number:.{_SIGNIFICANT_DIGITS}g}") for number in numbers)


def kind_of(value: object) -> type | None:
    """Return the type of a plain value: bool, float, str or list; None for any other value.

    Plain values are finite numbers, texts, booleans, and lists of these, but no lists of lists.
    Integers count as float.
    """
    if isinstance(value, bool | str):
        return type(value)
    if isinstance(value, int | float):
        return float if math.isfinite(value) else None
    is_list = isinstance(value, list) and all(kind_of(part) not in {None, list} for part in value)
    return list if is_list else None


MOST_CASES = 1_000_000


@dataclass(frozen=True, kw_only=True)
class Dimension:
    """Dimension of a sweep's grid of cases: one or more scenario fields that change together.

    Attributes
    ----------
    paths : tuple of str
        Dotted paths of the scenario fields that change.
    steps : tuple of tuple
        Values of the fields at each step along the dimension: one inner tuple for each step.
    is_random : bool
        Whether the values were drawn at random.
    """

    paths: tuple[str, ...]
    steps: tuple[tuple[Any, ...], ...]
    is_random: bool = False

    def in_cells(self) -> "Dimension":
        """Return a copy with list values as JSON texts, as in the cells of the result table."""
        steps = tuple(tuple(cell_of(value) for value in step) for step in self.steps)
        return replace(self, steps=steps)

    @property
    def is_sound(self) -> bool:
        """Whether each step has one plain value for each field, and each field has one type.

        Plain values are finite numbers, texts, booleans and lists of these. The test finds damage
        in dimensions that are read from a file.
        """
        columns = list(zip(*self.steps, strict=False))
        kinds = [{kind_of(value) for value in column} for column in columns]
        is_whole = all(len(step) == len(self.paths) > 0 for step in self.steps)
        is_plain = all(len(found) == 1 and None not in found for found in kinds)
        return len(columns) == len(self.paths) and is_whole and is_plain

    @property
    def is_numeric(self) -> bool:
        """Whether the values of the dimension's first field are numbers."""
        return all(kind_of(step[0]) is float for step in self.steps)

    def values(self, path: str) -> list[Any]:
        """Return the values that one field of the dimension takes, in the order of the steps."""
        column = self.paths.index(path)
        return [step[column] for step in self.steps]


@dataclass(frozen=True, kw_only=True)
class SweepDesign:
    """Specification of a parameter sweep, from which all its cases follow.

    Attributes
    ----------
    name, title, about : str
        Short name, title and first paragraph of the report, as in the study file.
    task : StudyTask
        `OPTIMISE`: each case is planned. `FLY_PLAN`: the controller flies the base scenario's plan
        in each case.
    baselines : tuple of Reference
        Reference trajectories that the controller flies in each case, for comparison.
    outputs, report_on : tuple of str
        Output columns that the result tables keep, and those that the report draws.
    base : mapping
        The complete base scenario, as nested mappings.
    dimensions : tuple of Dimension
        Scenario fields that vary, with their values. In the order of the cases, the last dimension
        varies fastest.
    """

    name: str
    title: str
    about: str
    task: StudyTask
    baselines: tuple[Reference, ...]
    outputs: tuple[str, ...]
    report_on: tuple[str, ...]
    base: dict[str, Any]
    dimensions: tuple[Dimension, ...]

    @property
    def case_count(self) -> int:
        """Number of cases of the sweep: product of the numbers of steps of all dimensions."""
        return prod(len(dimension.steps) for dimension in self.dimensions)

    @property
    def paths(self) -> tuple[str, ...]:
        """Dotted paths of the fields that vary, in the order of the result table's columns."""
        return tuple(path for dimension in self.dimensions for path in dimension.paths)

    def in_cells(self) -> Self:
        """Return a copy with list values as JSON texts, as in the cells of the result table."""
        return replace(self, dimensions=tuple(one.in_cells() for one in self.dimensions))

    def to_json(self) -> str:
        """Return the design as JSON text; equal designs give equal texts."""
        return _DESIGN.dump_json(self).decode()

    @classmethod
    def from_json(cls, text: str) -> Self:
        """Read a design from the JSON text that `to_json` wrote.

        Raises
        ------
        ValueError
            If the text is not a sweep design, or an attribute has a wrong type. The method
            `refuse_impossible` checks the values.
        """
        try:
            return _DESIGN.validate_json(text)  # type: ignore[return-value]
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            place = ".".join(map(str, first["loc"]))
            raise ValueError(f"not a sweep design: {place}: {first['msg']}") from None

    def refuse_impossible(self) -> None:
        """Raise an error if the design cannot stem from a study file.

        A result store with such a design is damaged.

        Raises
        ------
        ValueError
            If there are no dimensions, a dimension has missing or wrong values, the cases are too
            many, a field varies twice, an output column is unknown, or `report_on` is empty. Also
            if the base scenario is invalid; only that message has several lines.
        """
        Scenario.model_validate(self.base)
        if not self.dimensions or not all(one.is_sound for one in self.dimensions):
            raise ValueError("not a sweep design: dimensions: a field, a step or a value is amiss")
        if self.case_count > MOST_CASES or len(set(self.paths)) < len(self.paths):
            raise ValueError("not a sweep design: dimensions: too many, or a field twice")
        wrong = unknown_column((*self.outputs, *self.report_on), self.task, self.baselines)
        if wrong is not None or not self.report_on:
            raise ValueError(f"not a sweep design: outputs: none is called {shown(wrong)}")

    def changes_since(self, older: "SweepDesign") -> Iterator[str]:
        """Yield the changes of task, baselines and base scenario since an older design.

        After such a change, results of the older design are not valid for this design.

        Parameters
        ----------
        older : SweepDesign
            The older design.

        Yields
        ------
        str
            One change, such as ``scenario.vehicle.mass: 1.0 -> 1.2``.
        """
        for name in ("task", "baselines"):
            before, after = getattr(older, name), getattr(self, name)
            if before != after:
                yield f"{name}: {_listed(before)} -> {_listed(after)}"
        yield from _differences(older.base, self.base, "scenario")

    def axis_changes_since(self, older: "SweepDesign") -> Iterator[str]:
        """Yield the changes of the axes since an older design.

        An axis is a scenario field that varies, with its values. Results of the older design remain
        valid for the cases that both designs have.

        Parameters
        ----------
        older : SweepDesign
            The older design.

        Yields
        ------
        str
            One change, such as ``axis mission.duration: removed``.
        """
        before = {path: one.values(path) for one in older.dimensions for path in one.paths}
        after = {path: one.values(path) for one in self.dimensions for path in one.paths}
        for path in sorted(before.keys() | after.keys()):
            if path not in after:
                yield f"axis {path}: removed"
            elif path not in before:
                yield f"axis {path}: added"
            elif before[path] != after[path]:
                yield f"axis {path}: {_summary(before[path])} -> {_summary(after[path])}"
        if before == after and older.dimensions != self.dimensions:
            yield "axes: grouped or ordered differently"


_DESIGN = TypeAdapter(SweepDesign)


def cell_of(value: object) -> Any:  # noqa: ANN401  a value of any scenario field
    """Return a field's value as a table cell holds it: a list as JSON text, others unchanged."""
    return json.dumps(value) if isinstance(value, list) else value


def _differences(before: object, after: object, place: str) -> Iterator[str]:
    if isinstance(before, Mapping) and isinstance(after, Mapping):
        for key in sorted(before.keys() | after.keys()):
            yield from _differences(before.get(key), after.get(key), f"{place}.{key}")
    elif before != after:
        yield f"{place}: {_shortened(before)} -> {_shortened(after)}"


def _summary(values: list[Any]) -> str:
    return f"{len(values)} values {_shortened(values[0])} to {_shortened(values[-1])}"


def _listed(value: str | tuple[str, ...]) -> str:
    return value if isinstance(value, str) else (", ".join(value) or "none")


def _shortened(value: object) -> str:
    text = json.dumps(value)
    return text if len(text) <= 40 else f"{text[:40]}..."


_KEY_LENGTH = 20  # hexadecimal digits of a case's key


@dataclass(frozen=True, kw_only=True)
class Case:
    """One case of a sweep, with its values of the scenario fields that vary.

    Attributes
    ----------
    position : int
        Row number of the case, from 0.
    key : str
        Hash of the overrides. It stays the same if a later sweep adds values to the axes.
    overrides : mapping
        Value of each field that varies, by its dotted path.
    parent : int or None
        Position of the neighbouring case whose solution is the initial guess. None for the first
        solve, and for the task `FLY_PLAN`, in which all cases fly the base scenario's plan.
    """

    position: int
    key: str
    overrides: Mapping[str, Any]
    parent: int | None


def expand(design: SweepDesign) -> tuple[Case, ...]:
    """Return all cases of a sweep in row order: every combination of the dimensions' steps."""
    parents = [_step_parents(dimension) for dimension in design.dimensions]
    sizes = [len(dimension.steps) for dimension in design.dimensions]
    is_solved = design.task == StudyTask.OPTIMISE
    cases = []
    for position, place in enumerate(product(*(range(size) for size in sizes))):
        overrides = {
            path: value
            for dimension, step in zip(design.dimensions, place, strict=True)
            for path, value in zip(dimension.paths, dimension.steps[step], strict=True)
        }
        cases.append(
            Case(
                position=position,
                key=case_key(overrides),
                overrides=overrides,
                parent=_parent_position(place, parents, sizes) if is_solved else None,
            )
        )
    return tuple(cases)


def case_key(overrides: Mapping[str, Any]) -> str:
    """Return the key of a case: a hash of the field values that distinguish it.

    The key has the first 20 hexadecimal digits of the SHA-256 hash. `overrides` maps dotted paths
    to values.
    """
    text = json.dumps(dict(overrides), sort_keys=True, allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()[:_KEY_LENGTH]


def bisection_parents(count: int) -> list[int | None]:
    """Arrange the sorted values of a field in a bisection tree; return the index of each parent.

    The root is the middle value; its parent is None. Its children are the middles of the two
    halves, and so on. Parents are solved first.
    """
    parents: list[int | None] = [None] * count
    # A solve waits only for its ancestors, at most about log2(count): many can run in parallel.
    pending: list[tuple[int, int, int | None]] = [(0, count, None)]
    while pending:
        low, high, parent = pending.pop()
        if low >= high:
            continue
        middle = (low + high) // 2
        parents[middle] = parent
        pending += [(low, middle, middle), (middle + 1, high, middle)]
    return parents


def _step_parents(dimension: Dimension) -> list[int | None]:
    order = _sorted_steps(dimension.steps)
    parents: list[int | None] = [None] * len(order)
    for rank, parent in enumerate(bisection_parents(len(order))):
        parents[order[rank]] = None if parent is None else order[parent]
    return parents


def _sorted_steps(steps: Sequence[tuple[Any, ...]]) -> list[int]:
    # Steps are sorted by the first field if it is numeric; others keep the study file's order.
    is_numeric = all(isinstance(step[0], int | float) for step in steps)
    indices = range(len(steps))
    return sorted(indices, key=lambda index: steps[index][0]) if is_numeric else list(indices)


def _parent_position(
    place: Sequence[int], parents: Sequence[Sequence[int | None]], sizes: Sequence[int]
) -> int | None:
    for index in reversed(range(len(place))):
        step = parents[index][place[index]]
        if step is not None:
            neighbour = [*place[:index], step, *place[index + 1 :]]
            return int(np.ravel_multi_index(neighbour, sizes))
    return None
