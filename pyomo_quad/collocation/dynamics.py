"""The declared equations as functions of time: slopes, outputs, any variable or expression.

`ClosedLoop` combines them with a control law into one function.
"""

from __future__ import annotations

import operator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

import casadi
import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import maximum_bipartite_matching

from pyomo_quad.collocation.errors import TranscriptionError
from pyomo_quad.collocation.limits import LimitValues, Violation
from pyomo_quad.collocation.program.compiled import MappedFunction, stacked
from pyomo_quad.collocation.reading.schedules import BESIDE, Steps
from pyomo_quad.collocation.reading.writer import symbol_names

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from numpy.typing import ArrayLike

    from pyomo_quad.collocation.formulation import Formulation
    from pyomo_quad.collocation.mesh import FloatArray
    from pyomo_quad.collocation.reading.symbols import Slot
    from pyomo_quad.collocation.reading.values import Instance


# Residual at which Newton's method stops.
_NEWTON_TOLERANCE = 1e-13
# Number of Newton steps where it is fixed, starting at zero. The first step may overshoot by a
# factor of 2^12, as for the induced velocity of a hovering rotor; later steps first halve it.
_NEWTON_STEPS = 20


@dataclass(frozen=True, kw_only=True)
class Instants:
    """States and controls at n times, with the corresponding rates and algebraic variables.

    `read` evaluates components from the inputs of the equations; `numbers` replaces parameters,
    given by full name, in the last of these inputs.
    """

    inputs: list[FloatArray]
    read: Callable[..., FloatArray]
    numbers: Callable[[FloatArray, Mapping[str, ArrayLike]], FloatArray]

    def table(
        self,
        keys: tuple[tuple[str, Any], ...],
        changed: Mapping[str, ArrayLike] | None = None,
    ) -> FloatArray:
        """Return components, given as (full name, index) pairs, shape (n, n_keys).

        `changed` replaces parameters that affect neither rates nor algebraic variables.
        """
        *held, data = self.inputs
        return self.read(keys, *held, self.numbers(data, changed or {}))


