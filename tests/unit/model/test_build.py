"""The model as a whole: parts, numbers, boundary conditions, what forces a rebuild."""

import numpy as np
import pytest
from pyomo.environ import Param, value

from pyomo_quad.model import build_model, inspect_model, parameter_values, structure_key
from tests.declared_model import AIRSPACE, MISSION, ROTORS, Instant, scenario

VARIANTS = [
    {},
    {"power": {"model": "efficiency"}},
    {"power": {"model": "constant_efficiency"}, "wind": {"use": "calm", "coupling": "drag"}},
    {"limits": {"battery_current_max": 30.0, "speed_max": 5.0}},
    {"airspace": AIRSPACE},
    KEPT := {
        "vehicle": {"use": "dji_phantom_2", "attitude": "euler"},
        "mission": MISSION | {"yaw": "kept"},
    },
]


@pytest.mark.parametrize("tables", VARIANTS)
def test_every_number_is_a_mutable_parameter_under_its_full_name(tables):
    told = scenario(**tables)
    model = build_model(told)
    declared = {
        data.name: value(data)
        for data in model.component_data_objects(Param)
        if data.parent_component() is not model.clock
    }
    assert declared == parameter_values(told)


@pytest.mark.parametrize("vehicle", ["dji_phantom_2", "dji_matrice_100"])
def test_magnitudes_of_turning_are_within_a_hundred_of_what_the_limits_allow(vehicle):
    told = scenario(vehicle={"use": vehicle})
    model = build_model(told)
    magnitude = 1.0 / model.scaling_factor[model.rotors.alpha]
    most = told.limits.rotor_acceleration_max
    assert most / 100.0 < magnitude < most
    tilt = 1.0 / model.scaling_factor[model.rigid_body.phi]
    assert told.limits.roll_max / 5.0 < tilt <= told.limits.roll_max
    # A tilt is reached and left within a few tenths of a second.
    assert tilt / 1.0 < 1.0 / model.scaling_factor[model.rigid_body.p] < tilt / 0.05


def test_degrees_of_freedom_are_the_four_controls():
    found = inspect_model(build_model(scenario()))
    assert found.degrees_of_freedom == 4
    assert len(found.states) == 17
    assert found.other_variables == tuple(f"rotors.alpha[{j}]" for j in ROTORS)
    # 16 states at both ends and the charge at the start.
    assert found.boundary_conditions == 33
    assert found.is_unit_consistent


def test_boundary_conditions_hold_at_hover_and_nowhere_else():
    told = scenario(
        mission={
            "start": {"position": [1.0, 2.0, 3.0], "yaw": 0.5},
            "goal": {"position": [6.0, 7.0, 8.0], "yaw": -0.5},
        }
    )
    model = build_model(told)
    start = (1.0, 2.0, 3.0, 0, 0, 0, 0, 0, 0.5, 0, 0, 0)
    goal = (6.0, 7.0, 8.0, 0, 0, 0, 0, 0, -0.5, 0, 0, 0)
    Instant(model, model.time.first()).hover(body=start)
    Instant(model, model.time.last()).hover(body=goal)
    assert largest_boundary_residual(model) < 1e-12
    model.rigid_body.q[model.time.last()].set_value(0.01)
    assert largest_boundary_residual(model) == pytest.approx(0.01)


def test_a_kept_heading_takes_the_place_of_what_the_goal_says_of_it():
    kept, free = scenario(**KEPT), scenario(**KEPT | {"mission": MISSION})
    found = inspect_model(build_model(kept))
    assert found.boundary_conditions == inspect_model(build_model(free)).boundary_conditions - 2
    assert found.is_unit_consistent
    assert structure_key(kept) != structure_key(free)
    model = build_model(kept)
    t = model.time.first()
    model.rigid_body.q[t], model.rigid_body.phi[t] = 0.2, 0.5
    model.rigid_body.r[t] = -0.2 * np.tan(0.5)
    assert value(model.mission.yaw_keeping[t].body) == pytest.approx(0.0, abs=1e-15)
    assert value(model.mission.yaw_keeping[t].lower) == value(model.mission.yaw_keeping[t].upper)


@pytest.mark.parametrize(
    ("power", "mission", "is_kept"),
    [
        ("momentum", {}, True),
        ("motor", {}, False),
        ("motor", {"yaw": "kept"}, True),
        ("momentum", {"yaw": "free"}, False),
        ("momentum", {"goal": {"position": [6.0, 7.0, 8.0], "yaw": 1.0}}, False),
        ("momentum", {"waypoints": [{"position": [3.0, 3.0, 3.0], "yaw": 1.0}]}, False),
    ],
)
def test_which_missions_keep_their_heading(power, mission, is_kept):
    told = scenario(
        vehicle={"use": "dji_matrice_100"}, power={"model": power}, mission=MISSION | mission
    )
    assert told.keeps_yaw is is_kept


def largest_boundary_residual(model):
    names = [
        f"{end}_{what}" for end in ("start", "goal") for what in ("place", "rest", "rotor_speed")
    ]
    balances = [d for name in names for d in model.mission.component(name).values()]
    return max(abs(value(d.body) - value(d.upper)) for d in balances)


