"""Every declared equation against its second, flat writing, at 40 random states."""

import numpy as np
import pytest
from pyomo.environ import Constraint, units, value
from pyomo.util.check_units import assert_units_consistent, assert_units_equivalent

from pyomo_quad.model import build_model, inspect_model
from tests.agreement import plain_quadrotor as plain
from tests.declared_model import RIGID_BODY, ROTORS, Instant, scenario

# Both writings are the same arithmetic in another order: rounding alone may part them.
AGREEMENT = 1e-12
STATES = 40
PRINTED = {"attitude": "paper"}
RATE_NAMES = [*(f"d{name}_dt" for name in RIGID_BODY), *(f"domega_dt[{j}]" for j in ROTORS)]


def random_states(seed):
    generator = np.random.default_rng(seed)
    scale = [10.0] * 3 + [5.0] * 3 + [1.5] * 2 + [3.0] + [4.0] * 3
    for _ in range(STATES):
        body = generator.uniform(-1.0, 1.0, 12) * scale
        omega = generator.uniform(50.0, 1047.0, 4)
        alpha = generator.uniform(-3000.0, 3000.0, 4)
        yield body, omega, alpha


def largest_difference(instant, drag=None, *, is_exact=False, rotor_air=None):
    worst = 0.0
    for body, omega, alpha in random_states(1):
        instant.set(body, omega, alpha)
        declared = instant.rates()
        expected = plain.rates(body, omega, alpha, plain.wind(instant.t), drag, is_exact, rotor_air)
        found = np.array([declared[name] for name in RATE_NAMES])
        # A rate that nearly cancels is held to the size of its terms, here of the order of g.
        scale = np.maximum(np.abs(expected), plain.GRAVITY)
        worst = max(worst, float(np.max(np.abs(found - expected) / scale)))
    return worst


@pytest.mark.parametrize("time", [0.0, 5.0, 10.0])
def test_state_derivative_as_printed(time):
    instant = Instant.of(time, wind={"use": "paper_table_2"}, vehicle=PRINTED)
    assert largest_difference(instant) < AGREEMENT


@pytest.mark.parametrize("drag", [(0.43, 0.0), (0.25, 0.02)])
@pytest.mark.parametrize("is_exact", [False, True])
def test_state_derivative_with_drag(drag, is_exact):
    instant = Instant.of(
        wind={"use": "paper_table_2", "coupling": "drag"},
        vehicle={"drag_linear": drag[0], "drag_quadratic": drag[1]} | ({} if is_exact else PRINTED),
    )
    assert largest_difference(instant, drag, is_exact=is_exact) < AGREEMENT


@pytest.mark.lengthy
@pytest.mark.parametrize("coupling", [pytest.param("acceleration", marks=pytest.mark.slow), "drag"])
@pytest.mark.parametrize(
    "numbers",
    [
        pytest.param({"rotor_drag_plane": 1.19e-4}, marks=pytest.mark.slow),
        pytest.param({"rotor_drag_axis": 2.32e-4}, marks=pytest.mark.slow),
        pytest.param({"translational_lift": 3.4e-3}, marks=pytest.mark.slow),
        pytest.param({"parasitic_drag": [5e-3, 6e-3, 1e-2]}, marks=pytest.mark.slow),
        {"rotor_drag_plane": 1e-4, "rotor_drag_axis": 2e-4, "parasitic_drag": [0.0, 0.0, 1e-2]},
    ],
)
def test_state_derivative_with_air_in_body_axes(numbers, coupling):
    instant = Instant.of(
        wind={"use": "paper_table_2", "coupling": coupling},
        vehicle={"drag_linear": 0.43} | numbers,
    )
    names = {"rotor_drag_plane": "plane", "rotor_drag_axis": "axis"}
    names |= {"translational_lift": "lift", "parasitic_drag": "parasitic"}
    rotor_air = {names[name]: number for name, number in numbers.items()}
    drag = (0.43, 0.0) if coupling == "drag" else None
    assert largest_difference(instant, drag, is_exact=True, rotor_air=rotor_air) < AGREEMENT


@pytest.mark.lengthy
def test_air_in_body_axes_has_units_and_is_declared_only_where_it_acts():
    numbers = {"rotor_drag_plane": 1e-4, "translational_lift": 1e-3, "parasitic_drag": [0, 0, 1e-2]}
    model = build_model(scenario(vehicle=numbers | {"motor_time_constant": 0.05}))
    assert inspect_model(model).unit_errors == ()
    plain_model = build_model(scenario())
    assert plain_model.find_component("aerodynamics.body_force_x") is None
    assert plain_model.find_component("limits.motor_lag_limit") is None


def test_a_flipped_sign_is_noticed():
    model = build_model(scenario(wind={"use": "paper_table_2"}, vehicle=PRINTED))
    body = model.rigid_body
    body.del_component("roll_balance")

    def flipped(b, t):
        m = b.parent_block()
        airframe_coupling = (m.vehicle.Iy - m.vehicle.Iz) * b.q[t] * b.r[t]
        rotor_drum = m.vehicle.rotor_inertia * b.q[t] * m.rotors.speed_imbalance[t]
        return m.vehicle.Ix * b.dp_dt[t] == airframe_coupling - rotor_drum + m.rotors.roll_moment[t]

    body.roll_balance = Constraint(model.time, rule=flipped)
    assert largest_difference(Instant(model)) > 1e3 * AGREEMENT