class Dynamics:
    """Explicit right-hand side and outputs of a compiled problem, for given numbers.

    Attributes
    ----------
    state_names : tuple of str
        States of the program, followed by the output states.
    control_names : tuple of str
        Algebraic variables that no equation determines: the inputs of a simulation.
    """

    def __init__(self, formulation: Formulation, instance: Instance, statics: FloatArray) -> None:
        self._formulation = formulation
        self._instance = instance
        self._statics = np.asarray(statics, dtype=float)
        declared = formulation.compiled.declared
        states = (*declared.states, *declared.outputs)
        self.controls, self._determined = split_algebraics(formulation)
        self.state_names = tuple(s.name for s in states)
        self.control_names = tuple(s.name for s in self.controls)
        self.timeline = formulation.timeline(self._statics, instance)
        self.start = float(self.timeline.times[0])
        self._right_hand_side = self._compile(states)
        self._at_one = MappedFunction(self._right_hand_side, 1)
        self._signals = formulation.values.signals(instance)
        n_signals = len(declared.signals) + len(declared.scheduled)
        self._data = np.concatenate([np.zeros(1 + n_signals), instance.parameters])

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the arguments of the constructor instead of CasADi objects."""
        return type(self), (self._formulation, self._instance, self._statics)

    def _compile(self, states: tuple[Slot, ...]) -> Any:
        """Return the function (x, u, statics, data) -> slopes and algebraics, (integrand, span).

        Slopes and integrand are per fraction of the horizon; dividing by the span makes them per
        time.
        """
        declared = self._formulation.compiled.declared
        equations = [e for e in declared.equations if e.is_equality]
        rows = casadi.vertcat(*[e.expression for e in (*equations, *declared.output_equations)])
        unknowns = casadi.vertcat(*[s.rate for s in states], *[s.symbol for s in self._determined])
        if rows.shape[0] != unknowns.shape[0]:
            raise TranscriptionError(
                f"dynamics: {rows.shape[0]} equations determine {unknowns.shape[0]} slopes and "
                "algebraic variables; a simulation needs as many equations as unknowns."
            )
        inputs = [
            stacked([s.symbol for s in states]),
            stacked([s.symbol for s in self.controls]),
            stacked([s.symbol for s in declared.statics]),
            casadi.vertcat(*declared.path_data),
        ]
        rest = casadi.vertcat(_objective_density(self._formulation), declared.clock.span)
        if symbol_names(casadi.jacobian(rows, unknowns)) & symbol_names(unknowns):
            return self._implicit_side(_Core.of(rows, unknowns, inputs, rest), inputs)
        solved = _solved_for(rows, unknowns)
        outputs = casadi.substitute([unknowns, rest], [unknowns], [solved])
        return casadi.Function("right_hand_side", inputs, [casadi.densify(o) for o in outputs])

    def _implicit_side(self, core: _Core, inputs: list[Any]) -> Any:
        """Return the right-hand side of implicit equations, by Newton's method to its tolerance."""
        newton = casadi.rootfinder("slopes", "newton", core.residual, {"abstol": _NEWTON_TOLERANCE})
        symbols = [casadi.MX.sym(f"i{k}", i.shape[0]) for k, i in enumerate(inputs)]
        stacked = casadi.vertcat(*symbols)
        found = newton(casadi.MX.zeros(core.inner.shape[0]), stacked)
        return casadi.Function("right_hand_side", symbols, list(core.known(found, stacked)))

    def without_iterations(self) -> Dynamics:
        """Return the vehicle with a fixed number of Newton steps, in CasADi's fast symbols.

        Where equations are implicit, their iteration costs ten times as much as all others.
        """
        if self._right_hand_side.is_a("SXFunction"):
            return self
        return _WithoutIterations(self._formulation, self._instance, self._statics)

    def control_limits(self, breach: float = 0.0) -> tuple[FloatArray, FloatArray]:
        """Return constant lower and upper limits of the controls, shape (n_controls,) each.

        `breach` widens both limits, relative to the larger of 1 and the limit.
        """
        names = [s.name for s in self._formulation.compiled.declared.algebraics]
        chosen = [names.index(name) for name in self.control_names]
        lower, upper = control_limits(self._formulation, self._instance, breach)
        return lower[chosen], upper[chosen]

    def just_after(self, t: float) -> float:
        """Return a time just after t, where equations with jumps have their right-hand values.

        Where they jump, t itself belongs to the left.
        """
        return t + 2.0 * BESIDE * float(self.timeline.spans.max()) if self._instance.jumps else t

    def steps_between(self, start: float, end: float) -> list[float]:
        """Return the times at which parameters given as `Steps` jump, between two times."""
        given = [v for v in self._instance.overrides.values() if isinstance(v, Steps)]
        return sorted({edge for steps in given for edge in steps.edges(start, end)})

    @property
    def signal_names(self) -> tuple[str, ...]:
        """Full names of the time-dependent parameters, in the order of `moment`.

        Signals of rules that branch on time follow them.
        """
        return tuple(slot.name for slot in self._formulation.compiled.declared.signals)

    def moment(self, t: float) -> list[float]:
        """Return the time-dependent inputs of the equations: horizon fraction and signals."""
        fraction = float(self.timeline.fraction(t))
        return [fraction, *self._signals(fraction)]

    def symbol(self, name: str, size: int) -> Any:
        """Return a column of CasADi symbols of the type that `written` accepts."""
        is_explicit = self._right_hand_side.is_a("SXFunction")
        return (casadi.SX if is_explicit else casadi.MX).sym(name, size)

    def parameter_column(self, changed: Mapping[str, Any]) -> Any:
        """Return all parameters as a column, with some of them replaced by symbols."""
        pairs = zip(self.parameter_names, self._instance.parameters.tolist(), strict=True)
        return casadi.vertcat(*(changed.get(name, value) for name, value in pairs))

    def moment_column(self, moment: Any, changed: Mapping[str, Any]) -> Any:
        """Return time-dependent inputs with some parameters replaced by symbols."""
        own = casadi.vertsplit(moment)
        for k, name in enumerate(self.signal_names, start=1):
            own[k] = changed.get(name, own[k])
        return casadi.vertcat(*own)

    def written(self, moment: Any, x: Any, u: Any, parameters: Any = None) -> tuple[Any, Any]:
        """Return dx/dt and the objective's integrand as CasADi expressions of the given symbols.

        `parameters` is a column of `parameter_column`; without it they are the vehicle's own.
        """
        numbers = self._instance.parameters if parameters is None else parameters
        data = casadi.vertcat(moment, numbers)
        unknowns, rest = self._right_hand_side(x, u, self._statics, data)
        return unknowns[: x.shape[0]] / rest[1], rest[0] / rest[1]

    def expressions(
        self, keys: tuple[tuple[str, Any], ...], t: float, values: Mapping[str, Any]
    ) -> list[Any]:
        """Return components, given as (full name, index) pairs, as CasADi expressions.

        An equation, by its name, yields its residual. `values` gives states and algebraic variables
        by full name, as symbols or numbers; all others, and all rates, are zero.
        """
        declared, evaluator = self._formulation.compiled.declared, self._formulation.evaluator
        columns = [
            casadi.SX.zeros(evaluator.inputs[0].shape[0]),
            stacked([casadi.SX(values.get(name, 0.0)) for name in self.state_names]),
            stacked([casadi.SX(values.get(s.name, 0.0)) for s in declared.algebraics]),
            casadi.SX(casadi.DM(self._statics)),
            casadi.SX(casadi.DM(np.concatenate([self.moment(t), self._instance.parameters]))),
        ]
        equations = {e.name: e.expression for e in declared.equations}
        written = casadi.vertcat(
            *[equations[n] if n in equations else evaluator.expression(n, k) for n, k in keys]
        )
        found = casadi.substitute(
            written, casadi.vertcat(*evaluator.inputs), casadi.vertcat(*columns)
        )
        return casadi.vertsplit(found)

    def _row(self, t: float) -> FloatArray:
        moment = self.moment(t)
        self._data[: len(moment)] = moment
        return self._data

    def _solve(self, t: float, x: FloatArray, u: FloatArray) -> list[FloatArray]:
        row = self._row(t)
        return self._at_one(x[None, :], u[None, :], self._statics[None, :], row[None, :])

    def rates(self, t: float, x: FloatArray, u: FloatArray) -> FloatArray:
        """Return dx/dt, shape (n_states,)."""
        return self.rates_and_integrand(t, x, u)[0]

    def rates_and_integrand(
        self, t: float, x: FloatArray, u: FloatArray
    ) -> tuple[FloatArray, float]:
        """Return dx/dt and the objective's integrand in one evaluation."""
        unknowns, ((density, span),) = self._solve(t, x, u)
        return unknowns[0, : x.size] / span, float(density / span)

    def integrand(self, t: float, x: FloatArray, u: FloatArray) -> float:
        """Return the objective's integrand per unit of physical time."""
        return self.rates_and_integrand(t, x, u)[1]

    def solved(
        self,
        t: FloatArray,
        states: FloatArray,
        controls: FloatArray,
        numbers: Mapping[str, ArrayLike] | None = None,
    ) -> Instants:
        """Return states and controls at n times with the resulting rates and algebraics.

        `numbers` gives parameters by full name, each as one number or a column of n.
        """
        n = len(t)
        # Flights side by side share their times, and signals are read one by one.
        times, which = np.unique(np.asarray(t, dtype=float), return_inverse=True)
        fractions = self.timeline.fraction(times)
        signals = self._formulation.signals(self._instance, fractions)[which]
        parameters = np.tile(self._instance.parameters, (n, 1))
        data = self._with_numbers(np.hstack([signals, parameters]), numbers or {})
        statics = np.broadcast_to(self._statics, (n, self._statics.size))
        mapped = MappedFunction(self._right_hand_side, n)
        unknowns = mapped(states, controls, statics, data)[0]
        algebraics = self._algebraics(unknowns[:, states.shape[1] :], controls)
        inputs = [unknowns[:, : states.shape[1]], states, algebraics, statics, data]
        return Instants(inputs=inputs, read=self._formulation.evaluator, numbers=self._with_numbers)

    def _with_numbers(self, data: FloatArray, numbers: Mapping[str, ArrayLike]) -> FloatArray:
        """Return a table of input data with the columns of some parameters set to other numbers."""
        names = self.parameter_names
        changed = data.copy()
        for name, column in numbers.items():
            changed[:, data.shape[1] - len(names) + names.index(name)] = column
        return changed

    def _algebraics(self, determined: FloatArray, controls: FloatArray) -> FloatArray:
        """Return all algebraic variables in their declared order."""
        names = [s.name for s in self._determined]
        columns = [
            determined[:, names.index(s.name)]
            if s.name in names
            else controls[:, self.control_names.index(s.name)]
            for s in self._formulation.compiled.declared.algebraics
        ]
        return np.column_stack(columns) if columns else np.zeros((determined.shape[0], 0))

    def evaluate(
        self,
        component: Any,
        t: FloatArray,
        states: FloatArray,
        controls: FloatArray,
        index: Any = None,
    ) -> FloatArray:
        """Return a variable or expression over time along a flown trajectory.

        Parameters
        ----------
        component : Var, DerivativeVar, Expression or str
            A component over time of the model, or its full name.
        t : ndarray, shape (n,)
        states : ndarray, shape (n, n_states)
        controls : ndarray, shape (n, n_controls)
        index : optional
            The component's index beside time.

        Returns
        -------
        ndarray, shape (n,)
        """
        name = component if isinstance(component, str) else component.name
        return self.table(((name, index),), t, states, controls)[:, 0]

    def table(
        self,
        keys: tuple[tuple[str, Any], ...],
        t: FloatArray,
        states: FloatArray,
        controls: FloatArray,
    ) -> FloatArray:
        """Return several components, as (full name, index) pairs, at once: shape (n, n_keys)."""
        return self.solved(t, states, controls).table(keys)

    @property
    def states_used_up(self) -> tuple[str, ...]:
        """Names of states with a given start and a free end, such as the charge of a battery."""
        declared = self._formulation.compiled.declared
        # An objective that reads the end of a state leaves it free.
        priced = symbol_names(declared.objective)
        points = [p for p in declared.point_symbols if p.symbol.name() not in priced]
        given = {(p.slot, p.fraction) for p in points} | set(declared.fixed)
        at_start = {name for name, fraction in given if fraction == 0.0}
        at_start |= {slot.name for slot in declared.outputs}
        return tuple(n for n in self.state_names if n in at_start and (n, 1.0) not in given)

    @property
    def tables_read(self) -> tuple[str, ...]:
        """Names of the interpolation tables that the equations over time read."""
        return tuple(use.name for use in self._formulation.compiled.tables.over_time)

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Full names of the parameters that the equations read."""
        return tuple(p.name for p in self._formulation.compiled.declared.parameters)

    def initial_states(self) -> dict[str, float]:
        """Return the values that the model's own variables hold at the start, zero if unset."""
        declared = self._formulation.compiled.declared
        held = {
            slot.name: dict(self._formulation.values.initial_values(slot))
            for slot in (*declared.states, *declared.outputs)
        }
        return {name: values.get(0.0, 0.0) for name, values in held.items()}

    def has(self, name: str) -> bool:
        """Return whether the model has a component of this name."""
        return self._formulation.source.has(name)

    def unit(self, name: str) -> str:
        """Return the unit of a limit or a variable, "" where it has none."""
        return self._formulation.source.unit(name)

    def violations(
        self, t: FloatArray, states: FloatArray, controls: FloatArray
    ) -> tuple[Violation, ...]:
        """Return the worst violation of every limit over time, the worst first.

        Limits are path inequalities and bounds; a limit that is met has size 0.
        """
        (found,) = self.violations_of(self.solved(t, states, controls), t)
        return found

    def violations_of(self, instants: Instants, t: FloatArray) -> list[tuple[Violation, ...]]:
        """Return the `violations` of several flights that share the same times."""
        limits = self.limits_of(instants)
        flights = (slice(k, k + len(t)) for k in range(0, len(instants.inputs[0]), len(t)))
        return [
            tuple(
                sorted(
                    (limit.worst(own, t) for limit in limits),
                    key=lambda v: -v.relative,
                )
            )
            for own in flights
        ]

    def limits_of(self, instants: Instants) -> list[LimitValues]:
        """Return each path inequality and bound over time, with its values along a given flight."""
        compiled = self._formulation.compiled
        declared, n_states = compiled.declared, len(compiled.declared.states)
        rates, all_states, algebraics, statics, data = instants.inputs
        n = len(data)
        inner = all_states[:, :n_states]
        variables = np.hstack([rates[:, :n_states], inner, algebraics, statics])
        rows = MappedFunction(compiled.path.values, n)(variables, data)[0]
        lower, upper = MappedFunction(compiled.path_bounds, n)(data)
        low, high = MappedFunction(compiled.limits_over_time, n)(data)
        values = np.hstack([inner, algebraics])[:, compiled.limited]
        limits = [
            LimitValues(e.name, rows[:, k], lower[:, k], upper[:, k])
            for k, e in enumerate(declared.equations)
            if not e.is_equality
        ]
        limits += [
            LimitValues(limit.name, values[:, k], low[:, k], high[:, k])
            for k, limit in enumerate(compiled.limits)
        ]
        return limits


