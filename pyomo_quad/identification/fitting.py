"""Fit of a vehicle's power parameters to logged flights, with their uncertainty.

Method: robust least squares; see docs/theory/identification.md, eqs. (2) to (4).

A residual is the mean computed power minus the mean measured power in a time window of 10 s. The
average reduces the noise of airspeed and acceleration in the rows of the log. Large residuals, for
example in gusts or ground effect, count linearly instead of quadratically.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.optimize import least_squares

from pyomo_quad.arrays import FloatArray
from pyomo_quad.identification.columns import AIR_VELOCITY, CRUISE, FLIGHT, PHASE, POWER, TIME
from pyomo_quad.identification.motion import LoggedMotion
from pyomo_quad.identification.validation import SEED, Rows, Trial, cross_validated, folds, trials
from pyomo_quad.scenario import Scenario, ScenarioError, library_entry, library_names
from pyomo_quad.scenario.tables import Vehicle

#: Fields of the vehicle that are fitted by default. The induced power factor is excluded: in hover,
#: induced and profile power depend on thrust in the same way, so that flights cannot distinguish
#: them. It keeps its textbook value.
FITTED = ("profile_power_coefficient", "climb_power_factor", "descent_power_factor")
#: All fields that can be fitted.
FITTABLE = (
    *FITTED,
    "induced_power_factor",
    "profile_advance_factor",
    "electronics_power",
    "drag_linear",
    "drag_quadratic",
)
_POWER_BLOCK, _VEHICLE_BLOCK = "power.", "vehicle."
# Parameters on which the motion depends, with the exponent of the airspeed that each multiplies.
_OF_MOTION = {"drag_linear": 1, "drag_quadratic": 2}
# Length of a window, s: long compared with the noise of airspeed and acceleration.
_WINDOW_S = 10.0
# Residual, W, above which a window counts linearly instead of quadratically.
_LARGE_RESIDUAL_W = 20.0
# The flights determine a parameter if a change by the fraction `_SHARE` of its value, with the best
# compensation by the other parameters, changes the windows' power by at least the fraction
# `_LEAST_EFFECT`: 0.5 W of 450 W.
_SHARE = 0.1
_LEAST_EFFECT = 1.1e-3
# Drag coefficient [kg/s or kg/m] that is tested in place of a smaller one; see `undetermined`.
_SMALL_DRAG = 0.02
# Cosine between the effects of two parameters above which they cannot be distinguished.
_ALIKE = 0.95
# Numbers of rows and flights below which a caution is given; number of rows above which the test
# with every other row would take too long.
_FEW_ROWS, _FEW_FLIGHTS, _MANY_ROWS = 300, 5, 5_000
# Change of a parameter, in standard deviations and relative, by a fit to every other row above
# which the rows count as too far apart in time.
_DEVIATIONS, _CHANGE = 2.0, 0.05
_HALVES = 2
# Bootstrap draws of flights: 200 draws give a standard deviation to 5 %.
_DRAWS = 200
# Step of the difference quotients, relative to a parameter's size.
_STEP = 1e-3
# Relative distance from a bound at which a fit starts; ten times that counts as at the bound.
_NEAR_BOUND, _AT_BOUND = 1e-6, 1e-5


@dataclass(frozen=True, kw_only=True)
class FittedParameter:
    """Result of a fit for one field of a vehicle, such as a drag coefficient.

    Attributes
    ----------
    name : str
        Name of the field.
    base, value, deviation : float
        Value before the fit, fitted value, and its standard deviation, which is 0 if the field is
        not determined.
    is_determined : bool
        Whether the measurements determine the field. Otherwise, `value` equals `base`.
    is_at_bound : bool
        Whether the fitted value lies at an end of its permitted range.
    """

    name: str
    base: float
    value: float
    deviation: float
    is_determined: bool
    is_at_bound: bool


@dataclass(frozen=True, kw_only=True)
class IdentifiedParameter:
    """Field of a vehicle that was fitted to flights, with its uncertainty.

    Attributes
    ----------
    name : str
        Name of the field.
    base, base_source : float, str
        Value before the fit, and its source in words, for example an earlier fit to flights.
    value : float
        Fitted value.
    first_half, second_half : float
        Values fitted to one half of the flights and to the other.
    deviation : float
        Standard deviation by bootstrap over the flights; 0 if undetermined.
    is_determined : bool
        Whether the flights determine the field. If not, all values equal `base`.
    is_at_bound : bool
        Whether `value` is at a bound.
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
class Identification:
    """Vehicle identified from flights, with the errors of its computed powers.

    Attributes
    ----------
    scenario : Scenario
        Scenario with the fitted vehicle.
    frame : DataFrame
        Rows of all flights.
    parameters : tuple of IdentifiedParameter
        Result for each field that was to be fitted.
    correlations : DataFrame
        Correlation matrix of the fitted parameters.
    fitted_power, cross_validated : ndarray, shape (n_rows,)
        Power computed by the fit to all flights, and by a fit without the row's flight [W].
    trials : tuple of Trial
        Extrapolation tests: errors for the lightest payload or the fastest speed, of a fit to
        flights with the heaviest payload or slower speeds.
    together : tuple of (str, str)
        Pairs for the fields that the flights do not determine: the field, and the other field that
        has the most similar effect on the power. The latter is "" if no effect is similar.
    cautions : tuple of str
        Warnings that the rows are too few or too far apart in time.
    """

    scenario: Scenario
    frame: pd.DataFrame
    parameters: tuple[IdentifiedParameter, ...]
    correlations: pd.DataFrame
    fitted_power: FloatArray
    cross_validated: FloatArray
    trials: tuple[Trial, ...]
    together: tuple[tuple[str, str], ...] = ()
    cautions: tuple[str, ...] = ()

    @property
    def airspeeds(self) -> FloatArray:
        """Horizontal component of the true airspeed in each row [m/s]."""
        north, east = (self.frame[name].to_numpy() for name in AIR_VELOCITY)
        return np.hypot(north, east) * self.scenario.vehicle.anemometer_factor

    def excess(self, slowest: float, fastest: float) -> float:
        """Return the mean of measured minus computed power in cruise, in a range of airspeeds [W].

        The computed power is that of the fit to all flights. The horizontal airspeed v satisfies
        slowest <= v < fastest [m/s]. Without such rows, the result is NaN.
        """
        is_between = (slowest <= self.airspeeds) & (self.airspeeds < fastest)
        is_meant = (self.frame[PHASE] == CRUISE).to_numpy() & is_between
        if not is_meant.any():
            return np.nan
        return float((self.frame[POWER].to_numpy() - self.fitted_power)[is_meant].mean())


