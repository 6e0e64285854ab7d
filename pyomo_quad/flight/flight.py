"""Result of a simulated flight: table, energy, distance from the goal and broken limits."""

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
    from numpy.typing import NDArray

    from pyomo_quad.arrays import FloatArray
    from pyomo_quad.collocation import Dynamics, Violation


ARRIVAL_DISTANCE_M = 0.05
"""Largest distance from the goal at the end of a flight that has arrived [m]. It is a seventh of
the rotor-to-rotor distance of the paper's vehicle, and so small a part of a flight of metres that
stopping short by as much saves no noticeable energy."""
ARRIVAL_SPEED_M_PER_S = 0.1
"""Largest final speed of a flight that has arrived [m/s]. From this speed, the controller with its
default gains stops within the distance above."""
#: Excess over a control's limit, relative to the larger of 1 and the limit, at which simulations
#: clip the planned control: half of the tolerance of the highest accuracy.
HELD_BREACH = 0.5 * FIGURES[Accuracy.PROOF].breach
#: The position states, by their names in the declared model.
POSITION_STATES = ("rigid_body.x", "rigid_body.y", "rigid_body.z")
VELOCITY_STATES = ("rigid_body.vx", "rigid_body.vy", "rigid_body.vz")
TILT_STATES = ("rigid_body.phi", "rigid_body.theta")
#: Aerodynamic force on the vehicle other than thrust [N], along world axes.
AIR_FORCE = tuple(f"aerodynamics.force_{axis}" for axis in "xyz")


@dataclass(frozen=True, kw_only=True)
class Flown:
    """States, controls and energy of a simulated flight, sampled at n times.

    Attributes
    ----------
    t : ndarray, shape (n,)
        Times [s].
    states : ndarray, shape (n, n_states)
        States in the order of the dynamics.
    controls : ndarray, shape (n, n_controls)
        Controls in the order of the dynamics.
    energy : ndarray, shape (n,)
        Energy spent since the start [J].
    """

    t: FloatArray
    states: FloatArray
    controls: FloatArray
    energy: FloatArray


@dataclass(frozen=True, kw_only=True)
class Resolve:
    """Record of one solve for a new plan during a simulated flight.

    Attributes
    ----------
    t : float
        Time in flight at which the solve began [s].
    arrived_at : float
        Time in flight at which the new plan was available [s].
    """

    t: float
    arrived_at: float
    solve_s: float
    """Processor time of the solve, independent of the delay in the simulated flight."""
    is_converged: bool
    """Whether Ipopt converged; otherwise the vehicle kept the plan before."""
    is_late: bool
    """Whether the plan was available only after the time at which it starts."""


