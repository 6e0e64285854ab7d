"""Battery, eqs. (4), (5) of Yacef et al.: equal cells in series and parallel, as a circuit.

symbol | name | unit | meaning
int i_bat | charge_drawn | A h | charge drawn since the pack was full, a state
i_bat | current | A | pack current, from the power balance V i = P
V_bat | voltage | V | terminal voltage, eq. (4)
e_m | open_circuit_voltage | V | eq. (5), cells in series added
SoC | state_of_charge | percent | eq. (4)
e_0, k, c_1, c_2 | E0, K, A, B | V, V, V, 1/(A h) | constants of one cell
Q_bat, R_bat | capacity, cell_resistance | A h, ohm | of one cell
f_Q, f_R | capacity_factor, resistance_factor | - | state of health; only with battery.health

The module `battery_circuit` adds a slow voltage drop and a temperature of the pack if the scenario
gives their constants. Derivation and sources: see docs/theory/battery.md, eqs. (1) to (6).

P is the total power by the chosen power model, which the pack delivers at its terminals. Eq. (4)
gives the charge in ampere-seconds; the model converts it to ampere-hours.

Assumptions: no self-discharge, no entropic heat, and an open-circuit voltage that does not depend
on the temperature. Without the scenario's table `battery.relaxation`, the voltage does not recover
at rest. Without the table `battery.thermal`, the pack has no temperature.

Eq. (5) has a pole at SoC = 0. The power balance has no solution if P exceeds the pack's greatest
power U^2/(4 R), where U is the open-circuit voltage (less the relaxation voltage) and R the
resistance of the pack. Two smooth lower limits, called guards, keep the equations finite. One
limits the state of charge. The other limits the ratio of `power_reserve` (greatest power less P) to
the greatest power. At a state of charge above 20 % and a power below 90 % of the greatest power,
the effect of the guards is below rounding. If the state of charge or the power reserve is negative,
the pack is too small for the mission.
"""

from pyomo.core import (
    Block,
    ConcreteModel,
    Expression,
    Objective,
    Param,
    Suffix,
    Var,
    exp,
    sqrt,
    value,
)
from pyomo.core.base.units_container import units
from pyomo.core.expr import NumericExpression, RelationalExpression
from pyomo.dae import ContinuousSet, DerivativeVar, Integral

from pyomo_quad.model import battery_circuit as circuit
from pyomo_quad.model.parameters import (
    DIP,
    Parameter,
    declare_parameters,
    fields_of,
    parameters_in,
    saturated,
)
from pyomo_quad.scenario import Scenario

CHARGE = units.A * units.hr
#: Full name of the charge drawn, a state.
CHARGE_STATE = "battery.charge_drawn"
# Fractions of the charge and of the greatest power at which the guards act, and their widths.
GUARD_FLOOR = 0.01
GUARD_WIDTH = 0.005
# Fraction of the pack's greatest power below which the guard changes no digit of the equations.
GIVEN_SHARE = 1 - GUARD_FLOOR - 10 * GUARD_WIDTH
# Fraction of the capacity that a flight of some seconds may draw, for scaling.
_NOMINAL_SHARE = 0.01

#: Names of the conditions on the pack's states at the start, where they are declared.
CONDITIONS_AT_START = (
    *("initial_charge", "initial_relaxation", "initial_temperature"),
    "initial_loss",
)

_CELL = (
    *fields_of("battery", "cells_series", "cells_parallel", "E0", "K", "A", "B", "capacity"),
    *fields_of("battery", "cell_resistance", "initial_state_of_charge"),
)


@parameters_in("battery")
def _parameters(scenario: Scenario) -> tuple[Parameter, ...]:
    """Return the parameters that the model of a scenario declares in its block `battery`."""
    return _CELL + circuit.parameters_of(scenario)


def may_lose_voltage(scenario: Scenario) -> bool:
    """Return whether the open-circuit voltage can fall to zero before the battery is empty.

    The voltage follows eq. (5) of Yacef et al. If the result is true, `declare_battery` adds the
    path constraint that the voltage is not negative.
    """
    # The polarisation voltage k / SoC grows while the pack is discharged. For some constants, it
    # exceeds the other terms of e_m before the pack is empty, so that e_m becomes negative.
    least_share = GUARD_FLOOR - DIP * GUARD_WIDTH
    return scenario.battery.K / least_share >= scenario.battery.E0


