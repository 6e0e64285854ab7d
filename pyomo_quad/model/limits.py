"""Limits on attitude, rotors, thrust, moments, speed and airspeed, and on the battery.

The module declares the limits of eq. (10) of the paper (Yacef et al.), with two changes:

- The paper prints abs(u_k) <= u_max for k = 1, 2, 3. But u_1 is the thrust, which has a limit of
  its own. This module limits the moments u_2, u_3 and u_4.
- The rotor accelerations are limited, too. Without this limit, the problem with the paper's
  efficiency function has no minimum.

A plan leaves the fraction `limits.reserve` of the largest rotor speed and thrust unused, for the
controller that follows the plan.

If the motors have a time constant, the magnitude of the rotor acceleration is at most
(rotor_speed_max - speed) / time constant, where speed is the present rotor speed. A motor with a
first-order lag cannot accelerate faster. As a simplification, the same limit applies while the
rotor slows down.
"""

from pyomo.core import Block, ConcreteModel, inequality, sqrt
from pyomo.core.base.units_container import units
from pyomo.core.expr import NumericExpression, RelationalExpression

from pyomo_quad.model.parameters import (
    Parameter,
    declare_parameters,
    fields_of,
    parameters_in,
)
from pyomo_quad.scenario import Scenario

# The norm of the velocity is not differentiable at rest; smoothing changes it by 5e-7 at 1 m/s.
_SPEED_SMOOTHING = 1e-3 * units.m / units.s

_BOUNDS = (
    *fields_of("limits", "roll_max", "pitch_max"),
    *fields_of("limits", "rotor_speed_min", "rotor_speed_max", "rotor_acceleration_max"),
    *fields_of("limits", "thrust_max", "roll_moment_max", "pitch_moment_max", "yaw_moment_max"),
    *fields_of("limits", "speed_max", "state_of_charge_min"),
    *fields_of("limits", "battery_current_max", "battery_voltage_min", "battery_power_share_max"),
)
# Names of the parameters that are declared only where they are not zero.
_RESERVE, _MOTOR_LAG = "reserve", "motor_time_constant"
_OPTIONAL = (*fields_of("limits", _RESERVE), *fields_of("vehicle", _MOTOR_LAG))


_VALIDATED = fields_of(
    "vehicle.validated",
    validated_airspeed="airspeed",
    validated_climb_speed="climb_speed",
    validated_descent_speed="descent_speed",
)


@parameters_in("limits")
def parameters_of(scenario: Scenario) -> tuple[Parameter, ...]:
    """Return the parameters that the model of a scenario declares in its block `limits`.

    A bound whose scenario field is None is left out.
    """
    validated = _VALIDATED if scenario.limits.within_validated else ()
    return (*_BOUNDS, *(row for row in _OPTIONAL if row.value(scenario)), *validated)


def without_reserve(numbers: dict[str, float] | None) -> dict[str, float] | None:
    """Return a copy of parameter values in which `limits.reserve` is 0.

    The reserve is the fraction of rotor speed and thrust that a plan leaves to the controller. If
    `numbers` is None or has no reserve, it is returned as it is.
    """
    reserve = f"limits.{_RESERVE}"
    return numbers | {reserve: 0.0} if numbers is not None and reserve in numbers else numbers


def declare_limits(m: ConcreteModel, scenario: Scenario) -> None:
    """Declare limits of vehicle and battery as path constraints in block `limits`.

    The limits are those on attitude, rotors, thrust, moments, speed and battery. If the scenario
    sets `limits.within_validated`, airspeed, climb and descent are also limited to the range that
    measured flights validate. An optional limit is declared only if the scenario sets it.
    """
    b = m.limits = Block(doc="limits, Yacef et al., eq. (10)")
    declare_parameters(b, scenario)
    _declare_attitude_limits(b, m)
    _declare_rotor_limits(b, m)
    _declare_thrust_limits(b, m)
    _declare_battery_limits(b, m, scenario)
    if scenario.limits.speed_max is not None:
        _declare_speed_limit(b, m)
    if scenario.vehicle.motor_time_constant:
        _declare_motor_lag(b, m)
    if scenario.limits.within_validated:
        _declare_validated_range(b, m)


