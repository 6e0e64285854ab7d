"""hp-adaptive refinement: solve, estimate, change the mesh, solve again from there.

Damping of controls that enter linearly: see docs/theory/refinement.md, eq. (9).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any, Generic, Protocol, Self, TypeVar

import numpy as np
from numpy.polynomial.legendre import legvander

from pyomo_quad.collocation.mesh import radau_rule
from pyomo_quad.collocation.program.bounds import ChangedProgram
from pyomo_quad.collocation.program.ipopt import SEEN, Status
from pyomo_quad.collocation.refining.activity import junction_elements
from pyomo_quad.collocation.refining.error import ErrorEstimate, estimate_error
from pyomo_quad.collocation.refining.minimum_principle import improved_controls, state_error
from pyomo_quad.collocation.refining.remeshing import (
    Marks,
    RefinementOptions,
    refined_mesh,
)
from pyomo_quad.collocation.solution import MeshRecord, Solution

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from pyomo_quad.collocation.mesh import FloatArray, Mesh
    from pyomo_quad.collocation.program.ipopt import Iteration
    from pyomo_quad.collocation.program.transcription import Transcription


@dataclass(frozen=True, kw_only=True)
class Damping:
    """What the distance of controls from the course of a solution's costs.

    Their course are the straight lines between their means over the elements.

    Attributes
    ----------
    solution : Solution
        Of the last mesh.
    controls : ndarray of int
        Positions among the algebraic variables.
    prices : ndarray
        For each of them, the price of a unit of its mean square distance over the horizon.
    gap : float
        What the barrier shall leave of the objective, zero for as little as Ipopt does.
    is_still : bool
        Whether the course has been found: then it is the controls themselves.
    """

    solution: Solution
    controls: NDArray[np.intp]
    prices: FloatArray
    gap: float
    is_still: bool

    def firmer(self, factor: float, gap: float) -> Damping:
        """Return the damping, still, with its prices multiplied and that share as gap at least."""
        gap = max(gap * self.solution.nominal_objective, self.gap)
        return replace(self, prices=factor * self.prices, gap=gap, is_still=True)

    def applied_to(self, program: Transcription) -> DampedProgram:
        """Return a program of the same model with the price on its objective."""
        mesh = program.mesh or self.solution.mesh
        return DampedProgram(
            program=program,
            columns=program.layout.algebraic_columns[:, self.controls].ravel(),
            weights=(mesh.quadrature_weights[:, None] * self.prices).ravel(),
            near=self._near(mesh.point_fractions).ravel(),
        )

    def _near(self, fractions: FloatArray) -> FloatArray:
        """Return what the controls are drawn to, shape (n_fractions, n_controls)."""
        mesh, held = self.solution.mesh, self.solution.trajectory.algebraics[:, self.controls]
        if self.is_still:
            lower, upper = (limit[self.controls] for limit in self.solution.algebraic_limits)
            return np.clip(_smoothed(mesh, held, fractions), lower, upper)
        # Toward the points themselves, chatter would be kept.
        middles, means = _element_means(mesh, held)
        near = [np.interp(fractions, middles, mean) for mean in means.T]
        return np.reshape(near, (self.controls.size, fractions.size)).T


def _smoothed(mesh: Mesh, values: FloatArray, fractions: FloatArray) -> FloatArray:
    """Return values at points, in each element by the lower half of their Legendre terms."""
    starts, found = np.asarray(mesh.breakpoints), np.empty((fractions.size, values.shape[1]))
    element = np.clip(np.searchsorted(starts, fractions) - 1, 0, mesh.elements - 1)
    for e in np.unique(element):
        degree, points = mesh.degrees[e], slice(mesh.first_node[e], mesh.first_node[e + 1])
        kept, root = (degree - 1) // 2, np.sqrt(radau_rule(degree).weights)[:, None]
        terms = root * legvander(2.0 * radau_rule(degree).points - 1.0, kept)
        coefficients = np.linalg.lstsq(terms, root * values[points], rcond=None)[0]
        inside = element == e
        places = 2.0 * (fractions[inside] - starts[e]) / mesh.widths[e] - 1.0
        found[inside] = legvander(places, kept) @ coefficients
    return found


def _element_means(mesh: Mesh, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return where the elements have their middles, and the means over each of values at points."""
    weights = mesh.quadrature_weights[:, None]
    columns = np.column_stack([mesh.point_fractions, values, np.ones(mesh.points)])
    sums = np.add.reduceat(weights * columns, mesh.first_node[:-1], axis=0)
    means = sums / sums[:, -1:]
    return means[:, 0], means[:, 1:-1]


