"""Tests of a solution by Pontryagin's principle: better controls, and singular arcs.

If the Hamiltonian has two local minima in a control, a switch between them may stay where the first
mesh put it. Mesh refinement does not reveal this.

On a singular arc, the states may be inaccurate although the objective is accurate: even large
deviations of the states hardly change the objective. Derivations: see docs/theory/refinement.md,
eqs. (10) and (11).
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from pyomo_quad.collocation.program.compiled import MappedFunction
from pyomo_quad.collocation.program.transcription import rate_corrections
from pyomo_quad.collocation.refining.activity import active_limits
from pyomo_quad.collocation.refining.error import (
    densely_sampled,
    state_errors_as_interpolated,
    state_sizes,
    violations,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import NDArray

    from pyomo_quad.collocation.mesh import FloatArray
    from pyomo_quad.collocation.program.transcription import Transcription
    from pyomo_quad.collocation.refining.error import ErrorEstimate
    from pyomo_quad.collocation.solution import Solution

# Number of values of a control tried at each point, from bound to bound.
_TRIED = 17
# Violation of a path constraint, relative to its scale, that a tried value may cause.
_KEPT = 1e-9


def improved_controls(solution: Solution, tolerance: float) -> Solution | None:
    """Return a copy of a solution with controls of lower Hamiltonian; None if the gain is small.

    The gain is the decrease of the Hamiltonian, integrated over the horizon. It must exceed
    `tolerance` times `Solution.nominal_objective`. States and costates are unchanged.
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
    # Where Ipopt's tolerance leaves an inequality violated, the controls stay as they are.
    now = np.where(np.isfinite(now), now, -np.inf)
    # At each point, only one control is changed: the one that lowers the Hamiltonian most.
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
    # Multipliers of bounds that are inactive now must not pull the controls back.
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
    """Yield trial values of a control and the Hamiltonian for them, shape (n_points,) each.

    First come values equally spaced between the bounds, and last the minima of parabolas. Each
    parabola passes through a local minimum and its neighbours. `at` maps control values to the
    Hamiltonian.
    """
    step = (upper - lower) / (_TRIED - 1)
    tried = [lower + k * step for k in range(_TRIED)]
    heights = [at(values) for values in tried]
    yield from zip(tried, heights, strict=True)
    # The lowest point of a parabola through each local minimum on the grid and its neighbours.
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
    """Return the free controls for which the Hamiltonian may have several local minima.

    The result has indices of algebraic variables. For free controls, see `_free_controls`. The
    bounds `lower` and `upper` of all algebraic variables have the shape (n_points, n_algebraics).
    """
    program = solution.program
    free = _free_controls(program, lower, upper)
    if free.size == 0:
        return free
    layout, compiled = program.layout, program.compiled
    first, z = 2 * layout.n_states, np.array(solution.unknowns)
    least = np.full(free.size, np.inf)
    # Other algebraic variables may have no bounds.
    lowest, width = lower[:, free], (upper - lower)[:, free]
    # Between two minima, the second derivative with respect to the control is negative for some
    # values of the control.
    for share in np.linspace(0.0, 1.0, _TRIED):
        z[layout.algebraic_columns[:, free]] = lowest + share * width
        curvatures = program.path_curvatures(z, solution.multipliers.rows)[:, first + free]
        least = np.minimum(least, np.nan_to_num(curvatures, nan=-np.inf).min(axis=0))
    # The second derivative holds the rates constant. It is not meaningful for a control if an
    # equation contains a product of a rate and a function of the control. Such a control is
    # included.
    rows, columns = compiled.path.hessian_rows, compiled.path.hessian_columns
    beside_rates = rows[columns < layout.n_states] - first
    return free[(least < 0.0) | np.isin(free, beside_rates)]


def _free_controls(
    program: Transcription, lower: FloatArray, upper: FloatArray
) -> NDArray[np.intp]:
    """Return the indices of bounded algebraic variables that appear in no algebraic equation.

    Each of them can be changed alone. The bounds have shape (n_points, n_algebraics).
    """
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
    """Return the Hamiltonian at the collocation points, up to a constant that no control changes.

    `variables` has one row per point: rates, states, algebraic and static variables. The result is
    infinite where a path inequality is violated or the Hamiltonian is undefined.
    """
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


