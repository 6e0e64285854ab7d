"""Idle unknowns, which prevent Ipopt from treating a program as a square system of equations.

If there are as many equations as free unknowns, Ipopt solves the equations alone: it stops at the
first point that satisfies them, whatever the objective, and it refuses a program with more
equations. Both are wrong if some equations follow from others, for example an end condition that a
conserved quantity satisfies: the feasible point is then not unique. An idle unknown appears as a
square in the objective and in no equation, so that it stays zero and changes nothing else.
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
    """A program with idle unknowns appended.

    Attributes
    ----------
    own, idle : int
        Numbers of the program's unknowns and of idle unknowns.
    weight : float
        Weight of an idle unknown's square in the objective.
    """

    own: int
    idle: int
    weight: float

    def objective(self, z: FloatArray) -> float:
        """Return the objective to minimise."""
        spare = z[self.own :]
        return self.program.objective(z[: self.own]) + 0.5 * self.weight * float(spare @ spare)

    def gradient(self, z: FloatArray) -> FloatArray:
        """Return the gradient of the objective to minimise."""
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
        """Return the program's bounds, extended to the idle unknowns."""
        none = np.full(self.idle, np.inf)
        return replace(
            own,
            lower=np.concatenate([own.lower, -none]),
            upper=np.concatenate([own.upper, none]),
        )

    def scaling(self, own: Scaling) -> Scaling:
        """Return the program's scaling, extended to the idle unknowns."""
        return replace(own, unknowns=self.point(own.unknowns, fill=1.0))

    def point(self, own: FloatArray, fill: float = 0.0) -> FloatArray:
        """Return the program's unknowns, extended by the idle ones."""
        return np.concatenate([own, np.full(self.idle, fill)])


def padded(program: Any, bounds: Bounds, scaling: Scaling) -> PaddedProgram | None:
    """Return a program with enough idle unknowns not to be square, None if it needs none."""
    idle = bounds.surplus + 1
    if idle <= 0:
        return None
    return PaddedProgram(
        program=program, own=bounds.lower.size, idle=idle, weight=1.0 / scaling.objective
    )
