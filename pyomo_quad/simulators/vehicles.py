"""Vehicle files made from parameter sets of the simulator RotorPy.

RotorPy's rotors are placed diagonally, the package's rotors on the body axes x and y. The
parameters are converted to body axes turned by 45 degrees: RotorPy's first rotor is then ahead, its
fourth to the left.

If Ixx and Iyy differ, the turned axes have a product of inertia of half their difference, which is
neglected.
"""

from math import hypot
from typing import Any, NamedTuple

from pyomo_quad.flight.outside_plant import rotorpy_module
from pyomo_quad.report.folder import MARK
from pyomo_quad.scenario import ScenarioError
from pyomo_quad.scenario.messages import shown
from pyomo_quad.scenario.toml_text import with_source

#: Parameter sets of RotorPy with four rotors in a cross, each with the mass [kg] and length [m] of
#: a rotor.
_ROTORS = {"hummingbird": (6e-3, 0.2), "crazyflie": (2e-4, 0.046)}
NAMES = tuple(_ROTORS)


class Said(NamedTuple):
    """Value of one field of a vehicle file in SI units, and the source of this value in words."""

    value: float | str | list[float]
    source: str


def rotorpy_parameters(name: str) -> dict[str, Any]:
    """Return a parameter set of RotorPy by name, in RotorPy's own keys and units.

    `name` is "hummingbird" or "crazyflie". ScenarioError is raised for any other name, or if
    RotorPy is not installed.
    """
    if name not in NAMES:
        raise ScenarioError(f"NAME = {shown(name)}; must be one of {', '.join(NAMES)}.")
    return dict(rotorpy_module(f"vehicles.{name}_params").quad_params)


def vehicle_fields(name: str) -> dict[str, Said]:
    """Convert RotorPy's parameter set "hummingbird" or "crazyflie" to fields of a vehicle file.

    The keys of the result are dotted paths in the vehicle file, such as "fields.mass".
    ScenarioError is raised for any other `name`, or if RotorPy is not installed.
    """
    held = rotorpy_parameters(name)
    x, y, _ = held["rotor_pos"]["r1"]
    across = (held["Ixx"] + held["Iyy"]) / 2
    sideways = (held["c_Dx"] + held["c_Dy"]) / 2
    mass, length = _ROTORS[name]
    said = f"RotorPy, {name}_params: "
    turned = said + "mean of Ixx and Iyy, turned by 45 degrees"
    return {
        "fields.title": Said(f"{name} of RotorPy", "its file"),
        "fields.mass": Said(held["mass"], said + "mass"),
        "fields.arm_length": Said(hypot(x, y), said + "rotor_pos"),
        "fields.Ix": Said(across, turned),
        "fields.Iy": Said(across, turned),
        "fields.Iz": Said(held["Izz"], said + "Izz"),
        "fields.thrust_coefficient": Said(held["k_eta"], said + "k_eta"),
        "fields.drag_torque_coefficient": Said(held["k_m"], said + "k_m"),
        "fields.rotor_inertia": Said(
            mass * length**2 / 12,
            f"assumed: a thin blade of {1e3 * mass:g} g and {length:g} m; RotorPy has none",
        ),
        "fields.rotor_drag_plane": Said(held["k_d"], said + "k_d"),
        "fields.rotor_drag_axis": Said(held["k_z"], said + "k_z"),
        "fields.translational_lift": Said(held["k_h"], said + "k_h"),
        "fields.parasitic_drag": Said(
            [sideways, sideways, held["c_Dz"]], said + "c_Dx, c_Dy, c_Dz"
        ),
        "fields.motor_time_constant": Said(held["tau_m"], said + "tau_m"),
        "limits.rotor_speed_min": Said(float(held["rotor_speed_min"]), said + "rotor_speed_min"),
        "limits.rotor_speed_max": Said(float(held["rotor_speed_max"]), said + "rotor_speed_max"),
        "limits.rotor_acceleration_max": Said(
            held["rotor_speed_max"] / held["tau_m"], said + "rotor_speed_max / tau_m, from rest"
        ),
    }


def vehicle_file(name: str) -> str:
    """Return the text of a vehicle file (TOML), made from a parameter set of RotorPy.

    Each number is in a table with the keys `value` and `source`. `name` is "hummingbird" or
    "crazyflie". ScenarioError is raised for any other name, or if RotorPy is not installed.
    """
    lines = [
        f"# {MARK}: the {name} of RotorPy. RotorPy has no motor constants and no",
        "# pack: the estimates of the library's vehicle of that name are used here.",
        "",
        f'use = "{name}"',
    ]
    for path, (value, source) in vehicle_fields(name).items():
        number = value if isinstance(value, str | list) else float(value)
        lines += with_source(path, number, source)
    return "\n".join(lines) + "\n"
