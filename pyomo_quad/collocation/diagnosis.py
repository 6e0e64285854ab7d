"""Why a solve failed: the worst equations, the active limits, and the least that must give.

Feasibility is not guessed: the elastic program either brings every limit's violation to
zero, and then its point is a better start, or it names the limits that have to give way
and by how much.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from pyomo_quad.collocation.bounds import Bounds, limits_of
from pyomo_quad.collocation.elastic_program import ElasticProgram, SoftRows
from pyomo_quad.collocation.ipopt import Progress, SolverOptions, run
from pyomo_quad.collocation.naming import row_place
from pyomo_quad.collocation.scaling import Scaling

if TYPE_CHECKING:
    from pyomo_quad.collocation.nodes import FloatArray
    from pyomo_quad.collocation.solution import Solution
    from pyomo_quad.collocation.trajectory import Trajectory

__all__ = ["ActiveLimit", "Diagnosis", "Relaxation", "Residual", "diagnose"]

_MOST_RESIDUALS = 10
# A residual or slack below this share of its scale is met.
_MET = 1e-6
_ELASTIC = SolverOptions(tolerance=1e-7, max_iterations=300)


@dataclass(frozen=True, kw_only=True)
class Residual:
    """An equation that the best iterate breaks, by how much, in the equation's own unit."""

    name: str
    element: int | None
    time: float | None
    violation: float
    unit: str

    def __str__(self) -> str:
        where = "" if self.time is None else f" at {self.time:.4g}"
        if self.element is not None:
            where += f" (element {self.element + 1})"
        return f"{self.name}{where}: off by {self.violation:.4g} {self.unit}".rstrip()


@dataclass(frozen=True, kw_only=True)
class ActiveLimit:
    """A limit that the best iterate touches: its value and the share of points where it does."""

    name: str
    limit: float
    unit: str
    share: float

    def __str__(self) -> str:
        return f"{self.name}: at {self.limit:.6g} {self.unit} for {self.share:.0%} of the points"


@dataclass(frozen=True, kw_only=True)
class Relaxation:
    """What one declaration would have to give way by, at the least, in its own unit."""

    name: str
    amount: float
    limit: float
    unit: str

    def __str__(self) -> str:
        return f"{self.name}: {self.limit:.6g} {self.unit} gives way by {self.amount:.4g}"


@dataclass(frozen=True, kw_only=True)
class Diagnosis:
    """Why a solve failed.

    Attributes
    ----------
    residuals : tuple of Residual
        The ten worst equations of the best iterate, worst first by their own scale.
    active : tuple of ActiveLimit
        Limits that the best iterate touches.
    least_violation : float
        Sum of the relative slacks of the elastic program; infinite when it did not converge.
    relaxations : tuple of Relaxation
        What has to give way together, empty when everything can be met.
    feasible_point : Trajectory or None
        A trajectory that meets everything, where the elastic program found one.
    """

    residuals: tuple[Residual, ...]
    active: tuple[ActiveLimit, ...]
    least_violation: float
    relaxations: tuple[Relaxation, ...]
    feasible_point: Trajectory | None

    @property
    def is_infeasible(self) -> bool:
        """Whether the elastic program converged without meeting everything."""
        return np.isfinite(self.least_violation) and self.feasible_point is None


def diagnose(
    solution: Solution,
    *,
    families: frozenset[str] | None = None,
    progress: Progress | None = None,
) -> Diagnosis:
    """Find out why a solve failed.

    Parameters
    ----------
    solution : Solution
        Of a solve that did not converge; its unknowns are the best iterate.
    families : frozenset of str, optional
        Names of the declarations that may give way; all by default.
    progress : callable, optional
        Called at each iteration of the elastic solve.

    Returns
    -------
    Diagnosis

    Raises
    ------
    TranscriptionError
        If none of the families has a limit that could give way.
    """
    program, scaling = solution.program, solution.scaling
    soft = SoftRows.of(
        program, solution.bounds, scaling, limits_of(*_limit_inputs(solution)), families
    )
    z = solution.unknowns
    elastic = ElasticProgram(program, soft, near=z, scale=scaling.unknowns)
    rows = elastic.constraints(np.concatenate([z, np.zeros(len(soft.names))]))[program.n_rows :]
    first = np.zeros(len(soft.names))
    np.maximum.at(first, soft.family, rows)
    result = run(
        elastic,
        _elastic_bounds(elastic, solution.bounds),
        _elastic_scaling(elastic, scaling),
        np.concatenate([z, first + _MET]),
        options=_ELASTIC,
        progress=progress,
    )
    slacks = result.z[z.size :]
    has_converged = result.is_converged
    is_met = has_converged and bool(np.all(slacks <= _MET))
    return Diagnosis(
        residuals=_residuals(solution),
        active=_active(solution, soft),
        least_violation=float(slacks.sum()) if has_converged else np.inf,
        relaxations=() if is_met or not has_converged else _relaxations(solution, soft, slacks),
        feasible_point=program.trajectory(result.z[: z.size]) if is_met else None,
    )


