"""The rotors and their brushless motors, eq. (1)-(3) and (7) of Yacef et al.

The motors are modelled as direct-current motors.
"""

from collections.abc import Callable, Iterable

from pyomo.core import Block, ConcreteModel, Set, Var
from pyomo.core.base.units_container import units
from pyomo.core.expr import NumericExpression, RelationalExpression
from pyomo.dae import DerivativeVar

from pyomo_quad.model.parameters import Parameter, declare_parameters, parameters_in
from pyomo_quad.scenario import Scenario
from pyomo_quad.scenario.vehicle import Attitude


def _numbers(scenario: Scenario) -> tuple[int, ...]:
    """Return the numbers of a scenario's rotors, 1 to n, which index the rotors in the model."""
    return tuple(range(1, len(scenario.vehicle.rotor_places) + 1))


def _by_rotor(
    read: Callable[[Scenario], Iterable[float]],
) -> Callable[[Scenario], dict[int, float]]:
    return lambda scenario: dict(zip(_numbers(scenario), read(scenario), strict=True))


@parameters_in("rotors")
def parameters_of(scenario: Scenario) -> tuple[Parameter, ...]:
    """Return the model parameters for positions and directions of rotation of the rotors.

    The standard cross of eq. (7) of Yacef et al. has none, except for the positions if rotor drag
    or translational lift depends on them. Any other layout has both.
    """
    vehicle = scenario.vehicle
    ahead = Parameter(
        name="ahead",
        units=units.m,
        value=_by_rotor(lambda s: (x for x, _ in s.vehicle.rotor_places)),
        doc="X: place of a rotor along body x",
    )
    aside = Parameter(
        name="aside",
        units=units.m,
        value=_by_rotor(lambda s: (y for _, y in s.vehicle.rotor_places)),
        doc="Y: place of a rotor along body y",
    )
    sense = Parameter(
        name="sense",
        units=units.dimensionless,
        value=_by_rotor(lambda s: s.vehicle.rotor_senses),
        doc="s: sense in which the drag of a rotor turns the body, 1 or -1",
    )
    has_places = vehicle.has_own_rotors or vehicle.has_rotor_forces
    return (*((ahead, aside) if has_places else ()), *((sense,) if vehicle.has_own_rotors else ()))


def declare_motors(m: ConcreteModel, scenario: Scenario) -> None:
    """Declare the torque of each motor and, if the motor constants are known, current and voltage.

    Torque [N m], current [A] and voltage [V] are expressions over rotors and time in block
    `rotors`. The vehicle's table `motor`, if given, has the motor constants.
    """
    b = m.rotors

    @b.Expression(b.rotor, m.time, doc="Yacef et al., eq. (1) row 1: motor torque [N m]")
    def motor_torque(b: Block, j: int, t: float) -> NumericExpression:
        vehicle = b.parent_block().vehicle
        propeller_drag = vehicle.drag_torque_coefficient * b.omega[j, t] ** 2
        return vehicle.rotor_inertia * b.alpha[j, t] + propeller_drag

    if scenario.vehicle.motor is None:
        return

    @b.Expression(b.rotor, m.time, doc="Yacef et al., eq. (2): motor current [A]")
    def motor_current(b: Block, j: int, t: float) -> NumericExpression:
        return b.motor_torque[j, t] / b.parent_block().vehicle.torque_constant

    @b.Expression(b.rotor, m.time, doc="Yacef et al., eq. (3) row 2: motor voltage [V]")
    def motor_voltage(b: Block, j: int, t: float) -> NumericExpression:
        vehicle = b.parent_block().vehicle
        resistive_drop = vehicle.motor_resistance * b.motor_current[j, t]
        electromotive_force = b.omega[j, t] / vehicle.voltage_constant
        return resistive_drop + electromotive_force


# Usual rotor acceleration [rad/s^2] when a flight changes its attitude. Ipopt regularises in units
# of the magnitudes: at a magnitude of 10, regularised steps hardly moved the accelerations, and
# solves between waypoints and zones crept for a hundred iterations; see docs/decisions/speed.md.
_NOMINAL_ACCELERATION = 1e3


def declare_rotors(m: ConcreteModel, scenario: Scenario) -> None:
    """Declare rotor speeds, their accelerations and the mixer in block `rotors`.

    Speeds are states, and accelerations are controls. The mixer consists of total thrust [N],
    moments about the body axes [N m], and speed imbalance [rad/s]. The imbalance is the sum of the
    rotor speeds, signed by the direction of rotation.
    """
    b = m.rotors = Block(doc="rotors, Yacef et al., eqs. (7) and (9)")
    b.rotor = Set(initialize=_numbers(scenario), doc="rotors as the paper numbers them")
    _declare_speeds(b, m, scenario)
    declare_parameters(b, scenario)
    if scenario.vehicle.has_own_rotors:
        _declare_mixer_of_places(b, m)
    else:
        _declare_mixer(b, m)
    if scenario.vehicle.attitude is Attitude.EULER:
        # Moment of accelerating rotors on the body [N m], which the attitude "paper" omits.
        _declare_yaw_reaction(b, m, scenario.vehicle.rotor_senses)


