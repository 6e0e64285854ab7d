"""The declared equations as functions of time: slopes, outputs, any variable or expression."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import casadi
import numpy as np
from scipy.sparse import bsr_matrix, csr_matrix, identity, kron
from scipy.sparse.csgraph import maximum_bipartite_matching
from scipy.sparse.linalg import splu

from pyomo_quad.collocation.errors import SolveError, TranscriptionError
from pyomo_quad.collocation.program.compiled import MappedFunction
from pyomo_quad.collocation.reading.schedules import BESIDE
from pyomo_quad.collocation.reading.writer import symbol_names
from pyomo_quad.collocation.serialisation import Packed, packed

if TYPE_CHECKING:
    from collections.abc import Iterator

    from pyomo_quad.collocation.mesh import FloatArray
    from pyomo_quad.collocation.problem import Instance, Problem
    from pyomo_quad.collocation.program.compiled import CompiledModel
    from pyomo_quad.collocation.program.sparsity import Layout
    from pyomo_quad.collocation.reading.symbols import Declarations, Slot
    from pyomo_quad.collocation.reading.writer import TemplateWriter


def index_tuple(index: Any) -> tuple[Any, ...]:
    """Return a component's index without time as a tuple."""
    if index is None:
        return ()
    return index if isinstance(index, tuple) else (index,)


class WrittenComponents:
    """A model's components over time, written before it was pickled; read like a writer.

    Parameters
    ----------
    written : dict
        By name and index beside time the expression, or why it cannot be written.
    """

    def __init__(self, written: dict[tuple[str, tuple[Any, ...]], Any]) -> None:
        self._written = written

    def components_over_time(self) -> Iterator[tuple[str, tuple[Any, ...]]]:
        """Yield name and index of all components."""
        yield from self._written

    def over_time(self, name: str, index: tuple[Any, ...]) -> Any:
        """Return a component's expression, None if there is none of the name."""
        if all(name != known for known, _ in self._written):
            return None
        found = self._written[name, index]
        if isinstance(found, str):
            raise TranscriptionError(found)
        return found


