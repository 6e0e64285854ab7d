"""A flown flight: what comparison and report read of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from collections.abc import Mapping

    import pandas as pd

    from pyomo_quad.collocation import Dynamics, Violation

__all__ = ["POSITION_STATES", "Flight", "Flown", "position_miss", "terminal_miss_of"]

FloatArray = NDArray[np.float64]

#: The states that say where the vehicle is, as the declared model names them.
POSITION_STATES = ("rigid_body.x", "rigid_body.y", "rigid_body.z")


@dataclass(frozen=True, kw_only=True)
class Flown:
    """Samples of an integrated flight.

    Shapes: t (n,), states (n, n_states), controls (n, n_controls), energy (n,).
    """

    t: FloatArray
    states: FloatArray
    controls: FloatArray
    energy: FloatArray


@dataclass(frozen=True, kw_only=True)
class Flight:
    """One flight of a mission.

    Attributes
    ----------
    name : str
        "optimal", "adaptive/quintic", "open_loop/plan" and so on.
    frame : DataFrame
        Dense table, columns of `flight.columns`.
    energy_J : float
        Energy spent, integrated with the flight.
    terminal_miss : mapping
        State name to final value minus wanted value, in the state's unit.
    terminal_miss_m : float
        Distance between final and wanted position.
    max_violation : float
        Worst breach of a limit, relative to the larger of 1 and the limit.
    worst_constraint : str
        The limit that breach is of.
    is_verified : bool
        Whether something that did not make the flight confirmed it.
    """

    name: str
    frame: pd.DataFrame
    energy_J: float
    duration_s: float
    terminal_miss: Mapping[str, float]
    terminal_miss_m: float
    max_violation: float
    worst_constraint: str
    is_verified: bool
    wall_s: float

    @classmethod
    def from_flown(
        cls,
        name: str,
        dynamics: Dynamics,
        flown: Flown,
        wanted: Mapping[str, float],
        frame: pd.DataFrame,
        *,
        is_verified: bool,
        wall_s: float,
    ) -> Flight:
        """Make a flight of its samples and the final values wanted of its states."""
        miss = terminal_miss_of(dynamics, flown.states[-1], wanted)
        worst: Violation = dynamics.violations(flown.t, flown.states, flown.controls)[0]
        return cls(
            name=name,
            frame=frame,
            energy_J=float(flown.energy[-1]),
            duration_s=float(flown.t[-1] - flown.t[0]),
            terminal_miss=miss,
            terminal_miss_m=position_miss(miss),
            max_violation=worst.relative,
            worst_constraint=worst.name,
            is_verified=is_verified,
            wall_s=wall_s,
        )


def terminal_miss_of(
    dynamics: Dynamics, state: FloatArray, wanted: Mapping[str, float]
) -> dict[str, float]:
    """Return final minus wanted value of each state that a value is wanted of."""
    final = dict(zip(dynamics.state_names, state, strict=True))
    return {name: float(final[name] - value) for name, value in wanted.items()}


def position_miss(miss: Mapping[str, float]) -> float:
    """Return the distance [m] of a terminal miss."""
    return float(np.linalg.norm([miss.get(name, 0.0) for name in POSITION_STATES]))
