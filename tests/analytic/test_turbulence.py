"""Turbulence as declared, against the spectra of MIL-F-8785C written anew in feet and knots."""

import numpy as np
import pytest
from pyomo.util.check_units import assert_units_consistent
from scipy.signal import welch

from pyomo_quad.collocation import compile as compile_model
from pyomo_quad.flight.baselines import fly_baseline, fly_reference, start_state
from pyomo_quad.flight.weather import vehicle_flown
from pyomo_quad.model import build_in_turbulence, parameter_values, structure_key
from pyomo_quad.model.turbulence import FILTER_STATES, NOISE, NOISE_STEP, Gusts
from pyomo_quad.scenario.tables import Reference
from tests.declared_model import scenario
from tests.flights import PLANNER

FOOT, KNOT = 0.3048, 0.514444
WIND = {"use": "constant", "speed": 3.0, "direction": 0.4, "coupling": "drag"}
DRAG = {"drag_linear": 0.3}
GUSTS = tuple(f"wind.turbulence.gust_{axis}" for axis in ("along", "across", "upwards"))
KNOTS = {"light": 15.0, "moderate": 30.0, "severe": 45.0}


def in_turbulence(**turbulence):
    return scenario(wind=WIND | {"turbulence": turbulence}, vehicle=DRAG)


def specified(height, intensity):
    """Return deviations [m/s] and lengths [m] of u, v and w."""
    h, w20 = height / FOOT, KNOTS[intensity] * KNOT
    sigma_w = 0.1 * w20
    sigma_u = sigma_w / (0.177 + 0.000823 * h) ** 0.4
    length = h / (0.177 + 0.000823 * h) ** 1.2 * FOOT
    return np.array([sigma_u, sigma_u, sigma_w]), np.array([length, length, height])


def spectrum(omega, speed, deviations, lengths):
    """Return the one-sided spectra of u, v and w over angular frequency, shape (3, n)."""
    scaled = lengths[:, None] * omega / speed
    scale = deviations[:, None] ** 2 * lengths[:, None] / (np.pi * speed)
    shapes = np.array(
        [2 / (1 + scaled[0] ** 2), *((1 + 3 * scaled[1:] ** 2) / (1 + scaled[1:] ** 2) ** 2)]
    )
    return scale * shapes


class Filters:
    """The declared filters of a vehicle in steady motion: x' = A x + B n, gusts = C x."""

    def __init__(self, told, height, velocity):
        problem = compile_model(build_in_turbulence(told))
        self.names = list(problem.dynamics().state_names)
        self.columns = [self.names.index(name) for name in FILTER_STATES]
        still = np.zeros(len(self.names))
        moving = dict(zip(("z", "vx", "vy", "vz"), (height, *velocity), strict=True))
        for name, number in moving.items():
            still[self.names.index(f"rigid_body.{name}")] = number
        quiet = problem.dynamics()
        u = np.zeros(len(quiet.control_names))
        units = np.eye(len(self.names))[self.columns]
        self.A = np.array([quiet.rates(0.0, still + unit, u)[self.columns] for unit in units]).T
        self.B = np.array(
            [
                problem.dynamics(parameters={name: 1.0}).rates(0.0, still, u)[self.columns]
                for name in NOISE
            ]
        ).T
        self.C = np.array(
            [quiet.evaluate(g, np.zeros(5), still + units, np.zeros((5, u.size))) for g in GUSTS]
        )

    def spectra(self, omega):
        found = []
        for frequency in omega:
            response = self.C @ np.linalg.solve(1j * frequency * np.eye(5) - self.A, self.B)
            found.append((np.abs(response) ** 2).sum(axis=1) / np.pi)
        return np.array(found).T


CASES = [
    (6.0, (9.0, 3.0, 0.0), "light"),
    (20.0, (0.0, -12.0, 2.0), "moderate"),
    (90.0, (15.0, 0.0, 0.0), "severe"),
]