class Evaluator:
    """Writes components of the model as CasADi functions of a point, once each.

    The inputs of a function are the rates, states and algebraic variables (outputs after the
    states of the program), the static variables, and the data: fraction, signals, parameters.
    """

    def __init__(self, inputs: tuple[Any, ...], writer: TemplateWriter | WrittenComponents) -> None:
        self._writer = writer
        self.inputs = inputs
        self._known = symbol_names(casadi.vertcat(*self.inputs))
        self._functions: dict[tuple[tuple[str, Any], ...], Any] = {}

    @classmethod
    def of(cls, compiled: CompiledModel, writer: TemplateWriter) -> Evaluator:
        """Return what evaluates the components of the model that was compiled."""
        d = compiled.declared
        states = (*d.states, *d.outputs)
        inputs = (
            _value_column([s.rate for s in states]),
            _value_column([s.symbol for s in states]),
            _value_column([s.symbol for s in d.algebraics]),
            _value_column([s.symbol for s in d.statics]),
            casadi.vertcat(*d.path_data),
        )
        return cls(inputs, writer)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the components written, each once."""
        written: dict[tuple[str, tuple[Any, ...]], Any] = {}
        for name, index in self._writer.components_over_time():
            try:
                written[name, index] = self._writer.over_time(name, index)
            except TranscriptionError as error:
                written[name, index] = str(error)
        return _unpacked, (packed((self.inputs, written)),)

    def __deepcopy__(self, memo: dict[int, Any]) -> Evaluator:
        """Return itself: it reads no number of the model."""
        return self

    def expression(self, component: Any, index: Any = None) -> Any:
        """Return a component over time as a CasADi expression of the inputs.

        Raises
        ------
        TranscriptionError
            If the component is not a variable or expression over time of this model.
        """
        name = component if isinstance(component, str) else component.name
        try:
            written = self._writer.over_time(name, index_tuple(index))
        except KeyError:
            raise TranscriptionError(
                f"{name}: has no index {index!r} beside time; give index= one of its set."
            ) from None
        if written is None:
            raise TranscriptionError(
                f"{name}: is not a variable or expression over time of the compiled model."
            )
        unknown = symbol_names(written) - self._known
        if unknown:
            raise TranscriptionError(
                f"{name}: holds {', '.join(sorted(unknown))}, which takes no part in the problem."
            )
        return written

    def function(self, keys: tuple[tuple[str, Any], ...]) -> Any:
        """Return the CasADi function of some (name, index) pairs, compiled when first asked."""
        if keys not in self._functions:
            rows = casadi.vertcat(*[self.expression(name, index) for name, index in keys])
            self._functions[keys] = casadi.Function(
                "components", list(self.inputs), [casadi.densify(rows)]
            )
        return self._functions[keys]

    def __call__(self, keys: tuple[tuple[str, Any], ...], *inputs: FloatArray) -> FloatArray:
        """Evaluate components at n points.

        Parameters
        ----------
        keys : tuple of (str, index)
            Full names and indices beside time (None for none).
        inputs : ndarray, shape (n, k)
            Rates, states, algebraics, statics and data, one row per point.

        Returns
        -------
        ndarray, shape (n, n_keys)
        """
        return MappedFunction(self.function(keys), inputs[0].shape[0])(*inputs)[0]


def _unpacked(kept: Packed) -> Evaluator:
    inputs, written = kept.unpacked()
    return Evaluator(inputs, WrittenComponents(written))


def _value_column(symbols: list[Any]) -> Any:
    return casadi.vertcat(casadi.SX(0, 1), *symbols)


_NEWTON_STEPS = 50
_NEWTON_TOLERANCE = 1e-13


class OutputStates:
    """Compiled equations of the output states."""

    def __init__(self, compiled: CompiledModel) -> None:
        declared = compiled.declared
        path_variables, path_data = compiled.symbols
        self._slots = declared.outputs
        rates = casadi.vertcat(casadi.SX(0, 1), *[s.rate for s in self._slots])
        states = casadi.vertcat(casadi.SX(0, 1), *[s.symbol for s in self._slots])
        rows = casadi.vertcat(casadi.SX(0, 1), *[e.expression for e in declared.output_equations])
        inputs = [rates, states, path_variables, path_data]
        self._residual = casadi.Function(
            "outputs",
            inputs,
            [
                casadi.densify(rows),
                casadi.densify(casadi.jacobian(rows, rates)),
                casadi.densify(casadi.jacobian(rows, states)),
            ],
        )
        self._starts = self._start_function(declared)

    def __len__(self) -> int:
        return len(self._slots)

    @staticmethod
    def _start_function(declared: Declarations) -> Any:
        """Return a function of the parameters: the start value of each output, or NaN."""
        parameters = casadi.vertcat(casadi.SX(0, 1), *[s.symbol for s in declared.parameters])
        values = []
        for slot in declared.outputs:
            found = casadi.SX(np.nan)
            for condition in declared.output_starts:
                for symbol in casadi.symvar(condition.expression):
                    if symbol.name().startswith(f"{slot.component}["):
                        slope = casadi.jacobian(condition.expression, symbol)
                        offset = casadi.substitute(condition.expression, symbol, casadi.SX(0))
                        found = (condition.lower - offset) / slope
            values.append(found)
        return casadi.Function(
            "output_starts", [parameters], [casadi.vertcat(casadi.SX(0, 1), *values)]
        )

    def start(self, parameters: FloatArray, fixed: dict[tuple[str, float], float]) -> FloatArray:
        """Return the values at the start of the horizon, shape (n_outputs,)."""
        held = np.asarray(self._starts(parameters)).ravel()
        return np.array(
            [fixed.get((s.name, 0.0), held[k]) for k, s in enumerate(self._slots)], dtype=float
        )

    def solve(
        self, layout: Layout, start: FloatArray, path_variables: FloatArray, data: FloatArray
    ) -> FloatArray:
        """Return the output states at the nodes, shape (n_points + 1, n_outputs).

        Raises
        ------
        SolveError
            If Newton's method does not converge.
        """
        n, points = len(self._slots), layout.points
        function = MappedFunction(self._residual, points)
        slope = kron(layout.slope_matrix[:, 1:], identity(n), format="csr")
        states = np.tile(start, (points + 1, 1))
        for _ in range(_NEWTON_STEPS):
            rates = layout.slope_matrix @ states
            rows, by_rate, by_state = function(rates, states[1:], path_variables, data)
            jacobian = self._blocks(by_rate, n) @ slope + self._blocks(by_state, n)
            step = splu(csr_matrix(jacobian).tocsc()).solve(rows.ravel()).reshape(points, n)
            states[1:] -= step
            if np.max(np.abs(step)) <= _NEWTON_TOLERANCE * (1.0 + np.max(np.abs(states))):
                return states
        names = ", ".join(s.name for s in self._slots)
        raise SolveError(
            f"{names}: Newton's method did not solve the equations of these output states; "
            "check their equations and start values."
        )

    @staticmethod
    def _blocks(values: FloatArray, n: int) -> csr_matrix:
        # CasADi stores a point's matrix by columns.
        matrices = values.reshape(-1, n, n).transpose(0, 2, 1)
        count = len(matrices)
        return bsr_matrix((matrices, np.arange(count), np.arange(count + 1))).tocsr()


@dataclass(frozen=True)
class Violation:
    """The worst breach of one limit: its name, size in its own unit, bound and time."""

    name: str
    size: float
    bound: float
    time: float

    @property
    def relative(self) -> float:
        """Size relative to the larger of 1 and the bound."""
        return self.size / max(1.0, abs(self.bound))


class Dynamics:
    """Explicit right-hand side and outputs of a compiled problem, for given numbers.

    Attributes
    ----------
    state_names : tuple of str
        States of the program, then output states.
    control_names : tuple of str
        Algebraic variables that no equation determines: what a simulation is given.
    """

    def __init__(self, problem: Problem, instance: Instance, statics: FloatArray) -> None:
        self._problem = problem
        self._instance = instance
        self._statics = np.asarray(statics, dtype=float)
        declared = problem.compiled.declared
        states = (*declared.states, *declared.outputs)
        self.controls, self._determined = _controls(problem)
        self.state_names = tuple(s.name for s in states)
        self.control_names = tuple(s.name for s in self.controls)
        self.start, end = problem.horizon_of(self._statics, instance)
        self._span = end - self.start
        self._right_hand_side = self._compile(states)
        self._at_one = MappedFunction(self._right_hand_side, 1)
        self._signals = problem.values.signals(instance)
        n_signals = len(declared.signals) + len(declared.scheduled)
        self._data = np.concatenate([np.zeros(1 + n_signals), instance.parameters])

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle what it is made of."""
        return type(self), (self._problem, self._instance, self._statics)

    def _compile(self, states: tuple[Slot, ...]) -> Any:
        """Return the function (x, u, statics, data) -> slopes, algebraics, integrand."""
        declared = self._problem.compiled.declared
        equations = [e for e in declared.equations if e.is_equality]
        rows = casadi.vertcat(*[e.expression for e in (*equations, *declared.output_equations)])
        unknowns = casadi.vertcat(*[s.rate for s in states], *[s.symbol for s in self._determined])
        if rows.shape[0] != unknowns.shape[0]:
            raise TranscriptionError(
                f"dynamics: {rows.shape[0]} equations determine {unknowns.shape[0]} slopes and "
                "algebraic variables; a simulation needs as many equations as unknowns."
            )
        inputs = [
            _column([s.symbol for s in states]),
            _column([s.symbol for s in self.controls]),
            _column([s.symbol for s in declared.statics]),
            casadi.vertcat(*declared.path_data),
        ]
        density = _objective_density(self._problem)
        jacobian = casadi.jacobian(rows, unknowns)
        if not symbol_names(jacobian) & symbol_names(unknowns):
            zero = casadi.DM.zeros(unknowns.shape[0])
            offset = casadi.substitute(rows, unknowns, zero)
            solved = _solve_linear(jacobian, -offset)
            outputs = casadi.substitute([unknowns, density], [unknowns], [solved])
            return casadi.Function("right_hand_side", inputs, [casadi.densify(o) for o in outputs])
        return _implicit(rows, unknowns, inputs, density)

    def just_after(self, t: float) -> float:
        """Return a time at which the equations are what they are after t.

        Where they jump, t itself belongs to what is before.
        """
        return t + 2.0 * BESIDE * self._span if self._instance.jumps else t

    def _row(self, t: float) -> FloatArray:
        self._data[0] = (t - self.start) / self._span
        for k, number in enumerate(self._signals(float(self._data[0])), start=1):
            self._data[k] = number
        return self._data

    def _solve(self, t: float, x: FloatArray, u: FloatArray) -> list[FloatArray]:
        row = self._row(t)
        return self._at_one(x[None, :], u[None, :], self._statics[None, :], row[None, :])

    def rates(self, t: float, x: FloatArray, u: FloatArray) -> FloatArray:
        """Return dx/dt, shape (n_states,)."""
        return self._solve(t, x, u)[0][0, : x.size] / self._span

    def rates_and_integrand(
        self, t: float, x: FloatArray, u: FloatArray
    ) -> tuple[FloatArray, float]:
        """Return dx/dt and the objective's integrand in one evaluation."""
        unknowns, density = self._solve(t, x, u)
        return unknowns[0, : x.size] / self._span, float(density[0, 0]) / self._span

    def integrand(self, t: float, x: FloatArray, u: FloatArray) -> float:
        """Return the objective's integrand per unit of physical time."""
        return float(self._solve(t, x, u)[1][0, 0]) / self._span

    def _inputs(self, t: FloatArray, states: FloatArray, controls: FloatArray) -> list[FloatArray]:
        """Return what an `Evaluator` reads, for n times at once."""
        n = len(t)
        fractions = (np.asarray(t, dtype=float) - self.start) / self._span
        signals = self._problem.signals(self._instance, fractions)
        parameters = np.broadcast_to(self._instance.parameters, (n, self._instance.parameters.size))
        data = np.hstack([signals, parameters])
        statics = np.broadcast_to(self._statics, (n, self._statics.size))
        mapped = MappedFunction(self._right_hand_side, n)
        unknowns = mapped(states, controls, statics, data)[0]
        algebraics = self._algebraics(unknowns[:, states.shape[1] :], controls)
        return [unknowns[:, : states.shape[1]], states, algebraics, statics, data]

    def _algebraics(self, determined: FloatArray, controls: FloatArray) -> FloatArray:
        """Return all algebraic variables in their declared order."""
        names = [s.name for s in self._determined]
        columns = [
            determined[:, names.index(s.name)]
            if s.name in names
            else controls[:, self.control_names.index(s.name)]
            for s in self._problem.compiled.declared.algebraics
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
        return self._problem.evaluator(keys, *self._inputs(t, states, controls))

    @property
    def states_used_up(self) -> tuple[str, ...]:
        """States given at the start of the horizon and left free at its end, as a charge is."""
        declared = self._problem.compiled.declared
        given = {(p.slot, p.fraction) for p in declared.point_symbols} | set(declared.fixed)
        at_start = {name for name, fraction in given if fraction == 0.0}
        at_start |= {slot.name for slot in declared.outputs}
        return tuple(n for n in self.state_names if n in at_start and (n, 1.0) not in given)

    def initial_states(self) -> dict[str, float]:
        """Return the values that the model's own variables hold at the start, zero for none."""
        declared = self._problem.compiled.declared
        held = {
            slot.name: dict(self._problem.values.initial_values(slot))
            for slot in (*declared.states, *declared.outputs)
        }
        return {name: values.get(0.0, 0.0) for name, values in held.items()}

    def has(self, name: str) -> bool:
        """Say whether the model has a component of this name."""
        return self._problem.source.has(name)

    def unit(self, name: str) -> str:
        """Return the unit of a limit or a variable, "" where it has none."""
        return self._problem.source.unit(name)

    def violations(
        self, t: FloatArray, states: FloatArray, controls: FloatArray
    ) -> tuple[Violation, ...]:
        """Return the worst breach of every limit over time, the worst first.

        Limits are path inequalities and bounds; a limit that is kept counts with size 0.
        """
        compiled = self._problem.compiled
        declared, n_states = compiled.declared, len(compiled.declared.states)
        rates, all_states, algebraics, statics, data = self._inputs(t, states, controls)
        inner = all_states[:, :n_states]
        variables = np.hstack([rates[:, :n_states], inner, algebraics, statics])
        rows = MappedFunction(compiled.path.values, len(t))(variables, data)[0]
        lower, upper = MappedFunction(compiled.path_bounds, len(t))(data)
        low, high, simple_low, simple_high = MappedFunction(compiled.variable_limits, len(t))(data)
        values = np.hstack([inner, algebraics])
        names = [s.name for s in (*declared.states, *declared.algebraics)]
        found = [
            _worst(e.name, rows[:, k], lower[:, k], upper[:, k], t)
            for k, e in enumerate(declared.equations)
            if not e.is_equality
        ]
        found += [_worst(n, values[:, k], low[:, k], high[:, k], t) for k, n in enumerate(names)]
        for k, bound in enumerate(compiled.simple_path_bounds):
            held = values[:, names.index(bound.variable)]
            sides = simple_low[:, k], simple_high[:, k]
            found.append(_worst(bound.name, held, *sides, t))
        return tuple(sorted(found, key=lambda v: -v.relative))


def _worst(
    name: str, values: FloatArray, lower: FloatArray, upper: FloatArray, t: FloatArray
) -> Violation:
    below, above = lower - values, values - upper
    size = np.maximum(below, above)
    at = int(np.argmax(size))
    bound = lower[at] if below[at] > above[at] else upper[at]
    bound = float(bound) if np.isfinite(bound) else 0.0
    return Violation(name, max(float(size[at]), 0.0), bound, float(t[at]))


def _column(symbols: list[Any]) -> Any:
    return casadi.vertcat(casadi.SX(0, 1), *symbols)


def _controls(problem: Problem) -> tuple[tuple[Slot, ...], tuple[Slot, ...]]:
    """Split the algebraic variables into controls and those that equations determine.

    Equality equations without rates determine algebraic variables; which ones follows from a
    maximum matching of equations and variables, later declared variables first.
    """
    declared = problem.compiled.declared
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


def _objective_density(problem: Problem) -> Any:
    """Return the integrand of the objective, as declared, over the unit horizon."""
    declared = problem.compiled.declared
    density = casadi.SX(0)
    for k in problem.compiled.row_integrals:
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


def _implicit(rows: Any, unknowns: Any, inputs: list[Any], density: Any) -> Any:
    """Return the right-hand side of equations that are nonlinear in the slopes."""
    parameters = casadi.vertcat(*inputs)
    residual = casadi.Function("residual", [unknowns, parameters], [rows])
    newton = casadi.rootfinder("slopes", "newton", residual, {"abstol": 1e-13})
    integrand = casadi.Function("integrand", [unknowns, parameters], [density])
    symbols = [casadi.MX.sym(f"i{k}", i.shape[0]) for k, i in enumerate(inputs)]
    stacked = casadi.vertcat(*symbols)
    solved = newton(casadi.MX.zeros(unknowns.shape[0]), stacked)
    return casadi.Function("right_hand_side", symbols, [solved, integrand(solved, stacked)])
