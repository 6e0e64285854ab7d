"""Equivalent circuit of a battery: relaxation voltage (RC pair), temperature and health.

symbol | name | unit | meaning
u_1 | relaxation_voltage | V | voltage of the RC pair, the slow part of the pack's drop, a state
R_1, tau_1 | relaxation_resistance, relaxation_time_constant | ohm, s | of one cell
T | temperature | K | of the pack, a state
C_T, h | heat_capacity, cooling | J/K, W/K | of one cell
T_a | ambient_temperature | K | of the air
T_r | reference_temperature | K | for which the scenario gives the resistances
E_a | activation_energy | J/mol | of the resistances, in Arrhenius's law
s_R | resistance_share | - | resistance at the temperature T over resistance at T_r

Derivation and sources: see docs/theory/battery.md, eqs. (4) to (10). The RC pair is declared only
if the scenario has the table `battery.relaxation`. The temperature is declared only if the scenario
has the table `battery.thermal`.

Assumptions: all cells alike and at one temperature, no entropic heat, one time constant at all
temperatures and states of charge.
"""

from collections.abc import Mapping
from operator import attrgetter

from pyomo.core import Block, ConcreteModel, Constraint, Expression, Var, exp
from pyomo.core.base.units_container import units
from pyomo.core.expr import NumericExpression, RelationalExpression
from pyomo.dae import DerivativeVar

from pyomo_quad.model.parameters import Parameter, fields_of
from pyomo_quad.scenario import Scenario
from pyomo_quad.scenario.mission import Aim

GAS_CONSTANT = 8.314462618 * units.J / units.mol / units.K
"""Molar gas constant, CODATA 2018, exact."""
# Usual relaxation voltage as a fraction of the cells' constant voltage E0, for scaling.
_NOMINAL_DROP = 0.03

_RELAXATION = fields_of(
    "battery.relaxation",
    relaxation_resistance="resistance",
    relaxation_time_constant="time_constant",
    initial_relaxation_voltage="initial_voltage",
)
_THERMAL = (
    *fields_of("battery.thermal", "heat_capacity", "cooling", "ambient_temperature"),
    Parameter(
        name="initial_pack_temperature",
        units=units.K,
        value=attrgetter("battery.thermal.start"),
        doc="temperature of the pack at the start",
    ),
    *fields_of("battery.thermal", "reference_temperature", "activation_energy"),
)
_HEALTH = fields_of("battery.health", "capacity_factor", "resistance_factor")
CIRCUIT_STATES = _DROP, _TEMPERATURE = ("battery.relaxation_voltage", "battery.temperature")
"""Full names of the optional states of the battery: relaxation voltage and temperature."""
#: Full name of the energy lost in the battery, a state under `mission.aim = "charge"`.
LOSS = "battery.loss"


def parameters_of(scenario: Scenario) -> tuple[Parameter, ...]:
    """Return the parameters of relaxation, temperature and health of a scenario's battery.

    If the scenario has no table `battery.relaxation`, `battery.thermal` or `battery.health`, the
    parameters of this table are left out.
    """
    pack = scenario.battery
    optional = ((pack.relaxation, _RELAXATION), (pack.thermal, _THERMAL), (pack.health, _HEALTH))
    return tuple(row for given, table in optional if given is not None for row in table)


def states_at_start(scenario: Scenario) -> dict[str, float]:
    """Return the initial values of the battery's states other than its charge, by full name.

    If the model has them, the states are relaxation voltage [V], temperature [K] and the energy
    lost inside the battery [J]. The model has the last state if `mission.aim` is "charge". An
    example of a full name is "battery.temperature".
    """
    pack, states = scenario.battery, {}
    if pack.relaxation is not None:
        states[_DROP] = pack.cells_series * pack.relaxation.initial_voltage
    if pack.thermal is not None:
        states[_TEMPERATURE] = pack.thermal.start
    if scenario.mission.aim is Aim.CHARGE:
        states[LOSS] = 0.0
    return states


def fields_after(scenario: Scenario, ended: Mapping[str, float]) -> dict[str, float]:
    """Return the scenario fields that start the next flight with the battery's present state.

    `ended` has the states at the end of the flight by full name, such as ``"battery.temperature"``.
    The fields are the initial relaxation voltage and temperature, but not the initial charge.
    """
    fields = {}
    if _DROP in ended:
        drop = ended[_DROP] / scenario.battery.cells_series
        fields["battery.relaxation.initial_voltage"] = drop
    if _TEMPERATURE in ended:
        fields["battery.thermal.initial_temperature"] = ended[_TEMPERATURE]
    return fields


def declare_states(b: Block, m: ConcreteModel, scenario: Scenario) -> None:
    """Declare relaxation voltage [V] and temperature [K] of the pack as states, if modelled.

    The scenario's tables `battery.relaxation` and `battery.thermal` select them. The states are
    added to `b`, the block `battery` of the model `m`.
    """
    pack = scenario.battery
    if pack.relaxation is not None:
        b.relaxation_voltage = Var(
            m.time, units=units.V, initialize=0.0, doc="u_1: slow part of the voltage drop"
        )
        b.drelaxation_voltage_dt = DerivativeVar(
            b.relaxation_voltage, wrt=m.time, units=units.V / units.s, initialize=0.0
        )
        usual = _NOMINAL_DROP * pack.cells_series * pack.E0
        m.scaling_factor[b.relaxation_voltage] = 1.0 / usual
    if pack.thermal is not None:
        start = pack.thermal.start
        b.temperature = Var(m.time, units=units.K, initialize=start, doc="T: of the pack")
        b.dtemperature_dt = DerivativeVar(
            b.temperature, wrt=m.time, units=units.K / units.s, initialize=0.0
        )
        m.scaling_factor[b.temperature] = 1.0 / start
        b.resistance_share = Expression(m.time, rule=resistance_share, doc=_line(resistance_share))


