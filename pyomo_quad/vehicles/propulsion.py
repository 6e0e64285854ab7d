"""Thrust, torque and losses of propeller and motor, from diameter and pitch.

Derivation, sources and ranges: see docs/theory/vehicle_from_data.md, eqs. (1) to (4).

symbol | name | unit | meaning
D, p | diameter, pitch | m | nominal; a label such as "10x4.5" on the propeller gives them in inches
C_T | coefficient | - | thrust = C_T rho n^2 D^4, with air density rho and n revolutions per second
sigma | _SOLIDITY | - | blade area divided by disc area
c_d | _DRAG_AT | - | mean drag coefficient of the blade, at the Reynolds number _REYNOLDS_AT
FM | figure_of_merit | - | ideal power divided by shaft power, in hover
eta | drive_efficiency | - | shaft power divided by electrical power of motor and speed controller
"""

import re
from dataclasses import dataclass
from math import pi, sqrt

from pyomo_quad.scenario import ScenarioError
from pyomo_quad.scenario.messages import shown

_INCH_M = 0.0254
_SIZE = re.compile(r"([0-9]{1,2}(?:\.[0-9]{1,3})?)\s*[xX*]\s*([0-9]{1,2}(?:\.[0-9]{1,3})?)")
# C_T = a + b p/D of 2-bladed propellers for multirotors: Budinger, Reysset, Ochotorena, Delbecq,
# "Scaling laws and similarity models for the preliminary design of multirotor drones", Aerospace
# Science and Technology 98 (2020), to APC's data.
_THRUST_FIT = (0.0427, 0.144)
_USUAL_PITCH = 0.45  # pitch over diameter, where the label gives no pitch
# Blade area over disc area of APC's 10 x 4.7, and the mean drag coefficient of its blades at a
# Reynolds number: from the static test of the UIUC propeller data site, C_T = 0.1228 and
# C_P = 0.0508 at 5417 rpm.
_SOLIDITY = 0.11
_DRAG_AT, _REYNOLDS_AT = 0.034, 8.0e4
_KINEMATIC_VISCOSITY = 1.5e-5  # m^2/s, air at 15 degrees
#: Induced power relative to that of an ideal rotor: Leishman (2006), section 3.2.
INDUCED = 1.15
# P_1 and b of the drive efficiency eta = 1 / (1 + (P_1 / P)^b), P being the shaft power of a rotor.
_HALF_LOST_W, _LOSS_EXPONENT = 2.6, 0.3


@dataclass(frozen=True, kw_only=True)
class Propeller:
    """Propeller, described by its diameter and pitch.

    Attributes
    ----------
    diameter, pitch : float
        Diameter and pitch [m].
    """

    diameter: float
    pitch: float

    @property
    def radius(self) -> float:
        """Radius of the propeller [m]."""
        return self.diameter / 2

    @property
    def disc_area(self) -> float:
        """Area that the blades sweep [m²]."""
        return pi * self.radius**2

    @property
    def coefficient(self) -> float:
        """Static thrust coefficient C_T: thrust divided by rho n² D⁴.

        In this formula, rho is the air density, n the revolutions per second and D the diameter.

        Derivation: see docs/theory/vehicle_from_data.md, eq. (1).
        """
        first, second = _THRUST_FIT
        return first + second * self.pitch / self.diameter

    def thrust_over_speed_squared(self, density: float) -> float:
        """Return the thrust divided by the square of the rotor speed in rad/s [N s²].

        `density` is the air density [kg/m³]. Derivation: see docs/theory/vehicle_from_data.md, eq.
        (1).
        """
        return self.coefficient * density * self.diameter**4 / (2 * pi) ** 2

    def hover(self, thrust: float, density: float) -> "RotorHover":
        """Return the speed and the powers of one rotor in hover.

        `thrust` is the thrust of the rotor [N], `density` the air density [kg/m³].
        """
        speed = sqrt(thrust / self.thrust_over_speed_squared(density))
        # Thrust coefficient of blade element theory, T / (rho A (omega R)^2).
        blade = 4 / pi**3 * self.coefficient
        chord = _SOLIDITY * pi * self.radius / 2
        reynolds = 0.75 * speed * self.radius * chord / _KINEMATIC_VISCOSITY
        profile = _SOLIDITY / 8 * _DRAG_AT * sqrt(_REYNOLDS_AT / reynolds)
        ideal = thrust * sqrt(thrust / (2 * density * self.disc_area))
        induced = INDUCED * ideal
        return RotorHover(
            speed=speed,
            ideal_power=ideal,
            induced_power=induced,
            profile_power=profile / (blade**1.5 / sqrt(2)) * ideal,
            profile_over_thrust=profile / blade**1.5,
        )


@dataclass(frozen=True, kw_only=True)
class RotorHover:
    """Speed and powers of one rotor in hover.

    Attributes
    ----------
    speed : float
        Rotor speed [rad/s].
    ideal_power : float
        Power of an ideal rotor with equal thrust and disc area [W].
    induced_power : float
        Power that accelerates the air downwards [W].
    profile_power : float
        Power that overcomes the drag of the blades [W].
    profile_over_thrust : float
        Profile power divided by T^1.5 / sqrt(rho A), with thrust T, air density rho and disc area
        A.
    """

    speed: float
    ideal_power: float
    induced_power: float
    profile_power: float
    profile_over_thrust: float

    @property
    def shaft_power(self) -> float:
        """Power of the shaft [W]: induced power plus profile power.

        Derivation: see docs/theory/vehicle_from_data.md, eq. (2).
        """
        return self.induced_power + self.profile_power

    @property
    def torque(self) -> float:
        """Torque of the shaft [N m]."""
        return self.shaft_power / self.speed

    @property
    def figure_of_merit(self) -> float:
        """Figure of merit: power of an ideal rotor divided by shaft power."""
        return self.ideal_power / self.shaft_power

    @property
    def drive_efficiency(self) -> float:
        """Efficiency of motor and speed controller: shaft power divided by electrical power.

        Derivation: see docs/theory/vehicle_from_data.md, eq. (4).
        """
        return 1 / (1 + (_HALF_LOST_W / self.shaft_power) ** _LOSS_EXPONENT)


def propeller_of(text: str) -> Propeller:
    """Read a propeller label such as "10x4.5": diameter and pitch in inches.

    If the label gives no pitch, a usual ratio of pitch to diameter is assumed.

    Raises
    ------
    ScenarioError
        If the text is not a propeller label.
    """
    match = _SIZE.fullmatch(text.strip()) or _SIZE.fullmatch(f"{text.strip()}x0")
    if match is None or not 0.5 <= float(match[1]) <= 60:
        raise ScenarioError(
            f"--propeller {shown(text)[1:-1]}; must be DIAMETERxPITCH in inches, such as 10x4.5."
        )
    diameter = float(match[1]) * _INCH_M
    pitch = float(match[2]) * _INCH_M or _USUAL_PITCH * diameter
    return Propeller(diameter=diameter, pitch=pitch)
