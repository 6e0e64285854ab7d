"""Names of the nonlinear program's unknowns and rows, in the words of the Pyomo model."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from pyomo_quad.collocation.transcription import Transcription

__all__ = ["Place", "row_place", "unknown_place"]


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
