"""Initial points for Ipopt, from a guess, the values in the model, and the model's equations."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from pyomo_quad.collocation.errors import TranscriptionError
from pyomo_quad.collocation.mesh import Trajectory
from pyomo_quad.collocation.program.bounds import is_defined, nominal_magnitudes
from pyomo_quad.collocation.program.definitions import definitions, with_defined

if TYPE_CHECKING:
    from collections.abc import Mapping

    import pandas as pd
    from numpy.typing import NDArray

    from pyomo_quad.collocation.mesh import FloatArray
    from pyomo_quad.collocation.program.nonlinear import Bounds
    from pyomo_quad.collocation.program.transcription import Transcription
    from pyomo_quad.collocation.reading.symbols import Declarations, Slot
    from pyomo_quad.collocation.reading.values import ModelValues

TIME_COLUMN = "time"

#: A mapping from the name of a variable, as in ``rotors.omega[1]``, to a function of time, a
#: constant, or samples at the times in `TIME_COLUMN`; a pandas frame with a time column and one
#: column per variable is a mapping of this kind. If start or end of the horizon is a variable,
#: functions take the fraction of the horizon, and samples span the horizon from its start to its
#: end. Or a complete trajectory on any mesh.
Guess: TypeAlias = "Mapping[str, Any] | pd.DataFrame | Trajectory"


def point_from_trajectory(program: Transcription, trajectory: Trajectory) -> FloatArray:
    """Interpolate a trajectory from any mesh to the unknowns of a nonlinear program.

    `program` is the nonlinear program on its own mesh. The result has shape (n_unknowns,).
    """
    layout, mesh, z = program.layout, program.mesh, np.zeros(program.layout.unknowns)
    if mesh is not None:
        same, path = trajectory.mesh == mesh, trajectory
        states = path.states if same else path.states_at(mesh.node_fractions)
        z[layout.state_columns] = states
        algebraics = path.algebraics if same else path.algebraics_at(mesh.point_fractions)
        z[layout.algebraic_columns] = algebraics
    z[layout.static_columns] = trajectory.statics
    return z


def initial_point(
    program: Transcription, bounds: Bounds, values: ModelValues, guess: Guess | None
) -> FloatArray:
    """Return an initial point inside the bounds, from a guess and the values in the model.

    If `guess` is a `Trajectory`, it is interpolated to the program's mesh. Otherwise, `guess` gives
    values by variable name. Any other variable is interpolated in time between its known values:
    fixed values, and the values in the Pyomo model (`values`). Algebraic variables without values
    are computed from equations that define them.

    Raises
    ------
    TranscriptionError
        If a name in the guess is no variable.
    """
    if isinstance(guess, Trajectory):
        return np.clip(point_from_trajectory(program, guess), bounds.lower, bounds.upper)
    layout, declared = program.layout, program.compiled.declared
    z = np.zeros(layout.unknowns)
    if guess is not None:
        _refuse_unknown_names(program, guess)
    known = _Known(program, bounds, values, {} if guess is None else guess)
    if program.mesh is not None:
        mesh = program.mesh
        for slots, columns, fractions in (
            (declared.states, layout.state_columns, mesh.node_fractions),
            (declared.algebraics, layout.algebraic_columns, mesh.point_fractions),
        ):
            for k, slot in enumerate(slots):
                z[columns[:, k]] = known.over_time(slot, columns[:, k], fractions)
    for column, slot in zip(layout.static_columns, declared.statics, strict=True):
        held = known.given.get(slot.name, values.static_value(slot))
        z[column] = _inside(0.0 if held is None else float(np.asarray(held)), bounds, int(column))
    known.order_times(z)
    z = known.with_defined_algebraics(np.clip(z, bounds.lower, bounds.upper))
    integrals = program.integrals(z)
    for integral, static in program.compiled.static_of_integral.items():
        z[layout.static_columns[static]] = integrals[integral]
    return np.clip(z, bounds.lower, bounds.upper)


def first_point(
    program: Transcription,
    bounds: Bounds,
    values: ModelValues,
    guess: Guess | None,
    seed: int = 0,
) -> FloatArray:
    """Return an initial point for Ipopt, corrected by means of the model's equations.

    The point before the correction is that of `initial_point` or, if `seed` is above 0, a random
    point of `scattered`. The correction changes states to satisfy the equations that contain states
    only. If an equation or a derivative is NaN at the resulting point, the algebraic variables are
    adjusted to the equations.
    """
    z = initial_point(program, bounds, values, guess)
    z = scattered(program, bounds, z, seed) if seed else z
    z = on_path_equalities(program, bounds, z)
    return z if is_defined(program, z) else with_consistent_algebraics(program, bounds, z)


@dataclass(frozen=True)
class _Known:
    """Known values for an initial point: fixed values, values in the model, and the guess.

    Fixed values include boundary conditions. Values in the model include those of `initialize`
    rules. `given` is the user's guess by variable name, empty if there is none.
    """

    program: Transcription
    bounds: Bounds
    values: ModelValues
    given: Mapping[str, Any] | pd.DataFrame

    def over_time(self, slot: Slot, columns: Any, fractions: FloatArray) -> FloatArray:
        """Return initial values of a variable over time, interpolated between its known values.

        `columns` are the positions of the variable's unknowns in the nonlinear program. `fractions`
        are the times of these unknowns, as fractions of the horizon.
        """
        if slot.name in self.given:
            return self._guess_at(slot.name, fractions)
        fixed = _are_fixed(self.bounds, columns)
        guessed = self.values.first_guesses(slot, fractions)
        if guessed is not None:
            return np.where(fixed, self.bounds.lower[columns], guessed)
        known = dict(self.values.initial_values(slot))
        known |= dict(zip(fractions[fixed], self.bounds.lower[columns][fixed], strict=True))
        if not known:
            middle = _inside(0.0, self.bounds, int(columns[len(columns) // 2]))
            return np.full(len(fractions), middle)
        at = np.array(sorted(known))
        return np.interp(fractions, at, np.array([known[f] for f in at]))

    def _guess_at(self, name: str, fractions: FloatArray) -> FloatArray:
        """Return the guess of the variable `name` at n fractions of the horizon, shape (n,).

        It is a number, a function of time, or samples at the times in "time". If start or end is
        free, these times are scaled, and the function takes fractions.
        """
        times = np.array([self.program.time_of(float(f)) for f in fractions])
        held = self.given[name]
        if callable(held):
            try:
                values = np.asarray(held(times), dtype=float)
            except (TypeError, ValueError):  # It accepts single numbers only, like math.sin.
                values = np.array([float(held(float(time))) for time in times])
            return np.broadcast_to(values, times.shape)
        samples = np.asarray(held, dtype=float)
        if samples.ndim == 0:
            return np.full(len(times), float(samples))
        at = np.asarray(self.given[TIME_COLUMN], dtype=float)
        if self.program.horizon is None and at[-1] > at[0]:
            # The samples may have physical times, such as those of a solution.
            at = (at - at[0]) / (at[-1] - at[0])
        return np.interp(times, at, samples)

    def with_defined_algebraics(self, z: FloatArray) -> FloatArray:
        """Return a copy of `z` with values of the algebraic variables that equations define.

        `z` has the values of all unknowns of the program. Known values are kept. If a computed
        value is infinite or NaN, the result is `z` itself.
        """
        program, bounds = self.program, self.bounds
        columns = program.layout.algebraic_columns
        unknown = [
            k
            for k, slot in enumerate(program.compiled.declared.algebraics)
            if not (slot.name in self.given or self.values.initial_values(slot))
            and not np.any(_are_fixed(bounds, columns[:, k]))
        ]
        found = definitions(program, z, unknown)
        if not found:
            return z
        moved, first = np.array(z), 2 * program.layout.n_states
        variables = with_defined(
            program, program.path_variables(z), program.data.at_points(), found
        )
        for _, k, _ in found:
            moved[columns[:, k]] = variables[:, first + k]
        return np.clip(moved, bounds.lower, bounds.upper) if np.all(np.isfinite(moved)) else z

    def order_times(self, z: FloatArray) -> None:
        """Make the values of the free times in the vector of unknowns `z` increase, in place.

        The solve determines free times. A free time without a value in model and guess takes its
        declared time. A value out of order is replaced by one after the preceding time.
        """
        program, bounds = self.program, self.bounds
        statics, clock = program.compiled.declared.statics, program.compiled.declared.clock
        slots = {slot.name: k for k, slot in enumerate(statics)}
        columns = program.layout.static_columns
        free = {k: slots[t.name()] for k, t in enumerate(clock.times) if str(t) in slots}
        for k, static in free.items():
            slot = statics[static]
            if self.values.static_value(slot) is None and slot.name not in self.given:
                z[columns[static]] = _inside(clock.declared[k], bounds, int(columns[static]))
        times = program.times(z)
        latest = program.times(bounds.upper)
        latest = np.minimum.accumulate(latest[::-1])[::-1]
        for k, static in free.items():
            column = columns[static]
            if k > 0 and not times[k - 1] < times[k] < np.append(latest, np.inf)[k + 1]:
                earliest = max(times[k - 1], bounds.lower[column])
                room = (latest[k] - earliest) / (len(times) - k)
                step = room if np.isfinite(room) else clock.declared[k] - clock.declared[k - 1]
                times[k] = z[column] = earliest + step


def _are_fixed(bounds: Bounds, columns: Any) -> NDArray[np.bool_]:
    """Return whether the two bounds are equal, for each of several unknowns.

    `columns` are the positions of these unknowns in the nonlinear program. The result has the shape
    of `columns`.
    """
    return np.asarray(bounds.lower[columns] == bounds.upper[columns])


_STEPS = 3


def with_consistent_algebraics(program: Transcription, bounds: Bounds, z: FloatArray) -> FloatArray:
    """Adjust the algebraic variables so that the equations nearly hold at each collocation point.

    Three Gauss-Newton steps are taken in the algebraic variables, inside the bounds. The states are
    not changed.
    """
    columns, n = program.layout.algebraic_columns, program.layout.n_states
    if program.mesh is None or not columns.size:
        return z
    rows, moved = np.flatnonzero(program.compiled.is_equality), np.array(z)
    algebraics, data = 2 * n + np.arange(columns.shape[1]), program.data.at_points()
    for _ in range(_STEPS):
        matrices = program.path_slopes(program.path_variables(moved), data, rows, algebraics)
        residuals = program.rows_at_points(moved)[:, rows]
        if not (np.all(np.isfinite(matrices)) and np.all(np.isfinite(residuals))):
            break
        moved[columns] -= np.einsum("kij,kj->ki", np.linalg.pinv(matrices), residuals)
        moved = np.clip(moved, bounds.lower, bounds.upper)
    return moved


# Largest number of Gauss-Newton steps that project states onto equations among states, and largest
# final residual relative to the initial residual.
_PROJECTIONS, _LEFT = 30, 1e-9


def on_path_equalities(program: Transcription, bounds: Bounds, z: FloatArray) -> FloatArray:
    """Move states as little as possible until they satisfy the equations among states alone.

    An example is a path that a vehicle must follow. The algebraic variables are then adjusted to
    the states. The result is `z` itself if moving the states did not decrease the largest residual
    of these equations.
    """
    compiled, layout = program.compiled, program.layout
    path, n = compiled.path, layout.n_states
    of_states = (path.jacobian_columns >= n) & (path.jacobian_columns < 2 * n)
    others = np.unique(path.jacobian_rows[~of_states])
    # These equations contain neither rates nor controls, and have index 2. Their derivatives tell
    # Ipopt little about the rates and controls that they require, so the states are moved first.
    rows = np.setdiff1d(np.flatnonzero(compiled.is_equality), others)
    if program.mesh is None or not rows.size:
        return z
    columns = layout.state_columns[1:]
    sizes = nominal_magnitudes(program, bounds, z)[columns]
    sizes = np.where(bounds.lower[columns] < bounds.upper[columns], sizes, 0.0)
    moved, data = np.array(z), program.data.at_points()
    first = largest = float(np.abs(program.rows_at_points(z)[:, rows]).max())
    for _ in range(_PROJECTIONS):
        if largest <= _LEFT * max(first, 1.0):
            break
        states = n + np.arange(n)
        matrices = program.path_slopes(program.path_variables(moved), data, rows, states)
        if not np.all(np.isfinite(matrices)):
            break
        residuals = program.rows_at_points(moved)[:, rows]
        # A Gauss-Newton step, the shortest possible in units of the states' magnitudes.
        steps = np.einsum("kij,kj->ki", np.linalg.pinv(matrices * sizes[:, None, :]), residuals)
        moved[columns] -= sizes * steps
        moved = np.clip(moved, bounds.lower, bounds.upper)
        largest = float(np.abs(program.rows_at_points(moved)[:, rows]).max())
        if not np.isfinite(largest):
            break
    return with_consistent_algebraics(program, bounds, moved) if largest < first else z


# Number of instants between which random functions of time are linear; and magnitude above which a
# bound counts as absent.
_INSTANTS = 4
_LARGEST_BOUND = 1e6


def scattered(program: Transcription, bounds: Bounds, z: FloatArray, seed: int) -> FloatArray:
    """Return a random initial point inside the bounds.

    The values are uniform between the bounds. If a bound is 1e6 or more in magnitude, they are
    normally distributed around `z`. A variable over time is linear between four equally spaced
    random values.
    """
    generator = np.random.default_rng(seed)
    layout, moved = program.layout, np.array(z)
    groups = [(layout.static_columns[None, :], np.zeros(1))]
    if program.mesh is not None:
        groups += [
            (layout.state_columns, program.mesh.node_fractions),
            (layout.algebraic_columns, program.mesh.point_fractions),
        ]
    instants = np.linspace(0.0, 1.0, _INSTANTS)
    for columns, fractions in groups:
        for own in columns.T:
            # Use the median, because values fixed at the ends are not bounds between them.
            lower, upper = (np.median(side[own]) for side in (bounds.lower, bounds.upper))
            if max(abs(lower), abs(upper)) < _LARGEST_BOUND:
                values = generator.uniform(lower, upper, _INSTANTS)
                moved[own] = np.interp(fractions, instants, values)
            else:
                # The standard deviation is the variable's largest magnitude in `z`, but at least 1.
                size = max(1.0, float(np.max(np.abs(z[own]), initial=0.0)))
                values = generator.normal(scale=size, size=_INSTANTS)
                moved[own] += np.interp(fractions, instants, values)
    return np.clip(moved, bounds.lower, bounds.upper)


def _inside(number: float, bounds: Bounds, column: int) -> float:
    """Return the initial value `number`, moved inside the bounds of the unknown `column`.

    A value that is NaN or outside becomes the middle of finite bounds, or the only finite bound.
    """
    # If both bounds are infinite, NaN becomes inf.
    lower, upper = bounds.lower[column], bounds.upper[column]
    if lower <= number <= upper:
        return number
    if np.isfinite(lower) and np.isfinite(upper):
        return float(0.5 * (lower + upper))
    return float(lower if np.isfinite(lower) else upper)


def known_names(declared: Declarations) -> set[str]:
    """Return the names that a user's guess may contain: "time", and the names of all variables.

    `declared` are the declarations of the model, with its variables.
    """
    return {TIME_COLUMN, *(slot.name for slot in (*declared.varying, *declared.statics))}


def _refuse_unknown_names(program: Transcription, guess: Mapping[str, Any] | pd.DataFrame) -> None:
    """Raise an error if a name in a user's guess is neither a variable nor "time"."""
    known = known_names(program.compiled.declared)
    for name in guess:
        if name not in known:
            raise TranscriptionError(
                f"guess: {name!r} is none of the model's variables; known are "
                f"{', '.join(sorted(known))}."
            )
