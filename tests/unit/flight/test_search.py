"""Accuracies, and the best usable plan of a search that is stopped."""

import math
from dataclasses import replace
from itertools import count
from types import SimpleNamespace

import pytest

from pyomo_quad import Plan
from pyomo_quad.collocation import Mesh
from pyomo_quad.flight import PlanStatus, search
from pyomo_quad.flight.mission_problem import MissionProblem
from pyomo_quad.flight.planning import Planner
from pyomo_quad.flight.usable import flyable_from, led_inside, stricter_limits, within_airspace
from pyomo_quad.flight.verdict import plan_of, verified
from pyomo_quad.scenario import load_scenario
from pyomo_quad.scenario.accuracy import FIGURES, Accuracy
from tests.command import PAPER_CALM

PROVEN_J = 709.65279


def test_a_mission_asks_for_standard_and_the_papers_for_proof():
    mission = {"goal": {"position": [2.0, 0.0, 1.0]}, "duration": 4.0}
    own = {"name": "hop", "vehicle": {"use": "dji_phantom_2"}, "wind": {"use": "calm"}}
    hop = load_scenario({**own, "mission": mission})
    assert (hop.solver.accuracy, hop.solver.tolerance) == (Accuracy.STANDARD, 1e-4)
    paper = load_scenario(PAPER_CALM)
    assert (paper.solver.accuracy, paper.solver.tolerance) == (Accuracy.PROOF, 1e-6)
    quick = paper.with_values({"solver.accuracy": "quick"})
    assert quick.solver.tolerance == 1e-3


@pytest.mark.parametrize("accuracy", list(Accuracy))
def test_the_energy_is_as_close_to_the_least_as_the_accuracy_says(accuracy):
    plan = Planner().solve(load_scenario(PAPER_CALM, [f"solver.accuracy={accuracy.value}"]))
    figures = FIGURES[accuracy]
    assert plan.status is PlanStatus.VERIFIED
    assert plan.accuracy_reached is accuracy
    assert plan.energy == pytest.approx(PROVEN_J, rel=figures.energy)
    assert plan.verification.terminal_miss_m <= figures.miss
    assert plan.verification.max_violation <= figures.breach


def test_a_search_that_is_stopped_ends_with_its_usable_plan(monkeypatch, tmp_path):
    monkeypatch.setattr(search, "_PATIENCE", 0.0)
    monkeypatch.setattr(search, "_SHARE", math.inf)  # else a flight puts off the next one
    states = []
    # From a coarse mesh, a finer one still has iterations to go when the first plan is usable.
    stopped = Planner().solve(
        load_scenario(PAPER_CALM, ["solver.elements=5"]),
        progress=lambda _: not (states and states[-1].has_usable),
        show=states.append,
    )
    assert stopped.status is PlanStatus.USABLE
    assert stopped.accuracy_reached is not Accuracy.PROOF
    assert "proof was not reached" in stopped.message
    assert abs(stopped.energy - PROVEN_J) <= stopped.energy_uncertainty * PROVEN_J
    assert stopped.verification.terminal_miss_m <= FIGURES[Accuracy.QUICK].miss
    stopped.save(tmp_path / "plan.npz")
    assert Plan.load(tmp_path / "plan.npz").status is PlanStatus.USABLE


def test_what_leads_on_from_a_coarse_mesh_can_be_flown():
    planner, told = Planner(), load_scenario(PAPER_CALM)
    mission = MissionProblem(planner, told)
    coarse = mission.solve(mesh=Mesh.uniform(4, 4), tolerance=None)
    asked = Accuracy.QUICK
    before = verified(plan_of(told, coarse, {}, 0.0), coarse, asked).verification
    *_, last = flyable_from(mission.problem, mission.arguments, coarse, told.airspace)
    after = verified(plan_of(told, last, {}, 0.0), last, asked).verification
    assert before.reached is None
    assert after.reached is asked
    # Flown by SciPy it arrives, and of all flights that do, none spends less than the optimum.
    assert after.terminal_miss_m <= FIGURES[asked].miss
    assert after.flown_energy_J >= PROVEN_J * (1.0 - FIGURES[asked].energy)


