"""Zones are looked at between the points of the mesh, where the flight is."""

import numpy as np
import pytest

from pyomo_quad.flight.flight import POSITION_STATES
from pyomo_quad.flight.verification import split_at_breaches, verify_controls
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
    assert along[widest + 1] - along[widest] > 10 * MAST["radius"]
    return float(along[widest : widest + 2].mean())


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


def test_the_element_where_a_limit_was_broken_is_split(planned):
    planner, plan = planned
    place = place_between_samples(plan)
    blocked = plan.scenario.with_values({"airspace.keep_out[0].centre": [place, 0.0]})
    held, dynamics = plan.trajectories, planner.dynamics(blocked)
    finer = split_at_breaches(dynamics, plan.flown, held.mesh, held.horizon)
    assert finer == held.mesh
    wider = blocked.with_values({"airspace.keep_out[0].radius": 0.5})
    dynamics = planner.dynamics(wider)
    finer = split_at_breaches(dynamics, plan.flown, held.mesh, held.horizon)
    added = sorted(set(finer.breakpoints) - set(held.mesh.breakpoints))
    (element,) = set(held.mesh.locate(np.array(added)).tolist())
    ends = held.horizon[1] * np.array(held.mesh.breakpoints[element : element + 2])
    along = held.states_at(ends)[:, dynamics.state_names.index(POSITION_STATES[0])]
    assert along[0] < place < along[1]
    assert len(added) == 3
