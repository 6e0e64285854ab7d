"""The continuous model as CasADi functions of one collocation point, mapped over many."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from hashlib import sha256
from typing import TYPE_CHECKING, Any

import casadi
import numpy as np
from numpy.typing import NDArray

from pyomo_quad.collocation.packing import Packed, packed
from pyomo_quad.collocation.reading.symbols import Declarations, PathEquation, PointCondition, Slot
from pyomo_quad.collocation.reading.writer import is_unbounded, symbol_names

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from pyomo_quad.collocation.mesh import FloatArray
    from pyomo_quad.collocation.reading.tables import TableUse

# Points evaluated in one call of CasADi; a larger map takes more time and memory to set up.
_CHUNK = 512


class MappedFunction:
    """One function of one point, evaluated at `n` points without copying.

    Parameters
    ----------
    function : casadi.Function
        Dense column inputs, dense column outputs.
    n : int
        Number of points.
    n_shared : int, optional
        Number of inputs, the first ones, that are the same at all points.
    """

    def __init__(self, function: Any, n: int, n_shared: int = 0) -> None:
        self._arguments = function, n, n_shared
        self._shapes = [(n, function.numel_out(k)) for k in range(function.n_out())]
        self._chunks: list[tuple[slice, Any, Any]] = []
        made: dict[int, Any] = {}
        for start in range(0, n, _CHUNK):
            size = min(_CHUNK, n - start)
            if size not in made:
                shared = list(range(n_shared))
                mapped = (
                    function.map("mapped", "serial", size, shared, [])
                    if n_shared
                    else function.map(size)
                )
                made[size] = (function if size == 1 else mapped).buffer()
            self._chunks.append((slice(start, start + size), *made[size]))

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle without the buffers, which each copy allocates anew."""
        return type(self), self._arguments

    def __call__(self, *inputs: FloatArray) -> list[FloatArray]:
        """Return each output as an array of shape (n, rows).

        Inputs are (n, columns), shared ones (columns,).
        """
        outputs = [np.zeros(shape) for shape in self._shapes]
        held = [np.ascontiguousarray(array, dtype=float) for array in inputs]
        n_shared = self._arguments[2]
        for chosen, buffer, trigger in self._chunks:
            for k, array in enumerate(held):
                if array.size:
                    buffer.set_arg(k, (array if k < n_shared else array[chosen]).data)
            for k, array in enumerate(outputs):
                if array.size:
                    buffer.set_res(k, array[chosen].data)
            trigger()
        return outputs


def set_outputs_aside(declared: Declarations) -> Declarations:
    """Separate output states and their equations from the declarations.

    A state is an output if its symbol and rate appear in one equality only, it has no bounds, and
    it is fixed at the start and nowhere else. Repetition finds outputs that feed other outputs
    only.
    """
    while True:
        found = _one_output(declared)
        if found is None:
            return declared
        slot, equation = found
        start = tuple(
            c for c in declared.conditions if _names_at(declared, slot) & symbol_names(c.expression)
        )
        declared = replace(
            declared,
            states=tuple(s for s in declared.states if s is not slot),
            equations=tuple(e for e in declared.equations if e is not equation),
            conditions=tuple(c for c in declared.conditions if c not in start),
            point_symbols=tuple(p for p in declared.point_symbols if p.slot != slot.name),
            outputs=(slot, *declared.outputs),
            output_equations=(equation, *declared.output_equations),
            output_starts=(*start, *declared.output_starts),
        )


def _names_at(declared: Declarations, slot: Slot) -> frozenset[str]:
    return frozenset(p.symbol.name() for p in declared.point_symbols if p.slot == slot.name)


def _one_output(declared: Declarations) -> tuple[Slot, PathEquation] | None:
    uses = Counter[str]()
    for equation in declared.equations:
        uses.update(
            symbol_names(casadi.vertcat(equation.expression, equation.lower, equation.upper))
        )
    elsewhere = symbol_names(
        casadi.vertcat(declared.objective, *[i.integrand for i in declared.integrals])
    )
    for slot in declared.states:
        if uses[slot.rate.name()] != 1 or slot.name in elsewhere or slot.rate.name() in elsewhere:
            continue
        equation = next(
            e for e in declared.equations if slot.rate.name() in symbol_names(e.expression)
        )
        inside = slot.name in symbol_names(equation.expression)
        only_here = uses[slot.name] == int(inside)
        rates = [s.rate.name() for s in declared.states]
        one_rate = len(symbol_names(equation.expression) & set(rates)) == 1
        if (
            only_here
            and one_rate
            and equation.is_equality
            and is_unbounded(slot.lower, slot.upper)
            and _held_at_start_only(declared, slot)
        ):
            return slot, equation
    return None


