"""Tensor-product B-splines in CasADi whose evaluation cost does not depend on the grid's size.

In each cell of its grid, a spline of x, y, ... is the sum of the terms

    c[i, j, ...] * f_i(x) * g_j(y) * ... ,

where each index runs from 0 to the degree. The factors along an axis are powers of the local
coordinate, or B-spline basis functions. One call of a CasADi function looks up the coefficients c
of a cell, and returns value, gradient and Hessian at a rounded point near the arguments. The
expression of the spline is the Taylor polynomial of degree two about this point: see
docs/theory/transcription.md, "Interpolation tables".
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

    The spline is linear in the first and last interval of each axis. The module's docstring
    describes the evaluation.

    Attributes
    ----------
    roundings : tuple of float
        Step of the rounding of each argument.
    ends : tuple of (float, float)
        Interval to which each rounded argument is limited. An argument outside the interval is
        rounded to the nearer end of the interval.
    function : casadi.Function
        Rounded arguments -> value, gradient and upper triangle of the Hessian of the spline.
    kept : tuple of casadi.Function
        CasADi functions for the derivatives of `function`. They return zero, because the rounded
        arguments count as constants. (The derivatives of the spline come from the Taylor
        polynomial.) The attribute keeps these functions, so that CasADi does not construct them
        anew for each expression.
    """

    roundings: tuple[float, ...]
    ends: tuple[tuple[float, float], ...]
    function: Any
    kept: tuple[Any, ...]

    @classmethod
    def of(cls, knots: Sequence[FloatArray], coefficients: FloatArray, degree: int) -> Self:
        """Return a B-spline in the form of a `LocalSpline`.

        The B-spline must be linear in the first and last interval of each axis, as is that of
        `Spline.through`. Otherwise, the tangent from the neighbouring interval replaces it there.

        Parameters
        ----------
        knots : sequence of ndarray
            Knots along each axis.
        coefficients : ndarray
            B-spline coefficients, with one array axis per argument of the spline.
        degree : int
            Degree of the B-spline along every axis.
        """
        place: Any = casadi.MX.sym("place", len(knots))
        found = _jet(place, knots, coefficients, degree)
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
        """Return the value of the spline as a CasADi expression of its arguments.

        `arguments` are CasADi expressions, one for each axis of the spline.
        """
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
    """Return the index pairs (i, j), i <= j < count, of the upper triangle of a Hessian.

    The pairs are in the order of the rows. `count` is the number of rows of the Hessian.
    """
    return list(combinations_with_replacement(range(count), 2))


