"""Many flights at once are those that SciPy's adaptive integration flies one by one."""

import numpy as np
import pytest

from pyomo_quad.flight.baselines import (
    broken_under_control,
    fly_reference,
    reference_path,
    start_state,
)
from pyomo_quad.flight.baselines import fly as fly_once
from pyomo_quad.flight.controller import AdaptiveController, mixer_matrix
from pyomo_quad.flight.ensemble import NOT_AT_REST, NOT_THERE, Draws, EnsembleSimulation
from pyomo_quad.scenario import Reference
from tests import flights
from tests.command import QUICK

HOP = tuple(option.removeprefix("--set=") for option in QUICK)
# A fixed step of 0.02 s against an adaptive one of error 1e-7: end places, and energy relative.
PLACE_M, ENERGY = 1e-5, 5e-5


def hop(*more):
    return flights.scenario("paper_wind", *HOP, *more), flights.vehicle("paper_wind", *HOP, *more)


def squadron(mission, vehicle, *varied):
    return EnsembleSimulation(mission, vehicle, reference_path(mission, Reference.QUINTIC), varied)


def alone(mission, vehicle):
    return fly_reference(mission, Reference.QUINTIC, dynamics=vehicle).flown


def test_a_flight_in_fixed_steps_is_that_of_the_adaptive_integrator():
    mission, vehicle = hop()
    many, one = squadron(mission, vehicle).fly(Draws(count=2)), alone(mission, vehicle)
    columns = [vehicle.state_names.index(f"rigid_body.{axis}") for axis in "xyz"]
    for column, axis in zip(columns, "xyz", strict=True):
        held = np.interp(many.t, one.t, one.states[:, column])
        # What is between samples of the flight alone is interpolated.
        assert np.abs(many.tracks[f"{axis}_m"] - held[:, None]).max() < 1e-4
        assert many.tracks[f"{axis}_m"][-1] == pytest.approx(one.states[-1, column], abs=PLACE_M)
    assert many.tracks["energy_J"][-1] == pytest.approx(one.energy[-1], rel=ENERGY)
    assert many.endings[0] == many.endings[1]


@pytest.mark.lengthy
def test_a_vehicle_heavier_than_the_controller_knows_flies_as_it_does_alone():
    mission, vehicle = hop()
    masses = np.array([1.25, 1.3, 1.4])
    many = squadron(mission, vehicle, "vehicle.mass").fly(
        Draws(count=3, numbers={"vehicle.mass": masses})
    )
    for k, mass in enumerate(masses):
        heavy = flights.vehicle("paper_wind", *HOP, f"vehicle.mass={mass}")
        one = fly_once(
            dynamics=heavy,
            controller=AdaptiveController(mission, mixer_matrix(heavy)),
            reference=reference_path(mission, Reference.QUINTIC),
            initial_state=start_state(mission, heavy),
            times=np.linspace(0.0, 4.0, 401),
        ).flown
        assert many.tracks["energy_J"][-1, k] == pytest.approx(one.energy[-1], rel=ENERGY)
        height = one.states[-1, heavy.state_names.index("rigid_body.z")]
        assert many.tracks["z_m"][-1, k] == pytest.approx(height, abs=PLACE_M)


@pytest.mark.lengthy
def test_flights_are_judged_as_one_flight_is():
    tight = "limits.battery_current_max=1.0", "limits.speed_max=0.2"
    mission, vehicle = hop(*tight)
    (ending,) = squadron(mission, vehicle).fly(Draws(count=1)).endings
    one = alone(mission, vehicle)
    breaches = vehicle.violations(one.t, one.states, one.controls)
    expected = broken_under_control(mission, vehicle, one, breaches)
    ends = (NOT_THERE, NOT_AT_REST)
    limits = {name: size for name, size in ending.broken.items() if name not in ends}
    assert set(limits) == set(expected) == {"battery current", "speed over ground"}
    # Samples of 25 and of 100 Hz do not see the very same greatest value.
    assert limits == pytest.approx(expected, rel=0.02)


def test_a_flight_started_elsewhere_ends_elsewhere():
    mission, vehicle = hop()
    off = Draws(count=2, start={"rigid_body.x": np.array([0.0, -3.0])})
    near, far = squadron(mission, vehicle).fly(off).endings
    assert NOT_THERE not in near.broken
    assert far.miss_m > near.miss_m
    assert NOT_THERE in far.broken
    assert not far.has_succeeded


def test_a_part_of_the_draws_has_the_numbers_of_its_flights():
    draws = Draws(
        count=5,
        numbers={"a": np.arange(5.0)},
        noise={"b": np.arange(10.0).reshape(2, 5)},
        start={"c": -np.arange(5.0)},
    )
    part = draws.part(slice(3, 9))
    assert (part.count, part.numbers["a"].tolist()) == (2, [3.0, 4.0])
    assert (part.noise["b"].tolist(), part.start["c"].tolist()) == ([[3, 4], [8, 9]], [-3.0, -4.0])
