"""Pontryagin's principle: whether another control, a jump away, would serve a solution better.

A nonlinear program holds each control where small changes gain nothing.  Where the Hamiltonian has
two valleys that is not enough: a switch then stays wherever the first mesh put it, and no finer
mesh tells.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from pyomo_quad.collocation.program.compiled import MappedFunction
from pyomo_quad.collocation.refining.error import rate_corrections

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import NDArray

    from pyomo_quad.collocation.mesh import FloatArray
    from pyomo_quad.collocation.program.transcription import Transcription
    from pyomo_quad.collocation.solution import Solution

# Values of a control that are tried at each point, from bound to bound.
_TRIED = 17
# Breach of a path constraint, relative to its scale, that another value may cause.
_KEPT = 1e-9


def improved_controls(solution: Solution, tolerance: float) -> Solution | None:
    """Return a solution with the controls that minimise the Hamiltonian, where that pays.

    One control at a time is moved, at every point on its own, while states and costates stay.

    Parameters
    ----------
    solution : Solution
    tolerance : float
        The least gain that counts, relative to the objective.

    Returns
    -------
    Solution or None
        To start from; None where no other control gains so much.
    """
    program, mesh = solution.program, solution.mesh
    variables = program.path_variables(solution.unknowns)
    first = 2 * program.layout.n_states
    best, chosen = np.zeros(mesh.points), np.array(solution.trajectory.algebraics)
    columns = program.layout.algebraic_columns
    lower, upper = solution.bounds.lower[columns], solution.bounds.upper[columns]
    hilly = _hilly_controls(solution, lower, upper)
    if hilly.size == 0:
        return None
    now = _hamiltonian(solution, variables)
    for k in hilly:

        def at(values: FloatArray, place: int = first + k) -> FloatArray:
            moved = np.array(variables)
            moved[:, place] = values
            return _hamiltonian(solution, moved)

        for values, found in _valleys(at, lower[:, k], upper[:, k]):
            gain = now - found
            better = gain > best
            best[better] = gain[better]
            chosen[better] = solution.trajectory.algebraics[better]
            chosen[better, k] = values[better]
    if float(mesh.quadrature_weights @ best) <= tolerance * solution.nominal_objective:
        return None
    # Bounds that no longer hold must not draw the controls back.
    moved = columns[chosen != solution.trajectory.algebraics]
    held = solution.multipliers
    below, above = np.array(held.lower), np.array(held.upper)
    below[moved] = above[moved] = 0.0
    unknowns = np.array(solution.unknowns)
    unknowns[columns] = chosen
    return replace(
        solution,
        unknowns=unknowns,
        trajectory=replace(solution.trajectory, algebraics=chosen),
        multipliers=replace(held, lower=below, upper=above),
    )


def _valleys(
    at: Callable[[FloatArray], FloatArray], lower: FloatArray, upper: FloatArray
) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Yield values from bound to bound and the bottoms of parabolas between them, with heights."""
    step = (upper - lower) / (_TRIED - 1)
    tried = [lower + k * step for k in range(_TRIED)]
    heights = [at(values) for values in tried]
    yield from zip(tried, heights, strict=True)
    for k in range(1, _TRIED - 1):
        before, here, after = heights[k - 1 : k + 2]
        is_low = (here <= before) & (here <= after) & (before + after > 2.0 * here)
        is_low &= np.isfinite(before + after)
        if np.any(is_low):
            with np.errstate(invalid="ignore", divide="ignore"):
                shift = 0.5 * (before - after) / (before - 2.0 * here + after)
            bottom = np.where(is_low, tried[k] + shift * step, tried[k])
            yield bottom, at(bottom)


def _hilly_controls(solution: Solution, lower: FloatArray, upper: FloatArray) -> NDArray[np.intp]:
    """Return the free controls in which the Hamiltonian may have a second valley.

    Between two valleys it curves down; where rates have factors that depend on a control, the
    Lagrangian's curvature does not tell.
    """
    program = solution.program
    free = _free_controls(program, lower, upper)
    if free.size == 0:
        return free
    layout, compiled = program.layout, program.compiled
    first, z = 2 * layout.n_states, np.array(solution.unknowns)
    least = np.full(free.size, np.inf)
    # Other algebraic variables may be without bounds.
    lowest, width = lower[:, free], (upper - lower)[:, free]
    for share in np.linspace(0.0, 1.0, _TRIED):
        z[layout.algebraic_columns[:, free]] = lowest + share * width
        curvatures = program.path_curvatures(z, solution.multipliers.rows)[:, first + free]
        least = np.minimum(least, np.nan_to_num(curvatures, nan=-np.inf).min(axis=0))
    rows, columns = compiled.path.hessian_rows, compiled.path.hessian_columns
    beside_rates = rows[columns < layout.n_states] - first
    return free[(least < 0.0) | np.isin(free, beside_rates)]


def _free_controls(
    program: Transcription, lower: FloatArray, upper: FloatArray
) -> NDArray[np.intp]:
    """Return the bounded algebraic variables that no algebraic equation ties to others."""
    compiled, n = program.compiled, program.layout.n_states
    path = compiled.path
    differential = np.unique(path.jacobian_rows[path.jacobian_columns < n])
    rows = np.flatnonzero(compiled.is_equality)
    tying = np.isin(path.jacobian_rows, np.setdiff1d(rows, differential))
    tied = path.jacobian_columns[tying] - 2 * n
    width = upper - lower
    is_open = np.all(np.isfinite(width), axis=0) & np.any(width > 0.0, axis=0)
    return np.setdiff1d(np.flatnonzero(is_open), tied)


def _hamiltonian(solution: Solution, variables: FloatArray) -> FloatArray:
    """Return the Hamiltonian at the points but for a constant, infinite where a limit breaks."""
    program = solution.program
    compiled, count = program.compiled, len(variables)
    data = program.data.at_points()
    rows = MappedFunction(compiled.path.values, count)(variables, data)[0]
    low, high = MappedFunction(compiled.path_bounds, count)(data)
    held = rows[:, : compiled.n_equations]
    scale = np.maximum(1.0, np.abs(np.where(np.isfinite(low), low, high)))
    is_broken = (np.maximum(low - held, held - high) > _KEPT * scale)[:, ~compiled.is_equality]
    prices = program.integral_weights(solution.unknowns, solution.multipliers.rows)
    rates = rate_corrections(program, variables, data, rows)
    value = rows[:, compiled.n_equations :] @ prices
    value += np.sum(solution.costates.at_points * rates, axis=1)
    is_valid = np.isfinite(value) & ~is_broken.any(axis=1)
    return np.where(is_valid, value, np.inf)
