"""The rigid body: translation and rotation, eq. (6) of Yacef et al. and its state form, eq. (9).

symbol | name | unit | meaning
x, y, z | x, y, z | m | position in world axes, z up
x', y', z' | vx, vy, vz | m/s | velocity in world axes
phi, theta, psi | phi, theta, psi | rad | roll, pitch, yaw; yaw-pitch-roll order
phi', theta', psi' | p, q, r | rad/s | body rates (the paper equates them to the Euler rates)

`vehicle.attitude` selects the relation between the angles and the body rates, and the yaw balance:

- `euler` is exact. The Euler rates are those of Beard and McLain (2012), eq. (3.3), singular at a
  pitch of 90 degrees. The yaw balance includes the reaction of the body to the rotors'
  acceleration.
- `paper` has the equations of Yacef et al. The Euler rates equal the body rates, correct to first
  order in the tilt. The yaw balance omits the reaction to the rotors' acceleration.

The balances have the form of eq. (6): mass times acceleration equals the forces, and moment of
inertia times angular acceleration equals the moments. The gyroscopic terms of the rotors follow eq.
(6). The terms that eq. (9) prints contradict eq. (6) in the sign and in the order of the time
derivatives of roll and pitch.
"""

from collections.abc import Callable

from numpy import interp
from pyomo.core import Block, ConcreteModel, Var, cos, sin, tan
from pyomo.core.base.units_container import units
from pyomo.core.expr import NumericExpression, RelationalExpression
from pyomo.dae import DerivativeVar

from pyomo_quad.model.vehicle import mass_at
from pyomo_quad.scenario import Scenario
from pyomo_quad.scenario.vehicle import Attitude

_SPEED = units.m / units.s
_RATE = units.rad / units.s

STATES = {
    "x": (units.m, "position along world x"),
    "y": (units.m, "position along world y"),
    "z": (units.m, "height"),
    "vx": (_SPEED, "velocity along world x"),
    "vy": (_SPEED, "velocity along world y"),
    "vz": (_SPEED, "vertical velocity"),
    "phi": (units.rad, "roll angle"),
    "theta": (units.rad, "pitch angle"),
    "psi": (units.rad, "yaw angle"),
    "p": (_RATE, "roll rate"),
    "q": (_RATE, "pitch rate"),
    "r": (_RATE, "yaw rate"),
}
# States whose values at start and goal the mission sets; all others are zero there.
PLACE = ("x", "y", "z", "psi")
# Usual tilt [rad] and angular rates [rad/s] when a flight turns or brakes.
_NOMINAL_ANGLE = 0.5
_NOMINAL_RATE = 2.0


def declare_motion(m: ConcreteModel, scenario: Scenario) -> None:
    """Declare the states of the rigid body and their kinematics in block `rigid_body`.

    The states are position, velocity, attitude angles and body rates. `vehicle.attitude` selects
    the relation between the angles and the body rates.
    """
    m.rigid_body = Block(doc="rigid body, Yacef et al., eqs. (6) and (9)")
    _declare_states(m, scenario)
    _declare_translation(m.rigid_body, m)
    match scenario.vehicle.attitude:
        case Attitude.EULER:
            _declare_euler_rates(m.rigid_body, m)
        case Attitude.PAPER:
            _declare_equated_rates(m.rigid_body, m)


def declare_balances(m: ConcreteModel, scenario: Scenario) -> None:
    """Declare the force and moment balances in block `rigid_body`.

    `vehicle.attitude` selects the yaw balance: exact, or that of the paper, which omits the
    reaction of the body to accelerating rotors.
    """
    _declare_force_balances(m.rigid_body, m)
    _declare_tilting_balances(m.rigid_body, m)
    _declare_yaw_balance(m.rigid_body, m, scenario.vehicle.attitude)


def _straight_line(start: float, goal: float, duration: float) -> Callable[[Block, float], float]:
    """Return a Pyomo rule for the initial guess of a state: linear in time from start to goal."""
    return lambda _b, t: start + (goal - start) * t / duration


def _from_place_to_place(scenario: Scenario, axis: int) -> Callable[[Block, float], float]:
    """Return a Pyomo rule for the initial guess of one position coordinate over time [m].

    The guess is linear in time between start, waypoints and goal, and constant during a hover.
    """
    places = [position[axis] for position in scenario.mission.positions]
    times = [0.0, *scenario.nominal_times]
    stays = [places[0], *(place for place in places[1:-1] for _ in range(2)), places[-1]]
    return lambda _b, t: float(interp(t, times, stays))


