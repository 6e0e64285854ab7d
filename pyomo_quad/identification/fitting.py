"""Parameters of the declared equations by robust least squares, and what their numbers are worth.

Method: see docs/theory/identification.md, eqs. (2) to (5).

The residual is the mean power of windows of some seconds, measured less computed: over one second
airspeed and acceleration are noise as much as flight, and a fit to single rows takes that noise
for a flatter power curve.  Large residuals (gusts, the ground) count less than by their square.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.optimize import least_squares

from pyomo_quad.identification.logs import (
    AIR_VELOCITY,
    CRUISE,
    FLIGHT,
    PAYLOAD,
    PHASE,
    POWER,
    TIME,
    VELOCITY,
)
from pyomo_quad.identification.motion import LoggedMotion
from pyomo_quad.scenario import Scenario, ScenarioError, library_entry, library_names
from pyomo_quad.scenario.tables import Vehicle

FloatArray = NDArray[np.float64]
Rows = NDArray[np.bool_]

#: Fields of the vehicle that are fitted unless others are asked for.  Induced power is not among
#: them: in hover it goes with the thrust as profile power does, so it keeps its textbook value.
FITTED = ("profile_power_coefficient", "climb_power_factor", "descent_power_factor")
#: All fields that may be asked for.
FITTABLE = (
    *FITTED,
    "induced_power_factor",
    "profile_advance_factor",
    "electronics_power",
)
#: Columns of `energies` beside the flight.
MEASURED_ENERGY, PREDICTED_ENERGY = "measured_energy_J", "predicted_energy_J"
ERROR = "error_percent"
_BLOCK = "power."
_WINDOW_S = 10.0
# Residual, W, beyond which a window counts by its size and no more by its square.
_LARGE_RESIDUAL_W = 20.0
# What a change of a parameter by this share of its size, the others making the best of it, must
# move the windows' power by, W, for the flights to determine it.
_SHARE = 0.1
_LEAST_EFFECT_W = 0.5
_FOLDS, _HALVES = 10, 2
_DRAWS = 200
_SEED = 1
# Speeds, m/s, and payloads, kg, that differ by less belong to one group.
_SPEED_STEP, _PAYLOAD_STEP = 2.0, 0.01
_SLOW_SHARE = 0.5
# Share of the cruise that is no faster than its usual speed: the rest is gusts.
_CRUISING = 0.9
_NEAR_BOUND = 1e-6


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """One number as the flights have it.

    `deviation` is its standard deviation over flights drawn anew, nought where it was kept.
    `first_half` and `second_half` are of fits to one half of the flights each, with no flight in
    common: unlike the base, which may have been fitted to these flights, they are independent.
    """

    name: str
    base: float
    base_source: str
    value: float
    first_half: float
    second_half: float
    deviation: float
    is_determined: bool
    is_at_bound: bool


@dataclass(frozen=True, kw_only=True)
class Scores:
    """How computed energies and powers of flights differ from the measured ones.

    Energies are sums over the rows of the phases 1 to 3; the bias is that of the sum over all
    flights.
    """

    flights: int
    mean_absolute_error_percent: float
    bias_percent: float
    power_rmse_W: float


@dataclass(frozen=True, kw_only=True)
class Trial:
    """A fit to some flights tried on others."""

    name: str
    fitted_on: str
    tried_on: str
    scores: Scores


@dataclass(frozen=True, kw_only=True)
class Identification:
    """What flights say of a vehicle.

    `correlations` has the determined parameters as rows and columns; `cross_validated` is the
    power of each row by a fit that had not seen its flight.
    """

    scenario: Scenario
    frame: pd.DataFrame
    parameters: tuple[Parameter, ...]
    correlations: pd.DataFrame
    fitted_power: FloatArray
    cross_validated: FloatArray
    trials: tuple[Trial, ...]

    @property
    def airspeeds(self) -> FloatArray:
        """The level part of the true airspeed of each row, m/s."""
        north, east = (self.frame[name].to_numpy() for name in AIR_VELOCITY)
        return np.hypot(north, east) * self.scenario.vehicle.anemometer_factor

    def excess(self, slowest: float, fastest: float) -> float:
        """Return by how much measured power exceeds computed in cruise between airspeeds, W.

        NaN where no row cruises there.
        """
        is_meant = (self.frame[PHASE] == CRUISE).to_numpy() & (slowest <= self.airspeeds)
        is_meant = is_meant & (self.airspeeds < fastest)
        if not is_meant.any():
            return np.nan
        return float((self.frame[POWER].to_numpy() - self.fitted_power)[is_meant].mean())


def energies(frame: pd.DataFrame, power: FloatArray) -> pd.DataFrame:
    """Return one row a flight: measured and computed energy, J, and the error in per cent."""
    steps = frame.groupby(FLIGHT, sort=False)[TIME].transform(lambda t: np.median(np.diff(t)))
    table = pd.DataFrame(
        {
            FLIGHT: frame[FLIGHT],
            MEASURED_ENERGY: frame[POWER] * steps,
            PREDICTED_ENERGY: power * steps,
        }
    )
    table = table.groupby(FLIGHT, sort=False, as_index=False).sum()
    ratio = table[PREDICTED_ENERGY] / table[MEASURED_ENERGY]
    return table.assign(**{ERROR: 100.0 * (ratio - 1.0)})


def scores(frame: pd.DataFrame, power: FloatArray) -> Scores:
    """Compare powers with the measured ones, flight by flight."""
    table = energies(frame, power)
    total = table[[MEASURED_ENERGY, PREDICTED_ENERGY]].sum()
    return Scores(
        flights=len(table),
        mean_absolute_error_percent=float(table[ERROR].abs().mean()),
        bias_percent=float(100.0 * (total[PREDICTED_ENERGY] / total[MEASURED_ENERGY] - 1.0)),
        power_rmse_W=float(np.sqrt(np.mean((power - frame[POWER].to_numpy()) ** 2))),
    )


class Fit:
    """Least squares of a vehicle's parameters over flights.

    Parameters
    ----------
    motion : LoggedMotion
    scenario : Scenario
        Where the fit starts, and what it keeps.
    names : sequence of str
        Of `FITTABLE`.
    """

    def __init__(self, motion: LoggedMotion, scenario: Scenario, names: Sequence[str]) -> None:
        self._motion = motion
        self.frame = motion.frame
        self.names = tuple(names)
        self.base = np.array([getattr(scenario.vehicle, name) for name in names])
        self.bounds = np.array([_bounds(name) for name in names]).T.reshape(2, len(self.names))
        self._window = _windows(self.frame)
        self._measured = self.frame[POWER].to_numpy()

    def power(self, values: FloatArray) -> FloatArray:
        """Return the power of each row, W."""
        named = zip(self.names, values.tolist(), strict=True)
        return self._motion.power({f"{_BLOCK}{name}": value for name, value in named})

    def windows(self, power: FloatArray, rows: Rows) -> tuple[FloatArray, NDArray[np.int64]]:
        """Return the mean power of the windows of some rows, and the first row of each."""
        _, first, inverse = np.unique(self._window[rows], return_index=True, return_inverse=True)
        mean = np.bincount(inverse, power[rows]) / np.bincount(inverse)
        return mean, np.flatnonzero(rows)[first]

    def over(self, rows: Rows, start: FloatArray | None = None) -> FloatArray:
        """Return the values that fit some rows best."""
        if not self.names:
            return self.base
        measured, _ = self.windows(self._measured, rows)

        def residual(values: FloatArray) -> FloatArray:
            return self.windows(self.power(values), rows)[0] - measured

        return _robust(residual, self.base if start is None else start, self.bounds)

    def slopes(self, values: FloatArray, rows: Rows) -> FloatArray:
        """Return what a unit of each parameter does to the windows' power, by differences."""
        at, _ = self.windows(self.power(values), rows)
        columns = []
        for k in range(len(self.names)):
            moved = values.copy()
            step = 1e-3 * max(1.0, abs(values[k]))
            moved[k] += step
            columns.append((self.windows(self.power(moved), rows)[0] - at) / step)
        return np.column_stack(columns) if columns else np.zeros((len(at), 0))

    def drawn_anew(self, values: FloatArray) -> FloatArray:
        """Return fits to flights drawn with replacement, shape (draws, n).

        Each is a robust fit of the equations' first-order change about the fit to all flights,
        exact for parameters that enter linearly.
        """
        everything = np.ones(len(self.frame), dtype=bool)
        slopes = self.slopes(values, everything)
        at, first = self.windows(self.power(values), everything)
        measured, _ = self.windows(self._measured, everything)
        flights, flight = np.unique(self.frame[FLIGHT].to_numpy()[first], return_inverse=True)
        generator = np.random.default_rng(_SEED)
        found = []
        for _ in range(_DRAWS):
            counts = np.bincount(
                generator.integers(0, len(flights), len(flights)), minlength=len(flights)
            )
            chosen = np.repeat(np.arange(len(at)), counts[flight])

            def residual(new: FloatArray, chosen: NDArray[np.int64] = chosen) -> FloatArray:
                return (at + slopes @ (new - values) - measured)[chosen]

            found.append(_robust(residual, values, self.bounds))
        return np.array(found)


