"""First solve of a problem: strategies that vary initial point, mesh and settings on failure."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from pyomo_quad.collocation.mesh import Mesh
from pyomo_quad.collocation.program.bounds import counted
from pyomo_quad.collocation.program.ipopt import DIVERGED_CODE, Status
from pyomo_quad.collocation.program.redundancy import (
    FORGIVEN,
    misses,
    redundant_conditions,
    without,
)
from pyomo_quad.collocation.solution import Outcome
from pyomo_quad.collocation.starts import Start
from pyomo_quad.collocation.strategies import PATIENCE, Fact, First, Search, Strategy
from pyomo_quad.collocation.verdicts import judged, violation_of, with_surplus, without_bound

if TYPE_CHECKING:
    from collections.abc import Callable

    from pyomo_quad.collocation.program.bounds import Bounds
    from pyomo_quad.collocation.program.ipopt import Progress, SolverOptions
    from pyomo_quad.collocation.program.transcription import Transcription
    from pyomo_quad.collocation.reading.values import Instance
    from pyomo_quad.collocation.solution import Solution

S = TypeVar("S", bound=Outcome)
_COARSE_MESH = Mesh.uniform(elements=4, degree=3)


@dataclass(kw_only=True)
class FirstSolve(Search[S], Generic[S]):
    """Search for a first solution by trying strategies in order, on one horizon or several.

    Attributes
    ----------
    solve : callable
        (mesh, start, options=, is_scaled=) -> solution on that one mesh.
    finish : callable
        (solve, mesh, start) -> the solution, on refined meshes if a tolerance is given.
    judge : callable
        Failed solution -> the same, with a message on which equations cannot be met together (from
        the elastic program, which minimises the constraint violation).
    mesh : Mesh, list of Mesh, or None
        The initial mesh.
    start : Start
    options : SolverOptions
    """

    solve: Callable[..., S]
    finish: Callable[[Callable[..., S], Any, Start], S]
    judge: Callable[[S], S]
    mesh: Any
    start: Start
    options: SolverOptions
    first: S | None = None

    @cached_property
    def judged(self) -> S:
        """Failed requested solve, with the verdict of its elastic program on its feasibility."""
        return self.judge(self.failed)

    @property
    def failed(self) -> S:
        """Result of the solve that the caller requested, which failed."""
        if self.first is None:
            raise LookupError("no solve has failed yet")
        return self.first

    def holds(self, fact: Fact) -> bool:
        """Return whether the condition of a strategy is met."""
        is_judged = self.first is not None and self.judged.status is not Status.INTERRUPTED
        if fact is Fact.POSSIBLE:
            return is_judged and self.judged.status is not Status.INFEASIBLE
        return fact is Fact.JUDGED and is_judged

    def attempt(self, strategy: Strategy) -> S | None:
        """Solve with a strategy's initial point, mesh and settings; None if it does not apply."""
        own = partial(
            self.solve, options=strategy.settings(self.options), is_scaled=strategy.is_scaled
        )
        mesh = self.mesh
        if strategy.finer > 1 and mesh is not None:
            mesh = Mesh.uniform(strategy.finer * mesh.elements, mesh.degrees[0])
        found = self.begun(strategy.first, own, mesh)
        if self.first is None and strategy.first is First.GIVEN:
            self.first = found
        return found

    def begun(self, first: First, own: Callable[..., S], mesh: Any) -> S | None:
        """Solve from the kind of initial point that a strategy names, None if there is none."""
        del first
        return self.finish(own, mesh, self.start)

    def is_final(self, found: S) -> bool:
        """Return whether a result ends the search."""
        is_hasty = self.options.max_iterations < PATIENCE
        is_first = found is self.first
        return not found.status.has_failed or (
            is_first and (is_hasty or found.ipopt_code == DIVERGED_CODE)
        )

    def failure(self, last: S) -> S:
        """Return the failed requested solve, with the verdict on its feasibility."""
        del last
        return self.judged


