"""What `identify` and `predict` write: tables, figures, a vehicle file, a summary and a report.

The figures show flights, their power over time, and the power curve.  Published ways to guess a
flight's power are fitted to the same flights for comparison:

name | power
constant power | one number
constant efficiency | ideal power of hover over one number, P = c (m g)^1.5 / sqrt(rho)
regression by phase | P = a + b (m g)^1.5 / sqrt(rho) in each phase of the flight

The last is the form of Rodrigues et al., "Drone flight data reveal energy and greenhouse gas
emissions savings for very small package delivery", Patterns 3 (2022), fitted anew.
"""

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from numpy.typing import NDArray

from pyomo_quad.flight import Planner
from pyomo_quad.identification.fitting import (
    ERROR,
    MEASURED_ENERGY,
    PREDICTED_ENERGY,
    Identification,
    Scores,
    Trial,
    changes,
    cruise_speeds,
    energies,
    extrapolations,
    folds,
    scores,
)
from pyomo_quad.identification.logs import (
    CRUISE,
    DENSITY,
    FLIGHT,
    FLYING,
    PAYLOAD,
    PHASE,
    POWER,
    TIME,
)
from pyomo_quad.report import Figures
from pyomo_quad.report.document import REPORT_NAME, Drawing, save_drawings, wanted_drawings
from pyomo_quad.report.render import render_markdown
from pyomo_quad.report.style import FULL_WIDTH, INK, MUTED, PALE, SERIES_STYLES
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
        measures=measures(models, found.trials),
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


@dataclass(frozen=True, kw_only=True)
class Measure:
    """How the declared equations do by one measure, beside the rival that does best by it."""

    name: str
    unit: str
    own: float
    rival: str
    best: float

    @property
    def is_gain(self) -> bool:
        """Whether the declared equations err less than every rival."""
        return self.own < self.best


def measures(models: pd.DataFrame, trials: Sequence[Trial]) -> tuple[Measure, ...]:
    """Return by what the models are judged, from the table of the models."""
    *rivals, own = models.to_dict("records")
    columns = {
        "mean_absolute_error_percent": ("energy of a flight", "%"),
        "power_rmse_W": ("power of a second", "W"),
    }
    for number, trial in enumerate(trials, start=1):
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


def _extrapolation(number: int) -> str:
    return f"extrapolation_{number}_error_percent"


