"""Search, near a given trajectory, for a trajectory that satisfies the equations of a fine mesh.

The optimum of a coarse mesh satisfies the equations at few points only, and violates them widely on
a finer mesh. From that optimum, Ipopt needs dozens of iterations to the optimum of the finer mesh,
but only a few iterations to a point that satisfies the equations of the finer mesh. The search
stops at the first point that satisfies the equations. A small penalty on the distance from the
initial point determines the unknowns on which the objective hardly depends. The bounds are relaxed
slightly, because an iterate of an interior-point method never lies on a bound.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from pyomo_quad.collocation.program.ipopt import SolverOptions, Status, run
from pyomo_quad.collocation.program.nonlinear import ExtendedProgram

if TYPE_CHECKING:
    from pyomo_quad.collocation.mesh import FloatArray
    from pyomo_quad.collocation.program.ipopt import IpoptResult, Iteration, Progress
    from pyomo_quad.collocation.program.nonlinear import Bounds, NonlinearProgram, Scaling

# Weight of the squared distances of the scaled unknowns from the initial point, relative to an
# objective that is scaled to about 1.
_PROXIMITY = 1e-4
# Initial barrier parameter, and initial distance from the bounds.
_BEGUN = 1e-4
_OPTIONS = SolverOptions(
    tolerance=1e-10,
    max_iterations=80,
    extra=(
        ("mu_init", _BEGUN),
        ("bound_push", _BEGUN),
        ("bound_frac", _BEGUN),
        ("slack_bound_push", _BEGUN),
        ("slack_bound_frac", _BEGUN),
    ),
)
# Least number of iterations: the initial point may satisfy the equations by chance.
_LEAST_ITERATIONS = 3


def feasible_point(
    program: NonlinearProgram,
    bounds: Bounds,
    scaling: Scaling,
    z: FloatArray,
    *,
    breach: float,
    feasibility_tolerance: float,
    progress: Progress | None,
) -> IpoptResult:
    """Return the first iterate of Ipopt, from a given point, that satisfies all equations.

    Parameters
    ----------
    program, bounds, scaling
        The nonlinear program, with its bounds and its scaling.
    z : ndarray, shape (n_unknowns,)
        Initial point. A small penalty on the distance from this point keeps the result near it.
    breach : float
        Allowed violation of bounds, relative to max(1, abs(bound)).
    feasibility_tolerance : float
        Violation of the scaled equations below which they count as satisfied.
    progress : callable or None
        Called at each iteration; returning False stops the search.

    Returns
    -------
    IpoptResult
        Its status is `CONVERGED` if the point satisfies the equations, whatever its objective.
    """
    has_met = False

    def follow(now: Iteration) -> bool:
        nonlocal has_met
        has_met = now.infeasibility <= feasibility_tolerance and now.iteration >= _LEAST_ITERATIONS
        return not has_met and (progress is None or progress(now) is not False)

    near = ExtendedProgram(
        program=program,
        columns=np.arange(z.size),
        near=z,
        weights=_PROXIMITY * scaling.unknowns**2,
        share=scaling.objective,
    )
    once = replace(scaling, objective=1.0)
    found = run(near, _widened(bounds, breach), once, z, options=_OPTIONS, progress=follow)
    return replace(found, status=Status.CONVERGED) if has_met else found


def _widened(bounds: Bounds, breach: float) -> Bounds:
    """Return bounds relaxed by `breach` times max(1, abs(bound)); equations are not relaxed."""

    def moved(lower: FloatArray, upper: FloatArray) -> tuple[FloatArray, FloatArray]:
        is_open = lower < upper
        below, above = (breach * np.maximum(1.0, np.abs(side)) for side in (lower, upper))
        return np.where(is_open, lower - below, lower), np.where(is_open, upper + above, upper)

    lower, upper = moved(bounds.lower, bounds.upper)
    row_lower, row_upper = moved(bounds.row_lower, bounds.row_upper)
    return replace(bounds, lower=lower, upper=upper, row_lower=row_lower, row_upper=row_upper)