def damping_of(
    solution: Solution, weight: float, *, gap: float = 0.0, is_still: bool = False
) -> Damping | None:
    """Return the damping toward a solution.

    None where no bounded control is nearly linear, and the barrier may leave what it does.

    Beside a corner of the cost, which curves at the corner alone, a control chatters like one that
    enters linearly.

    Parameters
    ----------
    solution : Solution
    weight : float
        Share of the objective that a control a whole range away from the solution's costs.
    gap : float, optional
        Share of the objective that the barrier shall leave.
    is_still : bool, optional
        Whether the costs have settled, so that controls are held where they are.
    """
    lower, upper = solution.algebraic_limits
    width = upper - lower
    is_bounded = np.isfinite(width) & (width > 0.0)
    prices, controls = np.zeros(width.size), np.zeros(0, dtype=np.intp)
    if weight > 0.0 and np.any(is_bounded):
        prices[is_bounded] = 2.0 * weight * solution.nominal_objective / width[is_bounded] ** 2
        controls = np.flatnonzero(is_bounded & (_least_curvatures(solution) < prices))
    if controls.size == 0 and gap == 0.0:
        return None
    return Damping(
        solution=solution,
        controls=controls,
        prices=prices[controls],
        gap=gap * solution.nominal_objective,
        is_still=is_still,
    )


def _least_curvatures(solution: Solution) -> FloatArray:
    """Return how little the Lagrangian curves in each algebraic variable, at any point."""
    program = solution.program
    first = 2 * program.layout.n_states
    controls = slice(first, first + program.layout.n_algebraics)
    curvatures = program.path_curvatures(solution.unknowns, solution.multipliers.rows)
    return np.asarray(curvatures[:, controls].min(axis=0))


@dataclass(frozen=True, kw_only=True)
class DampedProgram(ChangedProgram):
    """A program with `weights / 2 * (z[columns] - near)**2` added to what Ipopt minimises."""

    columns: NDArray[np.intp]
    weights: FloatArray
    near: FloatArray

    def objective(self, z: FloatArray) -> float:
        """Return the objective and the price of the distance."""
        away = z[self.columns] - self.near
        return self.program.objective(z) + 0.5 * float(self.weights @ away**2)

    def gradient(self, z: FloatArray) -> FloatArray:
        """Return the gradient of the objective."""
        gradient = np.array(self.program.gradient(z))
        gradient[self.columns] += self.weights * (z[self.columns] - self.near)
        return gradient

    def hessianstructure(self) -> tuple[Any, Any]:
        """Return rows and columns of the Lagrangian Hessian's lower triangle."""
        rows, columns = self.program.hessianstructure()
        return np.concatenate([rows, self.columns]), np.concatenate([columns, self.columns])

    def hessian(self, z: FloatArray, multipliers: FloatArray, factor: float) -> FloatArray:
        """Return the nonzeros of the Lagrangian's Hessian."""
        held = self.program.hessian(z, multipliers, factor)
        return np.concatenate([held, factor * self.weights])


# The objective's last change, as a share of the tolerance, at which it counts as settled.
_SETTLED = 0.5
# A warm start that takes more iterations than this leaves its linear controls undetermined, as do
# costs that settled so many meshes ago: they are damped so many times more, up to so many, and
# without end where that was twice as many ago.
_MANY_ITERATIONS, _MANY_SETTLED, _TOO_MANY_SETTLED = 30, 4, 8
_FIRMER, _FIRM, _FIRMEST = 5.0, 25.0, 125.0
# What the barrier then leaves of the objective: a share of the tolerance, and of it at most.
_GAP, _LARGEST_GAP = 0.03, 3e-7
# Where limits move, it leaves this share of the error that the last mesh had, of the tolerance at
# least, and of the objective at most: what is not known yet is not worth sharpening.
_INEXACT, _LEAST_INEXACT, _MOST_INEXACT = 0.3, 0.2, 1e-3
# Searches from one mesh to the next that took so many iterations twice in succession, and left more
# than this share of the error, are lost.
_LOST_ITERATIONS, _LEFT = 150, 0.5
# Times that a solution is started anew from the controls that minimise the Hamiltonian.
_IMPROVEMENTS = 8