@dataclass(kw_only=True)
class FirstSolveOfOne(FirstSolve["Solution"]):
    """Search for a first solution on one horizon.

    Attributes
    ----------
    bounds_of : callable
        Program -> its bounds with all conditions.
    simulate : callable, optional
        Returns a simulated trajectory, None if any variable is free; None if a guess is given.
    instance : Instance
    progress : callable or None
    is_overdetermined : bool
        Whether there are more equations than free unknowns.
    is_mesh_free : bool
        Whether the first mesh may be changed, because the caller gave none.
    """

    bounds_of: Callable[[Transcription], Bounds]
    simulate: Callable[[], Any] | None
    instance: Instance
    progress: Progress | None
    is_overdetermined: bool
    is_mesh_free: bool

    def holds(self, fact: Fact) -> bool:
        """Return whether the condition of a strategy is met."""
        known = {
            Fact.ONE_HORIZON: True,
            Fact.OVERDETERMINED: self.is_overdetermined and self.first is None,
            Fact.FREE_MESH: self.is_mesh_free,
            Fact.FREE_GUESS: self.simulate is not None,
        }
        if fact is Fact.SQUARE:
            return self.failed.bounds.surplus == 0
        return known[fact] if fact in known else super().holds(fact)

    def begun(self, first: First, own: Callable[..., Solution], mesh: Any) -> Solution | None:
        """Solve from the kind of initial point that a strategy names, None if there is none."""
        if first is First.GIVEN:
            return self._ended(self.finish(own, mesh, self.start))
        if first is First.REDUCED:
            return self._reduced(own, mesh)
        if first in (First.COARSE, First.PRICED):
            is_coarse = first is First.COARSE
            start = replace(self.start.cold, is_elastic=not is_coarse)
            lenient = own(_COARSE_MESH if is_coarse else mesh, start)
            start = replace(self.start, warm=lenient.warm_start)
            return self._ended(self.finish(own, mesh, start)) if lenient.is_converged else None
        path = self.judged.trajectory if first is First.LEAST_VIOLATION else self._simulated()
        return self._ended(self.finish(own, mesh, Start(guess=path))) if path else None

    def _simulated(self) -> Any:
        return self.simulate and self.simulate()

    def _ended(self, found: Solution) -> Solution:
        """Return a result, with a message if it is unbounded or has redundant equations."""
        diverged = found.status.has_failed and found.ipopt_code == DIVERGED_CODE
        return without_bound(found) if diverged else with_surplus(found)

    def _reduced(self, solve_on: Callable[..., Solution], mesh: Mesh | None) -> Solution | None:
        """Solve without redundant conditions, and check that the solution satisfies them.

        They are detected at the point of least violation near the guess: with them, a coarse mesh
        has spurious solutions or none.
        """
        near = solve_on(mesh, self.start, options=replace(self.options, max_iterations=0))
        least = violation_of(near, self.options, self.progress)
        if least is None or least.result.status is Status.INTERRUPTED:
            return None
        near = judged(near, least)
        fixed = self.instance.fixed
        left_out = redundant_conditions(
            near.program, near.bounds, near.scaling, fixed, near.unknowns
        )
        if not left_out:
            return None
        reduced = partial(solve_on, instance=without(self.instance, left_out))
        solution = self.finish(reduced, mesh, Start(guess=near.trajectory))
        bounds = self.bounds_of(solution.program)
        found = solution.scaling, solution.unknowns
        missed = misses(left_out, solution.program, bounds, fixed, *found)
        if solution.status.has_failed or max(missed) > FORGIVEN:
            return None
        names = ", ".join(candidate.name for candidate in left_out)
        note = (
            f"model: {counted(bounds)}; {names} follow from the others and were left out of the "
            f"solve, which meets them to {max(missed):.1e} of their size; their multipliers are 0."
        )
        return solution.updated(notes=(note,))
