"""Published ways to guess a flight's power, fitted to the same flights for comparison.

name | power
constant power | one number
constant efficiency | ideal power of hover over one number, P = c (m g)^1.5 / sqrt(rho)
regression by phase | P = a + b (m g)^1.5 / sqrt(rho) in each phase of the flight

The last is the form of Rodrigues et al., "Drone flight data reveal energy and greenhouse gas
emissions savings for very small package delivery", Patterns 3 (2022), fitted anew.
"""

from collections.abc import Callable

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from pyomo_quad.identification.fitting import Scores, extrapolations, folds, scores
from pyomo_quad.identification.logs import DENSITY, FLIGHT, FLYING, PAYLOAD, PHASE, POWER

FloatArray = NDArray[np.float64]


def _hovering(frame: pd.DataFrame, mass: float) -> FloatArray:
    return ((mass + frame[PAYLOAD]) ** 1.5 / np.sqrt(frame[DENSITY])).to_numpy()


def _constant_power(frame: pd.DataFrame, _mass: float) -> FloatArray:
    return np.ones((len(frame), 1))


def _constant_efficiency(frame: pd.DataFrame, mass: float) -> FloatArray:
    return _hovering(frame, mass)[:, None]


def _by_phase(frame: pd.DataFrame, mass: float) -> FloatArray:
    is_in = [(frame[PHASE] == phase).to_numpy(float) for phase in FLYING]
    return np.column_stack([*is_in, *(one * _hovering(frame, mass) for one in is_in)])


_TERMS: dict[str, Callable[[pd.DataFrame, float], FloatArray]] = {
    "constant power": _constant_power,
    "constant efficiency": _constant_efficiency,
    "regression by phase": _by_phase,
}


def regression_scores(frame: pd.DataFrame, mass: float) -> dict[str, tuple[int, list[Scores]]]:
    """Return, by name, the count of numbers fitted and the scores.

    Those of cross-validation come first, then those of each extrapolation.
    """
    of_row, measured = frame[FLIGHT].to_numpy(), frame[POWER].to_numpy()
    found = {}
    for name, terms in _TERMS.items():
        columns = terms(frame, mass)

        def fitted(rows: NDArray[np.bool_], columns: FloatArray = columns) -> FloatArray:
            return columns @ np.linalg.lstsq(columns[rows], measured[rows], rcond=None)[0]

        power = np.zeros(len(frame))
        for fold in folds(frame):
            tried = np.isin(of_row, fold)
            power[tried] = fitted(~tried)[tried]
        judged = [scores(frame, power)]
        for _, _, seen, _, tried in extrapolations(frame):
            judged.append(scores(frame[tried].reset_index(drop=True), fitted(seen)[tried]))
        found[name] = columns.shape[1], judged
    return found
