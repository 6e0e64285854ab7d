"""Sentences on the limits that each flight of a run breaks, for the run's report.

The risk of a plan is the allowed share of its flights in turbulence that break a limit. The planner
simulates test flights of the plan in turbulence. The risk covers a limit if the limit is among the
three that the test flights break most often. The risk covers a flight if it covers every limit that
the flight breaks.
"""

from collections.abc import Iterator, Sequence

from pyomo_quad.flight import Flight, Plan
from pyomo_quad.flight.baselines import baseline_name
from pyomo_quad.flight.margins import RiskTaken
from pyomo_quad.flight.replanning import replanned_name
from pyomo_quad.scenario.tables import Knowledge, Reference
from pyomo_quad.study.comparison import OPTIMAL

# Names of the flights to which a plan's risk applies: flights under feedback that follow the plan,
# or re-plans for the true or the estimated wind.
_OF_THE_PLAN = (
    baseline_name(Reference.PLAN),
    replanned_name(Knowledge.TOLD),
    replanned_name(Knowledge.ESTIMATED),
)
_WITHOUT_RISK = "planned without mission.risk, so without margins for the controller"


def limit_lines(plan: Plan, flights: Sequence[Flight]) -> Iterator[str]:
    """Yield a sentence on each flight that breaks limits, for the report of a run.

    Each sentence says whether the plan's risk covers the flight. If no flight breaks a limit, a
    single sentence says so.
    """
    if flights and not any(flight.broken_limits for flight in flights):
        yield "Every flight keeps every limit."
    for flight in flights:
        if not flight.broken_limits:
            continue
        broken = "; ".join(flight.broken_limits)
        yield f"{flight.name} breaks a limit: {broken} ({_risk_words(plan.risk, flight)})."


def _risk_words(risk: RiskTaken | None, flight: Flight) -> str:
    """Return in words whether the plan's risk covers a flight that breaks limits.

    `risk` is None if the plan was made without an allowed risk (`mission.risk`).
    """
    if flight.name == OPTIMAL:
        return "the plan itself, beyond the error that its accuracy allows"
    if risk is None:
        return _WITHOUT_RISK
    if flight.name not in _OF_THE_PLAN:
        return f"the plan's risk of {risk.asked:g} does not apply to this flight"
    seen = f"{risk.failed} of {risk.flown} flights of the plan broke a limit"
    # `risk.limiting` has the three limits that the test flights break most often.
    new = [words for words in flight.broken_limits if not words.startswith(tuple(risk.limiting))]
    if not new:
        return f"covered by the plan's risk: {seen}, this limit among the most frequent"
    first = new[0].rpartition(" by ")[0] or new[0]
    return (
        f"not covered by the plan's risk of {risk.asked:g}: {seen}, {first} not among the most "
        "frequent"
    )
