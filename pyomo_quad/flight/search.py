"""Progress of a search for a plan: stage, processor time, and the best usable plan found so far.

A search consists of many solves of one mission, on several meshes and from several initial guesses,
and of simulations of the solutions. A usable plan is a plan that simulation confirms at lower
accuracy than requested. A search that is stopped returns the best usable plan.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from enum import StrEnum
from itertools import islice
from math import inf, isfinite
from typing import TYPE_CHECKING

from pyomo_quad.flight.limit_words import percent
from pyomo_quad.flight.plan import LEAST_ENERGY_J, PlanStatus

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from pyomo_quad.collocation import Iteration
    from pyomo_quad.flight.deadline import Deadline
    from pyomo_quad.flight.plan import Plan

# Work of a search (the sum over Ipopt's iterations of the number of mesh points): before it makes
# the first plan, somewhat more than a second of a processor; and before it computes usable plans at
# the highest accuracy, about two seconds. Largest fractions of its work that it spends on
# simulating the controls of finished meshes: before it has a usable plan from a solution, and
# afterwards, to find a better usable plan.
_PROMPT, _PATIENCE, _SHARE, _SHARE_FOR_BETTER = 7.5e3, 1.2e4, 0.3, 0.05
# Correcting the controls of a mesh and simulating them counts as the work of this number of
# iterations on the mesh.
_ITERATIONS_OF_FLIGHT = 20
# Largest number of plans that are made from one finished mesh, with stricter and stricter limits.
_MOST_PLANS = 3


class Stage(StrEnum):
    """Stage of a search for a plan, as a progress display shows it.

    The stages are the comparison of routes round zones, the first solves on coarse meshes, the
    search for a usable plan, and the refinement of the mesh to the requested accuracy.
    """

    ROUTES = "routes"
    COARSE = "coarse solves"
    USABLE = "search for a usable plan"
    REFINING = "refinement"


@dataclass(frozen=True, kw_only=True)
class State:
    """Snapshot of the progress of a search for a plan, for a progress display.

    Attributes
    ----------
    stage : Stage
        Present stage.
    energy_J : float
        Energy on the last solved mesh [J]; infinite if there is none.
    uncertainty : float
        Relative change of the energy between the last two meshes; infinite if there are fewer.
    spent_s : float
        Processor time of the search [s].
    has_usable : bool
        Whether the search has a usable plan.
    iteration : Iteration
        Present iteration of Ipopt.
    """

    stage: Stage
    energy_J: float
    uncertainty: float
    spent_s: float
    has_usable: bool
    iteration: Iteration


class Search:
    """State of one search for a plan, from its first solve to its result.

    It is the progress callback of all solves, and stops Ipopt when the time is used up. A search
    that is stopped returns the best usable plan.

    If there is no usable plan after somewhat more than a second of solves, the callback tries to
    make one without an optimisation. This plan is called the first plan. The method `begin_with`
    sets the function that makes it.

    Attributes
    ----------
    deadline : Deadline
        Time limit.
    stage : Stage
        Present stage.
    record : list of str
        Names and outcomes of the strategies tried.
    usable : Plan or None
        Best usable plan.
    work : int
        Number of mesh points, summed over all iterations of Ipopt.
    """

    def __init__(self, deadline: Deadline, show: Callable[[State], None] | None = None) -> None:
        self.deadline = deadline
        self.stage = Stage.COARSE
        self.record: list[str] = []
        self.usable: Plan | None = None
        self._make_first: Callable[[], Plan | None] | None = None
        self.work = self._patient_from = self._work_of_flights = 0
        self.begin_effort(inf)
        self._show = show
        self._began = time.thread_time()
        self._energy, self._uncertainty = inf, inf
        self._last: Iteration | None = None

    @property
    def spent_s(self) -> float:
        """Processor time of this thread since the start of the search [s]."""
        return time.thread_time() - self._began

    @property
    def effort(self) -> int:
        """Cost of the solves since the last call of `begin_effort`, which sets its upper limit.

        The cost is the number of mesh points, summed over Ipopt's iterations. It does not depend on
        the speed and the load of the machine.
        """
        return self.work - self._effort_from

    @property
    def is_early(self) -> bool:
        """Whether the search has run for less than about two seconds.

        During this time, a search at the highest accuracy, `proof`, does not simulate solutions to
        obtain usable plans.
        """
        # A usable plan is needed only if the search is stopped. Making one takes time, and most
        # searches end soon and by themselves.
        return self.work - self._patient_from < _PATIENCE

    def begin_with(self, make_first: Callable[[], Plan | None]) -> None:
        """Set the function that makes the first plan of the search.

        `make_first` returns a simulated plan or None. It is called at most once, if there is no
        usable plan after somewhat more than a second of solves.
        """
        self._make_first = make_first

    def begin_apart(self, spent_s: float) -> None:
        """Prepare this copy of a search for solves in a forked process.

        The method is called in the forked process. The copy shows no progress, and does not make
        the first plan. `spent_s` is the processor time of the search before the fork [s].
        """
        self._make_first = self._show = None
        # The clock of a forked process starts at zero.
        self._began = time.thread_time() - spent_s

    def is_stopped(self) -> bool:
        """Return whether the user or the time limit has stopped the search.

        The user stops it by a progress callback that returns False. This method calls the callback
        again, with the most recent iteration of Ipopt. Before the first iteration, the result is
        False, whatever the time.
        """
        return self._last is not None and not self.deadline(self._last)

    def _begin(self) -> None:
        """Make the first plan of the search, and store it if it is usable.

        If there is a usable plan, or if the first plan was already tried, nothing happens.
        """
        make, self._make_first = self._make_first, None
        if make is None or self.usable is not None:
            return
        stage, self.stage = self.stage, Stage.USABLE
        plan = make()
        if plan is not None:
            self.keep(plan)
        self.stage = stage

    def restart_patience(self) -> None:
        """Start the first seconds of the search again, for a new series of solves.

        The property `is_early` becomes true for about two seconds of solves. The delay of the first
        plan starts again. The method is called when the order of the waypoints has been chosen,
        before the whole mission is solved.
        """
        self._patient_from = self.work

    def begin_effort(self, limit: float) -> None:
        """Limit the cost of the next solves.

        The cost `effort` is set to zero. Solves are stopped when `effort` exceeds `limit`. Both are
        numbers of mesh points, summed over Ipopt's iterations.
        """
        self._effort_from, self._most_effort = self.work, limit

    def __call__(self, iteration: Iteration) -> bool:
        """Record an iteration of Ipopt, and return whether Ipopt may continue.

        Ipopt may not continue if the user or the time limit stops the search, or if `effort`
        exceeds the limit set by `begin_effort`. The call makes the first plan if its delay is over.
        """
        self._last = iteration
        self.work += iteration.mesh_points
        if self.work - self._patient_from > _PROMPT and not self.deadline.is_over:
            self._begin()
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
        return self.deadline(iteration) and self.effort <= self._most_effort

    def finished(
        self,
        energy_J: float,
        flown: Callable[[], Iterator[Plan]],
        *,
        points: int,
        is_skipped: bool,
    ) -> None:
        """Try to make a usable plan from the solution on a mesh that has just been solved.

        `flown` yields simulated plans: of the solution, then of solves with stricter limits. The
        mesh has `points` points. If `is_skipped`, only the energy `energy_J` [J] is noted.
        """
        self._note(energy_J)
        share = _SHARE_FOR_BETTER if _is_optimised(self.usable) else _SHARE
        if is_skipped or self._work_of_flights > share * self.work or self.deadline.is_over:
            return
        before, stage = self.usable, self.stage
        self.stage = Stage.USABLE
        for plan in islice(flown(), _MOST_PLANS):
            self.keep(plan)
            self._work_of_flights += _ITERATIONS_OF_FLIGHT * points
            # If the search already has a usable plan from a solution, one further plan is enough.
            if before is not self.usable or _is_optimised(self.usable):
                break
        self.stage = stage

    def _note(self, energy_J: float) -> None:
        if isfinite(self._energy):
            self._uncertainty = abs(energy_J - self._energy) / max(abs(energy_J), LEAST_ENERGY_J)
        self._energy = energy_J
        if self.usable is not None and not self.usable.is_optimised:
            # The solution is a better estimate of the optimum than steady flight is.
            saving = 1.0 - energy_J / max(self.usable.energy, LEAST_ENERGY_J)
            self.usable = replace(self.usable, error_estimate=max(0.0, saving))

    def keep(self, plan: Plan) -> None:
        """Store a plan as the best usable plan if it is usable and better than the stored plan.

        Of two plans from solutions of the optimal control problem, the better has the smaller
        uncertainty of the energy. A search may begin with a plan along the shortest route, made
        without optimisation. If one of the two is such a plan, the better has the lower objective,
        `Plan.cost`.
        """
        found, kept = as_usable(plan), self.usable
        if not found.is_flyable:
            return
        if kept is None:
            self.usable = found
        elif found.is_optimised and kept.is_optimised:
            if found.energy_uncertainty <= kept.energy_uncertainty:
                self.usable = found
        elif found.cost <= kept.cost:
            self.usable = found

    def ended(self, plan: Plan) -> Plan:
        """Return the result of the search: its last plan or the best usable plan.

        The last plan, `plan`, is returned if it is flyable or infeasible, or if there is no usable
        plan. The attribute `attempts` of the result is the record of the search.
        """
        plan = as_usable(self._given_up(replace(plan, attempts=tuple(self.record))))
        if plan.is_flyable or plan.status is PlanStatus.INFEASIBLE or self.usable is None:
            return plan
        cause = plan.message.partition(". ")[0].rstrip(".; ")
        kept = self.usable
        # If the order of the waypoints is free, the usable plan may have another order.
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
        """Return the last plan, marked as "not converged" if the search ran out of time.

        A flyable or infeasible plan is returned unchanged.
        """
        if not self.deadline.is_over or plan.is_flyable or plan.status is PlanStatus.INFEASIBLE:
            return plan
        message = (
            f"given up after solver.time_limit = {self.deadline.limit_s:g} s; allow more time, or "
            f"ask for a lower solver.accuracy or fewer solver.elements. {plan.reached}"
        )
        if plan.attempts:
            message += f" Tried: {'; '.join(plan.attempts)}."
        return replace(plan, status=PlanStatus.NOT_CONVERGED, message=message, failure=None)


def _is_optimised(plan: Plan | None) -> bool:
    """Return whether a plan exists and was made from a solution of the optimal control problem."""
    return plan is not None and plan.is_optimised


def as_usable(plan: Plan) -> Plan:
    """Return a plan, marked as usable if simulation confirms it at lower accuracy than requested.

    The simulated flight must be within `scenario.accuracy.USABLE`, and `Plan.energy_uncertainty`
    must be finite. A plan that is flyable already, or infeasible, is returned unchanged.
    """
    if plan.is_flyable or plan.status is PlanStatus.INFEASIBLE:
        return plan
    found = plan.verification
    if found is None or not found.is_usable or not isfinite(plan.energy_uncertainty):
        return plan
    why = plan.message.rstrip(".; ")
    usable = replace(plan, status=PlanStatus.USABLE)
    asked = plan.scenario.solver.accuracy.value
    return replace(usable, message=f"{_proven(usable)} {asked} was not reached: {why}.")


def _proven(plan: Plan) -> str:
    """Return a sentence for the user on how closely a usable plan agrees with its simulation.

    A usable plan is a plan that simulation confirms at lower accuracy than requested.
    """
    found = plan.verification
    if found is None:
        return ""
    off = abs(found.energy_difference_J) / max(abs(plan.energy), LEAST_ENERGY_J)
    kind = "" if plan.is_optimised else "The plan follows the route and is not optimised. "
    return (
        f"{kind}Flown in open loop, the plan ends {found.terminal_miss_m:.2g} m from the goal, "
        f"exceeds no limit by more than {percent(max(found.max_violation, 0.0))}, and spends an "
        f"energy within {percent(off)} of the planned energy; a better plan may save an estimated "
        f"{percent(plan.energy_uncertainty)}."
    )


def accuracy_words(plan: Plan) -> str:
    """Return a text that states the requested and the reached accuracy of a plan.

    The text also states the uncertainty of the energy, if it is known.
    """
    asked, reached = plan.scenario.solver.accuracy, plan.accuracy_reached
    known = plan.energy_uncertainty
    words = f"accuracy requested: {asked.value}; reached: {'none' if reached is None else reached}"
    return f"{words}; uncertainty of the energy: {percent(known)}" if isfinite(known) else words