class Fit:
    """Least-squares fit of a vehicle's parameters to the power of logged flights.

    Parameters
    ----------
    motion : LoggedMotion
        Motion of the flights, from which the power is computed.
    scenario : Scenario
        Scenario with the vehicle before the fit, whose values are the initial values.
    names : sequence of str
        The n fields to fit, from `FITTABLE`: the parameters of the least-squares problem.
    """

    def __init__(self, motion: LoggedMotion, scenario: Scenario, names: Sequence[str]) -> None:
        self._motion = motion
        self.frame = motion.frame
        self.names = tuple(names)
        self.base = np.array([getattr(scenario.vehicle, name) for name in names])
        self.bounds = np.array([_bounds(name) for name in names]).T.reshape(2, len(self.names))
        for k, name in enumerate(self.names):
            if name in _OF_MOTION:
                self.bounds[1, k] = _most_drag(scenario, self.frame, _OF_MOTION[name])
        self._scenario = scenario
        self._window = _windows(self.frame)
        self._measured = self.frame[POWER].to_numpy()
        self.everything = np.ones(len(self.frame), dtype=bool)

    def power(self, values: FloatArray) -> FloatArray:
        """Compute the vehicle's power in each row of the log, for given values of the parameters.

        Parameters
        ----------
        values : ndarray, shape (n,)
            Values of the parameters, in the order of `names`.

        Returns
        -------
        ndarray, shape (n_rows,)
            Power [W].
        """
        named = zip(self.names, values.tolist(), strict=True)
        return self._motion.power({component(name): value for name, value in named})

    def windows(self, power: FloatArray, rows: Rows) -> tuple[FloatArray, NDArray[np.int64]]:
        """Average a measured or computed power over the time windows of the log [W].

        `rows` is True for the rows to average. The results are the mean of each window with such
        rows, and the index of its first such row in the log.
        """
        _, first, inverse = np.unique(self._window[rows], return_index=True, return_inverse=True)
        mean = np.bincount(inverse, power[rows]) / np.bincount(inverse)
        return mean, np.flatnonzero(rows)[first]

    def over(self, rows: Rows, start: FloatArray | None = None) -> FloatArray:
        """Fit the parameters to the measured power in a part of the log, such as half the flights.

        `rows` is True for the rows to use. The iteration starts from `start`, by default the values
        before the fit. The result has shape (n,).
        """
        if not self.names:
            return self.base
        measured, _ = self.windows(self._measured, rows)

        def residual(values: FloatArray) -> FloatArray:
            return self.windows(self.power(values), rows)[0] - measured

        return _robust(residual, self.base if start is None else start, self.bounds)

    def slopes(self, values: FloatArray) -> FloatArray:
        """Return the derivatives of the computed power with respect to each fitted parameter.

        They are finite differences of the power averaged by `windows`, shape (n_windows, n), in W
        per unit of the parameter.
        """
        at, _ = self.windows(self.power(values), self.everything)
        columns = []
        for k in range(len(self.names)):
            moved = values.copy()
            step = _STEP * max(1.0, abs(values[k]))
            moved[k] += step
            columns.append((self.windows(self.power(moved), self.everything)[0] - at) / step)
        return np.column_stack(columns) if columns else np.zeros((len(at), 0))

    def drawn_anew(self, values: FloatArray) -> FloatArray:
        """Return the parameters fitted to random draws of flights (bootstrap), shape (n_draws, n).

        Each draw chooses as many flights as the log has, with replacement. Equal input gives equal
        draws. `values` are those fitted to all flights. See docs/theory/identification.md, eq. (4).
        """
        slopes = self.slopes(values)
        at, first = self.windows(self.power(values), self.everything)
        measured, _ = self.windows(self._measured, self.everything)
        flights, flight = np.unique(self.frame[FLIGHT].to_numpy()[first], return_inverse=True)
        generator = np.random.default_rng(SEED)
        found = []
        for _ in range(_DRAWS):
            counts = np.bincount(
                generator.integers(0, len(flights), len(flights)), minlength=len(flights)
            )
            chosen = np.repeat(np.arange(len(at)), counts[flight])

            def residual(new: FloatArray, chosen: NDArray[np.int64] = chosen) -> FloatArray:
                # Linearised about `values` to save time; exact for parameters in which the power is
                # linear.
                return (at + slopes @ (new - values) - measured)[chosen]

            found.append(_robust(residual, values, self.bounds))
        return np.array(found)

    def applied(self, values: FloatArray) -> Scenario:
        """Return a copy of the scenario in which the vehicle's fitted fields have given values.

        `values` are these values, shape (n,), in the order of `names`.
        """
        named = zip(self.names, values.tolist(), strict=True)
        return self._scenario.with_values({f"vehicle.{name}": value for name, value in named})

    def parameter(self, name: str, values: FloatArray, deviations: FloatArray) -> FittedParameter:
        """Return the result of the fit for one field of the vehicle.

        `values` and `deviations` have the fitted values and their standard deviations, shape (n,).
        A field that was not fitted keeps its value.
        """
        value = base = float(getattr(self._scenario.vehicle, name))
        deviation, distance = 0.0, np.inf
        if name in self.names:
            k = self.names.index(name)
            value, deviation = float(values[k]), float(deviations[k])
            distance = float(np.min(np.abs(self.bounds[:, k] - value)))
        return FittedParameter(
            name=name,
            base=base,
            value=value,
            deviation=deviation,
            is_determined=name in self.names,
            is_at_bound=distance <= _AT_BOUND * max(1.0, abs(value)),
        )


