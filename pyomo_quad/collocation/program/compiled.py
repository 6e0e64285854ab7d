"""CasADi functions of a model at a single collocation point, before discretisation.

The functions are compiled once per model, independently of the mesh. CasADi's method `map`
evaluates them at all collocation points.

Static variables are variables without time. A condition is a constraint among values at declared
times (members of the continuous set), static variables and integrals. A static variable replaces
each integral that enters a condition, a nonlinear term of the objective, or the coupling of several
horizons. An added constraint makes it equal to the integral. All other integrals enter only the
objective, linearly.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field, fields, replace
from functools import cached_property, lru_cache
from hashlib import sha256
from typing import TYPE_CHECKING, Any

import casadi
import numpy as np
from numpy.typing import NDArray

from pyomo_quad.collocation.packing import Packed, packed
from pyomo_quad.collocation.program.shared_terms import WithoutCalls
from pyomo_quad.collocation.reading.symbols import Declarations, PathEquation, PointCondition, Slot
from pyomo_quad.collocation.reading.writer import is_unbounded, symbol_names

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from pyomo_quad.collocation.mesh import FloatArray
    from pyomo_quad.collocation.reading.tables import TableUse

# Points evaluated in one call of CasADi; a larger map takes more time and memory to set up.
_CHUNK = 512


# Mapped functions that are kept, because making one takes some milliseconds: as many as the
# simulations of one plan use in turn.
_MOST_MAPPED = 64


@lru_cache(maxsize=_MOST_MAPPED)
def _mapped(function: Any, size: int, n_shared: int) -> Any:
    """Return a CasADi function that evaluates `function` at `size` points, one column per point.

    The first `n_shared` inputs are the same at all points.
    """
    if size == 1:
        return function
    if n_shared:
        return function.map("mapped", "serial", size, list(range(n_shared)), [])
    return function.map(size)


class MappedFunction:
    """CasADi function of a single point, evaluated at many points without copying arrays.

    Parameters
    ----------
    function : casadi.Function
        Function whose inputs and outputs are dense column vectors.
    n : int
        Number of points.
    n_shared : int, optional
        Number of leading inputs that are the same at all points.
    """

    def __init__(self, function: Any, n: int, n_shared: int = 0) -> None:
        self._arguments = function, n, n_shared
        self._shapes = [(n, function.numel_out(k)) for k in range(function.n_out())]
        self._chunks: list[tuple[slice, Any, Any]] = []
        made: dict[int, Any] = {}
        for start in range(0, n, _CHUNK):
            size = min(_CHUNK, n - start)
            if size not in made:
                made[size] = _mapped(function, size, n_shared).buffer()
            self._chunks.append((slice(start, start + size), *made[size]))

    def __reduce__(self) -> tuple[Any, ...]:
        """Return the recipe by which `pickle` stores this function: class and arguments.

        The arguments are those of the constructor. The restored copy allocates its buffers anew.
        """
        return type(self), self._arguments

    def __call__(self, *inputs: FloatArray) -> list[FloatArray]:
        """Evaluate the function at all points; inputs and outputs have one row per point.

        Only the first `n_shared` inputs, which are the same at all points, have no such rows. Each
        of them has the shape of the function's input, (size,).
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
    """Return a copy of a model's declarations, in which the output states are set aside.

    An output state affects neither the objective nor other equations. Its equation and its initial
    condition are moved to the attributes `output_equations` and `output_starts`.
    """
    # The search is repeated, to find also states that affect only other output states.
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
    """Return the names of the symbols that stand for a variable's values at declared times.

    The symbol for the value of x at time 0.5 is named ``x[0.5]``, for example.
    """
    return frozenset(p.symbol.name() for p in declared.point_symbols if p.slot == slot.name)


def _one_output(declared: Declarations) -> tuple[Slot, PathEquation] | None:
    """Return an output state with its equation; None if the model has no output state.

    An output state affects neither the objective nor other equations, has no bounds, and is fixed
    at the start only.
    """
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
            and _is_fixed_at_start_only(declared, slot)
        ):
            return slot, equation
    return None


