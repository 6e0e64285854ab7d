"""The pack as an equivalent circuit against closed forms, and against PyBaMM where installed."""

import warnings
from math import exp, log, sqrt

import numpy as np
import pytest
from pyomo.dae import ContinuousSet, Integral
from pyomo.environ import Block, ConcreteModel, Expression, Objective, Param, Suffix, sin
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from pyomo_quad.collocation import compile as compile_model
from pyomo_quad.flight.baselines import declared_start
from pyomo_quad.model import build_model, inspect_model
from pyomo_quad.model.battery import build_pack, declare_battery
from pyomo_quad.model.typeset import typeset_equations
from tests.declared_model import scenario

MILLIVOLT = 1e-3
RELAXATION = {"resistance": 0.012, "time_constant": 25.0}
THERMAL = {
    "heat_capacity": 90.0,
    "cooling": 0.15,
    "ambient_temperature": 283.15,
    "activation_energy": 2e4,
}
#: A source of constant voltage: 3 cells of 3.7 V.
CONSTANT = {"use": "phantom_2_pack", "K": 0.0, "A": 0.0, "E0": 3.7}
KEYS = ("battery.voltage", "battery.current")


def under_load(told, load, end):
    """Declare the pack alone under a load that is a formula of the time."""
    m = ConcreteModel()
    m.time = ContinuousSet(initialize=(0.0, end / 2, end))
    m.clock = Param(m.time, initialize=lambda _m, t: t, mutable=True)
    m.scaling_factor = Suffix()
    m.power = Block()
    m.power.total = Expression(m.time, rule=lambda _b, t: load(m.clock[t]))
    declare_battery(m, told)
    m.energy = Integral(m.time, wrt=m.time, rule=lambda m, t: m.power.total[t])
    m.objective = Objective(expr=m.energy)
    return m


class Pack:
    """A pack alone under a load over time, integrated by SciPy."""

    def __init__(self, load, end, **battery):
        told = scenario(battery=battery)
        self.dynamics = compile_model(under_load(told, load, end)).dynamics()
        self.names = self.dynamics.state_names
        known = declared_start(told, self.dynamics)
        self.found = solve_ivp(
            lambda t, x: self.dynamics.rates(t, x, np.zeros(0)),
            (0.0, end),
            [known[name] for name in self.names],
            dense_output=True,
            rtol=1e-9,
            atol=1e-10,
            max_step=end / 20,
        )

    def state(self, name, t):
        return float(self.found.sol(t)[self.names.index(f"battery.{name}")])

    def read(self, t):
        """Voltage and current at a time."""
        keys = tuple((name, None) for name in KEYS)
        at = self.found.sol(t)[None, :]
        return self.dynamics.table(keys, np.array([t]), at, np.zeros((1, 0)))[0]


def test_constant_power_from_a_source_and_a_resistance():
    # V i = P and V = U - R i: the current is constant, and the charge grows with the time.
    power, voltage, resistance = 150.0, 3 * 3.7, 3 * 0.0173
    pack = Pack(lambda _t: power, 600.0, **CONSTANT)
    current = (voltage - sqrt(voltage**2 - 4 * resistance * power)) / (2 * resistance)
    for t in (0.0, 200.0, 600.0):
        found_voltage, found_current = pack.read(t)
        assert found_voltage == pytest.approx(voltage - resistance * current, abs=MILLIVOLT)
        assert found_current == pytest.approx(current, rel=1e-6)
        assert pack.state("charge_drawn", t) == pytest.approx(current * t / 3600, rel=1e-6)


def time_until(voltage, begun, *, source, fast, slow, tau, power):
    """docs/theory/battery.md, eq. (14): when constant power has drawn the voltage down."""
    root = sqrt(source**2 - 4 * (fast + slow) * power)
    high, low = (source + root) / 2, (source - root) / 2
    weights = (
        (fast / (fast + slow), 0.0),
        ((fast * power - high**2) / (high * root), high),
        ((low**2 - fast * power) / (low * root), low),
    )
    return tau * sum(w * log(abs((voltage - v) / (begun - v))) for w, v in weights)


