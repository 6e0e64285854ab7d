"""Output files of the commands `identify` and `predict`.

The command `identify` fits the parameters of a vehicle to measured flights. The command `predict`
computes the energy of measured flights with a given vehicle. The files are tables, figures, a
report text, a summary, and the files of the identified vehicle and battery.
"""

from collections.abc import Iterator, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from pyomo_quad.arrays import FloatArray
from pyomo_quad.identification.columns import DENSITY, FLIGHT, PAYLOAD
from pyomo_quad.identification.figures import identification_drawings
from pyomo_quad.identification.fitting import Identification, changes
from pyomo_quad.identification.pack import DEPENDENT, LEAST_CHARGE, PackIdentification
from pyomo_quad.identification.rivals import measures, model_table
from pyomo_quad.identification.validation import (
    ERROR,
    MEASURED_ENERGY,
    PREDICTED_ENERGY,
    Scores,
    energies,
    scores,
)
from pyomo_quad.report import Figures
from pyomo_quad.report.document import write_study
from pyomo_quad.report.tables import write_summary, write_table
from pyomo_quad.scenario.fields import leaves, spell
from pyomo_quad.scenario.resolution import read_toml
from pyomo_quad.scenario.toml_text import inline
from pyomo_quad.version import __version__

VEHICLE_NAME = "vehicle.toml"
PACK_NAME = "pack.toml"
PREDICTIONS_NAME = "predictions.csv"
_PARAMETERS_NAME, _MODELS_NAME = "parameters.csv", "models.csv"
_VOLTAGES_NAME = "voltages.csv"
# Range of airspeeds [m/s] between hover and the speed at which the rotors leave their own wake.
_SLOW_M_S = (1.0, 4.0)
# Number of flights listed with the largest errors.
_WORST = 5


def write_identification(
    folder: Path,
    found: Identification,
    base: str,
    figures: Figures = Figures.SVG,
    pack: PackIdentification | None = None,
) -> None:
    """Write the results of an identification: vehicle file, report, tables and figures.

    `folder` must exist and be empty. `base` is the vehicle before the fit: the name of a vehicle in
    the package's library, or the path of a vehicle file. `figures` chooses the file format of the
    figures. `pack` is the battery fitted to the same flights.
    """
    battery = ""
    if pack is not None:
        battery = PACK_NAME
        (folder / PACK_NAME).write_text(pack_file(pack), encoding="utf-8")
    vehicle = vehicle_file(changes(found), base, battery)
    (folder / VEHICLE_NAME).write_text(vehicle, encoding="utf-8")
    frame, table = found.frame, energies(found.frame, found.cross_validated)
    models = model_table(found)
    by_error = table[ERROR].abs().sort_values(ascending=False).index
    write_study(
        folder,
        "identification/report.md.j2",
        tables={
            PREDICTIONS_NAME: table,
            _PARAMETERS_NAME: pd.DataFrame([asdict(one) for one in found.parameters]),
            _MODELS_NAME: models,
            **({} if pack is None else {_VOLTAGES_NAME: pack.flights}),
        },
        summary=identification_summary(found, pack),
        drawings=identification_drawings(found, pack),
        figures=figures,
        found=found,
        base=base,
        flights=frame[FLIGHT].nunique(),
        rows=len(frame),
        seen=scores(frame, found.fitted_power),
        unseen=scores(frame, found.cross_validated),
        payloads=np.unique(frame[PAYLOAD]).tolist(),
        densities=(float(frame[DENSITY].min()), float(frame[DENSITY].max())),
        slow_m_s=_SLOW_M_S,
        slow_excess_W=found.excess(*_SLOW_M_S),
        models=models.to_dict("records"),
        measures=measures(models, found.trials),
        worst=table.reindex(by_error).head(_WORST).to_dict("records"),
        VEHICLE_NAME=VEHICLE_NAME,
        pack=pack,
        least_charge_percent=0.0 if pack is None else pack.flights[LEAST_CHARGE].min(),
        PACK_NAME=PACK_NAME,
        VOLTAGES_NAME=_VOLTAGES_NAME,
        energy_columns=(FLIGHT, MEASURED_ENERGY, PREDICTED_ENERGY, ERROR),
    )


