"""Report of missions flown in the simulator RotorPy: table, figure and text."""

from importlib.metadata import version
from math import ceil
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pyomo_quad.flight.outside_plant import PLANT, Pilot
from pyomo_quad.report import Figures
from pyomo_quad.report.document import Drawing, write_study
from pyomo_quad.report.style import LEGEND_COLUMNS, SERIES_STYLES, label_time, panel_grid
from pyomo_quad.simulators import study as missions
from pyomo_quad.simulators.study import CAUSES, OutsideStudy

if TYPE_CHECKING:
    from matplotlib.figure import Figure

TABLE_NAME = "flights.csv"
# Least distances on the logarithmic axes [m]: rounding errors of the integrators for flights
# without feedback, 0.1 mm for flights with feedback.
_LEAST_SHOWN, _LEAST_LED = 1e-9, 1e-4
# Number of columns of the legend, whose labels are long.
_CAUSES_ABREAST = 3


def draw_causes(study: OutsideStudy) -> "Figure":
    """Draw the distance of simulated flights from their plan over time, without and with feedback.

    Each line is one flight in RotorPy, named by the cause of its distance, such as a difference
    between the models (see `CAUSES`).
    """
    lines = ceil(len(CAUSES) / _CAUSES_ABREAST)
    figure, (panels,) = panel_grid(1, 2, panel_height=2.6, legend_entries=lines * LEGEND_COLUMNS)
    for axes, pilot, title, least in (
        (panels[0], Pilot.OPEN_LOOP, "Without feedback: distance from the plan (m)", _LEAST_SHOWN),
        (panels[1], Pilot.ADAPTIVE, "Under our controller: distance from the plan (m)", _LEAST_LED),
    ):
        for (cause, (case, plant)), style in zip(CAUSES.items(), SERIES_STYLES, strict=True):
            track = study.tracks.get((case, plant, pilot))
            if track is not None:
                t, distance = track
                axes.plot(t, np.maximum(distance, least), label=cause, **style.line)
        axes.set_yscale("log")
        axes.set_title(title)
    label_time(panels, max(t[-1] for t, _ in study.tracks.values()))
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="lower center", ncols=_CAUSES_ABREAST)
    return figure


def write_outside_report(folder: Path, study: OutsideStudy, figures: Figures = Figures.SVG) -> None:
    """Write the report of missions flown in the simulator RotorPy: table, figure, `report.md`."""
    drawing = Drawing(
        name="causes",
        title="Over time",
        caption="Distance of each flight from its plan, one cause at a time; distances below "
        f"{_LEAST_SHOWN:g} m, or {_LEAST_LED:g} m under feedback, are drawn there.",
        draw=lambda: draw_causes(study),
    )
    write_study(
        folder,
        "simulators/outside_plant.md.j2",
        tables={TABLE_NAME: study.flights},
        drawings=[drawing],
        figures=figures,
        study=study,
        of=missions,
        lag_ms=1e3 * study.lag_s,
        rows=study.flights.to_dict("records"),
        version_of_rotorpy=version(PLANT),
    )