def split_algebraics(formulation: Formulation) -> tuple[tuple[Slot, ...], tuple[Slot, ...]]:
    """Split the algebraic variables into controls and variables that equations determine.

    Equality equations without rates determine algebraic variables. A maximum matching of equations
    and variables decides which variables these are, with later declared variables first.

    Examples
    --------
    >>> controls, determined = split_algebraics(solution.problem)
    >>> [slot.name for slot in controls], determined
    (['u'], ())
    """
    declared = formulation.compiled.declared
    rates = {s.rate.name() for s in declared.states}
    rows = [
        names
        for e in declared.equations
        if e.is_equality and not (names := symbol_names(e.expression)) & rates
    ]
    slots = list(reversed(declared.algebraics))
    if not rows or not slots:
        return declared.algebraics, ()
    incidence = csr_matrix([[int(s.name in names) for s in slots] for names in rows])
    matched = {int(k) for k in maximum_bipartite_matching(incidence, perm_type="column") if k >= 0}
    determined = {s.name for k, s in enumerate(slots) if k in matched}
    return (
        tuple(s for s in declared.algebraics if s.name not in determined),
        tuple(s for s in declared.algebraics if s.name in determined),
    )


def control_limits(
    formulation: Formulation, instance: Instance, breach: float
) -> tuple[FloatArray, FloatArray]:
    """Return constant limits of the algebraic variables that are controls, widened by `breach`.

    Shape (n_algebraics,) each, infinite for variables that equations determine.
    """
    controls = {slot.name for slot in split_algebraics(formulation)[0]}
    is_control = np.array([s.name in controls for s in formulation.compiled.declared.algebraics])
    lower, upper = formulation.algebraic_limits(instance)
    lower = lower - breach * np.maximum(1.0, np.abs(lower))
    upper = upper + breach * np.maximum(1.0, np.abs(upper))
    return np.where(is_control, lower, -np.inf), np.where(is_control, upper, np.inf)


