"""A program whose limits may be broken at a price: what infeasibility is measured by.

Every declaration that limits the optimum (inequalities over time, bounds, boundary
conditions) becomes a family with one slack: all its rows may be broken by that share of
their own magnitude.  Equalities over time, the physics, stay as they are.  The sum of the
slacks is minimised, an exact penalty that brings to zero what can be zero, and names the
few declarations that must give way where not all can be (Chinneck (2008), Feasibility and
Infeasibility in Optimization, chapter 6).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from pyomo_quad.collocation.errors import TranscriptionError
from pyomo_quad.collocation.naming import family_name

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from pyomo_quad.collocation.bounds import Bounds, Limit
    from pyomo_quad.collocation.nodes import FloatArray
    from pyomo_quad.collocation.scaling import Scaling
    from pyomo_quad.collocation.transcription import Transcription

__all__ = ["ElasticProgram", "SoftRows"]

# Weight of staying near the first point: it makes the unknowns that no slack depends on
# unique, and is too small to buy a slack.
_PROXIMITY = 1e-6


class _SoftRow(NamedTuple):
    family: str
    row: int
    column: int
    sign: float
    limit: float
    size: float


@dataclass(frozen=True, kw_only=True)
class SoftRows:
    """One-sided limits: sign * (value - limit) <= slack * size, one entry each.

    `row` is the program's row the value is of, or -1; then it is unknown `column`.
    """

    family: NDArray[np.intp]
    row: NDArray[np.intp]
    column: NDArray[np.intp]
    sign: FloatArray
    limit: FloatArray
    size: FloatArray
    names: tuple[str, ...]

    @classmethod
    def of(
        cls,
        program: Transcription,
        bounds: Bounds,
        scaling: Scaling,
        limits: list[Limit],
        families: frozenset[str] | None = None,
    ) -> SoftRows:
        """Collect the one-sided limits of chosen families, of all where None are chosen.

        Raises
        ------
        TranscriptionError
            If the families have no limits.
        """
        entries = [*_soft_unknowns(limits, scaling), *_soft_program_rows(program, bounds, scaling)]
        chosen = [
            entry
            for entry in entries
            if np.isfinite(entry.limit) and (families is None or entry.family in families)
        ]
        if not chosen:
            wanted = "the model" if families is None else ", ".join(sorted(families))
            raise TranscriptionError(f"{wanted}: has no limits that could give way.")
        names = sorted({entry.family for entry in chosen})
        limit = np.array([entry.limit for entry in chosen])
        return cls(
            family=np.array([names.index(entry.family) for entry in chosen]),
            row=np.array([entry.row for entry in chosen]),
            column=np.array([entry.column for entry in chosen]),
            sign=np.array([entry.sign for entry in chosen]),
            limit=limit,
            size=np.maximum(np.abs(limit), [entry.size for entry in chosen]),
            names=tuple(names),
        )

    def __len__(self) -> int:
        return len(self.family)


def _soft_unknowns(limits: list[Limit], scaling: Scaling) -> Iterator[_SoftRow]:
    for limit in limits:
        for k, column in enumerate(limit.columns):
            size = 1.0 / float(scaling.unknowns[column])
            for sign, bound in ((1.0, limit.upper[k]), (-1.0, limit.lower[k])):
                family = family_name(limit.name)
                yield _SoftRow(family, -1, int(column), sign, float(bound), size)


def _soft_program_rows(
    program: Transcription, bounds: Bounds, scaling: Scaling
) -> Iterator[_SoftRow]:
    equations = program.compiled.declared.equations
    rows = [
        (point * len(equations) + k, equation.name)
        for k, equation in enumerate(equations)
        if not equation.is_equality
        for point in range(program.layout.points)
    ]
    conditions = program.compiled.declared.conditions
    rows += [(program.first_condition_row + k, c.name) for k, c in enumerate(conditions)]
    for row, name in rows:
        size = 1.0 / float(scaling.rows[row])
        for sign, bound in ((1.0, bounds.row_upper[row]), (-1.0, bounds.row_lower[row])):
            yield _SoftRow(family_name(name), row, -1, sign, float(bound), size)


class ElasticProgram:
    """The elastic counterpart of a program, in the form Ipopt asks for.

    Unknowns are those of the program, then one slack per family.  Rows are the program's, of
    which the soft ones are free, then the soft rows.
    """

    def __init__(
        self, program: Transcription, soft: SoftRows, near: FloatArray, scale: FloatArray
    ) -> None:
        self.program = program
        self.soft = soft
        self._near, self._scale = near, scale
        self._n = near.size

    @property
    def n_rows(self) -> int:
        """Number of rows."""
        return self.program.n_rows + len(self.soft)

    @property
    def n_points(self) -> int:
        """Number of collocation points."""
        return self.program.n_points

    @property
    def is_negated(self) -> bool:
        """Say that slacks are minimised, whatever the program does."""
        return False

    def objective(self, z: FloatArray) -> float:
        """Return the sum of slacks, plus a trace of the distance from the first point."""
        moved = (z[: self._n] - self._near) * self._scale
        return float(z[self._n :].sum() + 0.5 * _PROXIMITY * moved @ moved / self._n)

    def gradient(self, z: FloatArray) -> FloatArray:
        """Return the gradient of the objective."""
        moved = (z[: self._n] - self._near) * self._scale**2
        return np.concatenate([_PROXIMITY * moved / self._n, np.ones(z.size - self._n)])

    def constraints(self, z: FloatArray) -> FloatArray:
        """Return the program's rows, then how far each soft row is beyond its slack."""
        rows = self.program.constraints(z[: self._n])
        soft = self.soft
        values = np.where(soft.row >= 0, rows[soft.row], z[soft.column])
        beyond = soft.sign * (values - soft.limit) / soft.size - z[self._n + soft.family]
        return np.concatenate([rows, beyond])

    @cached_property
    def _copies(self) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Entries of the program's Jacobian that soft rows copy, and the soft row of each."""
        rows, _ = self.program.jacobianstructure()
        order = np.argsort(rows, kind="stable")
        starts = np.searchsorted(rows[order], np.arange(self.program.n_rows + 1))
        entries, owners = [], []
        for k in np.flatnonzero(self.soft.row >= 0):
            r = self.soft.row[k]
            found = order[starts[r] : starts[r + 1]]
            entries.append(found)
            owners.append(np.full(found.size, k))
        empty = np.zeros(0, dtype=np.intp)
        return np.concatenate([empty, *entries]), np.concatenate([empty, *owners])

    def jacobianstructure(self) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Return rows and columns of the Jacobian's entries."""
        rows, columns = self.program.jacobianstructure()
        entries, owners = self._copies
        m = self.program.n_rows
        plain = np.flatnonzero(self.soft.row < 0)
        every = np.arange(len(self.soft))
        return (
            np.concatenate([rows, m + owners, m + plain, m + every]),
            np.concatenate(
                [columns, columns[entries], self.soft.column[plain], self._n + self.soft.family]
            ),
        )

    def jacobian(self, z: FloatArray) -> FloatArray:
        """Return the values of the Jacobian's entries."""
        soft, values = self.soft, self.program.jacobian(z[: self._n])
        entries, owners = self._copies
        factor = soft.sign / soft.size
        plain = factor[soft.row < 0]
        return np.concatenate(
            [values, values[entries] * factor[owners], plain, -np.ones(len(soft))]
        )

    def hessianstructure(self) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Return rows and columns of the Lagrangian's lower triangle."""
        rows, columns = self.program.hessianstructure()
        diagonal = np.arange(self._n)
        return np.concatenate([rows, diagonal]), np.concatenate([columns, diagonal])

    def hessian(self, z: FloatArray, multipliers: FloatArray, factor: float) -> FloatArray:
        """Return the values of the Lagrangian's lower triangle."""
        soft, m = self.soft, self.program.n_rows
        on_rows = np.array(multipliers[:m])
        held = soft.row >= 0
        weights = (multipliers[m:] * soft.sign / soft.size)[held]
        np.add.at(on_rows, soft.row[held], weights)
        values = self.program.hessian(z[: self._n], on_rows, 0.0)
        return np.concatenate([values, factor * _PROXIMITY * self._scale**2 / self._n])
