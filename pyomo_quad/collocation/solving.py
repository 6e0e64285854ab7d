"""Complete solve: budget of the warm start, time limit, and the best finished mesh."""

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
    """Solve from a warm start, and from the guess if the warm start takes too many iterations.

    Attributes
    ----------
    solve : callable
        (start, progress) -> solution.
    known : ColdStart, optional
        Budget of the warm start; without it there is no limit.
    """

    solve: Callable[[Start, Progress], S]
    start: Start
    known: ColdStart | None
    tolerance: float
    progress: Progress | None
    warm: S | None = None
    spent: int = 0
    has_ended: bool = False

    def holds(self, fact: Fact) -> bool:
        """Return whether the condition of a strategy is met."""
        return (fact is Fact.WARM_START and self.start.warm is not None) or (
            fact is Fact.COLD_FAILED and self.warm is not None
        )

    def attempt(self, strategy: Strategy) -> S:
        """Solve by one strategy."""
        known = self.known if strategy.iterations is None else None
        limits = (known.first, known.iterations) if known else (inf, inf)
        effort = Effort(limits=limits, progress=self.progress)
        if strategy.first is First.GUESS:
            return self._cold(effort)
        start = self.start
        if self.warm is not None and strategy.first is First.REACHED:
            start = replace(start, warm=self.warm.warm_start)
        found = self.solve(start, effort)
        self.warm, self.spent, self.has_ended = found, effort.count, not effort.is_over
        return found.updated(cold_start=known) if known and self.has_ended else found

    def _cold(self, effort: Effort) -> S:
        """Solve from the guess, and record the iterations that it takes."""
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
        """Return whether a result ends the search; a warm start over budget does not."""
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
    """Solve from a warm start within the iterations of the cold start, else from the guess.

    The first solve may take the iterations of the cold start's first mesh, and all solves together
    those of all its meshes, if they are known for the same tolerance; otherwise, and without
    `is_known`, there is no limit. If the new cold start fails, the warm start is continued.
    """
    demand, known = tolerance or 0.0, start.cold_start if is_known else None
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
    """Solve within the time limit and the ranges of the tables, refining if a tolerance is given.

    If a refinement is interrupted or fails, the most accurate finished mesh is returned.

    Parameters
    ----------
    attempt : callable
        (start, progress, options, tolerance, refinement) -> solution.
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
    return doubted(_finished_of(finished, _in_time(solution, deadline)))


def _finished_of(finished: list[S], ended: S) -> S:
    """Replace an unconverged iterate by the solution on the most accurate finished mesh."""
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
    """Return a solution with a message if the deadline ended its solve."""
    if not deadline.is_over or solution.status is not Status.INTERRUPTED:
        return solution
    message = (
        f"stopped at the time limit of {deadline.limit_s:g} s, on mesh "
        f"{len(solution.parts[0].history) or 1}; allow more time or a larger tolerance."
    )
    return solution.updated(ipopt_code=TIME_LIMIT_CODE, message=message)