class Solved(Protocol):
    """A solution on one mesh or, of several horizons, on one each."""

    @property
    def parts(self) -> tuple[Solution, ...]:
        """The solution on each horizon, with the history of the whole."""

    @property
    def status(self) -> Status:
        """How the solve ended."""

    @property
    def ipopt_code(self) -> int:
        """Ipopt's own return code."""

    @property
    def iterations(self) -> tuple[Iteration, ...]:
        """Ipopt's progress."""

    @property
    def objective(self) -> float:
        """As declared."""

    @property
    def message(self) -> str:
        """Why the solve ended."""

    @property
    def wall_s(self) -> float:
        """Time of the solve."""

    @property
    def warm_start(self) -> Any:
        """What another solve can start from."""

    def updated(self, **changes: Any) -> Self:
        """Return it with other attributes."""


S = TypeVar("S", bound=Solved)


def refine(
    solve: Callable[..., S],
    *,
    meshes: tuple[Mesh, ...],
    tolerance: float,
    refinement: RefinementOptions,
    warm_start: Any,
    past_the_barrier: Callable[[tuple[Damping | None, ...], S], S] | None = None,
) -> S:
    """Solve on finer and finer meshes until the error estimate meets the tolerance.

    Where limits begin or cease to hold inside an element, or controls are damped, the
    objective must also have settled to the tolerance between the last two meshes.

    Parameters
    ----------
    solve : callable
        (meshes, warm start, dampings, change=) -> solution, with one mesh and damping for each
        horizon, and by how much the objective is expected to change, None where nothing tells.
    meshes : tuple
        To begin with, one for each horizon.
    past_the_barrier : callable, optional
        (dampings, solution) -> a solution on the same meshes with less of the barrier's gap.

    Returns
    -------
    Solved
        `converged`, or `tolerance_not_met` with the smallest error reached in its message,
        or the status of the solve that failed.
    """
    chosen = meshes
    records: list[MeshRecord] = []
    dampings: tuple[Damping | None, ...] = (None,) * len(chosen)
    firmness, improvements, settled = 1.0, 0, 0
    gap = min(_GAP * tolerance, _LARGEST_GAP)
    reached: _Reached[S] | None = None
    before: tuple[Solution | None, ...] = (None,) * len(chosen)
    while True:
        change = _expected_change(before, tolerance)
        solved, dampings = _solved(solve, chosen, warm_start, dampings, change, gap)
        is_damped = _are_damped(dampings)
        sharpen = past_the_barrier and partial(past_the_barrier, _sharper(dampings, tolerance))
        is_left = any(d is not None and d.gap > 0.0 for d in dampings)
        solved, errors = _measured(solved, sharpen, tolerance, refinement, is_left=is_left)
        error = max(e.largest for e in errors)
        records.append(_record(solved, error))
        solution = solved.updated(error_estimate=error, history=tuple(records))
        solution = _shown(solution, refinement)
        if solution.status is not Status.CONVERGED:
            return _lost(solution, reached, tolerance) if solved.status.has_failed else solution
        if reached is not None:
            reached.compare(solution, error)
        finer = _next_meshes(solution, errors, tolerance, refinement, is_damped=is_damped)
        if finer is None:
            met = _with_state_error(solution, errors, before, tolerance)
            ended, better = _ended_or_better(met, reached, _IMPROVEMENTS - improvements, tolerance)
            if better is None:
                return ended
            reached = _Reached(met, earned=0.0 if reached is None else reached.gain(met))
            improvements += 1
            chosen, warm_start, before = _meshes(solution), better.warm_start, (None,)
            weight = firmness * refinement.damping * tolerance
            dampings = (damping_of(better, weight),)
            continue
        is_stuck = finer == _meshes(solution) and error > tolerance
        if is_stuck or len(records) >= refinement.max_meshes or _is_lost(records):
            ended = _given_up(solution, before, error, tolerance)
            if reached is not None and reached.earned > tolerance and not is_stuck:
                return _cut_off(reached)
            return _lost(_with_state_error(ended, errors, before, tolerance), reached, tolerance)
        settled += is_damped and _has_settled(solution, tolerance)
        is_stalled = settled >= _MANY_SETTLED
        if is_damped and (is_stalled or records[-1].iterations > _MANY_ITERATIONS):
            firmness = _firmer(firmness, settled)
        chosen, warm_start, before = finer, solution.warm_start, solution.parts
        weight = firmness * refinement.damping * tolerance
        left = gap if is_stalled else 0.0
        if refinement.limits_move and not is_stalled:
            left = _gap_to_leave(solution, errors, tolerance)
        dampings = tuple(
            damping_of(part, weight, gap=left, is_still=is_stalled) for part in solution.parts
        )


