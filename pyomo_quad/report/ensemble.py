"""Report of an ensemble: one mission flown many times, each flight in its own random wind."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from pyomo_quad.arrays import FloatArray
from pyomo_quad.flight.columns import ENERGY as ENERGY_TRACK
from pyomo_quad.flight.ensemble import OFF, SPEED, TILT
from pyomo_quad.report import Figures
from pyomo_quad.report.document import Drawing, write_study
from pyomo_quad.report.labels import write_labels
from pyomo_quad.report.paths import axis_label, draw_mission
from pyomo_quad.report.signals import POSITION
from pyomo_quad.report.style import (
    INK,
    SERIES_STYLES,
    label_time,
    legend_below,
    panel_grid,
)
from pyomo_quad.study.ensemble import (
    BAND,
    CONFIDENCE,
    Ensemble,
    Saving,
    ensemble_summary,
)

FLIGHTS_NAME, BANDS_NAME = "flights.csv", "bands.csv"
#: Largest number of paths in the figure; more could not be distinguished.
SHOWN_PATHS = 50
_BINS = 40  # of the histogram of energies


def write_ensemble(
    folder: Path,
    flown: Ensemble,
    savings: Sequence[Saving] = (),
    figures: Figures = Figures.SVG,
) -> dict[str, Any]:
    """Write the report of an ensemble of flights: tables, `summary.json`, figures and text.

    `savings` hold rival flights in the same winds, such as those of an autopilot. `folder` must
    exist and be empty. The result is the content of `summary.json`.
    """
    summary = ensemble_summary(flown, savings)
    write_study(
        folder,
        "report/ensemble.md.j2",
        tables={FLIGHTS_NAME: flown.table(), BANDS_NAME: flown.bands()},
        summary=summary,
        drawings=ensemble_drawings(flown, savings),
        figures=figures,
        flown=flown,
        savings=savings,
        told=summary,
        confidence=CONFIDENCE,
    )
    return summary


def ensemble_drawings(
    flown: Ensemble, savings: Sequence[Saving], margin: float = 0.0
) -> tuple[Drawing, ...]:
    """List the figures of an ensemble of flights: paths, energies, and quantities over time.

    Each item of `savings` compares the ensemble with other flights in the same winds, such as those
    of an autopilot. The energies of these flights are also drawn. `margin` [m] is the safety margin
    of the reference path from zones. Lines on both sides of the path mark it.
    """
    shown = min(SHOWN_PATHS, flown.count)
    paths = f"Paths of {shown} flights, and the path to follow."
    energy = "Energies of the flights (kJ), each in its own random wind; line: median."
    if savings:
        energy += " Plan and autopilot fly in the same winds."
    bands = "Median of the flights over time, and the band of 90 % of the flights."
    return (
        Drawing("paths", "Paths", paths, partial(draw_many_paths, flown, margin)),
        Drawing("energy", "Energy", energy, partial(draw_energies, flown, savings)),
        Drawing("bands", "Over time", bands, partial(draw_bands, flown)),
    )


def draw_many_paths(flown: Ensemble, margin: float = 0.0) -> Figure:
    """Draw the paths of the first flights of an ensemble, and their common reference path.

    At most `SHOWN_PATHS` flights are drawn, from above and from the front. Lines on both sides of
    the reference path mark its safety margin from zones, `margin` [m].
    """
    figure, panels = panel_grid(2, 1, panel_height=2.5, legend_entries=2, share_time=False)
    tracks = [flown.flown.tracks[f"{axis}_m"][:, :SHOWN_PATHS] for axis in "xyz"]
    color = SERIES_STYLES[0].color
    for axes, (across, up), title in zip(
        panels[:, 0], ((0, 1), (0, 2)), ("from above", "from the front"), strict=True
    ):
        labels = draw_mission(axes, flown.scenario, (across, up))
        for k in range(tracks[0].shape[1]):
            label = "flights" if k == 0 else None
            axes.plot(
                tracks[across][:, k], tracks[up][:, k], color=color, linewidth=0.5, label=label
            )
        planned = flown.planned
        to_follow = planned[:, across], planned[:, up]
        axes.plot(*to_follow, color=INK, linewidth=0.8, label="path to follow")
        # The plan keeps the margin in addition to the scenario's clearance.
        for side, label in ((margin, "margin"), (-margin, None)) if margin else ():
            beside = _beside(planned[:, [across, up]], side)
            axes.plot(*beside.T, color=INK, linewidth=0.5, linestyle=":", label=label)
        axes.set_title(f"Seen {title}")
        axes.set(xlabel=axis_label(POSITION[across]), ylabel=axis_label(POSITION[up]))
        axes.set_aspect("equal", adjustable="datalim")
        write_labels(axes, labels)
    legend_below(figure, panels[0, 0])
    return figure


def _beside(path: FloatArray, off: float) -> FloatArray:
    """Shift a path in a plane, shape (n, 2) [m], to its left by the distance `off` [m]."""
    along = np.gradient(path, axis=0)
    length = np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-9)
    return path + off * np.column_stack([-along[:, 1], along[:, 0]]) / length


def draw_energies(flown: Ensemble, savings: Sequence[Saving]) -> Figure:
    """Draw histograms of the energies of an ensemble's flights, each with its median.

    Each item of `savings` compares the ensemble with rival flights in the same winds, such as those
    of an autopilot. It adds a histogram of the rival flights.
    """
    kinds = [flown, *(saving.rival for saving in savings)]
    figure, ((axes,),) = panel_grid(
        1, 1, panel_height=2.4, legend_entries=len(kinds), share_time=False
    )
    energies = [kind.of_flights("energy_J") / 1e3 for kind in kinds]
    low, high = min(map(np.min, energies)), max(map(np.max, energies))
    edges = np.linspace(low, max(high, low * (1 + 1e-6) + 1e-9), _BINS + 1)
    for kind, held, style in zip(kinds, energies, SERIES_STYLES, strict=False):
        axes.hist(held, edges, color=style.color, alpha=0.55, label=kind.name)
        axes.axvline(float(np.median(held)), color=style.color, linewidth=1.2)
    axes.set(xlabel="Energy (kJ)", ylabel="Flights")
    legend_below(figure, axes)
    return figure


# Recorded quantity, title of its panel, and factor from the stored to the printed unit.
_PANELS = (
    (OFF, "Distance from the path to follow (m)", 1.0),
    (SPEED, "Speed over ground (m/s)", 1.0),
    (TILT, "Tilt (°)", float(np.degrees(1.0))),
    (ENERGY_TRACK, "Energy (kJ)", 1e-3),
)


def draw_bands(flown: Ensemble) -> Figure:
    """Draw four quantities of an ensemble of flights over time: the median, and a 90 % band.

    The band lies between the 5 % and 95 % quantiles of the flights.
    """
    figure, panels = panel_grid(2, 2, panel_height=1.9)
    t, color = flown.flown.t, SERIES_STYLES[0].color
    for axes, (track, title, scale) in zip(panels.flat, _PANELS, strict=True):
        low, middle, high = scale * np.quantile(flown.flown.tracks[track], BAND, axis=1)
        axes.fill_between(t, low, high, color=color, alpha=0.25, linewidth=0)
        axes.plot(t, middle, color=color)
        axes.set_title(title)
    label_time(panels[-1], float(t[-1]))
    return figure
