"""Names of limits (path constraints), and the amounts by which flights exceed them, in words.

Reports print these words. Limits of the package's own model have names in words and familiar units.
Limits of a user's own model keep the names and units that the user gave them.
"""

from math import sqrt

from pyomo_quad.collocation import Violation

#: Name of a limit without its index -> words, with a placeholder for rotor, waypoint or zone.
WORDS = {
    "airspace.ceiling_limit": "ceiling",
    "airspace.field_edge": "{} edge of the wind field",
    "airspace.floor_limit": "floor",
    "airspace.keep_in": "edge {} of the fence",
    "airspace.keep_out": "keep-out {}",
    "airspace.terrain_edge": "{} edge of the terrain",
    "homing.return_limit": "charge for the return",
    "limits.battery_current_limit": "battery current",
    "limits.battery_power_limit": "power left in the battery",
    "limits.battery_voltage_limit": "battery voltage",
    "limits.motor_braking_limit": "lag of motor {} while it slows down",
    "limits.motor_lag_limit": "lag of motor {} while it speeds up",
    "limits.pitch_limit": "pitch angle",
    "limits.pitch_moment_limit": "pitch moment",
    "limits.roll_limit": "roll angle",
    "limits.roll_moment_limit": "roll moment",
    "limits.rotor_acceleration_limit": "acceleration of rotor {}",
    "limits.rotor_speed_limit": "speed of rotor {}",
    "limits.speed_limit": "speed over ground",
    "limits.state_of_charge_limit": "state of charge",
    "limits.thrust_limit": "total thrust",
    "limits.validated_airspeed_limit": "airspeed that measurements confirm",
    "limits.validated_climb_limit": "climb that measurements confirm",
    "limits.validated_descent_limit": "descent that measurements confirm",
    "limits.yaw_moment_limit": "yaw moment",
    "mission.hold_distance": "distance from hover waypoint {}",
    "mission.hold_speed": "speed at hover waypoint {}",
    "mission.passing_near": "distance from waypoint {}",
    "mission.passing_speed": "speed at waypoint {}",
    "mission.yaw_keeping": "turning while the heading is kept",
    "rotors.alpha": "acceleration of rotor {}",
    "rotors.omega": "speed of rotor {}",
}
# The equations number waypoints from 0; figures and tables number them from 1, like legs.
_COUNTED_FROM_0 = "mission."
_UNITS = {"N*m": "N m", "rad/s**2": "rad/s²"}
# The equations limit squared lengths, which are differentiable at zero.
_ROOTS = {"m**2": "m", "m**2/s**2": "m/s"}


def limit_words(name: str) -> str:
    """Return the name of a limit in words, from its name in the model.

    The limit ``mission.hold_speed[0]``, for example, is the "speed at hover waypoint 1". The name
    of a limit of a user's own model is returned unchanged.
    """
    declared, _, index = name.partition("[")
    # Pyomo quotes an index with a dot.
    index = index.removesuffix("]").strip("'")
    if declared.startswith(_COUNTED_FROM_0) and index.isdecimal():
        index = str(int(index) + 1)
    return WORDS[declared].format(index).rstrip() if declared in WORDS else name


def limit_amount(name: str, size: float, unit: str) -> tuple[float, str]:
    """Convert a value in the model's unit to the value and unit printed in reports.

    A squared speed or distance becomes its square root. Values of limits of a user's own model stay
    unchanged. `name` is the name of the limit in the model.
    """
    if name.partition("[")[0] not in WORDS:
        return size, unit
    return (sqrt(size), _ROOTS[unit]) if unit in _ROOTS else (size, _UNITS.get(unit, unit))


def excess(breach: Violation, unit: str) -> tuple[float, str]:
    """Return the violation of a limit, in the unit printed in reports, and this unit.

    `unit` is the unit in the model. For example, a squared speed of 16 m**2/s**2 violates the limit
    9 m**2/s**2. The result is sqrt(16) - sqrt(9) = 1 m/s.
    """
    # For a square, this is the excess of the length over its limit, not the root of the difference.
    reached, plain = limit_amount(breach.name, abs(breach.bound) + breach.size, unit)
    return reached - limit_amount(breach.name, abs(breach.bound), unit)[0], plain


def breach_words(breach: Violation, unit: str) -> str:
    """Return a violated limit in words, with the amount: "roll angle by 0.15 rad".

    `breach` is the violation, `unit` the unit of the limit in the model.
    """
    size, plain = excess(breach, unit)
    return f"{limit_words(breach.name)} by {size:.2g} {plain}".rstrip()


def percent(share: float) -> str:
    """Return a fraction as a percentage with one significant digit, as in "0.02 %" or "30 %"."""
    return f"{float(f'{100.0 * share:.1g}'):g} %"
