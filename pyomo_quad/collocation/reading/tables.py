"""Interpolation tables and external functions in Pyomo models, and their CasADi expressions.

An external function is a function, usually in Python, that a Pyomo model calls. An interpolation
table (`Table`) is an external function that is given by its values on a grid.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, fields
from functools import cached_property
from itertools import product
from typing import TYPE_CHECKING, Any, Self

import casadi
import numpy as np
from pyomo.core.base.external import PythonCallbackFunction

from pyomo_quad.collocation.errors import TranscriptionError, raised
from pyomo_quad.collocation.reading.local_splines import LocalSpline

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from pyomo_quad.collocation.mesh import FloatArray

# Degrees of the splines through a table, and through the samples of a function.
_CUBIC, _QUINTIC = 3, 5
# Numbers of samples along each axis, tried in turn, by number of arguments, for a function that can
# only be called with numbers.
_SAMPLES = {1: (17, 33, 65, 129, 257), 2: (9, 17, 33, 65)}
# Largest accepted difference of a function from its spline, relative to the largest sample, and the
# number of random points at which the two are compared.
_ACCURACY = 1e-7
_COMPARED = 40
# Points at which a function of symbols is checked against the function of numbers.
_CHECKED = 20


# Length of the linear extrapolation beyond either end, in units of the table's range.
_BEYOND = 100.0


@dataclass(frozen=True, kw_only=True)
class Spline:
    """Tensor-product not-a-knot B-spline, extrapolated linearly beyond its range.

    Attributes
    ----------
    knots : tuple of ndarray
        Knots along each axis; an axis belongs to one argument.
    coefficients : ndarray
        B-spline coefficients, one axis per argument.
    degree : int
    ranges : tuple of (float, float)
        First and last data point of each argument.
    """

    knots: tuple[FloatArray, ...]
    coefficients: FloatArray
    degree: int
    ranges: tuple[tuple[float, float], ...]

    @classmethod
    def through(cls, points: Sequence[FloatArray], values: FloatArray, degree: int) -> Self:
        """Return the spline through values on a grid.

        Parameters
        ----------
        points : sequence of ndarray
            Grid points of each argument, rising.
        values : ndarray
            Values at the grid points, with one array axis per argument.
        degree : int
        """
        held, knots = np.asarray(values, dtype=float), []
        for axis, at in enumerate(points):
            found, coefficients = _extended_linearly(at, np.moveaxis(held, axis, 0), degree)
            held = np.moveaxis(coefficients, 0, axis)
            knots.append(found)
        ranges = tuple((float(at[0]), float(at[-1])) for at in points)
        return cls(knots=tuple(knots), coefficients=held, degree=degree, ranges=ranges)

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        """Return the spline itself, since it is immutable."""
        return self

    def written(self, arguments: Sequence[Any]) -> Any:
        """Return the value of the spline as a CasADi expression of its arguments, one per axis.

        The cost of an evaluation does not depend on the number of data points.
        """
        return self._local.written([casadi.SX(argument) for argument in arguments])

    @cached_property
    def _local(self) -> LocalSpline:
        """The same spline as a `LocalSpline`, which is fast to evaluate."""
        return LocalSpline.of(self.knots, self.coefficients, self.degree)

    @cached_property
    def function(self) -> Any:
        """CasADi function from a point to the spline's value, gradient and Hessian there."""
        arguments = casadi.SX.sym("arguments", len(self.knots))
        written = self.written(casadi.vertsplit(arguments))
        hessian, gradient = casadi.hessian(written, arguments)
        return casadi.Function("spline", [arguments], [written, gradient, hessian])

    def __getstate__(self) -> dict[str, Any]:
        """Return the attributes that a pickle keeps: the spline's data, no CasADi functions."""
        return {field.name: getattr(self, field.name) for field in fields(self)}


