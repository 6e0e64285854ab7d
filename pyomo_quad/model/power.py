"""The electrical power of the rotors, by six models of which a scenario chooses one.

Each is a function that declares the power of every rotor before anything is said of braking;
regeneration then says what braking earns, all of it or nothing.  The energy of the flight is the
integral of their sum, eq. (8); the paper's second sum, over every speed for every rotor, is
read as one sum over the four rotors.

name | power of one rotor | convex in alpha | convex in thrust in steady flight
motor | v i | yes | yes
motor_with_friction | v i with friction in the torque | yes | no
shaft | tau omega | yes, linear | yes
constant_efficiency | tau omega / eta | yes | yes
efficiency | tau omega / f_r(tau, omega) | no | no
momentum | induced, profile and axial, in moving air: see `model.momentum` | yes | yes

By default the first three and the last earn what braking gives: theirs are balances that hold
whichever way the energy flows.  The others do not: a braking power divided by an efficiency
would earn more than it gave.
"""

from collections.abc import Callable

from pyomo.core import Block, ConcreteModel, Expression
from pyomo.core.base.units_container import units
from pyomo.core.expr import NumericExpression

from pyomo_quad.model import momentum
from pyomo_quad.model.parameters import Parameter, declare_parameters
from pyomo_quad.model.smoothing import floored, positive_part
from pyomo_quad.scenario import Scenario
from pyomo_quad.scenario.tables import PowerModel

_TORQUE = units.N * units.m
_SPEED = units.rad / units.s
_ROWS = ("cubic", "quadratic", "linear", "constant")
_COLUMNS = ("a", "b", "c")
# Half widths over which the floors of f_r are rounded: far below hover's 0.0187 N m and 0.14.
TORQUE_FLOOR_WIDTH = 1e-4 * _TORQUE
EFFICIENCY_FLOOR_WIDTH = 1e-3
# Widths from which a corner at zero power is narrowed to the one asked for.
_WIDER_SMOOTHINGS_W = (10.0, 3.0, 1.0, 0.3)

_SMOOTHING = Parameter(
    name="smoothing",
    units=units.W,
    value=lambda s: s.power.smoothing,
    doc="width of the smooth floor at zero power",
)
_CONSTANT_EFFICIENCY = Parameter(
    name="efficiency",
    units=units.dimensionless,
    value=lambda s: s.power.efficiency,
    doc="shaft power over electrical power",
)


def _efficiency_map(scenario: Scenario) -> dict[tuple[str, str], float]:
    rows = scenario.vehicle.efficiency_map
    return {
        (row, column): number
        for row in _ROWS
        for column, number in zip(_COLUMNS, getattr(rows, row), strict=True)
    }


_EFFICIENCY_FUNCTION = (
    Parameter(
        name="efficiency_map",
        units=units.dimensionless,
        value=_efficiency_map,
        doc="f_r: rows are powers of the torque in N m, columns of the speed in rad/s",
        index=tuple((row, column) for row in _ROWS for column in _COLUMNS),
    ),
    Parameter(
        name="torque_floor",
        units=_TORQUE,
        value=lambda s: s.power.torque_floor,
        doc="smallest torque at which f_r is used",
    ),
    Parameter(
        name="efficiency_floor",
        units=units.dimensionless,
        value=lambda s: s.power.efficiency_floor,
        doc="smallest f_r used",
    ),
)


def parameters_of(scenario: Scenario) -> tuple[Parameter, ...]:
    """Return the parameters that the scenario's power model declares in block `power`.

    Returns
    -------
    tuple of Parameter
        Empty for the regenerating models that use the vehicle's numbers alone.
    """
    guard = () if scenario.power.regeneration else (_SMOOTHING,)
    match scenario.power.model:
        case PowerModel.EFFICIENCY:
            return _EFFICIENCY_FUNCTION + guard
        case PowerModel.CONSTANT_EFFICIENCY:
            return (_CONSTANT_EFFICIENCY, *guard)
        case PowerModel.MOMENTUM:
            return momentum.PARAMETERS + guard
    return guard


