"""Adaptive backstepping controller for position and attitude of a quadrotor.

Yacef et al., whose model this package uses, refer to such a controller without its equations. For
the control law, the proof by a Lyapunov function and the limits, see docs/theory/controller.md,
eqs. (1) to (11).

The control law accepts numbers and symbolic variables. It therefore uses only arithmetic and
NumPy's scalar functions, without branches (if) that depend on values.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import reduce
from math import acos, exp, inf, tan
from typing import Protocol

import numpy as np

from pyomo_quad.arrays import FloatArray
from pyomo_quad.collocation import Dynamics, Law
from pyomo_quad.flight.references import ReferencePath, Setpoint
from pyomo_quad.scenario import Attitude, Scenario
from pyomo_quad.scenario.tables import Limits

Vector = Sequence[float]


class AttitudeKinematics(Protocol):
    """Interface of the attitude kinematics, which relate attitude angles and body rates.

    The methods convert body rates to rates of the angles, and body accelerations to accelerations
    of the angles and back. The angles are roll, pitch and yaw [rad]. The body rates are the angular
    velocities about the body axes [rad/s], the body accelerations their time derivatives.
    """

    def angle_rates(self, attitude: Vector, body_rates: Vector, /) -> Vector:
        """Return the time derivatives of roll, pitch and yaw for given body rates, all in rad/s.

        `attitude` holds roll, pitch and yaw [rad].
        """

    def angle_accelerations(
        self, attitude: Vector, body_rates: Vector, body_accelerations: Vector, /
    ) -> Vector:
        """Return the second time derivatives of roll, pitch and yaw [rad/s^2].

        `attitude` holds roll, pitch and yaw [rad], `body_rates` the angular velocities about the
        body axes [rad/s], and `body_accelerations` their time derivatives [rad/s^2].
        """

    def body_accelerations(
        self, attitude: Vector, body_rates: Vector, angle_accelerations: Vector, /
    ) -> Vector:
        """Return the angular accelerations about the body axes [rad/s^2].

        `attitude` holds roll, pitch and yaw [rad], `body_rates` the angular velocities about the
        body axes [rad/s], and `angle_accelerations` the second time derivatives of roll, pitch and
        yaw [rad/s^2].
        """


class EquatedRates:
    """Simplified kinematics: rates of roll, pitch and yaw equal the body rates.

    This is eq. (9) of the paper by Yacef et al., whose model this package uses.
    """

    def angle_rates(self, _attitude: Vector, body_rates: Vector) -> Vector:
        """Return the body rates, which equal the rates of roll, pitch and yaw here [rad/s]."""
        return body_rates

    def angle_accelerations(
        self, _attitude: Vector, _body_rates: Vector, body_accelerations: Vector
    ) -> Vector:
        """Return the second time derivatives of roll, pitch and yaw [rad/s^2].

        They are `body_accelerations`, unchanged: the angular accelerations about the body axes
        [rad/s^2].
        """
        return body_accelerations

    def body_accelerations(
        self, _attitude: Vector, _body_rates: Vector, angle_accelerations: Vector
    ) -> Vector:
        """Return the angular accelerations about the body axes [rad/s^2].

        They are `angle_accelerations`, unchanged: the second time derivatives of roll, pitch and
        yaw [rad/s^2].
        """
        return angle_accelerations


class EulerRates:
    """Exact kinematics of the Euler angles, for rates and for accelerations.

    The rates follow from eq. (3.3) of Beard and McLain (2012). The time derivative of eq. (3.3)
    gives the accelerations.
    """

    def angle_rates(self, attitude: Vector, body_rates: Vector) -> Vector:
        """Return the rates of roll, pitch and yaw for given body rates, all in rad/s.

        `attitude` holds roll, pitch and yaw [rad]. `body_rates` holds the angular velocities about
        the body axes. At a pitch of 90 degrees, the rates of roll and yaw are infinite.
        """
        roll, pitch, _ = attitude
        p, q, r = body_rates
        turning = q * np.sin(roll) + r * np.cos(roll)
        return (
            p + turning * np.tan(pitch),
            q * np.cos(roll) - r * np.sin(roll),
            turning / np.cos(pitch),
        )

    def angle_accelerations(
        self, attitude: Vector, body_rates: Vector, body_accelerations: Vector
    ) -> Vector:
        """Return the second time derivatives of roll, pitch and yaw [rad/s^2].

        `attitude` holds roll, pitch and yaw [rad], `body_rates` the angular velocities about the
        body axes [rad/s], and `body_accelerations` their time derivatives [rad/s^2].
        """
        linear = self.angle_rates(attitude, body_accelerations)
        turning = self._turning(attitude, body_rates)
        return [a + b for a, b in zip(linear, turning, strict=True)]

    def body_accelerations(
        self, attitude: Vector, body_rates: Vector, angle_accelerations: Vector
    ) -> Vector:
        """Return the angular accelerations about the body axes for given angle accelerations.

        `attitude` holds roll, pitch and yaw [rad], `body_rates` the angular velocities about the
        body axes [rad/s], and `angle_accelerations` the second time derivatives of roll, pitch and
        yaw. All accelerations are in rad/s^2.
        """
        roll, pitch, _ = attitude
        turning = self._turning(attitude, body_rates)
        rolling, pitching, yawing = (
            a - b for a, b in zip(angle_accelerations, turning, strict=True)
        )
        level = yawing * np.cos(pitch)
        return (
            rolling - yawing * np.sin(pitch),
            pitching * np.cos(roll) + level * np.sin(roll),
            level * np.cos(roll) - pitching * np.sin(roll),
        )

    def _turning(self, attitude: Vector, body_rates: Vector) -> Vector:
        """Return the second derivatives of roll, pitch and yaw at constant body rates [rad/s^2].

        At constant body rates, the changing attitude still changes the rates of the angles.
        """
        pitch = attitude[1]
        rolling, pitching, yawing = self.angle_rates(attitude, body_rates)
        return (
            pitching * (rolling * np.tan(pitch) + yawing / np.cos(pitch)),
            -rolling * yawing * np.cos(pitch),
            pitching * (rolling / np.cos(pitch) + yawing * np.tan(pitch)),
        )


KINEMATICS: dict[Attitude, AttitudeKinematics] = {
    Attitude.EULER: EulerRates(),
    Attitude.PAPER: EquatedRates(),
}


_MIXER_ROWS = (
    "rotors.total_thrust",
    "rotors.roll_moment",
    "rotors.pitch_moment",
    "rotors.yaw_moment",
)


def rotor_columns(dynamics: Dynamics) -> list[int]:
    """Return the index of each rotor's speed ``rotors.omega[j]`` among the states.

    The order is that of the controls, the accelerations ``rotors.alpha[j]``.
    """
    names = list(dynamics.state_names)
    return [names.index(name.replace("alpha", "omega")) for name in dynamics.control_names]


def mixer_matrix(dynamics: Dynamics) -> FloatArray:
    """Return the matrix that maps squared rotor speeds to total thrust and body moments.

    The rows are thrust [N s^2] and roll, pitch and yaw moment [N m s^2]. Each column is evaluated
    with only one rotor turning, at 1 rad/s.
    """
    columns = rotor_columns(dynamics)
    X = np.zeros((len(columns), len(dynamics.state_names)))
    X[range(len(columns)), columns] = 1.0
    U = np.zeros((len(columns), len(columns)))
    times = np.zeros(len(columns))
    return np.array([dynamics.evaluate(row, times, X, U) for row in _MIXER_ROWS])


# Square of the lowest commanded rotor speed, (1 rad/s)^2: at zero, the square root has no
# derivative, and the closed loop could not be linearised.
_SLOWEST_SQUARED = 1.0


class Allocation:
    """Control allocation: rotor speeds for a commanded thrust and moments, within the limits.

    If the limits do not allow the whole command, the order of priority is: roll and pitch moments,
    thrust, yaw moment.

    Parameters
    ----------
    mixer : ndarray, shape (4, n_rotors)
        Matrix from `mixer_matrix`, from squared rotor speeds to thrust and moments.
    limits : Limits
        Limits on rotor speeds, thrust and moments.
    """

    def __init__(self, mixer: FloatArray, limits: Limits) -> None:
        is_square = len(mixer) == mixer.shape[1]
        inverse = np.linalg.inv(mixer) if is_square else np.linalg.pinv(mixer)
        # Equal on all rotors, since the moments' rows of the mixer each sum to zero.
        self._share = float(inverse[0, 0])
        self._roll, self._pitch, self._yaw = (tuple(column) for column in inverse.T[1:].tolist())
        self._roll_max, self._pitch_max = limits.roll_moment_max, limits.pitch_moment_max
        self._yaw_max = limits.yaw_moment_max
        self._thrust_max = limits.thrust_max
        self._lowest = limits.rotor_speed_min**2
        self._highest = limits.rotor_speed_max**2

    def rotor_speeds(self, thrust: float, moments: Sequence[float]) -> list[float]:
        """Return the rotor speeds [rad/s] within their limits, for a commanded thrust and moments.

        `thrust` is the total thrust [N]. `moments` are roll, pitch and yaw moment [N m].
        """
        # A vehicle that keeps its roll and pitch can correct errors of height and yaw later.
        low, high = self._lowest, self._highest
        roll = _clipped(moments[0], -self._roll_max, self._roll_max)
        pitch = _clipped(moments[1], -self._pitch_max, self._pitch_max)
        yaw = _clipped(moments[2], -self._yaw_max, self._yaw_max)
        wanted = [a * roll + b * pitch for a, b in zip(self._roll, self._pitch, strict=True)]
        fitting = (high - low) / np.fmax(_largest(wanted) - _least(wanted), high - low)
        tilting = [fitting * change for change in wanted]
        least = (low - _least(tilting)) / self._share
        most = (high - _largest(tilting)) / self._share
        equal = self._share * np.fmax(least, _least((most, thrust, self._thrust_max)))
        squares = [change + equal for change in tilting]
        yaw = _clipped(yaw, *_steps_within(squares, self._yaw, low, high))
        turned = (square + share * yaw for square, share in zip(squares, self._yaw, strict=True))
        slowest = max(low, _SLOWEST_SQUARED)
        return [np.sqrt(_clipped(square, slowest, high)) for square in turned]

    def tilting_moment_at(self, thrust: float) -> tuple[float, float]:
        """Return the largest roll and pitch moments [N m] that the limits allow at a thrust [N].

        The limits are those on rotor speeds and on moments. Each moment is the largest without the
        other.
        """
        # Without a moment, all rotors give the same part of the thrust.
        squares = [self._share * thrust] * len(self._roll)
        _, roll = _steps_within(squares, self._roll, self._lowest, self._highest)
        _, pitch = _steps_within(squares, self._pitch, self._lowest, self._highest)
        return min(roll, self._roll_max), min(pitch, self._pitch_max)


def _steps_within(
    values: Sequence[float], direction: Sequence[float], low: float, high: float
) -> tuple[float, float]:
    """Return the largest steps, backward and forward, for which all values stay within limits.

    A step s adds s times `direction` to the values. The backward step is zero or negative.
    """
    ways = [(value, share) for value, share in zip(values, direction, strict=True) if share != 0.0]
    back = [((low if share > 0 else high) - value) / share for value, share in ways]
    forth = [((high if share > 0 else low) - value) / share for value, share in ways]
    return np.fmin(_largest(back), 0.0), np.fmax(_least(forth), 0.0)


def _clipped(number: float, low: float, high: float) -> float:
    return np.fmin(np.fmax(number, low), high)


def _least(numbers: Iterable[float]) -> float:
    return reduce(np.fmin, numbers)


def _largest(numbers: Iterable[float]) -> float:
    return reduce(np.fmax, numbers)


# Fraction of the limit up to which `bend` changes nothing, so that small signals stay linear.
_LINEAR_SHARE = 0.8
# Smallest divisor, in place of zero: far below any acceleration in m/s^2 that matters.
_NOUGHT = 1e-12
# Width of the layer below the bound, relative to it, in which `project` reduces outward motion.
_PROJECTION_LAYER = 0.1


def bend(magnitude: float, limit: float) -> float:
    """Limit the magnitude of a number smoothly; values well below the limit stay unchanged.

    The result is the number itself up to 80 % of the limit. Above that, it is a tanh function of
    the same sign, which approaches the limit.
    """
    straight = _LINEAR_SHARE * limit
    rest = limit - straight
    untouched = _clipped(magnitude, -straight, straight)
    # The result is twice continuously differentiable, because tanh has no curvature at zero.
    return untouched + rest * np.tanh((magnitude - untouched) / rest)


def braking_rate(error: float, gain: float, acceleration_max: float) -> float:
    """Return the rate at which to reduce a tracking error to zero with limited deceleration.

    The rate is gain e / sqrt(1 + q), q = gain^2 abs(e) / a, for the error e and a =
    `acceleration_max`. `gain` is in 1/s.
    """
    # For large errors, the rate r is about sqrt(a abs(e)). At the rate r(e), the deceleration of
    # the error is r dr/de = a/2 q (2 + q) / (1 + q)^2. This is less than a/2 for every gain.
    return gain * error / np.sqrt(1 + gain**2 * np.abs(error) / acceleration_max)


def project(estimate: Sequence[float], rate: Sequence[float], bound: float) -> list[float]:
    """Limit the rate of an adaptive estimate, so that the estimate stays in a ball about zero.

    `bound` is the radius of the ball. This is the smooth projection operator of Krstic,
    Kanellakopoulos and Kokotovic (1995): see docs/theory/controller.md, eq. (6).
    """
    # The projection never increases the Lyapunov function V of the controller, because
    # (estimate - true) . (result - rate) <= 0. This holds if the true value lies in the inner ball
    # with 90 % of the radius.
    outward = sum(d * r for d, r in zip(estimate, rate, strict=True))
    inner = bound * (1 - _PROJECTION_LAYER)
    size_squared = sum(d * d for d in estimate)
    depth = _clipped((size_squared - inner**2) / (bound**2 - inner**2), 0.0, 1.0)
    turned = depth * np.fmax(outward, 0.0) / np.fmax(size_squared, inner**2)
    return [r - turned * d for d, r in zip(estimate, rate, strict=True)]


# Axes of a loop (x, y, z or roll, pitch, yaw), and states of a loop: two states for the actuators'
# lag and one estimated disturbance for each axis.
_AXES = 3
STATES_PER_LOOP = 3 * _AXES


@dataclass(frozen=True, kw_only=True)
class BacksteppingLoop:
    """Adaptive backstepping controller of three double integrators, for position or attitude.

    Each axis has three states. Two states, xi_p and xi_v, are the effects of the actuators' lag on
    the tracking error and on its rate. The third, d_hat, is the estimated disturbance (an
    acceleration). The tracking error is the actual minus the reference value [m or rad]. See
    docs/theory/controller.md, eqs. (1) to (7).
    """

    outer: tuple[float, float, float]
    """k1, 1/s, per axis; equal for all axes if `reach` is finite."""
    inner: tuple[float, float, float]
    """k2, 1/s, per axis."""
    reach: float
    """L: size of the error beyond which the rate of reducing it no longer grows; may be
    infinite."""
    identification: float
    """kappa, 1/s: rate at which the compensated error settles."""
    effort_max: float
    """Largest correcting acceleration; may be infinite."""
    adaptation: float
    """gamma, 1/s^2; zero for a law without adaptation."""
    disturbance_max: float
    """Bound of the estimated disturbance, in the unit of the acceleration."""

    def started(
        self,
        error: Sequence[float],
        error_rate: Sequence[float],
        learnt: Sequence[float] = (0.0,) * _AXES,
    ) -> list[float]:
        """Return the initial states of the loop, for which the compensated errors are zero.

        A compensated error is a tracking error minus the effect of the actuators' lag. `learnt` is
        the initial d_hat. The result has three values each of xi_p, xi_v and d_hat.
        """
        shrink = _shrink(error, self.reach)
        missing = [
            v + k * shrink * e for k, e, v in zip(self.outer, error, error_rate, strict=True)
        ]
        return [*error, *missing, *learnt]

    def __call__(
        self,
        error: Sequence[float],
        error_rate: Sequence[float],
        reference_acceleration: Sequence[float],
        achieved_acceleration: Sequence[float],
        states: Sequence[float],
    ) -> tuple[list[float], list[float]]:
        """Return the commanded acceleration and the time derivatives of the loop's states.

        `reference_acceleration` is that of the reference. `achieved_acceleration` is what the
        actuators produce now, without the disturbance. The order of the nine `states` is that of
        `started`.
        """
        lags, lag_rates, estimate = states[:3], states[3:6], states[6:]
        compensated = [e - lag for e, lag in zip(error, lags, strict=True)]
        shrink = _shrink(error, self.reach)
        compensated_shrink = _shrink(compensated, self.reach)
        along = sum(e * v for e, v in zip(error, error_rate, strict=True))
        turning = along * (shrink / self.reach) ** 2
        known, efforts, discounted, position_rates, velocity_rates = [], [], [], [], []
        for i in range(_AXES):
            k1, e, lag_rate = self.outer[i], error[i], lag_rates[i]
            closing = k1 * shrink * e
            closing_rate = k1 * shrink * (error_rate[i] - turning * e)
            compensated_closing = k1 * compensated_shrink * compensated[i]
            missing = error_rate[i] + closing
            backstep = closing_rate + k1 * compensated_closing
            z = missing - lag_rate
            wanted = reference_acceleration[i] - estimate[i]
            known.append(wanted)
            efforts.append(backstep + self.inner[i] * missing)
            discounted.append(z)
            position_rates.append(lag_rate - closing + compensated_closing)
            identified = self.identification * z
            velocity_rates.append(achieved_acceleration[i] - wanted + backstep + identified)
        learning = project(
            estimate, [self.adaptation * z for z in discounted], self.disturbance_max
        )
        cut = _shrink(efforts, self.effort_max)
        demand = [a - cut * effort for a, effort in zip(known, efforts, strict=True)]
        return demand, [*position_rates, *velocity_rates, *learning]


def _shrink(vector: Sequence[float], reach: float) -> float:
    """Return the factor 1 / sqrt(1 + abs(v)^2 / reach^2), which limits the length of a vector v.

    The product of the factor and v is always shorter than `reach`.
    """
    a, b, c = vector
    return 1 / np.sqrt(1 + (a * a + b * b + c * c) / reach**2)


# Fraction of the allowed roll and pitch that is commanded: the rest is for the attitude error,
# which in light turbulence stayed within a degree.
_SHARE_OF_TILT = 0.97
# Smallest tilt limit of the commands [rad], for a vehicle whose thrust hardly exceeds its weight:
# with less, it could not move sideways.
_LEAST_TILT = 0.1
# Fraction of the weight that the thrust must always balance: a falling quadrotor cannot steer.
_LEAST_SUPPORT = 0.3


def thrust_direction(roll: float, pitch: float, yaw: float) -> tuple[float, float, float]:
    """Return the unit vector of the thrust in world axes, for a given attitude.

    Parameters
    ----------
    roll, pitch, yaw : float
        Attitude [rad].

    Returns
    -------
    tuple of three floats
        Components along world x, y and z (up).
    """
    ahead, aside = np.cos(roll) * np.sin(pitch), np.sin(roll)
    return (
        ahead * np.cos(yaw) + aside * np.sin(yaw),
        ahead * np.sin(yaw) - aside * np.cos(yaw),
        np.cos(roll) * np.cos(pitch),
    )


def tilt_toward(force: Sequence[float], yaw: float) -> tuple[float, float]:
    """Return the roll and pitch [rad] that align the thrust with a force in world axes.

    The vertical component of the force must be positive. `yaw` is the present yaw [rad]. The
    function inverts `thrust_direction`.
    """
    ahead = force[0] * np.cos(yaw) + force[1] * np.sin(yaw)
    aside = force[0] * np.sin(yaw) - force[1] * np.cos(yaw)
    return np.arcsin(aside / _size(force)), np.arctan2(ahead, force[2])


def _size(vector: Sequence[float]) -> float:
    return np.sqrt(_dot(vector, vector))


def followed_tilt(believed: Scenario) -> float:
    """Return the largest tilt that the controller of a scenario commands [rad].

    It is `baseline.gains.tilt_max` if that is set. Otherwise, it is the tilt at which the largest
    commanded thrust just carries the weight, but at least 0.1 rad. The limits on roll and pitch
    always apply.
    """
    limits, gains, gravity = believed.limits, believed.baseline.gains, believed.gravity
    spare = limits.thrust_max / believed.vehicle.total_mass - gravity
    level = acos(gravity / (gravity + gains.thrust_share * max(spare, 0.0)))
    allowed = min(limits.largest_tilt, max(level, _LEAST_TILT))
    return allowed if gains.tilt_max is None else min(gains.tilt_max, limits.largest_tilt)


class ThrustEnvelope:
    """Set of accelerations of the vehicle that the limits of thrust and tilt allow.

    An acceleration is the second time derivative of the position, zero in hover. For an
    acceleration v, the thrust vector divided by the mass is v + (0, 0, gravity).

    Parameters
    ----------
    gravity : float
        Gravitational acceleration [m/s^2].
    acceleration_max : float
        Largest thrust divided by mass [m/s^2]; it must exceed `gravity`.
    tilt_max : float
        Largest tilt of the thrust [rad].
    """

    def __init__(self, *, gravity: float, acceleration_max: float, tilt_max: float) -> None:
        self._gravity = gravity
        self._reserve = acceleration_max**2 - gravity**2
        self._slope = tan(tilt_max)

    def limited(
        self, acceleration: Sequence[float], planned: Sequence[float] = (0.0,) * _AXES
    ) -> tuple[float, float, float]:
        """Limit the commanded acceleration by reducing its difference from the planned one.

        The result is planned + (s(acceleration) - s(planned)) [m/s^2]. The function s shortens a
        vector to fit the limits of thrust and tilt. The planned acceleration itself is not reduced.
        """
        # Without a plan (zero), the result is parallel to the command.
        # If the plan needs more thrust or tilt than the limits allow, `_reach` raises the limits.
        whole, own = (self._shortened(vector, planned) for vector in (acceleration, planned))
        x, y, z = (a + b - c for a, b, c in zip(planned, whole, own, strict=True))
        return x, y, z

    def _shortened(self, acceleration: Sequence[float], planned: Sequence[float]) -> list[float]:
        size = np.fmax(_size(acceleration), _NOUGHT)
        ax, ay, az = (component / size for component in acceleration)
        length = bend(size, self._reach(_size((ax, ay)), az, planned))
        return [length * ax, length * ay, length * az]

    def _reach(self, along: float, upward: float, planned: Sequence[float]) -> float:
        """Return the largest acceleration [m/s^2] in a direction, within thrust and tilt limits.

        `along` and `upward` are the horizontal and vertical components of the direction's unit
        vector. If the acceleration `planned` [m/s^2] exceeds a limit of thrust or tilt, it replaces
        this limit.
        """
        gravity = self._gravity
        level, lift = _size(planned[:2]), planned[2] + gravity
        # The limits are raised as far as the planned acceleration needs. This is safe, because a
        # plan keeps the actual limits of the vehicle.
        reserve = np.fmax(self._reserve, level**2 + lift**2 - gravity**2)
        slope = np.fmax(self._slope, level / np.fmax(lift, _NOUGHT))
        # The thrust must balance 30 % of the weight, or what the plan needs if that is less.
        support = np.fmin(_LEAST_SUPPORT * gravity, lift)
        rising = gravity * upward
        by_thrust = np.sqrt(rising**2 + reserve) - rising
        by_tilt = slope * gravity / np.fmax(along - slope * upward, _NOUGHT)
        by_fall = (gravity - support) / np.fmax(-upward, _NOUGHT)
        return _least((by_thrust, by_tilt, by_fall))


MEASURED_STATES = tuple(
    f"rigid_body.{name}" for name in ("x", "y", "z", "vx", "vy", "vz", "phi", "theta", "psi")
) + tuple(f"rigid_body.{name}" for name in ("p", "q", "r"))
"""States that the controller measures, in this order, besides the rotor speeds."""

CONTROLLER_STATES = (
    *(f"position_lag_{axis}_m" for axis in "xyz"),
    *(f"velocity_lag_{axis}_m_per_s" for axis in "xyz"),
    *(f"disturbance_{axis}_m_per_s2" for axis in "xyz"),
    *(f"attitude_lag_{axis}_rad" for axis in ("phi", "theta", "psi")),
    *(f"rate_lag_{axis}_rad_per_s" for axis in "pqr"),
    *(f"disturbance_{axis}_rad_per_s2" for axis in "pqr"),
    *(f"commanded_{axis}_rad" for axis in ("phi", "theta")),
    *(f"commanded_{axis}_rad_per_s" for axis in "pq"),
)
"""The controller's own states, in order."""