def component(name: str) -> str:
    """Return the full name of the model parameter that corresponds to a field of the vehicle.

    `name` is the field's name. Examples of full names are ``vehicle.drag_linear`` and
    ``power.climb_power_factor``.
    """
    return f"{_VEHICLE_BLOCK if name in _OF_MOTION else _POWER_BLOCK}{name}"


def _robust(residual: object, start: FloatArray, bounds: FloatArray) -> FloatArray:
    low, high = bounds
    inside = np.clip(start, low + _NEAR_BOUND, np.maximum(high - _NEAR_BOUND, low + _NEAR_BOUND))
    found = least_squares(
        residual, inside, bounds=bounds, loss="soft_l1", f_scale=_LARGE_RESIDUAL_W
    )
    return np.asarray(found.x)


def _bounds(name: str) -> tuple[float, float]:
    limits = {type(m).__name__: m for m in Vehicle.model_fields[name].metadata}
    low, high = limits.get("Ge"), limits.get("Le")
    return (0.0 if low is None else float(low.ge), np.inf if high is None else float(high.le))


def _most_drag(scenario: Scenario, frame: pd.DataFrame, power: int) -> float:
    """Return the upper bound of a drag coefficient in the fit [kg/s or kg/m].

    The drag is the coefficient times airspeed^power (1 or 2). At the bound, the drag at the log's
    largest airspeed equals the weight without payload: the vehicle tilts by 45°.
    """
    north, east = (frame[name].to_numpy() for name in AIR_VELOCITY)
    fastest = float(np.hypot(north, east).max()) * scenario.vehicle.anemometer_factor
    return scenario.vehicle.mass * scenario.gravity / max(fastest, 1.0) ** power


