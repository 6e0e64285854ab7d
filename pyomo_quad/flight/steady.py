"""Steady flight of a vehicle, computed from its compiled equations: hover, trim and battery load.

In steady flight all states are constant, except for position and consumption. The states and
controls of a steady flight are called its trim.

For a proven lower bound of a mission's energy, the module also computes the thrust that a motion
requires, and the power at a given thrust: docs/theory/bound.md, eqs. (1) and (6).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import brentq, least_squares

from pyomo_quad.collocation import SolveError
from pyomo_quad.flight.baselines import declared_start
from pyomo_quad.flight.caches import Recent
from pyomo_quad.flight.flight import POSITION_STATES, VELOCITY_STATES
from pyomo_quad.model.battery import CHARGE_STATE
from pyomo_quad.model.battery_circuit import CIRCUIT_STATES

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from numpy.typing import ArrayLike
    from scipy.optimize import OptimizeResult

    from pyomo_quad.arrays import FloatArray
    from pyomo_quad.collocation import Dynamics
    from pyomo_quad.scenario import Scenario


# Names of states and other components of the declared model, or their beginnings.
ROLL, PITCH, _YAW = "rigid_body.phi", "rigid_body.theta", "rigid_body.psi"
_ROTOR_SPEED = "rotors.omega["
_CHARGE_RATE = "battery.dcharge_drawn_dt"
_FIRST_ROTOR = 1
_INDUCED = "power.induced_velocity"
_UNCREDITED = "power.uncredited_power"
# Velocity or acceleration of a vehicle at rest.
_STILL = np.zeros(3)
# Largest number of trims that are kept, far above the number of velocities in one search.
_MOST_TRIMS = 1000
# Largest rate of change of a state in a trim, in the state's own unit per second.
_AT_REST = 1e-7
# Residual of the least-squares search below which Newton steps with its last Jacobian follow, and
# number of these steps.
_NEARLY, _SHARPENINGS = 1e-2, 4
# Relative tolerance of a rotor speed, near the rounding error, because the lower bound uses it.
_PRECISION = 1e-15
# Velocities at which linearity is tested, m/s: each axis alone, and all axes together.
_TRIALS = np.array([[3.0, 0, 0], [0, 3.0, 0], [0, 0, 3.0], [-5.0, 7.0, -2.0]])
# Rounding error of a balance that is linear, relative to the thrust.
_ROUNDING = 1e-9


@dataclass(frozen=True, kw_only=True)
class Trim:
    """Steady flight at a constant velocity: states, controls and power.

    Attributes
    ----------
    states : ndarray, shape (n_states,)
        States, in the order of the states in the compiled equations.
    controls : ndarray, shape (n_controls,)
        Controls, in the order of the controls in the compiled equations.
    power_W : float
        Power drawn in the steady flight [W].
    """

    states: FloatArray
    controls: FloatArray
    power_W: float


@dataclass(frozen=True, kw_only=True)
class HoverState:
    """Hover with the battery in its initial state: rotor speed, power and battery.

    Current, voltage and charge rate of the battery are those under the power of the hover. The
    battery can give at most `greatest_battery_power_W`.
    """

    rotor_speed_rad_per_s: float
    thrust_N: float
    power_W: float
    battery_current_A: float
    battery_voltage_V: float
    greatest_battery_power_W: float
    charge_rate_Ah_per_s: float


def _sharpen(
    residual: Callable[[FloatArray], FloatArray], found: OptimizeResult, scale: FloatArray
) -> None:
    """Reduce the residual of a least-squares solution to rounding errors by Newton steps.

    `found` is changed in place. A step is not unique; the shortest one is taken, relative to
    `scale`.
    """
    for _ in range(_SHARPENINGS):
        # A large residual means that no solution is near.
        if not np.max(np.abs(found.fun), initial=0.0) <= _NEARLY:
            break
        found.x -= np.linalg.lstsq(found.jac * scale, found.fun, rcond=None)[0] * scale
        found.fun = residual(found.x)


class SteadyFlight:
    """Calculator of a vehicle's steady flight from its compiled equations.

    Parameters
    ----------
    scenario : Scenario
        The scenario, which gives the initial position and state of charge.
    dynamics : Dynamics
        The compiled equations of the vehicle in the wind of the steady flight, which may be still
        air.
    known : mapping, optional
        State name -> initial value, for states of a user's own model that the mission does not
        define.
    """

    def __init__(
        self, scenario: Scenario, dynamics: Dynamics, known: Mapping[str, float] | None = None
    ) -> None:
        names = dynamics.state_names
        start = dynamics.initial_states() | declared_start(scenario, dynamics) | dict(known or {})
        self._dynamics = dynamics
        self._start = np.array([start[name] for name in names])
        self._rotors = [k for k, name in enumerate(names) if name.startswith(_ROTOR_SPEED)]
        self._trims: Recent[Trim] = Recent(_MOST_TRIMS)

    @property
    def dynamics(self) -> Dynamics:
        """The equations of the vehicle, in the wind of the steady flight."""
        return self._dynamics

    def trim(self, velocity: ArrayLike = _STILL, near: Trim | None = None) -> Trim:
        """Return the steady flight at a velocity over ground, in world axes [m/s].

        Position and heading are those of the mission's start, and limits are not applied. The
        flight `near`, at a similar velocity, is the initial guess. Raises a SolveError if there is
        no steady flight.
        """
        wanted = np.array(velocity, dtype=float)
        key = tuple(wanted.tolist())
        # The guess has no effect on a velocity that was computed before.
        return self._trims.get(key) or self._trims.store(key, self._trimmed(wanted, near))

    def _trimmed(self, velocity: FloatArray, near: Trim | None) -> Trim:
        """Return the steady flight at a velocity over ground, computed from the initial guess.

        Arguments and result are those of `trim`, which keeps the results.
        """
        names, t = list(self._dynamics.state_names), self._dynamics.start
        # States that measure consumption change in every flight. They are the states that the
        # mission fixes at the start and leaves free at the end. In a trim they keep their initial
        # values.
        used_up = set(self._dynamics.states_used_up)
        held = used_up | {*POSITION_STATES, _YAW}
        free = [k for k, name in enumerate(names) if name not in held]
        resting = [k for k, name in enumerate(names) if name not in used_up]
        wanted, guess = np.zeros(len(names)), self._start.copy()
        for place, rate, speed in zip(POSITION_STATES, VELOCITY_STATES, velocity, strict=True):
            if place in names:
                wanted[names.index(place)] = speed
            if rate in names:
                guess[names.index(rate)] = speed
        split = len(free)

        def flight(unknown: FloatArray) -> tuple[FloatArray, FloatArray]:
            states = guess.copy()
            states[free] = unknown[:split]
            return states, unknown[split:]

        def unrest(unknown: FloatArray) -> FloatArray:
            return (self._dynamics.rates(t, *flight(unknown)) - wanted)[resting]

        def slopes(unknown: FloatArray) -> FloatArray:
            by_state, by_control = self._dynamics.slopes(t, *flight(unknown))
            return np.hstack([by_state[:, free], by_control])[resting]

        first = np.concatenate([guess[free], np.zeros(len(self._dynamics.control_names))])
        scale = np.maximum(1.0, np.abs(first))
        if near is not None:
            first = np.concatenate([near.states[free], near.controls])
        found = least_squares(unrest, first, slopes, x_scale=scale)
        _sharpen(unrest, found, scale)
        if not np.max(np.abs(found.fun), initial=0.0) <= _AT_REST:
            raise SolveError(
                f"steady flight: the model has none at {velocity.tolist()} m/s; "
                "even without its limits, some state is never at rest."
            )
        states, controls = flight(found.x)
        power = self._dynamics.integrand(t, states, controls)
        return Trim(states=states, controls=controls, power_W=float(power))

    def reading(self, names: tuple[str, ...], trim: Trim) -> FloatArray:
        """Return the values of n components of the model in a steady flight, shape (n,).

        `names` has the full names of the components, such as "battery.current".
        """
        return self._rows(tuple((n, None) for n in names), trim.states[None], trim.controls[None])[
            0
        ]

    def held_in(self, trim: Trim) -> dict[str, float]:
        """Return the constant states of a steady flight, such as attitude and rotor speeds.

        The result maps full names to values, without position, velocity and consumption. It
        includes the induced velocity, which some models have as an algebraic variable.
        """
        moved = {*self._dynamics.states_used_up, *POSITION_STATES, *VELOCITY_STATES}
        named = dict(zip(self._dynamics.state_names, trim.states.tolist(), strict=True))
        held = {name: value for name, value in named.items() if name not in moved}
        if self._dynamics.has(_INDUCED):
            held[_INDUCED] = float(self.reading((_INDUCED,), trim)[0])
        return held

    def rotor_speeds(self, trim: Trim) -> FloatArray:
        """Return the speed of each rotor in a steady flight [rad/s]."""
        return trim.states[self._rotors]

    def charge_rates(
        self, trim: Trim, drawn: FloatArray, circuit: FloatArray | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Return charge rates [A h/s] and power reserves [W] of a steady flight at charges drawn.

        `drawn` is counted from the full pack [A h]. `circuit` has relaxation voltage [V] and
        temperature [K], shape (n, n_circuit), if they are states; by default those in `trim`. The
        power reserve is the battery's greatest power minus the power of the flight.
        """
        states = np.tile(trim.states, (len(drawn), 1))
        controls = np.tile(trim.controls, (len(drawn), 1))
        states[:, self._dynamics.state_names.index(CHARGE_STATE)] = drawn
        if circuit is not None:
            states[:, self._circuit] = circuit
        keys = ((_CHARGE_RATE, None), ("battery.power_reserve", None))
        rate, reserve = self._rows(keys, states, controls).T
        return rate, reserve

    def endurance(self, trim: Trim, depth: float, samples: int) -> float:
        """Return the time for which a full battery sustains a steady flight [s].

        The time is the integral of 1 / (charge rate) over the charge drawn, computed with `samples`
        points. `depth` is the fraction of the capacity that is drawn. The time is infinite if no
        charge is drawn, and zero if the battery is too weak.
        """
        drawn = np.linspace(0.0, depth * self.pack_capacity, samples)
        rate, reserve = self.charge_rates(trim, drawn, self._circuit_under_load(trim, drawn))
        if np.min(reserve) < 0.0:
            return 0.0
        return float(np.trapezoid(1.0 / rate, drawn)) if np.min(rate) > 0.0 else np.inf

    @property
    def _circuit(self) -> list[int]:
        """Indices of the battery's relaxation voltage and temperature among the states, if any."""
        return [k for k, n in enumerate(self._dynamics.state_names) if n in CIRCUIT_STATES]

    def _circuit_under_load(self, trim: Trim, drawn: FloatArray) -> FloatArray | None:
        """Return the RC pair's voltage [V] and the pack's temperature [K] under a steady load.

        The rows belong to increasing charges `drawn` from the full pack [A h]. A quantity that is
        no state of the model has no column; None if neither has.
        """
        own, charge = self._circuit, self._dynamics.state_names.index(CHARGE_STATE)
        if not own:
            return None

        def slope(drawn: float, circuit: FloatArray) -> FloatArray:
            state = trim.states.copy()
            state[charge], state[own] = drawn, circuit
            rates = self._dynamics.rates(self._dynamics.start, state, trim.controls)
            return np.asarray(rates[own] / rates[charge])

        ends = float(drawn[0]), float(drawn[-1])
        found = solve_ivp(slope, ends, trim.states[own], t_eval=drawn, method="LSODA", rtol=1e-6)
        # The battery may be unable to give the later charges under this load. The last possible row
        # is repeated for them.
        missing = len(drawn) - found.y.shape[1]
        return np.asarray(np.pad(found.y.T, ((0, missing), (0, 0)), mode="edge"))

    @cached_property
    def _hovering(self) -> Trim:
        return self.trim()

    @property
    def hover_power(self) -> float:
        """Power of hover [W], in the wind of the attribute `dynamics`."""
        return self._hovering.power_W

    @property
    def hover_speed(self) -> float:
        """Rotor speed of hover [rad/s], the mean of all rotors."""
        return float(np.mean(self._hovering.states[self._rotors]))

    @cached_property
    def hover(self) -> HoverState:
        """Hover in the wind of the attribute `dynamics`, with the battery in its initial state."""
        names = (
            *("rotors.total_thrust", "battery.current", "battery.voltage"),
            "battery.greatest_power",
        )
        thrust, current, voltage, greatest = self._read(names, self._hovering.states).tolist()
        return HoverState(
            rotor_speed_rad_per_s=self.hover_speed,
            thrust_N=thrust,
            power_W=self.hover_power,
            battery_current_A=current,
            battery_voltage_V=voltage,
            greatest_battery_power_W=greatest,
            charge_rate_Ah_per_s=self._charge_rate(self._hovering.states),
        )

    def thrust(self, speed: ArrayLike) -> FloatArray:
        """Return the total thrust [N] if all rotors turn at the same speed.

        `speed` has rotor speeds [rad/s]; the result has the same shape.
        """
        return self._over_speeds("rotors.total_thrust", speed)

    def power(self, speed: ArrayLike) -> FloatArray:
        """Return the total power [W] if all rotors turn at the same, constant speed.

        `speed` has rotor speeds [rad/s]; the result has the same shape.
        """
        return self._over_speeds("power.total", speed)

    def uncredited_power(self, speed: ArrayLike) -> FloatArray:
        """Return the power [W] at equal, constant rotor speeds, without a lower limit of zero.

        In a model without regeneration, the method `power` replaces a negative power of a rotor by
        zero. This method returns the negative power, and leaves out the power of the electronics.
        With regeneration, both methods are equal. `speed` has rotor speeds [rad/s]; the result has
        the same shape.
        """
        rotors = range(_FIRST_ROTOR, _FIRST_ROTOR + len(self._rotors))
        # Without regeneration, a braking rotor returns no energy (see `model.power`).
        if not self._dynamics.has(_UNCREDITED):
            return self.power(speed)
        return np.sum([self._over_speeds(_UNCREDITED, speed, index=j) for j in rotors], axis=0)

    def power_of_accelerating(self, speed: ArrayLike) -> FloatArray:
        """Return the power that accelerates all rotors, per unit of acceleration [J s/rad].

        It changes their kinetic energy. All rotors have the same acceleration [rad/s^2]. The result
        has the shape of `speed` [rad/s].
        """
        name = _UNCREDITED if self._dynamics.has(_UNCREDITED) else "power.rotor_power"
        up, down = (self.rotor_value(name, speed, sign) for sign in (1.0, -1.0))
        # Losses that are equal at +1 and -1 rad/s^2 cancel. What is left is the power that rotors
        # return when they slow down.
        return len(self._rotors) * (up - down) / 2.0

    def power_at_thrust(self, thrust: float) -> float:
        """Return the power [W] at a total thrust [N], with equal, constant rotor speeds.

        A negative thrust counts as zero.
        """
        if thrust <= 0.0:
            return float(self.power(0.0))
        return float(self.power(self._speed_where(self.thrust, thrust)))

    def rotor_value(self, name: str, speed: ArrayLike, acceleration: ArrayLike = 0.0) -> FloatArray:
        """Return a quantity of one rotor at given speeds [rad/s] and accelerations [rad/s^2].

        `name` is an expression of the model over rotors and time, such as
        ``"rotors.motor_torque"``. `speed` and `acceleration` are broadcast.
        """
        speeds, accelerations = np.broadcast_arrays(
            np.asarray(speed, dtype=float), np.asarray(acceleration, dtype=float)
        )
        return self._over_speeds(name, speeds, accelerations, index=_FIRST_ROTOR)

    def yaw_moment(self, odd_speed: float, even_speed: float) -> float:
        """Return the yaw moment [N m] if odd rotors turn at one speed and even rotors at another.

        `odd_speed` is the constant speed of rotors 1 and 3 [rad/s]. `even_speed` is the constant
        speed of rotors 2 and 4 [rad/s].
        """
        states = self._start.copy()
        states[self._rotors[::2]], states[self._rotors[1::2]] = odd_speed, even_speed
        return float(self._read(("rotors.yaw_moment",), states)[0])

    def pack_under(self, power: float) -> tuple[float, float, float]:
        """Return current [A], voltage [V] and charge per second [A h/s] of the battery under load.

        The load ``power`` [W] is the electrical power of all rotors together. The rotors turn at
        equal speed. The battery is in its initial state.
        """
        states = self._start.copy()
        states[self._rotors] = self._speed_where(self.power, power)
        current, voltage = self._read(("battery.current", "battery.voltage"), states).tolist()
        return current, voltage, self._charge_rate(states)

    @property
    def greatest_pack_power(self) -> float:
        """Greatest power that the battery can give in its initial state [W].

        At this power, the voltage is half of the voltage without load. The scenario's limits on
        voltage and current are not applied.
        """
        return float(self._read(("battery.greatest_power",), self._start)[0])

    def stored_energy(self, depth: float, samples: int) -> float:
        """Return the energy of a full battery down to a depth of discharge, without losses [J].

        `depth` is the fraction of the capacity that is drawn, `samples` the number of quadrature
        points.
        """
        states = np.tile(self._start, (samples, 1))
        column = self._dynamics.state_names.index(CHARGE_STATE)
        drawn = states[:, column] = np.linspace(0.0, depth * self.pack_capacity, samples)
        # A real discharge loses a part of this energy inside the battery.
        voltage = self._rows((("battery.open_circuit_voltage", None),), states)[:, 0]
        hover = self.hover
        coulombs_per_ampere_hour = hover.battery_current_A / hover.charge_rate_Ah_per_s
        return float(np.trapezoid(voltage, drawn) * coulombs_per_ampere_hour)

    @cached_property
    def pack_capacity(self) -> float:
        """Capacity of the battery [A h]."""
        states = np.tile(self._start, (2, 1))
        states[:, self._dynamics.state_names.index(CHARGE_STATE)] = 0.0, 1.0
        full, less = self._rows((("battery.state_of_charge", None),), states)[:, 0].tolist()
        return full / (full - less)

    def _charge_rate(self, states: FloatArray) -> float:
        rates = self._dynamics.rates(
            self._dynamics.start, states, np.zeros(len(self._dynamics.control_names))
        )
        return float(rates[self._dynamics.state_names.index(CHARGE_STATE)])

    def _speed_where(self, reading: object, wanted: float) -> float:
        """Return the rotor speed [rad/s] at which an increasing quantity has a wanted value.

        `reading` takes the common speed of all rotors, and returns the quantity.
        """

        def excess(speed: float) -> float:
            return float(reading(speed)) - wanted  # type: ignore[operator]

        fastest = self.hover_speed
        while excess(fastest) < 0.0:
            fastest *= 2.0
        return float(brentq(excess, 0.0, fastest, xtol=1e-12, rtol=_PRECISION))

    def _over_speeds(
        self,
        name: str,
        speed: ArrayLike,
        acceleration: ArrayLike = 0.0,
        index: int | None = None,
    ) -> FloatArray:
        speeds = np.asarray(speed, dtype=float)
        states = np.tile(self._start, (speeds.size, 1))
        states[:, self._rotors] = speeds.reshape(-1, 1)
        controls = np.zeros((speeds.size, len(self._dynamics.control_names)))
        controls += np.broadcast_to(acceleration, speeds.shape).reshape(-1, 1)
        return self._rows(((name, index),), states, controls)[:, 0].reshape(speeds.shape)

    def _read(self, names: tuple[str, ...], states: FloatArray) -> FloatArray:
        return self._rows(tuple((name, None) for name in names), states[None, :])[0]

    def _rows(
        self,
        keys: tuple[tuple[str, int | None], ...],
        states: FloatArray,
        controls: FloatArray | None = None,
    ) -> FloatArray:
        if controls is None:
            controls = np.zeros((len(states), len(self._dynamics.control_names)))
        times = np.full(len(states), self._dynamics.start)
        return self._dynamics.table(keys, times, states, controls)