def _jet(
    place: Any,
    knots: Sequence[FloatArray],
    coefficients: FloatArray,
    degree: int,
) -> Any:
    """Return value, gradient and upper triangle of the Hessian of a spline at a symbolic point.

    Parameters
    ----------
    place : casadi.MX
        Symbols of the point's coordinates, one per axis of the spline.
    knots : sequence of ndarray
        Knots along each axis.
    coefficients : ndarray
        B-spline coefficients, with one array axis per axis of the spline.
    degree : int

    Returns
    -------
    casadi.MX
        Column of the value, then the gradient, then the upper triangle of the Hessian.
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
    """Return a CasADi function for the factors of a spline in a grid cell, with their derivatives.

    The module's docstring defines the factors.

    Parameters
    ----------
    count : int
        Number of axes of the spline.
    cells : int
        Number of axes, counted from the first, whose factors are powers. The factors of the other
        axes are B-spline basis functions.
    degree : int
        Degree of the spline along every axis.

    Returns
    -------
    casadi.Function
        (point, a column for each axis) -> a matrix for each axis. The matrix has the shape (degree
        + 1, 3): one row per factor, with its value, first and second derivative.

        The column of an axis describes the cell that contains the point. It has four parts:

        - origin of the local coordinate;
        - reciprocal of the cell's width;
        - index of the first basis function that is not zero in the cell;
        - coefficients of the basis functions, as polynomials of the local coordinate.

        An axis with powers uses only the first two parts.
    """
    order, weights = degree + 1, []
    place = casadi.SX.sym("place", count)
    along = [casadi.SX.sym(f"along_{axis}", 3 + order**2) for axis in range(count)]
    for axis, found in enumerate(along):
        powers = _powers(place[axis], found[0], found[1], degree)
        basis = casadi.reshape(found[3:], order, order)
        weights.append(casadi.densify(powers if axis < cells else basis @ powers))
    return casadi.Function("weights", [place, *along], weights)


def _contracted(parts: _Parts, weights: Sequence[Any], axes: Iterable[int]) -> _Parts:
    """Sum the terms of a spline's value and derivatives along some axes.

    The module's docstring gives the terms of the value. For a derivative along an axis, the
    derivative of the factor of this axis replaces the factor.

    Parameters
    ----------
    parts : dict
        Partial sums of the value and of each derivative of the spline. Earlier calls of this
        function have summed over the last axes of the spline, or over none.

        A key identifies a derivative: it is a tuple with the order of the derivative along each
        axis that is already summed. If no axis is summed yet, the only key is (). The value of a
        key is a CasADi column, with one partial sum for each combination of the indices of the
        other axes.
    weights : sequence of casadi.SX or casadi.MX
        For each axis, the matrix of the factors, shape (degree + 1, 3): one row per factor, with
        its value, first and second derivative.
    axes : iterable of int
        The axes to sum over, in rising order: the last of the axes not yet summed in `parts`.

    Returns
    -------
    dict
        The partial sums over `axes` and the axes summed earlier, in the form of `parts`. A key has
        the orders of the derivative along `axes`, then the orders along the axes summed earlier.
        The sum of the orders in a key is at most 2.
    """
    # Multiply by the factors of an axis, and sum over its index.
    for axis in reversed([*axes]):
        order = weights[axis].shape[0]
        parts = {
            (degree_along, *orders): column
            for orders, part in parts.items()
            for degree_along, column in enumerate(
                casadi.horzsplit(
                    casadi.reshape(part, -1, order)
                    @ weights[axis][:, : _VALUE_SLOPE_BEND - sum(orders)]
                )
            )
        }
    return parts


def _contraction(given: Sequence[tuple[int, ...]], count: int, degree: int) -> Any:
    """Return a CasADi function that completes the sums for value, gradient and Hessian.

    The function `_contracted` first sums over all axes except the first two. The returned function
    sums over the first two axes (or over the only axis).

    Parameters
    ----------
    given : sequence of tuple of int
        Keys of the dictionary that the first step returns. A key identifies a derivative: it is a
        tuple with the order of the derivative along each axis of the first step. For a spline with
        one or two axes, the first step has no axis, and the only key is ().
    count : int
        Number of axes of the spline.
    degree : int
        Degree of the spline along every axis.

    Returns
    -------
    casadi.Function
        (sums of the first step, matrices of factors) -> column of value, gradient and upper
        triangle of the Hessian. The sums of the first step are one column, in the order of `given`.
        There is one matrix for each of the first two axes, of shape (degree + 1, 3): one row per
        factor, with its value, first and second derivative.
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
    """Return the powers of ``(at - anchor) * per_width``, with two derivatives by `at`.

    `anchor` is the origin of the cell, and `per_width` the reciprocal of its width. The CasADi
    matrix has one row per power from 0 to `degree`.
    """
    share = (at - anchor) * per_width
    powers = [casadi.SX(1), *(share**k for k in range(1, degree + 1))]
    columns = [powers]
    for _ in range(1, _VALUE_SLOPE_BEND):
        columns.append([0, *(k * per_width * columns[-1][k - 1] for k in range(1, degree + 1))])
    return casadi.horzcat(*[casadi.vertcat(*column) for column in columns])


def _looked_up(place: Any, breaks: Sequence[FloatArray], table: FloatArray) -> Any:
    """Return the numbers that a table stores for the grid cell that contains a point.

    Parameters
    ----------
    place : casadi.MX
        Coordinates of the point, one per axis of the grid.
    breaks : sequence of ndarray
        Ends of the cells along each axis.
    table : ndarray
        One array of numbers for each cell. The leading axes of the table are those of the grid, and
        count the cells. The other axes are those of the array of a single cell.

    Returns
    -------
    casadi.MX
        Column of the numbers of the cell. The first axis of the cell's array varies fastest.
    """
    count = len(breaks)
    values = np.moveaxis(table, range(count, table.ndim), range(table.ndim - count))
    flat = casadi.DM(values.ravel(order="F").tolist())
    size = flat.numel() // int(np.prod(table.shape[:count]))
    return casadi.bspline(place, flat, [b.tolist() for b in breaks], [0] * count, size, {})


@dataclass(frozen=True, kw_only=True)
class _Pieces:
    """Polynomial pieces of the B-spline basis functions of one axis, in each of n grid cells.

    Attributes
    ----------
    breaks : ndarray, shape (n + 1,)
        Ends of the cells.
    columns : ndarray of int, shape (n, degree + 1)
        For each cell, the indices of the basis functions that are not zero in the cell.
    ends : ndarray, shape (n, 2)
        Origin and scale of the local coordinate for each cell: the local coordinate is scale *
        (coordinate - origin). The scale is 1 / (width of the cell). The first and the last cell
        have the scale of the neighbouring cell.
    matrices : ndarray, shape (n, degree + 1, degree + 1)
        For each cell, the polynomial coefficients of the basis functions in `columns`: one row per
        power of the local coordinate, one column per basis function.
    """

    breaks: FloatArray
    columns: Any
    ends: FloatArray
    matrices: FloatArray

    @classmethod
    def of(cls, knots: FloatArray, degree: int) -> Self:
        """Return the polynomial pieces of the B-spline basis with given knots, in each cell.

        The first and the last cell serve for linear extrapolation. There, each basis function is
        its tangent at the boundary to the neighbouring cell.
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
