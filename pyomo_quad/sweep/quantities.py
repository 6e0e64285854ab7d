"""Printed names, units and number formats of the fields and output columns of a sweep."""

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
# Columns whose least value is the worst, as with savings; of other columns the greatest is.
_BETTER_LARGE = ("range_m", "endurance_s", "lowest_voltage_V")


@dataclass(frozen=True, kw_only=True)
class Quantity:
    """Printed form of a table column of a sweep: name, unit, and factor to the printed unit.

    Attributes
    ----------
    column : str
        Name of the column: an output, or the dotted path of a scenario field.
    name, unit : str
        Name and unit in print.
    scale : float
        Factor from the column's unit to the printed unit.
    """

    column: str
    name: str
    unit: str
    scale: float = 1.0

    def of(self, frame: pd.DataFrame) -> pd.Series:
        """Return the quantity's column of a result table, converted to the printed unit."""
        return frame[self.column] * self.scale

    def worst_row(self, frame: pd.DataFrame) -> pd.Series:
        """Return the row of a result table in which the quantity is worst.

        For savings, range, endurance and lowest voltage, the least value is worst. For all other
        quantities, the greatest value is worst.
        """
        is_rising = not (self.column in _BETTER_LARGE or self.column.startswith("saving_"))
        return frame.sort_values(
            self.column, ascending=is_rising, na_position="first", kind="stable"
        ).iloc[-1]

    @property
    def label(self) -> str:
        """Label of a chart's axis: the name with a capital letter, and the printed unit."""
        return f"{self.name[:1].upper()}{self.name[1:]}" + (f" ({self.unit})" if self.unit else "")


def field_quantity(path: str) -> Quantity:
    """Return printed name and unit of a scenario field, and the factor to the printed unit.

    `path` is the dotted path of the field, such as "mission.duration".
    """
    unit = field_unit(path)
    name = " ".join(path.split(".")[-2:]).replace("_", " ")
    return _quantity(path, name, _PRINTED.get(unit, unit))


def output_quantity(column: str) -> Quantity:
    """Return printed name and unit of a sweep's output column, and the factor to this unit.

    `column` is the name of the column, such as "energy_J".
    """
    unit = unit_of_column(column)
    name = column.removesuffix(f"_{unit}").replace("_", " ")
    return _quantity(column, name, _PRINTED.get(unit, unit))


def _quantity(column: str, name: str, unit: str) -> Quantity:
    if unit == "rad":
        return Quantity(column=column, name=name, unit="°", scale=degrees(1.0))
    return Quantity(column=column, name=name, unit=unit)


def number(value: object) -> str:
    """Format a value of a result table with four significant digits, or five from 10,000 to 99,999.

    A missing number (NaN) becomes a dash; a value that is not a float is printed as it is.
    """
    if not isinstance(value, float):
        return str(value)
    if pd.isna(value):
        return NOTHING
    if 1.0 <= abs(value) < _LARGE:
        whole = len(f"{abs(value):.0f}")
        return f"{value:.{max(0, _SIGNIFICANT - whole)}f}"
    return f"{value:.{_SIGNIFICANT}g}"


def setting(value: object) -> str:
    """Format the value of a scenario field as text, without trailing zeros."""
    text = number(value)
    is_padded = isinstance(value, float) and "." in text and "e" not in text
    return text.rstrip("0").rstrip(".") if is_padded else text


def settings_name(fixed: Mapping[str, Any]) -> str:
    """Return the name of a curve for a chart's legend: the field values that all its cases share.

    An example is "mass 1.2 kg, momentum". A text value is printed without the name of its field.
    Without fields in `fixed`, the name is "all cases".
    """
    parts = [
        value.replace("_", " ")
        if isinstance(value, str)
        else f"{path.rsplit('.', maxsplit=1)[-1].replace('_', ' ')} {_with_unit(path, value)}"
        for path, value in fixed.items()
    ]
    return ", ".join(parts) or "all cases"


def case_name(fields: Mapping[str, Any]) -> str:
    """Return the printed name of a sweep's central case: its field values, such as "a.b = 1 m".

    The docstring of `sweep.statistics` defines the central case. If all fields that vary are
    random, `fields` is empty and the name is "the middle of the draws".
    """
    parts = [f"{path} = {_with_unit(path, value)}" for path, value in fields.items()]
    return ", ".join(parts) or "the middle of the draws"


def _with_unit(path: str, value: Any) -> str:  # noqa: ANN401  a value of any field
    shown = field_quantity(path)
    size = setting(value * shown.scale if isinstance(value, float) else value)
    return f"{size} {shown.unit}".strip()
