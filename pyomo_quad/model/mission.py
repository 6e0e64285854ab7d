"""Boundary conditions of a mission: hover at start and goal, passages of waypoints.

A passage is the instant at which the flight is at a waypoint. Its time is a variable of the plan.

At start and goal, the paper (Yacef et al.) sets every rotor to 912 rad/s, at which the thrust is
0.07 % less than the weight. In this module, the thrust equals the weight: the rotor speed omega
satisfies n kappa_b omega^2 = m g for n rotors.
"""

from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

from pyomo.core import Block, ConcreteModel, Constraint, Param, Var, inequality, sqrt, value
from pyomo.core.base.units_container import units
from pyomo.core.expr import NumericExpression, RelationalExpression
from pyomo.dae import DerivativeVar

from pyomo_quad.model.battery import CONDITIONS_AT_START
from pyomo_quad.model.parameters import (
    Parameter,
    declare_parameters,
    fields_of,
    parameters_in,
)
from pyomo_quad.model.rigid_body import PLACE, STATES, turning
from pyomo_quad.model.vehicle import mass_at
from pyomo_quad.scenario import Scenario
from pyomo_quad.scenario.mission import Hover, Waypoint

_AXES = tuple(enumerate(PLACE[:3]))
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
    *fields_of("mission", "price_of_time"),
)


_TURNING = Parameter(
    name="turning_max",
    units=STATES["r"][0],
    value=lambda _: 0.0,
    doc="largest yaw rate about the vertical of a constant heading",
)


# Largest distance from a waypoint, and largest speed, during a hover at the waypoint.
HOVERING_M, HOVERING_M_PER_S = 0.05, 0.1
_HOVERING = (
    Parameter(
        name="hovering_distance_max",
        units=units.m,
        value=lambda _: HOVERING_M,
        doc="largest distance from a waypoint during a hover",
    ),
    Parameter(
        name="hovering_speed_max",
        units=units.m / units.s,
        value=lambda _: HOVERING_M_PER_S,
        doc="largest speed during a hover",
    ),
)


def _passed(field: str, scenario: Scenario) -> dict[int, float]:
    """Return the values of one field of the waypoints, by the index of the waypoint from 0.

    Waypoints at which the field has its default value need no parameter and are left out.
    """
    default = Waypoint.model_fields[field].default
    values = {k: getattr(w, field) for k, w in enumerate(scenario.mission.waypoints)}
    return {k: number for k, number in values.items() if number != default}


_PASSAGES = tuple(
    replace(row, name=f"passing_{row.name}", value=partial(_passed, row.name))
    for row in fields_of("mission.waypoints", "radius", "hold", "yaw", "speed_max", "at")
)


@parameters_in("mission")
def parameters_of(scenario: Scenario) -> tuple[Parameter, ...]:
    """Return the parameters that the model of a scenario declares in its block `mission`.

    They give place and heading at start and goal, and conditions at waypoints. If the mission
    hovers at a waypoint, they also limit distance from the waypoint and speed during hovers. A
    constant heading adds a limit on the yaw rate. A free duration adds its bounds and the price
    `price_of_time` [W].
    """
    duration = _DURATION if scenario.mission.is_free else ()
    hovering = _HOVERING if any(w.hold for w in scenario.mission.waypoints) else ()
    turning_max = (_TURNING,) if scenario.keeps_yaw else ()
    return (*_ENDS, *duration, *turning_max, *hovering, *_PASSAGES)


def declare_mission(m: ConcreteModel, scenario: Scenario) -> None:
    """Declare hover at start and goal and the conditions at waypoints in block `mission`.

    If the heading is constant, the path constraint `yaw_keeping` is declared, too. `m` already
    declares `time`, `vehicle`, `rigid_body` and `rotors`.
    """
    b = m.mission = Block(doc="boundary conditions, Yacef et al., section 3")
    declare_parameters(b, scenario)

    @b.Expression(doc="rotor speed at which the thrust balances the weight [rad/s]")
    def hover_speed(b: Block) -> NumericExpression:
        m = b.parent_block()
        return _hover_speed(m, m.vehicle.mass)

    end = m.time.last()
    _declare_end(b, m, "start", m.time.first(), b.hover_speed)
    _declare_end(b, m, "goal", end, _hover_speed(m, mass_at(m, end)))
    if scenario.keeps_yaw:
        _declare_kept_yaw(b, m)
    if scenario.mission.waypoints:
        _declare_waypoints(b, m, scenario)


def _hover_speed(m: ConcreteModel, mass: NumericExpression) -> NumericExpression:
    """Return the rotor speed at which the thrust balances the weight of a mass [rad/s]."""
    rotor_thrust = mass * m.vehicle.gravity / len(m.rotors.rotor)
    return sqrt(rotor_thrust / m.vehicle.thrust_coefficient) * units.rad


