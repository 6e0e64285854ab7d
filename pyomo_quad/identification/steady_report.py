"""Output files of the command `identify --steady`: table, figure, vehicle file, summary, text.

The command fits the power model of a vehicle to measured points of steady flight.
"""

from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pyomo_quad.flight import Planner
from pyomo_quad.identification.columns import DENSITY, PAYLOAD, POWER
from pyomo_quad.identification.report import VEHICLE_NAME, vehicle_file
from pyomo_quad.identification.steady import AIRSPEED, SteadyFit, level_powers
from pyomo_quad.report import Figures
from pyomo_quad.report.document import Drawing, write_study
from pyomo_quad.report.style import SERIES_STYLES, LineStyle, full_width
from pyomo_quad.scenario import Scenario
from pyomo_quad.version import __version__

POINTS_NAME = "points.csv"
#: Columns of the table of steady points besides the measurements.
COMPUTED, UNSEEN, ERROR = "computed_W", "computed_unseen_W", "error_percent"
_CURVE_POINTS = 21


def write_steady(folder: Path, found: SteadyFit, base: str, figures: Figures) -> None:
    """Write the results of a fit to points of steady flight: vehicle file, report and tables.

    `folder` must exist and be empty. `base` is the vehicle before the fit: the name of a vehicle in
    the package's library, or the path of a vehicle file (.toml). `figures` chooses the file format
    of the figure.
    """
    table = point_table(found.points, found.power)
    source = f"identified from {len(found.points)} steady points, plus or minus"
    changed = {
        one.name: (one.value, f"{source} {one.deviation:.2g}")
        for one in found.parameters
        if one.is_determined
    }
    (folder / VEHICLE_NAME).write_text(vehicle_file(changed, base), encoding="utf-8")
    write_study(
        folder,
        "identification/steady.md.j2",
        tables={POINTS_NAME: table.assign(**{UNSEEN: found.unseen})},
        summary={
            "points": len(found.points),
            "parameters": {one.name: asdict(one) for one in found.parameters},
            "error_percent": found.error_percent,
            "unseen_error_percent": (
                None if np.isnan(found.unseen_error_percent) else found.unseen_error_percent
            ),
            "together": [list(pair) for pair in found.together],
            "cautions": list(found.cautions),
            "version": __version__,
        },
        drawings=[
            Drawing(
                name="steady",
                title="Power of steady flight",
                caption="Dots: measured. Lines: the declared equations with the fitted numbers.",
                draw=partial(draw_points, found.scenario, found.points, Planner()),
            )
        ],
        figures=figures,
        found=found,
        base=base,
        VEHICLE_NAME=VEHICLE_NAME,
    )


def point_table(points: pd.DataFrame, power: np.ndarray) -> pd.DataFrame:
    """Return the table of steady flight points with computed powers [W] and errors [percent].

    An error is the computed minus the measured power, divided by the measured power.
    """
    return points.assign(**{COMPUTED: power, ERROR: 100.0 * (power / points[POWER] - 1.0)})


def draw_points(scenario: Scenario, points: pd.DataFrame, planner: Planner) -> Figure:
    """Draw measured and computed power of steady flight over airspeed.

    If all points are in hover, the power is drawn over payload. `scenario` has the fitted vehicle.
    """
    figure, axes = full_width(3.2, top=0.96, bottom=0.15)
    if points[AIRSPEED].max() == 0.0:
        _draw_loads(axes, scenario, points, planner)
        axes.set(xlabel="Mass carried (kg)", ylabel="Power of hover (W)")
        return figure
    for style, (_, rows) in zip(SERIES_STYLES, points.groupby(PAYLOAD), strict=False):
        payload = float(rows[PAYLOAD].iloc[0])
        speeds = np.linspace(0.0, float(points[AIRSPEED].max()), _CURVE_POINTS)
        loaded = {"vehicle.payload": payload, "power.air_density": float(rows[DENSITY].mean())}
        powers = level_powers(scenario.with_values(loaded), speeds.tolist(), planner)
        axes.plot(speeds, powers, color=style.color, label=f"{payload:g} kg")
        axes.plot(rows[AIRSPEED], rows[POWER], **_dots(style))
    axes.set(xlabel="Airspeed (m/s)", ylabel="Power (W)")
    if not (points[PAYLOAD] == points[PAYLOAD].iloc[0]).all():
        axes.legend(title="Carried", frameon=False)
    return figure


def _draw_loads(axes: Axes, scenario: Scenario, points: pd.DataFrame, planner: Planner) -> None:
    axes.plot(points[PAYLOAD], points[POWER], **_dots(SERIES_STYLES[0]))
    least, most = float(points[PAYLOAD].min()), float(points[PAYLOAD].max())
    loads = np.linspace(least, most, _CURVE_POINTS if most > least else 1)
    powers = [
        level_powers(scenario.with_values({"vehicle.payload": load}), (0.0,), planner)[0]
        for load in loads.tolist()
    ]
    style = SERIES_STYLES[1]
    axes.plot(loads, powers, color=style.color, marker="" if most > least else style.marker)


def _dots(style: LineStyle) -> dict[str, Any]:
    return {"color": style.color, "linestyle": "none", "marker": style.marker, "markersize": 4}