def declare_balances(b: Block, m: ConcreteModel, scenario: Scenario) -> None:
    """Declare the differential equations of relaxation voltage and temperature, if modelled.

    The initial conditions are declared, too. The scenario's tables `battery.relaxation` and
    `battery.thermal` select the equations. `b` is the block `battery` of the model `m`.
    """
    if scenario.battery.relaxation is not None:
        b.relaxation_balance = Constraint(
            m.time, rule=relaxation_balance, doc=_line(relaxation_balance)
        )
        b.initial_relaxation = Constraint(rule=initial_relaxation, doc=_line(initial_relaxation))
    if scenario.battery.thermal is not None:
        b.heat = Expression(m.time, rule=heat, doc=_line(heat))
        b.heat_balance = Constraint(m.time, rule=heat_balance, doc=_line(heat_balance))
        b.initial_temperature = Constraint(rule=initial_temperature, doc=_line(initial_temperature))


def _line(equation: object) -> str:
    """Return the first line of an equation's docstring without full stop, as documentation text."""
    return str(equation.__doc__).partition("\n")[0].rstrip(".")


def resistance_share(b: Block, t: float) -> NumericExpression:
    """Resistance at the cell's temperature over resistance at the reference temperature [-].

    The ratio follows Arrhenius's law; see docs/theory/battery.md, eq. (7). `b` is the block
    `battery`, and `t` the time in flight [s].
    """
    inverse = 1 / b.temperature[t] - 1 / b.reference_temperature
    return exp(b.activation_energy / GAS_CONSTANT * inverse)


def resistance_at(b: Block, t: float) -> NumericExpression:
    """Ohmic resistance of the battery at its temperature [ohm].

    `b` is the block `battery`, and `t` the time in flight [s]. See docs/theory/battery.md, eq. (4).
    """
    if b.component("resistance_share") is None:
        return b.pack_resistance
    return b.pack_resistance * b.resistance_share[t]


def source_voltage(b: Block, t: float) -> NumericExpression:
    """Open-circuit voltage less the relaxation voltage, before the ohmic drop [V].

    Without a relaxation voltage in the scenario, the result is the open-circuit voltage. `b` is the
    block `battery`, and `t` the time in flight [s]. See docs/theory/battery.md, eq. (5).
    """
    if b.component("relaxation_voltage") is None:
        return b.open_circuit_voltage[t]
    return b.open_circuit_voltage[t] - b.relaxation_voltage[t]


def slow_resistance(b: Block, t: float) -> NumericExpression:
    """Resistance of the RC pair at the battery's health and temperature [ohm].

    The RC pair (a resistor and a capacitor in parallel) models the slow part of the voltage drop.
    `b` is the block `battery`, and `t` the time in flight [s].
    """
    of_pack = b.relaxation_resistance * b.cells_series / b.cells_parallel
    if b.component("resistance_factor") is not None:
        of_pack *= b.resistance_factor
    return of_pack if b.component("resistance_share") is None else of_pack * b.resistance_share[t]


def relaxation_balance(b: Block, t: float) -> RelationalExpression:
    """RC pair: the relaxation voltage tends to the battery current times the pair's resistance [V].

    The result is the differential equation of the relaxation voltage, docs/theory/battery.md, eq.
    (8). `b` is the block `battery`, and `t` the time in flight [s].
    """
    settled = slow_resistance(b, t) * b.current[t]
    return (
        b.relaxation_time_constant * b.drelaxation_voltage_dt[t]
        == settled - b.relaxation_voltage[t]
    )


def initial_relaxation(b: Block) -> RelationalExpression:
    """Relaxation voltage at the start, of all cells in series [V].

    The result is the initial condition of the state `relaxation_voltage` of `b`, the block
    `battery`.
    """
    start = b.parent_block().time.first()
    return b.relaxation_voltage[start] == b.cells_series * b.initial_relaxation_voltage


def heat(b: Block, t: float) -> NumericExpression:
    """Heat of the pack's losses, Bernardi's equation without entropy [W].

    The heat is (open-circuit voltage - terminal voltage) * current. `b` is the block `battery`, and
    `t` the time in flight [s]. See docs/theory/battery.md, eq. (9).
    """
    return (b.open_circuit_voltage[t] - b.voltage[t]) * b.current[t]


def heat_balance(b: Block, t: float) -> RelationalExpression:
    """Lumped temperature: heat of the losses less the heat lost to the air [W].

    The heat capacity of the pack times dT/dt equals this difference. The result is this
    differential equation, docs/theory/battery.md, eq. (10). `b` is the block `battery`, and `t` the
    time in flight [s].
    """
    cells = b.cells_series * b.cells_parallel
    warming = cells * b.heat_capacity * b.dtemperature_dt[t]
    cooled = cells * b.cooling * (b.temperature[t] - b.ambient_temperature)
    return warming == b.heat[t] - cooled


def initial_temperature(b: Block) -> RelationalExpression:
    """Temperature of the battery at the start [K].

    The result is the initial condition of the state `temperature` of `b`, the block `battery`.
    """
    return b.temperature[b.parent_block().time.first()] == b.initial_pack_temperature