class MomentumDemand:
    """Calculator of the thrust vector that a motion of the vehicle requires (momentum balance).

    Whatever the attitude, the required thrust is mass * (a - a_0), with the acceleration a of the
    motion. Weight and aerodynamic force would cause the acceleration a_0 if the rotors stood still.
    For drag that is linear in the velocity, see docs/theory/bound.md, eq. (1).

    Attributes
    ----------
    mass, drag : ndarray, shape (3,)
        Thrust per acceleration [kg] and per velocity [kg/s] along each world axis.
    is_linear : bool
        Whether the thrust along each axis is linear in the velocity along it, and independent of
        the others. Otherwise `drag` is meaningless.
    """

    def __init__(self, dynamics: Dynamics) -> None:
        self._dynamics = dynamics
        names = list(dynamics.state_names)
        self._velocity = [names.index(name) for name in VELOCITY_STATES]
        self._rotors = [k for k, name in enumerate(names) if name.startswith(_ROTOR_SPEED)]
        self._controls = np.zeros(len(dynamics.control_names))
        self._at_rest = np.zeros(len(names))
        self.mass = np.array([self._mass(axis) for axis in range(3)])
        start = dynamics.start
        at_rest = self.thrust(start)
        axes = range(len(VELOCITY_STATES))
        self.drag = np.array([self.thrust(start, np.eye(3)[i])[i] for i in axes]) - at_rest
        scale = float(np.max(np.abs(at_rest)) + np.max(np.abs(self.drag)))
        errors = [
            self.thrust(start, velocity) - at_rest - self.drag * velocity for velocity in _TRIALS
        ]
        self.is_linear = bool(np.max(np.abs(errors)) <= _ROUNDING * scale)

    def thrust(
        self, time: float, velocity: FloatArray = _STILL, acceleration: FloatArray = _STILL
    ) -> FloatArray:
        """Return the required thrust vector [N] at a time, for a velocity and an acceleration.

        Velocity [m/s] and acceleration [m/s^2] are in world axes; both are zero by default.
        """
        states = self._at_rest.copy()
        states[self._velocity] = velocity
        return np.asarray(self.mass * (acceleration - self._acceleration(time, states)))

    def _acceleration(self, time: float, states: FloatArray) -> FloatArray:
        return np.asarray(self._dynamics.rates(time, states, self._controls)[self._velocity])

    def _mass(self, axis: int) -> float:
        """Return the mass that the equations of motion imply along a world axis [kg].

        It is the ratio of a test thrust along this axis to the acceleration that the thrust adds.
        """
        names, start = self._dynamics.state_names, self._dynamics.start
        states = self._at_rest.copy()
        if axis == 0:
            states[names.index(PITCH)] = np.pi / 2
        elif axis == 1:
            states[names.index(ROLL)] = -np.pi / 2
        without = self._acceleration(start, states)
        states[self._rotors] = 1e3
        keys = (("rotors.total_thrust", None),)
        times, controls = np.array([start]), self._controls[None, :]
        thrust = float(self._dynamics.table(keys, times, states[None, :], controls)[0, 0])
        return float(thrust / (self._acceleration(start, states) - without)[axis])


def battery_shortfalls(scenario: Scenario, steady: SteadyFlight) -> tuple[str, ...]:
    """Return the reason why the battery cannot supply a hover of the mission's duration, in words.

    The result is empty if the battery can supply it, otherwise it has one entry.
    """
    hover = steady.hover
    pack = scenario.battery
    cells = f"battery {pack.use}, {pack.cells_series} x {pack.cells_parallel} cells"
    greatest = hover.greatest_battery_power_W
    if greatest <= 0.0:
        return (f"{cells}: has no voltage at the start; correct its K, or charge it.",)
    if hover.power_W > greatest:
        needs = f"hover needs {hover.power_W:.4g} W, the pack delivers at most {greatest:.4g} W"
        return (f"{cells}: {needs}; add cells.",)
    duration = scenario.mission.fixed_duration
    needed = hover.charge_rate_Ah_per_s * duration
    held = steady.pack_capacity * pack.initial_state_of_charge / 100
    if needed > held:
        needs = f"hovering for {duration:.4g} s needs {needed:.4g} Ah, the pack holds {held:.4g} Ah"
        return (f"{cells}: {needs}; add cells or shorten the mission.",)
    return ()
