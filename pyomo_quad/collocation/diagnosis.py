"""Diagnosis of a failed solve: worst equations, active limits, and least relaxation needed."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from pyomo_quad.collocation.errors import TranscriptionError
from pyomo_quad.collocation.program.bounds import Bounds, Scaling, limits_of
from pyomo_quad.collocation.program.ipopt import Progress, SolverOptions, run
from pyomo_quad.collocation.program.transcription import row_place
from pyomo_quad.collocation.reading.model_source import family_name

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from pyomo_quad.collocation.mesh import FloatArray, Trajectory
    from pyomo_quad.collocation.program.bounds import Limit
    from pyomo_quad.collocation.program.transcription import Transcription
    from pyomo_quad.collocation.solution import Solution

# Weight of the distance from the first point. It makes the unknowns unique that affect no slack,
# and is too small to outweigh a slack.
_PROXIMITY = 1e-6


class _SoftRow(NamedTuple):
    family: str
    row: int
    column: int
    sign: float
    limit: float
    size: float


@dataclass(frozen=True, kw_only=True)
class SoftRows:
    """One-sided limits: sign * (value - limit) <= slack * size, one entry each.

    `row` is the row of the program that is limited, or -1 if the unknown `column` is limited.
    """

    family: NDArray[np.intp]
    row: NDArray[np.intp]
    column: NDArray[np.intp]
    sign: FloatArray
    limit: FloatArray
    size: FloatArray
    names: tuple[str, ...]

    @classmethod
    def of(
        cls,
        program: Transcription,
        bounds: Bounds,
        scaling: Scaling,
        limits: list[Limit],
        families: frozenset[str] | None = None,
    ) -> SoftRows:
        """Collect the one-sided limits of chosen families, or of all families if None.

        Raises
        ------
        TranscriptionError
            If the families have no limits.
        """
        entries = [*_soft_unknowns(limits, scaling), *_soft_program_rows(program, bounds, scaling)]
        chosen = [
            entry
            for entry in entries
            if np.isfinite(entry.limit) and (families is None or entry.family in families)
        ]
        if not chosen:
            wanted = "the model" if families is None else ", ".join(sorted(families))
            raise TranscriptionError(f"{wanted}: has no limits that could be relaxed.")
        names = sorted({entry.family for entry in chosen})
        limit = np.array([entry.limit for entry in chosen])
        return cls(
            family=np.array([names.index(entry.family) for entry in chosen]),
            row=np.array([entry.row for entry in chosen]),
            column=np.array([entry.column for entry in chosen]),
            sign=np.array([entry.sign for entry in chosen]),
            limit=limit,
            size=np.maximum(np.abs(limit), [entry.size for entry in chosen]),
            names=tuple(names),
        )

    def __len__(self) -> int:
        return len(self.family)


def _soft_unknowns(limits: list[Limit], scaling: Scaling) -> Iterator[_SoftRow]:
    for limit in limits:
        for k, column in enumerate(limit.columns):
            size = 1.0 / float(scaling.unknowns[column])
            for sign, bound in ((1.0, limit.upper[k]), (-1.0, limit.lower[k])):
                family = family_name(limit.name)
                yield _SoftRow(family, -1, int(column), sign, float(bound), size)


def _soft_program_rows(
    program: Transcription, bounds: Bounds, scaling: Scaling
) -> Iterator[_SoftRow]:
    equations = program.compiled.declared.equations
    rows = [
        (point * len(equations) + k, equation.name)
        for k, equation in enumerate(equations)
        if not equation.is_equality
        for point in range(program.layout.points)
    ]
    conditions = program.compiled.declared.conditions
    rows += [(program.first_condition_row + k, c.name) for k, c in enumerate(conditions)]
    for row, name in rows:
        size = 1.0 / float(scaling.rows[row])
        for sign, bound in ((1.0, bounds.row_upper[row]), (-1.0, bounds.row_lower[row])):
            yield _SoftRow(family_name(name), row, -1, sign, float(bound), size)


class ElasticProgram:
    """The elastic counterpart of a program, in the form Ipopt asks for.

    Unknowns are those of the program, then one slack per family. Rows are those of the program,
    with the soft ones free, then the soft rows.
    """

    def __init__(
        self, program: Transcription, soft: SoftRows, near: FloatArray, scale: FloatArray
    ) -> None:
        self.program = program
        self.soft = soft
        self._near, self._scale = near, scale
        self._n = near.size

    @property
    def n_rows(self) -> int:
        """Number of rows."""
        return self.program.n_rows + len(self.soft)

    @property
    def n_points(self) -> int:
        """Number of collocation points."""
        return self.program.n_points

    @property
    def is_negated(self) -> bool:
        """Return False: slacks are minimised, whether or not the program maximises."""
        return False

    def objective(self, z: FloatArray) -> float:
        """Return the sum of slacks, plus a small penalty on the distance from the first point."""
        moved = (z[: self._n] - self._near) * self._scale
        return float(z[self._n :].sum() + 0.5 * _PROXIMITY * moved @ moved / self._n)

    def gradient(self, z: FloatArray) -> FloatArray:
        """Return the gradient of the objective."""
        moved = (z[: self._n] - self._near) * self._scale**2
        return np.concatenate([_PROXIMITY * moved / self._n, np.ones(z.size - self._n)])

    def constraints(self, z: FloatArray) -> FloatArray:
        """Return the program's rows, then the excess of each soft row over its slack."""
        rows = self.program.constraints(z[: self._n])
        soft = self.soft
        values = np.where(soft.row >= 0, rows[soft.row], z[soft.column])
        beyond = soft.sign * (values - soft.limit) / soft.size - z[self._n + soft.family]
        return np.concatenate([rows, beyond])

    @cached_property
    def _copies(self) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Entries of the program's Jacobian that soft rows copy, and the soft row of each entry."""
        rows, _ = self.program.jacobianstructure()
        order = np.argsort(rows, kind="stable")
        starts = np.searchsorted(rows[order], np.arange(self.program.n_rows + 1))
        entries, owners = [], []
        for k in np.flatnonzero(self.soft.row >= 0):
            r = self.soft.row[k]
            found = order[starts[r] : starts[r + 1]]
            entries.append(found)
            owners.append(np.full(found.size, k))
        empty = np.zeros(0, dtype=np.intp)
        return np.concatenate([empty, *entries]), np.concatenate([empty, *owners])

    def jacobianstructure(self) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Return rows and columns of the Jacobian's entries."""
        rows, columns = self.program.jacobianstructure()
        entries, owners = self._copies
        m = self.program.n_rows
        plain = np.flatnonzero(self.soft.row < 0)
        every = np.arange(len(self.soft))
        return (
            np.concatenate([rows, m + owners, m + plain, m + every]),
            np.concatenate(
                [columns, columns[entries], self.soft.column[plain], self._n + self.soft.family]
            ),
        )

    def jacobian(self, z: FloatArray) -> FloatArray:
        """Return the values of the Jacobian's entries."""
        soft, values = self.soft, self.program.jacobian(z[: self._n])
        entries, owners = self._copies
        factor = soft.sign / soft.size
        plain = factor[soft.row < 0]
        return np.concatenate(
            [values, values[entries] * factor[owners], plain, -np.ones(len(soft))]
        )

    def hessianstructure(self) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Return rows and columns of the lower triangle of the Lagrangian's Hessian."""
        rows, columns = self.program.hessianstructure()
        diagonal = np.arange(self._n)
        return np.concatenate([rows, diagonal]), np.concatenate([columns, diagonal])

    def hessian(self, z: FloatArray, multipliers: FloatArray, factor: float) -> FloatArray:
        """Return the values of the lower triangle of the Lagrangian's Hessian."""
        soft, m = self.soft, self.program.n_rows
        on_rows = np.array(multipliers[:m])
        held = soft.row >= 0
        weights = (multipliers[m:] * soft.sign / soft.size)[held]
        np.add.at(on_rows, soft.row[held], weights)
        values = self.program.hessian(z[: self._n], on_rows, 0.0)
        return np.concatenate([values, factor * _PROXIMITY * self._scale**2 / self._n])


