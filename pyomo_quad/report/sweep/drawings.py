"""Which figures the rows of a sweep allow."""

from collections.abc import Iterator, Sequence
from functools import partial

import pandas as pd

from pyomo_quad.report.gallery import Drawing
from pyomo_quad.report.sweep.curves import FRONT_ZOOM, draw_curves, draw_front
from pyomo_quad.report.sweep.maps import draw_heat_map, draw_wind_rose, rose_range
from pyomo_quad.report.sweep.quantities import (
    Quantity,
    case_name,
    field_quantity,
    number,
    output_quantity,
    setting,
    settings_name,
)
from pyomo_quad.report.sweep.sections import linear_note
from pyomo_quad.report.sweep.spreads import draw_distributions, draw_scatter, draw_tornado
from pyomo_quad.study.sweep.design import Dimension, SweepDesign
from pyomo_quad.study.sweep.outputs import DURATION_FIELD
from pyomo_quad.study.sweep.views import (
    Curve,
    central_case,
    curves_along,
    finished_rows,
    is_numeric,
    plane_of,
    sensitivities,
    spread_of,
)

__all__ = ["sweep_drawings"]

_DIRECTION_FIELD = "wind.direction"
# A map needs an area, a rose some directions, a legend no more lines than one can tell apart.
_FEWEST_STEPS = 3
_MOST_CURVES = 7


def sweep_drawings(design: SweepDesign, frame: pd.DataFrame) -> tuple[Drawing, ...]:
    """List the figures of a sweep.

    Parameters
    ----------
    design : SweepDesign
        Of the rows.
    frame : DataFrame
        Rows of `results_frame`, at least one of them finished.

    Returns
    -------
    tuple of Drawing
        Only those whose rows are there.
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
