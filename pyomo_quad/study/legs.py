"""Lower bound on the energy of a flight through waypoints, by Lagrange duality.

A leg is the flight from one waypoint to the next. Waypoints with a given passing time divide the
legs into groups; the sum of the durations of a group's legs is fixed or limited. A passage is the
instant at a waypoint. A price is the Lagrange multiplier of a condition that every flight of the
mission meets. The price of momentum belongs to the momentum balance, the price of time to the limit
on the duration.
Derivation: see docs/theory/bound.md, eqs. (12) and (13).

symbol | meaning
d_k, T_k, m_k | displacement of leg k, its duration, and the mass on it
r_k | largest distance of the start of leg k from its nominal place, plus that of the end of leg k
s_k | thrust that holds the vehicle still on leg k, against weight and the force of a steady wind
p | price of thrust and momentum, W/N = J per N s
y | price of velocity, J per m/s: m_k times p, linear in time on each leg
P* | conjugate of the power: maximum over the thrust of (price of thrust * thrust - power)
A_k, G_k | terms of the bound, J s and W, defined below
mu | price of time, W

For given T_k, every flight takes at least the energy

sum over k of  A_k / T_k + G_k T_k,   A_k = -(change of y) . d_k - r_k length(change of y),
G_k = mean over the leg of p . s_k - P*(length(p)).

At a passage with a speed limit y may jump. A jump lowers the bound by the speed limit times the
length of the jump.

In a group of legs, only the sum of the T_k is given or limited. Let mu be any number below all G_k
of the group; it may be negative. If all A_k >= 0, the legs take at least the energy

sum over k of  2 sqrt(A_k (G_k - mu)) + mu T_k.

This bound depends on the T_k only through their sum. If the sum is limited, its allowed value with
the least bound counts. The two bounds are equal at T_k = sqrt(A_k / (G_k - mu)).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import inf
from typing import TYPE_CHECKING

import numpy as np
from scipy.optimize import brentq, minimize

from pyomo_quad.model.mission import HOVERING_M, HOVERING_M_PER_S

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from pyomo_quad.arrays import FloatArray
    from pyomo_quad.scenario import Scenario

_NODES = 48  # of the Gauss quadrature over a leg: the conjugate is piecewise linear
_ITERATIONS = 200  # of L-BFGS in each search
# Smoothing of the length of a change of price, which is not differentiable at zero, J per m/s.
_CORNER = 1e-6
# Starts of the search: decrease of the price of velocity per distance flown, J s/m^2.
_STIFFNESSES = np.geomspace(1e-3, 1e2, 26)
_RESTARTS = 3  # a restarted L-BFGS discards the curvature that it has estimated across kinks
_ROUNDING = 1e-9  # relative
# Value of the minimised function where the prices give no bound, J: above any energy.
_NONE = 1e12


@dataclass(frozen=True, kw_only=True)
class Leg:
    """One leg of a flight, from waypoint to waypoint, or a hover at a waypoint.

    Attributes
    ----------
    displacement : ndarray, shape (3,)
        From the nominal start to the nominal end, m.
    slack : float
        Sum of the allowed distances of both ends from their nominal places, m.
    mass : float
        Mass on the leg, as a fraction of the mass at the start of the flight.
    group : int
        Index of the group of legs whose total duration is fixed or limited.
    end_speed : float
        Largest speed at the end, m/s.
    """

    displacement: FloatArray
    slack: float
    mass: float
    group: int
    end_speed: float = inf


def legs_of(scenario: Scenario) -> tuple[list[Leg], list[tuple[float, float]]]:
    """Return the legs of a mission, and the least and greatest duration of each group of legs [s].

    Waypoints with a given passing time divide the legs into groups. Each hover is a leg and a group
    of its own. The waypoints keep the order of the scenario, even if the planner may choose it.
    """
    mission, mass, hovering = scenario.mission, 1.0, HOVERING_M_PER_S
    displacements = np.diff(np.array(mission.positions), axis=0)
    legs: list[Leg] = []
    shared: list[tuple[float, float]] = []
    groups = 1 + sum(waypoint.at is not None for waypoint in mission.waypoints)
    holds: list[float] = []
    begun = held = slack = 0.0
    for waypoint, displacement in zip(mission.waypoints, displacements, strict=False):
        leg = Leg(
            displacement=displacement, slack=slack + waypoint.radius, mass=mass, group=len(shared)
        )
        slack = waypoint.radius
        if waypoint.speed_max is not None:
            leg = replace(leg, end_speed=waypoint.speed_max)
        legs.append(leg)
        if waypoint.at is not None:
            shared.append((waypoint.at - begun - held,) * 2)
            begun, held = waypoint.at, 0.0
        if waypoint.hold > 0.0:
            near = min(waypoint.radius, HOVERING_M)
            legs[-1] = replace(leg, slack=leg.slack - waypoint.radius + near, end_speed=hovering)
            held, slack = held + waypoint.hold, HOVERING_M
            still = replace(
                leg, displacement=0.0 * displacement, slack=near + slack, end_speed=hovering
            )
            legs.append(replace(still, group=groups + len(holds)))
            holds.append(waypoint.hold)
        mass -= waypoint.release / scenario.vehicle.total_mass
    legs.append(Leg(displacement=displacements[-1], slack=slack, mass=mass, group=len(shared)))
    least, greatest = (time - begun - held for time in mission.duration_limits)
    shared.append((max(least, 0.0), greatest))
    return legs, shared + [(hold, hold) for hold in holds]


class Itinerary:
    """Lower bound on the energy of a flight in legs, over all allowed durations of the legs.

    Parameters
    ----------
    legs, shared : sequence
        Legs, and for each group of legs the least and greatest total duration [s], from `legs_of`.
    standing : ndarray, shape (3,)
        Thrust that holds the vehicle still at the start, N.
    mass : float
        Mass at the start, kg.
    conjugate : callable
        Takes prices of thrust, W/N; returns the maxima of price * thrust - power, W, and the
        thrusts there, N.
    """

    def __init__(
        self,
        legs: Sequence[Leg],
        shared: Sequence[tuple[float, float]],
        standing: FloatArray,
        mass: float,
        conjugate: Callable[[FloatArray], tuple[FloatArray, FloatArray]],
    ) -> None:
        self._displacements = np.array([leg.displacement for leg in legs])
        self._slacks = np.array([leg.slack for leg in legs])
        self._masses = mass * np.array([leg.mass for leg in legs])
        self._standing = np.outer([leg.mass for leg in legs], standing)
        self._groups = np.array([leg.group for leg in legs])
        self._shared = shared
        self._conjugate = conjugate
        nodes, widths = np.polynomial.legendre.leggauss(_NODES)
        self._shares, self._widths = (nodes + 1) / 2, widths / 2
        # A waypoint that limits the speed has two prices of velocity, before and after it. Every
        # other waypoint has one.
        jumps = [k for k, leg in enumerate(legs[:-1]) if leg.end_speed < inf]
        before = np.cumsum([0, *[1 + (k in jumps) for k in range(len(legs) - 1)]])
        self._first, self._last = before, before + 1
        self._jumps = np.array(jumps, dtype=int)
        self._jump_price = np.array([legs[k].end_speed for k in jumps])
        self._size = int(self._last[-1]) + 1

    def _terms(self, prices: FloatArray) -> tuple[FloatArray, FloatArray, float, FloatArray]:
        """Return A_k [J s] and G_k [W] of all legs, the term of the jumps [J], and their gradients.

        `prices`, shape (n_prices, 3), are the prices y of velocity at start, waypoints and goal. A
        waypoint with a speed limit has two. The gradients have the shape (2 n_legs + 1, n_prices,
        3).
        """
        n = len(self._displacements)
        legs = np.arange(n)
        first, last = prices[self._first], prices[self._last]
        length, direction = _length(last - first)
        gained = -np.sum((last - first) * self._displacements, axis=1) - self._slacks * length
        slopes = np.zeros((2 * n + 1, self._size, 3))
        along = self._displacements + self._slacks[:, None] * direction
        slopes[legs, self._first] += along
        slopes[legs, self._last] -= along
        share = self._shares[None, :, None]
        price = (first[:, None] + share * (last - first)[:, None]) / self._masses[:, None, None]
        size = np.linalg.norm(price, axis=2)
        value, thrust = self._conjugate(size.ravel())
        unit = price / np.maximum(size, np.finfo(float).tiny)[:, :, None]
        missing = self._standing[:, None] - thrust.reshape(size.shape)[:, :, None] * unit
        held = np.sum(price * self._standing[:, None], axis=2)
        spent = (held - value.reshape(size.shape)) @ self._widths
        missing *= self._widths[None, :, None] / self._masses[:, None, None]
        slopes[n + legs, self._first] += np.sum((1 - share) * missing, axis=1)
        slopes[n + legs, self._last] += np.sum(share * missing, axis=1)
        here, there = self._last[self._jumps], self._first[self._jumps + 1]
        jump, towards = _length(prices[there] - prices[here])
        slopes[-1, here] += self._jump_price[:, None] * towards
        slopes[-1, there] -= self._jump_price[:, None] * towards
        return gained, spent, -float(self._jump_price @ jump), slopes

    def bound(self, price: FloatArray) -> float:
        """Return a lower bound on the energy for all allowed passing times and durations [J].

        A search finds the prices y of velocity with the largest bound. It starts from y = m p - c x
        with the best of several factors c. Here m is the mass at the start, x the displacement from
        the start, and p the price of thrust `price`, shape (3,), W/N. If no prices give a bound,
        the result is -1e12 J.
        """
        places = np.zeros((self._size, 3))
        for first, last, displacement in zip(
            self._first, self._last, self._displacements, strict=True
        ):
            places[last : last + 2] = places[first] + displacement
        # Prices that fall along the displacement have A_k > 0 on every leg, so the bound is finite.
        starts = (price * self._masses[0] - stiffness * places for stiffness in _STIFFNESSES)
        found = min(starts, key=lambda start: self._negative(start.ravel())[0]).ravel()
        for _ in range(_RESTARTS):
            found = minimize(
                self._negative,
                found,
                jac=True,
                method="L-BFGS-B",
                options={"maxiter": _ITERATIONS, "maxcor": 30, "ftol": 1e-13},
            ).x
        return -self._negative(found)[0]

    def _negative(self, flat: FloatArray) -> tuple[float, FloatArray]:
        """Return minus the lower bound on the energy [J], and its gradient, for a minimiser.

        `flat` holds the prices of velocity [J per m/s]. If they give no bound, the result is 1e12
        J.
        """
        gained, spent, jumped, slopes = self._terms(flat.reshape(-1, 3))
        bound, times = jumped, np.zeros(len(gained))
        for of, limits in zip(self._by_group(), self._shared, strict=True):
            least, times[of] = _least_over_times(gained[of], spent[of], *limits)
            bound += least
        if not np.isfinite(bound):
            return _NONE, np.zeros(flat.size)
        with np.errstate(divide="ignore"):
            paces = np.where(times > 0.0, 1.0 / times, 0.0)
        weights = np.concatenate([paces, times, [1.0]])
        return -bound, -np.tensordot(weights, slopes, 1).ravel()

    def _by_group(self) -> list[NDArray[np.bool_]]:
        """Return, for each group of legs, a mask that selects the legs of the group.

        Each mask has the shape (n_legs,).
        """
        return [self._groups == k for k in range(len(self._shared))]


def _length(vectors: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the lengths of vectors, smoothed at zero, and their gradients.

    The smoothed length is slightly larger than the exact one.
    """
    length = np.sqrt(np.sum(vectors**2, axis=1) + _CORNER**2)
    return length, vectors / length[:, None]


