"""Pickling of data with CasADi expressions, by writing all expressions as one text."""

from __future__ import annotations

from dataclasses import dataclass, fields, is_dataclass, replace
from typing import TYPE_CHECKING, Any

import casadi

if TYPE_CHECKING:
    from collections.abc import Callable


@dataclass(frozen=True)
class _Place:
    """Placeholder for an expression, with the expression's position in the text."""

    position: int


@dataclass(frozen=True, kw_only=True)
class Packed:
    """Data with placeholders for its expressions, and the expressions as one text."""

    data: Any
    text: str
    count: int

    def unpacked(self) -> Any:
        """Return the data with its expressions."""
        reader = casadi.StringDeserializer(self.text)
        expressions = [reader.unpack() for _ in range(self.count)]
        return _changed(self.data, _Place, lambda place: expressions[place.position])


def packed(data: Any) -> Packed:
    """Replace the expressions in data classes, tuples and dictionaries by placeholders."""
    writer, count = casadi.StringSerializer(), 0

    def place(expression: Any) -> _Place:
        nonlocal count
        writer.pack(expression)
        count += 1
        return _Place(count - 1)

    without = _changed(data, casadi.SX, place)
    return Packed(data=without, text=writer.encode(), count=count)


def _changed(data: Any, kind: type, change: Callable[[Any], Any]) -> Any:
    """Return nested data with a function applied to each instance of a type."""
    if isinstance(data, kind):
        return change(data)
    if isinstance(data, tuple):
        return tuple(_changed(item, kind, change) for item in data)
    if isinstance(data, dict):
        return {key: _changed(item, kind, change) for key, item in data.items()}
    if is_dataclass(data) and not isinstance(data, type):
        parts = {f.name: _changed(getattr(data, f.name), kind, change) for f in fields(data)}
        return replace(data, **parts)
    return data
