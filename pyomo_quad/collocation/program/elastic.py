"""Elastic programs: rows with penalised slacks, and the infeasibility verdict from them.

With the objective, and slacks in the equations over time, an elastic program leads to a point that
satisfies these equations. Without the objective, and with slacks in every row, its optimum is the
least sum of violations. A positive sum shows that no choice of the unknowns within their bounds,
near the point where the search ended, satisfies all rows.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from pyomo_quad.collocation.program.bounds import Bounds, ChangedProgram, Scaling
from pyomo_quad.collocation.program.ipopt import IpoptResult, Progress, SolverOptions, run

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pyomo_quad.collocation.mesh import FloatArray
    from pyomo_quad.collocation.program.bounds import NonlinearProgram
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


@dataclass(frozen=True, kw_only=True)
class PricedProgram(ChangedProgram):
    """A program whose chosen rows have penalised slacks of either sign.

    Attributes
    ----------
    rows : ndarray of int
        The rows that have slacks.
    sizes, prices : ndarray
        Change of each of these rows per unit of slack, and the penalty per unit of slack.
    share : float
        Weight of the program's objective: 1 or 0.
    near, weights : ndarray, shape (n,)
        A point, and weights of the squared distances of the unknowns from it.
    """

    rows: NDArray[np.intp]
    sizes: FloatArray
    prices: FloatArray
    share: float
    near: FloatArray
    weights: FloatArray

    @property
    def is_negated(self) -> bool:
        """Whether the program is a maximisation; without the objective it never is."""
        return self.share > 0.0 and self.program.is_negated

    def split(self, z: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the program's unknowns, and the slacks above, then below."""
        n = self.near.size
        return z[:n], z[n:]

    def objective(self, z: FloatArray) -> float:
        """Return the objective plus the penalties of all slacks."""
        own, slacks = self.split(z)
        moved = own - self.near
        held = self.share * self.program.objective(own) if self.share else 0.0
        price = np.tile(self.prices, 2) @ slacks
        return held + float(price + 0.5 * (self.weights * moved) @ moved)

    def gradient(self, z: FloatArray) -> FloatArray:
        """Return the gradient of the objective."""
        own = self.split(z)[0]
        gradient = self.weights * (own - self.near)
        if self.share:
            gradient = gradient + self.share * self.program.gradient(own)
        return np.concatenate([gradient, self.prices, self.prices])

    def constraints(self, z: FloatArray) -> FloatArray:
        """Return the value of every row, with its slacks."""
        own, slacks = self.split(z)
        above, below = np.split(slacks, 2)
        values = np.array(self.program.constraints(own))
        values[self.rows] += self.sizes * (above - below)
        return values

    def jacobianstructure(self) -> tuple[Any, Any]:
        """Return rows and columns of the Jacobian's nonzeros."""
        rows, columns = self.program.jacobianstructure()
        slacks = self.near.size + np.arange(2 * self.rows.size)
        return np.concatenate([rows, self.rows, self.rows]), np.concatenate([columns, slacks])

    def jacobian(self, z: FloatArray) -> FloatArray:
        """Return the Jacobian's nonzeros."""
        return np.concatenate([self.program.jacobian(self.split(z)[0]), self.sizes, -self.sizes])

    def hessianstructure(self) -> tuple[Any, Any]:
        """Return rows and columns of the Lagrangian Hessian's lower triangle."""
        rows, columns = self.program.hessianstructure()
        pulled = np.flatnonzero(self.weights)
        return np.concatenate([rows, pulled]), np.concatenate([columns, pulled])

    def hessian(self, z: FloatArray, multipliers: FloatArray, factor: float) -> FloatArray:
        """Return the nonzeros of the Lagrangian's Hessian, to which slacks add nothing."""
        held = self.program.hessian(self.split(z)[0], multipliers, self.share * factor)
        return np.concatenate([held, factor * self.weights[self.weights != 0.0]])

    def solve(
        self,
        bounds: Bounds,
        scaling: Scaling,
        options: SolverOptions,
        progress: Progress | None,
    ) -> IpoptResult:
        """Solve from the point `near`, with the slacks that its residuals need."""
        values = self.program.constraints(self.near)[self.rows]
        short, long = bounds.row_lower[self.rows] - values, values - bounds.row_upper[self.rows]
        slacks = _ROOM + np.maximum(np.concatenate([short, long]) / np.tile(self.sizes, 2), 0.0)
        none = np.zeros(slacks.size)
        return run(
            self,
            replace(
                bounds,
                lower=np.concatenate([bounds.lower, none]),
                upper=np.concatenate([bounds.upper, none + np.inf]),
            ),
            replace(scaling, unknowns=np.concatenate([scaling.unknowns, none + 1.0])),
            np.concatenate([self.near, slacks]),
            options=options,
            progress=progress,
        )


def priced(program: Transcription, scaling: Scaling, z: FloatArray) -> PricedProgram:
    """Return a program whose equations over time have scaled slacks, penalised by their weights."""
    equations = np.tile(program.compiled.is_equality, program.n_points)
    rows = np.flatnonzero(equations)
    mesh = program.mesh
    weights = np.zeros(0) if mesh is None else mesh.quadrature_weights
    weights = np.repeat(weights, program.compiled.is_equality.size)[rows]
    return PricedProgram(
        program=program,
        rows=rows,
        sizes=1.0 / scaling.rows[rows],
        prices=_PRICE / scaling.objective * weights,
        share=1.0,
        near=z,
        weights=np.zeros(z.size),
    )


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
    result = elastic.solve(bounds, scaling, options, progress)
    return np.clip(elastic.split(result.z)[0], bounds.lower, bounds.upper)


@dataclass(frozen=True, kw_only=True)
class LeastViolation:
    """The optimum of the elastic program without the objective.

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
        """Whether the search has converged and left a row violated."""
        return self.result.is_converged and bool(np.any(self.slacks > MET))

    @property
    def is_zero(self) -> bool:
        """Whether the search found a point that meets every row."""
        return self.result.is_converged and not self.is_positive

    @property
    def worst_rows(self) -> NDArray[np.intp]:
        """The rows that are violated, the worst first."""
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
    """Minimise the sum of the rows' violations, each as a fraction of its row's size.

    Every row has the same penalty. Ipopt's barrier therefore leaves the same slack in each row, far
    below the least slack that counts, on fine meshes as on coarse ones.
    """
    is_limit = np.isfinite(bounds.row_lower) | np.isfinite(bounds.row_upper)
    rows = np.flatnonzero(is_limit)
    start = np.clip(z, bounds.lower, bounds.upper)
    elastic = PricedProgram(
        program=program,
        rows=rows,
        sizes=1.0 / scaling.rows[rows],
        prices=np.ones(rows.size),
        share=0.0,
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
        result = elastic.solve(bounds, replace(scaling, objective=1.0), chosen, progress)
        if not result.status.has_failed:
            break
    own, slacks = elastic.split(result.z)
    missed = np.zeros(program.n_rows)
    missed[rows] = np.abs(np.subtract(*np.split(slacks, 2)))
    return LeastViolation(z=np.clip(own, bounds.lower, bounds.upper), slacks=missed, result=result)
