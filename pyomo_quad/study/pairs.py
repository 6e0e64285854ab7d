"""Lower bound on the energy of flights whose power or drag depends on the airspeed.

A pair is a combination of thrust and airspeed. A price is the Lagrange multiplier of a condition
that every flight from rest to rest meets. A leg is the flight from one waypoint to the next; the
mass may differ between legs. Derivation: see docs/theory/bound.md, eqs. (14) to (23).

symbol | meaning
u, v, W | thrust, airspeed and wind, world axes
U | middle of the range of all winds that occur, axis by axis; W itself if the wind is steady
f(v) | force of the air, against the airspeed
s | thrust that holds the mass still at zero airspeed, as a rule its weight
P | power of the vehicle, a function of u and v
m | mass of the vehicle
p, w, eta | prices of momentum [W/N], of displacement, and of kinetic energy
T, a, r | size of the thrust, airspeed along it and across it

In a steady wind, three means over the duration are fixed:

- the mean of u + f - s is zero, because the momentum is equal at both ends;
- the mean of v . (u + f - s) is zero, because the kinetic energy is equal at both ends;
- the mean of v + W is the displacement divided by the duration.

Therefore

energy >= w . displacement + duration * (least H over all pairs u, v),
H = P - p . (u + f - s) - w . (v + W) - eta v . (u + f - s).

In a wind field, the kinetic energy is that of the motion relative to air of the velocity U, p in H
is replaced by p + eta (W - U), and the least H is taken over all winds too.

The prices are chosen such that m p and m eta are equal on all legs. Only then do the unknown
velocities at the waypoints cancel in the sum over the legs.

H is minimised over T, a and r: of all orientations of a pair in space, the best one is known in
closed form. As a coordinate, T is replaced by the rotor speed. With the power model `momentum`, T
is replaced by the induced velocity, from which rotor speed and thrust follow.

The least H is bounded from below by branch and bound over boxes, which are ranges of the three
coordinates. A box is excluded if its lower bound on H is at least the least H found so far minus a
tolerance. Other boxes are halved.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import inf, sqrt
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.optimize import brentq, linprog

from pyomo_quad.collocation import Dynamics, Enclosure, symbols
from pyomo_quad.flight.flight import VELOCITY_STATES
from pyomo_quad.scenario import PowerModel, Scenario

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from pyomo_quad.arrays import FloatArray
    from pyomo_quad.study.legs import Leg

# A CasADi expression or a number.
Symbol = Any

_INDUCED = "power.induced_velocity"
_BALANCE = "power.induced_velocity_balance"
_PROFILE = "power.profile_power"
_UNCREDITED = "power.uncredited_power"
_ROTOR_SPEED = "rotors.omega["
# Upper limit of searches for an airspeed [m/s] or a rotor speed [rad/s], above any vehicle's.
_FASTER = 1e4
# `Pairs.cheapest`: samples along each of the three numbers, number of local minima that are
# refined, and refinements of each, which halve the spacing (25 / 2^9: to 1e-4 of a range).
_SAMPLES = 25
_CANDIDATES = 8
_ZOOMS = 9
# `Pairs.samples`: samples along each of the three numbers, and thrust relative to hover.
_COARSE = (30, 33, 17)
_USUAL_THRUST = (0.3, 1.8)
# `Pairs.least`: boxes along each of the three numbers before the first halving, and number of boxes
# at which the search ends with its present bound.
_FIRST_BOXES = 8
_MOST_BOXES = 500_000
# Number of sets of prices that `Pairs.least_through_air` treats together: the arrays of more sets
# do not fit into a processor's cache.
_AT_ONCE = 4
# `bound_of_pairs`: limit on linear programs, and number of headings with which each pair enters.
_ROUNDS = 60
_HEADINGS = 8
# Multiple of the tolerance by which a sampled bound is lowered before it is compared, because the
# proof lowers it by the tolerance and by the error of the samples.
_SURE = 1.5
# Largest price in the linear program, relative to hover: optimal prices are much smaller.
_DEAREST = 6.0
#: Tolerance of the proven least power, relative to the power of hover.
POWER_TOLERANCE = 1e-3


@dataclass(frozen=True, kw_only=True)
class MotionPrices:
    """Prices (Lagrange multipliers) of momentum, displacement and kinetic energy on one leg.

    The mission fixes the total change of these quantities over a flight. Any prices give a lower
    bound on the energy.

    Attributes
    ----------
    momentum : ndarray, shape (3,)
        Along the world axes, W/N (J per N s).
    displacement : ndarray, shape (3,)
        Along the world axes, N (J per m).
    motion : float
        Price of kinetic energy, dimensionless.
    """

    momentum: FloatArray
    displacement: FloatArray
    motion: float


class Pairs:
    """All combinations (pairs) of thrust and airspeed of a vehicle, with the power that they take.

    The coordinates of a pair are rotor speed, airspeed along the thrust and airspeed across the
    thrust. With the power model `momentum`, the induced velocity replaces the rotor speed. The
    module docstring defines H. Some methods use H without `_constant`, its terms that are equal for
    all pairs. Their argument `numbers` has the four numbers that the method `numbers` computes from
    prices.

    The limits of `scenario` on rotor speed and vehicle speed, and the thrust `most_thrust` [N] of
    all rotors, bound the pairs. `winds` [m/s], shape (n_winds, 3), are the corners of a polyhedron
    of all winds of the mission. `dynamics` has the compiled equations of the vehicle. By default,
    the wind is the steady wind in these equations. If `winds` is given, compile `dynamics` for
    still air.

    Attributes
    ----------
    standing : ndarray, shape (3,)
        Thrust that holds the vehicle still at zero airspeed, N.
    fastest : float
        Upper limit on the airspeed, m/s. If it is infinite, no bound exists, and no search may be
        called.
    """

    def __init__(
        self,
        scenario: Scenario,
        dynamics: Dynamics,
        standing: FloatArray,
        most_thrust: float,
        winds: FloatArray | None = None,
    ) -> None:
        self._dynamics, self.standing, self._most_thrust = dynamics, standing, most_thrust
        self._rotors = [n for n in dynamics.state_names if n.startswith(_ROTOR_SPEED)]
        # The wind in which the equations are read; they depend on the airspeed alone.
        self._read_in = wind_of(dynamics, np.array([dynamics.start]))[0]
        self._winds = self._read_in[None, :] if winds is None else winds
        self._middle = (self._winds.min(axis=0) + self._winds.max(axis=0)) / 2
        self._has_induced = scenario.power.model is PowerModel.MOMENTUM
        first, along, across = variables = symbols("first", "along", "across")
        numbers = symbols("momentum", "with_momentum", "aside", "motion", "alike")
        momentum, with_momentum, aside, motion, alike = numbers
        speed, thrust, power, excess, margin = self._of_rotors(first, along, across)
        forward, upward = self._forces(along, across)
        drag = -(forward * across + upward * along)
        # Force and airspeed are coplanar: the sum of singular values is the length of a vector.
        level = momentum * forward + with_momentum * across - aside * along
        rising = momentum * (thrust + upward) + with_momentum * along + aside * across
        spent = power - (1 - alike) * excess
        worth = spent + motion * (drag - thrust * along) - (level**2 + rising**2) ** 0.5
        expressions = [worth, thrust, speed, margin, forward, upward, spent, excess]
        self._enclosure = Enclosure(expressions, variables, numbers)
        self._slowest = scenario.limits.rotor_speed_min
        self.fastest = self._fastest(scenario)
        self._corner = self._most_of_first()

    def _values(
        self, along: Symbol, across: Symbol, speed: Symbol, induced: Symbol
    ) -> dict[str, Any]:
        x, y, z = self._read_in.tolist()
        moving = dict(zip(VELOCITY_STATES, (x + across, y, z + along), strict=True))
        return moving | {_INDUCED: induced} | dict.fromkeys(self._rotors, speed)

    def _read(self, keys: Sequence[tuple[str, Any]], *at: Symbol) -> list[Any]:
        return self._dynamics.expressions(tuple(keys), self._dynamics.start, self._values(*at))

    def _of_rotors(self, first: Symbol, along: Symbol, across: Symbol) -> tuple[Any, ...]:
        """Return rotor speed, thrust, power, `excess` and `margin` of a pair as CasADi expressions.

        The power [W] is that of equal rotor speeds. Unequal speeds of the same thrust can take less
        power only if `margin` is negative, and at most `excess` [W] less: docs/theory/bound.md, eq.
        (17).
        """
        each = range(1, len(self._rotors) + 1)
        powers: list[tuple[str, Any]] = [("power.total", None)]
        if self._dynamics.has(_UNCREDITED):
            powers = [(_UNCREDITED, j) for j in each]
        keys = [("rotors.total_thrust", None), *powers]
        if not self._has_induced:
            thrust, *power = self._read(keys, along, across, first, 0.0)
            return first, thrust, sum(power), 0.0 * first, 1.0 + 0.0 * first
        # The balance is linear in the thrust, and so in the square of the speed.
        per_square = -self._read([(_BALANCE, None)], 0.0, 0.0, 1.0, 0.0)[0]
        squared = self._read([(_BALANCE, None)], along, across, 0.0, first)[0] / per_square
        speed = squared**0.5
        thrust, *power = self._read(keys, along, across, speed, first)
        # Profile power: a cubic term of the speed and, in moving air, a linear term.
        cube = self._read([(_PROFILE, 1)], 0.0, 0.0, 1.0, 0.0)[0]
        multiple = self._read([(_PROFILE, 1)], along, across, 1.0, first)[0] - cube
        # Power at equal speeds less the convex envelope: the tangent through zero thrust.
        excess = len(each) * speed * (cube**0.5 * speed - multiple**0.5) ** 2
        # Only the sign of the margin is used. If it is positive, equal speeds take the least power,
        # and the excess has no meaning.
        return speed, thrust, sum(power), excess, cube * squared - multiple

    def _forces(self, along: Symbol, across: Symbol) -> tuple[Any, Any]:
        """Return the force of the air on the moving vehicle, across and along the thrust [N].

        The force is zero at zero airspeed.
        """
        keys = [("aerodynamics.force_x", None), ("aerodynamics.force_z", None)]
        moving = self._read(keys, along, across, 0.0, 0.0)
        still = self._read(keys, 0.0, 0.0, 0.0, 0.0)
        return moving[0] - still[0], moving[1] - still[1]

    def _at(self, points: FloatArray, numbers: Sequence[float] = (0.0,) * 4) -> FloatArray:
        """Return H and other quantities at n pairs, shape (8, n), in SI units.

        `points`, shape (3, n), has the coordinates. The rows are H without `_constant`, thrust,
        rotor speed, margin, air force across and along the thrust, power, excess. `_of_rotors`
        explains margin and excess.
        """
        # With the default `numbers`, H is the power.
        found = self._enclosure.at(points, (*numbers, 1.0))
        # H and power become lower bounds for rotors with unequal speeds, too.
        found[[0, 6]] -= np.where(found[3] >= 0.0, 0.0, found[7])
        return found

    def _fastest(self, scenario: Scenario) -> float:
        """Return an upper limit on the airspeed of every flight that begins at rest [m/s].

        It is infinite if neither the drag nor a limit bounds the speed: docs/theory/bound.md, eq.
        (22).
        """
        strongest = float(np.linalg.norm(self._winds, axis=1).max())
        allowed = inf if scenario.limits.speed_max is None else scenario.limits.speed_max
        # The speed relative to air of the velocity `_middle` starts at the size of `_middle`. It
        # falls where the drag exceeds all other forces.
        most = self._most_thrust + float(np.linalg.norm(self.standing))
        apart = float(np.linalg.norm(self._winds - self._middle, axis=1).max())

        def excess(speed: float) -> float:
            drag = -float(self._at(np.array([[1.0], [0.0], [speed - apart]]))[4, 0])
            return drag * sqrt(1.0 - (apart / speed) ** 2 if apart else 1.0) - most

        terminal = brentq(excess, apart, _FASTER) if excess(_FASTER) > 0.0 else inf
        return min(allowed + strongest, max(terminal, float(np.linalg.norm(self._middle))) + apart)

    def _most_of_first(self) -> float:
        """Return the largest value of a pair's first coordinate that the largest thrust permits.

        It is a rotor speed [rad/s], or an induced velocity [m/s] for the model `momentum`.
        """

        def excess(first: float) -> float:
            return float(self._at(np.array([[first], [0.0], [0.0]]))[1, 0]) - self._most_thrust

        still = float(brentq(excess, 0.0, _FASTER))
        # Air passes the disc at least at v_i minus the airspeed.
        return still + self.fastest if self._has_induced else still

    def numbers(self, prices: MotionPrices, mass: float) -> tuple[float, ...]:
        """Return the four numbers by which the prices enter the minimisation of H over the pairs.

        For prices p, w, eta and q = w - eta * mass * `standing`, they are length(p), the components
        of q along and across p, and eta: docs/theory/bound.md, eq. (16).
        """
        displacement = prices.displacement - prices.motion * mass * self.standing
        size = float(np.linalg.norm(prices.momentum))
        if size == 0.0:
            return 0.0, float(np.linalg.norm(displacement)), 0.0, prices.motion
        aside = float(np.linalg.norm(np.cross(prices.momentum, displacement)))
        return size, float(prices.momentum @ displacement) / size, aside / size, prices.motion

    def _in_wind(self, prices: MotionPrices, wind: FloatArray) -> MotionPrices:
        """Convert the prices on a leg into prices for the motion through the air in one wind.

        The price of momentum p becomes p + eta (W - U), where W is `wind`. The other prices remain
        the same: docs/theory/bound.md, eq. (20).
        """
        return replace(prices, momentum=prices.momentum + prices.motion * (wind - self._middle))

    def _constant(self, prices: MotionPrices, mass: float, wind: FloatArray) -> float:
        return float(prices.momentum @ self.standing * mass - prices.displacement @ wind)

    def cheapest(self, prices: MotionPrices, mass: float) -> tuple[float, list[FloatArray]]:
        """Return the least H that a search over samples finds [W], and rows for `_Program`.

        The search covers all winds; the true minimum may be lower. The rows belong to the pairs at
        the lowest local minima of H. `_Program` makes a constraint of each row. A row, shape (8,),
        has the power [W] of the pair. Then follow the derivatives of H by the prices of momentum
        [N], displacement [m/s] and kinetic energy [W]. `mass` is that on the leg, as a fraction of
        the mass at the start.
        """
        minima = []
        for wind in self._winds:
            own = self._in_wind(prices, wind)
            points, values = self._minima(own, mass)
            values = values + self._constant(own, mass, wind)
            minima += [(value, at, own, wind) for value, at in zip(values, points.T, strict=True)]
        minima.sort(key=lambda found: found[0])
        chosen = minima[:_CANDIDATES]
        rows = [row for _, at, own, wind in chosen for row in self._rows(at, own, mass, wind)]
        return float(minima[0][0]), rows

    def least_through_air(
        self, prices: Sequence[MotionPrices], above: FloatArray, tolerance: float
    ) -> FloatArray:
        """Return proven lower bounds on G, the least H over all pairs in still air, shape (n,) [W].

        The prices of momentum include the effect of the wind. `above` has upper bounds on G, such
        as the least H of sampled pairs; branch and bound starts from them. The results are at most
        `tolerance` [W] below G, unless the search ends after too many boxes. Implements
        docs/theory/bound.md, eq. (23).
        """
        constants = np.array([self._constant(p, 1.0, np.zeros(3)) for p in prices])
        numbers = np.array([self.numbers(p, 1.0) for p in prices]).T
        found = [
            self._proven(
                numbers[:, k : k + _AT_ONCE], (above - constants)[k : k + _AT_ONCE], tolerance
            )
            for k in range(0, len(prices), _AT_ONCE)
        ]
        return np.concatenate(found) + constants

    def samples(self) -> FloatArray:
        """Return thrust, force of the air, power and airspeed of many pairs, shape (6, n).

        The rows are thrust [N], force of the air along and across the thrust [N], power [W],
        airspeed along and across the thrust [m/s].
        """
        sides = self._edges()
        axes = [np.linspace(a, b, count) for (a, b), count in zip(sides, _COARSE, strict=True)]
        axes[0] *= axes[0] / axes[0][-1]
        points = np.stack(np.meshgrid(*axes, indexing="ij")).reshape(3, -1)
        _, thrust, _, _, across, along, power, _ = self._at(points)
        # Flights of little energy do not use thrusts far from that of hover.
        share = thrust / float(np.linalg.norm(self.standing))
        kept = (share > _USUAL_THRUST[0]) & (share < _USUAL_THRUST[1])
        found = np.stack([thrust, along, across, power, *points[1:]])
        return np.asarray(found[:, kept])

    def _minima(self, prices: MotionPrices, mass: float) -> tuple[FloatArray, FloatArray]:
        """Return pairs at the lowest local minima of H, found by sampling, and H at these pairs.

        At most `_CANDIDATES` pairs are returned. H [W] is without `_constant`. `prices` are those
        for the motion through the air in one wind, from `_in_wind`.
        """
        from scipy.ndimage import minimum_filter  # noqa: PLC0415  not for every certificate

        numbers = self.numbers(prices, mass)
        edges = self._edges()
        axes = [np.linspace(edge[0], edge[1], _SAMPLES) for edge in edges]
        # Minima lie at small values of the first number, where samples are denser.
        axes[0] *= axes[0] / axes[0][-1]
        points = np.stack(np.meshgrid(*axes, indexing="ij"))
        worth = self._worth(points.reshape(3, -1), numbers).reshape(points.shape[1:])
        is_least = (worth == minimum_filter(worth, size=3)) & np.isfinite(worth)
        here = points[:, is_least][:, np.argsort(worth[is_least])[:_CANDIDATES]]
        steps = np.stack(np.meshgrid(*[[-1.0, -0.5, 0.0, 0.5, 1.0]] * 3)).reshape(3, 1, -1)
        reach = np.ptp(edges, axis=1) / (_SAMPLES - 1)
        for _ in range(_ZOOMS):
            near = here[:, :, None] + reach[:, None, None] * steps
            near = np.clip(near, edges[:, 0, None, None], edges[:, 1, None, None])
            around = self._worth(near.reshape(3, -1), numbers).reshape(near.shape[1:])
            here = near[:, np.arange(here.shape[1]), np.argmin(around, axis=1)]
            reach = reach / 2
        return here, self._at(here, numbers)[0]

    def _edges(self) -> FloatArray:
        return np.array([[0.0, self._corner], [-self.fastest, self.fastest], [0.0, self.fastest]])

    def _worth(self, points: FloatArray, numbers: Sequence[float]) -> FloatArray:
        found = self._at(points, numbers)
        return np.where(found[1] <= self._most_thrust, found[0], inf)

    def _rows(
        self, at: FloatArray, prices: MotionPrices, mass: float, wind: FloatArray
    ) -> list[FloatArray]:
        """Return the rows of `cheapest` for the pair with the coordinates `at`.

        The pair has the orientation with the least H. If `standing` is vertical, seven rows follow,
        for the pair turned about the vertical in steps of 45 degrees. `prices` are those for
        `wind`, from `_in_wind`.
        """
        momentum, displacement = (
            prices.momentum,
            prices.displacement - prices.motion * mass * self.standing,
        )
        _, along, across = at
        _, thrust, _, _, forward, upward, power, _ = self._at(at[:, None])[:, 0]
        force, air = np.array([forward, 0.0, thrust + upward]), np.array([across, 0.0, along])
        left, _, right = np.linalg.svd(np.outer(force, momentum) + np.outer(air, displacement))
        best = (left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right).T
        pushed, through_air = best @ force - mass * self.standing, best @ air
        found = []
        for angle in 2 * np.pi * np.arange(_HEADINGS) / _HEADINGS:
            c, s = np.cos(angle), np.sin(angle)
            turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
            force, moved = turn @ pushed, turn @ through_air + wind
            motion = float((moved - self._middle) @ force)
            found.append(np.array([power, *-force, *-moved, -motion]))
        # Copies, rotated about the vertical, have the same H only if `standing` is vertical.
        return found[:1] if np.any(self.standing[:2]) else found

    def least(self, prices: MotionPrices, mass: float, tolerance: float) -> float:
        """Return a proven lower bound on H over all pairs and winds, by branch and bound [W].

        It is at most `tolerance` [W] below the least H, unless the search ends after too many
        boxes. `mass` is a fraction of the mass at the start.
        """
        sampled = self.cheapest(prices, mass)[0]
        # The least H over the pairs is concave in the wind, so its minimum over all winds is at a
        # corner of their polyhedron: docs/theory/bound.md, eq. (20).
        proven = sampled
        for wind in self._winds:
            own = self._in_wind(prices, wind)
            constant = self._constant(own, mass, wind)
            numbers = np.array(self.numbers(own, mass))[:, None]
            found = self._proven(numbers, np.array([sampled - constant]), tolerance)
            proven = min(proven, float(found[0]) + constant)
        return proven

    def _proven(self, numbers: FloatArray, sampled: FloatArray, tolerance: float) -> FloatArray:
        """Return a proven lower bound on H without `_constant` for each column of `numbers` [W].

        `numbers`, shape (4, n), has a column per set of prices. `sampled`, shape (n,), has upper
        bounds on this least H. Unless the search ends early, errors are at most `tolerance`.
        """
        cuts = [np.linspace(edge[0], edge[1], _FIRST_BOXES + 1) for edge in self._edges()]
        low = np.stack(np.meshgrid(*(c[:-1] for c in cuts), indexing="ij")).reshape(3, -1)
        high = np.stack(np.meshgrid(*(c[1:] for c in cuts), indexing="ij")).reshape(3, -1)
        count = numbers.shape[1]
        of = np.repeat(np.arange(count), low.shape[1])
        low, high, best = np.tile(low, count), np.tile(high, count), sampled.copy()
        looked_at = 0
        while low.size:
            looked_at += low.shape[1]
            kept, is_alike = self._not_excluded(low, high, numbers[:, of], (best - tolerance)[of])
            low, high, of = low[:, kept], high[:, kept], of[kept]
            if not low.size:
                break
            under, reached, split = self._box(low, high, numbers[:, of], is_alike)
            np.minimum.at(best, of, reached)
            is_open = under < (best - tolerance)[of]
            low, high, split, of = low[:, is_open], high[:, is_open], split[is_open], of[is_open]
            if looked_at > _MOST_BOXES * count:
                np.minimum.at(best, of, under[is_open])
                break
            low, high = _halved(low, high, split)
            of = np.tile(of, 2)
        return best - tolerance

    def _not_excluded(
        self, low: FloatArray, high: FloatArray, numbers: FloatArray, enough: FloatArray
    ) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Return which of n boxes may contain a permitted pair with H below `enough`.

        H is without `_constant`. `numbers` has a column, `enough` an item, per box. For each box
        not excluded, the second result says whether equal rotor speeds provably take the least
        power at all its pairs.
        """
        # Without the slopes that `_box` bounds, the enclosure is much faster.
        given = np.vstack([numbers, np.zeros(low.shape[1])])
        under, over = self._enclosure.values_over(low, high, given)
        nearest = np.minimum(np.abs(low[1]), np.abs(high[1])) * (low[1] * high[1] > 0.0)
        # Empty boxes have no pair that keeps the limits on thrust, rotor speed and airspeed.
        is_empty = (
            (under[1] > self._most_thrust)
            | (over[2] < self._slowest)
            | (np.hypot(nearest, low[2]) > self.fastest)
        )
        # A bound that is not a number excludes nothing.
        kept = ~is_empty & ~(under[0] >= enough)
        return kept, under[3, kept] >= 0.0

    def _box(
        self, low: FloatArray, high: FloatArray, numbers: FloatArray, is_alike: NDArray[np.bool_]
    ) -> tuple[FloatArray, FloatArray, NDArray[np.int_]]:
        """Return for n boxes a lower bound on H, H at a pair inside, and the coordinate to halve.

        `numbers` has a column per box; `is_alike` comes from `_not_excluded`. H is without
        `_constant`, and infinite at a pair beyond the largest thrust. Implements
        docs/theory/bound.md, eq. (18).
        """
        given = np.vstack([numbers, is_alike])
        (under, _), slopes = self._enclosure.over(low, high, given)
        # Centre of the mean value form: its best place if the slope changes sign (Baumann, 1988).
        falls, rises = slopes
        with np.errstate(invalid="ignore"):
            share = np.clip(-falls / (rises - falls), 0.0, 1.0)
            lost = np.where((falls < 0.0) & (rises > 0.0), share * rises * (high - low), 0.0)
        share = np.where(np.isnan(share), 0.5, share)
        centre = low + share * (high - low)
        reach = np.where(np.isfinite(falls) & np.isfinite(rises), lost, inf)
        middle, thrust, _, margin, *_, excess = self._enclosure.at(centre, given)
        proven = np.fmax(under[0], middle - np.sum(reach, axis=0))
        relative = (high - low) / np.array([[self._corner], [self.fastest], [self.fastest]])
        by_reach = np.where(np.all(np.isfinite(reach), axis=0), reach, relative)
        worth = middle + np.where(is_alike, 0.0, np.where(margin >= 0.0, excess, 0.0))
        reached = np.where(thrust <= self._most_thrust, worth, inf)
        return proven, reached, np.argmax(by_reach, axis=0)