def _least_over_times(
    gained: FloatArray, spent: FloatArray, least: float, greatest: float
) -> tuple[float, FloatArray]:
    """Return the least sum of A_k / T_k + G_k T_k over a group of legs [J], and the T_k [s].

    `gained` holds the A_k, `spent` the G_k. The sum of the T_k is between `least` and `greatest`
    [s]. If an A_k is negative, the minimum is minus infinity, except for one leg of fixed duration:
    docs/theory/bound.md, eq. (13).
    """
    if least == greatest and gained.size == 1:
        return float(gained[0] / least + spent[0] * least), np.array([least])
    if np.min(gained) < 0.0:
        return -inf, np.zeros(gained.size)
    dearest = float(np.min(spent))

    def times(price: float) -> FloatArray:
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(gained > 0.0, np.sqrt(gained / (spent - price)), 0.0)

    unhurried = float(np.sum(times(0.0))) if dearest > 0.0 else inf
    whole = float(np.clip(unhurried, least, greatest))
    price = 0.0
    if whole != unhurried:
        price = slow = dearest - float(gained[np.argmin(spent)]) / whole**2
        fast = dearest - (1 + _ROUNDING) * float(np.sum(np.sqrt(gained)) / whole) ** 2
        if np.sum(times(slow)) > whole > np.sum(times(fast)):
            price = float(brentq(lambda mu: np.sum(times(mu)) - whole, fast, slow))
        if least < greatest:
            price = max(price, 0.0) if whole == least else min(price, 0.0)
    saved = np.sqrt(gained * np.maximum(spent - price, 0.0))
    return float(2 * np.sum(saved) + price * whole), times(price)
