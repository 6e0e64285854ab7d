"""Symbols of the paper for the declared components, in LaTeX."""

from pyomo_quad.model.wind import HARMONICS

__all__ = ["SYMBOLS"]

_VEHICLE = {
    "mass": "m",
    "gravity": "g",
    "arm_length": "l",
    "Ix": "I_x",
    "Iy": "I_y",
    "Iz": "I_z",
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
    "vx": "v_x",
    "vy": "v_y",
    "vz": "v_z",
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
    "motor_torque": r"\tau",
    "motor_current": "i",
    "motor_voltage": "v",
}
_AERODYNAMICS = {
    "acceleration_coefficient": "c_W",
    "force_x": "F_x",
    "force_y": "F_y",
    "force_z": "F_z",
    "airspeed_x": "v^{air}_x",
    "airspeed_y": "v^{air}_y",
    "airspeed_z": "v^{air}_z",
    "drag_coefficient": "d",
}
_POWER = {
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
    "state_of_charge_min": r"\mathrm{SoC}_{min}",
    "battery_current_max": "i_{max}",
    "battery_voltage_min": "V_{min}",
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
        "velocity_x": "v^{wind}_x",
        "velocity_y": "v^{wind}_y",
        "wind_time": r"t_w",
        "time_offset": "t_0",
        "measured_x": r"\tilde v^{wind}_x",
        "measured_y": r"\tilde v^{wind}_y",
    },
    "aerodynamics": _AERODYNAMICS,
    "power": _POWER,
    "battery": _BATTERY,
    "limits": _LIMITS,
}

# Full component name (with index where the symbol depends on it) to its symbol.
SYMBOLS = {"clock": "t"} | {
    f"{block}.{name}": symbol
    for block, symbols in _BLOCKS.items()
    for name, symbol in symbols.items()
}
