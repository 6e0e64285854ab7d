"""The electrical power of the rotors, by one of six models.

Each model is a function that declares the power of every rotor over time [W]. Its argument `name`
is the name of this expression in block `power`. The energy of the flight is the integral over time
of the power of all rotors, eq. (8) of the paper (Yacef et al.). The paper prints eq. (8) with a
double sum: for each rotor, over the speeds of all rotors. The package uses a single sum over the
rotors.

Symbols in the table: v, i and tau are voltage, current and torque of a motor. omega is the rotor
speed, alpha the rotor acceleration. eta is a constant efficiency. f_r is the efficiency of motor
and rotor in the paper, a polynomial.

name | power of one rotor | convex in alpha | convex in thrust in steady flight
motor | v i | yes | yes
motor_with_friction | v i with friction in the torque | yes | no
shaft | tau omega | yes, linear | yes
constant_efficiency | tau omega / eta | yes | yes
efficiency | tau omega / f_r(tau, omega) | no | no
momentum | induced, profile and axial power, in moving air | yes | yes

The power of a rotor may be negative while the rotor brakes. Without regeneration
(`power.regeneration`), zero replaces a negative power, with a smooth transition. Regeneration is
the default, except for the two models with an efficiency. These divide by the efficiency, and would
return more energy than the braking rotor gives.

Alternating acceleration and braking of the rotors saves no energy, except in the model
`efficiency`: see docs/theory/bound.md, eqs. (5) and (6).

The model `momentum` consists of momentum theory, blade drag and the power of climb, all in moving
air. For its derivation and validated range see docs/theory/momentum_power.md, eqs. (1) to (6). In
the table, T is the thrust of all rotors together:

symbol | name | unit | meaning
v_i | induced_velocity | m/s | velocity that the rotors add to the air, equal for all rotors
v_a | axial_airspeed | m/s | airspeed along the thrust, positive in climb
v_p^2 | in_plane_airspeed_squared | m2/s2 | square of the airspeed across the thrust
v_h | | m/s | v_i of hover, v_h^2 = T / (2 rho A)
k_i | induced_power_factor | - | induced power over the power of an ideal rotor
c_0 | profile_power_coefficient | - | profile power in hover over T^(3/2) / sqrt(rho A)
K | profile_advance_factor | - | growth of the profile power with the square of the advance ratio
k_c, k_d | climb_power_factor, descent_power_factor | - | power over T v_a, in climb and in descent
P_e | electronics_power | W | power drawn by all but the motors
rho, A | air_density, disc_area | kg/m3, m2 | of the air and of all discs together

Induced velocity: Glauert (1926), v_i sqrt(v_p^2 + (v_a + v_i)^2) = v_h^2. In descent, the term
v_a^2 / 7.67 is added under the root. With this term, and with any term of at least v_a^2 / 8, there
is exactly one solution. The result is close to Leishman (2006), eq. (2.96), a fit to measurements
on descending rotors.

Profile power of rotor j: P_j = c_0 T_j^(3/2) / sqrt(rho A_j) (1 + K mu^2), with the thrust T_j and
disc area A_j of this rotor. In hover, the thrusts are equal, and the sum of the profile powers is
c_0 T^(3/2) / sqrt(rho A). The advance ratio is mu = v_p / (omega R), with the radius R of a rotor.
K = 4.65 is Bennett's, in Leishman (2006), section 5.4.

In the model `momentum`, accelerating a rotor of inertia I_r takes the power I_r omega alpha, which
becomes kinetic energy of the rotor, plus the copper loss R (I_r alpha / k_t)^2 in the motor. R is
the resistance and k_t the torque constant of the motor.
"""

from collections.abc import Callable
from math import pi

from pyomo.core import Block, ConcreteModel, Expression, Param, Var, sqrt, value
from pyomo.core.base.units_container import units
from pyomo.core.expr import NumericExpression, RelationalExpression

from pyomo_quad.model.parameters import (
    Parameter,
    declare_parameters,
    fields_of,
    floored,
    parameters_in,
    positive_part,
)
from pyomo_quad.model.rigid_body import thrust_axis
from pyomo_quad.scenario import Scenario
from pyomo_quad.scenario.tables import PowerModel

_TORQUE = units.N * units.m
_SPEED = units.rad / units.s
_ROWS = ("cubic", "quadratic", "linear", "constant")
_COLUMNS = ("a", "b", "c")
# Half widths over which the lower limits of torque and f_r are rounded: far below their values in
# hover, 0.0187 N m and 0.14.
TORQUE_FLOOR_WIDTH = 1e-4 * _TORQUE
EFFICIENCY_FLOOR_WIDTH = 1e-3
# Widths [W] of the smoothed corner at zero power for the first solves, before the requested width.
_WIDER_SMOOTHINGS_W = (10.0, 3.0, 1.0, 0.3)


