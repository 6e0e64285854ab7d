"""Where Ipopt starts: from the model's values, from a function or frame, or a past solution."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from pyomo_quad.collocation.errors import TranscriptionError
from pyomo_quad.collocation.trajectory import Trajectory

if TYPE_CHECKING:
    from pyomo_quad.collocation.bounds import Bounds
    from pyomo_quad.collocation.declarations import Slot
    from pyomo_quad.collocation.nodes import FloatArray
    from pyomo_quad.collocation.transcription import Transcription
    from pyomo_quad.collocation.values import ModelValues

__all__ = ["TIME_COLUMN", "Guess", "initial_point", "point_from_trajectory"]

TIME_COLUMN = "time"

#: A mapping from slot name to a function of time, a constant or samples over `TIME_COLUMN`;
#: a pandas frame with a time column and one column per slot is such a mapping.  Or a whole
#: trajectory on any mesh.
Guess = Mapping[str, Any] | pd.DataFrame | Trajectory


def point_from_trajectory(program: Transcription, trajectory: Trajectory) -> FloatArray:
    """Return the unknowns that a trajectory on any mesh has on this program's mesh."""
    z = np.zeros(program.layout.unknowns)
    layout = program.layout
    if program.mesh is not None:
        same = trajectory.mesh == program.mesh
        z[layout.state_columns] = (
            trajectory.states if same else trajectory.states_at(program.mesh.node_fractions)
        )
        z[layout.algebraic_columns] = (
            trajectory.algebraics
            if same
            else trajectory.algebraics_at(program.mesh.point_fractions)
        )
    z[layout.static_columns] = trajectory.statics
    return z


def initial_point(
    program: Transcription, bounds: Bounds, values: ModelValues, guess: Guess | None
) -> FloatArray:
    """Return a first point: straight lines between what is known, inside the bounds.

    Known are the values a guess gives, those the model's variables hold, and those that
    boundary conditions fix.
    """
    if isinstance(guess, Trajectory):
        return np.clip(point_from_trajectory(program, guess), bounds.lower, bounds.upper)
    layout, declared = program.layout, program.compiled.declared
    z = np.zeros(layout.unknowns)
    if guess is not None:
        _refuse_unknown_names(program, guess)
    given: Mapping[str, Any] | pd.DataFrame = {} if guess is None else guess
    if program.mesh is not None:
        mesh = program.mesh
        for slots, columns, fractions in (
            (declared.states, layout.state_columns, mesh.node_fractions),
            (declared.algebraics, layout.algebraic_columns, mesh.point_fractions),
        ):
            for k, slot in enumerate(slots):
                z[columns[:, k]] = _function_of_time(
                    program, bounds, values, given, slot, columns[:, k], fractions
                )
    for column, slot in zip(layout.static_columns, declared.statics, strict=True):
        held = given.get(slot.name, values.static_value(slot))
        z[column] = _inside(0.0 if held is None else float(np.asarray(held)), bounds, int(column))
    z = np.clip(z, bounds.lower, bounds.upper)
    integrals = program.integrals(z)
    for integral, static in program.compiled.static_of_integral.items():
        z[layout.static_columns[static]] = integrals[integral]
    return np.clip(z, bounds.lower, bounds.upper)


def _function_of_time(
    program: Transcription,
    bounds: Bounds,
    values: ModelValues,
    given: Mapping[str, Any] | pd.DataFrame,
    slot: Slot,
    columns: Any,
    fractions: FloatArray,
) -> FloatArray:
    if slot.name in given:
        return _given(program, given, slot.name, fractions)
    known = dict(values.initial_values(slot))
    fixed = bounds.lower[columns] == bounds.upper[columns]
    known |= dict(zip(fractions[fixed], bounds.lower[columns][fixed], strict=True))
    if not known:
        middle = _inside(0.0, bounds, int(columns[len(columns) // 2]))
        return np.full(len(fractions), middle)
    at = np.array(sorted(known))
    return np.interp(fractions, at, np.array([known[f] for f in at]))


def _given(
    program: Transcription,
    given: Mapping[str, Any] | pd.DataFrame,
    name: str,
    fractions: FloatArray,
) -> FloatArray:
    times = np.array([program.time_of(float(f)) for f in fractions])
    held = given[name]
    if callable(held):
        return np.broadcast_to(np.asarray(held(times), dtype=float), times.shape)
    samples = np.asarray(held, dtype=float)
    if samples.ndim == 0:
        return np.full(len(times), float(samples))
    return np.interp(times, np.asarray(given[TIME_COLUMN], dtype=float), samples)


def _inside(number: float, bounds: Bounds, column: int) -> float:
    """Return a number moved inside its bounds; between two finite bounds, the middle."""
    lower, upper = bounds.lower[column], bounds.upper[column]
    if lower <= number <= upper:
        return number
    if np.isfinite(lower) and np.isfinite(upper):
        return float(0.5 * (lower + upper))
    return float(lower if np.isfinite(lower) else upper)


def _refuse_unknown_names(program: Transcription, guess: Mapping[str, Any] | pd.DataFrame) -> None:
    declared = program.compiled.declared
    slots = (*declared.states, *declared.outputs, *declared.algebraics, *declared.statics)
    known = {TIME_COLUMN, *(slot.name for slot in slots)}
    for name in guess:
        if name not in known:
            raise TranscriptionError(
                f"guess: {name!r} is none of the model's variables; known are "
                f"{', '.join(sorted(known))}."
            )
