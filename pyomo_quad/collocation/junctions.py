"""Where limits begin and cease to hold the optimum: the junctions of its arcs.

Between two collocation points where a limit's activity changes, the optimum has a corner or
a jump that no polynomial follows.  The state equations are met there all the same, so that
their error estimate sees nothing; the objective does.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pyomo_quad.collocation.nodes import FloatArray
    from pyomo_quad.collocation.solution import Solution

__all__ = ["junction_elements"]


def junction_elements(solution: Solution) -> frozenset[int]:
    """Return the elements in or beside which the activity of a limit changes."""
    active = _active_limits(solution)
    changes = np.flatnonzero(np.any(active[1:] != active[:-1], axis=1))
    element = solution.mesh.element_of_point
    return frozenset(element[changes].tolist()) | frozenset(element[changes + 1].tolist())


def _active_limits(solution: Solution) -> NDArray[np.bool_]:
    """Say of every limit over time whether it holds at each point, shape (n_points, n_limits).

    At an interior-point solution the product of multiplier and slack is the same small
    number everywhere; a limit is active where the multiplier is the larger of the two.
    """
    program, layout = solution.program, solution.program.layout
    bounds, scaling = solution.bounds, solution.scaling
    density = scaling.objective / solution.mesh.quadrature_weights[:, None]
    columns = np.hstack([layout.state_columns[1:], layout.algebraic_columns])
    z, scale = solution.unknowns, scaling.unknowns
    held = bounds.lower == bounds.upper
    found = [
        _exceeds(multiplier / scale, np.abs(z - limit) * scale, held, columns, density)
        for multiplier, limit in (
            (solution.multipliers.lower, bounds.lower),
            (solution.multipliers.upper, bounds.upper),
        )
    ]
    rows = np.arange(program.first_condition_row).reshape(
        solution.mesh.points, program.compiled.n_equations
    )
    values = program.constraints(z)
    held = bounds.row_lower == bounds.row_upper
    multipliers, scale = solution.multipliers.rows, scaling.rows
    for limit, sign in ((bounds.row_lower, -1.0), (bounds.row_upper, 1.0)):
        pull = np.maximum(sign * multipliers, 0.0) / scale
        found.append(_exceeds(pull, np.abs(values - limit) * scale, held, rows, density))
    return np.hstack(found)


def _exceeds(
    multipliers: FloatArray,
    slacks: FloatArray,
    held: NDArray[np.bool_],
    positions: NDArray[np.intp],
    density: FloatArray,
) -> NDArray[np.bool_]:
    """Compare scaled multiplier densities with scaled slacks; equalities never count."""
    is_active = multipliers[positions] * density > slacks[positions]
    return np.asarray(is_active & ~held[positions])
