"""The case solver of real sweeps: a plan for the case's scenario, and the controller's flights.

Each process keeps one compiled problem, and solves with it from the parent case's solution.  That
solution is chosen by the design and travels with the task, and a case without one is solved by a
problem compiled for it alone, since a problem remembers the last solution it found.  So a case is a
pure function of its task, whoever solves it and whatever was solved there before.
"""

import threading
from dataclasses import dataclass, field

from pyomo_quad.flight import Plan, Planner
from pyomo_quad.flight.baselines import fly_baseline
from pyomo_quad.scenario import Scenario
from pyomo_quad.scenario.baseline import Reference
from pyomo_quad.study.sweep.outputs import baseline_outputs, flown_outputs, plan_outputs
from pyomo_quad.study.sweep.task import CaseResult, CaseTask, StudyTask
from pyomo_quad.study.sweep.warm_start import pack, unpack

__all__ = ["solve_case"]


def solve_case(task: CaseTask) -> CaseResult:
    """Solve one case.

    Parameters
    ----------
    task : CaseTask
        The case.

    Returns
    -------
    CaseResult
        Finished when its flights were verified; else the numbers are kept with the reason.
    """
    with _BENCH.lock:
        scenario = Scenario.model_validate_json(task.scenario)
        if task.task == StudyTask.FLY_PLAN:
            return _fly_base_plan(task, scenario)
        return _optimise(task, scenario)


def _optimise(task: CaseTask, scenario: Scenario) -> CaseResult:
    plan = _BENCH.plan(scenario, task.warm_start)
    values = plan_outputs(plan)
    if not plan.is_verified:
        return CaseResult(values=values, reason=f"{plan.status}: {plan.message}")
    reason = ""
    for reference in task.baselines:
        flight = fly_baseline(scenario, reference, dynamics=plan.dynamics, plan=plan)
        values |= baseline_outputs(reference, flight, plan)
        if not flight.is_verified:
            reason = f"{flight.name}: two integrators disagree on this flight"
    warm_start = pack(plan.warm_start) if plan.warm_start is not None else None
    return CaseResult(values=values, warm_start=warm_start, reason=reason)


def _fly_base_plan(task: CaseTask, scenario: Scenario) -> CaseResult:
    """Let the controller, which believes in the base case, fly its plan in the case's world."""
    base = Scenario.model_validate_json(task.base)
    plan = _BENCH.base_plan(base, task.base)
    if not plan.is_verified:
        return CaseResult(values={}, reason=f"base case: {plan.status}: {plan.message}")
    flight = fly_baseline(
        base, Reference.PLAN, dynamics=_BENCH.planner.dynamics(scenario), plan=plan
    )
    reason = "" if flight.is_verified else "two integrators disagree on this flight"
    return CaseResult(values=flown_outputs(flight, plan, scenario), reason=reason)


@dataclass
class _Bench:
    """What this process keeps; MUMPS serves one thread at a time."""

    lock: threading.Lock = field(default_factory=threading.Lock)
    planner: Planner = field(default_factory=Planner)
    _base_plans: dict[str, Plan] = field(default_factory=dict)

    def plan(self, scenario: Scenario, warm_start: bytes | None) -> Plan:
        """Solve from a parent's point, and from nothing where that leads nowhere."""
        parent = unpack(warm_start) if warm_start is not None else None
        if parent is not None:
            plan = self.planner.solve(scenario, warm_start=parent)
            if plan.is_verified:
                return plan
        self.planner = Planner()
        return self.planner.solve(scenario)

    def base_plan(self, base: Scenario, text: str) -> Plan:
        """Return the plan of a study's base case, solved once."""
        if text not in self._base_plans:
            self._base_plans = {text: self.plan(base, None)}
        return self._base_plans[text]


_BENCH = _Bench()