# Fraction of the angular acceleration available at hover that a tilt command may use; the rest
# rejects disturbances of the attitude.
_COMMAND_SHARE = 0.6
# Ratio of rate gain to angle gain of the command filter: critical damping.
_CRITICAL = 4.0
# Indices of the horizontal components, and parts of the controller's state vector.
_HORIZONTAL = (0, 1)
_POSITION = slice(0, STATES_PER_LOOP)
_ATTITUDE = slice(STATES_PER_LOOP, 2 * STATES_PER_LOOP)
_COMMAND = slice(2 * STATES_PER_LOOP, len(CONTROLLER_STATES))

COMMAND_SIZE = 22
"""Length of a command: place, rate and acceleration of a setpoint, four numbers each; accelerations
along world x and y that the tilt is to give, and rates and accelerations of roll and pitch that are
known beforehand, two numbers each; three accelerations of a plan, and the payload released."""
# Parts of a command, in the order of `COMMAND_SIZE`; a reference may give no rates of tilt.
_SETPOINT = slice(0, 4), slice(4, 8), slice(8, 12)
_AHEAD, _TILT_RATE, _TILT_ACCELERATION = slice(12, 14), slice(14, 16), slice(16, 18)
_PLANNED, _RELEASED = slice(18, 21), 21
_UNKNOWN_TILTING, _UNPLANNED = (0.0,) * 4, (0.0,) * _AXES


