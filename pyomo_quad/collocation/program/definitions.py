"""Find algebraic variables that equations define by other variables, and compute their values.

An example is a rate constant that an equation gives as a function of temperature. Such values
follow from the equations without a solve of the nonlinear program.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pyomo_quad.collocation.program.compiled import MappedFunction

if TYPE_CHECKING:
    from collections.abc import Iterable

    from pyomo_quad.collocation.mesh import FloatArray
    from pyomo_quad.collocation.program.transcription import Transcription

# Relative difference between two points below which a coefficient counts as constant.
_SAME = 1e-9
# Relative displacement of all variables (absolute below 1) between these two points.
_AWAY = 0.5
# Fraction of the largest initial residual that may remain for computed values to be accepted.
_LEFT = 1e-6

#: Position of a path equation, position of the algebraic variable that it defines, and constant
#: coefficient of that variable in the equation.
Definition = tuple[int, int, float]


def definitions(
    program: Transcription, z: FloatArray, among: Iterable[int] | None = None
) -> list[Definition]:
    """Find equations without time derivatives that define one algebraic variable each.

    An equality defines an algebraic variable that has a constant coefficient in it, if no other
    undefined algebraic variable has one. For example, ``k == exp(-1 / x)`` defines k, but not x. If
    y is a state, ``p - q == y`` defines p once another equation defines q.

    Parameters
    ----------
    program : Transcription
        Nonlinear program on one mesh.
    z : ndarray, shape (n_unknowns,)
        Unknowns of the program, at which the coefficients are evaluated.
    among : iterable of int, optional
        Indices, among all algebraic variables, of those that may be defined; by default all. The
        others count as already defined.

    Returns
    -------
    list of Definition
        Index of each defining equation among the path equations, index of the defined variable
        among the algebraic variables, and its coefficient.
    """
    compiled, layout, path = program.compiled, program.layout, program.compiled.path
    n, count = layout.n_states, layout.n_algebraics
    differential = path.jacobian_rows[path.jacobian_columns < n]
    rows = np.setdiff1d(np.flatnonzero(compiled.is_equality), differential)
    if program.mesh is None or not (count and rows.size):
        return []
    here, data = program.path_variables(z), program.data.at_points()
    there = here + _AWAY * np.maximum(1.0, np.abs(here))
    function = MappedFunction(path.jacobian, program.n_points)
    entries, moved = (function(variables, data)[0] for variables in (here, there))
    # A coefficient counts as constant if it is the same at all collocation points, and stays the
    # same when all variables are displaced.
    is_constant = np.all((entries == entries[0]) & (entries != 0.0), axis=0)
    is_constant &= np.all(np.abs(moved - entries) <= _SAME * np.abs(entries), axis=0)
    chosen = is_constant & np.isin(path.jacobian_rows, rows)
    chosen &= (path.jacobian_columns >= 2 * n) & (path.jacobian_columns < 2 * n + count)
    coefficients = np.zeros((compiled.n_equations, count))
    at = path.jacobian_rows[chosen], path.jacobian_columns[chosen] - 2 * n
    coefficients[at] = entries[0, chosen]
    is_open = np.isin(np.arange(count), list(range(count) if among is None else among))
    found: list[Definition] = []
    while True:
        candidates = (coefficients != 0.0) & is_open
        single = np.flatnonzero(candidates.sum(axis=1) == 1)
        if not single.size:
            return found
        row = int(single[0])
        k = int(candidates[row].argmax())
        found.append((row, k, float(coefficients[row, k])))
        is_open[k], coefficients[row] = False, 0.0


def with_defined(
    program: Transcription, variables: FloatArray, data: FloatArray, given: list[Definition]
) -> FloatArray:
    """Compute the algebraic variables that equations define, at several points.

    Repeated substitution solves the equations, which may depend on each other. It fails if the
    largest residual stays above a millionth of its initial value. Circular dependencies can cause
    this.

    Parameters
    ----------
    program : Transcription
    variables : ndarray, shape (n_points, n_variables)
        Rates (derivatives of the states with respect to the fraction of the horizon), states,
        algebraic and static variables, one row per point.
    data : ndarray, shape (n_points, n_data)
        Fraction of the horizon and parameters, one row per point.
    given : list of Definition
        The defining equations and their variables, from `definitions`.

    Returns
    -------
    ndarray, shape (n_points, n_variables)
        Copy of `variables` in which the defined variables satisfy their equations. If the
        substitution fails, `variables` itself.
    """
    if not given:
        return variables
    rows, defined, coefficients = (np.array(part) for part in zip(*given, strict=True))
    function = MappedFunction(program.compiled.path.values, len(variables))
    columns, moved = 2 * program.layout.n_states + defined, np.array(variables)
    before = function(moved, data)[0][:, rows]
    left = before
    for _ in given:
        moved[:, columns] -= left / coefficients
        left = function(moved, data)[0][:, rows]
    is_met = np.abs(left).max() <= _LEFT * np.abs(before).max()
    return moved if is_met else variables
