"""Fit of a vehicle's power model to points of steady flight.

The points are measured powers at several airspeeds (a polar), in hover, or with several payloads.
Each point is treated like a row of a flight log with zero acceleration, and the model computes its
power. Method: see docs/theory/identification.md, "Steady points".
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from pyomo_quad.arrays import FloatArray
from pyomo_quad.collocation import SolveError
from pyomo_quad.flight import Planner
from pyomo_quad.identification.columns import (
    AIR_VELOCITY,
    CRUISE,
    DENSITY,
    FLIGHT,
    PAYLOAD,
    PHASE,
    POWER,
    TIME,
    VELOCITY,
    LogColumn,
    wanted_columns,
)
from pyomo_quad.identification.fitting import Fit, FittedParameter, confounded, undetermined
from pyomo_quad.identification.logs import LEAST_POWER_PER_KG, MOST_POWER_PER_KG
from pyomo_quad.identification.motion import LoggedMotion
from pyomo_quad.scenario import Scenario, ScenarioError
from pyomo_quad.scenario.messages import printable

AIRSPEED, CLIMB, ENDURANCE = "airspeed_m_s", "climb_m_s", "endurance_s"
#: Columns of a table of steady points; all except power or endurance are optional.
STEADY_COLUMNS = {
    POWER: LogColumn("W", "power drawn from the pack", ("power",)),
    ENDURANCE: LogColumn("s", "time aloft on the pack, in place of a power", ("endurance",)),
    AIRSPEED: LogColumn("m/s", "level airspeed, 0 when absent", ("missionspeed", "speed_m_s")),
    PAYLOAD: LogColumn("kg", "mass carried, the vehicle's own when absent", ("payload",)),
    CLIMB: LogColumn("m/s", "steady climb, 0 when absent"),
    DENSITY: LogColumn("kg/m^3", "density of the air, the scenario's when absent"),
}
#: Fields fitted to steady points by default.
STEADY_FITTED = ("profile_power_coefficient", "induced_power_factor", "drag_quadratic")
#: Fraction of the stored energy that a stated endurance uses: makers usually keep 20 % in reserve.
USED_SHARE = 0.8
_SAMPLES = 60
_MOST_POINTS = 10_000
# Assumed relative error of a single measured power, if too few points give a better estimate.
_READING_ERROR = 0.05
# Number of points per fitted parameter below which the residual does not tell the error.
_FEW_PER_NUMBER = 3
# Seconds between the two equal rows that represent a point.
_STEP_S = 1.0


@dataclass(frozen=True, kw_only=True)
class SteadyFit:
    """Vehicle fitted to points of steady flight.

    Attributes
    ----------
    scenario : Scenario
        Scenario with the fitted vehicle.
    points : DataFrame
        Power, airspeed, payload, climb and air density.
    parameters : tuple of FittedParameter
        Result for each field.
    power : ndarray, shape (n_points,)
        Computed power [W].
    unseen : ndarray, shape (n_points,)
        Power by a fit to the other points [W]; NaN if there are too few.
    together : tuple of (str, str)
        Pairs for the fields that were not fitted: the field, and the other field that has the most
        similar effect on the power. The latter is "" if no effect is similar.
    cautions : tuple of str
        Warnings about the result.
    """

    scenario: Scenario
    points: pd.DataFrame
    parameters: tuple[FittedParameter, ...]
    power: FloatArray
    unseen: FloatArray
    together: tuple[tuple[str, str], ...]
    cautions: tuple[str, ...]

    @property
    def error_percent(self) -> float:
        """Mean absolute relative error of the computed powers [percent]."""
        return _mean_error(self.power, self.points)

    @property
    def unseen_error_percent(self) -> float:
        """Mean absolute relative error of points left out of the fit [percent].

        NaN if there are too few points.
        """
        return _mean_error(self.unseen, self.points)


def _mean_error(power: FloatArray, points: pd.DataFrame) -> float:
    return float(100.0 * np.mean(np.abs(power / points[POWER].to_numpy() - 1.0)))


def read_steady(file: Path, scenario: Scenario) -> pd.DataFrame:
    """Read points of steady flight from a CSV file, and complete missing columns.

    The columns are some of `STEADY_COLUMNS`. Missing payloads and air densities are those of the
    scenario; missing airspeeds and climbs are 0. A missing power follows from the endurance.

    ScenarioError is raised if the file is unreadable, if both power and endurance are missing, if a
    value is impossible, or if the power seems to be in kW or mW.
    """
    points = filled_in(_read_csv(file), scenario)
    for name in points:
        column = points[name]
        least = 0.0 if name in {POWER, DENSITY} else -np.inf
        wrong = ~np.isfinite(column) | (column <= least)
        if wrong.any():
            row = int(wrong.to_numpy().argmax())
            raise ScenarioError(
                f"{printable(str(file))}: {name} = {column.iloc[row]:g} in row {row + 1}; must be "
                f"a number{' > 0' if least == 0.0 else ''}; correct the row or leave it out."
            )
    usual, mass = float(points[POWER].median()), scenario.vehicle.mass
    if not LEAST_POWER_PER_KG <= usual / mass <= MOST_POWER_PER_KG:
        unit = "kilowatts; multiply" if usual < mass else "milliwatts; divide"
        raise ScenarioError(
            f"{printable(str(file))}: {POWER} has a median of {usual:.4g} W for a vehicle of "
            f"{mass:.4g} kg, which must be {unit} it by 1000."
        )
    return points


def filled_in(frame: pd.DataFrame, scenario: Scenario) -> pd.DataFrame:
    """Complete a table of measured points of steady flight with default values.

    A missing payload or air density is that of the scenario; a missing airspeed or climb is 0. If
    the table has endurances but no powers, a flight is assumed to use 80 % of the stored energy:
    the power is 0.8 * stored energy of the scenario's battery / endurance.
    """
    frame = frame.copy()
    if POWER not in frame:
        steady = Planner().steady_flight(scenario)
        stored = USED_SHARE * steady.stored_energy(1.0, _SAMPLES)
        frame[POWER] = stored / frame[ENDURANCE]
    vehicle = scenario.vehicle
    defaults = {AIRSPEED: 0.0, PAYLOAD: vehicle.payload, CLIMB: 0.0}
    for name, value in (defaults | {DENSITY: scenario.power.air_density}).items():
        if name not in frame:
            frame[name] = value
    names = [POWER, AIRSPEED, PAYLOAD, CLIMB, DENSITY]
    return frame[names].astype(float)


def _read_csv(file: Path) -> pd.DataFrame:
    """Read at most 10000 measured points of steady flight from a CSV table, one point per row.

    If the file is unreadable or empty, has text in a column, or has neither powers nor endurances,
    a ScenarioError is raised.
    """
    source, wanted = printable(str(file)), wanted_columns(STEADY_COLUMNS)
    try:
        held = pd.read_csv(file, nrows=_MOST_POINTS)
    except (OSError, ValueError, pd.errors.ParserError):
        raise ScenarioError(f"{source}: cannot be read; give a CSV of points; {wanted}.") from None
    called = {other: own for own, c in STEADY_COLUMNS.items() for other in c.other_names}
    frame = held.rename(columns=called)
    frame = frame[[name for name in STEADY_COLUMNS if name in frame]]
    if POWER not in frame and ENDURANCE not in frame:
        raise ScenarioError(f"{source}: has neither {POWER} nor {ENDURANCE}; {wanted}.")
    if frame.empty:
        raise ScenarioError(f"{source}: has no row; give one point at least, such as hover.")
    for name in map(str, frame):
        if not pd.api.types.is_numeric_dtype(frame[name]):
            raise ScenarioError(f"{source}: column {name} holds text; it must hold numbers.")
    return frame


def as_flights(points: pd.DataFrame, scenario: Scenario) -> pd.DataFrame:
    """Convert points of steady flight to the format of logged flights.

    Each point, also a hover, becomes a flight of two rows that differ only in time. The flight goes
    toward north in calm air, and its phase is cruise. The logged airspeed is the airspeed of the
    point divided by the vehicle's `anemometer_factor` in the scenario. The fit to logged flights
    can use the result.
    """
    twice = points.loc[points.index.repeat(2)].reset_index(drop=True)
    read = twice[AIRSPEED] / scenario.vehicle.anemometer_factor
    return pd.DataFrame(
        {
            FLIGHT: np.repeat(np.arange(len(points)), 2),
            TIME: np.tile([0.0, _STEP_S], len(points)),
            PHASE: CRUISE,
            PAYLOAD: twice[PAYLOAD],
            DENSITY: twice[DENSITY],
            POWER: twice[POWER],
            VELOCITY[0]: twice[AIRSPEED],
            VELOCITY[1]: 0.0,
            VELOCITY[2]: twice[CLIMB],
            AIR_VELOCITY[0]: read,
            AIR_VELOCITY[1]: 0.0,
        }
    )


def level_powers(scenario: Scenario, airspeeds: Sequence[float], planner: Planner) -> FloatArray:
    """Compute the power of steady level flight at ascending airspeeds [m/s], shape (n,) [W].

    Powers above the greatest airspeed that the vehicle can fly are NaN.
    """
    steady = planner.steady_flight(scenario)
    powers = np.full(len(airspeeds), np.nan)
    trim = None
    for k, speed in enumerate(airspeeds):
        try:
            trim = steady.trim([float(speed), 0.0, 0.0], trim)
        except SolveError:
            break
        powers[k] = trim.power_W
    return powers


def identify_steady(
    scenario: Scenario, points: pd.DataFrame, names: Sequence[str] = STEADY_FITTED
) -> SteadyFit:
    """Fit a vehicle's power parameters to points of steady flight.

    `scenario` comes from `vehicle_scenario`, and `points` from `read_steady`. `names` are the
    vehicle's fields to fit, in the order of preference. Fields that the points do not determine
    keep their values, see `undetermined`. Of the others, at most the first `len(points)` are
    fitted. If the vehicle cannot fly steadily at a point, a ScenarioError is raised.
    """
    frame = as_flights(points, scenario)
    motion = LoggedMotion(scenario, frame)
    asked = Fit(motion, scenario, names)
    lost = undetermined(asked)
    kept = [name for name in names if name not in lost][: len(points)]
    fit = Fit(motion, scenario, kept)
    values = fit.over(fit.everything)
    power = fit.power(values)[::2]
    unseen = np.full(len(points), np.nan)
    if len(points) > len(kept) + 1:
        flights = frame[FLIGHT].to_numpy()
        for k in range(len(points)):
            unseen[k] = fit.power(fit.over(flights != k, values))[2 * k]
    spread = _deviations(fit, values, power, points) if kept else np.zeros(0)
    return SteadyFit(
        scenario=fit.applied(values),
        points=points,
        parameters=tuple(fit.parameter(name, values, spread) for name in names),
        power=power,
        unseen=unseen,
        together=confounded(asked, [name for name in names if name not in kept]),
        cautions=tuple(_cautions(points, kept)),
    )


def _deviations(
    fit: Fit, values: FloatArray, power: FloatArray, points: pd.DataFrame
) -> FloatArray:
    """Return the standard deviations of the fitted parameters, from the linearised fit.

    `values` are the fitted parameters, and `power` is the power [W] computed with them.
    """
    slopes = fit.slopes(values)
    measured = points[POWER].to_numpy()
    freedom = len(points) - len(values)
    reading = _READING_ERROR * float(np.mean(measured))
    # Standard deviation of a measured power. With few points, the assumed error is its lower limit.
    residual = float(np.sqrt(np.sum((power - measured) ** 2) / max(freedom, 1)))
    few = len(points) < _FEW_PER_NUMBER * len(values)
    error = max(reading, residual) if few else residual
    covariance = error**2 * np.linalg.pinv(slopes.T @ slopes)
    return np.sqrt(np.diag(covariance))


def _is_constant(column: "pd.Series[float]") -> bool:
    return bool((column == column.iloc[0]).all())


def _cautions(points: pd.DataFrame, kept: Sequence[str]) -> list[str]:
    cautions = []
    if len(points) < _FEW_PER_NUMBER * max(1, len(kept)):
        cautions.append(
            f"{len(points)} points for {len(kept)} fitted numbers; their deviations assume "
            f"errors of {100 * _READING_ERROR:g} % in each reading: give "
            f"{_FEW_PER_NUMBER} points or more for each number."
        )
    if _is_constant(points[AIRSPEED]):
        cautions.append(
            "all points are at one airspeed: power at other airspeeds is computed by theory alone; "
            "add points of level flight, such as at 5, 10 and 15 m/s."
        )
    if _is_constant(points[PAYLOAD]):
        cautions.append(
            "all points have the same payload: the growth of power with mass is computed by theory "
            "alone; add points with other payloads."
        )
    return cautions