def _efficiency_map(scenario: Scenario) -> dict[tuple[str, str], float]:
    rows = scenario.vehicle.efficiency_map  # given, or no scenario under this model is loaded
    return {
        (row, column): number
        for row in _ROWS
        for column, number in zip(_COLUMNS, getattr(rows, row), strict=True)
    }


_EFFICIENCY_MAP = Parameter(
    name="efficiency_map",
    units=units.dimensionless,
    value=_efficiency_map,
    doc="f_r: rows are powers of the torque in N m, columns of the speed in rad/s",
)
_NUMBERS: dict[PowerModel, tuple[Parameter, ...]] = {
    PowerModel.CONSTANT_EFFICIENCY: fields_of("power", "efficiency"),
    PowerModel.EFFICIENCY: (
        _EFFICIENCY_MAP,
        *fields_of("power", "torque_floor", "efficiency_floor"),
    ),
    PowerModel.MOMENTUM: (
        *fields_of("vehicle", "rotor_radius"),
        *fields_of("power", "air_density"),
        *fields_of("vehicle", "induced_power_factor"),
        *fields_of("vehicle", "profile_power_coefficient", "profile_advance_factor"),
        *fields_of("vehicle", "climb_power_factor", "descent_power_factor", "electronics_power"),
    ),
}
_SMOOTHING = "smoothing"


@parameters_in("power")
def parameters_of(scenario: Scenario) -> tuple[Parameter, ...]:
    """Return the parameters that the scenario's power model declares in block `power`.

    If `power.regeneration` is false, every model has the parameter `smoothing` [W] in this block.
    The models `motor`, `motor_with_friction` and `shaft` have no other parameter in this block, and
    use parameters of block `vehicle`.
    """
    guard = () if scenario.power.regeneration else fields_of("power", _SMOOTHING)
    return (*_NUMBERS.get(scenario.power.model, ()), *guard)


def wider_smoothings(scenario: Scenario) -> tuple[dict[str, float], ...]:
    """Return parameter values that smooth a rotor's power at zero over larger widths [W].

    The widest comes first; all exceed twice the scenario's own width. The solution with one width
    is the initial guess for the next. With regeneration, the result is empty.
    """
    if scenario.power.regeneration:
        return ()
    own = scenario.power.smoothing
    # The kink of max(P, 0) is rounded over the width. A solve with a large width converges easily.
    return tuple({f"power.{_SMOOTHING}": w} for w in _WIDER_SMOOTHINGS_W if w > 2.0 * own)


def declare_power(m: ConcreteModel, scenario: Scenario) -> None:
    """Declare the power of each rotor and the total power in block `power`.

    The scenario selects the power model, and whether braking rotors return energy. `m` already
    declares `time`, `vehicle` and `rotors` and, for the power model `momentum`, `rigid_body` and
    the airspeeds of block `aerodynamics`.
    """
    b = m.power = Block(doc="power, Yacef et al., eq. (8)")
    declare_parameters(b, scenario)
    if scenario.power.regeneration:
        _MODELS[scenario.power.model](m, "rotor_power")
    else:
        _MODELS[scenario.power.model](m, "uncredited_power")
        _declare_floor(m)

    @b.Expression(m.time, doc="Yacef et al., eq. (8): power of the four rotors [W]")
    def total(b: Block, t: float) -> NumericExpression:
        of_rotors = sum(b.rotor_power[j, t] for j in b.parent_block().rotors.rotor)
        if scenario.power.model is PowerModel.MOMENTUM:
            return of_rotors + b.electronics_power
        return of_rotors


def declare_error(m: ConcreteModel) -> None:
    """Multiply the total power by 1 + `power.error`, where the error is a mutable parameter.

    The error is initially zero; simulated flights set it to random values. No component may refer
    to `power.total` yet, because this expression is replaced.
    """
    b = m.power
    b.error = Param(initialize=0.0, mutable=True, doc="relative error of the modelled power")
    modelled = b.total
    b.del_component(modelled)
    b.modelled_total = modelled

    @b.Expression(m.time, doc="Yacef et al., eq. (8): power of the four rotors, with its error [W]")
    def total(b: Block, t: float) -> NumericExpression:
        return (1 + b.error) * b.modelled_total[t]


_RotorRule = Callable[[Block, int, float], NumericExpression]


