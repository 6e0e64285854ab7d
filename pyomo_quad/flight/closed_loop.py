"""Fly the vehicle under its controller: plant, controller and energy as one SciPy ODE."""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from pyomo_quad.collocation import SolveError
from pyomo_quad.flight.allocation import VehicleDynamics, rotor_columns
from pyomo_quad.flight.controller import MEASURED_STATES, AdaptiveController
from pyomo_quad.flight.flight import Flown
from pyomo_quad.flight.references import ReferencePath

__all__ = ["ClosedLoopFlight", "Integrator", "fly"]

FloatArray = NDArray[np.float64]

# Gives energies to 1e-7 and better with either integrator.
_TOLERANCE = 1e-7
# Longest step, s: a smooth stretch must not step over a gust or a change of the reference.
_LONGEST_STEP = 0.1
# A flight under control takes some 500 evaluations per second; ten times that is a tumble, which
# would keep the integrator busy for hours.
_MOST_EVALUATIONS_PER_SECOND = 5000


class Integrator(StrEnum):
    """SciPy's integrators that share no code with each other."""

    RUNGE_KUTTA = "DOP853"
    MULTISTEP = "LSODA"


@dataclass(frozen=True, kw_only=True)
class ClosedLoopFlight:
    """A controlled flight at n times."""

    flown: Flown
    """The vehicle; its controls are the rotor accelerations applied."""
    controller_states: FloatArray
    """The `CONTROLLER_STATES`, shape (n, 22)."""
    evaluations: int
    """Evaluations of the right-hand side."""


def fly(
    *,
    dynamics: VehicleDynamics,
    controller: AdaptiveController,
    reference: ReferencePath,
    initial_state: FloatArray,
    times: FloatArray,
    integrator: Integrator = Integrator.RUNGE_KUTTA,
) -> ClosedLoopFlight:
    """Fly a reference under feedback.

    Parameters
    ----------
    dynamics : VehicleDynamics
        The declared equations, with the wind that really blows.
    controller : AdaptiveController
        Starts with nothing learnt.
    reference : callable
        Time in s -> Setpoint.
    initial_state : ndarray, shape (n_states,)
        State of the vehicle at the first time.
    times : ndarray, shape (n,)
        Rising times at which the flight is returned, s.
    integrator : Integrator, optional
        What steps through time.

    Returns
    -------
    ClosedLoopFlight
        The flight.

    Raises
    ------
    SolveError
        If the integration breaks down before the last time, or takes so many evaluations that
        the vehicle must be tumbling.
    """
    loop = _ClosedLoop(dynamics, controller, reference, duration=times[-1] - times[0])
    solution = solve_ivp(
        loop.rates,
        (times[0], times[-1]),
        loop.started(times[0], initial_state),
        method=integrator.value,
        t_eval=times,
        rtol=_TOLERANCE,
        atol=_TOLERANCE,
        max_step=_LONGEST_STEP,
    )
    if not solution.success:
        raise SolveError(
            f"controlled flight: {solution.message} Check the gains and limits of the scenario."
        )
    return loop.flight(times, solution.y.T)


class _ClosedLoop:
    """The right-hand side; its state is vehicle, controller, energy, one after the other."""

    def __init__(
        self,
        dynamics: VehicleDynamics,
        controller: AdaptiveController,
        reference: ReferencePath,
        *,
        duration: float,
    ) -> None:
        self._dynamics = dynamics
        self._controller = controller
        self._reference = reference
        self._size = len(dynamics.state_names)
        self._body = [list(dynamics.state_names).index(name) for name in MEASURED_STATES]
        self._rotors = rotor_columns(dynamics)
        self._evaluations = 0
        self._most_evaluations = _MOST_EVALUATIONS_PER_SECOND * max(1.0, duration)

    def started(self, t: float, state: FloatArray) -> FloatArray:
        """Return the joint state at the start."""
        body = state[self._body].tolist()
        return np.array([*state, *self._controller.started(self._reference(t), body), 0.0])

    def rates(self, t: float, joint: FloatArray) -> FloatArray:
        """Return the derivative of the joint state."""
        self._evaluations += 1
        if self._evaluations > self._most_evaluations:
            raise SolveError(
                f"controlled flight: out of control at {t:.4g} s, stopped after "
                f"{self._most_evaluations:g} evaluations; check the gains and limits of the "
                "scenario."
            )
        alpha, controller_rates = self._law(t, joint)
        rates, power = self._dynamics.rates_and_integrand(t, joint[: self._size], np.array(alpha))
        return np.array([*rates.tolist(), *controller_rates, power])

    def flight(self, times: FloatArray, rows: FloatArray) -> ClosedLoopFlight:
        """Return a flight of the joint states at some times."""
        return ClosedLoopFlight(
            flown=Flown(
                t=times,
                states=rows[:, : self._size],
                controls=np.array([self._law(t, y)[0] for t, y in zip(times, rows, strict=True)]),
                energy=rows[:, -1],
            ),
            controller_states=rows[:, self._size : -1],
            evaluations=self._evaluations,
        )

    def _law(self, t: float, joint: FloatArray) -> tuple[list[float], list[float]]:
        values = joint.tolist()
        return self._controller(
            self._reference,
            t,
            [values[k] for k in self._body],
            [values[k] for k in self._rotors],
            values[self._size : -1],
        )