def _declare_states(m: ConcreteModel, scenario: Scenario) -> None:
    b, mission = m.rigid_body, scenario.mission
    start = (*mission.start.position, mission.start.yaw)
    goal = (*mission.goal.position, mission.goal.yaw)
    ends = dict(zip(PLACE, zip(start, goal, strict=True), strict=True))
    distance = max(1.0, *(abs(there - here) for here, there in ends.values()))
    for place in mission.positions[1:-1]:
        distance = max(distance, *(abs(x - y) for x, y in zip(place, start, strict=False)))
    nominal = dict.fromkeys(("x", "y", "z"), distance)
    nominal |= dict.fromkeys(("vx", "vy", "vz"), distance / scenario.nominal_duration)
    nominal |= dict.fromkeys(("phi", "theta", "psi"), _NOMINAL_ANGLE)
    nominal |= dict.fromkeys(("p", "q", "r"), _NOMINAL_RATE)
    for name, (unit, doc) in STATES.items():
        guess = _straight_line(*ends.get(name, (0.0, 0.0)), scenario.nominal_duration)
        if mission.waypoints and name in PLACE[:3]:
            guess = _from_place_to_place(scenario, PLACE.index(name))
        state = Var(m.time, units=unit, initialize=guess, doc=doc)
        b.add_component(name, state)
        rate = DerivativeVar(state, wrt=m.time, units=unit / units.s, initialize=0.0)
        b.add_component(f"d{name}_dt", rate)
        m.scaling_factor[state] = 1.0 / nominal[name]


def _declare_translation(b: Block, m: ConcreteModel) -> None:
    @b.Constraint(m.time, doc="Yacef et al., eq. (9) row 1: velocity along world x [m/s]")
    def x_kinematics(b: Block, t: float) -> RelationalExpression:
        return b.dx_dt[t] == b.vx[t]

    @b.Constraint(m.time, doc="Yacef et al., eq. (9) row 1: velocity along world y [m/s]")
    def y_kinematics(b: Block, t: float) -> RelationalExpression:
        return b.dy_dt[t] == b.vy[t]

    @b.Constraint(m.time, doc="Yacef et al., eq. (9) row 1: vertical velocity [m/s]")
    def z_kinematics(b: Block, t: float) -> RelationalExpression:
        return b.dz_dt[t] == b.vz[t]


def turning(b: Block, t: float) -> NumericExpression:
    """Return dpsi/dt cos(theta) [rad/s], for the yaw angle psi and the pitch angle theta.

    In terms of the body rates, it is q sin(phi) + r cos(phi), exact if `vehicle.attitude` is
    "euler". `b` is the block `rigid_body`, and `t` the time in flight [s].
    """
    return b.q[t] * sin(b.phi[t]) + b.r[t] * cos(b.phi[t])


def _declare_euler_rates(b: Block, m: ConcreteModel) -> None:
    @b.Constraint(m.time, doc="Beard and McLain (2012), eq. (3.3) row 1: roll angle [rad/s]")
    def roll_kinematics(b: Block, t: float) -> RelationalExpression:
        return b.dphi_dt[t] == b.p[t] + turning(b, t) * tan(b.theta[t])

    @b.Constraint(m.time, doc="Beard and McLain (2012), eq. (3.3) row 2: pitch angle [rad/s]")
    def pitch_kinematics(b: Block, t: float) -> RelationalExpression:
        return b.dtheta_dt[t] == b.q[t] * cos(b.phi[t]) - b.r[t] * sin(b.phi[t])

    @b.Constraint(m.time, doc="Beard and McLain (2012), eq. (3.3) row 3: yaw angle [rad/s]")
    def yaw_kinematics(b: Block, t: float) -> RelationalExpression:
        return b.dpsi_dt[t] == turning(b, t) / cos(b.theta[t])


def _declare_equated_rates(b: Block, m: ConcreteModel) -> None:
    @b.Constraint(m.time, doc="Yacef et al., eq. (9) row 3: roll rate [rad/s]")
    def roll_kinematics(b: Block, t: float) -> RelationalExpression:
        return b.dphi_dt[t] == b.p[t]

    @b.Constraint(m.time, doc="Yacef et al., eq. (9) row 3: pitch rate [rad/s]")
    def pitch_kinematics(b: Block, t: float) -> RelationalExpression:
        return b.dtheta_dt[t] == b.q[t]

    @b.Constraint(m.time, doc="Yacef et al., eq. (9) row 3: yaw rate [rad/s]")
    def yaw_kinematics(b: Block, t: float) -> RelationalExpression:
        return b.dpsi_dt[t] == b.r[t]


def forward_axis(b: Block, t: float) -> tuple[NumericExpression, ...]:
    """Return the unit vector of body x (forward) in world axes, shape (3,).

    `b` is the block `rigid_body`, and `t` the time in flight [s].
    """
    theta, psi = b.theta[t], b.psi[t]
    return cos(theta) * cos(psi), cos(theta) * sin(psi), -sin(theta)


def left_axis(b: Block, t: float) -> tuple[NumericExpression, ...]:
    """Return the unit vector of body y (left) in world axes, shape (3,).

    `b` is the block `rigid_body`, and `t` the time in flight [s].
    """
    phi, theta, psi = b.phi[t], b.theta[t], b.psi[t]
    return (
        sin(phi) * sin(theta) * cos(psi) - cos(phi) * sin(psi),
        sin(phi) * sin(theta) * sin(psi) + cos(phi) * cos(psi),
        sin(phi) * cos(theta),
    )


