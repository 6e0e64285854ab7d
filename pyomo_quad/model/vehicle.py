"""Numbers of the vehicle: airframe, rotors and motors.

symbol | name | unit | meaning
m | mass | kg | vehicle and payload
g | gravity | m/s2 | the paper's 9.81
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

from collections.abc import Callable

from pyomo.core import Block, ConcreteModel, Param
from pyomo.core.base.units_container import units
from pyomo.core.expr import NumericExpression

from pyomo_quad.model.parameters import Parameter, declare_parameters
from pyomo_quad.scenario import Scenario

_INERTIA = units.kg * units.m**2
_TORQUE = units.N * units.m


def _known(name: str) -> Callable[[Scenario], float]:
    """Return the reader of a number that is declared where the vehicle's file gives it."""
    return lambda scenario: getattr(scenario.vehicle, name)


_PARAMETERS = (
    Parameter(
        name="mass",
        units=units.kg,
        value=lambda s: s.vehicle.total_mass,
        doc="m: vehicle and payload",
    ),
    Parameter(
        name="gravity",
        units=units.m / units.s**2,
        value=lambda s: s.gravity,
        doc="g: acceleration of gravity",
    ),
    Parameter(
        name="arm_length",
        units=units.m,
        value=lambda s: s.vehicle.arm_length,
        doc="l: centre of mass to rotor shaft",
    ),
    Parameter(name="Ix", units=_INERTIA, value=lambda s: s.vehicle.Ix, doc="inertia about body x"),
    Parameter(name="Iy", units=_INERTIA, value=lambda s: s.vehicle.Iy, doc="inertia about body y"),
    Parameter(name="Iz", units=_INERTIA, value=lambda s: s.vehicle.Iz, doc="inertia about body z"),
    Parameter(
        name="thrust_coefficient",
        units=units.N * units.s**2,
        value=lambda s: s.vehicle.thrust_coefficient,
        doc="kappa_b: thrust over rotor speed squared",
    ),
    Parameter(
        name="drag_torque_coefficient",
        units=_TORQUE * units.s**2,
        value=lambda s: s.vehicle.drag_torque_coefficient,
        doc="kappa: drag torque over rotor speed squared",
    ),
    Parameter(
        name="rotor_inertia",
        units=_INERTIA,
        value=lambda s: s.vehicle.rotor_inertia,
        doc="I_r: motor and propeller",
    ),
    Parameter(
        name="torque_constant",
        units=_TORQUE / units.A,
        value=_known("torque_constant"),
        doc="k_t: motor torque over current",
    ),
    Parameter(
        name="voltage_constant",
        units=units.rad / units.s / units.V,
        value=_known("voltage_constant"),
        doc="k_v: motor speed over voltage",
    ),
    Parameter(
        name="motor_resistance",
        units=units.ohm,
        value=_known("motor_resistance"),
        doc="R: winding resistance",
    ),
    Parameter(
        name="friction_torque",
        units=_TORQUE,
        value=lambda s: s.vehicle.friction_torque,
        doc="T_f: dry friction of one motor",
    ),
    Parameter(
        name="viscous_damping",
        units=_TORQUE * units.s,
        value=lambda s: s.vehicle.viscous_damping,
        doc="D_f: viscous friction of one motor",
    ),
    Parameter(
        name="drag_linear",
        units=units.kg / units.s,
        value=lambda s: s.vehicle.drag_linear,
        doc="drag force over airspeed",
    ),
    Parameter(
        name="drag_quadratic",
        units=units.kg / units.m,
        value=lambda s: s.vehicle.drag_quadratic,
        doc="drag force over airspeed squared",
    ),
)


def declare_vehicle(m: ConcreteModel, scenario: Scenario) -> None:
    """Declare the vehicle's numbers as mutable parameters in block `vehicle`."""
    m.vehicle = Block(doc="numbers of the vehicle")
    declare_parameters(m.vehicle, parameters_of(scenario), scenario)
    loads, times = _loads(scenario), scenario.nominal_times
    if loads:
        left = {k: times[2 * k + 1] for k in loads}

        def is_left(_: Block, k: int, t: float) -> float:
            return float(t > left[k])

        m.vehicle.is_left = Param(loads, m.time, rule=is_left, doc="whether it has been left")


def parameters_of(scenario: Scenario) -> tuple[Parameter, ...]:
    """Return the numbers of a scenario's vehicle, and the payloads that it releases on the way."""
    loads = _loads(scenario)
    known = tuple(row for row in _PARAMETERS if row.value(scenario) is not None)
    if not loads:
        return known
    return (
        *known,
        Parameter(
            name="released",
            units=units.kg,
            value=lambda s: {k: s.mission.waypoints[k].release for k in loads},
            doc="payload left at a waypoint",
            index=loads,
        ),
    )


def _loads(scenario: Scenario) -> tuple[int, ...]:
    """Return the indices of the waypoints at which a payload is released."""
    return tuple(k for k, waypoint in enumerate(scenario.mission.waypoints) if waypoint.release > 0)


def mass_at(m: ConcreteModel, t: float) -> NumericExpression:
    """Return the mass in flight at a time, without payloads of waypoints that have been left."""
    b = m.vehicle
    if b.component("released") is None:
        return b.mass
    return b.mass - sum(b.released[k] * b.is_left[k, t] for k in b.released)
