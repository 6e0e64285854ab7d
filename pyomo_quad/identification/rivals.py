"""Published models of a multirotor's power, as rivals of the package's own model.

name | power
constant power | P = a
constant efficiency | proportional to the ideal power of hover, P = c (m g)^1.5 / sqrt(rho)
regression by phase | P = a + b (m g)^1.5 / sqrt(rho), with own a and b in each phase of the flight

P is the power, m the mass with payload, g gravity, and rho the air density; a, b and c are fitted.
All models are fitted and validated in the same way, on the same flights. An extrapolation test fits
a model to flights with some payloads or speeds, and computes the energies of flights with others.

Arguments `frame` are the table of these flights: one row per time, with the columns
`identification.columns.COLUMNS`. The regression by phase has the form of Rodrigues et al., "Drone
flight data reveal energy and greenhouse gas emissions savings for very small package delivery",
Patterns 3 (2022).
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np
import pandas as pd

from pyomo_quad.arrays import FloatArray
from pyomo_quad.identification.columns import DENSITY, FLYING, PAYLOAD, PHASE, POWER
from pyomo_quad.identification.fitting import Identification
from pyomo_quad.identification.validation import (
    Rows,
    Scores,
    Trial,
    cross_validated,
    scores,
    trials,
)

_OURS = "momentum theory, declared"


def model_table(found: Identification) -> pd.DataFrame:
    """Tabulate the errors of the published power models and of the identified model.

    The columns are `model`, `numbers_fitted`, the errors of `Scores` in cross-validation, and one
    column for each extrapolation test, from `extrapolation_1_error_percent` on. Its values are mean
    absolute relative errors of the flights' energies. The last row is the identified model.
    """
    frame, measured = found.frame, found.frame[POWER].to_numpy()
    rows = []
    for name, columns in _regressors(frame, found.scenario.vehicle.mass).items():

        def fitted(rows: Rows, columns: FloatArray = columns) -> FloatArray:
            return columns @ np.linalg.lstsq(columns[rows], measured[rows], rcond=None)[0]

        judged = scores(frame, cross_validated(frame, fitted))
        rows.append(_row(name, columns.shape[1], judged, trials(frame, fitted)))
    count = sum(one.is_determined for one in found.parameters)
    own = scores(frame, found.cross_validated)
    return pd.DataFrame([*rows, _row(_OURS, count, own, found.trials)])


def _regressors(frame: pd.DataFrame, mass: float) -> dict[str, FloatArray]:
    """Return the regressors of each published power model, by the model's name.

    Each model is linear in its parameters p: power = X p, with the matrix X of regressors, shape
    (n_rows, n_parameters). `mass` is without payload [kg].
    """
    hovering = ((mass + frame[PAYLOAD]) ** 1.5 / np.sqrt(frame[DENSITY])).to_numpy()[:, None]
    phases = (frame[[PHASE]].to_numpy() == FLYING).astype(float)
    return {
        "constant power": np.ones((len(frame), 1)),
        "constant efficiency": hovering,
        "regression by phase": np.hstack([phases, phases * hovering]),
    }


def _row(name: str, count: int, judged: Scores, tried: Sequence[Trial]) -> dict[str, object]:
    errors = asdict(judged)
    del errors["flights"]
    beyond = {
        _extrapolation(number): trial.scores.mean_absolute_error_percent
        for number, trial in enumerate(tried, start=1)
    }
    return {"model": name, "numbers_fitted": count, **errors, **beyond}


def _extrapolation(number: int) -> str:
    return f"extrapolation_{number}_error_percent"


@dataclass(frozen=True, kw_only=True)
class Measure:
    """Comparison of the identified model with the best published model, for one kind of error.

    Attributes
    ----------
    name, unit : str
        Kind of error, and its unit.
    own : float
        Error of the identified model.
    rival, best : str, float
        Published model with the least error, and this error.
    """

    name: str
    unit: str
    own: float
    rival: str
    best: float

    @property
    def is_gain(self) -> bool:
        """Whether the identified model has a smaller error than every published model."""
        return self.own < self.best


def measures(models: pd.DataFrame, tried: Sequence[Trial]) -> tuple[Measure, ...]:
    """Compare the identified model with the best published model, for each kind of error.

    `models` comes from `model_table` and has the errors of all models. `tried` describes the
    extrapolation tests: the first is that of the column `extrapolation_1_error_percent`, and so on.
    The kinds are the errors of a flight's energy, of the power in a row of the log, and of the
    energy in each extrapolation test.
    """
    *rivals, own = models.to_dict("records")
    columns = {
        "mean_absolute_error_percent": ("energy of a flight", "%"),
        "power_rmse_W": ("power of a second", "W"),
    }
    for number, trial in enumerate(tried, start=1):
        said = f"energy when fitted at {trial.fitted_on} and tried at {trial.tried_on}"
        columns[_extrapolation(number)] = (said, "%")
    best = {column: min(rivals, key=lambda row: float(row[column])) for column in columns}
    return tuple(
        Measure(
            name=name,
            unit=unit,
            own=float(own[column]),
            rival=str(best[column]["model"]),
            best=float(best[column][column]),
        )
        for column, (name, unit) in columns.items()
    )
