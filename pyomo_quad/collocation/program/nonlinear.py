"""Nonlinear programs: their interface, bounds, scaling and multipliers, and their extension.

An `ExtendedProgram` is a program with more unknowns, more linear rows and quadratic costs. Elastic
programs, bounds between the points, damped controls and idle unknowns are such extensions.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pyomo_quad.collocation.mesh import FloatArray


_NONE: FloatArray = np.zeros(0)


@dataclass(frozen=True, kw_only=True)
class Bounds:
    """Lower and upper bounds of unknowns, shape (n,), and rows, shape (m,)."""

    lower: FloatArray
    upper: FloatArray
    row_lower: FloatArray
    row_upper: FloatArray

    @property
    def surplus(self) -> int:
        """Number of equations minus number of free unknowns."""
        equations = int(np.sum(self.row_lower == self.row_upper))
        return equations - int(np.sum(self.lower < self.upper))

    @property
    def sides(self) -> int:
        """Number of inequality bounds, those with an interior."""
        pairs = ((self.lower, self.upper), (self.row_lower, self.row_upper))
        return sum(
            int(np.count_nonzero(np.isfinite(side) & (lower < upper)))
            for lower, upper in pairs
            for side in (lower, upper)
        )

    def part(self, columns: Any, rows: Any) -> Bounds:
        """Return the bounds of chosen unknowns and rows."""
        return Bounds(
            lower=self.lower[columns],
            upper=self.upper[columns],
            row_lower=self.row_lower[rows],
            row_upper=self.row_upper[rows],
        )

    def extended(
        self,
        unknowns: tuple[FloatArray, FloatArray] = (_NONE, _NONE),
        rows: tuple[FloatArray, FloatArray] = (_NONE, _NONE),
    ) -> Bounds:
        """Return these bounds extended by the bounds of further unknowns and rows."""
        return Bounds(
            lower=np.append(self.lower, unknowns[0]),
            upper=np.append(self.upper, unknowns[1]),
            row_lower=np.append(self.row_lower, rows[0]),
            row_upper=np.append(self.row_upper, rows[1]),
        )


@dataclass(frozen=True, kw_only=True)
class Scaling:
    """Factors that multiply the objective, the unknowns and the rows."""

    objective: float
    unknowns: FloatArray
    rows: FloatArray

    @property
    def none(self) -> Scaling:
        """Return factors that are all 1."""
        return Scaling(
            objective=1.0, unknowns=np.ones_like(self.unknowns), rows=np.ones_like(self.rows)
        )

    def part(self, columns: Any, rows: Any) -> Scaling:
        """Return the factors of chosen unknowns and rows."""
        return replace(self, unknowns=self.unknowns[columns], rows=self.rows[rows])

    def extended(self, unknowns: int = 0, rows: FloatArray = _NONE) -> Scaling:
        """Return these factors followed by 1 for more unknowns, and by factors of more rows."""
        return replace(
            self,
            unknowns=np.append(self.unknowns, np.ones(unknowns)),
            rows=np.append(self.rows, rows),
        )


@dataclass(frozen=True, kw_only=True)
class Multipliers:
    """Multipliers of rows and of lower and upper bounds, for the unscaled program."""

    rows: FloatArray
    lower: FloatArray
    upper: FloatArray

    def part(self, columns: Any, rows: Any) -> Multipliers:
        """Return the multipliers of chosen unknowns and rows."""
        return Multipliers(
            rows=self.rows[rows], lower=self.lower[columns], upper=self.upper[columns]
        )

    def extended(self, unknowns: int = 0, rows: int = 0) -> Multipliers:
        """Return these multipliers followed by zeros for more unknowns and more rows."""
        return Multipliers(
            rows=np.append(self.rows, np.zeros(rows)),
            lower=np.append(self.lower, np.zeros(unknowns)),
            upper=np.append(self.upper, np.zeros(unknowns)),
        )


class NonlinearProgram(Protocol):
    """Interface of a program that Ipopt solves, including its progress callback."""

    @property
    def n_rows(self) -> int:
        """Number of rows."""

    @property
    def n_points(self) -> int:
        """Number of collocation points."""

    @property
    def is_negated(self) -> bool:
        """Whether the declared objective is maximised, and its negative minimised."""

    def objective(self, z: FloatArray) -> float:
        """Return the objective to minimise."""

    def gradient(self, z: FloatArray) -> FloatArray:
        """Return the gradient of the objective to minimise."""

    def constraints(self, z: FloatArray) -> FloatArray:
        """Return the value of every row."""

    def jacobianstructure(self) -> tuple[Any, Any]:
        """Return rows and columns of the Jacobian's nonzeros."""

    def jacobian(self, z: FloatArray) -> FloatArray:
        """Return the Jacobian's nonzeros."""

    def hessianstructure(self) -> tuple[Any, Any]:
        """Return rows and columns of the Lagrangian Hessian's lower triangle."""

    def hessian(self, z: FloatArray, multipliers: FloatArray, factor: float) -> FloatArray:
        """Return the nonzeros of the Hessian of factor * objective + multipliers . rows."""


