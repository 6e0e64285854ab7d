"""Merging of equal terms in equations and derivatives, without writing out data of tables.

CasADi differentiates column after column, so that a Jacobian or Hessian contains many terms more
than once. The function `casadi.cse` merges them, and leaves every result the same to the last bit.
It would, however, write out the whole table of each interpolation: a second for a million numbers.
Symbols therefore replace the results of tables while terms are merged. Differentiation treats these
symbols as constants. This is correct, because the derivatives of the results are defined as zero:
see `collocation.reading.local_splines`.
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

    If the expressions also call another CasADi function, no call is replaced, and equal terms of
    `rows` are not merged.

    Attributes
    ----------
    rows : casadi.SX
        The expressions.
    calls : tuple of (casadi.SX, casadi.Function, casadi.SX)
        For each call of a table: symbols of its result, function, and arguments, which may contain
        symbols of earlier calls.
    """

    rows: Any
    calls: tuple[tuple[Any, Any, Any], ...]

    @classmethod
    def of(cls, rows: Any, inputs: Sequence[Any]) -> Self:
        """Replace each call of an interpolation table in a dense column of expressions by symbols.

        `inputs` are columns that together contain every symbol of the expressions.
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
            Expressions computed from the attribute `rows`, such as the nonzeros of its Jacobian.

        Returns
        -------
        casadi.SX
            The merged column, in which calls replace the symbols.
        """
        return self.with_calls(casadi.cse(column))

    def with_calls(self, column: Any) -> Any:
        """Insert calls of interpolation tables in place of the symbols that stand for them.

        `column` holds expressions computed from the attribute `rows`.
        """
        found = column
        for results, called, arguments in reversed(self.calls):
            found = casadi.substitute(found, results, called(arguments))
        return found
