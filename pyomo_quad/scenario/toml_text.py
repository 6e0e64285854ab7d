"""Writing of values as TOML text, with or without the source of each value."""

import json
from collections.abc import Mapping


def inline(value: object) -> str:
    """Return a value, which may be a table or list, as TOML text in one line.

    None, NaN, infinity and keys that need quotes are not supported: the text is then not TOML.
    """
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{key} = {inline(held)}" for key, held in value.items()) + " }"
    if isinstance(value, list):
        return "[" + ", ".join(map(inline, value)) + "]"
    # With ASCII escapes, JSON would write characters beyond 16 bits as surrogates, which TOML does
    # not allow.
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")


def with_source(path: str, value: object, source: str) -> tuple[str, ...]:
    """Return the lines of a TOML table with a value and its source.

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
