"""Flights are compared at one end, under every limit, and on a battery that can feed them."""

from math import nan

import numpy as np
import pytest
from pyomo.environ import Constraint, units

from pyomo_quad import build_model
from pyomo_quad.flight import Planner
from pyomo_quad.flight.baselines import fly_baseline, fly_open_loop
from pyomo_quad.flight.plan import PlanStatus
from pyomo_quad.scenario.tables import Reference
from pyomo_quad.study.comparison import ComparisonColumn as Column
from pyomo_quad.study.comparison import compare_flights, has_arrived
from pyomo_quad.study.run import run_scenario
from tests.declared_model import ROTORS, scenario
from tests.flights import PLANNER, certified

COARSE = {"elements": 16, "degree": 4, "max_refinements": 0}
HOP = {"goal": {"position": [1.0, 0.5, 0.5]}, "duration": 4.0}
PLACE = ("rigid_body.x", "rigid_body.y", "rigid_body.z")


def coarse(**tables):
    return scenario(**({"solver": COARSE, "mission": HOP} | tables))


def final_states(plan):
    held = plan.trajectories
    return dict(zip(held.state_names, held.states[-1], strict=True))


def hop_to(displaced):
    """Return the least energy of the hop with the goal displaced by some metres."""
    goal = [a + b for a, b in zip(HOP["goal"]["position"], displaced, strict=True)]
    return coarse(mission=HOP | {"goal": {"position": goal}})


@pytest.fixture(scope="module")
def planner():
    return PLANNER


@pytest.fixture(scope="module")
def vehicle():
    return PLANNER.dynamics(coarse(limits={"battery_current_max": 50.0}))


@pytest.fixture(scope="module")
def plan(planner):
    return planner.solve(coarse())


@pytest.mark.lengthy
def test_the_price_of_a_place_is_what_flying_there_costs_less(planner, plan):
    step = (0.02, -0.01, 0.03)
    beyond, before = (
        planner.solve(hop_to([sign * s for s in step])).energy for sign in (1.0, -1.0)
    )
    final = final_states(plan)
    moved = final | {name: final[name] + s for name, s in zip(PLACE, step, strict=True)}
    assert plan.owed_energy(final) == 0.0
    assert plan.owed_energy(moved) == pytest.approx((before - beyond) / 2, rel=1e-3)


def ending_with(sink, spin):
    """Build the model with an end that sinks [m/s] on rotors that turn too fast [rad/s]."""

    def build(told):
        model = build_model(told)
        end, mission = model.time.last(), model.mission
        speed, rotation = units.m / units.s, units.rad / units.s
        omega, body = model.rotors.omega, model.rigid_body
        at_rest = [name for name in mission.goal_rest if name != "vz"]
        mission.del_component("goal_rest")
        mission.del_component("goal_rotor_speed")
        model.end_rest = Constraint(at_rest, rule=lambda _m, s: body.component(s)[end] == 0)
        model.end_sink = Constraint(expr=body.vz[end] == -sink * speed)
        model.end_spin = Constraint(
            ROTORS, rule=lambda _m, j: omega[j, end] == mission.hover_speed + spin * rotation
        )
        return model

    return build


@pytest.mark.lengthy
def test_the_price_of_motion_and_of_spinning_rotors_is_what_they_cost(plan):
    sink, spin = 0.02, 1.5
    sinking, rising = (
        Planner(ending_with(sign * sink, sign * spin)).solve(coarse()).energy
        for sign in (1.0, -1.0)
    )
    final = final_states(plan)
    moved = final | {"rigid_body.vz": -sink}
    moved |= {f"rotors.omega[{j}]": final[f"rotors.omega[{j}]"] + spin for j in ROTORS}
    assert plan.owed_energy(moved) == pytest.approx((rising - sinking) / 2, rel=1e-3)


@pytest.mark.lengthy
def test_the_tangent_does_not_undercharge(plan):
    # The least energy is convex in the end: what it owes at a distance is at most its price.
    final = final_states(plan)
    far = plan.owed_energy(final | {"rigid_body.vz": -0.2})
    assert plan.energy - Planner(ending_with(0.2, 0.0)).solve(coarse()).energy <= far


