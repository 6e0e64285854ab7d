"""Progress of a search for a plan: stage, processor time and best usable plan so far."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import partial
from math import inf, isfinite
from typing import TYPE_CHECKING

from pyomo_quad.flight.plan import LEAST_ENERGY_J, PlanStatus
from pyomo_quad.scenario.accuracy import FIGURES, Accuracy

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from pyomo_quad.collocation import Iteration, Solution
    from pyomo_quad.flight.deadline import Deadline
    from pyomo_quad.flight.plan import Plan

#: Largest share of its energy by which a usable plan may differ from the mesh before: a trajectory
#: near a coarse optimum spends a few per cent more.
USABLE_ENERGY = 0.1
# Error estimate of a mesh above which no flight of its controls arrives, found by experience: the
# estimate holds the breach of limits as it is, of which a usable plan may have as much.
_PROMISING = FIGURES[Accuracy.QUICK].breach
# Searches that end within so many seconds of the processor keep nothing on the way, and longer ones
# spend at most this share of their time on flights of finished meshes: before there is a usable
# plan, and for a better one.
_PATIENCE_S, _SHARE, _SHARE_FOR_BETTER = 2.0, 0.2, 0.05
# What can be flown near a coarse mesh, which takes seconds to find, is found after so many times
# as long, by which most searches have a better plan, or after this share of the time limit.
_LONG, _SHARE_OF_LIMIT = 7.5, 0.3
# Coarse meshes from which a usable plan is sought.
_MOST_SEARCHES = 2


class Stage(StrEnum):
    """Stage of a search."""

    ROUTES = "routes"
    COARSE = "coarse solves"
    USABLE = "towards a usable plan"
    REFINING = "refinement"


@dataclass(frozen=True, kw_only=True)
class State:
    """Snapshot of a search's progress.

    Attributes
    ----------
    stage : Stage
    energy_J : float
        Least energy found so far, infinite before there is one.
    uncertainty : float
        Share of that energy by which the last mesh changed it, infinite where there was one mesh.
    spent_s : float
        Processor time since the search began.
    has_usable : bool
        Whether a usable plan is kept, which is returned when the search is stopped now.
    iteration : Iteration
        Of the solve under way.
    """

    stage: Stage
    energy_J: float
    uncertainty: float
    spent_s: float
    has_usable: bool
    iteration: Iteration


class Search:
    """Progress callback that ends a search in time and keeps the best usable plan.

    Parameters
    ----------
    deadline : Deadline
    show : callable, optional
        Called with the state of the search at each iteration.

    Attributes
    ----------
    stage : Stage
    record : list of str
        Outcomes of the strategies carried out so far.
    usable : Plan or None
        The best usable plan so far.
    effort : int
        Sum over iterations of the points of their meshes, since `begin_effort`.
    """

    def __init__(self, deadline: Deadline, show: Callable[[State], None] | None = None) -> None:
        self.deadline = deadline
        self.stage = Stage.COARSE
        self.record: list[str] = []
        self.usable: Plan | None = None
        self.begin_effort(inf)
        self._show = show
        self._began = self._patient_from = time.thread_time()
        self._coarse: Callable[[], Iterator[Plan]] | None = None
        self._flights_s, self._searches = 0.0, 0
        self._energy, self._uncertainty = inf, inf

    @property
    def spent_s(self) -> float:
        """Processor time since the start of the search [s]."""
        return time.thread_time() - self._began

    @property
    def _waited_s(self) -> float:
        return time.thread_time() - self._patient_from

    def restart_patience(self) -> None:
        """Restart the time that the search waits before it seeks a usable plan."""
        self._patient_from = time.thread_time()

    def begin_effort(self, most: float) -> None:
        """Reset the effort counter and set the largest effort of the next solves."""
        self.effort, self._most_effort = 0, most

    def __call__(self, iteration: Iteration) -> bool:
        """Return False when the search must stop."""
        self.effort += iteration.mesh_points
        if self._show is not None:
            self._show(
                State(
                    stage=self.stage,
                    energy_J=self._energy,
                    uncertainty=self._uncertainty,
                    spent_s=self.spent_s,
                    has_usable=self.usable is not None,
                    iteration=iteration,
                )
            )
        self._seek_usable()
        return self.deadline(iteration) and self.effort <= self._most_effort

    def finished(
        self,
        solution: Solution,
        energy_J: float,
        flown: Callable[[Solution], Plan],
        flyable: Callable[[Solution], Iterator[Plan]],
    ) -> None:
        """Try a mesh's solution as a usable plan: simulate its controls if it is promising.

        From a mesh that is too coarse for that, what can be flown is found first where the search
        lasts long, if need be in the middle of a solve, unless there is a usable plan already.  A
        search that ends soon needs neither.

        Parameters
        ----------
        solution : Solution
        energy_J : float
            Of the solution.
        flown : callable
            Returns the plan of a solution with the verdict of its flight.
        flyable : callable
            Yields such plans for trajectories near a solution that is not flyable itself.
        """
        self._note(energy_J)
        if solution.error_estimate > _PROMISING:
            self._coarse = partial(flyable, solution)
            self._seek_usable()
            return
        share = _SHARE if self.usable is None else _SHARE_FOR_BETTER
        if self._waited_s >= _PATIENCE_S and self._flights_s <= share * self.spent_s:
            began = time.thread_time()
            self.keep(flown(solution))
            self._flights_s += time.thread_time() - began
            self.stage = Stage.REFINING

    def _seek_usable(self) -> None:
        """In a long search, make a usable plan from the last coarse solution."""
        patience = min(_LONG * _PATIENCE_S, _SHARE_OF_LIMIT * self.deadline.limit_s)
        is_time = self._waited_s >= patience and not self.deadline.is_over
        is_wanted = self.usable is None and self.stage is not Stage.USABLE
        if self._coarse is None or not (is_time and is_wanted) or self._searches >= _MOST_SEARCHES:
            return
        coarse, self._coarse = self._coarse, None
        self._searches += 1
        self.stage = Stage.USABLE
        for plan in coarse():
            self.keep(plan)
            if self.usable is not None:
                break
        self.stage = Stage.REFINING

    def _note(self, energy_J: float) -> None:
        if isfinite(self._energy):
            self._uncertainty = abs(energy_J - self._energy) / max(abs(energy_J), LEAST_ENERGY_J)
        self._energy = energy_J

    def keep(self, plan: Plan) -> None:
        """Keep a plan that simulation confirms if it is the best so far."""
        found = as_usable(plan)
        if not found.is_flyable:
            return
        if self.usable is None or found.energy_uncertainty <= self.usable.energy_uncertainty:
            self.usable = found

    def ended(self, plan: Plan) -> Plan:
        """Return the plan that a search ends with: the last plan, or the best usable one."""
        plan = as_usable(self._given_up(replace(plan, attempts=tuple(self.record))))
        if plan.is_flyable or plan.status is PlanStatus.INFEASIBLE or self.usable is None:
            return plan
        cause = plan.message.partition(". ")[0].rstrip(".; ")
        kept = self.usable
        # Of waypoints in the best order, the kept plan has the order of its own.
        mission = plan.scenario.mission.model_copy(
            update={"waypoints": kept.scenario.mission.waypoints}
        )
        return replace(
            kept,
            scenario=plan.scenario.model_copy(update={"mission": mission}),
            message=f"{_proven(kept)} {kept.scenario.solver.accuracy.value} was not reached: "
            f"{cause}.",
            attempts=plan.attempts,
            timings=dict(kept.timings) | {"solve": plan.timings.get("solve", 0.0)},
            routes=plan.routes or kept.routes,
        )

    def _given_up(self, plan: Plan) -> Plan:
        """Return the plan as not converged if the time limit left neither flight nor proof."""
        if not self.deadline.is_over or plan.is_flyable or plan.status is PlanStatus.INFEASIBLE:
            return plan
        message = (
            f"given up after solver.time_limit = {self.deadline.limit_s:g} s; allow more time, or "
            f"ask for a lower solver.accuracy or fewer solver.elements. {plan.reached}"
        )
        if plan.attempts:
            message += f" Tried: {'; '.join(plan.attempts)}."
        return replace(plan, status=PlanStatus.NOT_CONVERGED, message=message, failure=None)


def as_usable(plan: Plan) -> Plan:
    """Return a plan with status usable if simulation confirms it at lower accuracy."""
    if plan.is_flyable or plan.status is PlanStatus.INFEASIBLE:
        return plan
    found = plan.verification
    if found is None or not found.is_usable or not plan.energy_uncertainty <= USABLE_ENERGY:
        return plan
    why = plan.message.rstrip(".; ")
    usable = replace(plan, status=PlanStatus.USABLE)
    asked = plan.scenario.solver.accuracy.value
    return replace(usable, message=f"{_proven(usable)} {asked} was not reached: {why}.")


def _proven(plan: Plan) -> str:
    """Return the confirmed accuracy of a usable plan, as a sentence."""
    found = plan.verification
    if found is None:
        return ""
    off = abs(found.energy_difference_J) / max(abs(plan.energy), LEAST_ENERGY_J)
    return (
        f"Flown open loop it ends {found.terminal_miss_m:.2g} m from the goal, breaks no limit by "
        f"more than {max(found.max_violation, 0.0):.1g} of it, and its energy differs from the "
        f"plan's by {off:.1g} of it; a better plan may spend less, by an estimated "
        f"{plan.energy_uncertainty:.1g} of it."
    )


def accuracy_words(plan: Plan) -> str:
    """Return the requested accuracy, the accuracy reached, and the uncertainty of the energy."""
    asked, reached = plan.scenario.solver.accuracy, plan.accuracy_reached
    known = plan.energy_uncertainty
    words = f"accuracy requested: {asked.value}; reached: {'none' if reached is None else reached}"
    return f"{words}; uncertainty of the energy: {100 * known:.1g} %" if isfinite(known) else words