def free_times(m: ConcreteModel, scenario: Scenario) -> dict[float, Any]:
    """Return the Pyomo variables of all times that a plan chooses, by their nominal times [s].

    A plan chooses the passing times of waypoints, the ends of hovers and, if it is free, the
    duration. The nominal times are members of the time set of the model `m`.
    """
    # Constraints at a chosen time are declared at its nominal time.
    *passages, end = scenario.nominal_times
    free: dict[float, Any] = {end: m.duration} if scenario.mission.is_free else {}
    for k in range(len(scenario.mission.waypoints)):
        free[passages[2 * k]] = m.mission.passing_time[k]
        if scenario.mission.waypoints[k].hold > 0:
            free[passages[2 * k + 1]] = m.mission.leaving_time[k]
    return free


def chosen_times(
    scenario: Scenario, passing_times: Sequence[float], duration: float
) -> dict[str, float]:
    """Return values for the Pyomo variables of all times that a plan chooses, by their full names.

    `passing_times` are the times at which each waypoint of `scenario` is reached, and `duration` is
    the duration of the flight [s].
    """
    times = {"duration": duration} if scenario.mission.is_free else {}
    for k, (waypoint, reached) in enumerate(
        zip(scenario.mission.waypoints, passing_times, strict=True)
    ):
        times[f"mission.passing_time[{k}]"] = reached
        if waypoint.hold:
            times[f"mission.leaving_time[{k}]"] = reached + waypoint.hold
    return times


def _declare_waypoints(b: Block, m: ConcreteModel, scenario: Scenario) -> None:
    """Declare for each waypoint the time of its passage and the conditions at that time.

    The conditions are on position and, if the scenario sets them, on heading, speed and hover.
    """
    waypoints, times = scenario.mission.waypoints, scenario.nominal_times
    reached = {k: times[2 * k] for k in range(len(waypoints))}
    left = {k: times[2 * k + 1] for k in reached}
    places = {(k, axis): w.position[i] for k, w in enumerate(waypoints) for i, axis in _AXES}
    b.waypoint = Param(list(places), initialize=places, mutable=True, units=units.m, doc="x_k")
    given = b.component("passing_at")

    def is_given(k: int) -> bool:
        return given is not None and k in given

    def limits(_b: Block, k: int) -> tuple[Any, Any]:
        return (given[k], given[k]) if is_given(k) else (0.0, None)

    def begun(_b: Block, k: int) -> Any:
        return value(given[k]) if is_given(k) else reached[k]

    b.passing_time = Var(
        list(reached), bounds=limits, initialize=begun, units=units.s, doc="t_k: passage [s]"
    )
    m.scaling_factor[b.passing_time] = 1.0 / scenario.nominal_duration
    _declare_passing(b, reached, [k for k, w in enumerate(waypoints) if w.radius > 0])
    if b.component("passing_hold") is not None:
        _declare_holds(b, m, reached, left)


def _declare_passing(b: Block, reached: dict[int, float], near: list[int]) -> None:
    exact = [k for k in reached if k not in near]

    @b.Constraint(exact, [axis for _, axis in _AXES], doc="x(t_k) = x_k: passing a waypoint [m]")
    def passing_place(b: Block, k: int, axis: str) -> RelationalExpression:
        return b.parent_block().rigid_body.component(axis)[reached[k]] == b.waypoint[k, axis]

    @b.Constraint(near, doc="|x(t_k) - x_k| <= r_k: passing near a waypoint [m^2]")
    def passing_near(b: Block, k: int) -> RelationalExpression:
        return _distance_squared(b, k, reached[k]) <= b.passing_radius[k] ** 2

    if b.component("passing_yaw") is not None:

        @b.Constraint(list(b.passing_yaw), doc="psi(t_k): heading at a waypoint [rad]")
        def passing_heading(b: Block, k: int) -> RelationalExpression:
            return b.parent_block().rigid_body.psi[reached[k]] == b.passing_yaw[k]

    if b.component("passing_speed_max") is not None:

        @b.Constraint(list(b.passing_speed_max), doc="|v(t_k)|: speed at a waypoint [m^2/s^2]")
        def passing_speed(b: Block, k: int) -> RelationalExpression:
            speed = _speed_squared(b.parent_block().rigid_body, reached[k])
            return speed <= b.passing_speed_max[k] ** 2


def _declare_holds(
    b: Block, m: ConcreteModel, reached: dict[int, float], left: dict[int, float]
) -> None:
    held = list(b.passing_hold)
    b.leaving_time = Var(
        held,
        bounds=(0.0, None),
        initialize=lambda _b, k: left[k],
        units=units.s,
        doc="when a waypoint is left [s]",
    )
    m.scaling_factor[b.leaving_time] = m.scaling_factor[b.passing_time]

    @b.Constraint(held, doc="time of hover at a waypoint [s]")
    def hold_time(b: Block, k: int) -> RelationalExpression:
        return b.leaving_time[k] == b.passing_time[k] + b.passing_hold[k]

    @b.Constraint(held, m.time, doc="hovering at a waypoint: distance [m^2]")
    def hold_distance(b: Block, k: int, t: float) -> Any:
        if not reached[k] < t <= left[k]:
            return Constraint.Skip
        return _distance_squared(b, k, t) <= b.hovering_distance_max**2

    @b.Constraint(held, m.time, doc="hovering at a waypoint: speed [m^2/s^2]")
    def hold_speed(b: Block, k: int, t: float) -> Any:
        if not reached[k] < t <= left[k]:
            return Constraint.Skip
        speed = _speed_squared(b.parent_block().rigid_body, t)
        return speed <= b.hovering_speed_max**2


