"""What can be told to be unsolvable before Ipopt starts."""

from __future__ import annotations

from typing import TYPE_CHECKING, NoReturn

import numpy as np

from pyomo_quad.collocation.errors import TranscriptionError
from pyomo_quad.collocation.naming import row_place, unknown_place

if TYPE_CHECKING:
    from pyomo_quad.collocation.bounds import Bounds
    from pyomo_quad.collocation.nodes import FloatArray
    from pyomo_quad.collocation.transcription import Transcription

__all__ = ["refuse_unsolvable"]


def refuse_unsolvable(program: Transcription, bounds: Bounds, z: FloatArray) -> None:
    """Check that the program is finite at the first point and not over-determined.

    Raises
    ------
    TranscriptionError
        Naming the equation, element and time that is not finite, or the counts.
    """
    _refuse_not_finite(program, z)
    equalities = int(np.sum(bounds.row_lower == bounds.row_upper))
    free = int(np.sum(bounds.lower < bounds.upper))
    if equalities > free:
        held = np.flatnonzero(bounds.lower == bounds.upper)
        names = sorted({str(unknown_place(program, int(c)).name) for c in held})
        raise TranscriptionError(
            f"model: {equalities} equations for {free} free unknowns; it is over-determined. "
            f"Release a fixed value or boundary condition of {', '.join(names[:8]) or 'the model'}"
            ", or add a control."
        )


def _refuse_not_finite(program: Transcription, z: FloatArray) -> None:
    rows = program.constraints(z)
    bad = np.flatnonzero(~np.isfinite(rows))
    if bad.size:
        place = row_place(program, int(bad[0]))
        raise TranscriptionError(
            f"{place}: is {rows[bad[0]]} at the initial guess; give the variables in it initial "
            "values or bounds where it is defined."
        )
    if not np.isfinite(program.objective(z)):
        raise TranscriptionError(
            f"{program.compiled.declared.objective_name}: is {program.objective(z)} at the "
            "initial guess; give the variables in it initial values or bounds where it is defined."
        )
    entries = program.jacobian(z)
    bad = np.flatnonzero(~np.isfinite(entries))
    if bad.size:
        row, column = (int(held[bad[0]]) for held in program.jacobianstructure())
        place, variable = row_place(program, row), unknown_place(program, column)
        by = variable if place.time is None else variable.name
        _refuse_slope(str(place), str(by), entries[bad[0]])
    with np.errstate(invalid="ignore"):
        gradient = program.gradient(z)
    bad = np.flatnonzero(~np.isfinite(gradient))
    if bad.size:
        variable = unknown_place(program, int(bad[0]))
        _refuse_slope(program.compiled.declared.objective_name, str(variable), gradient[bad[0]])


def _refuse_slope(owner: str, variable: str, slope: float) -> NoReturn:
    raise TranscriptionError(
        f"{owner}: its derivative by {variable} is {slope} at the initial guess; start or bound "
        "that variable away from the point."
    )
