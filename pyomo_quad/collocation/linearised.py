"""The differential equations linearised at points, and what a small error becomes by them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pyomo_quad.collocation.mapped import MappedFunction
from pyomo_quad.collocation.nodes import radau_rule

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pyomo_quad.collocation.nodes import FloatArray
    from pyomo_quad.collocation.solution import Solution
    from pyomo_quad.collocation.transcription import Transcription

__all__ = ["Linearised", "final_misses", "linearised"]


@dataclass(frozen=True, kw_only=True)
class Linearised:
    """Partial derivatives of the differential equations.

    Attributes
    ----------
    rows : ndarray of int, shape (n_rows,)
        Which path equations these are.
    by_rate, by_state : ndarray, shape (n_points, n_rows, n_states)
    """

    rows: NDArray[np.intp]
    by_rate: FloatArray
    by_state: FloatArray


def linearised(program: Transcription, variables: FloatArray, data: FloatArray) -> Linearised:
    """Return the derivatives at points, whose variables and data are given row by row."""
    compiled, n = program.compiled, program.layout.n_states
    path = compiled.path
    is_equality = compiled.is_equality
    by_rate = path.jacobian_columns < n
    rows = np.unique(
        [r for r in path.jacobian_rows[by_rate] if r < compiled.n_equations and is_equality[r]]
    ).astype(np.intp)
    entries = MappedFunction(path.jacobian, variables.shape[0])(variables, data)[0]
    matrices = np.zeros((variables.shape[0], rows.size, 2 * n))
    wanted = np.isin(path.jacobian_rows, rows) & (path.jacobian_columns < 2 * n)
    at = np.searchsorted(rows, path.jacobian_rows[wanted])
    matrices[:, at, path.jacobian_columns[wanted]] = entries[:, wanted]
    return Linearised(rows=rows, by_rate=matrices[:, :, :n], by_state=matrices[:, :, n:])


def final_misses(solution: Solution, errors: FloatArray) -> FloatArray:
    """Return what an error made in one element becomes at the end, when the controls are flown.

    Parameters
    ----------
    solution : Solution
    errors : ndarray, shape (n_elements, n_states)
        Of the states at the elements' ends.

    Returns
    -------
    ndarray, shape (n_elements, n_states)
        To first order, relative to the larger of 1 and the state's final magnitude; zero where
        the equations do not determine every rate.
    """
    program, mesh = solution.program, solution.mesh
    variables = program.path_variables(solution.unknowns)
    equations = linearised(program, variables, program.data.at_points())
    misses = np.zeros_like(errors)
    if equations.rows.size != errors.shape[1]:
        return misses
    growth = np.eye(errors.shape[1])
    for e in reversed(range(mesh.elements)):
        misses[e] = growth @ errors[e]
        growth = growth @ _transition(solution, equations, e)
    final = np.maximum(1.0, np.abs(solution.trajectory.states[-1]))
    return np.asarray(np.abs(misses) / final)


def _transition(solution: Solution, equations: Linearised, e: int) -> FloatArray:
    """Return how an element's last state depends on its first, its controls kept."""
    mesh = solution.mesh
    first, last = mesh.first_node[e], mesh.first_node[e + 1]
    slopes = radau_rule(mesh.degrees[e]).differentiation / mesh.widths[e]
    by_rate, by_state = equations.by_rate[first:last], equations.by_state[first:last]
    degree, n = last - first, by_state.shape[2]
    inner = np.einsum("kj,kab->kajb", slopes[:, 1:], by_rate)
    inner[np.arange(degree), :, np.arange(degree), :] += by_state
    outer = -np.einsum("k,kab->kab", slopes[:, 0], by_rate)
    moved = np.linalg.solve(inner.reshape(degree * n, degree * n), outer.reshape(degree * n, n))
    return np.asarray(moved[-n:])
