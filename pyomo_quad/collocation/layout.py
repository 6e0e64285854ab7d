"""Where each quantity of a mesh sits in the vector of unknowns.

The unknowns are the states at the first node, then point by point the states and the
algebraic variables, then the static variables.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from pyomo_quad.collocation.nodes import FloatArray, interpolation_matrix, radau_rule

if TYPE_CHECKING:
    from pyomo_quad.collocation.declarations import Declarations, PointSymbol
    from pyomo_quad.collocation.mesh import Mesh

__all__ = ["Layout"]

IndexArray = NDArray[np.intp]


@dataclass(frozen=True)
class Layout:
    """Index arithmetic of the unknowns on one mesh (None: a model without time)."""

    declared: Declarations
    mesh: Mesh | None

    @property
    def points(self) -> int:
        """Number of collocation points."""
        return self.mesh.points if self.mesh else 0

    @property
    def n_states(self) -> int:
        """Number of states."""
        return len(self.declared.states)

    @property
    def n_algebraics(self) -> int:
        """Number of algebraic variables."""
        return len(self.declared.algebraics)

    @property
    def n_statics(self) -> int:
        """Number of static variables."""
        return len(self.declared.statics)

    @cached_property
    def state_columns(self) -> IndexArray:
        """Columns of the states at the nodes, shape (n_points + 1, n_states)."""
        if self.mesh is None:
            return np.zeros((0, 0), dtype=np.intp)
        stride = self.n_states + self.n_algebraics
        starts = np.concatenate(([0], self.n_states + stride * np.arange(self.points)))
        return (starts[:, None] + np.arange(self.n_states)[None, :]).astype(np.intp)

    @cached_property
    def algebraic_columns(self) -> IndexArray:
        """Columns of the algebraic variables at the points, shape (n_points, n_algebraics)."""
        if self.mesh is None:
            return np.zeros((0, 0), dtype=np.intp)
        stride = self.n_states + self.n_algebraics
        starts = 2 * self.n_states + stride * np.arange(self.points)
        return (starts[:, None] + np.arange(self.n_algebraics)[None, :]).astype(np.intp)

    @cached_property
    def static_columns(self) -> IndexArray:
        """Columns of the static variables, shape (n_statics,)."""
        first = self.unknowns - self.n_statics
        return np.arange(first, self.unknowns, dtype=np.intp)

    @property
    def unknowns(self) -> int:
        """Number of unknowns."""
        varying = 0
        if self.mesh is not None:
            varying = self.n_states + self.points * (self.n_states + self.n_algebraics)
        return varying + self.n_statics

    @cached_property
    def stencil(self) -> tuple[IndexArray, IndexArray, FloatArray]:
        """Points, nodes and weights of the slope of the states: rate = sum weight * state."""
        if self.mesh is None:
            empty = np.zeros(0, dtype=np.intp)
            return empty, empty, np.zeros(0)
        points, nodes, weights = [], [], []
        firsts, degrees = self.mesh.first_node, np.asarray(self.mesh.degrees)
        for degree in np.unique(degrees):
            chosen = np.flatnonzero(degrees == degree)
            slope = radau_rule(int(degree)).differentiation
            row, column = np.indices(slope.shape)
            points.append((firsts[chosen][:, None, None] + row).ravel())
            nodes.append((firsts[chosen][:, None, None] + column).ravel())
            weights.append((slope[None] / self.mesh.widths[chosen][:, None, None]).ravel())
        return np.concatenate(points), np.concatenate(nodes), np.concatenate(weights)

    @cached_property
    def slope_matrix(self) -> csr_matrix:
        """Matrix from states at the nodes to rates at the points."""
        points, nodes, weights = self.stencil
        return csr_matrix((weights, (points, nodes)), shape=(self.points, self.points + 1))

    @cached_property
    def point_values(self) -> csr_matrix:
        """Matrix from the unknowns to the values that conditions and objective mention."""
        rows: list[int] = []
        columns: list[int] = []
        weights: list[float] = []
        for row, symbol in enumerate(self.declared.point_symbols):
            found, factor = self._at_point(symbol)
            rows.extend([row] * len(found))
            columns.extend(found)
            weights.extend(factor)
        shape = (len(self.declared.point_symbols), self.unknowns)
        return csr_matrix((weights, (rows, columns)), shape=shape)

    def _at_point(self, symbol: PointSymbol) -> tuple[IndexArray, FloatArray]:
        """Return the unknowns and weights that give one point value."""
        if self.mesh is None:
            return np.zeros(0, dtype=np.intp), np.zeros(0)
        element = int(self.mesh.locate(np.array([symbol.fraction]))[0])
        first, degree = self.mesh.first_node[element], self.mesh.degrees[element]
        width = self.mesh.widths[element]
        rule = radau_rule(degree)
        local = np.array([(symbol.fraction - self.mesh.breakpoints[element]) / width])
        local = np.where(abs(local - np.rint(local)) < 1e-9, np.rint(local), local)
        names = [s.name for s in self.declared.states]
        if symbol.slot in names:
            columns = self.state_columns[first : first + degree + 1, names.index(symbol.slot)]
            if not symbol.is_rate:
                return _nonzero(columns, interpolation_matrix(rule.nodes, local)[0])
            slopes = np.vstack([rule.slope_at_start, rule.differentiation])
            at = interpolation_matrix(rule.nodes, local)[0] @ slopes
            return columns, at / width
        position = [s.name for s in self.declared.algebraics].index(symbol.slot)
        columns = self.algebraic_columns[first : first + degree, position]
        return _nonzero(columns, interpolation_matrix(rule.points, local)[0])


def _nonzero(columns: IndexArray, weights: FloatArray) -> tuple[IndexArray, FloatArray]:
    kept = weights != 0.0
    return columns[kept], weights[kept]
