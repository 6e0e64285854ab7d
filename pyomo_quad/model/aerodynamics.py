"""The aerodynamic force on the vehicle along world axes, and its moments about body axes.

The force is the sum of two parts. The first part follows one of two laws, which the scenario's
`wind.coupling` selects:

`acceleration` is eq. (9) of the paper (Yacef et al.) as printed, which adds the wind velocity to
the acceleration of the vehicle. A coefficient of 1 per second, which the paper does not print,
makes the units consistent. The vehicle's own velocity has no effect on this force.

`drag` is an isotropic drag: the force is -(d_1 + d_2 abs(v)) v. The airspeed v is the velocity of
the vehicle relative to the air. The coefficients d_1 [kg/s] and d_2 [kg/m] are the vehicle's
`drag_linear` and `drag_quadratic`. The law is valid at airspeeds of a few m/s. `drag` is the
default for a vehicle that has any drag coefficient.

The second part consists of forces along the body axes, under either law. These forces depend on the
airspeed v in body axes and on the rotor speed omega. All three rotor forces are declared if any of
their coefficients is not zero. The parasitic drag is declared if any of its coefficients is not
zero. A vehicle with rotor drag and parasitic drag usually has d_1 = d_2 = 0.

name | force on the vehicle | source
rotor_drag_plane | -k_d omega v along x and y, at each rotor | Mellinger (2012)
rotor_drag_axis | -k_z omega v along z, at each rotor | Svacha, Mohta and Kumar (2017)
translational_lift | k_h (v_x^2 + v_y^2) along z, at each rotor | Faessler et al. (2018)
parasitic_drag | -c_i abs(v) v_i along each axis | Svacha, Mohta and Kumar (2017)

The airspeed of a rotor includes the velocity of the rotor's place due to the body rates. Rotor drag
therefore damps the body rates without a further coefficient.
"""

from collections.abc import Callable

from pyomo.core import Block, ConcreteModel, Expression, Param, sqrt
from pyomo.core.base.units_container import units
from pyomo.core.expr import NumericExpression

from pyomo_quad.model.parameters import (
    Parameter,
    declare_parameters,
    fields_of,
    parameters_in,
)
from pyomo_quad.model.rigid_body import BODY_AXES, BodyAxis
from pyomo_quad.model.vehicle import mass_at
from pyomo_quad.scenario import Scenario
from pyomo_quad.scenario.tables import PowerModel
from pyomo_quad.scenario.wind import WindCoupling

# The norm of the airspeed is not differentiable at zero; smoothing changes it by 5e-7 at 1 m/s.
AIRSPEED_SMOOTHING = 1e-3 * units.m / units.s

_AXES = ("x", "y", "z")

# Coefficient of eq. (9) as printed: acceleration over wind velocity [1/s].
PARAMETERS = fields_of("wind", "acceleration_coefficient")
_ROTOR_NUMBERS = fields_of("vehicle", "rotor_drag_plane", "rotor_drag_axis", "translational_lift")
_PARASITIC = Parameter(
    name="parasitic_drag",
    units=units.kg / units.m,
    value=lambda s: dict(zip(_AXES, s.vehicle.parasitic_drag, strict=True)),
    doc="c: drag over airspeed squared along the body's axes",
)


@parameters_in("aerodynamics")
def parameters_of(scenario: Scenario) -> tuple[Parameter, ...]:
    """Return the parameters that the model of a scenario declares in its block `aerodynamics`.

    They are the coefficients of the forces that act on the vehicle, except for those of the
    isotropic drag, which block `vehicle` has.
    """
    is_printed = scenario.wind.coupling is WindCoupling.ACCELERATION
    return (
        *(PARAMETERS if is_printed else ()),
        *(_ROTOR_NUMBERS if scenario.vehicle.has_rotor_forces else ()),
        *((_PARASITIC,) if any(scenario.vehicle.parasitic_drag) else ()),
    )


def acts_in_body_axes(scenario: Scenario) -> bool:
    """Return whether the vehicle has forces that depend on the airspeed in body axes.

    These forces are the rotor forces (drag and translational lift at each rotor) and the parasitic
    drag.
    """
    return scenario.vehicle.has_rotor_forces or any(scenario.vehicle.parasitic_drag)


