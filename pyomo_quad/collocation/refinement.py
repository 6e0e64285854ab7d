"""hp-adaptive refinement: solve, estimate, change the mesh, solve again from there."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from pyomo_quad.collocation.damping import damping_of
from pyomo_quad.collocation.error_estimate import ErrorEstimate, estimate_error
from pyomo_quad.collocation.ipopt import Progress, SolverOptions, Status
from pyomo_quad.collocation.junctions import junction_elements
from pyomo_quad.collocation.mesh import Mesh
from pyomo_quad.collocation.remeshing import Marks, RefinementOptions, refined_mesh
from pyomo_quad.collocation.solution import MeshRecord, Solution

if TYPE_CHECKING:
    from pyomo_quad.collocation.damping import Damping
    from pyomo_quad.collocation.guess import Guess
    from pyomo_quad.collocation.problem import Instance, Problem
    from pyomo_quad.collocation.warm_start import WarmStart

__all__ = ["RefinementOptions", "refine"]

# The objective's last change, as a share of the tolerance, at which it counts as settled.
_SETTLED = 0.5
# A warm start that takes more iterations than this leaves its linear controls undetermined:
# they are damped so many times more, up to so many times in all.
_MANY_ITERATIONS = 30
_FIRMER, _FIRMEST = 5.0, 25.0


def refine(
    problem: Problem,
    instance: Instance,
    *,
    mesh: Mesh | None,
    tolerance: float,
    options: SolverOptions,
    refinement: RefinementOptions,
    guess: Guess | None,
    warm_start: WarmStart | None,
    progress: Progress | None,
) -> Solution:
    """Solve on finer and finer meshes until the error estimate meets the tolerance.

    Where limits begin or cease to hold inside an element, or controls are damped, the
    objective must also have settled to the tolerance between the last two meshes.

    Returns
    -------
    Solution
        `converged`, or `tolerance_not_met` with the smallest error reached in its message,
        or the status of the solve that failed.
    """
    mesh = mesh or Mesh.uniform(refinement.first_elements, refinement.first_degree)
    options = options.suiting(tolerance)
    records: list[MeshRecord] = []
    damping: Damping | None = None
    firmness = 1.0
    while True:
        solve = partial(problem.solve_on_mesh, mesh, instance, options, guess)
        solved = solve(warm_start, progress, damping)
        if solved.status is Status.NOT_CONVERGED and damping is not None:
            damping = damping.times(_FIRMEST)
            solved = solve(warm_start, progress, damping)
        if solved.status is Status.NOT_CONVERGED and warm_start is not None:
            solved = solve(None, progress, damping)
        error = estimate_error(solved, tolerance=tolerance, allowance=refinement.allowance)
        records.append(_record(solved, error))
        solution = replace(solved, error_estimate=error.largest, history=tuple(records))
        if solved.status is not Status.CONVERGED:
            return solution
        finer = _next_mesh(solution, error, tolerance, refinement, is_damped=damping is not None)
        if finer is None:
            return solution
        is_stuck = finer == solution.mesh and error.largest > tolerance
        if is_stuck or len(records) >= refinement.max_meshes:
            return _given_up(solution, tolerance)
        if damping is not None and records[-1].iterations > _MANY_ITERATIONS:
            firmness = min(_FIRMER * firmness, _FIRMEST)
        mesh, warm_start = finer, solution.warm_start
        damping = damping_of(solution, firmness * refinement.damping * tolerance)


def _next_mesh(
    solution: Solution,
    error: ErrorEstimate,
    tolerance: float,
    refinement: RefinementOptions,
    *,
    is_damped: bool,
) -> Mesh | None:
    """Return the mesh to solve on next, None when the tolerance is met.

    It may be the same mesh once more, while the damping still moves the objective.
    """
    junctions = junction_elements(solution)
    is_met = error.largest <= tolerance
    has_settled = _objective_change(solution) <= _SETTLED * tolerance
    if is_met and (has_settled or not (junctions or is_damped)):
        return None
    marks = Marks(
        coarse=frozenset(np.flatnonzero(error.per_element > tolerance).tolist())
        | (frozenset() if has_settled else junctions),
        kept=junctions,
    )
    mesh = refined_mesh(solution, error, marks, tolerance, refinement)
    return None if mesh == solution.mesh and is_met and not is_damped else mesh


def _objective_change(solution: Solution) -> float:
    """Return by how much the objective moved from the last mesh but one, relative."""
    if len(solution.history) < 2:
        return math.inf
    before, now = (record.objective for record in solution.history[-2:])
    return abs(now - before) / solution.nominal_objective


def _given_up(solution: Solution, tolerance: float) -> Solution:
    return replace(
        solution,
        status=Status.TOLERANCE_NOT_MET,
        message=(
            f"refinement stopped after {len(solution.history)} meshes with an estimated error of "
            f"{solution.error_estimate:.3g}, above the tolerance {tolerance:.3g}; allow more "
            "meshes, elements or a higher degree, or ask for less."
        ),
    )


def _record(solution: Solution, error: ErrorEstimate) -> MeshRecord:
    return MeshRecord(
        elements=solution.mesh.elements,
        points=solution.mesh.points,
        iterations=solution.iterations[-1].iteration if solution.iterations else 0,
        objective=solution.objective,
        error=error.largest,
        wall_s=solution.wall_s,
    )
