"""Battery, motor, wind and hover of the declared model against arithmetic done by hand."""

from math import cos, exp, pi, sin, sqrt

import pytest
from pyomo.dae import ContinuousSet
from pyomo.environ import Block, ConcreteModel, Expression, Param, Suffix, units

from pyomo_quad.flight.steady import battery_shortfalls
from pyomo_quad.model import build_model
from pyomo_quad.model.battery import declare_battery
from tests.declared_model import Instant, scenario, steady

ROUNDING = 1e-12


class Bench:
    """A pack alone on a load of any power."""

    def __init__(self, **battery):
        m = self.model = ConcreteModel()
        m.time = ContinuousSet(initialize=(0.0, 1.0, 2.0))
        m.scaling_factor = Suffix()
        m.demand = Param(initialize=0.0, mutable=True, units=units.W)
        m.power = Block()
        m.power.total = Expression(m.time, rule=lambda b, _t: b.parent_block().demand)
        declare_battery(m, scenario(battery=battery))

    def under(self, demand, charge):
        self.model.demand.set_value(demand)
        self.model.battery.charge_drawn[1.0].set_value(charge)
        return Instant(self.model)


def test_constant_current_discharge():
    # Phantom 2 pack, 3 x 1 cells, 10 A: charge grows by 10 A h per hour, whatever the voltage.
    bench, current, resistance = Bench(use="phantom_2_pack"), 10.0, 3 * 0.0173
    for minutes in (0.0, 6.0, 12.0, 24.0):
        charge = current * minutes / 60
        cell = 3.7348 - 0.00876 * 5.2 / (5.2 - charge) + 0.468 * exp(-0.6787 * charge)
        voltage = 3 * cell - resistance * current
        at = bench.under(voltage * current, charge)
        assert at.read("battery.current") == pytest.approx(current, rel=1e-12)
        assert at.read("battery.voltage") == pytest.approx(voltage, rel=1e-12)
        assert at.read("battery.state_of_charge") == pytest.approx(100 - 100 * charge / 5.2)
        assert at.rates()["dcharge_drawn_dt"] == pytest.approx(10.0 / 3600, rel=1e-12)


def test_cells_share_voltage_and_current():
    one = Bench(use="phantom_2_pack", cells_series=1, cells_parallel=1)
    six = Bench(use="phantom_2_pack", cells_series=3, cells_parallel=2)
    single = one.under(20.0, 1.0)
    pack = six.under(6 * 20.0, 2.0)
    assert pack.read("battery.voltage") == pytest.approx(3 * single.read("battery.voltage"))
    assert pack.read("battery.current") == pytest.approx(2 * single.read("battery.current"))


def test_an_overloaded_or_empty_pack_stays_finite_and_says_so():
    bench = Bench(use="paper_cell", cells_series=1)
    # One cell: U = 1.24 - 0.00292 + 0.156 = 1.39308 V, R = 0.02 ohm, at most U^2/4R = 24.258 W.
    at = bench.under(70.0, 0.0)
    assert at.read("battery.power_reserve") == pytest.approx(1.39308**2 / 0.08 - 70.0)
    assert 0.0 < at.read("battery.voltage") < 1.39308
    at = bench.under(5.0, 2.0)
    assert at.read("battery.state_of_charge") < 0.0
    assert 0.0 < at.read("battery.voltage") < 1.24


def test_steady_motor():
    # At rest in speed: kt i = kappa omega^2 and v = R i + omega / kv.
    at = Instant.of().set(omega=(700.0,) * 4)
    current = 2.2518e-8 * 490_000 / 0.0104
    assert at.read("rotors.motor_current", 1) == pytest.approx(current, rel=ROUNDING)
    assert at.read("rotors.motor_voltage", 1) == pytest.approx(0.2 * current + 700 / 96.342)
    assert at.rates()["domega_dt[1]"] == 0.0


def wind_at(time, **wind):
    mission = {"goal": {"position": [6.0, 7.0, 8.0]}, "duration": 2 * time}
    return Instant.of(wind=wind, mission=mission)


@pytest.mark.parametrize("time", [0.4, 1.0, 2.5, 7.3])
def test_harmonic_wind(time):
    silent = {"gust_amplitude": 0.0}
    at = wind_at(time, use="paper_table_2", x=silent, y=silent)
    x = 1.0 + 0.1 * sin(0.5 * time) + 0.25 * sin(0.7 * time) + 0.3 * sin(1.0 * time)
    y = 0.5 - 0.05 * sin(0.6 * time) - 0.1 * sin(1.0 * time) - 0.3 * sin(1.5 * time)
    assert at.read("wind.velocity_x") == pytest.approx(x, rel=ROUNDING)
    assert at.read("wind.velocity_y") == pytest.approx(y, rel=ROUNDING)


