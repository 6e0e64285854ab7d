"""Initial points for Ipopt: the model's values, a function or frame, or another mesh's solution."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from pyomo_quad.collocation.errors import TranscriptionError
from pyomo_quad.collocation.mesh import Mesh, Timeline, Trajectory, interpolate, real_array
from pyomo_quad.collocation.program.bounds import nominal_magnitudes
from pyomo_quad.collocation.program.compiled import MappedFunction
from pyomo_quad.collocation.program.definitions import definitions, with_defined
from pyomo_quad.collocation.program.nonlinear import Multipliers

if TYPE_CHECKING:
    from collections.abc import Mapping

    import pandas as pd
    from numpy.typing import NDArray

    from pyomo_quad.collocation.mesh import FloatArray
    from pyomo_quad.collocation.program.compiled import CompiledModel
    from pyomo_quad.collocation.program.nonlinear import Bounds
    from pyomo_quad.collocation.program.transcription import Transcription
    from pyomo_quad.collocation.reading.symbols import Slot
    from pyomo_quad.collocation.reading.values import ModelValues

TIME_COLUMN = "time"

#: A mapping from slot name to a function of time, a constant, or samples over `TIME_COLUMN`; a
#: pandas frame with a time column and one column per slot is a mapping of this kind. Or a complete
#: trajectory on any mesh.
Guess: TypeAlias = "Mapping[str, Any] | pd.DataFrame | Trajectory"


def point_from_trajectory(program: Transcription, trajectory: Trajectory) -> FloatArray:
    """Return a trajectory's values, from any mesh, as unknowns on this program's mesh."""
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
    """Return a first point: linear interpolation between known values, inside the bounds.

    Known values come from a guess, from `initialize` rules at any time, from the model's variables,
    and from boundary conditions. Algebraic variables without a known value are computed from their
    defining equations.
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
    _order_times(program, bounds, values, given, z)
    z = np.clip(z, bounds.lower, bounds.upper)
    z = _with_defined_algebraics(program, bounds, values, given, z)
    integrals = program.integrals(z)
    for integral, static in program.compiled.static_of_integral.items():
        z[layout.static_columns[static]] = integrals[integral]
    return np.clip(z, bounds.lower, bounds.upper)


def _with_defined_algebraics(
    program: Transcription,
    bounds: Bounds,
    values: ModelValues,
    given: Mapping[str, Any] | pd.DataFrame,
    z: FloatArray,
) -> FloatArray:
    """Return a point with algebraic variables that have no guess computed from their equations."""
    columns = program.layout.algebraic_columns
    unknown = [
        k
        for k, slot in enumerate(program.compiled.declared.algebraics)
        if not (slot.name in given or values.initial_values(slot))
        and not np.any(_are_fixed(bounds, columns[:, k]))
    ]
    found = definitions(program, z, unknown)
    if not found:
        return z
    moved, first = np.array(z), 2 * program.layout.n_states
    variables = with_defined(program, program.path_variables(z), program.data.at_points(), found)
    for _, k, _ in found:
        moved[columns[:, k]] = variables[:, first + k]
    return np.clip(moved, bounds.lower, bounds.upper) if np.all(np.isfinite(moved)) else z


def _are_fixed(bounds: Bounds, columns: Any) -> NDArray[np.bool_]:
    return np.asarray(bounds.lower[columns] == bounds.upper[columns])


_STEPS = 3


