"""Smooth surfaces above and below terrain that is given on a grid.

Between the grid points the ground is bilinear. A `Surface` is a cubic spline nowhere below the
ground, or nowhere above it.

A surface above the ground begins as the cubic spline through the heights. Its B-spline coefficients
are raised until, in every cell, all Bernstein coefficients of (spline minus ground) are at least 0.
A surface below the ground is -1 times the surface above the heights multiplied by -1. Proof: see
docs/theory/homing.md.
"""

from dataclasses import dataclass
from functools import cached_property
from math import comb
from typing import Any, Self

import numpy as np
from numpy import intp
from numpy.typing import ArrayLike, NDArray

from pyomo_quad.arrays import FloatArray

# Height by which surfaces are moved away from the ground because of rounding errors [m].
_ROUNDING_M = 1e-6
_CUBIC = 3
_FEWEST_POINTS = 4
_THIRDS = np.linspace(0.0, 1.0, _CUBIC + 1)
# Bernstein coefficients of a cubic from its values at thirds of a cell.
_TO_BERNSTEIN = np.linalg.inv(
    [[comb(_CUBIC, k) * s**k * (1 - s) ** (_CUBIC - k) for k in range(_CUBIC + 1)] for s in _THIRDS]
)
# Shares of the missing height by which coefficients are raised, iteration by iteration. Raising a
# neighbour often supplies a part of the missing height, so that small steps raise less in total.
_SHARES = (*(0.3,) * 10, 1.0)


@dataclass(frozen=True, kw_only=True, eq=False)
class Surface:
    """Cubic spline surface above or below the terrain, from which height limits are measured.

    It is the not-a-knot spline through its heights at the grid points.

    Attributes
    ----------
    x, y : ndarray
        Grid points [m], at least four each.
    heights : ndarray, shape (len(x), len(y))
        Heights of the surface at the grid points [m].
    excess : float
        Upper bound on the vertical distance between surface and ground [m].
    """

    x: FloatArray
    y: FloatArray
    heights: FloatArray
    excess: float

    def at(self, places: ArrayLike) -> FloatArray:
        """Return the height of the surface at places x, y [m].

        The coordinate z is ignored. Outside the grid, the result is the height at the nearest place
        on its border.
        """
        from scipy.interpolate import NdBSpline  # noqa: PLC0415  see `_through`

        held = np.asarray(places, dtype=float)[..., :2]
        ends = np.array([[axis[0], axis[-1]] for axis in (self.x, self.y)])
        # Figures of the surroundings need a value outside the grid.
        return np.asarray(NdBSpline(*self._spline, _CUBIC)(np.clip(held, *ends.T)))

    @cached_property
    def _spline(self) -> tuple[tuple[FloatArray, FloatArray], FloatArray]:
        return _through(self.x, self.y, self.heights)


def surface_of(x: ArrayLike, y: ArrayLike, heights: FloatArray, side: int) -> Surface:
    """Construct a smooth surface that is nowhere below the ground, or nowhere above it.

    `side` is 1 for a surface nowhere below the ground, and -1 for one nowhere above it. `x` and `y`
    ascend; `heights` of the ground have shape (len(x), len(y)) [m].
    """
    # The grid of the surface is refined along an axis with fewer than four points.
    x, y, ground = _with_enough_points(np.array(x), np.array(y), heights)
    knots, coefficients = _through(x, y, side * ground)
    along_x, along_y = (_Axis.of(*pair) for pair in zip((x, y), knots, strict=True))
    of_ground = along_y.line @ (along_x.line @ (side * ground)).T

    def above(spline: FloatArray) -> FloatArray:
        """Return the Bernstein coefficients [m] of (spline - side * ground) in each grid cell.

        `side` is the argument of `surface_of`: 1 for a surface nowhere below the ground, -1 for one
        nowhere above it. `spline` holds the B-spline coefficients of side * surface, shape (len(x),
        len(y)) [m]. The result has shape (cells along x, cells along y, 4, 4).
        """
        found = (along_y.cubic @ (along_x.cubic @ spline).T - of_ground).T
        return found.reshape(x.size - 1, 4, y.size - 1, 4).swapaxes(1, 2)

    for share in _SHARES:
        lacking = share * np.maximum(0.0, -above(coefficients).min(axis=(2, 3)))
        coefficients = coefficients + along_y.greatest(along_x.greatest(lacking).T).T
    coefficients = coefficients + _ROUNDING_M
    heights = along_y.at_points @ (along_x.at_points @ coefficients).T
    excess = float(above(coefficients).max())
    return Surface(x=x, y=y, heights=side * heights.T, excess=excess)


