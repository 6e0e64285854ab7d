"""The four rotors: speeds as states, accelerations as controls, and the mixer.

symbol | name | unit | meaning
omega_j | omega[j] | rad/s | speed of rotor j, numbered from 1 as in the paper
alpha_j | alpha[j] | rad/s2 | acceleration of rotor j, the control, eq. (9)
u_1 | total_thrust | N | eq. (7)
u_2, u_3, u_4 | roll_moment, pitch_moment, yaw_moment | N m | eq. (7)
varpi | speed_imbalance | rad/s | omega_1 - omega_2 + omega_3 - omega_4, eq. (6)

Assumption: thrust and drag torque are those of hover, kappa_b omega^2 and kappa omega^2,
whatever the airspeed.
"""

from pyomo.core.expr import NumericExpression, RelationalExpression
from pyomo.dae import DerivativeVar
from pyomo.environ import Block, ConcreteModel, Set, Var, units

from pyomo_quad.scenario import Scenario
from pyomo_quad.scenario.vehicle import ROTOR_COUNT

__all__ = ["declare_rotors"]

_NOMINAL_ACCELERATION = 10.0


def declare_rotors(m: ConcreteModel, scenario: Scenario) -> None:
    """Declare rotor states, controls and the mixer in block `rotors`.

    Parameters
    ----------
    m : ConcreteModel
        With `time`, `vehicle` and `scaling_factor`.
    scenario : Scenario
        Its hover speed is the initial value and the magnitude for scaling.
    """
    b = m.rotors = Block(doc="rotors, eq. (7) and (9)")
    b.rotor = Set(initialize=range(1, ROTOR_COUNT + 1), doc="rotors as the paper numbers them")
    _declare_speeds(b, m, scenario)
    _declare_mixer(b, m)


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