# Factor for the error of the controls, which the residual of the equations does not show: as much
# again as the error of the states.
_UNSEEN = 2.0
# Samples per collocation point at which two meshes are compared.
_SAMPLES = 4
# Factor and exponent that relate the error of the states to the error of the objective, by the
# order of a singular arc. For a pulse of control whose duration is proportional to its effect on
# the state, the objective changes with the third power of that effect at order 1 (a good mesh
# leaves less: exponent 1/2), and with the fifth power at order 2.
_FELT = {1: (4.0, 1 / 2), 2: (1.0, 1 / 5)}
# Curvature relative to the objective, for a change over the whole range, that counts as zero.
_FLAT = 1e-6
# Least slack in a division: smaller slacks are zero up to rounding.
_LEAST_SLACK = 1e-100


def state_error(
    solution: Solution, error: ErrorEstimate, before: Solution | None, change: float
) -> float:
    """Estimate the distance of the states from the optimal states, relative to their magnitudes.

    The result is the largest of several estimates, for the worst state.

    Parameters
    ----------
    solution : Solution
    error : ErrorEstimate
    before : Solution or None
        Solution on the previous mesh, for its difference from `solution`. It is given only if
        limits become active or inactive inside elements.
    change : float
        Relative change of the objective, for the estimate on singular arcs. The objective is
        compared with that on the previous mesh, and on each earlier mesh that met the tolerance.
        The smallest absolute difference counts; it is 0 on the first mesh.
    """
    # The result is the largest of several estimates. The first two are the largest error of the
    # solution, and twice the sum of a state's errors over all elements, for the worst state.
    moving = np.maximum(error.states, state_errors_as_interpolated(solution))
    own = max(error.largest, _UNSEEN * float(moving.sum(axis=0).max(initial=0.0)))
    order = singular_order(solution)
    # In eq. (11), delta is the larger of `change` and the largest estimated error.
    if order:
        factor, root = _FELT[order]
        own = max(own, factor * max(error.largest, change) ** root)
    # With `before`, limits become active or inactive inside elements. The times of these changes
    # depend on the mesh, and are inaccurate. Three more estimates then count: the violation of
    # limits between the points, the change of the states since the previous mesh, and their change
    # if a control jumps at another time inside its element.
    if before is None:
        return own
    mesh, path = solution.mesh, solution.trajectory
    starts, widths = np.asarray(mesh.breakpoints[:-1]), mesh.widths
    places = (np.arange(_SAMPLES * max(mesh.degrees)) + 0.5) / (_SAMPLES * max(mesh.degrees))
    fractions = np.append(mesh.node_fractions, starts[:, None] + widths[:, None] * places)
    moved = np.abs(before.trajectory.states_at(fractions) - path.states_at(fractions))
    bent = np.zeros_like(moved[:1])
    # The refinement encloses the jump of a control in an element with a single collocation point.
    # The true jump may be anywhere in this element.
    for e in np.flatnonzero(np.asarray(mesh.degrees) == 1):
        sides = np.clip([starts[e] - widths[e], starts[e] + 2.0 * widths[e]], 0.0, 1.0)
        bent = np.maximum(bent, widths[e] / 4.0 * np.abs(np.diff(path.rates_at(sides), axis=0)))
    _, limits, _ = violations(solution.program, densely_sampled(solution))
    # On a singular arc, the change of the states since the previous mesh is not counted.
    found = np.vstack([bent] if order else [moved, bent]) / state_sizes(solution)
    return max(own, float(limits.max(initial=0.0)), float(found.max(initial=0.0)))


