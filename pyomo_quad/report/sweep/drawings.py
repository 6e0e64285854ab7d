"""Which figures the rows of a sweep allow."""

from collections.abc import Iterator, Sequence
from functools import partial

import pandas as pd

from pyomo_quad.report.gallery import Drawing
from pyomo_quad.report.sweep.curves import draw_curves, draw_front
from pyomo_quad.report.sweep.maps import draw_heat_map, draw_wind_rose
from pyomo_quad.report.sweep.quantities import Quantity, field_quantity, output_quantity
from pyomo_quad.report.sweep.spreads import draw_distributions, draw_scatter, draw_tornado
from pyomo_quad.study.sweep.design import Dimension, SweepDesign
from pyomo_quad.study.sweep.outputs import DURATION_FIELD
from pyomo_quad.study.sweep.views import (
    Curve,
    curves_along,
    finished_rows,
    is_numeric,
    plane_of,
    sensitivities,
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
    if not any(DURATION_FIELD in one.paths for one in design.dimensions):
        return
    curves = _some(curves_along(design, frame, DURATION_FIELD))
    first = quantities[0]
    yield Drawing(
        name="pareto",
        title=f"{first.label} against duration",
        caption=f"{first.label} against the duration of the mission. On the Pareto front (thick) "
        "no other duration is both shorter and cheaper; it ends at the best duration (star).",
        draw=partial(draw_front, curves, first),
    )
    if len(quantities) > 1:
        yield Drawing(
            name="along_duration",
            title="Against duration",
            caption="Other quantities against the duration of the mission.",
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
            caption=f"Each quantity against {field_quantity(field).name}.",
            draw=partial(draw_curves, curves, field, quantities),
        )


def _roses(
    design: SweepDesign, frame: pd.DataFrame, quantities: Sequence[Quantity]
) -> Iterator[Drawing]:
    if not any(_DIRECTION_FIELD in one.paths for one in _scales(design)):
        return
    curves = _some(curves_along(design, frame, _DIRECTION_FIELD))
    for quantity in quantities:
        yield Drawing(
            name=f"wind_rose_{quantity.column}",
            title=f"Wind rose of {quantity.name}",
            caption=f"{quantity.label} against the direction that the wind blows to.",
            draw=partial(draw_wind_rose, curves, _DIRECTION_FIELD, quantity),
        )


def _maps(
    design: SweepDesign, frame: pd.DataFrame, quantities: Sequence[Quantity]
) -> Iterator[Drawing]:
    scales = _scales(design)
    if len(scales) < 2:
        return
    up, across = scales[0], scales[1]
    for quantity in quantities:
        plane = plane_of(design, frame, across, up, quantity.column)
        if plane.notna().any(axis=None):
            yield Drawing(
                name=f"map_{quantity.column}",
                title=f"{quantity.label} over two fields",
                caption=f"{quantity.label} over {field_quantity(across.paths[0]).name} and "
                f"{field_quantity(up.paths[0]).name}; a cross marks a case that failed.",
                draw=partial(draw_heat_map, plane, quantity),
            )


def _spreads(
    design: SweepDesign, frame: pd.DataFrame, quantities: Sequence[Quantity]
) -> Iterator[Drawing]:
    fields = [path for one in design.dimensions if one.is_random for path in one.paths]
    if not fields:
        return
    rows = finished_rows(frame)
    yield Drawing(
        name="distribution",
        title="Distribution",
        caption="Cases by value: median (solid) and the middle nine tenths (between the dashes).",
        draw=partial(draw_distributions, rows, quantities),
    )
    yield Drawing(
        name="scatter",
        title="Against the random fields",
        caption="One dot per case.",
        draw=partial(draw_scatter, rows, fields, quantities),
    )


def _tornadoes(
    design: SweepDesign, frame: pd.DataFrame, quantities: Sequence[Quantity]
) -> Iterator[Drawing]:
    for quantity in quantities:
        found = sensitivities(design, frame, quantity.column)
        if len(found) > 1:
            yield Drawing(
                name=f"tornado_{quantity.column}",
                title=f"Sensitivity of {quantity.name}",
                caption=f"Range of {quantity.name} along each field, all others in the middle; the "
                "numbers beside the bars say where in the field its ends are reached. Of random "
                "fields only the linear effect is shown.",
                draw=partial(draw_tornado, found, quantity),
            )


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