def _power_of_each_rotor(
    m: ConcreteModel, name: str, *, doc: str
) -> Callable[[_RotorRule], _RotorRule]:
    """Return a decorator that adds the power of each rotor, `power.<name>` [W], to the model `m`.

    The decorated Pyomo rule takes the block `power`, the rotor's number and the time.
    """

    def declare(rule: _RotorRule) -> _RotorRule:
        m.power.add_component(name, Expression(m.rotors.rotor, m.time, rule=rule, doc=doc))
        return rule

    return declare


def declare_motor_power(m: ConcreteModel, name: str) -> None:
    """Declare the power model `motor`: terminal voltage times current of each motor.

    Both follow eqs. (2) and (3) of Yacef et al. With regeneration, a braking rotor returns its
    shaft power less the copper loss. The drag torque of a rotor is `drag_torque_coefficient` times
    omega^2. There is no separate term for the profile drag of the blades.
    """
    b = m.power

    @b.Expression(m.rotors.rotor, m.time, doc="voltage that the pack must give a motor [V]")
    def terminal_voltage(b: Block, j: int, t: float) -> NumericExpression:
        return b.parent_block().rotors.motor_voltage[j, t]

    # Convex in the rotor acceleration and in thrust, because the copper loss grows with the square
    # of the torque; see docs/theory/bound.md, eq. (5).
    # The equations are valid at all speeds and torques.
    @_power_of_each_rotor(m, name, doc="Yacef et al., eq. (2)-(3): electrical power v i [W]")
    def electrical_power(b: Block, j: int, t: float) -> NumericExpression:
        rotors = b.parent_block().rotors
        return rotors.motor_voltage[j, t] * rotors.motor_current[j, t]


def declare_shaft_power(m: ConcreteModel, name: str) -> None:
    """Declare the power model `shaft`: mechanical power of each rotor, torque times speed.

    Motor and converter have no loss. With regeneration, a braking rotor returns its full shaft
    power.
    """

    # Convex in thrust (exponent 3/2). For a driven rotor, it is a lower bound of the power by a
    # model with an efficiency and, if the motor constants have k_t k_v = 1, by the motor models.
    # Linear in the rotor acceleration, which must therefore be bounded.
    @_power_of_each_rotor(m, name, doc="Yacef et al., eq. (8) with f_r = 1: shaft power [W]")
    def electrical_power(b: Block, j: int, t: float) -> NumericExpression:
        rotors = b.parent_block().rotors
        return rotors.motor_torque[j, t] * rotors.omega[j, t]


def declare_constant_efficiency_power(m: ConcreteModel, name: str) -> None:
    """Declare the power model `constant_efficiency`: shaft power divided by a constant efficiency.

    The model is valid near the operating point at which the efficiency was measured. The power is
    convex in the rotor acceleration and in thrust. Without regeneration, it is never negative.
    """

    @_power_of_each_rotor(m, name, doc="Yacef et al., eq. (8) with constant f_r [W]")
    def electrical_power(b: Block, j: int, t: float) -> NumericExpression:
        rotors = b.parent_block().rotors
        return rotors.motor_torque[j, t] * rotors.omega[j, t] / b.efficiency


def declare_efficiency_power(m: ConcreteModel, name: str) -> None:
    """Declare the power model `efficiency`: shaft power divided by f_r(tau, omega), eq. (8).

    f_r is the polynomial of Yacef et al., recovered from two public re-implementations. tau and f_r
    have the smooth lower limits `torque_floor` and `efficiency_floor`.
    """
    b = m.power

    # Below some 780 rad/s, f_r is zero at moderate braking torques. The lower limits of torque and
    # f_r avoid the poles of the power there.
    @b.Expression(m.rotors.rotor, m.time, doc="torque at which f_r is read [N m]")
    def map_torque(b: Block, j: int, t: float) -> NumericExpression:
        torque = b.parent_block().rotors.motor_torque[j, t]
        return floored(torque, b.torque_floor, TORQUE_FLOOR_WIDTH)

    @b.Expression(
        m.rotors.rotor, m.time, doc="Yacef et al., eq. (8): efficiency function f_r as recovered"
    )
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

    @b.Expression(m.rotors.rotor, m.time, doc="Yacef et al., eq. (8): f_r with its floor")
    def drive_efficiency(b: Block, j: int, t: float) -> NumericExpression:
        return floored(b.efficiency_polynomial[j, t], b.efficiency_floor, EFFICIENCY_FLOOR_WIDTH)

    # Not convex in the rotor acceleration: below 858 rad/s, a rotor that alternates between
    # acceleration and coasting takes less energy than at constant speed. The bound on the
    # acceleration limits the amplitude of the alternation, and the mesh limits its frequency.
    @_power_of_each_rotor(m, name, doc="Yacef et al., eq. (8): shaft power over f_r [W]")
    def electrical_power(b: Block, j: int, t: float) -> NumericExpression:
        rotors = b.parent_block().rotors
        return rotors.motor_torque[j, t] * rotors.omega[j, t] / b.drive_efficiency[j, t]


