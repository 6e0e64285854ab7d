"""One line for each flight that breaks limits: which, and whether the plan's risk covers them."""

from types import SimpleNamespace

import pytest

from pyomo_quad.flight.margins import RiskTaken
from pyomo_quad.study.limits_kept import limit_lines

RISK = RiskTaken(
    asked=0.01,
    predicted=0.009,
    failed=2,
    flown=200,
    is_satisfied=True,
    paper_energy_J=1.0,
    limiting=("speed at hover waypoint 1",),
)


def line(name, broken, risk):
    flight = SimpleNamespace(name=name, broken_limits=broken)
    (said,) = limit_lines(SimpleNamespace(risk=risk), [flight])
    return said


def test_flights_that_keep_their_limits_take_one_line_together_and_none_beside_others():
    kept, other = (SimpleNamespace(name=name, broken_limits=()) for name in ("mpc/told", "optimal"))
    broken = SimpleNamespace(name="adaptive/plan", broken_limits=("floor by 1 m",))
    plan = SimpleNamespace(risk=RISK)
    assert list(limit_lines(plan, [kept, other])) == ["Every flight keeps every limit."]
    (only,) = limit_lines(plan, [kept, broken, other])
    assert only.startswith("adaptive/plan breaks a limit")
    assert list(limit_lines(plan, [])) == []


@pytest.mark.parametrize(
    ("name", "broken", "risk", "words"),
    [
        ("mpc/told", "speed at hover waypoint 1 by 0.17 m/s", None, "planned without mission.risk"),
        (
            "mpc/told",
            "speed at hover waypoint 1 by 0.17 m/s",
            RISK,
            "covered by the plan's risk: 2 of",
        ),
        ("adaptive/plan", "roll angle by 0.1 rad", RISK, "not covered by the plan's risk of 0.01"),
        ("adaptive/cruise 6 m/s", "floor by 1 m", RISK, "does not apply to this flight"),
        ("optimal", "floor by 1e-6 m", RISK, "the plan itself"),
    ],
)
def test_a_broken_limit_is_named_with_its_amount_and_what_the_risk_says(name, broken, risk, words):
    said = line(name, (broken,), risk)
    assert said.startswith(f"{name} breaks a limit: {broken} (")
    assert words in said
