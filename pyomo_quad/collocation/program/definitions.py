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

#: Index of an equation among the path equations, index of the variable that it defines among the
#: algebraic variables, and constant coefficient of this variable in the equation.
Definition = tuple[int, int, float]


def definitions(
    program: Transcription, z: FloatArray, among: Iterable[int] | None = None
) -> list[Definition]:
    """Find equations without time derivatives that define one algebraic variable each.

    The variable must have a constant coefficient in the equation. The coefficients are compared at
    the unknowns `z` and at a point displaced from `z`. `among` has the indices of admissible
    variables; None admits all. For example, ``k == exp(-1 / x)`` defines k, but not x.
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
    # An equation defines a variable if all other variables with a constant coefficient in it are
    # excluded or already defined. If y is a state, ``p - q == y`` defines p after q.
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
    """Return a copy of `variables` in which the equations `given` hold, one row per point.

    `variables` and `data` have the layout of `Transcription.path_slopes`. If the equations cannot
    be solved, for example because their dependencies are circular, `variables` is returned.
    """
    if not given:
        return variables
    rows, defined, coefficients = (np.array(part) for part in zip(*given, strict=True))
    function = MappedFunction(program.compiled.path.values, len(variables))
    columns, moved = 2 * program.layout.n_states + defined, np.array(variables)
    before = function(moved, data)[0][:, rows]
    left = before
    # An equation may depend on variables that other equations define. One pass per equation
    # suffices unless the dependencies are circular.
    for _ in given:
        moved[:, columns] -= left / coefficients
        left = function(moved, data)[0][:, rows]
    is_met = np.abs(left).max() <= _LEFT * np.abs(before).max()
    return moved if is_met else variables
