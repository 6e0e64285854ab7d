"""Diagnosis of a failed solve: violated equations, active limits, and least relaxation.

The least relaxation is the least amount by which the model's limits must be relaxed to satisfy all
equations. All limits of one Pyomo component form a family, which has one common relaxation: its
slack. The slack is relative to the reference magnitudes of the limits; see `SoftRows`. The best
iterate is the point with the least constraint violation that the solve found.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.sparse import csr_array

from pyomo_quad.collocation.errors import TranscriptionError
from pyomo_quad.collocation.program.bounds import limits_of
from pyomo_quad.collocation.program.ipopt import IpoptResult, Progress, SolverOptions, run
from pyomo_quad.collocation.program.nonlinear import Bounds, ExtendedProgram, Scaling
from pyomo_quad.collocation.program.transcription import row_place
from pyomo_quad.collocation.reading.model_source import family_name

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from pyomo_quad.collocation.mesh import FloatArray, Trajectory
    from pyomo_quad.collocation.program.bounds import Limit
    from pyomo_quad.collocation.program.transcription import Transcription
    from pyomo_quad.collocation.solution import Solution

# Weight of the distance from the initial point. It makes the unknowns unique that affect no slack,
# and is too small to outweigh a slack.
_PROXIMITY = 1e-6


# One-sided limit: name of the declaring component, index of the constraint or -1, index of the
# unknown or -1, sign (1 for an upper limit), value of the limit, and least reference magnitude.
_SoftRow = tuple[str, int, int, float, float, float]


@dataclass(frozen=True, kw_only=True)
class SoftRows:
    """One-sided limits that a diagnosis may relax: sign * (value - limit) <= slack * size.

    Here `value` is that of a constraint or an unknown of the nonlinear program. All limits of one
    Pyomo component form a family with one common slack >= 0. Each array has one entry per limit.

    Attributes
    ----------
    family : ndarray of int
        Position of each limit's family in `names`.
    row, column : ndarray of int
        Index of the limited constraint, and of the limited unknown. One of the two is -1.
    sign : ndarray
        1 for an upper limit, -1 for a lower limit.
    limit : ndarray
    size : ndarray
        max(abs(limit), 1 / scaling factor of the constraint or unknown).
    names : tuple of str
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
        """Collect the one-sided limits of a nonlinear program that a diagnosis may relax.

        `limits` are those on unknowns; `bounds` contains those on constraints. `families` names the
        Pyomo components whose limits are collected, by default all.

        Raises
        ------
        TranscriptionError
            If none of these components declares a limit.
        """
        entries = [*_soft_unknowns(limits, scaling), *_soft_program_rows(program, bounds, scaling)]
        chosen = [
            entry
            for entry in entries
            if np.isfinite(entry[4]) and (families is None or entry[0] in families)
        ]
        if not chosen:
            wanted = "the model" if families is None else ", ".join(sorted(families))
            raise TranscriptionError(f"{wanted}: has no limits that could be relaxed.")
        family, row, column, sign, limit, size = map(np.array, zip(*chosen, strict=True))
        names, position = np.unique(family, return_inverse=True)
        return cls(
            family=position,
            row=row,
            column=column,
            sign=sign,
            limit=limit,
            size=np.maximum(np.abs(limit), size),
            names=tuple(names.tolist()),
        )

    def __len__(self) -> int:
        """Return the number of one-sided limits."""
        return len(self.family)


def _soft_unknowns(limits: list[Limit], scaling: Scaling) -> Iterator[_SoftRow]:
    """Yield the one-sided limits on unknowns of the program, for `SoftRows.of`.

    A tuple is (component's name, -1, index of the unknown, sign, value, 1 / scaling factor). The
    number -1 replaces a constraint's index. The sign is 1 for an upper limit, otherwise -1.
    """
    for limit in limits:
        for k, column in enumerate(limit.columns):
            size = 1.0 / float(scaling.unknowns[column])
            for sign, bound in ((1.0, limit.upper[k]), (-1.0, limit.lower[k])):
                family = family_name(limit.name)
                yield family, -1, int(column), sign, float(bound), size


def _soft_program_rows(
    program: Transcription, bounds: Bounds, scaling: Scaling
) -> Iterator[_SoftRow]:
    """Yield the one-sided limits on path inequalities and conditions, for `SoftRows.of`.

    A tuple is (component's name, index of the program's constraint, -1, sign, value, 1 / scaling
    factor). The number -1 replaces an unknown's index. The sign is 1 for an upper limit, otherwise
    -1.
    """
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
            yield family_name(name), row, -1, sign, float(bound), size


_MOST_RESIDUALS = 10
# Relative residual or slack below which an equation or limit counts as met.
_MET = 1e-6
_ELASTIC = SolverOptions(tolerance=1e-7, max_iterations=300)