def _robust(residual: object, start: FloatArray, bounds: FloatArray) -> FloatArray:
    low, high = bounds
    inside = np.clip(start, low + _NEAR_BOUND, high - _NEAR_BOUND)
    found = least_squares(
        residual, inside, bounds=bounds, loss="soft_l1", f_scale=_LARGE_RESIDUAL_W
    )
    return np.asarray(found.x)


def _bounds(name: str) -> tuple[float, float]:
    limits = {type(m).__name__: m for m in Vehicle.model_fields[name].metadata}
    low, high = limits.get("Ge"), limits.get("Le")
    return (0.0 if low is None else float(low.ge), np.inf if high is None else float(high.le))


def _windows(frame: pd.DataFrame) -> NDArray[np.int64]:
    """Return the number of each row's window, which ends where its flight or phase does."""
    stretch = [frame[FLIGHT], frame[PHASE]]
    since = frame[TIME] - frame.groupby(stretch, sort=False)[TIME].transform("min")
    keys = [*stretch, np.floor(since / _WINDOW_S)]
    return np.asarray(frame.groupby(keys, sort=False).ngroup(), dtype=np.int64)


def undetermined(fit: Fit) -> tuple[str, ...]:
    """Return the parameters that the flights cannot tell from the others or from nothing."""
    everything = np.ones(len(fit.frame), dtype=bool)
    slopes = fit.slopes(fit.base, everything)
    slopes *= _SHARE * np.maximum(np.abs(fit.base), _SHARE)
    left = list(range(len(fit.names)))
    lost: list[str] = []
    while left:
        effects = []
        for k in left:
            others = slopes[:, [j for j in left if j != k]]
            own = slopes[:, k]
            fitted = others @ np.linalg.lstsq(others, own, rcond=None)[0] if len(left) > 1 else 0.0
            effects.append(float(np.sqrt(np.mean((own - fitted) ** 2))))
        weakest = int(np.argmin(effects))
        if effects[weakest] >= _LEAST_EFFECT_W:
            break
        lost.append(fit.names[left.pop(weakest)])
    return tuple(lost)


