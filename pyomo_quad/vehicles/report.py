"""Report that compares computed with measured powers of vehicles.

A library vehicle is one of the vehicles of the package, whose power was measured. The report has a
page for each. It also has a table of other vehicles, of which only data sheets are known.
"""

from functools import partial
from pathlib import Path

import pandas as pd

from pyomo_quad.flight import Planner
from pyomo_quad.identification.columns import PAYLOAD, POWER
from pyomo_quad.identification.steady import AIRSPEED
from pyomo_quad.identification.steady_report import (
    COMPUTED,
    ERROR,
    POINTS_NAME,
    draw_points,
    point_table,
)
from pyomo_quad.report import Figures
from pyomo_quad.report.document import Drawing, write_study, write_text
from pyomo_quad.scenario import library_entry
from pyomo_quad.vehicles.holding import ALLOWED_PERCENT, SHEET_ERROR, Held, data_sheets
from pyomo_quad.version import __version__

SHEETS_NAME = "data_sheets.csv"


def write_vehicles(
    folder: Path, held: tuple[Held, ...], planner: Planner, figures: Figures
) -> pd.DataFrame:
    """Write the report on powers of vehicles into an existing empty folder.

    `held` has the comparisons of all library vehicles. `planner` compiles their equations, from
    which the curves in the figures are computed. The result is that of `data_sheets`.
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
        draw=partial(draw_points, held.scenario, held.points, planner),
    )
