"""A resolved scenario as a list: each field with value, unit, meaning and origin."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from pydantic import BaseModel

from pyomo_quad.scenario.fields import unit_of
from pyomo_quad.scenario.messages import declared_place
from pyomo_quad.scenario.schema import Scenario
from pyomo_quad.scenario.tree import FieldPath, parse_path, spell


@dataclass(frozen=True, kw_only=True)
class FieldDescription:
    """One field of a resolved scenario.

    Attributes
    ----------
    path : str
        Dotted path, as `--set` takes it.
    value : object
        Number, text, tuple or None.
    unit : str
        SI unit, empty where there is none.
    origin : str
        ``default``, ``library NAME``, ``scenario``, ``--set`` or ``file NAME``.
    meaning : str
        One line.
    """

    path: str
    value: Any
    unit: str
    origin: str
    meaning: str


def describe_fields(scenario: Scenario) -> tuple[FieldDescription, ...]:
    """List all fields of a scenario in the order of the schema.

    Parameters
    ----------
    scenario : Scenario
        The resolved scenario.

    Returns
    -------
    tuple of FieldDescription
        One for each field that is not a table.
    """
    provenance = scenario.provenance
    return tuple(
        FieldDescription(
            path=spell(path),
            value=value,
            unit=_unit(table, path),
            origin=provenance.get(spell(path), "default"),
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
        SI unit, empty where there is none.
    """
    steps = parse_path(path) or ()
    _, unit = declared_place(Scenario, steps)
    return "" if unit == "1" else unit


def _unit(table: BaseModel, path: FieldPath) -> str:
    unit = unit_of(type(table), str(path[-1]))
    return "" if unit == "1" else unit


def _fields(table: BaseModel, prefix: FieldPath = ()) -> Iterator[tuple[FieldPath, BaseModel, Any]]:
    for name in type(table).model_fields:
        value = getattr(table, name)
        if isinstance(value, BaseModel):
            yield from _fields(value, (*prefix, name))
        else:
            yield (*prefix, name), table, value
