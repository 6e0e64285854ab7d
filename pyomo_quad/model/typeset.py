"""Conversion of the equations in a Pyomo model to LaTeX, in the symbols of Yacef et al."""

import tomllib
from collections.abc import Hashable, Iterator
from dataclasses import dataclass
from math import tau
from pathlib import Path

from pyomo.core import ConcreteModel, Constraint, Expression, value
from pyomo.core.base.component import ComponentData
from pyomo.core.base.indexed_component import IndexedComponent
from pyomo.core.base.units_container import _PyomoUnit
from pyomo.core.expr import numeric_expr, relational_expr
from pyomo.core.expr.numvalue import NumericValue, native_numeric_types
from pyomo.dae import ContinuousSet, DerivativeVar, Integral

from pyomo_quad.model.screening import instances, is_over
from pyomo_quad.scenario.fields import leaves, spell

#: Full component name (with index where the symbol depends on it) -> its symbol.
SYMBOLS: dict[str, str] = {
    spell(path): symbol
    for path, symbol in leaves(
        tomllib.loads(Path(__file__).with_name("symbols.toml").read_text(encoding="utf-8"))
    )
}

# Component that declares each numbered equation of the paper.
EQUATION_TABLE = {
    1: ("pyomo_quad.model.rotors.declare_motors", "pyomo_quad.model.rotors.declare_rotors"),
    2: ("pyomo_quad.model.rotors.declare_motors",),
    3: ("pyomo_quad.model.rotors.declare_motors",),
    4: ("pyomo_quad.model.battery.declare_battery",),
    5: ("pyomo_quad.model.battery.declare_battery",),
    6: ("pyomo_quad.model.rigid_body.declare_balances",),
    7: ("pyomo_quad.model.rotors.declare_rotors",),
    8: (
        "pyomo_quad.model.power.declare_power",
        "pyomo_quad.model.power.declare_efficiency_power",
    ),
    9: (
        "pyomo_quad.model.rigid_body.declare_motion",
        "pyomo_quad.model.rotors.declare_rotors",
        "pyomo_quad.model.aerodynamics.declare_aerodynamics",
    ),
    10: ("pyomo_quad.model.limits.declare_limits",),
    11: ("pyomo_quad.model.wind.declare_wind",),
    12: ("pyomo_quad.model.wind.declare_wind",),
}

# Precedence of the parts of a LaTeX expression.
_SUM, _PRODUCT, _POWER, _ATOM = range(4)
_FUNCTIONS = {"sin", "cos", "tan", "exp", "log", "tanh"}


@dataclass(frozen=True, kw_only=True)
class TypesetEquation:
    """Declared equation as LaTeX.

    Attributes
    ----------
    name : str
        Name of the Pyomo component.
    description : str
        The component's `doc` text.
    latex : str
        The equation as LaTeX, without delimiters.
    """

    name: str
    description: str
    latex: str