@dataclass(frozen=True, kw_only=True)
class Residual:
    """Equation that a failed solve violates, and the amount of the violation.

    The violation is that of the best iterate; see `Diagnosis`.

    Attributes
    ----------
    name : str
        Full name of the equation.
    element : int, optional
        Index of the element, from 0. None for an equation that does not hold over time, such as a
        condition at a single time.
    time : float, optional
        Physical time of the collocation point in this element; None if `element` is None.
    violation : float
        Distance of the equation's value from its bounds.
    unit : str
        Unit of the violation, "" if it has none.
    """

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
    """Limit that is active at the best iterate of a failed solve.

    The best iterate is the point with the least constraint violation that the solve found.

    Attributes
    ----------
    name : str
        Name of the component that declares the limit.
    limit : float
        Value of the limit. If several limits of the component are active, for example at several
        times, the value of the first of them.
    unit : str
        Unit of the limit, "" if it has none.
    share : float
        Fraction of the component's limited points (collocation points or nodes) at which a limit is
        active.
    """

    name: str
    limit: float
    unit: str
    share: float

    def __str__(self) -> str:
        return f"{self.name}: at {self.limit:.6g} {self.unit} for {self.share:.0%} of the points"


@dataclass(frozen=True, kw_only=True)
class Relaxation:
    """Amount by which a component's limits are relaxed to make an infeasible problem feasible.

    A component is a constraint or a variable of the Pyomo model. The diagnosis minimises the sum of
    all relaxations, relative to the magnitudes of the limits.

    Attributes
    ----------
    name : str
        Name of the component that declares the limits.
    amount : float
        Relaxation of `limit`, in its unit. The other limits of the component are relaxed in
        proportion to their reference magnitudes; see `SoftRows`.
    limit : float
        Value of the limit. If the component declares several, the value of the limit with the
        largest reference magnitude.
    unit : str
        Unit of `amount` and `limit`, "" if they have none.
    """

    name: str
    amount: float
    limit: float
    unit: str

    def __str__(self) -> str:
        return f"{self.name}: {self.limit:.6g} {self.unit} relaxed by {self.amount:.4g}"


@dataclass(frozen=True, kw_only=True)
class Diagnosis:
    """Reasons for the failure of a solve.

    The best iterate is the point with the least constraint violation that the solve found.

    Attributes
    ----------
    residuals : tuple of Residual
        The ten most violated equations of the best iterate, the largest scaled violation first.
    active : tuple of ActiveLimit
        Limits that are active at the best iterate.
    least_violation : float
        Least sum of the components' relaxations with which all equations can be satisfied. Each
        relaxation is relative to the reference magnitude of its limit; see `SoftRows`. Infinite if
        the diagnosis did not converge.
    relaxations : tuple of Relaxation
        Relaxations of the components whose limits must all be relaxed to make the problem feasible.
        Empty if all limits can be satisfied.
    feasible_point : Trajectory or None
        A trajectory that satisfies all equations and limits, if one was found.
    """

    residuals: tuple[Residual, ...]
    active: tuple[ActiveLimit, ...]
    least_violation: float
    relaxations: tuple[Relaxation, ...]
    feasible_point: Trajectory | None

    @property
    def is_infeasible(self) -> bool:
        """Whether the problem has no feasible point near the best iterate of the failed solve.

        The result is True if the diagnosis converged, and limits must be relaxed. It is False if
        the diagnosis found a feasible point, or did not converge.
        """
        return np.isfinite(self.least_violation) and self.feasible_point is None