def _objective_density(formulation: Formulation) -> Any:
    """Return the integrand of the objective, as declared, over the unit horizon."""
    declared = formulation.compiled.declared
    density = casadi.SX(0)
    for k in formulation.compiled.row_integrals:
        integral = declared.integrals[k]
        slope = casadi.jacobian(casadi.SX(declared.objective), integral.symbol)
        density += slope * integral.integrand
    return density


def _solve_linear(matrix: Any, right: Any) -> Any:
    """Solve a linear system symbolically; one unknown per row needs only a division."""
    rows, columns = matrix.sparsity().get_triplet()
    n = matrix.shape[0]
    if sorted(rows) == list(range(n)) and sorted(columns) == list(range(n)):
        solved = [casadi.SX(0)] * n
        for row, column in zip(rows, columns, strict=True):
            solved[column] = right[row] / matrix[row, column]
        return casadi.vertcat(*solved)
    return casadi.solve(matrix, right)


def _solved_for(rows: Any, unknowns: Any) -> Any:
    """Solve equations for unknowns that enter them linearly."""
    offset = casadi.substitute(rows, unknowns, casadi.DM.zeros(unknowns.shape[0]))
    return _solve_linear(casadi.jacobian(rows, unknowns), -offset)


@dataclass(frozen=True, kw_only=True)
class _Core:
    """Implicit equations, split into a nonlinear core for Newton's method and a linear rest.

    `inner` are its unknowns, `residual` takes them and all inputs as one column, and `known`
    returns all unknowns, the integrand and the span of the same.
    """

    inner: Any
    residual: Any
    known: Any

    @classmethod
    def of(cls, rows: Any, unknowns: Any, inputs: list[Any], rest: Any) -> _Core:
        """Split equations that are nonlinear in the slopes or algebraics.

        Newton's method solves only those equations on which the others depend. Equations that are
        linear in the remaining unknowns are solved symbolically.
        """
        core, others = _nonlinear_core(rows, unknowns)
        parameters = casadi.vertcat(*inputs)
        inner = casadi.vertcat(*[unknowns[k] for k in core[1]])
        residual = casadi.Function(
            "residual", [inner, parameters], [casadi.vertcat(*[rows[k] for k in core[0]])]
        )
        solved, left = unknowns, casadi.vertcat(*[unknowns[k] for k in others[1]])
        if others[0]:
            outer = _solved_for(casadi.vertcat(*[rows[k] for k in others[0]]), left)
            solved = casadi.substitute(unknowns, left, outer)
            rest = casadi.substitute(rest, left, outer)
        outputs = [casadi.densify(solved), casadi.densify(rest)]
        known = casadi.Function("known", [inner, parameters], outputs)
        return cls(inner=inner, residual=residual, known=known)


