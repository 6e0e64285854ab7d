"""Simulated flight: its table, energy, distance from the goal and broken limits."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import nan
from typing import TYPE_CHECKING

import numpy as np

from pyomo_quad.collocation import Summarised
from pyomo_quad.flight.limit_words import breach_words
from pyomo_quad.scenario.accuracy import FIGURES, Accuracy

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    import pandas as pd

    from pyomo_quad.arrays import FloatArray
    from pyomo_quad.collocation import Dynamics, Violation


ARRIVAL_DISTANCE_M = 0.05
"""Miss beyond which a flight has not arrived: a seventh of the paper's vehicle from rotor to
rotor, and so little of a flight of metres that leaving it out saves no energy worth naming."""
ARRIVAL_SPEED_M_PER_S = 0.1
"""Final speed beyond which a flight passes the goal rather than arriving: from it, the controller
with its default gains stops within the distance above."""
#: Violation of a control's limit, relative to the larger of 1 and the limit, to which a flight
#: clips the control: half of what the highest accuracy allows.
HELD_BREACH = 0.5 * FIGURES[Accuracy.PROOF].breach
#: The position states, by their names in the declared model.
POSITION_STATES = ("rigid_body.x", "rigid_body.y", "rigid_body.z")
VELOCITY_STATES = ("rigid_body.vx", "rigid_body.vy", "rigid_body.vz")
TILT_STATES = ("rigid_body.phi", "rigid_body.theta")
#: Aerodynamic force on the vehicle other than thrust [N], along world axes.
AIR_FORCE = tuple(f"aerodynamics.force_{axis}" for axis in "xyz")


@dataclass(frozen=True, kw_only=True)
class Flown:
    """Samples of a simulated flight: times, states, controls and energy.

    Shapes: t (n,), states (n, n_states), controls (n, n_controls), energy (n,).
    """

    t: FloatArray
    states: FloatArray
    controls: FloatArray
    energy: FloatArray


@dataclass(frozen=True, kw_only=True)
class Resolve:
    """Record of one re-planning solve in flight."""

    t: float
    arrived_at: float
    """Time at which its plan arrived [s]."""
    solve_s: float
    """Processor time of the solve, independent of the delay in the simulated flight."""
    is_converged: bool
    is_late: bool
    """Whether its plan arrived after the time that the plan was made for."""


@dataclass(frozen=True, kw_only=True, repr=False)
class Flight(Summarised):
    """Simulated flight of a mission, with its table and results.

    Attributes
    ----------
    name : str
        "optimal", "adaptive/quintic", "open_loop/plan" and so on.
    frame : DataFrame
        Dense table with the columns `COLUMNS`.
    energy_J : float
        Energy spent, integrated with the flight.
    terminal_miss : mapping
        State name to final value minus required value, in the state's unit.
    terminal_miss_m : float
        Distance between final and required position.
    max_violation : float
        Worst violation of a limit, relative to the larger of 1 and the limit.
    worst_constraint : str
        The limit of that violation.
    is_verified : bool
        Whether an independent integration confirmed the flight, and the battery's power balance
        closes all along it.
    doubt : str
        Reason why a controlled flight is not verified, with the value found and the value allowed.
    owed_energy_J : float
        Energy needed to reach the required end from the flight's end state, estimated from the
        plan's costates; NaN if no plan has costates for it.
    broken_limits : tuple of str
        Every limit of the model that the flight violates, with the amount, the worst first.
    resolves : tuple of Resolve
        The solves of a flight that was re-planned.
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
    owed_energy_J: float = 0.0
    broken_limits: tuple[str, ...] = ()
    resolves: tuple[Resolve, ...] = ()
    doubt: str = ""

    @property
    def summary(self) -> dict[str, str]:
        """Name, energy, distance from the goal and duration."""
        return {
            "flight": self.name,
            "energy": f"{self.energy_J:.2f} J",
            "duration": f"{self.duration_s:g} s",
            "miss of the goal": f"{self.terminal_miss_m:.2g} m",
            "verified": "yes" if self.is_verified else "no",
        }

    def priced(self, end_prices: Mapping[str, float]) -> Flight:
        """Return the flight with its energy to complete, estimated from a plan's costates."""
        owed = sum(price * self.terminal_miss.get(name, 0.0) for name, price in end_prices.items())
        return replace(self, owed_energy_J=owed if end_prices else nan)

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
        owed_energy_J: float = nan,
        allowed: Mapping[str, float] | None = None,
        accuracy: Accuracy = Accuracy.PROOF,
    ) -> Flight:
        """Make a flight from its samples and the required final values of its states.

        ``allowed`` is the tolerated violation of a limit, by name without index; ``accuracy``, of
        the mission, gives the relative violation tolerated of every limit.
        """
        miss = terminal_miss_of(dynamics, flown.states[-1], wanted)
        breaches = dynamics.violations(flown.t, flown.states, flown.controls)
        worst: Violation = breaches[0]
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
            owed_energy_J=owed_energy_J,
            broken_limits=broken_limits(
                dynamics, breaches, allowed or {}, FIGURES[accuracy].breach
            ),
        )


def broken_limits(
    dynamics: Dynamics, breaches: Sequence[Violation], allowed: Mapping[str, float], breach: float
) -> tuple[str, ...]:
    """Return the limits that are violated by more than the tolerances, in words.

    As "roll angle by 0.2 rad".
    """
    return tuple(
        breach_words(found, dynamics.unit(found.name))
        for found in breaches
        if is_broken(found, allowed, breach)
    )


def is_broken(found: Violation, allowed: Mapping[str, float], breach: float) -> bool:
    """Return whether a limit is violated by more than the tolerances."""
    return found.relative > breach and found.size > allowed.get(found.name.partition("[")[0], 0.0)


def terminal_miss_of(
    dynamics: Dynamics, state: FloatArray, wanted: Mapping[str, float]
) -> dict[str, float]:
    """Return final minus required value of each state that the mission prescribes at the end."""
    final = dict(zip(dynamics.state_names, state, strict=True))
    return {name: float(final[name] - value) for name, value in wanted.items()}


def position_miss(miss: Mapping[str, float]) -> float:
    """Return the distance between final and required position [m]."""
    return float(np.linalg.norm([miss.get(name, 0.0) for name in POSITION_STATES]))
