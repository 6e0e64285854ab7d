"""Impossible missions name their cause before any solve, and possible ones are left alone."""

from math import sqrt

import numpy as np
import pytest
from pyomo.environ import Constraint, Var, units

from pyomo_quad.model import build_model
from pyomo_quad.model.screening import Severity, screen_model
from pyomo_quad.study.check import check_mission
from tests.agreement.test_certificate_against_flights import random_mission
from tests.declared_model import scenario
from tests.flights import diagnosed

PLACE = {"goal": {"position": [6.0, 7.0, 8.0]}, "duration": 10.0}

# Each kind of impossible mission: its tables -> the field that its finding names, and why.
IMPOSSIBLE = {
    "too short to climb": (
        {"mission": {"goal": {"position": [0.0, 0.0, 8.0]}, "duration": 0.3}},
        "mission.duration",
        "mission.duration = 0.3 s: to reach the goal and stop needs",
    ),
    "too short to go sideways": (
        {"mission": {"goal": {"position": [40.0, 0.0, 0.0]}, "duration": 3.0}},
        "mission.duration",
        "limits.rotor_speed_max = 1047 rad/s allows 16.8 N; allow more than",
    ),
    "thrust limit": (
        {"mission": PLACE | {"duration": 4.0}, "limits": {"thrust_max": 13.0}},
        "mission.duration",
        "limits.thrust_max = 13 N allows 13 N",
    ),
    "wind stronger than the rotors": (
        {"wind": {"use": "constant", "speed": 9.0}},
        "wind.use",
        "holding against the mean wind needs 17.31 N of thrust",
    ),
    "tilt limit against the wind": (
        {
            "wind": {"use": "constant", "speed": 4.0},
            "limits": {"roll_max": 0.1, "pitch_max": 0.1},
        },
        "limits.pitch_max",
        "the mean thrust of the mission must tilt by 0.387 rad",
    ),
    "tilt limit over the distance": (
        {"limits": {"roll_max": 0.01, "pitch_max": 0.02}},
        "limits.roll_max",
        "N across at full thrust, the mission needs",
    ),
    "slow rotors": (
        {"limits": {"rotor_acceleration_max": 0.1}},
        "limits.rotor_acceleration_max",
        "limits.rotor_acceleration_max = 0.1 rad/s^2: the mission needs",
    ),
    "rotors that cannot slow down to hover": (
        {"limits": {"rotor_speed_min": 950.0}},
        "limits.rotor_speed_min",
        "limits.rotor_speed_min = 950 rad/s; must be at most the 912.3 rad/s of hover",
    ),
    "no rotor speed at all": (
        {"limits": {"rotor_speed_min": 1100.0}},
        "limits.rotor_speed_limit[1,0.0]",
        "no value is allowed",
    ),
    "turning too fast": (
        {"mission": PLACE | {"goal": {"position": [0.0, 0.0, 1.0], "yaw": 3.0}, "duration": 4.0}},
        "mission.goal.yaw",
        "mission.goal.yaw = 3 rad: in 4 s a yaw moment of 0.0494 N m turns by at most 1.39 rad",
    ),
    "charge to keep": (
        {"limits": {"state_of_charge_min": 99.9}},
        "limits.state_of_charge_min",
        "limits.state_of_charge_min = 99.9 percent: the flight takes at least 0.016",
    ),
    "charge to keep above that at the start": (
        {
            "limits": {"state_of_charge_min": 30.0},
            "battery": {"initial_state_of_charge": 20.0},
        },
        "limits.state_of_charge_min",
        "must be at most battery.initial_state_of_charge, 20 percent",
    ),
    "current limit": (
        {"limits": {"battery_current_max": 5.0}},
        "limits.battery_current_max",
        "limits.battery_current_max = 5 A: the mean current of any flight is at least 5.77",
    ),
    "voltage limit": (
        {"limits": {"battery_voltage_min": 12.5}},
        "limits.battery_voltage_min",
        "limits.battery_voltage_min = 12.5 V: under the mean current the pack has at most 12.28 V",
    ),
    "share of the pack's power": (
        {"limits": {"battery_power_share_max": 0.05}},
        "limits.battery_power_share_max",
        "limits.battery_power_share_max = 0.05: the mean power of any flight is at least 0.093",
    ),
    "too few cells in series": (
        {"battery": {"cells_series": 2, "cells_parallel": 2}},
        "battery.cells_series",
        "battery.cells_series = 2: hover needs 9.83 V at the motors, the pack gives",
    ),
}

