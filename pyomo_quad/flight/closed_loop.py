"""Fly the vehicle under its controller: plant, controller and energy as one SciPy ODE."""

from dataclasses import dataclass
from time import perf_counter

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from pyomo_quad.flight.allocation import VehicleDynamics, rotor_columns
from pyomo_quad.flight.controller import CONTROLLER_STATES, MEASURED_STATES, AdaptiveController
from pyomo_quad.flight.references import ReferencePath

__all__ = ["ClosedLoopFlight", "fly"]

FloatArray = NDArray[np.float64]

_RELATIVE_TOLERANCE = 1e-8
_ABSOLUTE_TOLERANCE = 1e-8
# Longest step, s: a smooth stretch must not step over a gust or a change of the reference.
_LONGEST_STEP = 0.1


@dataclass(frozen=True, kw_only=True)
class ClosedLoopFlight:
    """A controlled flight at n times."""

    times: FloatArray
    """Times, s, shape (n,)."""
    states: FloatArray
    """States of the vehicle in the order of the dynamics, shape (n, n_states)."""
    controls: FloatArray
    """Rotor accelerations applied, rad/s^2, shape (n, 4)."""
    energy: FloatArray
    """Energy spent since the start, J, shape (n,)."""
    controller_states: FloatArray
    """The `CONTROLLER_STATES`, shape (n, 22)."""
    evaluations: int
    """Evaluations of the right-hand side."""
    wall_s: float
    """Time the integration took, s."""


def fly(
    *,
    dynamics: VehicleDynamics,
    controller: AdaptiveController,
    reference: ReferencePath,
    initial_state: FloatArray,
    times: FloatArray,
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

    Returns
    -------
    ClosedLoopFlight
        The flight.

    Raises
    ------
    ArithmeticError
        If the integration breaks down before the last time.
    """
    loop = _ClosedLoop(dynamics, controller, reference)
    began = perf_counter()
    solution = solve_ivp(
        loop.rates,
        (times[0], times[-1]),
        np.concatenate([initial_state, np.zeros(len(CONTROLLER_STATES) + 1)]),
        method="DOP853",
        t_eval=times,
        rtol=_RELATIVE_TOLERANCE,
        atol=_ABSOLUTE_TOLERANCE,
        max_step=_LONGEST_STEP,
    )
    if not solution.success:
        raise ArithmeticError(
            f"controlled flight: integration stopped at t = {solution.t[-1]:.4g} s of "
            f"{times[-1]:.4g} s: {solution.message}"
        )
    states, controller_states, energy = loop.split(solution.y.T)
    return ClosedLoopFlight(
        times=times,
        states=states,
        controls=np.array([loop.controls(t, y) for t, y in zip(times, solution.y.T, strict=True)]),
        energy=energy,
        controller_states=controller_states,
        evaluations=solution.nfev,
        wall_s=perf_counter() - began,
    )


class _ClosedLoop:
    """The right-hand side; its state is vehicle, controller, energy, one after the other."""

    def __init__(
        self, dynamics: VehicleDynamics, controller: AdaptiveController, reference: ReferencePath
    ) -> None:
        self._dynamics = dynamics
        self._controller = controller
        self._reference = reference
        self._size = len(dynamics.state_names)
        self._body = [list(dynamics.state_names).index(name) for name in MEASURED_STATES]
        self._rotors = rotor_columns(dynamics)

    def split(self, rows: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Split rows of the joint state into vehicle, controller and energy."""
        return rows[:, : self._size], rows[:, self._size : -1], rows[:, -1]

    def controls(self, t: float, joint: FloatArray) -> FloatArray:
        """Return the rotor accelerations at one moment."""
        return self._law(t, joint)[0]

    def rates(self, t: float, joint: FloatArray) -> FloatArray:
        """Return the derivative of the joint state."""
        alpha, controller_rates = self._law(t, joint)
        state = joint[: self._size]
        power = self._dynamics.integrand(t, state, alpha)
        return np.concatenate([self._dynamics.rates(t, state, alpha), controller_rates, (power,)])

    def _law(self, t: float, joint: FloatArray) -> tuple[FloatArray, FloatArray]:
        return self._controller(
            self._reference(t), joint[self._body], joint[self._rotors], joint[self._size : -1]
        )
