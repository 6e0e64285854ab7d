"""What a small change of each state would cost along the optimum, and the Hamiltonian."""

from typing import Any

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pyomo_quad.report.figures.panels import keep_span, label_time, panel_grid
from pyomo_quad.report.signals import (
    ATTITUDE,
    BODY_RATE,
    POSITION,
    ROTOR_SPEED,
    TIME,
    VELOCITY,
    Signal,
)
from pyomo_quad.report.style import ROTOR_STYLES

__all__ = ["COSTATES", "HAMILTONIAN", "costate_name", "draw_costates"]

HAMILTONIAN = "hamiltonian"

_GROUPS = (
    (POSITION, "Position", "J/m", 1.0),
    (VELOCITY, "Velocity", "J s/m", 1.0),
    (ATTITUDE, "Attitude", "J/rad", 1.0),
    (BODY_RATE, "Body rates", "J s/rad", 1.0),
    (ROTOR_SPEED, "Rotors", "mJ s/rad", 1e3),
)
_SMALLEST_PRICE = 1e-2
# In the line of the title, so that it hides nothing.
_LEGEND: dict[str, Any] = {
    "loc": "lower right",
    "bbox_to_anchor": (1.0, 0.98),
    "borderaxespad": 0.0,
    "columnspacing": 0.9,
    "handlelength": 1.7,
    "handletextpad": 0.4,
    "ncols": 4,
}
_SMALLEST_POWER = 0.1  # W


def costate_name(state: Signal) -> str:
    """Return the name of a state in the plan's table of costates.

    Parameters
    ----------
    state : Signal
        One of the sixteen states.

    Returns
    -------
    str
        As the declared model names the state.
    """
    return state.component if state.index is None else f"{state.component}[{state.index}]"


#: Columns of the plan's table of costates that the figure shows.
COSTATES = (
    *(costate_name(state) for group in _GROUPS for state in group[0]),
    HAMILTONIAN,
)


def draw_costates(costates: pd.DataFrame, duration: float) -> Figure:
    """Draw the costates in five groups, and the Hamiltonian.

    Parameters
    ----------
    costates : DataFrame
        Time, one column per state and the Hamiltonian, at the collocation points.
    duration : float
        End of the flight, s.

    Returns
    -------
    Figure
        Six panels.
    """
    figure, panels = panel_grid(3, 2, panel_height=1.4, legend_entries=0)
    time = TIME.of(costates)
    for axes, (states, title, unit, scale) in zip(panels.flat, _GROUPS, strict=False):
        for state, style in zip(states, ROTOR_STYLES, strict=False):
            price = costates[costate_name(state)].to_numpy() * scale
            axes.plot(time, price, label=f"${state.symbol}$", **style.line)
        _finish(axes, f"{title} ({unit})", _SMALLEST_PRICE)
        axes.legend(**_LEGEND)
    last = panels[-1, -1]
    last.plot(time, costates[HAMILTONIAN].to_numpy(), **ROTOR_STYLES[0].line)
    _finish(last, "Hamiltonian $H$ (W)", _SMALLEST_POWER)
    label_time(panels[-1], duration)
    return figure


def _finish(axes: Axes, title: str, smallest_span: float) -> None:
    axes.set_title(title)
    keep_span([axes], smallest_span)