# What deserves a second look, without being impossible.
DOUBTFUL = {
    "a pack too weak": (
        {"battery": {"use": "paper_cell", "cells_series": 1}},
        "battery.use",
        "hover needs 70.86 W, the pack delivers at most 24.26 W",
    ),
    "a pack without voltage": (
        {"battery": {"K": 3.0, "initial_state_of_charge": 30.0}},
        "battery.use",
        "3 x 1 cells: has no voltage at the start; correct its K, or charge it.",
    ),
    "a pack too small": (
        {"mission": PLACE | {"duration": 20_000.0}},
        "battery.use",
        "the pack holds 5.2 Ah; add cells or shorten the mission",
    ),
    "too few cells in series for motors whose voltage is not counted": (
        {"battery": {"cells_series": 2, "cells_parallel": 2}, "power": {"model": "shaft"}},
        "battery.cells_series",
        "battery.cells_series = 2: hover needs 9.83 V at the motors, the pack gives",
    ),
    "f_r where chattering pays": (
        {"power": {"model": "efficiency"}},
        "power.model",
        "alternating acceleration and braking costs less than a steady speed",
    ),
    "f_r below its floor": (
        {"power": {"model": "efficiency", "efficiency_floor": 0.2}},
        "power.efficiency_floor",
        "power.efficiency_floor = 0.2: above f_r = 0.14",
    ),
    "f_r above the torque of hover": (
        {"power": {"model": "efficiency", "torque_floor": 0.05}},
        "power.torque_floor",
        "above the torque of hover, 0.01874 N m",
    ),
    "f_r with regeneration": (
        {"power": {"model": "efficiency", "regeneration": True}},
        "power.regeneration",
        "braking returns more energy than it absorbs",
    ),
    "a limit never reached": (
        {"limits": {"yaw_moment_max": 1.0}},
        "limits.yaw_moment_max",
        "limits.yaw_moment_max = 1 N m: never reached",
    ),
}


def named(findings, subject):
    return [f for f in findings if f.subject == subject]


@pytest.mark.lengthy
@pytest.mark.parametrize("kind", IMPOSSIBLE)
def test_an_impossible_mission_names_its_cause(kind):
    tables, subject, cause = IMPOSSIBLE[kind]
    findings = diagnosed(scenario(**tables))
    # The impossible come first.
    assert findings[0].severity is Severity.IMPOSSIBLE
    (found,) = named(findings, subject)
    assert found.severity is Severity.IMPOSSIBLE
    assert cause in str(found)
    assert "\n" not in str(found)


@pytest.mark.lengthy
@pytest.mark.parametrize("kind", DOUBTFUL)
def test_a_doubtful_mission_names_its_doubt(kind):
    tables, subject, doubt = DOUBTFUL[kind]
    findings = diagnosed(scenario(**tables))
    (found,) = named(findings, subject)
    assert found.severity is Severity.CAUTION
    assert doubt in str(found)
    assert all(f.severity is Severity.CAUTION for f in findings)


@pytest.mark.parametrize("wind", ["calm", "paper_table_2"])
def test_the_paper_s_missions_are_left_alone(wind):
    assert diagnosed(scenario(wind={"use": wind})) == ()


@pytest.mark.parametrize("coupling", ["acceleration", "drag"])
def test_missions_that_can_be_flown_are_not_called_impossible(coupling):
    # The same missions are planned and verified where the bound on their energy is tested.
    generator = np.random.default_rng([len("motor"), len(coupling)])
    for _ in range(2):
        assert diagnosed(random_mission(generator, "motor", coupling)) == ()


