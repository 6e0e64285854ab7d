"""The declared equations as LaTeX in the paper's symbols, generated from the Pyomo model."""

from collections.abc import Hashable, Iterator
from dataclasses import dataclass
from math import tau

from pyomo.core import ConcreteModel, Constraint, Expression, value
from pyomo.core.base.component import ComponentData
from pyomo.core.base.indexed_component import IndexedComponent
from pyomo.core.base.units_container import _PyomoUnit
from pyomo.core.expr import numeric_expr, relational_expr
from pyomo.core.expr.numvalue import NumericValue, native_numeric_types
from pyomo.dae import ContinuousSet, DerivativeVar, Integral

from pyomo_quad.model.wind import HARMONICS


def _along(axes: str, **symbols: str) -> dict[str, str]:
    """Return the symbols of the components of vectors: each name and symbol with its axis."""
    return {
        f"{name}_{axis}": f"{symbol}_{axis}" for name, symbol in symbols.items() for axis in axes
    }


_VEHICLE = {
    "mass": "m",
    "gravity": "g",
    "arm_length": "l",
    **{f"I{axis}": f"I_{axis}" for axis in "xyz"},
    "thrust_coefficient": r"\kappa_b",
    "drag_torque_coefficient": r"\kappa",
    "rotor_inertia": "I_r",
    "torque_constant": "k_t",
    "voltage_constant": "k_v",
    "motor_resistance": "R",
    "friction_torque": "T_f",
    "viscous_damping": "D_f",
    "drag_linear": "d_1",
    "drag_quadratic": "d_2",
}
_RIGID_BODY = {
    **{name: name for name in "xyzpqr"},
    **{f"v{axis}": f"v_{axis}" for axis in "xyz"},
    "phi": r"\phi",
    "theta": r"\theta",
    "psi": r"\psi",
}
_ROTORS = {
    "omega": r"\omega",
    "alpha": r"\alpha",
    "total_thrust": "u_1",
    "roll_moment": "u_2",
    "pitch_moment": "u_3",
    "yaw_moment": "u_4",
    "speed_imbalance": r"\varpi",
    "yaw_reaction": "u_r",
    "rotor_thrust": "T",
    "ahead": "X",
    "aside": "Y",
    "sense": "s",
    "motor_torque": r"\tau",
    "motor_current": "i",
    "motor_voltage": "v",
}
_AERODYNAMICS = {
    "acceleration_coefficient": "c_W",
    **_along("xyz", force="F", airspeed="v^{air}"),
    "drag_coefficient": "d",
    **_along("xyz", body_airspeed="v^{body}", rotor_airspeed="v^{rotor}"),
    **_along("xyz", rotor_force="F^{rotor}", body_force="F^{body}", airframe_force="F^{frame}"),
    "roll_moment": "M_x",
    "pitch_moment": "M_y",
    "yaw_moment": "M_z",
    "rotor_drag_plane": "k_d",
    "rotor_drag_axis": "k_z",
    "translational_lift": "k_h",
    **{f"parasitic_drag[{axis}]": f"c_{axis}" for axis in "xyz"},
}
_POWER_SYMBOL = {
    "rotor_power": "P",
    "uncredited_power": r"P^{\pm}",
    "total": r"P_{\Sigma}",
    "efficiency": r"\eta",
    "efficiency_polynomial": r"\hat f_r",
    "drive_efficiency": "f_r",
    "map_torque": r"\hat\tau",
    "efficiency_floor": r"f_{min}",
    "torque_floor": r"\tau_{min}",
    "smoothing": r"\varepsilon",
    "torque_with_friction": r"\tau^{f}",
    "current_with_friction": "i^{f}",
    "terminal_voltage": r"v^{m}",
    "rotor_radius": "R",
    "air_density": r"\rho",
    "disc_area": "A",
    "induced_power_factor": "k_i",
    "profile_power_coefficient": "c_0",
    "profile_advance_factor": "K",
    "climb_power_factor": "k_c",
    "descent_power_factor": "k_d",
    "electronics_power": "P_e",
    "induced_velocity": "v_i",
    "axial_airspeed": "v_a",
    "in_plane_airspeed_squared": "v_p^2",
    "axial_power_over_thrust": r"\kappa v_a",
    "acceleration_power": r"P_\alpha",
    "rotor_thrust": "T",
    "profile_power": "P_0",
    **{
        f"efficiency_map[{row},{column}]": f"{column}_{number}"
        for number, row in enumerate(("cubic", "quadratic", "linear", "constant"), start=1)
        for column in "abc"
    },
}
_BATTERY = {
    "cells_series": "n_s",
    "cells_parallel": "n_p",
    "E0": "e_0",
    "K": "k",
    "A": "c_1",
    "B": "c_2",
    "capacity": "Q_{cell}",
    "cell_resistance": "R_{cell}",
    "pack_capacity": "Q_{bat}",
    "pack_resistance": "R_{bat}",
    "charge_drawn": "q_{bat}",
    "current": "i_{bat}",
    "voltage": "V_{bat}",
    "open_circuit_voltage": "e_m",
    "state_of_charge": r"\mathrm{SoC}",
    "greatest_power": "P_{max}",
    "power_reserve": r"\Delta P",
    "remaining_share": r"\sigma_q",
    "reserve_share": r"\sigma_P",
    "relaxation_voltage": "u_1",
    "loss": "E_l",
    "reference_voltage": "U_0",
    "relaxation_resistance": "R_1",
    "relaxation_time_constant": r"\tau_1",
    "temperature": "T_{bat}",
    "heat": r"\dot Q",
    "heat_capacity": "C_T",
    "cooling": "h",
    "ambient_temperature": "T_a",
    "reference_temperature": "T_r",
    "activation_energy": "E_a",
    "resistance_share": "s_R",
    "capacity_factor": "f_Q",
    "resistance_factor": "f_R",
}
_LIMITS = {
    "roll_max": r"\phi_{max}",
    "pitch_max": r"\theta_{max}",
    "rotor_speed_min": r"\omega_{min}",
    "rotor_speed_max": r"\omega_{max}",
    "rotor_acceleration_max": r"\alpha_{max}",
    "thrust_max": "T_{max}",
    "roll_moment_max": "u_{2,max}",
    "pitch_moment_max": "u_{3,max}",
    "yaw_moment_max": "u_{4,max}",
    "reserve": r"\sigma",
    "motor_time_constant": r"\tau_m",
    "lagging_acceleration": r"\alpha_{lag}",
    "state_of_charge_min": r"\mathrm{SoC}_{min}",
    "battery_current_max": "i_{max}",
    "battery_voltage_min": "V_{min}",
    "battery_power_share_max": r"\eta_{max}",
    "speed": "v",
    "speed_max": "v_{max}",
}
_AIRSPACE = {
    "floor": "z_{min}",
    "ceiling": "z_{max}",
    "clearance": "c",
    "centre": "c",
    "radius": "R",
    "beyond": "d",
    "rounding": r"\varepsilon_r",
    "edge_width": "w",
    "terrain_end": "b",
}
_GROUND = {"height_limited_below": "h_U", "height_limited_above": "h_L"}
_HOMING = {
    **{f"home_{axis}": f"{axis}_{{home}}" for axis in "xyz"},
    "way": "d",
    "tail_wind": r"w_{\parallel}",
    "ground_speed": "g",
    "airspeed": "V",
    "current": "i",
    "margin": r"\mu",
    "usable_charge": r"\kappa",
    "charge_to": "q",
    "charge_home": "q_{home}",
}


