"""Energy under f_r against the bound on the rotor acceleration: where a minimum ceases to be."""

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from pyomo_quad.report.figures.panels import panel_grid
from pyomo_quad.report.style import INK, MUTED, SERIES_STYLES
from pyomo_quad.study.paper.readings import Reading

__all__ = ["LOWEST_SHOWN", "draw_floors"]

_KILO = 1e3
LOWEST_SHOWN = -2.0  # kJ: far enough down to see that the literal curve falls without end
_HEADROOM = 0.6  # kJ


def draw_floors(
    floors: dict[Reading, NDArray[np.float64]],
    hover_energy: float,
    printed_energy: float,
    critical: float,
) -> Figure:
    """Draw the least energy of any flight for both readings of f_r.

    Parameters
    ----------
    floors : dict
        Reading -> bounds [rad/s²] and energies [J].
    hover_energy : float
        Of hovering for as long as the mission lasts, J.
    printed_energy : float
        The paper's optimum, J.
    critical : float
        Bound from which f_r passes zero, rad/s².

    Returns
    -------
    Figure
        One panel.
    """
    figure, panels = panel_grid(1, 1, panel_height=2.9, left=0.6, legend_entries=12)
    axes = panels[0, 0]
    styles = dict(zip(Reading, SERIES_STYLES, strict=False))
    for reading, pairs in floors.items():
        bounds, energies = pairs[np.isfinite(pairs[:, 1])].T
        style = styles[reading]
        label = f"least energy of any flight, {reading.value} $f_r$"
        axes.semilogx(
            bounds, energies / _KILO, label=label, marker=style.marker, markersize=3.5, **style.line
        )
    axes.axhline(hover_energy / _KILO, color=MUTED, linewidth=1.2, label="hovering")
    axes.axhline(
        printed_energy / _KILO,
        color=INK,
        linewidth=1.2,
        linestyle=(0, (6, 2)),
        label="the paper's optimum",
    )
    axes.axvspan(
        critical,
        axes.get_xlim()[1],
        facecolor="none",
        edgecolor=MUTED,
        hatch="..",
        linewidth=0.0,
        label="no minimum with literal $f_r$",
    )
    axes.set_xlim(floors[Reading.LITERAL][0, 0], floors[Reading.LITERAL][-1, 0])
    axes.set_ylim(LOWEST_SHOWN, hover_energy / _KILO + _HEADROOM)
    axes.set_xlabel(r"Bound on the rotor acceleration $|\alpha|$ (rad/s²)")
    axes.set_ylabel("Energy in 10 s (kJ)")
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="lower center", ncols=2)
    return figure
