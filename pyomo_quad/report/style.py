"""Style of all figures: colours, fonts, panels and legends; and writing of figure files.

A figure drawn twice from the same data gives files with the same bytes.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import cycle
from math import ceil, isclose
from pathlib import Path
from typing import TYPE_CHECKING, Any

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from PIL import Image
from PIL.PngImagePlugin import PngInfo

from pyomo_quad.flight.baselines import OPEN_LOOP, baseline_name
from pyomo_quad.flight.columns import Column
from pyomo_quad.flight.replanning import replanned_name
from pyomo_quad.report.signals import ENERGY, TIME
from pyomo_quad.scenario.tables import MISSION_TIMED, Knowledge
from pyomo_quad.study.autopilot import TUNED_CRUISE
from pyomo_quad.study.certificate import SAME_TIME
from pyomo_quad.study.comparison import FAIR_BASELINE, OPTIMAL, settled_energy

if TYPE_CHECKING:
    from pyomo_quad.flight import Flight, Plan

FULL_WIDTH = 7.2  # inches: the text width of an A4 page, and of the HTML report
_DOTS_PER_INCH = 160
_PNG_COLORS = 256

INK = "#222222"
MUTED = "#767676"
PALE = "#dddddd"

_BLUE, _VERMILION, _GREEN = "#0072b2", "#d55e00", "#009e73"
_ORANGE, _PURPLE, _SKY = "#e69f00", "#a8487f", "#56b4e9"
_BROWN, _PINK, _OLIVE, _TEAL = "#7a4b1e", "#f2a0c0", "#8a8a00", "#006d77"
_VIOLET, _LIME = "#5e3c99", "#66a61e"

# Metadata of files, without a date, because a date would make the files of equal runs differ.
_UNDATED = {"svg": {"Date": None, "Creator": None}, "pdf": {"CreationDate": None}}

#: Settings under which every figure is drawn and written.
# matplotlib types the keys of its settings as literals, in some versions only.
HOUSE_STYLE: Any = {
    "axes.axisbelow": True,
    "axes.edgecolor": MUTED,
    "axes.formatter.limits": (-4, 5),
    "axes.formatter.useoffset": False,
    "axes.grid": True,
    "axes.labelcolor": INK,
    "axes.labelsize": 8,
    "axes.linewidth": 0.6,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlelocation": "left",
    "axes.titlepad": 4,
    "axes.titlesize": 8.5,
    "axes.titley": 1.0,  # a fixed position: the automatic one takes a third of the time
    "figure.dpi": _DOTS_PER_INCH,
    "font.family": "DejaVu Sans",
    "font.size": 8,
    "grid.color": "#e4e4e4",
    "grid.linewidth": 0.5,
    "legend.fontsize": 8,
    "legend.frameon": False,
    "legend.handlelength": 2.8,
    "lines.linewidth": 1.4,
    "lines.solid_capstyle": "round",
    "mathtext.fontset": "dejavusans",
    "savefig.dpi": _DOTS_PER_INCH,
    "svg.fonttype": "path",
    "svg.hashsalt": "pyomo_quad",
    "text.color": INK,
    "xtick.color": MUTED,
    "xtick.labelcolor": INK,
    "xtick.labelsize": 7.5,
    "xtick.major.size": 2.5,
    "xtick.major.width": 0.6,
    "ytick.color": MUTED,
    "ytick.labelcolor": INK,
    "ytick.labelsize": 7.5,
    "ytick.major.size": 2.5,
    "ytick.major.width": 0.6,
}


@dataclass(frozen=True, kw_only=True)
class LineStyle:
    """Colour, dashes, marker and hatch by which a curve or bar is distinguished in all figures."""

    color: str
    dashes: tuple[float, ...] = ()
    marker: str = "o"
    width: float = 1.4
    hatch: str = ""

    @property
    def line(self) -> dict[str, Any]:
        """Keyword arguments of `Axes.plot` for a curve in this style."""
        pattern = (0, self.dashes) if self.dashes else "solid"
        return {"color": self.color, "linestyle": pattern, "linewidth": self.width}


#: Styles of curves that are not flights, such as the curves of a sweep.
SERIES_STYLES = (
    LineStyle(color=_BLUE, marker="o", width=1.9),
    LineStyle(color=_VERMILION, dashes=(4.5, 1.6), marker="s", hatch="///"),
    LineStyle(color=_GREEN, dashes=(6, 1.5, 1.2, 1.5), marker="^", hatch=".."),
    LineStyle(color=INK, dashes=(1.2, 1.4), marker="D", hatch="xx"),
    LineStyle(color=_PURPLE, dashes=(8, 2), marker="v", hatch="\\\\"),
    LineStyle(color=_ORANGE, dashes=(3, 1.3, 1, 1.3, 1, 1.3), marker="P", hatch="++"),
    LineStyle(color=_SKY, dashes=(2.2, 1.1), marker="X", hatch="--"),
    LineStyle(color=MUTED, dashes=(5, 1.2, 1, 1.2), marker="d", hatch="oo"),
    LineStyle(color=_BROWN, dashes=(3, 1, 1, 1), marker="<", hatch="||"),
    LineStyle(color=_TEAL, dashes=(6, 1, 1, 1, 1, 1), marker="h", hatch="-|"),
    LineStyle(color=_OLIVE, dashes=(1, 2), marker="p", hatch="//\\\\"),
    LineStyle(color=_PINK, dashes=(10, 2, 2, 2), marker=">", hatch="**"),
    LineStyle(color=_VIOLET, dashes=(2.5, 1.2, 2.5, 1.2, 1, 1.2), marker="*", hatch="OO"),
    LineStyle(color=_LIME, dashes=(7, 1.2, 2.5, 1.2), marker="8", hatch="|/"),
)

_FLIGHTS = (
    *(OPTIMAL, *(baseline_name(reference) for reference in MISSION_TIMED), OPEN_LOOP),
    *(replanned_name(knowledge) for knowledge in Knowledge),
    TUNED_CRUISE,
)
# Each flight that the program itself names has one style in all reports. Flights that a caller
# names share the remaining styles.
_FLIGHT_STYLES = dict(zip(_FLIGHTS, SERIES_STYLES, strict=False))
_OTHER_STYLES = SERIES_STYLES[len(_FLIGHTS) :]

ROTOR_STYLES = (
    LineStyle(color=_BLUE, width=1.8),
    LineStyle(color=_VERMILION, dashes=(4.5, 1.6)),
    LineStyle(color=_GREEN, dashes=(6, 1.5, 1.2, 1.5)),
    LineStyle(color=INK, dashes=(1.2, 1.4)),
)


def flight_styles(names: tuple[str, ...]) -> dict[str, LineStyle]:
    """Return the line style of each flight, by the name of the flight.

    Flights that the program names itself, such as the plan, have a fixed style. All others get the
    remaining styles in turn.
    """
    others = cycle(_OTHER_STYLES)
    return {
        name: _FLIGHT_STYLES[name] if name in _FLIGHT_STYLES else next(others) for name in names
    }


def save_figure(
    draw: Callable[[], Figure], files: Mapping[str, Path], creator: str | None = None
) -> None:
    """Draw a figure once and write it in one or more file formats.

    Each key of `files` is a format: "png", "svg" or "pdf". `creator`, the name of the program, is
    stored in the metadata of each file.
    """
    with mpl.rc_context(HOUSE_STYLE):
        figure = _drawn(draw)
        for kind, path in files.items():
            if kind == "png":
                _save_png(figure, path, creator)
            else:
                said = {} if creator is None else {"Creator": creator}
                figure.savefig(path, format=kind, metadata=_UNDATED[kind] | said)


def _drawn(draw: Callable[[], Figure]) -> Figure:
    """Draw a figure with the function `draw`, prepare it for fast saving, and return it."""
    figure = draw()
    for axes in figure.axes:
        for axis in (axes.xaxis, axes.yaxis):
            # Matplotlib computes the position of a label even if the label is empty. A constant
            # position saves a tenth of the drawing time. It is wrong for a label set later.
            if not axis.get_label_text():
                axis.set_label_coords(0.0, 0.0)
    return figure


def _save_png(figure: Figure, path: Path, creator: str | None) -> None:
    # A palette image is a third as large. With fewer than `_PNG_COLORS` colours, a thin line takes
    # the colour of a thicker line.
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    picture = Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")
    about = PngInfo()
    if creator is not None:
        about.add_text("Software", creator)
    picture.quantize(_PNG_COLORS, kmeans=1, dither=Image.Dither.NONE).save(
        path, format="PNG", dpi=(_DOTS_PER_INCH, _DOTS_PER_INCH), pnginfo=about
    )


def full_width(
    height: float,
    shape: tuple[int, int] = (1, 1),
    left: float = 0.09,
    right: float = 0.98,
    **margins: float,
) -> tuple[Figure, Any]:
    """Make a figure as wide as the text of a report, with a grid of panels.

    `height` is in inches, and `shape` is (rows, columns). The other arguments are those of
    `Figure.subplots_adjust`: fractions of the figure. The panels are returned as by
    `Figure.subplots`.
    """
    figure = Figure(figsize=(FULL_WIDTH, height))
    axes = figure.subplots(*shape)
    figure.subplots_adjust(left=left, right=right, **margins)
    return figure, axes


_MARGIN = 0.06
_LEGEND_LINE = 0.2  # inches
TICK_STEPS = (1, 2, 5, 10)

LEGEND_COLUMNS = 4


def panel_grid(
    rows: int,
    columns: int,
    *,
    panel_height: float,
    gap: float = 0.6,
    left: float = 0.5,
    legend_entries: int = 1,
    share_time: bool = True,
) -> tuple[Figure, np.ndarray]:
    """Make a figure of equal panels, with space for titles above them and a legend below.

    `panel_height`, `gap` (between panels) and `left` (for tick labels) are in inches. A legend with
    one entry is left out. If `share_time`, the panels share one horizontal axis. The panels have
    shape (rows, columns).
    """
    right, top = 0.12, 0.28
    gap_y = 0.36 if share_time else 0.72
    legend_lines = ceil(legend_entries / LEGEND_COLUMNS) if legend_entries > 1 else 0
    bottom = 0.5 + _LEGEND_LINE * legend_lines
    height = top + rows * panel_height + (rows - 1) * gap_y + bottom
    panel_width = (FULL_WIDTH - left - right - (columns - 1) * gap) / columns
    figure = Figure(figsize=(FULL_WIDTH, height))
    panels = figure.subplots(rows, columns, sharex=share_time, squeeze=False)
    figure.subplots_adjust(
        left=left / FULL_WIDTH,
        right=1 - right / FULL_WIDTH,
        top=1 - top / height,
        bottom=bottom / height,
        wspace=gap / panel_width,
        hspace=gap_y / panel_height,
    )
    return figure, panels


def draw_over_time(
    axes: Axes, frame: pd.DataFrame, shown: Column, style: LineStyle, label: str
) -> None:
    """Draw a column of a flight's table against time, with a legend entry."""
    axes.plot(TIME.of(frame), shown.of(frame), label=label, **style.line)