def test_constant_power_from_a_thevenin_pack():
    power, tau = 150.0, 25.0
    source, fast, slow = 3 * 3.7, 3 * 0.0173, 3 * 0.012
    pack = Pack(lambda _t: power, 100.0, **CONSTANT, relaxation=RELAXATION)
    begun = source - fast * pack.read(0.0)[1]
    settled = (source + sqrt(source**2 - 4 * (fast + slow) * power)) / 2
    told = {"source": source, "fast": fast, "slow": slow, "tau": tau, "power": power}
    for t in (5.0, 25.0, 60.0, 100.0):
        expected = brentq(
            lambda v: time_until(v, begun, **told) - t,  # noqa: B023
            settled + 1e-9,
            begun - 1e-12,
        )
        assert pack.read(t)[0] == pytest.approx(expected, abs=MILLIVOLT)


def test_a_pack_recovers_as_its_slow_drop_relaxes():
    # Without a load the slow drop falls by exp(-t / tau), and the voltage is all but it.
    pack = Pack(lambda _t: 0.0, 60.0, **CONSTANT, relaxation=RELAXATION | {"initial_voltage": 0.1})
    for t in (0.0, 10.0, 60.0):
        assert pack.read(t)[0] == pytest.approx(11.1 - 0.3 * exp(-t / 25.0), abs=MILLIVOLT)


def test_the_temperature_is_that_of_its_losses():
    # Constant resistance and no cooling: the heat is R i^2, all of which stays.
    still = THERMAL | {"activation_energy": 0.0, "cooling": 0.0}
    pack = Pack(lambda _t: 150.0, 300.0, **CONSTANT, thermal=still)
    current = pack.read(0.0)[1]
    warmer = 3 * 0.0173 * current**2 * 300.0 / (3 * 90.0)
    assert pack.state("temperature", 300.0) == pytest.approx(283.15 + warmer, abs=1e-4)
    # With cooling it ends where the air takes the heat.
    pack = Pack(
        lambda _t: 150.0, 8000.0, **CONSTANT, capacity=50.0, thermal=still | {"cooling": 0.5}
    )
    warmer = 3 * 0.0173 * current**2 / (3 * 0.5)
    assert pack.state("temperature", 8000.0) == pytest.approx(283.15 + warmer, abs=1e-3)


def test_resistances_fall_with_temperature_and_grow_with_age():
    cold = Pack(lambda _t: 150.0, 1.0, **CONSTANT, thermal=THERMAL)
    current = cold.read(0.0)[1]
    share = exp(2e4 / 8.314462618 * (1 / 283.15 - 1 / 298.15))
    assert cold.read(0.0)[0] == pytest.approx(11.1 - share * 3 * 0.0173 * current, abs=1e-6)
    aged = {"capacity_factor": 0.8, "resistance_factor": 1.5}
    old = Pack(lambda _t: 150.0, 600.0, **CONSTANT, relaxation=RELAXATION, health=aged)
    voltage, current = old.read(0.0)
    assert voltage == pytest.approx(11.1 - 1.5 * 3 * 0.0173 * current, abs=1e-6)
    voltage, current = old.read(600.0)
    assert voltage == pytest.approx(11.1 - 1.5 * 3 * (0.0173 + 0.012) * current, abs=MILLIVOLT)


def test_a_pack_of_less_capacity_has_the_same_voltage_at_the_same_state_of_charge():
    kept = {"initial_state_of_charge": 60.0, "use": "phantom_2_pack"}
    for factor in (1.0, 0.7):
        told = scenario(battery=kept | {"health": {"capacity_factor": factor}})
        problem = compile_model(build_pack(told))
        states = np.array([[0.4 * 5.2 * factor]])
        keys = (("battery.voltage", None), ("battery.state_of_charge", None))
        voltage, charge = problem.dynamics().table(keys, np.zeros(1), states, np.zeros((1, 0)))[0]
        assert charge == pytest.approx(60.0)
        cell = 3.7348 - 0.00876 / 0.6 + 0.468 * exp(-0.6787 * 0.4 * 5.2)
        assert voltage == pytest.approx(3 * cell, rel=1e-9)


