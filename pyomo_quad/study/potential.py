"""Lower bound on the energy of flights through a wind field, by a potential over the ground.

The bound uses the winds of each place; that of `study.pairs` assumes the most favourable wind
everywhere. The rise of a potential from start to goal, plus terms for height and duration, is a
lower bound on the energy of every flight, along any path. The mission fixes how much some
quantities, such as momentum, change between start and goal. The price of a quantity is the Lagrange
multiplier of its change. A pair is a combination of thrust and airspeed. Derivation: see
docs/theory/bound.md, eqs. (23) to (27).

symbol | meaning
u, v | thrust and airspeed of a pair
f, s | force of the air, and thrust that holds the vehicle still at zero airspeed
P | power of the vehicle, a function of u and v
phi(x, y) | potential: linear in each of two triangles of a cell of the field's grid [J]
q | gradient of the potential, and as third component the price of vertical displacement [N]
o, eta | prices of momentum in still air [W/N] and of kinetic energy; each is the same everywhere
W | wind
a | price of momentum [W/N] in the wind W: o + eta W
G(a, q) | least value of P - a . (u + f - s) - q . v - eta v . (u + f - s) over all pairs u, v
h | price of time [W], the constant in the condition on the potential

The condition on the potential: a gradient q is allowed in the wind W if

G(o + eta W, q) >= h + q . W.

G is a concave function of a and q together. Therefore

- linear interpolation between proven lower bounds on G gives lower bounds on G;
- the allowed gradients in a wind form a convex set, which an inscribed polygon represents;
- in each cell, limits on the two wind components form a rectangle of winds: a gradient that is
  allowed at its four corners is allowed in all winds of the cell.

The largest rise of a potential with allowed gradients is the optimal value of a linear program.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import inf
from typing import TYPE_CHECKING

import numpy as np
from scipy.optimize import linprog, minimize_scalar
from scipy.sparse import coo_array

from pyomo_quad.study.pairs import POWER_TOLERANCE, MotionPrices, Pairs, prices_of_pairs

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from pyomo_quad.arrays import FloatArray
    from pyomo_quad.model.wind_field import ColumnWinds
    from pyomo_quad.study.legs import Leg

# Directions of a gradient in a half turn from the price of momentum, both ends included.
_DIRECTIONS = 9
# Quantiles of the lengths of the price of momentum in the winds of the field at which G is proven,
# and number of lengths of a gradient in each direction at which it is proven.
_SIZES, _LENGTHS = (0.0, 0.25, 0.7, 0.97, 1.0), 4
# Number of lengths of a gradient in each direction at which G is sampled, and the longest length,
# relative to the power of hover [s/m].
_SAMPLED_LENGTHS, _LONGEST = 16, 0.4
# Ranges of winds for which prices are computed and tried in turn, relative to the range of the
# whole field: prices for the whole range would suit the few extreme winds.
_SPREADS = (0.2, 0.6)
# Steps of the search for the power of flights of fixed duration.
_POWERS = 8
# Length below which an edge of a polygon counts as rounding error, relative to the longest
# gradient; and factor on the allowed gradients, because their polygons have rounding errors.
_SLIVER, _SHRUNK = 1e-9, 1.0 - 1e-7


@dataclass(frozen=True, kw_only=True)
class PlacePrices:
    """Prices in the bound by a potential, each the same at all places of a wind field.

    They are multipliers of the changes that the mission fixes. The module docstring defines o, eta
    and h.

    Attributes
    ----------
    offset : ndarray, shape (3,)
        Price o of momentum where there is no wind [W/N].
    motion : float
        Price eta of kinetic energy.
    climb : float
        Price of vertical displacement [N].
    power : float
        Price h of time [W].
    """

    offset: FloatArray
    motion: float
    climb: float
    power: float = 0.0

    @classmethod
    def of(cls, prices: MotionPrices, middle: FloatArray) -> PlacePrices:
        """Convert the prices of `study.pairs` into prices for the bound by a potential.

        `prices` were found for a range of winds with the middle `middle`, shape (3,) [m/s]. The
        price of time in the result is zero.
        """
        return cls(
            # Here the kinetic energy is that of the motion over ground, not relative to air of the
            # velocity `middle`.
            offset=prices.momentum - prices.motion * middle,
            motion=prices.motion,
            # The gradient of the potential takes the place of the horizontal price.
            climb=float(prices.displacement[2]),
        )

    def table(
        self,
        least: Callable[[Sequence[MotionPrices]], FloatArray],
        sizes: FloatArray,
        lengths: FloatArray,
    ) -> GradientTable:
        """Tabulate the function G over horizontal prices of momentum and gradients of a potential.

        `least` takes n sets of prices and returns G, or lower bounds on it, shape (n,) [W]. `sizes`
        and `lengths` are those of `GradientTable`. The vertical price of momentum, and the prices
        of kinetic energy and vertical displacement, are those of this object.
        """
        angles = np.pi * np.arange(_DIRECTIONS) / (_DIRECTIONS - 1)
        aside = lengths[..., None] * np.stack([np.cos(angles), np.sin(angles)], axis=-1)[:, None]
        own = [
            MotionPrices(
                momentum=np.array([size, 0.0, self.offset[2]]),
                displacement=np.array([*gradient, self.climb]),
                motion=self.motion,
            )
            for size in sizes
            # The gradient zero is the same in all directions.
            for gradient in (np.zeros(2), *aside[:, 1:].reshape(-1, 2))
        ]
        found = least(own).reshape(len(sizes), -1)
        at_zero = np.repeat(found[:, None, :1], _DIRECTIONS, axis=1)
        others = found[:, 1:].reshape(len(sizes), _DIRECTIONS, -1)
        values = np.concatenate([at_zero, others], axis=2)
        return GradientTable(sizes=sizes, lengths=lengths, values=values)


@dataclass(frozen=True, kw_only=True)
class GradientTable:
    """Table of the function G over the lengths of price and gradient and the angle between them.

    The module docstring defines G. The price of momentum and the gradient are horizontal. There are
    `_DIRECTIONS` equally spaced angles from 0 to half a turn; others follow by symmetry.

    Attributes
    ----------
    sizes : ndarray, shape (n_sizes,)
        Lengths of the price [W/N], increasing.
    lengths : ndarray, shape (n_directions, n_lengths)
        Lengths of the gradient [N], increasing from zero.
    values : ndarray, shape (n_sizes, n_directions, n_lengths)
        G or lower bounds on G [W].
    """

    sizes: FloatArray
    lengths: FloatArray
    values: FloatArray

    def gradients(self, prices: PlacePrices, winds: FloatArray) -> FloatArray | None:
        """Return a polygon of allowed gradients of a potential for each of n winds.

        `winds` has the shape (n, 2) [m/s]. The result has the corners of the polygons [N],
        counter-clockwise, shape (n, n_corners, 2). It is None if the gradient zero is not allowed
        in one of the winds. Implements docs/theory/bound.md, eq. (26).
        """
        # The table does not depend on the price of time, so `prices.power` may differ from that of
        # its computation.
        momentum = prices.offset[:2] + prices.motion * winds
        size, turned = np.linalg.norm(momentum, axis=1), np.arctan2(*momentum.T[::-1])
        above = np.clip(np.searchsorted(self.sizes, size), 1, len(self.sizes) - 1)
        share = (size - self.sizes[above - 1]) / (self.sizes[above] - self.sizes[above - 1])
        share = share[:, None, None]
        between = (1 - share) * self.values[above - 1] + share * self.values[above]
        # The corners lie in the directions of the table, which cover half a turn from the price of
        # momentum, and in their mirror images.
        round_about = np.arange(2 * (_DIRECTIONS - 1))
        number = np.minimum(round_about, 2 * (_DIRECTIONS - 1) - round_about)
        angles = turned[:, None] + np.pi * round_about / (_DIRECTIONS - 1)
        ways = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
        lengths = self.lengths[number]
        tail = np.sum(ways * winds[:, None], axis=2)
        spare = between[:, number] - prices.power - lengths * tail[..., None]
        if np.any(spare[..., 0] <= 0.0):
            return None
        return _last_positive(lengths, spare)[..., None] * ways


def _last_positive(at: FloatArray, values: FloatArray) -> FloatArray:
    """Return the place where each of many concave functions falls to zero, by linear interpolation.

    `values`, shape (n, m, k), has the k samples of each function, `at`, shape (m, k), their places.
    The first sample is positive. If all are, the result is the last place.
    """
    last = np.sum(np.cumprod(values > 0.0, axis=-1), axis=-1, dtype=int) - 1
    after = np.minimum(last + 1, at.shape[1] - 1)
    before, beyond = (np.take_along_axis(values, k[..., None], -1)[..., 0] for k in (last, after))
    here, there = (np.take_along_axis(at[None], k[..., None], -1)[..., 0] for k in (last, after))
    fall = np.where(after > last, before - beyond, 1.0)
    return np.asarray(here + (there - here) * before / fall)


class Sampled:
    """Approximation of the function G by a least value over samples of pairs.

    The approximation is never below G, which is the least value over all pairs.

    Parameters
    ----------
    pairs : Pairs
        Pairs of thrust and airspeed of the vehicle, from which the samples are taken.
    """

    def __init__(self, pairs: Pairs) -> None:
        self._pairs, self._samples = pairs, pairs.samples()

    def __call__(self, prices: Sequence[MotionPrices]) -> FloatArray:
        """Return approximate values of the function G for n sets of prices, shape (n,) [W].

        `prices` holds n sets of Lagrange multipliers of momentum, displacement and kinetic energy.
        """
        thrust, lift, aside, power, along, across = self._samples
        drag = -(aside * across + lift * along)
        found = np.empty(len(prices))
        for k, own in enumerate(prices):
            size, level, rising, motion = self._pairs.numbers(own, 1.0)
            one = size * aside + level * across - rising * along
            other = size * (thrust + lift) + level * along + rising * across
            worth = power + motion * (drag - thrust * along) - np.sqrt(one**2 + other**2)
            found[k] = worth.min() + own.momentum @ self._pairs.standing
        return found


class Places:
    """Grid of places of a mission in a wind field, on which potentials are defined.

    A potential is given by its values at the nodes of the grid.

    Parameters
    ----------
    columns : ColumnWinds
        Limits of the winds over each cell of the field's grid.
    ends : ndarray, shape (2, 3)
        Start and goal of the mission [m].
    """

    def __init__(self, columns: ColumnWinds, ends: FloatArray) -> None:
        self._columns = columns
        #: Height of the goal above the start [m].
        self.climb = float(ends[1, 2] - ends[0, 2])
        low, high = columns.low[:, columns.is_open], columns.high[:, columns.is_open]
        #: Corners of the rectangle of winds in each cell that a flight may enter [m/s], shape
        #: (n_cells, 4, 2).
        self.corners = np.stack(
            [np.stack([x, y], axis=-1) for x in (low[0], high[0]) for y in (low[1], high[1])],
            axis=1,
        )
        self._count = len(columns.x) * len(columns.y)
        self._numbers = np.arange(self._count).reshape(len(columns.x), len(columns.y))
        self._gain = np.zeros(self._count)
        for sign, end in zip((-1.0, 1.0), ends, strict=True):
            for node, share in self._shares(end):
                self._gain[node] += sign * share

    def _shares(self, place: FloatArray) -> list[tuple[int, float]]:
        """Return the nodes of the triangle of the grid that contains a place, with their weights.

        The weights are barycentric. Only x and y of `place` [m] count.
        """
        cell, shares = [], []
        for axis, at in zip((self._columns.x, self._columns.y), place, strict=False):
            number = int(np.clip(np.searchsorted(axis, at) - 1, 0, len(axis) - 2))
            cell.append(number)
            shares.append(float((at - axis[number]) / (axis[number + 1] - axis[number])))
        (i, j), (u, v), node = cell, shares, self._numbers
        aside = [(int(node[i + 1, j]), u), (int(node[i, j + 1]), v)]
        if u + v <= 1.0:
            return [(int(node[i, j]), 1.0 - u - v), *aside]
        aside = [(int(node[i, j + 1]), 1.0 - u), (int(node[i + 1, j]), 1.0 - v)]
        return [(int(node[i + 1, j + 1]), u + v - 1.0), *aside]

    def rise(self, gradients: FloatArray) -> float:
        """Return the largest rise of a potential from start to goal [J]; 0 if the solver fails.

        `gradients`, shape (4 * n_cells, n, 2), are polygons of n vertices [N], one for each wind in
        the attribute `corners`. In each cell, the gradient lies inside the polygons of all four
        winds. Implements docs/theory/bound.md, eq. (27).
        """
        cell, normals, most = _common_edges(gradients.reshape(*self.corners.shape[:2], -1, 2))
        i, j = (part[cell] for part in np.nonzero(self._columns.is_open))
        node, entries, rows = self._numbers, [], np.arange(len(cell))
        steps = np.diff(self._columns.x)[i], np.diff(self._columns.y)[j]
        for upper in (0, 1):
            here = node[i + upper, j + upper]
            for axis, there in enumerate((node[i + 1 - upper, j + upper],
                                          node[i + upper, j + 1 - upper])):  # fmt: skip
                value = normals[:, axis] / steps[axis] * (-1.0 if upper else 1.0) / most
                entries += [(rows, there, value), (rows, here, -value)]
            rows = rows + len(cell)
        row, column, value = (np.concatenate(part) for part in zip(*entries, strict=True))
        matrix = coo_array((value, (row, column)), shape=(2 * len(cell), self._count)).tocsr()
        bounds = [(0.0, 0.0), *[(None, None)] * (self._count - 1)]
        found = linprog(
            -self._gain, A_ub=matrix, b_ub=np.ones(2 * len(cell)), bounds=bounds,
            method="highs-ipm",
        )  # fmt: skip
        if found.x is None:
            return 0.0
        # The solver may violate the constraints slightly; its potential is then too steep.
        return float(self._gain @ found.x / max(1.0, float(np.max(matrix @ found.x))))


def _common_edges(polygons: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the edges of the intersection of each cell's polygons: cell index, normal, and limit.

    A gradient q is inside if `normal . q <= limit` for all edges of its cell. `polygons` has the
    shape (n_cells, n_winds, n_corners, 2). Each polygon contains the origin.
    """
    import shapely  # noqa: PLC0415  for fields alone

    common = shapely.polygons(polygons[:, 0])
    for k in range(1, polygons.shape[1]):
        common = shapely.intersection(common, shapely.polygons(polygons[:, k]))
    places, cell = shapely.get_coordinates(common, return_index=True)
    steps = np.diff(places, axis=0)
    is_edge = (np.diff(cell) == 0) & (np.abs(steps).max(axis=1) > _SLIVER * np.abs(places).max())
    steps, first = steps[is_edge], places[:-1][is_edge]
    normals = np.stack([steps[:, 1], -steps[:, 0]], axis=1)
    most = np.sum(normals * first, axis=1)
    return cell[:-1][is_edge], normals * np.sign(most)[:, None], np.abs(most) * _SHRUNK


