"""A solution on one mesh as the first point on another, multipliers included."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pyomo_quad.collocation.guess import point_from_trajectory
from pyomo_quad.collocation.ipopt import Multipliers
from pyomo_quad.collocation.trajectory import interpolate

if TYPE_CHECKING:
    from pyomo_quad.collocation.mesh import Mesh
    from pyomo_quad.collocation.nodes import FloatArray
    from pyomo_quad.collocation.solution import Solution
    from pyomo_quad.collocation.transcription import Transcription

__all__ = ["transfer"]


def transfer(solution: Solution, program: Transcription) -> tuple[FloatArray, Multipliers]:
    """Return unknowns and multipliers of a solution on the mesh of a program.

    Multipliers of what is imposed at a point are, divided by the quadrature weight there,
    samples of a function of time; that function is what is carried over.
    """
    z = point_from_trajectory(program, solution.trajectory)
    if solution.mesh == program.mesh:
        return z, solution.multipliers
    old, new = solution.trajectory.mesh, program.mesh
    if new is None:
        return z, solution.multipliers
    layout, n = program.layout, program.compiled.n_equations
    rows = np.zeros(program.n_rows)
    held = solution.multipliers.rows
    per_point = held[: old.points * n].reshape(old.points, n)
    rows[: program.first_condition_row] = _carried(old, new, per_point).ravel()
    rows[program.first_condition_row :] = held[old.points * n :]
    sides = []
    for side in (solution.multipliers.lower, solution.multipliers.upper):
        on_new = np.zeros(layout.unknowns)
        states, algebraics, statics = solution.split(side)
        on_new[layout.state_columns[0]] = states[0]
        on_new[layout.state_columns[1:]] = np.maximum(_carried(old, new, states[1:]), 0.0)
        on_new[layout.algebraic_columns] = np.maximum(_carried(old, new, algebraics), 0.0)
        on_new[layout.static_columns] = statics
        sides.append(on_new)
    return z, Multipliers(rows=rows, lower=sides[0], upper=sides[1])


def _carried(old: Mesh, new: Mesh, values: FloatArray) -> FloatArray:
    density = values / old.quadrature_weights[:, None]
    moved = interpolate(old, density, new.point_fractions, with_start=False)
    return moved * new.quadrature_weights[:, None]
