"""Declaration of scenario fields with unit, meaning and plausible range; access by dotted path.

Fields are in nested tables, as in TOML. A dotted path such as `mission.goal.position[2]` locates a
field. In the program the path is a tuple of keys and list indices.
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

# Strict types, so that "10" and true are refused as numbers; an integer is accepted as a float.
Number = Annotated[float, Strict()]
WholeNumber = Annotated[int, Strict()]
Text = Annotated[str, Strict()]
Flag = Annotated[bool, Strict()]
Triple = tuple[Number, Number, Number]

#: Ending of keys that give an angle in degrees.
DEGREES = "_deg"

# Notation of numbers in files of tables and on the command line. Python's `float` would also accept
# "2_0" and the digits of any script.
_DECIMAL = re.compile(
    r"[+-]?(?:(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?|inf|infinity|nan)", re.IGNORECASE
)

# Pattern of a title: no line break and no other control character.
_ONE_LINE = r"^[^\x00-\x1f\x7f-\x9f\u2028\u2029]*$"


class Sound(NamedTuple):
    """Plausible range of a numeric scenario field, and the reason for the range in words.

    A number outside is refused: it is probably a typing error.

    Attributes
    ----------
    low, high : float
        Ends of the range, in the field's unit.
    because : str
        Reason for the range, for messages and the documentation.
    sign : str
        "gt" if the number must also be greater than 0, "ge" if at least 0, else "".
    """

    low: float
    high: float
    because: str
    sign: str = ""


def positive(low: float, high: float, because: str) -> Sound:
    """Return the plausible range of a number that must be above 0.

    Parameters
    ----------
    low, high : float
        Ends of the range, in the field's unit.
    because : str
        Reason for the range.
    """
    return Sound(low, high, because, "gt")


def not_negative(high: float, because: str) -> Sound:
    """Return the plausible range of a number that must be 0 or above.

    Parameters
    ----------
    high : float
        Upper end of the range, in the field's unit.
    because : str
        Reason for the range.
    """
    return Sound(0, high, because, "ge")


class Part(BaseModel):
    """Base class of all tables of a scenario.

    A table is immutable, has finite numbers only, and refuses unknown keys. Unit and meaning of
    each field are in the field's declaration, see `quantity`.
    """

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
        """Serialise the table for a record, such as the scenario in the summary of a report.

        Fields declared with `is_late` (see `quantity`) are left out if they have their default
        value.
        """
        written: dict[str, Any] = dump(self)
        for name, field in type(self).model_fields.items():
            is_late = _declared_with(type(self), name, "is_late")
            # A scenario that uses no late field thus has the same record in all versions of the
            # package.
            if is_late and getattr(self, name) == field.default:
                written.pop(name, None)
        return written


def number_in_text(text: str) -> float:
    """Convert the text of a number, written in ASCII, to a float; surrounding blanks are ignored.

    Returns
    -------
    float
        The number; infinite or NaN if the text is ``inf`` or ``nan``.

    Raises
    ------
    ValueError
        If the text is not a number.
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
    """Declare a field of a scenario's table, with unit, meaning and allowed values.

    Parameters
    ----------
    unit : str
        A Pyomo unit string: ``"1"`` for a plain number, ``""`` for texts and tables.
    description : str
        Meaning of the field, in one line.
    default : object, optional
        Default of the field; without it the field is required.
    allowed : str, optional
        Description of the allowed texts, for a field whose texts must match a pattern.
    example : str, optional
        Example in TOML, for the message on a missing field.
    other_names : tuple of str, optional
        Keys that users may write by mistake; a message then names the field.
    sound : Sound, optional
        Plausible range of a number; numbers outside are refused.
    is_late : bool, optional
        Whether earlier versions of the package lack the field. A stored scenario omits such a
        field if it has its default.
    initial : object, optional
        Value that the field gets instead of `default` if a user's scenario file omits it.
    unit_keys : mapping, optional
        Keys for other units, such as ``kv_rpm_per_V``, each with its factor to `unit`.
    **limits
        Constraints of pydantic, such as ``gt=0``.
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


#: Declare a field that older records (stored scenarios) lack: `quantity` with `is_late` set.
late_quantity = partial(quantity, is_late=True)
#: Declare a field with a text of one line, such as a title.
title_field = partial(quantity, "", pattern=_ONE_LINE, allowed="one line", max_length=200)


def unit_of(model: type[BaseModel], name: str) -> str:
    """Return the unit of a field of a scenario's table.

    The unit is empty if the field has none or does not exist.
    """
    return str(_declared_with(model, name, "unit"))


def allowed_text(model: type[BaseModel], name: str) -> str:
    """Return the description of the texts that a field accepts, for error messages.

    The words follow "must be" in a message. They are empty if the field has no description.
    """
    return str(_declared_with(model, name, "allowed"))


def example_of(model: type[BaseModel], name: str) -> str:
    """Return the example value of a table's field, in TOML; empty if none is declared.

    `model` is the model class of the table, and `name` the name of the field.
    """
    return str(_declared_with(model, name, "example"))


def other_names_of(model: type[BaseModel], name: str) -> tuple[str, ...]:
    """Return keys that users may write by mistake for a field, such as `time` for `duration`.

    `model` is the model class of the table that has the field, and `name` the name of the field.
    """
    return tuple(_declared_with(model, name, "other_names"))


def initial_of(model: type[BaseModel], name: str) -> Any:  # noqa: ANN401
    """Return the initial value of a field, or None if the field has no initial value.

    A field gets its initial value if a user's scenario file omits it. It gets its default if a
    stored scenario omits it.
    """
    # Initial values 0, False and "" also give None.
    return _declared_with(model, name, "default") or None


@cache
def unit_keys_of(model: type[BaseModel]) -> dict[str, tuple[str, float]]:
    """Return the keys by which a table's fields may be given in other units.

    Each key leads to the field's name, and to the factor from the key's unit. An example is
    ``{"roll_max_deg": ("roll_max", pi / 180)}``.
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
    # A number outside the range may be in a wrong unit, and might cause overflow.
    if any(isinstance(n, int | float) and not sound.low <= n <= sound.high for n in numbers):
        each = "each " if isinstance(value, tuple) else ""
        allowed = f"{each}must be from {sound.low:g} to {sound.high:g}: {sound.because}"
        raise PydanticCustomError("unsound", "{allowed}", {"allowed": allowed})
    return value


