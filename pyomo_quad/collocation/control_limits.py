"""The range of each control: what its bounds and simple path limits leave of it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from pyomo_quad.collocation.nodes import FloatArray
    from pyomo_quad.collocation.problem import Instance, Problem

__all__ = ["control_limits"]

# Fractions of the horizon at which a limit is compared with itself to see if it varies.
_LOOKED_AT = (0.0, 0.2718, 0.5772, 1.0)


def control_limits(problem: Problem, instance: Instance) -> tuple[FloatArray, FloatArray]:
    """Return lower and upper limits of the algebraic variables, shape (n_algebraics,) each.

    Infinite where there is none, or where it varies with time.
    """
    at_each = [_limits_at(problem, instance, fraction) for fraction in _LOOKED_AT]
    lower, upper = (np.array(side) for side in zip(*at_each, strict=True))
    return (
        np.where(np.all(lower == lower[0], axis=0), lower[0], -np.inf),
        np.where(np.all(upper == upper[0], axis=0), upper[0], np.inf),
    )


def _limits_at(
    problem: Problem, instance: Instance, fraction: float
) -> tuple[FloatArray, FloatArray]:
    compiled = problem.compiled
    declared = compiled.declared
    data = problem.data_of(instance, np.array([fraction])).at_points()[0]
    limits = [np.array(side).ravel() for side in compiled.variable_limits(data)]
    lower, upper = (side[len(declared.states) :] for side in limits[:2])
    names = [s.name for s in declared.algebraics]
    for k, bound in enumerate(compiled.simple_path_bounds):
        if bound.variable in names:
            at = names.index(bound.variable)
            lower[at] = max(lower[at], limits[2][k])
            upper[at] = min(upper[at], limits[3][k])
    return lower, upper