def declare_aerodynamics(m: ConcreteModel, scenario: Scenario) -> None:
    """Declare the aerodynamic force and moments on the vehicle in block `aerodynamics`.

    The expressions `force_x`, `force_y` and `force_z` are along the world axes [N]. If the vehicle
    has rotor drag or translational lift, `roll_moment`, `pitch_moment` and `yaw_moment` about the
    body axes [N m] are declared, too.
    """
    b = m.aerodynamics = Block(doc="aerodynamic force")
    declare_parameters(b, scenario)
    is_drag, in_body_axes = scenario.wind.coupling is WindCoupling.DRAG, acts_in_body_axes(scenario)
    if is_drag or in_body_axes or scenario.power.model is PowerModel.MOMENTUM:
        _declare_airspeed(b, m)
    rules = _drag(b, m) if is_drag else _wind_acceleration(m.wind.component("velocity_z"))
    for name, (rule, doc) in rules.items():
        part = f"airframe_{name}" if in_body_axes else name
        b.add_component(part, Expression(m.time, rule=rule, doc=doc))
    if not in_body_axes:
        return
    _declare_body_airspeed(b, m)
    if scenario.vehicle.has_rotor_forces:
        _declare_rotor_forces(b, m)
        _declare_rotor_moments(b, m)
    _declare_sum(b, m, scenario)


_HORIZONTAL = ("x", "y")
_ACCELERATION = units.m / units.s**2


def declare_unexplained(m: ConcreteModel) -> None:
    """Add a constant horizontal acceleration to the equations of motion, as a correction.

    The mutable parameter `aerodynamics.unexplained` is the observed minus the modelled acceleration
    along x and y [m/s^2]. No component may refer to `force_x` or `force_y` yet, because they are
    replaced.
    """
    b = m.aerodynamics
    # Not zero if, for example, the wind differs from the forecast.
    b.unexplained = Param(
        _HORIZONTAL,
        initialize=0.0,
        mutable=True,
        units=_ACCELERATION,
        doc="observed acceleration that no equation explains",
    )
    for axis in _HORIZONTAL:
        explained = b.component(f"force_{axis}")
        b.del_component(explained)
        b.add_component(f"explained_force_{axis}", explained)
        b.add_component(
            f"force_{axis}",
            Expression(m.time, rule=_all_of(axis), doc=f"force along world {axis} [N]"),
        )


def _all_of(axis: str) -> Callable[[Block, float], NumericExpression]:
    def force(b: Block, t: float) -> NumericExpression:
        unexplained = mass_at(b.parent_block(), t) * b.unexplained[axis]
        return b.component(f"explained_force_{axis}")[t] + unexplained

    return force


_Rules = dict[str, tuple[Callable[[Block, float], NumericExpression], str]]


def _wind_acceleration(updraft: Expression | None) -> _Rules:
    """Return Pyomo rule and documentation text of the wind force of eq. (9), for each world axis.

    The force is mass times c w [N], with wind velocity w and coefficient c [1/s]. `updraft` is w's
    vertical part, or None if w is horizontal.
    """

    def force_x(b: Block, t: float) -> NumericExpression:
        m = b.parent_block()
        return mass_at(m, t) * (b.acceleration_coefficient * m.wind.velocity_x[t])

    def force_y(b: Block, t: float) -> NumericExpression:
        m = b.parent_block()
        return mass_at(m, t) * (b.acceleration_coefficient * m.wind.velocity_y[t])

    def force_z(_b: Block, _t: float) -> NumericExpression:
        return 0 * units.N

    def lift_z(b: Block, t: float) -> NumericExpression:
        m = b.parent_block()
        return mass_at(m, t) * (b.acceleration_coefficient * m.wind.velocity_z[t])

    vertical = (
        (force_z, "Yacef et al., eq. (9) row 2: W has no vertical part [N]")
        if updraft is None
        else (lift_z, "Yacef et al., eq. (9) row 2, W along world z, times the mass [N]")
    )

    return {
        "force_x": (force_x, "Yacef et al., eq. (9) row 2, W along world x, times the mass [N]"),
        "force_y": (force_y, "Yacef et al., eq. (9) row 2, W along world y, times the mass [N]"),
        "force_z": vertical,
    }


