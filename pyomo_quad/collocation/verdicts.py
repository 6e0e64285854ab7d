"""Verdicts on a solve: its status and message, after a failure or a doubtful success.

A failed solve gets a message on the reasons for the failure. A converged solution gets another
status or message if there is doubt that it is an optimum.
"""

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
    """Return the result of a diverged solve, with a message that the problem is unbounded.

    The message names the variable that diverges.
    """
    program, sizes = solution.program, np.abs(solution.unknowns) * solution.scaling.unknowns
    name = unknown_place(program, int(np.nanargmax(sizes))).name
    objective = program.compiled.declared.objective_name
    way = "grows" if program.is_negated else "falls"
    message = (
        f"unbounded: {objective} {way} without bound while {name} diverges; bound {name}, or add "
        f"a cost of {name} to {objective}."
    )
    return solution.updated(message=message)


def with_surplus(solution: Solution) -> Solution:
    """Add a note to a successful solution of a model with more equations than free unknowns.

    The note states that some equations follow from others, and that the multipliers are not unique.
    Any other solution is returned unchanged.
    """
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
    """Find the point of least constraint violation near the last iterate of a failed solve.

    `options` and `progress` are for the minimisation by Ipopt. The result is None if the last
    iterate or its constraints are not finite.
    """
    z = failed.unknowns
    if not np.all(np.isfinite(z)) or not np.all(np.isfinite(failed.program.constraints(z))):
        return None
    return least_violation(
        failed.program, failed.bounds, failed.scaling, z, options=options, progress=progress
    )


def verdict_on(failed: Solution, options: SolverOptions, progress: Progress | None) -> Solution:
    """Return a failed solution with a verdict on the feasibility of its problem.

    Ipopt minimises the constraint violation from the last iterate of `failed`, with `options` and
    the callback `progress`. If a violation remains, the status becomes infeasible; see `judged` for
    other outcomes. If `progress` returns False, the status becomes interrupted. If the last iterate
    or its constraints are not finite, `failed` is returned unchanged.
    """
    found = violation_of(failed, options, progress)
    if found is not None and found.result.status is Status.INTERRUPTED:
        return failed.updated(status=Status.INTERRUPTED)
    return failed if found is None else judged(failed, found)


# Number of violated equations that a message names.
_NAMED = 3


def judged(failed: Solution, found: LeastViolation) -> Solution:
    """Return a failed solution, moved to the point of least violation, with a verdict.

    If the least violation is positive, the status becomes infeasible, and the message names the
    violated equations. If it is zero, a status infeasible becomes not converged.
    """
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
    # Ipopt reported infeasibility, although this point violates no constraint.
    if found.is_zero and failed.status is Status.INFEASIBLE:
        return told.updated(status=Status.NOT_CONVERGED)
    return told


def violation(failed: Solution, row: int, slack: float) -> tuple[str, str]:
    """Return the name of a violated equation, and a line with its name and violation.

    `slack` is the violation of the scaled constraint `row`; the line gives it in the equation's
    unit. For an equation over time, the line adds time, element and collocation point.
    """
    place = row_place(failed.program, row)
    missed, unit = slack / failed.scaling.rows[row], failed.problem.source.unit(place.name)
    return place.name, f"{place} by {missed:.3g} {unit}".rstrip()


def verdict(violated: list[tuple[str, str]]) -> str:
    """Return the message for an infeasible problem, which lists violated equations, worst first.

    `violated` holds pairs (name of an equation, line on its violation), worst first. An equation
    that is violated at several times is listed once, with its worst violation.
    """
    worst: dict[str, str] = {}
    for name, line in violated:
        worst.setdefault(name, line)
    named = ", ".join(list(worst.values())[:_NAMED])
    others = len(worst) - _NAMED
    more = f" and {others} more" if others > 0 else ""
    return (
        f"infeasible: the point of least violation within the bounds still violates {named}{more}; "
        "relax a limit or an end condition, as `diagnose` proposes, or start from another guess."
    )


# Multiplier over time, relative to objective / size of its equation, above which it counts as
# unbounded.
_UNBOUNDED = 1e12


def diverging_multipliers(solution: Solution) -> tuple[str, ...]:
    """Return the names of the equations over time whose multipliers have diverged.

    If multipliers diverge, no constraint qualification holds at the solution, and the optimality
    conditions are meaningless.
    """
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
    """Return a message on a table that the solution evaluates outside the range of its data.

    The message names the table whose argument lies farthest outside, relative to the table's range,
    with the value of the argument. It is empty if all arguments are inside.
    """
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
    """Return a solution whose status and message record doubts about its optimality or validity.

    There is a doubt if the model declares no objective, a table is evaluated outside its data, or
    multipliers diverge. Diverging multipliers count only if a Hamiltonian varies that should be
    constant. Without a doubt, the solution is returned unchanged.
    """
    return _within_tables(_undoubted(_without_objective(solution)))


def _without_objective(solution: S) -> S:
    """Add a message to a converged solution of a problem that has no objective.

    The message says that nothing was optimised. Any other solution is returned unchanged.
    """
    declared = solution.parts[0].problem.compiled.declared
    if declared.objective_name or solution.status is not Status.CONVERGED:
        return solution
    return solution.updated(
        message="no objective is declared: all equations and limits are met, and nothing is "
        "optimised; declare an active Objective to choose among such solutions."
    )


def _undoubted(solution: S) -> S:
    """Change the status of a converged solution if its optimality conditions are meaningless.

    The status becomes "tolerance not met" if multipliers diverge and a Hamiltonian varies that
    should be constant.
    """
    for part in solution.parts if solution.status is Status.CONVERGED else ():
        names, warnings = diverging_multipliers(part), hamiltonian_warnings(part)
        # Only both signs together cast doubt on the optimum. If the problem depends on time
        # explicitly, even the exact Hamiltonian varies, and there is no warning.
        if names and warnings:
            line = (
                f"{', '.join(names)}: multipliers grow without bound, and the point may not be an "
                "optimum; where a product must be zero, require that it is at most a small number. "
                f"{warnings[0]}"
            )
            return solution.updated(status=Status.TOLERANCE_NOT_MET, message=line)
    return solution


def _within_tables(solution: S) -> S:
    """Mark a solution as not converged if it evaluates a table outside the range of its data.

    The message names the table.
    """
    line = next(filter(None, map(outside_tables, solution.parts)), "")
    if not line:
        return solution
    if solution.status is not Status.CONVERGED:
        # A solution with another status keeps it.
        return solution.updated(message=f"{solution.message} {line}")
    # A table has no meaning outside the range of its data.
    return solution.updated(status=Status.NOT_CONVERGED, message=line)
