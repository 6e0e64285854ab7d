"""An elastic start: equations over time that give way for a price lead to where they can be met."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from pyomo_quad.collocation.program.bounds import Bounds, ChangedProgram, Scaling
from pyomo_quad.collocation.program.ipopt import Progress, SolverOptions, run

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pyomo_quad.collocation.mesh import FloatArray
    from pyomo_quad.collocation.program.transcription import Transcription

# What a unit of slack in every scaled equation, all the time, costs beside the scaled objective.
_PRICE = 1e4
# Slacks at the first point beyond those that it asks for, so that none is at its limit.
_ROOM = 0.1


@dataclass(frozen=True, kw_only=True)
class PricedProgram(ChangedProgram):
    """A program whose chosen rows have a slack of either sign, at a price for each."""

    rows: NDArray[np.intp]
    sizes: FloatArray
    prices: FloatArray

    def split(self, z: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the program's unknowns, and the slacks above, then below."""
        n = self.program.layout.unknowns
        return z[:n], z[n:]

    def objective(self, z: FloatArray) -> float:
        """Return the objective and the price of all slacks."""
        own, slacks = self.split(z)
        return self.program.objective(own) + float(np.tile(self.prices, 2) @ slacks)

    def gradient(self, z: FloatArray) -> FloatArray:
        """Return the gradient of the objective."""
        gradient = self.program.gradient(self.split(z)[0])
        return np.concatenate([gradient, self.prices, self.prices])

    def constraints(self, z: FloatArray) -> FloatArray:
        """Return the value of every row, with its slacks."""
        own, slacks = self.split(z)
        above, below = np.split(slacks, 2)
        values = np.array(self.program.constraints(own))
        values[self.rows] += self.sizes * (above - below)
        return values

    def jacobianstructure(self) -> tuple[Any, Any]:
        """Return rows and columns of the Jacobian's nonzeros."""
        rows, columns = self.program.jacobianstructure()
        slacks = self.program.layout.unknowns + np.arange(2 * self.rows.size)
        return np.concatenate([rows, self.rows, self.rows]), np.concatenate([columns, slacks])

    def jacobian(self, z: FloatArray) -> FloatArray:
        """Return the Jacobian's nonzeros."""
        return np.concatenate([self.program.jacobian(self.split(z)[0]), self.sizes, -self.sizes])

    def hessian(self, z: FloatArray, multipliers: FloatArray, factor: float) -> FloatArray:
        """Return the nonzeros of the Lagrangian's Hessian, which slacks leave as it is."""
        return self.program.hessian(self.split(z)[0], multipliers, factor)


def priced(program: Transcription, scaling: Scaling) -> PricedProgram:
    """Return a program whose equations over time have slacks of a scaled size, by their weights."""
    equations = np.tile(program.compiled.is_equality, program.n_points)
    rows = np.flatnonzero(equations)
    mesh = program.mesh
    weights = np.zeros(0) if mesh is None else mesh.quadrature_weights
    weights = np.repeat(weights, program.compiled.is_equality.size)[rows]
    return PricedProgram(
        program=program,
        rows=rows,
        sizes=1.0 / scaling.rows[rows],
        prices=_PRICE / scaling.objective * weights,
    )


def elastic_point(
    program: Transcription,
    bounds: Bounds,
    scaling: Scaling,
    z: FloatArray,
    *,
    options: SolverOptions,
    progress: Progress | None,
) -> FloatArray:
    """Return the unknowns at the optimum of the elastic program, from a first point."""
    elastic = priced(program, scaling)
    none, asked = np.zeros(2 * elastic.rows.size), bounds.row_lower[elastic.rows]
    off = (program.constraints(z)[elastic.rows] - asked) / elastic.sizes
    slacks = _ROOM + np.concatenate([np.maximum(-off, 0.0), np.maximum(off, 0.0)])
    result = run(
        elastic,
        Bounds(
            lower=np.concatenate([bounds.lower, none]),
            upper=np.concatenate([bounds.upper, none + np.inf]),
            row_lower=bounds.row_lower,
            row_upper=bounds.row_upper,
        ),
        Scaling(
            objective=scaling.objective,
            unknowns=np.concatenate([scaling.unknowns, none + 1.0]),
            rows=scaling.rows,
        ),
        np.concatenate([z, slacks]),
        options=options,
        progress=progress,
    )
    return np.clip(elastic.split(result.z)[0], bounds.lower, bounds.upper)