def highest_on_ways(x: ArrayLike, y: ArrayLike, heights: FloatArray, home: ArrayLike) -> FloatArray:
    """Return, for each point of a grid, a height that clears the terrain on a straight flight home.

    At each place, the bilinear interpolation of the result [m] is at least as high as all ground on
    the way to `home`. `heights` have shape (len(x), len(y)) [m]. Derivation:
    docs/theory/homing.md, eq. (7).
    """
    from scipy.ndimage import maximum_filter  # noqa: PLC0415  see `_through`

    axes, ends = [np.array(axis, dtype=float) for axis in (x, y)], np.asarray(home)[:2]
    steps = [np.diff(axis) for axis in axes]
    cells = _greatest_of_corners(heights)
    # The straight line home from any point of a cell stays within half a cell of the line home from
    # the cell's centre. The samples below are half a step apart on the latter line. The searched
    # neighbourhood of a sample covers both distances.
    beside = [int(np.ceil((s.max() / 2 + s.min() / 4) / s.min())) for s in steps]
    near = maximum_filter(cells, size=[2 * count + 1 for count in beside], mode="nearest")
    longest = [np.abs(axis[[0, -1]] - end).max() for axis, end in zip(axes, ends, strict=True)]
    count = max(int(np.ceil(far / (s.min() / 2))) for far, s in zip(longest, steps, strict=True))
    middles = [axis[:-1] + step / 2 for axis, step in zip(axes, steps, strict=True)]
    found = near.copy()
    for share in np.linspace(0.0, 1.0, count + 1):
        rows, columns = (
            np.clip(np.searchsorted(axis, m + share * (end - m)) - 1, 0, axis.size - 2)
            for axis, m, end in zip(axes, middles, ends, strict=True)
        )
        np.maximum(found, near[np.ix_(rows, columns)], out=found)
    return _greatest_of_corners(np.pad(found, 1, constant_values=-np.inf))


def _greatest_of_corners(values: FloatArray) -> FloatArray:
    """Return, for each cell of a grid, the greatest of the values at its four corners.

    `values` has shape (n, m), and the result (n - 1, m - 1).
    """
    along = np.maximum(values[:-1], values[1:])
    return np.maximum(along[:, :-1], along[:, 1:])


def _with_enough_points(
    x: FloatArray, y: FloatArray, ground: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Refine a terrain grid with fewer than four points on an axis, without changing the ground.

    `x`, `y`, and `ground` with shape (len(x), len(y)), are in metres.
    """
    axes = [x, y]
    for number, axis in enumerate(axes):
        # A cubic spline needs four points on each axis.
        if axis.size < _FEWEST_POINTS:
            fine = np.interp(np.arange(0, axis.size - 0.9, 1 / 3), np.arange(axis.size), axis)
            along = np.moveaxis(ground, number, -1)
            rows = [np.interp(fine, axis, row) for row in along.reshape(-1, axis.size)]
            found = np.reshape(rows, (*along.shape[:-1], fine.size))
            axes[number], ground = fine, np.moveaxis(found, -1, number)
    return axes[0], axes[1], ground


def _through(
    x: FloatArray, y: FloatArray, heights: FloatArray
) -> tuple[tuple[FloatArray, FloatArray], FloatArray]:
    """Return knots and B-spline coefficients of the not-a-knot cubic spline through heights.

    Each axis has at least four points. `heights` and coefficients have shape (len(x), len(y)) [m].
    """
    from scipy.interpolate import make_interp_spline  # noqa: PLC0415  for terrain alone

    first = make_interp_spline(x, heights, _CUBIC)
    second = make_interp_spline(y, first.c, _CUBIC, axis=1)
    # The axis of the coefficients is moved to the front.
    return (first.t, second.t), np.moveaxis(second.c, 0, 1)


@dataclass(frozen=True, kw_only=True)
class _Axis:
    """Matrices that evaluate a spline surface and the ground along one axis of a grid.

    In the shapes of arrays, n is the number of grid points on the axis.
    """

    # From n spline coefficients to four Bernstein coefficients per cell, shape (4 (n - 1), n).
    cubic: Any
    # From n heights of the ground to four Bernstein coefficients per cell, shape (4 (n - 1), n).
    line: Any
    # From n spline coefficients to the values of the spline at the points, shape (n, n).
    at_points: Any
    # Index of the first of four spline coefficients that influence each cell, shape (n - 1,).
    first: NDArray[intp]

    @classmethod
    def of(cls, points: FloatArray, knots: FloatArray) -> Self:
        from scipy.interpolate import BSpline  # noqa: PLC0415  see `_through`
        from scipy.sparse import block_diag, csr_array  # noqa: PLC0415  see `_through`

        thirds = (points[:-1, None] + np.diff(points)[:, None] * _THIRDS).clip(max=points[-1])
        straight = np.concatenate([points[:1], points, points[-1:]])
        to_bernstein = block_diag([csr_array(_TO_BERNSTEIN)] * (points.size - 1), format="csr")
        return cls(
            cubic=to_bernstein @ BSpline.design_matrix(thirds.ravel(), knots, _CUBIC),
            line=BSpline.design_matrix(thirds.ravel(), straight, 1),
            at_points=BSpline.design_matrix(points, knots, _CUBIC),
            first=np.searchsorted(knots[: 1 - _FEWEST_POINTS], points[:-1], "right") - 1 - _CUBIC,
        )

    def greatest(self, of_cells: FloatArray) -> FloatArray:
        """Return, for each spline coefficient, the greatest value of the cells that depend on it.

        `of_cells` has shape (n - 1, ...) and values of at least 0. The result has shape (n, ...).
        """
        found = np.zeros((of_cells.shape[0] + 1, *of_cells.shape[1:]))
        for k in range(_CUBIC + 1):
            np.maximum.at(found, self.first + k, of_cells)
        return found
