"""Nonlinear programs (NLPs): interface, bounds, scaling, multipliers, and extension.

An `ExtendedProgram` adds unknowns, linear constraints and quadratic costs to a program. It serves
four purposes:

- penalised slacks in the constraints (elastic programs);
- constraints that impose bounds between the collocation points;
- a quadratic cost that keeps controls near given values (damping);
- idle unknowns, which keep Ipopt from treating a program as a square system.
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
    """Bounds of a nonlinear program: of n unknowns, and of m constraints ("rows").

    Attributes
    ----------
    lower, upper : ndarray, shape (n,)
        Bounds of the unknowns.
    row_lower, row_upper : ndarray, shape (m,)
        Lower and upper bounds of the constraints. They are equal for an equation. An absent bound
        is infinite.
    """

    lower: FloatArray
    upper: FloatArray
    row_lower: FloatArray
    row_upper: FloatArray

    @property
    def surplus(self) -> int:
        """Number of equations minus number of free unknowns (unknowns whose bounds differ)."""
        equations = int(np.sum(self.row_lower == self.row_upper))
        return equations - int(np.sum(self.lower < self.upper))

    @property
    def sides(self) -> int:
        """Number of finite inequality bounds, where lower and upper bound differ."""
        pairs = ((self.lower, self.upper), (self.row_lower, self.row_upper))
        return sum(
            int(np.count_nonzero(np.isfinite(side) & (lower < upper)))
            for lower, upper in pairs
            for side in (lower, upper)
        )

    def part(self, columns: Any, rows: Any) -> Bounds:
        """Return the bounds of chosen unknowns and constraints.

        `columns` are the positions of the unknowns (indices or a slice), `rows` those of the
        constraints.
        """
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
        """Return these bounds, followed by bounds of additional unknowns and constraints ("rows").

        `unknowns` and `rows` are pairs of arrays: lower bounds, upper bounds.
        """
        return Bounds(
            lower=np.append(self.lower, unknowns[0]),
            upper=np.append(self.upper, unknowns[1]),
            row_lower=np.append(self.row_lower, rows[0]),
            row_upper=np.append(self.row_upper, rows[1]),
        )


@dataclass(frozen=True, kw_only=True)
class Scaling:
    """Scaling of a nonlinear program: factors of the objective, the unknowns and the constraints.

    Attributes
    ----------
    objective : float
        Factor of the objective.
    unknowns : ndarray, shape (n_unknowns,)
        Inverse magnitudes of the unknowns.
    rows : ndarray, shape (n_rows,)
        Factors of the constraints.
    """

    objective: float
    unknowns: FloatArray
    rows: FloatArray

    @property
    def none(self) -> Scaling:
        """Scaling of the same program in which all factors are 1."""
        return Scaling(
            objective=1.0, unknowns=np.ones_like(self.unknowns), rows=np.ones_like(self.rows)
        )

    def part(self, columns: Any, rows: Any) -> Scaling:
        """Return the scaling of chosen unknowns and constraints; the objective keeps its factor.

        `columns` are the positions of the unknowns (indices or a slice), `rows` those of the
        constraints.
        """
        return replace(self, unknowns=self.unknowns[columns], rows=self.rows[rows])

    def extended(self, unknowns: int = 0, rows: FloatArray = _NONE) -> Scaling:
        """Return the scaling of a program with additional unknowns and constraints.

        `unknowns` is the number of additional unknowns, which have the factor 1; `rows` are the
        factors of the additional constraints.
        """
        return replace(
            self,
            unknowns=np.append(self.unknowns, np.ones(unknowns)),
            rows=np.append(self.rows, rows),
        )


@dataclass(frozen=True, kw_only=True)
class Multipliers:
    """Lagrange multipliers of constraints, lower and upper bounds, for the unscaled program.

    Attributes
    ----------
    rows : ndarray, shape (n_rows,)
        Multipliers of the constraints: positive where an upper bound is active, negative where a
        lower bound is active.
    lower, upper : ndarray, shape (n_unknowns,)
        Multipliers of the lower and of the upper bounds of the unknowns; none is negative.
    """

    rows: FloatArray
    lower: FloatArray
    upper: FloatArray

    def part(self, columns: Any, rows: Any) -> Multipliers:
        """Return the multipliers of chosen unknowns' bounds and of chosen constraints.

        `columns` are the positions of the unknowns (indices or a slice), `rows` those of the
        constraints.
        """
        return Multipliers(
            rows=self.rows[rows], lower=self.lower[columns], upper=self.upper[columns]
        )

    def extended(self, unknowns: int = 0, rows: int = 0) -> Multipliers:
        """Return these multipliers followed by zeros for more unknowns and more constraints.

        `unknowns` and `rows` are the numbers of additional unknowns and constraints.
        """
        return Multipliers(
            rows=np.append(self.rows, np.zeros(rows)),
            lower=np.append(self.lower, np.zeros(unknowns)),
            upper=np.append(self.upper, np.zeros(unknowns)),
        )


class NonlinearProgram(Protocol):
    """Interface of a nonlinear program, as Ipopt and its progress callback require it."""

    @property
    def n_rows(self) -> int:
        """Number of constraints."""

    @property
    def n_points(self) -> int:
        """Number of collocation points, for progress reports."""

    @property
    def is_negated(self) -> bool:
        """Whether the Pyomo model maximises its objective, so that the negative is minimised."""

    def objective(self, z: FloatArray) -> float:
        """Return the objective to minimise at the unknowns `z`."""

    def gradient(self, z: FloatArray) -> FloatArray:
        """Return the gradient of the objective to minimise at `z`, shape (n_unknowns,)."""

    def constraints(self, z: FloatArray) -> FloatArray:
        """Return the values of the constraints at the unknowns `z`, shape (n_rows,)."""

    def jacobianstructure(self) -> tuple[Any, Any]:
        """Return row and column indices of the nonzeros of the constraints' Jacobian."""

    def jacobian(self, z: FloatArray) -> FloatArray:
        """Return the nonzeros of the constraints' Jacobian at the unknowns `z`.

        Their order is that of `jacobianstructure`.
        """

    def hessianstructure(self) -> tuple[Any, Any]:
        """Return row and column indices of the nonzeros of the Lagrangian's Hessian.

        Only the lower triangle is given.
        """

    def hessian(self, z: FloatArray, multipliers: FloatArray, factor: float) -> FloatArray:
        """Return the nonzeros of the Hessian of factor * objective + multipliers . constraints.

        The nonzeros are those of the lower triangle at the unknowns `z`, in the order of
        `hessianstructure`. `multipliers` has one value per constraint.
        """