def _row(name: str, count: int, judged: list[Scores]) -> Mapping[str, object]:
    first, *others = judged
    return {
        "model": name,
        "numbers_fitted": count,
        "mean_absolute_error_percent": first.mean_absolute_error_percent,
        "bias_percent": first.bias_percent,
        "power_rmse_W": first.power_rmse_W,
        **{
            _extrapolation(k): one.mean_absolute_error_percent
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


_SHOWN = 3
_FASTEST_M_S = 17.0
_FEWEST_ROWS = 20
_KILO = 1e-3


def identification_drawings(found: Identification) -> tuple[Drawing, ...]:
    """List the figures of an identification."""
    return (
        Drawing(
            name="energies",
            title="Energy of each flight",
            caption="Left: computed against measured energy, each flight by a fit that had not "
            "seen it. Right: the error over the measured energy, with the band of two per cent.",
            draw=lambda: draw_energies(found),
        ),
        Drawing(
            name="power_over_time",
            title="Power over time",
            caption="Three flights, slow, usual and fast: measured power of each second, and "
            "computed by a fit that had not seen the flight. Between the dotted lines is cruise.",
            draw=lambda: draw_power(found),
        ),
        Drawing(
            name="power_curve",
            title="The power curve, with the data in it",
            caption="Lines: power of level, steady flight by the declared equations in the mean "
            "density of the flights. Dots: mean measured power of the seconds of cruise at each "
            "airspeed, with half of them inside the bar; gusts and turns are in it.",
            draw=lambda: draw_curve(found),
        ),
    )


def draw_energies(found: Identification) -> Figure:
    """Draw computed against measured energies, and their errors."""
    table = energies(found.frame, found.cross_validated)
    payload = found.frame.groupby(FLIGHT, sort=False)[PAYLOAD].first().to_numpy()
    figure = Figure(figsize=(FULL_WIDTH, 3.3))
    left, right = figure.subplots(1, 2)
    figure.subplots_adjust(left=0.09, right=0.98, top=0.92, bottom=0.15, wspace=0.28)
    measured = table[MEASURED_ENERGY] * _KILO
    ends = [measured.min(), measured.max()]
    left.plot(ends, ends, color=MUTED, linewidth=0.8)
    right.axhspan(-2.0, 2.0, color=PALE, linewidth=0)
    for value, style in zip(np.unique(payload), SERIES_STYLES, strict=False):
        chosen = payload == value
        look = {
            "linestyle": "none",
            "marker": style.marker,
            "color": style.color,
            "markersize": 3.5,
        }
        label = f"{value:g} kg"
        left.plot(measured[chosen], table[PREDICTED_ENERGY][chosen] * _KILO, label=label, **look)
        right.plot(measured[chosen], table[ERROR][chosen], **look)
    left.set(xlabel="Measured energy (kJ)", ylabel="Computed energy (kJ)", title="Energy")
    right.set(xlabel="Measured energy (kJ)", ylabel="Computed less measured (%)", title="Error")
    left.legend(title="Payload", frameon=False)
    return figure


def shown_flights(frame: pd.DataFrame) -> list[object]:
    """Return a slow, a usual and a fast flight."""
    speeds = pd.Series(cruise_speeds(frame), index=frame[FLIGHT].to_numpy())
    each = speeds.groupby(level=0, sort=False).first().sort_values(kind="stable")
    places = np.linspace(0, len(each) - 1, min(_SHOWN, len(each))).round().astype(int)
    return [each.index[place] for place in places]


def draw_power(found: Identification) -> Figure:
    """Draw measured and computed power of three flights over time."""
    chosen = shown_flights(found.frame)
    figure = Figure(figsize=(FULL_WIDTH, 1.7 * len(chosen) + 0.6))
    panels = np.atleast_1d(figure.subplots(len(chosen), 1))
    figure.subplots_adjust(left=0.09, right=0.98, top=0.94, bottom=0.12, hspace=0.55)
    speeds = cruise_speeds(found.frame)
    for flight, panel in zip(chosen, panels, strict=True):
        is_own = (found.frame[FLIGHT] == flight).to_numpy()
        rows = found.frame[is_own]
        times = rows[TIME] - rows[TIME].iloc[0]
        panel.plot(times, rows[POWER], color=MUTED, linewidth=0.9, label="measured")
        panel.plot(
            times,
            found.cross_validated[is_own],
            color=SERIES_STYLES[0].color,
            linewidth=1.3,
            label="computed",
        )
        cruise = times[(rows[PHASE] == CRUISE).to_numpy()]
        for edge in () if cruise.empty else (cruise.iloc[0], cruise.iloc[-1]):
            panel.axvline(edge, color=INK, linestyle=":", linewidth=0.8)
        panel.set(
            ylabel="Power (W)",
            title=f"Flight {flight}: {speeds[is_own][0]:g} m/s, {rows[PAYLOAD].iloc[0]:g} kg",
        )
    panels[-1].set_xlabel("Time (s)")
    panels[0].legend(frameon=False, ncols=2, loc="lower center")
    return figure


def draw_curve(found: Identification) -> Figure:
    """Draw steady power over airspeed for each payload, with the data."""
    is_cruise = (found.frame[PHASE] == CRUISE).to_numpy()
    frame, airspeed = found.frame[is_cruise], found.airspeeds[is_cruise]
    fastest = min(_FASTEST_M_S, float(airspeed.max()))
    figure = Figure(figsize=(FULL_WIDTH, 3.6))
    axes = figure.subplots()
    figure.subplots_adjust(left=0.09, right=0.98, top=0.96, bottom=0.14)
    speeds = np.linspace(0.0, fastest, 35)
    density = float(found.frame[DENSITY].mean())
    for payload, style in zip(np.unique(frame[PAYLOAD]), SERIES_STYLES, strict=False):
        power = steady_power(found, float(payload), density, speeds)
        axes.plot(speeds, power, color=style.color, label=f"{payload:g} kg")
        chosen = (frame[PAYLOAD] == payload).to_numpy()
        groups = frame[POWER][chosen].groupby(np.round(airspeed[chosen]))
        binned = groups.agg(
            ["mean", "size", lambda v: v.quantile(0.25), lambda v: v.quantile(0.75)]
        )
        binned = binned[binned["size"] >= _FEWEST_ROWS]
        mean, _, low, high = binned.to_numpy().T
        reach = np.abs(np.stack([mean - low, high - mean]))
        axes.errorbar(
            binned.index + 0.12 * style_shift(style.marker),
            mean,
            yerr=reach,
            linestyle="none",
            marker=style.marker,
            markersize=4,
            color=style.color,
            elinewidth=0.7,
        )
    axes.set(xlabel="Airspeed (m/s)", ylabel="Power (W)")
    axes.legend(title="Payload", frameon=False)
    return figure


def style_shift(marker: str) -> int:
    """Return by how many steps the bars of a series are set aside, so that none hides another."""
    markers = [style.marker for style in SERIES_STYLES]
    return markers.index(marker) - 1


def steady_power(
    found: Identification, payload: float, density: float, speeds: Sequence[float] | np.ndarray
) -> np.ndarray:
    """Return the power of level flight at each of some airspeeds, W."""
    scenario = found.scenario.with_values(
        {"vehicle.payload": payload, "power.air_density": density}
    )
    steady = Planner().steady_flight(scenario)
    return np.array([steady.trim([float(speed), 0.0, 0.0]).power_W for speed in speeds])