def typeset_equations(model: ConcreteModel) -> tuple[TypesetEquation, ...]:
    """Typeset every constraint and named expression over time as LaTeX.

    The order is that of the declaration. An indexed component has the equation of its first member,
    in which the index of rotor 1 is written as j.
    """
    time = next(model.component_objects(ContinuousSet, descend_into=True))
    instant = sorted(time)[len(time) // 2]
    kinds = (Constraint, Expression)
    return tuple(
        TypesetEquation(name=component.name, description=component.doc or "", latex=latex)
        for component in model.component_objects(kinds, active=True, descend_into=True)
        if not isinstance(component, Integral)
        for latex in _component(component, time, instant)
    )


def _component(component: IndexedComponent, time: ContinuousSet, instant: float) -> Iterator[str]:
    if not is_over(component, time):
        return
    first = instances(component, instant)[0]
    writer = _Writer(has_free_index=len(_index(first)) > 0)
    if component.ctype is Constraint:
        yield writer.relation(first.expr)
    else:
        yield f"{writer.symbol(first)} = {writer.text(first.expr)}"


def _index(data: ComponentData) -> tuple[Hashable, ...]:
    """Return the index of a member of a Pyomo component as a tuple, with the time removed.

    For ``x[i, t]`` with the time t, the result is (i,).
    """
    index = data.index()
    if index is None:
        return ()
    whole = index if isinstance(index, tuple) else (index,)
    is_over_time = data.parent_component().is_indexed() and any(
        s.ctype is ContinuousSet for s in data.parent_component().index_set().subsets()
    )
    return whole[:-1] if is_over_time else whole


class _Writer:
    """Writer of Pyomo expressions as LaTeX.

    If `has_free_index` is true, the index 1 is written as the free index j. An equation that holds
    for each rotor is then printed once, from its form for rotor 1.
    """

    def __init__(self, *, has_free_index: bool) -> None:
        self._has_free_index = has_free_index

    def relation(self, expression: NumericValue) -> str:
        operator = {
            relational_expr.EqualityExpression: " = ",
            relational_expr.InequalityExpression: r" \le ",
            relational_expr.RangedExpression: r" \le ",
        }[type(expression)]
        return operator.join(self.text(side) for side in expression.args)

    def text(self, expression: NumericValue) -> str:
        return self._write(expression)[0]

    def symbol(self, data: ComponentData) -> str:
        component = data.parent_component()
        if isinstance(component, DerivativeVar):
            state = component.get_state_var()
            return rf"\dot{{{self._named(state.name, ())}}}{self._subscript(_index(data))}"
        return self._named(component.name, _index(data))

    def _named(self, name: str, index: tuple[Hashable, ...]) -> str:
        whole = f"{name}[{','.join(map(str, index))}]"
        if whole in SYMBOLS:
            return SYMBOLS[whole]
        own_name = rf"\mathrm{{{name.rsplit('.', 1)[-1]}}}".replace("_", r"\_")
        symbol = SYMBOLS.get(name, own_name)
        # LaTeX refuses a second subscript.
        if index and "_" in symbol:
            symbol = f"{{{symbol}}}"
        return symbol + self._subscript(index)

    def _subscript(self, index: tuple[Hashable, ...]) -> str:
        if not index:
            return ""
        is_free = self._has_free_index and index == (1,)
        return "_{j}" if is_free else f"_{{{','.join(map(str, index))}}}"

    def _write(self, node: NumericValue) -> tuple[str, int]:
        if type(node) in native_numeric_types:
            return _number(node), _ATOM if node >= 0 else _SUM
        if not node.is_expression_type():
            return self.symbol(node), _ATOM
        if node.is_named_expression_type():
            return self.symbol(node), _ATOM
        return self._operation(node)

    def _operation(self, node: NumericValue) -> tuple[str, int]:
        writers = {
            numeric_expr.SumExpression: self._sum,
            numeric_expr.NegationExpression: self._negation,
            numeric_expr.ProductExpression: self._product,
            numeric_expr.DivisionExpression: self._division,
            numeric_expr.PowExpression: self._power,
        }
        for kind, write in writers.items():
            if isinstance(node, kind):
                return write(node)
        return self._function(node)

    def _negation(self, node: NumericValue) -> tuple[str, int]:
        return f"-{self._bracketed(node.args[0], _PRODUCT)}", _SUM

    def _division(self, node: NumericValue) -> tuple[str, int]:
        above, below = node.args
        if _is_unit(below):
            return self._write(above)
        return rf"\frac{{{self.text(above)}}}{{{self.text(below)}}}", _PRODUCT

    def _power(self, node: NumericValue) -> tuple[str, int]:
        base, exponent = node.args
        text, strength = self._write(base)
        # LaTeX refuses a second superscript.
        if strength < _ATOM or "^" in text:
            text = rf"\left({text}\right)"
        return f"{text}^{{{self.text(exponent)}}}", _POWER

    def _sum(self, node: NumericValue) -> tuple[str, int]:
        text = ""
        for term in node.args:
            piece = self.text(term)
            if text:
                text += f" - {piece[1:]}" if piece.startswith("-") else f" + {piece}"
            else:
                text = piece
        return text, _SUM

    def _product(self, node: NumericValue) -> tuple[str, int]:
        sign, strength = "", _PRODUCT
        factors: list[str] = []
        for factor in (f for f in node.args if not _is_unit(f)):
            text, strength = self._write(factor)
            if text.startswith("-") and not factors and not sign:
                # A leading minus belongs to the whole product.
                sign, text = "-", text[1:]
                strength = _PRODUCT if _is_single_term(factor) else strength
            factors.append(text if strength >= _PRODUCT else rf"\left({text}\right)")
        if len(factors) > 1 and factors[0] == "1":
            factors = factors[1:]
        if sign or len(factors) > 1:
            strength = _SUM if sign else _PRODUCT
        return sign + r" \, ".join(factors), strength

    def _function(self, node: NumericValue) -> tuple[str, int]:
        argument = self.text(node.args[0])
        if node.name == "abs":
            return rf"\left|{argument}\right|", _ATOM
        if node.name == "sqrt":
            return rf"\sqrt{{{argument}}}", _ATOM
        if node.name == "exp":
            return f"e^{{{argument}}}", _POWER
        if node.name in _FUNCTIONS:
            return rf"\{node.name}\left({argument}\right)", _ATOM
        if node.name in SYMBOLS:
            # A table of the model; Pyomo appends an argument that identifies it.
            arguments = ", ".join(map(self.text, node.args[:-1]))
            return rf"{SYMBOLS[node.name]}\left({arguments}\right)", _ATOM
        return rf"\operatorname{{{node.name}}}\left({argument}\right)", _ATOM

    def _bracketed(self, node: NumericValue, needed: int) -> str:
        text, strength = self._write(node)
        return text if strength >= needed else rf"\left({text}\right)"


def _number(number: float) -> str:
    if number == tau:
        return r"2 \pi"
    mantissa, _, exponent = f"{number:.6g}".partition("e")
    if not exponent:
        return mantissa
    power = f"10^{{{int(exponent)}}}"
    return power if mantissa == "1" else rf"{mantissa} \cdot {power}"


def _is_single_term(node: NumericValue) -> bool:
    """Return whether an expression is a single term, which a minus sign can precede directly."""
    return type(node) in native_numeric_types or not isinstance(node, numeric_expr.SumExpression)


def _is_unit(node: NumericValue) -> bool:
    """Return whether a factor is a Pyomo unit, or an expression of units and numbers of value 1.

    Each unit counts as 1, so that m/s has the value 1. Typeset equations leave these factors out.
    """
    if isinstance(node, _PyomoUnit):
        return True
    if type(node) in native_numeric_types or not node.is_expression_type():
        return False
    if node.is_named_expression_type():
        return False
    return all(_is_unit(a) or type(a) in native_numeric_types for a in node.args) and (
        value(node) == 1.0
    )
