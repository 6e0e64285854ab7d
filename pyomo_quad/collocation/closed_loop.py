"""Vehicle and control law in closed loop, compiled to one CasADi function.

The function is the right-hand side of the closed loop. Its joint state consists of the vehicle's
states, the law's own states, and the integral of the objective's integrand. The command is the
vector of values that the law is to follow, such as a reference position. Besides states and
controls, the vehicle's equations have time-dependent inputs, such as the wind. `Dynamics.moment`
returns the values of these inputs at one time, as a list.

The control law is written in Python, for numbers. To compile the law, it is called once with
symbols instead of numbers.
"""

from __future__ import annotations

import operator
from typing import TYPE_CHECKING, Any, Protocol, Self

import casadi
import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin

from pyomo_quad.collocation.errors import TranscriptionError
from pyomo_quad.collocation.program.compiled import MappedFunction, stacked

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

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
    """Symbol that takes the place of a number while a control law is compiled.

    The control law is called once, with symbols as arguments. Arithmetic and NumPy functions that
    the law applies to the symbols become CasADi expressions.
    """

    def __init__(self, expression: Any) -> None:
        self.expression = expression

    def __array_ufunc__(self, function: np.ufunc, method: str, *numbers: Any, **_: Any) -> Symbol:
        """Apply a NumPy function to symbols or numbers, as a CasADi expression.

        Raises
        ------
        TranscriptionError
            If the function cannot be compiled.
        """
        if function not in _OPERATIONS or method != "__call__":
            raise _refusal(f"np.{function.__name__}")
        return Symbol(_OPERATIONS[function](*map(_expression, numbers)))

    def __bool__(self) -> bool:
        """Raise an error, because a control law must not branch (`if`) on a symbol."""
        raise _refusal("a branch on a number known in flight only")


def _refusal(what: str) -> TranscriptionError:
    """Return the error to raise for a control law with an operation that cannot be compiled.

    `what` is the operation as text, for the error's message.
    """
    known = ", ".join(sorted(f"np.{function.__name__}" for function in _FUNCTIONS))
    return TranscriptionError(
        f"control law: {what} cannot be compiled; write it with arithmetic and {known}, and "
        "branches as one formula of np.fmin and np.fmax."
    )


def _expression(number: Any) -> Any:
    """Return the CasADi expression of a `Symbol`; return any other number unchanged."""
    return number.expression if isinstance(number, Symbol) else number


class Law(Protocol):
    """Type of a feedback control law: a function of numbers that can be compiled to CasADi.

    The law may use arithmetic and NumPy's elementwise functions `sqrt`, `exp`, `log`, `fmin` and
    `fmax`. It may also use trigonometric, inverse trigonometric and hyperbolic functions. It must
    not branch (`if`) on its arguments.
    """

    def __call__(
        self, command: Sequence[Any], x: Sequence[Any], own: Sequence[Any], /
    ) -> tuple[Sequence[Any], Sequence[Any]]:
        """Return the controls, and the time derivatives of the law's own states.

        Parameters
        ----------
        command : sequence
            Values that the law is to follow, for example a reference position.
        x : sequence
            States of the vehicle.
        own : sequence
            States of the law itself, for example an integral or an adapted parameter.
        """


def written_law(dynamics: Dynamics, law: Law, sizes: tuple[int, int, int]) -> Any:
    """Compile a control law to a CasADi function.

    The function maps (joint state, command) to (controls, time derivatives of the law's own
    states). `sizes` are from `joint_sizes`: the numbers of time-dependent inputs, of joint states
    and of components of the command. The first number is not used.

    Raises
    ------
    TranscriptionError
        If the law returns a wrong number of values, or violates the rules of `Law`.
    """
    n_states = len(dynamics.state_names)
    joint, command = casadi.SX.sym("joint", sizes[1]), casadi.SX.sym("command", sizes[2])
    symbols = [Symbol(s) for s in casadi.vertsplit(joint)]
    results = law(
        [Symbol(s) for s in casadi.vertsplit(command)], symbols[:n_states], symbols[n_states:-1]
    )
    expected = len(dynamics.control_names), sizes[1] - n_states - 1
    found = tuple(len(result) for result in results)
    if found != expected:
        raise TranscriptionError(
            f"control law: returns {found[0]} controls and {found[1]} rates of its own states; "
            f"the vehicle has {expected[0]} controls, and the law {expected[1]} states."
        )
    columns = [stacked(map(_expression, result)) for result in results]
    return casadi.Function("law", [joint, command], columns)


def joint_sizes(dynamics: Dynamics, n_command: int, n_own: int) -> tuple[int, int, int]:
    """Return the numbers of time-dependent inputs, joint states, and components of the command.

    `n_own` is the number of the law's own states. For the time-dependent inputs, see
    `Dynamics.moment`.
    """
    moment = len(dynamics.moment(dynamics.start))
    return moment, len(dynamics.state_names) + n_own + 1, n_command


def closed(
    dynamics: Dynamics, law: Law, sizes: tuple[int, int, int], numbers: Mapping[str, Any]
) -> tuple[list[Any], Any, Any]:
    """Return a closed loop in CasADi: its symbols, the rates of the joint state, the controls.

    The symbols are three columns: time-dependent inputs of the equations, joint state, command.
    `sizes`, from `joint_sizes`, are the lengths of these columns. `numbers` maps names of
    parameters to symbols that replace them. Unknown names are ignored.
    """
    written = written_law(dynamics, law, sizes)
    names = ("moment", "joint", "command")
    symbols = [dynamics.symbol(name, size) for name, size in zip(names, sizes, strict=True)]
    moment, joint, command = symbols
    controls, own_rates = written(joint, command)
    if numbers:
        moment = dynamics.moment_column(moment, numbers)
    parameters = dynamics.parameter_column(numbers) if numbers else None
    states = joint[: len(dynamics.state_names)]
    rates, integrand = dynamics.written(moment, states, controls, parameters)
    whole = casadi.densify(casadi.vertcat(rates, own_rates, integrand))
    return symbols, whole, casadi.densify(controls)


