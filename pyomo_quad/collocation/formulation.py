"""Compiled Pyomo.DAE model: its equations, its data, and its nonlinear programs on meshes.

The module also does three other tasks:

- It evaluates any component of the model.
- It computes output states: states on which neither the objective nor other equations depend.
- It computes the structural index: the number of times by which the equations must be
  differentiated to obtain an ODE.
"""

from __future__ import annotations

from copy import deepcopy
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Self

import casadi
import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.sparse import bsr_matrix, csr_matrix, identity, kron
from scipy.sparse.linalg import splu

from pyomo_quad.collocation.errors import SolveError, TranscriptionError
from pyomo_quad.collocation.mesh import Timeline
from pyomo_quad.collocation.packing import Packed, packed
from pyomo_quad.collocation.program.compiled import (
    CompiledModel,
    MappedFunction,
    compile_declarations,
    stacked,
)
from pyomo_quad.collocation.program.transcription import Data, Transcription
from pyomo_quad.collocation.reading.clock import index_tuple
from pyomo_quad.collocation.reading.model import read_declarations
from pyomo_quad.collocation.reading.model_source import LiveModel, declared_magnitudes
from pyomo_quad.collocation.reading.schedules import BESIDE
from pyomo_quad.collocation.reading.symbols import indexed_name
from pyomo_quad.collocation.reading.values import Instance, ModelValues, Overrides
from pyomo_quad.collocation.reading.writer import symbol_names

if TYPE_CHECKING:
    from collections.abc import Iterator

    from pyomo_quad.collocation.mesh import FloatArray, Mesh
    from pyomo_quad.collocation.program.sparsity import Layout
    from pyomo_quad.collocation.reading.clock import FreeTimes
    from pyomo_quad.collocation.reading.model import ModelReader
    from pyomo_quad.collocation.reading.model_source import ModelSnapshot
    from pyomo_quad.collocation.reading.symbols import Declarations
    from pyomo_quad.collocation.reading.writer import TemplateWriter


class WrittenComponents:
    """CasADi expressions of model components over time, available without the Pyomo model.

    In a problem that is restored from a pickle, an object of this class replaces the
    `TemplateWriter`, which needs the Pyomo model.

    Parameters
    ----------
    written : dict
        (full name, index without time) -> CasADi expression, or a text that says why there is none.
        For ``x[i, t]``, the index without time is (i,).
    """

    def __init__(self, written: dict[tuple[str, tuple[Any, ...]], Any]) -> None:
        self._written = written

    def components_over_time(self) -> Iterator[tuple[str, tuple[Any, ...]]]:
        """Yield for each component its full name and its index without the time.

        For ``x[i, t]`` with the time t, the index without the time is (i,).
        """
        yield from self._written

    def over_time(self, name: str, index: tuple[Any, ...]) -> Any:
        """Return a component's CasADi expression, or None if no component has this name.

        `index` is the index without the time: (i,) for ``x[i, t]``.

        Raises
        ------
        TranscriptionError
            If the component cannot be written as an expression.
        KeyError
            If the component has no such index.
        """
        if all(name != known for known, _ in self._written):
            return None
        found = self._written[name, index]
        if isinstance(found, str):
            raise TranscriptionError(found)
        return found


