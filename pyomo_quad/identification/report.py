"""What `identify` and `predict` write: tables, a vehicle file, a summary and a report."""

import json
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from pyomo_quad.identification.figures import identification_drawings
from pyomo_quad.identification.fitting import (
    ERROR,
    MEASURED_ENERGY,
    PREDICTED_ENERGY,
    Identification,
    Scores,
    changes,
    energies,
    scores,
)
from pyomo_quad.identification.logs import DENSITY, FLIGHT, PAYLOAD
from pyomo_quad.identification.regressions import regression_scores
from pyomo_quad.report import Figures
from pyomo_quad.report.gallery import save_drawings, wanted_drawings
from pyomo_quad.report.render import render_markdown
from pyomo_quad.report.report import REPORT_NAME
from pyomo_quad.report.tables import write_summary, write_table
from pyomo_quad.scenario.resolution import read_toml
from pyomo_quad.version import __version__

VEHICLE_NAME = "vehicle.toml"
PREDICTIONS_NAME = "predictions.csv"
_PARAMETERS_NAME, _MODELS_NAME = "parameters.csv", "models.csv"
_OURS = "momentum theory, declared"
# Between hover and where the wake is left behind.
_SLOW_M_S = (1.0, 4.0)


def write_identification(
    folder: Path, found: Identification, base: str, figures: Figures = Figures.SVG
) -> None:
    """Write the vehicle file, its report, tables and figures into an empty folder."""
    (folder / VEHICLE_NAME).write_text(_vehicle_file(found, base), encoding="utf-8")
    table = energies(found.frame, found.cross_validated)
    write_table(table, folder / PREDICTIONS_NAME)
    write_table(pd.DataFrame([asdict(one) for one in found.parameters]), folder / _PARAMETERS_NAME)
    models = _models(found)
    write_table(models, folder / _MODELS_NAME)
    write_summary(folder, identification_summary(found))
    drawings = wanted_drawings(identification_drawings(found), figures)
    save_drawings(drawings, folder)
    text = render_markdown(
        "identification/report.md.j2",
        found=found,
        base=base,
        flights=found.frame[FLIGHT].nunique(),
        rows=len(found.frame),
        seen=scores(found.frame, found.fitted_power),
        unseen=scores(found.frame, found.cross_validated),
        payloads=np.unique(found.frame[PAYLOAD]).tolist(),
        densities=(float(found.frame[DENSITY].min()), float(found.frame[DENSITY].max())),
        slow_m_s=_SLOW_M_S,
        slow_excess_W=found.excess(*_SLOW_M_S),
        models=models.to_dict("records"),
        drawings=drawings,
        worst=table.reindex(table[ERROR].abs().sort_values(ascending=False).index)
        .head(5)
        .to_dict("records"),
        version=__version__,
        VEHICLE_NAME=VEHICLE_NAME,
        energy_columns=(FLIGHT, MEASURED_ENERGY, PREDICTED_ENERGY, ERROR),
        PREDICTIONS_NAME=PREDICTIONS_NAME,
        PARAMETERS_NAME=_PARAMETERS_NAME,
        MODELS_NAME=_MODELS_NAME,
    )
    (folder / REPORT_NAME).write_text(text, encoding="utf-8")


def identification_summary(found: Identification) -> dict[str, object]:
    """Return what an identification found, as only JSON can hold it."""
    return {
        "flights": int(found.frame[FLIGHT].nunique()),
        "parameters": {one.name: asdict(one) for one in found.parameters},
        "fitted": asdict(scores(found.frame, found.fitted_power)),
        "cross_validated": asdict(scores(found.frame, found.cross_validated)),
        "extrapolated": {
            trial.name: {
                "fitted_on": trial.fitted_on,
                "tried_on": trial.tried_on,
                **asdict(trial.scores),
            }
            for trial in found.trials
        },
        "version": __version__,
    }


def write_predictions(folder: Path, frame: pd.DataFrame, power: np.ndarray) -> Scores:
    """Write the energy of each flight and a summary into an empty folder; return the scores."""
    write_table(energies(frame, power), folder / PREDICTIONS_NAME)
    found = scores(frame, power)
    write_summary(folder, asdict(found))
    return found


def _models(found: Identification) -> pd.DataFrame:
    """Return one row a model: numbers fitted, and errors by the same validation."""
    rows = [
        _row(name, count, judged)
        for name, (count, judged) in regression_scores(
            found.frame, found.scenario.vehicle.mass
        ).items()
    ]
    own = [scores(found.frame, found.cross_validated), *(trial.scores for trial in found.trials)]
    count = sum(one.is_determined for one in found.parameters)
    return pd.DataFrame([*rows, _row(_OURS, count, own)])


def _row(name: str, count: int, judged: list[Scores]) -> Mapping[str, object]:
    first, *others = judged
    return {
        "model": name,
        "numbers_fitted": count,
        "mean_absolute_error_percent": first.mean_absolute_error_percent,
        "bias_percent": first.bias_percent,
        "power_rmse_W": first.power_rmse_W,
        **{
            f"extrapolation_{k}_error_percent": one.mean_absolute_error_percent
            for k, one in enumerate(others, start=1)
        },
    }


def _vehicle_file(found: Identification, base: str) -> str:
    """Return a vehicle file: what the base's file says, with what the flights determined."""
    file = Path(base)
    told: dict[str, Any] = read_toml(file) if file.suffix == ".toml" else {"use": base}
    fields = dict(told.pop("fields", {}))
    fields |= {
        name: {"value": float(f"{value:.6g}"), "source": source}
        for name, (value, source) in changes(found).items()
    }
    return "\n".join([*_toml_lines(told), *_toml_lines({"fields": fields})]) + "\n"


def _toml_lines(table: Mapping[str, Any], path: str = "") -> Iterator[str]:
    """Yield TOML with dotted keys, one number and its source a line."""
    for name, content in table.items():
        key = f"{path}{name}"
        if not isinstance(content, Mapping):
            yield f"{key} = {_quoted(content)}"
        elif "value" in content:
            parts = ", ".join(f"{k} = {_quoted(v)}" for k, v in content.items())
            yield f"{key} = {{ {parts} }}"
        else:
            yield from _toml_lines(content, f"{key}.")


def _quoted(value: object) -> str:
    # TOML has no surrogates, by which JSON escapes what lies beyond 16 bits.
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