def _shown(solution: S, refinement: RefinementOptions) -> S:
    """Show a finished solution to the caller, and return it: interrupted if the caller says so."""
    is_finished = solution.status is Status.CONVERGED
    if is_finished and refinement.on_mesh and refinement.on_mesh(solution) is False:
        return solution.updated(status=Status.INTERRUPTED, message="stopped by the caller")
    return solution


def _firmer(firmness: float, settled: int) -> float:
    """Return how firmly to damp from now on, where costs have settled on so many meshes."""
    most = _FIRMEST if settled >= _MANY_SETTLED else _FIRM
    most = math.inf if settled >= _TOO_MANY_SETTLED else most
    return max(firmness, min(_FIRMER * firmness, most))


def _solved(
    solve: Callable[..., S],
    meshes: tuple[Mesh, ...],
    warm_start: Any,
    dampings: tuple[Damping | None, ...],
    change: float | None,
    gap: float,
) -> tuple[S, tuple[Damping | None, ...]]:
    """Solve; where that fails, from a larger barrier, more firmly damped, then from the guess."""
    solved = solve(meshes, warm_start, dampings, change=change)
    if solved.status.has_failed and (change is not None or _are_damped(dampings)):
        dampings = tuple(d and d.firmer(_FIRM, gap) for d in dampings)
        solved = solve(meshes, warm_start, dampings)
    if solved.status.has_failed and warm_start is not None:
        solved = solve(meshes, None, dampings)
    return solved, dampings


def _measured(
    solved: S,
    sharpen: Callable[[S], S] | None,
    tolerance: float,
    refinement: RefinementOptions,
    *,
    is_left: bool,
) -> tuple[S, tuple[ErrorEstimate, ...]]:
    """Return a solution and its errors, with less of the barrier where that is in the way.

    A gap that `is_left` on purpose, which the next mesh leaves less of, is in the way of nothing
    but the tolerance.
    """
    errors = _errors(solved, tolerance, refinement)
    fine = tolerance if is_left else max(tolerance, errors[0].gap)
    if sharpen is not None and _is_held_by_the_barrier(solved, errors, tolerance, fine):
        solved = sharpen(solved)
        errors = _errors(solved, tolerance, refinement)
    return solved, errors


def _gap_to_leave(solution: Solved, errors: tuple[ErrorEstimate, ...], tolerance: float) -> float:
    """Return what the barrier shall leave of the objective where limits move, as a share of it."""
    unknown = max(e.of_integrals for e in errors)
    if any(part.restraint is not None for part in solution.parts):
        # Bounds kept everywhere hide that the mesh is too coarse for the optimum.
        unknown = max(unknown, _objective_change(solution.parts[0], tolerance))
    return max(min(_INEXACT * unknown, _MOST_INEXACT), _LEAST_INEXACT * tolerance)


def _sharper(dampings: tuple[Damping | None, ...], tolerance: float) -> tuple[Damping | None, ...]:
    """Return dampings that leave no more of the objective than the tolerance allows."""
    least = _LEAST_INEXACT * tolerance
    return tuple(
        d and replace(d, gap=min(least * d.solution.nominal_objective, d.gap)) for d in dampings
    )


def _are_damped(dampings: tuple[Damping | None, ...]) -> bool:
    return any(damping is not None and damping.controls.size > 0 for damping in dampings)


def _with_state_error(
    solution: S,
    errors: tuple[ErrorEstimate, ...],
    before: tuple[Solution | None, ...],
    tolerance: float,
) -> S:
    """Return a solution with what its states may be off by, all horizons together."""
    change = _objective_change(solution.parts[0], tolerance)
    change = change if np.isfinite(change) else 0.0
    parts = zip(solution.parts, errors, before, strict=True)
    found = [
        state_error(part, error, last if junction_elements(part) else None, change)
        for part, error, last in parts
    ]
    return solution.updated(state_error=max(found))


def _errors(
    solution: Solved, tolerance: float, refinement: RefinementOptions
) -> tuple[ErrorEstimate, ...]:
    """Return the errors on each horizon; the gap of several is not shared out among them."""
    estimate = partial(estimate_error, tolerance=tolerance, allowance=refinement.allowance)
    errors = tuple(estimate(part) for part in solution.parts)
    return errors if len(errors) == 1 else tuple(replace(e, gap=0.0) for e in errors)