def with_consistent_algebraics(program: Transcription, bounds: Bounds, z: FloatArray) -> FloatArray:
    """Return a point whose algebraic variables nearly satisfy the equations at each point.

    Takes a few Gauss-Newton steps with fixed states: a control without a known value becomes the
    one that the states require.
    """
    compiled, columns = program.compiled, program.layout.algebraic_columns
    if program.mesh is None or not columns.size:
        return z
    rows = np.flatnonzero(compiled.is_equality)
    first = 2 * program.layout.n_states
    path, moved = compiled.path, np.array(z)
    jacobian = MappedFunction(path.jacobian, program.n_points)
    chosen = np.isin(path.jacobian_rows, rows) & (path.jacobian_columns >= first)
    chosen &= path.jacobian_columns < first + columns.shape[1]
    at = np.searchsorted(rows, path.jacobian_rows[chosen]), path.jacobian_columns[chosen] - first
    for _ in range(_STEPS):
        entries = jacobian(program.path_variables(moved), program.data.at_points())[0]
        matrices = np.zeros((program.n_points, rows.size, columns.shape[1]))
        matrices[:, at[0], at[1]] = entries[:, chosen]
        residuals = program.rows_at_points(moved)[:, rows]
        if not (np.all(np.isfinite(matrices)) and np.all(np.isfinite(residuals))):
            break
        moved[columns] -= np.einsum("kij,kj->ki", np.linalg.pinv(matrices), residuals)
        moved = np.clip(moved, bounds.lower, bounds.upper)
    return moved


# Number of steps onto equations among states, and residual to reach relative to the first one.
_PROJECTIONS, _LEFT = 30, 1e-9


def on_path_equalities(program: Transcription, bounds: Bounds, z: FloatArray) -> FloatArray:
    """Return a point near a given one whose states satisfy the equations among states alone.

    Such an equation has index 2: far from it, its slopes at the first point give little information
    on the rates and controls that maintain it. Each Gauss-Newton step is the shortest one in units
    of the states' sizes.
    """
    compiled, layout = program.compiled, program.layout
    path, n = compiled.path, layout.n_states
    of_states = (path.jacobian_columns >= n) & (path.jacobian_columns < 2 * n)
    others = np.unique(path.jacobian_rows[~of_states])
    rows = np.setdiff1d(np.flatnonzero(compiled.is_equality), others)
    if program.mesh is None or not rows.size:
        return z
    columns = layout.state_columns[1:]
    sizes = nominal_magnitudes(program, bounds, z)[columns]
    sizes = np.where(bounds.lower[columns] < bounds.upper[columns], sizes, 0.0)
    chosen = np.isin(path.jacobian_rows, rows) & of_states
    at = np.searchsorted(rows, path.jacobian_rows[chosen]), path.jacobian_columns[chosen] - n
    jacobian, moved = MappedFunction(path.jacobian, program.n_points), np.array(z)
    first = largest = float(np.abs(program.rows_at_points(z)[:, rows]).max())
    for _ in range(_PROJECTIONS):
        if largest <= _LEFT * max(first, 1.0):
            break
        entries = jacobian(program.path_variables(moved), program.data.at_points())[0]
        matrices = np.zeros((program.n_points, rows.size, n))
        matrices[:, at[0], at[1]] = entries[:, chosen]
        if not np.all(np.isfinite(matrices)):
            break
        residuals = program.rows_at_points(moved)[:, rows]
        steps = np.einsum("kij,kj->ki", np.linalg.pinv(matrices * sizes[:, None, :]), residuals)
        moved[columns] -= sizes * steps
        moved = np.clip(moved, bounds.lower, bounds.upper)
        largest = float(np.abs(program.rows_at_points(moved)[:, rows]).max())
        if not np.isfinite(largest):
            break
    return with_consistent_algebraics(program, bounds, moved) if largest < first else z


# Number of instants between which random functions are linear; larger bounds count as absent.
_INSTANTS = 4
_LARGEST_BOUND = 1e6


