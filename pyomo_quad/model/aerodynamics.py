"""The force of the air on the airframe, in world axes.

Two couplings of the wind to the vehicle:

`acceleration` is eq. (9) as printed, which adds the wind velocity to an acceleration; the
coefficient of 1 1/s that this silently needs is declared with its unit.  The vehicle's own
velocity has no part in it.

`drag` is the force against the airspeed, the velocity relative to the wind: linear (rotor
drag) plus quadratic (parasitic drag).  Isotropic; sound at the few m/s of these missions.
"""

from collections.abc import Callable

from pyomo.core.expr import NumericExpression
from pyomo.environ import Block, ConcreteModel, Expression, Param, sqrt, units

from pyomo_quad.model.parameters import Parameter, declare_parameters
from pyomo_quad.scenario import Scenario
from pyomo_quad.scenario.tables import PowerModel
from pyomo_quad.scenario.wind import WindCoupling

# The norm of the airspeed has no derivative at zero; at 1 m/s this changes it by 5e-7.
AIRSPEED_SMOOTHING = 1e-3 * units.m / units.s

PARAMETERS = (
    Parameter(
        name="acceleration_coefficient",
        units=1 / units.s,
        value=lambda s: s.wind.acceleration_coefficient,
        doc="turns wind velocity into acceleration, eq. (9)",
    ),
)


def declare_aerodynamics(m: ConcreteModel, scenario: Scenario) -> None:
    """Declare the aerodynamic force in block `aerodynamics`.

    Parameters
    ----------
    m : ConcreteModel
        With `time`, `vehicle`, `wind`; the velocities of `rigid_body` for the drag coupling.
    """
    b = m.aerodynamics = Block(doc="aerodynamic force")
    is_drag = scenario.wind.coupling is WindCoupling.DRAG
    if is_drag or scenario.power.model is PowerModel.MOMENTUM:
        _declare_airspeed(b, m)
    if is_drag:
        _declare_drag(b, m)
    else:
        declare_parameters(b, PARAMETERS, scenario)
        _declare_acceleration(b, m)


_HORIZONTAL = ("x", "y")
_ACCELERATION = units.m / units.s**2


def declare_unexplained(m: ConcreteModel) -> None:
    """Add a constant horizontal acceleration that no equation explains to the force of the air.

    It is the mutable `aerodynamics.unexplained`, by axis: what a vehicle observes of a wind that
    it was not told.

    Parameters
    ----------
    m : ConcreteModel
        With the forces of `aerodynamics`, which nothing refers to yet.
    """
    b = m.aerodynamics
    b.unexplained = Param(
        _HORIZONTAL, initialize=0.0, mutable=True, units=_ACCELERATION, doc="acceleration observed"
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
        unexplained = b.parent_block().vehicle.mass * b.unexplained[axis]
        return b.component(f"explained_force_{axis}")[t] + unexplained

    return force


def _declare_acceleration(b: Block, m: ConcreteModel) -> None:
    @b.Expression(m.time, doc="eq. (9) row 2, W along world x, times the mass [N]")
    def force_x(b: Block, t: float) -> NumericExpression:
        m = b.parent_block()
        return m.vehicle.mass * (b.acceleration_coefficient * m.wind.velocity_x[t])

    @b.Expression(m.time, doc="eq. (9) row 2, W along world y, times the mass [N]")
    def force_y(b: Block, t: float) -> NumericExpression:
        m = b.parent_block()
        return m.vehicle.mass * (b.acceleration_coefficient * m.wind.velocity_y[t])

    @b.Expression(m.time, doc="eq. (9) row 2: W has no vertical part [N]")
    def force_z(_b: Block, _t: float) -> NumericExpression:
        return 0 * units.N


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
        return b.parent_block().rigid_body.vz[t]


def _declare_drag(b: Block, m: ConcreteModel) -> None:
    @b.Expression(m.time, doc="drag over airspeed [kg/s]")
    def drag_coefficient(b: Block, t: float) -> NumericExpression:
        vehicle = b.parent_block().vehicle
        airspeed = sqrt(
            b.airspeed_x[t] ** 2
            + b.airspeed_y[t] ** 2
            + b.airspeed_z[t] ** 2
            + AIRSPEED_SMOOTHING**2
        )
        return vehicle.drag_linear + vehicle.drag_quadratic * airspeed

    @b.Expression(m.time, doc="drag along world x [N]")
    def force_x(b: Block, t: float) -> NumericExpression:
        return -b.drag_coefficient[t] * b.airspeed_x[t]

    @b.Expression(m.time, doc="drag along world y [N]")
    def force_y(b: Block, t: float) -> NumericExpression:
        return -b.drag_coefficient[t] * b.airspeed_y[t]

    @b.Expression(m.time, doc="vertical drag [N]")
    def force_z(b: Block, t: float) -> NumericExpression:
        return -b.drag_coefficient[t] * b.airspeed_z[t]
