"""Estimation of a vehicle's model parameters from the few data that its owner knows.

The owner states at least the vehicle's mass and the size of its propellers. From these and optional
data, such as the length of the arms, the module estimates all numbers of the vehicle that a
scenario needs: model parameters, limits, and the battery. Each estimate has a range of uncertainty.

Derivation: see docs/theory/vehicle_from_data.md.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import cos, pi, sin, sqrt

from pyomo_quad.scenario import ScenarioError, library_entry
from pyomo_quad.scenario.vehicle import RPM
from pyomo_quad.scenario.wind import SEA_LEVEL_DENSITY
from pyomo_quad.vehicles.estimate import Estimate, Kind, computed, estimated, given
from pyomo_quad.vehicles.inertia import MassModel
from pyomo_quad.vehicles.pack import Pack, usual_pack
from pyomo_quad.vehicles.propulsion import INDUCED, Propeller, RotorHover

GRAVITY = 9.81
ROTOR_COUNTS = (4, 6, 8)
# Distance between the shafts of neighbouring rotors, relative to their diameter. Assumed: rotors do
# not overlap.
_SPACING = 1.25
# Motor constant (torque squared over copper loss) [(N m)²/W] of a motor of 1 kg; it is proportional
# to the mass to the power of 5/3. Both are the regression of Budinger et al. (2020).
_MOTOR_CONSTANT, _MOTOR_EXPONENT = 0.15, 5 / 3
# Ratio of the rotor speeds at full throttle and in hover, if the speed constant is unknown: the
# thrust is then 1.8^2 times the weight. Fraction of the pack's nominal voltage at the motors at
# full throttle: the rest is the drop over pack and controllers. Both are assumed.
_FULL_OVER_HOVER, _FULL_VOLTAGE = 1.8, 0.85
# Mass of a 10-inch propeller [kg], and the exponent of its growth with the diameter, less than the
# 3 of blades of one shape. Assumed; the inertia of rotors is uncertain by a factor of 2.
_PROPELLER_KG, _PROPELLER_EXPONENT, _TEN_INCHES_M = 0.012, 2.5, 0.254
# Radius of a motor's bell, which turns with the propeller, over the propeller's radius. Assumed.
_BELL_SHARE = 0.1
# Power of the electronics of a vehicle of 1.5 kg [W], and the exponent of their growth with its
# mass. Assumed: a few per cent of the power in flight.
_ELECTRONICS_W, _ELECTRONICS_EXPONENT, _AT_KG = 5.0, 0.4, 1.5
# Library vehicle whose drag and power of descent are assumed for other vehicles. The drag was
# determined from the tilt in flight, the power of descent from 120 flights.
_MEASURED = "dji_matrice_100"
# Exponent of the growth of quadratic drag with the mass; the area of equal shapes grows likewise.
_AREA_EXPONENT = 2 / 3
# Limit of roll and pitch [degrees]: the default of autopilots.
_TILT_DEG = 35.0
# Least share of the voltage that counts as left for acceleration at hover: rotors accelerate
# whatever the speed constant is.
_LEAST_SPARE = 0.1
#: Relative error of a measured hover power, caused by the gain of the current sensor and by wind.
MEASUREMENT_ERROR = 0.03
#: Factors at the ends of their ranges, on the loss of motor and speed controller, which cover the
#: 15 % within which the hover powers of data sheets come out, and on the blades' drag, assumed for
#: blades of other makers.
DRIVE_RANGE, BLADE_RANGE = (0.85, 1.2), (0.6, 1.6)
# Factors on an estimate at the ends of its range. Assumed, from what they mean for a vehicle.
_RANGES = {
    "arm_length": (0.85, 1.3),  # neighbouring rotors 1.06 to 1.6 diameters apart
    "inertia": (0.6, 1.6),  # frames with other shares of the mass at the arms' ends
    "thrust_coefficient": (0.85, 1.2),  # propellers of other makers than the regression's
    "drag_torque_coefficient": (0.8, 1.3),  # figures of merit of 0.5 to 0.85 in place of 0.676
    "rotor_inertia": (0.5, 2.0),  # propellers of 6 to 24 g at 10 inches
    "voltage_constant": (0.7, 1.6),  # full throttle at 1.26 to 2.9 times the speed of hover
    "motor_resistance": (0.4, 2.5),  # motors of other shapes than the regression's
    "descent_power_factor": (0.5, 1.5),  # measured on one vehicle
    "electronics_power": (0.4, 2.5),  # 2 to 12.5 W at 1.5 kg
    "drag_linear": (0.4, 3.0),  # measured on one vehicle
    "drag_quadratic": (0.5, 2.0),  # measured on one vehicle
    "tilt": (0.6, 1.3),  # 21 to 45 degrees
    "rotor_speed_max": (0.8, 1.1),  # a pack from nearly empty to full
    "rotor_acceleration_max": (0.3, 1.5),  # controllers may limit the current
}


@dataclass(frozen=True, kw_only=True)
class Known:
    """Data that the owner of a vehicle knows, in SI units.

    `arm`, `voltage_constant`, `pack` and `hover_power` are None if the owner does not know them.

    Attributes
    ----------
    name : str
        Name of the vehicle.
    mass : float
        Mass with battery.
    propeller : Propeller
        Diameter and pitch.
    arm : float or None
        Distance from the centre to a motor shaft.
    voltage_constant : float or None
        Motor speed over voltage [rad/s/V].
    pack : Pack or None
        Battery.
    hover_power : float or None
        Measured electrical power of the whole vehicle in hover.
    hover_said : str
        Measurement in words, such as "8 A at 15 V", or empty.
    rotors : int
        Number of rotors.
    density : float
        Air density.
    """

    name: str
    mass: float
    propeller: Propeller
    arm: float | None = None
    voltage_constant: float | None = None
    pack: Pack | None = None
    hover_power: float | None = None
    hover_said: str = ""
    rotors: int = 4
    density: float = SEA_LEVEL_DENSITY


@dataclass(frozen=True, kw_only=True)
class EstimatedVehicle:
    """Vehicle estimated from its owner's data, with the origin of every number.

    Attributes
    ----------
    known : Known
        The owner's data.
    pack : Pack
        Battery.
    hover : RotorHover
        Speed and powers of one rotor.
    fields, limits : mapping
        Estimates by field of the scenario's tables `vehicle` and `limits`.
    rotor_positions : tuple or None
        Positions x, y of six or eight rotors [m]; None for four.
    estimated_hover_W : float
        Hover power from the estimates alone, even if it was measured.
    """

    known: Known
    pack: Pack
    hover: RotorHover
    fields: Mapping[str, Estimate]
    limits: Mapping[str, Estimate]
    rotor_positions: tuple[tuple[float, float], ...] | None
    #: Hover power from the estimates alone, W, even if it was measured.
    estimated_hover_W: float

    @property
    def is_measured(self) -> bool:
        """Whether the owner has measured the hover power.

        If so, the rotor power of the model is scaled to the measurement.
        """
        return self.known.hover_power is not None


def estimate_vehicle(known: Known) -> EstimatedVehicle:
    """Estimate all numbers of a vehicle from its owner's data, with ranges and origins.

    ScenarioError is raised if the data contradict each other, for example if the motors are too
    slow to hover, or if the number of rotors is not 4, 6 or 8.
    """
    pack = known.pack or usual_pack(known.mass)
    thrust = known.mass * GRAVITY / known.rotors
    hover = known.propeller.hover(thrust, known.density)
    arm = _arm(known)
    model = MassModel(mass=known.mass, pack_mass=pack.mass, arm=arm.value, rotors=known.rotors)
    constants = _motor(known, pack, hover, model)
    powers, alone = _powers(known, hover)
    fields = {
        "mass": given(known.mass, "--mass, with its pack"),
        "arm_length": arm,
        **_inertias(model),
        **_rotor(known, hover, model),
        **constants,
        **powers,
        **_drag(known.mass),
    }
    vehicle = EstimatedVehicle(
        known=known,
        pack=pack,
        hover=hover,
        fields=fields,
        limits=_limits(pack, hover, fields),
        rotor_positions=_positions(known.rotors, arm.value),
        estimated_hover_W=alone,
    )
    if vehicle.limits["rotor_speed_max"].value < hover.speed:
        kv = constants["voltage_constant"].value / RPM
        raise ScenarioError(
            f"--kv {kv:.4g} rpm/V: at {pack.label} the rotors turn at "
            f"{vehicle.limits['rotor_speed_max'].value:.4g} rad/s at most, and hover needs "
            f"{hover.speed:.4g}; correct kv, the battery, the mass or the propeller."
        )
    return vehicle


def _ranged(field: str, value: float, said: str) -> Estimate:
    """Return an estimated value with the relative uncertainty that is typical of its field.

    `field` is a key of the table of ranges `_RANGES`. `said` is the value's origin in words, such
    as a formula or publication.
    """
    return estimated(value, said, *_RANGES[field])


def _arm(known: Known) -> Estimate:
    if known.arm is not None:
        return given(known.arm, "--arm")
    length = _SPACING * known.propeller.diameter / (2 * sin(pi / known.rotors))
    return _ranged("arm_length", length, "neighbouring rotors 1.25 diameters apart")


def _inertias(model: MassModel) -> dict[str, Estimate]:
    said = "mass model: 22 % of the mass without the pack at the ends of the arms, 15 % in them"
    names = ("Ix", "Iy", "Iz")
    return {
        name: _ranged("inertia", value, said)
        for name, value in zip(names, model.moments(), strict=True)
    }


def _rotor(known: Known, hover: RotorHover, model: MassModel) -> dict[str, Estimate]:
    propeller = known.propeller
    blades = _PROPELLER_KG * (propeller.diameter / _TEN_INCHES_M) ** _PROPELLER_EXPONENT
    bell = 0.5 * model.motor * (_BELL_SHARE * propeller.radius) ** 2
    thrust = propeller.thrust_over_speed_squared(known.density)
    return {
        "rotor_radius": given(propeller.radius, "--propeller, half the diameter"),
        "thrust_coefficient": _ranged(
            "thrust_coefficient", thrust, "C_T = 0.0427 + 0.144 p/D (Budinger et al. 2020)"
        ),
        "drag_torque_coefficient": _ranged(
            "drag_torque_coefficient",
            hover.torque / hover.speed**2,
            f"shaft power of hover, figure of merit {hover.figure_of_merit:.2f} (blade element)",
        ),
        "rotor_inertia": _ranged(
            "rotor_inertia",
            blades * propeller.diameter**2 / 12 + bell,
            f"thin blade of {1e3 * blades:.2g} g and the motor's bell",
        ),
    }


def _motor(known: Known, pack: Pack, hover: RotorHover, model: MassModel) -> dict[str, Estimate]:
    if known.voltage_constant is not None:
        speed_constant = given(known.voltage_constant, "--kv, rpm/V times 2 pi/60")
    else:
        full = _FULL_OVER_HOVER * hover.speed
        speed_constant = _ranged(
            "voltage_constant",
            full / (_FULL_VOLTAGE * pack.nominal_voltage),
            f"full throttle at {_FULL_OVER_HOVER:g} times the speed of hover",
        )
    torque_constant = 1 / speed_constant.value
    weight = model.motor
    resistance = torque_constant**2 / (_MOTOR_CONSTANT * weight**_MOTOR_EXPONENT)
    return {
        "voltage_constant": speed_constant,
        "torque_constant": computed(torque_constant, "1 / voltage_constant"),
        "motor_resistance": _ranged(
            "motor_resistance",
            resistance,
            f"kt^2 / (0.15 m^(5/3)) of a motor of {1e3 * weight:.2g} g",
        ),
    }


def _powers(known: Known, hover: RotorHover) -> tuple[dict[str, Estimate], float]:
    """Return the parameters of the power model `momentum`, and the estimated hover power [W].

    A measured hover power scales the parameters. ScenarioError is raised if it is less than
    electronics and ideal rotors take.
    """
    electronics = _ELECTRONICS_W * (known.mass / _AT_KG) ** _ELECTRONICS_EXPONENT
    loss = 1 / hover.drive_efficiency
    alone = known.rotors * hover.shaft_power * loss + electronics
    low, high = DRIVE_RANGE
    kind, said = Kind.ESTIMATED, f"drive efficiency {hover.drive_efficiency:.2f} by shaft power"
    factor = loss
    if known.hover_power is not None:
        if known.hover_power <= electronics:
            raise ScenarioError(
                f"hover: {known.hover_power:.4g} W is no more than the electronics' "
                f"{electronics:.3g} W; must be the power of the whole vehicle aloft."
            )
        factor = loss * (known.hover_power - electronics) / (alone - electronics)
        kind, said = Kind.MEASURED, f"{known.hover_said}, over {alone:.4g} W by the estimates"
        low, high = 1 - MEASUREMENT_ERROR, 1 + MEASUREMENT_ERROR
        # No rotor hovers with less than its ideal power.
        ideal = known.rotors * hover.ideal_power
        if known.hover_power - electronics < ideal:
            raise ScenarioError(
                f"hover: {known.hover_power:.4g} W; ideal rotors of this size and mass take "
                f"{ideal:.4g} W; correct the hover current and voltage, the mass or the propeller."
            )

    def number(value: float, words: str, least: float = low, most: float = high) -> Estimate:
        scaled = value * factor
        return Estimate(
            value=scaled, low=least * scaled, high=most * scaled, kind=kind, said=f"{words}, {said}"
        )

    blade_low, blade_high = BLADE_RANGE
    induced = number(INDUCED, "1.15 times an ideal rotor's over the drive efficiency")
    flown = library_entry("vehicles", _MEASURED).values()
    share = flown["vehicle.descent_power_factor"] / flown["vehicle.induced_power_factor"]
    climb = number(1.0, "momentum theory's 1 over the drive efficiency")
    powers = {
        "induced_power_factor": replace(
            induced, value=max(induced.value, 1.0), low=max(induced.low, 1.0)
        ),
        "profile_power_coefficient": number(
            hover.profile_over_thrust,
            "blade element, sigma c_d / 8 over C_T^1.5",
            low * blade_low,
            high * blade_high,
        ),
        "climb_power_factor": climb,
        "descent_power_factor": _ranged(
            "descent_power_factor",
            share * induced.value,
            "share of the induced power: the Matrice 100's",
        ),
        "electronics_power": _ranged("electronics_power", electronics, "5 W (mass / 1.5 kg)^0.4"),
    }
    return powers, alone


def _drag(mass: float) -> dict[str, Estimate]:
    flown = library_entry("vehicles", _MEASURED).values()
    larger = mass / flown["vehicle.mass"]
    linear, quadratic = "drag_linear", "drag_quadratic"
    slope, area = (flown[f"vehicle.{name}"] for name in (linear, quadratic))
    area *= larger**_AREA_EXPONENT
    return {
        linear: _ranged(linear, larger * slope, "the Matrice 100's by mass"),
        quadratic: _ranged(quadratic, area, "the Matrice 100's by mass^(2/3)"),
    }


def _limits(pack: Pack, hover: RotorHover, fields: Mapping[str, Estimate]) -> dict[str, Estimate]:
    speed_constant = fields["voltage_constant"].value
    torque_constant, resistance = fields["torque_constant"].value, fields["motor_resistance"].value
    drag, inertia = fields["drag_torque_coefficient"].value, fields["rotor_inertia"].value
    voltage = _FULL_VOLTAGE * pack.nominal_voltage
    # Greatest speed: there the electromotive force and the resistive drop add up to the voltage.
    copper, back = resistance * drag / torque_constant, 1 / speed_constant
    fastest = (sqrt(back**2 + 4 * copper * voltage) - back) / (2 * copper)
    spare = max(voltage - back * hover.speed, _LEAST_SPARE * voltage)
    jerk = (torque_constant * spare / resistance - hover.torque) / inertia
    tilt = _TILT_DEG * pi / 180
    said = "autopilots' usual 35 degrees"
    return {
        "roll_max": _ranged("tilt", tilt, said),
        "pitch_max": _ranged("tilt", tilt, said),
        "rotor_speed_min": given(0.0, "none"),
        "rotor_speed_max": _ranged(
            "rotor_speed_max", fastest, f"full throttle on {voltage:.3g} V by kv and resistance"
        ),
        "rotor_acceleration_max": _ranged(
            "rotor_acceleration_max", max(jerk, hover.speed), f"{voltage:.3g} V on a motor at hover"
        ),
    }


def _positions(rotors: int, arm: float) -> tuple[tuple[float, float], ...] | None:
    """Return the body coordinates x, y [m] of six or eight rotors, equally spaced on a circle.

    The result is None for four rotors. Any other number raises ScenarioError.
    """
    if rotors not in ROTOR_COUNTS:
        raise ScenarioError(
            f"--rotors {rotors}; must be one of {', '.join(map(str, ROTOR_COUNTS))}."
        )
    # For four rotors, the model needs only the length of the arms.
    if rotors == ROTOR_COUNTS[0]:
        return None
    angles = [2 * pi * k / rotors for k in range(rotors)]
    return tuple((round(arm * cos(a), 6), round(arm * sin(a), 6)) for a in angles)
