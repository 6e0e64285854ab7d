"""Tables `baseline`, `power`, `solver` and `limits` of a scenario, and the controller's gains."""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from functools import partial
from math import acos, cos, pi
from typing import Annotated, Any, Self

from pydantic import Field, model_validator

from pyomo_quad.scenario.accuracy import FIGURES, Accuracy
from pyomo_quad.scenario.fields import (
    Flag,
    Number,
    Part,
    Sound,
    WholeNumber,
    late_quantity,
    not_negative,
    positive,
    quantity,
)
from pyomo_quad.scenario.vehicle import Vehicle
from pyomo_quad.scenario.wind import SEA_LEVEL_DENSITY

_MILLISECONDS = "motors and sensors respond within milliseconds"
_rate = partial(quantity, "1/s", sound=positive(1e-3, 1e4, _MILLISECONDS))
_adaptation = partial(quantity, "1/s^2", sound=not_negative(1e6, _MILLISECONDS))
_FORCE = positive(1e-3, 1e4, "accelerations stay below 1000 g")
_SPEED = Sound(1e-3, 1e3, "rotorcraft fly below 340 m/s, the speed of sound")
_MOST_SPEEDS = 20


class Reference(StrEnum):
    """Reference trajectory that the controller follows in a baseline flight.

    `STEP` commands the goal at once, `QUINTIC` and `MINIMUM_SNAP` are polynomials of time, `PLAN`
    is the minimum-energy plan, and `CRUISE` flies like an autopilot with limited speed,
    acceleration and jerk.
    """

    STEP = "step"
    QUINTIC = "quintic"
    MINIMUM_SNAP = "minimum_snap"
    PLAN = "plan"
    CRUISE = "cruise"


#: References whose flights last as long as the mission; cruise has a duration of its own.
MISSION_TIMED = tuple(reference for reference in Reference if reference is not Reference.CRUISE)


class Gains(Part):
    """Gains of the adaptive backstepping controller, per unit of mass and of inertia.

    Because of the division by mass and inertia, the defaults suit vehicles of any size. The default
    gains place the poles of the position error at 1.5 and 3 rad/s, of the tilt command at 12 rad/s,
    of the attitude error at 6 and 15 rad/s and of the rotors at 60 rad/s. The
    attitude is thus controlled at least twice as fast as the position, and the rotors four times as
    fast as the attitude. The response to a step of the position command settles in less than 3 s.
    """

    position: Number = _rate("position error to velocity (k1)", 1.5)
    velocity: Number = _rate("velocity error to acceleration (k2)", 3.0)
    speed_max: Number = quantity(
        "m/s", "largest speed of approach to a distant goal", 3.0, gt=0, sound=_SPEED
    )
    acceleration_max: Number = quantity(
        "m/s^2", "largest correcting acceleration", 2.0, sound=_FORCE
    )
    tilt_max: Number | None = quantity(
        "rad",
        "largest tilt that the position loop commands; when absent, the largest that the limits of "
        "roll, pitch and thrust allow",
        None,
        lt=1.5,
        sound=positive(1e-3, 1.5, "a smaller tilt cannot steer the vehicle"),
    )
    thrust_share: Number = quantity(
        "1",
        "share of the thrust in excess of the weight that the position loop may use",
        0.9,
        le=1,
        sound=positive(1e-3, 1, "a smaller share of thrust cannot steer the vehicle"),
    )
    tilt_command: Number = _rate("tilt error to tilt rate, of the filter", 6.0)
    attitude: Number = _rate("roll and pitch error to rate (k3)", 6.0)
    attitude_rate: Number = _rate("roll and pitch rate error to acceleration (k4)", 15.0)
    yaw: Number = _rate("yaw error to yaw rate (k3)", 1.0)
    yaw_rate: Number = _rate("yaw rate error to acceleration (k4)", 2.5)
    rotor: Number = _rate("rotor speed error to rotor acceleration", 60.0)
    force_identification: Number = _rate("rate of the force identifier (kappa)", 20.0)
    moment_identification: Number = _rate("rate of the moment identifier (kappa)", 10.0)
    force_adaptation: Number = _adaptation("adaptation to a force (gamma)", 100.0)
    force_max: Number = quantity(
        "m/s^2", "bound of the adapted force over the mass", 4.0, sound=_FORCE
    )
    moment_adaptation: Number = _adaptation("adaptation to a moment (gamma)", 25.0)
    moment_max: Number = quantity(
        "rad/s^2",
        "bound of the adapted moment over the inertia",
        1.0,
        sound=positive(1e-3, 1e8, "larger than the rotors of any vehicle can cause"),
    )


