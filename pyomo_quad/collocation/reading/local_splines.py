"""Tensor-product B-splines in CasADi whose evaluation cost does not depend on the grid's size.

In each cell of its grid, a spline of x, y, ... is the sum of the terms

    c[i, j, ...] * f_i(x) * g_j(y) * ... ,

where each index runs from 0 to the degree. Along the first axes, the factors are powers of a
coordinate in the cell. Along the others, they are B-spline basis functions, for which the
coefficients need less memory. A CasADi function looks up the coefficients c, and returns value,
gradient and Hessian. Its arguments are rounded to 2**-38 of a grid step. In differentiation, the
rounded arguments count as constants. The spline's expression is the Taylor polynomial of degree two
about them: see docs/theory/transcription.md, "Interpolation tables".
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations_with_replacement, product
from math import factorial
from typing import TYPE_CHECKING, Any, Self

import casadi
import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from pyomo_quad.collocation.mesh import FloatArray

# Numbers in the largest table of coefficients of powers: CasADi writes it out with each function.
_MOST_LOOKED_UP = 3_000_000
# Rounding of the arguments of a call, as a fraction of the smallest grid step of an axis.
_ROUNDING = 2.0**-38
# Offset of the rounded arguments within the rounding step, and within the first and the last grid
# step, as a fraction of each step: CasADi's look-up fails at the end of a cell itself.
_ASIDE = 0.3819660112501051
# Number of derivatives in the result of a call: value, first and second derivative.
_VALUE_SLOPE_BEND = 3
# Leading axes along which a call sums number by number, and not by matrices.
_AS_NUMBERS = 2
#: Name of the CasADi function of every table, by which its calls are found in an expression.
CALLED = "local"


@dataclass(frozen=True, kw_only=True)
class LocalSpline:
    """Tensor-product B-spline in a form whose evaluation cost does not depend on the grid's size.

    The first and the last grid interval of each axis serve for extrapolation: the spline is linear
    in them.

    Attributes
    ----------
    roundings : tuple of float
        Step of the rounding of each argument.
    ends : tuple of (float, float)
        Interval to which each rounded argument is clipped.
    function : casadi.Function
        Rounded arguments -> value, gradient and upper triangle of the Hessian.
    kept : tuple of casadi.Function
        Derivatives of `function`, defined as zero because its arguments count as constants.
    """

    roundings: tuple[float, ...]
    ends: tuple[tuple[float, float], ...]
    function: Any
    # CasADi would otherwise construct the derivatives anew for each expression.
    kept: tuple[Any, ...]

    @classmethod
    def of(cls, knots: Sequence[FloatArray], coefficients: FloatArray, degree: int) -> Self:
        """Return a B-spline in the form of a `LocalSpline`.

        The given B-spline is linear in the first and the last interval of each axis. The method
        `reading.tables.Spline.through` returns such splines. The coefficients have one array axis
        per argument.
        """
        place: Any = casadi.MX.sym("place", len(knots))
        found = _jet(place, knots, coefficients, degree)
        # The derivatives of the call are zero: the rounded arguments count as constants, and the
        # derivatives of the spline come from the Taylor polynomial.
        # CasADi would otherwise differentiate the call itself.
        told, seed = casadi.MX.sym("told", found.numel()), casadi.MX.sym("seed", found.numel())
        moved = casadi.MX.sym("moved", len(knots))
        zeros: dict[str, tuple[list[Any], Any]] = {
            f"fwd1_{CALLED}": ([place, told, moved], casadi.MX.zeros(found.numel())),
            f"adj1_{CALLED}": ([place, told, seed], casadi.MX.zeros(len(knots))),
        }
        known = {n: casadi.Function(n, inputs, [zero]) for n, (inputs, zero) in zeros.items()}
        options: dict[str, Any] = {"never_inline": True, "cache": known}
        function = casadi.Function(CALLED, [place], [found], options)
        inner = [np.unique(t)[1:-1] for t in knots]
        steps = [float(np.diff(breaks).min()) for breaks in inner]
        return cls(
            roundings=tuple(_ROUNDING * step for step in steps),
            ends=tuple(
                (float(t[0]) + _ASIDE * step, float(t[-1]) - _ASIDE * step)
                for t, step in zip(knots, steps, strict=True)
            ),
            function=function,
            kept=tuple(known.values()),
        )

    def written(self, arguments: Sequence[Any]) -> Any:
        """Return the value of the spline as a CasADi expression of its arguments, one per axis."""
        # CasADi's look-up fails at NaN, so fmax replaces NaN; `away` makes the result NaN again.
        rounded = [
            casadi.fmin(casadi.fmax(step * (casadi.floor(argument / step) + _ASIDE), low), high)
            for argument, step, (low, high) in zip(
                arguments, self.roundings, self.ends, strict=True
            )
        ]
        value, *slopes = casadi.vertsplit(self.function(casadi.vertcat(*rounded)))
        away = [argument - at for argument, at in zip(arguments, rounded, strict=True)]
        bends = slopes[len(away) :]
        for slope, step in zip(slopes, away, strict=False):
            value += slope * step
        for bend, (one, other) in zip(bends, _pairs(len(away)), strict=True):
            value += bend * away[one] * away[other] * (0.5 if one == other else 1.0)
        return value


def _pairs(count: int) -> list[tuple[int, int]]:
    """Return the index pairs (i, j), i <= j < count, of a Hessian's upper triangle, row by row."""
    return list(combinations_with_replacement(range(count), 2))


