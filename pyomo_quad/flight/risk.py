"""Planning of flights that break limits with at most an allowed probability, the allowed risk.

The risk of a plan is the probability that a flight in turbulence breaks any limit. To reduce it, a
search finds margins by which the plan tightens limits. If no margins suffice for the allowed risk
with the default gains of the controller, the search is repeated with faster gains. See
docs/theory/risk.md.
"""

from dataclasses import replace
from typing import Any

from pyomo_quad.collocation import Progress, SolveError
from pyomo_quad.flight.margin_search import STOPPED, MarginSearch
from pyomo_quad.flight.plan import Plan
from pyomo_quad.flight.planning import Planner
from pyomo_quad.model import build_model
from pyomo_quad.scenario import Attitude, Scenario
from pyomo_quad.scenario.tables import FASTER_GAINS, Gains

# Risk of a plan with free duration whose scenario states no risk.
_USUAL_RISK = 0.01
# Reason for which margins are not searched for.
_OWN_MODEL = "margins are computed for the built-in model only, not for a user's own model"


def risk_asked(scenario: Scenario) -> float:
    """Return the allowed risk that the scenario states, or else a default.

    The default is 1 (any risk) if the duration is prescribed, or for the simplified attitude
    equations of Yacef et al. Otherwise it is `_USUAL_RISK`.
    """
    stated = scenario.mission.risk
    if stated is not None:
        return stated
    # Without margins, a plan of free duration uses the full thrust of the rotors, so that no
    # controller can follow it. With the simplified attitude equations of the paper (Yacef et al.),
    # any risk is allowed.
    is_of_paper = scenario.vehicle.attitude is Attitude.PAPER
    return _USUAL_RISK if scenario.mission.is_free and not is_of_paper else 1.0


def plan_at_risk(
    scenario: Scenario, planner: Planner, *, progress: Progress | None = None, **solve: Any
) -> Plan:
    """Solve a scenario for a plan whose margins are large enough for the allowed risk.

    If no such plan is found, the result is the plan of least risk. There are no margins if the
    allowed risk is 1, if the plan is not flyable, or if the model is a user's own. The keywords
    ``solve`` are further arguments of `Planner.solve`.
    """
    with planner.until_stopped() as is_stopped:
        paper = planner.solve(scenario, progress=progress, **solve)
        risk = risk_asked(scenario)
        if risk >= 1.0 or not paper.is_flyable:
            return paper

        def search_from(start: Plan) -> MarginSearch:
            return MarginSearch(start, planner, risk, progress=progress, is_stopped=is_stopped)

        search, found = search_from(paper), list[Plan]()
        if planner.builder is not build_model:
            # If a risk is stated, the record `Plan.risk` says why there are no margins.
            is_stated = scenario.mission.risk is not None
            return search.unfinished(_OWN_MODEL) if is_stated else paper
        if is_stopped():
            return search.unfinished(STOPPED)
        may_change_gains = scenario.baseline.has_default_gains
        try:
            if not (may_change_gains and search.is_beyond_the_controller()):
                found.append(search.best())
            if may_change_gains and not any(map(_is_kept, found)) and not is_stopped():
                found.append(_for_faster_gains(search_from(_with_faster_gains(paper)).best()))
        except SolveError as error:
            return found[0] if found else search.unfinished(str(error).removesuffix("."))
        return min(found, key=_share_failed) if found else search.unfinished(STOPPED)


def _with_faster_gains(plan: Plan) -> Plan:
    """Return a plan whose scenario has the faster gains of the controller, `FASTER_GAINS`.

    The trajectory of the plan is unchanged.
    """
    baseline = plan.scenario.baseline.model_copy(update={"gains": FASTER_GAINS})
    return replace(plan, scenario=plan.scenario.model_copy(update={"baseline": baseline}))


def _for_faster_gains(plan: Plan) -> Plan:
    """Return a plan with a record of the faster controller gains for which it was made.

    The record `risk.gains` maps each gain that differs from the default to its value.
    """
    if plan.risk is None:
        return plan
    usual = Gains().model_dump()
    changed = {n: g for n, g in FASTER_GAINS.model_dump().items() if g != usual[n]}
    return replace(plan, risk=replace(plan.risk, gains=changed))


def _is_kept(plan: Plan) -> bool:
    return plan.risk is not None and plan.risk.is_satisfied


def _share_failed(plan: Plan) -> float:
    """Return the fraction of a plan's test flights that broke a limit; 1 if none was flown."""
    risk = plan.risk
    return 1.0 if risk is None or not risk.flown else risk.failed / risk.flown
