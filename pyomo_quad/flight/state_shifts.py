"""Shifts of a path in tilt, speed and rotor speeds that lead its flight within their limits.

Between the collocation points, a coarse solution may exceed a limit on one of these, and so does a
vehicle that follows it under feedback. In the next simulated flight, the path is therefore shifted
away from the limit during the time of the excess, and the regulator follows the path closely in
this state. The corrections anticipate the shift. See docs/theory/tracking.md, eq. (9).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pyomo_quad.flight.flight import TILT_STATES, VELOCITY_STATES, spans_where

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from pyomo_quad.arrays import FloatArray
    from pyomo_quad.collocation import Dynamics
    from pyomo_quad.flight.flight import Flown

# Limits on roll and pitch, on the speed, and the beginning of the names of the limits on rotor
# speeds, which end with the number of the rotor as the names of the states do.
_TILT_LIMITS = dict(zip(("limits.roll_limit", "limits.pitch_limit"), TILT_STATES, strict=True))
_SPEED_LIMIT = "limits.speed_limit"
_ROTOR_LIMIT, _ROTOR_SPEED = "limits.rotor_speed_limit", "rotors.omega"
# Fraction of the tolerance on a violation above which the path is shifted.
_SHARE = 0.5
# Shift relative to the largest excess.
_MORE = 1.0
# Time before and after an excess during which the shift is kept [s].
_AROUND_S = 0.1


@dataclass(frozen=True, kw_only=True)
class StateShift:
    """Shift of a path in some of its states during a time span.

    Attributes
    ----------
    first, last : float
        Time span [s].
    shift : mapping
        Full name of a state -> its change, in the unit of the state.
    """

    first: float
    last: float
    shift: Mapping[str, float]


def shifts_within_limits(
    dynamics: Dynamics, flown: Flown, tolerated: float
) -> tuple[StateShift, ...]:
    """Return shifts away from the limits on tilt, speed and rotor speed that a flight exceeds.

    Implements docs/theory/tracking.md, eq. (9).

    Parameters
    ----------
    dynamics : Dynamics
        Equations of the vehicle, with the limits.
    flown : Flown
        Samples of the flight.
    tolerated : float
        Tolerated violation of a limit, relative to the larger of 1 and the limit.

    Returns
    -------
    tuple of StateShift
        One for each time span in which the flight exceeds one of the limits by more than half of
        what is tolerated.
    """
    found: list[StateShift] = []
    for limit in dynamics.limits_of(dynamics.solved(flown.t, flown.states, flown.controls)):
        if not _is_kept_by_shifts(limit.name):
            continue
        above, below = limit.values - limit.upper, limit.lower - limit.values
        least = _SHARE * tolerated * max(1.0, float(np.abs(limit.values).max()))
        for excess, side in ((above, -1.0), (below, 1.0)):
            for first, after in spans_where(excess > 0.0):
                worst = first + int(np.argmax(excess[first:after]))
                if excess[worst] > least:
                    size = side * _MORE * float(excess[worst])
                    towards = _slope(limit.name, dynamics.state_names, flown.states[worst])
                    found.append(
                        StateShift(
                            first=float(flown.t[first]) - _AROUND_S,
                            last=float(flown.t[after - 1]) + _AROUND_S,
                            shift={name: size * slope for name, slope in towards.items()},
                        )
                    )
    return tuple(found)


def shifted(names: Sequence[str], times: FloatArray, shifts: Sequence[StateShift]) -> FloatArray:
    """Return the change of the states of a path at n times by shifts, shape (n, n_states).

    `names` has the names of the states, `times` the times of the path [s].
    """
    changes = np.zeros((len(times), len(names)))
    for shift in shifts:
        rows = (times >= shift.first) & (times <= shift.last)
        for name, change in shift.shift.items():
            changes[rows, names.index(name)] += change
    return changes


def _is_kept_by_shifts(limit: str) -> bool:
    """Return whether a limit is one of those on tilt, speed and rotor speed."""
    return limit in _TILT_LIMITS or limit == _SPEED_LIMIT or limit.startswith(_ROTOR_LIMIT)


def _slope(limit: str, names: Sequence[str], states: FloatArray) -> dict[str, float]:
    """Return the gradient of a limited quantity with respect to the states, by name of the state.

    `limit` is the name of the limit, and `states` has the states at the time of the gradient, named
    `names`. The quantity is a state itself, or the speed.
    """
    if limit == _SPEED_LIMIT:
        velocity = states[[names.index(name) for name in VELOCITY_STATES]]
        course = velocity / np.linalg.norm(velocity)
        return dict(zip(VELOCITY_STATES, course.tolist(), strict=True))
    if limit.startswith(_ROTOR_LIMIT):
        return {_ROTOR_SPEED + limit.removeprefix(_ROTOR_LIMIT): 1.0}
    return {_TILT_LIMITS[limit]: 1.0}
