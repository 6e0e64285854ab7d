"""Shifts of a path in tilt, speed and rotor speeds, away from limits that a flight exceeds.

A coarse solution may exceed a limit between its collocation points. So may a simulated vehicle that
follows it under feedback. For the next simulation, the path is shifted away from the limit during
the excess. The linear-quadratic regulator that steers the simulated vehicle anticipates the shift.
It gives the shifted states a greater weight. See docs/theory/tracking.md, eq. (9).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pyomo_quad.flight.flight import TILT_STATES, VELOCITY_STATES, spans_where

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from pyomo_quad.arrays import FloatArray
    from pyomo_quad.collocation.limits import LimitValues
    from pyomo_quad.flight.flight import Flown

# Limits on roll and pitch, on the speed, and the beginning of the names of the limits on rotor
# speeds, which end with the number of the rotor as the names of the states do.
_TILT_LIMITS = dict(zip(("limits.roll_limit", "limits.pitch_limit"), TILT_STATES, strict=True))
_SPEED_LIMIT = "limits.speed_limit"
_ROTOR_LIMIT, _ROTOR_SPEED = "limits.rotor_speed_limit", "rotors.omega"
# Fraction of the tolerance on a violation above which the path is shifted.
_SHARE = 0.5
# Time before and after an excess during which the shift is kept [s].
_AROUND_S = 0.1


@dataclass(frozen=True, kw_only=True)
class StateShift:
    """Constant shift of some states of the path that a vehicle follows, during a time span.

    Attributes
    ----------
    first, last : float
        Start and end of the time span [s].
    shift : mapping
        Full name of a state -> its change, in the unit of the state.
    """

    first: float
    last: float
    shift: Mapping[str, float]


def shifts_within_limits(
    names: Sequence[str], flown: Flown, limits: Sequence[LimitValues], tolerated: float
) -> tuple[StateShift, ...]:
    """Return shifts of a path away from the limits that a simulated flight along it exceeds.

    Only limits on tilt, speed and rotor speed count. A time span beyond a limit gives a shift if
    its largest excess is above 0.5 * `tolerated` * max(1, m). Here m is the largest magnitude of
    the limited quantity along the flight. Implements docs/theory/tracking.md, eq. (9).

    Parameters
    ----------
    names : sequence of str
        Names of the states, in the order of the columns of `flown.states`.
    flown : Flown
        The simulated flight.
    limits : sequence of LimitValues
        Values and bounds of the limited quantities along the flight.
    tolerated : float
        Tolerated violation of a limit, relative to max(1, m).
    """
    found: list[StateShift] = []
    for limit in limits:
        if not _is_kept_by_shifts(limit.name):
            continue
        above, below = limit.values - limit.upper, limit.lower - limit.values
        least = _SHARE * tolerated * max(1.0, float(np.abs(limit.values).max()))
        for excess, side in ((above, -1.0), (below, 1.0)):
            for first, after in spans_where(excess > 0.0):
                worst = first + int(np.argmax(excess[first:after]))
                if excess[worst] > least:
                    size = side * float(excess[worst])
                    towards = _slope(limit.name, names, flown.states[worst])
                    found.append(
                        StateShift(
                            first=float(flown.t[first]) - _AROUND_S,
                            last=float(flown.t[after - 1]) + _AROUND_S,
                            shift={name: size * slope for name, slope in towards.items()},
                        )
                    )
    return tuple(found)


def shifted(names: Sequence[str], times: FloatArray, shifts: Sequence[StateShift]) -> FloatArray:
    """Return the sum of given shifts of a path's states at n times, shape (n, n_states).

    `names` has the names of all states, in the order of the columns. `times` has the n times [s].
    """
    changes = np.zeros((len(times), len(names)))
    for shift in shifts:
        rows = (times >= shift.first) & (times <= shift.last)
        for name, change in shift.shift.items():
            changes[rows, names.index(name)] += change
    return changes


def _is_kept_by_shifts(limit: str) -> bool:
    """Return whether a limit concerns tilt, speed or rotor speed.

    `limit` is the full name of the limit. Shifts of the path are made for these limits only.
    """
    return limit in _TILT_LIMITS or limit == _SPEED_LIMIT or limit.startswith(_ROTOR_LIMIT)


def _slope(limit: str, names: Sequence[str], states: FloatArray) -> dict[str, float]:
    """Return the gradient of a limited quantity with respect to the states of the vehicle.

    The result maps names of states to partial derivatives at `states`. `limit` is the name of the
    limit, `names` has the names of all states.
    """
    if limit == _SPEED_LIMIT:
        velocity = states[[names.index(name) for name in VELOCITY_STATES]]
        course = velocity / np.linalg.norm(velocity)
        return dict(zip(VELOCITY_STATES, course.tolist(), strict=True))
    if limit.startswith(_ROTOR_LIMIT):
        return {_ROTOR_SPEED + limit.removeprefix(_ROTOR_LIMIT): 1.0}
    return {_TILT_LIMITS[limit]: 1.0}