@dataclass(frozen=True, kw_only=True, repr=False)
class Flight(Summarised):
    """Result of a simulated flight of a mission, with its table.

    Attributes
    ----------
    name : str
        Name in comparisons, such as "optimal", "adaptive/quintic" or "open_loop/plan".
    frame : DataFrame
        Table of the flight, one row per time, with the columns of `columns.flight_columns`.
    energy_J : float
        Energy spent [J], integrated together with the equations of motion.
    duration_s : float
        Time from the first to the last sample [s].
    terminal_miss : mapping
        State name -> final value minus required value, in the state's unit.
    terminal_miss_m : float
        Distance between final and required position [m].
    max_violation : float
        Largest violation of any limit, divided by max(1, abs(limit)).
    worst_constraint : str
        Name of the limit with the largest violation.
    is_verified : bool
        True if a second, independent integration confirmed the flight, and the battery can supply
        the required power throughout.
    wall_s : float
        Computing time of the simulation [s]. For the flight of a plan (the method `Plan.flight`),
        the time to compile, solve and verify the plan.
    owed_energy_J : float
        Energy needed to get from the flight's final state to the required final state [J],
        estimated from the costates of a plan. NaN without a plan, or for a plan made for a forecast
        wind, whose costates do not hold in the actual wind.
    broken_limits : tuple of str
        Every limit that the flight violates by more than the tolerance, in words with the amount.
        Limits of the model come first, in order of decreasing relative violation. Missed waypoints
        follow.
    resolves : tuple of Resolve
        Record of each solve for a new plan during the flight.
    doubt : str
        Reasons why a simulated flight is not verified, with the values found and allowed. Examples
        are two integrations that differ too much, and a battery that lacks power. Empty if there is
        none.
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
        """Main results of the flight, as a mapping from the name of a result to its value as text.

        The results are the flight's name, its energy, its duration, its distance from the goal and
        whether it is verified.
        """
        return {
            "flight": self.name,
            "energy": f"{self.energy_J:.2f} J",
            "duration": f"{self.duration_s:g} s",
            "miss of the goal": f"{self.terminal_miss_m:.2g} m",
            "verified": "yes" if self.is_verified else "no",
        }

    def priced(self, end_prices: Mapping[str, float]) -> Flight:
        """Return a copy of the flight with an estimate of the energy still needed at its end.

        The estimate is the attribute `owed_energy_J` of the copy. It is of first order, from the
        costates of a plan.

        Parameters
        ----------
        end_prices : mapping
            State name -> costate at the end of the plan, in J per unit of the state. If the mapping
            is empty, the estimate is NaN.
        """
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
        """Make the result of a flight from its samples and from the required final states.

        Parameters
        ----------
        name : str
            Name of the flight in comparisons.
        dynamics : Dynamics
            Simulated vehicle, which evaluates the limits.
        flown : Flown
            Samples of the flight.
        wanted : mapping
            State name -> required final value.
        frame : DataFrame
            Table of the flight.
        is_verified : bool
            Whether an independent integration confirmed the flight.
        wall_s : float
            Computing time [s].
        owed_energy_J : float, optional
            Energy needed to get from the final state to the required one [J]; NaN if unknown.
        allowed : mapping, optional
            Name of a limit without its index, such as "mission.hold_speed" -> tolerance on its
            violation, in the unit of the limit. A limit is broken if its violation exceeds this
            tolerance and the relative tolerance of `accuracy`.
        accuracy : Accuracy, optional
            Accuracy level, which sets the tolerance on the relative violation of every limit.
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


def spans_where(is_inside: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return the spans of consecutive samples for which a condition is true.

    `is_inside` has the truth value of the condition for each sample of a flight. Each span is a
    pair: the index of its first sample, and the index after its last sample.
    """
    edges = np.flatnonzero(np.diff(np.concatenate([[0], is_inside.astype(int), [0]]))).tolist()
    return list(zip(edges[::2], edges[1::2], strict=True))


def broken_limits(
    dynamics: Dynamics, breaches: Sequence[Violation], allowed: Mapping[str, float], breach: float
) -> tuple[str, ...]:
    """Return the limits that a flight violates by more than both tolerances, in words with amounts.

    An example is "roll angle by 0.2 rad". `breaches` has the largest violation of each limit, and
    `dynamics` the units of the limits. `allowed` maps names of limits to tolerances in these units,
    zero for a missing name. `breach` is one tolerance for all limits, on the violation divided by
    max(1, abs(limit)).
    """
    return tuple(
        breach_words(found, dynamics.unit(found.name))
        for found in breaches
        if is_broken(found, allowed, breach)
    )


def is_broken(found: Violation, allowed: Mapping[str, float], breach: float) -> bool:
    """Return whether a violation of a limit exceeds both of its tolerances.

    `allowed` maps names such as "mission.hold_speed" to tolerances in the unit of the limit, zero
    for a missing name. `breach` is the tolerance on the violation divided by max(1, abs(limit)).
    """
    return found.relative > breach and found.size > allowed.get(found.name.partition("[")[0], 0.0)


def terminal_miss_of(
    dynamics: Dynamics, state: FloatArray, wanted: Mapping[str, float]
) -> dict[str, float]:
    """Return the final value minus the required final value of states.

    `state` has the final values of all states, shape (n_states,). `wanted` maps names of states to
    required values. The result maps the same names to the differences.
    """
    final = dict(zip(dynamics.state_names, state, strict=True))
    return {name: float(final[name] - value) for name, value in wanted.items()}


def position_miss(miss: Mapping[str, float]) -> float:
    """Return the distance between final and required position [m].

    `miss` maps names of states to final minus required values, as `terminal_miss_of` returns them.
    """
    return float(np.linalg.norm([miss.get(name, 0.0) for name in POSITION_STATES]))
