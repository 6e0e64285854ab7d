"""CasADi functions evaluated at many points at once, on NumPy's own memory."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from pyomo_quad.collocation.nodes import FloatArray

__all__ = ["MappedFunction"]


# Points evaluated in one call of CasADi: a map over more costs time and memory to set up.
_CHUNK = 512


class MappedFunction:
    """One function of one point, evaluated at `n` points without copying.

    Parameters
    ----------
    function : casadi.Function
        Dense column inputs, dense column outputs.
    n : int
        Number of points.
    """

    def __init__(self, function: Any, n: int) -> None:
        self._function, self._n = function, n
        self._shapes = [(n, function.numel_out(k)) for k in range(function.n_out())]
        self._chunks: list[tuple[int, int, Any, Any]] = []
        made: dict[int, Any] = {}
        for start in range(0, n, _CHUNK):
            size = min(_CHUNK, n - start)
            if size not in made:
                made[size] = (function if size == 1 else function.map(size)).buffer()
            self._chunks.append((start, start + size, *made[size]))

    def __reduce__(self) -> tuple[Any, ...]:
        """Let a copy have buffers of its own: CasADi's cannot be copied."""
        return type(self), (self._function, self._n)

    def __call__(self, *inputs: FloatArray) -> list[FloatArray]:
        """Return each output as an array of shape (n, rows); inputs are (n, columns)."""
        outputs = [np.zeros(shape) for shape in self._shapes]
        held = [np.ascontiguousarray(array, dtype=float) for array in inputs]
        for start, end, buffer, trigger in self._chunks:
            for k, array in enumerate(held):
                if array.size:
                    buffer.set_arg(k, array[start:end].data)
            for k, array in enumerate(outputs):
                if array.size:
                    buffer.set_res(k, array[start:end].data)
            trigger()
        return outputs