def wider_smoothings(scenario: Scenario) -> tuple[dict[str, float], ...]:
    """Return parameters under which a kinked power is easier to minimise, the easiest first.

    Returns
    -------
    tuple of mapping
        Full component name to value [W]; empty where the power has no corner.
    """
    if _SMOOTHING not in parameters_of(scenario):
        return ()
    own = scenario.power.smoothing
    return tuple({f"power.{_SMOOTHING.name}": w} for w in _WIDER_SMOOTHINGS_W if w > 2.0 * own)


def declare_power(m: ConcreteModel, scenario: Scenario) -> None:
    """Declare the power of each rotor and of all four in block `power`.

    Parameters
    ----------
    m : ConcreteModel
        With `time`, `vehicle` and `rotors`; for `momentum`, with the airspeeds too.
    """
    b = m.power = Block(doc="power, eq. (8)")
    declare_parameters(b, parameters_of(scenario), scenario)
    if scenario.power.regeneration:
        _MODELS[scenario.power.model](m, "rotor_power")
    else:
        _MODELS[scenario.power.model](m, "uncredited_power")
        _declare_floor(m)

    @b.Expression(m.time, doc="eq. (8): power of the four rotors [W]")
    def total(b: Block, t: float) -> NumericExpression:
        of_rotors = sum(b.rotor_power[j, t] for j in b.parent_block().rotors.rotor)
        if scenario.power.model is PowerModel.MOMENTUM:
            return of_rotors + b.electronics_power
        return of_rotors


def declare_motor_power(m: ConcreteModel, name: str) -> None:
    """Declare `motor`: terminal voltage times current, eq. (2)-(3).

    Sound wherever the motor runs: copper loss grows with the square of the torque, so the
    power is convex in alpha and in thrust.  With regeneration braking returns what the winding
    does not take.
    The rotor loses nothing to profile drag, so hover comes out at half a real aircraft's.
    """
    b = m.power

    def electrical_power(b: Block, j: int, t: float) -> NumericExpression:
        rotors = b.parent_block().rotors
        return rotors.motor_voltage[j, t] * rotors.motor_current[j, t]

    b.add_component(
        name,
        Expression(
            m.rotors.rotor,
            m.time,
            rule=electrical_power,
            doc="eq. (2)-(3): electrical power v i [W]",
        ),
    )


def declare_shaft_power(m: ConcreteModel, name: str) -> None:
    """Declare `shaft`: mechanical power, torque times speed.

    Sound as a floor under every other model: it knows no loss in motor or converter, and
    with regeneration braking returns all it takes.  Linear in alpha, so alpha needs its bound;
    convex in thrust (power 3/2).
    """
    b = m.power

    def electrical_power(b: Block, j: int, t: float) -> NumericExpression:
        rotors = b.parent_block().rotors
        return rotors.motor_torque[j, t] * rotors.omega[j, t]

    b.add_component(
        name,
        Expression(
            m.rotors.rotor,
            m.time,
            rule=electrical_power,
            doc="eq. (8) with f_r = 1: shaft power [W]",
        ),
    )


def declare_constant_efficiency_power(m: ConcreteModel, name: str) -> None:
    """Declare `constant_efficiency`: shaft power over a stated number.

    Sound near the operating point where the number was measured.  Convex in alpha and in
    thrust.  Non-negative unless regeneration is asked for.
    """
    b = m.power

    def electrical_power(b: Block, j: int, t: float) -> NumericExpression:
        rotors = b.parent_block().rotors
        return rotors.motor_torque[j, t] * rotors.omega[j, t] / b.efficiency

    b.add_component(
        name,
        Expression(
            m.rotors.rotor, m.time, rule=electrical_power, doc="eq. (8) with constant f_r [W]"
        ),
    )


