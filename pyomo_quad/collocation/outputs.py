"""Output states: solved for on the mesh once everything they read is known.

Their collocation equations are a square system, which Newton's method solves with the
exact sparse Jacobian.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import casadi
import numpy as np
from scipy.sparse import bsr_matrix, csr_matrix, identity, kron
from scipy.sparse.linalg import splu

from pyomo_quad.collocation.errors import SolveError
from pyomo_quad.collocation.mapped import MappedFunction

if TYPE_CHECKING:
    from pyomo_quad.collocation.compiled import CompiledModel
    from pyomo_quad.collocation.declarations import Declarations
    from pyomo_quad.collocation.layout import Layout
    from pyomo_quad.collocation.nodes import FloatArray

__all__ = ["OutputStates"]

_NEWTON_STEPS = 50
_NEWTON_TOLERANCE = 1e-13


class OutputStates:
    """Compiled equations of the output states."""

    def __init__(self, compiled: CompiledModel) -> None:
        declared = compiled.declared
        path_variables, path_data = compiled.symbols
        self._slots = declared.outputs
        rates = casadi.vertcat(casadi.SX(0, 1), *[s.rate for s in self._slots])
        states = casadi.vertcat(casadi.SX(0, 1), *[s.symbol for s in self._slots])
        rows = casadi.vertcat(casadi.SX(0, 1), *[e.expression for e in declared.output_equations])
        inputs = [rates, states, path_variables, path_data]
        self._residual = casadi.Function(
            "outputs",
            inputs,
            [
                casadi.densify(rows),
                casadi.densify(casadi.jacobian(rows, rates)),
                casadi.densify(casadi.jacobian(rows, states)),
            ],
        )
        self._starts = self._start_function(declared)

    def __len__(self) -> int:
        return len(self._slots)

    @staticmethod
    def _start_function(declared: Declarations) -> Any:
        """Return a function of the parameters: the start value of each output, or NaN."""
        parameters = casadi.vertcat(casadi.SX(0, 1), *[s.symbol for s in declared.parameters])
        values = []
        for slot in declared.outputs:
            found = casadi.SX(np.nan)
            for condition in declared.output_starts:
                for symbol in casadi.symvar(condition.expression):
                    if symbol.name().startswith(f"{slot.component}["):
                        slope = casadi.jacobian(condition.expression, symbol)
                        offset = casadi.substitute(condition.expression, symbol, casadi.SX(0))
                        found = (condition.lower - offset) / slope
            values.append(found)
        return casadi.Function(
            "output_starts", [parameters], [casadi.vertcat(casadi.SX(0, 1), *values)]
        )

    def start(self, parameters: FloatArray, fixed: dict[tuple[str, float], float]) -> FloatArray:
        """Return the values at the start of the horizon, shape (n_outputs,)."""
        held = np.asarray(self._starts(parameters)).ravel()
        return np.array(
            [fixed.get((s.name, 0.0), held[k]) for k, s in enumerate(self._slots)], dtype=float
        )

    def solve(
        self, layout: Layout, start: FloatArray, path_variables: FloatArray, data: FloatArray
    ) -> FloatArray:
        """Return the output states at the nodes, shape (n_points + 1, n_outputs).

        Raises
        ------
        SolveError
            If Newton's method does not converge.
        """
        n, points = len(self._slots), layout.points
        function = MappedFunction(self._residual, points)
        slope = kron(layout.slope_matrix[:, 1:], identity(n), format="csr")
        states = np.tile(start, (points + 1, 1))
        for _ in range(_NEWTON_STEPS):
            rates = layout.slope_matrix @ states
            rows, by_rate, by_state = function(rates, states[1:], path_variables, data)
            jacobian = self._blocks(by_rate, n) @ slope + self._blocks(by_state, n)
            step = splu(csr_matrix(jacobian).tocsc()).solve(rows.ravel()).reshape(points, n)
            states[1:] -= step
            if np.max(np.abs(step)) <= _NEWTON_TOLERANCE * (1.0 + np.max(np.abs(states))):
                return states
        names = ", ".join(s.name for s in self._slots)
        raise SolveError(
            f"{names}: Newton's method did not solve the equations of these output states; "
            "check their equations and start values."
        )

    @staticmethod
    def _blocks(values: FloatArray, n: int) -> csr_matrix:
        # CasADi stores a point's matrix by columns.
        matrices = values.reshape(-1, n, n).transpose(0, 2, 1)
        count = len(matrices)
        return bsr_matrix((matrices, np.arange(count), np.arange(count + 1))).tocsr()
