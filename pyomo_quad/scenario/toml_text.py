"""TOML text of values, and of numbers that name their source."""

import json
from collections.abc import Mapping


def inline(value: object) -> str:
    """Write a value in one line, tables and lists included."""
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{key} = {inline(held)}" for key, held in value.items()) + " }"
    if isinstance(value, list):
        return "[" + ", ".join(map(inline, value)) + "]"
    # JSON escapes characters beyond 16 bits by surrogates, which TOML does not allow.
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")


def with_source(path: str, value: object, source: str) -> tuple[str, ...]:
    """Return the lines of a table that holds a value and its source."""
    return ("", f"[{path}]", f"value = {inline(value)}", f"source = {inline(source)}")