def thrust_axis(b: Block, t: float) -> tuple[NumericExpression, ...]:
    """Return the unit vector of body z, the direction of the thrust, in world axes, shape (3,).

    `b` is the block `rigid_body`, and `t` the time in flight [s].
    """
    phi, theta, psi = b.phi[t], b.theta[t], b.psi[t]
    return (
        cos(phi) * sin(theta) * cos(psi) + sin(phi) * sin(psi),
        cos(phi) * sin(theta) * sin(psi) - sin(phi) * cos(psi),
        cos(phi) * cos(theta),
    )


# Function of block `rigid_body` and time that returns a body axis in world axes.
BodyAxis = Callable[[Block, float], tuple[NumericExpression, ...]]
BODY_AXES: tuple[BodyAxis, ...] = (forward_axis, left_axis, thrust_axis)


def _moment(m: ConcreteModel, name: str, t: float) -> NumericExpression:
    """Return the moment of rotors and aerodynamic forces about a body axis [N m].

    `name` is "roll_moment", "pitch_moment" or "yaw_moment".
    """
    # The aerodynamic moment comes from rotor drag and translational lift, if the vehicle has them.
    of_rotors, of_air = m.rotors.component(name)[t], m.aerodynamics.component(name)
    return of_rotors if of_air is None else of_rotors + of_air[t]


def _declare_force_balances(b: Block, m: ConcreteModel) -> None:
    @b.Constraint(m.time, doc="Yacef et al., eq. (6) row 1: force balance along world x [N]")
    def x_momentum_balance(b: Block, t: float) -> RelationalExpression:
        m = b.parent_block()
        thrust = thrust_axis(b, t)[0] * m.rotors.total_thrust[t]
        return mass_at(m, t) * b.dvx_dt[t] == thrust + m.aerodynamics.force_x[t]

    @b.Constraint(m.time, doc="Yacef et al., eq. (6) row 2: force balance along world y [N]")
    def y_momentum_balance(b: Block, t: float) -> RelationalExpression:
        m = b.parent_block()
        thrust = thrust_axis(b, t)[1] * m.rotors.total_thrust[t]
        return mass_at(m, t) * b.dvy_dt[t] == thrust + m.aerodynamics.force_y[t]

    @b.Constraint(m.time, doc="Yacef et al., eq. (6) row 3: vertical force balance [N]")
    def z_momentum_balance(b: Block, t: float) -> RelationalExpression:
        m = b.parent_block()
        thrust = thrust_axis(b, t)[2] * m.rotors.total_thrust[t]
        weight = mass_at(m, t) * m.vehicle.gravity
        return mass_at(m, t) * b.dvz_dt[t] == thrust - weight + m.aerodynamics.force_z[t]


def _declare_tilting_balances(b: Block, m: ConcreteModel) -> None:
    @b.Constraint(m.time, doc="Yacef et al., eq. (6) row 4: moment balance about body x [N m]")
    def roll_balance(b: Block, t: float) -> RelationalExpression:
        m = b.parent_block()
        airframe_coupling = (m.vehicle.Iy - m.vehicle.Iz) * b.q[t] * b.r[t]
        rotor_drum = m.vehicle.rotor_inertia * b.q[t] * m.rotors.speed_imbalance[t]
        return m.vehicle.Ix * b.dp_dt[t] == airframe_coupling + rotor_drum + _moment(
            m, "roll_moment", t
        )

    @b.Constraint(m.time, doc="Yacef et al., eq. (6) row 5: moment balance about body y [N m]")
    def pitch_balance(b: Block, t: float) -> RelationalExpression:
        m = b.parent_block()
        airframe_coupling = (m.vehicle.Iz - m.vehicle.Ix) * b.p[t] * b.r[t]
        rotor_drum = m.vehicle.rotor_inertia * b.p[t] * m.rotors.speed_imbalance[t]
        return m.vehicle.Iy * b.dq_dt[t] == airframe_coupling - rotor_drum + _moment(
            m, "pitch_moment", t
        )


def _declare_yaw_balance(b: Block, m: ConcreteModel, attitude: Attitude) -> None:
    """Declare the moment balance about body z.

    The balance of attitude "euler" includes the reaction moment of accelerating rotors on the body,
    which the paper (Yacef et al.) omits.
    """
    is_exact = attitude is Attitude.EULER
    what = " with the rotors' reaction: body z" if is_exact else ": moment balance about body z"

    @b.Constraint(m.time, doc=f"Yacef et al., eq. (6) row 6{what} [N m]")
    def yaw_balance(b: Block, t: float) -> RelationalExpression:
        m = b.parent_block()
        airframe_coupling = (m.vehicle.Ix - m.vehicle.Iy) * b.p[t] * b.q[t]
        moment = _moment(m, "yaw_moment", t)
        if is_exact:
            moment = moment + m.rotors.yaw_reaction[t]
        return m.vehicle.Iz * b.dr_dt[t] == airframe_coupling + moment