def _extended_linearly(
    at: FloatArray, values: FloatArray, degree: int
) -> tuple[FloatArray, FloatArray]:
    """Return knots and coefficients of a spline that is extrapolated linearly beyond its data.

    Beyond the data points `at`, the spline is its tangent at the first or last data point. Data run
    along the first axis.
    """
    from scipy.interpolate import make_interp_spline  # noqa: PLC0415  few models have tables

    # Within the data, the result equals this usual interpolating spline.
    spline = make_interp_spline(at, values, k=degree)
    first, last, far = at[0], at[-1], _BEYOND * (at[-1] - at[0])
    inner = spline.t[degree + 1 : -degree - 1]
    # At a knot of multiplicity degree - 1, only value and slope are continuous. The spline can
    # therefore change to a straight line at the first and the last data point.
    ends = [np.full(degree + 1, first - far), np.full(degree - 1, first)]
    starts = [np.full(degree - 1, last), np.full(degree + 1, last + far)]
    knots = np.concatenate([*ends, inner, *starts])
    count = knots.size - degree - 1
    # Greville abscissae: means of `degree` successive knots, one for each coefficient.
    places = np.array([knots[k + 1 : k + 1 + degree].mean() for k in range(count)])
    # The average of three equal knots may be off by a rounding error.
    places = np.clip(places, knots[0], knots[-1])
    within = np.clip(places, first, last)
    beyond = (places - within).reshape(-1, *[1] * (values.ndim - 1))
    straight = spline(within) + beyond * spline(within, 1)
    return knots, np.asarray(make_interp_spline(places, straight, k=degree, t=knots).c)


class Table(PythonCallbackFunction):
    """Interpolation table: values on a grid as a smooth function, for use in a Pyomo model.

    With ``m.density = Table(heights, densities)``, a rule may contain ``m.density(m.h[t])``. The
    function is the cubic not-a-knot spline through the values, twice continuously differentiable.
    Outside the grid, it is extrapolated linearly.

    Parameters
    ----------
    *grid : array_like
        For each argument, an array of at least four grid points in ascending order. Then the array
        of values, with one axis per argument.
    units, arg_units : optional
        Pyomo unit of the values, and tuple of the units of the arguments; dimensionless by default.

    Raises
    ------
    TranscriptionError
        If there are too few points, points do not rise, a number is not finite, or the values have
        the wrong shape.
    """

    def __init__(self, *grid: Any, **keywords: Any) -> None:
        *points, values = (np.asarray(part, dtype=float) for part in grid)
        _refuse_unfit(points, values)
        self.spline = Spline.through(points, values, _CUBIC)
        super().__init__(fgh=self._at, **keywords)

    def __call__(self, *arguments: Any) -> Any:
        """Return the Pyomo expression that stands for the table's value at given arguments.

        `arguments` are Pyomo expressions or numbers, one for each argument of the table.

        Raises
        ------
        TranscriptionError
            If the number of arguments is wrong.
        """
        if len(arguments) != len(self.spline.knots):
            raise TranscriptionError(
                f"{self.name or 'Table'}: called with {len(arguments)} arguments; it has points "
                f"for {len(self.spline.knots)}."
            )
        return super().__call__(*arguments)

    def _at(self, arguments: Any, _order: int, _fixed: Any) -> tuple[float, list[float], Any]:
        """Return the table's value, gradient and Hessian at given arguments, as Pyomo requires.

        The Hessian is returned as its upper triangle, column after column.
        """
        # Pyomo also passes the required order of derivatives and the constant arguments.
        value, gradient, hessian = self.spline.function(arguments)
        upper = [float(hessian[i, j]) for j in range(len(arguments)) for i in range(j + 1)]
        return float(value), [float(gradient[k]) for k in range(len(arguments))], upper