@pytest.mark.lengthy
@pytest.mark.parametrize(("height", "velocity", "intensity"), CASES)
def test_filters_have_the_spectra_and_deviations_of_the_specification(height, velocity, intensity):
    filters = Filters(in_turbulence(intensity=intensity), height, velocity)
    wind = np.array([3.0 * np.cos(0.4), 3.0 * np.sin(0.4), 0.0])
    deviations, lengths = specified(height, intensity)
    omega = np.geomspace(1e-3, 1e2, 40)
    expected = spectrum(omega, np.linalg.norm(velocity - wind), deviations, lengths)
    np.testing.assert_allclose(filters.spectra(omega), expected, rtol=2e-3)
    variance = 0.5 * np.eye(5)
    variance[[2, 4], [2, 4]] = variance[[1, 2, 3, 4], [2, 1, 4, 3]] = 0.25
    balance = filters.A @ variance + variance @ filters.A.T + filters.B @ filters.B.T
    assert np.abs(balance).max() < 1e-12
    found = np.sqrt(np.diag(filters.C @ variance @ filters.C.T))
    np.testing.assert_allclose(found, deviations, rtol=2e-3)


@pytest.mark.lengthy
def test_laws_are_held_below_ten_feet_and_above_a_thousand():
    told = in_turbulence(intensity="light")
    for beyond, border in ((-5.0, 10.0 * FOOT), (500.0, 1000.0 * FOOT)):
        outer = Filters(told, beyond, (9.0, 0.0, 0.0)).spectra([0.5])
        deviations, lengths = specified(border, "light")
        wind = np.array([3.0 * np.cos(0.4) - 9.0, 3.0 * np.sin(0.4)])
        inner = spectrum(np.array([0.5]), np.linalg.norm(wind), deviations, lengths)
        np.testing.assert_allclose(outer, inner, rtol=2e-2)


def test_hovering_in_calm_air_gusts_change_at_their_own_rate():
    calm = scenario(wind={"use": "calm", "coupling": "drag", "turbulence": {"intensity": "light"}})
    deviations, lengths = specified(20.0, "light")
    rates = -np.diag(Filters(calm, 20.0, (0.0, 0.0, 0.0)).A)
    np.testing.assert_allclose(rates[0], deviations[0] / lengths[0], rtol=5e-3)


def test_the_noise_is_white_of_unit_intensity_and_the_filters_begin_in_the_long_run():
    noise = Gusts(7).noise(2000.0)
    frequency, density = welch(noise.T, fs=1 / NOISE_STEP, nperseg=256)
    inside = (frequency > 1.0) & (frequency < 24.0)
    np.testing.assert_allclose(density[:, inside].mean(axis=1), 2.0, rtol=0.02)
    np.testing.assert_array_equal(Gusts(7).noise(10.0), noise[:501])
    starts = np.array([list(Gusts([7, k]).start.values()) for k in range(4000)])
    expected = 0.5 * np.eye(5)
    expected[[2, 4], [2, 4]] = expected[[1, 2, 3, 4], [2, 1, 4, 3]] = 0.25
    np.testing.assert_allclose(np.cov(starts.T), expected, atol=0.04)


def flown(told):
    return fly_reference(told, Reference.QUINTIC, dynamics=vehicle_flown(PLANNER, told)).flown


@pytest.mark.lengthy
def test_a_flight_meets_gusts_of_its_seed_and_plans_do_not():
    hop = {"goal": {"position": [1.0, 2.0, 8.0]}, "start": {"position": [0.0, 0.0, 8.0]}}
    calm = scenario(wind=WIND, vehicle=DRAG, mission=hop | {"duration": 3.0})
    told, other = (
        calm.with_values({"wind.turbulence": {"intensity": "moderate", "seed": seed}})
        for seed in (3, 4)
    )
    vehicle = vehicle_flown(PLANNER, told)
    flight = fly_baseline(told, Reference.QUINTIC, dynamics=vehicle)
    assert flight.is_verified
    assert flown(told).energy[-1] == flight.energy_J
    assert len({flown(t).energy[-1] for t in (told, other, calm)}) == 3
    assert structure_key(told) == structure_key(calm)
    assert parameter_values(told) == parameter_values(calm)
    state = dict(zip(vehicle.state_names, start_state(told, vehicle), strict=True))
    assert {name: state[name] for name in FILTER_STATES} == Gusts(3).start


def test_units_of_the_filters_agree():
    assert_units_consistent(build_in_turbulence(in_turbulence(wind_at_6_m=8.0)).wind)