#: Gains of a faster controller than the default, for turbulence in which hovering with the default
#: gains does not keep within the limits on the arrival. Errors of a vehicle that keeps away from
#: its limits decay a third to a half faster, and the correcting acceleration is smaller, so that
#: the command filter can follow it. Found by simulated flights of a Phantom 2 in moderate
#: turbulence.
FASTER_GAINS = Gains(
    position=2.0,
    velocity=4.5,
    acceleration_max=1.3,
    tilt_command=9.0,
    attitude=9.0,
    attitude_rate=22.0,
    force_adaptation=200.0,
)


class Knowledge(StrEnum):
    """Wind information on which re-planning in flight is based.

    `TOLD` is the true wind, `ESTIMATED` an estimate from the flight added to the forecast, and
    `UNTOLD` the forecast alone, or calm air if there is no forecast.
    """

    TOLD = "told"
    ESTIMATED = "estimated"
    UNTOLD = "untold"


class SolveTiming(StrEnum):
    """Source of the time that each solve is assumed to take in a simulated flight with re-planning.

    `STATED` is a constant time in the scenario, which makes the simulation reproducible; `MEASURED`
    is the measured time of the solve.
    """

    STATED = "stated"
    MEASURED = "measured"


class Replanning(Part):
    """Settings of re-planning in flight (model-predictive control).

    At regular intervals during the flight, the rest of the mission is planned again.
    """

    interval: Number = quantity(
        "s",
        "time from one solve of the remaining mission to the next",
        0.2,
        sound=positive(1e-2, 1e4, "a solve on board takes at least 10 ms"),
    )
    solve_time: Number = quantity(
        "s",
        "time allowed for a solve; the new plan starts at the state predicted for the end of this "
        "time",
        0.06,
        sound=not_negative(1e3, "an older plan is useless"),
    )
    clock: SolveTiming = quantity(
        "",
        "time that a solve takes in flight: stated, the reproducible solve_time, or measured",
        SolveTiming.STATED,
    )
    knowledge: tuple[Knowledge, ...] = quantity(
        "",
        "knowledge of the wind, one flight for each: told, the wind itself; estimated, an estimate "
        "added to the forecast; untold, the forecast alone (calm air without one)",
        tuple(Knowledge),
        max_length=len(Knowledge),
    )


@dataclass(frozen=True, kw_only=True)
class CruiseSettings:
    """Largest speed [m/s], acceleration [m/s²] and jerk [m/s³] of the baseline flight `cruise`.

    The baseline flight `cruise` imitates the flight of an autopilot.
    """

    speed: float
    acceleration: float
    jerk: float

    @property
    def words(self) -> str:
        """Largest speed, acceleration and jerk in words: "9.2 m/s, 4.1 m/s² and 31 m/s³"."""
        return f"{self.speed:.3g} m/s, {self.acceleration:.3g} m/s² and {self.jerk:.3g} m/s³"