def _windows(frame: pd.DataFrame) -> NDArray[np.int64]:
    """Return the number of the 10 s time window of each row of a log, shape (n_rows,).

    No window spans two flights or two phases of a flight, such as take-off and cruise.
    """
    stretch = [frame[FLIGHT], frame[PHASE]]
    since = frame[TIME] - frame.groupby(stretch, sort=False)[TIME].transform("min")
    keys = [*stretch, np.floor(since / _WINDOW_S)]
    return np.asarray(frame.groupby(keys, sort=False).ngroup(), dtype=np.int64)


def undetermined(fit: Fit) -> tuple[str, ...]:
    """Return the names of the parameters that the flights do not determine.

    Such a parameter has almost no effect on the computed power, or changes of the other parameters
    can cancel almost all of its effect. See docs/theory/identification.md, eq. (3).
    """
    slopes = fit.slopes(fit.base)
    # The least magnitude ensures that a parameter with the value 0 is changed, too.
    slopes *= _SHARE * np.maximum(np.abs(fit.base), _size(fit))
    least = _LEAST_EFFECT * float(np.median(fit.frame[POWER]))
    left = list(range(len(fit.names)))
    lost: list[str] = []
    while left:
        effects = []
        for k in left:
            others = slopes[:, [j for j in left if j != k]]
            own = slopes[:, k]
            fitted = others @ np.linalg.lstsq(others, own, rcond=None)[0] if len(left) > 1 else 0.0
            effects.append(float(np.sqrt(np.mean((own - fitted) ** 2))))
        # The weakest is removed first; the others are tested again without it.
        weakest = int(np.argmin(effects))
        if effects[weakest] >= least:
            break
        lost.append(fit.names[left.pop(weakest)])
    return tuple(lost)


def _size(fit: Fit) -> FloatArray:
    """Return the least magnitude m that the function `undetermined` assumes for each parameter p.

    It changes p by 10 % of max(abs(p), m), so that a parameter near zero is changed, too. m is in
    the unit of p.
    """
    return np.array([_SMALL_DRAG if name in _OF_MOTION else _SHARE for name in fit.names])


def confounded(fit: Fit, lost: Sequence[str]) -> tuple[tuple[str, str], ...]:
    """Pair each undetermined parameter in `lost` with the one that has the most similar effect.

    The effect is the derivative of the computed power with respect to the parameter. If no effect
    is similar, the second name of the pair is "".
    """
    slopes = fit.slopes(fit.base)
    norms = np.linalg.norm(slopes, axis=0)
    pairs = []
    for name in lost:
        k = fit.names.index(name)
        likeness = np.abs(slopes.T @ slopes[:, k]) / np.maximum(norms * norms[k], 1e-300)
        likeness[k] = 0.0
        most = int(np.argmax(likeness))
        alike = norms[k] > 0.0 and likeness[most] > _ALIKE
        pairs.append((name, fit.names[most] if alike else ""))
    return tuple(pairs)


