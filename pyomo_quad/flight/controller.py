"""The adaptive controller that stands in for the one the paper cites.

The paper compares its optimum with "the adaptive controller considered in [Yacef 2016]" (J.
Intell. Robot. Syst. 84, 2016: adaptive fuzzy backstepping) but prints neither law nor gains nor
reference.  This is a stand-in by published methods, not that controller: two cascaded loops of
adaptive backstepping (see `backstepping` for the law, its Lyapunov function and the literature).

1. Position.  m p'' = F - m g e3 + m d, with F the thrust vector and d unknown: the wind, which
   the controller is not told, and the error of the mass it believes in.  The loop gives the
   acceleration to ask for; `ThrustEnvelope` shortens it to what thrust and tilt allow.  The mass
   and the vertical part of d cannot be told apart near hover, so only d is adapted.
2. Tilt.  Roll and pitch that point the thrust that way, at the present yaw (`thrust_vector`);
   a filter of second order, whose acceleration the rotors can follow, makes of them a command
   with two derivatives.  The reference is known in advance: its horizontal acceleration is asked
   for earlier by the lag of filter and rotors.
3. Attitude.  I eta'' = M + I d_eta, Euler rates being body rates as in eq. (6).  The gyroscopic
   couplings of eq. (6), zero in steady flight, are part of the unknown d_eta.
4. Allocation.  Rotor speeds by the inverse of eq. (7), attitude before thrust before yaw; each
   rotor follows with the acceleration k (omega_command - omega), cut off at the same limit as
   the optimiser's.

What the actuators deliver less, filter, rotors and limits included, enters both loops as the
difference between the achieved and the demanded acceleration: the estimates of d are not misled
by it, and V of each loop does not increase whatever it is.

The vehicle is believed to be that of the scenario given, which need not be the one flown.
"""

from collections.abc import Sequence
from math import exp, inf

import numpy as np
from numpy.typing import NDArray

from pyomo_quad.flight.allocation import Allocation
from pyomo_quad.flight.backstepping import STATES_PER_LOOP, BacksteppingLoop
from pyomo_quad.flight.references import ReferencePath, Setpoint
from pyomo_quad.flight.saturation import bend, braking_rate
from pyomo_quad.flight.thrust_vector import ThrustEnvelope, thrust_direction, tilt_toward
from pyomo_quad.scenario import Scenario

__all__ = ["CONTROLLER_STATES", "MEASURED_STATES", "AdaptiveController"]

FloatArray = NDArray[np.float64]

MEASURED_STATES = tuple(
    f"rigid_body.{name}" for name in ("x", "y", "z", "vx", "vy", "vz", "phi", "theta", "psi")
) + tuple(f"rigid_body.{name}" for name in ("p", "q", "r"))
"""What the controller measures, in this order, beside the rotor speeds."""

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

# Share of the angular acceleration available at hover that a tilt command may use; the rest is
# left for holding the attitude against disturbances.
_COMMAND_SHARE = 0.6
# The filter's rate gain over its angle gain: critical damping.
_CRITICAL = 4.0
_HORIZONTAL = (0, 1)
_POSITION = slice(0, STATES_PER_LOOP)
_ATTITUDE = slice(STATES_PER_LOOP, 2 * STATES_PER_LOOP)
_COMMAND = slice(2 * STATES_PER_LOOP, len(CONTROLLER_STATES))