class _Search:
    """Calculator of lower bounds on the energy by a potential.

    A bound is approximate with sampled values of the function G, and proven with proven lower
    bounds on G.
    """

    def __init__(
        self, pairs: Pairs, places: Places, durations: tuple[float, float], power: float
    ) -> None:
        self._pairs, self._places, self._durations = pairs, places, durations
        self._tolerance = POWER_TOLERANCE * power
        self._winds = places.corners.reshape(-1, 2)
        self._sampled = Sampled(pairs)
        shares = np.linspace(0.0, 1.0, _SAMPLED_LENGTHS) ** 2
        self._lengths = np.tile(_LONGEST * power * shares, (_DIRECTIONS, 1))

    def _sizes(self, prices: PlacePrices) -> FloatArray:
        size = np.linalg.norm(prices.offset[:2] + prices.motion * self._winds, axis=1)
        # Lengths of the price of momentum: most winds lie far from the extreme winds, and linear
        # interpolation of G is least accurate between distant lengths.
        found = np.quantile(size, _SIZES)
        return found + self._tolerance * np.arange(len(found)) / len(found)

    def _bound(self, prices: PlacePrices, table: GradientTable) -> float:
        """Return a lower bound on the energy of every flight [J], from a table of the function G.

        The bound is proven if `table` has proven lower bounds on G. It is minus infinity if a wind
        forbids even the gradient zero.
        """
        gradients = table.gradients(prices, self._winds)
        if gradients is None:
            return -inf
        spent = min(time * prices.power for time in self._durations)
        return self._places.rise(gradients) + prices.climb * self._places.climb + spent

    def with_power(self, prices: PlacePrices) -> PlacePrices | None:
        """Return `prices` with the best price of time (`power`); the other prices are unchanged.

        The best price gives the largest approximate lower bound. If the greatest allowed duration
        exceeds twice the least, all prices are unchanged. If no price of time gives a bound, the
        result is None.
        """
        table = prices.table(self._sampled, self._sizes(prices), self._lengths)
        most = float(table.values[:, 0, 0].min())
        if most <= 0.0:
            return None
        # If the duration is free, the price of time stays zero.
        if self._durations[0] < self._durations[1] / 2:
            return prices
        # A larger price of time raises the term of the duration, but allows only smaller gradients
        # of the potential.
        found = minimize_scalar(
            lambda power: -max(self._bound(replace(prices, power=power), table), -1e12),
            bounds=(0.0, most),
            method="bounded",
            options={"maxiter": _POWERS},
        )
        return replace(prices, power=float(found.x))

    def proven(self, prices: PlacePrices) -> float:
        """Return a proven lower bound on the energy for given prices [J].

        The result is minus infinity if a wind of the field forbids even the gradient zero.
        """
        table = prices.table(self._sampled, self._sizes(prices), self._lengths)
        gradients = table.gradients(prices, self._winds)
        if gradients is None:
            return -inf
        # Proofs take long: sampled values of G tell near which gradients they are needed.
        length = np.linalg.norm(gradients, axis=2)
        mirrored = np.roll(length[:, ::-1], 1, axis=1)
        both = np.concatenate([length, mirrored])[:, :_DIRECTIONS]
        reached = np.quantile(both, np.linspace(0.0, 1.0, _LENGTHS), axis=0)
        reached += self._tolerance * np.arange(_LENGTHS)[:, None]
        lengths = np.vstack([np.zeros(_DIRECTIONS), reached]).T

        def least(own: Sequence[MotionPrices]) -> FloatArray:
            return self._pairs.least_through_air(own, self._sampled(own), self._tolerance)

        return self._bound(prices, prices.table(least, self._sizes(prices), lengths))


def bound_by_places(
    pairs_in: Callable[[FloatArray], Pairs],
    winds: FloatArray,
    places: Places,
    leg: Leg,
    durations: tuple[float, float],
    power: float,
) -> float:
    """Return a lower bound on the energy of flights [J], from the wind at each place of a field.

    `winds`, shape (n, 3) [m/s], are horizontal: the corners of a polygon that contains all winds.
    `pairs_in` takes such corners and returns the pairs of the vehicle in these winds. `leg` is the
    flight from start to goal, which the search for prices needs. `durations` has its least and
    greatest duration [s]. `power` is that of hover [W]. If no prices give a bound, the result is
    minus infinity. Implements docs/theory/bound.md, eq. (25).
    """
    search = _Search(pairs_in(winds), places, durations, power)
    mean = np.array([*places.corners.mean(axis=(0, 1)), 0.0])
    for spread in _SPREADS:
        near = mean + spread * (winds - mean)
        (found,), _ = prices_of_pairs(pairs_in(near), [leg], [durations], power)
        middle = (near.min(axis=0) + near.max(axis=0)) / 2
        prices = search.with_power(PlacePrices.of(found, middle))
        if prices is not None:
            return search.proven(prices)
    return -inf