_MOST_RESIDUALS = 10
# Relative residual or slack below which an equation or limit counts as met.
_MET = 1e-6
_ELASTIC = SolverOptions(tolerance=1e-7, max_iterations=300)


@dataclass(frozen=True, kw_only=True)
class Residual:
    """An equation that the best iterate violates, with the violation in the equation's own unit."""

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
    """A limit that is active at the best iterate: its value, and the fraction of points on it."""

    name: str
    limit: float
    unit: str
    share: float

    def __str__(self) -> str:
        return f"{self.name}: at {self.limit:.6g} {self.unit} for {self.share:.0%} of the points"


@dataclass(frozen=True, kw_only=True)
class Relaxation:
    """Least relaxation of one declaration, in its own unit."""

    name: str
    amount: float
    limit: float
    unit: str

    def __str__(self) -> str:
        return f"{self.name}: {self.limit:.6g} {self.unit} relaxed by {self.amount:.4g}"


@dataclass(frozen=True, kw_only=True)
class Diagnosis:
    """Why a solve failed.

    Attributes
    ----------
    residuals : tuple of Residual
        The ten worst equations of the best iterate, in order of violation relative to their scale.
    active : tuple of ActiveLimit
        Limits that are active at the best iterate.
    least_violation : float
        Sum of the relative slacks of the elastic program; infinite if that did not converge.
    relaxations : tuple of Relaxation
        Declarations that must be relaxed together; empty if all can be met.
    feasible_point : Trajectory or None
        A trajectory that satisfies all declarations, if the elastic program found one.
    """

    residuals: tuple[Residual, ...]
    active: tuple[ActiveLimit, ...]
    least_violation: float
    relaxations: tuple[Relaxation, ...]
    feasible_point: Trajectory | None

    @property
    def is_infeasible(self) -> bool:
        """Whether the elastic program converged with a positive violation."""
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
        The result of a solve that did not converge; its unknowns are the best iterate.
    families : frozenset of str, optional
        Names of the declarations that may be relaxed; all by default.
    progress : callable, optional
        Called at each iteration of the elastic solve.

    Returns
    -------
    Diagnosis

    Raises
    ------
    TranscriptionError
        If none of the families has a limit that could be relaxed, or there are several horizons.

    Examples
    --------
    >>> from pyomo_quad.collocation import solve
    >>> m.u.setub(0.9)  # 1 m in 1 s needs a speed of 1
    >>> failed = solve(m)
    >>> failed.is_converged
    False
    >>> diagnosis = diagnose(failed)
    >>> diagnosis.least_violation > 0.0, len(diagnosis.relaxations) > 0
    (True, True)
    """
    if solution.parts != (solution,):
        raise TranscriptionError(
            "diagnose: the solution is of several horizons; diagnose one of its `horizons`."
        )
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
    """Free the bounds that the soft rows replace; keep all others."""
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
