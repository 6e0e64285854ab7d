"""Report of a parameter sweep: result tables, figures and the text from templates.

A case ends as finished, failed, or lost because its worker process died. The sensitivities vary
single fields of the central case. The central case has the field values of the base scenario. If
the sweep does not contain the base value of a field, the middle of the field's values replaces it.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from pyomo_quad.flight.flight import ARRIVAL_DISTANCE_M
from pyomo_quad.report import Figures
from pyomo_quad.report.document import write_study, write_text
from pyomo_quad.sweep.case import DURATION_FIELD, TERMINAL_MISS, StudyTask
from pyomo_quad.sweep.design import Dimension, SweepDesign
from pyomo_quad.sweep.figures import sweep_drawings
from pyomo_quad.sweep.quantities import (
    Quantity,
    case_name,
    field_quantity,
    number,
    output_quantity,
    setting,
)
from pyomo_quad.sweep.statistics import SweepResults, best_along
from pyomo_quad.sweep.store import CASE_COLUMN, REASON_COLUMN, STATUS_COLUMN

_MOST_REASONS = 10
_QUANTILES = (0.0, 0.05, 0.5, 0.95, 1.0)
_TABLE, _PARQUET, _CASES = "results.csv", "results.parquet", "results.md"
_PRINTED: dict[str, Any] = {"number": number, "setting": setting, "field_quantity": field_quantity}


def write_sweep_report(
    folder: Path, design: SweepDesign, frame: pd.DataFrame, figures: Figures = Figures.SVG
) -> None:
    """Write the report of a sweep: result tables (CSV, Parquet, Markdown), figures and text.

    Parameters
    ----------
    folder : Path
        Existing empty folder that receives the files.
    design : SweepDesign
        Specification of the sweep.
    frame : DataFrame
        Result table with one row for each case that has ended, as the function `results_frame`
        reads it from the result store.
    figures : Figures, optional
        File formats of the figures, or `Figures.NONE` for a report without figures.

    Examples
    --------
    >>> from pathlib import Path
    >>> from pyomo_quad.sweep import ResultStore, results_frame
    >>> folder = Path("swept_report")
    >>> folder.mkdir()
    >>> with ResultStore.reading("swept") as store:
    ...     write_sweep_report(folder, store.design, results_frame(store), Figures.NONE)
    >>> (folder / "report.md").is_file()
    True
    """
    results = SweepResults(design.in_cells(), frame)
    design, finished = results.design, results.finished
    title = design.title or design.name
    columns = [CASE_COLUMN, *design.paths, STATUS_COLUMN, *design.report_on]
    failed = frame.drop(finished.index)
    frame.to_parquet(folder / _PARQUET, index=False)
    write_text(
        folder / _CASES,
        "sweep/cases.md.j2",
        title=title,
        columns=columns,
        settings=len(columns) - len(design.report_on),
        rows=frame.reindex(columns=columns).to_numpy(object).tolist(),
        **_PRINTED,
    )
    write_study(
        folder,
        "sweep/report.md.j2",
        tables={_TABLE: frame},
        drawings=() if finished.empty else sweep_drawings(results),
        figures=figures,
        title=title,
        design=design,
        finished=len(finished),
        failed=len(failed),
        missing=design.case_count - len(frame),
        axes=[_axis(one, path) for one in design.dimensions for path in one.paths],
        reasons=_reasons(failed),
        other_tables=(_PARQUET, _CASES),
        **({} if finished.empty else _outcome(results)),
        **_PRINTED,
    )


def _outcome(results: SweepResults) -> dict[str, Any]:
    """Return the variables of the report's template that need at least one finished case.

    `best_durations` has the best mission duration for each combination of the other fields. There,
    the first output column of the report is least. `best_of` is its label.
    """
    quantities = [output_quantity(column) for column in results.design.report_on]
    spans = [one.of(results.finished).dropna().quantile(_QUANTILES) for one in quantities]
    return {
        "arrivals": list(_arrivals(results)),
        "arrival_m": ARRIVAL_DISTANCE_M,
        "extremes": [(one.label, list(span)) for one, span in zip(quantities, spans, strict=True)],
        "best_of": quantities[0].label,
        "best_durations": list(_best_durations(results, quantities[0])),
        "sensitivities": list(_sensitivities(results, quantities)),
    }


def _reasons(failed: pd.DataFrame) -> list[tuple[str, list[Any]]]:
    """Group failed and lost cases of a sweep by reason, the most frequent reason first.

    Each of at most ten reasons has the row numbers of its cases.
    """
    grouped = failed.groupby(REASON_COLUMN)[CASE_COLUMN]
    reasons = sorted(grouped, key=lambda pair: len(pair[1]), reverse=True)
    return [(str(reason), cases.tolist()) for reason, cases in reasons[:_MOST_REASONS]]


def _axis(dimension: Dimension, path: str) -> dict[str, Any]:
    quantity, values = field_quantity(path), dimension.values(path)
    ends: Sequence[Any] = (values[0], values[-1])
    if dimension.is_numeric and all(isinstance(value, int | float) for value in values):
        ends = [end * quantity.scale for end in (min(values), max(values))]
    return {
        "path": path,
        "unit": quantity.unit,
        "count": len(values),
        "is_random": dimension.is_random,
        "first": ends[0],
        "last": ends[1],
    }


def _arrivals(results: SweepResults) -> Iterator[dict[str, Any]]:
    """Yield, for each kind of controlled flight, the cases in which it missed the goal.

    A dictionary has the `name` of the kind and the `count` of its flights. `away` has the row
    numbers of these cases, `worst_m` their largest distance from the goal [m], NaN if none missed.
    """
    rows = results.finished
    for column in map(str, rows.columns):
        is_planned = column == TERMINAL_MISS and results.design.task != StudyTask.FLY_PLAN
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
    results: SweepResults, quantities: Sequence[Quantity]
) -> Iterator[dict[str, Any]]:
    """Yield the ranges of each quantity as scenario fields vary, for the report's template.

    The key `spread` is the range over all finished cases. The key `found` has the range along each
    numeric field (`Sensitivity`). A quantity with fewer than two ranges in `found` is left out.
    """
    for quantity in quantities:
        found = results.sensitivities(quantity.column)
        # A single field leaves nothing to compare.
        if len(found) > 1:
            yield {
                "label": quantity.label,
                "scale": quantity.scale,
                "centre": case_name(results.central_case),
                "spread": results.spread(quantity.column),
                "found": found,
            }


def _best_durations(results: SweepResults, quantity: Quantity) -> Iterator[dict[str, Any]]:
    """Yield the mission duration at which a quantity is least, for the report's template.

    Each dictionary is for one combination of the other fields' values. `best` has this duration.
    `at_base` is the quantity at the base scenario's duration, NaN if no such case finished.
    """
    along = results.dimension_of(DURATION_FIELD)
    if along is None:
        return
    for curve in results.curves_along(DURATION_FIELD):
        durations = curve.rows[DURATION_FIELD]
        base = curve.rows[durations == results.design.base["mission"]["duration"]]
        yield {
            "fixed": curve.fixed,
            "best": best_along(
                curve, DURATION_FIELD, quantity.column, along.values(DURATION_FIELD)
            ),
            "scale": quantity.scale,
            "at_base": float("nan") if base.empty else float(base[quantity.column].iloc[0]),
            "shortest": float(durations.min()),
        }
