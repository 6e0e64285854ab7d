"""Verdicts on a solve: reasons for a failure, and doubts about a success, as status and message."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from pyomo_quad.collocation.program.bounds import counted
from pyomo_quad.collocation.program.compiled import MappedFunction
from pyomo_quad.collocation.program.elastic import least_violation
from pyomo_quad.collocation.program.ipopt import Status
from pyomo_quad.collocation.program.transcription import row_place, unknown_place
from pyomo_quad.collocation.solution import Outcome, Solution, hamiltonian_warnings

if TYPE_CHECKING:
    from pyomo_quad.collocation.program.elastic import LeastViolation
    from pyomo_quad.collocation.program.ipopt import Progress, SolverOptions

S = TypeVar("S", bound=Outcome)


def without_bound(solution: Solution) -> Solution:
    """Return a solution whose message names the variable that diverges."""
    program, sizes = solution.program, np.abs(solution.unknowns) * solution.scaling.unknowns
    name = unknown_place(program, int(np.nanargmax(sizes))).name
    objective = program.compiled.declared.objective_name
    way = "grows" if program.is_negated else "falls"
    message = (
        f"unbounded: {objective} {way} without bound while {name} diverges; bound {name}, or let "
        f"{objective} hold what it costs."
    )
    return solution.updated(message=message)


def with_surplus(solution: Solution) -> Solution:
    """Return a solution with a message if it has more equations than unknowns."""
    if solution.bounds.surplus <= 0 or not solution.status.is_solved:
        return solution
    note = (
        f"model: {counted(solution.bounds)}, of which some follow from the others; their "
        "multipliers are not unique."
    )
    return solution.updated(notes=(note,))


def violation_of(
    failed: Solution, options: SolverOptions, progress: Progress | None
) -> LeastViolation | None:
    """Return the least violation near a failed solution, None if it is not finite."""
    z = failed.unknowns
    if not np.all(np.isfinite(z)) or not np.all(np.isfinite(failed.program.constraints(z))):
        return None
    return least_violation(
        failed.program, failed.bounds, failed.scaling, z, options=options, progress=progress
    )


def verdict_on(failed: Solution, options: SolverOptions, progress: Progress | None) -> Solution:
    """Return a failed solution with its verdict; interrupted if the user stopped the search."""
    found = violation_of(failed, options, progress)
    if found is not None and found.result.status is Status.INTERRUPTED:
        return failed.updated(status=Status.INTERRUPTED)
    return failed if found is None else judged(failed, found)


# Number of rows that a message names.
_NAMED = 3


def judged(failed: Solution, found: LeastViolation) -> Solution:
    """Return a failed solution with the verdict of its elastic program, and its point."""
    told = replace(
        failed,
        unknowns=found.z,
        trajectory=failed.program.trajectory(found.z),
        objective=failed.program.user_objective(found.z),
    )
    if found.is_positive:
        rows = found.worst_rows.tolist()
        violated = [violation(failed, row, found.slacks[row]) for row in rows]
        return told.updated(status=Status.INFEASIBLE, message=verdict(violated))
    if found.is_zero and failed.status is Status.INFEASIBLE:
        return told.updated(status=Status.NOT_CONVERGED)
    return told


def violation(failed: Solution, row: int, slack: float) -> tuple[str, str]:
    """Return an equation's name with place and amount of its violation in its own unit."""
    place = row_place(failed.program, row)
    missed, unit = slack / failed.scaling.rows[row], failed.problem.source.unit(place.name)
    return place.name, f"{place} by {missed:.3g} {unit}".rstrip()


def verdict(violated: list[tuple[str, str]]) -> str:
    """Return the message on a positive least violation: the violated equations, the worst first.

    Each equation is named once.
    """
    worst: dict[str, str] = {}
    for name, line in violated:
        worst.setdefault(name, line)
    named = ", ".join(list(worst.values())[:_NAMED])
    others = len(worst) - _NAMED
    more = f" and {others} more" if others > 0 else ""
    return (
        f"infeasible: the least violation of all equations within the bounds is above zero and "
        f"leaves {named}{more}; relax a limit or an end condition, as `diagnose` proposes, or "
        "begin from another guess."
    )


