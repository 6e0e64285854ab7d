"""Error messages about a user's input, one line each: field, value found and allowed values."""

from collections.abc import Iterator, Mapping, Sequence
from difflib import get_close_matches
from types import UnionType
from typing import Any, Literal, NoReturn, Union, get_args, get_origin

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from pyomo_quad.scenario.fields import (
    FieldPath,
    allowed_text,
    example_of,
    is_number,
    other_names_of,
    spell,
    unit_keys_of,
    unit_of,
)

_LONGEST_VALUE = 60

# Allowed values in words, by pydantic's type of error; {name} is filled in from the error.
_ALLOWED: Mapping[str, str] = {
    "greater_than": "must be > {gt}",
    "greater_than_equal": "must be >= {ge}",
    "less_than": "must be < {lt}",
    "less_than_equal": "must be <= {le}",
    "finite_number": "must be finite",
    "float_type": "must be a number",
    "float_parsing": "must be a number",
    "int_type": "must be a whole number",
    "int_from_float": "must be a whole number",
    "int_parsing_size": "must be a whole number of fewer digits",
    "bool_type": "must be true or false",
    "string_type": "must be text in quotes",
    "string_too_long": "must be at most {max_length} characters",
    "string_too_short": "must be at least {min_length} characters",
    "enum": "must be one of {expected}",
    "tuple_type": "must be a list in brackets",
    "too_long": "must be a list of at most {max_length} values",
    "too_short": "must be a list of at least {min_length} values",
    "model_type": "must be a table",
    "model_attributes_type": "must be a table",
}


def complaints(
    error: ValidationError,
    model: type[BaseModel],
    prefix: FieldPath = (),
    spared: Sequence[FieldPath] = (),
) -> list[tuple[FieldPath, str]]:
    """Convert pydantic's validation errors of a table to messages of one line each.

    Unknown keys come first. `prefix` is put before each path. Missing or contradictory fields at
    and below the paths `spared` are not reported.
    """
    # pydantic also reports a list as too short if one of its items is invalid.
    order = {"extra_forbidden": 0, "missing": 2, "too_short": 3}
    found: dict[FieldPath, str] = {}
    misspelt: set[FieldPath] = set()
    short: set[FieldPath] = set()
    for details in sorted(error.errors(), key=lambda one: order.get(one["type"], 1)):
        details["loc"] = path = _without_branches(details["loc"], model)
        follows = details["type"] in {"missing", "value_error"}
        # Another error, such as an unreadable data file, has left these fields incomplete.
        is_spared = any(path[: len(place)] == place for place in spared)
        is_told = path in found or path in misspelt or path[:-1] in short
        is_by_item = details["type"] == "too_short" and any(
            place[: len(path)] == path for place in found
        )
        if is_told or is_by_item or (follows and is_spared):
            continue
        if details["type"] == "missing" and isinstance(path[-1], int):
            short.add(path[:-1])
        found[path] = _line(details, model, (*prefix, *path))
        if details["type"] == "extra_forbidden":
            table, _ = declared_place(model, path[:-1])
            # An unknown key that resembles a missing required field is probably a misspelling. Only
            # the unknown key is then reported.
            misspelt |= {(*path[:-1], name) for name in _meant(table, str(path[-1]))}
    return [((*prefix, *path), line) for path, line in found.items()]


#: Largest number of lines in a message; a file with more errors is not a scenario.
_MOST_LINES = 20


def listed(lines: Sequence[str]) -> str:
    """Join error messages to one text, one per line.

    After the first 20 messages, a last line states how many more there are.
    """
    more = len(lines) - _MOST_LINES
    left_out = [f"... and {more} more."] if more > 0 else []
    return "\n".join([*lines[:_MOST_LINES], *left_out])


def _without_branches(path: FieldPath, model: type[BaseModel]) -> FieldPath:
    """Return the path of a pydantic error without the type name that pydantic may append.

    It appends this name if a field accepts several types.
    """
    table, _ = declared_place(model, path[:-1])
    last = path[-1] if path else None
    # Some fields, such as `mission.duration`, accept a number or a word. For an invalid value,
    # pydantic reports one error for each type, and appends the name of the type to the path.
    is_branch = len(path) > 1 and bool(words_of(table, str(path[-2]))) and isinstance(last, str)
    return path[:-1] if is_branch else path


def words_of(model: type[BaseModel], name: str) -> tuple[str, ...]:
    """Return the words that a field accepts instead of a number, such as "free" for a duration.

    `model` is the class of the table that has the field `name`.
    """
    field = model.model_fields.get(name)
    annotation: Any = field.annotation if field is not None else None
    literals = [part for part in get_args(annotation) if get_origin(part) is Literal]
    return tuple(word for part in literals for word in get_args(part))


def shown(value: object) -> str:
    """Format a value for a message: as in TOML, on one line, shortened to about 60 characters.

    A table becomes "a table".
    """
    if isinstance(value, Mapping):
        return "a table"
    if isinstance(value, bool):
        return str(value).lower()
    text = f'"{value}"' if isinstance(value, str) else _number_text(value)
    text = printable(text)
    return text if len(text) <= _LONGEST_VALUE else f"{text[:_LONGEST_VALUE]}..."


def printable(text: str) -> str:
    """Replace line breaks and control characters by "?", so that a message stays one line."""
    return "".join(letter if letter.isprintable() else "?" for letter in text)


def field_paths(model: type[BaseModel], prefix: FieldPath = ()) -> Iterator[FieldPath]:
    """Yield the paths of all fields of a table, including the fields of nested tables.

    For a list of tables, the paths have the list index 0. `prefix` is put before each path.
    """
    for name in model.model_fields:
        yield (*prefix, name)
        nested = table_of(model, name)
        if nested is not None and nested is not model:
            is_list = get_origin(model.model_fields[name].annotation) is tuple
            yield from field_paths(nested, (*prefix, name, *((0,) if is_list else ())))


