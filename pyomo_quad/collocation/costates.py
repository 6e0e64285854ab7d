"""Costates and Hamiltonian from the multipliers, by the covector mapping.

Sign convention: for the minimised objective J, the costate p is the derivative of the
optimal J with respect to the state, and H = L + p . dx/dt with L the integrand of J, plus
those of integral constraints times their multipliers; a maximised objective is mapped as
the minimum of its negative, and p and H are given for that minimum.

The multiplier of an equation F(dx/dt, x, u, t) = 0 at a point of weight w on a horizon of
length T approximates w T mu with mu the continuous multiplier, and p = -(dF/d(dx/dt))' mu.
At the left end of an element the Lagrangian's derivative with respect to that state gives
the costate directly: p(start) = (dF/d(dx/dt))' multipliers weighted by column 0 of the
differentiation matrix.  Source: Garg, Hager and Rao (2011), Automatica 47, 829-837, for the flipped
Radau scheme.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pyomo_quad.collocation.mapped import MappedFunction
from pyomo_quad.collocation.nodes import FloatArray, radau_rule

if TYPE_CHECKING:
    from pyomo_quad.collocation.transcription import Transcription

__all__ = ["Costates", "costates_of"]


@dataclass(frozen=True, kw_only=True)
class Costates:
    """Costates per element: per_element[e] has shape (degree + 1, n_states), left end first.

    `hamiltonian` holds H at the collocation points, shape (n_points,).
    """

    per_element: tuple[FloatArray, ...]
    hamiltonian: FloatArray

    @property
    def at_points(self) -> FloatArray:
        """Costates at the collocation points, shape (n_points, n_states)."""
        return np.vstack([block[1:] for block in self.per_element])


def costates_of(
    program: Transcription, z: FloatArray, multipliers: FloatArray, span: float
) -> Costates:
    """Map the multipliers of the path equations to costates and Hamiltonian.

    Parameters
    ----------
    program : Transcription
    z : ndarray
        The solution.
    multipliers : ndarray
        Of all rows, as Ipopt returns them for the unscaled program.
    span : float
        Length of the horizon in physical time.
    """
    mesh, compiled = program.mesh, program.compiled
    if mesh is None:
        return Costates(per_element=(), hamiltonian=np.zeros(0))
    n_states, n = len(compiled.declared.states), compiled.n_equations
    rows = multipliers[: mesh.points * n].reshape(mesh.points, n)
    by_rate = _rate_products(program, z, rows, n_states)
    inner = -by_rate / mesh.quadrature_weights[:, None]
    values = []
    for e, degree in enumerate(mesh.degrees):
        points = slice(mesh.first_node[e], mesh.first_node[e + 1])
        first_column = radau_rule(degree).differentiation[:, 0] / mesh.widths[e]
        left = first_column @ by_rate[points]
        values.append(np.vstack([left, inner[points]]))
    states = z[program.layout.state_columns]
    rates = program.layout.slope_matrix @ states
    density = program.lagrangian_density(z, multipliers)
    hamiltonian = (density + np.sum(inner * rates, axis=1)) / span
    return Costates(per_element=tuple(values), hamiltonian=hamiltonian)


def _rate_products(
    program: Transcription, z: FloatArray, rows: FloatArray, n_states: int
) -> FloatArray:
    """Return (dF/d rate)' multipliers at every point, shape (n_points, n_states)."""
    compiled = program.compiled
    jacobian = MappedFunction(compiled.path.jacobian, program.layout.points)
    entries = jacobian(program.path_variables(z), program.data.at_points())[0]
    products = np.zeros((program.layout.points, n_states))
    for k, (row, column) in enumerate(
        zip(compiled.path.jacobian_rows, compiled.path.jacobian_columns, strict=True)
    ):
        if column < n_states and row < compiled.n_equations:
            products[:, column] += entries[:, k] * rows[:, row]
    return products
