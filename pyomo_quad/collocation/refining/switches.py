"""Possible loss in the objective from a control that switches within an element."""

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
    """Bound the cost of each element's misplaced switch, in units of the objective.

    Let J(s) be the least objective with a control that switches at time s. If the switch is later
    by ds, the Hamiltonian before the switch, H-, applies for ds instead of the one after, H+, and
    the costates are the derivatives of the objective by the changed states: dJ/ds = H- - H+. At the
    optimal switch the Hamiltonian does not jump (Weierstrass and Erdmann). A mesh determines the
    element of the switch but not its place inside: the polynomials, or the single point of a
    sliver, put the switch anywhere in the width w. Neither the equations between the points nor a
    comparison with the last mesh, which may have had the same sliver, determine the place. The jump
    of the Hamiltonian decreases towards the optimal switch, which is at most w away, so that J is
    too large by at most |H- - H+| w.

    The Hamiltonian of an equation that reads time changes without a switch: each pair of
    neighbouring points is compared at the times of both.  A jump between two elements counts for
    the narrower, which was cut for it.  The costates come in two ways, as multipliers and
    integrated through the element; where the polynomials cannot follow them, these differ, and
    the smaller jump counts.

    Returns
    -------
    ndarray, shape (n_elements,)
        Zero where no limit on an algebraic variable begins or ceases to hold, or none jumps.
    """
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
    changes = np.abs(
        _hamiltonians(solution, first + 1, here)
        + _hamiltonians(solution, first + 1, there)
        - _hamiltonians(solution, first, here)
        - _hamiltonians(solution, first, there)
    )
    left, right, is_inside = before[first], after[first], is_inside[first]
    counts_left = is_inside | (widths[left] <= _SAME_WIDTH * widths[right])
    counts_right = ~is_inside & (widths[right] <= _SAME_WIDTH * widths[left])
    for change, jump in zip(0.5 * changes, jumps, strict=True):
        np.add.at(jump, left, np.where(counts_left, change, 0.0))
        np.add.at(jump, right, np.where(counts_right, change, 0.0))
    return np.asarray(np.where(is_chosen, widths * jumps.min(axis=0), 0.0))


def _jumping_elements(solution: Solution) -> frozenset[int]:
    """Return the elements in or beside which an algebraic variable changes by much of its range."""
    held, ranges = solution.trajectory.algebraics, solution.algebraic_ranges
    first = solution.mesh.first_node
    found = []
    for e in range(solution.mesh.elements):
        near = held[max(first[e] - 1, 0) : first[e + 1] + 1]
        if np.any(np.ptp(near, axis=0) > JUMP_SHARE * ranges):
            found.append(e)
    return frozenset(found)


def _hamiltonians(
    solution: Solution, points: NDArray[np.intp], fractions: FloatArray
) -> FloatArray:
    """Return the Hamiltonian at collocation points, with the data of other times.

    Shape (2, n_points). Row 0 takes the costates integrated through the elements, row 1 the
    costates as multipliers of the equations at the points. States, rates and controls are those
    of `points`; parameters over time are read at `fractions` of the horizon instead.
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
