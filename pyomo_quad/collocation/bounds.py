"""Bounds of the unknowns and of the rows of the nonlinear program."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pyomo_quad.collocation.errors import TranscriptionError
from pyomo_quad.collocation.mapped import MappedFunction
from pyomo_quad.collocation.naming import unknown_place

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pyomo_quad.collocation.compiled import CompiledModel
    from pyomo_quad.collocation.nodes import FloatArray
    from pyomo_quad.collocation.transcription import Transcription

__all__ = ["Bounds", "bounds_of"]


@dataclass(frozen=True, kw_only=True)
class Bounds:
    """Lower and upper bounds of unknowns, shape (n,), and rows, shape (m,)."""

    lower: FloatArray
    upper: FloatArray
    row_lower: FloatArray
    row_upper: FloatArray


def bounds_of(
    program: Transcription, start_data: FloatArray, fixed: dict[tuple[str, float], float]
) -> Bounds:
    """Evaluate all bounds for the current data.

    Parameters
    ----------
    program : Transcription
    start_data : ndarray, shape (1, n_data)
        Signals and parameters at the start of the horizon.
    fixed : dict
        Values fixed at declared times, by slot name and fraction.

    Raises
    ------
    TranscriptionError
        If a lower bound exceeds an upper bound; the message names the variable.
    """
    unknowns = _Unknowns(program)
    if program.mesh is not None:
        unknowns.limit_over_time(start_data)
        unknowns.fix(fixed)
    unknowns.limit_at_points()
    unknowns.refuse_crossed()
    row_lower, row_upper = _rows(program)
    return Bounds(
        lower=unknowns.lower, upper=unknowns.upper, row_lower=row_lower, row_upper=row_upper
    )


def _rows(program: Transcription) -> tuple[FloatArray, FloatArray]:
    compiled, data = program.compiled, program.data
    sides = []
    path: list[FloatArray] = [np.zeros(0), np.zeros(0)]
    if program.layout.points:
        mapped = MappedFunction(compiled.path_bounds, program.layout.points)
        path = [side.ravel() for side in mapped(data.at_points())]
    conditions = MappedFunction(compiled.condition_limits, 1)(data.parameters[None, :])
    for side, condition in zip(path, conditions, strict=True):
        definitions = np.zeros(len(compiled.static_of_integral))
        sides.append(np.concatenate([side, condition.ravel(), definitions]))
    return sides[0], sides[1]


class _Unknowns:
    """Tightens the bounds of the unknowns, one source after another."""

    def __init__(self, program: Transcription) -> None:
        self._program = program
        self._compiled: CompiledModel = program.compiled
        self._layout = program.layout
        self.lower = np.full(self._layout.unknowns, -np.inf)
        self.upper = np.full(self._layout.unknowns, np.inf)

    def limit_over_time(self, start_data: FloatArray) -> None:
        """Apply the bounds of variables and of single-variable path limits."""
        layout, n = self._layout, self._layout.n_states
        mapped = MappedFunction(self._compiled.variable_limits, layout.points + 1)
        data = np.vstack([start_data, self._program.data.at_points()])
        lower, upper, first, second = mapped(data)
        self._tighten(layout.state_columns, lower[:, :n], upper[:, :n])
        self._tighten(layout.algebraic_columns, lower[1:, n:], upper[1:, n:])
        states = [s.name for s in self._compiled.declared.states]
        algebraics = [s.name for s in self._compiled.declared.algebraics]
        for k, bound in enumerate(self._compiled.simple_path_bounds):
            if bound.variable in states:
                columns = layout.state_columns[:, states.index(bound.variable)]
                self._tighten_either(columns, first[:, k], second[:, k])
            else:
                columns = layout.algebraic_columns[:, algebraics.index(bound.variable)]
                self._tighten_either(columns, first[1:, k], second[1:, k])

    def fix(self, fixed: dict[tuple[str, float], float]) -> None:
        """Hold states at declared times; the fractions are element boundaries."""
        states = [s.name for s in self._compiled.declared.states]
        nodes = self._program.mesh.node_fractions if self._program.mesh else np.zeros(0)
        for (name, fraction), number in fixed.items():
            if name in states:
                node = int(np.argmin(np.abs(nodes - fraction)))
                column = self._layout.state_columns[node, states.index(name)]
                self.lower[column] = self.upper[column] = number

    def limit_at_points(self) -> None:
        """Apply conditions on one value and the bounds of static variables."""
        compiled, layout = self._compiled, self._layout
        parameters = self._program.data.parameters[None, :]
        names = [s.name for s in compiled.declared.statics]
        points = {p.symbol.name(): k for k, p in enumerate(compiled.declared.point_symbols)}
        lower, upper = MappedFunction(compiled.static_limits, 1)(parameters)
        self._tighten(layout.static_columns, lower[0], upper[0])
        first, second = MappedFunction(compiled.simple_point_limits, 1)(parameters)
        for k, bound in enumerate(compiled.simple_point_bounds):
            if bound.variable in points:
                row = points[bound.variable]
                columns = layout.point_values.indices[
                    layout.point_values.indptr[row] : layout.point_values.indptr[row + 1]
                ]
            else:
                columns = layout.static_columns[[names.index(bound.variable)]]
            self._tighten_either(columns, first[0, k], second[0, k])

    def _tighten_either(
        self, columns: NDArray[np.intp], first: FloatArray, second: FloatArray
    ) -> None:
        self._tighten(columns, np.minimum(first, second), np.maximum(first, second))

    def _tighten(self, columns: NDArray[np.intp], lower: FloatArray, upper: FloatArray) -> None:
        self.lower[columns] = np.maximum(self.lower[columns], lower)
        self.upper[columns] = np.minimum(self.upper[columns], upper)

    def refuse_crossed(self) -> None:
        """Raise if any bounds cross, naming the worst variable."""
        gap = self.lower - self.upper
        scale = 1e-9 * (1.0 + np.minimum(np.abs(self.lower), np.abs(self.upper)))
        close = (gap > 0.0) & (gap <= scale)
        self.upper[close] = self.lower[close]
        worst = int(np.argmax(self.lower - self.upper)) if gap.size else 0
        if gap.size and self.lower[worst] > self.upper[worst]:
            raise TranscriptionError(
                f"{unknown_place(self._program, worst)}: lower bound {self.lower[worst]:g} is "
                f"above upper bound {self.upper[worst]:g}; relax one of the two."
            )
