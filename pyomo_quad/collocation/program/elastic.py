"""Elastic programs: nonlinear programs whose constraints may be violated at a penalty.

An elastic program has further unknowns, called slacks, that permit a violation.

- `priced` keeps the objective, and adds slacks to the path equations (equalities over time). Its
  optimum serves as the initial point of the program without slacks.
- `least_violation` adds slacks to all constraints, and minimises their sum instead of the
  objective. If the least sum is positive, no point nearby satisfies all constraints: the problem is
  reported as infeasible.
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

# Penalty for a unit of slack in a scaled equation throughout the horizon, relative to a scaled
# objective of about 1.
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
# Tolerance of Ipopt for the scaled elastic program, and limit of its iterations.
_TOLERANCE, _MOST_ITERATIONS = 1e-8, 300
# Both barrier strategies of Ipopt: where one of them stalls, the other seldom does.
_BARRIERS = ("adaptive", "monotone")


def _with_slacks(
    program: NonlinearProgram, rows: NDArray[np.intp], sizes: FloatArray, prices: FloatArray, n: int
) -> ExtendedProgram:
    """Return a program with two penalised slacks >= 0 in each of the constraints `rows`.

    One slack increases the value of the constraint by `sizes` times the slack, the other decreases
    it. `prices` are penalties per unit of slack. The original program has `n` unknowns.
    """
    slacks = n + np.arange(2 * rows.size)
    # After the n original unknowns come k slacks that increase the values of the constraints, then
    # k slacks that decrease them.
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
    """Solve an elastic program by Ipopt from the point `near` of the original program.

    `bounds` and `scaling` are those of the original program. The result has the original unknowns,
    then the slacks.
    """
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
    """Return an elastic program whose path equalities may be violated at a penalty.

    One unit of slack changes the scaled value of an equation by 1. Its penalty is proportional to
    the quadrature weight of the collocation point. `z` has the unknowns of `program`; only their
    number is used.
    """
    is_equality, mesh = program.compiled.is_equality, program.mesh
    rows = np.flatnonzero(np.tile(is_equality, program.n_points))
    weights = np.zeros(0) if mesh is None else mesh.quadrature_weights
    # With these weights, the sum of penalties approximates an integral over the horizon on every
    # mesh.
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
    """Return an initial point, shape (n_unknowns,): the optimum of the program of `priced`.

    If its solve from the point `z` fails or is stopped, the best iterate is returned. The result
    lies within the bounds.
    """
    elastic = priced(program, scaling, z)
    result = _solved(elastic, z, bounds, scaling, options, progress)
    return np.clip(elastic.split(result.z)[0], bounds.lower, bounds.upper)


@dataclass(frozen=True, kw_only=True)
class LeastViolation:
    """Point with the least sum of scaled constraint violations, from `least_violation`.

    Attributes
    ----------
    z : ndarray, shape (n_unknowns,)
        Unknowns, within their bounds. If the search failed or was stopped, those of the best
        iterate.
    slacks : ndarray, shape (n_rows,)
        Violation of each constraint times the scaling factor of the constraint.
    result : IpoptResult
        Ipopt's result for the elastic program.
    """

    z: FloatArray
    slacks: FloatArray
    result: IpoptResult

    @property
    def is_positive(self) -> bool:
        """Whether the search converged and at least one constraint remains violated."""
        return self.result.is_converged and bool(np.any(self.slacks > MET))

    @property
    def is_zero(self) -> bool:
        """Whether the search converged to a point that satisfies every constraint."""
        return self.result.is_converged and not self.is_positive

    @property
    def worst_rows(self) -> NDArray[np.intp]:
        """Indices of the violated constraints, the worst first."""
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
    """Find a point within the bounds at which the sum of scaled constraint violations is least.

    Ipopt minimises the slacks of an l1 elastic program from the point `z`, with a tolerance of 1e-8
    and at most 300 iterations. If it fails, its other barrier strategy is tried.
    """
    is_limit = np.isfinite(bounds.row_lower) | np.isfinite(bounds.row_upper)
    rows = np.flatnonzero(is_limit)
    start = np.clip(z, bounds.lower, bounds.upper)
    # Ipopt's barrier leaves a small slack even in a constraint that can be satisfied. With equal
    # penalties, this slack is about the same in all such constraints, and on every mesh far below
    # `MET`.
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
