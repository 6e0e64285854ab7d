"""Paths that are pushed out of zones, so that flights of coarse solutions keep out of them."""

import numpy as np
import pytest

from pyomo_quad.collocation import Mesh
from pyomo_quad.flight import Planner
from pyomo_quad.flight.displacement import Push, displaced, limits_along, pushes_out
from pyomo_quad.flight.flight import POSITION_STATES
from pyomo_quad.flight.mission_problem import MissionProblem
from pyomo_quad.flight.verdict import plan_of, verified
from pyomo_quad.scenario import load_scenario
from pyomo_quad.scenario.accuracy import FIGURES, USABLE, Accuracy
from tests.command import PAPER_CALM

MAST = {"centre": (4.0, 0.2), "radius": 0.5, "clearance": 0.3}
ZONE = (
    f"{{name='mast', shape='cylinder', centre={list(MAST['centre'])}, "
    f"radius={MAST['radius']}, bottom=0.0, top=50.0}}"
)
AROUND = [
    "mission.goal.position=[8.0, 0.0, 1.0]",
    "mission.duration=8.0",
    f"airspace.keep_out=[{ZONE}]",
    f"airspace.clearance={MAST['clearance']}",
    "solver.accuracy=quick",
]


@pytest.fixture(scope="module")
def cutting():
    """Solution whose path cuts through the clearance between its points, and its plan."""
    told = load_scenario(PAPER_CALM, AROUND)
    mission = MissionProblem(Planner(), told)
    solution = mission.solve(mesh=Mesh.uniform(5, 4), tolerance=None)
    return told, solution, plan_of(told, solution, {}, 0.0)


def intrusion(flown, names):
    """Depth of a flight inside the clearance of the mast [m], by the distance from its axis."""
    x, y = (flown.states[:, list(names).index(name)] for name in POSITION_STATES[:2])
    away = np.hypot(x - MAST["centre"][0], y - MAST["centre"][1])
    return float(np.max(MAST["radius"] + MAST["clearance"] - away))


def test_a_push_is_complete_in_its_span_and_zero_far_from_it():
    push = Push(first=5.0, last=6.0, vector=np.array([0.3, 0.0, -0.1]))
    times = np.array([0.0, 3.0, 5.0, 5.5, 6.0, 8.0, 20.0])
    expected = np.outer([0.0, 0.0, 1.0, 1.0, 1.0, 0.0, 0.0], push.vector)
    assert push.at(times) == pytest.approx(expected, abs=1e-12)


def test_the_rate_of_a_displacement_integrates_to_it():
    pushes = (
        Push(first=2.0, last=2.2, vector=np.array([0.3, 0.1, 0.0])),
        Push(first=3.0, last=4.0, vector=np.array([0.0, -0.2, 0.5])),
    )
    times = np.linspace(0.0, 7.0, 7001)
    moved, rates = displaced(times, pushes)
    steps = 0.5 * (rates[1:] + rates[:-1]) * np.diff(times)[:, None]
    assert np.cumsum(steps, axis=0) == pytest.approx(moved[1:] - moved[0], abs=1e-6)


def test_no_pushes_leave_a_path_in_its_place():
    moved, rates = displaced(np.linspace(0.0, 1.0, 5), ())
    assert not moved.any()
    assert not rates.any()


@pytest.mark.lengthy
def test_a_coarse_path_through_a_zone_is_flown_outside_of_it(cutting):
    _, solution, plan = cutting
    flown = verified(plan, solution, Accuracy.QUICK, is_rough=True)
    assert intrusion(flown.flown, plan.dynamics.state_names) <= USABLE.intrusion
    assert flown.verification.is_usable
    # The path of the solution itself is well inside the clearance, between its points.
    columns = [list(plan.dynamics.state_names).index(name) for name in POSITION_STATES[:2]]
    path = plan.trajectories.states_at(np.linspace(0.0, 8.0, 2000))[:, columns]
    away = np.hypot(*(path - MAST["centre"]).T)
    assert away.min() < MAST["radius"] + MAST["clearance"] - 10 * USABLE.intrusion
    # What the detour costs is part of the error that the plan states.
    excess = abs(flown.energy - plan.energy) / plan.energy
    assert flown.error_estimate >= min(excess, FIGURES[Accuracy.QUICK].energy)


def test_a_push_leads_away_from_the_zone_by_the_depth_of_the_path(cutting):
    _, solution, plan = cutting
    path = verified(plan, solution, Accuracy.PROOF).flown
    moved = path.states.copy()
    column = list(plan.dynamics.state_names).index("rigid_body.y")
    # Another path crosses the clearance 0.2 m from its edge, on the side of negative y.
    moved[:, column] = MAST["centre"][1] - 0.6
    moved[:, list(plan.dynamics.state_names).index("rigid_body.x")] = np.linspace(
        0.0, 8.0, len(path.t)
    )
    straight = type(path)(t=path.t, states=moved, controls=path.controls, energy=path.energy)
    (push,) = pushes_out(plan.dynamics, straight, limits_along(plan.dynamics, straight))
    assert push.vector[0] == pytest.approx(0.0, abs=0.05)
    assert push.vector[1] == pytest.approx(-1.3 * 0.2 - 0.02, abs=0.03)
    assert push.vector[2] == pytest.approx(0.0, abs=0.05)