def declared_place(
    model: type[BaseModel], place: Sequence[str | int]
) -> tuple[type[BaseModel], str]:
    """Return the innermost table on the path of a field, and the unit of the field.

    For example, `mission.goal.position[2]` gives the class of the table `goal`, and the unit of
    `position`.
    """
    table, unit = model, ""
    for step in place:
        if not isinstance(step, str):
            continue
        unit = unit_of(table, step)
        nested = table_of(table, step)
        if nested is None:
            break
        table = nested
    return table, unit


def _number_text(value: object) -> str:
    try:
        return f"{value:g}" if isinstance(value, float) else str(value)
    except ValueError:  # Python refuses to write integers of thousands of digits
        return "a number of thousands of digits"


def _line(details: ErrorDetails, model: type[BaseModel], path: FieldPath) -> str:
    table, unit = declared_place(model, details["loc"])
    where = spell(path)
    if details["type"] == "extra_forbidden":
        return _unknown_key(model, table, path, details["loc"])
    if details["type"] == "missing" and isinstance(path[-1], int):
        return f"{spell(path[:-1])} is too short; give {where} too{f', in {unit}' if unit else ''}."
    if details["type"] == "missing":
        holder, _ = declared_place(model, details["loc"][:-1])
        example = _example(holder, str(path[-1]))
        such = f" For example: {where} = {example}" if example else ""
        return f"{where} is missing; give it{f' in {unit}' if unit else ''}.{such}"
    if details["type"] == "value_error":
        return f"{where}: {details['ctx']['error']}."
    found = shown(details["input"])
    suffix = f" {unit}" if unit not in {"", "1"} else ""
    allowed = _allowed(details, allowed_text(table, str(path[-1])))
    if (
        not is_number(details["input"])
        and details["type"] in {"float_type", "float_parsing"}
        and suffix
    ):
        allowed += f" in{suffix}"
        allowed += "".join(f' or "{word}"' for word in words_of(table, str(path[-1])))
    return f"{where} = {found}{suffix if is_number(details['input']) else ''}; {allowed}."


def _allowed(details: ErrorDetails, in_words: str) -> str:
    context = details.get("ctx", {})
    if details["type"] == "string_pattern_mismatch":
        return f"must be {in_words or context['pattern']}"
    allowed = _ALLOWED.get(details["type"])
    if allowed is None:
        return details["msg"][:1].lower() + details["msg"][1:]
    numbers = {
        name: f"{value:g}" if isinstance(value, float) else value for name, value in context.items()
    }
    return allowed.format(**numbers)


def _unknown_key(
    model: type[BaseModel], table: type[BaseModel], path: FieldPath, place: Sequence[str | int]
) -> str:
    prefix = path[: len(path) - len(place)]
    unknown = str(path[-1])
    where = shown(spell(path))[1:-1]
    near = _meant(table, unknown)
    if near:
        return f"unknown key {where}; did you mean {spell((*path[:-1], near[0]))}?"
    everywhere = {spell(found): str(found[-1]) for found in field_paths(model, prefix)}
    same_name = [found for found, name in everywhere.items() if name == unknown]
    near = same_name or get_close_matches(where, everywhere, n=1, cutoff=0.75)
    if near:
        return f"unknown key {where}; did you mean {near[0]}?"
    return f"unknown key {where}; known keys here: {', '.join(table.model_fields)}."


def _meant(table: type[BaseModel], unknown: str) -> list[str]:
    """Return the keys of a table that a user probably meant by an unknown key.

    The keys include keys for other units, such as `roll_max_deg`. The list may be empty.
    """
    meant = [name for name in table.model_fields if unknown in other_names_of(table, name)]
    return meant or get_close_matches(unknown, [*table.model_fields, *unit_keys_of(table)], n=1)


def _example(model: type[BaseModel], name: str) -> str:
    """Return an example value of a field in TOML, for error messages; empty if there is none.

    The example of a table has its required fields.
    """
    nested = table_of(model, name)
    if nested is None:
        return example_of(model, name)
    needed = [key for key, field in nested.model_fields.items() if field.is_required()]
    parts = {key: _example(nested, key) for key in needed}
    if not all(parts.values()):
        return ""
    return f"{{ {', '.join(f'{key} = {value}' for key, value in parts.items())} }}"


def table_of(model: type[BaseModel], name: str) -> type[BaseModel] | None:
    """Return the pydantic class of the table, or of the list of tables, that a field holds.

    The result is None if the field has any other value.
    """
    field = model.model_fields.get(name)
    annotation: Any = field.annotation if field is not None else None
    is_many = get_origin(annotation) in {Union, UnionType, tuple}
    choices = get_args(annotation) if is_many else [annotation]
    for choice in choices:
        if isinstance(choice, type) and issubclass(choice, BaseModel):
            return choice
    return None


class PyomoQuadError(Exception):
    """Base class of all errors that pyomo_quad raises deliberately."""


class ScenarioError(PyomoQuadError, ValueError):
    """Error for an invalid input of the user: a scenario, data file, report or option."""


class FeasibilityError(PyomoQuadError, ValueError):
    """Error: a valid scenario demands more than the vehicle can physically do."""


class OutputError(PyomoQuadError, RuntimeError):
    """Error: results cannot be written to the requested folder or file."""


def refuse(place: str, reason: str) -> NoReturn:
    """Raise a one-line ScenarioError about a data file.

    Parameters
    ----------
    place : str
        Beginning of the error message: the scenario field that names the file.
    reason : str
        Rest of the message: the fault of the file, and what the user can do.
    """
    raise ScenarioError(f"{place}; {reason}.") from None
