"""Descriptions of scenario fields, JSON Schemas for editors, and the shipped scenarios.

A field is described by path, unit, default, allowed values and meaning. The JSON Schema of a
scenario file lets editors complete and check TOML. The shipped scenarios are templates for new
scenarios, found in a source checkout or in the installed package.
"""

import re
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from math import inf
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from pyomo_quad.scenario.fields import DEGREES, FieldPath, parse_path, spell, unit_of
from pyomo_quad.scenario.messages import ScenarioError, declared_place, shown
from pyomo_quad.scenario.schema import NAME_PATTERN, Scenario
from pyomo_quad.scenario.spellings import FROM, ON_EARTH, PLACES


@dataclass(frozen=True, kw_only=True)
class FieldDescription:
    """Value, unit and origin of one field of a scenario.

    Attributes
    ----------
    path : str
        Dotted path of the field, such as ``vehicle.mass``.
    value : object
        Number, text, tuple or None.
    unit : str
        SI unit; empty if the field has none.
    origin : str
        Source of the value: ``default`` (the default of the field), ``library NAME`` (an entry of
        the package's library), ``scenario`` (the scenario file), ``--set`` (an override on the
        command line) or ``file NAME`` (a data file that the scenario names).
    meaning : str
        Meaning of the field, in one line.
    """

    path: str
    value: Any
    unit: str
    origin: str
    meaning: str


def describe_fields(scenario: Scenario) -> tuple[FieldDescription, ...]:
    """List all fields of a scenario with value, unit, origin and meaning.

    Parameters
    ----------
    scenario : Scenario
        The complete scenario.

    Returns
    -------
    tuple of FieldDescription
        A description of each field that is not a table, in the order of the schema.

    Examples
    --------
    >>> fields = {field.path: field for field in describe_fields(scenario)}
    >>> fields["mission.duration"].value, fields["mission.duration"].unit
    (4.0, 's')
    """
    provenance = scenario.provenance
    return tuple(
        FieldDescription(
            path=spell(path),
            value=value,
            unit=_unit(table, path),
            origin=_origin(provenance, path),
            meaning=type(table).model_fields[str(path[-1])].description or "",
        )
        for path, table, value in _fields(scenario)
    )


def field_unit(path: str) -> str:
    """Return the unit of a scenario field.

    Parameters
    ----------
    path : str
        Dotted path of the field.

    Returns
    -------
    str
        SI unit; empty if the field has none or does not exist.

    Examples
    --------
    >>> field_unit("vehicle.mass")
    'kg'
    """
    steps = parse_path(path) or ()
    _, unit = declared_place(Scenario, steps)
    return "" if unit == "1" else unit


def _origin(provenance: Mapping[str, str], path: FieldPath) -> str:
    """Return the origin of a field's value, such as "default" or "library dji_phantom_2"."""
    # A field without a recorded origin has the origin of the list or table that contains it.
    held = (provenance.get(spell(path[:length])) for length in range(len(path), 0, -1))
    return next(filter(None, held), "default")


def _unit(table: BaseModel, path: FieldPath) -> str:
    unit = unit_of(type(table), str(path[-1]))
    return "" if unit == "1" else unit


def _fields(table: BaseModel, prefix: FieldPath = ()) -> Iterator[tuple[FieldPath, BaseModel, Any]]:
    for name in type(table).model_fields:
        value = getattr(table, name)
        if isinstance(value, BaseModel):
            yield from _fields(value, (*prefix, name))
        elif isinstance(value, tuple) and value and isinstance(value[0], BaseModel):
            for number, row in enumerate(value):
                yield from _fields(row, (*prefix, name, number))
        else:
            yield (*prefix, name), table, value


# Keys that `quantity` adds to a field's JSON Schema for messages, and that editors do not know.
_NOTES = ("unit", "allowed", "example", "other_names", "sound", "is_late", "unit_keys")
# Fields whose content is read from a file that another field names; users do not write them.
_DERIVED = ("series", "grid", "ground")
_LIMITS = {"minimum": "≥", "exclusiveMinimum": ">", "maximum": "≤", "exclusiveMaximum": "<"}


@dataclass(frozen=True, kw_only=True)
class WritableField:
    """Description of a field that users may write in a scenario or study file.

    A study file describes a parameter sweep. The attributes are the texts of one row in the
    documentation's table of fields: dotted path, unit, default, allowed values and meaning.
    """

    path: str
    unit: str
    default: str
    allowed: str
    meaning: str