def _held_at_start_only(declared: Declarations, slot: Slot) -> bool:
    """Return whether conditions fix a variable at the start and appear nowhere else."""
    names = _names_at(declared, slot)
    if names & symbol_names(declared.objective):
        return False
    points = [p for p in declared.point_symbols if p.slot == slot.name]
    if any(p.fraction != 0.0 or p.is_rate for p in points):
        return False
    fixed_at = {fraction for name, fraction in declared.fixed if name == slot.name}
    if not (points or fixed_at) or fixed_at - {0.0}:
        return False
    everything = {p.symbol.name() for p in declared.point_symbols} | {
        s.name for s in declared.statics
    }
    return all(
        symbol_names(c.expression) & everything <= names
        for c in declared.conditions
        if symbol_names(c.expression) & names
    )


@dataclass(frozen=True, kw_only=True)
class SimpleBound:
    """Limits of one variable, named `variable`; `slope` is its factor in the relation."""

    name: str
    variable: str
    slope: float
    lower: Any
    upper: Any


def _own_limits(slot: Slot) -> SimpleBound:
    """Return the declared bounds of a variable."""
    return SimpleBound(
        name=slot.name, variable=slot.name, slope=1.0, lower=slot.lower, upper=slot.upper
    )


def split_simple_bounds(
    relations: tuple[Any, ...], variables: dict[str, Any], candidates: frozenset[str]
) -> tuple[tuple[Any, ...], tuple[SimpleBound, ...]]:
    """Separate the relations that are bounds on one candidate variable from the rest.

    Parameters
    ----------
    relations : tuple of PathEquation or PointCondition
    variables : dict
        Every variable symbol by name; anything else in a relation is a parameter.
    candidates : frozenset of str
        Variables that may be bounded in the nonlinear program.
    """
    others, bounds = [], []
    for relation in relations:
        bound = _as_simple_bound(relation, variables, candidates)
        if bound is None:
            others.append(relation)
        else:
            bounds.append(bound)
    return tuple(others), tuple(bounds)


def _as_simple_bound(
    relation: PathEquation | PointCondition, variables: dict[str, Any], candidates: frozenset[str]
) -> SimpleBound | None:
    if isinstance(relation, PathEquation) and relation.is_equality:
        return None
    held = symbol_names(relation.expression) & set(variables)
    if len(held) != 1 or not held <= candidates:
        return None
    (name,) = held
    symbol = variables[name]
    coefficient = casadi.simplify(casadi.jacobian(relation.expression, symbol))
    if not coefficient.is_constant() or coefficient.is_zero():
        return None
    offset = casadi.substitute(relation.expression, symbol, casadi.SX(0))
    sides = [(side - offset) / coefficient for side in (relation.lower, relation.upper)]
    lower, upper = sides if float(coefficient) > 0.0 else reversed(sides)
    slope = float(coefficient)
    return SimpleBound(name=relation.name, variable=name, slope=slope, lower=lower, upper=upper)


IndexArray = NDArray[np.intp]


@dataclass(frozen=True, kw_only=True)
class DerivedFunctions:
    """A vector function with its exact sparse Jacobian and the Hessian of a weighted sum.

    `values`, `jacobian` take (variables, data); `hessian` takes (variables, data, weights).
    `jacobian` and `hessian` return nonzeros only, for the rows and columns listed; the
    Hessian's are those of its lower triangle.
    """

    values: Any
    jacobian: Any
    hessian: Any
    jacobian_rows: IndexArray
    jacobian_columns: IndexArray
    hessian_rows: IndexArray
    hessian_columns: IndexArray


@dataclass(frozen=True, kw_only=True)
class TableArguments:
    """Arguments of tables in path equations and in conditions, and functions that evaluate them."""

    over_time: tuple[TableUse, ...]
    path: Any
    in_conditions: tuple[TableUse, ...]
    points: Any


