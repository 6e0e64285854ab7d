"""hp-adaptive refinement: solve, estimate, change the mesh, solve again from there."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from pyomo_quad.collocation.error_estimate import ErrorEstimate, estimate_error
from pyomo_quad.collocation.ipopt import Progress, SolverOptions, Status
from pyomo_quad.collocation.mesh import Mesh
from pyomo_quad.collocation.remeshing import RefinementOptions, refined_mesh
from pyomo_quad.collocation.solution import MeshRecord, Solution

if TYPE_CHECKING:
    from pyomo_quad.collocation.guess import Guess
    from pyomo_quad.collocation.problem import Instance, Problem

__all__ = ["RefinementOptions", "refine"]


def refine(
    problem: Problem,
    instance: Instance,
    *,
    mesh: Mesh | None,
    tolerance: float,
    options: SolverOptions,
    refinement: RefinementOptions,
    guess: Guess | None,
    warm_start: Solution | None,
    progress: Progress | None,
) -> Solution:
    """Solve on finer and finer meshes until the error estimate meets the tolerance.

    Returns
    -------
    Solution
        `converged`, or `tolerance_not_met` with the smallest error reached in its message,
        or the status of the solve that failed.
    """
    mesh = mesh or Mesh.uniform(refinement.first_elements, refinement.first_degree)
    records: list[MeshRecord] = []
    solution = warm_start
    for _ in range(refinement.max_meshes):
        solved = problem.solve_on_mesh(mesh, instance, options, guess, solution, progress)
        if solved.status is not Status.CONVERGED and solution is not None:
            solved = problem.solve_on_mesh(mesh, instance, options, guess, None, progress)
        error = estimate_error(solved)
        records.append(_record(solved, error))
        solution = replace(solved, error_estimate=error.largest, history=tuple(records))
        if solved.status is not Status.CONVERGED or error.largest <= tolerance:
            return solution
        finer = refined_mesh(solution, error, tolerance, refinement)
        if finer == solution.mesh:
            break
        mesh = finer
    assert solution is not None
    return replace(
        solution,
        status=Status.TOLERANCE_NOT_MET,
        message=(
            f"refinement stopped after {len(records)} meshes with an estimated error of "
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
