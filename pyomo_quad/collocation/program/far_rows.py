"""Constraints far from their limits: left out of a warm-started solve, and checked afterwards.

Each constraint costs Ipopt a slack, a multiplier and a matrix row. A constraint c with the distance
s to its nearest limit is far if, linearised at the warm start,

    s > 0.1 sum_j abs(dc / dz_j) magnitude_j .

Then no limit is reached when each unknown z_j changes by a tenth of its magnitude.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from pyomo_quad.collocation.mesh import FloatArray
    from pyomo_quad.collocation.program.ipopt import IpoptResult
    from pyomo_quad.collocation.program.nonlinear import (
        Bounds,
        Multipliers,
        NonlinearProgram,
        Scaling,
    )

# Change of each unknown, relative to its magnitude, that a far row allows.
_CHANGE = 0.1
# Least share of far rows for which they are left out. In a mission past a dozen buildings, nearly
# all constraints are far.
_WORTH = 0.2


@dataclass(frozen=True)
class ProgramOfRows:
    """Nonlinear program with chosen constraints of another program, and all of its unknowns.

    Attributes
    ----------
    program : NonlinearProgram
        The other program.
    rows : ndarray of int
        Positions of the chosen constraints in the other program, in rising order.
    """

    program: NonlinearProgram
    rows: NDArray[np.intp]

    @property
    def n_rows(self) -> int:
        """Number of chosen constraints."""
        return int(self.rows.size)

    @property
    def n_points(self) -> int:
        """Number of collocation points, for progress reports."""
        return self.program.n_points

    @property
    def is_negated(self) -> bool:
        """Whether the Pyomo model maximises its objective, so that the negative is minimised."""
        return self.program.is_negated

    def objective(self, z: FloatArray) -> float:
        """Return the objective to minimise at the unknowns `z`."""
        return self.program.objective(z)

    def gradient(self, z: FloatArray) -> FloatArray:
        """Return the gradient of the objective to minimise at `z`, shape (n_unknowns,)."""
        return self.program.gradient(z)

    def constraints(self, z: FloatArray) -> FloatArray:
        """Return the values of the chosen constraints at the unknowns `z`, shape (n_rows,)."""
        return self.program.constraints(z)[self.rows]

    @cached_property
    def _entries(self) -> tuple[NDArray[np.intp], tuple[Any, Any]]:
        """Positions of the chosen constraints' nonzeros in the Jacobian of the other program.

        The second item has their rows and columns. The rows are numbered among the chosen
        constraints.
        """
        rows, columns = (np.asarray(index) for index in self.program.jacobianstructure())
        position = np.full(self.program.n_rows, -1)
        position[self.rows] = np.arange(self.rows.size)
        entries = np.flatnonzero(position[rows] >= 0)
        return entries, (position[rows[entries]], columns[entries])

    def jacobianstructure(self) -> tuple[Any, Any]:
        """Return row and column indices of the nonzeros of the constraints' Jacobian."""
        return self._entries[1]

    def jacobian(self, z: FloatArray) -> FloatArray:
        """Return the nonzeros of the constraints' Jacobian at the unknowns `z`."""
        return self.program.jacobian(z)[self._entries[0]]

    def hessianstructure(self) -> tuple[Any, Any]:
        """Return row and column indices of nonzeros in the lower triangle of the Hessian."""
        return self.program.hessianstructure()

    def hessian(self, z: FloatArray, multipliers: FloatArray, factor: float) -> FloatArray:
        """Return the nonzeros of the Hessian of factor * objective + multipliers . constraints.

        `multipliers` has one item for each chosen constraint.
        """
        return self.program.hessian(z, self.of_all(multipliers), factor)

    def of_all(self, multipliers: FloatArray) -> FloatArray:
        """Return multipliers of all constraints of the other program, zero for those not chosen.

        `multipliers` has one item for each chosen constraint.
        """
        full = np.zeros(self.program.n_rows)
        full[self.rows] = multipliers
        return full


def far_rows(
    program: NonlinearProgram, bounds: Bounds, scaling: Scaling, z: FloatArray
) -> NDArray[np.bool_]:
    """Return which constraints are far from their limits at the unknowns `z`, shape (n_rows,).

    The module's docstring defines a far constraint. An equation is never far.
    """
    values = program.constraints(z)
    slack = np.minimum(values - bounds.row_lower, bounds.row_upper - values)
    rows, columns = program.jacobianstructure()
    slopes = np.abs(program.jacobian(z)) / scaling.unknowns[columns]
    reach = np.bincount(rows, slopes, minlength=program.n_rows)
    return np.asarray((slack > _CHANGE * reach) & (bounds.row_lower < bounds.row_upper))


def run_without_far_rows(
    run: Callable[..., IpoptResult],
    program: NonlinearProgram,
    bounds: Bounds,
    scaling: Scaling,
    start: FloatArray,
    *,
    multipliers: Multipliers,
    **settings: Any,
) -> IpoptResult:
    """Solve a program from a warm start, without the constraints that are far from their limits.

    The whole program is solved if less than a fifth of the constraints are far, or if the optimum
    violates a far constraint. If the first solve fails, its result is returned unchecked. `run` has
    the arguments of `program.ipopt.run`.
    """
    is_far = far_rows(program, bounds, scaling, start)
    if np.count_nonzero(is_far) < _WORTH * program.n_rows:
        return run(program, bounds, scaling, start, multipliers=multipliers, **settings)
    part = ProgramOfRows(program, np.flatnonzero(~is_far))
    found = run(
        part,
        bounds.part(slice(None), part.rows),
        scaling.part(slice(None), part.rows),
        start,
        multipliers=multipliers.part(slice(None), part.rows),
        **settings,
    )
    held = found.multipliers
    found = replace(found, multipliers=replace(held, rows=part.of_all(held.rows)))
    # If the optimum satisfies the far rows, it is a local optimum of the whole program, in which
    # their multipliers are zero.
    values = program.constraints(found.z)[is_far]
    keeps = (values >= bounds.row_lower[is_far]) & (values <= bounds.row_upper[is_far])
    if not found.is_converged or keeps.all():
        return found
    # The violated far rows may be active at the optimum, so the whole program continues from here.
    whole = run(program, bounds, scaling, found.z, multipliers=found.multipliers, **settings)
    return whole.after(found)