def draw_panels(
    panels: Iterable[Axes], shown: Iterable[Column], flights: Sequence["StyledFlight"]
) -> None:
    """Draw several columns of the flights' tables against time, each column in a panel of its own.

    There must be as many panels as columns. The vertical axis covers at least the column's
    `smallest_span`.
    """
    for axes, column in zip(panels, shown, strict=True):
        for flight in flights:
            draw_over_time(axes, flight.frame, column, flight.style, flight.name)
        axes.set_title(column.title)
        keep_span([axes], column.smallest_span)


def keep_span(panels: Iterable[Axes], smallest_span: float) -> None:
    """Give panels a common vertical scale that covers at least a given range.

    All curves must be drawn already. `smallest_span` is in the unit of the axis.
    """
    panels = tuple(panels)
    ends = np.array([axes.dataLim.intervaly for axes in panels])
    low, high = ends.min(), ends.max()
    # The smallest span keeps a constant curve flat: its numerical noise does not fill the panel.
    middle, half = (low + high) / 2, max(high - low, smallest_span) / 2
    for axes in panels:
        axes.set_ylim(middle - half * (1 + _MARGIN), middle + half * (1 + _MARGIN))
        axes.yaxis.set_major_locator(MaxNLocator(nbins=5, steps=TICK_STEPS))