class AdaptiveController:
    """Adaptive controller of a quadrotor: position loop, command filter, attitude loop, allocation.

    The position loop commands thrust and tilt. The attitude loop commands moments that follow the
    filtered tilt. See docs/theory/controller.md.

    Parameters
    ----------
    believed : Scenario
        Scenario whose vehicle, limits, gravity and gains are used, but not its wind.
    mixer : ndarray, shape (4, n_rotors)
        Result of `mixer_matrix`.
    learnt : sequence of three floats, optional
        Initial estimate of the acceleration by the air [m/s^2]; ignored if `baseline.adaptation` is
        false.
    """

    def __init__(
        self, believed: Scenario, mixer: FloatArray, learnt: Sequence[float] = (0.0,) * _AXES
    ) -> None:
        vehicle, limits, gains = believed.vehicle, believed.limits, believed.baseline.gains
        self._kinematics = KINEMATICS[vehicle.attitude]
        self._released = believed.release_schedule()
        self._mass = vehicle.total_mass
        self._gravity = believed.gravity
        self._inertia = (vehicle.Ix, vehicle.Iy, vehicle.Iz)
        self._mixer = mixer.tolist()
        self._allocation = Allocation(mixer, limits)
        self._rotor_gain = gains.rotor
        self._rotor_acceleration_max = limits.rotor_acceleration_max
        self._rotor_speed_max = limits.rotor_speed_max
        self._motor_lag = vehicle.motor_time_constant
        self._tilt_gain = gains.tilt_command
        self._tilt_lag = 1 / gains.tilt_command + 1 / gains.rotor
        available = self._allocation.tilting_moment_at(self._mass * believed.gravity)
        # A larger correction by the attitude loop would slow rotors down so far that thrust is
        # lost, and that they regain their speed too late: roll and pitch would then oscillate with
        # growing amplitude.
        self._correction_max = tuple(
            moment / inertia for moment, inertia in zip(available, self._inertia[:2], strict=True)
        )
        self._tilt_acceleration_max = tuple(_COMMAND_SHARE * most for most in self._correction_max)
        spare = limits.thrust_max / self._mass - believed.gravity
        acceleration_max = believed.gravity + gains.thrust_share * spare
        self._envelope = ThrustEnvelope(
            gravity=believed.gravity,
            acceleration_max=acceleration_max,
            tilt_max=followed_tilt(believed),
        )
        self._tilt_limits = _SHARE_OF_TILT * limits.roll_max, _SHARE_OF_TILT * limits.pitch_max
        self._position_loop, self._attitude_loop = _loops(believed)
        self._learnt = learnt if believed.baseline.adaptation else (0.0,) * _AXES

    def started(
        self, setpoint: Setpoint, body: Sequence[float], last: Sequence[float] | None = None
    ) -> list[float]:
        """Return the controller's states at the start of a flight or of a new reference.

        `body` has the values of `MEASURED_STATES`. `last` has the controller's final states for
        the previous reference, or is None at the start of a flight. If `last` is given, only the
        position loop is reset, so that the attitude command has no jump.
        """
        position, velocity, attitude, body_rates = body[0:3], body[3:6], body[6:9], body[9:12]
        angle_rates = self._kinematics.angle_rates(attitude, body_rates)
        yaw_error = attitude[2] - setpoint.place[3]
        yaw_rate_error = angle_rates[2] - setpoint.rate[3]
        place = self._position_loop.started(
            _difference(position, setpoint.place[:3]),
            _difference(velocity, setpoint.rate[:3]),
            self._learnt,
        )
        if last is not None:
            return [*place, *last[_ATTITUDE], *last[_COMMAND]]
        return [
            *place,
            *self._attitude_loop.started((0.0, 0.0, yaw_error), (0.0, 0.0, yaw_rate_error)),
            *attitude[:2],
            *angle_rates[:2],
        ]

    def command(self, reference: ReferencePath, t: float) -> list[float]:
        """Return the controller's input, computed from a reference path at time t [s].

        The input is the argument `command` of the controller; for its numbers, see `COMMAND_SIZE`.
        If the reference is a plan, all numbers are those at time t. For any other reference, the
        numbers that only a plan has are zero: the rates and accelerations of roll and pitch, and
        three planned accelerations. The two accelerations that determine the commanded tilt are
        those at a later time. The tilt of the vehicle lags behind its command by this time.
        """
        place, rate, acceleration, tilting = reference(t)
        # Mass of the payload released so far [kg].
        left = self._released(t)
        if tilting is not None:
            planned = acceleration[:_AXES]
            return [*place, *rate, *acceleration, *planned[:2], *tilting, *planned, left]
        # The vehicle reaches a commanded tilt with a lag. The look-ahead starts at zero, because
        # the vehicle is level at take-off.
        lead = self._tilt_lag * (1 - exp(-t / self._tilt_lag))
        ahead = reference(t + lead).acceleration[:2]
        return [*place, *rate, *acceleration, *ahead, *_UNKNOWN_TILTING, *_UNPLANNED, left]

    def __call__(
        self,
        command: Sequence[float],
        body: Sequence[float],
        omega: Sequence[float],
        states: Sequence[float],
    ) -> tuple[list[float], list[float]]:
        """Return the rotor accelerations [rad/s^2], and the derivatives of the controller's states.

        `command` is the result of the method `command`. `body` has the values of `MEASURED_STATES`,
        `omega` the rotor speeds [rad/s], and `states` those of `CONTROLLER_STATES`.
        """
        setpoint = Setpoint(*(command[part] for part in _SETPOINT))
        squares = [speed * speed for speed in omega]
        thrust, *achieved_moments = (_dot(row, squares) for row in self._mixer)
        direction = thrust_direction(*body[6:9])
        mass = self._mass - command[_RELEASED]
        specific = thrust / mass
        wanted, position_rates = self._position_loop(
            _difference(body[0:3], setpoint.place[:3]),
            _difference(body[3:6], setpoint.rate[:3]),
            setpoint.acceleration[:3],
            (
                specific * direction[0],
                specific * direction[1],
                specific * direction[2] - self._gravity,
            ),
            states[_POSITION],
        )
        for axis in _HORIZONTAL:
            wanted[axis] += command[_AHEAD][axis] - setpoint.acceleration[axis]
        ax, ay, az = self._envelope.limited(wanted, command[_PLANNED])
        force = (mass * ax, mass * ay, mass * (az + self._gravity))
        tilt_acceleration, command_rates = self._filtered(force, body[8], command, states[_COMMAND])
        moments, attitude_rates = self._moments(
            setpoint, tilt_acceleration, body, achieved_moments, states
        )
        targets = self._allocation.rotor_speeds(_dot(force, direction), moments)
        alpha = []
        for target, speed in zip(targets, omega, strict=True):
            most = self._most_rotor_acceleration(speed)
            alpha.append(_clipped(self._rotor_gain * (target - speed), -most, most))
        return alpha, [*position_rates, *attitude_rates, *command_rates]

    def _most_rotor_acceleration(self, speed: float) -> float:
        """Return the largest rotor acceleration [rad/s^2] at a rotor speed [rad/s].

        The same value limits speeding up and slowing down.
        """
        most = self._rotor_acceleration_max
        if not self._motor_lag:
            return most
        # Near the largest rotor speed, the lag of the motors reduces it.
        return np.fmin(most, np.fmax(self._rotor_speed_max - speed, 0.0) / self._motor_lag)

    def _filtered(
        self,
        force: Sequence[float],
        yaw: float,
        command: Sequence[float],
        states: Sequence[float],
    ) -> tuple[list[float], list[float]]:
        """Return accelerations of filtered roll and pitch [rad/s^2], and the rates of `states`.

        `states` are filtered roll and pitch [rad], and their rates. They follow the angles that
        point the thrust along `force` at the measured `yaw`. `command` is the result of the method
        `command`.
        """
        angles, angle_rates = states[:2], states[2:]
        targets = [
            _clipped(angle, -limit, limit)
            for angle, limit in zip(tilt_toward(force, yaw), self._tilt_limits, strict=True)
        ]
        accelerations = []
        for target, angle, rate, known_rate, known_acceleration, most in zip(
            targets,
            angles,
            angle_rates,
            command[_TILT_RATE],
            command[_TILT_ACCELERATION],
            self._tilt_acceleration_max,
            strict=True,
        ):
            closing = known_rate + braking_rate(target - angle, self._tilt_gain, most)
            correction = bend(_CRITICAL * self._tilt_gain * (closing - rate), most)
            accelerations.append(known_acceleration + correction)
        return accelerations, [*angle_rates, *accelerations]

    def _moments(
        self,
        setpoint: Setpoint,
        tilt_acceleration: Sequence[float],
        body: Sequence[float],
        achieved: Sequence[float],
        states: Sequence[float],
    ) -> tuple[list[float], list[float]]:
        """Return the commanded moments [N m], and the derivatives of the attitude loop's states.

        The commanded roll and pitch are in `states`, all states of the controller.
        `tilt_acceleration` is their second derivative. `setpoint` gives the yaw. `body` has the
        values of `MEASURED_STATES`, `achieved` the present moments.
        """
        command, attitude, body_rates = states[_COMMAND], body[6:9], body[9:12]
        turning = [
            moment / inertia for moment, inertia in zip(achieved, self._inertia, strict=True)
        ]
        reference = (*tilt_acceleration, setpoint.acceleration[3])
        demand, rates = self._attitude_loop(
            _difference(attitude, (*command[:2], setpoint.place[3])),
            _difference(
                self._kinematics.angle_rates(attitude, body_rates),
                (*command[2:], setpoint.rate[3]),
            ),
            reference,
            self._kinematics.angle_accelerations(attitude, body_rates, turning),
            states[_ATTITUDE],
        )
        for axis, most in enumerate(self._correction_max):
            demand[axis] = reference[axis] + bend(demand[axis] - reference[axis], most)
        wanted = self._kinematics.body_accelerations(attitude, body_rates, demand)
        return [inertia * a for inertia, a in zip(self._inertia, wanted, strict=True)], rates