def test_gust_peaks_at_a_quarter_of_its_period():
    # sin(2 pi 2.5 / 10) = 1, so the gust is 2 * 0.2 / (1 + exp(0)) = 0.2 m/s, and less beside.
    assert wind_at(2.5, use="paper_table_2").read("wind.x.gust") == pytest.approx(0.2, rel=1e-12)
    beside = 2 * 0.2 / (1 + exp(-4 * (sin(2 * pi * 2.0 / 10) - 1)))
    assert wind_at(2.0, use="paper_table_2").read("wind.x.gust") == pytest.approx(beside)
    assert beside < 0.2


def test_steady_wind_blows_where_it_is_told():
    at = Instant.of(wind={"use": "constant", "speed": 3.0, "direction": 2.0})
    assert at.read("wind.velocity_x") == pytest.approx(3.0 * cos(2.0))
    assert at.read("wind.velocity_y") == pytest.approx(3.0 * sin(2.0))


def test_a_measured_wind_is_a_cubic_spline_in_wind_time(tmp_path):
    # A spline through samples of one cubic is that cubic.
    def cubic(time):
        return 0.5 + 0.3 * time - 0.06 * time**2 + 0.002 * time**3

    rows = "\n".join(f"{t},{cubic(t)},{-2 * cubic(t)}" for t in range(14))
    (tmp_path / "wind.csv").write_text(f"time_s,wind_x_m_per_s,wind_y_m_per_s\n{rows}\n")
    wind = {"use": "calm", "file": str(tmp_path / "wind.csv"), "time_offset": 1.25}
    model = build_model(scenario(wind=wind))
    at = Instant(model)
    assert at.read("wind.velocity_x") == pytest.approx(cubic(5.0 + 1.25), rel=1e-9)
    assert at.read("wind.velocity_y") == pytest.approx(-2 * cubic(5.0 + 1.25), rel=1e-9)


@pytest.mark.lengthy
@pytest.mark.parametrize(
    ("model", "watts", "tolerance"),
    [
        # tau = kappa m g / 4 kb = 2.2518e-8 * 3.18825 / 3.8305e-6 = 0.0187425 N m at 912.3226 rad/s
        ("shaft", 68.397, 1e-5),
        # i = 0.0187425 / 0.0104 = 1.80217 A, v = 0.2 i + 912.3226 / 96.342 = 9.83005 V
        ("motor", 4 * 1.80217 * 9.83005, 1e-5),
        ("constant_efficiency", 68.397 / 0.75, 1e-5),
        # The published 486.5 W are for 912 rad/s; at 912.32 f_r and speed differ by some 5e-4.
        ("efficiency", 486.5, 1e-3),
        # tau + 0.04 + 2e-4 * 912.3226 = 0.241207 N m, i = 23.1930 A, v = 14.1083 V
        ("motor_with_friction", 4 * 23.1930 * 14.1083, 1e-4),
    ],
)
def test_hover_power(model, watts, tolerance):
    assert steady(scenario(power={"model": model})).hover_power == pytest.approx(
        watts, rel=tolerance
    )


@pytest.mark.parametrize(("model", "watts"), [("motor", 70.96), ("motor_with_friction", 4 * 327.9)])
def test_hover_power_with_the_published_constants(model, watts):
    # Morbidi's set: kt = 1/kv to the digit, g = 9.8066 m/s^2.
    published = {"torque_constant": 0.0103797}
    told = scenario(power={"model": model}, vehicle=published).with_values({"gravity": 9.8066})
    assert steady(told).hover_power == pytest.approx(watts, rel=1e-3)


def test_hover():
    told = scenario(power={"model": "shaft"})
    found = steady(told).hover
    assert found.rotor_speed_rad_per_s == pytest.approx(sqrt(1.3 * 9.81 / (4 * 3.8305e-6)))
    assert found.thrust_N == pytest.approx(1.3 * 9.81)
    assert found.battery_current_A * found.battery_voltage_V == pytest.approx(found.power_W)
    assert battery_shortfalls(told, steady(told)) == ()


def test_power_at_thrust_grows_with_its_three_halves_power():
    flight = steady(scenario(power={"model": "shaft"}))
    hovering = flight.power_at_thrust(1.3 * 9.81)
    assert hovering == pytest.approx(68.397, rel=1e-5)
    assert flight.power_at_thrust(4 * 1.3 * 9.81) == pytest.approx(8 * hovering, rel=1e-9)
    assert flight.power_at_thrust(0.0) == 0.0


def test_battery_shortfalls_name_what_is_missing():
    weak = scenario(battery={"use": "paper_cell", "cells_series": 1})
    (line,) = battery_shortfalls(weak, steady(weak))
    assert "hover needs 70.86 W, the pack delivers at most 24.26 W" in line
    far = scenario(mission={"goal": {"position": [0.0, 0.0, 1.0]}, "duration": 7200.0})
    (line,) = battery_shortfalls(far, steady(far))
    assert "the pack holds 5.2 Ah" in line