class Evaluator:
    """Evaluator of model components at single times, by compiled and cached CasADi functions.

    A component is a variable, derivative or named expression over time.

    Parameters
    ----------
    inputs : tuple of casadi.SX
        Five columns of symbols: rates, states, algebraic variables, static variables, and data.
        They are those of `Instants.inputs`. In rates and states, the output states come last.
    writer : TemplateWriter or WrittenComponents
        Source of the expressions of the components.
    """

    def __init__(self, inputs: tuple[Any, ...], writer: TemplateWriter | WrittenComponents) -> None:
        self._writer = writer
        self.inputs = inputs
        self._known = symbol_names(casadi.vertcat(*self.inputs))
        self._functions: dict[tuple[tuple[str, Any], ...], Any] = {}

    @classmethod
    def of(cls, compiled: CompiledModel, writer: TemplateWriter) -> Evaluator:
        """Return an evaluator of all components of a compiled model.

        `writer` translates components of the Pyomo model to CasADi expressions.
        """
        d = compiled.declared
        states = (*d.states, *d.outputs)
        inputs = (
            stacked([s.rate for s in states]),
            stacked([s.symbol for s in states]),
            stacked([s.symbol for s in d.algebraics]),
            stacked([s.symbol for s in d.statics]),
            casadi.vertcat(*d.path_data),
        )
        return cls(inputs, writer)

    def __reduce__(self) -> tuple[Any, ...]:
        """Return the recipe by which `pickle` stores this evaluator: `_unpacked` and its argument.

        If a component has no CasADi expression, the recipe holds the reason as a text.
        """
        written: dict[tuple[str, tuple[Any, ...]], Any] = {}
        for name, index in self._writer.components_over_time():
            try:
                written[name, index] = self._writer.over_time(name, index)
            except TranscriptionError as error:
                written[name, index] = str(error)
        # CasADi expressions cannot be pickled, and are therefore serialised into one text. The
        # restored evaluator compiles its functions again at first use.
        return _unpacked, (packed((self.inputs, written)),)

    def __deepcopy__(self, memo: dict[int, Any]) -> Evaluator:
        """Return this evaluator itself, which holds no parameter values and can be shared."""
        return self

    def expression(self, component: Any, index: Any = None) -> Any:
        """Return a component over time as a CasADi expression of the evaluator's inputs.

        `component` may be a full name. `index` is i for ``x[i, t]``, and None for ``x[t]``.

        Raises
        ------
        TranscriptionError
            If the component is no variable or expression over time of this model.
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
                f"{name}: contains {', '.join(sorted(unknown))}, which the problem does not; use "
                "variables and parameters of the compiled model."
            )
        return written

    def is_over_time(self, component: str, index: Any = None) -> bool:
        """Return whether a variable or expression depends on time.

        `component` is its full name. `index` is i for ``x[i, t]``, and omitted for ``x[t]``. If a
        component over time has no such index, the result is True. Its evaluation then raises an
        error that names the index.
        """
        try:
            return self._writer.over_time(component, index_tuple(index)) is not None
        except KeyError:
            return True

    def function(self, keys: tuple[tuple[str, Any], ...]) -> Any:
        """Return the CasADi function that evaluates several components, compiled at first use.

        `keys` are pairs (full name, index without the time). The index is i for ``x[i, t]``, and
        None for ``x[t]``. The function's only output is a column vector with one component per row.
        """
        if keys not in self._functions:
            rows = casadi.vertcat(*[self.expression(name, index) for name, index in keys])
            self._functions[keys] = casadi.Function(
                "components", list(self.inputs), [casadi.densify(rows)]
            )
        return self._functions[keys]

    def __call__(self, keys: tuple[tuple[str, Any], ...], *inputs: FloatArray) -> FloatArray:
        """Evaluate components of the model at n points in time, shape (n, n_keys).

        The `keys` are those of the method `function`. Each of the five `inputs` has one row per
        point.
        """
        return MappedFunction(self.function(keys), inputs[0].shape[0])(*inputs)[0]


def _unpacked(kept: Packed) -> Evaluator:
    """Return the evaluator that a pickle contains; the inverse of `Evaluator.__reduce__`."""
    inputs, written = kept.unpacked()
    return Evaluator(inputs, WrittenComponents(written))


_NEWTON_STEPS = 50
_NEWTON_TOLERANCE = 1e-13


class OutputStates:
    """Solver for the output states, which affect neither the objective nor other equations.

    An example is an energy that is only reported. The nonlinear program leaves output states out.
    After its solution, Newton's method computes them from their own collocation equations.
    """

    def __init__(self, compiled: CompiledModel) -> None:
        declared = compiled.declared
        path_variables, path_data = compiled.symbols
        self._slots = declared.outputs
        rates = stacked([s.rate for s in self._slots])
        states = stacked([s.symbol for s in self._slots])
        rows = stacked([e.expression for e in declared.output_equations])
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
        """Return the number of output states, on which neither objective nor equations depend."""
        return len(self._slots)

    @staticmethod
    def _start_function(declared: Declarations) -> Any:
        """Return the CasADi function from parameters to initial values of the output states.

        A value is NaN if no condition at the start of the horizon determines it.
        """
        parameters = stacked([s.symbol for s in declared.parameters])
        values = []
        for slot in declared.outputs:
            found = casadi.SX(np.nan)
            # The value of o[1] at time 0 has the symbol o[1,0].
            begun = indexed_name(slot.component, (*slot.index, "")).removesuffix("]")
            for condition in declared.output_starts:
                for symbol in casadi.symvar(condition.expression):
                    if symbol.name().startswith(begun):
                        slope = casadi.jacobian(condition.expression, symbol)
                        offset = casadi.substitute(condition.expression, symbol, casadi.SX(0))
                        found = (condition.lower - offset) / slope
            values.append(found)
        return casadi.Function("output_starts", [parameters], [stacked(values)])

    def start(self, parameters: FloatArray, fixed: dict[tuple[str, float], float]) -> FloatArray:
        """Return the initial values of the output states, shape (n_outputs,).

        `fixed` has values of variables by (name, fraction of the horizon). A fixed value takes
        precedence over an initial condition.
        """
        held = np.asarray(self._starts(parameters)).ravel()
        return np.array(
            [fixed.get((s.name, 0.0), held[k]) for k, s in enumerate(self._slots)], dtype=float
        )

    def solve(
        self, layout: Layout, start: FloatArray, path_variables: FloatArray, data: FloatArray
    ) -> FloatArray:
        """Solve the collocation equations of the output states by Newton's method.

        The result, shape (n_points + 1, n_outputs), begins with `start`. `path_variables` and
        `data` are the inputs of `CompiledModel.path`, with one row per collocation point.

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
        """Return a block-diagonal sparse matrix with an n x n block per collocation point.

        A row of `values` has the entries of one block, column by column as CasADi stores them.
        """
        matrices = values.reshape(-1, n, n).transpose(0, 2, 1)
        count = len(matrices)
        return bsr_matrix((matrices, np.arange(count), np.arange(count + 1))).tocsr()


