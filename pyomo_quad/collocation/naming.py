"""Names of the nonlinear program's unknowns and rows, in the words of the Pyomo model."""

from __future__ import annotations

import re
from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np
from pyomo.core.base.units_container import UnitsError
from pyomo.environ import units

if TYPE_CHECKING:
    from pyomo_quad.collocation.transcription import Transcription

__all__ = ["Place", "declared_unit", "family_name", "row_place", "unknown_place"]

# What a derived unit of the same size and dimension is called; a moment before a work.
_CALLED = {
    "N": units.N,
    "N*m": units.get_units(units.N * units.m),
    "W": units.W,
    "V": units.V,
    "A": units.A,
}
# An angle is a number: Pyomo keeps the radians of a squared speed, engineers do not.
_ANGLES = (units.dimensionless, units.rad, units.rad**2)
_ROUNDING = 1e-12
_ANGLE_FACTOR = re.compile(r"\*rad(\*\*[\d.]+)?")


@dataclass(frozen=True, kw_only=True)
class Place:
    """A component of the model, and where on the horizon: None where time has no part."""

    name: str
    time: float | None = None
    element: int | None = None
    point: int | None = None

    def __str__(self) -> str:
        if self.time is None:
            return self.name
        where = f"{self.name} at time {self.time:.6g}"
        if self.element is None:
            return where
        return f"{where} (element {self.element + 1}, point {self.point})"


def _at_point(program: Transcription, name: str, point: int) -> Place:
    mesh = program.mesh
    if mesh is None:
        return Place(name=name)
    element = int(mesh.element_of_point[point])
    return Place(
        name=name,
        time=program.time_of(float(mesh.point_fractions[point])),
        element=element,
        point=int(point - mesh.first_node[element] + 1),
    )


def row_place(program: Transcription, row: int) -> Place:
    """Return the equation, time, element and point of a row."""
    compiled = program.compiled
    declared = compiled.declared
    if row < program.first_condition_row:
        point, equation = divmod(row, compiled.n_equations)
        return _at_point(program, declared.equations[equation].name, point)
    if row < program.first_integral_row:
        return Place(name=declared.conditions[row - program.first_condition_row].name)
    integral = list(compiled.static_of_integral)[row - program.first_integral_row]
    return Place(name=declared.integrals[integral].name)


def unknown_place(program: Transcription, column: int) -> Place:
    """Return the variable, time, element and point of an unknown."""
    layout, declared = program.layout, program.compiled.declared
    if column >= layout.unknowns - layout.n_statics:
        return Place(name=declared.statics[column - (layout.unknowns - layout.n_statics)].name)
    for slots, columns, first in (
        (declared.states, layout.state_columns, -1),
        (declared.algebraics, layout.algebraic_columns, 0),
    ):
        found = np.argwhere(columns == column)
        if found.size:
            row, slot = (int(k) for k in found[0])
            point = row + first
            if point < 0:
                return Place(name=slots[slot].name, time=program.time_of(0.0))
            return _at_point(program, slots[slot].name, point)
    raise IndexError(column)


def family_name(name: str) -> str:
    """Return the component that a row, bound or condition belongs to."""
    return name.split("[", 1)[0].split(" at time", 1)[0]


def declared_unit(model: Any, name: str) -> str:
    """Return the unit of a constraint's body or of a variable, "" where it has none."""
    component = model.find_component(family_name(name))
    data: Any = None if component is None else next(iter(component.values()), None)
    try:
        unit = units.get_units(data if data.is_variable_type() else data.body)
    except (UnitsError, AttributeError):
        return ""
    return "" if unit is None or str(unit) == "dimensionless" else _spelled(unit)


def _spelled(unit: Any) -> str:
    """Return a unit as an engineer writes it: Pyomo's N*rad**2 of a thrust is N."""
    text = str(unit)
    if "*" not in text and "/" not in text:
        return text
    for angle, (called, plain) in product(_ANGLES, _CALLED.items()):
        try:
            factor = units.convert_value(
                1.0, from_units=units.get_units(unit / angle), to_units=plain
            )
        except UnitsError:
            continue
        if abs(factor - 1.0) < _ROUNDING:
            return called
    return _ANGLE_FACTOR.sub("", text)
