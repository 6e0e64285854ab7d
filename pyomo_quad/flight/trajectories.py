"""States, controls, energy and costates of a plan, as polynomials on its mesh."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pyomo_quad.collocation import interpolate

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pyomo_quad.collocation import Mesh

    FloatArray = NDArray[np.float64]

__all__ = ["Trajectories"]


@dataclass(frozen=True, kw_only=True)
class Trajectories:
    """Named values on a mesh.

    Shapes: states (n_points + 1, n_states), controls (n_points, n_controls), energy
    (n_points + 1,), costates (n_points, n_costates), hamiltonian (n_points,).
    """

    mesh: Mesh
    horizon: tuple[float, float]
    state_names: tuple[str, ...]
    control_names: tuple[str, ...]
    costate_names: tuple[str, ...]
    states: FloatArray
    controls: FloatArray
    energy: FloatArray
    costates: FloatArray
    hamiltonian: FloatArray

    def fractions(self, t: FloatArray) -> FloatArray:
        """Return times as fractions of the horizon, clipped to it."""
        start, end = self.horizon
        return np.clip((np.asarray(t, dtype=float) - start) / (end - start), 0.0, 1.0)

    def states_at(self, t: FloatArray) -> FloatArray:
        """Return the state polynomials at times, shape (n, n_states)."""
        return interpolate(self.mesh, self.states, self.fractions(t), with_start=True)

    def controls_at(self, t: FloatArray) -> FloatArray:
        """Return the control polynomials at times, shape (n, n_controls)."""
        return interpolate(self.mesh, self.controls, self.fractions(t), with_start=False)

    def energy_at(self, t: FloatArray) -> FloatArray:
        """Return the energy spent until times, shape (n,)."""
        held = interpolate(self.mesh, self.energy[:, None], self.fractions(t), with_start=True)
        return held[:, 0]

    @property
    def node_times(self) -> FloatArray:
        """Times of the nodes [s]."""
        start, end = self.horizon
        return start + (end - start) * self.mesh.node_fractions
