"""Errors of computed energies on flights that were not fitted.

Method: see docs/theory/identification.md, eq. (5).  The same cross-validation and extrapolations
judge the declared equations and their rivals.
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
"""Rows to fit to -> the power of every row, W, by that fit."""

#: Columns of `energies` beside the flight.
MEASURED_ENERGY, PREDICTED_ENERGY = "measured_energy_J", "predicted_energy_J"
ERROR = "error_percent"
#: Seed of every random choice, so that two runs agree.
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
    """Errors of computed energies and powers of flights.

    Energies are sums over the rows of the phases 1 to 3; the bias is that of the sum over all
    flights.
    """

    flights: int
    mean_absolute_error_percent: float
    bias_percent: float
    power_rmse_W: float


@dataclass(frozen=True, kw_only=True)
class Trial:
    """Errors of a fit to some flights on other flights."""

    name: str
    fitted_on: str
    tried_on: str
    scores: Scores


def energies(frame: pd.DataFrame, power: FloatArray) -> pd.DataFrame:
    """Return measured and computed energy [J] of each flight, with the error in per cent."""
    steps = frame.groupby(FLIGHT, sort=False)[TIME].transform(lambda t: np.median(np.diff(t)))
    columns = {MEASURED_ENERGY: frame[POWER] * steps, PREDICTED_ENERGY: power * steps}
    table = pd.DataFrame({FLIGHT: frame[FLIGHT], **columns})
    table = table.groupby(FLIGHT, sort=False, as_index=False).sum()
    ratio = table[PREDICTED_ENERGY] / table[MEASURED_ENERGY]
    return table.assign(**{ERROR: 100.0 * (ratio - 1.0)})


def scores(frame: pd.DataFrame, power: FloatArray) -> Scores:
    """Compare computed with measured powers, flight by flight."""
    table = energies(frame, power)
    total = table[[MEASURED_ENERGY, PREDICTED_ENERGY]].sum()
    return Scores(
        flights=len(table),
        mean_absolute_error_percent=float(table[ERROR].abs().mean()),
        bias_percent=float(100.0 * (total[PREDICTED_ENERGY] / total[MEASURED_ENERGY] - 1.0)),
        power_rmse_W=float(np.sqrt(np.mean((power - frame[POWER].to_numpy()) ** 2))),
    )


def folds(frame: pd.DataFrame, count: int = _FOLDS) -> list[NDArray[np.object_]]:
    """Divide the flights at random into at most ``count`` groups."""
    flights = frame[FLIGHT].unique()
    order = np.random.default_rng(SEED).permutation(len(flights))
    return [flights[part] for part in np.array_split(order, min(count, len(flights)))]


def cross_validated(frame: pd.DataFrame, fitted: Fitted) -> FloatArray:
    """Return the power of each row [W] by a fit to the flights of the other groups."""
    of_row = frame[FLIGHT].to_numpy()
    power = np.zeros(len(frame))
    for fold in folds(frame):
        tried = np.isin(of_row, fold)
        power[tried] = fitted(~tried)[tried]
    return power


def trials(frame: pd.DataFrame, fitted: Fitted) -> tuple[Trial, ...]:
    """Return the errors of fits to heavy or slow flights on light or fast flights.

    Over payload and over speed, if the flights differ in them.
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
    """Return the usual ground speed in cruise of each row's flight, to the next even m/s."""
    north, east = (frame[name].to_numpy() for name in VELOCITY[:2])
    over_ground = pd.Series(np.hypot(north, east), index=frame.index)
    cruising = over_ground.where(frame[PHASE] == CRUISE)
    usual = cruising.groupby(frame[FLIGHT]).transform(lambda v: v.quantile(_CRUISING))
    return np.nan_to_num(np.round(usual.to_numpy() / _SPEED_STEP) * _SPEED_STEP)
