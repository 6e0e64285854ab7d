"""Displacements that move the path of a coarse solution out of keep-out zones.

Between its collocation points, the path of a coarse solution may cut corners of zones. A vehicle
that follows it under feedback then enters the zones too (`flight.tracking`). The path is therefore
displaced. A simulated flight follows the displaced path. If this flight reaches the goal within the
limits, the coarse solution becomes a usable plan of lower accuracy.

A displacement is a sum of pushes, each of which moves the path by one vector during a time span.
See docs/theory/tracking.md, eq. (8).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from pyomo_quad.flight.flight import POSITION_STATES, spans_where
from pyomo_quad.flight.references import quintic_progress

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pyomo_quad.arrays import FloatArray
    from pyomo_quad.collocation import Dynamics
    from pyomo_quad.collocation.limits import LimitValues
    from pyomo_quad.flight.flight import Flown

# Prefix of the limits that depend on the position only.
_AIRSPACE = "airspace."
# Name of the limits on the speed during hovers at waypoints.
_HOVER = "mission.hold_speed"
# Time in which a path moves from its own place to its displaced place [s]: a push of half a metre
# then takes an acceleration of 1 m/s^2.
_RAMP_S = 1.7
# Push relative to the depth of the path inside a zone, and its least length [m]: the vehicle
# follows a push only in part, and edges of zones are rounded.
_MORE, _LEAST_M = 1.3, 0.004
# Step of the finite differences that give the direction out of a zone [m].
_STEP_M = 1e-3


@dataclass(frozen=True, kw_only=True, eq=False)
class Push:
    """Displacement of a path by one vector during a time span, with smooth ramps before and after.

    Attributes
    ----------
    first, last : float
        Time span of the full displacement [s].
    vector : ndarray, shape (3,)
        Full displacement [m].
    """

    first: float
    last: float
    vector: FloatArray

    def at(self, times: FloatArray) -> FloatArray:
        """Return the displacement at n times, shape (n, 3) [m].

        `times` has the times in flight [s], shape (n,).
        """
        before = np.clip((times - self.first) / _RAMP_S + 1.0, 0.0, 1.0)
        after = np.clip((self.last - times) / _RAMP_S + 1.0, 0.0, 1.0)
        share = quintic_progress(before) * quintic_progress(after)
        return np.asarray(share[:, None] * self.vector)


Displacement = tuple[Push, ...]
"""Sum of pushes by which a path is displaced."""


def displaced(times: FloatArray, displacement: Displacement) -> tuple[FloatArray, FloatArray]:
    """Return the displacement [m] of a path and its time derivative [m/s], shape (n, 3) each.

    `times` are the n times [s]. `displacement` is a tuple of pushes, which are summed. An empty
    tuple displaces nothing.
    """
    step = 1e-4 * _RAMP_S
    none = np.zeros((len(times), 3))
    early, late = (sum((p.at(times + s) for p in displacement), none) for s in (-step, step))
    return 0.5 * (early + late), (late - early) / (2.0 * step)


def limits_along(dynamics: Dynamics, flown: Flown) -> list[LimitValues]:
    """Return values and bounds of each limited quantity at the samples of a flight.

    `dynamics` has the equations of the vehicle and the limits. `flown` has the samples of the
    flight.
    """
    return dynamics.limits_of(dynamics.solved(flown.t, flown.states, flown.controls))


def pushes_out(dynamics: Dynamics, flown: Flown, limits: Sequence[LimitValues]) -> Displacement:
    """Return displacements that lead a flight's path back within the limits of the airspace.

    These limits are keep-out zones, fence, floor and ceiling. Each time span with a violation gets
    one push, the shortest way back and somewhat beyond. `limits` has all
    limits along the flight (see `limits_along`); limits that do not belong to the airspace are
    ignored. The samples of `flown` must be dense near the limits of the airspace.
    """
    # See docs/theory/tracking.md, eq. (8).
    found: list[Push] = []
    for name, depth in _depths(limits).items():
        for first, after in spans_where(depth > 0.0):
            # The shortest way out is taken from the place where the flight is deepest inside.
            deepest = first + int(np.argmax(depth[first:after]))
            slope = _slope(dynamics, flown, deepest, name)
            steepness = float(np.linalg.norm(slope))
            if steepness > 0.0:
                length = _MORE * float(depth[deepest]) / steepness + _LEAST_M
                span = float(flown.t[first]), float(flown.t[after - 1])
                vector = -length * slope / steepness
                found.append(Push(first=span[0], last=span[1], vector=vector))
    return tuple(found)


def moves_in_hovers(flown: Flown, limits: Sequence[LimitValues], allowed: float) -> bool:
    """Return whether a flight exceeds the limit on the speed during hovers at waypoints.

    `flown` has the samples of the flight. `limits` has the limited quantities at these samples (see
    `limits_along`). `allowed` is the tolerated violation, relative to the larger of 1 and the
    limit.
    """
    hovers = [limit for limit in limits if limit.name.startswith(_HOVER)]
    return any(limit.worst(slice(None), flown.t).relative > allowed for limit in hovers)


def _depths(limits: Sequence[LimitValues]) -> dict[str, FloatArray]:
    """Return how much each sample of a flight violates each limit of the airspace, by limit.

    Violations are in the unit of the limit, and negative if the limit is kept.
    """
    return {
        limit.name: np.fmax(limit.lower - limit.values, limit.values - limit.upper)
        for limit in limits
        if limit.name.startswith(_AIRSPACE)
    }


def _slope(dynamics: Dynamics, flown: Flown, sample: int, name: str) -> FloatArray:
    """Return the gradient of the depth inside a zone at one sample, shape (3,).

    The gradient points deeper into the zone, in the unit of the constraint `name` per metre.
    """
    columns = [dynamics.state_names.index(state) for state in POSITION_STATES]
    rows = np.full(2 * len(columns), sample)
    states = flown.states[rows]
    for k, column in enumerate(columns):
        states[2 * k : 2 * k + 2, column] += (-_STEP_M, _STEP_M)
    near = replace(
        flown,
        t=flown.t[rows],
        states=states,
        controls=flown.controls[rows],
        energy=flown.energy[rows],
    )
    before, beyond = _depths(limits_along(dynamics, near))[name].reshape(-1, 2).T
    return np.asarray((beyond - before) / (2.0 * _STEP_M))