def declare_efficiency_power(m: ConcreteModel, name: str) -> None:
    """Declare `efficiency`: shaft power over the recovered polynomial f_r(tau, omega), eq. (8).

    Sound only with its regularisation: f_r has zeros at moderate braking torque below some
    780 rad/s, so it is read at no less than `torque_floor`, floored at `efficiency_floor`,
    and braking earns nothing unless regeneration is asked for.  Not convex in alpha: below
    858 rad/s accelerating and coasting in turn is cheaper than steady flight, so an optimum
    depends on the bound on alpha and on the mesh.  Non-negative without regeneration.
    """
    b = m.power

    @b.Expression(m.rotors.rotor, m.time, doc="torque at which f_r is read [N m]")
    def map_torque(b: Block, j: int, t: float) -> NumericExpression:
        torque = b.parent_block().rotors.motor_torque[j, t]
        return floored(torque, b.torque_floor, TORQUE_FLOOR_WIDTH)

    @b.Expression(m.rotors.rotor, m.time, doc="eq. (8): efficiency function f_r as recovered")
    def efficiency_polynomial(b: Block, j: int, t: float) -> NumericExpression:
        torque = b.map_torque[j, t] / _TORQUE
        speed = b.parent_block().rotors.omega[j, t] / _SPEED
        cubic, quadratic, linear, constant = (
            b.efficiency_map[row, "a"] * speed**2
            + b.efficiency_map[row, "b"] * speed
            + b.efficiency_map[row, "c"]
            for row in _ROWS
        )
        return cubic * torque**3 + quadratic * torque**2 + linear * torque + constant

    @b.Expression(m.rotors.rotor, m.time, doc="eq. (8): f_r with its floor")
    def drive_efficiency(b: Block, j: int, t: float) -> NumericExpression:
        return floored(b.efficiency_polynomial[j, t], b.efficiency_floor, EFFICIENCY_FLOOR_WIDTH)

    def electrical_power(b: Block, j: int, t: float) -> NumericExpression:
        rotors = b.parent_block().rotors
        return rotors.motor_torque[j, t] * rotors.omega[j, t] / b.drive_efficiency[j, t]

    b.add_component(
        name,
        Expression(
            m.rotors.rotor, m.time, rule=electrical_power, doc="eq. (8): shaft power over f_r [W]"
        ),
    )


def declare_motor_power_with_friction(m: ConcreteModel, name: str) -> None:
    """Declare `motor_with_friction`: v i with dry and viscous friction (Morbidi et al. 2016).

    Sound in form, and convex in alpha; the published friction constants look ten times too
    high (hover at 1.3 kW).  In thrust it is not convex: the viscous and dry parts make the
    first watt per newton the dearest.
    """
    b = m.power

    @b.Expression(m.rotors.rotor, m.time, doc="motor torque with friction [N m]")
    def torque_with_friction(b: Block, j: int, t: float) -> NumericExpression:
        m = b.parent_block()
        friction = m.vehicle.friction_torque + m.vehicle.viscous_damping * m.rotors.omega[j, t]
        return m.rotors.motor_torque[j, t] + friction

    def electrical_power(b: Block, j: int, t: float) -> NumericExpression:
        m = b.parent_block()
        current = b.torque_with_friction[j, t] / m.vehicle.torque_constant
        resistive_drop = m.vehicle.motor_resistance * current
        electromotive_force = m.rotors.omega[j, t] / m.vehicle.voltage_constant
        return (resistive_drop + electromotive_force) * current

    b.add_component(
        name,
        Expression(
            m.rotors.rotor, m.time, rule=electrical_power, doc="electrical power with friction [W]"
        ),
    )


def _declare_floor(m: ConcreteModel) -> None:
    """Declare that braking earns nothing, through a smooth floor at zero."""
    b = m.power

    @b.Expression(m.rotors.rotor, m.time, doc="eq. (8): power of one rotor [W]")
    def rotor_power(b: Block, j: int, t: float) -> NumericExpression:
        return positive_part(b.uncredited_power[j, t], b.smoothing)


_MODELS: dict[PowerModel, Callable[[ConcreteModel, str], None]] = {
    PowerModel.MOTOR: declare_motor_power,
    PowerModel.SHAFT: declare_shaft_power,
    PowerModel.CONSTANT_EFFICIENCY: declare_constant_efficiency_power,
    PowerModel.EFFICIENCY: declare_efficiency_power,
    PowerModel.MOTOR_WITH_FRICTION: declare_motor_power_with_friction,
    PowerModel.MOMENTUM: momentum.declare_momentum_power,
}