_CACHED_MESHES = 4
# Fractions of the horizon at which a limit is evaluated to find out whether it varies with time.
_LOOKED_AT = (0.0, 0.2718, 0.5772, 1.0)


class Formulation:
    """Pyomo.DAE model translated to CasADi functions, with its data and its nonlinear programs.

    Base class of `Problem`, which documents the arguments and the accepted declarations. Each mesh
    has its own nonlinear program. The nonlinear programs of the last four meshes are cached.
    """

    def __init__(
        self,
        model: Any,
        final_time: Any = None,
        times: FreeTimes | None = None,
    ) -> None:
        self._hold(*_compiled(model, *read_declarations(model, final_time, times)))

    @classmethod
    def of(cls, model: Any, declared: Declarations, reader: ModelReader) -> Self:
        """Compile a model whose declarations have been read already, and return its formulation.

        `reader` has read the declarations `declared` from the Pyomo model.
        """
        formulation = object.__new__(cls)
        formulation._hold(*_compiled(model, declared, reader))
        return formulation

    def _hold(
        self, compiled: CompiledModel, source: LiveModel | ModelSnapshot, evaluator: Evaluator
    ) -> None:
        """Set all attributes of the formulation; `source` has the data of the Pyomo model."""
        self.compiled = compiled
        self.source = source
        self.evaluator = evaluator
        self.values = ModelValues(source, compiled.declared)
        self.outputs = OutputStates(compiled)
        self._programs: dict[Mesh | None, Transcription] = {}

    def __reduce__(self) -> tuple[Any, ...]:
        """Return the recipe by which `pickle` stores this formulation, without the Pyomo model."""
        return _restored, (type(self), self.compiled, self.values.snapshot(), self.evaluator)

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        """Return a copy of the formulation together with a copy of its Pyomo model."""
        # `deepcopy` finds in `memo` the objects that it has copied already.
        memo[id(self)] = other = object.__new__(type(self))
        vars(other).update(deepcopy(vars(self), memo))
        return other

    def holding(self, model: Any) -> Self:
        """Return a formulation with the same compiled equations and the data of another model.

        Nothing is compiled. The other model must have the same declarations. Three things may
        differ: the values of parameters, the values of variables (the initial guess), and the
        suffix `scaling_factor`.
        """
        other = object.__new__(type(self))
        vars(other).update(vars(self))
        other.source = self.source.of(model)
        other.compiled = self.compiled.scaled(declared_magnitudes(model))
        other.values = ModelValues(other.source, other.compiled.declared)
        other._programs = self._programs if other.compiled is self.compiled else {}
        return other

    @property
    def model(self) -> Any:
        """Pyomo model of the formulation.

        Raises
        ------
        TranscriptionError
            If this formulation was restored from a pickle, which does not contain the model.
        """
        return self.source.model

    @property
    def has_horizon(self) -> bool:
        """Whether the model has a continuous set, and therefore variables over time."""
        return self.compiled.declared.has_horizon

    def required_breakpoints(self, instance: Instance) -> tuple[float, ...]:
        """Return the fractions of the horizon at which an element of every mesh must end.

        The fractions lie between 0 and 1, in increasing order. They belong to constraints at single
        times, fixed variables, and jumps of time-dependent parameters in `instance`.
        """
        declared = self.compiled.declared
        fractions = {p.fraction for p in declared.point_symbols} | {f for _, f in declared.fixed}
        return tuple(sorted(f for f in fractions.union(instance.jumps) if 0.0 < f < 1.0))

    def instance(
        self, parameters: Overrides | None = None, horizon: tuple[float, float] | None = None
    ) -> Instance:
        """Collect the data of a single solve: parameter values, horizon and fixed variables.

        `parameters` has new values by component or full name. The default `horizon` is the range of
        the continuous set.

        Raises
        ------
        TranscriptionError
            If the horizon is not increasing, or a parameter is unknown or has no value.
        """
        if horizon is not None and not horizon[1] > horizon[0]:
            raise TranscriptionError(
                f"horizon: end {horizon[1]:g} is not after start {horizon[0]:g}."
            )
        return Instance(
            parameters=self.values.parameters(parameters, horizon),
            horizon=horizon or self.values.declared_horizon,
            fixed=self.values.fixed(),
            overrides=self.values.by_name(parameters),
            jumps=self.values.jumps(parameters, horizon),
        )

    def signals(self, instance: Instance, fractions: FloatArray) -> FloatArray:
        """Return the time-dependent data of the equations, one row for each of `fractions`.

        The columns are the fraction, the time-dependent parameters, and the quantities of
        `Declarations.scheduled`.
        """
        if not self.compiled.declared.has_signals:
            return fractions[:, None]
        at = self.values.signals(instance)
        return np.array([[fraction, *at(fraction)] for fraction in fractions.tolist()])

    def data_of(self, instance: Instance, fractions: FloatArray) -> Data:
        """Return the values of all parameters in the equations, at fractions of the horizon.

        The result holds the constant parameters and, for each fraction, the time-dependent
        parameters. `instance` is the data of one solve.
        """
        return Data(parameters=instance.parameters, signals=self.signals(instance, fractions))

    def data_at_starts(self, instance: Instance) -> FloatArray:
        """Return the values of all parameters at the start of the horizon and just after each jump.

        The shape is (1 + n_jumps, n_data). The columns are the fraction of the horizon, the
        time-dependent and the constant parameters.
        """
        after = np.array(instance.jumps) + 2.0 * BESIDE
        return self.data_of(instance, np.concatenate([np.zeros(1), after])).at_points()

    def program(self, mesh: Mesh | None, instance: Instance) -> Transcription:
        """Return the nonlinear program on a mesh, with the data of one solve.

        `mesh` is None for a model without time. `instance` holds parameter values, horizon and
        fixed variables. The structure of the program is cached for the last four meshes.
        """
        data = self.data_of(instance, mesh.point_fractions if mesh else np.zeros(0))
        if mesh not in self._programs:
            if len(self._programs) >= _CACHED_MESHES:
                self._programs.pop(next(iter(self._programs)))
            self._programs[mesh] = Transcription(self.compiled, mesh, data)
        return self._programs[mesh].with_data(data)

    def timeline(self, statics: FloatArray, instance: Instance) -> Timeline:
        """Return the piecewise linear mapping between fractions of the horizon and physical time.

        `statics` are the values of the static variables, some of which may be free times. A start
        or end of the horizon that is not free has its value from `instance`.
        """
        times = np.array(self.compiled.times(statics, instance.parameters)).ravel()
        return Timeline(fractions=np.array(self.compiled.declared.clock.fractions), times=times)

    def algebraic_limits(self, instance: Instance) -> tuple[FloatArray, FloatArray]:
        """Return lower and upper limits of the algebraic variables, shape (n_algebraics,) each.

        A limit is infinite if none is declared, or if its values at four sampled times differ.
        `instance` holds the parameter values on which the limits depend.
        """
        compiled, first = self.compiled, len(self.compiled.declared.states)
        data = self.data_of(instance, np.array(_LOOKED_AT)).at_points()
        lower, upper = MappedFunction(compiled.limits_over_time, len(data))(data)

        def constant(side: FloatArray, tightest: np.ufunc, none: float) -> FloatArray:
            limits = np.full((first + len(compiled.declared.algebraics), len(data)), none)
            tightest.at(limits, compiled.limited, side.T)
            return np.where(np.all(limits[:, 0] == limits.T, axis=0), limits[:, 0], none)[first:]

        return constant(lower, np.maximum, -np.inf), constant(upper, np.minimum, np.inf)