class ClosedLoop:
    """Closed loop of a vehicle and a feedback law, compiled to one function for simulation.

    The joint state consists of the vehicle's states, the law's own states, and the integral of the
    objective's integrand.

    Parameters
    ----------
    dynamics : Dynamics
        Right-hand side of the vehicle's equations.
    law : callable
        (command, x, own) -> (controls, time derivatives of own); see `Law`.
    n_command, n_own : int
        Number of components of the command that the law follows, and number of states of the law.

    Attributes
    ----------
    function : casadi.Function
        (time-dependent inputs of the equations, joint state, command) -> (time derivative of the
        joint state, controls). Implicit equations are solved by a fixed number of Newton steps.

    Raises
    ------
    TranscriptionError
        If the law branches on its arguments, calls a function that cannot be compiled, or returns
        sequences of wrong length.
    """

    def __init__(self, dynamics: Dynamics, law: Law, *, n_command: int, n_own: int) -> None:
        self._dynamics = dynamics = dynamics.without_iterations()
        sizes = joint_sizes(dynamics, n_command, n_own)
        self.function = self._compiled(law, sizes)
        self._moment, self._joint, self._command = (np.zeros(size) for size in sizes)
        self._rates = np.zeros(sizes[1])
        controls = np.zeros(len(dynamics.control_names))
        buffer, self._evaluate = self.function.buffer()
        for k, held in enumerate((self._moment, self._joint, self._command)):
            if held.size:
                buffer.set_arg(k, held.data)
        for k, held in enumerate((self._rates, controls)):
            buffer.set_res(k, held.data)
        # The CasADi buffer stores addresses only; keep the arrays alive.
        self._held = buffer, controls

    @classmethod
    def without_feedback(cls, dynamics: Dynamics) -> Self:
        """Return an object that simulates the vehicle in open loop, with given controls.

        `dynamics` is the right-hand side of the vehicle's equations. The command of the returned
        object is the control vector, and its control law has no states.
        """
        n_controls = len(dynamics.control_names)
        return cls(dynamics, lambda command, _x, _own: (command, ()), n_command=n_controls, n_own=0)

    def _compiled(self, law: Law, sizes: tuple[int, int, int]) -> Any:
        """Return the CasADi function of the closed loop, for the attribute `function`.

        `sizes`, from `joint_sizes`, are the sizes of the function's three inputs.
        """
        symbols, rates, controls = closed(self._dynamics, law, sizes, {})
        # To find common subexpressions, CasADi would write out the data of each table in full.
        has_tables = bool(self._dynamics.tables_read)
        options = {"cse": not has_tables}
        return casadi.Function("closed_loop", symbols, [rates, controls], options)

    def rates(
        self, t: float, joint: FloatArray, command: Sequence[float] | FloatArray
    ) -> FloatArray:
        """Return the time derivative of the closed loop's joint state, shape (n_joint,).

        Parameters
        ----------
        t : float
            Physical time.
        joint : ndarray, shape (n_joint,)
            States of vehicle and law, and the integral of the objective's integrand.
        command : sequence, length n_command
            Values that the law is to follow.
        """
        self._moment[:] = self._dynamics.moment(t)
        self._joint[:] = joint
        self._command[:] = command
        self._evaluate()
        return self._rates.copy()

    def slopes(
        self, t: FloatArray, joint: FloatArray, command: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return the Jacobians of the joint state's time derivative at n times.

        At a kink of the control law, such as a switch of NumPy's `fmin`, the derivatives are
        one-sided.

        Parameters
        ----------
        t : ndarray, shape (n,)
            Physical times.
        joint : ndarray, shape (n, n_joint)
            States of vehicle and law, and the integral of the objective's integrand.
        command : ndarray, shape (n, n_command)
            Values that the law is to follow.

        Returns
        -------
        ndarray, shape (n, n_joint, n_moment)
            Derivatives with respect to the time-dependent inputs; see `Dynamics.moment`.
        ndarray, shape (n, n_joint, n_joint)
            Derivatives with respect to the joint state.
        """
        names = self.function.name_in()
        jacobians = [f"jac:{self.function.name_out(0)}:{names[k]}" for k in (0, 1)]
        written = self.function.factory("slopes", names, jacobians)
        symbols = written.mx_in()
        columns = [casadi.vec(casadi.densify(out)) for out in written.call(symbols)]
        mapped = MappedFunction(casadi.Function("slopes", symbols, columns), len(t))
        moments = self._dynamics.moments(t)
        by_moment, by_joint = mapped(moments, joint, command)
        # CasADi keeps matrices by columns.
        shape = len(t), -1, joint.shape[1]
        return (
            by_moment.reshape(shape).transpose(0, 2, 1),
            by_joint.reshape(shape).transpose(0, 2, 1),
        )

    def controls(self, t: FloatArray, joint: FloatArray, command: FloatArray) -> FloatArray:
        """Return the controls that the law applies at n times.

        Parameters
        ----------
        t : ndarray, shape (n,)
            Physical times.
        joint : ndarray, shape (n, n_joint)
            States of vehicle and law, and the integral of the objective's integrand.
        command : ndarray, shape (n, n_command)
            Values that the law is to follow.

        Returns
        -------
        ndarray, shape (n, n_controls)
        """
        moments = self._dynamics.moments(t)
        return MappedFunction(self.function, len(t))(moments, joint, command)[1]
