"""Solves side by side: the solutions, the work and the plans are those of solves in turn."""

from functools import partial

import numpy as np
import pytest

from pyomo_quad import processes
from pyomo_quad.collocation import Mesh, Status
from pyomo_quad.flight import Planner
from pyomo_quad.flight.deadline import Deadline
from pyomo_quad.flight.mission_problem import MissionProblem
from pyomo_quad.flight.parallel_solves import solve_side_by_side
from pyomo_quad.flight.search import Search
from pyomo_quad.scenario import load_scenario
from tests.command import PAPER_CALM

QUICK = ["solver.accuracy='quick'"]


@pytest.fixture(autouse=True)
def three_processes(monkeypatch):
    monkeypatch.setattr(processes, "cores", lambda most, **_: min(3, most))


def searched(progress=None):
    """Return a mission with a search, and solves of it on meshes of four to six elements."""
    told = load_scenario(PAPER_CALM, QUICK)
    mission = MissionProblem(Planner(), told, Search(Deadline(told, progress)))
    meshes = [Mesh.uniform(elements, 4) for elements in (4, 5, 6)]
    return mission, [partial(mission.solve, mesh=mesh) for mesh in meshes]


@pytest.mark.lengthy
def test_solutions_and_work_are_those_of_solves_in_turn():
    mission, solves = searched()
    together = solve_side_by_side(mission, solves)
    alone, again = searched()
    in_turn = [solve() for solve in again]
    assert [s.mesh for s in together] == [s.mesh for s in in_turn]
    for found, expected in zip(together, in_turn, strict=True):
        assert found.status is Status.CONVERGED
        assert found.problem is mission.problem
        assert np.array_equal(found.trajectory.states, expected.trajectory.states)
        assert found.objective == expected.objective
        assert np.array_equal(found.unknowns, expected.unknowns)
    assert mission.search.work == alone.search.work
    assert mission.search.usable is not None
    assert mission.search.usable.is_flyable


def test_a_stopped_search_gives_up_its_copies():
    mission, solves = searched(lambda _now: False)
    statuses = {solution.status for solution in solve_side_by_side(mission, solves)}
    assert statuses == {Status.INTERRUPTED}


@pytest.mark.lengthy
def test_a_solution_from_a_copy_begins_the_next_solve():
    mission, solves = searched()
    *_, last = solve_side_by_side(mission, solves)
    refined = mission.go_on(last)
    assert refined.status is Status.CONVERGED
    assert refined.objective == pytest.approx(last.objective, rel=1e-4)


@pytest.mark.lengthy
def test_the_plan_does_not_depend_on_the_number_of_cores(monkeypatch):
    """On either side of the first mast, the second leaves both sides open."""
    masts = ", ".join(
        f"{{name='mast-{x}', shape='cylinder', centre=[{x}, {y}], radius=0.5, "
        "bottom=-50.0, top=60.0}"
        for x, y in ((1.7, 2.3), (3.3, 2.7))
    )
    told = load_scenario(
        PAPER_CALM,
        ["solver.accuracy='standard'", "airspace.clearance=0.3", f"airspace.keep_out=[{masts}]"],
    )
    plans = []
    for number in (1, 3):
        monkeypatch.setattr(processes, "cores", lambda most, n=number, **_: min(n, most))
        plans.append(Planner().solve(told))
    alone, together = plans
    assert alone.is_verified
    assert len(alone.routes) > 1
    assert together.energy == alone.energy
    assert together.routes == alone.routes
    assert np.array_equal(together.trajectories.states, alone.trajectories.states)