def build_pack(scenario: Scenario) -> ConcreteModel:
    """Build a model of the battery alone, which delivers the mutable parameter `power.load` [W].

    `power.total` equals this load. The set `time` is one hour, not discretised. The package
    `identification` simulates the model in time steps, with the measured power of each step as the
    load.
    """
    m = ConcreteModel(name="pack")
    m.time = ContinuousSet(initialize=(0.0, 1800.0, 3600.0), doc="time [s]")
    m.scaling_factor = Suffix(direction=Suffix.EXPORT)
    m.power = Block(doc="load of the pack")
    m.power.load = Param(initialize=0.0, mutable=True, units=units.W, doc="P: power drawn")

    @m.power.Expression(m.time, doc="power drawn from the pack [W]")
    def total(b: Block, _t: float) -> NumericExpression:
        return 1.0 * b.load

    declare_battery(m, scenario)
    m.energy = Integral(m.time, wrt=m.time, rule=lambda m, t: m.power.total[t], doc="energy [J]")
    m.objective = Objective(expr=m.energy)
    return m


def declare_battery(m: ConcreteModel, scenario: Scenario) -> None:
    """Declare charge, voltage and current of the battery in block `battery`.

    If the battery has the table `relaxation` or `thermal`, the relaxation voltage or the
    temperature is a further state. `m` already declares `time`, `power` and `scaling_factor`.
    """
    b = m.battery = Block(doc="battery pack, Yacef et al., eqs. (4) and (5)")
    pack = scenario.battery
    declare_parameters(b, scenario)
    _declare_sizes(b)
    b.charge_drawn = Var(m.time, units=CHARGE, initialize=0.0, doc="charge drawn from full")
    b.dcharge_drawn_dt = DerivativeVar(
        b.charge_drawn, wrt=m.time, units=CHARGE / units.s, initialize=0.0
    )
    pack_capacity = pack.capacity * pack.cells_parallel
    m.scaling_factor[b.charge_drawn] = 1.0 / (_NOMINAL_SHARE * pack_capacity)
    circuit.declare_states(b, m, scenario)
    _declare_voltage(b, m)
    _declare_charge(b, m)
    circuit.declare_balances(b, m, scenario)
    if may_lose_voltage(scenario):

        @b.Constraint(m.time, doc="open-circuit voltage of the pack is not negative [V]")
        def pack_voltage_limit(b: Block, t: float) -> RelationalExpression:
            return b.open_circuit_voltage[t] >= 0 * units.V


def declare_loss(m: ConcreteModel) -> None:
    """Declare the energy lost inside the battery as a state, to minimise the charge.

    The loss is the integral of U_0 i - P, with the initial open-circuit voltage U_0, current i and
    power P. Energy plus loss is U_0 times the charge drawn in flight. See docs/theory/battery.md,
    eqs. (11) to (12).
    """
    b, start = m.battery, m.time.first()
    charge, missing = b.charge_drawn[start], 1 - b.initial_state_of_charge / (100 * units.percent)
    # The open-circuit voltage at the start is evaluated at the initial charge.
    charge.set_value(value(b.pack_capacity * missing))
    b.reference_voltage = Param(
        initialize=value(b.open_circuit_voltage[start]),
        mutable=True,
        units=units.V,
        doc="open-circuit voltage at the start",
    )
    b.loss = Var(m.time, units=units.J, initialize=0.0, doc="E_l: energy lost inside the pack")
    b.dloss_dt = DerivativeVar(b.loss, wrt=m.time, units=units.W, initialize=0.0)

    @b.Constraint(m.time, doc="power at the initial open-circuit voltage is delivered or lost [W]")
    def loss_balance(b: Block, t: float) -> RelationalExpression:
        drawn = b.reference_voltage * b.current[t]
        return b.dloss_dt[t] == drawn - b.parent_block().power.total[t]

    @b.Constraint(doc="energy lost inside the pack is zero at the start [J]")
    def initial_loss(b: Block) -> RelationalExpression:
        return b.loss[start] == 0