def _is_fixed_at_start_only(declared: Declarations, slot: Slot) -> bool:
    """Return whether a state has an initial condition or value, and no other condition.

    The result is False if the initial condition contains other variables, or if the objective
    contains the state's value at a declared time.
    """
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
    """Bounds of a single variable, declared with it or by a constraint on it alone.

    The constraint ``low <= a * x + b <= high`` on the variable x gives the bounds (low - b) / a and
    (high - b) / a, exchanged if a < 0.

    Attributes
    ----------
    name : str
        Name of the variable or constraint that declares the bounds.
    variable : str
        Name of the bounded variable's symbol.
    slope : float
        Coefficient a, to convert multipliers of bounds to duals of constraints. It is 1 for bounds
        declared with the variable.
    lower, upper : casadi.SX
        Bounds of the variable x itself, already divided by a. They are expressions of the
        parameters and, for a bound over time, of the fraction of the horizon.
    """

    name: str
    variable: str
    slope: float
    lower: Any
    upper: Any


def _own_limits(slot: Slot) -> SimpleBound:
    """Return the bounds declared with a Pyomo variable, as a `SimpleBound`.

    `slot` is the variable. Bounds that constraints impose on the variable are not included.
    """
    return SimpleBound(
        name=slot.name, variable=slot.name, slope=1.0, lower=slot.lower, upper=slot.upper
    )


