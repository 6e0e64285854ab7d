"""Controls that enter linearly, held near those of the last mesh.

Where neither cost nor equations curve in a control, a short element hardly determines it: the
cost of a wrong value falls with the cube of the width, below the barrier of Ipopt, and the
control chatters.  A small price on its distance from the last mesh's control determines it,
and vanishes as the meshes converge: a step of the proximal point method (Rockafellar (1976),
SIAM Journal on Control and Optimization 14, 877-898), used on singular arcs by Pager and Rao
(2022), Computational Optimization and Applications 81, 857-887.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pyomo_quad.collocation.compiled import CompiledModel
    from pyomo_quad.collocation.nodes import FloatArray
    from pyomo_quad.collocation.solution import Solution
    from pyomo_quad.collocation.transcription import Transcription

__all__ = ["DampedProgram", "Damping", "damping_of"]


@dataclass(frozen=True, kw_only=True)
class Damping:
    """What the distance of controls from those of a solution costs.

    Attributes
    ----------
    solution : Solution
        Of the last mesh.
    controls : ndarray of int
        Positions among the algebraic variables.
    prices : ndarray
        For each of them, the price of a unit of its mean square distance over the horizon.
    """

    solution: Solution
    controls: NDArray[np.intp]
    prices: FloatArray

    def times(self, factor: float) -> Damping:
        """Return the damping with its prices multiplied."""
        return replace(self, prices=factor * self.prices)

    def applied_to(self, program: Transcription) -> DampedProgram:
        """Return a program of the same model with the price on its objective."""
        mesh = program.mesh or self.solution.mesh
        old, held = self.solution.mesh.point_fractions, self.solution.trajectory.algebraics
        # Straight lines between the points: beside a jump the polynomials swing far beyond.
        near = [np.interp(mesh.point_fractions, old, held[:, k]) for k in self.controls]
        return DampedProgram(
            program=program,
            columns=program.layout.algebraic_columns[:, self.controls].ravel(),
            weights=(mesh.quadrature_weights[:, None] * self.prices).ravel(),
            near=np.column_stack(near).ravel(),
        )


def damping_of(solution: Solution, weight: float) -> Damping | None:
    """Return the damping toward a solution; None where it has no bounded linear control.

    Parameters
    ----------
    solution : Solution
    weight : float
        Share of the objective that a control a whole range away from the solution's costs.
    """
    lower, upper = solution.algebraic_limits
    width = upper - lower
    is_damped = _is_linear(solution.problem.compiled) & np.isfinite(width) & (width > 0.0)
    controls = np.flatnonzero(is_damped)
    if weight == 0.0 or controls.size == 0:
        return None
    prices = 2.0 * weight * solution.nominal_objective / width[controls] ** 2
    return Damping(solution=solution, controls=controls, prices=prices)


def _is_linear(compiled: CompiledModel) -> NDArray[np.bool_]:
    """Say of each algebraic variable if no equation or integrand over time curves in it."""
    declared, path = compiled.declared, compiled.path
    first = 2 * len(declared.states)
    curved = path.hessian_columns[path.hessian_rows == path.hessian_columns]
    return ~np.isin(first + np.arange(len(declared.algebraics)), curved)


@dataclass(frozen=True, kw_only=True)
class DampedProgram:
    """A program with `weights / 2 * (z[columns] - near)**2` added to what Ipopt minimises."""

    program: Transcription
    columns: NDArray[np.intp]
    weights: FloatArray
    near: FloatArray

    @property
    def n_rows(self) -> int:
        """Number of rows."""
        return self.program.n_rows

    @property
    def n_points(self) -> int:
        """Number of collocation points."""
        return self.program.n_points

    @property
    def is_negated(self) -> bool:
        """Whether the declared objective is maximised."""
        return self.program.is_negated

    def objective(self, z: FloatArray) -> float:
        """Return the objective and the price of the distance."""
        away = z[self.columns] - self.near
        return self.program.objective(z) + 0.5 * float(self.weights @ away**2)

    def gradient(self, z: FloatArray) -> FloatArray:
        """Return the gradient of the objective."""
        gradient = np.array(self.program.gradient(z))
        gradient[self.columns] += self.weights * (z[self.columns] - self.near)
        return gradient

    def constraints(self, z: FloatArray) -> FloatArray:
        """Return the value of every row."""
        return self.program.constraints(z)

    def jacobianstructure(self) -> tuple[Any, Any]:
        """Return rows and columns of the Jacobian's nonzeros."""
        return self.program.jacobianstructure()

    def jacobian(self, z: FloatArray) -> FloatArray:
        """Return the Jacobian's nonzeros."""
        return self.program.jacobian(z)

    def hessianstructure(self) -> tuple[Any, Any]:
        """Return rows and columns of the Lagrangian Hessian's lower triangle."""
        rows, columns = self.program.hessianstructure()
        return np.concatenate([rows, self.columns]), np.concatenate([columns, self.columns])

    def hessian(self, z: FloatArray, multipliers: FloatArray, factor: float) -> FloatArray:
        """Return the nonzeros of the Lagrangian's Hessian."""
        held = self.program.hessian(z, multipliers, factor)
        return np.concatenate([held, factor * self.weights])