def _is_held_by_the_barrier(
    solution: Solved, errors: tuple[ErrorEstimate, ...], tolerance: float, fine: float
) -> bool:
    """Say whether the barrier, or a scaling that hides the objective, is in the way.

    It is where the barrier alone is above the tolerance, and no element errs by more than `fine`.
    """
    (part,), (error,) = solution.parts, errors
    counted = replace(error, switches=0.0 * error.switches, costs=0.0 * error.costs)
    is_fine = counted.per_element.max(initial=0.0) <= fine
    size = part.program.objective_size(part.unknowns) * part.scaling.objective
    is_hidden = size < SEEN and part.problem.compiled.declared.objective_name != ""
    is_solved = solution.status is Status.CONVERGED
    return is_solved and is_fine and (error.gap > tolerance or is_hidden)


@dataclass
class _Reached(Generic[S]):
    """A solution that met the tolerance before a restart by Pontryagin's principle.

    Attributes
    ----------
    solution : Solved
    shown : float, optional
        What the restart has shown to be gained, relative to the objective: by how much any of its
        solutions is better, less that one's own error; None before there is one.
    earned : float
        What it gained over the solution before it, relative to the objective.
    """

    solution: S
    shown: float | None = None
    earned: float = 0.0

    def gain(self, other: S) -> float:
        """Return by how much another solution is better, relative to the objective."""
        first = self.solution.parts[0]
        earned = self.solution.objective - other.objective
        is_maximised = first.problem.compiled.declared.maximise
        return (-earned if is_maximised else earned) / first.nominal_objective

    def compare(self, other: S, error: float) -> None:
        """Take note of what a solution of the restart shows, whose error is given."""
        shown = self.gain(other) - error
        self.shown = shown if self.shown is None else max(self.shown, shown)

    def better(self, other: S) -> S:
        """Return the better of both, which meet the tolerance."""
        if self.gain(other) >= 0.0:
            return other
        return self.solution.updated(history=other.parts[0].history)


def _lost(ended: S, reached: _Reached[S] | None, tolerance: float) -> S:
    """Return how a search ends that met no tolerance, or what was reached before its restart.

    That stands, unless the restart has shown a better solution or led to none at all.
    """
    if reached is None:
        return ended
    is_refuted = reached.shown is None or reached.shown > tolerance
    return _doubted(reached.solution) if is_refuted else reached.solution


def _cut_off(reached: _Reached[S]) -> S:
    """Return what was reached by a restart, where the next one ran out of meshes.

    It may be off by as much as that restart earned.
    """
    own = reached.solution.parts[0].error_estimate
    return _doubted(reached.solution.updated(error_estimate=max(own, reached.earned)))


def _ended_or_better(
    met: S, reached: _Reached[S] | None, restarts: int, tolerance: float
) -> tuple[S, Solution | None]:
    """Return what to end with, or better controls to start a solution that met the tolerance from.

    A restart that earned less than the tolerance is the last: the Hamiltonian of a singular control
    is so flat that rounding alone finds lower points of it for ever.
    """
    if reached is not None and reached.gain(met) <= tolerance:
        return reached.better(met), None
    better = _improved(met, tolerance)
    if better is not None and restarts == 0:
        return _doubted(met), None
    return met, better


def _doubted(solution: S) -> S:
    """Return a solution that says that it is the best of small changes only."""
    return solution.updated(
        status=Status.TOLERANCE_NOT_MET,
        message=(
            "by Pontryagin's principle another control earns more than the tolerance, but no "
            "optimum was found from it; begin from another guess, or try `starts=6`."
        ),
    )


def _improved(solution: Solved, tolerance: float) -> Solution | None:
    """Return better controls to start from, None where there are none or several horizons."""
    parts = solution.parts
    return improved_controls(parts[0], tolerance) if len(parts) == 1 else None


def _meshes(solution: Solved) -> tuple[Mesh, ...]:
    return tuple(part.mesh for part in solution.parts)


