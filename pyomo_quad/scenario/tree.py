"""Nested tables as TOML gives them: dotted paths, layers, depth."""

import re
from collections.abc import Iterator, Mapping
from typing import Any

FieldPath = tuple[str | int, ...]

# No field lies half as deep; what follows a path goes down it step by step.
_MOST_STEPS = 16
_STEP = re.compile(r"([A-Za-z0-9_-]+)((?:\[[0-9]{1,3}\])*)")


def parse_path(text: str) -> FieldPath | None:
    """Split `mission.goal.position[2]` into its steps.

    Returns
    -------
    tuple of str and int, or None
        The steps, None when the text is no path or leads deeper than any field.
    """
    steps: list[str | int] = []
    for part in text.strip().split("."):
        match = _STEP.fullmatch(part)
        if match is None:
            return None
        steps.append(match[1])
        steps.extend(int(index) for index in re.findall("[0-9]+", match[2]))
        if len(steps) > _MOST_STEPS:
            return None
    return tuple(steps)


def spell(path: FieldPath) -> str:
    """Write steps as `mission.goal.position[2]`."""
    text = "".join(f"[{step}]" if isinstance(step, int) else f".{step}" for step in path)
    return text.removeprefix(".")


def depth(value: object, allowed: int) -> int:
    """Measure how deep tables and lists are nested, stopping past what is allowed.

    Returns
    -------
    int
        Depth, at most ``allowed + 1``; a plain value has depth 0.
    """
    level, layer = 0, [value]
    while level <= allowed:
        nested: list[object] = []
        for item in layer:
            if isinstance(item, Mapping):
                nested.extend(item.values())
            elif isinstance(item, list | tuple):
                nested.extend(item)
        if not any(isinstance(item, Mapping | list | tuple) for item in layer):
            break
        level, layer = level + 1, nested
    return level


def leaves(tree: Mapping[str, Any], prefix: FieldPath = ()) -> Iterator[tuple[FieldPath, Any]]:
    """Walk over all values that are not tables."""
    for key, value in tree.items():
        if isinstance(value, Mapping):
            yield from leaves(value, (*prefix, key))
        else:
            yield (*prefix, key), value


def merge(lower: Mapping[str, Any], upper: Mapping[str, Any]) -> dict[str, Any]:
    """Return a copy of a nested table with another, which wins, laid over it."""
    merged = dict(lower)
    for key, value in upper.items():
        below = merged.get(key)
        both_tables = isinstance(below, Mapping) and isinstance(value, Mapping)
        merged[key] = merge(below, value) if both_tables else value  # type: ignore[arg-type]
    return merged


def set_value(tree: object, path: FieldPath, value: object) -> Any:  # noqa: ANN401
    """Return a copy of nested tables and lists with one value set.

    Raises
    ------
    LookupError
        If the path goes through a plain value or past the end of a list.
    """
    if not path:
        return value
    head, rest = path[0], path[1:]
    if isinstance(tree, Mapping) and isinstance(head, str):
        return {**tree, head: set_value(tree.get(head, {}), rest, value)}
    if isinstance(tree, list | tuple) and isinstance(head, int) and head < len(tree):
        items = list(tree)
        items[head] = set_value(items[head], rest, value)
        return items
    raise LookupError(spell(path))