def split_simple_bounds(
    relations: tuple[Any, ...], variables: dict[str, Any], candidates: frozenset[str]
) -> tuple[tuple[Any, ...], tuple[SimpleBound, ...]]:
    """Separate constraints that bound a single variable from all other constraints.

    The result is (other constraints, bounds). `variables` maps the names of all variables in the
    constraints to their CasADi symbols; all other symbols are parameters. `candidates` names the
    variables that may have bounds. Rates (time derivatives), for example, may not.
    """
    # Ipopt handles bounds of variables more efficiently than constraints.
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
    """Return a constraint on a single variable as a `SimpleBound`, otherwise None.

    `variables` maps names to CasADi symbols. The constraint must be linear in the variable, with a
    number as coefficient. The variable must be one of `candidates`. An equality over time gives
    None.
    """
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
    """CasADi functions of a vector of expressions, its sparse Jacobian, and a weighted Hessian.

    Derivatives are taken with respect to the variables. The data are the parameters and, for
    equations over time, the fraction of the horizon.

    Attributes
    ----------
    values : casadi.Function
        (variables, data) -> column of values.
    jacobian : casadi.Function
        (variables, data) -> nonzeros of the Jacobian.
    hessian : casadi.Function
        (variables, data, weights) -> nonzeros of the lower triangle of the Hessian of the scalar
        product weights . values.
    jacobian_rows, jacobian_columns, hessian_rows, hessian_columns : ndarray of int
        Row and column of each nonzero.
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
    """Arguments of the interpolation tables in a model, with functions for the arguments' values.

    The values show whether a solution evaluates a table outside the range of its data.

    Attributes
    ----------
    over_time, in_conditions : tuple of TableUse
        Arguments in equations over time, and in constraints at declared times.
    path : casadi.Function
        (variables, data of a collocation point) -> values of `over_time`.
    points : casadi.Function
        (variables in conditions, parameters) -> values of `in_conditions`.
    """

    over_time: tuple[TableUse, ...]
    path: Any
    in_conditions: tuple[TableUse, ...]
    points: Any


@dataclass(frozen=True, kw_only=True)
class CompiledModel:
    """Model as CasADi functions: equations at one collocation point, conditions and objective.

    The data of a point are the fraction of the horizon, the
    time-dependent and the constant parameters. Functions for bounds have two outputs: the lower and
    the upper bounds.

    Attributes
    ----------
    declared : Declarations
    path : DerivedFunctions
        Equations at each collocation point, then integrands. The inputs are (rates, states,
        algebraic and static variables; data). Rates are derivatives with respect to the fraction of
        the horizon.
    points : DerivedFunctions
        Conditions, then objective. The inputs are (values at declared times, static variables,
        integrals; parameters).
    path_bounds : casadi.Function
        Data -> bounds of the equations in `path`.
    limits : tuple of SimpleBound
        Bounds over time; each state and algebraic variable has an entry, even if infinite.
    limits_over_time : casadi.Function
        Data -> bounds in `limits`.
    simple_point_bounds : tuple of SimpleBound
        Bounds from conditions on a single state at a declared time, or on a single static variable.
        Neither `points` nor `condition_limits` contains these conditions.
    simple_point_limits : casadi.Function
        Parameters -> bounds in `simple_point_bounds`.
    condition_limits, static_limits : casadi.Function
        Parameters -> bounds of conditions, and of static variables.
    times : casadi.Function
        (static variables, parameters) -> physical times of start, free interior times, and end.
    row_integrals : tuple of int
        Positions of the integrals that no static variable replaces, in `Declarations.integrals`.
    symbols : (casadi.SX, casadi.SX)
        Symbols of variables and data of a point.
    tables : TableArguments
    static_of_integral : dict
        Position of an integral that is not in `row_integrals` -> position of the static variable
        that replaces it.
    """

    declared: Declarations
    path: DerivedFunctions
    points: DerivedFunctions
    path_bounds: Any
    limits: tuple[SimpleBound, ...]
    """Bounds that variables declare, then constraints over time on a single variable."""
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
        """Pickle the model, with all its CasADi expressions serialised into one text."""
        parts = {item.name: getattr(self, item.name) for item in fields(self)}
        # Expressions share symbols. They still do in the restored model, because all are serialised
        # together.
        return _unpacked, (packed(parts),)

    def __deepcopy__(self, memo: dict[int, Any]) -> CompiledModel:
        """Return the model itself, which is immutable."""
        return self

    def scaled(self, magnitudes: Mapping[str, float]) -> CompiledModel:
        """Return a copy of the model with given magnitudes of its variables, for the scaling.

        `magnitudes` maps names of variables, or of their Pyomo components, to magnitudes. All other
        variables lose their declared magnitude. If no magnitude changes, the result is the model
        itself.
        """
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
        """Number of path equations (equalities and inequalities) at each collocation point."""
        return len(self.declared.equations)

    @cached_property
    def limited(self) -> IndexArray:
        """Position of the bounded variable for each bound over time, shape (n_limits,).

        The bounds are those of the attribute `limits`. The positions refer to the states followed
        by the algebraic variables.
        """
        names = [s.name for s in (*self.declared.states, *self.declared.algebraics)]
        return np.array([names.index(limit.variable) for limit in self.limits], dtype=np.intp)

    @property
    def is_equality(self) -> NDArray[np.bool_]:
        """Whether each path equation is an equality (else an inequality), shape (n_equations,)."""
        return np.array([e.is_equality for e in self.declared.equations], dtype=bool)


def _unpacked(parts: Packed) -> CompiledModel:
    """Restore a compiled model from its pickle.

    `parts` are the model's attributes by name, with their CasADi expressions serialised as text.
    """
    return CompiledModel(**parts.unpacked())


def compile_declarations(declared: Declarations) -> CompiledModel:
    """Compile the declarations of a model to CasADi functions.

    Bounds over time that depend on static variables become constraints. A linear inequality over
    time on a single state or algebraic variable becomes a bound. So does a linear condition on a
    single static variable, or on a single state at a declared time. Integrals in conditions or in
    nonlinear terms of the objective become static variables.
    """
    # Output states stay in the nonlinear program if the objective is constant.
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
    # Computed before derivatives exist: CasADi stores them in a spline's function, and would
    # serialise them too.
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
    """Return the CasADi function (static variables, parameters) -> boundaries of the phases.

    They are physical times: the start of the horizon, the free interior times, and the end. The
    argument `parameters` is the CasADi column of the parameters' symbols.
    """
    inputs = [_symbols(declared.statics), parameters]
    return casadi.Function("times", inputs, [stacked(declared.clock.times)])


def with_moving_limits(declared: Declarations) -> Declarations:
    """Return a copy of a model's declarations, without bounds that depend on static variables.

    If times of the horizon are free, the time t in ``m.x[t] <= t`` depends on static variables. The
    copy contains ``m.x[t] - t <= 0`` instead.
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

    # A variable's own bound that depends on static variables becomes a constraint first.
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
    """Return constraints equivalent to `equation`, whose limits contain no static variables.

    A limit contains static variables if `moves(limit)` is true. It is then subtracted: ``y <=
    limit`` becomes ``y - limit <= 0``. Limits may still depend on parameters and time.
    """
    below, above = moves(equation.lower), moves(equation.upper)
    if not (below or above):
        return [equation]
    body, none = equation.expression, casadi.SX(casadi.inf)
    found = []
    if below:
        side, unbounded = _moving_side(equation.lower)
        found.append(
            replace(
                equation,
                expression=body - side,
                lower=_infinite_where(unbounded, -none),
                upper=none,
            )
        )
    if above:
        side, unbounded = _moving_side(equation.upper)
        found.append(
            replace(
                equation,
                expression=body - side,
                lower=-none,
                upper=_infinite_where(unbounded, none),
            )
        )
    rest = replace(
        equation,
        lower=-none if below else equation.lower,
        upper=none if above else equation.upper,
    )
    return found if is_unbounded(rest.lower, rest.upper) else [*found, rest]


