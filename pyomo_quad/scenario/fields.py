"""Declaration of scenario fields, each with unit, meaning and plausible range.

Fields are arranged in nested tables, as in TOML; they have dotted paths, layers and a depth.
"""

import re
from collections.abc import Iterator, Mapping
from functools import cache, partial
from math import pi
from typing import Annotated, Any, NamedTuple, TypeGuard

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    SerializerFunctionWrapHandler,
    Strict,
    model_serializer,
)
from pydantic_core import PydanticCustomError

# Strict, so that "10" and true are refused as numbers; an integer is accepted.
Number = Annotated[float, Strict()]
WholeNumber = Annotated[int, Strict()]
Text = Annotated[str, Strict()]
Flag = Annotated[bool, Strict()]
Triple = tuple[Number, Number, Number]

#: Ending of keys that give an angle in degrees.
DEGREES = "_deg"

# Numbers that a table or a command line may hold. Python's own `float` also accepts "2_0" and the
# digits of any script.
_DECIMAL = re.compile(
    r"[+-]?(?:(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?|inf|infinity|nan)", re.IGNORECASE
)

# Pattern of a title: no line break and no other control character.
_ONE_LINE = r"^[^\x00-\x1f\x7f-\x9f\u2028\u2029]*$"


class Sound(NamedTuple):
    """Plausible range of a number, and the reason in words.

    A number outside is a typing error or has the wrong unit, and might overflow in arithmetic.
    """

    low: float
    high: float
    because: str
    sign: str = ""
    """Bound at 0 that holds whatever is plausible: `gt`, `ge`, or none."""


def positive(low: float, high: float, because: str) -> Sound:
    """Return the plausible range of a number that must be above 0."""
    return Sound(low, high, because, "gt")


def not_negative(high: float, because: str) -> Sound:
    """Return the plausible range of a number from 0 on."""
    return Sound(0, high, because, "ge")