def label_time(panels: Iterable[Axes], duration: float) -> None:
    """Label the horizontal axis of each panel as time, from 0 to `duration` [s]."""
    for axes in panels:
        axes.set_xlabel(TIME.label)
        axes.set_xlim(0.0, duration)
        axes.xaxis.set_major_locator(MaxNLocator(nbins=6, steps=TICK_STEPS))


def legend_below(figure: Figure, axes: Axes) -> None:
    """Draw a legend below all panels, for the curves of one panel, if there are at least two.

    Parameters
    ----------
    figure : Figure
        Figure with the panels.
    axes : Axes
        Panel whose curves the legend names.
    """
    handles, labels = axes.get_legend_handles_labels()
    if len(labels) > 1:
        figure.legend(handles, labels, loc="lower center", ncols=min(LEGEND_COLUMNS, len(labels)))


_FAILED_PLAN = "best iterate"


@dataclass(frozen=True, kw_only=True, eq=False)
class StyledFlight:
    """Flight with the line style in which all figures draw it.

    Attributes
    ----------
    name : str
        Name in legends.
    frame : DataFrame
        Table of the flight over time.
    duration_s : float
        Duration of the flight.
    energy_J : float
        Energy of the flight, corrected to the exact goal state if possible (see `settled_energy`).
    style : LineStyle
        Colour, dashes and marker.
    """

    name: str
    frame: pd.DataFrame
    duration_s: float
    energy_J: float
    style: LineStyle


