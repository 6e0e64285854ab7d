"""Probabilities that flights in turbulence break limits.

The probabilities follow from the covariance of the states of flights that follow a plan. See
docs/theory/risk.md, eqs. (7) to (9).
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from math import pi

import numpy as np
from scipy.special import ndtr

from pyomo_quad.arrays import FloatArray
from pyomo_quad.collocation import Dynamics
from pyomo_quad.flight.covariance import Spread
from pyomo_quad.flight.flight import (
    ARRIVAL_DISTANCE_M,
    ARRIVAL_SPEED_M_PER_S,
    POSITION_STATES,
    VELOCITY_STATES,
)
from pyomo_quad.flight.margins import FIELDS, HOLD, RADIUS, SPEED
from pyomo_quad.model.mission import HOVERING_M, HOVERING_M_PER_S
from pyomo_quad.scenario import Scenario

# Smallest standard deviation that a distance is divided by.
_ROUNDING = 1e-9
# Number of samples of the normal distribution at a place: a probability of 1e-3 is found within
# 14 %.
_SAMPLES = 50_000
# Steps of a spread between two evaluations of the derivatives of the limits, which change slowly
# along the path.
_GRADIENT_STEPS = 4
# Time between instants of a hover at a waypoint that are treated as independent [s].
_HOLD_STEP = 0.25

THERE, AT_REST = "distance from the goal at the end", "speed at the end"


@dataclass(frozen=True, kw_only=True, eq=False)
class LimitDistance:
    """Statistics of the distance between flights in turbulence and one bound on a constraint.

    The distance is positive within the bound.

    Attributes
    ----------
    name : str
        Name of the path constraint.
    field : str
        Scenario field that sets the bound, such as "limits.roll_max".
    distance, planned : ndarray, shape (n,)
        Distance of the mean flight (without gusts), and of the plan, at n times.
    deviation : ndarray, shape (n,)
        Standard deviation over the flights.
    correlation : ndarray, shape (n - 1,)
        Correlation between successive times.
    """

    name: str
    field: str
    # Distances are in the unit of the bound. The bound is the scenario's own, not the tightened one
    # that the plan keeps.
    distance: FloatArray
    planned: FloatArray
    deviation: FloatArray
    correlation: FloatArray

    @property
    def present_probability(self) -> float:
        """Probability that a flight along the present plan breaks the limit at some time."""
        return _crossing(self.distance, self.deviation, self.correlation)

    def probability(self, present: float = 0.0, changed: float = 0.0) -> float:
        """Predict the probability that a flight breaks the limit, for a plan with another margin.

        A margin is the least distance that a plan must keep from the bound: `present` now, and
        `changed` for the new plan. Let d be the planned distance. Where it is close to the margin,
        d <= present + max(present, largest deviation) / 4, it becomes `changed`. Elsewhere, it
        becomes max(d, changed). All are in the unit of the limit.
        """
        is_active = self.planned <= present + _ACTIVE * max(present, self.deviation.max())
        to_come = np.where(is_active, changed, np.maximum(self.planned, changed))
        # The distance of the mean flight changes by the same amount as that of the plan.
        return _crossing(self.distance + (to_come - self.planned), self.deviation, self.correlation)

    def margin_for(self, share: float, present: float, largest: float) -> float:
        """Return the smallest margin with which few enough flights break the limit.

        `share` is the largest acceptable probability, and `present` the margin of the present plan.
        The result is at most `largest`, even if that does not suffice.
        """
        if self.probability(present, 0.0) <= share:
            return 0.0
        low, high = 0.0, largest
        for _ in range(_HALVINGS):
            middle = (low + high) / 2
            low, high = (
                (low, middle) if self.probability(present, middle) <= share else (middle, high)
            )
        return high


# Distance of a plan from its tightened limit, relative to the margin or to the standard deviation,
# below which the limit counts as active.
_ACTIVE = 0.25
# Halvings in a search for a margin: it ends within 1e-9 of the largest margin considered.
_HALVINGS = 30


def _crossing(distance: FloatArray, deviation: FloatArray, correlation: FloatArray) -> float:
    """Return the probability that a flight starts beyond a limit or crosses it later.

    `distance` is the flights' mean distance from the limit at n times, negative beyond the limit.
    `deviation` is its standard deviation, `correlation` that between successive times.
    """
    # Over the flights, the distance is normally distributed.
    beyond = distance / np.maximum(deviation, _ROUNDING)
    # If the mean approaches the limit during a step, more flights are beyond it after the step.
    outside = ndtr(-beyond)
    carried = np.maximum(np.diff(outside), 0.0)
    # Rice's rate of crossings about a constant mean, from the correlation over a step.
    rate = np.sqrt(np.maximum(2 * (1 - correlation), 0.0)) / (2 * pi)
    crossings = rate * np.exp(-(np.maximum(beyond[1:], 0.0) ** 2) / 2)
    return float(min(outside[0] + carried.sum() + crossings.sum(), 1.0))


def limit_distances(
    spread: Spread, states: FloatArray, controls: FloatArray
) -> Iterator[LimitDistance]:
    """Yield the distance statistics of flights for each bound on a path constraint.

    Only finite bounds that a field of the scenario sets are included. `states` and `controls` are
    the plan at the n times of the spread, one row each.
    """
    dynamics = spread.dynamics
    gradients = _gradients(spread)
    seen = dynamics.limits_of(dynamics.solved(spread.t, spread.states, spread.controls))
    planned = dynamics.limits_of(dynamics.solved(spread.t, states, controls))
    for mean, plan in zip(seen, planned, strict=True):
        fields = FIELDS.get(mean.name.partition("[")[0], ("", ""))
        for side, name in zip((1.0, -1.0), fields, strict=True):
            bound = mean.upper if side > 0 else mean.lower
            if not name or not np.isfinite(bound).all():
                continue
            slope = gradients[mean.name]
            variance = np.einsum("ki,kij,kj->k", slope, spread.covariance, slope)
            deviation = np.sqrt(np.maximum(variance, 0.0))
            shared = np.einsum("ki,kij,kj->k", slope[:-1], spread.onward, slope[1:])
            scale = np.maximum(deviation[:-1] * deviation[1:], _ROUNDING**2)
            yield LimitDistance(
                name=mean.name,
                field=name,
                distance=side * (bound - mean.values),
                planned=side * (bound - plan.values),
                deviation=deviation,
                correlation=np.clip(shared / scale, -1.0, 1.0),
            )


def _gradients(spread: Spread) -> dict[str, FloatArray]:
    """Return the derivatives of all path constraints with respect to the states, by constraint.

    They are central differences along the flight without gusts, interpolated to the n times of
    `spread`. Each array has the shape (n, n_states). `spread` is the distribution of the flights.
    """
    dynamics, n_states = spread.dynamics, spread.states.shape[1]
    last = len(spread.t) - 1
    chosen = np.unique([*range(0, last, _GRADIENT_STEPS), last])
    t, states, controls = spread.t[chosen], spread.states[chosen], spread.controls[chosen]
    deviations = np.sqrt(np.maximum(np.diagonal(spread.covariance, axis1=1, axis2=2), 0.0))
    deviations = deviations[chosen]
    found: dict[str, FloatArray] = {}
    for state in range(n_states):
        # While the standard deviation of a state is still small, the step follows its maximum.
        step = np.maximum(deviations[:, state], 1e-3 * deviations[:, state].max())
        if not step.any():
            continue
        ends = []
        for side in (1.0, -1.0):
            moved = states.copy()
            moved[:, state] += side * step
            ends.append(dynamics.limits_of(dynamics.solved(t, moved, controls)))
        for more, less in zip(*ends, strict=True):
            slope = found.setdefault(more.name, np.zeros((len(spread.t), n_states)))
            by_state = (more.values - less.values) / (2 * step)
            slope[:, state] = np.interp(spread.t, t, by_state)
    return found


@dataclass(frozen=True, kw_only=True, eq=False)
class Miss:
    """Random samples of flights in turbulence, for one distance or speed that the mission limits.

    Attributes
    ----------
    words : str
        The limit in words, such as "distance from waypoint 1".
    field : str
        Scenario field that is tightened so that fewer flights break the limit; empty if none can
        be.
    off : ndarray, shape (n_instants, n_samples)
        Distance [m] or speed [m/s] of each sample, at each instant at which the limit applies.
    within : float
        Largest distance [m] or speed [m/s] allowed.
    """

    words: str
    # It is empty at the goal, which every plan reaches exactly. Only a larger reserve of thrust for
    # the controller helps there.
    field: str
    off: FloatArray
    within: float

    @property
    def probability(self) -> float:
        """Upper bound on the probability that a flight breaks the limit at one of the instants.

        The bound is the sum of the probabilities at the instants, at most 1.
        """
        return float(min((self.off > self.within).mean(axis=1).sum(), 1.0))

    def shrunk(self, share: float) -> "Miss":
        """Return a copy in which all samples of distance or speed are multiplied by `share`.

        If `share` is below 1, these are the distances or speeds in weaker turbulence.
        """
        return replace(self, off=share * self.off)

    def excess(self, share: float) -> float:
        """Return by how much the distances [m] or speeds [m/s] must decrease to keep the limit.

        The limit counts as kept if the probability that a flight breaks it is at most `share`. The
        result is zero if the limit is kept already.
        """
        most = np.quantile(self.off, 1.0 - share / len(self.off), axis=1).max()
        return max(float(most) - self.within, 0.0)


def missing(scenario: Scenario, spread: Spread) -> tuple[Miss, ...]:
    """Return random samples of flights: distances from goal and waypoints, and speeds there.

    Each limited distance or speed has one entry. Waypoints without a given time are left out. Equal
    input gives equal samples, because the random numbers have a fixed seed.
    """
    draws = np.random.default_rng(0).standard_normal((_SAMPLES, 3))
    mission, still = scenario.mission, np.zeros(3)
    end = np.array([mission.fixed_duration])

    def seen(names: tuple[str, ...], times: FloatArray, place: FloatArray) -> FloatArray:
        columns, rows = _columns(spread.dynamics, names), []
        for k in np.abs(spread.t - times[:, None]).argmin(axis=1).tolist():
            values, vectors = np.linalg.eigh(spread.of(*names)[k])
            factor = vectors * np.sqrt(np.maximum(values, 0.0))
            off = spread.states[k, columns] - place + draws @ factor.T
            rows.append(np.linalg.norm(off, axis=1))
        return np.array(rows)

    goal = np.array(mission.goal.position)
    there, at_rest = seen(POSITION_STATES, end, goal), seen(VELOCITY_STATES, end, still)
    found = [
        Miss(words=THERE, field="", off=there, within=ARRIVAL_DISTANCE_M),
        Miss(words=AT_REST, field="", off=at_rest, within=ARRIVAL_SPEED_M_PER_S),
    ]
    for k, waypoint in enumerate(mission.waypoints):
        if waypoint.at is None:
            continue
        times = np.arange(waypoint.at, waypoint.at + waypoint.hold + 1e-9, _HOLD_STEP)
        near = max(waypoint.radius, HOVERING_M if waypoint.hold else 0.0)
        words = "hover waypoint" if waypoint.hold else "waypoint"
        by_radius = RADIUS if waypoint.radius else ""
        found.append(
            Miss(
                words=f"distance from {words} {k + 1}",
                field=HOLD if waypoint.hold else by_radius,
                off=seen(POSITION_STATES, times, np.array(waypoint.position)),
                within=near + ARRIVAL_DISTANCE_M,
            )
        )
        fast = waypoint.speed_max
        if waypoint.hold:
            fast = min(fast or HOVERING_M_PER_S, HOVERING_M_PER_S)
        if fast is not None:
            found.append(
                Miss(
                    words=f"speed at {words} {k + 1}",
                    field=HOLD if waypoint.hold else SPEED,
                    off=seen(VELOCITY_STATES, times, still),
                    within=fast + ARRIVAL_SPEED_M_PER_S,
                )
            )
    return tuple(found)


def _columns(dynamics: Dynamics, names: tuple[str, ...]) -> list[int]:
    return [dynamics.state_names.index(name) for name in names]