def declare_motor_power_with_friction(m: ConcreteModel, name: str) -> None:
    """Declare the power model `motor_with_friction`: voltage times current of each motor.

    The motor's torque includes dry and viscous friction, as in Morbidi et al. (2016). Because of
    the friction, the power is concave in thrust at small thrust.
    """
    b = m.power

    @b.Expression(m.rotors.rotor, m.time, doc="motor torque with friction [N m]")
    def torque_with_friction(b: Block, j: int, t: float) -> NumericExpression:
        m = b.parent_block()
        # The published constants seem ten times too high: with them, hover takes 1.3 kW.
        friction = m.vehicle.friction_torque + m.vehicle.viscous_damping * m.rotors.omega[j, t]
        return m.rotors.motor_torque[j, t] + friction

    @b.Expression(m.rotors.rotor, m.time, doc="motor current with friction [A]")
    def current_with_friction(b: Block, j: int, t: float) -> NumericExpression:
        return b.torque_with_friction[j, t] / b.parent_block().vehicle.torque_constant

    @b.Expression(m.rotors.rotor, m.time, doc="voltage that the pack must give a motor [V]")
    def terminal_voltage(b: Block, j: int, t: float) -> NumericExpression:
        m = b.parent_block()
        resistive_drop = m.vehicle.motor_resistance * b.current_with_friction[j, t]
        electromotive_force = m.rotors.omega[j, t] / m.vehicle.voltage_constant
        return resistive_drop + electromotive_force

    @_power_of_each_rotor(m, name, doc="electrical power with friction [W]")
    def electrical_power(b: Block, j: int, t: float) -> NumericExpression:
        return b.terminal_voltage[j, t] * b.current_with_friction[j, t]


def _declare_floor(m: ConcreteModel) -> None:
    """Declare the power of each rotor as a smooth max(P, 0), for a mission without regeneration.

    P is the expression `uncredited_power` in block `power`.
    """
    b = m.power

    @b.Expression(m.rotors.rotor, m.time, doc="Yacef et al., eq. (8): power of one rotor [W]")
    def rotor_power(b: Block, j: int, t: float) -> NumericExpression:
        return positive_part(b.uncredited_power[j, t], b.smoothing)


_VELOCITY = units.m / units.s
# Widths over which the norm of an airspeed, and the climb and descent factors, are rounded at zero.
_AIRSPEED_WIDTH = 1e-2 * _VELOCITY
_AXIAL_WIDTH = 0.5 * _VELOCITY
# tau of docs/theory/momentum_power.md, eqs. (2) and (3).
WAKE_FACTOR = 1 / 7.67
# Upper bound on the induced velocity in the solver, relative to that of hover.
_FASTEST_INDUCED = 20.0


def declare_momentum_power(m: ConcreteModel, name: str) -> None:
    """Declare the power model `momentum`: induced, profile, climb and rotor-acceleration power.

    The model is valid in hover, climb, forward flight and slow descent. The power is convex in the
    rotor acceleration and in thrust. The docstring of this module has the equations.
    """
    b = m.power
    b.disc_area = Expression(
        expr=len(m.rotors.rotor) * pi * b.rotor_radius**2, doc="A: of all discs [m2]"
    )
    _declare_airspeeds(b, m)
    _declare_induced_velocity(b, m)
    _declare_profile(b, m)

    @b.Expression(m.time, doc="power over thrust of moving along the axis [m/s]")
    def axial_power_over_thrust(b: Block, t: float) -> NumericExpression:
        along = b.axial_airspeed[t]
        climbing = (1 + along / sqrt(along**2 + _AXIAL_WIDTH**2)) / 2
        factor = b.descent_power_factor + (b.climb_power_factor - b.descent_power_factor) * climbing
        return factor * along

    @b.Expression(m.rotors.rotor, m.time, doc="power that accelerates the drum [W]")
    def acceleration_power(b: Block, j: int, t: float) -> NumericExpression:
        vehicle, rotors = b.parent_block().vehicle, b.parent_block().rotors
        torque = vehicle.rotor_inertia * rotors.alpha[j, t]
        copper_loss = vehicle.motor_resistance * (torque / vehicle.torque_constant) ** 2
        return torque * rotors.omega[j, t] + copper_loss

    @_power_of_each_rotor(m, name, doc="induced, profile, axial and acceleration power [W]")
    def electrical_power(b: Block, j: int, t: float) -> NumericExpression:
        thrust = b.rotor_thrust[j, t]
        induced = b.induced_power_factor * thrust * b.induced_velocity[t]
        axial = thrust * b.axial_power_over_thrust[t]
        return induced + b.profile_power[j, t] + axial + b.acceleration_power[j, t]


