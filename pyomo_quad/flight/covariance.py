"""Covariance of the states of flights in turbulence, by linearisation of the closed loop.

The closed loop is one system of differential equations for the vehicle, its adaptive controller and
the filters that model turbulence. The system is linearised along the flight without gusts; see
docs/theory/risk.md, eqs. (4) to (6). The errors of wind forecast, mass and power are constant
inputs of the system.
"""

from dataclasses import dataclass
from math import ceil

import numpy as np

from pyomo_quad.arrays import FloatArray
from pyomo_quad.collocation import Dynamics
from pyomo_quad.flight.baselines import closed_loop, fly, reference_path, start_state
from pyomo_quad.flight.controller import (
    CONTROLLER_STATES,
    AdaptiveController,
    mixer_matrix,
)
from pyomo_quad.flight.integration import discrete
from pyomo_quad.flight.plan import Plan
from pyomo_quad.flight.planning import Planner
from pyomo_quad.flight.weather import as_expected, problem_in_turbulence, unknowns
from pyomo_quad.model import parameter_values
from pyomo_quad.model.limits import without_reserve
from pyomo_quad.model.turbulence import (
    FILTER_STATES,
    LONG_RUN_FACTOR,
    NOISE,
    NOISE_STEP,
    turbulence_values,
)
from pyomo_quad.scenario import Scenario
from pyomo_quad.scenario.tables import Reference

# Number added to all states before differentiation (units of the states): the derivative of a norm
# is not defined at zero.
_OFF_NOUGHT = 1e-9


# Standard deviation above which a flight counts as lost, in the unit of each state: m, rad, m/s,
# rad/s.
_LOST = 1e6


@dataclass(frozen=True, kw_only=True)
class Spread:
    """Normal distribution of the states of flights in turbulence that follow a plan, at n times.

    Attributes
    ----------
    t : ndarray, shape (n,)
        Times [s].
    states, controls : ndarray, shapes (n, n_states), (n, n_controls)
        The flight without gusts (the mean).
    covariance : ndarray, shape (n, n_states, n_states)
        Covariance of the states at each time.
    onward : ndarray, shape (n - 1, n_states, n_states)
        Covariance between one time (rows) and the next (columns).
    dynamics : Dynamics
        Equations in the mean wind, without noise.
    """

    t: FloatArray
    # States of the vehicle and of the turbulence filters, as `dynamics.state_names` lists them.
    states: FloatArray
    controls: FloatArray
    covariance: FloatArray
    onward: FloatArray
    dynamics: Dynamics

    def of(self, *names: str) -> FloatArray:
        """Return the covariance of the named states at the n times, shape (n, n_names, n_names)."""
        chosen = [self.dynamics.state_names.index(name) for name in names]
        return self.covariance[:, chosen][:, :, chosen]

    def deviation(self, name: str) -> FloatArray:
        """Return the standard deviation of the named state at the n times, shape (n,)."""
        return np.sqrt(self.of(name)[:, 0, 0])


def spread_along(scenario: Scenario, plan: Plan, planner: Planner) -> Spread:
    """Compute the distribution of flights in turbulence that follow a plan under feedback.

    `scenario` states the turbulence, and the standard deviations of the errors of wind forecast,
    mass and power. `planner` gives the power of hover, to which the error of the power is relative.
    The times of the result are equally spaced, at most `NOISE_STEP` [s] apart. Between two times,
    the white noise that drives the turbulence filters is constant.
    """
    mean = _MeanFlight(scenario, plan, planner)
    count = ceil(scenario.mission.fixed_duration / NOISE_STEP)
    times = np.linspace(0.0, scenario.mission.fixed_duration, 2 * count + 1)
    joint, commands = mean.flown(times)
    middle = times[1::2], joint[1::2], commands[1::2]
    A, B = mean.slopes(*middle)
    step = times[2] - times[0]
    transitions, driven = discrete(A, B, step)
    n_noise = len(NOISE)
    noise = driven[:, :, :n_noise] / np.sqrt(step)
    covariance, onward = without_overflow(
        *propagated(mean.start_covariance, transitions, noise, driven[:, :, n_noise:])
    )
    n_states = len(mean.dynamics.state_names)
    own = slice(0, n_states)
    return Spread(
        t=times[::2],
        states=np.nan_to_num(joint[::2, own], nan=_LOST, posinf=_LOST, neginf=-_LOST),
        controls=mean.loop.controls(times[::2], joint[::2], commands[::2]),
        covariance=covariance[:, own, own],
        onward=onward[:, own, own],
        dynamics=mean.dynamics,
    )


