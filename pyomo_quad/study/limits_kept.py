"""Limits that each flight of a run breaks, by how much, and whether the plan's risk covers it."""

from collections.abc import Iterator, Sequence

from pyomo_quad.flight import Flight, Plan
from pyomo_quad.flight.baselines import baseline_name
from pyomo_quad.flight.margins import RiskTaken
from pyomo_quad.flight.replanning import replanned_name
from pyomo_quad.scenario.tables import Knowledge, Reference
from pyomo_quad.study.comparison import OPTIMAL

# Flights that a plan's risk is about: under feedback, and told the forecast that the plan was made
# for.
_OF_THE_PLAN = (
    baseline_name(Reference.PLAN),
    replanned_name(Knowledge.TOLD),
    replanned_name(Knowledge.ESTIMATED),
)
_WITHOUT_RISK = "planned without a risk, which leaves nothing to the controller"


def limit_lines(plan: Plan, flights: Sequence[Flight]) -> Iterator[str]:
    """Yield a line for each flight that breaks a limit: which, and what the plan's risk says.

    Parameters
    ----------
    plan : Plan
        That the flights follow or are compared with.
    flights : sequence of Flight
    """
    if flights and not any(flight.broken_limits for flight in flights):
        yield "Every flight keeps every limit."
    for flight in flights:
        if not flight.broken_limits:
            continue
        broken = "; ".join(flight.broken_limits)
        yield f"{flight.name} breaks a limit: {broken} ({_risk_words(plan.risk, flight)})."


def _risk_words(risk: RiskTaken | None, flight: Flight) -> str:
    """Return whether a risk covers the limits that a flight breaks."""
    if flight.name == OPTIMAL:
        return "the plan itself, whose accuracy allows no more"
    if risk is None:
        return _WITHOUT_RISK
    if flight.name not in _OF_THE_PLAN:
        return f"the plan's risk of {risk.asked:g} is about other flights"
    seen = f"{risk.failed} of {risk.flown} flights of the plan broke a limit"
    new = [words for words in flight.broken_limits if not words.startswith(tuple(risk.limiting))]
    if not new:
        return f"covered by the plan's risk: {seen}, this one among the most frequent"
    first = new[0].rpartition(" by ")[0] or new[0]
    return f"not covered by the plan's risk of {risk.asked:g}: {seen}, {first} not most often"