def _refuse_unfit(points: Sequence[FloatArray], values: FloatArray) -> None:
    """Raise an error for grid points or values that do not define an interpolation table."""
    for axis, at in enumerate(points, start=1):
        if at.ndim != 1 or at.size <= _CUBIC:
            raise TranscriptionError(
                f"Table: {at.size} points along axis {axis}; at least {_CUBIC + 1} in one row are "
                "needed."
            )
        if not np.all(np.isfinite(at)) or np.any(np.diff(at) <= 0.0):
            k = int(np.argmin(np.diff(at)))
            raise TranscriptionError(
                f"Table: points along axis {axis} do not rise, {at[k]:g} before {at[k + 1]:g}; "
                "sort them and leave out repeated ones."
            )
    wanted = tuple(at.size for at in points)
    if not points or values.shape != wanted:
        raise TranscriptionError(
            f"Table: values of shape {values.shape} for points of shape {wanted}; give the points "
            "of each argument, then values with one axis per argument."
        )
    if not np.all(np.isfinite(values)):
        raise TranscriptionError("Table: some values are not finite; leave those points out.")


@dataclass(frozen=True, kw_only=True)
class TableUse:
    """Argument of an interpolation table in an equation, and the range of the table.

    A solution in which the argument leaves the range uses the extrapolated table.

    Attributes
    ----------
    name : str
        Text for messages: names of the table, of the component with the equation, and of the
        argument.
    expression : casadi.SX
        The argument.
    lower, upper : float
        First and last value of the argument for which the table has data.
    """

    name: str
    expression: Any
    lower: float
    upper: float


def external(node: Any, arguments: Sequence[Any], owner: str, uses: list[TableUse]) -> Any:
    """Return the CasADi expression of the call `node` of an external function in a Pyomo model.

    `arguments` are the CasADi expressions of the call's arguments. A `Table`, and a function that
    needs numbers (see `_sampled`), become a spline, whose arguments are added to `uses`. Any other
    Python function becomes the expression that it returns for symbols. `owner` is the name of the
    component with the call, for messages. If sampling fails, a `TranscriptionError` is raised.
    """
    function = node._fcn  # noqa: SLF001
    is_python = isinstance(function, PythonCallbackFunction)
    # Pyomo appends an argument that identifies the Python function.
    count = node.nargs() - is_python
    inputs, stated = list(arguments[:count]), [node.arg(k) for k in range(count)]
    if isinstance(function, Table):
        spline = function.spline
    else:
        written = _symbolic(function, inputs, stated) if is_python else None
        if written is not None:
            return written
        spline = _sampled(function, stated, owner)
    for place, (argument, (lower, upper)) in enumerate(
        zip(inputs, spline.ranges, strict=True), start=1
    ):
        which = "its argument" if count == 1 else f"its argument {place}"
        uses.append(
            TableUse(
                name=f"{function.name} in {owner}: {which}",
                expression=casadi.SX(argument),
                lower=lower,
                upper=upper,
            )
        )
    return spline.written(inputs)


def _symbolic(function: Any, inputs: Sequence[Any], stated: Sequence[Any]) -> Any:
    """Return the CasADi expression of a Python function's call, None if the function needs numbers.

    `inputs` are the call's arguments in CasADi, `stated` the same in Pyomo. The result is also None
    if function and expression differ at one of 20 random points.
    """
    if function._fcn is None:  # noqa: SLF001
        return None
    symbols = casadi.SX.sym("arguments", len(inputs))
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            said = casadi.SX(function._fcn(*casadi.vertsplit(symbols)))  # noqa: SLF001
        found = casadi.Function("function", [symbols], [said])
        lower, upper = np.transpose([_range(argument) for argument in stated])
        places = np.random.default_rng(seed=0).uniform(lower, upper, (_CHECKED, len(inputs)))
        # CasADi turns a symbol into NaN if the function converts it to a number.
        is_same = all(
            np.isclose(float(found(at)), function._fcn(*at.tolist()), 1e-9, equal_nan=True)  # noqa: SLF001
            for at in places
        )
    except Exception:  # noqa: BLE001  the function is the user's: it may raise anything
        return None
    return None if not is_same else casadi.substitute(said, symbols, casadi.vertcat(*inputs))