def editor_schema(model: type[BaseModel], title: str, required: tuple[str, ...]) -> dict[str, Any]:
    """Return the JSON Schema by which editors complete and check a TOML file.

    `model` describes the whole file, a scenario or a study. The schema includes alternative
    notations of values, such as angles in degrees or places by latitude and longitude. It excludes
    fields that users do not write. `required` names the keys that every file must have.
    """
    schema = model.model_json_schema()
    definitions = schema.get("$defs", {})
    for table in (schema, *definitions.values()):
        table.pop("required", None)
        for name in _DERIVED:
            table.get("properties", {}).pop(name, None)
        fields = table.get("properties", {})
        in_units = {
            key: {"type": "number", "description": f"{field.get('description')} [{unit}]"}
            for name, field in fields.items()
            for key, unit in _unit_keys(name, field)
        }
        table["properties"] = {name: _for_editors(field) for name, field in fields.items()}
        table["properties"] |= in_units
        for name, field in fields.items():
            table["properties"] |= _alternative_notations(name, field)
    for name in ("WindSeries", "WindGrid"):
        definitions.pop(name, None)
    return {
        "$schema": "http://json-schema.org/draft-07/schema#",
        **schema,
        "title": title,
        "required": list(required),
    }


def writable_fields(model: type[BaseModel]) -> tuple[WritableField, ...]:
    """Describe the fields that a scenario or study file may have, in the order of the schema.

    `model` describes the whole file. Each description is one row of the documentation's table of
    fields.
    """
    schema = model.model_json_schema()
    return tuple(_writable(schema, schema.get("$defs", {}), ""))


def _alternative_notations(name: str, field: dict[str, Any]) -> dict[str, Any]:
    """Return the JSON Schemas of a field's alternative notations, by their TOML keys.

    `field` is the JSON Schema of the field `name`. Places may be given by latitude and longitude,
    winds by the direction from which they blow. Other fields give an empty result.
    """
    found: dict[str, Any] = {}
    if field.get("unit") == "rad" and name == "direction":
        says = "where the wind comes from, clockwise from north [deg]"
        found[FROM] = {"type": "number", "description": says}
    if name in PLACES:
        kept = _for_editors(field)
        on_earth = {"type": "object", "properties": {key: {"type": "number"} for key in ON_EARTH}}
        found[name] = {"anyOf": [kept, on_earth], "description": kept.get("description", "")}
    return found


