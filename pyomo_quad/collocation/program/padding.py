"""Idle unknowns, which keep Ipopt from taking a program for a square system of equations.

Where equations are as many as free unknowns, Ipopt solves the equations alone: it ends at the first
point that meets them, whatever the objective says, and refuses more equations than that.  Both are
wrong where equations follow from others, as an end condition does that a conserved quantity meets:
the point is then not the only one.  An idle unknown has a square of its own in the objective and
stands in no equation, so that it stays zero and changes nothing else.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from pyomo_quad.collocation.program.bounds import Bounds, ChangedProgram, Scaling

if TYPE_CHECKING:
    from pyomo_quad.collocation.mesh import FloatArray


@dataclass(frozen=True, kw_only=True)
class PaddedProgram(ChangedProgram):
    """A program with idle unknowns behind its own.

    Attributes
    ----------
    own, idle : int
        Number of the program's unknowns, and of idle ones.
    weight : float
        Of an idle unknown's square in the objective.
    """

    own: int
    idle: int
    weight: float

    def objective(self, z: FloatArray) -> float:
        """Return what Ipopt minimises."""
        spare = z[self.own :]
        return self.program.objective(z[: self.own]) + 0.5 * self.weight * float(spare @ spare)

    def gradient(self, z: FloatArray) -> FloatArray:
        """Return its gradient."""
        own = self.program.gradient(z[: self.own])
        return np.concatenate([own, self.weight * z[self.own :]])

    def constraints(self, z: FloatArray) -> FloatArray:
        """Return the value of every row."""
        return self.program.constraints(z[: self.own])

    def jacobian(self, z: FloatArray) -> FloatArray:
        """Return the Jacobian's nonzeros."""
        return self.program.jacobian(z[: self.own])

    def hessianstructure(self) -> tuple[Any, Any]:
        """Return rows and columns of the Lagrangian Hessian's lower triangle."""
        rows, columns = self.program.hessianstructure()
        idle = self.own + np.arange(self.idle)
        return np.concatenate([rows, idle]), np.concatenate([columns, idle])

    def hessian(self, z: FloatArray, multipliers: FloatArray, factor: float) -> FloatArray:
        """Return the nonzeros of the Lagrangian's Hessian."""
        own = self.program.hessian(z[: self.own], multipliers, factor)
        return np.concatenate([own, np.full(self.idle, factor * self.weight)])

    def bounds(self, own: Bounds) -> Bounds:
        """Return the program's bounds with those of the idle unknowns."""
        none = np.full(self.idle, np.inf)
        return replace(
            own,
            lower=np.concatenate([own.lower, -none]),
            upper=np.concatenate([own.upper, none]),
        )

    def scaling(self, own: Scaling) -> Scaling:
        """Return the program's scaling with that of the idle unknowns."""
        return replace(own, unknowns=self.point(own.unknowns, fill=1.0))

    def point(self, own: FloatArray, fill: float = 0.0) -> FloatArray:
        """Return the program's unknowns with the idle ones."""
        return np.concatenate([own, np.full(self.idle, fill)])


def padded(program: Any, bounds: Bounds, scaling: Scaling) -> PaddedProgram | None:
    """Return a program with so many idle unknowns that it is not square, None if it is not."""
    idle = bounds.surplus + 1
    if idle <= 0:
        return None
    return PaddedProgram(
        program=program, own=bounds.lower.size, idle=idle, weight=1.0 / scaling.objective
    )
