"""Moments of inertia of a multirotor, from a mass model of arms, motors, battery and body.

Derivation: see docs/theory/vehicle_from_data.md, eq. (9).
"""

from dataclasses import dataclass

# Fractions of the mass without battery of multirotors of 0.5 to 4 kg: motors with propellers and
# speed controllers, at the ends of the arms; and the arms, rods from the centre. The rest of the
# mass is a cylinder.
_MOTOR_SHARE, _ARM_SHARE = 0.22, 0.15
# Radius and height of the cylinder relative to the arm; width and height of the battery relative to
# its length.
_BODY_RADIUS, _BODY_HEIGHT = 0.35, 0.3
_PACK_WIDTH, _PACK_HEIGHT = 0.31, 0.26
_PACK_DENSITY = 2300.0  # kg/m^3


@dataclass(frozen=True, kw_only=True)
class MassModel:
    """Mass model of a multirotor: arms with motors at their ends, cylindrical body and battery.

    Attributes
    ----------
    mass, pack_mass : float
        Total mass, and mass of the battery [kg].
    arm : float
        Distance from the centre to a motor shaft [m].
    rotors : int
        Number of rotors.
    """

    mass: float
    pack_mass: float
    arm: float
    rotors: int

    @property
    def empty(self) -> float:
        """Mass without the battery [kg], but never less than half of the total mass."""
        return max(self.mass - self.pack_mass, 0.5 * self.mass)

    @property
    def motor(self) -> float:
        """Mass of motor, propeller and speed controller at the end of one arm [kg]."""
        return _MOTOR_SHARE * self.empty / self.rotors

    def moments(self) -> tuple[float, float, float]:
        """Return the moments of inertia about body x, y and z [kg m²].

        Derivation: see docs/theory/vehicle_from_data.md, eq. (9).
        """
        tips = _MOTOR_SHARE * self.empty * self.arm**2
        arms = _ARM_SHARE * self.empty * self.arm**2 / 3
        body = (1 - _MOTOR_SHARE - _ARM_SHARE) * self.empty
        radius, height = _BODY_RADIUS * self.arm, _BODY_HEIGHT * self.arm
        pack = self.mass - self.empty
        volume = pack / _PACK_DENSITY
        length = (volume / (_PACK_WIDTH * _PACK_HEIGHT)) ** (1 / 3)
        wide, high = _PACK_WIDTH * length, _PACK_HEIGHT * length
        across = (tips + arms) / 2 + body * (3 * radius**2 + height**2) / 12
        return (
            across + pack * (wide**2 + high**2) / 12,
            across + pack * (length**2 + high**2) / 12,
            tips + arms + body * radius**2 / 2 + pack * (length**2 + wide**2) / 12,
        )
