"""How a scenario field is declared: frozen, closed to unknown keys, with its unit beside it."""

import re
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, Strict

__all__ = [
    "ONE_LINE",
    "Flag",
    "Number",
    "Part",
    "Text",
    "Triple",
    "WholeNumber",
    "allowed_text",
    "number_in_text",
    "quantity",
    "unit_of",
]

# Strict, so that "10" and true are refused where a number is meant; an integer still serves as one.
Number = Annotated[float, Strict()]
WholeNumber = Annotated[int, Strict()]
Text = Annotated[str, Strict()]
Flag = Annotated[bool, Strict()]
Triple = tuple[Number, Number, Number]

# What a table or a command line may give as a number: Python's own `float` takes "2_0" as well,
# and the digits of any script.
_DECIMAL = re.compile(
    r"[+-]?(?:(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?|inf|infinity|nan)", re.IGNORECASE
)

# Pattern of a title: no line break and no other control character.
ONE_LINE = r"^[^\x00-\x1f\x7f-\x9f\u2028\u2029]*$"


class Part(BaseModel):
    """Base of all tables of a scenario: immutable, finite numbers, no unknown keys."""

    model_config = ConfigDict(
        frozen=True,
        extra="forbid",
        allow_inf_nan=False,
        use_attribute_docstrings=False,
        protected_namespaces=(),
    )


def number_in_text(text: str) -> float:
    """Read a number written with the ASCII digits, point and exponent; blanks around it are none.

    Parameters
    ----------
    text : str
        From a table or a command line.

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
    **limits: Any,  # noqa: ANN401
) -> Any:  # noqa: ANN401
    """Declare a field with its unit.

    Parameters
    ----------
    unit : str
        SI unit as a Pyomo unit string, ``"1"`` for a plain number, ``""`` for text.
    description : str
        One line for the documentation and for ``pyomo-quad check``.
    default : object, optional
        Value when neither the scenario nor the library gives one; none by default.
    allowed : str, optional
        What a text must be, in words, where a pattern would be hard to read.
    **limits
        Bounds as pydantic names them: ``gt``, ``ge``, ``lt``, ``le``, ``min_length``, ...

    Returns
    -------
    FieldInfo
        To stand on the right of an annotated attribute.
    """
    return Field(
        default,
        description=description,
        json_schema_extra={"unit": unit, "allowed": allowed},
        **limits,
    )


def unit_of(model: type[BaseModel], name: str) -> str:
    """Return the unit declared for a field, empty for text and for tables.

    Parameters
    ----------
    model : type of BaseModel
        The table that holds the field.
    name : str
        The field's name in that table.

    Returns
    -------
    str
        Unit string, empty when the field has none or does not exist.
    """
    return _declared_with(model, name, "unit")


def allowed_text(model: type[BaseModel], name: str) -> str:
    """Return what a text field must be, in words.

    Parameters
    ----------
    model : type of BaseModel
        The table that holds the field.
    name : str
        The field's name in that table.

    Returns
    -------
    str
        What follows "must be", empty when the field says nothing.
    """
    return _declared_with(model, name, "allowed")


def _declared_with(model: type[BaseModel], name: str, item: str) -> str:
    field = model.model_fields.get(name)
    extra = field.json_schema_extra if field is not None else None
    return str(extra.get(item, "")) if isinstance(extra, dict) else ""
