"""Missions with waypoints, against CasADi by hand and against what is known without a computer."""

from itertools import pairwise

import numpy as np
import pytest

from pyomo_quad.flight.baselines import fly_baseline
from pyomo_quad.flight.plan import Plan
from pyomo_quad.model import build_model
from pyomo_quad.model.screening import screen_model
from pyomo_quad.scenario.tables import Reference
from tests.agreement.missions_by_hand import solve_legs
from tests.declared_model import scenario
from tests.flights import PLANNER

ON_ONE_MESH = {"elements": 12, "degree": 4, "max_refinements": 0}
ORIGIN, CORNER, GOAL = (0.0, 0.0, 0.0), (3.0, 4.0, 0.0), (3.0, 4.0, 5.0)


def through(*waypoints, duration=10.0, goal=GOAL, solver=None, payload=0.0, wind="calm"):
    return scenario(
        mission={"goal": {"position": goal}, "waypoints": waypoints, "duration": duration},
        vehicle={"attitude": "paper", "payload": payload},
        wind={"use": wind},
        solver={"accuracy": "proof"} | (solver or {}),
    )


def place(*position, **more):
    return {"position": list(position), **more}


@pytest.mark.lengthy
@pytest.mark.parametrize(
    ("duration", "guess"),
    [(10.0, (5.0, 5.0)), pytest.param("free", (2.0, 2.0), marks=pytest.mark.slow)],
)
def test_a_free_passage_is_that_of_the_same_mesh_by_hand(duration, guess):
    # Both legs are of one length, so that both take half of the mesh.
    plan = PLANNER.solve(through(place(*CORNER), duration=duration, solver=ON_ONE_MESH))
    total = None if duration == "free" else duration
    by_hand = solve_legs([ORIGIN, CORNER, GOAL], elements=6, degree=4, guess=guess, total=total)
    assert plan.energy == pytest.approx(by_hand.energy_J, rel=1e-6)
    assert (*plan.passing_times_s, plan.duration_s) == pytest.approx(
        by_hand.passing_times_s, abs=1e-4
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("duration", "guess", "wind"),
    [(10.0, (4.0, 6.0), "calm"), (9.0, (4.0, 5.0), "paper_table_2"), ("free", (2.0, 2.0), "calm")],
)
def test_a_refined_plan_is_that_of_a_fine_mesh_by_hand(duration, guess, wind):
    goal, corner = (6.0, 7.0, 8.0), (2.0, 4.0, 1.0)
    plan = PLANNER.solve(through(place(*corner), duration=duration, goal=goal, wind=wind))
    by_hand = solve_legs(
        [ORIGIN, corner, goal],
        elements=30,
        degree=5,
        guess=guess,
        total=None if duration == "free" else duration,
        has_wind=wind != "calm",
    )
    assert plan.is_verified
    assert plan.energy == pytest.approx(by_hand.energy_J, rel=1e-5)
    assert plan.passing_times_s[0] == pytest.approx(by_hand.passing_times_s[0], abs=1e-3)


@pytest.mark.lengthy
def test_a_waypoint_that_the_best_flight_passes_anyway_costs_nothing(tmp_path):
    planner = PLANNER
    without = planner.solve(through())
    at = 4.0
    there = without.at(at)[["x_m", "y_m", "z_m"]].tolist()
    plan = planner.solve(through(place(*there)))
    assert plan.is_verified
    assert plan.energy == pytest.approx(without.energy, rel=1e-6)
    assert plan.passing_times_s == pytest.approx([at], abs=1e-2)
    plan.save(tmp_path / "plan.npz")
    assert Plan.load(tmp_path / "plan.npz").passing_times_s == plan.passing_times_s


