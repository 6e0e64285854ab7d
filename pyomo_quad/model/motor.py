"""The brushless motors as direct-current motors, eq. (1)-(3).

symbol | name | unit | meaning
tau_j | motor_torque[j] | N m | torque of motor j, eq. (1) solved for it
i_j | motor_current[j] | A | eq. (2)
v_j | motor_voltage[j] | V | eq. (3)

Assumptions: the inductance is neglected, as the paper does between eq. (1) and (3); no
friction besides the propeller's drag torque.
"""

from pyomo.core.expr import NumericExpression
from pyomo.environ import Block, ConcreteModel

__all__ = ["declare_motors"]


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