class _WithoutIterations(Dynamics):
    """Implicit equations solved by `_NEWTON_STEPS` Newton steps, written out as expressions."""

    def _implicit_side(self, core: _Core, inputs: list[Any]) -> Any:
        stacked = casadi.vertcat(*inputs)
        residual = core.residual(core.inner, stacked)
        slope = casadi.Function(
            "slope", [core.inner, stacked], [casadi.jacobian(residual, core.inner)]
        )
        found = casadi.SX.zeros(core.inner.shape[0])
        for _ in range(_NEWTON_STEPS):
            step = _solve_linear(slope(found, stacked), core.residual(found, stacked))
            found = found - step
        known = list(core.known(found, stacked))
        return casadi.Function("right_hand_side", inputs, known, {"cse": True})


def _nonlinear_core(rows: Any, unknowns: Any) -> tuple[tuple[list[int], list[int]], ...]:
    """Return equations and unknowns that Newton's method must solve, and those that remain linear.

    If the unknowns that enter nonlinearly outnumber the equations in them, Newton's method solves
    all.
    """
    everything = list(range(unknowns.shape[0]))
    jacobian = casadi.jacobian(rows, unknowns)
    names = symbol_names(jacobian)
    inner = [k for k in everything if unknowns[k].name() in names]
    held: dict[int, set[int]] = {k: set() for k in everything}
    for row, column in zip(*jacobian.sparsity().get_triplet(), strict=True):
        held[row].add(column)
    own = [k for k in everything if held[k] <= set(inner)]
    if len(own) != len(inner):
        return (everything, everything), ([], [])
    others = [k for k in everything if k not in own], [k for k in everything if k not in inner]
    return (own, inner), others


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
    """A symbolic number that records the NumPy functions applied to it, for compilation."""

    def __init__(self, expression: Any) -> None:
        self.expression = expression

    def __array_ufunc__(self, function: np.ufunc, method: str, *numbers: Any, **_: Any) -> Symbol:
        """Record a function of symbols.

        Raises
        ------
        TranscriptionError
            If the function cannot be compiled.
        """
        if function not in _OPERATIONS or method != "__call__":
            raise _refusal(f"np.{function.__name__}")
        return Symbol(_OPERATIONS[function](*map(_expression, numbers)))

    def __bool__(self) -> bool:
        """Raise an error: a law must not branch on a symbol."""
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
    """Feedback law written with NumPy functions of single numbers."""

    def __call__(
        self, command: Sequence[Any], x: Sequence[Any], own: Sequence[Any], /
    ) -> tuple[Sequence[Any], Sequence[Any]]:
        """Return the controls and the time derivatives of the law's own states.

        Arguments: the command to follow, the vehicle's states, the law's own states.
        """


