"""The four rotors and their brushless motors, eq. (1)-(3) and (7), as direct-current motors."""

from pyomo.core.expr import NumericExpression, RelationalExpression
from pyomo.dae import DerivativeVar
from pyomo.environ import Block, ConcreteModel, Set, Var, units

from pyomo_quad.scenario import Scenario
from pyomo_quad.scenario.vehicle import ROTOR_COUNT, Attitude


def declare_motors(m: ConcreteModel) -> None:
    """Declare torque, current and voltage of each motor in block `rotors`.

    Parameters
    ----------
    m : ConcreteModel
        With `time`, `vehicle` and the speeds and accelerations of `rotors`.
    """
    b = m.rotors

    @b.Expression(b.rotor, m.time, doc="eq. (1) row 1: motor torque [N m]")
    def motor_torque(b: Block, j: int, t: float) -> NumericExpression:
        vehicle = b.parent_block().vehicle
        propeller_drag = vehicle.drag_torque_coefficient * b.omega[j, t] ** 2
        return vehicle.rotor_inertia * b.alpha[j, t] + propeller_drag

    @b.Expression(b.rotor, m.time, doc="eq. (2): motor current [A]")
    def motor_current(b: Block, j: int, t: float) -> NumericExpression:
        return b.motor_torque[j, t] / b.parent_block().vehicle.torque_constant

    @b.Expression(b.rotor, m.time, doc="eq. (3) row 2: motor voltage [V]")
    def motor_voltage(b: Block, j: int, t: float) -> NumericExpression:
        vehicle = b.parent_block().vehicle
        resistive_drop = vehicle.motor_resistance * b.motor_current[j, t]
        electromotive_force = b.omega[j, t] / vehicle.voltage_constant
        return resistive_drop + electromotive_force


_NOMINAL_ACCELERATION = 10.0


def declare_rotors(m: ConcreteModel, scenario: Scenario) -> None:
    """Declare rotor states, controls and the mixer in block `rotors`.

    Parameters
    ----------
    m : ConcreteModel
        With `time`, `vehicle` and `scaling_factor`.
    """
    b = m.rotors = Block(doc="rotors, eq. (7) and (9)")
    b.rotor = Set(initialize=range(1, ROTOR_COUNT + 1), doc="rotors as the paper numbers them")
    _declare_speeds(b, m, scenario)
    _declare_mixer(b, m)
    if scenario.vehicle.attitude is Attitude.EULER:
        _declare_yaw_reaction(b, m)


def _declare_speeds(b: Block, m: ConcreteModel, scenario: Scenario) -> None:
    speed, acceleration = units.rad / units.s, units.rad / units.s**2
    hover_speed = scenario.vehicle.hover_speed(scenario.gravity)
    b.omega = Var(b.rotor, m.time, units=speed, initialize=hover_speed, doc="rotor speed")
    b.domega_dt = DerivativeVar(b.omega, wrt=m.time, units=acceleration, initialize=0.0)
    b.alpha = Var(b.rotor, m.time, units=acceleration, initialize=0.0, doc="rotor acceleration")
    m.scaling_factor[b.omega] = 1.0 / hover_speed
    m.scaling_factor[b.alpha] = 1.0 / _NOMINAL_ACCELERATION

    @b.Constraint(b.rotor, m.time, doc="eq. (9) row 5: rotor acceleration [rad/s^2]")
    def rotor_kinematics(b: Block, j: int, t: float) -> RelationalExpression:
        return b.domega_dt[j, t] == b.alpha[j, t]


def _declare_mixer(b: Block, m: ConcreteModel) -> None:
    @b.Expression(m.time, doc="eq. (7) row 1: u_1 [N]")
    def total_thrust(b: Block, t: float) -> NumericExpression:
        kb = b.parent_block().vehicle.thrust_coefficient
        return kb * sum(b.omega[j, t] ** 2 for j in b.rotor)

    @b.Expression(m.time, doc="eq. (7) row 2: u_2 [N m]")
    def roll_moment(b: Block, t: float) -> NumericExpression:
        vehicle = b.parent_block().vehicle
        thrust_difference = vehicle.thrust_coefficient * (b.omega[2, t] ** 2 - b.omega[4, t] ** 2)
        return vehicle.arm_length * thrust_difference

    @b.Expression(m.time, doc="eq. (7) row 3: u_3 [N m]")
    def pitch_moment(b: Block, t: float) -> NumericExpression:
        vehicle = b.parent_block().vehicle
        thrust_difference = vehicle.thrust_coefficient * (b.omega[3, t] ** 2 - b.omega[1, t] ** 2)
        return vehicle.arm_length * thrust_difference

    @b.Expression(m.time, doc="eq. (7) row 4: u_4 [N m]")
    def yaw_moment(b: Block, t: float) -> NumericExpression:
        kappa = b.parent_block().vehicle.drag_torque_coefficient
        return kappa * (
            b.omega[1, t] ** 2 - b.omega[2, t] ** 2 + b.omega[3, t] ** 2 - b.omega[4, t] ** 2
        )

    @b.Expression(m.time, doc="eq. (6): speed imbalance of the rotors [rad/s]")
    def speed_imbalance(b: Block, t: float) -> NumericExpression:
        return b.omega[1, t] - b.omega[2, t] + b.omega[3, t] - b.omega[4, t]


def _declare_yaw_reaction(b: Block, m: ConcreteModel) -> None:
    @b.Expression(m.time, doc="moment on the body of rotors that gather speed [N m]")
    def yaw_reaction(b: Block, t: float) -> NumericExpression:
        gathering = b.alpha[1, t] - b.alpha[2, t] + b.alpha[3, t] - b.alpha[4, t]
        return b.parent_block().vehicle.rotor_inertia * gathering
