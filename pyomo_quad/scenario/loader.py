"""Read a scenario file, with what is set on the command line, into a scenario."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path as FilePath
from typing import Any

from pyomo_quad.scenario.fields import FieldPath, depth, leaves, parse_path, spell
from pyomo_quad.scenario.messages import ScenarioError, printable, shown
from pyomo_quad.scenario.resolution import (
    DEEPEST_NESTING,
    Origin,
    parse_toml,
    read_toml,
    refuse_deep,
)
from pyomo_quad.scenario.schema import Scenario

# What messages call a scenario that no file holds.
_MAPPING = "scenario"
_BARE_WORD = re.compile(r"[A-Za-z_][A-Za-z0-9_-]*")


def load_scenario(
    path: str | FilePath | Mapping[str, Any], overrides: Sequence[str] | Mapping[str, Any] = ()
) -> Scenario:
    """Read, complete and validate a scenario.

    Later layers win: default, library, scenario file, overrides.

    Parameters
    ----------
    path : str, Path or mapping
        A TOML file, or nested mappings that say what one would.
    overrides : sequence of str or mapping, optional
        ``PATH=VALUE`` with a TOML value, as `--set` takes them; or dotted path -> value.

    Returns
    -------
    Scenario
        Complete and immutable.

    Raises
    ------
    ScenarioError
        If the file or fields are not allowed; one line for each, naming the field.
    FeasibilityError
        If the rotors cannot carry the vehicle.
    """
    is_mapping = isinstance(overrides, Mapping)
    written = _mapped(overrides) if isinstance(overrides, Mapping) else _parsed(overrides)
    label = "overrides" if is_mapping else "--set"
    if isinstance(path, Mapping):
        refuse_deep(path, _MAPPING)
        source, folder, document = _MAPPING, FilePath(), path
    else:
        file = FilePath(path)
        source, folder, document = printable(str(file)), file.parent, read_toml(file)
    return _from_written(
        Origin(source=source, folder=folder, document=document, assignments=written, label=label)
    )


def scenario_from_mapping(
    tables: Mapping[str, Any], source: str = _MAPPING, folder: FilePath | None = None
) -> Scenario:
    """Complete and validate a scenario given as nested mappings.

    Parameters
    ----------
    tables : mapping
        What a TOML file would hold.
    source : str, optional
        What messages call it.
    folder : Path, optional
        Where relative file names start, the working folder by default.

    Returns
    -------
    Scenario
        Complete and immutable.

    Raises
    ------
    ScenarioError
        If a field is not allowed.
    FeasibilityError
        If the rotors cannot carry the vehicle.
    """
    refuse_deep(tables, source)
    return _from_written(Origin(source=source, folder=folder or FilePath(), document=tables))


def _from_written(origin: Origin) -> Scenario:
    written = (*(path for path, _ in leaves(origin.document)), *origin.assignments)
    for path in written:
        if path[0] == "wind" and "series" in path:
            where = origin.label if path in origin.assignments else origin.source
            raise ScenarioError(
                f"{where}: {shown(spell(path))[1:-1]} is not set by hand; name a CSV file in "
                "wind.file."
            )
    return Scenario.from_origin(origin)


def _parsed(overrides: Sequence[str]) -> dict[FieldPath, Any]:
    texts = (overrides,) if isinstance(overrides, str) else overrides
    return dict(_parse_override(text) for text in texts)


def _mapped(overrides: Mapping[str, Any]) -> dict[FieldPath, Any]:
    refuse_deep(overrides, "overrides")
    assignments: dict[FieldPath, Any] = {}
    for steps, value in leaves(overrides):
        path = parse_path(".".join(str(step) for step in steps))
        if path is None:
            raise ScenarioError(
                f"overrides: {shown('.'.join(map(str, steps)))} is not the path of a field; write "
                "for example mission.duration."
            )
        assignments[path] = value
    return assignments


def _parse_override(text: str) -> tuple[FieldPath, Any]:
    left, equals, right = text.partition("=")
    path = parse_path(left)
    if not equals or path is None:
        raise ScenarioError(
            f"--set: {shown(text)} is not PATH=VALUE; write for example mission.duration=12.0."
        )
    try:
        parsed = parse_toml(f"value = {right}")
    except (ValueError, RecursionError):
        parsed = {"value": right.strip()} if _BARE_WORD.fullmatch(right.strip()) else {}
    if parsed.keys() != {"value"} or depth(parsed, DEEPEST_NESTING) > DEEPEST_NESTING:
        raise ScenarioError(
            f"--set: {left.strip()} = {shown(right.strip())[1:-1]}; must be a TOML value, "
            f'such as 12.0, [1.0, 2.0, 3.0] or "text".'
        )
    return path, parsed["value"]