def test_a_partly_used_pack_starts_partly_used():
    model = build_model(scenario(battery={"initial_state_of_charge": 60.0}))
    missing = model.battery.initial_charge
    model.battery.charge_drawn[model.time.first()].set_value(0.4 * 5.2)
    assert value(missing.body) == pytest.approx(value(missing.upper))


@pytest.mark.parametrize(
    ("name", "quantity", "allowed"),
    [
        ("roll_limit", "rigid_body.phi", 1.5707963267948966),
        ("rotor_acceleration_limit", "rotors.alpha", 3000.0),
        ("rotor_speed_limit", "rotors.omega", 1047.1975511965977),
    ],
)
def test_single_variable_limits(name, quantity, allowed):
    model = build_model(scenario())
    limit = model.limits.component(name)
    (data, *_) = limit.values()
    assert value(data.upper) == pytest.approx(allowed)
    assert data.body.parent_component().name == quantity


def test_limits_of_eq_10_follow_from_the_rotors():
    told = scenario()
    at = Instant(build_model(told)).set(omega=(1000.0, 1047.0, 900.0, 300.0))
    limits = at.model.limits
    # One rotor at full speed and its opposite at rest give the largest roll or pitch moment.
    assert value(limits.roll_moment_max) == pytest.approx(0.175 * 3.8305e-6 * 1047.19755**2)
    assert value(limits.yaw_moment_max) == pytest.approx(2 * 2.2518e-8 * 1047.19755**2)
    assert value(limits.thrust_max) == pytest.approx(4 * 3.8305e-6 * 1047.19755**2)
    body = value(limits.roll_moment_limit[at.t].body)
    assert body == pytest.approx(0.175 * 3.8305e-6 * (1047.0**2 - 300.0**2))


def test_the_pack_gives_most_at_half_its_voltage():
    told = scenario(limits={"battery_power_share_max": 0.5})
    at = Instant(build_model(told)).set(omega=(900.0,) * 4)
    limit, cell = at.model.limits.battery_power_limit[at.t], told.battery
    full = cell.cells_series * (cell.E0 - cell.K + cell.A)
    greatest = full**2 / (4.0 * cell.cells_series * cell.cell_resistance)
    drawn = value(at.model.power.total[at.t])
    assert value(limit.body) - value(limit.upper) == pytest.approx(drawn - 0.5 * greatest)


# Polarised so strongly that e_0 + c_1 exp(-c_2 q) = k / SoC at a quarter of the charge.
POLARISED = {"K": 0.95, "A": 0.0, "E0": 3.8}


def test_a_pack_without_voltage_gives_no_power_and_no_flight_keeps_its_limit():
    told = scenario(battery=POLARISED)
    at = Instant(build_model(told)).set(omega=(900.0,) * 4, charge=0.9 * told.battery.capacity)
    voltage = at.read("battery.open_circuit_voltage")
    assert voltage == pytest.approx(3 * (3.8 - 0.95 / 0.1))
    assert at.read("battery.greatest_power") < 0.0
    # What it would have to give charges it no more.
    assert at.read("battery.current") > 0.0
    limit = at.model.battery.pack_voltage_limit[at.t]
    assert value(limit.body) - value(limit.lower) == pytest.approx(voltage)
    at.set(charge=0.75 * told.battery.capacity)
    assert value(limit.body) == pytest.approx(0.0, abs=1e-9)


def test_only_a_pack_that_can_lose_its_voltage_has_a_limit_on_it():
    usual, polarised = scenario(), scenario(battery=POLARISED)
    assert build_model(usual).battery.component("pack_voltage_limit") is None
    assert structure_key(usual) != structure_key(polarised)
    for name in ("paper_cell", "phantom_2_pack", "matrice_100_pack"):
        pack = scenario(battery={"use": name})
        empty = Instant(build_model(pack)).set(charge=2.0 * pack.battery.capacity)
        assert empty.read("battery.open_circuit_voltage") > 0.0
        assert build_model(pack).battery.component("pack_voltage_limit") is None
        has_circuit = pack.battery.relaxation is not None
        assert (structure_key(pack) == structure_key(usual)) is not has_circuit


def test_only_structure_forces_a_rebuild():
    told = scenario(airspace=AIRSPACE)
    for path, number in {
        "mission.duration": 12.0,
        "mission.goal.position": [1.0, 1.0, 1.0],
        "vehicle.payload": 0.1,
        "wind.x.mean": 2.0,
        "battery.cells_parallel": 2,
        "airspace.keep_out[0].radius": 0.7,
    }.items():
        assert structure_key(told.with_values({path: number})) == structure_key(told)
    for path, choice in {
        "power.model": "shaft",
        "wind.coupling": "drag",
        "limits.battery_current_max": 20.0,
        "limits.speed_max": 9.0,
        "airspace.keep_out": [],
    }.items():
        assert structure_key(told.with_values({path: choice})) != structure_key(told)


def test_the_optimiser_can_be_told_another_wind():
    told = scenario(wind={"use": "constant", "speed": 2.0, "forecast": {"use": "calm"}})
    truth, forecast = Instant(build_model(told)), Instant(build_model(told.as_forecast()))
    assert truth.read("wind.velocity_x") == pytest.approx(2.0)
    assert forecast.read("wind.velocity_x") == 0.0