def _compiled(
    model: Any, declared: Declarations, reader: ModelReader
) -> tuple[CompiledModel, LiveModel, Evaluator]:
    """Translate a model to its compiled equations, the source of its data, and its evaluator.

    Raises
    ------
    TranscriptionError
        If the equations are a DAE of index above 2.
    """
    refuse_high_index(declared)
    compiled = compile_declarations(declared)
    time = reader.copy.time
    own_time = None if time is None else model.find_component(time.name)
    source = LiveModel(model, own_time, tuple(reader.writer.schedules))
    return compiled, source, Evaluator.of(compiled, reader.writer)


def _restored(
    kind: type[Formulation],
    compiled: CompiledModel,
    source: ModelSnapshot,
    evaluator: Evaluator,
) -> Formulation:
    """Return the formulation that a pickle contains; the inverse of `Formulation.__reduce__`."""
    formulation = object.__new__(kind)
    formulation._hold(compiled, source, evaluator)
    return formulation


# Highest index that is solved as declared; at index 2, an equation among states determines a
# control.
_HIGHEST = 2
_ABSENT = -1e6
_ORDERS = {2: "second", 3: "third", 4: "fourth", 5: "fifth"}


@dataclass(frozen=True, kw_only=True)
class StructuralIndex:
    """Structural index of a DAE, and how often each of its equations must be differentiated.

    Attributes
    ----------
    index : int
        Structural index: the number of times by which the equations must be differentiated to
        obtain an ODE; 0 for an ODE.
    differentiated : dict
        Name of an equation -> number of differentiations with respect to time. Equations that need
        no differentiation are left out.
    """

    index: int
    differentiated: dict[str, int]


