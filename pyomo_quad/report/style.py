"""How every figure looks, and how a figure becomes files that are equal from run to run.

The colours are those of Okabe and Ito, told apart by colour-blind readers; line styles and markers
differ as well, so that the figures read on a grey printer.  Only the object-oriented interface of
matplotlib is used: no state is shared between figures.
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import cycle
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from pyomo_quad.flight.baselines import OPEN_LOOP, baseline_name
from pyomo_quad.scenario.baseline import Reference
from pyomo_quad.study.comparison import OPTIMAL

__all__ = [
    "FULL_WIDTH",
    "INK",
    "MUTED",
    "PALE",
    "ROTOR_STYLES",
    "SERIES_STYLES",
    "LineStyle",
    "flight_styles",
    "save_figure",
]

FULL_WIDTH = 7.2  # inches: the text width of an A4 page, and of the HTML report
_DOTS_PER_INCH = 160
_PNG_COLORS = 128

INK = "#222222"
MUTED = "#767676"
PALE = "#dddddd"

_BLUE, _VERMILION, _GREEN = "#0072b2", "#d55e00", "#009e73"
_ORANGE, _PURPLE, _SKY = "#e69f00", "#a8487f", "#56b4e9"

# A date would make two equal runs differ.
_SVG_METADATA = {"Date": None, "Creator": None}

# matplotlib types the keys of its settings as literals, in some versions only.
_RC: Any = {
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
    "axes.titley": 1.0,  # a fixed place: looking for a free one takes a third of the time
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
    """Colour, dashes and marker that together stand for one flight or one rotor."""

    color: str
    dashes: tuple[float, ...] = ()
    dash_name: str = "solid"  # the nearest that the interactive view has
    marker: str = "o"
    width: float = 1.4
    hatch: str = ""

    @property
    def line(self) -> dict[str, Any]:
        """Keyword arguments of a matplotlib line."""
        pattern = (0, self.dashes) if self.dashes else "solid"
        return {"color": self.color, "linestyle": pattern, "linewidth": self.width}


#: For curves that are no flights, as those of a sweep.
SERIES_STYLES = (
    LineStyle(color=_BLUE, marker="o", width=1.9),
    LineStyle(color=_VERMILION, dashes=(4.5, 1.6), dash_name="dash", marker="s", hatch="///"),
    LineStyle(color=_GREEN, dashes=(6, 1.5, 1.2, 1.5), dash_name="dashdot", marker="^", hatch=".."),
    LineStyle(color=INK, dashes=(1.2, 1.4), dash_name="dot", marker="D", hatch="xx"),
    LineStyle(color=_PURPLE, dashes=(8, 2), dash_name="longdash", marker="v", hatch="\\\\"),
    LineStyle(
        color=_ORANGE,
        dashes=(3, 1.3, 1, 1.3, 1, 1.3),
        dash_name="longdashdot",
        marker="P",
        hatch="++",
    ),
    LineStyle(color=_SKY, dashes=(2.2, 1.1), dash_name="dash", marker="X", hatch="--"),
    LineStyle(color=MUTED, dashes=(5, 1.2, 1, 1.2), dash_name="dashdot", marker="d", hatch="oo"),
)

_FLIGHTS = (OPTIMAL, *(baseline_name(reference) for reference in Reference), OPEN_LOOP)
# Every flight that the program can fly has a style of its own in every report; the rest is for
# what a caller names in another way.
_FLIGHT_STYLES = dict(zip(_FLIGHTS, SERIES_STYLES, strict=False))
_OTHER_STYLES = SERIES_STYLES[len(_FLIGHTS) :]

ROTOR_STYLES = (
    LineStyle(color=_BLUE, width=1.8),
    LineStyle(color=_VERMILION, dashes=(4.5, 1.6)),
    LineStyle(color=_GREEN, dashes=(6, 1.5, 1.2, 1.5)),
    LineStyle(color=INK, dashes=(1.2, 1.4)),
)


def flight_styles(names: tuple[str, ...]) -> dict[str, LineStyle]:
    """Give each flight the style that it keeps in every figure of every report.

    Parameters
    ----------
    names : tuple of str
        Names of flights.

    Returns
    -------
    dict of str to LineStyle
        By name, whatever else is drawn; names of no known flight share the styles left over.
    """
    others = cycle(_OTHER_STYLES)
    return {
        name: _FLIGHT_STYLES[name] if name in _FLIGHT_STYLES else next(others) for name in names
    }


def save_figure(draw: Callable[[], Figure], folder: Path, name: str) -> None:
    """Draw a figure in the house style and write it as PNG and SVG.

    Parameters
    ----------
    draw : callable
        Makes the figure; called with the style in force.
    folder : Path
        Where ``NAME.png`` and ``NAME.svg`` go.
    name : str
        File name without suffix.
    """
    with mpl.rc_context(_RC):
        figure = draw()
        _save_png(figure, folder / f"{name}.png")
        figure.savefig(folder / f"{name}.svg", metadata=_SVG_METADATA)


def _save_png(figure: Figure, path: Path) -> None:
    # A palette picture is a third of the size, and lines and labels need few colours.
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    picture = Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")
    picture.quantize(_PNG_COLORS, dither=Image.Dither.NONE).save(
        path, dpi=(_DOTS_PER_INCH, _DOTS_PER_INCH)
    )
