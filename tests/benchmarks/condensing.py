"""What it takes to condense each element before the linear solver sees the matrix of a step.

    python -m tests.benchmarks.condensing

The matrix of Ipopt's step, [[H + S, J'], [J, 0]], holds in each element states, controls and
multipliers that no other element reads.  Their elimination, element by element as batches of dense
blocks, leaves the states between elements; beside it stands a whole iteration of Ipopt with MUMPS.
"""

import sys

import numpy as np
from scipy.sparse import bmat, coo_array, csc_array, diags_array
from scipy.sparse.linalg import splu

from pyomo_quad.collocation import Mesh
from pyomo_quad.flight import Planner
from pyomo_quad.scenario import load_scenario
from tests.benchmarks.measuring import seconds

_REPEATS = 5
LINE = "{:<26}{:>9}{:>10}{:>8}{:>12}{:>12}{:>12}{:>12}\n"


def step_matrix(solution):
    """Return the matrix of a step at a solution, its slacks those of a barrier."""
    program, z, bounds = solution.program, solution.unknowns, solution.bounds
    multipliers = solution.multipliers
    size = z.size
    rows, columns = program.hessianstructure()
    lower = coo_array((program.hessian(z, multipliers.rows, 1.0), (rows, columns)), (size, size))
    hessian = lower + lower.T - diags_array(lower.diagonal())
    slopes = coo_array((program.jacobian(z), program.jacobianstructure()), (program.n_rows, size))
    away = [np.maximum(z - bounds.lower, 1e-9), np.maximum(bounds.upper - z, 1e-9)]
    barrier = multipliers.lower / away[0] + multipliers.upper / away[1] + 1e-8
    held = -1e-8 * diags_array(np.ones(program.n_rows))
    return csc_array(bmat([[hessian + diags_array(barrier), slopes.T], [slopes, held]]))


def inner_places(solution):
    """Return the places in the matrix that belong to each element alone, one row an element."""
    program, mesh = solution.program, solution.mesh
    layout, size = program.layout, solution.unknowns.size
    rows = size + np.arange(program.first_condition_row).reshape(mesh.points, -1)
    found = []
    for e in range(mesh.elements):
        points = slice(mesh.first_node[e], mesh.first_node[e + 1])
        # Of the states at an element's nodes, the ends are shared.
        inner = layout.state_columns[mesh.first_node[e] + 1 : mesh.first_node[e + 1]]
        own = (inner, layout.algebraic_columns[points], rows[points])
        found.append(np.concatenate([part.ravel() for part in own]))
    return np.array(found)


def least_time(job):
    """Return the least seconds of some runs, and what the job returns."""
    taken = []
    for _ in range(_REPEATS):
        began = seconds()
        result = job()
        taken.append(seconds() - began)
    return min(taken), result


def dense_blocks(matrix, places):
    """Return the blocks of elements, and what couples them to the states between elements."""
    inner = np.stack([matrix[own][:, own].toarray() for own in places])
    outer = np.setdiff1d(np.arange(matrix.shape[0]), places.ravel())
    near = [outer[np.diff(matrix[own][:, outer].tocsc().indptr) > 0] for own in places]
    width = max(held.size for held in near)
    coupling = np.zeros((*inner.shape[:2], width))
    for e, own in enumerate(places):
        coupling[e, :, : near[e].size] = matrix[own][:, near[e]].toarray()
    return inner, coupling, near


def measured(name, solution, per_iteration):
    """Return the line of one solution."""
    matrix, places = step_matrix(solution), inner_places(solution)
    inner, coupling, near = dense_blocks(matrix.tocsr(), places)
    outer = np.setdiff1d(np.arange(matrix.shape[0]), places.ravel())

    def condense():
        return coupling.transpose(0, 2, 1) @ np.linalg.solve(inner, coupling)

    condensing, moved = least_time(condense)
    at = [np.searchsorted(outer, held) for held in near]
    rows = np.concatenate([np.repeat(held, held.size) for held in at])
    columns = np.concatenate([np.tile(held, held.size) for held in at])
    entries = [m[: h.size, : h.size].ravel() for m, h in zip(moved, at, strict=True)]
    change = coo_array((np.concatenate(entries), (rows, columns)), (outer.size, outer.size))
    left = csc_array(matrix[outer][:, outer] - change)
    factoring, _ = least_time(lambda: splu(left))
    whole, _ = least_time(lambda: splu(matrix))
    cells = (name, matrix.shape[0], outer.size, places.shape[1])
    taken = (condensing, factoring, whole, per_iteration)
    return LINE.format(*cells, *(f"{1e3 * t:.1f}" for t in taken))


def main():
    """Print one line for each mesh."""
    head = ("mesh", "unknowns", "left", "block", "condense ms", "rest ms", "SuperLU ms", "Ipopt ms")
    sys.stdout.write(LINE.format(*head).rstrip() + "\n")
    scenario = load_scenario("scenarios/paper_calm.toml")
    problem, _ = Planner().problem_for(scenario)
    for elements, degree in ((40, 3), (40, 5), (20, 8), (100, 5)):
        mesh = Mesh.uniform(elements, degree)
        began, lines = seconds(), []
        solution = problem.solve(mesh=mesh, progress=lines.append)
        per_iteration = (seconds() - began) / max(len(lines), 1)
        line = measured(f"{elements} of degree {degree}", solution, per_iteration)
        sys.stdout.write(line.rstrip() + "\n")


if __name__ == "__main__":
    main()