def _distance_squared(b: Block, k: int, t: float) -> NumericExpression:
    body = b.parent_block().rigid_body
    return sum((body.component(axis)[t] - b.waypoint[k, axis]) ** 2 for _, axis in _AXES)


def _speed_squared(body: Block, t: float) -> NumericExpression:
    return body.vx[t] ** 2 + body.vy[t] ** 2 + body.vz[t] ** 2


def declare_duration(m: ConcreteModel, scenario: Scenario) -> None:
    """Declare the duration of the flight [s] as a variable, for a mission whose duration is free.

    The variable is added to the model `m`, whose block `mission` has the bounds of the duration.
    The initial guess is the duration that the scenario estimates.
    """
    nominal = scenario.nominal_duration
    m.duration = Var(
        bounds=(m.mission.duration_min, m.mission.duration_max),
        initialize=nominal,
        units=units.s,
        doc="duration of the flight [s]",
    )
    m.scaling_factor[m.duration] = 1.0 / nominal


def _declare_end(
    b: Block, m: ConcreteModel, end: str, t: float, rotor_speed: NumericExpression
) -> None:
    """Declare the conditions of hover at one end of the flight, "start" or "goal".

    Position and heading are those of the scenario. Velocity, tilt and body rates are zero.
    """
    said = "x(t_0) = x_0" if end == "start" else "x(t_f) = x_f"

    def place(b: Block, state: str) -> RelationalExpression:
        return m.rigid_body.component(state)[t] == b.component(f"{end}_{state}")

    def rest(_b: Block, state: str) -> RelationalExpression:
        return m.rigid_body.component(state)[t] == 0

    def hover(_b: Block, j: int) -> RelationalExpression:
        return m.rotors.omega[j, t] == rotor_speed

    for name, index, rule, doc in (
        ("place", PLACE, place, "place and heading"),
        ("rest", AT_REST, rest, "level and at rest"),
        ("rotor_speed", m.rotors.rotor, hover, "rotor speed of hover [rad/s]"),
    ):
        b.add_component(f"{end}_{name}", Constraint(index, rule=rule, doc=f"{said}: {doc}"))


def _goal_of_turning(b: Block) -> tuple[Any, ...]:
    """Return the constraints at the goal on yaw and body rate r.

    While the path constraint `yaw_keeping` is active, it implies both, and they are deactivated.
    """
    return b.goal_place["psi"], b.goal_rest["r"]


def _declare_kept_yaw(b: Block, m: ConcreteModel) -> None:
    # A limit and not an equation: in a simulated flight, the yaw follows from the rotor moments.
    @b.Constraint(m.time, doc="psi' cos(theta) = 0: the heading is kept [rad/s]")
    def yaw_keeping(b: Block, t: float) -> RelationalExpression:
        body = b.parent_block().rigid_body
        return inequality(-b.turning_max, turning(body, t), b.turning_max)

    for row in _goal_of_turning(b):
        row.deactivate()


def start_where_measured(m: ConcreteModel) -> None:
    """Replace the conditions of a mission at the start by initial values of all states.

    The new block `start` has a mutable parameter for each state, with the state's name. Replanning
    in flight sets these parameters to the measured states. The path constraint `yaw_keeping`, which
    keeps the heading constant, is deactivated: a gust may have turned the vehicle.
    """
    for said in (m.mission.start_place, m.mission.start_rest, m.mission.start_rotor_speed):
        said.deactivate()
    for condition in CONDITIONS_AT_START:
        if m.battery.component(condition) is not None:
            m.battery.component(condition).deactivate()
    if m.mission.component("yaw_keeping") is not None:
        # The vehicle must be free to turn back.
        m.mission.yaw_keeping.deactivate()
        for row in _goal_of_turning(m.mission):
            row.activate()
    m.start = Block(doc="measured states at which a re-plan starts")
    for rate in m.component_objects(DerivativeVar, descend_into=True):
        _start_measured(m.start, m.time.first(), rate.get_state_var())


def _start_measured(b: Block, start: float, state: Var) -> None:
    """Declare a mutable parameter for a state's measured value, and an initial condition with it.

    Both are added to block `b`; `start` is the initial time. A state that is also indexed by rotor
    gets one parameter and one condition per rotor.
    """
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
    """Replace the level hover at the goal by a steady hover, tilted against the wind.

    Models for replanning in flight use this end condition, because the vehicle can then stay at the
    goal.
    """
    # The wind accelerates a vehicle in level hover. A planned flight is then level and at rest for
    # an instant only, which a flight in a slightly different wind misses.
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
    """Return the values of the parameters in block `start`, which hold the measured states.

    `states` has the measured values by full name. The value of ``"rigid_body.x"``, for example,
    becomes that of the parameter ``"start.x"``.
    """
    return {f"start.{name.rpartition('.')[2]}": value for name, value in states.items()}
