"""Limits in the words and units of whoever wrote the mission."""

import numpy as np
import pytest

from pyomo_quad.collocation import Violation
from pyomo_quad.flight import Planner
from pyomo_quad.flight.flight import broken_limits
from pyomo_quad.flight.limit_words import WORDS, breach_words, limit_words, percent
from pyomo_quad.scenario import scenario_from_mapping

STOP = {"position": [1.0, 1.0, 1.0], "at": 2.0, "hold": 2.0, "speed_max": 3.0}
NEAR = {"position": [1.0, 2.0, 1.0], "at": 5.0, "radius": 0.5, "speed_max": 1.0}
FULL = {
    "name": "limits",
    "mission": {"goal": {"position": [0, 2, 2]}, "duration": 6, "waypoints": [STOP, NEAR]},
    "airspace": {
        "floor": -1.0,
        "ceiling": 9.0,
        "keep_out": [{"name": "church", "shape": "sphere", "centre": [3, 3, 3], "radius": 1.0}],
    },
    "vehicle": {"motor_time_constant": 0.02},
    "limits": {
        "speed_max": 12.0,
        "state_of_charge_min": 10.0,
        "battery_current_max": 90.0,
        "battery_voltage_min": 9.0,
        "battery_power_share_max": 0.9,
    },
}
BLOCKS = ("limits.", "airspace.", "mission.")


@pytest.fixture(scope="module")
def dynamics():
    return Planner().dynamics(scenario_from_mapping(FULL))


@pytest.fixture(scope="module")
def breaches(dynamics):
    """Return every limit at a state that breaks many: far from a hover waypoint, fast, rolled."""
    t = np.array([1.0, 3.0, 6.0])
    states = np.full((len(t), len(dynamics.state_names)), 3.0)
    return dynamics.violations(t, states, np.zeros((len(t), len(dynamics.control_names))))


def test_every_limit_of_the_declared_model_has_words(breaches):
    names = {breach.name.partition("[")[0] for breach in breaches}
    limits = {name for name in names if name.startswith(BLOCKS)}
    assert {"mission.hold_speed", "airspace.keep_out", "limits.motor_lag_limit"} <= limits
    assert limits <= set(WORDS)
    assert not any(character in limit_words(name) for name in limits for character in "_[.")


def test_broken_limits_are_told_in_the_missions_words_and_units(dynamics, breaches):
    said = dict(line.rsplit(" by ", 1) for line in broken_limits(dynamics, breaches, {}, 1e-4))
    # Speed 3 sqrt(3) m/s where 0.1 m/s is hovering; the centre of a ball of 1 m.
    assert said["speed at hover waypoint 1"] == f"{3 * np.sqrt(3.0) - 0.1:.2g} m/s"
    away = np.linalg.norm(np.subtract(3.0, STOP["position"]))
    assert said["distance from hover waypoint 1"] == f"{away - 0.05:.2g} m"
    assert said["keep-out church"] == "1 m"
    assert not any("**" in amount for name, amount in said.items())


def test_limits_of_ones_own_keep_name_and_unit():
    breach = Violation(name="mast[3]", size=0.04, bound=0.04, time=1.0)
    assert breach_words(breach, "m**2") == "mast[3] by 0.04 m**2"


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("rotors.omega[2]", "speed of rotor 2"),
        ("mission.hold_speed[0]", "speed at hover waypoint 1"),
        ("airspace.keep_out['mast-2.a']", "keep-out mast-2.a"),
        ("airspace.keep_out[3]", "keep-out 3"),
    ],
)
def test_rotors_waypoints_and_zones_keep_the_numbers_that_figures_give_them(name, said):
    assert limit_words(name) == said


def test_a_percentage_has_one_digit_and_no_exponent_where_it_is_not_tiny():
    assert [percent(x) for x in (0.31, 0.0266, 1e-3, 2.4e-6)] == [
        "30 %",
        "3 %",
        "0.1 %",
        "0.0002 %",
    ]
