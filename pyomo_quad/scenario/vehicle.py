"""Table `vehicle` of a scenario: masses, inertias, rotors, motors and drag."""

from collections.abc import Sequence
from enum import StrEnum
from math import hypot, pi, sqrt
from operator import mul
from typing import NamedTuple, Self

from pydantic import model_validator

from pyomo_quad.scenario.fields import (
    Number,
    Part,
    Sound,
    Text,
    Triple,
    WholeNumber,
    late_quantity,
    not_negative,
    positive,
    quantity,
    title_field,
)

ROTOR_COUNT = 4
MOST_ROTORS = 8
# Ahead, left, behind, right, as in the signs of eq. (7).
_CROSS = ((1, 0), (0, 1), (-1, 0), (0, -1))

_INERTIA = positive(1e-9, 1e6, "1 g at a radius of 1 mm has 1e-9, 10 t at 10 m have 1e6")
_WEIGHT = "multirotors weigh from 1 g to 10 t"
#: kg, mass carried by a vehicle.
CARRIED = not_negative(1e4, _WEIGHT)
_ROTOR_DRAG = not_negative(1e2, "from about 1e-8 for a 1 cm rotor to about 1 for a 10 m rotor")
_FITTED = Sound(-1e9, 1e9, "coefficients of a fit to f_r, which lies between 0 and 1")


# Least and greatest distance from the centre of mass to the farthest rotor [m].
_LEAST_REACH, _MOST_REACH = 1e-3, 100.0
# Tolerated unbalance of rotor positions that are typed with a few digits, as a fraction of the
# distance to the farthest rotor.
_BALANCED = 1e-4

#: rad/s in a revolution per minute.
RPM = 2 * pi / 60

# Least Gram determinant of the rotors' moments about the three axes, a measure of their linear
# independence; about 1 for rotors in a ring.
_LEAST_VOLUME = 1e-6


def _volume(*rows: Sequence[float]) -> float:
    """Return the Gram determinant of three vectors: the squared volume that they span.

    The vectors `rows` have one number per rotor, proportional to its moment about one body axis.
    Near zero, the rotors cannot produce independent moments about all three axes.
    """
    # The vectors hold one number per rotor: its coordinates along body x and body y, relative to
    # the largest arm, and its direction of rotation, 1 or -1. These determine the moments of the
    # rotor about body y, x and z.
    (a, b, c), (_, d, e), (_, _, f) = (
        [sum(map(mul, one, other)) for other in rows] for one in rows
    )
    return a * (d * f - e * e) - b * (b * f - c * e) + c * (b * e - c * d)


class EfficiencyMap(Part):
    """Coefficients of the efficiency f_r of motor and rotor, a polynomial of torque and speed.

    f_r(tau, omega) is cubic in the torque tau; each of its coefficients is (a, b, c) for the
    polynomial a omega^2 + b omega + c of the rotor speed omega.
    """

    cubic: Triple = quantity(
        "", "row of tau^3; f_r is a pure number, tau in N m, omega in rad/s", sound=_FITTED
    )
    quadratic: Triple = quantity("", "row of tau^2", sound=_FITTED)
    linear: Triple = quantity("", "row of tau", sound=_FITTED)
    constant: Triple = quantity("", "row without tau", sound=_FITTED)


_SLOW = positive(1e-2, 1e3, "rotorcraft fly below 340 m/s, the speed of sound")


class Validated(Part):
    """Limits of airspeed, climb, descent and payload up to which flight tests confirm the model."""

    airspeed: Number | None = quantity(
        "m/s", "largest airspeed of the flights that confirm the vehicle", None, sound=_SLOW
    )
    climb_speed: Number | None = quantity(
        "m/s",
        "largest climb speed of the flights that confirm the vehicle, over ground",
        None,
        sound=_SLOW,
    )
    descent_speed: Number | None = quantity(
        "m/s",
        "largest descent speed of the flights that confirm the vehicle, over ground",
        None,
        sound=_SLOW,
    )
    payload: Number | None = quantity(
        "kg", "largest payload of the flights that confirm the vehicle", None, sound=CARRIED
    )