def written_law(dynamics: Dynamics, law: Law, sizes: tuple[int, int, int]) -> Any:
    """Compile a law to a function (joint state, command) -> (controls, rates of its own states).

    Sizes are those of moment, joint state and command.

    Raises
    ------
    TranscriptionError
        If the law returns another number of controls or rates than there are.
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
    """Return the lengths of time-dependent inputs, joint state and command of a closed loop."""
    moment = len(dynamics.moment(dynamics.start))
    return moment, len(dynamics.state_names) + n_own + 1, n_command


def closed(
    dynamics: Dynamics, law: Law, sizes: tuple[int, int, int], numbers: Mapping[str, Any]
) -> tuple[list[Any], Any, Any]:
    """Return the symbols of a closed loop's inputs, the rates of its joint state, and its controls.

    `numbers` replaces parameters, by full name, by symbols.
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
    """Compiled closed loop of a vehicle and a feedback law.

    The joint state consists of the vehicle's states, the law's own states, and the integral of the
    objective's integrand.

    Parameters
    ----------
    dynamics : Dynamics
        The vehicle.
    law : callable
        (command, x, own) -> (controls, rates of own), sequences of numbers; see `Law`. It is called
        once, with symbols.
    n_command, n_own : int
        Number of commands that the law follows, and number of its own states.

    Raises
    ------
    TranscriptionError
        If the law branches on a state, calls a function that cannot be compiled, or returns a wrong
        number of controls or of rates of its own states.
    """

    def __init__(self, dynamics: Dynamics, law: Law, *, n_command: int, n_own: int) -> None:
        self._dynamics = dynamics
        sizes = joint_sizes(dynamics, n_command, n_own)
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
        # The CasADi buffer stores addresses only; keep the arrays alive.
        self._held = buffer, controls

    def _compiled(self, law: Law, sizes: tuple[int, int, int]) -> Any:
        """Return the function (moment, joint, command) -> rates of the joint state, controls."""
        symbols, rates, controls = closed(self._dynamics, law, sizes, {})
        # To tell whether two calls are the same, CasADi writes each table down in full.
        has_tables = bool(self._dynamics.tables_read)
        options = {"cse": not has_tables}
        return casadi.Function("closed_loop", symbols, [rates, controls], options)

    def rates(
        self, t: float, joint: FloatArray, command: Sequence[float] | FloatArray
    ) -> FloatArray:
        """Return the time derivative of the joint state, shape (n_joint,)."""
        self._moment[:] = self._dynamics.moment(t)
        self._joint[:] = joint
        self._command[:] = command
        self._evaluate()
        return self._rates.copy()

    def slopes(
        self, t: FloatArray, joint: FloatArray, command: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return derivatives of the joint state's rates at n times, by moment and by joint state.

        Shapes (n, n_joint, n_moment) and (n, n_joint, n_joint); where the law has a corner, those
        of one side.
        """
        names = self._function.name_in()
        jacobians = [f"jac:{self._function.name_out(0)}:{names[k]}" for k in (0, 1)]
        written = self._function.factory("slopes", names, jacobians)
        symbols = written.mx_in()
        columns = [casadi.vec(casadi.densify(out)) for out in written.call(symbols)]
        mapped = MappedFunction(casadi.Function("slopes", symbols, columns), len(t))
        moments = np.array([self._dynamics.moment(float(time)) for time in t])
        by_moment, by_joint = mapped(moments, joint, command)
        # CasADi keeps matrices by columns.
        shape = len(t), -1, joint.shape[1]
        return (
            by_moment.reshape(shape).transpose(0, 2, 1),
            by_joint.reshape(shape).transpose(0, 2, 1),
        )

    def controls(self, t: FloatArray, joint: FloatArray, command: FloatArray) -> FloatArray:
        """Return the controls that the law applies at n times, shape (n, n_controls)."""
        moments = np.array([self._dynamics.moment(float(time)) for time in t])
        return MappedFunction(self._function, len(t))(moments, joint, command)[1]