def plan_flight(plan: "Plan") -> "Flight":
    """Return a plan as a `Flight`, the form in which figures draw all flights.

    The flight has the name "optimal", or "best iterate" if the solve failed.
    """
    # The trajectory of a failed solve may violate constraints.
    return plan.flight() if plan.verification is not None else plan.flight(_FAILED_PLAN)


def styled_flights(flights: Sequence["Flight"]) -> tuple[StyledFlight, ...]:
    """Attach line styles to flights, in the same order.

    Parameters
    ----------
    flights : sequence of Flight
        Flights, the plan first.

    Returns
    -------
    tuple of StyledFlight
        Name, table over time, duration and energy of each flight, with its line style.
    """
    styles = flight_styles(tuple(flight.name for flight in flights))
    return tuple(
        StyledFlight(
            name=flight.name,
            frame=flight.frame,
            duration_s=flight.duration_s,
            energy_J=settled_energy(flight),
            style=styles[flight.name],
        )
        for flight in flights
    )


def flight_of_table(name: str, frame: pd.DataFrame) -> StyledFlight:
    """Make a flight for figures from its table alone, such as a table that was read from a file.

    The energy is the last value of the energy column, or 0 without this column. The style follows
    from the name (see `flight_styles`).
    """
    time = TIME.of(frame)
    has_energy = ENERGY.name in frame
    return StyledFlight(
        name=name,
        frame=frame,
        duration_s=float(time[-1] - time[0]),
        energy_J=float(ENERGY.of(frame)[-1]) if has_energy else 0.0,
        style=flight_styles((name,))[name],
    )


def last_end(flights: Sequence[StyledFlight]) -> float:
    """Return the longest duration of several flights, in s."""
    return max(flight.duration_s for flight in flights)


def have_equal_durations(flights: Sequence[StyledFlight]) -> bool:
    """Return whether flights have equal durations, up to the relative tolerance `SAME_TIME`.

    Energies above hovering can be compared only between flights of equal duration.
    """
    return all(isclose(f.duration_s, flights[0].duration_s, rel_tol=SAME_TIME) for f in flights)


def fair_pair(flights: Sequence[StyledFlight]) -> tuple[StyledFlight, ...]:
    """Return the two flights that the figures of states show: the plan and one baseline flight.

    The first flight is the plan. The baseline flight is named `FAIR_BASELINE`; without it, the
    result is the plan alone.
    """
    # The reference of this flight is independent of the plan, so that the comparison is fair.
    return tuple(
        flight for index, flight in enumerate(flights) if index == 0 or flight.name == FAIR_BASELINE
    )
