"""Active limits, and the elements in which limits become active or inactive (junctions).

A limit counts as active where its scaled multiplier exceeds its scaled slack (the distance to the
limit): see docs/theory/refinement.md, eq. (7). Arrays of limits over time have this order: lower
bounds of states and algebraic variables, upper bounds of these variables, lower sides of path
equations, and upper sides of path equations.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pyomo_quad.collocation.mesh import FloatArray
    from pyomo_quad.collocation.solution import Solution

# A change of a variable by more than this fraction of its range counts as a jump.
JUMP_SHARE = 0.25
# Number of points from which a kink's time is extrapolated.
_EXTRAPOLATED = 3
# Fractions of the horizon that differ by less are equal up to rounding.
SAME = 1e-12


def junction_elements(solution: Solution) -> frozenset[int]:
    """Return the indices of elements in or beside which a limit becomes active or inactive.

    Changes at element boundaries that `known_boundaries` returns are not counted.
    """
    active = active_limits(solution)
    return _changing(solution, np.ones(active.shape[1], dtype=bool), active)


def switch_elements(solution: Solution) -> frozenset[int]:
    """Return the indices of elements in or beside which only limits on controls switch.

    A limit on controls contains algebraic variables only. It switches where it becomes active or
    inactive, except at the element boundaries that `known_boundaries` returns. An element is left
    out if any other limit switches in or beside it.
    """
    chosen, active = _limits_on_algebraics(solution), active_limits(solution)
    # A costate may jump where a limit on a state or a rate (time derivative of a state) switches.
    return _changing(solution, chosen, active) - _changing(solution, ~chosen, active)


def _limits_on_algebraics(solution: Solution) -> NDArray[np.bool_]:
    """Return for each limit over time whether it limits algebraic variables alone.

    The limits have the order in the module's docstring.
    """
    program, layout = solution.program, solution.program.layout
    path, n = program.compiled.path, layout.n_states
    of_states = np.isin(
        np.arange(program.compiled.n_equations), path.jacobian_rows[path.jacobian_columns < 2 * n]
    )
    is_algebraic = np.arange(n + layout.n_algebraics) >= n
    return np.concatenate([np.tile(is_algebraic, 2), np.tile(~of_states, 2)])


def _changing(
    solution: Solution, limits: NDArray[np.bool_], active: NDArray[np.bool_]
) -> frozenset[int]:
    """Return the indices of elements in or beside which chosen limits become active or inactive.

    `limits` is True for the chosen limits. `active` has the shape (n_points, n_limits).
    """
    element = solution.mesh.element_of_point
    is_known = np.isin(element[1:], np.flatnonzero(known_boundaries(solution))) & (
        element[1:] > element[:-1]
    )
    changes = np.flatnonzero(np.any((active[1:] != active[:-1])[:, limits], axis=1) & ~is_known)
    return frozenset(element[changes].tolist()) | frozenset(element[changes + 1].tolist())


def known_boundaries(solution: Solution) -> NDArray[np.bool_]:
    """Return which element boundaries the problem itself requires, shape (n_elements + 1,).

    These are start and end of the horizon, jumps of parameters, times of fixed variables and
    conditions, and times in the objective.
    """
    required = solution.problem.required_breakpoints(solution.instance)
    starts = np.asarray(solution.mesh.breakpoints)
    return np.any(np.abs(starts[:, None] - np.array([0.0, *required, 1.0])) < SAME, axis=1)


def active_limits(solution: Solution) -> NDArray[np.bool_]:
    """Return whether each limit over time is active at each collocation point.

    The shape is (n_points, n_limits). The module's docstring gives the order of the limits.
    """
    pulls, slacks = _pulls_and_slacks(solution)
    # At an interior-point solution, the product of multiplier and slack is the same small number
    # for every limit. A large multiplier therefore means a small slack.
    return np.asarray(pulls > slacks)


def kinks(solution: Solution) -> FloatArray:
    """Return the times of kinks, at which an algebraic variable reaches or leaves a limit.

    At a kink the variable is continuous and its slope jumps: see docs/theory/refinement.md,
    "Junctions".

    Returns
    -------
    ndarray
        Ascending fractions of the horizon.
    """
    mesh, chosen = solution.mesh, np.flatnonzero(_limits_on_algebraics(solution))
    pulls, slacks = (values[:, chosen] for values in _pulls_and_slacks(solution))
    active, times = pulls > slacks, mesh.point_fractions
    found = []
    for last, limit in np.argwhere(active[1:] != active[:-1]).tolist():
        first, step = (last + 1, 1) if active[last, limit] else (last, -1)
        free = first + step * np.arange(_EXTRAPOLATED)
        if free.min() < 0 or free.max() >= times.size or active[free, limit].any():
            continue
        # At the kink, the extrapolated slack is zero.
        time = _zero(times[free], slacks[free, limit])
        # A large slack at the inactive point, or no zero between the two points, means that the
        # variable jumps from or to the limit.
        is_small = slacks[first, limit] <= JUMP_SHARE * slacks[:, limit].max()
        if is_small and times[last] <= time <= times[last + 1]:
            found.append(time)
    return np.sort(found)


def _zero(times: FloatArray, values: FloatArray) -> float:
    """Return the time at which a positive function reaches zero, extrapolated from samples.

    The first sample is the nearest to the zero. If the values do not rise from it, the result is
    NaN.
    """
    if not np.all(np.diff(values) > 0.0):
        return math.nan
    # A polynomial gives the time as a function of the value. These weights evaluate it at the value
    # 0.
    weights = [math.prod(b / (b - a) for b in np.delete(values, k)) for k, a in enumerate(values)]
    return float(weights @ times)


def _pulls_and_slacks(solution: Solution) -> tuple[FloatArray, FloatArray]:
    """Return the multipliers and slacks of all limits over time, shapes (n_points, n_limits).

    Both belong to the scaled program. Multipliers are divided by the quadrature weight.
    """
    program, layout = solution.program, solution.program.layout
    bounds, scaling = solution.bounds, solution.scaling
    density = scaling.objective / solution.mesh.quadrature_weights[:, None]
    columns = np.hstack([layout.state_columns[1:], layout.algebraic_columns])
    z, scale = solution.unknowns, scaling.unknowns
    # The multiplier counts as 0 where the lower and the upper limit are equal.
    held = bounds.lower == bounds.upper
    found = [
        (np.where(held, 0.0, multiplier / scale)[columns], (np.abs(z - limit) * scale)[columns])
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
        found.append((np.where(held, 0.0, pull)[rows], (np.abs(values - limit) * scale)[rows]))
    pulls, slacks = (np.hstack(parts) for parts in zip(*found, strict=True))
    return pulls * density, slacks
