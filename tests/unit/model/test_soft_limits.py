"""Soft limits: the penalty is exact above the norm of the multipliers, and a plan always exists."""

import pytest

from pyomo_quad.collocation import Mesh, SolverOptions, compile
from pyomo_quad.model import build_remaining, parameter_values, soft_limits
from pyomo_quad.model.mission import measured_start
from tests import flights

SHORT = (
    "mission.goal.position=[1.0, 0.5, 0.3]",
    "mission.duration=3.0",
    "airspace.ceiling=0.5",
)
MESH = Mesh.uniform(6, 4)
OPTIONS = SolverOptions(tolerance=1e-9)
# J; the objective of the mission is about 200 J.
SOLVED = 1e-4


@pytest.fixture(scope="module")
def mission():
    return flights.scenario("paper_calm", *SHORT)


@pytest.fixture(scope="module")
def soft(mission):
    return compile(build_remaining(mission))


@pytest.fixture(scope="module")
def hard(mission):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(soft_limits, "soften", lambda *_: None)
        return compile(build_remaining(mission))


def solved(problem, mission, **changed):
    """Solve the whole mission from its start, with some parameters changed."""
    hover = mission.vehicle.hover_speed(mission.gravity)
    at_rest = {state.name: 0.0 for state in problem.compiled.declared.states}
    start = {name: hover if "omega" in name else 0.0 for name in at_rest}
    numbers = parameter_values(mission) | measured_start(start)
    found = problem.solve(
        mesh=MESH,
        parameters=numbers | {name.replace("__", "."): value for name, value in changed.items()},
        horizon=(0.0, 3.0),
        options=OPTIONS,
    )
    assert found.is_converged
    return found


def breaches(found):
    slots = found.problem.compiled.declared.statics
    named = zip(slots, found.trajectory.statics.tolist(), strict=True)
    return {slot.name: size for slot, size in named if slot.component in soft_limits.BREACHES}


@pytest.mark.lengthy
def test_above_the_norm_of_the_multipliers_nothing_is_broken_and_below_it_something_is(
    mission, soft, hard
):
    """The norm is the change of the optimum with the limit: its multipliers' sum over time."""
    most = 0.08  # rad, below the pitch of the free optimum

    def optimum(limit):
        return solved(hard, mission, limits__pitch_max=limit).objective

    step, least = 1e-4, optimum(most)
    norm = (optimum(most - step) - least) / step
    assert norm > 1.0
    above, below = (
        solved(soft, mission, limits__pitch_max=most, soft__price=price)
        for price in (1e4, 0.5 * norm)
    )
    name = "soft.most['limits.pitch_limit']"
    assert above.objective == pytest.approx(least, abs=SOLVED)
    assert breaches(above)[name] < 1e-8
    assert breaches(below)[name] > 1e-3


def test_where_no_flight_keeps_the_limits_the_plan_breaks_them_by_as_little_as_any(mission, soft):
    """A ceiling of 0.2 m and a goal at 0.3 m leave 0.1 m to be broken between them."""
    found = solved(soft, mission, airspace__ceiling=0.2, soft__price=1e5)
    assert sum(breaches(found).values()) == pytest.approx(0.1, rel=1e-5)
