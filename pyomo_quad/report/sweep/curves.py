"""Energy against duration: curves, the front of what is worth flying, and the best duration."""

from collections.abc import Sequence
from itertools import cycle

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from pyomo_quad.report.figures.panels import legend_below, panel_grid
from pyomo_quad.report.style import INK, MUTED, SERIES_STYLES, LineStyle
from pyomo_quad.report.sweep.quantities import (
    Quantity,
    field_quantity,
    number,
    setting,
    settings_name,
)
from pyomo_quad.study.sweep.outputs import DURATION_FIELD, HOVER_ENERGY
from pyomo_quad.study.sweep.views import Curve, best_along, pareto_front

__all__ = ["FRONT_ZOOM", "draw_curves", "draw_front"]

_PANEL_HEIGHT = 2.7  # inches
_STAR_SIZE = 11
# The front is shown together with durations up to so many times the best.
FRONT_ZOOM = 1.6
_LINE_POINTS = 11


def draw_front(curves: Sequence[Curve], quantity: Quantity, tried: Sequence[float]) -> Figure:
    """Draw a quantity against duration, and mark the Pareto front and the best duration.

    Parameters
    ----------
    curves : sequence of Curve
        Along the duration.
    quantity : Quantity
        What is to be small.
    tried : sequence of float
        All durations that cases were made for.

    Returns
    -------
    Figure
        Left: all durations. Right: the front, which ends at the best duration.
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
    for row, (curve, style) in enumerate(zip(curves, cycle(SERIES_STYLES), strict=False)):
        _draw_curve(whole, curve, quantity, style)
        _draw_front(front, curve, quantity, style)
        _name_best(front, curve, quantity, tried, (style, row))
    _draw_hover_floor(whole, curves[0], quantity)
    duration = field_quantity(DURATION_FIELD)
    whole.set(title="All durations", xlabel=duration.label, ylabel=quantity.label)
    front.set(title="Pareto front (thick) and best duration (star)", xlabel=duration.label)
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
        for curve, style in zip(curves, cycle(SERIES_STYLES), strict=False):
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
    front = pareto_front(curve.rows, DURATION_FIELD, quantity.column)
    best = front.iloc[[-1]]
    near = curve.rows[curve.rows[DURATION_FIELD] <= FRONT_ZOOM * best[DURATION_FIELD].iloc[0]]
    duration = field_quantity(DURATION_FIELD)
    look = style.line | {"marker": style.marker, "markersize": 3.0, "linewidth": 0.9}
    axes.plot(duration.of(near), quantity.of(near), **look)
    axes.plot(duration.of(front), quantity.of(front), color=style.color, linewidth=3.5)
    at, value = float(duration.of(best).iloc[0]), float(quantity.of(best).iloc[0])
    axes.plot(at, value, marker="*", markersize=_STAR_SIZE, color=style.color, mec=INK)


def _name_best(
    axes: Axes,
    curve: Curve,
    quantity: Quantity,
    tried: Sequence[float],
    place: tuple[LineStyle, int],
) -> None:
    """Write the best duration of a curve into its row of the panel."""
    style, row = place
    best = best_along(curve, DURATION_FIELD, quantity.column, tried)
    said = f"{setting(best.at)} s, {number(best.value * quantity.scale)} {quantity.unit}"
    edge = "" if best.is_inside else " (at an edge)"
    axes.annotate(
        f"{settings_name(curve.fixed)}: {said}{edge}",
        (0.03, 0.97),
        xycoords="axes fraction",
        xytext=(0, -_LINE_POINTS * row),
        textcoords="offset points",
        va="top",
        color=style.color,
    )


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
