"""Polar of a vehicle: steady flight over airspeed, with best speeds, range and endurance.

Each point of the polar is a trim: the attitude and the rotor speeds that keep the vehicle in level
flight at one airspeed, with their power P. The air velocity is the ground velocity minus the wind.

At ground speed g, the energy per metre is P / g. If flight time has a price c [J/s = W], the cost
per metre is (P + c) / g.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.interpolate import CubicSpline
from scipy.optimize import minimize_scalar

from pyomo_quad.arrays import FloatArray
from pyomo_quad.collocation import SolveError
from pyomo_quad.flight import Planner
from pyomo_quad.flight.steady import SteadyFlight, Trim
from pyomo_quad.model.wind import mean_wind
from pyomo_quad.scenario import Scenario

#: Columns of `Polar.winds` and `Polar.reach`.
WIND, ANGLE = "wind_m_s", "angle_to_wind_deg"
GROUND_SPEED, ENERGY_PER_METRE = "ground_speed_m_s", "energy_per_metre_J_m"
COURSE, REACH = "course_deg", "reach_m"
#: Columns of these and of the table of airspeeds.
AIRSPEED, POWER, RANGE = "airspeed_m_s", "power_W", "range_m"

_STEP_M_S = 0.5  # airspeed step between trims, which a cubic spline interpolates
_FASTEST_M_S = 40.0  # greatest airspeed of the trims, unless a limit of the vehicle is lower
# Payloads of the curves: the scenario's own plus these fractions of the vehicle's mass.
_MORE_PAYLOAD = (0.0, 0.1, 0.2)
# Wind speeds of the table besides the scenario's own [m/s].
_WINDS_M_S = (0.0, 2.0, 4.0, 6.0, 8.0, 10.0)
_DIRECTIONS = 36  # number of courses, every 10 degrees
_SAMPLES = 60  # samples of the state of charge in the integral of the endurance
_SLOWEST_GROUND_SPEED = 0.05  # m/s; below this speed the wind stops the vehicle
_NO_WIND = 1e-9  # m/s
_TRIALS = 200  # speeds that are tried before the bounded search for the best


@dataclass(frozen=True, kw_only=True)
class SteadyCurve:
    """Power and endurance of level flight over airspeed, for one payload.

    Attributes
    ----------
    payload_kg : float
        Mass of the payload [kg].
    airspeeds : ndarray, shape (n,)
        Airspeeds in steps of 0.5 m/s [m/s], from 0 to the greatest possible, at most 39.5 m/s.
    powers : ndarray, shape (n,)
        Power at each airspeed [W].
    endurances : ndarray, shape (n,)
        Flight time [s] from a full battery to the least allowed state of charge.
    """

    payload_kg: float
    airspeeds: FloatArray
    powers: FloatArray
    endurances: FloatArray

    def power(self, airspeed: FloatArray | float) -> FloatArray:
        """Return the power [W] of level flight at one or more airspeeds [m/s], by interpolation.

        The power is infinite above the last of `airspeeds`.
        """
        return self._between(self.powers, airspeed, np.inf)

    def endurance(self, airspeed: FloatArray | float) -> FloatArray:
        """Return the flight time [s] on one battery charge at one or more airspeeds [m/s].

        The flight time is interpolated, and zero above the last of `airspeeds`.
        """
        return self._between(self.endurances, airspeed, 0.0)

    def _between(
        self, values: FloatArray, airspeed: FloatArray | float, beyond: float
    ) -> FloatArray:
        spline = CubicSpline(self.airspeeds, values)
        at = np.asarray(airspeed, dtype=float)
        return np.where(at <= self.airspeeds[-1], spline(at), beyond)

    @property
    def speed_of_least_power(self) -> float:
        """Airspeed of least power, and therefore of the longest flight time [m/s]."""
        return _least(self.power, np.linspace(0.0, self.airspeeds[-1], _TRIALS))

    def best_over_ground(
        self, wind: float = 0.0, angle: float = 0.0, price_of_time: float = 0.0
    ) -> "GroundSpeed":
        """Return the ground speed with the least cost per metre in a wind of speed `wind` [m/s].

        The cost is (power + `price_of_time` [W]) / ground speed. `angle` [rad] lies between the
        course and the direction toward which the wind blows; 0 is a tail wind.
        """
        along, across = wind * np.cos(angle), wind * np.sin(angle)

        def airspeed(ground_speed: FloatArray | float) -> FloatArray:
            return np.hypot(np.asarray(ground_speed) - along, across)

        def cost(ground_speed: FloatArray | float) -> FloatArray:
            return np.asarray((self.power(airspeed(ground_speed)) + price_of_time) / ground_speed)

        ahead = self.airspeeds[-1] ** 2 - across**2
        # Greatest airspeed along the course; -inf if the cross wind is faster than the vehicle.
        forward = np.sqrt(ahead) if ahead >= 0.0 else -np.inf
        fastest = along + forward
        if fastest <= _SLOWEST_GROUND_SPEED:
            return GroundSpeed(ground_speed=0.0, airspeed=np.nan, power=np.nan, endurance=0.0)
        # In a strong tail wind, a slow flight over ground would need too much airspeed against it.
        slowest = max(_SLOWEST_GROUND_SPEED, along - forward)
        best = _least(cost, np.linspace(slowest, fastest, _TRIALS))
        at = float(airspeed(best))
        return GroundSpeed(
            ground_speed=best,
            airspeed=at,
            power=float(self.power(at)),
            endurance=float(self.endurance(at)),
        )


def _least(cost: Callable[[FloatArray | float], FloatArray], trials: FloatArray) -> float:
    """Return the minimiser of a function of one variable, near the best of several trials.

    `trials` are arguments of `cost` in ascending order. The result lies between the neighbours of
    the best trial.
    """
    best = int(np.argmin(cost(trials)))
    low, high = trials[max(0, best - 1)], trials[min(len(trials) - 1, best + 1)]
    found = minimize_scalar(
        lambda at: float(cost(at)), bounds=(low, high), method="bounded", options={"xatol": 1e-6}
    )
    return float(found.x)


@dataclass(frozen=True, kw_only=True)
class GroundSpeed:
    """Steady flight at one ground speed, with its energy per metre and its range.

    If the wind is too strong for the course, the ground speed and the endurance are zero.

    Attributes
    ----------
    ground_speed : float
        Speed over the ground [m/s].
    airspeed : float
        Speed through the air [m/s]; NaN at zero ground speed.
    power : float
        Power [W]; NaN at zero ground speed.
    endurance : float
        Flight time [s], as in `SteadyCurve`.
    """

    ground_speed: float
    airspeed: float
    power: float
    endurance: float

    @property
    def energy_per_metre(self) -> float:
        """Energy per metre over the ground [J/m]; infinite at zero ground speed."""
        return self.power / self.ground_speed if self.ground_speed > 0.0 else np.inf

    @property
    def range_m(self) -> float:
        """Distance over the ground on one battery charge [m]: ground speed times flight time."""
        return self.ground_speed * self.endurance


@dataclass(frozen=True, kw_only=True)
class Polar:
    """Polar of a scenario's vehicle: steady flight over airspeed, payload and wind.

    Attributes
    ----------
    scenario : Scenario
        Scenario with the vehicle.
    curves : tuple of SteadyCurve
        One curve for each payload, the scenario's own first.
    winds : DataFrame
        Best ground speed for each wind speed `WIND`. `ANGLE` lies between the course and the
        direction toward which the wind blows. Further columns are `GROUND_SPEED`, `AIRSPEED`,
        `POWER`, `ENERGY_PER_METRE` (the least possible) and `RANGE`.
    reach : DataFrame
        Greatest distance `REACH` from which the vehicle returns on one battery charge. Each row
        has a course `COURSE`, and the ground speeds out and back in the mean wind.
    wind_m_s, wind_towards_rad : float
        Speed of the mean wind, and direction toward which it blows, counter-clockwise from x.
    depth : float
        Usable fraction of the battery's capacity.
    """

    scenario: Scenario
    curves: tuple[SteadyCurve, ...]
    winds: pd.DataFrame
    reach: pd.DataFrame
    wind_m_s: float
    wind_towards_rad: float
    depth: float

    @property
    def own(self) -> SteadyCurve:
        """Curve of power and endurance over airspeed with the scenario's own payload."""
        return self.curves[0]


