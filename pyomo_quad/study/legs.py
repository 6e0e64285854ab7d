"""The bound on a flight in legs: prices of thrust at its passages and of time, chosen together.

Derivation: see docs/theory/bound.md, eqs. (12) and (13).

symbol | meaning
d_k, T_k, m_k | way of leg k, its duration, and the mass that flies it
r_k | how far both its ends together may lie from where they are meant to be
s_k | thrust that holds the vehicle still on leg k: weight, and a steady wind's acceleration
y | price of momentum, J per N s: on each leg it runs in a straight line over time
P* | conjugate of the power: the largest of price times thrust less power

The thrust is u = m_k a + s_k, and power is at least p . u - P*(|p|) at any price p.  With
p = y / m_k the acceleration integrates by parts: what is left at the passages cancels, since the
velocity does not jump there and y does not either, and at rest there is none.  So every flight
spends at least

sum over k of  A_k / T_k + G_k T_k,   A_k = -(change of y) . d_k - r_k |change of y|,
G_k = mean over the leg of p . s_k - P*(|p|).

At a passage that limits the speed y may jump, for the price of that speed times the jump.

Where the T_k are free, and only their sum is known to lie between two durations, a price of time mu
makes that, for A_k >= 0 and mu < G_k, at least  sum of 2 sqrt(A_k (G_k - mu)) + mu (sum of T_k):
a closed form, so the bound holds at every passing time and duration at once, not at those tried.
Nothing is lost by it where the bound of fixed times is least: there both have the same slope in
every T_k.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import inf
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq, minimize

from pyomo_quad.model.mission import HOVERING_M, HOVERING_M_PER_S

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from pyomo_quad.scenario import Scenario

FloatArray = NDArray[np.float64]
_NODES = 48
_ITERATIONS = 200
# Lengths of price vectors are rounded by so much, N s/J upwards: a norm has no slope at nought.
_CORNER = 1e-6
# Fall of the price of momentum over the way from which the search may begin, J s / (kg m^2).
_STIFFNESSES = np.geomspace(1e-3, 1e2, 26)
_RESTARTS = 3
_ROUNDING = 1e-9
# J; where prices give no bound at all.
_NONE = 1e12


@dataclass(frozen=True, kw_only=True)
class Leg:
    """What is known of one leg of a flight, or of a hold.

    Attributes
    ----------
    way : ndarray, shape (3,)
        From where it is meant to begin to where it is meant to end, m.
    room : float
        How far its ends, together, may lie from there, m.
    mass : float
        Share of the mass at the start.
    party : int
        Legs of one party share a time: see `Itinerary`.
    end_speed : float
        Largest speed at its end, m/s; infinite where nothing limits it.
    """

    way: FloatArray
    room: float
    mass: float
    party: int
    end_speed: float = inf


def legs_of(scenario: Scenario) -> tuple[list[Leg], list[tuple[float, float]]]:
    """Return the legs and holds of a mission in the order given, and the times they share.

    Returns
    -------
    legs : list of Leg
    shared : list of tuple of float
        Least and greatest time of the legs of each party together, s.
    """
    mission, mass, hovering = scenario.mission, 1.0, HOVERING_M_PER_S
    ways = np.diff(np.array(mission.positions), axis=0)
    legs: list[Leg] = []
    shared: list[tuple[float, float]] = []
    parties = 1 + sum(waypoint.at is not None for waypoint in mission.waypoints)
    holds: list[float] = []
    begun = held = slack = 0.0
    for waypoint, way in zip(mission.waypoints, ways, strict=False):
        leg = Leg(way=way, room=slack + waypoint.radius, mass=mass, party=len(shared))
        slack = waypoint.radius
        if waypoint.speed_max is not None:
            leg = replace(leg, end_speed=waypoint.speed_max)
        legs.append(leg)
        if waypoint.at is not None:
            shared.append((waypoint.at - begun - held,) * 2)
            begun, held = waypoint.at, 0.0
        if waypoint.hold > 0.0:
            near = min(waypoint.radius, HOVERING_M)
            legs[-1] = replace(leg, room=leg.room - waypoint.radius + near, end_speed=hovering)
            held, slack = held + waypoint.hold, HOVERING_M
            still = replace(leg, way=0.0 * way, room=near + slack, end_speed=hovering)
            legs.append(replace(still, party=parties + len(holds)))
            holds.append(waypoint.hold)
        mass -= waypoint.release / scenario.vehicle.total_mass
    legs.append(Leg(way=ways[-1], room=slack, mass=mass, party=len(shared)))
    least, greatest = (time - begun - held for time in mission.duration_limits)
    shared.append((max(least, 0.0), greatest))
    return legs, shared + [(hold, hold) for hold in holds]


class Itinerary:
    """Legs in their order, and the times that parties of them share.

    Parameters
    ----------
    legs : sequence of Leg
        From start to goal.
    shared : sequence of tuple of float
        Least and greatest time of the legs of each party together, s.
    standing : ndarray, shape (3,)
        Thrust that holds the whole mass at the start still, N.
    mass : float
        That mass, kg.
    conjugate : callable
        Prices of thrust, shape (n,) -> the conjugate of the power and the thrust it is of.
    """

    def __init__(
        self,
        legs: Sequence[Leg],
        shared: Sequence[tuple[float, float]],
        standing: FloatArray,
        mass: float,
        conjugate: Callable[[FloatArray], tuple[FloatArray, FloatArray]],
    ) -> None:
        self._ways = np.array([leg.way for leg in legs])
        self._rooms = np.array([leg.room for leg in legs])
        self._masses = mass * np.array([leg.mass for leg in legs])
        self._standing = np.outer([leg.mass for leg in legs], standing)
        self._parties = np.array([leg.party for leg in legs])
        self._shared = shared
        self._conjugate = conjugate
        nodes, widths = np.polynomial.legendre.leggauss(_NODES)
        self._shares, self._widths = (nodes + 1) / 2, widths / 2
        jumps = [k for k, leg in enumerate(legs[:-1]) if leg.end_speed < inf]
        before = np.cumsum([0, *[1 + (k in jumps) for k in range(len(legs) - 1)]])
        self._first, self._last = before, before + 1
        self._jumps = np.array(jumps, dtype=int)
        self._jump_price = np.array([legs[k].end_speed for k in jumps])
        self._size = int(self._last[-1]) + 1

    def _terms(self, prices: FloatArray) -> tuple[FloatArray, FloatArray, float, FloatArray]:
        """Return A_k, G_k, the price of all jumps, and the slopes of the three by the prices.

        The slopes have shape (2 n_legs + 1, n_prices, 3).
        """
        n = len(self._ways)
        legs = np.arange(n)
        first, last = prices[self._first], prices[self._last]
        length, direction = _length(last - first)
        gained = -np.sum((last - first) * self._ways, axis=1) - self._rooms * length
        slopes = np.zeros((2 * n + 1, self._size, 3))
        along = self._ways + self._rooms[:, None] * direction
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
        jump, way = _length(prices[there] - prices[here])
        slopes[-1, here] += self._jump_price[:, None] * way
        slopes[-1, there] -= self._jump_price[:, None] * way
        return gained, spent, -float(self._jump_price @ jump), slopes

    def bound(self, price: FloatArray) -> float:
        """Return a bound at every passing time and duration allowed.

        Parameters
        ----------
        price : ndarray, shape (3,)
            Price of thrust from which the search for the best begins, W/N.
        """
        places = np.zeros((self._size, 3))
        for first, last, way in zip(self._first, self._last, self._ways, strict=True):
            places[last : last + 2] = places[first] + way
        # Prices that fall along the way have A_k > 0 on every leg, as the search needs.
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
        """Return the bound of some prices, and its slope, with the sign turned."""
        gained, spent, jumped, slopes = self._terms(flat.reshape(-1, 3))
        bound, times = jumped, np.zeros(len(gained))
        for of, limits in zip(self._by_party(), self._shared, strict=True):
            least, times[of] = _least_over_times(gained[of], spent[of], *limits)
            bound += least
        if not np.isfinite(bound):
            return _NONE, np.zeros(flat.size)
        with np.errstate(divide="ignore"):
            paces = np.where(times > 0.0, 1.0 / times, 0.0)
        weights = np.concatenate([paces, times, [1.0]])
        return -bound, -np.tensordot(weights, slopes, 1).ravel()

    def _by_party(self) -> list[NDArray[np.bool_]]:
        return [self._parties == k for k in range(len(self._shared))]


def _length(vectors: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return lengths of vectors, rounded upwards near nought, and their slopes."""
    length = np.sqrt(np.sum(vectors**2, axis=1) + _CORNER**2)
    return length, vectors / length[:, None]


def _least_over_times(
    gained: FloatArray, spent: FloatArray, least: float, greatest: float
) -> tuple[float, FloatArray]:
    """Return the least of sum of A_k / T_k + G_k T_k, over T_k > 0 of a sum within limits.

    Beside it the T_k; minus infinity where there is none.
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
