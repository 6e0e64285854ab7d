"""Sparse matrices whose entries are weighted sums of values computed elsewhere."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

if TYPE_CHECKING:
    from pyomo_quad.collocation.nodes import FloatArray

__all__ = ["Contributions", "Scatter"]

IndexArray = NDArray[np.intp]


class Contributions:
    """Collects entries (row, column) += weight * source until a `Scatter` is made of them."""

    def __init__(self) -> None:
        self._parts: list[tuple[IndexArray, IndexArray, IndexArray, FloatArray]] = []

    def add(
        self,
        rows: IndexArray,
        columns: IndexArray,
        sources: IndexArray,
        weights: FloatArray | float,
    ) -> None:
        """Add entries; the arrays broadcast against each other."""
        rows, columns, sources, weights = np.broadcast_arrays(rows, columns, sources, weights)
        self._parts.append((rows.ravel(), columns.ravel(), sources.ravel(), weights.ravel()))

    def scatter(self, n_columns: int, n_sources: int) -> Scatter:
        """Return the pattern and the map from sources to its values."""
        if not self._parts:
            empty = np.zeros(0, dtype=np.intp)
            return Scatter(rows=empty, columns=empty, matrix=csr_matrix((0, n_sources)))
        rows, columns, sources, weights = (
            np.concatenate([part[k] for part in self._parts]) for k in range(4)
        )
        keys, entries = np.unique(rows.astype(np.int64) * n_columns + columns, return_inverse=True)
        matrix = csr_matrix((weights, (entries, sources)), shape=(len(keys), n_sources))
        return Scatter(
            rows=(keys // n_columns).astype(np.intp),
            columns=(keys % n_columns).astype(np.intp),
            matrix=matrix,
        )


@dataclass(frozen=True, kw_only=True)
class Scatter:
    """A sparsity pattern and the matrix that takes source values to its nonzeros."""

    rows: IndexArray
    columns: IndexArray
    matrix: csr_matrix

    def values(self, sources: FloatArray) -> FloatArray:
        """Return the nonzeros for the given source values."""
        return np.asarray(self.matrix @ sources, dtype=float)
