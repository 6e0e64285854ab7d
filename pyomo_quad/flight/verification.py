"""Proof of a plan by something that did not make it: its controls, flown.

A plan is verified when its controls, interpolated by the collocation polynomials and flown
by an adaptive integrator through the declared equations, end where they should, keep the
limits between the collocation points, and spend the energy that the optimiser reported.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pyomo_quad.flight.flight import FloatArray, Flown, position_miss, terminal_miss_of
from pyomo_quad.flight.plant import fly_controls

if TYPE_CHECKING:
    from collections.abc import Mapping

    from pyomo_quad.collocation import Dynamics, Mesh

__all__ = [
    "ENERGY_TOLERANCE",
    "MISS_TOLERANCE",
    "VIOLATION_TOLERANCE",
    "Verification",
    "verify_controls",
]

#: Largest miss of any final state: metres, metres per second, radians, or, for what is
#: larger than one (rotor speeds), relative.
MISS_TOLERANCE = 1e-4
#: Largest breach of a limit between points, relative to the larger of 1 and the limit.
VIOLATION_TOLERANCE = 1e-4
#: Largest relative difference of flown and planned energy.
ENERGY_TOLERANCE = 1e-6


@dataclass(frozen=True, kw_only=True)
class Verification:
    """What the re-simulation of a plan found.

    Attributes
    ----------
    terminal_miss : mapping
        State name to flown minus planned final value, in the state's unit.
    terminal_miss_m : float
        Distance of the final positions.
    worst_miss : str
        State whose miss is largest, relative to the larger of 1 and its value.
    max_violation, worst_constraint : float, str
        Worst breach of a limit between points, relative, and the limit's name.
    energy_difference_J, flown_energy_J : float
    is_verified : bool
        All of the above within this module's tolerances.
    """

    terminal_miss: Mapping[str, float]
    terminal_miss_m: float
    worst_miss: str
    max_violation: float
    worst_constraint: str
    energy_difference_J: float
    flown_energy_J: float
    is_verified: bool


def verify_controls(
    dynamics: Dynamics,
    mesh: Mesh,
    states: FloatArray,
    controls: FloatArray,
    horizon: tuple[float, float],
    energy: float,
) -> tuple[Verification, Flown]:
    """Fly a plan's controls and compare.

    Parameters
    ----------
    dynamics : Dynamics
        Of the model that was optimised.
    mesh : Mesh
    states : ndarray, shape (n_points + 1, n_states)
        Planned states at the nodes, in the order of `dynamics.state_names`.
    controls : ndarray, shape (n_points, n_controls)
    horizon : (float, float)
    energy : float
        Objective of the plan [J].

    Returns
    -------
    Verification, Flown
    """
    flown = fly_controls(dynamics, mesh, controls, states[0], horizon)
    planned = dict(zip(dynamics.state_names, states[-1], strict=True))
    miss = terminal_miss_of(dynamics, flown.states[-1], planned)
    relative = {name: abs(m) / max(1.0, abs(planned[name])) for name, m in miss.items()}
    worst_miss = max(relative, key=lambda name: relative[name])
    breach = dynamics.violations(flown.t, flown.states, flown.controls)[0]
    flown_energy = float(flown.energy[-1])
    verification = Verification(
        terminal_miss=miss,
        terminal_miss_m=position_miss(miss),
        worst_miss=worst_miss,
        max_violation=breach.relative,
        worst_constraint=breach.name,
        energy_difference_J=flown_energy - energy,
        flown_energy_J=flown_energy,
        is_verified=bool(
            relative[worst_miss] <= MISS_TOLERANCE
            and breach.relative <= VIOLATION_TOLERANCE
            and abs(flown_energy - energy) <= ENERGY_TOLERANCE * max(1.0, abs(energy))
            and np.isfinite(flown_energy)
        ),
    )
    return verification, flown
