"""Accuracies, and the best usable plan of a search that is stopped."""

import math
from itertools import count
from types import SimpleNamespace

import pytest

from pyomo_quad import Plan
from pyomo_quad.flight import PlanStatus, search
from pyomo_quad.flight.planning import Planner
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


@pytest.mark.lengthy
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


@pytest.mark.parametrize("seconds_per_look", [1e-6, 1e3])
def test_usable_plans_are_made_after_work_whatever_the_clock_says(monkeypatch, seconds_per_look):
    clock = count()
    monkeypatch.setattr(search.time, "thread_time", lambda: seconds_per_look * next(clock))

    class Deadline:
        limit_s, is_over = math.inf, False

        def __call__(self, _iteration):
            return True

    made = []
    looking = search.Search(Deadline())
    for _ in range(200):
        looking(SimpleNamespace(mesh_points=100))
        if not made:
            told = {"points": 100, "is_skipped": looking.is_early}
            looking.finished(1.0, lambda: made.append(looking.work) or iter(()), **told)
    assert search._PATIENCE <= made[0] <= search._PATIENCE + 100