def test_a_flight_that_breaks_a_limit_slightly_is_led_inside():
    planner, asked = Planner(), Accuracy.QUICK
    goal = ["mission.goal.position=[4.0, 0.0, 1.0]", "mission.duration=6.0"]
    wide, told = (
        load_scenario(PAPER_CALM, [*goal, f"limits.speed_max={speed}"]) for speed in (1.06, 1.0)
    )
    loose, mission = MissionProblem(planner, wide), MissionProblem(planner, told)
    coarse = loose.solve(mesh=Mesh.uniform(8, 4), tolerance=None)
    *_, near = flyable_from(loose.problem, loose.arguments, coarse, wide.airspace)
    own = mission.problem.instance(mission.arguments["parameters"], mission.arguments["horizon"])
    plan = verified(plan_of(told, replace(near, instance=own), {}, 0.0), near, asked)
    assert plan.verification.worst_constraint.startswith("limits.speed_limit")
    assert plan.verification.max_violation > FIGURES[asked].breach
    changes = stricter_limits(plan)
    # Of a speed up to 1.06 m/s where 1 m/s is allowed, half more than the excess is taken off.
    assert changes["limits.speed_max"] == pytest.approx(-1.5 * 0.06, abs=0.02)
    inside = led_inside(mission.problem, mission.arguments, near, changes)
    after = verified(plan_of(told, replace(inside, instance=own), {}, 0.0), inside, asked)
    assert after.verification.max_violation <= FIGURES[asked].breach
    assert after.verification.is_usable


@pytest.mark.parametrize("seconds_per_look", [1e-6, 1e3])
def test_the_search_for_a_usable_plan_begins_after_work_whatever_the_clock_says(
    monkeypatch, seconds_per_look
):
    clock = count()
    monkeypatch.setattr(search.time, "thread_time", lambda: seconds_per_look * next(clock))

    class Deadline:
        limit_s, is_over = math.inf, False

        def __call__(self, _iteration):
            return True

    begun = []
    looking = search.Search(Deadline())
    coarse = SimpleNamespace(error_estimate=math.inf)
    looking.finished(coarse, 1.0, None, lambda _: begun.append(looking.work) or iter(()))
    for _ in range(200):
        looking(SimpleNamespace(mesh_points=1000))
    patience = search._LONG * search._PATIENCE
    assert len(begun) == 1
    assert patience <= begun[0] <= patience + 1000


@pytest.mark.parametrize(("error", "is_sought"), [(0.1, True), (10.0, False)])
def test_a_usable_plan_is_sought_at_the_end_of_a_mesh_with_a_small_error(error, is_sought):
    class Deadline:
        limit_s, is_over = math.inf, False

        def __call__(self, _iteration):
            return True

    begun = []
    looking = search.Search(Deadline())
    for _ in range(20):
        looking(SimpleNamespace(mesh_points=1000))
    coarse = SimpleNamespace(error_estimate=error)
    looking.finished(coarse, 1.0, None, lambda _: begun.append(looking.work) or iter(()))
    assert begun == ([20_000] if is_sought else [])


def test_a_flyable_trajectory_keeps_a_high_floor_itself():
    """The violation allowed is 0.3 % of the floor, so that a stricter floor makes up for it."""
    heights = {"mission.start_z": 27.1, "mission.goal_z": 24.0}
    within = within_airspace({"airspace.floor": 19.8, "airspace.ceiling": 40.0, **heights})
    assert within["airspace.floor"] * (1.0 - 0.003) == pytest.approx(19.8, abs=1e-3)
    assert within["airspace.ceiling"] * (1.0 + 0.003) == pytest.approx(40.0, abs=1e-3)


def test_a_flyable_trajectory_may_start_and_end_just_above_a_high_floor():
    told = ["airspace.floor=19.8", "mission.start.position=[0, 0, 19.85]"]
    told += ["mission.goal.position=[4, 0, 19.85]", "mission.duration=3.5"]
    scenario = load_scenario(PAPER_CALM, told)
    mission = MissionProblem(Planner(), scenario)
    coarse = mission.solve(mesh=Mesh.uniform(8, 4), tolerance=None)
    *_, last = flyable_from(mission.problem, mission.arguments, coarse, scenario.airspace)
    plan = verified(plan_of(scenario, last, {}, 0.0), last, Accuracy.QUICK)
    assert plan.verification.is_usable
    names = list(plan.dynamics.state_names)
    assert plan.flown.states[:, names.index("rigid_body.z")].min() >= 19.8 - 0.001