def test_the_duration_asked_for_is_that_of_full_thrust_up_and_down():
    # T^2 = 4 m u D / (u^2 - (mg)^2) for a climb of 8 m at u = 16.80 N.
    full, weight = 4 * 3.8305e-6 * 1047.1975511965977**2, 1.3 * 9.81
    least = sqrt(4 * 1.3 * full * 8.0 / (full**2 - weight**2))
    climb = {"goal": {"position": [0.0, 0.0, 8.0]}, "duration": 0.3}
    (found,) = diagnosed(scenario(mission=climb))
    named = float(str(found).partition("allow more than ")[2].partition(" s")[0])
    assert named == pytest.approx(least, rel=1e-2)
    assert named <= least


def test_the_forecast_is_what_is_judged():
    wind = {"use": "constant", "speed": 9.0, "forecast": {"use": "calm"}}
    assert diagnosed(scenario(wind=wind)) == ()


def test_quadratic_drag_is_not_judged_by_linear_bounds():
    tables = {"wind": {"use": "calm", "coupling": "drag"}, "vehicle": {"drag_quadratic": 0.02}}
    assert diagnosed(scenario(**tables)) == ()


def own_model(_scenario=None):
    """A declared model with every fault that screening looks for."""
    m = build_model(scenario())
    m.pull = Var(m.time, units=units.N)
    m.ceiling = Constraint(m.time, rule=lambda m, t: m.rigid_body.z[t] <= 9.0 * units.m)
    m.low_ceiling = Constraint(m.time, rule=lambda m, t: 2 * m.rigid_body.z[t] <= 12.0 * units.m)
    m.floor = Constraint(m.time, rule=lambda m, t: m.rigid_body.y[t] >= 3.0 * units.m)
    # The same limit with its sign turned round.
    m.roof = Constraint(m.time, rule=lambda m, t: -m.rigid_body.y[t] >= -2.0 * units.m)
    return m


def test_screening_names_what_a_model_of_one_s_own_lacks():
    lines = [str(finding) for finding in check_mission(scenario(), builder=own_model)]
    for expected in (
        "pull: has no scaling_factor",
        "pull: a control without a lower and an upper bound",
        "ceiling[0.0]: is never active, low_ceiling[0.0] is tighter",
        "floor[0.0]: keeps rigid_body.y[0.0] at or above 3, roof[0.0] at or below 2",
        "mission.goal_place[z]: sets rigid_body.z[10.0] to 8, low_ceiling[10.0] allows at most 6",
        "mission.start_place[y]: sets rigid_body.y[0.0] to 0, floor[0.0] allows at least 3",
    ):
        assert any(line.startswith(expected) for line in lines), (expected, lines)


def test_screening_finds_nothing_in_the_declared_model():
    assert screen_model(build_model(scenario())) == ()


@pytest.mark.parametrize(
    ("tables", "doubt"),
    [
        (
            {"wind": {"use": "constant", "direction": 180.0}},
            (
                "wind.direction = 180 rad is 28.6 turns; were degrees meant? "
                "180 degrees are 3.142 rad."
            ),
        ),
        ({"wind": {"use": "constant", "direction": -45}}, "-45 degrees are -0.7854 rad."),
        (
            {"mission": PLACE | {"goal": {"position": [1, 1, 1], "yaw": 90.0}}},
            "mission.goal.yaw = 90",
        ),
        ({"mission": PLACE | {"start": {"position": [0, 0, 0], "yaw": 90.0}}}, "mission.start.yaw"),
    ],
)
def test_angles_in_degrees_draw_a_doubt(tables, doubt):
    (found,) = [f for f in diagnosed(scenario(**tables)) if "degrees" in f.message]
    assert found.severity is Severity.CAUTION
    assert doubt in found.message


def test_angles_within_a_turn_draw_no_doubt():
    tables = {"wind": {"use": "constant", "direction": -6.28}, "limits": {"roll_max": 1.5}}
    assert not [f for f in diagnosed(scenario(**tables)) if "degrees" in f.message]