def _infinite_where(unbounded: Any, none: Any) -> Any:
    """Return the bound of (expression - limit): 0, or `none` if `unbounded` is true.

    `none` is inf or -inf, and `unbounded` indicates that there is no limit.
    """
    zero = casadi.SX(0)
    return zero if unbounded.is_zero() else casadi.if_else(unbounded, none, zero)


def _moving_side(side: Any) -> tuple[Any, Any]:
    """Return a limit with 0 in place of infinite values, and an indicator of absent limits.

    The indicator is 1 where the limit is infinite, else 0.
    """
    zero = casadi.SX(0)
    if side.is_constant():
        is_infinite = math.isinf(float(side))
        return (zero, casadi.SX(1)) if is_infinite else (side, zero)
    # A limit that differs between parts of the horizon is a sum of terms, each zero outside its
    # part.
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
    """Compile the functions that evaluate the arguments of all interpolation tables in a model.

    Both mappings have CasADi symbols by name, from `_path_symbols` for equations over time, and
    from `_point_symbols` for conditions. Each gives one function.
    """
    parameters = _symbols(declared.parameters)
    made: list[Any] = []
    for variables, data in (
        (path_variables, casadi.vertcat(*declared.path_data)),
        (point_variables, parameters),
    ):
        symbols = stacked(variables.values())
        known = symbol_names(casadi.vertcat(symbols, data))
        # Skip arguments in equations that were left out: no function has their symbols as inputs.
        uses = tuple(u for u in declared.table_uses if symbol_names(u.expression) <= known)
        rows = stacked([u.expression for u in uses])
        made += [uses, casadi.Function("table_arguments", [symbols, data], [rows])]
    return TableArguments(over_time=made[0], path=made[1], in_conditions=made[2], points=made[3])


def _fingerprint(declared: Declarations, functions: list[Any]) -> str:
    """Return a hash that identifies a model, independently of parameter values.

    The hash shows whether a warm start belongs to the same model.
    """
    d = declared
    names = ["maximise" if d.maximise else "minimise", *(e.name for e in d.equations)]
    names += [slot.name for slot in (*d.states, *d.algebraics, *d.statics)]
    code = [_anonymous(function) for function in functions]
    return sha256("\n".join([*code, *names]).encode()).hexdigest()


def _values(name: str, rows: Any, variables: Any, data: Any) -> Any:
    """Return the CasADi function (variables, data) -> dense column of the expressions `rows`."""
    return casadi.Function(name, [variables, data], [casadi.densify(rows)])


def _anonymous(function: Any) -> str:
    """Return the code of a CasADi function as text, without the names of the model's symbols.

    In the text, the inputs are named i0, i1 and so on.
    """
    # A name such as x[0.5] contains a time. The hash of the model must not depend on times.
    symbols = [casadi.SX.sym(f"i{k}", function.size1_in(k)) for k in range(function.n_in())]
    return str(casadi.Function("f", symbols, function.call(symbols)).serialize())


def _limits(name: str, data: Any, items: tuple[Any, ...]) -> Any:
    """Return the CasADi function from `data` to the lower and upper bounds of `items`.

    `data` is a column of symbols of parameters, possibly with the fraction of the horizon. Each
    item is a variable or constraint with expressions `lower` and `upper`.
    """
    sides = [stacked([i.lower for i in items]), stacked([i.upper for i in items])]
    return casadi.Function(name, [data], sides)