def _less_reserve(b: Block, most: NumericExpression) -> NumericExpression:
    """Return the largest rotor speed [rad/s] or thrust [N] that a plan may use.

    The result is (1 - reserve) times the vehicle's largest value `most`, or `most` without a
    reserve.
    """
    reserve = b.component(_RESERVE)
    return most if reserve is None else (1 - reserve) * most


def _declare_motor_lag(b: Block, m: ConcreteModel) -> None:
    @b.Expression(m.rotors.rotor, m.time, doc="rotor acceleration that the lag allows [rad/s^2]")
    def lagging_acceleration(b: Block, j: int, t: float) -> NumericExpression:
        speed = b.parent_block().rotors.omega[j, t]
        return (b.rotor_speed_max - speed) / b.motor_time_constant

    @b.Constraint(m.rotors.rotor, m.time, doc="motor lag while gathering speed [rad/s^2]")
    def motor_lag_limit(b: Block, j: int, t: float) -> RelationalExpression:
        return b.parent_block().rotors.alpha[j, t] <= b.lagging_acceleration[j, t]

    @b.Constraint(m.rotors.rotor, m.time, doc="motor lag while losing speed [rad/s^2]")
    def motor_braking_limit(b: Block, j: int, t: float) -> RelationalExpression:
        return b.parent_block().rotors.alpha[j, t] >= -b.lagging_acceleration[j, t]


def _declare_validated_range(b: Block, m: ConcreteModel) -> None:
    """Limit airspeed, climb and descent to the range for which measured flights validate the model.

    A limit is declared only if block `limits` has its parameter, such as `validated_airspeed`.
    """
    if b.component("validated_airspeed") is not None:

        @b.Expression(m.time, doc="airspeed [m/s]")
        def airspeed(_b: Block, t: float) -> NumericExpression:
            body, wind = m.rigid_body, m.wind
            updraft = wind.component("velocity_z")
            rising = body.vz[t] if updraft is None else body.vz[t] - updraft[t]
            across = (body.vx[t] - wind.velocity_x[t]) ** 2 + (body.vy[t] - wind.velocity_y[t]) ** 2
            return sqrt(across + rising**2 + _SPEED_SMOOTHING**2)

        @b.Constraint(m.time, doc="largest airspeed that measurements confirm [m/s]")
        def validated_airspeed_limit(b: Block, t: float) -> RelationalExpression:
            return b.airspeed[t] <= b.validated_airspeed

    if b.component("validated_climb_speed") is not None:

        @b.Constraint(m.time, doc="fastest climb that measurements confirm [m/s]")
        def validated_climb_limit(b: Block, t: float) -> RelationalExpression:
            return m.rigid_body.vz[t] <= b.validated_climb_speed

    if b.component("validated_descent_speed") is not None:

        @b.Constraint(m.time, doc="fastest descent that measurements confirm [m/s]")
        def validated_descent_limit(b: Block, t: float) -> RelationalExpression:
            return m.rigid_body.vz[t] >= -b.validated_descent_speed


def _declare_speed_limit(b: Block, m: ConcreteModel) -> None:
    @b.Expression(m.time, doc="speed over ground [m/s]")
    def speed(b: Block, t: float) -> NumericExpression:
        body = b.parent_block().rigid_body
        return sqrt(body.vx[t] ** 2 + body.vy[t] ** 2 + body.vz[t] ** 2 + _SPEED_SMOOTHING**2)

    @b.Constraint(m.time, doc="largest speed over ground [m/s]")
    def speed_limit(b: Block, t: float) -> RelationalExpression:
        return b.speed[t] <= b.speed_max


