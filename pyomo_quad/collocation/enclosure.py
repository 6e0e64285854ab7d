"""Enclosures of expressions over boxes of variables, by interval arithmetic.

An enclosure is an interval that contains all values of an expression, apart from rounding errors.
A box is a set of intervals, one for each variable. Each elementary operation of an expression is
evaluated on the bounds of its arguments, for many boxes at once (Moore, Interval Analysis, 1966).
The bounds are rounded to nearest, not outwards. The rounding errors are about 1e-14 times the
largest magnitude of the values.
"""

from __future__ import annotations

from functools import reduce
from typing import TYPE_CHECKING, Any

import casadi
import numpy as np
from numpy.typing import NDArray

from pyomo_quad.collocation.errors import TranscriptionError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import ArrayLike

FloatArray = NDArray[np.float64]
Interval = tuple[FloatArray, FloatArray]


def _number(value: float) -> Interval:
    """Return the interval that contains a single number only."""
    both = np.array(value)
    return both, both


def _product(a: Interval, b: Interval) -> Interval:
    """Return the interval of all products x * y, with x in the interval a and y in b."""
    # Most factors are constants; the two ends of a constant interval are the same array.
    ours, theirs = (ends[:1] if ends[0] is ends[1] else ends for ends in (a, b))
    corners = [x * y for x in ours for y in theirs]
    low = reduce(np.minimum, corners)
    if np.isnan(low).any():
        # 0 * inf is NaN; the product is 0, because the zero factor is exact.
        corners = [np.where(np.isnan(corner), 0.0, corner) for corner in corners]
        low = reduce(np.minimum, corners)
    return low, low if len(corners) == 1 else reduce(np.maximum, corners)


def _inverse(a: Interval) -> Interval:
    """Return the interval of 1 / x for all x in the interval a.

    The result is the whole real line if the interval contains 0.
    """
    low, high = a
    holds_nought = (low <= 0.0) & (high >= 0.0)
    with np.errstate(divide="ignore"):
        return (
            np.where(holds_nought, -np.inf, 1.0 / high),
            np.where(holds_nought, np.inf, 1.0 / low),
        )


def _square(a: Interval) -> Interval:
    """Return the interval of x^2 for all x in the interval a."""
    low, high = np.abs(a[0]), np.abs(a[1])
    spans = (a[0] < 0.0) & (a[1] > 0.0)
    return np.where(spans, 0.0, np.minimum(low, high) ** 2), np.maximum(low, high) ** 2


def _difference(a: Interval, b: Interval) -> Interval:
    """Return the interval of all differences x - y, with x in the interval a and y in b."""
    return a[0] - b[1], a[1] - b[0]


def _root(a: Interval) -> Interval:
    """Return the interval of sqrt(x) for all x >= 0 in the interval a."""
    return np.sqrt(np.maximum(a[0], 0.0)), np.sqrt(np.maximum(a[1], 0.0))


_OPERATIONS: dict[int, Callable[..., Interval]] = {
    casadi.OP_ADD: lambda a, b: (a[0] + b[0], a[1] + b[1]),
    casadi.OP_SUB: _difference,
    casadi.OP_MUL: _product,
    casadi.OP_DIV: lambda a, b: _product(a, _inverse(b)),
    casadi.OP_INV: _inverse,
    casadi.OP_NEG: lambda a: (-a[1], -a[0]),
    casadi.OP_TWICE: lambda a: (2.0 * a[0], 2.0 * a[1]),
    casadi.OP_SQ: _square,
    casadi.OP_SQRT: _root,
}


def symbols(*names: str) -> list[Any]:
    """Return scalar CasADi symbols with the given names, to write expressions with.

    For example, `Dynamics.expressions` replaces the variables of a model by such symbols, and
    returns components of the model as expressions. `Enclosure` bounds expressions over intervals of
    the symbols.

    Parameters
    ----------
    *names : str
        Names of the symbols.

    Returns
    -------
    list of casadi.SX
        One symbol for each name.

    Examples
    --------
    Bound x * y and its derivative with respect to x, for x between 1 and 2 and y = 3:

    >>> import numpy as np
    >>> x, y = symbols("x", "y")
    >>> product = Enclosure([x * y], [x], [y])
    >>> (low, high), slope = product.over(np.array([[1.0]]), np.array([[2.0]]), [3.0])
    >>> bool(low[0, 0] <= 3.0), bool(high[0, 0] >= 6.0)
    (True, True)
    """
    return [casadi.SX.sym(name) for name in names]