class Baseline(Part):
    """Baseline flights, with which a plan is compared, and settings of their controller."""

    references: tuple[Reference, ...] = quantity(
        "",
        "trajectories to follow; cruise is an autopilot tuned for least energy",
        tuple(Reference),
        max_length=len(Reference),
    )
    cruise_speeds: tuple[Annotated[Number, Field(gt=0)], ...] | None = late_quantity(
        "m/s",
        "speeds of reference cruise, one flight for each in addition to the tuned flight",
        None,
        min_length=1,
        max_length=_MOST_SPEEDS,
        example="[5.0, 10.0]",
        sound=_SPEED,
    )
    cruise_acceleration: Number = late_quantity(
        "m/s^2",
        "largest acceleration of reference cruise at cruise_speeds (MPC_ACC_HOR of PX4)",
        3.0,
        sound=_FORCE,
    )
    cruise_jerk: Number = late_quantity(
        "m/s^3",
        "largest jerk of reference cruise at cruise_speeds (MPC_JERK_AUTO of PX4)",
        4.0,
        sound=positive(1e-3, 1e6, _MILLISECONDS),
    )
    adaptation: Flag = quantity("", "whether the controller adapts", True)
    gains: Gains = quantity(
        "",
        "controller gains; a plan for a stated risk may replace default gains by faster ones",
        Gains(),
    )
    mpc: Replanning | None = late_quantity("", "re-planning in flight, not flown when absent", None)

    @property
    def has_default_gains(self) -> bool:
        """Whether the scenario leaves the controller's gains at their default values.

        The search for safety margins may replace default gains by faster ones.
        """
        return self.gains == Gains()

    def cruise_settings(self, speed: float) -> CruiseSettings:
        """Return largest speed, acceleration and jerk of the baseline flight `cruise`.

        The largest speed is `speed` [m/s]. Acceleration and jerk are fields of this table.
        """
        return CruiseSettings(
            speed=speed, acceleration=self.cruise_acceleration, jerk=self.cruise_jerk
        )

    @model_validator(mode="after")
    def _cruise_speeds_differ(self) -> Self:
        speeds = self.cruise_speeds or ()
        twice = next((speed for speed in speeds if speeds.count(speed) > 1), None)
        if twice is not None:
            raise ValueError(
                f"cruise_speeds has {twice:g} m/s twice; must be different speeds; leave one out"
            )
        return self


class PowerModel(StrEnum):
    """Model of the electrical power of the rotors.

    The module `model.power` of the package has the equations of each model.

    The integral of the power over time is the energy of the flight.
    """

    MOTOR = "motor"
    EFFICIENCY = "efficiency"
    SHAFT = "shaft"
    CONSTANT_EFFICIENCY = "constant_efficiency"
    MOTOR_WITH_FRICTION = "motor_with_friction"
    MOMENTUM = "momentum"


_ELECTRICS = ("torque_constant", "voltage_constant", "motor_resistance")
#: Numbers of the vehicle that each power model needs and that some other models do not.
USED_BY: Mapping[PowerModel, tuple[str, ...]] = {
    PowerModel.MOTOR: _ELECTRICS,
    PowerModel.MOTOR_WITH_FRICTION: _ELECTRICS,
    PowerModel.EFFICIENCY: ("efficiency_map",),
    PowerModel.SHAFT: (),
    PowerModel.CONSTANT_EFFICIENCY: (),
    PowerModel.MOMENTUM: ("rotor_radius", "torque_constant", "motor_resistance"),
}

# Power models that are valid for braking, too, when energy flows back. In the other models, a
# braking power divided by an efficiency would return more energy than braking absorbs.
_REGENERATING = (
    PowerModel.MOTOR,
    PowerModel.SHAFT,
    PowerModel.MOTOR_WITH_FRICTION,
    PowerModel.MOMENTUM,
)


class Power(Part):
    """Choice and parameters of the power model."""

    model: PowerModel = quantity("", "power model", PowerModel.MOTOR)
    efficiency: Number = quantity("1", "drive efficiency of constant_efficiency", 0.75, gt=0, le=1)
    torque_floor: Number = quantity(
        "N*m",
        "efficiency: smallest torque used in f_r",
        0.0,
        sound=not_negative(100, "drag torques of rotors are smaller"),
    )
    efficiency_floor: Number = quantity(
        "1",
        "efficiency: smallest f_r",
        0.05,
        le=1,
        sound=positive(1e-4, 1, "efficiencies are at most 1"),
    )
    air_density: Number = late_quantity(
        "kg/m^3",
        "momentum: density of the air",
        SEA_LEVEL_DENSITY,
        sound=positive(1e-3, 100, "1.225 at sea level, 0.02 on Mars"),
    )
    regeneration: Flag = quantity(
        "", "whether braking returns energy; the default depends on the power model", False
    )
    hover_power_deviation: Number = late_quantity(
        "W",
        "standard deviation of the hover power, if it is uncertain; all other powers err by the "
        "same share",
        0.0,
        sound=not_negative(1e6, "flight powers range from watts to megawatts"),
    )
    smoothing: Number = quantity(
        "W",
        "without regeneration: width of the smooth floor at 0 W",
        0.1,
        sound=positive(
            1e-6, 1e5, "must be small compared with the power in flight, watts to megawatts"
        ),
    )

    @model_validator(mode="before")
    @classmethod
    def _regenerates_by_default(cls, given: Any) -> Any:  # noqa: ANN401  before validation
        if not isinstance(given, Mapping) or "regeneration" in given:
            return given
        return {**given, "regeneration": given.get("model", PowerModel.MOTOR) in _REGENERATING}


