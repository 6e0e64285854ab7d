"""Shifts of a path that lead its simulated flight within limits on tilt, speed and rotor speeds."""

import numpy as np
import pytest

from pyomo_quad.collocation import Mesh
from pyomo_quad.flight import Planner
from pyomo_quad.flight.displacement import limits_along
from pyomo_quad.flight.mission_problem import MissionProblem
from pyomo_quad.flight.plan import trajectories_of
from pyomo_quad.flight.state_shifts import shifted, shifts_within_limits
from pyomo_quad.flight.tracking import Demands, tracked
from pyomo_quad.flight.verification import fly_controls
from pyomo_quad.scenario import load_scenario
from tests.command import PAPER_CALM

SLOW = ["mission.goal.position=[4.0, 0.0, 1.0]", "mission.duration=6.0"]


@pytest.fixture(scope="module")
def coarse():
    """Mission and its solution on four elements."""
    mission = MissionProblem(Planner(), load_scenario(PAPER_CALM, SLOW))
    solution = mission.solve(mesh=Mesh.uniform(4, 4), tolerance=None)
    return mission, trajectories_of(solution)


def flown(dynamics, path):
    return fly_controls(
        dynamics, path.mesh, path.controls, path.states[0], path.horizon, integration=1e-9
    )


def shifts_of(dynamics, samples, tolerated):
    limits = limits_along(dynamics, samples)
    return shifts_within_limits(dynamics.state_names, samples, limits, tolerated)


def largest(samples, names, limit):
    """Return the largest magnitude of the quantity that a limit bounds."""
    states = dict(zip(names, samples.states.T, strict=True))
    if limit == "speed_max":
        return np.sqrt(sum(states[f"rigid_body.v{axis}"] ** 2 for axis in "xyz")).max()
    if limit == "pitch_max":
        return np.abs(states["rigid_body.theta"]).max()
    return max(states[f"rotors.omega[{j}]"].max() for j in (1, 2, 3, 4))


@pytest.mark.lengthy
@pytest.mark.parametrize("limit", ["speed_max", "pitch_max", "rotor_speed_max"])
def test_a_flight_whose_path_is_shifted_exceeds_a_limit_far_less(coarse, limit):
    mission, path = coarse
    plain = flown(mission.problem.dynamics(), tracked(mission.problem.dynamics(), path))
    names = mission.problem.dynamics().state_names
    reached = float(largest(plain, names, limit))
    # A limit that the flight exceeds by a per mille of it; rotor speeds vary by 30 rad/s only.
    allowed = reached - (0.1 if limit == "rotor_speed_max" else 1e-3 * reached)
    told = load_scenario(PAPER_CALM, [*SLOW, f"limits.{limit}={allowed!r}"])
    tight = MissionProblem(Planner(), told)
    dynamics = tight.problem.dynamics(**{k: tight.arguments[k] for k in ("parameters", "horizon")})
    first = tracked(dynamics, path)
    before = flown(dynamics, first)
    shifts = shifts_of(dynamics, before, 1e-5)
    assert shifts
    second = tracked(dynamics, path, Demands(shifts=shifts), first)
    after = flown(dynamics, second)
    excess = [largest(samples, names, limit) - allowed for samples in (before, after)]
    assert excess[1] < 0.4 * excess[0]
    # The flight still arrives.
    columns = [names.index(f"rigid_body.{axis}") for axis in "xyz"]
    assert after.states[-1, columns] == pytest.approx(before.states[-1, columns], abs=5e-3)


def test_a_flight_within_its_limits_needs_no_shift(coarse):
    mission, path = coarse
    dynamics = mission.problem.dynamics()
    assert shifts_of(dynamics, flown(dynamics, tracked(dynamics, path)), 1e-3) == ()
    assert not shifted(dynamics.state_names, np.linspace(0.0, 6.0, 5), ()).any()
