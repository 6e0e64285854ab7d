"""Conversion of alternative notations of scenario fields, before validation.

The key `from` of a wind is the direction from which it blows, in degrees clockwise from north. It
becomes `wind.direction`, toward which the wind blows, in radians counter-clockwise from +x (east).
With `wind.from = 270`, a west wind, the wind blows toward +x.

A place `{ latitude, longitude, altitude }` becomes a position `[x, y, z]` in metres.
"""

from collections.abc import Iterator, Mapping
from math import pi, radians, remainder
from typing import Any

from pydantic import ValidationError

from pyomo_quad.scenario.earth import GeodeticOrigin, local_place
from pyomo_quad.scenario.fields import FieldPath, is_number, set_value, spell, table_at, value_at
from pyomo_quad.scenario.messages import ScenarioError, complaints, shown

#: Key for the direction that a wind comes from.
FROM = "from"
_DIRECTION = "direction"
_ORIGIN = ("mission", "origin")
#: Number of coordinates of each field that holds places; the centre of a cylinder has only two.
PLACES = {"position": 3, "rally": 3, "centre": 3, "low": 3, "high": 3}
_CORNERS = "corners"
_LATITUDE = "latitude"
#: Keys of a place on earth.
ON_EARTH = (_LATITUDE, "longitude", "altitude", "height")
_CYLINDER = "cylinder"
_MOST_TURN = 3.6e5


def in_plain_terms(
    tables: dict[str, Any],
    own: Mapping[str, Any],
    provenance: dict[str, str],
    source: str,
) -> dict[str, Any]:
    """Convert places from latitude and longitude to metres, and `wind.from` to `wind.direction`.

    Parameters
    ----------
    tables : dict
        Tables of the scenario, completed from the package's library (vehicles, batteries, winds).
    own : mapping
        The user's own values alone, without those of the library.
    provenance : dict
        Origin of each value, by dotted path. It is changed: a converted value keeps its origin.
    source : str
        Name of the scenario, with which error messages begin.

    Raises
    ------
    ScenarioError
        If a value is not valid, or the user gives it in both notations.
    """
    found = list(_in_other_notation(tables, ()))
    is_on_earth = any(isinstance(value, Mapping) for _, value in found)
    origin = origin_of_mission(tables, source) if is_on_earth else None
    for path, value in found:
        where = f"{source}: {spell(path)}"
        if isinstance(value, Mapping):
            place: Any = local_place(value, where, origin, _count(tables, path))
            tables, target = set_value(tables, path, place), path
            said = provenance.get(spell((*path, _LATITUDE)), "")
        else:
            target = (*path[:-1], _DIRECTION)
            # A direction from the library does not count as a second notation.
            _refuse_both(own, path, target, source)
            tables = set_value(_without(tables, path), target, _towards(value, where))
            said = provenance.pop(spell(path), "")
        if said:
            provenance[spell(target)] = said
    return tables


def _in_other_notation(tree: Any, path: FieldPath) -> Iterator[tuple[FieldPath, Any]]:  # noqa: ANN401
    """Yield path and value of each place by latitude and longitude, and of each wind's `from`.

    `path` is the path of `tree`; every yielded path begins with it.
    """
    items: Any = ()
    if isinstance(tree, Mapping):
        items = tree.items()
    elif isinstance(tree, list | tuple):
        items = enumerate(tree)
    for key, value in items:
        below = (*path, key)
        named = next((step for step in reversed(below) if isinstance(step, str)), "")
        if isinstance(value, Mapping) and _LATITUDE in value and below != _ORIGIN:
            if named in PLACES or named == _CORNERS:
                yield below, value
        elif isinstance(key, str) and not isinstance(value, Mapping):
            is_from = key == FROM and bool(path) and path[0] == "wind"
            if is_from:
                yield below, value
            else:
                yield from _in_other_notation(value, below)
        else:
            yield from _in_other_notation(value, below)


def origin_of_mission(tables: Mapping[str, Any], source: str) -> GeodeticOrigin | None:
    """Return the position of x = y = z = 0 on earth; None if the scenario gives no such position.

    Raises ScenarioError, which begins with `source`, if the position is not valid.
    """
    written = value_at(tables, *_ORIGIN)
    if written is None:
        return None
    try:
        return GeodeticOrigin.model_validate(written)
    except ValidationError as error:
        (_, line), *_ = complaints(error, GeodeticOrigin, _ORIGIN)
        raise ScenarioError(f"{source}: {line}") from None


def _count(tables: Any, path: FieldPath) -> int:  # noqa: ANN401  tables of TOML
    """Return the number of coordinates of a place in a scenario: 2 or 3.

    A polygon's corner and a vertical cylinder's centre have x and y only.
    """
    if _CORNERS in path:
        return 2
    is_axis = path[-1] == "centre" and table_at(tables, *path[:-1]).get("shape") == _CYLINDER
    return 2 if is_axis else PLACES.get(str(path[-1]), 3)


def _refuse_both(own: Any, path: FieldPath, target: FieldPath, source: str) -> None:  # noqa: ANN401
    if _DIRECTION in table_at(own, *path[:-1]):
        raise ScenarioError(
            f"{source}: {spell(target)} and {spell(path)} give the same angle; leave one out."
        )


def _towards(value: object, where: str) -> float:
    """Convert the direction from which a wind blows to the direction toward which it blows.

    `value` is clockwise from north [deg], the result counter-clockwise from +x (east) [rad]. Raises
    a ScenarioError for an invalid value. Its message begins with `where`, which names file and
    field.
    """
    if not is_number(value) or not abs(value) <= _MOST_TURN:
        raise ScenarioError(
            f"{where} = {shown(value)}; must be a number from {-_MOST_TURN:g} to {_MOST_TURN:g} "
            "degrees."
        )
    return remainder(radians(270.0 - value), 2.0 * pi)


def _without(tree: Any, path: FieldPath) -> Any:  # noqa: ANN401  tables of TOML
    """Return a copy of the nested tables `tree` without the field at `path` (keys and indices)."""
    head, *rest = path
    if isinstance(tree, Mapping):
        if not rest:
            return {key: value for key, value in tree.items() if key != head}
        return {**tree, head: _without(tree[head], tuple(rest))}
    items = list(tree)
    items[head] = _without(items[head], tuple(rest))  # type: ignore[index]
    return items
