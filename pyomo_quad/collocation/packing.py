"""Pickling of data that contain CasADi expressions.

CasADi expressions cannot be pickled. All expressions are therefore serialised into a single text. A
subexpression that occurs in several expressions is stored once.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, is_dataclass, replace
from typing import TYPE_CHECKING, Any

import casadi

if TYPE_CHECKING:
    from collections.abc import Callable


@dataclass(frozen=True)
class _Place:
    """Placeholder for a CasADi expression: its position among the serialised expressions."""

    position: int


@dataclass(frozen=True, kw_only=True)
class Packed:
    """Data in a form that can be pickled, with the CasADi expressions stored in a text.

    A placeholder in the data marks the place of each expression.

    Attributes
    ----------
    data : nested data
        The data, with a placeholder in place of each expression.
    text : str
        All expressions, serialised by CasADi.
    count : int
        Number of expressions in the text.
    """

    data: Any
    text: str
    count: int

    def unpacked(self) -> Any:
        """Return the original data, with CasADi expressions in place of the placeholders."""
        reader = casadi.StringDeserializer(self.text)
        expressions = [reader.unpack() for _ in range(self.count)]
        return _changed(self.data, _Place, lambda place: expressions[place.position])


def packed(data: Any) -> Packed:
    """Return data in a form that can be pickled, with its CasADi expressions as one text.

    Data classes, tuples and dictionaries are searched for expressions recursively.
    """
    writer, count = casadi.StringSerializer(), 0

    def place(expression: Any) -> _Place:
        nonlocal count
        writer.pack(expression)
        count += 1
        return _Place(count - 1)

    without = _changed(data, casadi.SX, place)
    return Packed(data=without, text=writer.encode(), count=count)


def _changed(data: Any, kind: type, change: Callable[[Any], Any]) -> Any:
    """Return a copy of nested data in which `change` replaces all objects of the type `kind`.

    Data classes, tuples and dictionaries are searched recursively.
    """
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
