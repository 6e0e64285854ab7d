"""Bounds and scaling of a nonlinear program, and errors for programs that cannot be solved.

The scaling divides each unknown by its magnitude. For the other scaling factors, see
docs/theory/refinement.md, eqs. (12) to (15).

Some arguments have the same meaning in several functions:

- `z`: values of the program's unknowns, usually those of the initial point.
- `start_data`: values of all parameters, one row per time. The times are the start of the horizon,
  and just after each jump of a parameter (`Formulation.data_at_starts`).
- `fixed`: values of variables that are fixed at declared times (members of the continuous set), by
  (name, fraction of the horizon).

Free times are static variables (without time) for times of the horizon: the start, the end or
times in between. The solve determines them. Each must lie after the time before it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np
from scipy.sparse import block_array, coo_array, diags_array, identity
from scipy.sparse.linalg import splu

from pyomo_quad.collocation.errors import TranscriptionError
from pyomo_quad.collocation.program.compiled import MappedFunction
from pyomo_quad.collocation.program.nonlinear import Bounds, Scaling
from pyomo_quad.collocation.program.transcription import row_place, unknown_place

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from numpy.typing import NDArray

    from pyomo_quad.collocation.mesh import FloatArray
    from pyomo_quad.collocation.program.nonlinear import NonlinearProgram
    from pyomo_quad.collocation.program.transcription import Transcription
    from pyomo_quad.collocation.reading.symbols import Slot


@dataclass(frozen=True, kw_only=True)
class Limit:
    """Bounds that one Pyomo variable or constraint imposes on unknowns of the nonlinear program.

    Attributes
    ----------
    name : str
        Name of the variable or constraint.
    columns : ndarray of int, shape (n,)
        Positions of the bounded unknowns.
    lower, upper : ndarray, shape (n,)
        Bounds of these unknowns, infinite where an unknown has no bound.
    """

    name: str
    columns: NDArray[np.intp]
    lower: FloatArray
    upper: FloatArray


def bounds_of(
    program: Transcription,
    start_data: FloatArray,
    fixed: dict[tuple[str, float], float],
    left_out: frozenset[str] = frozenset(),
) -> Bounds:
    """Evaluate all bounds of a nonlinear program for its current parameter values.

    `left_out` names conditions (constraints at single declared times) that are not imposed.

    Raises
    ------
    TranscriptionError
        If a lower bound exceeds an upper bound, or if bounds contradict the order of free times.
    """
    _refuse_crossed_times(program)
    lower = np.full(program.layout.unknowns, -np.inf)
    upper = np.full(program.layout.unknowns, np.inf)
    for limit in limits_of(program, start_data, fixed):
        if limit.name in left_out:
            continue
        lower[limit.columns] = np.maximum(lower[limit.columns], limit.lower)
        upper[limit.columns] = np.minimum(upper[limit.columns], limit.upper)
    _refuse_crossed(program, lower, upper)
    row_lower, row_upper = _rows(program)
    _refuse_crossed_rows(program, row_lower, row_upper)
    for k, condition in enumerate(program.compiled.declared.conditions if left_out else ()):
        if condition.name in left_out:
            row = program.first_condition_row + k
            row_lower[row], row_upper[row] = -np.inf, np.inf
    return Bounds(lower=lower, upper=upper, row_lower=row_lower, row_upper=row_upper)


def limits_of(
    program: Transcription, start_data: FloatArray, fixed: dict[tuple[str, float], float]
) -> list[Limit]:
    """Return the bounds that each variable or constraint of the model imposes on unknowns.

    A constraint on a single variable counts as a bound of that variable.
    """
    found = list(limits_at_points(program))
    if program.mesh is not None:
        found.extend(_over_time(program, start_data))
        found.extend(_fixed(program, fixed))
    return found


def _rows(program: Transcription) -> tuple[FloatArray, FloatArray]:
    """Return lower and upper bounds of all constraints of the program, shape (n_rows,) each."""
    compiled, data = program.compiled, program.data
    sides = []
    path: list[FloatArray] = [np.zeros(0), np.zeros(0)]
    if program.layout.points:
        mapped = MappedFunction(compiled.path_bounds, program.layout.points)
        path = [side.ravel() for side in mapped(data.at_points())]
    conditions = MappedFunction(compiled.condition_limits, 1)(data.parameters[None, :])
    for side, condition in zip(path, conditions, strict=True):
        definitions = np.zeros(len(compiled.static_of_integral))
        sides.append(np.concatenate([side, condition.ravel(), definitions]))
    return sides[0], sides[1]


def _over_time(program: Transcription, start_data: FloatArray) -> Iterator[Limit]:
    """Yield the bounds of states and algebraic variables at all nodes, as `Limit` objects.

    A constraint over time on a single variable counts as a bound of that variable.
    """
    layout, compiled = program.layout, program.compiled
    mapped = MappedFunction(compiled.limits_over_time, layout.points + 1)
    lower, upper = mapped(np.vstack([start_data[:1], program.data.at_points()]))
    columns = [*layout.state_columns.T, *layout.algebraic_columns.T]
    for k, (limit, variable) in enumerate(zip(compiled.limits, compiled.limited, strict=True)):
        at = columns[variable]
        rows = slice(len(lower) - len(at), None)
        yield Limit(name=limit.name, columns=at, lower=lower[rows, k], upper=upper[rows, k])
    if len(start_data) > 1:
        yield from _after_jumps(program, start_data[1:])


def _after_jumps(program: Transcription, data: FloatArray) -> Iterator[Limit]:
    """Yield the bounds of states just after a jump of a parameter, at the node of the jump.

    `data` has one row per jump, with the parameters just after the jump.
    """
    compiled, layout = program.compiled, program.layout
    nodes = program.mesh.node_fractions if program.mesh else np.zeros(0)
    at = np.abs(nodes[:, None] - data[:, 0]).argmin(axis=0)
    lower, upper = MappedFunction(compiled.limits_over_time, len(data))(data)
    # A bound may jump together with the parameter. The state at the node must satisfy the bound
    # before the jump, which `_over_time` yields, and the bound after it.
    for k in np.flatnonzero(compiled.limited < layout.n_states):
        columns = layout.state_columns[at, compiled.limited[k]]
        name = compiled.limits[k].name
        yield Limit(name=name, columns=columns, lower=lower[:, k], upper=upper[:, k])


def _fixed(program: Transcription, fixed: dict[tuple[str, float], float]) -> Iterator[Limit]:
    """Yield the values of states that are fixed at declared times, as equal bounds at a node.

    `fixed` maps (variable name, fraction of the horizon) to values.
    """
    for (name, fraction), number in fixed.items():
        # The node is the one nearest to the declared time. Other variables than states are skipped.
        column = program.layout.state_column(name, fraction)
        if column >= 0:
            place, held = str(unknown_place(program, column)), np.array([number])
            yield Limit(name=place, columns=np.array([column]), lower=held, upper=held)


def limits_at_points(program: Transcription) -> Iterator[Limit]:
    """Yield the bounds of static variables, and of single states at declared times.

    A condition (constraint at declared times) counts as a bound if it contains only a single state
    or static variable (`CompiledModel.simple_point_bounds`).
    """
    compiled, layout = program.compiled, program.layout
    declared = compiled.declared
    parameters = program.data.parameters[None, :]
    lower, upper = MappedFunction(compiled.static_limits, 1)(parameters)
    for k, slot in enumerate(declared.statics):
        column = layout.static_columns[[k]]
        yield Limit(name=slot.name, columns=column, lower=lower[0, [k]], upper=upper[0, [k]])
    names = [s.name for s in declared.statics]
    points = {p.symbol.name(): k for k, p in enumerate(declared.point_symbols)}
    lower, upper = MappedFunction(compiled.simple_point_limits, 1)(parameters)
    for k, bound in enumerate(compiled.simple_point_bounds):
        if bound.variable in points:
            row = points[bound.variable]
            values = layout.point_values
            column = values.indices[values.indptr[row] : values.indptr[row + 1]]
        else:
            column = layout.static_columns[[names.index(bound.variable)]]
        yield Limit(name=bound.name, columns=column, lower=lower[0, [k]], upper=upper[0, [k]])


def _refuse_crossed(program: Transcription, lower: FloatArray, upper: FloatArray) -> None:
    """Raise an error if the lower bound of an unknown exceeds its upper bound.

    If the excess is only a rounding error, `upper` is set to the lower bound, in place.
    """
    gap = lower - upper
    scale = 1e-9 * (1.0 + np.minimum(np.abs(lower), np.abs(upper)))
    close = (gap > 0.0) & (gap <= scale)
    upper[close] = lower[close]
    worst = int(np.argmax(lower - upper)) if gap.size else 0
    if gap.size and lower[worst] > upper[worst]:
        raise crossed(unknown_place(program, worst), lower[worst], upper[worst])


def _refuse_crossed_times(program: Transcription) -> None:
    """Raise an error if the bounds of free times contradict the order of these times."""
    compiled, clock = program.compiled, program.compiled.declared.clock
    parameters = program.data.parameters
    lower, upper = (np.array(side).ravel() for side in compiled.static_limits(parameters))
    earliest, latest = (np.array(compiled.times(s, parameters)).ravel() for s in (lower, upper))
    before = np.maximum.accumulate(earliest)
    # The lower bound of a time must be below the upper bounds of all later times.
    late = np.flatnonzero(before[:-1] >= latest[1:])
    if clock.is_free and late.size:
        after = int(late[0]) + 1
        first = int(np.argmax(earliest[:after]))
        raise TranscriptionError(
            f"{clock.label(after)}: is at most {latest[after]:g}, but {clock.label(first)} before "
            f"it is at least {earliest[first]:g}; relax the bounds of one of these times."
        )


def _refuse_crossed_rows(program: Transcription, lower: FloatArray, upper: FloatArray) -> None:
    """Raise an error if the lower bound of a constraint exceeds its upper bound."""
    rows = np.flatnonzero(lower > upper)
    if rows.size:
        row = int(rows[0])
        raise crossed(row_place(program, row), lower[row], upper[row])


def crossed(place: object, lower: float, upper: float) -> TranscriptionError:
    """Return the error for a quantity whose lower bound exceeds its upper bound.

    The message begins with `place`, which names the variable or constraint, and its time.
    """
    return TranscriptionError(
        f"{place}: lower bound {lower:g} is above upper bound {upper:g}; relax one of the two."
    )


# Bounds of this size or larger do not count in the magnitude of a variable, in the variable's unit:
# they usually stand for the absence of a bound.
_LARGEST_BOUND = 1e6
# A row whose slopes vanish at the first point, as those of a squared speed do at rest, would get an
# unbounded scale factor. If its slopes at a point displaced by `_BESIDE` times each magnitude are
# larger by a factor 1 / `_FLAT`, those slopes set the scale.
_BESIDE, _FLAT = 1e-2, 1e-2
# Range to which the largest scaled slope of a constraint is clipped before it is inverted.
_ROW_RANGE = (1e-8, 1e8)


def scaling_of(program: Transcription, bounds: Bounds, z: FloatArray) -> Scaling:
    """Return scaling factors of a nonlinear program, for given values of its unknowns.

    The factor of an unknown is 1 / magnitude; see `nominal_magnitudes`. The factors of constraints
    and objective follow from their derivatives at `z`.
    """
    return scaling_by(program, nominal_magnitudes(program, bounds, z), z)


def scaling_by(program: NonlinearProgram, nominal: FloatArray, z: FloatArray) -> Scaling:
    """Return scaling factors of a program whose unknowns have the magnitudes `nominal`.

    The factors are:

    - unknown: 1 / magnitude;
    - constraint: about 1 / largest absolute derivative;
    - objective: 1 / max(abs(objective), largest absolute derivative); 1 if its gradient is 0.

    All derivatives are taken at `z`, with respect to the scaled unknowns.
    """
    largest, beside = (_largest_slopes(program, nominal, at) for at in (z, z + _BESIDE * nominal))
    with np.errstate(invalid="ignore"):
        is_flat = np.isfinite(beside) & (largest < _FLAT * beside)
    largest = np.where(is_flat, beside, largest)
    largest = np.clip(np.where(largest > 0.0, largest, 1.0), *_ROW_RANGE)
    slope = float(np.max(np.abs(program.gradient(z)) * nominal, initial=0.0))
    objective = 1.0 / max(slope, abs(program.objective(z)), 1e-8) if slope > 0.0 else 1.0
    return Scaling(objective=objective, unknowns=1.0 / nominal, rows=1.0 / largest)


def _largest_slopes(program: NonlinearProgram, nominal: FloatArray, z: FloatArray) -> FloatArray:
    """Return the largest absolute derivative of each constraint at `z`, shape (n_rows,).

    The derivatives are taken with respect to the unknowns divided by their magnitudes `nominal`.
    """
    rows, columns = program.jacobianstructure()
    with np.errstate(all="ignore"):
        weighted = np.abs(program.jacobian(z)) * nominal[columns]
    largest = np.zeros(program.n_rows)
    np.maximum.at(largest, rows, weighted)
    return largest


def nominal_magnitudes(program: Transcription, bounds: Bounds, z: FloatArray) -> FloatArray:
    """Return the magnitude of each unknown, on which its scaling depends, shape (n_unknowns,).

    All unknowns of a variable have the same magnitude. It depends on the values of the unknowns in
    `z`, and on their bounds; see `_magnitude`.
    """
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
    """Return the magnitude of one variable, for the scaling of its unknowns.

    The magnitude is 1 / declared scaling factor. Without one, it is the largest absolute
    value of unknowns, and of bounds below 1e6; 1 if all are 0. `columns` are positions in `z`.
    """
    if slot.nominal is not None:
        return slot.nominal
    ends = np.abs(np.concatenate([bounds.lower[columns], bounds.upper[columns]]))
    finite = ends[(ends > 0.0) & (ends < _LARGEST_BOUND)]
    guess = float(np.max(np.abs(z[columns]), initial=0.0))
    size = max(float(np.max(finite, initial=0.0)), guess)
    return size if size > 0.0 else 1.0


def refuse_unsolvable(program: Transcription, bounds: Bounds, z: FloatArray) -> None:
    """Raise an error if a program has infinite or NaN values at `z`, or contradictory equations.

    The equations are checked if there are more equations than free unknowns. They are contradictory
    if they are linear and have no solution. The error is a `TranscriptionError`.
    """
    refuse_not_finite(program, z)
    held = np.flatnonzero(bounds.lower == bounds.upper).tolist()
    names = (unknown_place(program, column).name for column in held)
    refuse_overdetermined(program, bounds, z, names)


def counted(bounds: Bounds) -> str:
    """Return a phrase with the numbers of equations and of free unknowns, for error messages.

    Unknowns with unequal bounds are free; constraints with equal bounds are equations.
    """
    free = int(np.sum(bounds.lower < bounds.upper))
    return f"{bounds.surplus + free} equations for {free} free unknowns"


def refuse_overdetermined(
    program: NonlinearProgram, bounds: Bounds, z: FloatArray, fixed: Iterable[str]
) -> None:
    """Raise TranscriptionError if a program's equations are linear and contradict each other.

    The check is made only if the program has more equations than free unknowns. The equations are
    linearised at `z`, to find out whether they are linear and have a solution. Nonlinear equations
    raise no error. `fixed` are the names of variables with fixed values, for the message.
    """
    # Only a solve can decide whether nonlinear equations have a solution.
    if bounds.surplus > 0 and _is_contradictory(program, bounds, z):
        names = sorted(set(fixed))
        raise TranscriptionError(
            f"model: {counted(bounds)}; it is over-determined. "
            f"Release a fixed value or boundary condition of {', '.join(names[:8]) or 'the model'}"
            ", or add a control."
        )


# Largest scaled residual with which linear equations count as consistent, and the regularisation
# that makes their least-squares solution unique.
_AGREED, _REGULAR = 1e-7, 1e-12


def _is_contradictory(program: NonlinearProgram, bounds: Bounds, z: FloatArray) -> bool:
    """Return whether a program's equations are linear and have no solution.

    The equations are linearised at `z`, and solved for the free unknowns, whose bounds are unequal.
    Apart from fixed unknowns, bounds are ignored.
    """
    rows, columns = program.jacobianstructure()
    slopes = coo_array((program.jacobian(z), (rows, columns)), shape=(program.n_rows, z.size))
    equal = np.flatnonzero(bounds.row_lower == bounds.row_upper)
    free = np.flatnonzero(bounds.lower < bounds.upper)
    slopes = slopes.tocsr()[equal][:, free]
    sizes = 1.0 / np.maximum(abs(slopes).max(axis=1).toarray().ravel(), _ROW_RANGE[0])
    slopes = diags_array(sizes) @ slopes
    m, n = slopes.shape

    def off(point: FloatArray) -> FloatArray:
        return np.asarray((program.constraints(point)[equal] - bounds.row_lower[equal]) * sizes)

    # A least-squares step of the free unknowns minimises the residuals of the equations, linearised
    # at `z`.
    system = block_array([[identity(m), slopes], [slopes.T, -_REGULAR * identity(n)]], format="csc")
    solved = splu(system).solve(np.concatenate([-off(z), np.zeros(n)]))
    left, moved = -solved[:m], np.array(z)
    moved[free] += solved[m:]
    size = float(np.abs(left).max(initial=0.0))
    # Linear equations have the residuals that the linearised equations predict after the step. They
    # have no solution if these residuals are not zero.
    return size > _AGREED and bool(np.all(np.abs(off(moved) - left) <= _AGREED * (1.0 + size)))


# Residual, relative to a row's size, that rounding may leave where all its unknowns are fixed.
_ROUNDING = 1e-9


def without_settled_rows(program: NonlinearProgram, bounds: Bounds, z: FloatArray) -> Bounds:
    """Return bounds in which the bounds of redundant constraints are infinite.

    A constraint is redundant if it is satisfied at `z` and contains fixed unknowns only. An example
    is a path equality at a point where all its states are fixed.
    """
    rows, columns = program.jacobianstructure()
    is_free = bounds.lower < bounds.upper
    moves = np.zeros(program.n_rows, dtype=bool)
    moves[rows[is_free[columns]]] = True
    values = program.constraints(z)
    slack = _ROUNDING * (1.0 + np.abs(values))
    is_met = (bounds.row_lower - slack <= values) & (values <= bounds.row_upper + slack)
    # A settled equality has zero derivatives with respect to all free unknowns. It would make the
    # equations appear linearly dependent.
    settled = is_met & ~moves
    return replace(
        bounds,
        row_lower=np.where(settled, -np.inf, bounds.row_lower),
        row_upper=np.where(settled, np.inf, bounds.row_upper),
    )


def is_defined(program: Transcription, z: FloatArray) -> bool:
    """Return whether constraints, objective gradient and Jacobian contain no NaN at a point.

    `z` are the unknowns at this point. Infinite values count as defined.
    """
    with np.errstate(invalid="ignore"):
        parts = (program.constraints(z), program.jacobian(z), program.gradient(z))
    return not any(bool(np.any(np.isnan(part))) for part in parts)


def refuse_not_finite(program: Transcription, z: FloatArray) -> None:
    """Raise an error if an equation, the objective or a derivative is not finite at the guess `z`.

    Raises
    ------
    TranscriptionError
        The message names the equation with its element and time, and for a derivative the variable.
    """
    rows = program.constraints(z)
    bad = np.flatnonzero(~np.isfinite(rows))
    if bad.size:
        _refuse_value(str(row_place(program, int(bad[0]))), rows[bad[0]])
    if not np.isfinite(program.objective(z)):
        _refuse_value(program.compiled.declared.objective_name, program.objective(z))
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


def _refuse_value(owner: str, number: float) -> NoReturn:
    """Raise the error for an equation or objective that is not finite at the initial guess.

    `owner` is the name of the equation or objective, `number` its value.
    """
    raise TranscriptionError(
        f"{owner}: is {number} at the initial guess; give the variables in it initial values or "
        "bounds where it is defined."
    )


def _refuse_slope(owner: str, variable: str, slope: float) -> NoReturn:
    """Raise the error for a derivative that is not finite at the initial guess.

    `slope` is the derivative of `owner`, an equation or the objective, with respect to `variable`.
    """
    raise TranscriptionError(
        f"{owner}: its derivative by {variable} is {slope} at the initial guess; start or bound "
        "that variable away from the point."
    )
