"""First solve of a problem, on its initial mesh, with fallback strategies if it fails.

Fallback strategies change the initial point, the mesh or the settings of Ipopt. The table
`strategies.STRATEGIES` lists them, with the strategies for the other parts of a solve. This module
handles models with one horizon or several.

Redundant conditions are constraints at single times, or fixed values, that follow from other
equations. One strategy leaves them out of the solve.
"""

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
    """Search for a first solution of a problem, by strategies in a fixed order.

    Attributes
    ----------
    solve : callable
        (mesh, start, options=, is_scaled=) -> solution on this one mesh.
    finish : callable
        (solver, mesh, start) -> solution, with mesh refinement if the caller gave a tolerance. Here
        `solver` maps (mesh, start) to a solution on one mesh.
    judge : callable
        Failed solution -> solution whose status tells whether the problem was found infeasible. The
        function minimises the constraint violation. With one horizon, the unknowns of the result
        are at the minimum found; with several, they are unchanged.
    mesh : Mesh, list of Mesh, or None
        Initial mesh; a list for several horizons, None without time.
    start, options : Start, SolverOptions
        Initial point and settings that the caller requested.
    first : Solution or JointSolution, optional
        Result of the requested solve.
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
        """Result of the failed solve `first`, with a verdict on the feasibility of the problem.

        At the first access, `judge` computes the verdict.
        """
        return self.judge(self.failed)

    @property
    def failed(self) -> S:
        """Result of the failed solve with the caller's own start, mesh and settings.

        Raises
        ------
        LookupError
            If no solve has failed yet.
        """
        if self.first is None:
            raise LookupError("no solve has failed yet")
        return self.first

    def holds(self, fact: Fact) -> bool:
        """Return whether the condition `fact` is true at this stage of the search.

        `Fact.JUDGED` is true if the requested solve has failed and the user did not interrupt
        `judge`. `Fact.POSSIBLE` also requires that `judge` did not find the problem infeasible. The
        result is False for all other members of `Fact`.
        """
        is_judged = self.first is not None and self.judged.status is not Status.INTERRUPTED
        if fact is Fact.POSSIBLE:
            return is_judged and self.judged.status is not Status.INFEASIBLE
        return fact is Fact.JUDGED and is_judged

    def attempt(self, strategy: Strategy) -> S | None:
        """Solve with the initial point, mesh and settings of Ipopt that a strategy prescribes.

        The result is None if the strategy does not apply to this problem. The first strategy that
        starts from the initial point that the caller requested stores its result in `first`.
        """
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
        """Solve from the initial point that the caller requested, and return the result.

        The argument `first` is the kind of initial point that a strategy prescribes. This base
        class ignores it. A subclass starts from a point of this kind, and returns None if the
        problem has none. `own`, which is `solve` with the
        strategy's settings, maps (mesh, start) to a solution on this one mesh.
        """
        del first
        return self.finish(own, mesh, self.start)

    def is_final(self, found: S) -> bool:
        """Return whether `found`, the result of the strategy tried last, ends the search.

        A success or an interruption ends the search. So does a failure of the requested solve, if
        it diverged, or if the caller allows fewer than 200 iterations.
        """
        is_hasty = self.options.max_iterations < PATIENCE
        is_first = found is self.first
        # A requested solve that diverged ends the search, because the problem is unbounded.
        return not found.status.has_failed or (
            is_first and (is_hasty or found.ipopt_code == DIVERGED_CODE)
        )

    def failure(self, last: S) -> S:
        """Return the result to report if all strategies have failed.

        It is the result of the solve that the caller requested, with a verdict on feasibility. The
        result `last` of the strategy tried last is ignored.
        """
        del last
        return self.judged


@dataclass(kw_only=True)
class FirstSolveOfOne(FirstSolve["Solution"]):
    """Search for a first solution of a problem with one horizon, by all strategies.

    Attributes
    ----------
    bounds_of : callable
        Nonlinear program -> all its bounds, including those of redundant conditions. They show
        whether the solution of a solve without redundant conditions violates one.
    simulate : callable, optional
        () -> simulated initial guess; see `Problem._simulated`. The attribute is None if the caller
        gave a guess, a warm start, or no tolerance.
    instance : Instance
        Parameter values, horizon and fixed variables.
    progress : callable or None
        Called at each iteration; returning False stops the solve.
    is_overdetermined : bool
        Whether the equations outnumber the free unknowns.
    is_mesh_free : bool
        Whether the caller gave neither mesh nor warm start.
    """

    bounds_of: Callable[[Transcription], Bounds]
    simulate: Callable[[], Any] | None
    instance: Instance
    progress: Progress | None
    is_overdetermined: bool
    is_mesh_free: bool

    def holds(self, fact: Fact) -> bool:
        """Return whether the condition `fact` is true at this stage of the search."""
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
        """Solve from the initial point that a solution strategy prescribes; return the result.

        `own` maps (mesh, start) to a solution on this one mesh. The result is None if the problem
        has no initial point of the kind `first`. `First.REDUCED` leaves out redundant conditions;
        it also gives None if the solve fails or violates one.
        """
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
        """Return a trajectory simulated from the initial states, as an initial point.

        The result is None if the attribute `simulate` is None or returns None.
        """
        return self.simulate and self.simulate()

    def _ended(self, found: Solution) -> Solution:
        """Return the result of a solve, with a message if it diverged or has surplus equations.

        The message names the unbounded variable, or says that some equations follow from others.
        """
        diverged = found.status.has_failed and found.ipopt_code == DIVERGED_CODE
        return without_bound(found) if diverged else with_surplus(found)

    def _reduced(self, solve_on: Callable[..., Solution], mesh: Mesh | None) -> Solution | None:
        """Solve without the conditions that follow from other constraints.

        An example is an end condition on a conserved quantity. `solve_on` maps (mesh, start) to a
        solution. `mesh` is None for a model without time. The result is None if no condition is
        redundant, the solve fails, or a redundant condition is violated.
        """
        # Redundant conditions are detected at a point of least constraint violation near the start.
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
        # On a coarse mesh, the problem with redundant conditions may have no solution, or spurious
        # solutions.
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
            f"solve; their relative violation is at most {max(missed):.1e}, and their multipliers "
            "are 0."
        )
        return solution.updated(notes=(note,))
