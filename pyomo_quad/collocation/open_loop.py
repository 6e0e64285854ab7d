"""Simulation of a vehicle in open loop, by compiled Runge-Kutta steps.

The steps have order 8, with the coefficients and the error estimate of SciPy's `DOP853`. SciPy
calls Python for each of the twelve stages of a step. Here all stages form one CasADi function,
which is faster, especially for many short flights.

Besides states and controls, the vehicle's equations have time-dependent inputs, such as the wind.
`Dynamics.moment` returns the values of these inputs at one time, as a list. The joint state
consists of the vehicle's states and the integral of the objective's integrand.

The module serves the search for a plan. The finished plan is verified with SciPy's own integrator.
"""

from __future__ import annotations

from math import inf, sqrt
from typing import TYPE_CHECKING, Any

import casadi
import numpy as np
from scipy.integrate import DOP853

from pyomo_quad.collocation.closed_loop import ClosedLoop
from pyomo_quad.collocation.errors import SolveError
from pyomo_quad.collocation.program.compiled import MappedFunction

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from pyomo_quad.collocation.dynamics import Dynamics
    from pyomo_quad.collocation.mesh import FloatArray

_STAGES = DOP853.n_stages
# Weights of the two error estimates of DOP853, of orders 5 and 3, and their combination: Hairer,
# Norsett and Wanner, "Solving Ordinary Differential Equations I", section II.10.
_ORDER_5, _ORDER_3, _SHARE_OF_3 = DOP853.E5[:_STAGES], DOP853.E3[:_STAGES], 0.01
# Number of steps between two neighbouring times above which the vehicle counts as tumbling.
_MOST_STEPS = 300


