"""Every fault of a file in one message, only what is used is asked for, keys in other units."""

from math import pi

import pytest

from pyomo_quad.cli import main
from pyomo_quad.flight import Planner
from pyomo_quad.scenario import FeasibilityError, ScenarioError, load_scenario
from tests.scenario_files import write_scenario

# What any vehicle needs, and no more.
BARE = """
[fields]
mass = 1.5
arm_length = 0.225
Ix = 0.012
Iy = 0.012
Iz = 0.022
thrust_coefficient = 1.2e-5
drag_torque_coefficient = 2e-7
rotor_inertia = 5e-5
{more}
[limits]
rotor_speed_max = 1000.0
rotor_acceleration_max = 5000.0
"""
TITLE = 'title = "own"\n'


def bare(tmp_path, model, more="", battery='battery = "phantom_2_pack"'):
    text = battery + BARE.format(more=TITLE + more)
    (tmp_path / "own.toml").write_text(text)
    return write_scenario(tmp_path, 'vehicle.use = "own.toml"', f'power.model = "{model}"')


def test_every_fault_is_told_at_once(tmp_path):
    file = write_scenario(
        tmp_path,
        "vehicle.mas = 1.0",
        'battery.use = "lead"',
        'wind.file = "none.csv"',
        "mission.duration = -1.0",
        "limits.roll_max = 3.0",
        "solver.degree = 0",
    )
    with pytest.raises(ScenarioError) as caught:
        load_scenario(file)
    lines = str(caught.value).splitlines()
    assert len(lines) == 6
    assert all(line.startswith(f"{file}: ") for line in lines)
    for told in (
        "unknown key vehicle.mas; did you mean vehicle.mass?",
        "no battery named 'lead'",
        "cannot be read",
        "mission.duration = -1 s; must be > 0.",
        "limits.roll_max = 3 rad",
        "solver.degree = 0",
    ):
        assert sum(told in line for line in lines) == 1


def test_fields_that_contradict_each_other_are_told_at_once(tmp_path):
    file = write_scenario(
        tmp_path,
        "vehicle.mass = 9.0",
        "mission.waypoints = [{ position = [1, 1, 1], release = 0.4 }]",
        "vehicle.payload = 0.1",
    )
    with pytest.raises(ScenarioError, match=r"mission\.waypoints release 0\.4 kg") as caught:
        load_scenario(file)
    assert "hover needs" in str(caught.value).splitlines()[0]
    # A vehicle that cannot fly is a fault of another kind, where it is the only one.
    with pytest.raises(FeasibilityError, match="hover needs"):
        load_scenario(write_scenario(tmp_path, "vehicle.mass = 9.0"))