def _declare_sizes(b: Block) -> None:
    """Declare capacity [A h] and resistance [ohm] of the whole, possibly aged pack.

    `b` is the block `battery`, which receives the two expressions.
    """
    capacity = b.capacity * b.cells_parallel
    resistance = b.cell_resistance * b.cells_series / b.cells_parallel
    if b.component("capacity_factor") is not None:
        capacity *= b.capacity_factor
        resistance *= b.resistance_factor
    b.pack_capacity = Expression(expr=capacity)
    b.pack_resistance = Expression(expr=resistance)


def _declare_charge(b: Block, m: ConcreteModel) -> None:
    @b.Expression(m.time, doc="Yacef et al., eq. (4) row 1: state of charge [percent]")
    def state_of_charge(b: Block, t: float) -> NumericExpression:
        return 100 * units.percent * (1 - b.charge_drawn[t] / b.pack_capacity)

    @b.Constraint(
        m.time,
        doc="Yacef et al., eq. (4) row 1: the charge drawn is the integral of the current [A]",
    )
    def charge_balance(b: Block, t: float) -> RelationalExpression:
        return units.convert(b.dcharge_drawn_dt[t], to_units=units.A) == b.current[t]

    @b.Constraint(doc="charge missing from the pack at the start [A h]")
    def initial_charge(b: Block) -> RelationalExpression:
        missing_share = 1 - b.initial_state_of_charge / (100 * units.percent)
        start = b.parent_block().time.first()
        return b.charge_drawn[start] == b.pack_capacity * missing_share


def _declare_voltage(b: Block, m: ConcreteModel) -> None:
    @b.Expression(m.time, doc="share of the charge that remains, guarded")
    def remaining_share(b: Block, t: float) -> NumericExpression:
        share = 1 - b.charge_drawn[t] / b.pack_capacity
        return saturated(share, GUARD_FLOOR, GUARD_WIDTH)

    @b.Expression(m.time, doc="Yacef et al., eq. (5): open-circuit voltage of the pack [V]")
    def open_circuit_voltage(b: Block, t: float) -> NumericExpression:
        polarisation = b.K / b.remaining_share[t]
        exponential_zone = b.A * exp(-b.B * _charge_of_new_cell(b, t))
        return b.cells_series * (b.E0 - polarisation + exponential_zone)

    @b.Expression(m.time, doc="greatest power the pack can deliver, at half its voltage [W]")
    def greatest_power(b: Block, t: float) -> NumericExpression:
        # U |U|/(4 R) in place of U^2/(4 R): an iterate of the solver may have U < 0, where the pack
        # must supply no power.
        source = circuit.source_voltage(b, t)
        return source * abs(source) / (4 * circuit.resistance_at(b, t))

    @b.Expression(m.time, doc="greatest power less the power drawn [W]")
    def power_reserve(b: Block, t: float) -> NumericExpression:
        return b.greatest_power[t] - b.parent_block().power.total[t]

    @b.Expression(m.time, doc="share of the greatest power that is left, guarded")
    def reserve_share(b: Block, t: float) -> NumericExpression:
        share = b.power_reserve[t] / b.greatest_power[t]
        return saturated(share, GUARD_FLOOR, GUARD_WIDTH)

    @b.Expression(
        m.time, doc="Yacef et al., eq. (4) row 2 with V i = P, solved for the pack current [A]"
    )
    def current(b: Block, t: float) -> NumericExpression:
        current_at_greatest_power = circuit.source_voltage(b, t) / (2 * circuit.resistance_at(b, t))
        return current_at_greatest_power * (1 - sqrt(b.reserve_share[t]))

    @b.Expression(m.time, doc="Yacef et al., eq. (4) row 2: terminal voltage of the pack [V]")
    def voltage(b: Block, t: float) -> NumericExpression:
        return circuit.source_voltage(b, t) - circuit.resistance_at(b, t) * b.current[t]


def _charge_of_new_cell(b: Block, t: float) -> NumericExpression:
    """Return the charge drawn from one cell, divided by `capacity_factor` if it exists [A h]."""
    # The constants of eq. (5) of Yacef et al. hold for an unaged cell.
    charge = b.charge_drawn[t] / b.cells_parallel
    return charge if b.component("capacity_factor") is None else charge / b.capacity_factor
