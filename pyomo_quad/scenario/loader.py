"""Loading of a scenario from a file or from nested mappings, with overrides of fields."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path as FilePath
from typing import Any

from pyomo_quad.scenario.fields import FieldPath, depth, leaves, parse_path, spell
from pyomo_quad.scenario.messages import ScenarioError, listed, printable, shown
from pyomo_quad.scenario.resolution import (
    DEEPEST_NESTING,
    ScenarioSource,
    parse_toml,
    read_toml,
    refuse_deep,
)
from pyomo_quad.scenario.schema import Scenario

# Name in messages of a scenario that was not read from a file.
_MAPPING = "scenario"
# Fields whose content is read from a file: table and field, and the field that names the file.
_READ_FROM = {
    ("wind", "series"): "a CSV file in wind.file",
    ("wind", "grid"): "a NetCDF, CSV or Parquet file in wind.field",
    ("airspace", "ground"): "a NetCDF, CSV or Parquet file in airspace.terrain",
}
_BARE_WORD = re.compile(r"[A-Za-z_][A-Za-z0-9_-]*")


def load_scenario(
    path: str | FilePath | Mapping[str, Any], overrides: Sequence[str] | Mapping[str, Any] = ()
) -> Scenario:
    """Read, complete and validate a scenario.

    The value of a field comes from the first of these sources that has one: the overrides, the
    scenario file, the package's library of vehicles, batteries and winds, the field's default.

    Parameters
    ----------
    path : str, Path or mapping
        A scenario file (TOML), or nested mappings with the same content. Relative file names refer
        to the folder of the scenario file. In mappings they refer to the working folder.
    overrides : sequence of str or mapping, optional
        Changed fields: a mapping from dotted path to value, or texts ``PATH=VALUE`` with a TOML
        value, as for the command-line option `--set`.

    Returns
    -------
    Scenario
        Complete and immutable.

    Raises
    ------
    ScenarioError
        If the file cannot be read or fields are invalid. The message has one line for each invalid
        field.
    FeasibilityError
        If the rotors cannot lift the vehicle.

    Examples
    --------
    >>> scenario = load_scenario("scenarios/paper_wind.toml", {"mission.duration": 8.0})
    >>> scenario.mission.duration
    8.0
    >>> scenario.provenance["vehicle.mass"]
    'library dji_phantom_2'
    """
    is_mapping = isinstance(overrides, Mapping)
    label = "overrides" if is_mapping else "--set"
    if isinstance(overrides, Mapping):
        written = assignments_of(overrides, label)
    else:
        written = _parsed(overrides)
    if isinstance(path, Mapping):
        refuse_deep(path, _MAPPING)
        source, folder, document = _MAPPING, FilePath(), path
    else:
        file = FilePath(path)
        source, folder, document = printable(str(file)), file.parent, read_toml(file)
    return _from_written(
        ScenarioSource(
            source=source, folder=folder, document=document, assignments=written, label=label
        )
    )


def scenario_from_mapping(
    tables: Mapping[str, Any], source: str = _MAPPING, folder: FilePath | None = None
) -> Scenario:
    """Complete and validate a scenario that is given as nested mappings.

    Parameters
    ----------
    tables : mapping
        Content as in a scenario file.
    source : str, optional
        Name of the scenario in messages.
    folder : Path, optional
        Folder to which relative file names refer; the working folder by default.

    Returns
    -------
    Scenario
        Complete and immutable.

    Raises
    ------
    ScenarioError
        If a field is invalid.
    FeasibilityError
        If the rotors cannot lift the vehicle.

    Examples
    --------
    >>> mission = {"goal": {"position": [1.0, 0.0, 0.5]}, "duration": 4.0}
    >>> hop = scenario_from_mapping({"name": "hop", "mission": mission})
    >>> hop.mission.goal.position
    (1.0, 0.0, 0.5)
    """
    refuse_deep(tables, source)
    return _from_written(
        ScenarioSource(source=source, folder=folder or FilePath(), document=tables)
    )


def with_overrides(scenario: Scenario, overrides: Sequence[str]) -> Scenario:
    """Return a copy of a scenario with some fields changed; the scenario itself if none are.

    `overrides` are texts ``PATH=VALUE``, as for `--set`. Raises ScenarioError if a field or value
    is not valid, and FeasibilityError if the rotors cannot lift the vehicle.
    """
    parsed = _parsed(overrides)
    return scenario.with_values({spell(p): v for p, v in parsed.items()}) if parsed else scenario


def _from_written(origin: ScenarioSource) -> Scenario:
    written = (*(path for path, _ in leaves(origin.document)), *origin.assignments)
    for path in written:
        derived = next((key for key in _READ_FROM if key[0] == path[0] and key[1] in path), None)
        if derived is not None:
            where = origin.label if path in origin.assignments else origin.source
            raise ScenarioError(
                f"{where}: {shown(spell(path))[1:-1]} is not set by hand; name "
                f"{_READ_FROM[derived]}."
            )
    return Scenario.from_origin(origin)


def parse_overrides(overrides: Sequence[str]) -> dict[str, Any]:
    """Parse overrides such as ``solver.accuracy=proof``: value of each field, by dotted path.

    A value is TOML, or one word without quotes. If a path occurs several times, the last value
    counts. Raises ScenarioError if a text is not PATH=VALUE.
    """
    return {spell(path): value for path, value in _parsed(overrides).items()}


def _parsed(overrides: Sequence[str]) -> dict[FieldPath, Any]:
    texts = (overrides,) if isinstance(overrides, str) else overrides
    found: dict[FieldPath, Any] = {}
    lines: list[str] = []
    for text in texts:
        try:
            path, value = _parse_override(text)
        except ScenarioError as error:
            lines.append(str(error))
        else:
            found[path] = value
    if lines:
        raise ScenarioError(listed(lines))
    return found


def assignments_of(tables: Mapping[str, Any], source: str) -> dict[FieldPath, Any]:
    """Convert nested tables, or a mapping of dotted paths, to a flat dictionary of field values.

    For example, ``{"mission": {"duration": 8.0}}`` gives ``{("mission", "duration"): 8.0}``. Raises
    ScenarioError, which begins with `source`, if a path is not valid.
    """
    refuse_deep(tables, source)
    assignments: dict[FieldPath, Any] = {}
    for steps, value in leaves(tables):
        path = parse_path(".".join(str(step) for step in steps))
        if path is None:
            raise ScenarioError(
                f"{source}: {shown('.'.join(map(str, steps)))} is not the path of a field; write "
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
    except ValueError:
        parsed = {"value": right.strip()} if _BARE_WORD.fullmatch(right.strip()) else {}
    if parsed.keys() != {"value"} or depth(parsed, DEEPEST_NESTING) > DEEPEST_NESTING:
        raise ScenarioError(
            f"--set: {left.strip()} = {shown(right.strip())[1:-1]}; must be a TOML value, "
            f'such as 12.0, [1.0, 2.0, 3.0] or "text".'
        )
    return path, parsed["value"]
