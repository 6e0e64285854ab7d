"""A vehicle under feedback: the compiled equations and a control law as one function of time."""

from __future__ import annotations

import operator
from typing import TYPE_CHECKING, Any, Protocol

import casadi
import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin

from pyomo_quad.collocation.errors import TranscriptionError
from pyomo_quad.collocation.program.compiled import MappedFunction

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from pyomo_quad.collocation.dynamics import Dynamics
    from pyomo_quad.collocation.mesh import FloatArray

_ARITHMETIC: dict[np.ufunc, Callable[..., Any]] = {
    np.add: operator.add,
    np.subtract: operator.sub,
    np.multiply: operator.mul,
    np.divide: operator.truediv,
    np.power: operator.pow,
    np.negative: operator.neg,
    np.positive: operator.pos,
    np.absolute: casadi.fabs,
}
_FUNCTIONS: dict[np.ufunc, Callable[..., Any]] = {
    function: getattr(casadi, function.__name__)
    for function in (
        *(np.sqrt, np.exp, np.log, np.fmin, np.fmax),
        *(np.sin, np.cos, np.tan, np.arcsin, np.arccos, np.arctan, np.arctan2),
        *(np.sinh, np.cosh, np.tanh),
    )
}
_OPERATIONS = _ARITHMETIC | _FUNCTIONS


class Symbol(NDArrayOperatorsMixin):
    """A number not known yet: NumPy's functions of it are written down, to be compiled."""

    def __init__(self, expression: Any) -> None:
        self.expression = expression

    def __array_ufunc__(self, function: np.ufunc, method: str, *numbers: Any, **_: Any) -> Symbol:
        """Write a function down.

        Raises
        ------
        TranscriptionError
            If it cannot be compiled.
        """
        if function not in _OPERATIONS or method != "__call__":
            raise _refusal(f"np.{function.__name__}")
        return Symbol(_OPERATIONS[function](*map(_expression, numbers)))

    def __bool__(self) -> bool:
        """Refuse to be a condition."""
        raise _refusal("a branch on a number known in flight only")


def _refusal(what: str) -> TranscriptionError:
    known = ", ".join(sorted(f"np.{function.__name__}" for function in _FUNCTIONS))
    return TranscriptionError(
        f"control law: {what} cannot be compiled; write it with arithmetic and {known}, and "
        "branches as one formula of np.fmin and np.fmax."
    )


def _expression(number: Any) -> Any:
    return number.expression if isinstance(number, Symbol) else number


class Law(Protocol):
    """A control law, written with NumPy's functions of single numbers."""

    def __call__(
        self, command: Sequence[Any], x: Sequence[Any], own: Sequence[Any], /
    ) -> tuple[Sequence[Any], Sequence[Any]]:
        """Return the controls and the rates of the law's own states.

        Given are what it is to follow, the vehicle's states and its own.
        """


class ClosedLoop:
    """The right-hand side of a vehicle under a law.

    The joint state is that of the vehicle, the law's own, and the integral of the objective's
    integrand.

    Parameters
    ----------
    dynamics : Dynamics
        The vehicle.
    law : callable
        (command, x, own) -> (controls, rates of own), sequences of numbers; see `Law`.  It is
        called once, with symbols.
    n_command, n_own : int
        How many numbers the law follows, and how many states it has.

    Raises
    ------
    TranscriptionError
        If the law branches on a state, calls what cannot be compiled, or returns another number
        of controls or rates than the vehicle has controls and itself states.
    """

    def __init__(self, dynamics: Dynamics, law: Law, *, n_command: int, n_own: int) -> None:
        self._dynamics = dynamics
        self._n_states = len(dynamics.state_names)
        sizes = len(dynamics.moment(dynamics.start)), self._n_states + n_own + 1, n_command
        self._function = self._compiled(law, sizes)
        self._moment, self._joint, self._command = (np.zeros(size) for size in sizes)
        self._rates = np.zeros(sizes[1])
        controls = np.zeros(len(dynamics.control_names))
        buffer, self._evaluate = self._function.buffer()
        for k, held in enumerate((self._moment, self._joint, self._command)):
            if held.size:
                buffer.set_arg(k, held.data)
        for k, held in enumerate((self._rates, controls)):
            buffer.set_res(k, held.data)
        # The function keeps addresses only.
        self._held = buffer, controls

    def _compiled(self, law: Law, sizes: tuple[int, int, int]) -> Any:
        """Return the function (moment, joint, command) -> rates of the joint state, controls."""
        written = self._written(law, sizes)
        moment, joint, command = (
            self._dynamics.symbol(name, size)
            for name, size in zip(("moment", "joint", "command"), sizes, strict=True)
        )
        controls, own_rates = written(joint, command)
        rates, integrand = self._dynamics.written(moment, joint[: self._n_states], controls)
        return casadi.Function(
            "closed_loop",
            [moment, joint, command],
            [casadi.densify(casadi.vertcat(rates, own_rates, integrand)), casadi.densify(controls)],
            {"cse": True},
        )

    def _written(self, law: Law, sizes: tuple[int, int, int]) -> Any:
        """Return the law as a function (joint, command) -> controls, rates of its own states."""
        joint, command = casadi.SX.sym("joint", sizes[1]), casadi.SX.sym("command", sizes[2])
        symbols = [Symbol(s) for s in casadi.vertsplit(joint)]
        results = law(
            [Symbol(s) for s in casadi.vertsplit(command)],
            symbols[: self._n_states],
            symbols[self._n_states : -1],
        )
        expected = len(self._dynamics.control_names), sizes[1] - self._n_states - 1
        found = tuple(len(result) for result in results)
        if found != expected:
            raise TranscriptionError(
                f"control law: returns {found[0]} controls and {found[1]} rates of its own states; "
                f"the vehicle has {expected[0]} controls, and the law {expected[1]} states."
            )
        columns = [casadi.vertcat(casadi.SX(0, 1), *map(_expression, result)) for result in results]
        return casadi.Function("law", [joint, command], columns)

    def rates(
        self, t: float, joint: FloatArray, command: Sequence[float] | FloatArray
    ) -> FloatArray:
        """Return the derivative of the joint state by time, shape (n_joint,)."""
        self._moment[:] = self._dynamics.moment(t)
        self._joint[:] = joint
        self._command[:] = command
        self._evaluate()
        return self._rates.copy()

    def controls(self, t: FloatArray, joint: FloatArray, command: FloatArray) -> FloatArray:
        """Return what the law applies at n times, shape (n, n_controls)."""
        moments = np.array([self._dynamics.moment(float(time)) for time in t])
        return MappedFunction(self._function, len(t))(moments, joint, command)[1]