def _declare_attitude_limits(b: Block, m: ConcreteModel) -> None:
    @b.Constraint(m.time, doc="Yacef et al., eq. (10) row 1: roll angle [rad]")
    def roll_limit(b: Block, t: float) -> RelationalExpression:
        return inequality(-b.roll_max, b.parent_block().rigid_body.phi[t], b.roll_max)

    @b.Constraint(m.time, doc="Yacef et al., eq. (10) row 1: pitch angle [rad]")
    def pitch_limit(b: Block, t: float) -> RelationalExpression:
        return inequality(-b.pitch_max, b.parent_block().rigid_body.theta[t], b.pitch_max)


def _declare_rotor_limits(b: Block, m: ConcreteModel) -> None:
    @b.Constraint(m.rotors.rotor, m.time, doc="Yacef et al., eq. (10) row 2: rotor speed [rad/s]")
    def rotor_speed_limit(b: Block, j: int, t: float) -> RelationalExpression:
        speed = b.parent_block().rotors.omega[j, t]
        return inequality(b.rotor_speed_min, speed, _less_reserve(b, b.rotor_speed_max))

    @b.Constraint(m.rotors.rotor, m.time, doc="rotor acceleration [rad/s^2]")
    def rotor_acceleration_limit(b: Block, j: int, t: float) -> RelationalExpression:
        acceleration = b.parent_block().rotors.alpha[j, t]
        return inequality(-b.rotor_acceleration_max, acceleration, b.rotor_acceleration_max)


def _declare_thrust_limits(b: Block, m: ConcreteModel) -> None:
    @b.Constraint(m.time, doc="Yacef et al., eq. (10) row 3: total thrust [N]")
    def thrust_limit(b: Block, t: float) -> RelationalExpression:
        thrust = b.parent_block().rotors.total_thrust[t]
        return inequality(0 * units.N, thrust, _less_reserve(b, b.thrust_max))

    @b.Constraint(m.time, doc="Yacef et al., eq. (10) row 3, k = 2: roll moment [N m]")
    def roll_moment_limit(b: Block, t: float) -> RelationalExpression:
        moment = b.parent_block().rotors.roll_moment[t]
        return inequality(-b.roll_moment_max, moment, b.roll_moment_max)

    @b.Constraint(m.time, doc="Yacef et al., eq. (10) row 3, k = 3: pitch moment [N m]")
    def pitch_moment_limit(b: Block, t: float) -> RelationalExpression:
        moment = b.parent_block().rotors.pitch_moment[t]
        return inequality(-b.pitch_moment_max, moment, b.pitch_moment_max)

    @b.Constraint(m.time, doc="Yacef et al., eq. (10) row 3, k = 4: yaw moment [N m]")
    def yaw_moment_limit(b: Block, t: float) -> RelationalExpression:
        moment = b.parent_block().rotors.yaw_moment[t]
        return inequality(-b.yaw_moment_max, moment, b.yaw_moment_max)


def _declare_battery_limits(b: Block, m: ConcreteModel, scenario: Scenario) -> None:
    if scenario.limits.state_of_charge_min is not None:

        @b.Constraint(m.time, doc="lowest state of charge [percent]")
        def state_of_charge_limit(b: Block, t: float) -> RelationalExpression:
            return b.parent_block().battery.state_of_charge[t] >= b.state_of_charge_min

    if scenario.limits.battery_current_max is not None:

        @b.Constraint(m.time, doc="largest pack current [A]")
        def battery_current_limit(b: Block, t: float) -> RelationalExpression:
            return b.parent_block().battery.current[t] <= b.battery_current_max

    if scenario.limits.battery_voltage_min is not None:

        @b.Constraint(m.time, doc="lowest pack voltage [V]")
        def battery_voltage_limit(b: Block, t: float) -> RelationalExpression:
            return b.parent_block().battery.voltage[t] >= b.battery_voltage_min

    if scenario.limits.battery_power_share_max is not None:

        @b.Constraint(m.time, doc="largest share of the greatest power of the pack [W]")
        def battery_power_limit(b: Block, t: float) -> RelationalExpression:
            m = b.parent_block()
            return m.power.total[t] <= b.battery_power_share_max * m.battery.greatest_power[t]