@pytest.mark.lengthy
def test_no_flight_that_arrives_lies_below_the_optimum_or_the_bound():
    # On the mission of the paper the plan under feedback spends less than the bound allows.
    mission = {"goal": {"position": [6.0, 7.0, 8.0]}, "duration": 10.0}
    told = coarse(
        power={"model": "constant_efficiency"}, mission=mission, solver=COARSE | {"elements": 20}
    )
    planner = PLANNER
    plan, dynamics = planner.solve(told), planner.dynamics(told)
    flights = [
        fly_baseline(told, reference, dynamics=dynamics, plan=plan)
        for reference in (Reference.PLAN, Reference.QUINTIC)
    ]
    bound = certified(told)
    table = compare_flights(told, flights, bound, plan.hover_energy_J)
    assert flights[0].energy_J < bound.lower_bound_J
    assert table[Column.ARRIVED].all()
    summed = table[Column.ENERGY] + table[Column.OWED_ENERGY]
    assert (summed >= plan.energy).all()
    assert (table[Column.OPTIMALITY_GAP] >= 0.0).all()
    assert (table[Column.EXCESS_ENERGY] > 0.0).all()


@pytest.mark.lengthy
def test_a_flight_without_a_plan_for_its_wind_has_no_price(planner):
    told = coarse(wind={"use": "constant", "speed": 1.0, "forecast": {"use": "calm"}})
    plan, dynamics = planner.solve(told), planner.dynamics(told)
    assert fly_open_loop(told, plan, dynamics).owed_energy_J != 0.0
    untold = fly_baseline(told, Reference.QUINTIC, dynamics=dynamics, plan=plan)
    alone = fly_baseline(coarse(), Reference.QUINTIC, dynamics=planner.dynamics(coarse()))
    assert [untold.owed_energy_J, alone.owed_energy_J] == pytest.approx([nan, nan], nan_ok=True)


@pytest.mark.slow
def test_flights_in_a_wind_that_the_plan_was_not_told_are_priced_by_who_was():
    blowing = {"use": "constant", "speed": 1.0}
    one = (Reference.QUINTIC,)
    untold = run_scenario(coarse(wind=blowing | {"forecast": {"use": "calm"}}), baselines=one)
    told = run_scenario(coarse(wind=blowing), baselines=one)
    # The controller is told no wind at all: it flies the same in both.
    sums = [
        run.comparison.set_index(Column.FLIGHT)
        .loc["adaptive/quintic", [Column.ENERGY, Column.OWED_ENERGY, Column.OPTIMALITY_GAP]]
        .to_list()
        for run in (untold, told)
    ]
    assert sums[0][0] == pytest.approx(sums[1][0], rel=1e-6)
    # The optima that price it began at different points: their costates agree to Ipopt's tolerance.
    assert sums[0][1:] == pytest.approx(sums[1][1:], rel=1e-3)
    assert sums[0][1] != 0.0


def with_a_mast(told):
    """Forbid a column half way: what a smooth straight path flies through."""
    model = build_model(told)
    body = model.rigid_body

    def clear(_m, t):
        x, y = body.x[t] - 0.5 * units.m, body.y[t] - 0.25 * units.m
        return x**2 + y**2 >= (0.2 * units.m) ** 2

    model.mast = Constraint(model.time, rule=clear)
    return model


@pytest.mark.lengthy
def test_a_limit_of_ones_own_that_a_flight_breaks_is_named_with_its_breach():
    told = coarse()
    dynamics = Planner(with_a_mast).dynamics(told)
    flight = fly_baseline(told, Reference.QUINTIC, dynamics=dynamics)
    assert has_arrived(flight)
    (broken,) = flight.broken_limits
    # Through the middle: the square of the distance lacks all of 0.04 m^2.
    assert broken == "mast by 0.04 m**2"
    kept = fly_baseline(told, Reference.QUINTIC, dynamics=PLANNER.dynamics(told))
    assert kept.broken_limits == ()


@pytest.mark.parametrize(
    ("name", "unit"),
    [
        ("limits.thrust_limit", "N"),
        ("limits.roll_moment_limit", "N*m"),
        ("limits.battery_current_limit", "A"),
        ("limits.rotor_speed_limit[1]", "rad/s"),
        ("limits.roll_limit", "rad"),
        ("rigid_body.x_momentum_balance", "N"),
        ("rigid_body.yaw_balance", "N*m"),
        ("rotors.alpha[2]", "rad/s**2"),
        ("battery.charge_drawn", "A*h"),
    ],
)
def test_units_are_those_an_engineer_writes(vehicle, name, unit):
    assert vehicle.unit(name) == unit


