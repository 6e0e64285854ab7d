"""Best speeds against closed forms, power and endurance against the plain second writing."""

import json

import numpy as np
import pandas as pd
import pytest
from scipy.optimize import minimize_scalar

from pyomo_quad.cli import main
from pyomo_quad.cli.endings import ExitCode
from pyomo_quad.collocation import SolveError
from pyomo_quad.polar.polar import SteadyCurve, steady_curve
from tests.agreement import plain_quadrotor as plain
from tests.declared_model import scenario
from tests.flights import PLANNER
from tests.unit.identification.recorded import DRAG

FIXED_W, CUBIC = 200.0, 0.05


@pytest.fixture(scope="module")
def curve():
    """An aeroplane's: P = a + b v^3, whose least energy per metre is at (a / 2 b)^(1/3)."""
    speeds = np.arange(0.0, 30.5, 0.5)
    powers = FIXED_W + CUBIC * speeds**3
    return SteadyCurve(payload_kg=0.0, airspeeds=speeds, powers=powers, endurances=4e5 / powers)


def test_speeds_of_least_power_and_least_energy_per_metre(curve):
    assert curve.speed_of_least_power == pytest.approx(0.0, abs=0.2)
    best = curve.best_over_ground()
    assert best.ground_speed == pytest.approx((FIXED_W / (2 * CUBIC)) ** (1 / 3), rel=1e-4)
    assert best.energy_per_metre == pytest.approx(1.5 * FIXED_W / best.ground_speed, rel=1e-6)
    assert best.range_m == pytest.approx(4e5 / best.energy_per_metre, rel=1e-4)


def test_a_price_of_time_is_paid_like_power(curve):
    best = curve.best_over_ground(price_of_time=150.0)
    expected = ((FIXED_W + 150.0) / (2 * CUBIC)) ** (1 / 3)
    assert best.ground_speed == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize("angle", [0.0, 1.0, np.pi / 2, 2.5, np.pi])
def test_speed_in_wind_is_that_of_a_search_over_airspeed_vectors(curve, angle):
    wind = 6.0
    blowing = wind * np.array([np.cos(angle), np.sin(angle)])

    def energy_per_metre(ground_speed):
        airspeed = np.linalg.norm(np.array([ground_speed, 0.0]) - blowing)
        return (FIXED_W + CUBIC * airspeed**3) / ground_speed

    found = curve.best_over_ground(wind, angle)
    least = minimize_scalar(energy_per_metre, bounds=(1.0, 30.0), method="bounded")
    assert found.ground_speed == pytest.approx(least.x, rel=1e-3)
    assert found.energy_per_metre == pytest.approx(least.fun, rel=1e-5)


@pytest.mark.parametrize("factor", [0.9, 1.5, 3.0])
def test_a_tail_wind_faster_than_the_vehicle_is_flown_in_with_little_power(curve, factor):
    top = curve.airspeeds[-1]
    wind = factor * top

    def energy_per_metre(ground_speed):
        return (FIXED_W + CUBIC * abs(ground_speed - wind) ** 3) / ground_speed

    found = curve.best_over_ground(wind, 0.0)
    bounds = (max(0.1, wind - top), wind + top)
    least = minimize_scalar(energy_per_metre, bounds=bounds, method="bounded")
    assert found.ground_speed == pytest.approx(least.x, rel=1e-3)
    assert found.energy_per_metre == pytest.approx(least.fun, rel=1e-5)


def test_a_cross_wind_faster_than_the_vehicle_lets_it_go_nowhere(curve):
    wind = 1.05 * curve.airspeeds[-1] / np.sin(np.radians(70.0))
    best = curve.best_over_ground(wind, np.radians(70.0))
    assert (best.ground_speed, best.endurance) == (0.0, 0.0)


def test_a_vehicle_that_may_only_hover_has_no_curve():
    told = scenario(
        limits={"pitch_max": 1e-3, "roll_max": 1e-3},
        vehicle={"drag_linear": 0.3},
        wind={"coupling": "drag"},
    )
    with pytest.raises(SolveError, match=r"level flight at 0\.5 m/s is beyond a limit"):
        steady_curve(told, PLANNER.steady_flight(told), 0.8)


def test_a_wind_faster_than_the_vehicle_lets_it_go_nowhere_against(curve):
    stuck = curve.best_over_ground(35.0, np.pi)
    assert (stuck.ground_speed, stuck.range_m) == (0.0, 0.0)
    assert stuck.energy_per_metre == np.inf


CELL = {"E0": 3.3, "K": 0.0222, "A": 1.0466, "B": 0.1174, "capacity": 5.7}
RESISTANCE = 0.0095


@pytest.fixture(scope="module")
def steady():
    return flying()


