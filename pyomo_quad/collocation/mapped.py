"""CasADi functions evaluated at many points at once, on NumPy's own memory."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from pyomo_quad.collocation.nodes import FloatArray

__all__ = ["MappedFunction"]


class MappedFunction:
    """One function of one point, mapped over `n` points without copying.

    Parameters
    ----------
    function : casadi.Function
        Dense column inputs, dense column outputs.
    n : int
        Number of points.
    """

    def __init__(self, function: Any, n: int) -> None:
        self._function = function.map(n) if n != 1 else function
        self._shapes = [(n, function.numel_out(k)) for k in range(function.n_out())]
        self._buffer, self._trigger = self._function.buffer()

    def __call__(self, *inputs: FloatArray) -> list[FloatArray]:
        """Return each output as an array of shape (n, rows); inputs are (n, columns)."""
        outputs = [np.zeros(shape) for shape in self._shapes]
        held = [np.ascontiguousarray(array, dtype=float) for array in inputs]
        for k, array in enumerate(held):
            if array.size:
                self._buffer.set_arg(k, array.data)
        for k, array in enumerate(outputs):
            if array.size:
                self._buffer.set_res(k, array.data)
        self._trigger()
        return outputs