class Part(BaseModel):
    """Base class of all tables of a scenario: immutable, finite numbers, no unknown keys."""

    model_config = ConfigDict(
        frozen=True,
        extra="forbid",
        allow_inf_nan=False,
        use_attribute_docstrings=False,
        protected_namespaces=(),
        defer_build=True,  # builds validators of used tables only, to save start-up time
    )

    @model_serializer(mode="wrap")
    def _record(self, dump: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Dump the table without fields that are newer than the record and have their default."""
        written: dict[str, Any] = dump(self)
        for name, field in type(self).model_fields.items():
            is_late = _declared_with(type(self), name, "is_late")
            if is_late and getattr(self, name) == field.default:
                written.pop(name, None)
        return written


def number_in_text(text: str) -> float:
    """Read a number in ASCII notation, ignoring surrounding blanks.

    Returns
    -------
    float
        Infinite or NaN if the text says so.

    Raises
    ------
    ValueError
        If the text is anything else.
    """
    if _DECIMAL.fullmatch(text.strip(" \t")) is None:
        raise ValueError(f"{text!r} is not a number")
    return float(text)


def quantity(
    unit: str,
    description: str,
    default: object = ...,
    *,
    allowed: str = "",
    example: str = "",
    other_names: tuple[str, ...] = (),
    sound: Sound | None = None,
    is_late: bool = False,
    initial: object = None,
    unit_keys: Mapping[str, float] | None = None,
    **limits: Any,  # noqa: ANN401
) -> Any:  # noqa: ANN401
    """Declare a field with its unit.

    Parameters
    ----------
    unit : str
        SI unit as a Pyomo unit string, ``"1"`` for a plain number, ``""`` for text.
    default : object, optional
        Value if neither the scenario nor the library gives one; by default the field is required.
    allowed : str, optional
        The allowed texts in words, where a pattern would be hard to read.
    is_late : bool, optional
        Whether older records lack the field. Its default is the meaning of their silence, and new
        records leave it out while it has that value.
    initial : object, optional
        Value implied by a scenario file without the field, if it differs from the default of
        records.
    unit_keys : mapping, optional
        Keys by which a file may give the field in another unit, and that unit in ``unit``.
    """
    declared: dict[str, Any] = {} if initial is None else {"default": initial}
    if sound is not None:
        declared["sound"] = {"low": sound.low, "high": sound.high, "because": sound.because}
    if sound is not None and sound.sign:
        limits[sound.sign] = 0
    field = Field(
        default,
        description=description,
        json_schema_extra={
            "unit": unit,
            "allowed": allowed,
            "example": example,
            "other_names": list(other_names),
            "is_late": is_late,
            "unit_keys": dict(unit_keys or {}),
            **declared,
        },
        **limits,
    )
    if sound is not None:
        field.metadata.append(AfterValidator(partial(_sound, sound)))
    return field


#: Declares a field that older records lack: `quantity` with `is_late`.
late_quantity = partial(quantity, is_late=True)
#: Declares a text in one line.
title_field = partial(quantity, "", pattern=_ONE_LINE, allowed="one line", max_length=200)


def unit_of(model: type[BaseModel], name: str) -> str:
    """Return the unit declared for a field, empty for text and for tables.

    Returns
    -------
    str
        Unit string, empty when the field has none or does not exist.
    """
    return str(_declared_with(model, name, "unit"))


def allowed_text(model: type[BaseModel], name: str) -> str:
    """Return the allowed texts of a text field, in words.

    Returns
    -------
    str
        Text after "must be"; empty if the field declares none.
    """
    return str(_declared_with(model, name, "allowed"))


def example_of(model: type[BaseModel], name: str) -> str:
    """Return an example value of a field in TOML; empty if none is declared."""
    return str(_declared_with(model, name, "example"))


def other_names_of(model: type[BaseModel], name: str) -> tuple[str, ...]:
    """Return other names by which users may call a field."""
    return tuple(_declared_with(model, name, "other_names"))


def initial_of(model: type[BaseModel], name: str) -> Any:  # noqa: ANN401
    """Return the value that a field has in a file that leaves it out, None for the default."""
    return _declared_with(model, name, "default") or None


@cache
def unit_keys_of(model: type[BaseModel]) -> dict[str, tuple[str, float]]:
    """Return the keys by which a table takes numbers in other units: field and factor of each.

    An angle NAME in radians is also taken in degrees, as NAME_deg.
    """
    keys: dict[str, tuple[str, float]] = {}
    for name in model.model_fields:
        if unit_of(model, name) == "rad":
            keys[f"{name}{DEGREES}"] = (name, pi / 180)
        told: Any = _declared_with(model, name, "unit_keys") or {}
        keys |= {key: (name, factor) for key, factor in told.items()}
    return keys


def _declared_with(model: type[BaseModel], name: str, item: str) -> Any:  # noqa: ANN401
    field = model.model_fields.get(name)
    extra = field.json_schema_extra if field is not None else None
    return extra.get(item, "") if isinstance(extra, dict) else ""


def _sound(sound: Sound, value: Any) -> Any:  # noqa: ANN401
    numbers = value if isinstance(value, tuple) else (value,)
    if any(isinstance(n, int | float) and not sound.low <= n <= sound.high for n in numbers):
        each = "each " if isinstance(value, tuple) else ""
        allowed = f"{each}must be from {sound.low:g} to {sound.high:g}: {sound.because}"
        raise PydanticCustomError("unsound", "{allowed}", {"allowed": allowed})
    return value


FieldPath = tuple[str | int, ...]

# No field is half as deep; the code that follows a path recurses step by step.
_MOST_STEPS = 16
_STEP = re.compile(r"([A-Za-z0-9_-]+)((?:\[[0-9]{1,3}\])*)")


def parse_path(text: str) -> FieldPath | None:
    """Split `mission.goal.position[2]` into its steps.

    Returns
    -------
    tuple of str and int, or None
        The steps, None if the text is not a path or is deeper than any field.
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
    """Return the nesting depth of tables and lists, up to a maximum.

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
    """Yield path and value of every entry that is not a table."""
    for key, value in tree.items():
        if isinstance(value, Mapping):
            yield from leaves(value, (*prefix, key))
        else:
            yield (*prefix, key), value


def is_number(value: object) -> TypeGuard[float]:
    """Return whether a value is a number other than true or false."""
    return isinstance(value, int | float) and not isinstance(value, bool)


def value_at(tree: Any, *place: str | int) -> Any:  # noqa: ANN401  before validation
    """Return the value at a place of nested tables and lists, None where there is none."""
    for step in place:
        is_listed = isinstance(tree, list | tuple) and isinstance(step, int) and step < len(tree)
        tree = tree.get(step) if isinstance(tree, Mapping) else tree[step] if is_listed else None
    return tree


def table_at(tree: Any, *place: str | int) -> Mapping[str, Any]:  # noqa: ANN401  before validation
    """Return the table at a place of nested tables, empty where there is none."""
    found = value_at(tree, *place)
    return found if isinstance(found, Mapping) else {}


def merge(lower: Mapping[str, Any], upper: Mapping[str, Any]) -> dict[str, Any]:
    """Return a copy of a nested table overlaid by another one, whose values take precedence."""
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