def identify(
    scenario: Scenario, frame: pd.DataFrame, names: Sequence[str] = FITTED
) -> Identification:
    """Fit a vehicle's parameters to flights and judge them.

    Parameters
    ----------
    scenario : Scenario
        Of `vehicle_scenario`.
    frame : DataFrame
        Of `read_logs`, of two flights at least.

    Raises
    ------
    ScenarioError
        If there is one flight only.
    """
    flights = frame[FLIGHT].unique()
    if len(flights) < 2:
        raise ScenarioError(
            "logs: one flight only; identification needs two at least, so that one can judge the "
            "other, and the more the better."
        )
    motion = LoggedMotion(scenario, frame)
    lost = undetermined(Fit(motion, scenario, names))
    fit = Fit(motion, scenario, [name for name in names if name not in lost])
    everything = np.ones(len(frame), dtype=bool)
    values = fit.over(everything)
    draws = fit.drawn_anew(values) if fit.names else np.zeros((1, 0))
    return Identification(
        scenario=scenario.with_values(
            {f"vehicle.{n}": float(v) for n, v in zip(fit.names, values, strict=True)}
        ),
        frame=frame,
        parameters=_parameters(fit, values, draws, scenario, names),
        correlations=pd.DataFrame(draws, columns=list(fit.names)).corr(),
        fitted_power=fit.power(values),
        cross_validated=_cross_validated(fit, values),
        trials=_trials(fit, values),
    )