class Attitude(StrEnum):
    """Kinematics of the attitude angles: exact, or simplified as by Yacef et al.

    `EULER` relates the rates of the angles to the body rates exactly, and includes the reaction
    moment of accelerating rotors on the body. `PAPER` follows eq. (9) and (6) of Yacef et al. as
    printed.
    """

    EULER = "euler"
    PAPER = "paper"


class MotorConstants(NamedTuple):
    """Motor constants: torque constant [N m/A], speed per voltage [rad/s/V], resistance [ohm]."""

    torque_constant: float
    voltage_constant: float
    resistance: float

    @property
    def product(self) -> float:
        """Torque constant times voltage constant (speed per voltage), both in SI units.

        The product is 1 for every real motor, because the conversion of electrical into mechanical
        power conserves energy. A motor with a larger product would create energy.
        """
        return self.torque_constant * self.voltage_constant


class Vehicle(Part):
    """Multirotor with equal rotors, by default four on arms along body x and y.

    Equations and default arrangement of the rotors follow Yacef et al.
    """

    use: Text = quantity("", "name of the vehicle in the library, or a file of its own, NAME.toml")
    title: Text = title_field("name for people")
    mass: Number = quantity(
        "kg", "mass without payload", sound=positive(1e-3, CARRIED.high, _WEIGHT)
    )
    payload: Number = quantity("kg", "mass carried, at the centre of mass", 0.0, sound=CARRIED)
    mass_deviation: Number = late_quantity(
        "kg",
        "standard deviation of the mass in flight, for an uncertain mass of vehicle or payload",
        0.0,
        sound=CARRIED,
    )
    arm_length: Number = quantity(
        "m",
        "centre of mass to rotor shaft (l)",
        sound=positive(1e-3, 100, "lengths of arms"),
    )
    Ix: Number = quantity("kg*m^2", "moment of inertia about body x", sound=_INERTIA)
    Iy: Number = quantity("kg*m^2", "moment of inertia about body y", sound=_INERTIA)
    Iz: Number = quantity("kg*m^2", "moment of inertia about body z", sound=_INERTIA)
    thrust_coefficient: Number = quantity(
        "N*s^2",
        "thrust over rotor speed squared (kb)",
        sound=positive(
            1e-12, 100, "from about 1e-10 for a 1 cm rotor to about 10 for a 10 m rotor"
        ),
    )
    drag_torque_coefficient: Number = quantity(
        "N*m*s^2",
        "drag torque over rotor speed squared (kappa)",
        sound=positive(1e-15, 100, "from about 1e-13 for a 1 cm rotor to about 1 for a 10 m rotor"),
    )
    rotor_inertia: Number = quantity(
        "kg*m^2",
        "inertia of rotor and propeller (Ir)",
        sound=positive(
            1e-12, 1e4, "from about 1e-11 for a 1 cm rotor to about 1e3 for a 10 m rotor"
        ),
    )
    torque_constant: Number | None = late_quantity(
        "N*m/A",
        "motor torque over current (kt), 1 / voltage_constant when absent",
        None,
        sound=positive(1e-6, 100, "flight motors give from 1e-6 to some N m per ampere"),
    )
    voltage_constant: Number | None = late_quantity(
        "rad/s/V",
        "motor speed over voltage (kv), 1 / torque_constant when absent",
        None,
        sound=positive(1e-2, 1e5, "flight motors turn at 0.1 to 10,000 rad/s per volt"),
        unit_keys={"kv_rpm_per_V": RPM},
    )
    motor_resistance: Number | None = late_quantity(
        "ohm",
        "winding resistance (R)",
        None,
        sound=positive(1e-6, 1e3, "windings have from micro-ohms to hundreds of ohms"),
    )
    friction_torque: Number = quantity(
        "N*m",
        "dry friction of one motor (Tf)",
        0.0,
        sound=not_negative(100, "friction of bearings is smaller"),
    )
    viscous_damping: Number = quantity(
        "N*m*s",
        "viscous friction of one motor (Df)",
        0.0,
        sound=not_negative(1, "friction of bearings is smaller"),
    )
    drag_linear: Number = quantity(
        "kg/s",
        "linear drag on the relative airspeed",
        0.0,
        sound=not_negative(1e4, "a frontal area of 100 m^2 has about 1e3"),
    )
    drag_quadratic: Number = quantity(
        "kg/m",
        "quadratic drag on the relative airspeed",
        0.0,
        sound=not_negative(1e3, "a frontal area of 100 m^2 has about 1e2"),
    )
    efficiency_map: EfficiencyMap | None = late_quantity(
        "", "efficiency: the recovered function f_r", None
    )
    rotor_radius: Number | None = late_quantity(
        "m",
        "momentum: radius of one rotor (R)",
        None,
        sound=positive(1e-3, 100, "rotor radii range from 1 mm to 100 m"),
    )
    induced_power_factor: Number = late_quantity(
        "1",
        "momentum: induced power divided by the induced power of an ideal rotor",
        1.0,
        ge=1,
        le=10,
    )
    profile_power_coefficient: Number = late_quantity(
        "1", "momentum: profile power over thrust^1.5 / sqrt(density * disc area)", 0.0, ge=0, le=10
    )
    profile_advance_factor: Number = late_quantity(
        "1", "momentum: growth of profile power with the advance ratio squared", 4.65, ge=0, le=100
    )
    climb_power_factor: Number = late_quantity(
        "1", "momentum: power over thrust times axial airspeed, in climb", 1.0, ge=0, le=10
    )
    descent_power_factor: Number = late_quantity(
        "1", "momentum: power over thrust times axial airspeed, in descent", 1.0, ge=0, le=10
    )
    electronics_power: Number = late_quantity(
        "W",
        "momentum: power of all but the motors",
        0.0,
        sound=not_negative(1e5, "onboard electronics draw milliwatts to kilowatts"),
    )
    anemometer_factor: Number = late_quantity(
        "1", "logs: true airspeed over the reading of the vehicle's anemometer", 1.0, gt=0, le=10
    )
    rotor_positions: tuple[tuple[Number, Number], ...] | None = late_quantity(
        "m", "position of each rotor along body x and y; by default a cross of four arms", None
    )
    rotor_spins: tuple[WholeNumber, ...] | None = late_quantity(
        "1",
        "direction of each rotor from above: 1 clockwise, -1 the other way; by default alternating",
        None,
    )
    rotor_drag_plane: Number = late_quantity(
        "kg/rad",
        "drag in the rotor plane over airspeed and rotor speed, of one rotor (Mellinger)",
        0.0,
        sound=_ROTOR_DRAG,
    )
    rotor_drag_axis: Number = late_quantity(
        "kg/rad",
        "loss of thrust over axial airspeed and rotor speed, of one rotor (Svacha, Mohta, Kumar)",
        0.0,
        sound=_ROTOR_DRAG,
    )
    translational_lift: Number = late_quantity(
        "kg/m",
        "thrust over in-plane airspeed squared, of one rotor (Faessler, Franchi, Scaramuzza)",
        0.0,
        sound=not_negative(1e3, "a frontal area of 100 m^2 has about 1e2"),
    )
    parasitic_drag: Triple = late_quantity(
        "kg/m",
        "drag over airspeed squared, along body x, y and z",
        (0.0, 0.0, 0.0),
        sound=Sound(0, 1e3, "a frontal area of 100 m^2 has about 1e2"),
    )
    motor_time_constant: Number = late_quantity(
        "s",
        "time constant of the motors: a rotor accelerates by at most (rotor_speed_max - speed) / "
        "motor_time_constant",
        0.0,
        sound=not_negative(1e3, "rotors take from 1 ms to minutes to reach their speed"),
    )
    attitude: Attitude = late_quantity(
        "",
        "euler: exact kinematics and the rotors' yaw reaction; paper: eqs. (6) and (9) "
        "of Yacef et al. as printed",
        Attitude.PAPER,
        initial=Attitude.EULER,
    )

    validated: Validated = late_quantity("", "range that measurements confirm", Validated())

    @property
    def total_mass(self) -> float:
        """Mass in flight, payload included [kg]."""
        return self.mass + self.payload

    @model_validator(mode="after")
    def _rotors_hover_at_one_speed(self) -> Self:
        places, spins = self.rotor_places, self.rotor_senses
        if not ROTOR_COUNT <= len(places) <= MOST_ROTORS:
            raise ValueError(
                f"rotor_positions has {len(places)} rotors; must have {ROTOR_COUNT} to "
                f"{MOST_ROTORS}"
            )
        if len(spins) != len(places) or set(spins) - {-1, 1}:
            raise ValueError(
                f"rotor_spins must give 1 or -1 for each of the {len(places)} rotors; correct it"
            )
        reach = max(hypot(*place) for place in places)
        if not _LEAST_REACH <= reach <= _MOST_REACH:
            raise ValueError(
                f"rotor_positions reach {reach:g} m; must reach {_LEAST_REACH:g} to "
                f"{_MOST_REACH:g} m from the centre of mass"
            )
        moments = (*map(sum, zip(*places, strict=True)), sum(spins))
        if any(abs(moment) > _BALANCED * reach for moment in moments):
            raise ValueError(
                "rotor_positions and rotor_spins must each add up to zero: at one speed the rotors "
                "are to hover without a moment"
            )
        x, y = ([along / reach for along in axis] for axis in zip(*places, strict=True))
        if _volume(x, y, spins) < _LEAST_VOLUME:
            raise ValueError(
                "rotor_positions and rotor_spins cannot turn the vehicle about every axis; place "
                "the rotors off one line and let their spins alternate"
            )
        return self

    @property
    def rotor_places(self) -> tuple[tuple[float, float], ...]:
        """Position of each rotor along body x and y [m]."""
        if self.rotor_positions is not None:
            return self.rotor_positions
        return tuple((ahead * self.arm_length, aside * self.arm_length) for ahead, aside in _CROSS)

    @property
    def rotor_senses(self) -> tuple[int, ...]:
        """Direction in which each rotor's drag turns the body: 1 for +yaw, -1 for -yaw."""
        if self.rotor_spins is not None:
            return self.rotor_spins
        return tuple(1 - 2 * (j % 2) for j in range(len(self.rotor_places)))

    @property
    def has_own_rotors(self) -> bool:
        """Whether the scenario gives positions or directions of rotation of the rotors.

        The default is four rotors in a cross along body x and y.
        """
        return self.rotor_positions is not None or self.rotor_spins is not None

    @property
    def has_rotor_forces(self) -> bool:
        """Whether aerodynamic forces on the rotors other than thrust are modelled.

        The forces are rotor drag and translational lift.
        """
        return bool(self.rotor_drag_plane or self.rotor_drag_axis or self.translational_lift)

    @property
    def motor(self) -> MotorConstants | None:
        """Electrical constants of the motors; None if one of them is unknown.

        The constants are the torque constant, the speed per voltage and the resistance.
        """
        told = (self.torque_constant, self.voltage_constant, self.motor_resistance)
        if None in told:
            return None
        return MotorConstants(*(number for number in told if number is not None))

    def drag_torque(self, speed: float) -> float:
        """Return the torque [N m] that keeps one rotor at a constant speed against its air drag.

        `speed` is the rotor speed [rad/s].
        """
        return self.drag_torque_coefficient * speed**2

    def hover_speed(self, gravity: float) -> float:
        """Return the rotor speed at which the thrust balances the weight.

        Parameters
        ----------
        gravity : float
            Acceleration of gravity [m/s²].

        Returns
        -------
        float
            Speed of each rotor [rad/s].
        """
        return sqrt(self.total_mass * gravity / (len(self.rotor_places) * self.thrust_coefficient))