def diagnose(
    solution: Solution,
    *,
    families: frozenset[str] | None = None,
    progress: Progress | None = None,
) -> Diagnosis:
    """Find the reasons for the failure of a solve.

    The diagnosis relaxes the limits of the model by as little as possible to satisfy all equations.

    Parameters
    ----------
    solution : Solution
        The result of a solve that did not converge. Its unknowns are the best iterate.
    families : frozenset of str, optional
        Names of the components whose limits may be relaxed; all by default.
    progress : callable, optional
        Called at each iteration of the diagnosis; returning False stops it.

    Returns
    -------
    Diagnosis

    Raises
    ------
    TranscriptionError
        If the components declare no limit that could be relaxed, or if the model has several
        horizons.

    Examples
    --------
    The model `m` of the example of `solve` moves a point by 1 m in 1 s. A limit of 0.9 m/s on the
    speed `u` makes the model infeasible:

    >>> from pyomo_quad.collocation import solve
    >>> m.u.setub(0.9)
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
    instance = solution.instance
    limits = limits_of(program, solution.problem.data_at_starts(instance), instance.fixed)
    soft = SoftRows.of(program, solution.bounds, scaling, limits, families)
    result = _least_slacks(solution, soft, progress)
    z = solution.unknowns
    slacks = result.z[-len(soft.names) :]
    has_converged = result.is_converged
    is_met = has_converged and bool(np.all(slacks <= _MET))
    return Diagnosis(
        residuals=_residuals(solution),
        active=_active(solution, soft),
        least_violation=float(slacks.sum()) if has_converged else np.inf,
        relaxations=() if is_met or not has_converged else _relaxations(solution, soft, slacks),
        feasible_point=program.trajectory(result.z[: z.size]) if is_met else None,
    )


def _least_slacks(solution: Solution, soft: SoftRows, progress: Progress | None) -> IpoptResult:
    """Minimise the sum of the slacks by which limits are relaxed, and return Ipopt's result.

    `soft` are the limits. The unknowns of the result begin with those of the failed program, and
    end with one slack per family.
    """
    program, bounds, z = solution.program, solution.bounds, solution.unknowns
    n, m, count, families = z.size, program.n_rows, len(soft), len(soft.names)
    on_row, on_unknown = np.flatnonzero(soft.row >= 0), np.flatnonzero(soft.row < 0)
    own, first_slack = n + np.arange(on_row.size), n + on_row.size
    factors = soft.sign / soft.size
    # Limit on a constraint: its relative violation v is an added unknown, with the row v <= slack.
    # Limit on an unknown: an added row contains this unknown and the slack of the family.
    parts = (
        (-(soft.sign * soft.size)[on_row], soft.row[on_row], own),
        (np.ones(on_row.size), m + on_row, own),
        (factors[on_unknown], m + on_unknown, soft.column[on_unknown]),
        (-np.ones(count), m + np.arange(count), first_slack + soft.family),
    )
    values, at_row, at_column = (np.concatenate(part) for part in zip(*parts, strict=True))
    shape = m + count, first_slack + families
    # The objective is the sum of the slacks, plus a small penalty on the distance from the failed
    # solve's unknowns.
    elastic = ExtendedProgram(
        program=program,
        share=0.0,
        prices=np.append(np.zeros(on_row.size), np.ones(families)),
        columns=np.arange(n),
        weights=_PROXIMITY * solution.scaling.unknowns**2 / n,
        near=z,
        terms=csr_array((values, (at_row, at_column)), shape=shape),
    )
    free = replace(bounds, lower=bounds.lower.copy(), upper=bounds.upper.copy())
    for sign, side in ((-1.0, free.lower), (1.0, free.upper)):
        side[soft.column[on_unknown[soft.sign[on_unknown] == sign]]] = sign * np.inf
    at_point = np.where(soft.row >= 0, program.constraints(z)[soft.row], z[soft.column])
    excess = _MET + np.maximum(factors * (at_point - soft.limit), 0.0)
    slacks = np.zeros(families)
    np.maximum.at(slacks, soft.family, excess + _MET)
    start = np.concatenate([z, excess[on_row], slacks])
    above = np.zeros(count)
    above[on_unknown] = (factors * soft.limit)[on_unknown]
    return run(
        elastic,
        free.extended(
            unknowns=(np.zeros(start.size - n), np.full(start.size - n, np.inf)),
            rows=(np.full(count, -np.inf), above),
        ),
        replace(solution.scaling, objective=1.0).extended(start.size - n, np.ones(count)),
        start,
        options=_ELASTIC,
        progress=progress,
    )


def _residuals(solution: Solution) -> tuple[Residual, ...]:
    """Return the ten most violated equations of the best iterate, the most violated first."""
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
    """Return the components with limits that are active at the best iterate, one item for each.

    The item has the value of the component's first active limit, and the share of points with an
    active limit. `soft` are the model's one-sided limits.
    """
    values = solution.program.constraints(solution.unknowns)
    held = np.where(soft.row >= 0, values[soft.row], solution.unknowns[soft.column])
    touches = soft.sign * (held - soft.limit) >= -_MET * soft.size
    # Limits on fixed unknowns are left out.
    equal = solution.bounds.lower == solution.bounds.upper
    is_equality = (soft.row < 0) & equal[soft.column]
    # Both sides of a limit with two sides belong to the same point.
    points, found = np.column_stack([soft.row, soft.column]), []
    for k, name in enumerate(soft.names):
        mine = (soft.family == k) & ~is_equality
        count = len(np.unique(points[touches & mine], axis=0))
        if count:
            first = int(np.flatnonzero(touches & mine)[0])
            found.append(
                ActiveLimit(
                    name=name,
                    limit=float(soft.limit[first]),
                    unit=solution.problem.source.unit(name),
                    share=count / len(np.unique(points[mine], axis=0)),
                )
            )
    return tuple(found)


def _relaxations(solution: Solution, soft: SoftRows, slacks: FloatArray) -> tuple[Relaxation, ...]:
    """Return by how much the limits of each component must be relaxed, the most relaxed first.

    `soft` are these limits. `slacks`, shape (n_families,), are the relative relaxations of the
    components; each component has one family of limits.
    """
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
