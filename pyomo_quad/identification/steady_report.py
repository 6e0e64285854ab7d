"""Output files of the command `identify --steady`: table, figure, vehicle file, summary, text."""

from dataclasses import asdict
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from pyomo_quad.flight import Planner
from pyomo_quad.identification.columns import PAYLOAD, POWER
from pyomo_quad.identification.report import VEHICLE_NAME, vehicle_file
from pyomo_quad.identification.steady import AIRSPEED, SteadyFit, level_powers
from pyomo_quad.report import Figures
from pyomo_quad.report.document import Drawing, write_study
from pyomo_quad.report.style import SERIES_STYLES, full_width
from pyomo_quad.scenario import Scenario
from pyomo_quad.version import __version__

POINTS_NAME = "points.csv"
#: Columns of the table of steady points besides the measurements.
COMPUTED, UNSEEN, ERROR = "computed_W", "computed_unseen_W", "error_percent"
_CURVE_POINTS = 25


def write_steady(folder: Path, found: SteadyFit, base: str, figures: Figures) -> None:
    """Write the results of a fit to points of steady flight: vehicle file, report and tables.

    Parameters
    ----------
    folder : Path
        Existing empty folder that receives the files.
    found : SteadyFit
        Vehicle fitted to the points.
    base : str
        Vehicle before the fit: a name of the library, or a vehicle file.
    figures : Figures
        Which figures to draw, and in which file formats.
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
                draw=lambda: draw_points(found.scenario, found.points),
            )
        ],
        figures=figures,
        found=found,
        base=base,
        VEHICLE_NAME=VEHICLE_NAME,
    )


def point_table(points: pd.DataFrame, power: np.ndarray) -> pd.DataFrame:
    """Return the table of steady flight points with computed powers [W] and errors [percent].

    Parameters
    ----------
    points : DataFrame
        Measured points of steady flight.
    power : ndarray, shape (n_points,)
        Computed power of each point [W].
    """
    return points.assign(**{COMPUTED: power, ERROR: 100.0 * (power / points[POWER] - 1.0)})


def draw_points(scenario: Scenario, points: pd.DataFrame) -> Figure:
    """Draw measured and computed power of steady flight over airspeed.

    If all points are in hover, the power is drawn over payload.

    Parameters
    ----------
    scenario : Scenario
        Scenario with the fitted vehicle.
    points : DataFrame
        Measured points.
    """
    figure, axes = full_width(3.2, top=0.96, bottom=0.15)
    hovers = bool((points[AIRSPEED] == 0.0).all())
    over = PAYLOAD if hovers else AIRSPEED
    style = SERIES_STYLES[0]
    axes.plot(points[over], points[POWER], color=style.color, linestyle="none", marker=style.marker)
    least = float(points[over].min()) if hovers else 0.0
    at = np.linspace(least, float(points[over].max()), _CURVE_POINTS)
    planner = Planner()
    payloads = at.tolist() if hovers else [float(points[PAYLOAD].median())]
    speeds = [0.0] if hovers else at.tolist()
    curve = [
        power
        for payload in payloads
        for power in level_powers(
            scenario.with_values({"vehicle.payload": payload}), speeds, planner
        )
    ]
    axes.plot(at, curve, color=SERIES_STYLES[1].color)
    axes.set(xlabel="Mass carried (kg)" if hovers else "Airspeed (m/s)", ylabel="Power (W)")
    return figure
