"""Automatic scaling of unknowns, rows and objective.

An unknown is divided by its nominal magnitude: the one the model declares (Suffix
`scaling_factor`), else the largest finite bound or guess.  A row is divided by its largest
derivative with respect to the scaled unknowns at the guess, so that rotor speeds of 1e3
beside angles of 1e-2 weigh alike (compare Betts, Practical Methods, section 4.8).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from pyomo_quad.collocation.bounds import Bounds
    from pyomo_quad.collocation.declarations import Slot
    from pyomo_quad.collocation.nodes import FloatArray
    from pyomo_quad.collocation.transcription import Transcription

__all__ = ["Scaling", "scaling_of"]

_LARGEST_BOUND = 1e6
_ROW_RANGE = (1e-8, 1e8)


@dataclass(frozen=True, kw_only=True)
class Scaling:
    """Factors that multiply the objective, the unknowns and the rows."""

    objective: float
    unknowns: FloatArray
    rows: FloatArray


def scaling_of(program: Transcription, bounds: Bounds, z: FloatArray) -> Scaling:
    """Return scaling factors for a program at a point."""
    nominal = _nominal(program, bounds, z)
    rows, columns = program.jacobianstructure()
    weighted = np.abs(program.jacobian(z)) * nominal[columns]
    largest = np.zeros(program.n_rows)
    np.maximum.at(largest, rows, weighted)
    largest = np.clip(np.where(largest > 0.0, largest, 1.0), *_ROW_RANGE)
    slope = float(np.max(np.abs(program.gradient(z)) * nominal, initial=0.0))
    objective = 1.0 / max(slope, abs(program.objective(z)), 1e-8) if slope > 0.0 else 1.0
    return Scaling(objective=objective, unknowns=1.0 / nominal, rows=1.0 / largest)


def _nominal(program: Transcription, bounds: Bounds, z: FloatArray) -> FloatArray:
    layout, declared = program.layout, program.compiled.declared
    nominal = np.ones(layout.unknowns)
    for slots, columns in (
        (declared.states, layout.state_columns),
        (declared.algebraics, layout.algebraic_columns),
        (declared.statics, layout.static_columns[None, :]),
    ):
        for k, slot in enumerate(slots):
            nominal[columns[:, k]] = _magnitude(slot, bounds, z, columns[:, k])
    return nominal


def _magnitude(slot: Slot, bounds: Bounds, z: FloatArray, columns: Any) -> float:
    if slot.nominal is not None:
        return slot.nominal
    ends = np.abs(np.concatenate([bounds.lower[columns], bounds.upper[columns]]))
    finite = ends[(ends > 0.0) & (ends < _LARGEST_BOUND)]
    guess = float(np.max(np.abs(z[columns]), initial=0.0))
    size = max(float(np.max(finite, initial=0.0)), guess)
    return size if size > 0.0 else 1.0
