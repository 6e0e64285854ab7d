"""What adaptation is worth: the error with it and without, and the disturbance it found."""

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pyomo_quad.report.figures.panels import keep_span, label_time, legend_below, panel_grid
from pyomo_quad.report.flights import FAIR_BASELINE
from pyomo_quad.report.signals import TIME
from pyomo_quad.report.style import INK, MUTED, LineStyle, flight_styles
from pyomo_quad.study.adaptation import ERROR_WITH, ERROR_WITHOUT, ESTIMATED, TRUE

__all__ = ["draw_adaptation"]

_CENTIMETRES = 100.0
_SMALLEST_ERROR = 1.0  # cm
_SMALLEST_DISTURBANCE = 0.1  # m/s^2
# With adaptation it is the flight of that name in the other figures.
_WITH = flight_styles((FAIR_BASELINE,))[FAIR_BASELINE]
_WITHOUT = LineStyle(color=MUTED, dashes=(4.5, 1.6))


def draw_adaptation(study: pd.DataFrame) -> Figure:
    """Draw the distance from the reference, and the disturbance along x and y.

    Parameters
    ----------
    study : DataFrame
        Of `adaptation_study`.

    Returns
    -------
    Figure
        Three panels.
    """
    figure, (panels,) = panel_grid(1, 3, panel_height=1.8, legend_entries=2)
    error, *disturbances = panels
    time = TIME.of(study)
    for column, style, label in (
        (ERROR_WITH, _WITH, "with adaptation"),
        (ERROR_WITHOUT, _WITHOUT, "without"),
    ):
        error.plot(time, _CENTIMETRES * study[column].to_numpy(), label=label, **style.line)
    error.set_title("Distance from the reference (cm)")
    keep_span([error], _SMALLEST_ERROR)
    for axes, axis, estimated, true in zip(disturbances, "xy", ESTIMATED, TRUE, strict=False):
        _draw_disturbance(axes, time, study[true].to_numpy(), study[estimated].to_numpy())
        axes.set_title(f"Disturbance along ${axis}$ (m/s²)")
    keep_span(disturbances, _SMALLEST_DISTURBANCE)
    label_time(panels, float(time[-1]))
    legend_below(figure, error)
    return figure


def _draw_disturbance(
    axes: Axes, time: np.ndarray, true: np.ndarray, estimated: np.ndarray
) -> None:
    axes.plot(time, true, label="true", color=INK, linewidth=1.0, linestyle=(0, (1.2, 1.4)))
    axes.plot(time, estimated, label="estimated", **_WITH.line)
    axes.legend(loc="best")
