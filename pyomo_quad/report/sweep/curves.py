"""Energy against duration: curves, the front of what is worth flying, and the best duration."""

from collections.abc import Sequence
from itertools import cycle

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from pyomo_quad.report.figures.panels import legend_below, panel_grid
from pyomo_quad.report.style import FLIGHT_STYLES, INK, MUTED, LineStyle
from pyomo_quad.report.sweep.quantities import (
    Quantity,
    field_quantity,
    number,
    setting,
    settings_name,
)
from pyomo_quad.study.sweep.outputs import DURATION_FIELD, HOVER_ENERGY
from pyomo_quad.study.sweep.views import Curve, pareto_front

__all__ = ["draw_curves", "draw_front"]

_PANEL_HEIGHT = 2.7  # inches
_STAR_SIZE = 11
_ROOM = 0.08


def draw_front(curves: Sequence[Curve], quantity: Quantity) -> Figure:
    """Draw a quantity against duration, and mark the Pareto front and the best duration.

    Parameters
    ----------
    curves : sequence of Curve
        Along the duration.
    quantity : Quantity
        What is to be small.

    Returns
    -------
    Figure
        Left: all durations. Right: the front alone, which ends at the best duration.
    """
    figure, panels = panel_grid(
        1,
        2,
        panel_height=_PANEL_HEIGHT,
        left=0.6,
        gap=0.7,
        legend_entries=len(curves) + 2,
        share_time=False,
    )
    whole, front = panels[0]
    for curve, style in zip(curves, cycle(FLIGHT_STYLES), strict=False):
        _draw_curve(whole, curve, quantity, style)
        _draw_front(front, curve, quantity, style)
    _draw_hover_floor(whole, curves[0], quantity)
    duration = field_quantity(DURATION_FIELD)
    whole.set(title="All durations", xlabel=duration.label, ylabel=quantity.label)
    front.set(title="Pareto front, to the best duration (star)", xlabel=duration.label)
    legend_below(figure, whole)
    return figure


def draw_curves(curves: Sequence[Curve], field: str, quantities: Sequence[Quantity]) -> Figure:
    """Draw quantities against one field, one panel each.

    Parameters
    ----------
    curves : sequence of Curve
        Along the field.
    field : str
        A numeric scenario field.
    quantities : sequence of Quantity
        One panel each.

    Returns
    -------
    Figure
        Two panels in a row.
    """
    columns = min(2, len(quantities))
    rows = -(-len(quantities) // columns)
    figure, panels = panel_grid(
        rows,
        columns,
        panel_height=_PANEL_HEIGHT * 0.75,
        left=0.65,
        gap=0.75,
        legend_entries=len(curves),
    )
    along = field_quantity(field)
    for axes, quantity in zip(panels.flat, quantities, strict=False):
        for curve, style in zip(curves, cycle(FLIGHT_STYLES), strict=False):
            look = style.line | {"marker": style.marker, "markersize": 3.0}
            axes.plot(
                along.of(curve.rows),
                quantity.of(curve.rows),
                label=settings_name(curve.fixed),
                **look,
            )
        axes.set_title(quantity.label)
    for axes in panels.flat[len(quantities) :]:
        axes.set_visible(False)
    for axes in panels[-1]:
        axes.set_xlabel(along.label)
        axes.xaxis.set_major_locator(MaxNLocator(nbins=6))
    legend_below(figure, panels.flat[0])
    return figure


def _draw_curve(axes: Axes, curve: Curve, quantity: Quantity, style: LineStyle) -> None:
    duration = field_quantity(DURATION_FIELD).of(curve.rows)
    look = style.line | {"marker": style.marker, "markersize": 3.0}
    axes.plot(duration, quantity.of(curve.rows), label=settings_name(curve.fixed), **look)


def _draw_front(axes: Axes, curve: Curve, quantity: Quantity, style: LineStyle) -> None:
    rows = pareto_front(curve.rows, DURATION_FIELD, quantity.column)
    duration, values = field_quantity(DURATION_FIELD).of(rows), quantity.of(rows)
    axes.plot(duration, values, marker=style.marker, markersize=4.0, **style.line)
    best = (duration.iloc[-1], values.iloc[-1])
    axes.plot(*best, marker="*", markersize=_STAR_SIZE, color=style.color, markeredgecolor=INK)
    axes.annotate(
        f"{setting(best[0])} s, {number(best[1])} {quantity.unit}",
        best,
        xytext=(8, 0),
        textcoords="offset points",
        va="center",
        color=INK,
    )
    # Room for the words on the right of the stars.
    low, high = axes.dataLim.intervalx
    axes.set_xlim(low - _ROOM * (high - low or 1.0), high + 8 * _ROOM * (high - low or 1.0))


def _draw_hover_floor(axes: Axes, curve: Curve, quantity: Quantity) -> None:
    if quantity.column.endswith("_J") and HOVER_ENERGY in curve.rows:
        axes.plot(
            curve.rows[DURATION_FIELD],
            curve.rows[HOVER_ENERGY],
            color=MUTED,
            linestyle=(0, (1, 1.5)),
            linewidth=1.0,
            label="hovering as long",
        )
