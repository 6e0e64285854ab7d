"""The design of a sweep: what a study file asks for, with every axis value spelled out.

The design is everything that decides the results of a sweep, and is plain data.  A result store
keeps a copy, from which its rows can be put in order and its report made without the study file.
"""

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from math import prod
from typing import Any, Self

from pydantic import TypeAdapter, ValidationError

from pyomo_quad.scenario.baseline import Reference
from pyomo_quad.scenario.complaint import shown
from pyomo_quad.scenario.schema import Scenario
from pyomo_quad.study.sweep.axes import kind_of
from pyomo_quad.study.sweep.outputs import unknown_column
from pyomo_quad.study.sweep.task import StudyTask

__all__ = ["MOST_CASES", "Dimension", "SweepDesign", "cell_of"]

MOST_CASES = 1_000_000


@dataclass(frozen=True, kw_only=True)
class Dimension:
    """One direction of the grid of cases: axes that advance together.

    Attributes
    ----------
    paths : tuple of str
        Scenario fields that change.
    steps : tuple of tuple
        For each step the values of these fields.
    is_random : bool
        Whether the steps were drawn at random.
    """

    paths: tuple[str, ...]
    steps: tuple[tuple[Any, ...], ...]
    is_random: bool = False

    def in_cells(self) -> "Dimension":
        """Return the dimension with its values as they stand in a table's cells."""
        steps = tuple(tuple(cell_of(value) for value in step) for step in self.steps)
        return replace(self, steps=steps)

    @property
    def is_sound(self) -> bool:
        """Whether each step has one plain value for each field, of one kind along the steps."""
        columns = list(zip(*self.steps, strict=False))
        kinds = [{kind_of(value) for value in column} for column in columns]
        is_whole = all(len(step) == len(self.paths) > 0 for step in self.steps)
        is_plain = all(len(found) == 1 and None not in found for found in kinds)
        return len(columns) == len(self.paths) and is_whole and is_plain

    def values(self, path: str) -> list[Any]:
        """Return the values that one field takes along the steps."""
        column = self.paths.index(path)
        return [step[column] for step in self.steps]


@dataclass(frozen=True, kw_only=True)
class SweepDesign:
    """Everything that decides the rows of a sweep.

    Attributes
    ----------
    name, title, about : str
        As in the study file.
    task : StudyTask
        What is done in each case.
    baselines : tuple of Reference
        References that the controller flies.
    outputs, report_on : tuple of str
        Columns kept in the tables, and drawn in the report.
    base : mapping
        The complete base scenario.
    dimensions : tuple of Dimension
        Directions of the grid; the last varies fastest in the row order.
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
        """Number of cases."""
        return prod(len(dimension.steps) for dimension in self.dimensions)

    @property
    def paths(self) -> tuple[str, ...]:
        """All fields that vary, in the order of the table's columns."""
        return tuple(path for dimension in self.dimensions for path in dimension.paths)

    def in_cells(self) -> Self:
        """Return the design with its values as they stand in a table's cells."""
        return replace(self, dimensions=tuple(one.in_cells() for one in self.dimensions))

    def to_json(self) -> str:
        """Write the design as JSON text, the same for the same design."""
        return _DESIGN.dump_json(self).decode()

    @classmethod
    def from_json(cls, text: str) -> Self:
        """Read a design written by `to_json`.

        Parameters
        ----------
        text : str
            JSON text.

        Returns
        -------
        SweepDesign
            Equal to the one written.

        Raises
        ------
        ValueError
            If the text is not such a design, or not one that a study file could ask for.
        """
        try:
            return _DESIGN.validate_json(text)  # type: ignore[return-value]
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            place = ".".join(map(str, first["loc"]))
            raise ValueError(f"not a sweep design: {place}: {first['msg']}") from None

    def refuse_impossible(self) -> None:
        """Refuse a design that no study file can ask for, such as one from a damaged store.

        Raises
        ------
        ValueError
            One line that names what is wrong.
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
        """Say what differs from an older design in a way that makes its rows unusable.

        Parameters
        ----------
        older : SweepDesign
            What the stored rows were made from.

        Yields
        ------
        str
            One difference; axes are compared case by case elsewhere.
        """
        for name in ("task", "baselines"):
            before, after = getattr(older, name), getattr(self, name)
            if before != after:
                yield f"{name}: {_listed(before)} -> {_listed(after)}"
        yield from _differences(older.base, self.base, "scenario")

    def axis_changes_since(self, older: "SweepDesign") -> Iterator[str]:
        """Say how the axes differ from those of an older design.

        Parameters
        ----------
        older : SweepDesign
            What the stored rows were made from.

        Yields
        ------
        str
            One difference.
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
    """Return the value of a field as one cell of a table: a list is written as text."""
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
