"""Complete solve from a warm start or a guess, within limits of iterations and time.

A warm start records how many iterations an earlier solve of its problem from the guess took. It
records two numbers: for the first mesh, and for all meshes. They are the budget of a solve from the
warm start. If it exceeds one of them, the problem is solved from the guess instead (cold start). A
solve that is stopped early returns the solution on the most accurate mesh.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import inf
from typing import TYPE_CHECKING, Generic, TypeVar

from pyomo_quad.collocation.errors import TranscriptionError
from pyomo_quad.collocation.program.ipopt import TIME_LIMIT_CODE, Effort, SolverOptions, Status
from pyomo_quad.collocation.refining.remeshing import RefinementOptions
from pyomo_quad.collocation.solution import Outcome
from pyomo_quad.collocation.starts import ColdStart, Start
from pyomo_quad.collocation.strategies import (
    Fact,
    First,
    Scope,
    Search,
    Strategy,
    first_success,
)
from pyomo_quad.collocation.verdicts import doubted

if TYPE_CHECKING:
    from collections.abc import Callable

    from pyomo_quad.collocation.program.ipopt import Progress

#: Default of the required relative error.
DEFAULT_TOLERANCE = 1e-6
S = TypeVar("S", bound=Outcome)


@dataclass(kw_only=True)
class _WholeSolve(Search[S], Generic[S]):
    """Search that solves from a warm start; if this is too slow, it solves from the guess."""

    # Solves once from a starting point, with mesh refinement if the caller asked for it.
    solve: Callable[[Start, Progress], S]
    start: Start
    # Iterations of an earlier solve from the guess, the budget of the warm start; None without
    # budget.
    known: ColdStart | None
    # Tolerance of the mesh refinement, 0 for a single mesh.
    tolerance: float
    progress: Progress | None
    # Result of the last solve from the warm start, and its number of iterations.
    warm: S | None = None
    spent: int = 0
    # Whether the most recent result ends the search.
    has_ended: bool = False

    def holds(self, fact: Fact) -> bool:
        """Return whether `fact`, a condition for trying a solution strategy, is true at present."""
        # If the warm start kept its budget, or the cold start succeeded, the search has ended
        # already.
        return (fact is Fact.WARM_START and self.start.warm is not None) or (
            fact is Fact.COLD_FAILED and self.warm is not None
        )

    def attempt(self, strategy: Strategy) -> S:
        """Solve with a given solution strategy, and return the result."""
        known = self.known if strategy.iterations is None else None
        limits = (known.first, known.iterations) if known else (inf, inf)
        effort = Effort(limits=limits, progress=self.progress)
        if strategy.first is First.GUESS:
            return self._cold(effort)
        start = self.start
        if self.warm is not None and strategy.first is First.REACHED:
            # Continue from the last iterate of the interrupted solve.
            start = replace(start, warm=self.warm.warm_start)
        found = self.solve(start, effort)
        self.warm, self.spent, self.has_ended = found, effort.count, not effort.is_over
        return found.updated(cold_start=known) if known and self.has_ended else found

    def _cold(self, effort: Effort) -> S:
        """Solve from the guess, without the warm start, and record the number of iterations.

        `effort` is the progress callback of the solve, and counts the iterations. The record,
        `cold_start` of the result, is the budget of later solves from a warm start.
        """
        cold = self.solve(self.start.cold, effort)
        took = ColdStart(first=effort.first, iterations=effort.count, tolerance=self.tolerance)
        self.has_ended = self.warm is None or not cold.status.has_failed
        if self.warm is None:
            return cold.updated(cold_start=took if cold.status.is_solved else None)
        message = (
            f"{cold.message} The warm start was given up after {self.spent} iterations, more than "
            f"its own cold start had taken; a new cold start took {took.iterations}."
        )
        return cold.updated(cold_start=took, message=message)

    def is_final(self, found: S) -> bool:
        """Return whether the most recent result ends the search; the argument is not used.

        If the solve from the warm start exceeds its budget, a cold start follows. If that fails,
        the solve from the warm start continues.
        """
        del found
        return self.has_ended


def within_budget(
    solve: Callable[[Start, Progress], S],
    start: Start,
    tolerance: float | None,
    progress: Progress | None,
    *,
    is_known: bool = True,
) -> S:
    """Solve from a warm start; if its budget is used up, solve from the guess.

    The budget is the number of iterations that `start` records for an earlier solve from the guess.
    There is no budget if that solve had another `tolerance`, or if `is_known` is False. If the new
    solve from the guess fails, the warm start continues without a budget.

    Parameters
    ----------
    solve : callable
        (start, progress callback) -> solution.
    start : Start
    tolerance : float, optional
        Tolerance of the mesh refinement; None for a single mesh.
    progress : callable, optional
        Called at each iteration.
    is_known : bool, optional
        Whether the recorded number of iterations applies to this solve.
    """
    # Several initial points take more iterations than the recorded solve from one point. `is_known`
    # is then False.
    demand, known = tolerance or 0.0, start.cold_start if is_known else None
    # A warm start is useful only if it is faster than a solve from the guess (cold start). The
    # iterations of the cold start are therefore its budget.
    known = known if known is not None and known.tolerance == demand else None
    whole = _WholeSolve(solve=solve, start=start, known=known, tolerance=demand, progress=progress)
    return first_success(Scope.WHOLE, whole)


def carried_out(
    attempt: Callable[[Start, Progress, SolverOptions, float | None, RefinementOptions], S],
    start: Start,
    *,
    tolerance: float | None,
    has_mesh: bool,
    options: SolverOptions | None,
    refinement: RefinementOptions | None,
    progress: Progress | None,
    is_known: bool = True,
) -> S:
    """Carry out a complete solve: from a warm start or guess, and within the time limit.

    `attempt` solves once from a starting point, and refines the mesh if it gets a tolerance. This
    tolerance is `tolerance`, or 1e-6 if `tolerance` is None and `has_mesh` is False. A `tolerance`
    not above 0 raises a TranscriptionError.

    If `is_known` is True, the budget that a warm start records limits the iterations. `is_known` is
    False for a solve from several initial points.
    """
    if tolerance is not None and not tolerance > 0.0:
        raise TranscriptionError(f"tolerance: {tolerance:g}; must be above 0.")
    if tolerance is None and not has_mesh:
        tolerance = DEFAULT_TOLERANCE
    options, asked = options or SolverOptions(), refinement or RefinementOptions()
    finished: list[S] = []

    def kept(solution: S) -> bool | None:
        finished.append(solution)
        return asked.on_mesh and asked.on_mesh(solution)

    chosen = replace(asked, on_mesh=kept)
    limit_s = inf if options.max_wall_s is None else options.max_wall_s
    deadline = Effort(limit_s=limit_s, progress=progress)
    solution = within_budget(
        lambda start, progress: attempt(start, progress, options, tolerance, chosen),
        start,
        tolerance,
        deadline,
        is_known=is_known,
    )
    # Status and message record doubts, such as a table evaluated outside its data.
    return doubted(_finished_of(finished, _in_time(solution, deadline)))


def _finished_of(finished: list[S], ended: S) -> S:
    """Return the last solution `ended` of a refinement, or the most accurate one if it was stopped.

    `finished` has the converged solutions on the meshes of the refinement.
    """
    # Solutions without all conditions (constraints at single times, presumed redundant) do not
    # count.
    whole = [solution for solution in finished if not solution.parts[0].instance.left_out]
    if not whole or ended.status not in (Status.INTERRUPTED, Status.NOT_CONVERGED):
        return ended
    best = min(whole, key=lambda solution: solution.parts[0].error_estimate)
    part, message = best.parts[0], ended.message.rstrip(".; ")
    message = (
        f"{message}; this is the solution of mesh {len(part.history)}, with an estimated error of "
        f"{part.error_estimate:.3g}."
    )
    return best.updated(status=ended.status, message=message, ipopt_code=ended.ipopt_code)


def _in_time(solution: S, deadline: Effort) -> S:
    """Set message and return code of a solution if the time limit interrupted its solve.

    `deadline` holds the time limit, and whether the solve exceeded it.
    """
    if not deadline.is_over or solution.status is not Status.INTERRUPTED:
        return solution
    message = (
        f"stopped at the time limit of {deadline.limit_s:g} s, on mesh "
        f"{len(solution.parts[0].history) or 1}; allow more time or a larger tolerance."
    )
    return solution.updated(ipopt_code=TIME_LIMIT_CODE, message=message)