@pytest.mark.lengthy
def test_a_given_time_a_radius_and_a_speed_are_kept_and_a_baseline_flies_the_same_mission():
    asked = place(2.0, 4.0, 1.0, at=6.0, radius=0.5, speed_max=0.3, yaw=0.2)
    told, planner = through(asked), PLANNER
    plan = planner.solve(told)
    there = plan.at(6.0)
    off = np.linalg.norm(there[["x_m", "y_m", "z_m"]] - np.array(asked["position"], dtype=float))
    speed = np.linalg.norm(there[["vx_m_per_s", "vy_m_per_s", "vz_m_per_s"]].astype(float))
    assert plan.is_verified
    assert plan.passing_times_s == pytest.approx((6.0,), abs=1e-9)
    assert off == pytest.approx(0.5, abs=1e-6)
    assert speed <= 0.3 + 1e-6
    assert there["psi_rad"] == pytest.approx(0.2, abs=1e-9)
    flown = plan.mission_flown
    dynamics = planner.dynamics(flown)
    flight = fly_baseline(flown, Reference.QUINTIC, dynamics=dynamics, plan=plan)
    nearest = flight.frame.iloc[(flight.frame["time_s"] - 6.0).abs().argmin()]
    assert nearest[["x_m", "y_m", "z_m"]].tolist() == pytest.approx([2.0, 4.0, 1.0], abs=0.05)
    # The spline passes in the middle, and faster than the waypoint allows.
    assert len(flight.broken_limits) == 1
    assert flight.broken_limits[0].startswith("mission.waypoints[0].speed_max")


@pytest.mark.slow
def test_a_parcel_is_left_where_the_flight_holds():
    plan = PLANNER.solve(
        through(
            place(2.0, 4.0, 1.0, hold=1.0, release=0.2),
            duration=12.0,
            goal=(0.0, 0.0, 1.0),
            payload=0.2,
        )
    )
    assert plan.is_verified
    arrival = plan.passing_times_s[0]
    inside = plan.to_frame(50.0).query(f"{arrival} <= time_s <= {arrival + 1.0}")
    off = inside[["x_m", "y_m", "z_m"]].to_numpy() - np.array([2.0, 4.0, 1.0])
    assert np.linalg.norm(off, axis=1).max() <= 0.05 + 1e-5
    ends = plan.trajectories.states[[0, -1]]
    speeds = ends[:, [n.startswith("rotors.omega") for n in plan.trajectories.state_names]]
    # Thrust goes with the square of the rotor speed.
    assert speeds[1] ** 2 / speeds[0] ** 2 == pytest.approx(np.full(4, 1.3 / 1.5), rel=1e-9)


@pytest.mark.lengthy
def test_a_mirror_image_mission_has_the_mirror_image_route():
    planner = PLANNER
    sides = (1.0, -1.0)
    plan, image = (
        planner.solve(
            through(place(2.0, 4.0 * side, 1.0), goal=(6.0, 7.0 * side, 8.0), solver=ON_ONE_MESH)
        )
        for side in sides
    )
    assert image.energy == pytest.approx(plan.energy, rel=1e-6)
    assert image.passing_times_s == pytest.approx(plan.passing_times_s, abs=1e-3)
    times = np.linspace(0.0, 10.0, 19)
    columns = [plan.trajectories.state_names.index(f"rigid_body.{axis}") for axis in "xyz"]
    flown, mirrored = (p.trajectories.states_at(times)[:, columns] for p in (plan, image))
    assert mirrored == pytest.approx(flown * [1.0, -1.0, 1.0], abs=1e-3)


@pytest.mark.slow
def test_more_time_allowed_never_costs_more():
    planner = PLANNER
    told = [
        through(place(2.0, 1.0, 1.0), goal=(3.0, 3.0, 2.0)).with_values(
            {"mission.duration": "free", "mission.duration_max": limit}
        )
        for limit in (3.6, 4.0, 5.0)
    ]
    energies = [planner.solve(one).energy for one in told]
    assert all(later <= sooner * (1 + 1e-6) for sooner, later in pairwise(energies))


def test_the_times_of_passages_raise_no_doubts_about_the_model():
    for duration in (10.0, "free"):
        model = build_model(through(place(*CORNER, hold=1.0), duration=duration))
        assert screen_model(model) == ()