def _declare_airspeed(b: Block, m: ConcreteModel) -> None:
    @b.Expression(m.time, doc="airspeed along world x [m/s]")
    def airspeed_x(b: Block, t: float) -> NumericExpression:
        m = b.parent_block()
        return m.rigid_body.vx[t] - m.wind.velocity_x[t]

    @b.Expression(m.time, doc="airspeed along world y [m/s]")
    def airspeed_y(b: Block, t: float) -> NumericExpression:
        m = b.parent_block()
        return m.rigid_body.vy[t] - m.wind.velocity_y[t]

    @b.Expression(m.time, doc="vertical airspeed [m/s]")
    def airspeed_z(b: Block, t: float) -> NumericExpression:
        m = b.parent_block()
        updraft = m.wind.component("velocity_z")
        return m.rigid_body.vz[t] if updraft is None else m.rigid_body.vz[t] - updraft[t]


def _drag(b: Block, m: ConcreteModel) -> _Rules:
    """Declare the drag divided by the airspeed, and return the drag forces along the world axes.

    The ratio is d_1 + d_2 abs(v) [kg/s]. Each force is returned as its Pyomo rule and
    documentation text, by name.
    """

    @b.Expression(m.time, doc="drag over airspeed [kg/s]")
    def drag_coefficient(b: Block, t: float) -> NumericExpression:
        vehicle = b.parent_block().vehicle
        return vehicle.drag_linear + vehicle.drag_quadratic * _airspeed(b, t)

    def force_x(b: Block, t: float) -> NumericExpression:
        return -b.drag_coefficient[t] * b.airspeed_x[t]

    def force_y(b: Block, t: float) -> NumericExpression:
        return -b.drag_coefficient[t] * b.airspeed_y[t]

    def force_z(b: Block, t: float) -> NumericExpression:
        return -b.drag_coefficient[t] * b.airspeed_z[t]

    return {
        "force_x": (force_x, "drag along world x [N]"),
        "force_y": (force_y, "drag along world y [N]"),
        "force_z": (force_z, "vertical drag [N]"),
    }


def _airspeed(b: Block, t: float) -> NumericExpression:
    return sqrt(
        b.airspeed_x[t] ** 2 + b.airspeed_y[t] ** 2 + b.airspeed_z[t] ** 2 + AIRSPEED_SMOOTHING**2
    )


def _declare_body_airspeed(b: Block, m: ConcreteModel) -> None:
    for axis, direction in zip(_AXES, BODY_AXES, strict=True):

        def along(b: Block, t: float, direction: BodyAxis = direction) -> NumericExpression:
            x, y, z = direction(b.parent_block().rigid_body, t)
            return x * b.airspeed_x[t] + y * b.airspeed_y[t] + z * b.airspeed_z[t]

        doc = f"airspeed along body {axis} [m/s]"
        b.add_component(f"body_airspeed_{axis}", Expression(m.time, rule=along, doc=doc))


