"""Writing of values as TOML text, and of numbers with their source."""

import json
from collections.abc import Mapping


def inline(value: object) -> str:
    """Write a value as TOML in one line, including tables and lists."""
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{key} = {inline(held)}" for key, held in value.items()) + " }"
    if isinstance(value, list):
        return "[" + ", ".join(map(inline, value)) + "]"
    # With ASCII escapes, JSON would write characters beyond 16 bits as surrogates, which TOML does
    # not allow.
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")


def with_source(path: str, value: object, source: str) -> tuple[str, ...]:
    """Return the TOML lines of a table that holds a value and its source.

    Parameters
    ----------
    path : str
        Dotted path of the table.
    value : object
        The value.
    source : str
        Publication, data sheet or measurement that gives the value.
    """
    return ("", f"[{path}]", f"value = {inline(value)}", f"source = {inline(source)}")
