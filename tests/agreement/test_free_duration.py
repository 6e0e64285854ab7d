"""Missions that choose their own time, against CasADi by hand and against fixed times."""

import re

import pytest

from pyomo_quad.flight.least_time import shortest_flight
from pyomo_quad.model import build_model
from tests.agreement.missions_by_hand import solve_legs
from tests.declared_model import scenario
from tests.flights import PLANNER

PROOF = {"accuracy": "proof"}
ON_ONE_MESH = PROOF | {"elements": 12, "degree": 4, "max_refinements": 0}
ORIGIN = (0.0, 0.0, 0.0)


def free(goal=(6.0, 7.0, 8.0), *, wind="calm", solver=ON_ONE_MESH, **mission):
    return scenario(
        mission={"goal": {"position": list(goal)}, "duration": "free", **mission},
        vehicle={"attitude": "paper"},
        wind={"use": wind},
        solver=solver,
    )


@pytest.mark.lengthy
@pytest.mark.parametrize(
    ("goal", "wind", "price"),
    [
        ((3.0, -2.0, 1.0), "calm", 40.0),
        pytest.param((6.0, 7.0, 8.0), "paper_table_2", 0.0, marks=pytest.mark.slow),
    ],
)
def test_same_optimum_on_the_same_mesh(goal, wind, price):
    plan = PLANNER.solve(free(goal, wind=wind, price_of_time=price))
    by_hand = solve_legs(
        [ORIGIN, goal],
        elements=12,
        degree=4,
        guess=[3.0],
        price=price,
        has_wind=wind == "paper_table_2",
    )
    assert plan.energy == pytest.approx(by_hand.energy_J, rel=1e-6)
    assert plan.duration_s == pytest.approx(by_hand.duration_s, abs=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize("wind", ["calm", "paper_table_2"])
def test_the_paper_s_mission_agrees_with_a_fine_mesh(wind):
    plan = PLANNER.solve(free(wind=wind, solver=PROOF))
    by_hand = solve_legs(
        [ORIGIN, (6.0, 7.0, 8.0)],
        elements=60,
        degree=5,
        guess=[4.0],
        has_wind=wind == "paper_table_2",
    )
    assert plan.is_verified
    assert plan.energy == pytest.approx(by_hand.energy_J, rel=1e-5)
    assert plan.duration_s == pytest.approx(by_hand.duration_s, abs=1e-3)


@pytest.mark.slow
def test_no_fixed_time_costs_less_than_the_chosen_one():
    told, planner = free((2.0, 1.0, 3.0)), PLANNER
    plan = planner.solve(told)
    times = [factor * plan.duration_s for factor in (0.99, 1.0, 1.02)]
    shorter, same, longer = (planner.solve(told.lasting(time)).energy for time in times)
    assert same == pytest.approx(plan.energy, rel=1e-6)
    assert min(shorter, longer) > plan.energy


@pytest.mark.lengthy
@pytest.mark.parametrize("limits", [{"duration_min": 2.6}, {"duration_max": 2.39}])
def test_a_limit_on_the_time_binds(limits):
    # The best time is 2.41 s.
    plan = PLANNER.solve(free((2.0, 1.0, 3.0), **limits))
    assert plan.duration_s == pytest.approx(next(iter(limits.values())), rel=1e-6)


@pytest.mark.slow
def test_the_least_time_is_that_by_hand():
    told = free(solver={})
    shortest = shortest_flight(build_model(told), told, None, is_exact=True)
    by_hand = solve_legs(
        [ORIGIN, (6.0, 7.0, 8.0)], elements=120, degree=3, guess=[4.0], is_quickest=True
    )
    assert shortest.objective == pytest.approx(by_hand.duration_s, abs=1e-3)


@pytest.mark.slow
def test_who_asks_for_the_least_time_is_told_it_and_flies_nearly_as_fast():
    plan = PLANNER.solve(free(solver={}, aim="time"))
    (least,) = re.findall(r"where the least time is (\S+) s\.", plan.message)
    assert plan.is_verified
    assert plan.attempts[0] == f"shortest flight: {least} s"
    assert float(least) < plan.duration_s <= 1.01 * float(least)
    # Of all that take as long it is the one of least energy.
    fixed = PLANNER.solve(free(solver={}).lasting(plan.duration_s), warm_start=plan)
    assert plan.energy == pytest.approx(fixed.energy, rel=1e-5)