def _jet(
    place: Any,
    knots: Sequence[FloatArray],
    coefficients: FloatArray,
    degree: int,
) -> Any:
    """Return value, gradient and upper triangle of the Hessian of a spline at a symbolic point.

    `place` has the symbols of the coordinates. The result is one column.
    """
    table, order, cells = coefficients, degree + 1, 0
    axes, index, along = [], [], []
    for axis, t in enumerate(knots):
        pieces = _Pieces.of(t, degree)
        count = pieces.breaks.size - 1
        basis = pieces.matrices.transpose(0, 2, 1).reshape(count, -1, order="F")
        told = np.column_stack([pieces.ends, pieces.columns[:, 0], basis])
        found = _looked_up(place[axis], [pieces.breaks], told)
        along.append(found)
        grown = table.size // table.shape[axis] * count * order
        if cells == axis and grown <= _MOST_LOOKED_UP:
            cells += 1
            windows = np.moveaxis(table, axis, 0)[pieces.columns]
            by_power = np.einsum("kpj,kj...->k...p", pieces.matrices, windows)
            table = np.moveaxis(by_power, 0, axis)
            axes.append(pieces.breaks)
            index.append(place[axis])
        else:
            axes.append(np.arange(table.shape[axis] + 1.0))
            index.append(found[2] + 0.5)
    at = casadi.MX.sym("at", len(knots))
    entry = casadi.Function("entry", [at], [_looked_up(at, axes, table)])
    first = casadi.vertcat(*index)
    # The offset along the first axis varies fastest.
    offsets = product(range(order), repeat=len(knots) - cells)
    entries = casadi.vertcat(*[entry(first + casadi.DM([0] * cells + [*o][::-1])) for o in offsets])
    weights = _weights(len(knots), cells, degree)(place, *along)
    weights = [weights] if len(knots) == 1 else list(weights)
    parts = _contracted({(): entries}, weights, range(_AS_NUMBERS, len(knots)))
    weights = weights[:_AS_NUMBERS]
    return _contraction(list(parts), len(knots), degree)(casadi.vertcat(*parts.values()), *weights)


# Sums of a cell's coefficients times their factors along the last axes, for value and derivatives
# of a spline: orders of the derivative along these axes -> column with a sum for each combination
# of the coefficients along the other axes.
_Parts = dict[tuple[int, ...], Any]


def _weights(count: int, cells: int, degree: int) -> Any:
    """Return a CasADi function for a spline's factors in a grid cell.

    It maps a point and the cell's data to a matrix for each of `count` axes. A row has value and
    two derivatives of a factor. The first `cells` axes have powers.
    """
    order, weights = degree + 1, []
    place = casadi.SX.sym("place", count)
    # Column of an axis: origin of the local coordinate, reciprocal of the cell's width, index of
    # the first basis function that is not zero in the cell, and coefficients of the basis functions
    # as polynomials of the local coordinate. Axes with powers use the first two only.
    along = [casadi.SX.sym(f"along_{axis}", 3 + order**2) for axis in range(count)]
    for axis, found in enumerate(along):
        powers = _powers(place[axis], found[0], found[1], degree)
        basis = casadi.reshape(found[3:], order, order)
        weights.append(casadi.densify(powers if axis < cells else basis @ powers))
    return casadi.Function("weights", [place, *along], weights)


def _contracted(parts: _Parts, weights: Sequence[Any], axes: Iterable[int]) -> _Parts:
    """Sum the terms of a spline's value and derivatives along `axes`.

    `axes` are consecutive, in rising order. `parts` has the sums along all axes after them.
    ``weights[axis]`` has one row per factor: value, first and second derivative.
    """
    # Multiply by the factors of an axis, and sum over its index.
    # For a derivative along an axis, the derivative of the factor replaces the factor.
    for axis in reversed([*axes]):
        order = weights[axis].shape[0]
        parts = {
            (degree_along, *orders): column
            for orders, part in parts.items()
            for degree_along, column in enumerate(
                casadi.horzsplit(
                    casadi.reshape(part, -1, order)
                    # The orders in a key sum to 2 at most.
                    @ weights[axis][:, : _VALUE_SLOPE_BEND - sum(orders)]
                )
            )
        }
    return parts


