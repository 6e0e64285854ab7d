"""The design of a sweep: what a study file asks for, with every axis value spelled out.

The design is everything that decides the results of a sweep, and is plain data.  A result store
keeps a copy, from which its rows can be put in order and its report made without the study file.
"""

import json
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from math import prod
from typing import Any, Self

__all__ = ["Dimension", "SweepDesign"]


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
    task : str
        A `StudyTask`.
    baselines : tuple of str
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
    task: str
    baselines: tuple[str, ...]
    outputs: tuple[str, ...]
    report_on: tuple[str, ...]
    base: Mapping[str, Any]
    dimensions: tuple[Dimension, ...]

    @property
    def case_count(self) -> int:
        """Number of cases."""
        return prod(len(dimension.steps) for dimension in self.dimensions)

    @property
    def paths(self) -> tuple[str, ...]:
        """All fields that vary, in the order of the table's columns."""
        return tuple(path for dimension in self.dimensions for path in dimension.paths)

    def to_json(self) -> str:
        """Write the design as JSON text, the same for the same design."""
        return json.dumps(asdict(self), sort_keys=True, allow_nan=False)

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
            If the text is not such a design.
        """
        try:
            fields = json.loads(text)
            dimensions = tuple(
                Dimension(
                    paths=tuple(item["paths"]),
                    steps=tuple(tuple(step) for step in item["steps"]),
                    is_random=bool(item["is_random"]),
                )
                for item in fields.pop("dimensions")
            )
            for name in ("baselines", "outputs", "report_on"):
                fields[name] = tuple(fields[name])
            return cls(dimensions=dimensions, **fields)
        except (KeyError, TypeError, AttributeError) as error:
            raise ValueError(f"not a sweep design: {error}") from None

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