@pytest.mark.parametrize(
    ("power", "expected"),
    [
        ({"model": "motor"}, lambda w, a: plain.motor(w, a)[2]),
        ({"model": "shaft"}, lambda w, a: plain.shaft_torque(w, a) * w),
        (
            {"model": "constant_efficiency", "efficiency": 0.6, "regeneration": True},
            lambda w, a: plain.shaft_torque(w, a) * w / 0.6,
        ),
        (
            {"model": "constant_efficiency", "efficiency": 0.6, "smoothing": 0.5},
            lambda w, a: plain.smooth_maximum(plain.shaft_torque(w, a) * w / 0.6, 0.0, 0.5),
        ),
        (
            {
                "model": "efficiency",
                "torque_floor": 0.01,
                "efficiency_floor": 0.07,
                "smoothing": 0.3,
            },
            lambda w, a: plain.efficiency_power(w, a, 0.01, 0.07, 0.3),
        ),
        (
            {"model": "motor_with_friction"},
            lambda w, a: plain.motor(w, a, friction=(0.04, 2e-4))[2],
        ),
    ],
)
def test_power_of_each_rotor(power, expected):
    instant = Instant.of(power=power)
    for body, omega, alpha in random_states(2):
        instant.set(body, omega, alpha)
        found = instant.rotors("power.rotor_power")
        # Where power is floored at zero, a difference of large terms remains.
        size = np.maximum(np.abs(plain.shaft_torque(omega, alpha) * omega), 1.0)
        assert np.all(np.abs(found - expected(omega, alpha)) <= AGREEMENT * 20 * size)
        assert instant.read("power.total") == pytest.approx(found.sum(), rel=AGREEMENT)


def momentum_instant():
    craft = plain.M100
    vehicle = {
        "use": "dji_matrice_100",
        "mass": craft["mass"],
        "rotor_radius": craft["radius"],
        "thrust_coefficient": craft["kb"],
        "induced_power_factor": craft["induced"],
        "profile_power_coefficient": craft["profile"],
        "profile_advance_factor": craft["advance"],
        "climb_power_factor": craft["climb"],
        "descent_power_factor": craft["descent"],
        "electronics_power": craft["electronics"],
        "rotor_inertia": craft["drum"],
        "torque_constant": craft["kt"],
        "motor_resistance": craft["resistance"],
    }
    return Instant.of(
        vehicle=vehicle,
        wind={"use": "paper_table_2", "coupling": "drag"},
        power={"model": "momentum", "air_density": craft["density"]},
    )


def test_momentum_power():
    instant = momentum_instant()
    for body, omega, alpha in random_states(5):
        # Without the smooth floor at zero that only other models have.
        each, total, v_i = plain.momentum_power(
            body, omega, alpha, plain.wind(instant.t), plain.M100
        )
        instant.set(body, omega, alpha)
        instant.model.power.induced_velocity[instant.t].set_value(v_i)
        size = max(1.0, float(np.max(np.abs(each))))
        np.testing.assert_allclose(
            instant.rotors("power.rotor_power"), each, atol=10 * AGREEMENT * size
        )
        assert instant.read("power.total") == pytest.approx(total, abs=10 * AGREEMENT * size)
        balance = instant.model.power.induced_velocity_balance[instant.t]
        assert value(balance.body) == pytest.approx(value(balance.upper), abs=100 * AGREEMENT)


@pytest.mark.lengthy
def test_units_of_momentum_power():
    model = momentum_instant().model
    assert_units_consistent(model)
    t, power = model.time.first(), model.power
    assert_units_equivalent(power.total[t], units.W)
    assert_units_equivalent(power.induced_velocity[t], units.m / units.s)


def test_motor_current_and_voltage():
    instant = Instant.of()
    for body, omega, alpha in random_states(3):
        instant.set(body, omega, alpha)
        current, voltage, _ = plain.motor(omega, alpha)
        np.testing.assert_allclose(instant.rotors("rotors.motor_current"), current, rtol=AGREEMENT)
        np.testing.assert_allclose(
            instant.rotors("rotors.motor_voltage"), voltage, rtol=AGREEMENT, atol=1e-11
        )


@pytest.mark.lengthy
@pytest.mark.parametrize(
    ("use", "cell", "series", "parallel"),
    [
        ("phantom_2_pack", (3.7348, 0.00876, 0.468, 0.6787, 5.2, 0.0173), 3, 1),
        ("paper_cell", (1.24, 2.92e-3, 0.156, 2.35, 1.55, 0.02), 9, 4),
    ],
)
def test_battery(use, cell, series, parallel):
    pack = {"use": use, "cells_series": series, "cells_parallel": parallel}
    instant = Instant.of(battery=pack)
    generator = np.random.default_rng(4)
    for _ in range(STATES):
        charge = generator.uniform(0.0, 0.75) * cell[4] * parallel
        omega = generator.uniform(500.0, 1047.0, 4)
        instant.set(omega=omega, charge=charge)
        expected = plain.battery(
            charge, plain.motor(omega, np.zeros(4))[2].sum(), cell, series, parallel
        )
        names = ("state_of_charge", "open_circuit_voltage", "voltage", "current")
        found = [instant.read(f"battery.{name}") for name in names]
        # Each writing takes the small root of a quadratic: cancellation costs two digits.
        np.testing.assert_allclose(found, expected, rtol=100 * AGREEMENT)
        assert instant.rates()["dcharge_drawn_dt"] == pytest.approx(found[3] / 3600, rel=AGREEMENT)


@pytest.mark.parametrize("unit", ["rad/s", "hz"])
def test_wind(unit):
    instant = Instant.of(wind={"use": "paper_table_2", "frequency_unit": unit, "time_offset": 1.25})
    for time in sorted(instant.model.time):
        at = Instant(instant.model, time)
        found = [at.read("wind.velocity_x"), at.read("wind.velocity_y"), 0.0]
        np.testing.assert_allclose(
            found, plain.wind(time + 1.25, hertz=unit == "hz"), rtol=AGREEMENT
        )