def _contraction(given: Sequence[tuple[int, ...]], count: int, degree: int) -> Any:
    """Return a CasADi function that sums a spline's terms along at most the first two axes.

    It maps sums along the other ones of `count` axes, and matrices from `_weights`, to value,
    gradient and upper triangle of the Hessian. `given` has the sums' derivative orders.
    """
    left, order = min(count, _AS_NUMBERS), degree + 1
    size = order**left
    numbers = casadi.SX.sym("parts", size * len(given))
    weights = [casadi.SX.sym(f"weights_{k}", order, _VALUE_SLOPE_BEND) for k in range(left)]
    each = casadi.vertsplit(numbers, size)
    # Few numbers are summed number by number, which is faster than products of matrices.
    parts = _contracted(dict(zip(given, each, strict=True)), weights, range(left))
    chosen = [(), *((axis,) for axis in range(count)), *_pairs(count)]
    jet = [parts[tuple(orders.count(axis) for axis in range(count))] for orders in chosen]
    return casadi.Function("contraction", [numbers, *weights], [casadi.vertcat(*jet)])


def _powers(at: Any, anchor: Any, per_width: Any, degree: int) -> Any:
    """Return the powers of ``(at - anchor) * per_width``, with their derivatives by `at`.

    The grid cell has the origin `anchor` and the width ``1 / per_width``. Each row has value, first
    and second derivative of a power, from 0 to `degree`.
    """
    share = (at - anchor) * per_width
    powers = [casadi.SX(1), *(share**k for k in range(1, degree + 1))]
    columns = [powers]
    for _ in range(1, _VALUE_SLOPE_BEND):
        columns.append([0, *(k * per_width * columns[-1][k - 1] for k in range(1, degree + 1))])
    return casadi.horzcat(*[casadi.vertcat(*column) for column in columns])


def _looked_up(place: Any, breaks: Sequence[FloatArray], table: FloatArray) -> Any:
    """Return the numbers that a table stores for the grid cell that contains a point.

    `breaks` has the ends of the cells along each axis. The leading axes of `table` count the cells.
    """
    count = len(breaks)
    # In the result, the first axis of the cell's array varies fastest.
    values = np.moveaxis(table, range(count, table.ndim), range(table.ndim - count))
    flat = casadi.DM(values.ravel(order="F").tolist())
    size = flat.numel() // int(np.prod(table.shape[:count]))
    return casadi.bspline(place, flat, [b.tolist() for b in breaks], [0] * count, size, {})


@dataclass(frozen=True, kw_only=True)
class _Pieces:
    """Polynomial pieces of the B-spline basis functions of one axis, in each of n grid cells.

    The local coordinate is scale * (coordinate - origin). The scale is 1 / (width of the cell).
    """

    # Ends of the cells, shape (n + 1,).
    breaks: FloatArray
    # Indices of the basis functions that are not zero in each cell, shape (n, degree + 1).
    columns: Any
    # Origin and scale of the local coordinate of each cell, shape (n, 2). The first and the last
    # cell have the scale of the neighbouring cell.
    ends: FloatArray
    # Polynomial coefficients of the basis functions in `columns`, shape (n, degree + 1, degree +
    # 1): one row per power of the local coordinate, one column per basis function.
    matrices: FloatArray

    @classmethod
    def of(cls, knots: FloatArray, degree: int) -> Self:
        """Return the polynomial pieces of the B-spline basis with given knots, in each cell.

        The first and the last cell serve for linear extrapolation. Their pieces are tangents of the
        neighbouring cell's pieces at the common grid point.
        """
        from scipy.interpolate import BSpline  # noqa: PLC0415  few models have tables

        breaks, powers = np.unique(knots), np.arange(degree + 1)
        basis = BSpline(knots, np.eye(knots.size - degree - 1), degree)
        starts, widths = breaks[1:-2], np.diff(breaks[1:-1])
        firsts = np.searchsorted(knots, starts, side="right") - 1 - degree
        columns = firsts[:, None] + powers
        slopes = [np.take_along_axis(basis(starts, p) / factorial(p), columns, 1) for p in powers]
        matrices = np.stack(slopes, axis=1) * widths[:, None, None] ** powers[:, None]
        before, after = np.zeros((2, 1, degree + 1, degree + 1))
        before[0, :2] = matrices[0, :2]
        after[0, :2] = matrices[-1].sum(axis=0), powers @ matrices[-1]
        ends = np.column_stack([starts, 1.0 / widths])
        return cls(
            breaks=breaks,
            columns=np.vstack([columns[:1], columns, columns[-1:]]),
            ends=np.vstack([ends[:1], ends, [breaks[-2], ends[-1, 1]]]),
            matrices=np.concatenate([before, matrices, after]),
        )
