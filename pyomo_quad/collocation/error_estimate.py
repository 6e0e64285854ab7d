"""How far the collocation polynomials are from the differential equations between points.

On one more Radau point per element than were collocated, the slopes that satisfy the
equations are integrated from the element's left end and compared with the state
polynomials; bounds and path equations are checked at the same points.  Source: Patterson,
Hager and Rao (2015), Optimal Control Applications and Methods 36, 398-421, with the slope
found by one Newton step so that implicit equations count too (exact for explicit ones).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pyomo_quad.collocation.mapped import MappedFunction
from pyomo_quad.collocation.nodes import FloatArray, radau_rule

if TYPE_CHECKING:
    from pyomo_quad.collocation.solution import Solution
    from pyomo_quad.collocation.transcription import Transcription

__all__ = ["ErrorEstimate", "estimate_error"]


@dataclass(frozen=True, kw_only=True)
class ErrorEstimate:
    """Relative errors, largest between points.

    `states` has shape (n_elements, n_states), relative to the larger of the state's largest
    magnitude and its nominal one (1 unless declared); `violation`, shape (n_elements,), is
    that of path equations and bounds, relative to the larger of 1 and the bound.
    """

    states: FloatArray
    violation: FloatArray

    @property
    def per_element(self) -> FloatArray:
        """Larger of state error and violation, shape (n_elements,)."""
        return np.maximum(self.states.max(axis=1, initial=0.0), self.violation)

    @property
    def largest(self) -> float:
        """Largest of all."""
        return float(self.per_element.max(initial=0.0))


def estimate_error(solution: Solution) -> ErrorEstimate:
    """Estimate the errors of a solution, element by element."""
    program, mesh = solution.program, solution.mesh
    fractions = np.concatenate(
        [
            mesh.breakpoints[e] + mesh.widths[e] * radau_rule(degree + 1).points
            for e, degree in enumerate(mesh.degrees)
        ]
    )
    # A point on a boundary belongs to the element that it ends.
    ends = np.cumsum(np.asarray(mesh.degrees) + 1) - 1
    fractions[ends] = mesh.breakpoints[1:]
    path = solution.trajectory
    statics = np.broadcast_to(path.statics, (fractions.size, path.statics.size))
    variables = np.hstack(
        [
            path.rates_at(fractions),
            path.states_at(fractions),
            path.algebraics_at(fractions),
            statics,
        ]
    )
    signals = solution.problem.signals(solution.instance, fractions)
    parameters = np.broadcast_to(
        program.data.parameters, (fractions.size, program.data.parameters.size)
    )
    data = np.hstack([signals, parameters])
    rows = MappedFunction(program.compiled.path.values, fractions.size)(variables, data)[0]
    slopes = _slope_corrections(program, variables, data, rows)
    return ErrorEstimate(
        states=_state_errors(solution, slopes),
        violation=_violations(program, variables, data, rows),
    )


def _slope_corrections(
    program: Transcription, variables: FloatArray, data: FloatArray, rows: FloatArray
) -> FloatArray:
    """Return what must be added to the rates for the differential equations to hold."""
    compiled, n = program.compiled, program.layout.n_states
    path = compiled.path
    is_equality = np.array([e.is_equality for e in compiled.declared.equations], dtype=bool)
    by_rate = path.jacobian_columns < n
    differential = np.unique(
        [r for r in path.jacobian_rows[by_rate] if r < compiled.n_equations and is_equality[r]]
    ).astype(int)
    if n == 0 or differential.size == 0:
        return np.zeros((variables.shape[0], n))
    position = {int(r): k for k, r in enumerate(differential)}
    entries = MappedFunction(path.jacobian, variables.shape[0])(variables, data)[0]
    matrices = np.zeros((variables.shape[0], differential.size, n))
    for k in np.flatnonzero(by_rate):
        row = int(path.jacobian_rows[k])
        if row in position:
            matrices[:, position[row], path.jacobian_columns[k]] = entries[:, k]
    residuals = rows[:, differential]
    if differential.size == n:
        return -np.linalg.solve(matrices, residuals[:, :, None])[:, :, 0]
    return -np.einsum("kij,kj->ki", np.linalg.pinv(matrices), residuals)


def _state_errors(solution: Solution, slopes: FloatArray) -> FloatArray:
    mesh = solution.mesh
    slots = solution.problem.compiled.declared.states
    nominal = np.array([s.nominal or 1.0 for s in slots])
    size = np.maximum(np.abs(solution.trajectory.states).max(axis=0, initial=0.0), nominal)
    errors = np.zeros((mesh.elements, len(slots)))
    first = 0
    for e, degree in enumerate(mesh.degrees):
        local = slopes[first : first + degree + 1]
        moved = mesh.widths[e] * radau_rule(degree + 1).integration @ local
        errors[e] = np.abs(moved).max(axis=0) / size
        first += degree + 1
    return errors


def _violations(
    program: Transcription, variables: FloatArray, data: FloatArray, rows: FloatArray
) -> FloatArray:
    compiled, n = program.compiled, program.layout.n_states
    points = variables.shape[0]
    lower, upper = MappedFunction(compiled.path_bounds, points)(data)
    held = rows[:, : compiled.n_equations]
    differential = np.unique(compiled.path.jacobian_rows[compiled.path.jacobian_columns < n])
    algebraic = [r for r in range(compiled.n_equations) if r not in set(differential.tolist())]
    parts = [_outside(held[:, algebraic], lower[:, algebraic], upper[:, algebraic])]
    low, high, first, second = MappedFunction(compiled.variable_limits, points)(data)
    values = variables[:, n : 2 * n + program.layout.n_algebraics]
    parts.append(_outside(values, low, high))
    names = [s.name for s in (*compiled.declared.states, *compiled.declared.algebraics)]
    chosen = [names.index(b.variable) for b in compiled.simple_path_bounds]
    parts.append(_outside(values[:, chosen], np.minimum(first, second), np.maximum(first, second)))
    worst = np.hstack(parts).max(axis=1, initial=0.0)
    assert program.mesh is not None
    counts = np.asarray(program.mesh.degrees) + 1
    starts = np.concatenate(([0], np.cumsum(counts)[:-1]))
    return np.maximum.reduceat(worst, starts)


def _outside(values: FloatArray, lower: FloatArray, upper: FloatArray) -> FloatArray:
    with np.errstate(invalid="ignore"):
        below = (lower - values) / np.maximum(1.0, np.abs(lower))
        above = (values - upper) / np.maximum(1.0, np.abs(upper))
    return np.nan_to_num(np.maximum(np.maximum(below, above), 0.0), nan=0.0)
