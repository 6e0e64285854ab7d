"""Active limits, and the elements in which limits become active or inactive (junctions).

The rule: see docs/theory/refinement.md, eq. (7).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pyomo_quad.collocation.mesh import FloatArray
    from pyomo_quad.collocation.solution import Solution

# Fractions of the horizon that differ by less are equal up to rounding.
SAME = 1e-12


def junction_elements(solution: Solution) -> frozenset[int]:
    """Return the indices of elements in or beside which a limit becomes active or inactive.

    Changes at breakpoints that the problem requires, where for example a parameter jumps, are not
    counted.
    """
    active = active_limits(solution)
    return _changing(solution, np.ones(active.shape[1], dtype=bool), active)


def switch_elements(solution: Solution) -> frozenset[int]:
    """Return the indices of elements in which only limits on algebraic variables change activity.

    Where a limit on a state becomes active or inactive, the state's costate may jump as well.
    """
    program, layout = solution.program, solution.program.layout
    path, n = program.compiled.path, layout.n_states
    of_states = np.isin(
        np.arange(program.compiled.n_equations), path.jacobian_rows[path.jacobian_columns < 2 * n]
    )
    is_algebraic = np.arange(n + layout.n_algebraics) >= n
    chosen = np.concatenate([np.tile(is_algebraic, 2), np.tile(~of_states, 2)])
    active = active_limits(solution)
    return _changing(solution, chosen, active) - _changing(solution, ~chosen, active)


def _changing(
    solution: Solution, limits: NDArray[np.bool_], active: NDArray[np.bool_]
) -> frozenset[int]:
    """Return the indices of elements in or beside which chosen limits change their activity.

    Parameters
    ----------
    solution : Solution
    limits : ndarray of bool, shape (n_limits,)
        The chosen limits.
    active : ndarray of bool, shape (n_points, n_limits)
        Whether each limit is active at each collocation point.
    """
    element = solution.mesh.element_of_point
    is_known = np.isin(element[1:], np.flatnonzero(known_boundaries(solution))) & (
        element[1:] > element[:-1]
    )
    changes = np.flatnonzero(np.any((active[1:] != active[:-1])[:, limits], axis=1) & ~is_known)
    return frozenset(element[changes].tolist()) | frozenset(element[changes + 1].tolist())


def known_boundaries(solution: Solution) -> NDArray[np.bool_]:
    """Return whether the problem requires each breakpoint of the mesh.

    Shape (n_elements + 1,). A breakpoint is required at start and end, where a condition is
    imposed, and where a parameter jumps.
    """
    required = solution.problem.required_breakpoints(solution.instance)
    starts = np.asarray(solution.mesh.breakpoints)
    return np.any(np.abs(starts[:, None] - np.array([0.0, *required, 1.0])) < SAME, axis=1)


def active_limits(solution: Solution) -> NDArray[np.bool_]:
    """Return whether each limit over time is active at each point, shape (n_points, n_limits).

    The limits are, in this order: lower bounds of states and algebraic variables, their upper
    bounds, lower sides of path equations, and their upper sides. At an interior-point solution the
    product of multiplier and slack is the same small number everywhere; a limit is active where the
    multiplier is the larger of the two.
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
    """Return whether scaled multiplier densities exceed scaled slacks; False for equalities.

    Parameters
    ----------
    multipliers, slacks : ndarray, shape (n,)
        Scaled multipliers and slacks of all unknowns or constraints.
    held : ndarray of bool, shape (n,)
        Whether lower and upper bound are equal.
    positions : ndarray of int, shape (n_points, n_limits)
        Position of each limit among the n.
    density : ndarray, shape (n_points, 1)
        Factor that makes a multiplier a scaled function of time.
    """
    is_active = multipliers[positions] * density > slacks[positions]
    return np.asarray(is_active & ~held[positions])