def flying(**pack):
    """The vehicle of the plain writing in steady flight, on six of its cells."""
    craft = plain.M100
    told = scenario(
        vehicle={
            "use": "dji_matrice_100",
            "thrust_coefficient": craft["kb"],
            "induced_power_factor": craft["induced"],
            "profile_power_coefficient": craft["profile"],
            "climb_power_factor": craft["climb"],
            "descent_power_factor": craft["descent"],
            "drag_linear": DRAG[0],
            "drag_quadratic": DRAG[1],
        },
        battery={"use": "phantom_2_pack", "cells_series": 6, "cell_resistance": RESISTANCE}
        | CELL
        | pack,
        wind={"coupling": "drag"},
        power={"model": "momentum", "air_density": craft["density"]},
    )
    return PLANNER.steady_flight(told)


@pytest.mark.lengthy
@pytest.mark.parametrize("speed", [0.0, 7.0, 15.0])
def test_steady_power_is_that_of_the_plain_writing(steady, speed):
    craft = plain.M100
    drag = DRAG[0] * speed + DRAG[1] * speed * np.sqrt(speed**2 + 1e-6)
    weight = craft["mass"] * plain.GRAVITY
    body = np.zeros(12)
    body[3], body[7] = speed, np.arctan2(drag, weight)
    omega = np.full(4, np.sqrt(np.hypot(weight, drag) / 4 / craft["kb"]))
    expected = plain.momentum_power(body, omega, np.zeros(4), np.zeros(3), craft)[1]
    trim = steady.trim([speed, 0.0, 0.0])
    (found,) = steady.reading(("power.total",), trim)
    assert found == pytest.approx(expected, rel=1e-6)
    np.testing.assert_allclose(steady.rotor_speeds(trim), omega, rtol=1e-6)


def test_endurance_is_the_charge_over_the_current(steady):
    trim = steady.trim()
    (power,) = steady.reading(("power.total",), trim)
    cell, depth = (*CELL.values(), RESISTANCE), 0.7
    drawn = np.linspace(0.0, depth * cell[4], 400)
    current = [plain.battery(charge, power, cell, 6, 1)[3] for charge in drawn]
    expected = 3600.0 * np.trapezoid(1.0 / np.array(current), drawn)
    assert steady.endurance(trim, depth, 60) == pytest.approx(expected, rel=1e-4)


@pytest.mark.lengthy
def test_in_long_flight_the_slow_drop_is_a_resistance_and_a_warm_pack_lasts_longer(steady):
    def endurance(**pack):
        own = flying(**pack)
        return own.endurance(own.trim(), 0.7, 60)

    slow = {"relaxation": {"resistance": 0.004, "time_constant": 8.0}}
    whole = endurance(cell_resistance=RESISTANCE + 0.004)
    # But for the seconds in which the slow drop builds up.
    assert endurance(**slow) == pytest.approx(whole, rel=1e-3)
    warm = {"heat_capacity": 110.0, "activation_energy": 2e4}
    plainly = steady.endurance(steady.trim(), 0.7, 60)
    assert 1.001 * plainly < endurance(thermal=warm) < 1.05 * plainly


MISSION = """
name = "survey"
vehicle = { use = "dji_matrice_100" }
battery = { use = "matrice_100_pack" }
wind = { use = "constant", speed = 5.0, direction = 0.0, coupling = "drag" }
power = { model = "momentum", air_density = 1.186 }
mission = { goal = { position = [100, 0, 0] }, duration = 15 }
"""


@pytest.mark.slow
def test_the_matrice_100_flies_as_its_flights_did(tmp_path):
    file, out = tmp_path / "survey.toml", tmp_path / "out"
    file.write_text(MISSION)
    assert main(["polar", str(file), "--out", str(out)]) == 0
    summary = json.loads((out / "summary.json").read_text())
    assert 461 <= summary["hover_power_W"] <= 490
    assert 7 <= summary["least_power_speed_m_s"] <= 9
    assert 13 <= summary["best_speed_m_s"] <= 15.5
    winds = pd.read_csv(out / "wind.csv").set_index(["wind_m_s", "angle_to_wind_deg"])
    # Against the wind it pays to fly faster through the air, with it slower.
    assert winds.loc[(8.0, 180.0), "airspeed_m_s"] > winds.loc[(0.0, 0.0), "airspeed_m_s"] + 1
    assert winds.loc[(8.0, 0.0), "airspeed_m_s"] < winds.loc[(0.0, 0.0), "airspeed_m_s"] - 1
    reach = pd.read_csv(out / "reach.csv").set_index("course_deg")["reach_m"]
    # Out and back is the same flight as back and out.
    np.testing.assert_allclose(reach.loc[0.0], reach.loc[180.0], rtol=1e-9)
    assert reach.max() < summary["range_m"] / 2
    report = (out / "report.md").read_text()
    assert "**It means:** fly at the first of these speeds for the longest time aloft" in report
    assert len(list((out / "figures").glob("*.svg"))) == 3


def test_a_model_of_ones_own_is_refused(tmp_path, capsys):
    file = tmp_path / "own.toml"
    file.write_text(f'model = "own.py:build"\n{MISSION}')
    assert main(["polar", str(file), "--out", str(tmp_path / "out")]) == ExitCode.BAD_INPUT
    assert "polar reads declared models" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