def _wind_axis(axis: str) -> dict[str, str]:
    harmonics = {}
    for k in HARMONICS:
        harmonics[f"amplitudes[{k}]"] = f"A_{{{axis},{k}}}"
        harmonics[f"frequencies[{k}]"] = rf"\Omega_{{{axis},{k}}}"
    return harmonics | {
        "mean": f"v_{{0,{axis}}}",
        "gust": f"v_{{g,{axis}}}",
        "gust_amplitude": f"v_{{gmax,{axis}}}",
        "gust_period": f"T_{{g,{axis}}}",
    }


_BLOCKS = {
    "vehicle": _VEHICLE,
    "rigid_body": _RIGID_BODY,
    "rotors": _ROTORS,
    "wind.x": _wind_axis("x"),
    "wind.y": _wind_axis("y"),
    "wind": {
        **_along("xyz", velocity="v^{wind}"),
        "wind_time": r"t_w",
        "time_offset": "t_0",
        "vertical": "w_0",
        "height_above": r"\Delta h",
        "height": "h",
        "profile": "s_h",
        "reference_height": "h_r",
        "least_height": "h_0",
        "greatest_height": "h_1",
        "height_below": r"\Delta h_1",
        "height_share": r"\eta",
        "shape": "B",
        "exponent": "a",
        "roughness": "z_0",
        **_along("xy", measured=r"\tilde v^{wind}"),
        **_along("xyz", of_field="w"),
        "field_unit": "s",
    },
    "aerodynamics": _AERODYNAMICS,
    "power": _POWER_SYMBOL,
    "battery": _BATTERY,
    "limits": _LIMITS,
    "airspace": _AIRSPACE,
    "ground": _GROUND,
    "homing": _HOMING,
}

