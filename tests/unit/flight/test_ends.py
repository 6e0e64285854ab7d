"""Where flights start and should end."""

import numpy as np
import pytest

from pyomo_quad.flight.baselines import start_state, wanted_at_goal
from pyomo_quad.scenario import ScenarioError
from tests import flights


def test_without_a_plan_a_flight_starts_where_the_plan_does():
    dynamics, scenario = flights.vehicle("paper_wind"), flights.scenario("paper_wind")
    planned = start_state(scenario, dynamics, flights.plan("paper_wind"))
    assert start_state(scenario, dynamics) == pytest.approx(planned, abs=1e-6)


def test_the_battery_starts_with_the_charge_of_the_scenario():
    override = "battery.initial_state_of_charge=90.0"
    dynamics = flights.vehicle("paper_calm", override)
    start = start_state(flights.scenario("paper_calm", override), dynamics)
    charge = dict(zip(dynamics.state_names, start, strict=True))["battery.charge_drawn"]
    assert charge == pytest.approx(0.1 * 5.2)


def test_the_goal_is_wanted_level_and_at_rest():
    wanted = wanted_at_goal(flights.scenario("paper_calm"), flights.vehicle("paper_calm"))
    assert [wanted[f"rigid_body.{axis}"] for axis in "xyz"] == [6.0, 7.0, 8.0]
    assert wanted["rotors.omega[3]"] == pytest.approx(np.sqrt(1.3 * 9.81 / (4 * 3.8305e-6)))
    assert len(wanted) == 16
    assert sum(value != 0.0 for value in wanted.values()) == 7


class WithLamp:
    state_names = ("rigid_body.x", "lamp.heat")
    control_names = ()


def test_a_state_of_unknown_start_is_refused():
    with pytest.raises(ScenarioError, match=r"nothing says where state lamp\.heat of the"):
        start_state(flights.scenario("paper_calm"), WithLamp())