def _no_columns() -> NDArray[np.intp]:
    return np.zeros(0, dtype=np.intp)


@dataclass(frozen=True, kw_only=True)
class ExtendedProgram:
    """A program of unknowns z as a program of unknowns w = (z, more unknowns s).

    It minimises ``share f(z) + prices . s + weights / 2 . (w[columns] - near)**2``. Its rows are
    the rows of the program, then rows of zero, plus ``terms @ w``.

    Attributes
    ----------
    program : NonlinearProgram
        The program with the objective f.
    share : float
        Weight of the program's objective; 0 leaves it out.
    prices : ndarray, shape (n_more,)
        Cost of each additional unknown.
    columns, weights, near : ndarray
        Unknowns with a quadratic cost, each listed once; its weight, and the value without cost.
    terms : csr_array, shape (n_rows + n_more_rows, n + n_more), optional
        Linear terms of all rows, with no entry where the program's own Jacobian has one.
    """

    program: Any
    share: float = 1.0
    prices: FloatArray = field(default_factory=lambda: _NONE)
    columns: NDArray[np.intp] = field(default_factory=_no_columns)
    weights: FloatArray = field(default_factory=lambda: _NONE)
    near: FloatArray = field(default_factory=lambda: _NONE)
    terms: Any = None

    @property
    def n_rows(self) -> int:
        """Number of rows."""
        return int(self.program.n_rows if self.terms is None else self.terms.shape[0])

    @property
    def n_points(self) -> int:
        """Number of collocation points."""
        return int(self.program.n_points)

    @property
    def is_negated(self) -> bool:
        """Whether the program is a maximisation; without its objective it never is."""
        return bool(self.share and self.program.is_negated)

    def split(self, w: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the program's unknowns, and the additional ones."""
        own = w.size - self.prices.size
        return w[:own], w[own:]

    def objective(self, w: FloatArray) -> float:
        """Return the objective to minimise."""
        z, more = self.split(w)
        own = self.share * self.program.objective(z) if self.share else 0.0
        away = w[self.columns] - self.near
        return own + float(self.prices @ more + 0.5 * (self.weights @ away**2))

    def gradient(self, w: FloatArray) -> FloatArray:
        """Return the gradient of the objective to minimise."""
        z, _ = self.split(w)
        own = self.share * self.program.gradient(z) if self.share else np.zeros(z.size)
        gradient = np.append(own, self.prices)
        gradient[self.columns] += self.weights * (w[self.columns] - self.near)
        return gradient

    def constraints(self, w: FloatArray) -> FloatArray:
        """Return the value of every row."""
        own = self.program.constraints(self.split(w)[0])
        if self.terms is None:
            return np.asarray(own)
        values = self.terms @ w
        values[: own.size] += own
        return np.asarray(values)

    def jacobianstructure(self) -> tuple[Any, Any]:
        """Return rows and columns of the Jacobian's nonzeros."""
        own = self.program.jacobianstructure()
        if self.terms is None:
            return own
        more = self.terms.tocoo()
        return np.append(own[0], more.row), np.append(own[1], more.col)

    def jacobian(self, w: FloatArray) -> FloatArray:
        """Return the Jacobian's nonzeros."""
        own = self.program.jacobian(self.split(w)[0])
        return np.asarray(own if self.terms is None else np.append(own, self.terms.data))

    def hessianstructure(self) -> tuple[Any, Any]:
        """Return rows and columns of the Lagrangian Hessian's lower triangle."""
        rows, columns = self.program.hessianstructure()
        return np.append(rows, self.columns), np.append(columns, self.columns)

    def hessian(self, w: FloatArray, multipliers: FloatArray, factor: float) -> FloatArray:
        """Return the nonzeros of the Lagrangian's Hessian; linear rows add nothing."""
        own = multipliers[: self.program.n_rows]
        held = self.program.hessian(self.split(w)[0], own, self.share * factor)
        return np.append(held, factor * self.weights)