def _no_columns() -> NDArray[np.intp]:
    return np.zeros(0, dtype=np.intp)


@dataclass(frozen=True, kw_only=True)
class ExtendedProgram:
    """Nonlinear program with added unknowns s, linear terms in constraints, and quadratic costs.

    The unknowns are w = (z, s), with n unknowns z and n_more unknowns s. If `terms` has more rows
    than c, c counts as 0 in the last rows, the added constraints.

    - Objective: ``share * f(z) + prices @ s + sum(weights / 2 * (w[columns] - near)**2)``.
    - Constraints: ``c(z) + terms @ w``.

    Attributes
    ----------
    program : NonlinearProgram
        Original program: objective f and constraints c of z.
    share : float
    prices : ndarray, shape (n_more,)
    columns : ndarray of int, shape (k,)
    weights, near : ndarray, shape (k,)
    terms : csr_array, shape (n_rows + n_more_rows, n + n_more), optional
    """

    program: Any
    # 0 leaves the original objective out.
    share: float = 1.0
    prices: FloatArray = field(default_factory=lambda: _NONE)
    # Each listed once.
    columns: NDArray[np.intp] = field(default_factory=_no_columns)
    weights: FloatArray = field(default_factory=lambda: _NONE)
    near: FloatArray = field(default_factory=lambda: _NONE)
    # No entry may coincide with an entry of the original program's Jacobian.
    terms: Any = None

    @property
    def n_rows(self) -> int:
        """Number of constraints, including the added constraints."""
        return int(self.program.n_rows if self.terms is None else self.terms.shape[0])

    @property
    def n_points(self) -> int:
        """Number of collocation points of the original program."""
        return int(self.program.n_points)

    @property
    def is_negated(self) -> bool:
        """Whether the Pyomo model maximises its objective, so that the negative is minimised.

        The value is False if `share` is 0, which leaves the original objective out.
        """
        return bool(self.share and self.program.is_negated)

    def split(self, w: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Split all unknowns `w` into those of the original program and the added unknowns."""
        own = w.size - self.prices.size
        return w[:own], w[own:]

    def objective(self, w: FloatArray) -> float:
        """Return the objective to minimise at the unknowns `w`."""
        z, more = self.split(w)
        own = self.share * self.program.objective(z) if self.share else 0.0
        away = w[self.columns] - self.near
        return own + float(self.prices @ more + 0.5 * (self.weights @ away**2))

    def gradient(self, w: FloatArray) -> FloatArray:
        """Return the gradient of the objective to minimise at `w`, shape (n + n_more,)."""
        z, _ = self.split(w)
        own = self.share * self.program.gradient(z) if self.share else np.zeros(z.size)
        gradient = np.append(own, self.prices)
        gradient[self.columns] += self.weights * (w[self.columns] - self.near)
        return gradient

    def constraints(self, w: FloatArray) -> FloatArray:
        """Return the values of all constraints at the unknowns `w`, the added constraints last."""
        own = self.program.constraints(self.split(w)[0])
        if self.terms is None:
            return np.asarray(own)
        values = self.terms @ w
        values[: own.size] += own
        return np.asarray(values)

    def jacobianstructure(self) -> tuple[Any, Any]:
        """Return row and column indices of the nonzeros of the constraints' Jacobian."""
        own = self.program.jacobianstructure()
        if self.terms is None:
            return own
        more = self.terms.tocoo()
        return np.append(own[0], more.row), np.append(own[1], more.col)

    def jacobian(self, w: FloatArray) -> FloatArray:
        """Return the nonzeros of the constraints' Jacobian at the unknowns `w`.

        Their order is that of `jacobianstructure`.
        """
        own = self.program.jacobian(self.split(w)[0])
        return np.asarray(own if self.terms is None else np.append(own, self.terms.data))

    def hessianstructure(self) -> tuple[Any, Any]:
        """Return row and column indices of the nonzeros of the Lagrangian's Hessian.

        Only the lower triangle is given.
        """
        rows, columns = self.program.hessianstructure()
        return np.append(rows, self.columns), np.append(columns, self.columns)

    def hessian(self, w: FloatArray, multipliers: FloatArray, factor: float) -> FloatArray:
        """Return the nonzeros of the Hessian of factor * objective + multipliers . constraints.

        The nonzeros are those of the lower triangle at the unknowns `w`, in the order of
        `hessianstructure`. `multipliers` has one value per constraint.
        """
        # The added terms of the constraints are linear, without second derivatives.
        own = multipliers[: self.program.n_rows]
        held = self.program.hessian(self.split(w)[0], own, self.share * factor)
        return np.append(held, factor * self.weights)