@dataclass(frozen=True, kw_only=True)
class CompiledModel:
    """Functions of one point, functions of the conditions, and the meaning of their entries."""

    declared: Declarations
    path: DerivedFunctions
    points: DerivedFunctions
    path_bounds: Any
    limits: tuple[SimpleBound, ...]
    """Limits over time of one variable each: those of each variable, then simple bounds."""
    limits_over_time: Any
    simple_point_bounds: tuple[SimpleBound, ...]
    simple_point_limits: Any
    condition_limits: Any
    static_limits: Any
    times: Any
    row_integrals: tuple[int, ...]
    symbols: tuple[Any, Any]
    tables: TableArguments
    fingerprint: str
    """Hash of the equations' code and names, which does not depend on parameter values."""
    static_of_integral: dict[int, int] = field(default_factory=dict)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle all expressions as one text, because they share symbols."""
        parts = {item.name: getattr(self, item.name) for item in fields(self)}
        return _unpacked, (packed(parts),)

    def __deepcopy__(self, memo: dict[int, Any]) -> CompiledModel:
        """Return the model itself, which is immutable."""
        return self

    def scaled(self, magnitudes: Mapping[str, float]) -> CompiledModel:
        """Return the model with other magnitudes of its variables, by slot or component name."""
        d = self.declared
        kinds = (d.states, d.algebraics, d.statics)
        states, algebraics, statics = (
            tuple(s.scaled(magnitudes) for s in slots) for slots in kinds
        )
        declared = replace(d, states=states, algebraics=algebraics, statics=statics)
        was, now = (
            [s.nominal for s in (*of.states, *of.algebraics, *of.statics)] for of in (d, declared)
        )
        return self if was == now else replace(self, declared=declared)

    @property
    def n_equations(self) -> int:
        """Number of path equations at each point."""
        return len(self.declared.equations)

    @cached_property
    def limited(self) -> IndexArray:
        """Position of the variable of each limit over time: states, then algebraic variables."""
        names = [s.name for s in (*self.declared.states, *self.declared.algebraics)]
        return np.array([names.index(limit.variable) for limit in self.limits], dtype=np.intp)

    @property
    def is_equality(self) -> NDArray[np.bool_]:
        """Whether each path equation is an equality (else an inequality), shape (n_equations,)."""
        return np.array([e.is_equality for e in self.declared.equations], dtype=bool)


def _unpacked(parts: Packed) -> CompiledModel:
    return CompiledModel(**parts.unpacked())


def compile_declarations(declared: Declarations) -> CompiledModel:
    """Compile declarations to CasADi functions."""
    if symbol_names(declared.objective) & _point_symbols(declared).keys():
        declared = set_outputs_aside(declared)
    declared = _with_integral_variables(with_moving_limits(declared))
    path_variables = _path_symbols(declared)
    point_variables = _point_symbols(declared)
    equations, path_simple = split_simple_bounds(
        declared.equations,
        path_variables,
        frozenset(s.name for s in (*declared.states, *declared.algebraics)),
    )
    conditions, point_simple = split_simple_bounds(
        declared.conditions, point_variables, _boundable_at_points(declared)
    )
    declared = replace(declared, equations=equations, conditions=conditions)
    limits = (*map(_own_limits, (*declared.states, *declared.algebraics)), *path_simple)
    path_data = casadi.vertcat(*declared.path_data)
    parameters = _symbols(declared.parameters)
    integrals = [integral.name for integral in declared.integrals]
    direct = tuple(k for k, name in enumerate(integrals) if not _is_static(declared, name))
    rows = [e.expression for e in equations] + [i.integrand for i in declared.integrals]
    point_rows = [c.expression for c in conditions] + [declared.objective]
    path = stacked(rows), stacked(path_variables.values()), path_data
    points = stacked(point_rows), stacked(point_variables.values()), parameters
    # Before there are derivatives: CasADi keeps those of a spline in it, and serialises them.
    fingerprint = _fingerprint(declared, [_values("path", *path), _values("points", *points)])
    return CompiledModel(
        declared=declared,
        path=_derive("path", *path),
        points=_derive("points", *points),
        fingerprint=fingerprint,
        path_bounds=_limits("path_bounds", path_data, equations),
        limits=limits,
        limits_over_time=_limits("limits_over_time", path_data, limits),
        simple_point_bounds=point_simple,
        simple_point_limits=_limits("point_limits", parameters, point_simple),
        condition_limits=_limits("condition_limits", parameters, conditions),
        static_limits=_limits("static_limits", parameters, declared.statics),
        times=_times(declared, parameters),
        row_integrals=direct,
        symbols=(stacked(path_variables.values()), path_data),
        tables=_table_arguments(declared, path_variables, point_variables),
        static_of_integral={
            k: [s.name for s in declared.statics].index(name)
            for k, name in enumerate(integrals)
            if k not in direct
        },
    )


def _times(declared: Declarations, parameters: Any) -> Any:
    inputs = [_symbols(declared.statics), parameters]
    return casadi.Function("times", inputs, [stacked(declared.clock.times)])


def with_moving_limits(declared: Declarations) -> Declarations:
    """Rewrite limits that depend on static variables as relations with constant sides.

    A free time makes the time in a rule such as `m.x[t] <= t` depend on static variables, but the
    sides of a relation and the bounds of a variable may depend on data alone.
    """
    statics = symbol_names(_symbols(declared.statics))

    def moves(side: Any) -> bool:
        return not statics.isdisjoint(symbol_names(side))

    def without_moving(slots: tuple[Slot, ...]) -> tuple[Slot, ...]:
        none = casadi.SX(casadi.inf)
        return tuple(
            replace(s, lower=-none, upper=none) if moves(s.lower) or moves(s.upper) else s
            for s in slots
        )

    bounds = [
        PathEquation(
            name=s.name, expression=s.symbol, lower=s.lower, upper=s.upper, is_equality=False
        )
        for s in (*declared.states, *declared.algebraics)
        if moves(s.lower) or moves(s.upper)
    ]
    relations = (*declared.equations, *bounds)
    return replace(
        declared,
        equations=tuple(part for held in relations for part in _with_fixed_sides(held, moves)),
        states=without_moving(declared.states),
        algebraics=without_moving(declared.algebraics),
    )


def _with_fixed_sides(equation: PathEquation, moves: Callable[[Any], bool]) -> list[PathEquation]:
    """Return relations whose sides depend on data alone; each moving side becomes a relation."""
    below, above = moves(equation.lower), moves(equation.upper)
    if not (below or above):
        return [equation]
    body, none = equation.expression, casadi.SX(casadi.inf)
    found = []
    if below:
        side, unbounded = _moving_side(equation.lower)
        found.append(
            replace(equation, expression=body - side, lower=_unless(unbounded, -none), upper=none)
        )
    if above:
        side, unbounded = _moving_side(equation.upper)
        found.append(
            replace(equation, expression=body - side, lower=-none, upper=_unless(unbounded, none))
        )
    rest = replace(
        equation,
        lower=-none if below else equation.lower,
        upper=none if above else equation.upper,
    )
    return found if is_unbounded(rest.lower, rest.upper) else [*found, rest]


def _unless(unbounded: Any, none: Any) -> Any:
    """Return a side of zero, or ``none`` where there is no limit."""
    zero = casadi.SX(0)
    return zero if unbounded.is_zero() else casadi.if_else(unbounded, none, zero)


def _moving_side(side: Any) -> tuple[Any, Any]:
    """Return a side of a limit (zero where it is absent), and whether it is absent.

    A rule that skips a limit on a part of the horizon has an infinite side there: a sum of
    alternatives, each of which is zero where another alternative holds.
    """
    zero = casadi.SX(0)
    if side.is_constant():
        is_infinite = math.isinf(float(side))
        return (zero, casadi.SX(1)) if is_infinite else (side, zero)
    if side.op() == casadi.OP_IF_ELSE_ZERO:
        kept, unbounded = _moving_side(side.dep(1))
        holds = side.dep(0)
        return casadi.if_else(holds, kept, zero), casadi.if_else(holds, unbounded, zero)
    if side.op() == casadi.OP_ADD:
        (first, no_first), (second, no_second) = (_moving_side(side.dep(k)) for k in range(2))
        return first + second, no_first + no_second
    return side, zero


def _table_arguments(
    declared: Declarations, path_variables: dict[str, Any], point_variables: dict[str, Any]
) -> TableArguments:
    parameters = _symbols(declared.parameters)
    made: list[Any] = []
    for variables, data in (
        (path_variables, casadi.vertcat(*declared.path_data)),
        (point_variables, parameters),
    ):
        symbols = stacked(variables.values())
        known = symbol_names(casadi.vertcat(symbols, data))
        # An argument in an equation that was dropped holds symbols that no function has; skip it.
        uses = tuple(u for u in declared.table_uses if symbol_names(u.expression) <= known)
        rows = stacked([u.expression for u in uses])
        made += [uses, casadi.Function("table_arguments", [symbols, data], [rows])]
    return TableArguments(over_time=made[0], path=made[1], in_conditions=made[2], points=made[3])


def _fingerprint(declared: Declarations, functions: list[Any]) -> str:
    d = declared
    names = ["maximise" if d.maximise else "minimise", *(e.name for e in d.equations)]
    names += [slot.name for slot in (*d.states, *d.algebraics, *d.statics)]
    code = [_anonymous(function) for function in functions]
    return sha256("\n".join([*code, *names]).encode()).hexdigest()


def _values(name: str, rows: Any, variables: Any, data: Any) -> Any:
    return casadi.Function(name, [variables, data], [casadi.densify(rows)])


def _anonymous(function: Any) -> str:
    """Return the code of a function with anonymous symbols, whose names depend on time."""
    symbols = [casadi.SX.sym(f"i{k}", function.size1_in(k)) for k in range(function.n_in())]
    return str(casadi.Function("f", symbols, function.call(symbols)).serialize())


def _limits(name: str, data: Any, items: tuple[Any, ...]) -> Any:
    """Return the function of both sides of relations, bounds or variables."""
    sides = [stacked([i.lower for i in items]), stacked([i.upper for i in items])]
    return casadi.Function(name, [data], sides)


def stacked(expressions: Any) -> Any:
    """Return expressions as a column, which may be empty."""
    return casadi.vertcat(casadi.SX(0, 1), *[casadi.SX(e) for e in expressions])


def _symbols(slots: tuple[Slot, ...]) -> Any:
    return stacked([s.symbol for s in slots])


def _path_symbols(declared: Declarations) -> dict[str, Any]:
    """Return the variables of a point by name, in the order of the point's vector."""
    symbols = {s.rate.name(): s.rate for s in declared.states}
    for slots in (declared.states, declared.algebraics, declared.statics):
        symbols |= {s.symbol.name(): s.symbol for s in slots}
    return symbols


