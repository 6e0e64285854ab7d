"""Merging of equal terms in equations and derivatives, without writing out data of tables.

CasADi differentiates column after column, so that a Jacobian or Hessian contains many terms more
than once. The function `casadi.cse` merges equal terms, and leaves every result the same to the
last bit. It would, however, write out the whole table of each call of an interpolation table. This
takes a second for a table of a million numbers.

Symbols therefore replace the results of these calls while equal terms are merged. Differentiation
treats the symbols as constants. This is correct, because the results are Taylor coefficients, which
count as constants (see `collocation.reading.local_splines`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Self

import casadi

from pyomo_quad.collocation.reading.local_splines import CALLED

if TYPE_CHECKING:
    from collections.abc import Sequence


@dataclass(frozen=True, kw_only=True)
class WithoutCalls:
    """Column of CasADi expressions in which symbols replace the calls of interpolation tables.

    With symbols in place of the calls, `casadi.cse` can merge equal terms of the expressions and of
    their derivatives, without writing out the data of the tables. If the expressions also call
    another function, no call is replaced.

    Attributes
    ----------
    rows : casadi.SX
        The expressions. Each term occurs once, unless the expressions call another function.
    calls : tuple of (casadi.SX, casadi.Function, casadi.SX)
        For each call of a table: the symbols that stand for its result, the function that evaluates
        the table, and the arguments of the call. The calls are in the order of evaluation, because
        arguments may contain the symbols of earlier calls.
    """

    rows: Any
    calls: tuple[tuple[Any, Any, Any], ...]

    @classmethod
    def of(cls, rows: Any, inputs: Sequence[Any]) -> Self:
        """Replace each call of an interpolation table in a column of expressions by symbols.

        If the expressions also call another CasADi function, whose results have derivatives, they
        are returned unchanged.

        Parameters
        ----------
        rows : casadi.SX
            Dense column of expressions.
        inputs : sequence of casadi.SX
            Columns that together contain every symbol of the expressions.

        Returns
        -------
        WithoutCalls
            The expressions without calls, and the calls that the symbols replace.
        """
        function = casadi.Function("rows", list(inputs), [rows])
        steps = range(function.n_instructions())
        if not any(function.instruction_id(k) == casadi.OP_CALL for k in steps):
            return cls(rows=casadi.cse(rows), calls=())
        nodes, held = function.instructions_sx(), {}
        found, calls = casadi.SX(rows.shape[0], 1), []
        for k in steps:
            operation, at = function.instruction_id(k), function.instruction_input(k)
            to = function.instruction_output(k)
            if operation == casadi.OP_INPUT:
                held[to[0]] = inputs[at[0]].nz[at[1]]
            elif operation == casadi.OP_OUTPUT:
                found[to[1]] = held[at[0]]
            elif operation == casadi.OP_CONST:
                held[to[0]] = casadi.SX(function.instruction_constant(k))
            elif operation == casadi.OP_CALL:
                called = nodes[k].which_function()
                results = casadi.SX.sym(f"result_{k}", len(to))
                arguments = casadi.vertcat(*[held[place] for place in at])
                if called.name() != CALLED:
                    # The results of any other function have derivatives.
                    return cls(rows=rows, calls=())
                calls.append((results, called, arguments))
                held |= dict(zip(to, casadi.vertsplit(results), strict=True))
            elif len(at) == 1:
                held[to[0]] = casadi.SX.unary(operation, held[at[0]])
            else:
                held[to[0]] = casadi.SX.binary(operation, held[at[0]], held[at[1]])
        return cls(rows=casadi.cse(found), calls=tuple(calls))

    def merged(self, column: Any) -> Any:
        """Merge equal terms of a column of expressions, then insert calls of interpolation tables.

        Parameters
        ----------
        column : casadi.SX
            Expressions computed from this object's expressions (the attribute `rows`), such as the
            nonzeros of their Jacobian. Symbols stand for the results of calls.

        Returns
        -------
        casadi.SX
            The merged column, with the calls in place of these symbols.
        """
        return self.with_calls(casadi.cse(column))

    def with_calls(self, column: Any) -> Any:
        """Insert calls of interpolation tables in place of the symbols that stand for them.

        `column` is a column of expressions computed from this object's expressions.
        """
        found = column
        for results, called, arguments in reversed(self.calls):
            found = casadi.substitute(found, results, called(arguments))
        return found
