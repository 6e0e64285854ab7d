"""Zones are looked at between the points of the mesh, where the flight is."""

from dataclasses import replace

import numpy as np
import pytest

from pyomo_quad.flight.flight import POSITION_STATES
from pyomo_quad.flight.mission_problem import MissionProblem
from pyomo_quad.flight.stricter_limits import mesh_where_broken
from pyomo_quad.flight.verification import verify_controls
from pyomo_quad.scenario.accuracy import FIGURES, Accuracy
from tests.declared_model import scenario
from tests.flights import PLANNER

MAST = {"name": "mast", "shape": "cylinder", "radius": 0.02, "bottom": -50.0, "top": 50.0}
FAR = [-30.0, 0.0]


@pytest.fixture(scope="module")
def planned():
    """A straight flight of 30 m on few elements, with a mast that is nowhere near."""
    told = scenario(
        mission={"goal": {"position": [30.0, 0.0, 0.0]}, "duration": 10.0},
        airspace={"keep_out": [MAST | {"centre": FAR}]},
        solver={"tolerance": 1e-4},
    )
    planner = PLANNER
    return planner, planner.solve(told)


def place_between_samples(plan):
    """Halfway between two samples of the plain flight, in the fastest part."""
    along = plan.flown.states[:, plan.dynamics.state_names.index(POSITION_STATES[0])]
    widest = int(np.argmax(np.diff(along)))
    assert along[widest + 1] - along[widest] > 4 * MAST["radius"]
    return float(along[widest : widest + 2].mean())


def own_instance(planner, told):
    mission = MissionProblem(planner, told.as_forecast())
    arguments = mission.arguments
    return mission.problem.instance(arguments["parameters"], arguments["horizon"])


@pytest.mark.lengthy
def test_a_mast_between_the_samples_of_the_plain_flight_is_hit(planned):
    planner, plan = planned
    assert plan.is_verified
    moved = {"airspace.keep_out[0].centre": [place_between_samples(plan), 0.0]}
    blocked = plan.scenario.with_values(moved)
    held, dynamics = plan.trajectories, planner.dynamics(blocked)
    arguments = dynamics, held.mesh, held.states, held.controls, held.horizon, plan.energy
    plainly, _ = verify_controls(*arguments)
    assert plainly.is_verified
    closely, _ = verify_controls(*arguments, blocked.airspace)
    assert not closely.is_verified
    assert closely.worst_constraint == "airspace.keep_out[mast]"
    assert closely.max_violation == pytest.approx(MAST["radius"], rel=0.3)
    assert closely.broken_limits[0].startswith("keep-out mast by 0.0")


def test_the_mesh_is_finer_only_where_the_path_cuts_a_zone(planned):
    planner, plan = planned
    place = place_between_samples(plan)
    moved = {"airspace.keep_out[0].centre": [place, 0.0], "airspace.keep_out[0].radius": 0.5}
    blocked = plan.scenario.with_values(moved)
    asked, solution = FIGURES[Accuracy.STANDARD], plan.solution
    assert mesh_where_broken(solution, plan, asked) == solution.mesh
    own = replace(solution, instance=own_instance(planner, blocked))
    seen = replace(plan, scenario=blocked, solution=own)
    finer = mesh_where_broken(solution, seen, asked)
    added = np.array(sorted(set(finer.breakpoints) - set(solution.mesh.breakpoints)))
    assert added.size
    along = plan.trajectories.states_at(plan.duration_s * added)
    x = along[:, plan.dynamics.state_names.index(POSITION_STATES[0])]
    # The flight is inside for one diameter; the window extends by as much on either side.
    assert np.all(np.abs(x - place) <= 3.5 * 0.5)
    assert np.abs(x - place).min() <= 2.0 * 0.5