def _unit_keys(name: str, field: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return the keys by which a file may give a field in other units, with the unit's name.

    For example, the key `roll_max_deg` gives the field `roll_max` in degrees.
    """
    degrees = [(f"{name}{DEGREES}", "degrees")] if field.get("unit") == "rad" else []
    return degrees + [(key, key.partition("_")[2]) for key in field.get("unit_keys", {})]


def _for_editors(field: dict[str, Any]) -> dict[str, Any]:
    kept = {name: value for name, value in field.items() if name not in {*_NOTES, "title"}}
    if field.get("unit", "") not in {"", "1"}:
        kept["description"] = f"{field['description']} [{field['unit']}]"
    if field.get("sound") is not None and field.get("type") in {"number", "integer"}:
        low, high = field["sound"]["low"], field["sound"]["high"]
        kept["minimum"] = max(low, kept.get("minimum", low))
        kept["maximum"] = min(high, kept.get("maximum", high))
    return kept


def _writable(
    table: Mapping[str, Any], definitions: Mapping[str, Any], prefix: str
) -> Iterator[WritableField]:
    for name, field in table["properties"].items():
        path = f"{prefix}{name}"
        below = _table_below(field, definitions)
        if name in _DERIVED:
            continue
        if below is not None and below is not table:
            each = "[]" if field.get("type") == "array" else ""
            yield from _writable(below, definitions, f"{path}{each}.")
            continue
        unit = field.get("unit", "")
        others = [f"; or {key}" for key, _ in _unit_keys(name, field)]
        yield WritableField(
            path=path,
            unit="" if unit == "1" else unit,
            default=_default(field),
            allowed=_allowed(field, definitions),
            meaning="".join((field.get("description", ""), *others)),
        )


def _table_below(field: Mapping[str, Any], definitions: Mapping[str, Any]) -> Any:  # noqa: ANN401
    for option in (field, field.get("items", {}), *field.get("anyOf", ())):
        held = definitions.get(option.get("$ref", "").rpartition("/")[2], {})
        if "properties" in held:
            return held
    return None


def _default(field: Mapping[str, Any]) -> str:
    value = field.get("default")
    if value is None or isinstance(value, dict):
        return ""
    if isinstance(value, bool | str | list):
        return str(value).lower() if isinstance(value, bool) else str(value).replace("'", '"')
    return f"{value:g}"


def _allowed(field: Mapping[str, Any], definitions: Mapping[str, Any]) -> str:
    words = [field["allowed"]] if field.get("allowed") else []
    options = (field, *field.get("anyOf", ()))
    words += [
        _allowed_values(option, definitions) for option in options if not _is_ranged(field, option)
    ]
    if "sound" in field:
        ranged = next(option for option in options if _is_ranged(field, option))
        words.append(_range(field["sound"], ranged))
    return "; ".join(filter(None, words))


def _is_ranged(field: Mapping[str, Any], option: Mapping[str, Any]) -> bool:
    """Return whether a field's plausible range applies to the type with the schema `option`.

    A field may allow several types, such as a number and the word "free".
    """
    # The key `sound` holds the plausible range, which applies to numbers and lists of numbers only.
    return "sound" in field and option.get("type") in {"number", "integer", "array"}


def _range(sound: Mapping[str, Any], option: Mapping[str, Any]) -> str:
    """Return the allowed range of a number in words, followed by the reason for the range.

    `sound` is the plausible range, with its reason. `option` is the JSON Schema of the number or
    list of numbers, whose limits may narrow the range.
    """
    number = option.get("items", option)
    low = max(sound["low"], number.get("minimum", -inf), number.get("exclusiveMinimum", -inf))
    high = min(sound["high"], number.get("maximum", inf), number.get("exclusiveMaximum", inf))
    words = f"{low:g} to {high:g}"
    if low == number.get("exclusiveMinimum") or high == number.get("exclusiveMaximum"):
        least = ">" if low == number.get("exclusiveMinimum") else "≥"
        most = "<" if high == number.get("exclusiveMaximum") else "≤"
        words = f"{least} {low:g}, {most} {high:g}"
    each = "a list, each " if option.get("type") == "array" else ""
    return f"{each}{words} ({sound['because']})"


def _allowed_values(option: Mapping[str, Any], definitions: Mapping[str, Any]) -> str:
    """Return in words the values that a field accepts, for one of its types, `option`.

    `definitions` holds the JSON Schemas to which the schema `option` may refer, by name.
    """
    held = definitions.get(option.get("$ref", "").rpartition("/")[2], {})
    if "const" in option:
        return f'"{option["const"]}"'
    if "enum" in held:
        return ", ".join(map(str, held["enum"]))
    if option.get("type") == "array" and "items" in option:
        each = _allowed_values(option["items"], definitions)
        return f"a list of {each}" if each else "a list"
    return ", ".join(f"{sign} {option[key]:g}" for key, sign in _LIMITS.items() if key in option)


# Folders of the shipped scenarios: inside the installed package, or beside it in a checkout.
_PACKAGE = Path(__file__).parents[1]
_PLACES = (_PACKAGE / "shipped", _PACKAGE.parent / "scenarios")
_STUDY = "study_"
#: Short names of shipped scenarios: `paper` is the mission of the paper in calm air.
_SHORT_NAMES = {"paper": "paper_calm"}
_NAME = re.compile(r'^name = ".*"$', re.MULTILINE)
_SCHEMA_LINE = "#:schema ./scenario.schema.json\n"


def shipped_scenarios() -> Mapping[str, Path]:
    """Return the paths of the scenario files that belong to the package, by name of the scenario.

    Some scenarios are listed a second time under a short name, such as `paper`.
    """
    place = next(place for place in _PLACES if place.is_dir())
    found = {f.stem: f for f in sorted(place.glob("*.toml")) if not f.stem.startswith(_STUDY)}
    return {short: found[name] for short, name in _SHORT_NAMES.items() if name in found} | found


def files_beside(template: str) -> dict[str, Path]:
    """Return the data files (wind field, terrain) that a shipped scenario refers to.

    Parameters
    ----------
    template : str
        Name of the shipped scenario.

    Returns
    -------
    dict
        Path of each file, by the name that the scenario uses for it.
    """
    file = shipped_scenarios()[template]
    tables = tomllib.loads(file.read_text(encoding="utf-8"))
    fields = (("wind", "field"), ("airspace", "terrain"))
    named = (tables.get(table, {}).get(field) for table, field in fields)
    return {name: file.parent / name for name in named if name is not None}


def refuse_no_name(text: str) -> None:
    """Raise an error if a text is not a valid name of a scenario or vehicle.

    Raises
    ------
    ScenarioError
        If the text is not 1 to 64 letters, digits, '_', '-' or '.', or starts with '.', '_' or '-'.
    """
    if re.fullmatch(NAME_PATTERN, text) is None:
        raise ScenarioError(
            f"NAME = {shown(text)}; must be 1 to 64 letters, digits, '_', '-' or '.', starting "
            "with a letter or digit."
        )


def started_scenario(template: str, name: str) -> str:
    """Return the text of a shipped scenario under a new name, for the user to edit.

    Raises ScenarioError if there is no such shipped scenario, or the new name is not valid.
    """
    shipped = shipped_scenarios()
    if template not in shipped:
        raise ScenarioError(
            f"--from {shown(template)[1:-1]}: must be one of {', '.join(sorted(shipped))}."
        )
    refuse_no_name(name)
    text = shipped[template].read_text(encoding="utf-8")
    hint = (
        f"# Begun from {template}. `pyomo-quad check {name}.toml` shows every field, "
        f"`pyomo-quad run {name}.toml` flies it.\n"
    )
    named = _NAME.sub(f'name = "{name}"', text, count=1)
    return named.replace(_SCHEMA_LINE, _SCHEMA_LINE + hint, 1)