def _bounds(argument: Any) -> tuple[float | None, float | None]:
    """Return lower and upper bound of a Pyomo expression, None where it has none."""
    from pyomo.contrib.fbbt.fbbt import compute_bounds_on_expr  # noqa: PLC0415  as above

    lower, upper = compute_bounds_on_expr(argument)
    return lower, upper


def _range(argument: Any) -> tuple[float, float]:
    """Return the bounds of a Pyomo expression, or (0.1, 0.9) if one of them is missing.

    `_symbolic` compares a function with its expression at random points of this range.
    """
    lower, upper = _bounds(argument)
    return (0.1, 0.9) if lower is None or upper is None else (float(lower), float(upper))


def _sampled(function: Any, stated: Sequence[Any], owner: str) -> Spline:
    """Return the spline through samples of a function that can only be called with numbers.

    Samples lie between the bounds of `stated`, the Pyomo arguments. `owner` names the
    component in messages. A `TranscriptionError` is raised for over two arguments, missing bounds,
    failure, or low accuracy.
    """
    name = function.name
    if len(stated) not in _SAMPLES:
        raise TranscriptionError(
            f"{name} in {owner}: its function takes {len(stated)} numbers and no symbols; up to 2 "
            "can be tabulated. Write it with functions that take CasADi symbols, as NumPy's."
        )
    ranges = []
    for place, argument in enumerate(stated, start=1):
        lower, upper = _bounds(argument)
        if lower is None or upper is None or not upper > lower:
            raise TranscriptionError(
                f"{name} in {owner}: its function takes no symbols, and argument {place} has no "
                f"finite bounds to tabulate it between ({lower}, {upper}); bound the variables in "
                "it, or give points and values as a Table."
            )
        ranges.append((float(lower), float(upper)))

    extra = [function._fcn_id] if isinstance(function, PythonCallbackFunction) else []  # noqa: SLF001

    def call(*numbers: float) -> float:
        try:
            return float(function.evaluate([*numbers, *extra]))
        except Exception as error:
            at = ", ".join(f"{number:g}" for number in numbers)
            raise TranscriptionError(
                f"{name} in {owner}: its function fails at {at} ({raised(error)}), between the "
                "bounds of its arguments; tighten them, or let it have a value there."
            ) from error

    # More samples are taken until the relative error of the spline is at most 1e-7.
    for count in _SAMPLES[len(ranges)]:
        points = [np.linspace(lower, upper, count) for lower, upper in ranges]
        values = _on_grid(call, points)
        if not np.all(np.isfinite(values)):
            raise TranscriptionError(
                f"{name} in {owner}: its function is not finite everywhere between the bounds of "
                "its arguments; tighten them."
            )
        spline = Spline.through(points, values, _QUINTIC)
        miss = _largest_difference(call, spline, float(np.abs(values).max(initial=0.0)))
        if miss <= _ACCURACY:
            return spline
    raise TranscriptionError(
        f"{name} in {owner}: a smooth interpolant through {count} samples of each argument has a "
        f"relative error of {miss:.1e}; give points of the function, with its bends, as a Table."
    )


def _on_grid(call: Callable[..., float], points: Sequence[FloatArray]) -> FloatArray:
    """Return a function's values on a grid, with one array axis per argument of the function."""
    values = [call(*numbers) for numbers in product(*(at.tolist() for at in points))]
    return np.array(values).reshape([at.size for at in points])


def _largest_difference(call: Callable[..., float], spline: Spline, size: float) -> float:
    """Return the largest difference between a function and its spline, relative to `size`.

    It is taken over 40 random points in the range of the spline. A `size` of 0 counts as 1.
    """
    generator = np.random.default_rng(seed=0)
    lower, upper = np.transpose(spline.ranges)
    places = generator.uniform(lower, upper, (_COMPARED, len(spline.ranges)))
    misses = [abs(float(spline.function(at)[0]) - call(*at.tolist())) for at in places]
    return max(misses) / (size or 1.0)