def _halved(
    low: FloatArray, high: FloatArray, split: NDArray[np.int_]
) -> tuple[FloatArray, FloatArray]:
    columns = np.arange(split.size)
    middle = (low[split, columns] + high[split, columns]) / 2
    lower, upper = high.copy(), low.copy()
    lower[split, columns] = upper[split, columns] = middle
    return np.hstack([low, upper]), np.hstack([lower, high])


def wind_of(dynamics: Dynamics, times: FloatArray) -> FloatArray:
    """Return the wind at n given times in world axes [m/s], shape (n, 3).

    `times` has the n times [s]. If the wind varies with place, the result is that at the origin.
    Components that the model of the wind lacks are zero.
    """
    names = ("velocity_x", "velocity_y", "velocity_z")
    keys = tuple((f"wind.{n}", None) for n in names if dynamics.has(f"wind.{n}"))
    states = np.zeros((len(times), len(dynamics.state_names)))
    controls = np.zeros((len(times), len(dynamics.control_names)))
    found = np.zeros((len(times), 3))
    found[:, : len(keys)] = dynamics.table(keys, times, states, controls)
    return found


def bound_of_pairs(
    pairs: Pairs, legs: Sequence[Leg], shared: Sequence[tuple[float, float]], power: float
) -> float:
    """Return a lower bound on the energy of a flight in legs, for all allowed passing times [J].

    Implements docs/theory/bound.md, eq. (19). The tolerances of the search and of the proof are
    fixed fractions of `power`, the power of hover [W]. `shared` has the least and greatest total
    duration of each group of legs [s]; the attribute `group` of a leg is an index of it. `legs_of`
    gives `legs` and `shared`.
    """
    prices, program = prices_of_pairs(pairs, legs, shared, power)
    tolerance = POWER_TOLERANCE * power
    # The search for the prices uses samples; only their last values are proven over all pairs.
    proven = [pairs.least(p, leg.mass, tolerance) for p, leg in zip(prices, legs, strict=True)]
    return program.bound(prices, np.array(proven))


