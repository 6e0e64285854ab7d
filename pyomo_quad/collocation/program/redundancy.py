"""Redundant conditions: found at given unknowns, left out of a solve, and checked afterwards.

A condition is a constraint at declared times (members of the continuous set) or without time. It is
redundant if it follows from the other equations. For example, the initial conditions imply an end
condition on a conserved quantity.

On a mesh, the other equations imply the redundant condition only up to the discretisation error. A
program that imposes the condition may therefore have no solution, or only a single one with an
unbounded multiplier.
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
    """Condition that may be redundant, because it follows from other equations.

    A condition is a constraint at declared times (members of the continuous set) or without time.
    The fixed value of a state at a declared time, or of a variable without time, also counts.

    Attributes
    ----------
    name : str
        Name of the condition, or of the fixed variable and its time.
    key : str or (str, float)
        Key of the condition in the list of conditions to leave out. The key of a constraint is its
        name. The key of a fixed value is (variable name, fraction of the horizon).
    row, column : int
        Index of the condition in the program: `row` if it is a constraint, `column` if it fixes an
        unknown. The attribute that does not apply is -1.
    """

    name: str
    key: str | tuple[str, float]
    row: int
    column: int


def _candidates(
    program: Transcription, bounds: Bounds, fixed: dict[tuple[str, float], float]
) -> Iterator[Candidate]:
    """Yield the equality conditions that may turn out to be redundant, in a fixed order.

    A condition is a constraint or a fixed value at declared times. Initial values are not yielded:
    these are fixed values of single states at the start of the horizon.

    Parameters
    ----------
    program : Transcription
        Nonlinear program on one mesh.
    bounds : Bounds
        Bounds of the program.
    fixed : dict
        Values of variables fixed at declared times, by (variable name, fraction of the horizon).
    """
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
    """Return the conditions (constraints or fixed values at declared times) that are redundant.

    A condition is redundant if its gradient is a linear combination of the gradients of the
    equations over time and of the conditions tested before it. Remainders below 1e-4 of the scaled
    gradient count as zero.

    Parameters
    ----------
    program : Transcription
        Nonlinear program on one mesh.
    bounds : Bounds
        Bounds with all conditions imposed.
    scaling : Scaling
        Factors by which the gradients are scaled.
    fixed : dict
        Values of variables fixed at declared times, by (variable name, fraction of the horizon).
    z : ndarray, shape (n_unknowns,)
        Point at which the gradients are evaluated.

    Returns
    -------
    tuple of Candidate
        The redundant conditions.
    """
    candidates = list(_candidates(program, bounds, fixed))
    if not candidates:
        return ()
    held = np.array([c.column for c in candidates if c.column >= 0], dtype=np.intp)
    is_free = bounds.lower < bounds.upper
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
    """Return the scaled gradients of conditions with respect to the free unknowns.

    An unknown is free if its bounds are unequal, or if one of the conditions fixes it.

    Parameters
    ----------
    candidates : list of Candidate
        The conditions: constraints at declared times, or values fixed at declared times.
    slopes : sparse array, shape (n_rows, n_free)
        Scaled Jacobian of all constraints with respect to the free unknowns.
    free : ndarray of int, shape (n_free,)
        Positions of the free unknowns among all unknowns.

    Returns
    -------
    list of ndarray, shape (n_free,)
        One gradient per condition. The gradient of a condition that fixes an unknown is a unit
        vector.
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
    """Return the part of each vector that is orthogonal to the gradients of all equations.

    `equations` is a sparse matrix with one gradient per row, and `vectors` are gradients of
    conditions.
    """
    m, n = equations.shape
    system = block_array(
        [[identity(n), equations.T], [equations, -_REGULAR * identity(m)]], format="csc"
    )
    factors = splu(system)
    # A nearly zero part means that the condition follows from the equations.
    return [factors.solve(np.concatenate([v, np.zeros(m)]))[:n] for v in vectors]


def without(instance: Instance, left_out: tuple[Candidate, ...]) -> Instance:
    """Return a copy of the data of a solve, in which some conditions are not imposed.

    `instance` has the data of the solve: parameters, horizon, and values fixed at declared times.
    `left_out` are the conditions to leave out: constraints or fixed values at declared times.
    """
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
    """Return by how much a solution violates the conditions that were left out of its solve.

    Parameters
    ----------
    left_out : tuple of Candidate
        The conditions (constraints or fixed values at declared times) left out.
    program : Transcription
        Program of the last mesh.
    bounds : Bounds
        Bounds of the program with all conditions imposed.
    fixed : dict
        Values of variables fixed at declared times, by (variable name, fraction of the horizon);
        including the values that were left out.
    scaling : Scaling
        Factors of the constraints and the unknowns.
    z : ndarray, shape (n_unknowns,)
        The solution without the conditions in `left_out`.

    Returns
    -------
    list of float
        Absolute violation of each condition, multiplied by the scaling factor of its constraint or
        fixed unknown. The order is that of `redundant_conditions`.
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