def _next_meshes(
    solution: Solved,
    errors: tuple[ErrorEstimate, ...],
    tolerance: float,
    refinement: RefinementOptions,
    *,
    is_damped: bool,
) -> tuple[Mesh, ...] | None:
    """Return the meshes to solve on next, None when the tolerance is met.

    They may be the same once more, while the damping still moves the objective.
    """
    parts = solution.parts
    junctions = [junction_elements(part) for part in parts]
    is_met = all(error.largest <= tolerance for error in errors)
    has_settled = _has_settled(solution, tolerance)
    if is_met and (has_settled or not (any(junctions) or is_damped)):
        return None
    are_left = has_settled or (refinement.limits_move and not is_met)
    finer = []
    for part, error, mine in zip(parts, errors, junctions, strict=True):
        marks = Marks(
            coarse=frozenset(np.flatnonzero(error.per_element > tolerance).tolist())
            | (frozenset() if are_left else mine),
            kept=mine,
        )
        finer.append(refined_mesh(part, error, marks, tolerance, refinement))
    is_same = tuple(finer) == _meshes(solution)
    return None if is_same and is_met and not is_damped else tuple(finer)


def _expected_change(before: tuple[Solution | None, ...], tolerance: float) -> float | None:
    """Return the last change of the objective, of which the next is expected to be no larger."""
    last = before[0]
    change = math.inf if last is None else _objective_change(last, tolerance)
    return change * last.nominal_objective if last is not None and math.isfinite(change) else None


def _has_settled(solution: Solved, tolerance: float) -> bool:
    """Say whether the last mesh changed the objective by little."""
    return _objective_change(solution.parts[0], tolerance) <= _SETTLED * tolerance


def _objective_change(solution: Solution, tolerance: float) -> float:
    """Return by how much the objective moved, relative, from the last mesh but one.

    Or from any mesh that met the tolerance: one that did not, between two that agree, says nothing.
    """
    *before, now = solution.history
    met = [record for record in before[:-1] if record.error <= tolerance]
    moved = [abs(now.objective - record.objective) for record in (*met, *before[-1:])]
    return min(moved, default=math.inf) / solution.nominal_objective


def _is_lost(records: Sequence[MeshRecord]) -> bool:
    """Say whether two searches in succession were long, and the second gained next to nothing."""
    if len(records) < 3:
        return False
    last, now = records[-2:]
    is_long = min(last.iterations, now.iterations) > _LOST_ITERATIONS
    return is_long and now.error > _LEFT * last.error


def _given_up(
    solution: S, before: tuple[Solution | None, ...], error: float, tolerance: float
) -> S:
    history = solution.parts[0].history
    why = "allow more meshes, elements or a higher degree, or ask for less."
    if _is_lost(history):
        why = (
            f"the last two took {history[-2].iterations} and {history[-1].iterations} iterations "
            f"and gained nothing; {_most_moved(solution, before)}begin from a better guess, or let "
            "the controls' squares cost a little."
        )
    return solution.updated(
        status=Status.TOLERANCE_NOT_MET,
        message=(
            f"refinement stopped after {len(history)} meshes with an estimated error of "
            f"{error:.3g}, above the tolerance {tolerance:.3g}; {why}"
        ),
    )


def _most_moved(solution: Solved, before: tuple[Solution | None, ...]) -> str:
    """Return what says which control the last mesh moved most, where, and by how much."""
    found = []
    for part, last in zip(solution.parts, before, strict=True):
        if last is None or part.trajectory.algebraics.size == 0:
            continue
        mesh, lower, upper = part.mesh, *part.algebraic_limits
        now, then = (s.trajectory.algebraics_at(mesh.point_fractions) for s in (part, last))
        own = np.ptp(now, axis=0)
        ranges = np.where(np.isfinite(upper - lower), upper - lower, own)
        shares = np.abs(now - np.clip(then, lower, upper)) / np.where(ranges > 0.0, ranges, 1.0)
        means = mesh.quadrature_weights @ shares
        k = int(means.argmax())
        point = int(shares[:, k].argmax())
        time = float(part.timeline.time(mesh.point_fractions[point]))
        name = part.problem.compiled.declared.algebraics[k].name
        line = f"{name} still moves, at {time:.4g} by {shares[point, k]:.0%} of its range: "
        found.append((means[k], line))
    return max(found)[1] if found else ""


def _record(solution: Solved, error: float) -> MeshRecord:
    return MeshRecord(
        elements=sum(mesh.elements for mesh in _meshes(solution)),
        points=sum(mesh.points for mesh in _meshes(solution)),
        iterations=solution.iterations[-1].iteration if solution.iterations else 0,
        objective=solution.objective,
        error=error,
        wall_s=solution.wall_s,
    )
