"""The middle of a long straight flight of free duration has the speed that the polar calls best."""

import numpy as np
import pytest

from pyomo_quad.flight import Planner
from pyomo_quad.polar.polar import find_polar
from tests.declared_model import scenario

DISTANCE_M = 1000.0
HEAD_WIND_M_S, PRICE_W = 5.0, 200.0


def told(wind, price):
    blowing = {"use": "constant", "speed": wind, "direction": np.pi} if wind else {"use": "calm"}
    return scenario(
        vehicle={"use": "dji_matrice_100"},
        battery={"use": "matrice_100_pack"},
        wind=blowing | {"coupling": "drag"},
        power={"model": "momentum", "air_density": 1.186},
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
    plan = Planner().solve(mission)
    assert plan.is_verified
    frame = plan.to_frame(rate_hz=10)
    shares = frame["time_s"].to_numpy() / plan.trajectories.horizon[1]
    flown = float(frame["vx_m_per_s"].to_numpy()[np.abs(shares - 0.5) < 0.05].mean())
    best = find_polar(mission).own.best_over_ground(wind, np.pi, price)
    assert flown == pytest.approx(best.ground_speed, rel=0.01)
    np.testing.assert_allclose(frame["psi_rad"], 0.0, atol=1e-9)
    # No way of a steady flight is cheaper, and its ends cost little beside it.
    least = best.power / best.ground_speed * DISTANCE_M
    assert least < plan.energy < 1.03 * least