# Multiplier over time, relative to objective / size of its equation, above which it counts as
# unbounded.
_UNBOUNDED = 1e12


def diverging_multipliers(solution: Solution) -> tuple[str, ...]:
    """Return the equations over time whose multipliers exceed any regular size."""
    program, scaling = solution.program, solution.scaling
    if not program.n_points:
        return ()
    rows = slice(0, program.first_condition_row)
    held = np.abs(solution.multipliers.rows[rows]) / scaling.rows[rows]
    density = held.reshape(program.n_points, -1) / solution.mesh.quadrature_weights[:, None]
    largest = density.max(axis=0) / solution.nominal_objective
    equations = program.compiled.declared.equations
    return tuple(e.name for e, size in zip(equations, largest, strict=True) if size > _UNBOUNDED)


# Fraction of a table's range by which an argument may leave it.
_RANGE_SLACK = 1e-6


def outside_tables(solution: Solution) -> str:
    """Return one line naming the argument farthest outside its table's range, or ""."""
    program, z = solution.program, solution.unknowns
    tables = program.compiled.tables
    found = []
    if tables.over_time and program.n_points:
        at_points = program.path_variables(z), program.data.at_points()
        mapped = MappedFunction(tables.path, program.n_points)
        found.append((tables.over_time, mapped(*at_points)[0]))
    if tables.in_conditions:
        once = program.point_variables(z), program.data.parameters[None, :]
        found.append((tables.in_conditions, MappedFunction(tables.points, 1)(*once)[0]))
    worst, line = _RANGE_SLACK, ""
    for uses, held in found:
        for use, arguments in zip(uses, held.T, strict=True):
            beyond = np.maximum(use.lower - arguments, arguments - use.upper)
            k = int(np.argmax(beyond))
            if beyond[k] > worst * (use.upper - use.lower):
                worst = beyond[k] / (use.upper - use.lower)
                when = f" at time {solution.times[k + 1]:.6g}" if len(arguments) > 1 else ""
                line = (
                    f"{use.name} is {arguments[k]:.6g}{when}, outside its range "
                    f"[{use.lower:g}, {use.upper:g}]; extend the table, or bound the variables "
                    "in its argument."
                )
    return line


def doubted(solution: S) -> S:
    """Record doubts about a solution in its status and message."""
    return _within_tables(_undoubted(_without_objective(solution)))


def _without_objective(solution: S) -> S:
    """Add a message to the solution of a problem without an objective."""
    declared = solution.parts[0].problem.compiled.declared
    if declared.objective_name or solution.status is not Status.CONVERGED:
        return solution
    return solution.updated(
        message="no objective is declared: all equations and limits are met, and nothing is "
        "optimised; declare an active Objective to choose among such solutions."
    )


def _undoubted(solution: S) -> S:
    """Return a solution as not converged if multipliers or Hamiltonian contradict it."""
    for part in solution.parts if solution.status is Status.CONVERGED else ():
        names, warnings = diverging_multipliers(part), hamiltonian_warnings(part)
        if names and warnings:
            line = (
                f"{', '.join(names)}: multipliers grow without bound, so that nothing vouches for "
                f"the optimum; where a product must vanish, let it be at most a small number. "
                f"{warnings[0]}"
            )
            return solution.updated(status=Status.TOLERANCE_NOT_MET, message=line)
    return solution


def _within_tables(solution: S) -> S:
    """Add a message to a solution that reads a table beyond its range."""
    line = next(filter(None, map(outside_tables, solution.parts)), "")
    if not line:
        return solution
    if solution.status is not Status.CONVERGED:
        return solution.updated(message=f"{solution.message} {line}")
    return solution.updated(status=Status.NOT_CONVERGED, message=line)
