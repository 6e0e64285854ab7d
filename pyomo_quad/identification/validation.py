"""Errors of computed energies on flights that were not part of the fit.

Method: see docs/theory/identification.md, eq. (5). The errors come from cross-validation and from
extrapolations. They are computed for the package's model and, in the same way, for published
models.

Arguments `frame` are tables of logged flights, with one row per time, as `read_logs` returns them.
The column for the phase tells take-off, cruise and landing apart.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from pyomo_quad.arrays import FloatArray
from pyomo_quad.identification.columns import CRUISE, FLIGHT, PAYLOAD, PHASE, POWER, TIME, VELOCITY

Rows = NDArray[np.bool_]
Fitted = Callable[[Rows], FloatArray]
"""Function that fits a model to the given rows and returns its power in every row [W]."""

#: Columns of `energies` beside the flight.
MEASURED_ENERGY, PREDICTED_ENERGY = "measured_energy_J", "predicted_energy_J"
ERROR = "error_percent"
#: Seed of all random choices of an identification, so that equal runs give equal results.
SEED = 1
_FOLDS = 10
# Speeds, m/s, and payloads, kg, that differ by less belong to the same group.
_SPEED_STEP, _PAYLOAD_STEP = 2.0, 0.01
# Fraction of the speed groups that count as slow.
_SLOW_SHARE = 0.5
# Quantile of a flight's ground speed in cruise that is its usual speed, below the gusts.
_CRUISING = 0.9


@dataclass(frozen=True, kw_only=True)
class Scores:
    """Errors of the computed energies and powers of flights.

    Attributes
    ----------
    flights : int
        Number of flights.
    mean_absolute_error_percent : float
        Mean of the absolute relative errors of the flights' energies.
    bias_percent : float
        100 (computed - measured) / measured, for the sum of the energies of all flights.
    power_rmse_W : float
        Root mean square error of the power over all rows.
    """

    flights: int
    mean_absolute_error_percent: float
    bias_percent: float
    power_rmse_W: float


@dataclass(frozen=True, kw_only=True)
class Trial:
    """Extrapolation test: fit a model to some flights, and compute the energy of other flights.

    Attributes
    ----------
    name : str
        Kind of extrapolation, such as "heavy to light".
    fitted_on, tried_on : str
        Payload or speed of the flights in the fit, and of the other flights.
    scores : Scores
        Errors of the computed energies and powers of the other flights.
    """

    name: str
    fitted_on: str
    tried_on: str
    scores: Scores


def energies(frame: pd.DataFrame, power: FloatArray) -> pd.DataFrame:
    """Compute the measured and the computed energy of each flight [J].

    The energy is the sum over take-off, cruise and landing. `power` is the computed power of each
    row [W]. The column `ERROR` is 100 (computed - measured) / measured [percent].
    """
    steps = frame.groupby(FLIGHT, sort=False)[TIME].transform(lambda t: np.median(np.diff(t)))
    columns = {MEASURED_ENERGY: frame[POWER] * steps, PREDICTED_ENERGY: power * steps}
    table = pd.DataFrame({FLIGHT: frame[FLIGHT], **columns})
    table = table.groupby(FLIGHT, sort=False, as_index=False).sum()
    ratio = table[PREDICTED_ENERGY] / table[MEASURED_ENERGY]
    return table.assign(**{ERROR: 100.0 * (ratio - 1.0)})


def scores(frame: pd.DataFrame, power: FloatArray) -> Scores:
    """Compare computed with measured powers of flights.

    `power` is the computed power of each row of `frame`, shape (n_rows,) [W].
    """
    table = energies(frame, power)
    total = table[[MEASURED_ENERGY, PREDICTED_ENERGY]].sum()
    return Scores(
        flights=len(table),
        mean_absolute_error_percent=float(table[ERROR].abs().mean()),
        bias_percent=float(100.0 * (total[PREDICTED_ENERGY] / total[MEASURED_ENERGY] - 1.0)),
        power_rmse_W=float(np.sqrt(np.mean((power - frame[POWER].to_numpy()) ** 2))),
    )


def folds(frame: pd.DataFrame, count: int = _FOLDS) -> list[NDArray[np.object_]]:
    """Divide the flights at random into `count` groups for cross-validation.

    The result has the names of the flights in each group. Equal flights in equal order give equal
    groups. With fewer flights than `count`, each flight is a group.
    """
    flights = frame[FLIGHT].unique()
    order = np.random.default_rng(SEED).permutation(len(flights))
    return [flights[part] for part in np.array_split(order, min(count, len(flights)))]


def cross_validated(frame: pd.DataFrame, fitted: Fitted) -> FloatArray:
    """Compute the power of each row with a model that was fitted to other flights [W].

    `fitted` takes a boolean array, shape (n_rows,). It fits a model to the rows that are True, and
    returns the power of all rows [W].
    """
    of_row = frame[FLIGHT].to_numpy()
    power = np.zeros(len(frame))
    for fold in folds(frame):
        tried = np.isin(of_row, fold)
        power[tried] = fitted(~tried)[tried]
    return power


def trials(frame: pd.DataFrame, fitted: Fitted) -> tuple[Trial, ...]:
    """Test how a model extrapolates to other payloads and speeds.

    If the payloads differ, a fit to the heaviest payload is tested on the lightest. If the speeds
    differ, a fit to the slower half of the speeds is tested on the fastest. See `cross_validated`
    for `fitted`.
    """

    def trial(name: str, fitted_on: str, seen: Rows, tried_on: str, tried: Rows) -> Trial:
        judged = scores(frame[tried].reset_index(drop=True), fitted(seen)[tried])
        return Trial(name=name, fitted_on=fitted_on, tried_on=tried_on, scores=judged)

    found = []
    payload = np.round(frame[PAYLOAD].to_numpy() / _PAYLOAD_STEP) * _PAYLOAD_STEP
    most, least = payload.max(), payload.min()
    if most > least:
        heavy, light = payload == most, payload == least
        found.append(trial("heavy to light", f"{most:g} kg", heavy, f"{least:g} kg", light))
    speed = cruise_speeds(frame)
    groups = np.unique(speed)
    if len(groups) > 1:
        slow, fast = groups[: max(1, int(_SLOW_SHARE * len(groups)))], groups[-1]
        said = f"{' and '.join(f'{one:g}' for one in slow)} m/s"
        seen, tried = np.isin(speed, slow), speed == fast
        found.append(trial("slow to fast", said, seen, f"{fast:g} m/s", tried))
    return tuple(found)


def cruise_speeds(frame: pd.DataFrame) -> FloatArray:
    """Return the usual ground speed in cruise of each row's flight, shape (n_rows,) [m/s].

    It is the 90 % quantile of the ground speeds in the flight's rows with the phase cruise. It is
    rounded to a multiple of 2 m/s, and 0 for a flight without cruise.
    """
    north, east = (frame[name].to_numpy() for name in VELOCITY[:2])
    over_ground = pd.Series(np.hypot(north, east), index=frame.index)
    cruising = over_ground.where(frame[PHASE] == CRUISE)
    usual = cruising.groupby(frame[FLIGHT]).transform(lambda v: v.quantile(_CRUISING))
    return np.nan_to_num(np.round(usual.to_numpy() / _SPEED_STEP) * _SPEED_STEP)