def _limit_inputs(solution: Solution) -> tuple[Any, FloatArray, dict[tuple[str, float], float]]:
    instance = solution.instance
    return solution.program, solution.problem.data_at_starts(instance), instance.fixed


def _elastic_bounds(elastic: ElasticProgram, bounds: Bounds) -> Bounds:
    """Free what the soft rows hold instead; keep the rest as it is."""
    soft = elastic.soft
    lower, upper = bounds.lower.copy(), bounds.upper.copy()
    row_lower, row_upper = bounds.row_lower.copy(), bounds.row_upper.copy()
    for sign, sides in ((-1.0, (lower, row_lower)), (1.0, (upper, row_upper))):
        chosen = soft.sign == sign
        sides[0][soft.column[chosen & (soft.row < 0)]] = sign * np.inf
        sides[1][soft.row[chosen & (soft.row >= 0)]] = sign * np.inf
    count, slacks = len(soft), len(soft.names)
    return Bounds(
        lower=np.concatenate([lower, np.zeros(slacks)]),
        upper=np.concatenate([upper, np.full(slacks, np.inf)]),
        row_lower=np.concatenate([row_lower, np.full(count, -np.inf)]),
        row_upper=np.concatenate([row_upper, np.zeros(count)]),
    )


def _elastic_scaling(elastic: ElasticProgram, scaling: Scaling) -> Scaling:
    return Scaling(
        objective=1.0,
        unknowns=np.concatenate([scaling.unknowns, np.ones(len(elastic.soft.names))]),
        rows=np.concatenate([scaling.rows, np.ones(len(elastic.soft))]),
    )


def _residuals(solution: Solution) -> tuple[Residual, ...]:
    program, bounds = solution.program, solution.bounds
    values = program.constraints(solution.unknowns)
    off = np.maximum(np.maximum(bounds.row_lower - values, values - bounds.row_upper), 0.0)
    order = np.argsort(-off * solution.scaling.rows)[:_MOST_RESIDUALS]
    found = []
    for row in order[off[order] * solution.scaling.rows[order] > _MET]:
        place = row_place(program, int(row))
        unit = solution.problem.source.unit(place.name)
        found.append(
            Residual(
                name=place.name,
                element=place.element,
                time=place.time,
                violation=float(off[row]),
                unit=unit,
            )
        )
    return tuple(found)


def _active(solution: Solution, soft: SoftRows) -> tuple[ActiveLimit, ...]:
    values = solution.program.constraints(solution.unknowns)
    held = np.where(soft.row >= 0, values[soft.row], solution.unknowns[soft.column])
    touches = soft.sign * (held - soft.limit) >= -_MET * soft.size
    equal = solution.bounds.lower == solution.bounds.upper
    is_equality = (soft.row < 0) & equal[soft.column]
    found = []
    for k, name in enumerate(soft.names):
        mine = (soft.family == k) & ~is_equality
        count = int(np.sum(touches & mine))
        if count:
            first = int(np.flatnonzero(touches & mine)[0])
            found.append(
                ActiveLimit(
                    name=name,
                    limit=float(soft.limit[first]),
                    unit=solution.problem.source.unit(name),
                    share=count / int(np.sum(mine & (soft.sign == soft.sign[first]))),
                )
            )
    return tuple(found)


def _relaxations(solution: Solution, soft: SoftRows, slacks: FloatArray) -> tuple[Relaxation, ...]:
    found = []
    for k in np.argsort(-slacks):
        if slacks[k] > _MET:
            mine = np.flatnonzero(soft.family == k)
            widest = mine[np.argmax(soft.size[mine])]
            found.append(
                Relaxation(
                    name=soft.names[k],
                    amount=float(slacks[k] * soft.size[widest]),
                    limit=float(soft.limit[widest]),
                    unit=solution.problem.source.unit(soft.names[k]),
                )
            )
    return tuple(found)
