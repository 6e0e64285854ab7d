"""Redundant conditions: found at given unknowns, left out of a solve, and checked afterwards.

A condition is a fixed value, or a constraint without time or at declared times (members of the
continuous set). It is redundant if other equations, linearised at the unknowns, imply it. For
example, initial conditions imply an end condition on a conserved quantity. On a mesh, they imply it
only up to the discretisation error. A program that imposes it may then have no solution, or
unbounded multipliers.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.sparse import block_array, coo_array, identity
from scipy.sparse.linalg import splu

from pyomo_quad.collocation.program.bounds import limits_at_points

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from pyomo_quad.collocation.mesh import FloatArray
    from pyomo_quad.collocation.program.nonlinear import Bounds, Scaling
    from pyomo_quad.collocation.program.transcription import Transcription
    from pyomo_quad.collocation.reading.values import Instance

# A condition counts as dependent if the part of its scaled slopes outside the span of the
# conditions before it is below this fraction: above the error of a first mesh, far below the
# fraction of any independent condition.
_DEPENDENT = 1e-4
# Regularisation of a singular system of equations with scaled slopes.
_REGULAR = 1e-10
#: Relative violation of a condition that was left out with which the condition still counts as met:
#: slightly more than Ipopt's tolerance, or than the error of a conserved quantity on a first mesh.
FORGIVEN = 1e-4


@dataclass(frozen=True, kw_only=True)
class Candidate:
    """Equality condition that may be redundant.

    Attributes
    ----------
    name : str
        Name of the condition, or of the fixed variable and its time, for messages.
    key : str or (str, float)
        Name of the constraint, or (variable name, fraction of the horizon) of the fixed value.
    row : int
        Index of the constraint; -1 if the condition fixes a single unknown.
    column : int
        Index of the fixed unknown; -1 for any other condition.
    """

    name: str
    key: str | tuple[str, float]
    row: int
    column: int


def _candidates(
    program: Transcription, bounds: Bounds, fixed: dict[tuple[str, float], float]
) -> Iterator[Candidate]:
    """Yield the equality conditions that may be redundant: all except fixed initial states.

    `bounds` are those of `program` with every condition imposed. `fixed` maps (variable name,
    fraction of the horizon) to fixed values.
    """
    # The order is the same on every mesh.
    conditions = program.compiled.declared.conditions
    for k, condition in enumerate(conditions):
        row = program.first_condition_row + k
        if bounds.row_lower[row] == bounds.row_upper[row]:
            yield Candidate(name=condition.name, key=condition.name, row=row, column=-1)
    if program.mesh is None:
        return
    starts = set(program.layout.state_columns[0].tolist())
    for limit in limits_at_points(program):
        column = int(limit.columns[0])
        if limit.columns.size == 1 and limit.lower[0] == limit.upper[0] and column not in starts:
            yield Candidate(name=limit.name, key=limit.name, row=-1, column=column)
    for name, fraction in sorted(fixed):
        place = program.layout.state_column(name, fraction)
        if place >= 0 and fraction > 0.0:
            at = f"{name} at time {program.time_of(fraction):g}"
            yield Candidate(name=at, key=(name, fraction), row=-1, column=place)


def redundant_conditions(
    program: Transcription,
    bounds: Bounds,
    scaling: Scaling,
    fixed: dict[tuple[str, float], float],
    z: FloatArray,
) -> tuple[Candidate, ...]:
    """Return each condition that is redundant at the unknowns `z`.

    The scaled gradient of a redundant condition is, up to 1e-4 of its norm, a linear combination of
    other gradients. These are the gradients of the path equations (equalities over time) and of
    the preceding conditions that are not redundant. `bounds` are those of `program` with every
    condition imposed. `fixed` maps (variable name, fraction of the horizon) to the fixed value.
    """
    candidates = list(_candidates(program, bounds, fixed))
    if not candidates:
        return ()
    held = np.array([c.column for c in candidates if c.column >= 0], dtype=np.intp)
    is_free = bounds.lower < bounds.upper
    # An unknown fixed by a condition counts as free, because the condition is tested.
    is_free[held] = True
    free = np.flatnonzero(is_free)
    rows, columns = program.jacobianstructure()
    values = program.jacobian(z) * scaling.rows[rows] / scaling.unknowns[columns]
    slopes = coo_array((values, (rows, columns)), shape=(program.n_rows, z.size)).tocsr()[:, free]
    first = program.first_condition_row
    equal = np.flatnonzero(bounds.row_lower[:first] == bounds.row_upper[:first])
    own = _slopes_of(candidates, slopes, free)
    outside = _orthogonal_parts(slopes[equal], own)
    found, basis = [], list[np.ndarray]()
    for candidate, left, whole in zip(candidates, outside, own, strict=True):
        for known in basis:
            left = left - (known @ left) * known  # noqa: PLW2901
        size = float(np.linalg.norm(left))
        if size <= _DEPENDENT * float(np.linalg.norm(whole)):
            found.append(candidate)
        else:
            basis.append(left / size)
    return tuple(found)


def _slopes_of(
    candidates: list[Candidate], slopes: coo_array, free: NDArray[np.intp]
) -> list[FloatArray]:
    """Return the scaled gradients of conditions with respect to the unknowns `free`.

    `free` has the indices of n_free unknowns. `slopes` has only their columns of the scaled
    Jacobian, shape (n_rows, n_free). Each gradient has n_free items.
    """
    at = {int(column): k for k, column in enumerate(free)}
    found = []
    for candidate in candidates:
        if candidate.row >= 0:
            found.append(slopes[[candidate.row]].toarray()[0])
        else:
            unit = np.zeros(free.size)
            unit[at[candidate.column]] = 1.0
            found.append(unit)
    return found


def _orthogonal_parts(equations: coo_array, vectors: list[FloatArray]) -> list[FloatArray]:
    """Return the part of each vector that is orthogonal to all rows of `equations`."""
    m, n = equations.shape
    system = block_array(
        [[identity(n), equations.T], [equations, -_REGULAR * identity(m)]], format="csc"
    )
    factors = splu(system)
    # A nearly zero part means that the condition follows from the equations.
    return [factors.solve(np.concatenate([v, np.zeros(m)]))[:n] for v in vectors]


def without(instance: Instance, left_out: tuple[Candidate, ...]) -> Instance:
    """Return a copy of the data of a solve, in which the conditions `left_out` are not imposed."""
    keys = {candidate.key for candidate in left_out}
    return replace(
        instance,
        fixed={key: number for key, number in instance.fixed.items() if key not in keys},
        left_out=instance.left_out | {key for key in keys if isinstance(key, str)},
    )


def misses(
    left_out: tuple[Candidate, ...],
    program: Transcription,
    bounds: Bounds,
    fixed: dict[tuple[str, float], float],
    scaling: Scaling,
    z: FloatArray,
) -> list[float]:
    """Return by how much the solution `z` violates each condition that was left out of its solve.

    A violation is the absolute residual of the condition times its scaling factor. `left_out` is a
    result of `redundant_conditions`, and the violations are in the same order. `bounds` and `fixed`
    include the conditions that were left out.
    """
    values, keys = program.constraints(z), {candidate.key for candidate in left_out}
    found = []
    # Rows and columns depend on the mesh, and the last mesh differs from the mesh of the detection.
    for candidate in _candidates(program, bounds, fixed):
        if candidate.key not in keys:
            continue
        k = candidate.row if candidate.row >= 0 else candidate.column
        if candidate.row >= 0:
            found.append(abs(values[k] - bounds.row_lower[k]) * scaling.rows[k])
        else:
            found.append(abs(z[k] - bounds.lower[k]) * scaling.unknowns[k])
    return found
