"""Parameters of the vehicle: mass, geometry, inertia, rotors and motors.

symbol | name | unit | meaning
m | mass | kg | vehicle and payload
g | gravity | m/s2 | 9.81, as in the paper of Yacef et al.
l | arm_length | m | centre of mass to rotor shaft
I_x, I_y, I_z | Ix, Iy, Iz | kg m2 | moments of inertia about the body axes
kappa_b | thrust_coefficient | N s2 | thrust over rotor speed squared
kappa | drag_torque_coefficient | N m s2 | drag torque over rotor speed squared
I_r | rotor_inertia | kg m2 | motor and propeller
k_t | torque_constant | N m/A | torque over current
k_v | voltage_constant | rad/s/V | speed over voltage
R | motor_resistance | ohm | winding
T_f, D_f | friction_torque, viscous_damping | N m, N m s | only in the power model with friction
"""

from pyomo.core import Block, ConcreteModel, Param
from pyomo.core.base.units_container import units
from pyomo.core.expr import NumericExpression

from pyomo_quad.model.parameters import (
    Parameter,
    declare_parameters,
    fields_of,
    parameters_in,
)
from pyomo_quad.scenario import Scenario

_PARAMETERS = (
    Parameter(
        name="mass",
        units=units.kg,
        value=lambda s: s.vehicle.total_mass,
        doc="m: vehicle and payload",
    ),
    *fields_of("", "gravity"),
    *fields_of("vehicle", "arm_length", "Ix", "Iy", "Iz"),
    *fields_of("vehicle", "thrust_coefficient", "drag_torque_coefficient", "rotor_inertia"),
    *fields_of("vehicle", "torque_constant", "voltage_constant", "motor_resistance"),
    *fields_of("vehicle", "friction_torque", "viscous_damping"),
    *fields_of("vehicle", "drag_linear", "drag_quadratic"),
    Parameter(
        name="released",
        units=units.kg,
        value=lambda s: {k: s.mission.waypoints[k].release for k in _loads(s)},
        doc="payload released at a waypoint",
    ),
)


@parameters_in("vehicle")
def parameters_of(_scenario: Scenario) -> tuple[Parameter, ...]:
    """Return the parameters of block `vehicle`, including the payloads released at waypoints.

    Each parameter holds a function that computes its value from a scenario. The argument
    `_scenario` is therefore not used.
    """
    return _PARAMETERS


def declare_vehicle(m: ConcreteModel, scenario: Scenario) -> None:
    """Declare the vehicle's parameters and the releases of payloads in block `vehicle`.

    If payloads are released, the parameter `is_left[waypoint, time]` is 0 until the vehicle leaves
    the waypoint, and 1 afterwards.
    """
    m.vehicle = Block(doc="numbers of the vehicle")
    declare_parameters(m.vehicle, scenario)
    loads, times = _loads(scenario), scenario.nominal_times
    if loads:
        left = {k: times[2 * k + 1] for k in loads}

        def is_left(_: Block, k: int, t: float) -> float:
            return float(t > left[k])

        m.vehicle.is_left = Param(
            loads, m.time, rule=is_left, doc="1 once the payload is released, else 0"
        )


def _loads(scenario: Scenario) -> tuple[int, ...]:
    """Return the indices, from 0, of the waypoints at which a payload is released."""
    return tuple(k for k, waypoint in enumerate(scenario.mission.waypoints) if waypoint.release > 0)


def mass_at(m: ConcreteModel, t: float) -> NumericExpression:
    """Return the mass of vehicle and payload at a time in flight [kg].

    Payloads that have been released before this time are subtracted. `m` is the mission's model,
    and `t` the time in flight [s].
    """
    b = m.vehicle
    if b.component("released") is None:
        return b.mass
    return b.mass - sum(b.released[k] * b.is_left[k, t] for k in b.released)