def scattered(program: Transcription, bounds: Bounds, z: FloatArray, seed: int) -> FloatArray:
    """Return a random point: between bounds where both are finite, else around a given point."""
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
                size = max(1.0, float(np.max(np.abs(z[own]), initial=0.0)))
                values = generator.normal(scale=size, size=_INSTANTS)
                moved[own] += np.interp(fractions, instants, values)
    return np.clip(moved, bounds.lower, bounds.upper)


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
    fixed = _are_fixed(bounds, columns)
    guessed = values.first_guesses(slot, fractions)
    if guessed is not None:
        return np.where(fixed, bounds.lower[columns], guessed)
    known = dict(values.initial_values(slot))
    known |= dict(zip(fractions[fixed], bounds.lower[columns][fixed], strict=True))
    if not known:
        middle = _inside(0.0, bounds, int(columns[len(columns) // 2]))
        return np.full(len(fractions), middle)
    at = np.array(sorted(known))
    return np.interp(fractions, at, np.array([known[f] for f in at]))


def _order_times(
    program: Transcription,
    bounds: Bounds,
    values: ModelValues,
    given: Mapping[str, Any] | pd.DataFrame,
    z: FloatArray,
) -> None:
    """Start free times without a value at their declared times, and put all in increasing order."""
    statics, clock = program.compiled.declared.statics, program.compiled.declared.clock
    slots = {slot.name: k for k, slot in enumerate(statics)}
    columns = program.layout.static_columns
    free = {k: slots[t.name()] for k, t in enumerate(clock.times) if str(t) in slots}
    for k, static in free.items():
        if values.static_value(statics[static]) is None and statics[static].name not in given:
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


def _given(
    program: Transcription,
    given: Mapping[str, Any] | pd.DataFrame,
    name: str,
    fractions: FloatArray,
) -> FloatArray:
    times = np.array([program.time_of(float(f)) for f in fractions])
    held = given[name]
    if callable(held):
        try:
            values = np.asarray(held(times), dtype=float)
        except (TypeError, ValueError):  # It accepts single numbers only, like math.sin.
            values = np.array([float(held(float(time))) for time in times])
        return np.broadcast_to(values, times.shape)
    samples = np.asarray(held, dtype=float)
    if samples.ndim == 0:
        return np.full(len(times), float(samples))
    return np.interp(times, np.asarray(given[TIME_COLUMN], dtype=float), samples)


def _inside(number: float, bounds: Bounds, column: int) -> float:
    """Return a number moved inside its bounds; between two finite bounds, their middle."""
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


_PARTS = ("states", "algebraics", "statics")


@dataclass(frozen=True, kw_only=True)
class ColdStart:
    """Iterations of a cold start: a limit for a warm start of the same problem and tolerance.

    Attributes
    ----------
    first, iterations : int
        Iterations on the first mesh, and on all meshes.
    tolerance : float
        Tolerance of that solve, 0 for a single mesh.
    """

    first: int
    iterations: int
    tolerance: float

    @property
    def array(self) -> FloatArray:
        """Return the three numbers as an array for `from_arrays`."""
        return np.array([float(self.first), float(self.iterations), self.tolerance])

    @classmethod
    def from_arrays(cls, held: Mapping[str, NDArray[Any]]) -> ColdStart | None:
        """Return the record held in untrusted arrays, None if they hold none."""
        if "cold_start" not in held:
            return None
        first, iterations, tolerance = real_array(held, "cold_start", (3,)).tolist()
        return cls(first=int(first), iterations=int(iterations), tolerance=tolerance)


@dataclass(frozen=True, kw_only=True)
class WarmStart:
    """A point of a program with its multipliers, independent of the problem that it came from.

    Attributes
    ----------
    model : str
        Fingerprint of the equations to which the multipliers belong.
    trajectory : Trajectory
        The point itself.
    lower, upper : Trajectory
        Multipliers of the bounds, in the form of a trajectory.
    equations : ndarray, shape (n_points, n_equations)
        Multipliers of the equations over time.
    conditions : ndarray, shape (n_conditions,)
        Multipliers of all other rows.
    cold_start : ColdStart, optional
        Iterations of the solve without a warm start, if known.
    """

    model: str
    trajectory: Trajectory
    lower: Trajectory
    upper: Trajectory
    equations: FloatArray
    conditions: FloatArray
    cold_start: ColdStart | None = None

    def __post_init__(self) -> None:
        for array in self._numbers().values():
            array.setflags(write=False)

    @property
    def mesh(self) -> Mesh:
        """The mesh on which it was found."""
        return self.trajectory.mesh

    @property
    def is_finite(self) -> bool:
        """Whether all numbers are finite; those of a failed solve may not be."""
        return all(bool(np.all(np.isfinite(array))) for array in self._numbers().values())

    def fits(self, compiled: CompiledModel) -> bool:
        """Return whether a compiled model has the equations that the multipliers belong to."""
        held, declared = self.trajectory, compiled.declared
        return (
            self.model == compiled.fingerprint
            and (not declared.has_horizon or held.states.shape[1] == len(declared.states))
            and (not declared.has_horizon or held.algebraics.shape[1] == len(declared.algebraics))
            and held.statics.size == len(declared.statics)
            and self.equations.shape[1] == compiled.n_equations
            and self.conditions.size == len(declared.conditions) + len(compiled.static_of_integral)
        )

    def continued(self, mesh: Mesh, was: Timeline, now: Timeline) -> WarmStart:
        """Return the warm start on the mesh of another horizon, with its values at the same times.

        Parameters
        ----------
        mesh : Mesh
            Mesh of the other horizon, which lies inside its own.
        was, now : Timeline
            Times of its own horizon, and of the other.

        Returns
        -------
        WarmStart
            Multipliers of quantities imposed at each time are interpolated as between meshes.
        """
        nodes, points = (
            was.fraction(now.time(fractions))
            for fractions in (mesh.node_fractions, mesh.point_fractions)
        )
        old = self.mesh.quadrature_weights * was.span_at(self.mesh.point_fractions)
        new = mesh.quadrature_weights * now.span_at(mesh.point_fractions)

        path, lower, upper = self.trajectory, self.lower, self.upper
        # Interpolate all at once: building the polynomials costs as much as evaluating them.
        imposed = (lower.states[1:], lower.algebraics, upper.states[1:], upper.algebraics)
        parts = (*imposed, self.equations)
        densities = [values / old[:, None] for values in parts]
        held = np.hstack([path.algebraics, *densities])
        borders = np.cumsum([part.shape[1] for part in (path.algebraics, *densities)])[:-1]
        carried = interpolate(self.mesh, held, points, with_start=False)
        algebraics, *moved = np.split(carried, borders, axis=1)
        *pulls, equations = (part * new[:, None] for part in moved)
        positive = [np.maximum(part, 0.0) for part in pulls]
        sides = (
            replace(
                side, mesh=mesh, states=np.vstack([side.states[:1], over]), algebraics=of_others
            )
            for side, over, of_others in zip(
                (lower, upper), positive[::2], positive[1::2], strict=True
            )
        )
        below, above = sides
        return replace(
            self,
            trajectory=replace(
                path, mesh=mesh, states=path.states_at(nodes), algebraics=algebraics
            ),
            lower=below,
            upper=above,
            equations=equations,
        )

    def _numbers(self) -> dict[str, FloatArray]:
        sides = {"": self.trajectory, "lower_": self.lower, "upper_": self.upper}
        named = {f"{side}{part}": getattr(t, part) for side, t in sides.items() for part in _PARTS}
        return named | {"equations": self.equations, "conditions": self.conditions}

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return the warm start as named arrays for `from_arrays`."""
        about = {
            "model": np.frombuffer(self.model.encode("ascii"), dtype=np.uint8),
            "breakpoints": np.asarray(self.mesh.breakpoints),
            "degrees": np.asarray(self.mesh.degrees),
        }
        if self.cold_start is not None:
            about["cold_start"] = self.cold_start.array
        return about | self._numbers()

    @classmethod
    def from_arrays(cls, held: Mapping[str, NDArray[Any]]) -> WarmStart:
        """Return the warm start held in untrusted arrays.

        Raises
        ------
        TranscriptionError
            Naming the array that is missing or has another type, shape or content.
        """
        mesh = Mesh.from_arrays(held)
        model = held.get("model")
        if model is None or model.dtype != np.uint8 or model.ndim != 1 or np.any(model > 127):
            raise TranscriptionError("model: must be the ASCII codes of a fingerprint.")
        first = real_array(held, "states", (None, None))
        has_time = first.size > 0 or len(first) > 0
        points = mesh.points if has_time else 0
        nodes = points + 1 if has_time else 0
        widths = (first.shape[1], real_array(held, "algebraics", (points, None)).shape[1])
        statics = real_array(held, "statics", (None,)).size
        shapes = ((nodes, widths[0]), (points, widths[1]), (statics,))
        sides = []
        for side in ("", "lower_", "upper_"):
            states, algebraics, values = (
                real_array(held, f"{side}{part}", shape)
                for part, shape in zip(_PARTS, shapes, strict=True)
            )
            sides.append(
                Trajectory(mesh=mesh, states=states, algebraics=algebraics, statics=values)
            )
        return cls(
            model=model.tobytes().decode("ascii"),
            trajectory=sides[0],
            lower=sides[1],
            upper=sides[2],
            equations=real_array(held, "equations", (points, None)),
            conditions=real_array(held, "conditions", (None,)),
            cold_start=ColdStart.from_arrays(held),
        )


def warm_start_of(
    program: Transcription,
    z: FloatArray,
    multipliers: Multipliers,
    cold_start: ColdStart | None,
) -> WarmStart:
    """Return the warm start of a program's point and multipliers."""
    first = program.first_condition_row
    return WarmStart(
        model=program.compiled.fingerprint,
        trajectory=program.trajectory(z),
        lower=program.trajectory(multipliers.lower),
        upper=program.trajectory(multipliers.upper),
        equations=np.array(
            multipliers.rows[:first].reshape(program.n_points, program.compiled.n_equations)
        ),
        conditions=np.array(multipliers.rows[first:]),
        cold_start=cold_start,
    )


def transfer(start: WarmStart, program: Transcription) -> tuple[FloatArray, Multipliers]:
    """Return unknowns and multipliers of a warm start on the mesh of a program.

    Multipliers of quantities imposed at a point, divided by the quadrature weight there, are
    samples of a function of time. This function is interpolated to the new mesh.

    Raises
    ------
    TranscriptionError
        If the warm start belongs to another model.
    """
    if not start.fits(program.compiled):
        raise TranscriptionError(
            "warm_start: the solution is of another model; pass its frame as guess= instead."
        )
    z = point_from_trajectory(program, start.trajectory)
    old, new = start.mesh, program.mesh
    if new is None or old == new:
        rows = np.concatenate([start.equations.ravel(), start.conditions])
        lower, upper = (_assembled(program, side) for side in (start.lower, start.upper))
        return z, Multipliers(rows=rows, lower=lower, upper=upper)
    moved = _carried(old, new, start.equations).ravel()
    sides = [
        Trajectory(
            mesh=new,
            states=np.vstack(
                [side.states[:1], np.maximum(_carried(old, new, side.states[1:]), 0.0)]
            ),
            algebraics=np.maximum(_carried(old, new, side.algebraics), 0.0),
            statics=side.statics,
        )
        for side in (start.lower, start.upper)
    ]
    return z, Multipliers(
        rows=np.concatenate([moved, start.conditions]),
        lower=_assembled(program, sides[0]),
        upper=_assembled(program, sides[1]),
    )


def _assembled(program: Transcription, held: Trajectory) -> FloatArray:
    """Return states, algebraic and static variables on the program's mesh as one vector."""
    layout = program.layout
    z = np.zeros(layout.unknowns)
    z[layout.state_columns] = held.states
    z[layout.algebraic_columns] = held.algebraics
    z[layout.static_columns] = held.statics
    return z


def _carried(old: Mesh, new: Mesh, values: FloatArray) -> FloatArray:
    density = values / old.quadrature_weights[:, None]
    moved = interpolate(old, density, new.point_fractions, with_start=False)
    return moved * new.quadrature_weights[:, None]