class OpenLoopSteps:
    """Simulation of a vehicle whose controls are given functions of time.

    The joint state consists of the vehicle's states and the integral of the objective's integrand.

    Parameters
    ----------
    dynamics : Dynamics
        Right-hand side of the vehicle's equations.
    """

    def __init__(self, dynamics: Dynamics) -> None:
        self._dynamics = dynamics
        self._step = MappedFunction(_step(ClosedLoop.without_feedback(dynamics).function), 1)

    def carried(
        self,
        joint: FloatArray,
        times: FloatArray,
        control: Callable[[FloatArray], FloatArray],
        tolerance: float,
    ) -> FloatArray:
        """Simulate the vehicle over given times.

        One Runge-Kutta step leads from each time to the next. If a parameter given as `Steps` jumps
        in between, a step ends at the jump. A step whose estimated error is above the tolerance is
        replaced by shorter steps.

        Parameters
        ----------
        joint : ndarray, shape (n_joint,)
            Joint state at the first time.
        times : ndarray, shape (n,)
            Increasing times [s].
        control : callable
            Function from m times [s], shape (m,), to the controls at these times, shape (m,
            n_controls). The function must be smooth between the first and the last time.
        tolerance : float
            Largest error of a step, absolute and relative.

        Returns
        -------
        ndarray, shape (n, n_joint)
            Joint states at the given times.

        Raises
        ------
        SolveError
            If 300 steps, rejected steps included, do not reach the next of the given times.
        """
        jumps = self._dynamics.steps_between(float(times[0]), float(times[-1]))
        ends = np.union1d(times, jumps)
        found = [joint]
        for start, end, *inputs in self._inputs(ends[:-1], ends[1:], control):
            after, error = self._stepped(joint, inputs, tolerance)
            if error > 1.0:
                after = self._in_parts(joint, (start, end), control, tolerance)
            joint = after
            found.append(joint)
        return np.array(found)[np.isin(ends, times)]

    def _in_parts(
        self,
        joint: FloatArray,
        span: tuple[float, float],
        control: Callable[[FloatArray], FloatArray],
        tolerance: float,
    ) -> FloatArray:
        """Return the joint state at the end of a time span that needs several steps.

        Steps whose error is above `tolerance` are halved.

        Raises
        ------
        SolveError
            If 300 steps, rejected ones included, do not suffice.
        """
        start, ends = span[0], [span[1], 0.5 * (span[0] + span[1])]
        for _ in range(_MOST_STEPS):
            ((_, _, *inputs),) = self._inputs(np.array([start]), np.array(ends[-1:]), control)
            after, error = self._stepped(joint, inputs, tolerance)
            if error <= 1.0:
                joint, start = after, ends.pop()
                if not ends:
                    return joint
            else:
                ends.append(0.5 * (start + ends[-1]))
        raise SolveError(
            f"open loop: {_MOST_STEPS} steps did not follow the vehicle past {start:.4g} s; it is "
            "out of control there; use a finer mesh."
        )

    def _inputs(
        self, starts: FloatArray, ends: FloatArray, control: Callable[[FloatArray], FloatArray]
    ) -> Iterator[tuple[Any, ...]]:
        """Return the times and inputs of n Runge-Kutta steps, one tuple per step.

        The tuple is (start [s], end [s], time-dependent inputs of the equations, controls, duration
        [s]). The arrays of inputs and of controls have the values at all stages.
        """
        widths = ends - starts
        times = starts[:, None] + widths[:, None] * DOP853.C
        after = np.array([self._dynamics.just_after(start) for start in starts.tolist()])
        moments = self._dynamics.moments(np.maximum(times, after[:, None]).ravel())
        columns = (
            values.reshape(len(starts), -1) for values in (moments, control(times.ravel()), widths)
        )
        return zip(starts.tolist(), ends.tolist(), *columns, strict=True)

    def _stepped(
        self, joint: FloatArray, inputs: Sequence[FloatArray], tolerance: float
    ) -> tuple[FloatArray, float]:
        """Return the joint state after one step, and the step's error relative to the tolerance.

        The error is infinite if the state is not finite. `inputs` are three arrays: time-dependent
        inputs at all stages, controls at all stages, and the step's duration [s].
        """
        outputs = self._step(joint[None, :], *(values[None, :] for values in inputs))
        after, high, low = (output[0] for output in outputs)
        if not all(np.all(np.isfinite(output)) for output in outputs):
            return after, inf
        scale = tolerance * (1.0 + np.maximum(np.abs(joint), np.abs(after)))
        squares = [float(error @ error) for error in (high / scale, low / scale)]
        both = squares[0] + _SHARE_OF_3 * squares[1]
        return after, squares[0] / sqrt(both * after.size) if both != 0.0 else 0.0


def _step(rates: Any) -> Any:
    """Return one step of DOP853 as a CasADi function.

    `rates` maps (time-dependent inputs, joint state, controls) to the joint state's time
    derivative. Inputs: joint state; time-dependent inputs, then controls, at all stages; duration.
    Outputs: new joint state, error estimates of orders 5 and 3.
    """
    n_moment, n_joint, n_controls = (rates.numel_in(k) for k in range(3))
    joint, width = casadi.MX.sym("joint", n_joint), casadi.MX.sym("width")
    moments = casadi.MX.sym("moments", n_moment * _STAGES)
    controls = casadi.MX.sym("controls", n_controls * _STAGES)
    slopes: list[Any] = []
    inputs = casadi.vertsplit(moments, n_moment), casadi.vertsplit(controls, n_controls)
    for stage, (moment, control) in enumerate(zip(*inputs, strict=True)):
        earlier = casadi.mtimes(casadi.horzcat(*slopes), DOP853.A[stage, :stage]) if stage else 0.0
        slopes.append(rates(moment, joint + width * earlier, control)[0])
    columns = casadi.horzcat(*slopes)
    end, *errors = (
        width * casadi.mtimes(columns, weights) for weights in (DOP853.B, _ORDER_5, _ORDER_3)
    )
    return casadi.Function("step", [joint, moments, controls, width], [joint + end, *errors])