def test_the_circuit_has_units_and_is_declared_only_where_it_is_given():
    aged = {"capacity_factor": 0.9, "resistance_factor": 1.2}
    model = build_model(
        scenario(
            battery={"relaxation": RELAXATION, "thermal": THERMAL, "health": aged},
            mission={"aim": "charge"},
        )
    )
    assert inspect_model(model).unit_errors == ()
    written = {e.name: e.latex for e in typeset_equations(model)}
    assert r"\mathrm" not in written["battery.relaxation_balance"]
    assert r"\mathrm" not in written["battery.heat_balance"]
    plain = build_model(scenario())
    for name in (
        "relaxation_voltage",
        "temperature",
        "resistance_share",
        "loss",
        "capacity_factor",
    ):
        assert plain.battery.component(name) is None


@pytest.mark.slow  # its import alone takes seconds
def test_pybamm_gives_the_same_voltage_and_temperature_for_the_same_current():
    pybamm = pytest.importorskip("pybamm")
    cell = {"E0": 3.7348, "K": 0.00876, "A": 0.468, "B": 0.6787, "capacity": 5.2}

    def load(t):
        return 160.0 + 90.0 * sin(t / 7.0)

    charge = {"initial_state_of_charge": 95.0}
    pack = Pack(load, 250.0, use="phantom_2_pack", **charge, relaxation=RELAXATION, thermal=THERMAL)
    times = np.linspace(0.0, 250.0, 2501)
    ours = np.array([pack.read(t) for t in times])

    def voltage_of(charge):
        drawn = (1 - charge) * cell["capacity"]
        return cell["E0"] - cell["K"] / charge + cell["A"] * pybamm.exp(-cell["B"] * drawn)

    def warm(resistance):
        def at(temperature, _current, _charge):
            inverse = 1 / (temperature + 273.15) - 1 / 298.15
            return resistance * pybamm.exp(2e4 / 8.314462618 * inverse)

        return at

    def capacitance(temperature, current, charge):
        return 25.0 / warm(0.012)(temperature, current, charge)

    values = pybamm.ParameterValues("ECM_Example")
    values.update(
        {
            "Initial SoC": 0.95,
            "Initial temperature [K]": 283.15,
            "Ambient temperature [K]": 283.15,
            "Cell capacity [A.h]": 5.2,
            "Nominal cell capacity [A.h]": 5.2,
            "Current function [A]": pybamm.Interpolant(times, ours[:, 1], pybamm.t),
            "Upper voltage cut-off [V]": 5.0,
            "Lower voltage cut-off [V]": 2.0,
            "Cell thermal mass [J/K]": 90.0,
            "Cell-jig heat transfer coefficient [W/K]": 0.15,
            "Jig thermal mass [J/K]": 1e9,
            "Open-circuit voltage [V]": voltage_of,
            "R0 [Ohm]": warm(0.0173),
            "R1 [Ohm]": warm(0.012),
            "C1 [F]": capacitance,
            "Element-1 initial overpotential [V]": 0.0,
            "Entropic change [V/K]": 0.0,
        },
        check_already_exists=False,
    )
    told = pybamm.Simulation(pybamm.equivalent_circuit.Thevenin(), parameter_values=values)
    solver = pybamm.ScipySolver(rtol=1e-8, atol=1e-9)
    # Its interpolation ends the simulation where the table of the current ends.
    times, ours = times[:2401], ours[:2401]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", pybamm.SolverWarning)  # the rest of the table is not asked
        found = told.solve(times, solver=solver)
    voltage, warmth = found["Voltage [V]"](times), found["Cell temperature [degC]"](times)
    # Three cells in series have a third of the voltage each.
    assert np.max(np.abs(ours[:, 0] / 3 - voltage)) < MILLIVOLT
    own = [pack.state("temperature", t) - 273.15 for t in times[::100]]
    assert np.max(np.abs(np.array(own) - warmth[::100])) < 0.01
