"""The case solver of real sweeps: a plan for the case's scenario, and the controller's flights.

Each process keeps one compiled problem, and solves with it from the parent case's solution.  That
solution is chosen by the design and travels with the task, and a case without one is solved by a
problem compiled for it alone, since a problem remembers the last solution it found.  So a case is a
pure function of its task, whoever solves it and whatever was solved there before.
"""

import threading

from pyomo_quad.flight import Plan, Planner
from pyomo_quad.scenario import Scenario
from pyomo_quad.study.sweep.outputs import plan_outputs
from pyomo_quad.study.sweep.task import CaseResult, CaseTask
from pyomo_quad.study.sweep.warm_start import pack, unpack

__all__ = ["solve_case"]


class _Bench:
    """The planner of this process; MUMPS serves one thread at a time."""

    def __init__(self) -> None:
        self.lock = threading.Lock()
        self.planner = Planner()

    def solve(self, scenario: Scenario, warm_start: bytes | None) -> Plan:
        """Solve from a parent's point, and from nothing where that leads nowhere."""
        parent = unpack(warm_start, self.planner, scenario) if warm_start is not None else None
        if parent is not None:
            plan = self.planner.solve(scenario, warm_start=parent)
            if plan.is_verified:
                return plan
        self.planner = Planner()
        return self.planner.solve(scenario)


_BENCH = _Bench()


def solve_case(task: CaseTask) -> CaseResult:
    """Solve one case.

    Parameters
    ----------
    task : CaseTask
        The case.

    Returns
    -------
    CaseResult
        Finished when the plan was verified by a flight; else the best iterate's numbers are kept
        with the reason.
    """
    with _BENCH.lock:
        return _optimise(task)


def _optimise(task: CaseTask) -> CaseResult:
    scenario = Scenario.model_validate_json(task.scenario)
    plan = _BENCH.solve(scenario, task.warm_start)
    if not plan.is_verified:
        return CaseResult(values=plan_outputs(plan), reason=f"{plan.status}: {plan.message}")
    warm_start = pack(plan.solution) if plan.solution is not None else None
    return CaseResult(values=plan_outputs(plan), warm_start=warm_start)
