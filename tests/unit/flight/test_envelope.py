"""Plans that leave the range that measurements confirm say so, or keep inside when told."""

import numpy as np
import pytest

from pyomo_quad.flight.envelope import departures, departures_of
from pyomo_quad.scenario import ScenarioError
from tests import flights
from tests.command import QUICK

HOP = tuple(option.removeprefix("--set=") for option in QUICK)
RANGE = ("vehicle.validated.airspeed=0.4", "vehicle.validated.climb_speed=0.15")


def speeds(plan):
    held = plan.trajectories
    t = np.linspace(*held.horizon, 4001)
    chosen = [held.state_names.index(f"rigid_body.v{axis}") for axis in "xyz"]
    return t, held.states_at(t)[:, chosen]


@pytest.mark.lengthy
def test_a_plan_says_by_how_much_and_for_how_long_it_leaves_the_range():
    plan = flights.plan("paper_calm", *HOP, *RANGE)
    t, velocity = speeds(plan)
    airspeed = np.linalg.norm(velocity, axis=1)
    seconds = np.mean(airspeed > 0.4) * t[-1]
    said = departures(plan)
    assert said[0] == (
        f"airspeed to {airspeed.max():.3g} m/s, 0.4 m/s confirmed, for {seconds:.2g} s"
    )
    assert said[1].startswith(f"climb to {velocity[:, 2].max():.3g} m/s, 0.15 m/s confirmed")
    assert departures(flights.plan("paper_calm", *HOP)) == ()


@pytest.mark.lengthy
def test_a_plan_that_is_told_keeps_inside_and_costs_more():
    free = flights.plan("paper_calm", *HOP, *RANGE)
    held = flights.plan("paper_calm", *HOP, *RANGE, "limits.within_validated=true")
    _, velocity = speeds(held)
    assert held.is_verified
    assert np.linalg.norm(velocity, axis=1).max() <= 0.4 * (1 + 1e-4)
    assert velocity[:, 2].max() <= 0.15 + 1e-4
    assert held.energy > free.energy
    assert departures(held) == ()


def test_the_wind_counts_for_the_airspeed_alone():
    windy = flights.scenario(
        "delivery", "vehicle.payload=0.6", "wind.speed=10.0", "wind.direction=0.0"
    )
    t = np.linspace(0.0, 10.0, 1001)
    flown = dict.fromkeys(("vx_m_per_s", "vy_m_per_s", "wind_y_m_per_s"), np.zeros(1001))
    flown |= {"time_s": t, "vz_m_per_s": -0.5 * t, "wind_x_m_per_s": np.full(1001, 16.5)}
    payload, airspeed, descent = departures_of(windy, flown)
    assert payload == "payload 0.6 kg, 0.5 kg confirmed"
    assert airspeed == f"airspeed to {np.hypot(16.5, 5.0):.3g} m/s, 16 m/s confirmed, for 10 s"
    assert descent == "descent to 5 m/s, 3.5 m/s confirmed, for 3 s"


def test_a_range_that_is_not_stated_or_is_left_at_take_off_is_refused():
    with pytest.raises(ScenarioError, match=r"limits\.within_validated needs vehicle.validated"):
        flights.scenario("paper_calm", "limits.within_validated=true")
    with pytest.raises(ScenarioError, match=r"vehicle.payload = 0.6 kg; must be at most .* 0.5 kg"):
        flights.scenario("delivery", "limits.within_validated=true", "vehicle.payload=0.6")