def structural_index(declared: Declarations) -> StructuralIndex:
    """Return the structural index of the equations over time, by Pryce's signature matrix.

    It is 0 for an ODE. It is also 0 if no assignment gives each equation a different variable that
    occurs in the equation.

    Source: Pryce (2001), BIT Numerical Mathematics 41, 364-394.
    """
    equations = [e for e in declared.equations if e.is_equality]
    # Controls count as unknowns, like all algebraic variables. An equation among states alone
    # raises the index, even if controls influence these states through other equations.
    names = [s.name for s in (*declared.states, *declared.algebraics)]
    rates = {s.rate.name(): s.name for s in declared.states}
    orders = np.full((len(equations), len(names)), _ABSENT)
    for i, equation in enumerate(equations):
        held = symbol_names(equation.expression)
        for j, name in enumerate(names):
            orders[i, j] = 0.0 if name in held else _ABSENT
        for rate in held & rates.keys():
            orders[i, names.index(rates[rate])] = 1.0
    if not equations or len(equations) > len(names):
        return StructuralIndex(index=0, differentiated={})
    rows, columns = linear_sum_assignment(orders, maximize=True)
    # No assignment gives each equation a different variable that occurs in it.
    if np.any(orders[rows, columns] == _ABSENT):
        return StructuralIndex(index=0, differentiated={})
    counts = np.zeros(len(equations))
    for _ in range(len(equations) + 1):
        highest = np.max(orders + counts[:, None], axis=0)
        counts[rows] = highest[columns] - orders[rows, columns]
    found = dict(zip((e.name for e in equations), counts.astype(int).tolist(), strict=True))
    # A variable is algebraic if no equation determines a derivative of it; the index of a DAE is 1
    # larger than the largest number of differentiations.
    is_dae = bool(np.any(highest == 0.0))
    return StructuralIndex(
        index=int(counts.max()) + is_dae,
        differentiated={name: count for name, count in found.items() if count},
    )


def refuse_high_index(declared: Declarations) -> None:
    """Raise an error for a DAE of index above 2, which collocation cannot solve as declared.

    Raises
    ------
    TranscriptionError
        If the index is above 2. The message names an equation and how often to differentiate it.
    """
    found = structural_index(declared)
    if found.index <= _HIGHEST:
        return
    name = max(found.differentiated, key=lambda key: found.differentiated[key])
    count = found.differentiated[name]
    raise TranscriptionError(
        f"{name}: makes the model a DAE of index {found.index}; at most {_HIGHEST} is supported. "
        f"Write its {_ORDERS.get(count, f'{count}th')} time derivative in its place, with the "
        "rates that the other equations give, and impose the equation itself and its lower "
        "derivatives as conditions at the start."
    )