def _declare_rotor_forces(b: Block, m: ConcreteModel) -> None:
    @b.Expression(m.rotors.rotor, m.time, doc="airspeed of one rotor along body x [m/s]")
    def rotor_airspeed_x(b: Block, j: int, t: float) -> NumericExpression:
        m = b.parent_block()
        turning = m.rotors.aside[j] * m.rigid_body.r[t]
        return b.body_airspeed_x[t] - turning / units.rad

    @b.Expression(m.rotors.rotor, m.time, doc="airspeed of one rotor along body y [m/s]")
    def rotor_airspeed_y(b: Block, j: int, t: float) -> NumericExpression:
        m = b.parent_block()
        turning = m.rotors.ahead[j] * m.rigid_body.r[t]
        return b.body_airspeed_y[t] + turning / units.rad

    @b.Expression(m.rotors.rotor, m.time, doc="airspeed of one rotor along body z [m/s]")
    def rotor_airspeed_z(b: Block, j: int, t: float) -> NumericExpression:
        rotors, body = b.parent_block().rotors, b.parent_block().rigid_body
        turning = rotors.aside[j] * body.p[t] - rotors.ahead[j] * body.q[t]
        return b.body_airspeed_z[t] + turning / units.rad

    @b.Expression(m.rotors.rotor, m.time, doc="drag of one rotor along body x [N]")
    def rotor_force_x(b: Block, j: int, t: float) -> NumericExpression:
        speed = b.parent_block().rotors.omega[j, t]
        return -b.rotor_drag_plane * speed * b.rotor_airspeed_x[j, t]

    @b.Expression(m.rotors.rotor, m.time, doc="drag of one rotor along body y [N]")
    def rotor_force_y(b: Block, j: int, t: float) -> NumericExpression:
        speed = b.parent_block().rotors.omega[j, t]
        return -b.rotor_drag_plane * speed * b.rotor_airspeed_y[j, t]

    @b.Expression(m.rotors.rotor, m.time, doc="thrust that one rotor gains from moving air [N]")
    def rotor_force_z(b: Block, j: int, t: float) -> NumericExpression:
        speed = b.parent_block().rotors.omega[j, t]
        across = b.rotor_airspeed_x[j, t] ** 2 + b.rotor_airspeed_y[j, t] ** 2
        inflow = b.rotor_drag_axis * speed * b.rotor_airspeed_z[j, t]
        return b.translational_lift * across - inflow


def _declare_rotor_moments(b: Block, m: ConcreteModel) -> None:
    @b.Expression(m.time, doc="moment of the air on the rotors about body x [N m]")
    def roll_moment(b: Block, t: float) -> NumericExpression:
        rotors = b.parent_block().rotors
        return sum(rotors.aside[j] * b.rotor_force_z[j, t] for j in rotors.rotor)

    @b.Expression(m.time, doc="moment of the air on the rotors about body y [N m]")
    def pitch_moment(b: Block, t: float) -> NumericExpression:
        rotors = b.parent_block().rotors
        return -sum(rotors.ahead[j] * b.rotor_force_z[j, t] for j in rotors.rotor)

    @b.Expression(m.time, doc="moment of the air on the rotors about body z [N m]")
    def yaw_moment(b: Block, t: float) -> NumericExpression:
        rotors = b.parent_block().rotors
        return sum(
            rotors.ahead[j] * b.rotor_force_y[j, t] - rotors.aside[j] * b.rotor_force_x[j, t]
            for j in rotors.rotor
        )


def _declare_sum(b: Block, m: ConcreteModel, scenario: Scenario) -> None:
    """Declare the sum of the aerodynamic forces along each body axis and each world axis [N].

    Only the sums along the world axes include the isotropic drag or the wind force of eq. (9).
    """
    by_axis = any(scenario.vehicle.parasitic_drag)
    has_rotor_forces = scenario.vehicle.has_rotor_forces
    for axis in _AXES:

        def along_body(b: Block, t: float, axis: str = axis) -> NumericExpression:
            parts = []
            if has_rotor_forces:
                parts += [
                    b.component(f"rotor_force_{axis}")[j, t] for j in b.parent_block().rotors.rotor
                ]
            if by_axis:
                over_airspeed = b.parasitic_drag[axis] * _airspeed(b, t)
                parts.append(-over_airspeed * b.component(f"body_airspeed_{axis}")[t])
            return sum(parts)

        doc = f"force of the air along body {axis} [N]"
        b.add_component(f"body_force_{axis}", Expression(m.time, rule=along_body, doc=doc))
    for k, axis in enumerate(_AXES):

        def along_world(b: Block, t: float, k: int = k, axis: str = axis) -> NumericExpression:
            body = b.parent_block().rigid_body
            turned = sum(
                direction(body, t)[k] * b.component(f"body_force_{name}")[t]
                for name, direction in zip(_AXES, BODY_AXES, strict=True)
            )
            return b.component(f"airframe_force_{axis}")[t] + turned

        doc = f"force of the air along world {axis} [N]"
        b.add_component(f"force_{axis}", Expression(m.time, rule=along_world, doc=doc))