def _declare_speeds(b: Block, m: ConcreteModel, scenario: Scenario) -> None:
    speed, acceleration = units.rad / units.s, units.rad / units.s**2
    hover_speed = scenario.vehicle.hover_speed(scenario.gravity)
    b.omega = Var(b.rotor, m.time, units=speed, initialize=hover_speed, doc="rotor speed")
    b.domega_dt = DerivativeVar(b.omega, wrt=m.time, units=acceleration, initialize=0.0)
    b.alpha = Var(b.rotor, m.time, units=acceleration, initialize=0.0, doc="rotor acceleration")
    m.scaling_factor[b.omega] = 1.0 / hover_speed
    m.scaling_factor[b.alpha] = 1.0 / _NOMINAL_ACCELERATION

    @b.Constraint(b.rotor, m.time, doc="Yacef et al., eq. (9) row 5: rotor acceleration [rad/s^2]")
    def rotor_kinematics(b: Block, j: int, t: float) -> RelationalExpression:
        return b.domega_dt[j, t] == b.alpha[j, t]


def _declare_mixer(b: Block, m: ConcreteModel) -> None:
    @b.Expression(m.time, doc="Yacef et al., eq. (7) row 1: u_1 [N]")
    def total_thrust(b: Block, t: float) -> NumericExpression:
        kb = b.parent_block().vehicle.thrust_coefficient
        return kb * sum(b.omega[j, t] ** 2 for j in b.rotor)

    @b.Expression(m.time, doc="Yacef et al., eq. (7) row 2: u_2 [N m]")
    def roll_moment(b: Block, t: float) -> NumericExpression:
        vehicle = b.parent_block().vehicle
        thrust_difference = vehicle.thrust_coefficient * (b.omega[2, t] ** 2 - b.omega[4, t] ** 2)
        return vehicle.arm_length * thrust_difference

    @b.Expression(m.time, doc="Yacef et al., eq. (7) row 3: u_3 [N m]")
    def pitch_moment(b: Block, t: float) -> NumericExpression:
        vehicle = b.parent_block().vehicle
        thrust_difference = vehicle.thrust_coefficient * (b.omega[3, t] ** 2 - b.omega[1, t] ** 2)
        return vehicle.arm_length * thrust_difference

    @b.Expression(m.time, doc="Yacef et al., eq. (7) row 4: u_4 [N m]")
    def yaw_moment(b: Block, t: float) -> NumericExpression:
        kappa = b.parent_block().vehicle.drag_torque_coefficient
        return kappa * (
            b.omega[1, t] ** 2 - b.omega[2, t] ** 2 + b.omega[3, t] ** 2 - b.omega[4, t] ** 2
        )

    @b.Expression(m.time, doc="Yacef et al., eq. (6): speed imbalance of the rotors [rad/s]")
    def speed_imbalance(b: Block, t: float) -> NumericExpression:
        return b.omega[1, t] - b.omega[2, t] + b.omega[3, t] - b.omega[4, t]


def _declare_mixer_of_places(b: Block, m: ConcreteModel) -> None:
    """Declare thrust, moments and speed imbalance for any planar rotor layout.

    The imbalance, the sum of rotor speeds signed by the direction of rotation, causes a gyroscopic
    moment. For a standard cross, the results equal eqs. (6) and (7) of Yacef et al.
    """

    @b.Expression(b.rotor, m.time, doc="thrust of one rotor [N]")
    def rotor_thrust(b: Block, j: int, t: float) -> NumericExpression:
        return b.parent_block().vehicle.thrust_coefficient * b.omega[j, t] ** 2

    @b.Expression(m.time, doc="total thrust [N]")
    def total_thrust(b: Block, t: float) -> NumericExpression:
        return sum(b.rotor_thrust[j, t] for j in b.rotor)

    @b.Expression(m.time, doc="roll moment of the rotors [N m]")
    def roll_moment(b: Block, t: float) -> NumericExpression:
        return sum(b.aside[j] * b.rotor_thrust[j, t] for j in b.rotor)

    @b.Expression(m.time, doc="pitch moment of the rotors [N m]")
    def pitch_moment(b: Block, t: float) -> NumericExpression:
        return -sum(b.ahead[j] * b.rotor_thrust[j, t] for j in b.rotor)

    @b.Expression(m.time, doc="yaw moment of the rotors [N m]")
    def yaw_moment(b: Block, t: float) -> NumericExpression:
        kappa = b.parent_block().vehicle.drag_torque_coefficient
        return kappa * sum(b.sense[j] * b.omega[j, t] ** 2 for j in b.rotor)

    @b.Expression(m.time, doc="speed imbalance of the rotors [rad/s]")
    def speed_imbalance(b: Block, t: float) -> NumericExpression:
        return sum(b.sense[j] * b.omega[j, t] for j in b.rotor)


def _declare_yaw_reaction(b: Block, m: ConcreteModel, senses: tuple[int, ...]) -> None:
    @b.Expression(m.time, doc="moment on the body of rotors that gather speed [N m]")
    def yaw_reaction(b: Block, t: float) -> NumericExpression:
        gathering = sum(
            b.alpha[j, t] if sense > 0 else -b.alpha[j, t]
            for j, sense in zip(b.rotor, senses, strict=True)
        )
        return b.parent_block().vehicle.rotor_inertia * gathering
