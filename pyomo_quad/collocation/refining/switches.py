"""Possible increase of the objective because a control switches too early or too late."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pyomo_quad.collocation.program.compiled import MappedFunction
from pyomo_quad.collocation.program.transcription import rate_corrections
from pyomo_quad.collocation.refining.activity import JUMP_SHARE, known_boundaries, switch_elements

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pyomo_quad.collocation.mesh import FloatArray
    from pyomo_quad.collocation.solution import Solution

# Ratio of widths below which elements are equally wide up to rounding.
_SAME_WIDTH = 1.0 + 1e-9


def misplaced_switches(solution: Solution) -> FloatArray:
    """Return bounds on the increase of the objective by misplaced switches, shape (n_elements,).

    Each bound is the jump of the Hamiltonian times the element's width, in the unit of the
    objective. It is zero without a switch. See docs/theory/refinement.md, "Cost of a misplaced
    switch".
    """
    # At a switch, an algebraic variable jumps, and a limit on algebraic variables alone becomes
    # active or inactive. Elements where a limit on a state or a rate does so are left out.
    mesh, chosen = solution.mesh, switch_elements(solution) & _jumping_elements(solution)
    jumps = np.zeros((2, mesh.elements))
    if not (chosen and solution.problem.compiled.declared.states):
        return jumps[0]
    is_chosen = np.isin(np.arange(mesh.elements), list(chosen))
    element, widths = mesh.element_of_point, mesh.widths
    before, after = element[:-1], element[1:]
    is_inside = before == after
    is_compared = (is_chosen[before] | is_chosen[after]) & (
        is_inside | ~known_boundaries(solution)[after]
    )
    first = np.flatnonzero(is_compared)
    here, there = mesh.point_fractions[first], mesh.point_fractions[first + 1]
    # An explicit dependence on time changes the Hamiltonian even without a switch. Both points are
    # therefore compared at equal times: that of the first point, and that of the second.
    changes = np.abs(
        _hamiltonians(solution, first + 1, here)
        + _hamiltonians(solution, first + 1, there)
        - _hamiltonians(solution, first, here)
        - _hamiltonians(solution, first, there)
    )
    left, right, is_inside = before[first], after[first], is_inside[first]
    # A jump between two elements counts for the narrower one, which was cut for that jump.
    counts_left = is_inside | (widths[left] <= _SAME_WIDTH * widths[right])
    counts_right = ~is_inside & (widths[right] <= _SAME_WIDTH * widths[left])
    for change, jump in zip(0.5 * changes, jumps, strict=True):
        np.add.at(jump, left, np.where(counts_left, change, 0.0))
        np.add.at(jump, right, np.where(counts_right, change, 0.0))
    # Costates from multipliers and integrated costates differ where polynomials cannot follow them.
    # The smaller jump counts.
    return np.asarray(np.where(is_chosen, widths * jumps.min(axis=0), 0.0))


def _jumping_elements(solution: Solution) -> frozenset[int]:
    """Return the indices of elements in or beside which an algebraic variable jumps."""
    held, ranges = solution.trajectory.algebraics, solution.algebraic_ranges
    first = solution.mesh.first_node
    found = []
    for e in range(solution.mesh.elements):
        near = held[max(first[e] - 1, 0) : first[e + 1] + 1]
        # A jump exceeds a quarter of the variable's range (`Solution.algebraic_ranges`).
        if np.any(np.ptp(near, axis=0) > JUMP_SHARE * ranges):
            found.append(e)
    return frozenset(found)


def _hamiltonians(
    solution: Solution, points: NDArray[np.intp], fractions: FloatArray
) -> FloatArray:
    """Return the Hamiltonian at n collocation points, by two kinds of costates, shape (2, n).

    `points` are the points' indices. Time-dependent parameters are evaluated at `fractions`, n
    fractions of the horizon. The first row uses integrated costates, the second costates from
    multipliers.
    """
    program, n = solution.program, solution.program.layout.n_states
    variables = program.path_variables(solution.unknowns)[points]
    data = solution.problem.data_of(solution.instance, fractions).at_points()
    rows = MappedFunction(program.compiled.path.values, points.size)(variables, data)[0]
    prices = program.integral_weights(solution.unknowns, solution.multipliers.rows)
    rates = variables[:, :n] + rate_corrections(program, variables, data, rows)
    costates = solution.costates
    moved = [np.sum(p[points] * rates, axis=1) for p in (costates.at_points, costates.stages)]
    return np.asarray(rows[:, program.compiled.n_equations :] @ prices + np.array(moved))