def propagated(
    start: FloatArray, transitions: FloatArray, noise: FloatArray, constants: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Propagate the covariance of the states of a linear system over n steps.

    Step k replaces the states x by F_k x + G_k w_k + H_k c. The matrices F_k, G_k and H_k are entry
    k of `transitions`, `noise` and `constants`. The random vector w_k is drawn in each step, and c
    once for all steps. Their components are independent, with unit variance. `start` is the
    covariance before the first step.

    The results are the n + 1 covariances of x, and those between x before (rows) and after
    (columns) each step.
    """
    n, n_x, n_constants = constants.shape
    gusts = [start]
    # Responses of the states to each constant, which acts with one value in all steps.
    answers = [np.zeros((n_x, n_constants))]
    between = []
    # `without_overflow` bounds the spread of a flight that cannot be followed.
    with np.errstate(over="ignore", invalid="ignore"):
        for F, G, H in zip(transitions, noise, constants, strict=True):
            between.append(gusts[-1] @ F.T)
            gusts.append(F @ gusts[-1] @ F.T + G @ G.T)
            answers.append(F @ answers[-1] + H)
        sums = np.array([P + S @ S.T for P, S in zip(gusts, answers, strict=True)])
        pairs = zip(between, answers[:-1], answers[1:], strict=True)
        return sums, np.array([P + S @ T.T for P, S, T in pairs]).reshape(n, n_x, n_x)


def without_overflow(covariance: FloatArray, onward: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return covariances of the states, and between successive times, without overflow.

    `covariance` has shape (n + 1, n_x, n_x), `onward` (n, n_x, n_x). A time is lost if a standard
    deviation exceeds `_LOST`, or a covariance is not finite. From the first lost time on, all
    standard deviations become `_LOST`, and all covariances between states or times zero.
    """
    variance = np.diagonal(covariance, axis1=1, axis2=2)
    # If the controller cannot follow the plan, the covariance grows without limit. Every limit then
    # counts as broken.
    is_lost = ~np.isfinite(covariance).all(axis=(1, 2)) | (variance > _LOST**2).any(axis=1)
    if not is_lost.any():
        return covariance, onward
    first, n_x = int(np.argmax(is_lost)), covariance.shape[1]
    kept, kept_onward = covariance.copy(), onward.copy()
    kept[first:] = _LOST**2 * np.eye(n_x)
    kept_onward[max(first - 1, 0) :] = 0.0
    return kept, kept_onward


class _MeanFlight:
    """Flight of a plan under feedback without gusts, and the closed loop linearised along it.

    A joint state has the states of vehicle, turbulence filters and controller, and the energy. Rows
    of `joint` and `commands` are joint states and inputs of the controller at the times `t` [s],
    from the method `flown`.
    """

    def __init__(self, scenario: Scenario, plan: Plan, planner: Planner) -> None:
        told = as_expected(scenario)
        problem = problem_in_turbulence(told)
        numbers = without_reserve(parameter_values(told) | turbulence_values(told)) or {}
        self._problem, self._numbers = problem, numbers
        self._horizon = 0.0, scenario.mission.fixed_duration
        self._unknowns = unknowns(planner, scenario)
        dynamics = problem.dynamics(parameters=numbers, horizon=self._horizon)
        self.dynamics = dynamics.without_iterations()
        self._reference = reference_path(scenario, Reference.PLAN, plan)
        self._controller = AdaptiveController(scenario, mixer_matrix(self.dynamics))
        self.loop = closed_loop(self.dynamics, self._controller)
        names = list(self.dynamics.state_names)
        self._start = start_state(scenario, self.dynamics, plan)
        self._filters = [names.index(name) for name in FILTER_STATES]
        self._start[self._filters] = 0.0
        size = len(names) + len(CONTROLLER_STATES) + 1
        self.start_covariance = np.zeros((size, size))
        self.start_covariance[np.ix_(self._filters, self._filters)] = (
            LONG_RUN_FACTOR @ LONG_RUN_FACTOR.T
        )

    def flown(self, times: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the joint states and the inputs of the controller at n given times [s].

        The inputs are reference values (see `AdaptiveController.command`). The shapes are
        (n, n_joint) and (n, COMMAND_SIZE).
        """
        flight = fly(
            dynamics=self.dynamics,
            controller=self._controller,
            reference=self._reference,
            initial_state=self._start,
            times=times,
            system=self.loop,
        )
        flown = flight.flown
        joint = np.column_stack([flown.states, flight.controller_states, flown.energy])
        commands = [self._controller.command(self._reference, t) for t in times.tolist()]
        return joint, np.array(commands)

    def slopes(
        self, t: FloatArray, joint: FloatArray, commands: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return the derivatives of the joint state's rates by that state and by the random inputs.

        The random inputs are the white noise of the turbulence, then the constant errors of
        forecast, mass and power (parameters). The shapes are (n, n_joint, n_joint) and
        (n, n_joint, n_noise + n_parameters).
        """
        # Where an error is exactly zero, the derivative of its norm is not defined.
        by_moment, by_joint = self.loop.slopes(t, joint + _OFF_NOUGHT, commands)
        columns = [1 + self.dynamics.signal_names.index(name) for name in NOISE]
        by_unknowns = self._by_unknowns(t, joint, commands)
        # The derivatives by parameters are per standard deviation.
        return by_joint, np.concatenate([by_moment[:, :, columns], by_unknowns], axis=2)

    def _by_unknowns(self, t: FloatArray, joint: FloatArray, commands: FloatArray) -> FloatArray:
        """Return the derivatives of the joint state's rates by the uncertain parameters.

        Each is for a change by one standard deviation. `commands` has the controller's inputs at
        the times `t` [s], shape (n, COMMAND_SIZE). The result has shape (n, n_joint, n_parameters).
        """
        n_states = len(self.dynamics.state_names)
        states, controls = joint[:, :n_states], self.loop.controls(t, joint, commands)
        found = np.zeros((*joint.shape, len(self._unknowns)))
        for k, change in enumerate(self._unknowns):
            more, less = (self._rates(change, side, t, states, controls) for side in (1.0, -1.0))
            found[:, :n_states, k] = (more - less) / 2
        return found

    def _rates(
        self,
        change: dict[str, float],
        side: float,
        t: FloatArray,
        states: FloatArray,
        controls: FloatArray,
    ) -> FloatArray:
        """Return the rates of the vehicle's states for changed parameters, shape (n, n_states).

        `change` maps names of parameters to changes in their units. `side` is 1, or -1 for the
        opposite changes.
        """
        changed = {name: self._numbers.get(name, 0.0) + side * by for name, by in change.items()}
        numbers = self._numbers | changed
        other = self._problem.dynamics(parameters=numbers, horizon=self._horizon)
        other = other.without_iterations()
        rows = zip(t.tolist(), states, controls, strict=True)
        return np.array([other.rates(time, x, u) for time, x, u in rows])
