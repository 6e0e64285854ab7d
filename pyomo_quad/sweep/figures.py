"""The figures that the rows of a sweep allow: curves, maps and roses."""

from collections.abc import Iterator, Sequence
from functools import partial
from itertools import cycle
from math import degrees
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from pyomo_quad.report.document import Drawing
from pyomo_quad.report.style import (
    FULL_WIDTH,
    INK,
    MUTED,
    SERIES_STYLES,
    LineStyle,
    legend_below,
    panel_grid,
)
from pyomo_quad.sweep.case import DURATION_FIELD, HOVER_ENERGY
from pyomo_quad.sweep.design import Dimension, SweepDesign
from pyomo_quad.sweep.views import (
    Curve,
    Quantity,
    best_along,
    case_name,
    central_case,
    curves_along,
    draw_distributions,
    draw_scatter,
    draw_tornado,
    field_quantity,
    finished_rows,
    is_numeric,
    linear_note,
    number,
    output_quantity,
    pareto_front,
    plane_of,
    sensitivities,
    setting,
    settings_name,
    spread_of,
)

_PANEL_HEIGHT = 2.7  # inches
_STAR_SIZE = 11
# The front is shown together with durations up to so many times the best.
FRONT_ZOOM = 1.6
_LINE_POINTS = 11


def draw_front(curves: Sequence[Curve], quantity: Quantity, tried: Sequence[float]) -> Figure:
    """Draw a quantity against duration, and mark the Pareto front and the best duration."""
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


# Runs from dark to light in grey as well.
_COLORS = "cividis"
_CELL, _EDGES = 0.34, 1.25  # inches
_MOST_PRINTED = 13
_HALF = 0.5
# A curve that varies by less than this share of the picture has no worst direction to see.
_SAME = 0.01
_RIM = 0.06
_STAR: dict[str, Any] = {
    "clip_on": False,
    "linestyle": "none",
    "marker": "*",
    "markeredgecolor": INK,
    "markersize": 11,
    "zorder": 5,
}


def draw_heat_map(plane: pd.DataFrame, quantity: Quantity) -> Figure:
    """Draw a quantity over two numeric fields.

    Parameters
    ----------
    plane : DataFrame
        Index and columns are the two fields, named by their paths; NaN where no case finished.
    """
    across, up = field_quantity(str(plane.columns.name)), field_quantity(str(plane.index.name))
    height = min(5.0, _EDGES + _CELL * len(plane.index))
    figure = Figure(figsize=(FULL_WIDTH, height))
    axes = figure.subplots()
    figure.subplots_adjust(left=0.1, right=0.95, top=1 - 0.3 / height, bottom=0.5 / height)
    values = plane.to_numpy(dtype=float) * quantity.scale
    picture = axes.imshow(values, origin="lower", aspect="auto", cmap=_COLORS)
    figure.colorbar(picture, ax=axes, pad=0.02, fraction=0.06)
    axes.grid(visible=False)
    axes.set_xticks(range(values.shape[1]), _ticks(plane.columns, across))
    axes.set_yticks(range(values.shape[0]), _ticks(plane.index, up))
    axes.set(title=quantity.label, xlabel=across.label, ylabel=up.label)
    _print_cells(axes, values)
    return figure


def _ticks(steps: pd.Index, field: Quantity) -> list[str]:
    return [setting(float(step)) for step in steps.to_numpy(dtype=float) * field.scale]


def _print_cells(axes: Axes, values: np.ndarray) -> None:
    middle = np.nanmin(values) + _HALF * (np.nanmax(values) - np.nanmin(values))
    are_printed = values.shape[1] <= _MOST_PRINTED
    for (row, column), value in np.ndenumerate(values):
        if np.isnan(value):
            axes.plot(column, row, marker="x", color=MUTED, markersize=7)
        elif are_printed:
            color = "white" if value < middle else INK
            axes.text(
                column, row, number(value), ha="center", va="center", color=color, fontsize=6.5
            )


def draw_wind_rose(curves: Sequence[Curve], field: str, quantity: Quantity) -> Figure:
    """Draw a quantity around the compass."""
    figure = Figure(figsize=(FULL_WIDTH, 4.2))
    axes = figure.add_axes((0.04, 0.07, 0.55, 0.76), projection="polar")
    least, greatest = rose_range(curves, quantity)
    for curve, style in zip(curves, cycle(SERIES_STYLES), strict=False):
        angles, values = _closed(curve.rows[field], quantity.of(curve.rows))
        look = style.line | {"marker": style.marker, "markersize": 3.0}
        name = settings_name(curve.fixed)
        if quantity.of(curve.rows).agg(np.ptp) > _SAME * (greatest - least):
            worst = quantity.worst_row(curve.rows)
            at, value = float(worst[field]), float(worst[quantity.column]) * quantity.scale
            axes.plot(at, value, color=style.color, **_STAR)
            name += f"\nworst toward {setting(degrees(at))}°: {number(value)} {quantity.unit}"
        axes.plot(angles, values, label=name, **look)
    if greatest > least:
        axes.set_ylim(least, greatest + _RIM * (greatest - least))
    axes.set_title(f"{quantity.label} by where the wind blows to", loc="center", pad=22)
    axes.set_rlabel_position(112.5)  # type: ignore[attr-defined]
    axes.set_xticks(np.radians(range(0, 360, 45)))
    axes.set_xticklabels(["0° (+x)", "45°", "90° (+y)", "135°", "180°", "225°", "270°", "315°"])
    figure.legend(*axes.get_legend_handles_labels(), loc="center left", bbox_to_anchor=(0.66, 0.5))
    return figure


