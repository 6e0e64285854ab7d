"""Ordered attempts at a first solve, and the verdict where all of them fail."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum, auto
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from pyomo_quad.collocation.mesh import Mesh
from pyomo_quad.collocation.program.bounds import counted
from pyomo_quad.collocation.program.elastic import least_violation
from pyomo_quad.collocation.program.ipopt import DIVERGED_CODE, Status
from pyomo_quad.collocation.program.redundancy import (
    FORGIVEN,
    misses,
    redundant_conditions,
    without,
)
from pyomo_quad.collocation.program.transcription import row_place, unknown_place

if TYPE_CHECKING:
    from collections.abc import Callable

    from pyomo_quad.collocation.guess import WarmStart
    from pyomo_quad.collocation.mesh import Trajectory
    from pyomo_quad.collocation.program.elastic import LeastViolation
    from pyomo_quad.collocation.program.ipopt import Progress, SolverOptions
    from pyomo_quad.collocation.program.nonlinear import Bounds
    from pyomo_quad.collocation.program.transcription import Transcription
    from pyomo_quad.collocation.reading.values import Instance
    from pyomo_quad.collocation.solution import Solution


class First(Enum):
    """Initial point of an attempt."""

    GIVEN = auto()
    SIMULATED = auto()
    FEASIBLE = auto()
    REDUCED = auto()
    COARSE = auto()
    PRICED = auto()


# Iterations of an attempt on the mesh that failed; successful attempts need fewer.
_PATIENCE = 200


@dataclass(frozen=True, kw_only=True)
class Attempt:
    """One strategy for a solve.

    Attributes
    ----------
    name : str
    first : First
        The initial point: as requested, from a simulation, the point of least violation, the same
        without redundant conditions, the optimum on a coarse mesh, or the optimum of the elastic
        program.
    finer : int
        Factor on the number of elements of the first mesh.
    barrier : str, optional
        Ipopt's strategy for its barrier.
    is_scaled : bool
        Whether Ipopt solves the scaled program.
    """

    name: str
    first: First = First.GIVEN
    finer: int = 1
    barrier: str | None = None
    is_scaled: bool = True

    def settings(self, options: SolverOptions) -> SolverOptions:
        """Return the settings of the attempt."""
        if self.barrier is None:
            return options
        return replace(
            options,
            max_iterations=min(options.max_iterations, _PATIENCE),
            extra=(*options.extra, ("mu_strategy", self.barrier)),
        )


#: For problems without freedom, and for problems whose equations leave none.
SIMULATED = Attempt(name="from a simulation", first=First.SIMULATED)
REDUCED = (
    Attempt(name="without conditions that follow from others", first=First.REDUCED),
    Attempt(name="the same on a mesh four times finer", first=First.REDUCED, finer=4),
)
WITH_OTHER_SETTINGS = (
    Attempt(name="monotone barrier", barrier="monotone"),
    Attempt(name="adaptive barrier, unscaled", barrier="adaptive", is_scaled=False),
    Attempt(name="monotone barrier, unscaled", barrier="monotone", is_scaled=False),
)
#: Attempts on the mesh that failed.
ON_THE_MESH = (
    Attempt(name="from the point of least violation", first=First.FEASIBLE),
    *WITH_OTHER_SETTINGS,
)
#: Attempts on other meshes: a first mesh may be too coarse for the limits, or too fine for the
#: error of the first point.
ON_OTHER_MESHES = (
    Attempt(name="on a mesh four times finer", finer=4),
    Attempt(name="on a mesh twice as fine", finer=2),
    Attempt(name="from a coarse mesh", first=First.COARSE),
    Attempt(name="from equations at a price", first=First.PRICED),
)
_COARSE_MESH = Mesh.uniform(elements=4, degree=3)


@dataclass(frozen=True, kw_only=True)
class FirstSolve:
    """The attempts at one solve.

    Attributes
    ----------
    solve_on : callable
        Solves once on a mesh; see `Problem.solve_on_mesh`.
    finish : callable
        (solve_on, mesh, warm start) -> the solution, refined if a tolerance is given.
    bounds_of : callable
        Program -> its bounds with all conditions.
    simulate : callable, optional
        Returns a simulated trajectory, None if any variable is free; None if there is a guess.
    mesh : Mesh or None
        The initial mesh.
    warm_start : WarmStart, optional
    instance : Instance
    options : SolverOptions
    progress : callable or None
    is_overdetermined : bool
        Whether there are more equations than free unknowns.
    is_mesh_free : bool
        Whether the first mesh may be changed, because the caller gave none.
    """

    solve_on: Callable[..., Solution]
    finish: Callable[[Callable[..., Solution], Mesh | None, WarmStart | None], Solution]
    bounds_of: Callable[[Transcription], Bounds]
    simulate: Callable[[], Trajectory | None] | None
    mesh: Mesh | None
    warm_start: WarmStart | None
    instance: Instance
    options: SolverOptions
    progress: Progress | None
    is_overdetermined: bool
    is_mesh_free: bool

    def __call__(self) -> Solution:
        """Return the first successful solution, else the first failure with its verdict."""
        for way in REDUCED[: 1 + self.is_mesh_free] if self.is_overdetermined else ():
            reduced = self._attempted(way, None)
            if reduced is not None and not reduced.status.has_failed:
                return reduced
        first = self.finish(self.solve_on, self.mesh, self.warm_start)
        # A low iteration limit shows that a quick answer is needed, as in flight.
        is_hasty = self.options.max_iterations < _PATIENCE
        if is_hasty or not first.status.has_failed:
            return _noted(first)
        return _unbounded(first) if first.ipopt_code == DIVERGED_CODE else self._retried(first)

    def _retried(self, first: Solution) -> Solution:
        """Return the first success of the further attempts, else the failure with its verdict."""
        simulated = self._attempted(SIMULATED, first)
        if simulated is not None and not simulated.status.has_failed:
            return simulated
        found = violation_of(first, self.options, self.progress)
        if found is not None and found.result.status is Status.INTERRUPTED:
            return first.updated(status=Status.INTERRUPTED)
        failed = first if found is None else judged(first, found)
        for way in self._further_attempts(failed):
            solution = self._attempted(way, failed)
            if solution is not None and not solution.status.has_failed:
                return _noted(solution)
        return failed

    def _further_attempts(self, failed: Solution) -> tuple[Attempt, ...]:
        """Return the further attempts; a mesh found infeasible is not tried again."""
        is_square = failed.bounds.surplus == 0
        reduced = REDUCED[: 1 + self.is_mesh_free] if is_square else ()
        own = () if failed.status is Status.INFEASIBLE else ON_THE_MESH
        return (*reduced, *own, *(ON_OTHER_MESHES if self.is_mesh_free and self.simulate else ()))

    def _attempted(self, way: Attempt, failed: Solution | None) -> Solution | None:
        """Solve by one strategy, None if it does not apply."""
        solve_on = partial(
            self.solve_on, options=way.settings(self.options), is_scaled=way.is_scaled
        )
        mesh, start = self.mesh, self.warm_start
        if way.finer > 1 and mesh is not None:
            mesh = Mesh.uniform(way.finer * mesh.elements, mesh.degrees[0])
        if way.first in (First.COARSE, First.PRICED):
            is_coarse = way.first is First.COARSE
            lenient = solve_on(_COARSE_MESH) if is_coarse else solve_on(mesh, is_elastic=True)
            return self.finish(solve_on, mesh, lenient.warm_start) if lenient.is_converged else None
        if way.first is First.GIVEN:
            return self.finish(solve_on, mesh, start)
        if way.first is First.REDUCED:
            return self._reduced(solve_on, mesh)
        path = failed and failed.trajectory
        if way.first is First.SIMULATED:
            path = self.simulate and self.simulate()
        return self.finish(partial(solve_on, guess=path), mesh, None) if path else None

    def _reduced(self, solve_on: Callable[..., Solution], mesh: Mesh | None) -> Solution | None:
        """Solve without redundant conditions, and check that the solution satisfies them.

        They are detected at the point of least violation near the guess: with them, a coarse mesh
        has spurious solutions or none.
        """
        none = replace(self.options, max_iterations=0)
        near = solve_on(mesh, self.warm_start, options=none)
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
        reduced = partial(
            solve_on, guess=near.trajectory, instance=without(self.instance, left_out)
        )
        solution = self.finish(reduced, mesh, None)
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


def _unbounded(solution: Solution) -> Solution:
    """Return a solution whose message names the variable that diverges."""
    program, sizes = solution.program, np.abs(solution.unknowns) * solution.scaling.unknowns
    name = unknown_place(program, int(np.nanargmax(sizes))).name
    objective = program.compiled.declared.objective_name
    way = "grows" if program.is_negated else "falls"
    message = (
        f"unbounded: {objective} {way} without bound while {name} diverges; bound {name}, or let "
        f"{objective} hold what it costs."
    )
    return solution.updated(message=message)


def _noted(solution: Solution) -> Solution:
    """Return a solution with a message if it has more equations than unknowns."""
    if solution.bounds.surplus <= 0 or not solution.status.is_solved:
        return solution
    note = (
        f"model: {counted(solution.bounds)}, of which some follow from the others; their "
        "multipliers are not unique."
    )
    return solution.updated(notes=(note,))


def violation_of(
    failed: Solution, options: SolverOptions, progress: Progress | None
) -> LeastViolation | None:
    """Return the least violation near a failed solution, None if it is not finite."""
    z = failed.unknowns
    if not np.all(np.isfinite(z)) or not np.all(np.isfinite(failed.program.constraints(z))):
        return None
    return least_violation(
        failed.program, failed.bounds, failed.scaling, z, options=options, progress=progress
    )


# Number of rows that a message names.
_NAMED = 3


def judged(failed: Solution, found: LeastViolation) -> Solution:
    """Return a failed solution with the verdict of its elastic program, and its point."""
    told = replace(
        failed,
        unknowns=found.z,
        trajectory=failed.program.trajectory(found.z),
        objective=failed.program.user_objective(found.z),
    )
    if found.is_positive:
        rows = found.worst_rows.tolist()
        violated = [violation(failed, row, found.slacks[row]) for row in rows]
        return told.updated(status=Status.INFEASIBLE, message=verdict(violated))
    if found.is_zero and failed.status is Status.INFEASIBLE:
        return told.updated(status=Status.NOT_CONVERGED)
    return told


def violation(failed: Solution, row: int, slack: float) -> tuple[str, str]:
    """Return the name of an equation, and place and amount of its violation in its own unit."""
    place = row_place(failed.program, row)
    missed, unit = slack / failed.scaling.rows[row], failed.problem.source.unit(place.name)
    return place.name, f"{place} by {missed:.3g} {unit}".rstrip()


def verdict(violated: list[tuple[str, str]]) -> str:
    """Return the message of a positive least violation: its violated equations, the worst first.

    Each equation is named once.
    """
    worst: dict[str, str] = {}
    for name, line in violated:
        worst.setdefault(name, line)
    named = ", ".join(list(worst.values())[:_NAMED])
    others = len(worst) - _NAMED
    more = f" and {others} more" if others > 0 else ""
    return (
        f"infeasible: the least violation of all equations within the bounds is above zero and "
        f"leaves {named}{more}; relax a limit or an end condition, as `diagnose` proposes, or "
        "begin from another guess."
    )
