"""Flyable trajectories near a coarse optimum: equations first, costs by the way.

The optimum of a coarse mesh obeys its equations at few points, and on a finer mesh misses them by
far.  From there Ipopt needs dozens of iterations to the optimum of the finer mesh, but few to a
point that obeys its equations: the search stops at the first.  The unknowns' distance from where it
began costs a little, so that flat directions stay where they are, and the bounds give way a little,
for none of the first points lies on them.
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

# Price of the squares of the scaled unknowns' distances, beside an objective scaled to about 1.
_PROXIMITY = 1e-4
# Barrier, and distance from the bounds, that the search begins with.
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
# Iterations that any search takes: equations may be met by chance where it begins.
_LEAST_ITERATIONS = 3


def feasible_point(
    program: NonlinearProgram,
    bounds: Bounds,
    scaling: Scaling,
    z: FloatArray,
    *,
    breach: float,
    met: float,
    progress: Progress | None,
) -> IpoptResult:
    """Return the first point of a search near another that obeys all equations.

    Parameters
    ----------
    breach : float
        By how much it may break bounds, relative to the larger of 1 and the bound.
    met : float
        Violation of the scaled equations at which they count as obeyed.

    Returns
    -------
    IpoptResult
        Its status is `CONVERGED` where the point obeys the equations, whatever the costs.
    """
    has_met = False

    def follow(now: Iteration) -> bool:
        nonlocal has_met
        has_met = now.infeasibility <= met and now.iteration >= _LEAST_ITERATIONS
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
    """Return bounds that give way by a share of the larger of 1 and the bound, but no equations."""

    def moved(lower: FloatArray, upper: FloatArray) -> tuple[FloatArray, FloatArray]:
        is_open = lower < upper
        below, above = (breach * np.maximum(1.0, np.abs(side)) for side in (lower, upper))
        return np.where(is_open, lower - below, lower), np.where(is_open, upper + above, upper)

    lower, upper = moved(bounds.lower, bounds.upper)
    row_lower, row_upper = moved(bounds.row_lower, bounds.row_upper)
    return replace(bounds, lower=lower, upper=upper, row_lower=row_lower, row_upper=row_upper)
