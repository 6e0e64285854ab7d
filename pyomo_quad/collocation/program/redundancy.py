"""Conditions that follow from others: found at a point, left out of a solve, and checked after it.

A conserved quantity makes an end condition follow from the start and the equations over time.  On a
mesh it does so but for the mesh's error, so that the two together have no solution, or a single
point where there should be a curve of them, and multipliers without bound.
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
    from pyomo_quad.collocation.program.bounds import Bounds, Scaling
    from pyomo_quad.collocation.program.transcription import Transcription
    from pyomo_quad.collocation.reading.values import Instance

# Share of a condition's scaled slopes outside those of the conditions before it that counts as
# none: above the error of a first mesh, far below what any condition of its own has.
_DEPENDENT = 1e-4
# Weight that lets a singular system of equations be solved, beside scaled slopes.
_REGULAR = 1e-10
#: Miss of a condition that was left out, as a share of its size, with which it still counts as met:
#: a little more than Ipopt forgives, or than a first mesh makes of a conserved quantity.
FORGIVEN = 1e-4


@dataclass(frozen=True, kw_only=True)
class Candidate:
    """A condition that may follow from others.

    Attributes
    ----------
    name : str
        Of the condition, or of the variable that is fixed and when.
    key : str or (str, float)
        Its name, or what `Instance.fixed` calls it.
    row, column : int
        The row of the program, or -1; then it holds an unknown at a number.
    """

    name: str
    key: str | tuple[str, float]
    row: int
    column: int


def _candidates(
    program: Transcription, bounds: Bounds, fixed: dict[tuple[str, float], float]
) -> Iterator[Candidate]:
    """Yield the conditions after the start that are equalities, in the order of their names."""
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
    states = [slot.name for slot in program.compiled.declared.states]
    for name, fraction in sorted(fixed):
        if name in states and fraction > 0.0:
            node = int(np.argmin(np.abs(program.mesh.node_fractions - fraction)))
            column = int(program.layout.state_columns[node, states.index(name)])
            at = f"{name} at time {program.time_of(fraction):g}"
            yield Candidate(name=at, key=(name, fraction), row=-1, column=column)


def redundant_conditions(
    program: Transcription,
    bounds: Bounds,
    scaling: Scaling,
    fixed: dict[tuple[str, float], float],
    z: FloatArray,
) -> tuple[Candidate, ...]:
    """Return the conditions whose slopes at a point follow from those of all equations before them.

    The equations over time come first, then the conditions one by one.
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
    outside = _outside(slopes[equal], own)
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
    """Return the slopes of each condition in the free unknowns."""
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


def _outside(equations: coo_array, vectors: list[FloatArray]) -> list[FloatArray]:
    """Return what of each vector is outside the span of the equations' slopes."""
    m, n = equations.shape
    system = block_array(
        [[identity(n), equations.T], [equations, -_REGULAR * identity(m)]], format="csc"
    )
    factors = splu(system)
    return [factors.solve(np.concatenate([v, np.zeros(m)]))[:n] for v in vectors]


def without(instance: Instance, left_out: tuple[Candidate, ...]) -> Instance:
    """Return the numbers of a solve without some conditions."""
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
    """Return by how much a point misses conditions that were left out, as shares of their size.

    Parameters
    ----------
    bounds, fixed : Bounds, dict
        Of the program with these conditions.
    """
    values, keys = program.constraints(z), {candidate.key for candidate in left_out}
    found = []
    # Rows and columns are those of the mesh: the last is not that where they were found.
    for candidate in _candidates(program, bounds, fixed):
        if candidate.key not in keys:
            continue
        k = candidate.row if candidate.row >= 0 else candidate.column
        if candidate.row >= 0:
            found.append(abs(values[k] - bounds.row_lower[k]) * scaling.rows[k])
        else:
            found.append(abs(z[k] - bounds.lower[k]) * scaling.unknowns[k])
    return found
