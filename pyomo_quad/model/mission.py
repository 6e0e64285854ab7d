"""The boundary conditions: hover at the start, hover at the goal.

The paper gives every rotor 912 rad/s at both ends, 0.07 % short of balancing the weight; here
it is the exact speed at which 4 kappa_b omega^2 = m g.
"""

from collections.abc import Callable, Hashable, Mapping

from pyomo.core.expr import NumericExpression, RelationalExpression
from pyomo.dae import DerivativeVar
from pyomo.environ import Block, ConcreteModel, Constraint, Param, Var, sqrt, units

from pyomo_quad.model.parameters import Parameter, declare_parameters
from pyomo_quad.model.rigid_body import PLACE, STATES
from pyomo_quad.scenario import Scenario
from pyomo_quad.scenario.mission import Hover

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


_ENDS = _end_parameters("start") + _end_parameters("goal")
_DURATION = (
    Parameter(
        name="duration_min",
        units=units.s,
        value=lambda scenario: scenario.mission.duration_limits[0],
        doc="least duration",
    ),
    Parameter(
        name="duration_max",
        units=units.s,
        value=lambda scenario: scenario.mission.duration_limits[1],
        doc="greatest duration",
    ),
    Parameter(
        name="price_of_time",
        units=units.W,
        value=lambda scenario: scenario.mission.price_of_time,
        doc="what a second costs beside the energy",
    ),
)


def parameters_of(scenario: Scenario) -> tuple[Parameter, ...]:
    """Return the numbers of a scenario's mission, as parameters of block `mission`."""
    return _ENDS + (_DURATION if scenario.mission.is_free else ())


def declare_mission(m: ConcreteModel, scenario: Scenario) -> None:
    """Declare both ends of the flight in block `mission`.

    Parameters
    ----------
    m : ConcreteModel
        With `time`, `vehicle`, `rigid_body` and `rotors`.
    """
    b = m.mission = Block(doc="boundary conditions, section 3 of the paper")
    declare_parameters(b, parameters_of(scenario), scenario)

    @b.Expression(doc="rotor speed at which the thrust balances the weight [rad/s]")
    def hover_speed(b: Block) -> NumericExpression:
        m = b.parent_block()
        weight = m.vehicle.mass * m.vehicle.gravity
        rotor_thrust = weight / len(m.rotors.rotor)
        return sqrt(rotor_thrust / m.vehicle.thrust_coefficient) * units.rad

    _declare_start(b, m)
    _declare_goal(b, m)


def declare_duration(m: ConcreteModel, scenario: Scenario) -> None:
    """Declare the duration as a variable of the model within the mission's limits."""
    nominal = scenario.nominal_duration
    m.duration = Var(
        bounds=(m.mission.duration_min, m.mission.duration_max),
        initialize=nominal,
        units=units.s,
        doc="duration of the flight [s]",
    )
    m.scaling_factor[m.duration] = 1.0 / nominal


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


def start_where_measured(m: ConcreteModel) -> None:
    """Replace what the mission says of the start by mutable parameters in block `start`.

    Parameters
    ----------
    m : ConcreteModel
        With all its states and `mission`.
    """
    for said in (m.mission.start_place, m.mission.start_rest, m.mission.start_rotor_speed):
        said.deactivate()
    m.battery.initial_charge.deactivate()
    m.start = Block(doc="where the rest of the mission starts")
    for rate in m.component_objects(DerivativeVar, descend_into=True):
        _start_measured(m.start, m.time.first(), rate.get_state_var())


def _start_measured(b: Block, start: float, state: Var) -> None:
    """Declare the measured value of a state, with its index beside time, and the condition."""
    beside_time = [index[:-1] for index in state if isinstance(index, tuple) and index[-1] == start]
    sets = (beside_time,) if beside_time else ()
    measured = Param(
        *sets, initialize=0.0, mutable=True, units=state.get_units(), doc=f"{state.doc} measured"
    )
    b.add_component(state.local_name, measured)

    def is_measured(_b: Block, *index: Hashable) -> RelationalExpression:
        if not beside_time:
            return state[start] == measured
        return state[(*index, start)] == measured[index]

    condition = Constraint(*sets, rule=is_measured, doc=f"x(t) as measured: {state.doc}")
    b.add_component(f"{state.local_name}_condition", condition)


def end_in_equilibrium(m: ConcreteModel) -> None:
    """End hovering in the air as it is, tilted against a wind, in place of level.

    Level in a wind is a state that a vehicle passes through, by a swing that meets it at one
    moment; in a wind that is not known to the last, it meets nothing.

    Parameters
    ----------
    m : ConcreteModel
        With `rigid_body`, `rotors` and `mission`.
    """
    for state in ("phi", "theta"):
        m.mission.goal_rest[state].deactivate()
    m.mission.goal_rotor_speed.deactivate()
    end = m.time.last()

    @m.mission.Constraint(("x", "y", "z"), doc="x(t_f): no acceleration [m/s^2]")
    def goal_balance(b: Block, axis: str) -> RelationalExpression:
        return b.parent_block().rigid_body.component(f"dv{axis}_dt")[end] == 0

    @m.mission.Constraint(list(m.rotors.rotor)[1:], doc="x(t_f): no moments [rad/s]")
    def goal_moments(b: Block, j: int) -> RelationalExpression:
        omega = b.parent_block().rotors.omega
        return omega[j, end] == omega[m.rotors.rotor.first(), end]


def measured_start(states: Mapping[str, float]) -> dict[str, float]:
    """Return the parameters of a start where measured, by the full names of states."""
    return {f"start.{name.rpartition('.')[2]}": value for name, value in states.items()}
