"""The controller's plant against the optimiser, and against a second, flat writing of it."""

import numpy as np
import pytest

from pyomo_quad.flight.baselines import fly, fly_open_loop
from pyomo_quad.flight.controller import AdaptiveController, mixer_matrix
from pyomo_quad.flight.references import quintic
from pyomo_quad.scenario.tables import Reference
from tests import flights
from tests.unit.flight.flat_dynamics import FlatDynamics, table_2_wind


@pytest.mark.parametrize("name", ["paper_calm", "paper_wind"])
def test_the_plans_controls_cost_in_the_controllers_plant_what_the_optimiser_says(name):
    plan = flights.plan(name)
    flight = fly_open_loop(flights.scenario(name), plan, flights.vehicle(name))
    assert flight.energy_J == pytest.approx(plan.energy, rel=1e-6)
    assert flight.terminal_miss_m < 1e-6
    assert flight.is_verified


@pytest.mark.parametrize(
    ("name", "wind"), [("paper_calm", lambda _t: np.zeros(3)), ("paper_wind", table_2_wind)]
)
def test_a_controlled_flight_costs_the_same_through_a_second_writing_of_the_vehicle(name, wind):
    scenario = flights.scenario(name)
    plain = FlatDynamics(scenario, wind)
    flight = fly(
        dynamics=plain,
        controller=AdaptiveController(scenario, mixer_matrix(plain)),
        reference=quintic(scenario.mission),
        initial_state=plain.start,
        times=np.linspace(0.0, scenario.mission.duration, 11),
    )
    declared = flights.baseline(name, Reference.QUINTIC)
    place = declared.frame[["x_m", "y_m", "z_m"]].to_numpy()[::100]
    assert np.abs(flight.flown.states[:, :3] - place).max() < 1e-6
    assert flight.flown.energy[-1] == pytest.approx(declared.energy_J, rel=1e-6)