def rose_range(curves: Sequence[Curve], quantity: Quantity) -> tuple[float, float]:
    """Return the least and the greatest value of all curves of a rose, in the printed unit."""
    values = pd.concat([quantity.of(curve.rows) for curve in curves])
    return float(values.min()), float(values.max())


def _closed(angles: pd.Series, values: pd.Series) -> tuple[np.ndarray, np.ndarray]:
    """Join the last direction to the first, unless a gap is left between them."""
    directions, distances = angles.to_numpy(dtype=float), values.to_numpy(dtype=float)
    steps = np.diff(directions)
    if not steps.size or directions[0] + 2 * np.pi - directions[-1] > 1.5 * steps.max():
        return directions, distances
    return np.append(directions, directions[0] + 2 * np.pi), np.append(distances, distances[0])


_DIRECTION_FIELD = "wind.direction"
# A map needs an area, a rose some directions, a legend no more lines than one can tell apart.
_FEWEST_STEPS = 3
_MOST_CURVES = 7


def sweep_drawings(design: SweepDesign, frame: pd.DataFrame) -> tuple[Drawing, ...]:
    """List the figures of a sweep.

    Parameters
    ----------
    frame : DataFrame
        Rows of `results_frame`, at least one of them finished.
    """
    quantities = [output_quantity(column) for column in design.report_on]
    return (
        *_along_duration(design, frame, quantities),
        *_along_other_fields(design, frame, quantities),
        *_roses(design, frame, quantities),
        *_maps(design, frame, quantities),
        *_spreads(design, frame, quantities),
        *_tornadoes(design, frame, quantities),
    )


def _along_duration(
    design: SweepDesign, frame: pd.DataFrame, quantities: Sequence[Quantity]
) -> Iterator[Drawing]:
    along = next((one for one in design.dimensions if DURATION_FIELD in one.paths), None)
    if along is None:
        return
    curves = _some(curves_along(design, frame, DURATION_FIELD))
    hidden = f"{_left_out(design, frame, DURATION_FIELD)}{_hidden(design, frame)}"
    first = quantities[0]
    yield Drawing(
        name="pareto",
        title=f"{first.label} against duration",
        caption=f"{first.label} against the duration of the mission. On the Pareto front (thick) "
        "no other duration is both shorter and cheaper; it ends at the best duration (star). "
        f"Right: durations up to {FRONT_ZOOM:g} times the best only.{hidden}",
        draw=partial(draw_front, curves, first, along.values(DURATION_FIELD)),
    )
    if len(quantities) > 1:
        yield Drawing(
            name="along_duration",
            title="Against duration",
            caption=f"Other quantities against the duration of the mission.{hidden}",
            draw=partial(draw_curves, curves, DURATION_FIELD, quantities[1:]),
        )


def _along_other_fields(
    design: SweepDesign, frame: pd.DataFrame, quantities: Sequence[Quantity]
) -> Iterator[Drawing]:
    for dimension in _scales(design):
        field = dimension.paths[0]
        if field in {DURATION_FIELD, _DIRECTION_FIELD}:
            continue
        curves = _some(curves_along(design, frame, field))
        yield Drawing(
            name=f"along_{_file_name(field)}",
            title=f"Against {field_quantity(field).name}",
            caption=f"Each quantity against {field_quantity(field).name}."
            f"{_left_out(design, frame, field)}{_hidden(design, frame)}",
            draw=partial(draw_curves, curves, field, quantities),
        )


def _roses(
    design: SweepDesign, frame: pd.DataFrame, quantities: Sequence[Quantity]
) -> Iterator[Drawing]:
    if not any(_DIRECTION_FIELD in one.paths for one in _scales(design)):
        return
    curves = _some(curves_along(design, frame, _DIRECTION_FIELD))
    hidden = f"{_left_out(design, frame, _DIRECTION_FIELD)}{_hidden(design, frame)}"
    for quantity in quantities:
        yield Drawing(
            name=f"wind_rose_{quantity.column}",
            title=f"Wind rose of {quantity.name}",
            caption=f"{quantity.label} against the direction that the wind blows to."
            f"{_worst_direction(curves, quantity)}{hidden}",
            draw=partial(draw_wind_rose, curves, _DIRECTION_FIELD, quantity),
        )