def _declare_airspeeds(b: Block, m: ConcreteModel) -> None:
    @b.Expression(m.time, doc="airspeed along the thrust, positive in climb [m/s]")
    def axial_airspeed(b: Block, t: float) -> NumericExpression:
        m = b.parent_block()
        along_x, along_y, along_z = thrust_axis(m.rigid_body, t)
        air = m.aerodynamics
        return (
            along_x * air.airspeed_x[t] + along_y * air.airspeed_y[t] + along_z * air.airspeed_z[t]
        )

    @b.Expression(m.time, doc="square of the airspeed across the thrust [m2/s2]")
    def in_plane_airspeed_squared(b: Block, t: float) -> NumericExpression:
        air = b.parent_block().aerodynamics
        squared = air.airspeed_x[t] ** 2 + air.airspeed_y[t] ** 2 + air.airspeed_z[t] ** 2
        return squared - b.axial_airspeed[t] ** 2


def _declare_induced_velocity(b: Block, m: ConcreteModel) -> None:
    hovering = sqrt(m.vehicle.mass * m.vehicle.gravity / (2 * b.air_density * b.disc_area))
    in_hover = value(hovering)
    b.fastest_induced_velocity = Param(
        initialize=_FASTEST_INDUCED * in_hover,
        mutable=True,
        units=_VELOCITY,
        doc="upper bound of v_i in the solver",
    )
    b.induced_velocity = Var(
        m.time,
        units=_VELOCITY,
        bounds=(0.0, b.fastest_induced_velocity),
        initialize=in_hover,
        doc="v_i: velocity that the rotors add to the air",
    )
    m.scaling_factor[b.induced_velocity] = 1.0 / in_hover

    @b.Constraint(m.time, doc="Glauert: thrust is mass flow times 2 v_i; divided by hover thrust")
    def induced_velocity_balance(b: Block, t: float) -> RelationalExpression:
        m = b.parent_block()
        induced, along = b.induced_velocity[t], b.axial_airspeed[t]
        sinking = positive_part(-along, _AIRSPEED_WIDTH)
        through_disc = sqrt(
            b.in_plane_airspeed_squared[t]
            + (along + induced) ** 2
            + WAKE_FACTOR * sinking**2
            + _AIRSPEED_WIDTH**2
        )
        momentum = 2 * b.air_density * b.disc_area * through_disc * induced
        weight = m.vehicle.mass * m.vehicle.gravity
        return momentum / weight == m.rotors.total_thrust[t] / weight


def _declare_profile(b: Block, m: ConcreteModel) -> None:
    @b.Expression(m.rotors.rotor, m.time, doc="thrust of one rotor [N]")
    def rotor_thrust(b: Block, j: int, t: float) -> NumericExpression:
        m = b.parent_block()
        return m.vehicle.thrust_coefficient * m.rotors.omega[j, t] ** 2

    @b.Expression(m.rotors.rotor, m.time, doc="profile power of one rotor [W]")
    def profile_power(b: Block, j: int, t: float) -> NumericExpression:
        m = b.parent_block()
        speed = m.rotors.omega[j, t]
        area = b.disc_area / len(m.rotors.rotor)
        # T^(3/2) / sqrt(rho A), with the thrust in terms of the rotor speed, which may be zero.
        at_rest_in_air = sqrt(m.vehicle.thrust_coefficient**3 / (b.air_density * area)) * speed
        advance = b.profile_advance_factor * b.in_plane_airspeed_squared[t] / b.rotor_radius**2
        return b.profile_power_coefficient * at_rest_in_air * (speed**2 + advance)


_MODELS: dict[PowerModel, Callable[[ConcreteModel, str], None]] = {
    PowerModel.MOTOR: declare_motor_power,
    PowerModel.SHAFT: declare_shaft_power,
    PowerModel.CONSTANT_EFFICIENCY: declare_constant_efficiency_power,
    PowerModel.EFFICIENCY: declare_efficiency_power,
    PowerModel.MOTOR_WITH_FRICTION: declare_motor_power_with_friction,
    PowerModel.MOMENTUM: declare_momentum_power,
}