def test_the_command_prints_a_line_for_each_fault(tmp_path, capsys):
    file = write_scenario(tmp_path, "mission.duration = -1.0", "solver.degree = 0")
    assert main(["check", str(file)]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 2


@pytest.mark.lengthy
@pytest.mark.parametrize(
    ("model", "more"),
    [
        ("shaft", ""),
        ("constant_efficiency", ""),
        ("motor", "kv_rpm_per_V = 920\nmotor_resistance = 0.1"),
        ("momentum", "rotor_radius = 0.127\nkv_rpm_per_V = 920\nmotor_resistance = 0.1"),
    ],
)
def test_a_vehicle_needs_what_its_power_model_uses(tmp_path, model, more):
    scenario = load_scenario(bare(tmp_path, model, more))
    assert scenario.vehicle.efficiency_map is None
    hover = Planner().steady_flight(scenario).hover_power
    shaft = 4 * 2e-7 * (1.5 * 9.81 / (4 * 1.2e-5)) ** 1.5
    if model == "shaft":
        assert hover == pytest.approx(shaft, rel=1e-9)
    assert hover > 0.0


@pytest.mark.parametrize(
    ("model", "missing"),
    [
        ("motor", ("torque_constant", "voltage_constant", "motor_resistance")),
        ("efficiency", ("efficiency_map",)),
        ("momentum", ("rotor_radius", "torque_constant", "motor_resistance")),
    ],
)
def test_a_power_model_names_every_number_that_it_lacks(tmp_path, model, missing):
    with pytest.raises(ScenarioError) as caught:
        load_scenario(bare(tmp_path, model))
    lines = str(caught.value).splitlines()
    assert len(lines) == len(missing)
    for name, line in zip(missing, lines, strict=True):
        assert f"vehicle.{name}, " in line
        assert f"is missing; power.model {model} needs it" in line


def test_keys_with_units(tmp_path):
    file = bare(tmp_path, "motor", "kv_rpm_per_V = 920\nmotor_resistance = 0.1")
    scenario = load_scenario(file, ["limits.roll_max_deg=30", "mission.start.position=[0,0,0]"])
    assert scenario.vehicle.voltage_constant == pytest.approx(920 * 2 * pi / 60)
    assert scenario.vehicle.torque_constant == pytest.approx(60 / (920 * 2 * pi))
    assert scenario.provenance["vehicle.torque_constant"] == "1 / voltage_constant"
    assert scenario.limits.roll_max == pytest.approx(pi / 6)
    assert scenario.provenance["limits.roll_max"] == "--set"
    turned = load_scenario(
        file, ["mission.waypoints=[{ position=[1,1,1], yaw_deg=90 }]", "wind.direction_deg=-180"]
    )
    assert turned.mission.waypoints[0].yaw == pytest.approx(pi / 2)
    assert turned.wind.direction == pytest.approx(-pi)
    again = turned.with_values({"mission.waypoints[0].yaw_deg": 45.0})
    assert again.mission.waypoints[0].yaw == pytest.approx(pi / 4)


@pytest.mark.parametrize(
    ("line", "told"),
    [
        ("limits.roll_max_deg = 100", "limits.roll_max = 1.74533 rad; must be <= 1.5708. It was"),
        ('limits.roll_max_deg = "ten"', 'limits.roll_max_deg = "ten"; must be a number.'),
        ("limits.roll_max_degr = 10", "unknown key limits.roll_max_degr; did you mean limits.roll"),
    ],
)
def test_keys_with_units_are_named_as_written(tmp_path, line, told):
    with pytest.raises(ScenarioError) as caught:
        load_scenario(write_scenario(tmp_path, line))
    (said,) = str(caught.value).splitlines()
    assert told in said


def test_a_field_is_not_given_twice(tmp_path):
    file = write_scenario(tmp_path, "limits.roll_max = 0.5", "limits.roll_max_deg = 30")
    with pytest.raises(ScenarioError, match=r"_deg and limits\.roll_max are the same field"):
        load_scenario(file)


def test_the_pack_is_that_of_the_vehicle(tmp_path):
    assert load_scenario(write_scenario(tmp_path)).battery.use == "phantom_2_pack"
    matrice = write_scenario(tmp_path, 'vehicle.use = "dji_matrice_100"')
    assert load_scenario(matrice).battery.use == "matrice_100_pack"
    own = bare(tmp_path, "shaft", battery='battery = "own_pack.toml"')
    (tmp_path / "own_pack.toml").write_text(
        "[fields]\ntitle = 'own'\ncells_series = 4\ncells_parallel = 1\nE0 = 3.7\nK = 0.01\n"
        "A = 0.4\nB = 0.7\ncapacity = 5\ncell_resistance = 0.004\n"
    )
    assert load_scenario(own).battery.cells_series == 4
    with pytest.raises(ScenarioError, match=r'battery.use is missing; the vehicle "own.toml"'):
        load_scenario(bare(tmp_path, "shaft", battery=""))


def test_every_fault_of_a_vehicle_file_and_of_set_is_told_at_once(tmp_path):
    (tmp_path / "own.toml").write_text(
        'use = 7\nlimits = 3\n[wings]\nspan = 1\n[fields.mass]\nvalue = 1\nsauce = "x"\n'
    )
    with pytest.raises(ScenarioError) as caught:
        load_scenario(write_scenario(tmp_path, 'vehicle.use = "own.toml"'))
    assert len(str(caught.value).splitlines()) == 4
    with pytest.raises(ScenarioError) as caught:
        load_scenario(write_scenario(tmp_path), ["mission.duration", "=3", "gravity=9"])
    assert len(str(caught.value).splitlines()) == 2
