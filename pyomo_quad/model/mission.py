"""The boundary conditions: hover at the start, hover at the goal.

The paper gives every rotor 912 rad/s at both ends, 0.07 % short of balancing the weight; here
it is the exact speed at which 4 kappa_b omega^2 = m g.
"""

from collections.abc import Callable

from pyomo.core.expr import NumericExpression, RelationalExpression
from pyomo.environ import Block, ConcreteModel, sqrt, units

from pyomo_quad.model.parameters import Parameter, declare_parameters
from pyomo_quad.model.rigid_body import PLACE, STATES
from pyomo_quad.scenario import Scenario
from pyomo_quad.scenario.tables import Hover

AT_REST = tuple(name for name in STATES if name not in PLACE)


def _place(hover: Hover) -> dict[str, float]:
    return dict(zip(PLACE, (*hover.position, hover.yaw), strict=True))


def _reader(end: str, state: str) -> Callable[[Scenario], float]:
    return lambda scenario: _place(getattr(scenario.mission, end))[state]


def _end_parameters(end: str) -> tuple[Parameter, ...]:
    return tuple(
        Parameter(
            name=f"{end}_{state}",
            units=STATES[state][0],
            value=_reader(end, state),
            doc=f"{STATES[state][1]} at the {end}",
        )
        for state in PLACE
    )


PARAMETERS = _end_parameters("start") + _end_parameters("goal")


def declare_mission(m: ConcreteModel, scenario: Scenario) -> None:
    """Declare both ends of the flight in block `mission`.

    Parameters
    ----------
    m : ConcreteModel
        With `time`, `vehicle`, `rigid_body` and `rotors`.
    """
    b = m.mission = Block(doc="boundary conditions, section 3 of the paper")
    declare_parameters(b, PARAMETERS, scenario)

    @b.Expression(doc="rotor speed at which the thrust balances the weight [rad/s]")
    def hover_speed(b: Block) -> NumericExpression:
        m = b.parent_block()
        weight = m.vehicle.mass * m.vehicle.gravity
        rotor_thrust = weight / len(m.rotors.rotor)
        return sqrt(rotor_thrust / m.vehicle.thrust_coefficient) * units.rad

    _declare_start(b, m)
    _declare_goal(b, m)


def _declare_start(b: Block, m: ConcreteModel) -> None:
    @b.Constraint(PLACE, doc="x(t_0) = x_0: place and heading")
    def start_place(b: Block, state: str) -> RelationalExpression:
        m = b.parent_block()
        return m.rigid_body.component(state)[m.time.first()] == b.component(f"start_{state}")

    @b.Constraint(AT_REST, doc="x(t_0) = x_0: level and at rest")
    def start_rest(b: Block, state: str) -> RelationalExpression:
        m = b.parent_block()
        return m.rigid_body.component(state)[m.time.first()] == 0

    @b.Constraint(m.rotors.rotor, doc="x(t_0) = x_0: rotor speed of hover [rad/s]")
    def start_rotor_speed(b: Block, j: int) -> RelationalExpression:
        m = b.parent_block()
        return m.rotors.omega[j, m.time.first()] == b.hover_speed


def _declare_goal(b: Block, m: ConcreteModel) -> None:
    @b.Constraint(PLACE, doc="x(t_f) = x_f: place and heading")
    def goal_place(b: Block, state: str) -> RelationalExpression:
        m = b.parent_block()
        return m.rigid_body.component(state)[m.time.last()] == b.component(f"goal_{state}")

    @b.Constraint(AT_REST, doc="x(t_f) = x_f: level and at rest")
    def goal_rest(b: Block, state: str) -> RelationalExpression:
        m = b.parent_block()
        return m.rigid_body.component(state)[m.time.last()] == 0

    @b.Constraint(m.rotors.rotor, doc="x(t_f) = x_f: rotor speed of hover [rad/s]")
    def goal_rotor_speed(b: Block, j: int) -> RelationalExpression:
        m = b.parent_block()
        return m.rotors.omega[j, m.time.last()] == b.hover_speed
