"""Conversion of values in other units, given by keys such as `roll_max_deg`, to SI units.

The Pydantic class of a table declares each field in SI units. A key such as `roll_max_deg` states
the field `roll_max` in degrees. The conversion is the first step when a scenario is read, so that
all later steps handle SI units only.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from pydantic import BaseModel

from pyomo_quad.scenario.fields import FieldPath, is_number, set_value, spell, unit_keys_of
from pyomo_quad.scenario.messages import shown, table_of


@dataclass(frozen=True, kw_only=True)
class Rewritten:
    """Tables of a scenario after the conversion of values in other units to SI units.

    Attributes
    ----------
    tables : dict
        Tables in SI units.
    spellings : dict
        Key and value as in the file, such as ``limits.roll_max_deg = 30``, by path of the field.
    complaints : list of str
        A message for each key that cannot be converted.
    unread : list
        Paths of the fields without a value because of an error.
    """

    tables: dict[str, Any]
    spellings: dict[FieldPath, str] = field(default_factory=dict)
    complaints: list[str] = field(default_factory=list)
    unread: list[FieldPath] = field(default_factory=list)


def in_declared_units(tables: Mapping[str, Any], model: type[BaseModel]) -> Rewritten:
    """Convert all values that nested tables give in other units, such as degrees, to SI units.

    The class `model` declares the fields, and the keys for other units.
    """
    rewritten = Rewritten(tables={})
    rewritten.tables.update(_table(tables, model, (), rewritten))
    return rewritten


def paths_in_declared_units(
    assignments: Mapping[FieldPath, Any], model: type[BaseModel]
) -> tuple[dict[FieldPath, Any], Rewritten]:
    """Convert all values of `assignments` in other units, such as degrees, to SI units.

    `assignments` maps paths of fields to values that replace those of the scenario file. The last
    key of a path, such as `roll_max_deg`, states the unit. The class `model` of the scenario
    declares the fields. The first result has the converted assignments, without those that have
    errors. The second result records conversions and errors.
    """
    rewritten, found = Rewritten(tables={}), {}
    for path, value in assignments.items():
        names = [step for step in path if isinstance(step, str)]
        alone: Any = set_value({}, tuple(names), value)
        one = in_declared_units(alone, model)
        rewritten.complaints.extend(one.complaints)
        rewritten.unread.extend(one.unread)
        if one.complaints:
            continue
        # Conversion replaces keys of a path, never list indices, which are put back here.
        (own, held), *more = list(_paths(one.tables, len(names))) or [((), value)]
        if more or len(own) != len(names):
            found[path] = value
            continue
        keys = iter(own)
        place = tuple(step if isinstance(step, int) else next(keys) for step in path)
        found.pop(place, None)
        found[place] = held
        for said in one.spellings.values():
            rewritten.spellings[place] = said
    return found, rewritten


def _paths(tables: Any, depth: int) -> Iterator[tuple[FieldPath, Any]]:  # noqa: ANN401
    if not depth:
        yield (), tables
    elif isinstance(tables, Mapping):
        for key, value in tables.items():
            yield from (((key, *rest), held) for rest, held in _paths(value, depth - 1))


def _table(
    table: Mapping[str, Any], model: type[BaseModel] | None, place: FieldPath, into: Rewritten
) -> dict[str, Any]:
    keys = {} if model is None else unit_keys_of(model)
    found: dict[str, Any] = {}
    for key, value in table.items():
        if key in keys:
            name, factor = keys[key]
            _rewrite(table, (*place, key), (*place, name), value, factor, found, into)
            continue
        nested = None if model is None else table_of(model, key)
        found[key] = _below(value, nested, (*place, key), into)
    return found


def _below(
    value: object, nested: type[BaseModel] | None, place: FieldPath, into: Rewritten
) -> object:
    if isinstance(value, Mapping):
        return _table(value, nested, place, into)
    if isinstance(value, list | tuple) and nested is not None:
        return [_below(one, nested, (*place, k), into) for k, one in enumerate(value)]
    return value


def _rewrite(
    table: Mapping[str, Any],
    written: FieldPath,
    place: FieldPath,
    value: object,
    factor: float,
    found: dict[str, Any],
    into: Rewritten,
) -> None:
    if place[-1] in table:
        into.complaints.append(f"{spell(written)} and {spell(place)} are the same field; give one.")
    elif not is_number(value):
        into.complaints.append(f"{spell(written)} = {shown(value)}; must be a number.")
        into.unread.append(place)
    else:
        found[str(place[-1])] = value * factor
        into.spellings[place] = f"{spell(written)} = {shown(value)}"
