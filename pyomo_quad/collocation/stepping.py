"""Simulation of many closed loops, each with its own parameters, by fixed Runge-Kutta steps.

A closed loop is a vehicle with the control law that steers it. All vehicles have the same control
law. A joint state holds the states of a vehicle, those of its control law, and the accumulated
objective. Each step uses the classical Runge-Kutta method of order 4; see docs/theory/flights.md,
eq. (1). The parameters that differ between vehicles may change from step to step, and may thus
represent noise that is constant during a step.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import casadi
import numpy as np

from pyomo_quad.collocation.closed_loop import Law, closed, joint_sizes
from pyomo_quad.collocation.errors import SolveError
from pyomo_quad.collocation.program.compiled import MappedFunction

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from pyomo_quad.collocation.dynamics import Dynamics
    from pyomo_quad.collocation.mesh import FloatArray


@dataclass(frozen=True, kw_only=True)
class SteppedFlights:
    """Simulated flights of n vehicles under a control law, sampled at the same times.

    Attributes
    ----------
    t : ndarray, shape (n_samples,)
        Times [s].
    joint : ndarray, shape (n_samples, n, n_joint)
        States of each vehicle, then those of its control law, then the objective accumulated since
        the start.
    controls : ndarray, shape (n_samples, n, n_controls)
        Controls that the control law applies to each vehicle.
    """

    t: FloatArray
    joint: FloatArray
    controls: FloatArray


class SteppedLoops:
    """Closed loops of a vehicle with a control law, simulated together for many parameter values.

    Parameters
    ----------
    dynamics : Dynamics
        Right-hand side of the vehicle's equations.
    law : callable
        (command, x, own) -> (controls, time derivatives of own); see `Law`. It is called with
        symbols. `x` are the states of the vehicle, `own` those of the law.
    n_command, n_own : int
        Number of components of the command, and number of the law's own states.
    varied : sequence of str
        Full names of the parameters that differ between the vehicles. They may be constant or vary
        with time.
    """

    def __init__(
        self, dynamics: Dynamics, law: Law, *, n_command: int, n_own: int, varied: Sequence[str]
    ) -> None:
        self._dynamics = dynamics = dynamics.without_iterations()
        self._n_varied = len(varied)
        sizes = joint_sizes(dynamics, n_command, n_own)
        own = dynamics.symbol("own_numbers", self._n_varied)
        numbers = dict(zip(varied, casadi.vertsplit(own), strict=True))
        (moment, joint, command), rates, controls = closed(dynamics, law, sizes, numbers)
        flow = casadi.Function("flow", [moment, joint, command, own], [rates], {"cse": True})
        self._controls = casadi.Function("applied", [joint, command], [controls])
        self._step = _step(flow, dynamics, sizes, self._n_varied)

    def fly(
        self,
        times: FloatArray,
        start: FloatArray,
        command: Callable[[float], Sequence[float]],
        numbers: Sequence[FloatArray],
        *,
        sampled: FloatArray,
    ) -> SteppedFlights:
        """Simulate all closed loops over given times, with one step between neighbouring times.

        Parameters
        ----------
        times : ndarray, shape (n_steps + 1,)
            Ends of the steps [s].
        start : ndarray, shape (n, n_joint)
            Joint states of vehicle, control law and accumulated objective at the first time.
        command : callable
            Time [s] -> command of the law, the same for all vehicles.
        numbers : sequence of ndarray, shape (n,) or (n_steps, n)
            Values of each parameter in `varied`: for each vehicle one number for the whole flight,
            or one for each step.
        sampled : ndarray of bool, shape (n_steps + 1,)
            Whether the flights are stored at each time.

        Returns
        -------
        SteppedFlights

        Raises
        ------
        SolveError
            If a state is not finite at a stored time.
        """
        count, steps = len(start), len(times) - 1
        flown = np.empty((int(sampled.sum()), *start.shape))
        followed = np.array([command(float(t)) for t in times[sampled]])
        held = np.zeros((count, self._n_varied))
        mapped = MappedFunction(self._step, count, n_shared=self._step.n_in() - 2)
        joint, kept = np.array(start, dtype=float), 0
        if sampled[0]:
            flown[0], kept = joint, 1
        for k in range(steps):
            for column, values in enumerate(numbers):
                held[:, column] = values if values.ndim == 1 else values[k]
            (joint,) = mapped(*self._around(times[k], times[k + 1], command), joint, held)
            if sampled[k + 1]:
                flown[kept] = joint
                kept += 1
        lost = ~np.isfinite(flown).all(axis=(0, 2))
        if lost.any():
            raise SolveError(
                f"flights in fixed steps: {int(lost.sum())} of {count} are no longer finite; take "
                "shorter steps, or check the gains and limits of the scenario."
            )
        shape = (len(flown) * count, -1)
        controls = MappedFunction(self._controls, shape[0])(
            flown.reshape(shape), np.repeat(followed, count, axis=0)
        )[0]
        return SteppedFlights(
            t=times[sampled], joint=flown, controls=controls.reshape(len(flown), count, -1)
        )

    def _around(
        self, begin: float, end: float, command: Callable[[float], Sequence[float]]
    ) -> list[FloatArray]:
        """Return those arguments of one Runge-Kutta step that are the same for all vehicles.

        They are the length of the step [s], results of `Dynamics.moment`, and commands. These
        results and commands are those at the start, the middle and the end of the step.
        """
        middle = 0.5 * (begin + end)
        # If the equations jump, a step starts after the jump and the previous step ends before it.
        moments = map(self._dynamics.moment, (self._dynamics.just_after(begin), middle, end))
        commands = map(command, (begin, middle, end))
        return [np.array([end - begin]), *map(np.array, moments), *map(np.array, commands)]


def _step(flow: Any, dynamics: Dynamics, sizes: tuple[int, int, int], n_varied: int) -> Any:
    """Return the CasADi function from the joint state before a Runge-Kutta step to that after it.

    `flow` gives the time derivative of the joint state. `sizes` are the numbers of time-dependent
    inputs, joint states and components of a command. `n_varied` parameters differ between vehicles.
    """
    n_moment, n_joint, n_command = sizes
    length = dynamics.symbol("length", 1)
    moments = [dynamics.symbol(f"moment{k}", n_moment) for k in range(3)]
    commands = [dynamics.symbol(f"command{k}", n_command) for k in range(3)]
    joint, own = dynamics.symbol("joint", n_joint), dynamics.symbol("own_numbers", n_varied)
    first = flow(moments[0], joint, commands[0], own)
    second = flow(moments[1], joint + length / 2 * first, commands[1], own)
    third = flow(moments[1], joint + length / 2 * second, commands[1], own)
    fourth = flow(moments[2], joint + length * third, commands[2], own)
    end = joint + length / 6 * (first + 2 * second + 2 * third + fourth)
    # `moments` and `commands` are values at the start, the middle and the end of the step.
    return casadi.Function("step", [length, *moments, *commands, joint, own], [end], {"cse": True})