def identification_summary(
    found: Identification, pack: PackIdentification | None = None
) -> dict[str, object]:
    """Return the results of an identification as a dictionary for `summary.json`.

    `pack` is the battery fitted to the same flights, if the logs have voltages.
    """
    of_pack = {} if pack is None else {"pack": _pack_summary(pack)}
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
        **of_pack,
        "version": __version__,
    }


def _pack_summary(pack: PackIdentification) -> dict[str, object]:
    return {
        "parameters": {one.name: asdict(one) for one in pack.parameters},
        "flights": len(pack.flights),
        "cross_validated_mV_per_cell": pack.error_mV,
        "cross_validated_with_a_middling_resistance_mV_per_cell": pack.error_unread_mV,
        "base_mV_per_cell": pack.base_error_mV,
    }


def pack_file(pack: PackIdentification) -> str:
    """Return the text of a battery file (TOML) with the fitted battery and sources of its values.

    The file lists all fields of the battery except the state of health.
    """
    battery = pack.scenario.battery
    deviations = {one.name: one.deviation for one in pack.parameters}
    fields = {}
    for path, value in leaves(battery.model_dump(exclude={"use", "health"}, exclude_none=True)):
        name = spell(path)
        source = f"as {battery.use}"
        if name in deviations:
            source = (
                f"identified from the voltages of {len(pack.flights)} flights, plus or minus "
                f"{deviations[name]:.2g}"
            )
        elif name == DEPENDENT:
            source = f"with E0, so that the full cell keeps the voltage of {battery.use}"
        number = float(f"{value:.6g}") if isinstance(value, float) else value
        fields[name] = {"value": number, "source": source}
    return "\n".join(_toml_lines({"fields": fields})) + "\n"


def write_predictions(folder: Path, frame: pd.DataFrame, power: FloatArray) -> Scores:
    """Write the computed energy of each flight and a summary into an empty folder.

    `frame` has the logged flights with measured power, one row per time. `power` is the computed
    power of each row, shape (n_rows,) [W]. The result has the errors of the computed energies and
    powers.
    """
    write_table(energies(frame, power), folder / PREDICTIONS_NAME)
    found = scores(frame, power)
    write_summary(folder, asdict(found))
    return found


def vehicle_file(changed: Mapping[str, tuple[float, str]], base: str, battery: str = "") -> str:
    """Return the text of a vehicle file: a base vehicle with some fields changed.

    `changed` has value and source by field name. `base` is a vehicle of the library or the path of
    a vehicle file. `battery` is the name of a battery file in the folder in which the text will be
    saved. It replaces the battery of `base`. If it is empty, the battery of `base` is kept.
    """
    file = Path(base)
    held: dict[str, Any] = read_toml(file) if file.suffix == ".toml" else {"use": base}
    pack = held.get("battery", "")
    if pack.endswith(".toml"):  # a file beside the base's, which may lie elsewhere
        held["battery"] = (file.parent / pack).resolve().as_posix()
    if battery:
        held["battery"] = battery
    fields = dict(held.pop("fields", {}))
    fields |= {
        name: {"value": float(f"{value:.6g}"), "source": source}
        for name, (value, source) in changed.items()
    }
    return "\n".join([*_toml_lines(held), *_toml_lines({"fields": fields})]) + "\n"


def _toml_lines(table: Mapping[str, Any], path: str = "") -> Iterator[str]:
    """Yield the lines of a vehicle or battery file (TOML), one for each entry.

    An entry is a value, or a number with its source. `path`, such as ``fields.``, precedes the keys
    of a nested table.
    """
    for name, content in table.items():
        key = f"{path}{name}"
        if isinstance(content, Mapping) and "value" not in content:
            yield from _toml_lines(content, f"{key}.")
        else:
            yield f"{key} = {inline(content)}"