def prices_of_pairs(
    pairs: Pairs, legs: Sequence[Leg], shared: Sequence[tuple[float, float]], power: float
) -> tuple[list[MotionPrices], _Program]:
    """Search for the prices that give the largest lower bound on a flight's energy.

    Return the best prices on each leg, and the linear program, which computes the bound from proven
    values of H. The tolerance of the search is a fixed fraction of `power`, the power of hover [W].
    `shared` has the least and greatest total duration of each group of legs [s]; the attribute
    `group` of a leg is an index of it.
    """
    tolerance = POWER_TOLERANCE * power
    program = _Program(legs, shared, power, pairs.standing)
    best, centre = -inf, program.start
    tried = centre
    # Method of cutting planes (Kelley, 1960): in each round, the pairs of least H at the present
    # prices become constraints. The bound is approximate, because the least H is sampled.
    for _ in range(_ROUNDS):
        prices, least = program.prices(tried), []
        for k, leg in enumerate(legs):
            value, found = pairs.cheapest(prices[k], leg.mass)
            for pair in found:
                program.add(k, pair)
            least.append(value)
        # Lowered by the largest amount that the proof may subtract.
        bound = program.bound(prices, np.array(least) - _SURE * tolerance)
        if bound > best:
            best, centre = bound, tried
        solution, promised = program.solve()
        if promised - best <= 4 * POWER_TOLERANCE * abs(promised):
            break
        # Half way from the best prices, because the optimum of a program with few pairs lies far
        # away.
        tried = (centre + solution) / 2
    return program.prices(centre), program