# Largest number of collocation points of the first mesh: a thousand points take about 0.1 GB of
# memory, so that these fit into 8 GB.
_MOST_POINTS = 50_000


class Solver(Part):
    """Required accuracy of the plan, first collocation mesh, and limits on the solver's effort."""

    accuracy: Accuracy = late_quantity(
        "",
        "required accuracy: quick, energy within 1e-3 and arrival within 0.1 m in open loop; "
        "standard, 1e-4 and 1 cm; proof, 1e-6 and 0.1 mm, for studies",
        Accuracy.PROOF,
        initial=Accuracy.STANDARD,
    )
    tolerance: Number = quantity(
        "1",
        "relative error of the states to which meshes are refined; by default 1e-3, 1e-4 or 1e-6, "
        "depending on the accuracy",
        FIGURES[Accuracy.PROOF].energy,
        le=1e-1,
        sound=positive(1e-11, 0.1, "rounding errors are about 1e-12"),
    )
    elements: WholeNumber = quantity("1", "elements of the first mesh", 10, ge=1, le=100_000)
    degree: WholeNumber = quantity("1", "degree of each element of the first mesh", 4, ge=1, le=20)
    max_iterations: WholeNumber = quantity("1", "Ipopt iterations per mesh", 150, ge=1, le=100_000)
    time_limit: Number = quantity(
        "s",
        "processor time after which each process of a command stops its solves and flights",
        300.0,
        gt=0,
        le=1e6,
    )
    max_refinements: WholeNumber = quantity("1", "mesh refinements", 20, ge=0, le=100)

    @model_validator(mode="before")
    @classmethod
    def _refines_as_the_accuracy_says(cls, given: Any) -> Any:  # noqa: ANN401  before validation
        if not isinstance(given, Mapping) or "tolerance" in given:
            return given
        known = given.get("accuracy")
        if known not in list(Accuracy):
            return given
        return {**given, "tolerance": FIGURES[Accuracy(known)].energy}

    @model_validator(mode="after")
    def _fits_into_memory(self) -> Self:
        points = self.elements * self.degree
        if points > _MOST_POINTS:
            raise ValueError(
                f"elements = {self.elements} of degree = {self.degree} make {points} points; must "
                f"make at most {_MOST_POINTS}: more do not fit into memory, and refinement adds "
                "elements where they are wanted"
            )
        return self


#: Largest rotor speed that a scenario may have [rad/s].
FASTEST_ROTOR = 1e5
_ANGLE = positive(1e-4, 2, "angles are in radians")
_MOMENT = positive(0, 1e8, "the weight of 10 t on an arm of 1 km is 1e8 N m")


# Fraction of the charge that is usually left in a pack. Above it the battery's equations are exact.
_LEAST_CHARGE = 0.2