def find_polar(scenario: Scenario) -> Polar:
    """Compute steady flight of a scenario's vehicle over airspeed, payload and wind.

    Raises SolveError if the vehicle cannot hover with one of the payloads, or cannot fly at 0.5 m/s
    within its limits.
    """
    planner = Planner()
    depth = 1.0 - scenario.limits.least_charge
    own = scenario.vehicle.payload
    curves = []
    for more in _MORE_PAYLOAD:
        payload = own + round(more * scenario.vehicle.mass, 2)
        loaded = scenario.with_values({"vehicle.payload": payload}) if more else scenario
        curves.append(steady_curve(loaded, planner.steady_flight(loaded), depth))
    wind_x, wind_y = mean_wind(scenario).tolist()
    speed, towards = float(np.hypot(wind_x, wind_y)), float(np.arctan2(wind_y, wind_x))
    winds = sorted({*_WINDS_M_S, round(speed, 3)})
    return Polar(
        scenario=scenario,
        curves=tuple(curves),
        winds=_winds(curves[0], winds),
        reach=_reach(curves[0], speed, towards),
        wind_m_s=speed,
        wind_towards_rad=towards,
        depth=depth,
    )


def steady_curve(scenario: Scenario, steady: SteadyFlight, depth: float) -> SteadyCurve:
    """Compute power and endurance of level flight at airspeeds from 0 in steps of 0.5 m/s.

    The last airspeed is the greatest one at which the vehicle keeps its limits, at most 39.5 m/s.
    `depth` is the usable fraction of the battery's capacity. Raises SolveError if the vehicle
    cannot hover, or fly at 0.5 m/s within its limits.
    """
    speeds: list[float] = []
    powers: list[float] = []
    endurances: list[float] = []
    trim = None
    for speed in np.arange(0.0, _FASTEST_M_S, _STEP_M_S):
        try:
            trim = steady.trim([float(speed), 0.0, 0.0], trim)
        except SolveError:
            if not speeds:
                raise
            break
        # The limits are not checked at airspeed 0.
        if speeds and not _is_allowed(scenario, steady, trim):
            break
        speeds.append(float(speed))
        powers.append(float(steady.reading(("power.total",), trim)[0]))
        endurances.append(steady.endurance(trim, depth, _SAMPLES))
    if len(speeds) < 2:
        raise SolveError(
            f"{scenario.name}: level flight at {_STEP_M_S:g} m/s is beyond a limit on roll, pitch, "
            "thrust or rotor speed; must be within them; raise the limit or lower the mass."
        )
    return SteadyCurve(
        payload_kg=scenario.vehicle.payload,
        airspeeds=np.array(speeds),
        powers=np.array(powers),
        endurances=np.array(endurances),
    )