def feedback_law(controller: AdaptiveController, dynamics: Dynamics) -> Law:
    """Return the controller as a feedback law, a function of the full state vector of a vehicle.

    The law is (command, states of the vehicle, states of the controller) -> (rotor accelerations
    [rad/s^2], derivatives of the controller's states). For the command, see
    `AdaptiveController.command`.
    """
    body = [list(dynamics.state_names).index(name) for name in MEASURED_STATES]
    rotors = rotor_columns(dynamics)

    def law(
        command: Sequence[float], x: Sequence[float], own: Sequence[float]
    ) -> tuple[list[float], list[float]]:
        return controller(command, [x[k] for k in body], [x[k] for k in rotors], own)

    return law


def _difference(value: Sequence[float], reference: Sequence[float]) -> list[float]:
    return [a - b for a, b in zip(value, reference, strict=True)]


def _dot(left: Sequence[float], right: Sequence[float]) -> float:
    return sum(a * b for a, b in zip(left, right, strict=True))


def _loops(believed: Scenario) -> tuple[BacksteppingLoop, BacksteppingLoop]:
    gains = believed.baseline.gains
    learning = 1.0 if believed.baseline.adaptation else 0.0
    position = BacksteppingLoop(
        outer=(gains.position,) * 3,
        inner=(gains.velocity,) * 3,
        reach=gains.speed_max / gains.position,
        identification=gains.force_identification,
        effort_max=gains.acceleration_max,
        adaptation=learning * gains.force_adaptation,
        disturbance_max=gains.force_max,
    )
    attitude = BacksteppingLoop(
        outer=(gains.attitude, gains.attitude, gains.yaw),
        inner=(gains.attitude_rate, gains.attitude_rate, gains.yaw_rate),
        reach=inf,
        identification=gains.moment_identification,
        effort_max=inf,
        adaptation=learning * gains.moment_adaptation,
        disturbance_max=gains.moment_max,
    )
    return position, attitude
