"""What the columns of a sweep are called in print, and in which unit they are shown."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import degrees
from typing import Any

import pandas as pd

from pyomo_quad.report.render import NOTHING
from pyomo_quad.scenario import field_unit

_SUFFIXES = {
    "_m_per_s": "m/s",
    "_percent": "%",
    "_rad": "rad",
    "_J": "J",
    "_W": "W",
    "_V": "V",
    "_m": "m",
    "_s": "s",
}
_PRINTED = {"kg": "kg", "m/s^2": "m/s²", "percent": "%", "A*hr": "A h", "1/A/hr": "1/(A h)"}
_LARGE, _SIGNIFICANT = 1e5, 4
# Of all other results the greatest is the worst.
_BETTER_LARGE = ("range_m", "endurance_s", "lowest_voltage_V")
_BETTER_LARGE_START = "saving_"


@dataclass(frozen=True, kw_only=True)
class Quantity:
    """One column: its name and unit in print, and what turns its values into that unit."""

    column: str
    name: str
    unit: str
    scale: float = 1.0

    def of(self, frame: pd.DataFrame) -> pd.Series:
        """Return the column in the printed unit."""
        return frame[self.column] * self.scale

    def worst_row(self, frame: pd.DataFrame) -> pd.Series:
        """Return the row of a table where the quantity is worst."""
        is_better_large = self.column in _BETTER_LARGE or self.column.startswith(
            _BETTER_LARGE_START
        )
        ordered = frame.sort_values(
            self.column, ascending=not is_better_large, na_position="first", kind="stable"
        )
        return ordered.iloc[-1]

    @property
    def label(self) -> str:
        """Name and unit, as beside an axis."""
        return f"{self.name[:1].upper()}{self.name[1:]}" + (f" ({self.unit})" if self.unit else "")


def field_quantity(path: str) -> Quantity:
    """Return how a scenario field is printed."""
    unit = field_unit(path)
    name = " ".join(path.split(".")[-2:]).replace("_", " ")
    if unit == "rad":
        return Quantity(column=path, name=name, unit="°", scale=degrees(1.0))
    return Quantity(column=path, name=name, unit=_PRINTED.get(unit, unit))


def output_quantity(column: str) -> Quantity:
    """Return how a column of results is printed."""
    for suffix, unit in _SUFFIXES.items():
        if column.endswith(suffix):
            name = column.removesuffix(suffix).replace("_", " ")
            if unit == "rad":
                return Quantity(column=column, name=name, unit="°", scale=degrees(1.0))
            return Quantity(column=column, name=name, unit=unit)
    return Quantity(column=column, name=column.replace("_", " "), unit="")


def number(value: object) -> str:
    """Return a result as a cell of a table."""
    if not isinstance(value, float):
        return str(value)
    if pd.isna(value):
        return NOTHING
    if 1.0 <= abs(value) < _LARGE:
        whole = len(f"{abs(value):.0f}")
        return f"{value:.{max(0, _SIGNIFICANT - whole)}f}"
    return f"{value:.{_SIGNIFICANT}g}"


def setting(value: object) -> str:
    """Return the value of a field, without zeros that say nothing."""
    text = number(value)
    is_padded = isinstance(value, float) and "." in text and "e" not in text
    return text.rstrip("0").rstrip(".") if is_padded else text


def settings_name(fixed: Mapping[str, Any]) -> str:
    """Return what a curve is called, by the fields that are the same along it."""
    parts = []
    for path, value in fixed.items():
        if isinstance(value, str):
            parts.append(value.replace("_", " "))
            continue
        shown = field_quantity(path)
        size = setting(value * shown.scale) if isinstance(value, float) else setting(value)
        name = path.rsplit(".", maxsplit=1)[-1].replace("_", " ")
        parts.append(f"{name} {size} {shown.unit}".strip())
    return ", ".join(parts) or "all cases"


def case_name(fields: Mapping[str, Any]) -> str:
    """Return what the case is called through which maps and sensitivities go.

    Parameters
    ----------
    fields : mapping
        Scenario field -> value; empty where all fields are random.
    """
    parts = []
    for path, value in fields.items():
        shown = field_quantity(path)
        size = setting(value * shown.scale) if isinstance(value, float) else setting(value)
        parts.append(f"{path} = {size} {shown.unit}".strip())
    return ", ".join(parts) or "the middle of the draws"