def _is_allowed(scenario: Scenario, steady: SteadyFlight, trim: Trim) -> bool:
    roll, pitch, thrust = steady.reading(
        ("rigid_body.phi", "rigid_body.theta", "rotors.total_thrust"), trim
    )
    limits = scenario.limits
    within = abs(roll) <= limits.roll_max and abs(pitch) <= limits.pitch_max
    return bool(
        within
        and thrust <= limits.thrust_max
        and steady.rotor_speeds(trim).max() <= limits.rotor_speed_max
    )


def _winds(curve: SteadyCurve, winds: Sequence[float]) -> pd.DataFrame:
    rows = []
    for wind in winds:
        for angle in np.linspace(0.0, np.pi, _DIRECTIONS // 2 + 1):
            best = curve.best_over_ground(wind, float(angle))
            rows.append(
                {
                    WIND: wind,
                    ANGLE: float(np.degrees(angle)),
                    GROUND_SPEED: best.ground_speed,
                    AIRSPEED: best.airspeed,
                    POWER: best.power,
                    ENERGY_PER_METRE: best.energy_per_metre,
                    RANGE: best.range_m,
                }
            )
            if wind <= _NO_WIND:
                break
    return pd.DataFrame(rows)


def _reach(curve: SteadyCurve, wind: float, towards: float) -> pd.DataFrame:
    """Return, for each course, how far the vehicle can fly and return on one battery charge.

    `wind` is the speed of the wind [m/s]. `towards` is the direction to which it blows,
    counter-clockwise from x [rad].
    """
    rows = []
    for course in np.linspace(0.0, 2.0 * np.pi, _DIRECTIONS, endpoint=False):
        legs = [
            curve.best_over_ground(wind, float(towards - course + turned))
            for turned in (0.0, np.pi)
        ]
        ranges = [leg.range_m for leg in legs]
        # Fraction of the battery charge that one metre out and back uses.
        share = sum(1.0 / leg if leg > 0.0 else np.inf for leg in ranges)
        rows.append(
            {
                COURSE: float(np.degrees(course)),
                f"out_{GROUND_SPEED}": legs[0].ground_speed,
                f"back_{GROUND_SPEED}": legs[1].ground_speed,
                REACH: 1.0 / share,
            }
        )
    return pd.DataFrame(rows)