def _point_symbols(declared: Declarations) -> dict[str, Any]:
    """Return the variables of the conditions and the objective by name, in order."""
    symbols = {p.symbol.name(): p.symbol for p in declared.point_symbols}
    symbols |= {s.symbol.name(): s.symbol for s in declared.statics}
    return symbols | {
        i.symbol.name(): i.symbol for i in declared.integrals if not _is_static(declared, i.name)
    }


def _boundable_at_points(declared: Declarations) -> frozenset[str]:
    states = {s.name for s in declared.states}
    at_points = {
        p.symbol.name() for p in declared.point_symbols if p.slot in states and not p.is_rate
    }
    return frozenset(at_points | {s.symbol.name() for s in declared.statics})


def _is_static(declared: Declarations, name: str) -> bool:
    return any(s.name == name for s in declared.statics)


def _with_integral_variables(declared: Declarations) -> Declarations:
    """Add a static variable for each integral that does not enter the objective linearly.

    Its defining equation is one dense row; an objective that is linear in its integrals needs none.
    """
    in_conditions = symbol_names(stacked([c.expression for c in declared.conditions]))
    variables = symbol_names(
        stacked([p.symbol for p in declared.point_symbols] + [s.symbol for s in declared.statics])
    ) | {i.symbol.name() for i in declared.integrals}
    statics = list(declared.statics)
    for integral in declared.integrals:
        slope = casadi.jacobian(casadi.SX(declared.objective), integral.symbol)
        if _is_static(declared, integral.name):
            continue
        if integral.symbol.name() in in_conditions or symbol_names(slope) & variables:
            statics.append(integral.slot)
    return replace(declared, statics=tuple(statics))


def _derive(name: str, rows: Any, variables: Any, data: Any) -> DerivedFunctions:
    jacobian = casadi.jacobian(rows, variables)
    weights = casadi.SX.sym("weights", rows.shape[0])
    hessian = casadi.tril(casadi.hessian(casadi.dot(weights, rows), variables)[0])
    j_rows, j_columns = jacobian.sparsity().get_triplet()
    h_rows, h_columns = hessian.sparsity().get_triplet()
    return DerivedFunctions(
        values=_values(name, rows, variables, data),
        jacobian=casadi.Function(f"{name}_jacobian", [variables, data], [_nonzeros(jacobian)]),
        hessian=casadi.Function(
            f"{name}_hessian", [variables, data, weights], [_nonzeros(hessian)]
        ),
        jacobian_rows=np.asarray(j_rows, dtype=np.intp),
        jacobian_columns=np.asarray(j_columns, dtype=np.intp),
        hessian_rows=np.asarray(h_rows, dtype=np.intp),
        hessian_columns=np.asarray(h_columns, dtype=np.intp),
    )


def _nonzeros(matrix: Any) -> Any:
    return casadi.vertcat(casadi.SX(0, 1), *matrix.nonzeros())