def _parameters(
    fit: Fit, values: FloatArray, draws: FloatArray, scenario: Scenario, names: Sequence[str]
) -> tuple[Parameter, ...]:
    of_row = fit.frame[FLIGHT].to_numpy()
    halves = [fit.over(np.isin(of_row, half), values) for half in folds(fit.frame, _HALVES)]
    columns = zip(values, draws.std(axis=0), *fit.bounds, *halves, strict=True)
    found = dict(zip(fit.names, columns, strict=True))
    rows = []
    for name in names:
        base = float(getattr(scenario.vehicle, name))
        kept = (base, 0.0, -np.inf, np.inf, base, base)
        value, deviation, low, high, first_half, second_half = found.get(name, kept)
        distance = min(value - low, high - value)
        rows.append(
            Parameter(
                name=name,
                base=base,
                base_source=_base_source(scenario, f"vehicle.{name}"),
                value=float(value),
                first_half=float(first_half),
                second_half=float(second_half),
                deviation=float(deviation),
                is_determined=name in found,
                is_at_bound=bool(distance <= 10 * _NEAR_BOUND * max(1.0, abs(value))),
            )
        )
    return tuple(rows)


def _base_source(scenario: Scenario, field: str) -> str:
    """Return where a number of the base comes from, as its file says."""
    vehicle, kind = scenario.vehicle.use, "vehicles"
    if vehicle in library_names(kind):
        return library_entry(kind, vehicle).sources.get(field, "default")
    return scenario.provenance.get(field, "default")


def _cross_validated(fit: Fit, values: FloatArray) -> FloatArray:
    """Return the power of each row by a fit to the other folds of flights."""
    of_row = fit.frame[FLIGHT].to_numpy()
    power = np.zeros(len(of_row))
    for fold in folds(fit.frame):
        tried = np.isin(of_row, fold)
        power[tried] = fit.power(fit.over(~tried, values))[tried]
    return power


def folds(frame: pd.DataFrame, count: int = _FOLDS) -> list[NDArray[np.object_]]:
    """Return the flights in groups, at most so many, drawn by lot."""
    flights = frame[FLIGHT].unique()
    order = np.random.default_rng(_SEED).permutation(len(flights))
    return [flights[part] for part in np.array_split(order, min(count, len(flights)))]


def _trials(fit: Fit, values: FloatArray) -> tuple[Trial, ...]:
    """Return how fits to heavy flights do on light ones, and fits to slow ones on fast ones."""
    return tuple(
        Trial(
            name=name,
            fitted_on=fitted_on,
            tried_on=tried_on,
            scores=scores(
                fit.frame[tried].reset_index(drop=True),
                fit.power(fit.over(fitted, values))[tried],
            ),
        )
        for name, fitted_on, fitted, tried_on, tried in extrapolations(fit.frame)
    )


def extrapolations(frame: pd.DataFrame) -> list[tuple[str, str, Rows, str, Rows]]:
    """Return name, what is fitted and what is tried, in words and rows, where flights differ."""
    payload = np.round(frame[PAYLOAD].to_numpy() / _PAYLOAD_STEP) * _PAYLOAD_STEP
    speed = cruise_speeds(frame)
    found = []
    if len(np.unique(payload)) > 1:
        most, least = payload.max(), payload.min()
        found.append(
            ("heavy to light", f"{most:g} kg", payload == most, f"{least:g} kg", payload == least)
        )
    groups = np.unique(speed)
    if len(groups) > 1:
        slow = groups[: max(1, int(_SLOW_SHARE * len(groups)))]
        said = " and ".join(f"{one:g}" for one in slow)
        fast = groups[-1]
        found.append(
            (
                "slow to fast",
                f"{said} m/s",
                np.isin(speed, slow),
                f"{fast:g} m/s",
                speed == fast,
            )
        )
    return found


def cruise_speeds(frame: pd.DataFrame) -> FloatArray:
    """Return the usual ground speed in cruise of each row's flight, to the next even m/s."""
    north, east = (frame[name].to_numpy() for name in VELOCITY[:2])
    over_ground = pd.Series(np.hypot(north, east), index=frame.index)
    cruising = over_ground.where(frame[PHASE] == CRUISE)
    usual = cruising.groupby(frame[FLIGHT]).transform(lambda v: v.quantile(_CRUISING))
    return np.nan_to_num(np.round(usual.to_numpy() / _SPEED_STEP) * _SPEED_STEP)


def changes(identification: Identification) -> Mapping[str, tuple[float, str]]:
    """Return the fields that the flights determined: value, and where it comes from."""
    count = identification.frame[FLIGHT].nunique()
    return {
        one.name: (
            one.value,
            f"identified from {count} flights, plus or minus {one.deviation:.2g}"
            + (" (at the least it may be)" if one.is_at_bound else ""),
        )
        for one in identification.parameters
        if one.is_determined
    }