class AdaptiveController:
    """Adaptive backstepping of a quadrotor; see the module for the law.

    Parameters
    ----------
    believed : Scenario
        Vehicle, limits, gravity and gains that the controller knows. Its wind is not read.
    mixer : ndarray, shape (4, 4)
        Thrust and moments over squared rotor speeds, of `mixer_matrix`.
    """

    def __init__(self, believed: Scenario, mixer: FloatArray) -> None:
        vehicle, limits, gains = believed.vehicle, believed.limits, believed.baseline.gains
        self._mass = vehicle.total_mass
        self._gravity = believed.gravity
        self._inertia = (vehicle.Ix, vehicle.Iy, vehicle.Iz)
        self._mixer = mixer.tolist()
        self._allocation = Allocation(mixer, limits)
        self._rotor_gain = gains.rotor
        self._rotor_acceleration_max = limits.rotor_acceleration_max
        self._tilt_gain = gains.tilt_command
        self._tilt_lag = 1 / gains.tilt_command + 1 / gains.rotor
        available = self._allocation.tilting_moment_at(self._mass * believed.gravity)
        self._tilt_acceleration_max = tuple(
            _COMMAND_SHARE * moment / inertia
            for moment, inertia in zip(available, self._inertia[:2], strict=True)
        )
        spare = limits.thrust_max / self._mass - believed.gravity
        self._envelope = ThrustEnvelope(
            gravity=believed.gravity,
            acceleration_max=believed.gravity + gains.thrust_share * spare,
            tilt_max=min(gains.tilt_max, limits.roll_max, limits.pitch_max),
        )
        self._position_loop, self._attitude_loop = _loops(believed)

    def started(self, setpoint: Setpoint, body: Sequence[float]) -> list[float]:
        """Return the controller's states at the start of a flight, with nothing learnt.

        Parameters
        ----------
        setpoint : Setpoint
            What the reference asks for first.
        body : sequence of twelve floats
            The `MEASURED_STATES`.

        Returns
        -------
        list of 22 floats
            The `CONTROLLER_STATES`.
        """
        position, velocity, attitude, body_rates = body[0:3], body[3:6], body[6:9], body[9:12]
        yaw_error = attitude[2] - setpoint.place[3]
        yaw_rate_error = body_rates[2] - setpoint.rate[3]
        return [
            *self._position_loop.started(
                _difference(position, setpoint.place[:3]), _difference(velocity, setpoint.rate[:3])
            ),
            *self._attitude_loop.started((0.0, 0.0, yaw_error), (0.0, 0.0, yaw_rate_error)),
            *attitude[:2],
            *body_rates[:2],
        ]

    def __call__(
        self,
        reference: ReferencePath,
        t: float,
        body: Sequence[float],
        omega: Sequence[float],
        states: Sequence[float],
    ) -> tuple[list[float], list[float]]:
        """Return the rotor accelerations to apply and the rates of the controller's states.

        Parameters
        ----------
        reference : callable
            Time in s -> Setpoint, known in advance.
        t : float
            Time since the start, s.
        body : sequence of twelve floats
            The `MEASURED_STATES`.
        omega : sequence of four floats
            Rotor speeds, rad/s.
        states : sequence of 22 floats
            The `CONTROLLER_STATES`.

        Returns
        -------
        alpha : list of four floats
            Rotor accelerations within their limit, rad/s^2.
        rates : list of 22 floats
            Derivatives of the controller's states by time.
        """
        setpoint = reference(t)
        squares = [speed * speed for speed in omega]
        thrust, *achieved_moments = (_dot(row, squares) for row in self._mixer)
        direction = thrust_direction(*body[6:9])
        specific = thrust / self._mass
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
        ahead = reference(t + self._lead(t)).acceleration
        for axis in _HORIZONTAL:
            wanted[axis] += ahead[axis] - setpoint.acceleration[axis]
        ax, ay, az = self._envelope.limited(wanted)
        force = (self._mass * ax, self._mass * ay, self._mass * (az + self._gravity))
        tilt_acceleration, command_rates = self._filtered(force, body[8], states[_COMMAND])
        moments, attitude_rates = self._moments(
            setpoint, tilt_acceleration, body, achieved_moments, states
        )
        command = self._allocation.rotor_speeds(_dot(force, direction), moments)
        most = self._rotor_acceleration_max
        alpha = [
            min(max(self._rotor_gain * (target - speed), -most), most)
            for target, speed in zip(command, omega, strict=True)
        ]
        return alpha, [*position_rates, *attitude_rates, *command_rates]

    def _lead(self, t: float) -> float:
        """Return how far ahead to look, s; little at the start, where the vehicle is level."""
        return self._tilt_lag * (1 - exp(-t / self._tilt_lag))

    def _filtered(
        self, force: Sequence[float], yaw: float, command: Sequence[float]
    ) -> tuple[list[float], list[float]]:
        """Return the commanded tilt acceleration and the rates of the filter's states."""
        angles, angle_rates = command[:2], command[2:]
        accelerations = []
        for target, angle, rate, most in zip(
            tilt_toward(force, yaw), angles, angle_rates, self._tilt_acceleration_max, strict=True
        ):
            closing = braking_rate(target - angle, self._tilt_gain, most)
            accelerations.append(bend(_CRITICAL * self._tilt_gain * (closing - rate), most))
        return accelerations, [*angle_rates, *accelerations]

    def _moments(
        self,
        setpoint: Setpoint,
        tilt_acceleration: Sequence[float],
        body: Sequence[float],
        achieved: Sequence[float],
        states: Sequence[float],
    ) -> tuple[list[float], list[float]]:
        """Return the moments to ask for and the rates of the attitude loop's states."""
        command = states[_COMMAND]
        demand, rates = self._attitude_loop(
            _difference(body[6:9], (*command[:2], setpoint.place[3])),
            _difference(body[9:12], (*command[2:], setpoint.rate[3])),
            (*tilt_acceleration, setpoint.acceleration[3]),
            [moment / inertia for moment, inertia in zip(achieved, self._inertia, strict=True)],
            states[_ATTITUDE],
        )
        return [inertia * a for inertia, a in zip(self._inertia, demand, strict=True)], rates


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