class _Program:
    """Linear program for the prices that maximise the lower bound on a flight's energy.

    Each pair known so far gives one constraint: the least H of a leg is at most H at the pair.
    `shared` has the least and greatest total duration of each group of legs [s]. `power` is that of
    hover [W], and `standing` the thrust that holds the vehicle still at zero airspeed [N].
    """

    def __init__(
        self,
        legs: Sequence[Leg],
        shared: Sequence[tuple[float, float]],
        power: float,
        standing: FloatArray,
    ) -> None:
        self._legs, self._shared = legs, shared
        margin, weight = 2 * POWER_TOLERANCE * power, float(np.linalg.norm(standing))
        n = len(legs)
        # In hover, power grows with thrust to the power of 3/2, and the price of kinetic energy is
        # 1.
        self.start = np.zeros(4 + 7 * n + len(shared))
        self.start[:4] = *(1.5 * power / weight**2 * standing), 1.0
        scales = np.repeat([power / weight, 1.0, weight], [3, 1, 6 * n])
        self._dearest = _DEAREST * scales
        # Unknowns: prices of momentum and of kinetic energy for the whole mass; for each leg the
        # price of displacement, its absolute value along each axis, and H; for each group of
        # legs its duration times the least H of its legs.
        self._displacement, self._length, self._least = 4, 4 + 3 * n, 4 + 6 * n
        self._worth = 4 + 7 * n
        self.size = self._worth + len(shared)
        self._rows: list[FloatArray] = []
        self._limits: list[float] = []
        self._gain = np.zeros(self.size)
        for k, leg in enumerate(legs):
            self._gain[self._of(self._displacement, k)] = leg.displacement
            self._gain[self._of(self._length, k)] = -leg.slack
            for sign in (1.0, -1.0):
                for axis in range(3):
                    row = {
                        self._displacement + 3 * k + axis: sign,
                        self._length + 3 * k + axis: -1.0,
                    }
                    self._add(row, 0.0)
            for time in shared[leg.group]:
                held = 0.0 if len(set(shared[leg.group])) == 1 else margin
                row = {self._worth + leg.group: 1.0, self._least + k: -time}
                self._add(row, -held * time)
        self._gain[self._worth :] = 1.0

    def _of(self, first: int, k: int) -> slice:
        return slice(first + 3 * k, first + 3 * k + 3)

    def _add(self, row: dict[int, float], limit: float) -> None:
        line = np.zeros(self.size)
        line[list(row)] = list(row.values())
        self._rows.append(line)
        self._limits.append(limit)

    def add(self, k: int, pair: FloatArray) -> None:
        """Add a constraint: the least H of leg `k` is at most the value of H at a given pair.

        `pair` is an array from `Pairs.cheapest`.
        """
        mass, line = self._legs[k].mass, np.zeros(self.size)
        line[:3], line[self._of(self._displacement, k)] = -pair[1:4] / mass, -pair[4:7]
        line[3], line[self._least + k] = -pair[7] / mass, 1.0
        self._rows.append(line)
        self._limits.append(float(pair[0]))

    def solve(self) -> tuple[FloatArray, float]:
        """Solve the linear program; return its unknowns at the optimum, and the optimal value [J].

        The method `prices` converts the unknowns into prices.
        """
        # Pairs that are not known yet could only lower the optimal value. If the ends of the legs
        # have no slack, no prices within the limits can prove more, up to a tolerance.
        limits = np.full((self.size, 2), [-inf, inf])
        limits[: self._least] = np.stack([-self._dearest, self._dearest], axis=1)
        limits[3, 0] = 0.0
        found = linprog(
            -self._gain, A_ub=np.array(self._rows), b_ub=self._limits, bounds=limits, method="highs"
        )
        return found.x, -float(found.fun)

    def prices(self, solution: FloatArray) -> list[MotionPrices]:
        """Return the prices on each leg from the unknowns that `solve` returns."""
        return [
            MotionPrices(
                momentum=solution[:3] / leg.mass,
                displacement=solution[self._of(self._displacement, k)],
                motion=float(solution[3] / leg.mass),
            )
            for k, leg in enumerate(self._legs)
        ]

    def bound(self, prices: Sequence[MotionPrices], least: FloatArray) -> float:
        """Return the lower bound on the flight's energy [J] that given prices on the legs prove.

        `least` holds for each leg a lower bound on H [W]. Implements docs/theory/bound.md, eq.
        (19).
        """
        found = sum(
            float(p.displacement @ leg.displacement)
            - leg.slack * float(np.linalg.norm(p.displacement))
            for p, leg in zip(prices, self._legs, strict=True)
        )
        for group, times in enumerate(self._shared):
            of = [k for k, leg in enumerate(self._legs) if leg.group == group]
            cheapest = float(np.min(least[of]))
            found += min(time * cheapest for time in times)
        return found