def _worst_direction(curves: Sequence[Curve], quantity: Quantity) -> str:
    """Say where a rose begins, and which of its directions is worst."""
    least, _ = rose_range(curves, quantity)
    worst_rows = [quantity.worst_row(curve.rows) for curve in curves]
    together = pd.DataFrame(worst_rows).reset_index(drop=True)
    worst = quantity.worst_row(together)
    curve = curves[int(worst.name)]  # type: ignore[call-overload]
    direction = field_quantity(_DIRECTION_FIELD)
    toward = setting(float(worst[_DIRECTION_FIELD]) * direction.scale)
    value = number(float(worst[quantity.column]) * quantity.scale)
    return (
        f" The centre is not zero but the least, {number(least)} {quantity.unit}; a star marks the "
        f"worst direction of each curve, and the worst of all is toward {toward}{direction.unit} "
        f"({settings_name(curve.fixed)}): {value} {quantity.unit}."
    )


def _maps(
    design: SweepDesign, frame: pd.DataFrame, quantities: Sequence[Quantity]
) -> Iterator[Drawing]:
    scales = _scales(design)
    if len(scales) < 2:
        return
    up, across = scales[0], scales[1]
    shown = {up.paths[0], across.paths[0]}
    rest = {path: value for path, value in central_case(design).items() if path not in shown}
    where = f", at {case_name(rest)}" if rest else ""
    for quantity in quantities:
        plane = plane_of(design, frame, across, up, quantity.column)
        if plane.notna().any(axis=None):
            yield Drawing(
                name=f"map_{quantity.column}",
                title=f"{quantity.label} over two fields",
                caption=f"{quantity.label} over {field_quantity(across.paths[0]).name} and "
                f"{field_quantity(up.paths[0]).name}{where}; a cross marks a case that failed.",
                draw=partial(draw_heat_map, plane, quantity),
            )


def _spreads(
    design: SweepDesign, frame: pd.DataFrame, quantities: Sequence[Quantity]
) -> Iterator[Drawing]:
    fields = [path for one in design.dimensions if one.is_random for path in one.paths]
    if not fields:
        return
    rows, hidden = finished_rows(frame), _hidden(design, frame)
    yield Drawing(
        name="distribution",
        title="Distribution",
        caption="Cases by value: median (solid) and the middle nine tenths (between the dashes)."
        f"{hidden}",
        draw=partial(draw_distributions, rows, quantities),
    )
    yield Drawing(
        name="scatter",
        title="Against the random fields",
        caption=f"One dot per case.{hidden}",
        draw=partial(draw_scatter, rows, fields, quantities),
    )


def _tornadoes(
    design: SweepDesign, frame: pd.DataFrame, quantities: Sequence[Quantity]
) -> Iterator[Drawing]:
    for quantity in quantities:
        found = sensitivities(design, frame, quantity.column)
        if len(found) < 2:
            continue
        spread = spread_of(design, frame, quantity.column)
        yield Drawing(
            name=f"tornado_{quantity.column}",
            title=f"Sensitivity of {quantity.name}",
            caption=f"Range of {quantity.name}. Top: over all cases. Below: one field at a time "
            f"from the base case, {case_name(central_case(design))}{linear_note(spread)}. The "
            "numbers beside the bars say where their ends are reached; the axis need not begin at "
            f"zero.{_hidden(design, frame)}",
            draw=partial(draw_tornado, found, spread, quantity),
        )


def _hidden(design: SweepDesign, frame: pd.DataFrame) -> str:
    """Say how many cases have no result to draw."""
    missing = design.case_count - len(finished_rows(frame))
    if not missing:
        return ""
    return f" Not drawn: {missing} of {design.case_count} cases, which did not finish."


def _left_out(design: SweepDesign, frame: pd.DataFrame, field: str) -> str:
    """Say how many curves along a field a picture leaves out."""
    curves = curves_along(design, frame, field)
    shown = len(_some(curves))
    return f" Shown are {shown} of {len(curves)} curves." if shown < len(curves) else ""


def _scales(design: SweepDesign) -> list[Dimension]:
    """Return the dimensions along which a quantity can be drawn."""
    return [
        one
        for one in design.dimensions
        if is_numeric(one) and not one.is_random and len(one.steps) >= _FEWEST_STEPS
    ]


def _some(curves: list[Curve]) -> list[Curve]:
    """Choose as many curves as can be told apart, evenly from all."""
    if len(curves) <= _MOST_CURVES:
        return curves
    last = len(curves) - 1
    return [curves[round(k * last / (_MOST_CURVES - 1))] for k in range(_MOST_CURVES)]


def _file_name(field: str) -> str:
    return "".join(character if character.isalnum() else "_" for character in field)
