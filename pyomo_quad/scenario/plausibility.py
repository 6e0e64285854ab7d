"""Physical consistency of a vehicle's numbers: motor constants, rotors and inertias.

symbol | meaning
k_t, k_v | torque constant [N m/A] and voltage constant [rad/s/V]
tau, omega | torque [N m] and speed [rad/s] of one rotor in hover
T, A | thrust [N] and disc area [m²] of this rotor
rho | air density [kg/m³]
P_i | ideal power of hover [W], T^(3/2) / sqrt(2 rho A), the least for a disc area A

These conditions are checked, apart from rounding of the numbers:

- k_t k_v = 1: the motor conserves energy. With a larger product it would create power.
- tau omega >= P_i: by momentum theory, the ideal power is the least shaft power of a rotor in
  hover.
- Ix <= Iy + Iz, and likewise for y and z. Ix is the mass integral of y² + z². The sum Iy + Iz is
  the mass integral of 2 x² + y² + z², which is at least as large.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations
from math import dist, inf, pi, sqrt

from pyomo_quad.scenario.tables import Power, PowerModel
from pyomo_quad.scenario.vehicle import RPM, MotorConstants, Vehicle

#: Accepted relative contradiction between two published numbers: each is rounded to three digits
#: and therefore wrong by up to half a per cent.
ROUNDED = 0.01
# Relative contradiction above which a remark is printed, even if rounding explains it.
_SEEN = 1e-3
# Figures of merit in hover of small vehicles' rotors, and of the best rotors.
_USUAL_MERIT, _BEST_MERIT = "0.5 to 0.7", 0.8
# Power models in which the motors' electrical constants determine the power.
_OF_MOTORS = (PowerModel.MOTOR, PowerModel.MOTOR_WITH_FRICTION)


@dataclass(frozen=True, kw_only=True)
class Contradiction:
    """Physical contradiction between the numbers of a vehicle.

    Attributes
    ----------
    field : str
        Dotted path of the field whose value contradicts other values of the vehicle, such as
        ``vehicle.Iz``.
    message : str
        Message for the user, one line.
    """

    field: str
    message: str


def created_power(vehicle: Vehicle, power: Power, gravity: float) -> str:
    """Return an error message if the motors give out more power in hover than they take in.

    The message is empty if they do not, or if the power model has no electrical motor constants.
    `gravity` is in m/s².
    """
    motor = vehicle.motor
    if power.model not in _OF_MOTORS or motor is None:
        return ""
    speed = vehicle.hover_speed(gravity)
    torque, friction = vehicle.drag_torque(speed), 0.0
    if power.model is PowerModel.MOTOR_WITH_FRICTION:
        friction = vehicle.friction_torque + vehicle.viscous_damping * speed
    current = (torque + friction) / motor.torque_constant
    voltage = motor.resistance * current + speed / motor.voltage_constant
    given, taken = torque * speed, voltage * current
    if given <= taken:
        return ""
    return (
        f"{_motor_constants(motor)}, since a motor in hover gives out {given:.3g} W and takes "
        f"{taken:.3g} W; {_remedy(motor)}."
    )


def contradictions(vehicle: Vehicle, power: Power, gravity: float) -> Iterator[Contradiction]:
    """Yield the physical contradictions between a vehicle's numbers.

    The function checks the motor constants, the moments of inertia and the power of hover.

    Parameters
    ----------
    vehicle : Vehicle
        The vehicle.
    power : Power
        Power model.
    gravity : float
        Acceleration of gravity [m/s²].
    """
    motor = vehicle.motor
    if motor is not None and not 1 - ROUNDED <= motor.product <= 1 + ROUNDED:
        yield Contradiction(
            field="vehicle.voltage_constant",
            message=f"{_motor_constants(motor)}; {_remedy(motor)}.",
        )
    moments = {name: getattr(vehicle, name) for name in ("Ix", "Iy", "Iz")}
    largest = max(moments, key=lambda name: moments[name])
    others = [name for name in moments if name != largest]
    most = sum(moments[name] for name in others)
    if moments[largest] > most * (1 + ROUNDED):
        yield Contradiction(
            field=f"vehicle.{largest}",
            message=f"vehicle.{largest} = {moments[largest]:.4g} kg m^2; must be at most "
            f"{' + '.join(others)} = {most:.4g} kg m^2; correct one of the three.",
        )
    hover = _hover(vehicle, power, gravity)
    if hover is not None and hover.shaft_W < hover.ideal_W * (1 - ROUNDED):
        yield Contradiction(
            field="vehicle.drag_torque_coefficient",
            message=f"{hover.start}, ideal rotors {hover.ideal_W:.4g} W at a radius of "
            f"{hover.radius}; raise it, or correct thrust_coefficient or rotor_radius.",
        )


def remarks(vehicle: Vehicle, power: Power, gravity: float) -> Iterator[str]:
    """Yield at most two remarks on numbers of a vehicle that are doubtful but not impossible.

    One remark is made if k_t k_v differs from 1 by no more than rounding explains. The other is
    made if the figure of merit (ideal power / shaft power in hover) exceeds 0.8.
    """
    motor = vehicle.motor
    # The product is 1 for a real motor. A difference up to `ROUNDED` may come from rounding of the
    # constants; a larger one is an error.
    if motor is not None and _SEEN < abs(motor.product - 1) <= ROUNDED:
        slowest = _least_speed(motor, vehicle.drag_torque_coefficient)
        at = f" below {slowest:.3g} rad/s a motor gives out more than it takes," if slowest else ""
        yield (
            f"{_motor_constants(motor)};{at} and two numbers rounded to three digits may differ by "
            f"{100 * ROUNDED:g} %."
        )
    hover = _hover(vehicle, power, gravity)
    if hover is not None:
        merit = hover.ideal_W / hover.shaft_W
        if _BEST_MERIT < merit <= 1 / (1 - ROUNDED):
            yield (
                f"{hover.start}, ideal rotors {hover.ideal_W:.4g} W at a radius of {hover.radius}: "
                f"figure of merit {merit:.2f}. Rotors of small vehicles reach {_USUAL_MERIT}, and "
                f"none much more than {_BEST_MERIT:g}; a real vehicle spends more."
            )


def _motor_constants(motor: MotorConstants) -> str:
    return (
        f"vehicle.voltage_constant = {motor.voltage_constant:.4g} rad/s/V: its product with "
        f"torque_constant = {motor.torque_constant:.4g} N m/A is {motor.product:.4g}; must be 1"
    )


def _least_speed(motor: MotorConstants, drag_torque_coefficient: float) -> float:
    """Return the rotor speed [rad/s] from which a motor gives out no more power than it takes in.

    The result is 0 unless k_t k_v > 1. `drag_torque_coefficient` is in N m s²/rad².
    """
    # If k_t k_v exceeds 1, the motor of the model creates power below the returned speed. The
    # created power is torque times speed times a constant, and grows with the third power of the
    # speed. The copper loss is resistance times current squared, and grows with the fourth
    # power. Both are equal at the returned speed.
    created = max(0.0, motor.torque_constant - 1 / motor.voltage_constant)
    return created / (motor.resistance * drag_torque_coefficient / motor.torque_constant)


def _remedy(motor: MotorConstants) -> str:
    wanted = f"give {1 / motor.torque_constant:.4g} rad/s/V, or another torque_constant"
    in_rpm = motor.voltage_constant * RPM
    if abs(in_rpm * motor.torque_constant - 1) <= 5 * ROUNDED:
        return f"{wanted}; were rpm/V meant? {motor.voltage_constant:.4g} rpm/V are {in_rpm:.4g}"
    return wanted


@dataclass(frozen=True, kw_only=True)
class _Hover:
    """Shaft power and ideal power of a vehicle in hover, and texts for messages about them.

    `start` is a text with the values of drag torque coefficient and shaft power. A message about
    hover begins with this text. `radius` is a text with rotor radius and source of this number.
    """

    start: str
    shaft_W: float
    ideal_W: float
    radius: str


def _hover(vehicle: Vehicle, power: Power, gravity: float) -> _Hover | None:
    """Return the shaft power and the ideal power of a vehicle in hover, or None.

    The result is None for the power model `momentum`, and for coaxial rotors without a given
    radius.
    """
    if power.model is PowerModel.MOMENTUM:
        return None  # this model's powers are at least those of ideal rotors
    places = vehicle.rotor_places
    radius, said = vehicle.rotor_radius, "vehicle.rotor_radius"
    if radius is None:
        radius = min((dist(*pair) / 2 for pair in combinations(places, 2)), default=inf)
        said = "the largest radius at which they do not overlap"
    if radius <= 0:
        return None  # coaxial rotors, whose disc area is not known
    speed, weight = vehicle.hover_speed(gravity), vehicle.total_mass * gravity
    shaft = len(places) * vehicle.drag_torque(speed) * speed
    disc_area = len(places) * pi * radius**2
    return _Hover(
        start=f"vehicle.drag_torque_coefficient = {vehicle.drag_torque_coefficient:.4g} N m s^2: "
        f"hover takes {shaft:.4g} W at the shafts",
        shaft_W=shaft,
        ideal_W=weight**1.5 / sqrt(2 * power.air_density * disc_area),
        radius=f"{radius:.3g} m, {said}",
    )
