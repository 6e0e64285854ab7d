"""One nonlinear program of several: each horizon's own unknowns, then the shared statics."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from pyomo_quad.collocation.errors import TranscriptionError
from pyomo_quad.collocation.program.bounds import (
    Bounds,
    NonlinearProgram,
    Scaling,
    nominal_magnitudes,
)
from pyomo_quad.collocation.program.ipopt import IpoptResult, Multipliers

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from pyomo_quad.collocation.mesh import FloatArray
    from pyomo_quad.collocation.program.transcription import Transcription


@dataclass(frozen=True, kw_only=True)
class StateValue:
    """A state of one of several programs, at a node that lies at a share of its horizon."""

    program: int
    state: str
    fraction: float


class Union:
    """Where the unknowns and rows of programs stand among those of all.

    Static variables of one name are one unknown.

    Parameters
    ----------
    programs : sequence of Transcription
    states : mapping
        Names of static variables that are values of states, and which.
    """

    def __init__(self, programs: Sequence[Transcription], states: Mapping[str, StateValue]) -> None:
        self.programs = tuple(programs)
        varying = [p.layout.unknowns - p.layout.n_statics for p in self.programs]
        firsts = np.cumsum([0, *varying]).tolist()
        names = [s.name for p in self.programs for s in p.compiled.declared.statics]
        own = [name for name in dict.fromkeys(names) if name not in states]
        self.statics = {name: k for k, name in enumerate(own, start=firsts[-1])}
        self.unknowns = firsts[-1] + len(own)
        columns = self.statics | {
            name: firsts[at.program] + _column(self.programs[at.program], at)
            for name, at in states.items()
        }
        self.places: list[NDArray[np.intp]] = [
            np.array(
                [
                    *range(first, first + count),
                    *(columns[slot.name] for slot in program.compiled.declared.statics),
                ],
                dtype=np.intp,
            )
            for program, first, count in zip(self.programs, firsts, varying, strict=False)
        ]
        counts = [program.n_rows for program in self.programs]
        ends = np.cumsum(counts).tolist()
        self.rows = [slice(end - n, end) for end, n in zip(ends, counts, strict=True)]

    def joined(self, parts: Sequence[FloatArray]) -> FloatArray:
        """Return the unknowns of all from those of each; of a shared one the first counts."""
        whole = np.zeros(self.unknowns)
        for places, part in reversed(list(zip(self.places, parts, strict=True))):
            whole[places] = part
        return whole

    def bounds(self, parts: Sequence[Bounds]) -> Bounds:
        """Return the narrowest bounds.

        Raises
        ------
        TranscriptionError
            If those of a static variable cross.
        """
        lower, upper = np.full(self.unknowns, -np.inf), np.full(self.unknowns, np.inf)
        for places, part in zip(self.places, parts, strict=True):
            lower[places] = np.maximum(lower[places], part.lower)
            upper[places] = np.minimum(upper[places], part.upper)
        for name, column in self.statics.items():
            if lower[column] > upper[column]:
                raise TranscriptionError(
                    f"{name}: lower bound {lower[column]:g} is above upper bound "
                    f"{upper[column]:g}; relax one of the two."
                )
        return Bounds(
            lower=lower,
            upper=upper,
            row_lower=np.concatenate([part.row_lower for part in parts]),
            row_upper=np.concatenate([part.row_upper for part in parts]),
        )

    def bounds_of(self, whole: Bounds, k: int) -> Bounds:
        """Return the bounds of one program."""
        places, rows = self.places[k], self.rows[k]
        return Bounds(
            lower=whole.lower[places],
            upper=whole.upper[places],
            row_lower=whole.row_lower[rows],
            row_upper=whole.row_upper[rows],
        )

    def nominal(self, whole: Bounds, z: FloatArray) -> FloatArray:
        """Return the magnitudes of the unknowns."""
        return self.joined(
            [
                nominal_magnitudes(program, self.bounds_of(whole, k), z[self.places[k]])
                for k, program in enumerate(self.programs)
            ]
        )

    def scaling_of(self, whole: Scaling, k: int) -> Scaling:
        """Return the scaling of one program."""
        return Scaling(
            objective=whole.objective,
            unknowns=whole.unknowns[self.places[k]],
            rows=whole.rows[self.rows[k]],
        )

    def multipliers(self, parts: Sequence[Multipliers]) -> Multipliers:
        """Return the multipliers of all."""
        return Multipliers(
            rows=np.concatenate([part.rows for part in parts]),
            lower=self.joined([part.lower for part in parts]),
            upper=self.joined([part.upper for part in parts]),
        )

    def result_of(self, whole: IpoptResult, k: int) -> IpoptResult:
        """Return what one program has of a result."""
        places, found = self.places[k], whole.multipliers
        return IpoptResult(
            status=whole.status,
            code=whole.code,
            message=whole.message,
            z=whole.z[places],
            multipliers=Multipliers(
                rows=found.rows[self.rows[k]],
                lower=found.lower[places],
                upper=found.upper[places],
            ),
            iterations=whole.iterations,
            history=whole.history,
            wall_s=whole.wall_s,
        )


def _column(program: Transcription, at: StateValue) -> int:
    nodes = program.mesh.node_fractions if program.mesh else np.zeros(1)
    node = int(np.argmin(np.abs(nodes - at.fraction)))
    names = [slot.name for slot in program.compiled.declared.states]
    return int(program.layout.state_columns[node, names.index(at.state)])


@dataclass(frozen=True)
class CoupledProgram:
    """The sum of programs, in the form Ipopt asks for; `programs` are those of the union.

    They may be the same with a price on their objective.
    """

    union: Union
    programs: tuple[NonlinearProgram, ...]

    def _parts(self, z: FloatArray) -> list[tuple[NonlinearProgram, FloatArray]]:
        held = (z[places] for places in self.union.places)
        return list(zip(self.programs, held, strict=True))

    @property
    def n_rows(self) -> int:
        """Number of rows."""
        return sum(program.n_rows for program in self.programs)

    @property
    def n_points(self) -> int:
        """Number of collocation points."""
        return sum(program.n_points for program in self.programs)

    @property
    def is_negated(self) -> bool:
        """Whether the declared objective is maximised."""
        return self.programs[0].is_negated

    def objective(self, z: FloatArray) -> float:
        """Return what Ipopt minimises."""
        return sum(program.objective(own) for program, own in self._parts(z))

    def gradient(self, z: FloatArray) -> FloatArray:
        """Return its gradient."""
        gradient = np.zeros(self.union.unknowns)
        for places, (program, own) in zip(self.union.places, self._parts(z), strict=True):
            gradient[places] += program.gradient(own)
        return gradient

    def constraints(self, z: FloatArray) -> FloatArray:
        """Return the value of every row."""
        return np.concatenate([program.constraints(own) for program, own in self._parts(z)])

    @cached_property
    def _jacobian(self) -> tuple[Any, Any]:
        found = []
        for rows, places, program in zip(
            self.union.rows, self.union.places, self.programs, strict=True
        ):
            own_rows, columns = program.jacobianstructure()
            found.append((own_rows + rows.start, places[columns]))
        every_row, every_column = zip(*found, strict=True)
        return np.concatenate(every_row), np.concatenate(every_column)

    def jacobianstructure(self) -> tuple[Any, Any]:
        """Return rows and columns of the Jacobian's nonzeros."""
        return self._jacobian

    def jacobian(self, z: FloatArray) -> FloatArray:
        """Return the Jacobian's nonzeros."""
        return np.concatenate([program.jacobian(own) for program, own in self._parts(z)])

    @cached_property
    def _hessian(self) -> tuple[Any, Any]:
        found = []
        for places, program in zip(self.union.places, self.programs, strict=True):
            rows, columns = (places[held] for held in program.hessianstructure())
            # Programs may have the shared statics in different orders.
            found.append((np.maximum(rows, columns), np.minimum(rows, columns)))
        every_row, every_column = zip(*found, strict=True)
        return np.concatenate(every_row), np.concatenate(every_column)

    def hessianstructure(self) -> tuple[Any, Any]:
        """Return rows and columns of the Lagrangian Hessian's lower triangle."""
        return self._hessian

    def hessian(self, z: FloatArray, multipliers: FloatArray, factor: float) -> FloatArray:
        """Return the nonzeros of the Lagrangian's Hessian."""
        return np.concatenate(
            [
                program.hessian(own, multipliers[rows], factor)
                for rows, (program, own) in zip(self.union.rows, self._parts(z), strict=True)
            ]
        )
