"""The middle of a long straight flight of free duration has the speed that the polar calls best."""

import numpy as np
import pytest

from pyomo_quad.collocation import Mesh, Status
from pyomo_quad.flight import Planner
from pyomo_quad.polar.polar import find_polar
from tests.declared_model import scenario
from tests.flights import certified

DISTANCE_M = 400.0
HEAD_WIND_M_S, PRICE_W = 5.0, 200.0


def told(wind, price):
    blowing = {"use": "constant", "speed": wind, "direction": np.pi} if wind else {"use": "calm"}
    return scenario(
        vehicle={"use": "dji_matrice_100", "attitude": "paper"},
        battery={"use": "matrice_100_pack"},
        wind=blowing | {"coupling": "drag"},
        power={"model": "momentum", "air_density": 1.186},
        # Level and straight, as steady flight is: else height is bought where it is cheap.
        airspace={"floor": -0.2, "ceiling": 0.2},
        limits={"roll_max": 0.001},
        mission={
            "goal": {"position": [DISTANCE_M, 0.0, 0.0]},
            "duration": "free",
            "price_of_time": price,
        },
    )


@pytest.mark.slow
@pytest.mark.parametrize(("wind", "price"), [(0.0, 0.0), (HEAD_WIND_M_S, 0.0), (0.0, PRICE_W)])
def test_speed_in_the_middle(wind, price):
    mission = told(wind, price)
    planner = Planner()
    problem, _ = planner.problem_for(mission)
    solution = problem.solve(
        mesh=Mesh.uniform(elements=40, degree=4),
        tolerance=None,
        parameters=planner.parameters(mission),
    )
    assert solution.status is Status.CONVERGED
    frame = solution.to_frame()
    times = frame["time"].to_numpy()
    middle = np.abs(times / times[-1] - 0.5) < 0.05
    flown = float(frame["rigid_body.vx"].to_numpy()[middle].mean())
    best = find_polar(mission).own.best_over_ground(wind, np.pi, price)
    assert flown == pytest.approx(best.ground_speed, rel=0.01)


def as_flown(wind=0.0, price=0.0, goal=(1000.0, 0.0, 0.0), **changed):
    free = {"vehicle.attitude": "euler", "limits.roll_max": 0.61, "airspace": {}}
    return told(wind, price).with_values(free | {"mission.goal.position": list(goal)} | changed)


@pytest.mark.slow
@pytest.mark.parametrize(("wind", "price"), [(0.0, 0.0), (HEAD_WIND_M_S, 0.0), (0.0, PRICE_W)])
def test_a_kilometre_is_verified_and_cruises_at_the_best_speed(wind, price):
    mission = as_flown(wind, price)
    plan = Planner().solve(mission)
    assert plan.is_verified
    frame = plan.to_frame(rate_hz=10)
    shares = frame.index.to_numpy() / plan.duration_s
    flown = float(frame["vx_m_per_s"].to_numpy()[np.abs(shares - 0.5) < 0.05].mean())
    best = find_polar(mission).own.best_over_ground(wind, np.pi, price)
    assert flown == pytest.approx(best.ground_speed, rel=0.01)
    # No steady flight is cheaper, and its ends cost little beside it.
    least = best.power / best.ground_speed * 1000.0
    assert least < plan.energy < 1.05 * least
    assert certified(mission).lower_bound_J <= plan.energy


@pytest.mark.slow
@pytest.mark.parametrize(
    "changed",
    [{"goal": (300.0, 0.0, 0.0)}, {"goal": (0.0, 0.0, 30.0)}, {"vehicle.payload": 0.5}],
)
def test_shorter_flights_a_climb_and_a_load_are_verified(changed):
    assert Planner().solve(as_flown(**changed)).is_verified
