"""hp-adaptive mesh refinement: solve, estimate the error, change the mesh, solve again.

Terms (see docs/theory/refinement.md):

- Damping: penalty on changes of controls since the previous mesh. Only controls on which equations
  and objective depend nearly linearly are damped.
- Complementarity gap: error that Ipopt's barrier leaves in the objective, eq. (16).
- Settled objective: its relative change since the previous mesh, or since an earlier mesh that met
  the tolerance, is at most half the tolerance.
- Horizon: interval of time with its own mesh. A joint problem has several, such as phases.
- Restart: new start of the refinement from controls with a lower Hamiltonian.
- Nominal magnitude of the objective: `Solution.nominal_objective`.
- Strategy: way to solve on a mesh, for example from the previous solution or with stronger damping.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Generic, TypeVar

import numpy as np

from pyomo_quad.collocation.program.ipopt import SEEN, Status
from pyomo_quad.collocation.refining.activity import junction_elements
from pyomo_quad.collocation.refining.damping import Damping, damping_of
from pyomo_quad.collocation.refining.error import ErrorEstimate, estimate_error
from pyomo_quad.collocation.refining.minimum_principle import improved_controls, state_error
from pyomo_quad.collocation.refining.remeshing import (
    Marks,
    RefinementOptions,
    refined_mesh,
)
from pyomo_quad.collocation.solution import MeshRecord, Outcome, Solution
from pyomo_quad.collocation.strategies import (
    MOST_RESTARTS,
    RESTART,
    Fact,
    First,
    Scope,
    Search,
    Strategy,
    first_success,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from pyomo_quad.collocation.mesh import Mesh
    from pyomo_quad.collocation.starts import Start

# Change of the objective, in units of the tolerance, below which it counts as settled.
_SETTLED = 0.5
# Controls that enter linearly count as undetermined if a warm start takes more than
# `_MANY_ITERATIONS`, or if the objective has been settled for `_MANY_SETTLED` meshes. Their damping
# is then increased by a factor, up to a limit; after `_TOO_MANY_SETTLED` meshes without a limit.
_MANY_ITERATIONS, _MANY_SETTLED, _TOO_MANY_SETTLED = 30, 4, 8
# Factor by which the damping is increased at once; limit of the damping before `_MANY_SETTLED`
# meshes; and its limit from then to `_TOO_MANY_SETTLED` meshes.
_FIRMER, _FIRM, _FIRMEST = 5.0, 25.0, 125.0
# Complementarity gap that the barrier then leaves: in units of the tolerance, and at most this
# fraction of the objective.
_GAP, _LARGEST_GAP = 0.03, 3e-7
# With the option `limits_move`, the gap is this fraction of the last mesh's error, at least this
# fraction of the tolerance, and at most this fraction of the objective: precision below the present
# error is not useful.
_INEXACT, _LEAST_INEXACT, _MOST_INEXACT = 0.3, 0.2, 1e-3
# A refinement is abandoned after two consecutive solves with so many iterations, if the second
# leaves more than this fraction of the error.
_LOST_ITERATIONS, _LEFT = 150, 0.5
S = TypeVar("S", bound=Outcome)


def refine(
    solve: Callable[..., S],
    *,
    meshes: tuple[Mesh, ...],
    tolerance: float,
    refinement: RefinementOptions,
    start: Start,
    past_the_barrier: Callable[[tuple[Damping | None, ...], S], S] | None = None,
) -> S:
    """Solve on finer meshes until the error estimate meets the tolerance.

    If controls are damped, or limits become active or inactive inside an element, the objective
    must have settled, too. It need not settle if `refinement.allowance.state_error` is given: the
    caller then simulates the solution with feedback. A result that falls short has
    `Status.TOLERANCE_NOT_MET` or its last solve's status.

    Parameters
    ----------
    solve : callable
        Called as solve(meshes, start, dampings, change=, iteration_limit=); returns the solution.
        `change` is the expected change of the objective, None if unknown. `iteration_limit` is the
        largest number of Ipopt's iterations.
    meshes : tuple of Mesh
        First meshes, one for each horizon.
    tolerance : float
    refinement : RefinementOptions
    start : Start
        Start of the first solve.
    past_the_barrier : callable, optional
        Called as past_the_barrier(dampings, solution) if Ipopt's barrier limits the accuracy of a
        solution. Returns a solution on the same meshes with a smaller complementarity gap.
        `dampings` has one item for each horizon, None without damping.
    """
    going = _Refinement(
        solve, meshes, tolerance, refinement, start, past_the_barrier, before=(None,) * len(meshes)
    )
    known, ended = refinement.known, None
    if known is not None and start.warm is not None and meshes == _meshes(known):
        ended = going.continue_from(known)
    while ended is None:
        ended = going.with_next_meshes()
    # After a restart that led to no better solution, this is the solution from before the restart.
    return ended


@dataclass
class _Refinement(Generic[S]):
    """Mesh refinement in progress: the next meshes with their start, and the previous results.

    Tuples have one item for each horizon.
    """

    # (meshes, start, dampings, change=, iteration_limit=) -> solution. A damping is None without a
    # penalty. `change` is the expected change of the objective.
    solve: Callable[..., S]
    meshes: tuple[Mesh, ...]
    tolerance: float
    options: RefinementOptions
    start: Start
    # Argument `past_the_barrier` of the function `refine`: (dampings, solution) -> solution on the
    # same meshes, with a smaller complementarity gap.
    sharpen: Callable[[tuple[Damping | None, ...], S], S] | None
    # Previous solutions; None before the first solve and after a restart.
    before: tuple[Solution | None, ...]
    records: list[MeshRecord] = field(default_factory=list)
    # Name and status of each solution strategy that was tried; only the name of a restart.
    tried: list[str] = field(default_factory=list)
    dampings: tuple[Damping | None, ...] = ()
    # Factor on the strength of the damping.
    firmness: float = 1.0
    # Number of meshes with damping on which the objective was settled.
    settled: int = 0
    restarts: int = 0
    # The solution that met the tolerance before the most recent restart.
    reached: _Reached[S] | None = None

    def __post_init__(self) -> None:
        # Relative complementarity gap at which a solve with increased damping may stop.
        self.gap = min(_GAP * self.tolerance, _LARGEST_GAP)
        self.dampings = (None,) * len(self.meshes)

    def with_next_meshes(self) -> S | None:
        """Solve on the next meshes, and choose the meshes for the solve after that.

        The result is the final solution if the refinement ends, and None if it continues.
        """
        solution, errors, has_failed = self._solved()
        if solution.status is not Status.CONVERGED:
            return (
                _result_above_tolerance(solution, self.reached, self.tolerance)
                if has_failed
                else solution
            )
        return self._advanced(solution, errors)

    def continue_from(self, known: S) -> S | None:
        """Choose the next meshes after a known solution, without a new solve.

        `known` has converged on the first meshes. The result is the final solution, or None if the
        refinement continues.
        """
        errors = self._errors(known)
        # Ipopt converged, even if an earlier refinement ended above its tolerance.
        solution = self._recorded(known, errors, status=Status.CONVERGED)
        return self._advanced(solution, errors) if solution.status is Status.CONVERGED else solution

    def _advanced(self, solution: S, errors: tuple[ErrorEstimate, ...]) -> S | None:
        """Choose the next meshes after a converged solution, or return the final solution.

        The result is None if the refinement continues.
        """
        error, is_damped = max(e.largest for e in errors), _are_damped(self.dampings)
        if self.reached is not None:
            self.reached.compare(solution, error)
        finer = self._next_meshes(solution, errors, is_damped=is_damped)
        if finer is None:
            return self._restarted(self._with_state_error(solution, errors))
        is_stuck = finer == _meshes(solution) and error > self.tolerance
        has_no_more = len(self.records) >= self.options.max_meshes
        if is_stuck or has_no_more or _gains_too_little(self.records):
            ended = self._given_up(solution, error)
            if self.reached is not None and self.reached.earned > self.tolerance and not is_stuck:
                return _cut_off(self.reached)
            ended = self._with_state_error(ended, errors)
            return _result_above_tolerance(ended, self.reached, self.tolerance)
        self._go_on(solution, errors, finer, is_damped=is_damped)
        return None

    def _solved(self) -> tuple[S, tuple[ErrorEstimate, ...], bool]:
        """Solve on the next meshes, and estimate the errors.

        The last item of the result states whether the solve failed. An interrupted solve has not
        failed.
        """
        change = self._expected_change()
        search = _MeshSolve(self.solve, self.meshes, self.start, self.dampings, change, self.gap)
        solved = first_success(Scope.MESH, search)
        self.dampings = search.dampings
        solved, errors = self._measured(solved)
        self.tried.extend(solved.tried)
        solution = self._recorded(solved, errors, tried=tuple(self.tried))
        return solution, errors, solved.status.has_failed

    def _recorded(self, solved: S, errors: tuple[ErrorEstimate, ...], **more: Any) -> S:
        """Add a solution to the history, and pass it to the caller's callback.

        The result is a copy with error and history, and with the attributes in `more`.
        """
        error = max(e.largest for e in errors)
        self.records.append(_record(solved, error))
        return self._shown(
            solved.updated(error_estimate=error, history=tuple(self.records), **more)
        )

    def _restarted(self, accepted: S) -> S | None:
        """Restart the refinement if Pontryagin's principle shows better controls than `accepted`.

        The result is None if the refinement restarts, and the final solution otherwise.
        """
        # A further restart requires that the previous one improved the objective by more than the
        # tolerance. The rule makes the restarts end. Singular controls need it: their Hamiltonian
        # is so flat that rounding errors can make other controls appear better.
        if self.reached is not None and self.reached.gain(accepted) <= self.tolerance:
            return self.reached.better(accepted)
        # The principle is applied to a single horizon only.
        parts = accepted.parts
        better = improved_controls(parts[0], self.tolerance) if len(parts) == 1 else None
        if better is None or self.restarts == MOST_RESTARTS:
            return accepted if better is None else _doubted(accepted)
        self.reached = _Reached(
            accepted, earned=0.0 if self.reached is None else self.reached.gain(accepted)
        )
        self.restarts += 1
        self.tried.append(RESTART)
        self._begin_at(better.warm_start, _meshes(accepted), (None,))
        self.dampings = self._damped((better,))
        return None

    def _go_on(
        self,
        solution: S,
        errors: tuple[ErrorEstimate, ...],
        finer: tuple[Mesh, ...],
        *,
        is_damped: bool,
    ) -> None:
        """Prepare the next solve, after a solution that is not accurate enough.

        `finer` are the next meshes, one for each horizon. `is_damped` states whether the solve that
        led to `solution` damped controls.
        """
        self.settled += is_damped and self._has_settled(solution)
        # Controls count as stalled if the objective has been settled on several damped meshes.
        is_stalled = self.settled >= _MANY_SETTLED
        if is_damped and (is_stalled or self.records[-1].iterations > _MANY_ITERATIONS):
            self.firmness = _firmer(self.firmness, self.settled)
        left = self.gap if is_stalled else 0.0
        if self.options.limits_move and not is_stalled:
            left = self._gap_to_leave(solution, errors)
        self._begin_at(solution.warm_start, finer, solution.parts)
        self.dampings = self._damped(solution.parts, gap=left, is_still=is_stalled)

    def _begin_at(
        self, warm: Any, meshes: tuple[Mesh, ...], before: tuple[Solution | None, ...]
    ) -> None:
        """Set warm start, meshes and previous solutions for the next solve.

        `warm` is the attribute `warm_start` of a solution.
        """
        self.start, self.meshes, self.before = replace(self.start, warm=warm), meshes, before

    def _damped(self, parts: tuple[Solution, ...], **how: Any) -> tuple[Damping | None, ...]:
        """Return the damping of the controls towards the solution in `parts`, for each horizon.

        `how` has optional arguments of the function `damping_of`.
        """
        weight = self.firmness * self.options.damping * self.tolerance
        return tuple(damping_of(part, weight, **how) for part in parts)

    def _measured(self, solved: S) -> tuple[S, tuple[ErrorEstimate, ...]]:
        """Estimate the errors of a solution, and reduce its complementarity gap if necessary.

        If a further solve reduces the gap, the result is the solution of that solve, otherwise
        `solved`; and its errors on each horizon.
        """
        errors = self._errors(solved)
        # A solve with damping may stop at a large gap on purpose: later solves on finer meshes
        # reduce the gap. Its gap is reduced here only if all other errors meet the tolerance.
        is_left = any(d is not None and d.gap > 0.0 for d in self.dampings)
        fine = self.tolerance if is_left else max(self.tolerance, errors[0].gap)
        if self.sharpen and _is_limited_by_the_barrier(solved, errors, self.tolerance, fine):
            solved = self.sharpen(_sharper(self.dampings, self.tolerance), solved)
            errors = self._errors(solved)
        return solved, errors

    def _errors(self, solution: Outcome) -> tuple[ErrorEstimate, ...]:
        """Return the error estimate of a solution on each horizon."""
        how: dict[str, Any] = {"tolerance": self.tolerance, "allowance": self.options.allowance}
        errors = tuple(estimate_error(part, **how) for part in solution.parts)
        # The gap of a joint solve cannot be attributed to a single horizon.
        return errors if len(errors) == 1 else tuple(replace(e, gap=0.0) for e in errors)

    def _with_state_error(self, solution: S, errors: tuple[ErrorEstimate, ...]) -> S:
        """Return a copy with the estimated distance of the states from the optimal states.

        The attribute `state_error` of the copy has the largest distance of all horizons.
        """
        change = _objective_change(solution.parts[0], self.tolerance)
        change = change if np.isfinite(change) else 0.0
        parts = zip(solution.parts, errors, self.before, strict=True)
        found = [
            state_error(part, error, last if junction_elements(part) else None, change)
            for part, error, last in parts
        ]
        return solution.updated(state_error=max(found))

    def _next_meshes(
        self, solution: Outcome, errors: tuple[ErrorEstimate, ...], *, is_damped: bool
    ) -> tuple[Mesh, ...] | None:
        """Return the next meshes, one for each horizon, or None if the refinement may end.

        For the conditions of the end, see `refine`. `is_damped` states whether the solve that led
        to `solution` damped controls.
        """
        parts = solution.parts
        junctions = [junction_elements(part) for part in parts]
        is_met = all(error.largest <= self.tolerance for error in errors)
        has_settled = self._has_settled(solution)
        # A simulation that corrects the controls shows what the junctions between the points cost.
        is_simulated = self.options.allowance.state_error is not None
        # Without such a simulation, the objective must settle if limits become active or inactive
        # inside elements, or if controls are damped.
        must_settle = not is_simulated and (any(junctions) or is_damped)
        if is_met and (has_settled or not must_settle):
            return None
        are_left = has_settled or (self.options.limits_move and not is_met)
        finer = []
        for part, error, mine in zip(parts, errors, junctions, strict=True):
            marks = Marks(
                coarse=frozenset(np.flatnonzero(error.per_element > self.tolerance).tolist())
                | (frozenset() if are_left else mine),
                kept=mine,
                are_kinked=not is_damped and len(self.records) > 1,
            )
            finer.append(refined_mesh(part, error, marks, self.tolerance, self.options))
        is_same = tuple(finer) == _meshes(solution)
        # Another solve on the same meshes is useful only with damping.
        return None if is_same and is_met and not is_damped else tuple(finer)

    def _has_settled(self, solution: Outcome) -> bool:
        """Return whether the objective has settled, as the docstring of this module defines it."""
        return _objective_change(solution.parts[0], self.tolerance) <= _SETTLED * self.tolerance

    def _given_up(self, solution: S, error: float) -> S:
        """Return a solution whose status and message state that the tolerance was not met.

        The message gives the reason, and advice for the user. `error` is the estimated error.
        """
        records = self.records
        why = "allow more meshes, elements or a higher degree, or ask for less."
        if _gains_too_little(records):
            why = (
                f"the last two took {records[-2].iterations} and {records[-1].iterations} "
                f"iterations without progress; {_most_moved(solution, self.before)}start from a "
                "better guess, or add a small cost of the squared controls to the objective."
            )
        found = f"an estimated error of {error:.3g}, above the tolerance {self.tolerance:.3g}"
        if error <= self.tolerance:
            found = f"an objective that has not settled to the tolerance {self.tolerance:.3g}"
        message = f"refinement stopped after {len(records)} meshes with {found}; {why}"
        return solution.updated(status=Status.TOLERANCE_NOT_MET, message=message)

    def _shown(self, solution: S) -> S:
        """Pass a converged solution to the caller's callback `on_mesh`, and return the solution.

        If the callback returns False, the status of the result is interrupted.
        """
        is_finished = solution.status is Status.CONVERGED
        if is_finished and self.options.on_mesh and self.options.on_mesh(solution) is False:
            return solution.updated(status=Status.INTERRUPTED, message="stopped by the caller")
        return solution

    def _expected_change(self) -> float | None:
        """Return the expected change of the objective to the next meshes: the previous change.

        It is in the unit of the objective. It is None before the solves on the first two meshes,
        and before the first solve after a restart.
        """
        last = self.before[0]
        if last is None:
            return None
        change = _objective_change(last, self.tolerance)
        return change * last.nominal_objective if math.isfinite(change) else None

    def _gap_to_leave(self, solution: Outcome, errors: tuple[ErrorEstimate, ...]) -> float:
        """Return the relative complementarity gap at which the next solve may stop.

        It is 0.3 times the largest error of objective and integrals, but from 0.2 times the
        tolerance to 1e-3. With bounds imposed between collocation points, the objective's last
        change replaces a smaller error.
        """
        unknown = max(e.of_integrals for e in errors)
        if any(part.restraint is not None for part in solution.parts):
            # Bounds between the points hide that the mesh is too coarse for the optimum.
            unknown = max(unknown, _objective_change(solution.parts[0], self.tolerance))
        # A smaller gap is not useful, because the times at which limits become active still change
        # from mesh to mesh.
        return max(min(_INEXACT * unknown, _MOST_INEXACT), _LEAST_INEXACT * self.tolerance)


def _firmer(firmness: float, settled: int) -> float:
    """Return the increased factor on the damping, max(firmness, min(5 firmness, most)).

    `settled` counts the damped meshes with settled objective. `most` is 25 if `settled` < 4, 125 if
    4 <= `settled` < 8, and infinite otherwise.
    """
    most = _FIRMEST if settled >= _MANY_SETTLED else _FIRM
    most = math.inf if settled >= _TOO_MANY_SETTLED else most
    return max(firmness, min(_FIRMER * firmness, most))


@dataclass
class _MeshSolve(Search[S], Generic[S]):
    """Search for the solution on the next meshes, one for each horizon, by several strategies.

    `first_success` tries those strategies of `STRATEGIES` that have the scope `Scope.MESH`. The
    attributes `meshes` and `dampings` have one item for each horizon.
    """

    solve: Callable[..., S]
    meshes: tuple[Mesh, ...]
    # Warm start from the previous meshes, with the caller's guess.
    start: Start
    dampings: tuple[Damping | None, ...]
    # Expected change of the objective from the previous meshes to the next; None if unknown.
    change: float | None
    # Relative complementarity gap at which a solve with increased damping may stop.
    gap: float

    def holds(self, fact: Fact) -> bool:
        """Return whether a condition that a strategy requires is true at present."""
        # Damping keeps the controls near the previous ones. With a known change of the objective,
        # Ipopt starts with a small barrier parameter.
        is_kept_near = self.change is not None or _are_damped(self.dampings)
        has_warm = self.start.warm is not None
        return {
            Fact.WARM_START: has_warm,
            Fact.KEPT_NEAR: is_kept_near,
            Fact.FREE: not is_kept_near,
        }[fact]

    def attempt(self, strategy: Strategy) -> S:
        """Solve on the next meshes with one strategy, and return the result, converged or not.

        If `strategy.is_firm`, the attribute `dampings` is replaced by stronger dampings. The
        attribute `change`, the expected change of the objective, becomes None (unknown).
        """
        if strategy.is_firm:
            self.dampings = tuple(d and d.firmer(_FIRM, self.gap) for d in self.dampings)
            self.change = None
        start = self.start.cold if strategy.first is First.GUESS else self.start
        change = None if strategy.first is First.GUESS else self.change
        budget = {"iteration_limit": strategy.iterations} if strategy.iterations != math.inf else {}
        return self.solve(self.meshes, start, self.dampings, change=change, **budget)


def _sharper(dampings: tuple[Damping | None, ...], tolerance: float) -> tuple[Damping | None, ...]:
    """Return copies of dampings, with a smaller complementarity gap for a more accurate solve.

    A solve stops at the `gap` of its damping. The new gap is at most 0.2 times `tolerance` times
    the nominal magnitude of the objective. None (no damping) remains None.
    """
    least = _LEAST_INEXACT * tolerance
    return tuple(
        d and replace(d, gap=min(least * d.solution.nominal_objective, d.gap)) for d in dampings
    )


def _are_damped(dampings: tuple[Damping | None, ...]) -> bool:
    """Return whether any controls are damped (penalised for changes from the previous mesh)."""
    return any(damping is not None and damping.controls.size > 0 for damping in dampings)


def _is_limited_by_the_barrier(
    solution: Outcome, errors: tuple[ErrorEstimate, ...], tolerance: float, fine: float
) -> bool:
    """Return whether Ipopt's barrier, not the mesh, limits the accuracy of a converged solution.

    The result is True if no element's error exceeds `fine`, and the complementarity gap exceeds
    `tolerance`. The gap need not exceed it if the scaled objective is below 1e-6.
    """
    (part,), (error,) = solution.parts, errors
    # `switches` and `costs` are not counted: they are estimated only if all other errors meet the
    # tolerance.
    counted = replace(error, switches=0.0 * error.switches, costs=0.0 * error.costs)
    is_fine = counted.per_element.max(initial=0.0) <= fine
    size = part.program.objective_size(part.unknowns) * part.scaling.objective
    # If the scaled objective is small, Ipopt's convergence test does not show errors of the
    # objective.
    is_hidden = size < SEEN and part.problem.compiled.declared.objective_name != ""
    is_solved = solution.status is Status.CONVERGED
    return is_solved and is_fine and (error.gap > tolerance or is_hidden)


@dataclass
class _Reached(Generic[S]):
    """Solution that met the tolerance, kept while the refinement restarts from other controls.

    The methods compare later solutions with the kept solution. The improvement is the relative
    difference of their objectives, which the method `gain` returns.
    """

    solution: S
    # Lower bound on the improvement by the restart: the largest (improvement - estimated error) of
    # all solutions since. None if there is no solution since.
    shown: float | None = None
    # Improvement by the previous restart, from its kept solution to `solution`.
    earned: float = 0.0

    def gain(self, other: S) -> float:
        """Return the relative improvement of the objective from the kept solution to `other`.

        It is relative to the nominal magnitude, and negative if `other` is worse.
        """
        first = self.solution.parts[0]
        earned = self.solution.objective - other.objective
        is_maximised = first.problem.compiled.declared.maximise
        return (-earned if is_maximised else earned) / first.nominal_objective

    def compare(self, other: S, error: float) -> None:
        """Update the lower bound on the improvement: shown = max(shown, gain(other) - error).

        `other` is a solution since the restart, and `error` its estimated relative error.
        """
        shown = self.gain(other) - error
        self.shown = shown if self.shown is None else max(self.shown, shown)

    def better(self, other: S) -> S:
        """Return the kept solution or `other`, whichever has the better objective.

        The history of the result includes the meshes since the restart.
        """
        if self.gain(other) >= 0.0:
            return other
        return self.solution.updated(history=other.parts[0].history)


def _result_above_tolerance(ended: S, reached: _Reached[S] | None, tolerance: float) -> S:
    """Return the result of a refinement that ended without meeting its tolerance.

    Without a restart, it is `ended`, otherwise the solution before the restart (`reached`). Its
    status is `TOLERANCE_NOT_MET` if no solution followed, or if one improved the objective by
    more than its error plus `tolerance`.
    """
    if reached is None:
        return ended
    # The solution counts as optimal if no solution since the restart improves the objective by more
    # than its own error plus the tolerance. It is in doubt if no solution followed the restart.
    is_refuted = reached.shown is None or reached.shown > tolerance
    return _doubted(reached.solution) if is_refuted else reached.solution


def _cut_off(reached: _Reached[S]) -> S:
    """Return the result of a refinement that was restarted and then stopped above its tolerance.

    It is the solution from before the restart, marked by `_doubted`.
    """
    # Its error is at least the improvement of the objective by the previous restart.
    own = reached.solution.parts[0].error_estimate
    return _doubted(reached.solution.updated(error_estimate=max(own, reached.earned)))


def _doubted(solution: S) -> S:
    """Return a copy of a solution whose status and message state that better controls exist."""
    return solution.updated(
        status=Status.TOLERANCE_NOT_MET,
        message=(
            "by Pontryagin's principle another control improves the objective by more than the "
            "tolerance, but no optimum was found from it; start from another guess, or try "
            "`starts=6`."
        ),
    )


def _meshes(solution: Outcome) -> tuple[Mesh, ...]:
    """Return the meshes of a solution, one for each horizon."""
    return tuple(part.mesh for part in solution.parts)


def _objective_change(solution: Solution, tolerance: float) -> float:
    """Return the least relative change of the objective from earlier meshes to the last mesh.

    The previous mesh counts, and those earlier meshes whose error met `tolerance`. The change is
    relative to `Solution.nominal_objective`, and infinite on the first mesh.
    """
    *before, now = solution.history
    # The objective on the mesh before the last may be inaccurate. Earlier meshes that met the
    # tolerance therefore count too.
    accepted = [record for record in before[:-1] if record.error <= tolerance]
    moved = [abs(now.objective - record.objective) for record in (*accepted, *before[-1:])]
    return min(moved, default=math.inf) / solution.nominal_objective


def _gains_too_little(records: Sequence[MeshRecord]) -> bool:
    """Return whether the last two solves gained too little for the refinement to go on.

    Both must have taken more than 150 iterations. The last must have left more than half of the
    error.
    """
    if len(records) < 3:
        return False
    last, now = records[-2:]
    is_long = min(last.iterations, now.iterations) > _LOST_ITERATIONS
    return is_long and now.error > _LEFT * last.error


def _most_moved(solution: Outcome, before: tuple[Solution | None, ...]) -> str:
    """Return a phrase on the control that changed most since the previous mesh, for a message.

    `before` has the previous solution on each horizon, or None. The phrase is empty without
    controls or without a previous solution.
    """
    found = []
    for part, last in zip(solution.parts, before, strict=True):
        if last is None or part.trajectory.algebraics.size == 0:
            continue
        mesh, lower, upper = part.mesh, *part.algebraic_limits
        now, then = (s.trajectory.algebraics_at(mesh.point_fractions) for s in (part, last))
        ranges = part.algebraic_ranges
        shares = np.abs(now - np.clip(then, lower, upper)) / np.where(ranges > 0.0, ranges, 1.0)
        means = mesh.quadrature_weights @ shares
        k = int(means.argmax())
        point = int(shares[:, k].argmax())
        time = float(part.timeline.time(mesh.point_fractions[point]))
        name = part.problem.compiled.declared.algebraics[k].name
        line = f"{name} still changes, at time {time:.4g} by {shares[point, k]:.0%} of its range; "
        found.append((means[k], line))
    return max(found)[1] if found else ""


def _record(solution: Outcome, error: float) -> MeshRecord:
    """Return the `MeshRecord` of a solution, for the history of the refinement.

    `error` is the estimated largest relative error of the solution.
    """
    return MeshRecord(
        elements=sum(mesh.elements for mesh in _meshes(solution)),
        points=sum(mesh.points for mesh in _meshes(solution)),
        iterations=solution.iterations[-1].iteration if solution.iterations else 0,
        objective=solution.objective,
        error=error,
        wall_s=solution.wall_s,
    )
