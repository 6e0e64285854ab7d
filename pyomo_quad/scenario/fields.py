"""How a scenario field is declared: frozen, closed to unknown keys, with its unit beside it.

Fields stand in nested tables, as TOML gives them: these have dotted paths, layers and a depth.
"""

import re
from collections.abc import Iterator, Mapping
from functools import partial
from math import pi
from typing import Annotated, Any, NamedTuple

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

# Strict, so that "10" and true are refused where a number is meant; an integer still serves as one.
Number = Annotated[float, Strict()]
WholeNumber = Annotated[int, Strict()]
Text = Annotated[str, Strict()]
Flag = Annotated[bool, Strict()]
Triple = tuple[Number, Number, Number]

#: Ending of keys that give an angle in degrees.
DEGREES = "_deg"

# What a table or a command line may give as a number: Python's own `float` takes "2_0" as well,
# and the digits of any script.
_DECIMAL = re.compile(
    r"[+-]?(?:(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?|inf|infinity|nan)", re.IGNORECASE
)

# Pattern of a title: no line break and no other control character.
ONE_LINE = r"^[^\x00-\x1f\x7f-\x9f\u2028\u2029]*$"


class Sound(NamedTuple):
    """Smallest and largest number that anything real can have, and why in words.

    Beyond lies a slip of the pen or a wrong unit, and arithmetic that overflows.
    """

    low: float
    high: float
    because: str


class Part(BaseModel):
    """Base of all tables of a scenario: immutable, finite numbers, no unknown keys."""

    model_config = ConfigDict(
        frozen=True,
        extra="forbid",
        allow_inf_nan=False,
        use_attribute_docstrings=False,
        protected_namespaces=(),
        defer_build=True,  # of the many tables, only those in use are worth the time
    )

    @model_serializer(mode="wrap")
    def _record(self, dump: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Write the table down without what it has as it was before there was a field for it."""
        written: dict[str, Any] = dump(self)
        for name, field in type(self).model_fields.items():
            is_late = _declared_with(type(self), name, "is_late")
            if is_late and getattr(self, name) == field.default:
                written.pop(name, None)
        return written


def number_in_text(text: str) -> float:
    """Read a number written with the ASCII digits, point and exponent; blanks around it are none.

    Returns
    -------
    float
        Infinite or NaN where the text says so.

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
        Value when neither the scenario nor the library gives one; none by default.
    allowed : str, optional
        What a text must be, in words, where a pattern would be hard to read.
    is_late : bool, optional
        Whether there are records older than the field: its default is what they mean by saying
        nothing, and records leave it out while it has that value.
    initial : object, optional
        What a scenario file means that says nothing, where that is not what a record means.
    unit_keys : mapping, optional
        Keys by which a file may give the field in another unit, and that unit in ``unit``.
    """
    declared: dict[str, Any] = {} if initial is None else {"default": initial}
    field = Field(
        default,
        description=description,
        json_schema_extra={
            "unit": unit,
            "allowed": allowed,
            "example": example,
            "other_names": list(other_names),
            "sound": None if sound is None else sound._asdict(),
            "is_late": is_late,
            "unit_keys": dict(unit_keys or {}),
            **declared,
        },
        **limits,
    )
    if sound is not None:
        field.metadata.append(AfterValidator(partial(_sound, sound)))
    return field


def unit_of(model: type[BaseModel], name: str) -> str:
    """Return the unit declared for a field, empty for text and for tables.

    Returns
    -------
    str
        Unit string, empty when the field has none or does not exist.
    """
    return str(_declared_with(model, name, "unit"))


def allowed_text(model: type[BaseModel], name: str) -> str:
    """Return what a text field must be, in words.

    Returns
    -------
    str
        What follows "must be", empty when the field says nothing.
    """
    return str(_declared_with(model, name, "allowed"))


def example_of(model: type[BaseModel], name: str) -> str:
    """Return a value that a field could have, as TOML writes it; empty when none is declared."""
    return str(_declared_with(model, name, "example"))


def other_names_of(model: type[BaseModel], name: str) -> tuple[str, ...]:
    """Return what people call a field elsewhere."""
    return tuple(_declared_with(model, name, "other_names"))


def initial_of(model: type[BaseModel], name: str) -> Any:  # noqa: ANN401
    """Return what a scenario file means by not saying a field, None where that is its default."""
    return _declared_with(model, name, "default") or None


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
