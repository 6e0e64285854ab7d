"""Printed quantities of a sweep: names, units and table cells."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import degrees
from typing import Any

import pandas as pd

from pyomo_quad.report.render import NOTHING
from pyomo_quad.scenario import field_unit
from pyomo_quad.sweep.case import unit_of_column

_PRINTED = {"kg": "kg", "m/s^2": "m/s²", "percent": "%", "A*hr": "A h", "1/A/hr": "1/(A h)"}
_LARGE, _SIGNIFICANT = 1e5, 4
# For these columns and for savings, the least value is the worst; otherwise the greatest is.
_BETTER_LARGE = ("range_m", "endurance_s", "lowest_voltage_V")


@dataclass(frozen=True, kw_only=True)
class Quantity:
    """Printed column: name, unit, and factor to that unit."""

    column: str
    name: str
    unit: str
    scale: float = 1.0

    def of(self, frame: pd.DataFrame) -> pd.Series:
        """Return the column in the printed unit."""
        return frame[self.column] * self.scale

    def worst_row(self, frame: pd.DataFrame) -> pd.Series:
        """Return the row of a table where the quantity is worst."""
        is_rising = not (self.column in _BETTER_LARGE or self.column.startswith("saving_"))
        return frame.sort_values(
            self.column, ascending=is_rising, na_position="first", kind="stable"
        ).iloc[-1]

    @property
    def label(self) -> str:
        """Label of an axis: name and unit."""
        return f"{self.name[:1].upper()}{self.name[1:]}" + (f" ({self.unit})" if self.unit else "")


def field_quantity(path: str) -> Quantity:
    """Return name, unit and scale of a scenario field in print."""
    unit = field_unit(path)
    name = " ".join(path.split(".")[-2:]).replace("_", " ")
    return _quantity(path, name, _PRINTED.get(unit, unit))


def output_quantity(column: str) -> Quantity:
    """Return name, unit and scale of an output column in print."""
    unit = unit_of_column(column)
    name = column.removesuffix(f"_{unit}").replace("_", " ")
    return _quantity(column, name, _PRINTED.get(unit, unit))


def _quantity(column: str, name: str, unit: str) -> Quantity:
    if unit == "rad":
        return Quantity(column=column, name=name, unit="°", scale=degrees(1.0))
    return Quantity(column=column, name=name, unit=unit)


def number(value: object) -> str:
    """Return a number of a result as the text of a table cell."""
    if not isinstance(value, float):
        return str(value)
    if pd.isna(value):
        return NOTHING
    if 1.0 <= abs(value) < _LARGE:
        whole = len(f"{abs(value):.0f}")
        return f"{value:.{max(0, _SIGNIFICANT - whole)}f}"
    return f"{value:.{_SIGNIFICANT}g}"


def setting(value: object) -> str:
    """Return a field's value as text, without trailing zeros."""
    text = number(value)
    is_padded = isinstance(value, float) and "." in text and "e" not in text
    return text.rstrip("0").rstrip(".") if is_padded else text


def settings_name(fixed: Mapping[str, Any]) -> str:
    """Return the name of a curve from its constant fields."""
    parts = [
        value.replace("_", " ")
        if isinstance(value, str)
        else f"{path.rsplit('.', maxsplit=1)[-1].replace('_', ' ')} {_with_unit(path, value)}"
        for path, value in fixed.items()
    ]
    return ", ".join(parts) or "all cases"


def case_name(fields: Mapping[str, Any]) -> str:
    """Return the name of the central case of maps and sensitivities.

    Parameters
    ----------
    fields : mapping
        Scenario field -> value; empty if all fields are random.
    """
    parts = [f"{path} = {_with_unit(path, value)}" for path, value in fields.items()]
    return ", ".join(parts) or "the middle of the draws"


def _with_unit(path: str, value: Any) -> str:  # noqa: ANN401  a value of any field
    shown = field_quantity(path)
    size = setting(value * shown.scale if isinstance(value, float) else value)
    return f"{size} {shown.unit}".strip()