def singular_order(solution: Solution) -> int:
    """Return the order of a singular arc: 0 without singular arc, 1, or 2 for order 2 and higher.

    Sources: Robbins (1967); Kelley, Kopp and Moyer (1967).
    """
    program, n = solution.program, solution.program.layout.n_states
    held = solution.trajectory.algebraics
    if not (held.size and n):
        return 0
    rates = np.abs(program.path_variables(solution.unknowns)[:, :n]).max(axis=0)
    scale = np.concatenate([rates, solution.algebraic_ranges])
    scale[scale == 0.0] = 1.0
    multipliers, barriers = solution.multipliers.rows, _barriers(solution)
    threshold = _FLAT * solution.nominal_objective
    controls = slice(2 * n, 2 * n + held.shape[1])
    own = program.path_curvatures(solution.unknowns, multipliers)[:, controls] + barriers
    is_candidate = np.any(np.abs(own) * scale[n:] ** 2 < threshold, axis=1)
    # On a singular arc, a control lies between its limits, and the second derivative of the
    # Hamiltonian with respect to the control is zero.
    points = np.flatnonzero(is_candidate & _is_between(solution))
    # The states are held constant. Rates and other algebraic variables change with the control, so
    # that all equations stay satisfied.
    directions = _free_directions(program, solution.unknowns, points, scale)
    if directions.shape[1] == 0 or points.size == 0:
        return 0
    hessians = program.path_hessians(solution.unknowns, multipliers)[points]
    at = np.arange(controls.start, controls.stop)
    hessians[:, at, at] += barriers[points]
    chosen = np.r_[0:n, controls]
    inner = hessians[:, chosen][:, :, chosen] * np.outer(scale, scale)
    curvatures, bases = np.linalg.eigh(np.einsum("kai,kij,kbj->kab", directions, inner, directions))
    is_flat = curvatures[:, 0] < threshold
    if not np.any(is_flat):
        return 0
    flat = scale * np.einsum("ka,kai->ki", bases[:, :, 0], directions)
    # The direction in which the changed rates move the states.
    pushed = flat[:, :n]
    in_states = np.einsum("ki,kij,kj->k", pushed, hessians[:, n : 2 * n, n : 2 * n], pushed)
    mixed = np.einsum("ki,kij,kj->k", flat, hessians[:, chosen, n : 2 * n], pushed)
    # At order 1, a second derivative in the direction of this motion is not zero.
    felt = np.median((np.abs(in_states) + np.abs(mixed))[is_flat])
    return 1 if felt > threshold else 2


def _barriers(solution: Solution) -> FloatArray:
    """Return second derivatives of Ipopt's barrier function, shape (n_points, n_algebraics).

    They are the derivatives with respect to each algebraic variable, divided by the quadrature
    weight of the point.
    """
    z, multipliers, bounds = solution.unknowns, solution.multipliers, solution.bounds
    lower = multipliers.lower / np.maximum(z - bounds.lower, _LEAST_SLACK)
    upper = multipliers.upper / np.maximum(bounds.upper - z, _LEAST_SLACK)
    columns = solution.program.layout.algebraic_columns
    return np.asarray((lower + upper)[columns] / solution.mesh.quadrature_weights[:, None])


def _is_between(solution: Solution) -> NDArray[np.bool_]:
    """Return where no path inequality and no bound of a state is active, shape (n_points,).

    A control can be singular only there. The result is False in elements with a single point.
    """
    layout = solution.program.layout
    states, algebraics = layout.n_states, layout.n_algebraics
    is_told = active_limits(solution)
    for first in (states, 2 * states + algebraics):
        is_told[:, first : first + algebraics] = False
    # The refinement cuts elements with a single point around jumps of controls.
    degrees = np.asarray(solution.mesh.degrees)[solution.mesh.element_of_point]
    return np.asarray((degrees > 1) & ~np.any(is_told, axis=1))


def _free_directions(
    program: Transcription, z: FloatArray, points: NDArray[np.intp], scale: FloatArray
) -> FloatArray:
    """Return a basis of changes of rates and algebraic variables that keep the equations satisfied.

    The states do not change. The result has shape (n_points, n_free, n_rates + n_algebraics), with
    n_free changes at each point. Changes are divided by `scale`, the variables' magnitudes.
    """
    n, rows = program.layout.n_states, np.flatnonzero(program.compiled.is_equality)
    chosen = np.r_[0:n, 2 * n : 2 * n + program.layout.n_algebraics]
    variables, data = program.path_variables(z)[points], program.data.at_points()[points]
    slopes = program.path_slopes(variables, data, rows, chosen)
    # To first order, the changes that keep the equations satisfied are the null space of their
    # Jacobian.
    # Each basis is orthonormal in changes divided by `scale`, the magnitudes of the variables.
    directions = np.linalg.svd(slopes * scale).Vh
    return np.asarray(directions[:, rows.size :])