@pytest.mark.lengthy
@pytest.mark.parametrize(("cells_series", "is_fed"), [(3, False), (8, True)])
def test_no_flight_on_a_pack_that_cannot_feed_it_is_verified(cells_series, is_fed):
    # The published friction asks for 1.3 kW; the pack of three cells gives some 750 W.
    told = coarse(power={"model": "motor_with_friction"}, battery={"cells_series": cells_series})
    planner = PLANNER
    plan, dynamics = planner.solve(told), planner.dynamics(told)
    assert plan.verification.terminal_miss_m < 0.05
    assert plan.verification.is_fed == is_fed
    flight = fly_baseline(told, Reference.QUINTIC, dynamics=dynamics, plan=plan)
    assert flight.is_verified == is_fed
    if not is_fed:
        lacking = 1 - flight.frame.eval("battery_voltage_V * battery_current_A / power_W").min()
        assert plan.verification.battery_imbalance == pytest.approx(lacking, rel=0.2)
        assert not plan.is_verified
        assert plan.message.startswith("battery: the pack lacks ")


@pytest.mark.lengthy
@pytest.mark.parametrize(("cells_series", "is_fed"), [(1, False), (2, False), (3, True)])
def test_no_flight_on_a_pack_that_cannot_turn_the_motors_is_verified(cells_series, is_fed):
    # A motor that holds the hover speed needs omega / kv + R kappa omega^2 / kt = 9.83 V.
    told = coarse(battery={"cells_series": cells_series})
    plan = PLANNER.solve(told)
    vehicle, speed = told.vehicle, told.vehicle.hover_speed(told.gravity)
    current = vehicle.drag_torque_coefficient * speed**2 / vehicle.torque_constant
    needed = speed / vehicle.voltage_constant + vehicle.motor_resistance * current
    power, resistance = 4 * needed * current, cells_series * told.battery.cell_resistance
    full = cells_series * (told.battery.E0 - told.battery.K + told.battery.A)
    given = full / 2 + np.sqrt(full**2 / 4 - resistance * power)
    lacking = plan.verification.voltage_lacking
    # The flight begins and ends in hover, and in between its rotors are hardly faster.
    assert 1 - given / needed - 1e-3 < lacking < 1 - given / needed + 0.05
    assert (lacking > 0.0) != is_fed
    assert plan.verification.battery_imbalance < 1e-3
    assert plan.verification.is_fed == is_fed
    flight = fly_baseline(told, Reference.QUINTIC, dynamics=PLANNER.dynamics(told), plan=plan)
    assert flight.is_verified == is_fed
    if not is_fed:
        assert not plan.is_verified
        assert plan.message.startswith("battery: the pack lacks ")
        assert "of the voltage that the motors need to keep their speed" in plan.message


def test_motors_whose_voltage_no_equation_counts_need_none():
    told = coarse(battery={"cells_series": 2}, power={"model": "shaft"})
    assert PLANNER.solve(told).verification.voltage_lacking == 0.0


@pytest.mark.slow
def test_a_flight_that_would_drain_a_pack_of_its_voltage_is_infeasible():
    # At a third of its charge three volts of polarisation leave each cell less than nothing.
    told = coarse(battery={"K": 3.0, "initial_state_of_charge": 33.0})
    plan = PLANNER.solve(told)
    assert plan.status is PlanStatus.INFEASIBLE
    assert any("battery" in cause for cause in plan.failure.causes())


@pytest.mark.slow
def test_a_plan_that_its_pack_cannot_feed_is_held_to_what_the_pack_gives():
    """A quick hop peaks at twice its mean power, just above the most that the pack gives."""
    quick = {"mission": HOP | {"duration": 2.0}}
    at_will = PLANNER.solve(scenario(**quick))
    # Six cells, so that the motors can turn at little more than half of the pack's voltage.
    told = scenario(**quick, battery={"cells_series": 6, "cell_resistance": 0.181})
    plan, cell = PLANNER.solve(told), told.battery
    assert plan.is_verified
    assert plan.scenario == told
    assert plan.attempts[-1].startswith("power limited to 94 % of the pack's greatest")
    power, left = plan.dynamics.table(
        (("power.total", None), ("battery.state_of_charge", None)),
        plan.flown.t,
        plan.flown.states,
        plan.flown.controls,
    ).T
    # The most is given at half the open-circuit voltage, eq. (5).
    drawn = (1.0 - left / 100.0) * cell.capacity
    zone = cell.A * np.exp(-cell.B * drawn)
    voltage = cell.cells_series * (cell.E0 - cell.K * 100.0 / left + zone)
    share = power / (voltage**2 / (4.0 * cell.cells_series * cell.cell_resistance))
    assert share.max() == pytest.approx(0.94, abs=1e-4)
    assert 0.0 < plan.energy - at_will.energy < 1e-3 * plan.energy


def test_a_flight_beyond_empty_is_not_fed():
    told = coarse(battery={"initial_state_of_charge": 0.01})
    plan = PLANNER.solve(told)
    assert not plan.is_verified
    assert plan.verification.battery_imbalance > 0.0