FieldPath = tuple[str | int, ...]

# Largest number of steps of a path, twice the depth of any field; functions that follow a path
# recurse once for each step.
_MOST_STEPS = 16
_STEP = re.compile(r"([A-Za-z0-9_-]+)((?:\[[0-9]{1,3}\])*)")


def parse_path(text: str) -> FieldPath | None:
    """Split a field's path such as `mission.goal.position[2]` into keys and list indices.

    This example gives ``("mission", "goal", "position", 2)``. The result is None if the text is not
    a path, or longer than the path of any field.
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
    """Return a path, given as keys and list indices, as text: `mission.goal.position[2]`."""
    text = "".join(f"[{step}]" if isinstance(step, int) else f".{step}" for step in path)
    return text.removeprefix(".")


def depth(value: object, allowed: int) -> int:
    """Return the nesting depth of tables and lists, at most ``allowed + 1``.

    A plain value has depth 0. Deeper levels are not counted, so that malicious input takes little
    time.
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
    """Yield path and value of each entry of nested tables that is not itself a table.

    Parameters
    ----------
    tree : mapping
        Nested tables. A list counts as one value.
    prefix : tuple, optional
        Path of `tree` in a larger scenario, put before each yielded path.
    """
    for key, value in tree.items():
        if isinstance(value, Mapping):
            yield from leaves(value, (*prefix, key))
        else:
            yield (*prefix, key), value


def is_number(value: object) -> TypeGuard[float]:
    """Return whether a value is an integer or float; true and false are not numbers."""
    return isinstance(value, int | float) and not isinstance(value, bool)


def value_at(tree: Any, *place: str | int) -> Any:  # noqa: ANN401  before validation
    """Return the value at a path in nested tables and lists; None if the path does not exist.

    The path `place` consists of table keys and list indices.
    """
    for step in place:
        is_listed = isinstance(tree, list | tuple) and isinstance(step, int) and step < len(tree)
        tree = tree.get(step) if isinstance(tree, Mapping) else tree[step] if is_listed else None
    return tree


def table_at(tree: Any, *place: str | int) -> Mapping[str, Any]:  # noqa: ANN401  before validation
    """Return the table at a path in nested tables and lists; an empty table if there is none.

    The path `place` consists of table keys and list indices.
    """
    found = value_at(tree, *place)
    return found if isinstance(found, Mapping) else {}


def merge(lower: Mapping[str, Any], upper: Mapping[str, Any]) -> dict[str, Any]:
    """Merge two nested tables into a new one; values of `upper` take precedence.

    If a key is in both, and both its values are tables, these are merged. Other values are not
    copied.
    """
    merged = dict(lower)
    for key, value in upper.items():
        below = merged.get(key)
        both_tables = isinstance(below, Mapping) and isinstance(value, Mapping)
        merged[key] = merge(below, value) if both_tables else value  # type: ignore[arg-type]
    return merged


def set_value(tree: object, path: FieldPath, value: object) -> Any:  # noqa: ANN401
    """Return a copy of nested tables and lists with the value at one path replaced.

    Missing tables are created. Raises LookupError if the path goes through a plain value, or past
    the end of a list.
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
