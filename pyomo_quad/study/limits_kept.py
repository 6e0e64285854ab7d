"""Sentences on the limits that each flight of a run breaks, for the run's report.

The risk of a plan is the allowed share of its flights in turbulence that break a limit. The planner
simulates test flights of the plan in turbulence. The sentences also say whether the risk covers a
flight that breaks limits: it does if the flight breaks only limits that the test flights break most
often.
"""

from collections.abc import Iterator, Sequence

from pyomo_quad.flight import Flight, Plan
from pyomo_quad.flight.baselines import baseline_name
from pyomo_quad.flight.margins import RiskTaken
from pyomo_quad.flight.replanning import replanned_name
from pyomo_quad.scenario.tables import Knowledge, Reference
from pyomo_quad.study.comparison import OPTIMAL

# Names of the flights to which a plan's risk applies: flights under feedback that use the plan or
# the forecast for which the plan was made.
_OF_THE_PLAN = (
    baseline_name(Reference.PLAN),
    replanned_name(Knowledge.TOLD),
    replanned_name(Knowledge.ESTIMATED),
)
_WITHOUT_RISK = "planned without mission.risk, so without margins for the controller"


def limit_lines(plan: Plan, flights: Sequence[Flight]) -> Iterator[str]:
    """Yield a sentence on each flight that breaks limits, for the report of a run.

    Limits are those of the scenario, such as the largest speed. Each sentence names the limits that
    its flight breaks. If all flights keep all limits, a single sentence says so.

    The sentence also says whether the risk of the plan covers the flight. The risk is the allowed
    share of the plan's flights in turbulence that break a limit. It covers a flight if both of
    these hold:

    - The flight is under feedback: a controller tracks the plan, or the plan is solved again during
      the flight with the actual wind known or estimated.
    - The flight breaks only limits among the three that the planner's own test flights of the plan
      break most often.

    Parameters
    ----------
    plan : Plan
        Plan that the flights follow or with which they are compared.
    flights : sequence of Flight
        Flights of the run.

    Yields
    ------
    str
        Sentence for the report.
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

    The risk covers a flight that breaks only those limits that the planner's test flights in
    turbulence break most often. For a flight to which the risk does not apply, the words say so. An
    example is the flight of a controller without the plan. `risk` is the record of the risk and of
    the test flights; None for a plan without risk.
    """
    if flight.name == OPTIMAL:
        return "the plan itself, beyond the error that its accuracy allows"
    if risk is None:
        return _WITHOUT_RISK
    if flight.name not in _OF_THE_PLAN:
        return f"the plan's risk of {risk.asked:g} does not apply to this flight"
    seen = f"{risk.failed} of {risk.flown} flights of the plan broke a limit"
    new = [words for words in flight.broken_limits if not words.startswith(tuple(risk.limiting))]
    if not new:
        return f"covered by the plan's risk: {seen}, this limit among the most frequent"
    first = new[0].rpartition(" by ")[0] or new[0]
    return (
        f"not covered by the plan's risk of {risk.asked:g}: {seen}, {first} not among the most "
        "frequent"
    )