def stacked(expressions: Any) -> Any:
    """Return CasADi expressions, stacked into one column vector.

    `expressions` is a sequence of expressions. If the sequence is empty, the column has no rows.
    """
    return casadi.vertcat(casadi.SX(0, 1), *[casadi.SX(e) for e in expressions])


def _symbols(slots: tuple[Slot, ...]) -> Any:
    """Return the symbols of variables or parameters (`slots`) as a CasADi column vector."""
    return stacked([s.symbol for s in slots])


def _path_symbols(declared: Declarations) -> dict[str, Any]:
    """Return the symbols of the variables at a collocation point, by name and in fixed order.

    The order is: rates, states, algebraic variables, static variables.
    """
    symbols = {s.rate.name(): s.rate for s in declared.states}
    for slots in (declared.states, declared.algebraics, declared.statics):
        symbols |= {s.symbol.name(): s.symbol for s in slots}
    return symbols


def _point_symbols(declared: Declarations) -> dict[str, Any]:
    """Return the symbols of the variables in conditions and objective, by name and in fixed order.

    The order is: values at declared times, static variables, integrals that no static variable
    replaces.
    """
    symbols = {p.symbol.name(): p.symbol for p in declared.point_symbols}
    symbols |= {s.symbol.name(): s.symbol for s in declared.statics}
    return symbols | {
        i.symbol.name(): i.symbol for i in declared.integrals if not _is_static(declared, i.name)
    }


def _boundable_at_points(declared: Declarations) -> frozenset[str]:
    """Return the names of the unknowns for which a condition on a single unknown becomes a bound.

    They are the values of states at declared times, and the static variables.
    """
    states = {s.name for s in declared.states}
    at_points = {
        p.symbol.name() for p in declared.point_symbols if p.slot in states and not p.is_rate
    }
    return frozenset(at_points | {s.symbol.name() for s in declared.statics})


def _is_static(declared: Declarations, name: str) -> bool:
    """Return whether the model has a static variable (a variable without time) of this name."""
    return any(s.name == name for s in declared.statics)


def _with_integral_variables(declared: Declarations) -> Declarations:
    """Return a copy of a model's declarations, with static variables for some integrals.

    These integrals enter a condition or a nonlinear term of the objective.
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
            # A constraint makes the static variable equal to the integral.
            statics.append(integral.slot)
    return replace(declared, statics=tuple(statics))


def _derive(name: str, rows: Any, variables: Any, data: Any) -> DerivedFunctions:
    """Return CasADi functions of a column of expressions, its Jacobian and its weighted Hessian.

    The expressions `rows` depend on the symbols `variables` and `data`. Derivatives are taken by
    `variables` only. The Hessian is that of the rows' weighted sum, with one weight per row.
    """
    plain = WithoutCalls.of(casadi.densify(rows), [variables, data])
    jacobian = casadi.jacobian(plain.rows, variables)
    weights = casadi.SX.sym("weights", rows.shape[0])
    hessian = casadi.tril(casadi.hessian(casadi.dot(weights, plain.rows), variables)[0])
    j_rows, j_columns = jacobian.sparsity().get_triplet()
    h_rows, h_columns = hessian.sparsity().get_triplet()
    return DerivedFunctions(
        values=_values(name, plain.with_calls(plain.rows), variables, data),
        jacobian=casadi.Function(
            f"{name}_jacobian", [variables, data], [plain.merged(_nonzeros(jacobian))]
        ),
        hessian=casadi.Function(
            f"{name}_hessian", [variables, data, weights], [plain.merged(_nonzeros(hessian))]
        ),
        jacobian_rows=np.asarray(j_rows, dtype=np.intp),
        jacobian_columns=np.asarray(j_columns, dtype=np.intp),
        hessian_rows=np.asarray(h_rows, dtype=np.intp),
        hessian_columns=np.asarray(h_columns, dtype=np.intp),
    )


def _nonzeros(matrix: Any) -> Any:
    """Return the nonzeros of a sparse CasADi matrix as a column vector."""
    return casadi.vertcat(casadi.SX(0, 1), *matrix.nonzeros())
