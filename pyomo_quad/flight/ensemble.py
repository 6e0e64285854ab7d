"""Simultaneous simulation of many flights along one reference, each with random wind and mass.

Control law, equations and assessment are those of a single flight; only the integration differs.
All flights together take Runge-Kutta steps of fixed length. The noise of the turbulence is constant
for `LONGEST_STEP_S`. The steps have this length, or a fraction of it if stability or accuracy
requires shorter steps. A test compares the result with SciPy's adaptive integration.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from math import ceil

import numpy as np

from pyomo_quad.arrays import FloatArray
from pyomo_quad.collocation import Dynamics, SteppedFlights, SteppedLoops
from pyomo_quad.flight.baselines import (
    broken_under_control,
    closed_loop,
    start_state,
    wanted_at_goal,
)
from pyomo_quad.flight.columns import ENERGY
from pyomo_quad.flight.controller import (
    COMMAND_SIZE,
    CONTROLLER_STATES,
    MEASURED_STATES,
    AdaptiveController,
    feedback_law,
    mixer_matrix,
)
from pyomo_quad.flight.deadline import keep_time
from pyomo_quad.flight.flight import (
    ARRIVAL_DISTANCE_M,
    ARRIVAL_SPEED_M_PER_S,
    POSITION_STATES,
    VELOCITY_STATES,
    Flown,
)
from pyomo_quad.flight.references import ReferencePath
from pyomo_quad.flight.verification import (
    BALANCE_KEYS,
    BALANCE_TOLERANCE,
    CHARGE_KEY,
    balance_lacking,
    has_balance,
)
from pyomo_quad.scenario import Scenario

#: Longest step of the integration [s], over which the noise of turbulence is constant.
LONGEST_STEP_S = 0.02
# Largest product of step length and controller gain, at which a flight ends within 1e-4 m of the
# exact solution; and largest product of step length and rate of the fastest mode, below the
# stability limit of the method, 2.78.
_SHARE_OF_LAG, _STABLE = 1.2, 2.2
# Number added to all states before differentiation (units of the states): the derivative of a norm
# is not defined at zero.
_OFF_NOUGHT = 1e-6
# Steps between two samples of a flight. At 25 samples per second, a path at 10 m/s around a corner
# of 2 m radius deviates from its chord by 1 cm.
_STEPS_PER_SAMPLE = 2
# Number of flights whose limits are evaluated in one call; more take more memory and no less time.
_JUDGED_AT_ONCE = 25

# Words for a miss of the goal, too much speed at the goal, and a lack of battery power or charge.
NOT_THERE = "distance from the goal at the end"
NOT_AT_REST = "speed at the end"
NOT_FED = "power or charge of the pack"


@dataclass(frozen=True, kw_only=True)
class Draws:
    """Random parameters, noise and initial states of many simulated flights.

    Attributes
    ----------
    count : int
        Number n of flights.
    numbers : mapping to ndarray, shape (n,)
        Full name of a parameter -> values, constant during a flight.
    noise : mapping to ndarray, shape (n_steps, n)
        Full name of a parameter -> values in steps of `LONGEST_STEP_S` [s].
    start : mapping to ndarray, shape (n,)
        Full name of a state -> values at take-off.
    """

    count: int
    numbers: Mapping[str, FloatArray] = field(default_factory=dict)
    noise: Mapping[str, FloatArray] = field(default_factory=dict)
    start: Mapping[str, FloatArray] = field(default_factory=dict)

    def part(self, chosen: slice) -> "Draws":
        """Return the random numbers of the flights that the slice `chosen` selects."""
        return Draws(
            count=len(range(self.count)[chosen]),
            numbers={name: values[chosen] for name, values in self.numbers.items()},
            noise={name: values[:, chosen] for name, values in self.noise.items()},
            start={name: values[chosen] for name, values in self.start.items()},
        )


@dataclass(frozen=True, kw_only=True)
class Ending:
    """Result of one simulated flight: energy, arrival, deviations, broken limits.

    Attributes
    ----------
    energy_J, charge_used_percent : float
        Energy spent, and charge drawn in per cent of the battery's capacity.
    miss_m, end_speed_m_per_s : float
        Distance from the goal and speed, at the end.
    largest_deviation_m, peak_tilt_rad : float
        Largest distance from the reference at equal times, and largest tilt.
    broken : mapping
        Name of each broken limit in words -> amount.
    """

    energy_J: float
    charge_used_percent: float
    miss_m: float
    end_speed_m_per_s: float
    largest_deviation_m: float
    peak_tilt_rad: float
    # Distance [m] or speed [m/s] on arrival, missing fraction of power or charge of the battery, or
    # violation of another limit, relative to the larger of 1 and the limit.
    broken: Mapping[str, float]

    @property
    def has_succeeded(self) -> bool:
        """Whether the simulated flight reached its goal and broke no limit."""
        return not self.broken

    @property
    def has_arrived(self) -> bool:
        """Whether the simulated flight ended at its goal and at rest.

        The distance from the goal may be at most `ARRIVAL_DISTANCE_M` [m], and the speed at most
        `ARRIVAL_SPEED_M_PER_S` [m/s].
        """
        return NOT_THERE not in self.broken and NOT_AT_REST not in self.broken


@dataclass(frozen=True, kw_only=True)
class FlownOften:
    """Results of many simulated flights: quantities over time, and the outcome of each flight.

    Attributes
    ----------
    t : ndarray, shape (n_samples,)
        Times [s].
    tracks : mapping to ndarray, shape (n_samples, n)
        Name of a quantity -> its values over time for each of n flights. The constant `TRACKS` has
        the names.
    endings : tuple of Ending
        Energy, arrival, deviations and broken limits of each flight.
    """

    t: FloatArray
    tracks: Mapping[str, FloatArray]
    endings: tuple[Ending, ...]


SPEED, TILT, OFF = "speed_m_per_s", "tilt_rad", "distance_from_reference_m"
TRACKS = ("x_m", "y_m", "z_m", SPEED, TILT, ENERGY, OFF)
"""Names of the quantities stored over time for each flight."""


class EnsembleSimulation:
    """Simulation of many flights of one scenario along one reference path, under feedback.

    Parameters
    ----------
    scenario : Scenario
        The mission, with fixed times, and the vehicle as the controller assumes it.
    dynamics : Dynamics
        Equations of the vehicle in the wind. The gusts and the random errors of forecast, mass and
        power are parameters of these equations. `varied` names these parameters, and the method
        `fly` takes their values for each flight.
    reference : callable
        Takes a time [s] and returns the `Setpoint` to follow.
    varied : sequence of str
        Full names of the parameters that differ between the flights.
    """

    def __init__(
        self,
        scenario: Scenario,
        dynamics: Dynamics,
        reference: ReferencePath,
        varied: Sequence[str] = (),
    ) -> None:
        self._scenario, self._dynamics, self._reference = scenario, dynamics, reference
        self._controller = AdaptiveController(scenario, mixer_matrix(dynamics))
        self._varied = tuple(varied)
        self._loops = SteppedLoops(
            dynamics,
            feedback_law(self._controller, dynamics),
            n_command=COMMAND_SIZE,
            n_own=len(CONTROLLER_STATES),
            varied=self._varied,
        )
        self._columns = {name: k for k, name in enumerate(dynamics.state_names)}
        self._times = _step_times(scenario, self._fastest_rate())

    def fly(self, draws: Draws) -> FlownOften:
        """Simulate one flight for each set of random numbers.

        `draws` must have every name in `varied`, either in its `numbers` (constant parameters) or
        in its `noise` (varying parameters). A SolveError is raised if a state is not finite or the
        time limit of the enclosing `Deadline` has passed.
        """
        keep_time()
        steps = np.floor(0.5 * (self._times[1:] + self._times[:-1]) / LONGEST_STEP_S).astype(int)
        held = {
            name: values[np.minimum(steps, len(values) - 1)] for name, values in draws.noise.items()
        }
        told = held | dict(draws.numbers)
        sampled = np.zeros(len(self._times), dtype=bool)
        sampled[::_STEPS_PER_SAMPLE] = True
        sampled |= np.isin(self._times, self._scenario.nominal_times)
        flown = self._loops.fly(
            self._times,
            self._started(draws),
            lambda t: self._controller.command(self._reference, t),
            [told[name] for name in self._varied],
            sampled=sampled,
        )
        return self._judged(flown, draws)

    def _fastest_rate(self) -> float:
        """Return the decay rate of the fastest mode of the closed loop at take-off [1/s].

        The integration steps must be short enough to be stable at this rate.
        """
        # The gains of the controller alone do not determine the rate. Owing to the reaction moment
        # of accelerating rotors on the body, the yaw loop is several times faster than any gain.
        loop = closed_loop(self._dynamics, self._controller)
        command = np.array([self._controller.command(self._reference, 0.0)])
        # Where an error is exactly zero, the derivative of its norm is not defined.
        begun = self._started(Draws(count=1)) + _OFF_NOUGHT
        _, by_joint = loop.slopes(np.zeros(1), begun, command)
        return float(-np.linalg.eigvals(by_joint[0]).real.min())

    def _started(self, draws: Draws) -> FloatArray:
        start = np.tile(start_state(self._scenario, self._dynamics), (draws.count, 1))
        for name, values in draws.start.items():
            start[:, self._columns[name]] = values
        body = start[0, [self._columns[name] for name in MEASURED_STATES]].tolist()
        own = self._controller.started(self._reference(0.0), body)
        return np.hstack([start, np.tile([*own, 0.0], (draws.count, 1))])

    def _judged(self, flown: SteppedFlights, draws: Draws) -> FlownOften:
        size = len(self._columns)
        states, energy = flown.joint[:, :, :size], flown.joint[:, :, -1]
        place, velocity = (
            states[:, :, [self._columns[name] for name in names]]
            for names in (POSITION_STATES, VELOCITY_STATES)
        )
        roll, pitch = (states[:, :, self._columns[f"rigid_body.{a}"]] for a in ("phi", "theta"))
        tilt = np.arccos(np.clip(np.cos(roll) * np.cos(pitch), -1.0, 1.0))
        wanted = np.array([self._reference(t).place[:3] for t in flown.t.tolist()])
        off = np.linalg.norm(place - wanted[:, None, :], axis=2)
        over_time = (*np.moveaxis(place, 2, 0), np.linalg.norm(velocity, axis=2), tilt, energy, off)
        tracks = dict(zip(TRACKS, over_time, strict=True))
        endings: list[Ending] = []
        for begin in range(0, draws.count, _JUDGED_AT_ONCE):
            keep_time()
            chosen = slice(begin, begin + _JUDGED_AT_ONCE)
            part = SteppedFlights(
                t=flown.t, joint=flown.joint[:, chosen], controls=flown.controls[:, chosen]
            )
            greatest = [tracks[name][:, chosen].max(axis=0) for name in (OFF, TILT)]
            endings += self._endings(part, draws.part(chosen), *greatest)
        return FlownOften(t=flown.t, tracks=tracks, endings=tuple(endings))

    def _endings(
        self, flown: SteppedFlights, draws: Draws, off: FloatArray, tilt: FloatArray
    ) -> Iterator[Ending]:
        """Yield the result of each flight: energy, arrival, deviations, broken limits.

        `off` and `tilt` are largest distance from the reference [m] and largest tilt [rad], shape
        (n,).
        """
        count, samples = draws.count, len(flown.t)
        # Reorder the arrays: one flight after the other, each with all its samples.
        states, controls = (
            np.ascontiguousarray(held.swapaxes(0, 1))
            for held in (flown.joint[:, :, : len(self._columns)], flown.controls)
        )
        told = {name: np.repeat(values, samples) for name, values in draws.numbers.items()}
        instants = self._dynamics.solved(
            np.tile(flown.t, count),
            states.reshape(count * samples, -1),
            controls.reshape(count * samples, -1),
            told,
        )
        breaches = self._dynamics.violations_of(instants, flown.t)
        # Without a battery, the charge drawn is 0.
        balance = np.full((count, samples, len(BALANCE_KEYS)), 0.0)
        if has_balance(self._dynamics):
            balance = instants.table(BALANCE_KEYS).reshape(balance.shape)
        for k in range(count):
            one = Flown(
                t=flown.t, states=states[k], controls=controls[k], energy=flown.joint[:, k, -1]
            )
            broken = broken_under_control(self._scenario, self._dynamics, one, breaches[k])
            miss, speed = self._missed(states[k, -1])
            ends = (
                (NOT_THERE, miss, ARRIVAL_DISTANCE_M),
                (NOT_AT_REST, speed, ARRIVAL_SPEED_M_PER_S),
                (NOT_FED, max(balance_lacking(balance[k])), BALANCE_TOLERANCE),
            )
            broken |= {words: found for words, found, allowed in ends if not found <= allowed}
            charge = balance[k, :, CHARGE_KEY]
            yield Ending(
                energy_J=float(one.energy[-1]),
                charge_used_percent=float(charge[0] - charge[-1]),
                miss_m=miss,
                end_speed_m_per_s=speed,
                largest_deviation_m=float(off[k]),
                peak_tilt_rad=float(tilt[k]),
                broken=broken,
            )

    def _missed(self, state: FloatArray) -> tuple[float, float]:
        """Return the distance from the goal [m] and the speed [m/s] of a flight at its end.

        `state` is the final state of the flight, shape (n_states,).
        """
        wanted = wanted_at_goal(self._scenario, self._dynamics)
        missed = {n: state[self._columns[n]] - value for n, value in wanted.items()}
        place, speed = (
            float(np.linalg.norm([missed[n] for n in names]))
            for names in (POSITION_STATES, VELOCITY_STATES)
        )
        return place, speed


def _step_times(scenario: Scenario, fastest_rate: float) -> FloatArray:
    """Return the times of all integration steps of a flight [s].

    The steps are stable for a mode with the decay rate `fastest_rate` [1/s].
    """
    gains, end = scenario.baseline.gains, scenario.mission.fixed_duration
    fastest = max(gains.rotor, gains.attitude_rate, gains.force_identification)
    parts = ceil(LONGEST_STEP_S * max(fastest / _SHARE_OF_LAG, fastest_rate / _STABLE))
    even = LONGEST_STEP_S / parts * np.arange(ceil(end / LONGEST_STEP_S * parts))
    # Arrivals and departures at waypoints are ends of steps too.
    given = np.array([*scenario.nominal_times, end])
    apart = np.abs(even[:, None] - given).min(axis=1) > _SAME_TIME_S
    return np.unique(np.concatenate([even[apart], given]))


# Difference below which two times count as equal [s].
_SAME_TIME_S = 1e-9