class Enclosure:
    """Lower and upper bounds of expressions, and of one gradient, over boxes of variables.

    The gradient is that of the first expression with respect to the variables. The square root of a
    negative number counts as 0.

    Parameters
    ----------
    expressions : sequence of casadi.SX
        CasADi expressions, for example those that `Dynamics.expressions` returns.
    variables : sequence of casadi.SX
        Symbols in the expressions that range over intervals.
    numbers : sequence of casadi.SX
        Symbols in the expressions that have single values.

    Raises
    ------
    TranscriptionError
        If the expressions contain an operation that this interval arithmetic does not implement.
    """

    def __init__(
        self, expressions: Sequence[Any], variables: Sequence[Any], numbers: Sequence[Any]
    ) -> None:
        columns = casadi.vertcat(*variables), casadi.vertcat(*numbers)
        values = casadi.densify(casadi.vertcat(*expressions))
        slopes = casadi.densify(casadi.gradient(expressions[0], columns[0]))
        self._values = _Steps(casadi.Function("values", list(columns), [values]))
        self._all = _Steps(casadi.Function("enclosed", list(columns), [values, slopes]))

    def over(self, low: FloatArray, high: FloatArray, numbers: ArrayLike) -> tuple[Interval, ...]:
        """Return bounds of the expressions, and of the first expression's gradient, over n boxes.

        The gradient is taken with respect to the variables, the symbols that range over intervals.

        Parameters
        ----------
        low, high : ndarray, shape (n_variables, n)
            Lower and upper ends of the variables' intervals, one column for each box. A box with
            equal ends is a point.
        numbers : array_like, shape (n_numbers,)
            Values of the symbols with single values.

        Returns
        -------
        (ndarray, ndarray), (ndarray, ndarray)
            Lower and upper bounds of the expressions, shape (n_expressions, n) each. Then lower and
            upper bounds of the gradient, shape (n_variables, n) each.
        """
        return self._all.over(low, high, numbers)

    def values_over(self, low: FloatArray, high: FloatArray, numbers: ArrayLike) -> Interval:
        """Return lower and upper bounds of the expressions over n boxes, without the gradient.

        The arguments are those of `over`, and the cost is lower. Both bounds have shape
        (n_expressions, n).
        """
        return self._values.over(low, high, numbers)[0]

    def at(self, points: FloatArray, numbers: ArrayLike) -> FloatArray:
        """Return the values of the expressions at n points.

        Parameters
        ----------
        points : ndarray, shape (n_variables, n)
            Values of the variables at each point.
        numbers : array_like, shape (n_numbers,)
            Values of the symbols with single values.

        Returns
        -------
        ndarray, shape (n_expressions, n)
        """
        ((values, _),) = self._values.over(points, points, numbers)
        return values


class _Steps:
    """Elementary operations of a CasADi function, evaluated on intervals.

    The function has two inputs: the variables, which range over intervals, and the numbers, which
    have single values.
    """

    def __init__(self, function: Any) -> None:
        self._function = function
        self._sizes = [function.size1_out(k) for k in range(function.n_out())]
        self._steps = list(map(self._step, range(function.n_instructions())))

    def _step(self, k: int) -> tuple[int, list[int], list[int], float]:
        """Return operation `k`: CasADi's operation code, arguments, results, and a constant.

        Arguments and results are positions in CasADi's work array. A read input or a written output
        is given as [its number, position in it]. The constant is that of a constant operation,
        otherwise 0.
        """
        f = self._function
        operation = f.instruction_id(k)
        known = (*_OPERATIONS, casadi.OP_CONST, casadi.OP_INPUT, casadi.OP_OUTPUT)
        if operation not in known:
            raise TranscriptionError(
                f"enclosure: operation {operation} of CasADi has no interval arithmetic; write the "
                "expression with another function."
            )
        constant = f.instruction_constant(k) if operation == casadi.OP_CONST else 0.0
        return operation, f.instruction_input(k), f.instruction_output(k), constant

    def over(self, low: FloatArray, high: FloatArray, numbers: ArrayLike) -> tuple[Interval, ...]:
        """Return lower and upper bounds of each output over n boxes, shape (n_rows, n) each.

        Here n_rows is the number of elements of the output. The corners `low` and `high` of the
        boxes have shape (n_variables, n). The values `numbers` of the second input, shape
        (n_numbers,), are the same for all boxes.
        """
        given = np.asarray(numbers, dtype=float)
        held: dict[int, Interval] = {}
        outputs = [np.empty((2, size, low.shape[1])) for size in self._sizes]
        with np.errstate(invalid="ignore", over="ignore"):
            for operation, inputs, results, constant in self._steps:
                if operation == casadi.OP_OUTPUT:
                    for side, value in enumerate(held[inputs[0]]):
                        outputs[results[0]][side, results[1]] = value
                elif operation == casadi.OP_INPUT:
                    column, row = inputs
                    held[results[0]] = (low[row], high[row]) if column == 0 else _number(given[row])
                elif operation == casadi.OP_CONST:
                    held[results[0]] = _number(constant)
                else:
                    held[results[0]] = _OPERATIONS[operation](*(held[k] for k in inputs))
        return tuple((found[0], found[1]) for found in outputs)