class Limits(Part):
    """Limits on vehicle and battery, which the plan and the controller must respect."""

    roll_max: Number = quantity(
        "rad", "largest roll angle, Yacef et al., eq. (10)", pi / 2, le=pi / 2, sound=_ANGLE
    )
    pitch_max: Number = quantity(
        "rad", "largest pitch angle, Yacef et al., eq. (10)", pi / 2, le=pi / 2, sound=_ANGLE
    )
    rotor_speed_min: Number = quantity(
        "rad/s",
        "smallest rotor speed, Yacef et al., eq. (10)",
        0.0,
        sound=not_negative(
            FASTEST_ROTOR, "the blade tips of a 1 cm rotor would exceed the speed of sound"
        ),
    )
    rotor_speed_max: Number = quantity(
        "rad/s", "largest rotor speed, Yacef et al., eq. (10)", gt=0, le=FASTEST_ROTOR
    )
    rotor_acceleration_max: Number = quantity(
        "rad/s^2",
        "largest rotor acceleration",
        sound=positive(1e-2, 1e8, "rotors take from 1 ms to minutes to reach their speed"),
    )
    thrust_max: Number = quantity(
        "N",
        "largest total thrust; by default all rotors at rotor_speed_max",
        sound=positive(0, 1e7, "multirotors weigh at most 10 t"),
    )
    roll_moment_max: Number = quantity(
        "N*m",
        "largest roll moment; by default the rotors on one side at rotor_speed_max",
        sound=_MOMENT,
    )
    pitch_moment_max: Number = quantity(
        "N*m", "largest pitch moment; by default the rotors ahead at rotor_speed_max", sound=_MOMENT
    )
    yaw_moment_max: Number = quantity(
        "N*m", "largest yaw moment; by default half of the rotors at rotor_speed_max", sound=_MOMENT
    )
    speed_max: Number | None = late_quantity(
        "m/s",
        "largest speed over ground, no limit when absent",
        None,
        sound=positive(1e-2, 1e3, "rotorcraft fly below 340 m/s, the speed of sound"),
    )
    reserve: Number = late_quantity(
        "1",
        "share of the largest rotor speed and thrust that plans leave to the controller",
        0.0,
        ge=0,
        lt=1,
    )
    state_of_charge_min: Number | None = quantity(
        "percent", "lowest state of charge, no limit when absent", None, ge=0, lt=100
    )
    battery_current_max: Number | None = quantity(
        "A",
        "largest pack current, no limit when absent",
        None,
        sound=positive(1e-3, 1e6, "flight packs give from milliamperes to thousands of amperes"),
    )
    battery_voltage_min: Number | None = quantity(
        "V",
        "lowest pack voltage, no limit when absent",
        None,
        sound=positive(1e-3, 1e5, "flight packs have from 1 V to thousands of volts"),
    )
    within_validated: Flag = late_quantity(
        "",
        "whether plans stay within the range confirmed by measurements, vehicle.validated",
        False,
    )
    battery_power_share_max: Number | None = late_quantity(
        "1",
        "largest share of the pack's greatest power that a flight may draw, no limit when absent",
        None,
        gt=0,
        le=1,
    )

    @property
    def least_charge(self) -> float:
        """Least allowed state of charge of the battery, as a fraction; one fifth by default."""
        least = self.state_of_charge_min
        return _LEAST_CHARGE if least is None else least / 100.0

    @property
    def largest_tilt(self) -> float:
        """Tilt of the thrust from the vertical if roll and pitch are both at their limits [rad]."""
        return acos(cos(self.roll_max) * cos(self.pitch_max))


#: Limits that are derived from the rotors' greatest speed unless the scenario gives them.
DERIVED_LIMITS = ("thrust_max", "roll_moment_max", "pitch_moment_max", "yaw_moment_max")


def derived_limits(vehicle: Vehicle, rotor_speed_max: float) -> dict[str, float]:
    """Return the thrust and moment limits that follow from the largest rotor speed [rad/s].

    `thrust_max` is in N, and the limits of roll, pitch and yaw moment are in N m. Source: eq. (10)
    and (7) of Yacef et al.
    """
    rotor_thrust = vehicle.thrust_coefficient * rotor_speed_max**2
    rotor_drag_torque = vehicle.drag_torque_coefficient * rotor_speed_max**2
    places = vehicle.rotor_places
    ahead, aside = (sum(map(abs, along)) / 2 for along in zip(*places, strict=True))
    values = (
        len(places) * rotor_thrust,
        aside * rotor_thrust,
        ahead * rotor_thrust,
        len(places) / 2 * rotor_drag_torque,
    )
    return dict(zip(DERIVED_LIMITS, values, strict=True))