# Full component name (with index where the symbol depends on it) to its symbol.
SYMBOLS = {"clock": "t"} | {
    f"{block}.{name}": symbol
    for block, symbols in _BLOCKS.items()
    for name, symbol in symbols.items()
}


_TABLES = {"ground.above": "U", "ground.below": "L"} | {
    f"wind.field_{axis}": rf"\hat w_{axis}" for axis in "xyz"
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
    """One declared equation: component name, its `doc`, and LaTeX without delimiters."""

    name: str
    description: str
    latex: str


def typeset_equations(model: ConcreteModel) -> tuple[TypesetEquation, ...]:
    """Typeset every constraint and named expression over time.

    Parameters
    ----------
    model : ConcreteModel
        A continuous model, as `build_model` declares it.
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
    if not component.is_indexed() or all(s is not time for s in component.index_set().subsets()):
        return
    instances = [d for index, d in component.items() if _time_of(index) == instant]
    first = instances[0]
    writer = _Writer(has_free_index=len(_index(first)) > 0)
    if component.ctype is Constraint:
        yield writer.relation(first.expr)
    else:
        yield f"{writer.symbol(first)} = {writer.text(first.expr)}"


def _index(data: ComponentData) -> tuple[Hashable, ...]:
    """Return the index without time."""
    index = data.index()
    if index is None:
        return ()
    whole = index if isinstance(index, tuple) else (index,)
    is_over_time = data.parent_component().is_indexed() and any(
        s.ctype is ContinuousSet for s in data.parent_component().index_set().subsets()
    )
    return whole[:-1] if is_over_time else whole


def _time_of(index: Hashable) -> Hashable:
    return index[-1] if isinstance(index, tuple) else index


class _Writer:
    """Writes Pyomo expressions as LaTeX; with a free index, the first rotor is written as j."""

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
        if node.name in _TABLES:
            # Pyomo appends an argument that identifies the function.
            arguments = ", ".join(map(self.text, node.args[:-1]))
            return rf"{_TABLES[node.name]}\left({arguments}\right)", _ATOM
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
    """Return whether a leading minus in the node's text applies to the whole node."""
    return type(node) in native_numeric_types or not isinstance(node, numeric_expr.SumExpression)


def _is_unit(node: NumericValue) -> bool:
    """Return whether a factor is a unit, or a product of units, with the value one."""
    if isinstance(node, _PyomoUnit):
        return True
    if type(node) in native_numeric_types or not node.is_expression_type():
        return False
    if node.is_named_expression_type():
        return False
    return all(_is_unit(a) or type(a) in native_numeric_types for a in node.args) and (
        value(node) == 1.0
    )
