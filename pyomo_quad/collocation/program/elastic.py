"""Elastic programs: rows with penalised slacks, and the infeasibility verdict from them.

With the objective, and slacks in the equations over time, an elastic program leads to a point that
satisfies these equations. Without the objective, and with slacks in every row, its optimum is the
least sum of violations. A positive sum shows that no choice of the unknowns within their bounds,
near the point where the search ended, satisfies all rows.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.sparse import csr_array

from pyomo_quad.collocation.program.ipopt import IpoptResult, Progress, SolverOptions, run
from pyomo_quad.collocation.program.nonlinear import ExtendedProgram

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pyomo_quad.collocation.mesh import FloatArray
    from pyomo_quad.collocation.program.nonlinear import Bounds, NonlinearProgram, Scaling
    from pyomo_quad.collocation.program.transcription import Transcription

# Penalty for a unit of slack in every scaled equation at all times, beside the scaled objective.
_PRICE = 1e4
# Slack added at the first point to the slack that its residuals need, so that none is at its bound.
_ROOM = 0.1
# Weight of the distance from the first point, in scaled unknowns. It makes the unknowns unique that
# affect no slack, and is too small to outweigh a slack.
_PROXIMITY = 1e-6
#: Slack of a row, as a fraction of the row's largest term, below which the row counts as met: a
#: hundred times the tolerance of the elastic solve, and a thousandth of the smallest relaxation of
#: a limit that a user would notice.
MET = 1e-6
_TOLERANCE, _MOST_ITERATIONS = 1e-8, 300
# Both barrier strategies of Ipopt: where one of them stalls, the other seldom does.
_BARRIERS = ("adaptive", "monotone")


def _with_slacks(
    program: NonlinearProgram, rows: NDArray[np.intp], sizes: FloatArray, prices: FloatArray, n: int
) -> ExtendedProgram:
    """Return a program of n unknowns whose chosen rows have penalised slacks of either sign.

    The slacks above come first, then those below; `sizes` are the changes of the rows per unit of
    slack, `prices` the penalties per unit of slack.
    """
    slacks = n + np.arange(2 * rows.size)
    entries = np.append(sizes, -sizes), (np.tile(rows, 2), slacks)
    terms = csr_array(entries, shape=(program.n_rows, n + slacks.size))
    return ExtendedProgram(program=program, prices=np.tile(prices, 2), terms=terms)


def _solved(
    elastic: ExtendedProgram,
    near: FloatArray,
    bounds: Bounds,
    scaling: Scaling,
    options: SolverOptions,
    progress: Progress | None,
) -> IpoptResult:
    """Solve from a point of the program, with the slacks that its residuals need."""
    values = elastic.program.constraints(near)
    by_slack = elastic.terms[:, near.size :].tocoo()
    needed = np.where(
        by_slack.data > 0.0,
        bounds.row_lower[by_slack.row] - values[by_slack.row],
        values[by_slack.row] - bounds.row_upper[by_slack.row],
    ) / np.abs(by_slack.data)
    slacks = np.empty(needed.size)
    slacks[by_slack.col] = _ROOM + np.maximum(needed, 0.0)
    return run(
        elastic,
        bounds.extended(unknowns=(np.zeros(slacks.size), np.full(slacks.size, np.inf))),
        scaling.extended(unknowns=slacks.size),
        np.append(near, slacks),
        options=options,
        progress=progress,
    )


def priced(program: Transcription, scaling: Scaling, z: FloatArray) -> ExtendedProgram:
    """Return a program in which slacks, at a penalty, may violate the equations over time.

    The slacks are in units of each equation's scale; the penalty is weighted by the quadrature.
    """
    is_equality, mesh = program.compiled.is_equality, program.mesh
    rows = np.flatnonzero(np.tile(is_equality, program.n_points))
    weights = np.zeros(0) if mesh is None else mesh.quadrature_weights
    prices = _PRICE / scaling.objective * np.repeat(weights, is_equality.size)[rows]
    return _with_slacks(program, rows, 1.0 / scaling.rows[rows], prices, z.size)


def elastic_point(
    program: Transcription,
    bounds: Bounds,
    scaling: Scaling,
    z: FloatArray,
    *,
    options: SolverOptions,
    progress: Progress | None,
) -> FloatArray:
    """Return the unknowns at the optimum of the elastic program, from a first point."""
    elastic = priced(program, scaling, z)
    result = _solved(elastic, z, bounds, scaling, options, progress)
    return np.clip(elastic.split(result.z)[0], bounds.lower, bounds.upper)


@dataclass(frozen=True, kw_only=True)
class LeastViolation:
    """Optimum of the elastic program without the objective: the least violation of the rows.

    Attributes
    ----------
    z : ndarray
        The unknowns at that optimum.
    slacks : ndarray, shape (n_rows,)
        Violation of each row, as a fraction of the row's largest term.
    result : IpoptResult
        The result of the elastic program.
    """

    z: FloatArray
    slacks: FloatArray
    result: IpoptResult

    @property
    def is_positive(self) -> bool:
        """Whether the search converged and some row remains violated."""
        return self.result.is_converged and bool(np.any(self.slacks > MET))

    @property
    def is_zero(self) -> bool:
        """Whether the search found a point that satisfies every row."""
        return self.result.is_converged and not self.is_positive

    @property
    def worst_rows(self) -> NDArray[np.intp]:
        """Violated rows, the worst first."""
        order = np.argsort(-self.slacks, kind="stable")
        return order[self.slacks[order] > MET]


def least_violation(
    program: NonlinearProgram,
    bounds: Bounds,
    scaling: Scaling,
    z: FloatArray,
    *,
    options: SolverOptions,
    progress: Progress | None,
) -> LeastViolation:
    """Find a point of least constraint violation: a minimum of the penalised slacks of all rows.

    Each row may be violated by a slack, measured in units of the row's scale, at the same
    penalty for every row (an l1 elastic program, without the objective). Ipopt's barrier
    therefore leaves the same slack in each row, far below the threshold at which a row counts
    as violated, on fine meshes as on coarse ones.
    """
    is_limit = np.isfinite(bounds.row_lower) | np.isfinite(bounds.row_upper)
    rows = np.flatnonzero(is_limit)
    start = np.clip(z, bounds.lower, bounds.upper)
    elastic = replace(
        _with_slacks(program, rows, 1.0 / scaling.rows[rows], np.ones(rows.size), z.size),
        share=0.0,
        columns=np.arange(z.size),
        near=start,
        weights=_PROXIMITY * scaling.unknowns**2 / max(start.size, 1),
    )
    most = min(options.max_iterations, _MOST_ITERATIONS)
    for barrier in _BARRIERS:
        chosen = replace(
            options,
            tolerance=_TOLERANCE,
            max_iterations=most,
            extra=(*options.extra, ("mu_strategy", barrier)),
        )
        unit = replace(scaling, objective=1.0)
        result = _solved(elastic, start, bounds, unit, chosen, progress)
        if not result.status.has_failed:
            break
    own, slacks = elastic.split(result.z)
    missed = np.zeros(program.n_rows)
    missed[rows] = np.abs(np.subtract(*np.split(slacks, 2)))
    return LeastViolation(z=np.clip(own, bounds.lower, bounds.upper), slacks=missed, result=result)
