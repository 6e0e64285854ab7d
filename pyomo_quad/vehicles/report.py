"""Report that compares vehicles with measured powers.

It has a table of data sheets, and a page for each vehicle of the library.
"""

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from pyomo_quad.flight import Planner
from pyomo_quad.identification.columns import DENSITY, PAYLOAD, POWER
from pyomo_quad.identification.steady import AIRSPEED, level_powers
from pyomo_quad.identification.steady_report import COMPUTED, ERROR, POINTS_NAME, point_table
from pyomo_quad.report import Figures
from pyomo_quad.report.document import Drawing, write_study, write_text
from pyomo_quad.report.style import SERIES_STYLES, full_width
from pyomo_quad.scenario import library_entry
from pyomo_quad.vehicles.holding import ALLOWED_PERCENT, SHEET_ERROR, Held, data_sheets
from pyomo_quad.version import __version__

SHEETS_NAME = "data_sheets.csv"
_CURVE_POINTS = 21


def write_vehicles(
    folder: Path, held: tuple[Held, ...], planner: Planner, figures: Figures
) -> pd.DataFrame:
    """Write the report that compares vehicles with measured powers.

    Parameters
    ----------
    folder : Path
        Existing empty folder that receives the files.
    held : tuple of Held
        Library vehicles with measured and computed powers.
    planner : Planner
        Keeps compiled models between figures.
    figures : Figures
        Which figures to draw, and in which file formats.

    Returns
    -------
    DataFrame
        Table of the data sheets.
    """
    sheets = data_sheets()
    drawings = write_study(
        folder,
        "vehicles/report.md.j2",
        tables={
            SHEETS_NAME: sheets,
            POINTS_NAME: pd.concat(
                [point_table(one.points, one.computed).assign(vehicle=one.name) for one in held]
            ),
        },
        summary={
            "data_sheets": sheets.to_dict("records"),
            "vehicles": {one.name: {"mean_error_percent": one.mean_error} for one in held},
            "version": __version__,
        },
        drawings=[_drawing(one, planner) for one in held],
        figures=figures,
        held=held,
        sheets=sheets.to_dict("records"),
        worst=float(sheets[SHEET_ERROR].abs().max()),
        allowed=ALLOWED_PERCENT,
    )
    shown = {drawing.name: drawing for drawing in drawings}
    for one in held:
        write_text(
            folder / f"{one.name}.md",
            "vehicles/page.md.j2",
            one=one,
            rows=point_table(one.points, one.computed).to_dict("records"),
            columns=(AIRSPEED, PAYLOAD, POWER, COMPUTED, ERROR),
            drawings=[shown[one.name]] if one.name in shown else [],
            sources=library_entry("vehicles", one.name).sources,
            version=__version__,
        )
    return sheets


def _drawing(held: Held, planner: Planner) -> Drawing:
    return Drawing(
        name=held.name,
        title=held.scenario.vehicle.title,
        caption="Dots: measured. Lines: computed by the declared equations.",
        draw=partial(draw_held, held, planner),
    )


def draw_held(held: Held, planner: Planner) -> Figure:
    """Draw measured and computed powers of a library vehicle.

    The power is drawn over airspeed or, if all measurements are in hover, over payload.

    Parameters
    ----------
    held : Held
        Vehicle with measured and computed powers.
    planner : Planner
        Keeps compiled models between figures.
    """
    figure, axes = full_width(3.2, top=0.96, bottom=0.15)
    points = held.points
    if points[AIRSPEED].max() == 0.0:
        _draw_loads(axes, held, planner)
        axes.set(xlabel="Mass carried (kg)", ylabel="Power of hover (W)")
        return figure
    for style, (_, rows) in zip(SERIES_STYLES, points.groupby(PAYLOAD), strict=False):
        payload = float(rows[PAYLOAD].iloc[0])
        speeds = np.linspace(0.0, float(points[AIRSPEED].max()), _CURVE_POINTS)
        density = float(rows[DENSITY].mean())
        loaded = held.scenario.with_values(
            {"vehicle.payload": payload, "power.air_density": density}
        )
        powers = level_powers(loaded, speeds.tolist(), planner)
        axes.plot(speeds, powers, color=style.color, label=f"{payload:g} kg")
        look: dict[str, Any] = {"color": style.color, "linestyle": "none", "marker": style.marker}
        axes.plot(rows[AIRSPEED], rows[POWER], markersize=4, **look)
    axes.set(xlabel="Airspeed (m/s)", ylabel="Power (W)")
    if not (points[PAYLOAD] == points[PAYLOAD].iloc[0]).all():
        axes.legend(title="Carried", frameon=False)
    return figure


def _draw_loads(axes: object, held: Held, planner: Planner) -> None:
    points, style = held.points, SERIES_STYLES[0]
    plot = axes.plot  # type: ignore[attr-defined]
    look = {"color": style.color, "linestyle": "none", "marker": style.marker, "markersize": 4}
    plot(points[PAYLOAD], points[POWER], **look)
    least, most = float(points[PAYLOAD].min()), float(points[PAYLOAD].max())
    loads = np.linspace(least, most, _CURVE_POINTS if most > least else 1)
    powers = [
        level_powers(held.scenario.with_values({"vehicle.payload": float(p)}), (0.0,), planner)[0]
        for p in loads
    ]
    other = SERIES_STYLES[1]
    plot(loads, powers, color=other.color, marker="" if most > least else other.marker)
