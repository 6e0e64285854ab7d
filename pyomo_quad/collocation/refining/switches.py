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
    """Return bounds on the increase of the objective by misplaced control switches, by element.

    Let J(s) be the least objective with a control that switches at time s. If the switch is later
    by ds, the Hamiltonian before the switch, H-, applies for ds instead of the Hamiltonian after
    the switch, H+. This changes the states after the switch. The costates are the derivatives of
    the objective with respect to the states. Therefore dJ/ds = H- - H+. At the optimal switch the
    Hamiltonian does not jump (Weierstrass and Erdmann).

    A mesh determines the element in which the control switches, but not the time of the switch
    within the element. The time may be wrong by up to the width w of the element. This also holds
    for a sliver (a narrow element with a single collocation point, cut around a switch). A wrong
    time leaves no residuals in the equations between the points. It may also remain hidden in a
    comparison with the previous mesh, which may have had the same sliver.

    The jump of the Hamiltonian decreases towards the optimal switch, which is at most w away. J is
    therefore too large by at most |H- - H+| w.

    The jump is the difference of the Hamiltonians at two neighbouring collocation points. If an
    equation depends on time explicitly, the Hamiltonian changes even without a switch. The
    difference is therefore taken with the explicit time equal for both points: once with the time
    of the first point, and once with the time of the second point. The mean of the two differences
    counts. A jump between two elements counts for the narrower element, which was cut for that
    jump.

    The costates are computed in two ways: directly as multipliers, and by integration through the
    element. The two results differ where the polynomials cannot follow the costates. The smaller
    jump of the Hamiltonian counts.

    Parameters
    ----------
    solution : Solution
        Solution on the present mesh, with its multipliers.

    Returns
    -------
    ndarray, shape (n_elements,)
        Upper bounds in the unit of the objective, zero for an element without a control switch. An
        element has a control switch if all of these conditions hold in or beside it:

        - An algebraic variable jumps.
        - A limit on algebraic variables alone becomes active or inactive.
        - No limit that contains a state or a rate becomes active or inactive.
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
    """Return the indices of elements in or beside which an algebraic variable jumps.

    Values are taken at the collocation points of the element, and at one point on either side. A
    variable jumps if the largest and smallest of these values differ by more than a quarter of its
    range. The range is the difference of the variable's upper and lower limits. If a limit is
    missing, the range is the difference of its largest and smallest values over the horizon.
    """
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
    """Return the Hamiltonian at collocation points, with parameters taken at given times.

    The function `misplaced_switches` compares the Hamiltonians of two neighbouring points. Both
    must use the same values of the time-dependent parameters. The caller therefore gives the times
    at which these parameters are taken.

    Parameters
    ----------
    solution : Solution
        Solution on the present mesh, with its multipliers.
    points : ndarray of int, shape (n,)
        Indices of the collocation points at which states, rates (derivatives of the states),
        controls and costates are taken.
    fractions : ndarray, shape (n,)
        Fractions of the horizon at which the time-dependent parameters are taken.

    Returns
    -------
    ndarray, shape (2, n)
        Hamiltonians per unit of the fraction of the horizon. Row 0 uses the costates integrated
        through the elements, row 1 the costates directly from the multipliers.
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
