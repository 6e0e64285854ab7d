"""The report of a sweep: numbers for its templates, tables and files."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from pyomo_quad.flight.flight import ARRIVAL_DISTANCE_M
from pyomo_quad.report import Figures
from pyomo_quad.report.document import REPORT_NAME, save_drawings, wanted_drawings
from pyomo_quad.report.render import render_markdown
from pyomo_quad.report.tables import write_table
from pyomo_quad.sweep.case import DURATION_FIELD, TERMINAL_MISS, StudyTask
from pyomo_quad.sweep.design import Dimension, SweepDesign
from pyomo_quad.sweep.figures import sweep_drawings
from pyomo_quad.sweep.store import CASE_COLUMN, REASON_COLUMN, STATUS_COLUMN
from pyomo_quad.sweep.views import (
    Quantity,
    best_along,
    case_name,
    central_case,
    curves_along,
    field_quantity,
    finished_rows,
    is_numeric,
    linear_note,
    number,
    output_quantity,
    sensitivities,
    setting,
    spread_of,
)
from pyomo_quad.version import __version__

_MOST_REASONS = 10
_QUANTILES = (0.0, 0.05, 0.5, 0.95, 1.0)
_TABLE, _PARQUET, _CASES = "results.csv", "results.parquet", "results.md"
_PRINTED = {"number": number, "setting": setting, "field_quantity": field_quantity}


def write_sweep_report(
    folder: Path,
    design: SweepDesign,
    frame: pd.DataFrame,
    figures: Figures = Figures.SVG,
) -> None:
    """Write tables (CSV, Parquet, Markdown), figures and the report.

    Parameters
    ----------
    folder : Path
        An empty folder.
    """
    design = design.in_cells()
    title = design.title or design.name
    write_table(frame, folder / _TABLE)
    frame.to_parquet(folder / _PARQUET, index=False)
    cases = render_markdown("sweep/cases.md.j2", title=title, **_cases(design, frame), **_PRINTED)
    (folder / _CASES).write_text(cases, encoding="utf-8")
    finished = finished_rows(frame)
    told = {} if finished.empty else _results(design, frame)
    drawings = () if finished.empty else wanted_drawings(sweep_drawings(design, frame), figures)
    save_drawings(drawings, folder)
    failed = frame.drop(finished.index)
    text = render_markdown(
        "sweep/report.md.j2",
        title=title,
        design=design,
        finished=len(finished),
        failed=len(failed),
        missing=design.case_count - len(frame),
        axes=[_axis(one, path) for one in design.dimensions for path in one.paths],
        drawings=drawings,
        reasons=_reasons(failed),
        version=__version__,
        TABLE=_TABLE,
        PARQUET=_PARQUET,
        CASES=_CASES,
        **told,
        **_PRINTED,
    )
    (folder / REPORT_NAME).write_text(text, encoding="utf-8")


def _cases(design: SweepDesign, frame: pd.DataFrame) -> dict[str, Any]:
    """Return the table of all rows: fields, status, and what the study reports on."""
    columns = [CASE_COLUMN, *design.paths, STATUS_COLUMN, *design.report_on]
    return {
        "columns": columns,
        "settings": len(columns) - len(design.report_on),
        "rows": frame.reindex(columns=columns).to_numpy(object).tolist(),
    }


def _results(design: SweepDesign, frame: pd.DataFrame) -> dict[str, Any]:
    """Return what came out: arrivals, extremes, best durations and sensitivities."""
    rows = finished_rows(frame)
    quantities = [output_quantity(column) for column in design.report_on]
    has_durations = any(DURATION_FIELD in one.paths for one in design.dimensions)
    return {
        "arrivals": list(_arrivals(design, rows)),
        "arrival_m": ARRIVAL_DISTANCE_M,
        "extremes": [
            {"label": one.label, "quantiles": one.of(rows).dropna().quantile(_QUANTILES).tolist()}
            for one in quantities
        ],
        "best_of": quantities[0].label,
        "best_durations": list(_best_durations(design, frame, quantities[0]))
        if has_durations
        else [],
        "sensitivities": list(_sensitivities(design, frame, quantities)),
    }


def _reasons(failed: pd.DataFrame) -> list[tuple[str, list[Any]]]:
    """Return why cases failed, the most frequent reason first, each with its cases."""
    grouped = failed.groupby(REASON_COLUMN)[CASE_COLUMN]
    reasons = sorted(grouped, key=lambda pair: len(pair[1]), reverse=True)
    return [(str(reason), cases.tolist()) for reason, cases in reasons[:_MOST_REASONS]]


def _axis(dimension: Dimension, path: str) -> dict[str, Any]:
    quantity, values = field_quantity(path), dimension.values(path)
    is_scale = is_numeric(dimension) and all(isinstance(value, int | float) for value in values)
    ends: Sequence[Any] = (values[0], values[-1])
    if is_scale:
        ends = [end * quantity.scale for end in (min(values), max(values))]
    return {
        "path": path,
        "unit": quantity.unit,
        "count": len(values),
        "is_random": dimension.is_random,
        "first": ends[0],
        "last": ends[1],
    }


def _arrivals(design: SweepDesign, rows: pd.DataFrame) -> Iterator[dict[str, Any]]:
    """Count the controlled flights that end too far from the goal to have arrived."""
    for column in map(str, rows.columns):
        is_planned = column == TERMINAL_MISS and design.task != StudyTask.FLY_PLAN
        if is_planned or not column.endswith(TERMINAL_MISS):
            continue
        misses = rows[column].dropna()
        away = misses[misses > ARRIVAL_DISTANCE_M]
        yield {
            "name": output_quantity(column).name,
            "count": len(misses),
            "away": rows.loc[away.index, CASE_COLUMN].tolist(),
            "worst_m": float(away.max()),
        }


def _sensitivities(
    design: SweepDesign, frame: pd.DataFrame, quantities: Sequence[Quantity]
) -> Iterator[dict[str, Any]]:
    """Yield by how much each quantity changes with one field at a time, where many vary."""
    for quantity in quantities:
        found = sensitivities(design, frame, quantity.column)
        if len(found) > 1:
            spread = spread_of(design, frame, quantity.column)
            yield {
                "label": quantity.label,
                "scale": quantity.scale,
                "centre": case_name(central_case(design)),
                "note": linear_note(spread),
                "spread": spread,
                "found": found,
            }


def _best_durations(
    design: SweepDesign, frame: pd.DataFrame, quantity: Quantity
) -> Iterator[dict[str, Any]]:
    """Yield where along the duration a quantity is least, for each set of the other fields."""
    tried = next(
        one.values(DURATION_FIELD) for one in design.dimensions if DURATION_FIELD in one.paths
    )
    for curve in curves_along(design, frame, DURATION_FIELD):
        base = curve.rows[curve.rows[DURATION_FIELD] == design.base["mission"]["duration"]]
        yield {
            "fixed": curve.fixed,
            "best": best_along(curve, DURATION_FIELD, quantity.column, tried),
            "scale": quantity.scale,
            "at_base": float("nan") if base.empty else float(base[quantity.column].iloc[0]),
            "shortest": float(curve.rows[DURATION_FIELD].min()),
        }
