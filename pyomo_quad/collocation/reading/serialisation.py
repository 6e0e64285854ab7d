"""CasADi expressions inside other data, as text that can be kept and read in another process."""

from __future__ import annotations

from dataclasses import dataclass, fields, is_dataclass, replace
from typing import TYPE_CHECKING, Any

import casadi

if TYPE_CHECKING:
    from collections.abc import Callable


@dataclass(frozen=True)
class _Place:
    """Where an expression stood: its position in the text."""

    position: int


@dataclass(frozen=True, kw_only=True)
class Packed:
    """Data without its expressions, and the text of these, in which symbols stay shared."""

    data: Any
    text: str
    count: int

    def unpacked(self) -> Any:
        """Return the data with its expressions."""
        reader = casadi.StringDeserializer(self.text)
        expressions = [reader.unpack() for _ in range(self.count)]
        return _changed(self.data, _Place, lambda place: expressions[place.position])


def packed(data: Any) -> Packed:
    """Take the expressions out of data classes, tuples and dictionaries."""
    writer, count = casadi.StringSerializer(), 0

    def place(expression: Any) -> _Place:
        nonlocal count
        writer.pack(expression)
        count += 1
        return _Place(count - 1)

    without = _changed(data, casadi.SX, place)
    return Packed(data=without, text=writer.encode(), count=count)


def _changed(data: Any, kind: type, change: Callable[[Any], Any]) -> Any:
    """Return data with everything of a kind changed."""
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