def identify(
    scenario: Scenario, frame: pd.DataFrame, names: Sequence[str] = FITTED
) -> Identification:
    """Fit the power parameters of a vehicle to measured flights, and assess the fit.

    `scenario` comes from `vehicle_scenario`, and `frame` from `read_logs`. If there is only one
    flight, or if the vehicle cannot produce a logged acceleration, a ScenarioError is raised.
    """
    flights = frame[FLIGHT].unique()
    if len(flights) < 2:
        raise ScenarioError(
            "logs: one flight only; identification needs at least two flights, one of them for "
            "validation, and is better with more; or give points of steady flight by --steady."
        )
    motion = LoggedMotion(scenario, frame)
    asked = Fit(motion, scenario, names)
    lost = undetermined(asked)
    fit = Fit(motion, scenario, [name for name in names if name not in lost])
    values = fit.over(fit.everything)
    draws = fit.drawn_anew(values) if fit.names else np.zeros((1, 0))

    def fitted(rows: Rows) -> FloatArray:
        return fit.power(fit.over(rows, values))

    return Identification(
        scenario=fit.applied(values),
        frame=frame,
        parameters=_parameters(fit, values, draws, scenario, names),
        correlations=pd.DataFrame(draws, columns=list(fit.names)).corr(),
        fitted_power=fit.power(values),
        cross_validated=cross_validated(frame, fitted),
        trials=trials(frame, fitted),
        together=confounded(asked, lost),
        cautions=tuple(_cautions(scenario, fit, values, draws)),
    )


def _cautions(scenario: Scenario, fit: Fit, values: FloatArray, draws: FloatArray) -> Iterator[str]:
    """Yield warnings if the log has too few rows, or if its rows are too far apart in time.

    A fit to every second row shows whether they are too far apart. `values` are the fitted
    parameters, `draws` their bootstrap samples, shape (n_draws, n).
    """
    frame = fit.frame
    flights, rows = frame[FLIGHT].nunique(), len(frame)
    if rows < _FEW_ROWS or flights < _FEW_FLIGHTS:
        yield (
            f"{rows} rows of {flights} flights are few: with less than {_FEW_ROWS} rows or "
            f"{_FEW_FLIGHTS} flights a fit may be off by many times its deviation; fly more."
        )
    step = float(frame.groupby(FLIGHT, sort=False)[TIME].diff().median())
    every_other = frame[frame.groupby(FLIGHT, sort=False).cumcount() % 2 == 0]
    thinned = every_other.groupby(FLIGHT, sort=False).filter(lambda rows: len(rows) > 1)
    if not fit.names or thinned.empty or rows > _MANY_ROWS:
        return
    motion = LoggedMotion(scenario, thinned.reset_index(drop=True))
    coarse = Fit(motion, scenario, fit.names)
    again = coarse.over(coarse.everything, values)
    for name, value, other, deviation in zip(
        fit.names, values, again, draws.std(axis=0), strict=True
    ):
        allowed = max(_DEVIATIONS * float(deviation), _CHANGE * abs(float(value)))
        if abs(other - value) > allowed:
            yield (
                f"rows of {step:.3g} s are too coarse for this motion: from every second row "
                f"{name} becomes {other:.3g} in place of {value:.3g}; log at 5 Hz or more, or fly "
                "more steadily."
            )


def _parameters(
    fit: Fit, values: FloatArray, draws: FloatArray, scenario: Scenario, names: Sequence[str]
) -> tuple[IdentifiedParameter, ...]:
    of_row, deviations = fit.frame[FLIGHT].to_numpy(), draws.std(axis=0)
    halves = [fit.over(np.isin(of_row, half), values) for half in folds(fit.frame, _HALVES)]
    rows = []
    for name in names:
        first, second = (fit.parameter(name, half, deviations).value for half in halves)
        rows.append(
            IdentifiedParameter(
                **vars(fit.parameter(name, values, deviations)),
                base_source=_base_source(scenario, f"vehicle.{name}"),
                first_half=first,
                second_half=second,
            )
        )
    return tuple(rows)


def _base_source(scenario: Scenario, field: str) -> str:
    """Return the source, in words, of the value that a vehicle's field had before the fit.

    `field` is a dotted path, such as ``vehicle.drag_linear``.
    """
    vehicle, kind = scenario.vehicle.use, "vehicles"
    if vehicle in library_names(kind):
        return library_entry(kind, vehicle).sources.get(field, "default")
    return scenario.provenance.get(field, "default")


def changes(identification: Identification) -> Mapping[str, tuple[float, str]]:
    """Return the fields of the vehicle that the flights determine, with their fitted values.

    Parameters
    ----------
    identification : Identification
        Result of a fit.

    Returns
    -------
    mapping
        Value of each field, and the source of the value in words, by the field's name.
    """
    count = identification.frame[FLIGHT].nunique()
    return {
        one.name: (
            one.value,
            f"identified from {count} flights, plus or minus {one.deviation:.2g}"
            + (" (at the end of its range)" if one.is_at_bound else ""),
        )
        for one in identification.parameters
        if one.is_determined
    }
