"""Pyomo expressions rewritten as CasADi expressions, leaf by leaf."""

from __future__ import annotations

import operator
from functools import reduce
from typing import TYPE_CHECKING, Any

import casadi
import numpy as np
from pyomo.core.base.units_container import _PyomoUnit
from pyomo.core.expr import numeric_expr
from pyomo.core.expr.numvalue import native_types
from pyomo.core.expr.visitor import StreamBasedExpressionVisitor

from pyomo_quad.collocation.errors import TranscriptionError

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = ["ExpressionWriter", "same_expression", "symbol_names"]

# Points at which two expressions must agree to be the same.
_COMPARED = 5

_UNARY: dict[str, Callable[[Any], Any]] = {
    "sin": casadi.sin,
    "cos": casadi.cos,
    "tan": casadi.tan,
    "asin": casadi.asin,
    "acos": casadi.acos,
    "atan": casadi.atan,
    "sinh": casadi.sinh,
    "cosh": casadi.cosh,
    "tanh": casadi.tanh,
    "asinh": casadi.asinh,
    "acosh": casadi.acosh,
    "atanh": casadi.atanh,
    "exp": casadi.exp,
    "log": casadi.log,
    "log10": casadi.log10,
    "sqrt": casadi.sqrt,
}


def _sum(*terms: Any) -> Any:
    return reduce(operator.add, terms)


_OPERATIONS: tuple[tuple[Any, Callable[..., Any]], ...] = (
    (numeric_expr.ProductExpression, operator.mul),
    (numeric_expr.SumExpression, _sum),
    (numeric_expr.LinearExpression, _sum),
    (numeric_expr.PowExpression, operator.pow),
    (numeric_expr.NegationExpression, operator.neg),
    (numeric_expr.DivisionExpression, operator.truediv),
    (numeric_expr.AbsExpression, casadi.fabs),
)


class ExpressionWriter:
    """Rewrite Pyomo expressions in CasADi symbols that a leaf function chooses.

    Parameters
    ----------
    leaf : callable
        Takes a Pyomo variable or mutable parameter (data object) and returns its symbol.
    named : callable, optional
        Takes a named expression and returns what to write instead of its own expression: a
        CasADi symbol, another Pyomo expression, or None to keep it.

    Notes
    -----
    A named expression is written once and shared afterwards, so the work grows with the
    text of the model and not with how often an expression is used.
    """

    def __init__(
        self, leaf: Callable[[Any], Any], named: Callable[[Any], Any] | None = None
    ) -> None:
        self._leaf = leaf
        self._replace = named or (lambda _expression: None)
        self._named: dict[int, Any] = {}
        self._owner = ""
        self._visitor = StreamBasedExpressionVisitor(
            beforeChild=self._before_child,
            exitNode=self._exit_node,
            initializeWalker=self._initialize,
        )

    def write(self, expression: Any, owner: str) -> Any:
        """Return the CasADi expression of a Pyomo expression (or number).

        Raises
        ------
        TranscriptionError
            If the expression holds something that has no smooth CasADi counterpart.
        """
        self._owner = owner
        return self._visitor.walk_expression(expression)

    def _initialize(self, expression: Any) -> tuple[bool, Any]:
        go_on, value = self._before_child(None, expression, 0)
        return go_on, expression if go_on else value

    def _before_child(self, _parent: Any, child: Any, _index: int) -> tuple[bool, Any]:
        if child.__class__ in native_types:
            return False, child
        if not child.is_expression_type():
            if isinstance(child, _PyomoUnit):
                return False, 1.0
            return False, self._leaf(child)
        if isinstance(child, numeric_expr.Expr_ifExpression):
            raise self._unsupported("Expr_if")
        if not child.is_named_expression_type():
            return True, None
        if id(child) not in self._named:
            replacement = self._replace(child)
            if replacement is None:
                return True, None
            if not isinstance(replacement, casadi.SX):
                replacement = self._visitor.walk_expression(replacement)
            self._named[id(child)] = replacement
        return False, self._named[id(child)]

    def _exit_node(self, node: Any, arguments: list[Any]) -> Any:
        if node.is_named_expression_type():
            self._named[id(node)] = arguments[0]
            return arguments[0]
        return self._apply(node, arguments)

    def apply(self, node: Any, arguments: list[Any], owner: str) -> Any:
        """Return the CasADi expression of an operation on arguments that are written already."""
        self._owner = owner
        return self._apply(node, arguments)

    def _apply(self, node: Any, arguments: list[Any]) -> Any:
        for kind, operation in _OPERATIONS:
            if isinstance(node, kind):
                return operation(*arguments)
        if isinstance(node, numeric_expr.UnaryFunctionExpression) and node.name in _UNARY:
            return _UNARY[node.name](arguments[0])
        is_function = isinstance(node, numeric_expr.UnaryFunctionExpression)
        raise self._unsupported(node.name if is_function else type(node).__name__)

    def _unsupported(self, what: str) -> TranscriptionError:
        return TranscriptionError(
            f"{self._owner}: {what} is not supported; write it with smooth functions (for a "
            "switch: a tanh or sqrt smoothing)."
        )


def same_expression(first: Any, second: Any) -> bool:
    """Say whether two CasADi expressions are the same function of the same symbols.

    Constants may have been folded in one of them, so that trees that differ are compared by
    their values at a few points.
    """
    first, second = casadi.SX(first), casadi.SX(second)
    if casadi.is_equal(first, second, 1_000_000):
        return True
    symbols = casadi.symvar(casadi.vertcat(first, second))
    both = casadi.Function("both", [casadi.vertcat(casadi.SX(0, 1), *symbols)], [first, second])
    points = np.random.default_rng(seed=0).uniform(0.1, 0.9, (_COMPARED, len(symbols)))
    values = np.array([[float(v) for v in both(point)] for point in points])
    return bool(np.allclose(values[:, 0], values[:, 1], rtol=1e-9, atol=1e-12, equal_nan=True))


def symbol_names(expression: Any) -> frozenset[str]:
    """Return the names of the symbols in a CasADi expression."""
    return frozenset(s.name() for s in casadi.symvar(casadi.SX(expression)))
