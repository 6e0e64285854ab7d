"""The text and the tables of a sweep's report."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import pandas as pd

from pyomo_quad.report.document import Block, Code, Heading, Paragraph, Piece, Strong, Table
from pyomo_quad.report.sweep.quantities import (
    Quantity,
    field_quantity,
    number,
    output_quantity,
    setting,
)
from pyomo_quad.study.sweep.design import Dimension, SweepDesign
from pyomo_quad.study.sweep.outputs import DURATION_FIELD
from pyomo_quad.study.sweep.results import CASE_COLUMN, REASON_COLUMN, STATUS_COLUMN
from pyomo_quad.study.sweep.views import (
    Sensitivity,
    curves_along,
    finished_rows,
    is_numeric,
    pareto_front,
    sensitivities,
)

__all__ = ["all_cases", "answer_blocks", "design_blocks", "failure_blocks"]

_MOST_REASONS = 10
_QUANTILES = (("5 %", 0.05), ("median", 0.5), ("95 %", 0.95))


def design_blocks(design: SweepDesign, frame: pd.DataFrame) -> Iterator[Block]:
    """Say what was varied.

    Parameters
    ----------
    design : SweepDesign
        Of the rows.
    frame : DataFrame
        Rows of `results_frame`.

    Yields
    ------
    Block
        Paragraphs and a table.
    """
    if design.about:
        yield Paragraph([design.about])
    finished = len(finished_rows(frame))
    missing = design.case_count - len(frame)
    pieces: list[Piece] = [
        f"Base scenario {design.base['name']}. ",
        Strong(f"{finished} of {design.case_count} cases finished"),
        f", {len(frame) - finished} failed",
        f", {missing} are still missing." if missing else ".",
    ]
    yield Paragraph(pieces)
    rows = [_axis_row(one, path) for one in design.dimensions for path in one.paths]
    yield Table(caption="What varies", header=("field", "unit", "values", "from", "to"), rows=rows)


def answer_blocks(design: SweepDesign, frame: pd.DataFrame) -> Iterator[Block]:
    """Say what came out.

    Parameters
    ----------
    design : SweepDesign
        Of the rows.
    frame : DataFrame
        Rows of `results_frame`.

    Yields
    ------
    Block
        A table of extremes; best durations and sensitivities where there are any.
    """
    rows = finished_rows(frame)
    quantities = [output_quantity(column) for column in design.report_on]
    yield Heading("Results")
    yield _extremes(rows, quantities)
    if any(DURATION_FIELD in one.paths for one in design.dimensions):
        yield _best_durations(design, frame, quantities[0])
    for quantity in quantities:
        found = sensitivities(design, frame, quantity.column)
        if len(found) > 1:
            yield _sensitivity_table(found, quantity)


def failure_blocks(frame: pd.DataFrame) -> Iterator[Block]:
    """Say which cases failed and why.

    Parameters
    ----------
    frame : DataFrame
        Rows of `results_frame`.

    Yields
    ------
    Block
        Nothing when all finished.
    """
    failed = frame.drop(finished_rows(frame).index)
    if failed.empty:
        return
    yield Heading("Cases that failed")
    grouped = failed.groupby(REASON_COLUMN)[CASE_COLUMN]
    reasons = sorted(grouped, key=lambda pair: len(pair[1]), reverse=True)
    yield Table(
        caption=f"{len(failed)} cases; their rows are in the tables with what was reached",
        header=("reason", "cases", "first cases"),
        rows=[
            (str(reason), str(len(cases)), ", ".join(map(str, cases.head(5))))
            for reason, cases in reasons[:_MOST_REASONS]
        ],
        numeric=frozenset({1}),
    )


def all_cases(design: SweepDesign, frame: pd.DataFrame) -> Table:
    """Return all rows as one table.

    Parameters
    ----------
    design : SweepDesign
        Of the rows.
    frame : DataFrame
        Rows of `results_frame`.

    Returns
    -------
    Table
        Fields, status, and the quantities that the study reports on.
    """
    columns = [CASE_COLUMN, *design.paths, STATUS_COLUMN, *design.report_on]
    settings = len(columns) - len(design.report_on)
    return Table(
        caption="All cases",
        header=columns,
        rows=[_row(row, settings) for row in frame.reindex(columns=columns).to_numpy(object)],
        numeric=frozenset(range(len(columns))),
    )


def _row(cells: np.ndarray, settings: int) -> tuple[Piece, ...]:
    return (*map(setting, cells[:settings]), *map(number, cells[settings:]))


def _axis_row(dimension: Dimension, path: str) -> tuple[Piece, ...]:
    quantity, values = field_quantity(path), dimension.values(path)
    how = f"{len(values)} drawn" if dimension.is_random else f"{len(values)}"
    is_scale = is_numeric(dimension) and all(isinstance(value, int | float) for value in values)
    ends: Sequence[Any] = (values[0], values[-1])
    if is_scale:
        ends = [end * quantity.scale for end in (min(values), max(values))]
    return Code(path), quantity.unit, how, *(setting(end) for end in ends)


def _extremes(rows: pd.DataFrame, quantities: Sequence[Quantity]) -> Table:
    lines = []
    for quantity in quantities:
        values = quantity.of(rows).dropna()
        lines.append(
            (
                quantity.label,
                number(float(values.min())),
                *(number(float(values.quantile(share))) for _, share in _QUANTILES),
                number(float(values.max())),
            )
        )
    header = ("quantity", "least", *(name for name, _ in _QUANTILES), "greatest")
    return Table(
        caption="Over all finished cases",
        header=header,
        rows=lines,
        numeric=frozenset(range(1, len(header))),
    )


def _sensitivity_table(found: Sequence[Sensitivity], quantity: Quantity) -> Table:
    lines: list[tuple[Piece, ...]] = []
    for one in found:
        ends = (
            setting(end * field_quantity(one.field).scale)
            for end in (one.least_at, one.greatest_at)
        )
        reached = (number(value * quantity.scale) for value in (one.least, one.greatest, one.swing))
        lines.append((Code(one.field), *reached, *ends))
    return Table(
        caption=f"Sensitivity of {quantity.label}",
        header=("field", "least", "greatest", "swing", "least at", "greatest at"),
        rows=lines,
        numeric=frozenset(range(1, 6)),
    )


def _best_durations(design: SweepDesign, frame: pd.DataFrame, quantity: Quantity) -> Table:
    lines = []
    for curve in curves_along(design, frame, DURATION_FIELD):
        best = pareto_front(curve.rows, DURATION_FIELD, quantity.column).iloc[-1]
        base = curve.rows[curve.rows[DURATION_FIELD] == design.base["mission"]["duration"]]
        at_base = float(base[quantity.column].iloc[0]) if not base.empty else float("nan")
        value = float(best[quantity.column])
        lines.append(
            (
                ", ".join(f"{name} = {setting(held)}" for name, held in curve.fixed.items())
                or "all",
                setting(float(best[DURATION_FIELD])),
                number(value * quantity.scale),
                number(at_base * quantity.scale),
                number(100.0 * (1.0 - value / at_base)),
            )
        )
    header = (
        "cases",
        "best duration (s)",
        quantity.label,
        f"at {setting(design.base['mission']['duration'])} s",
        "saved by the best (%)",
    )
    return Table(
        caption="Best duration among those flown",
        header=header,
        rows=lines,
        numeric=frozenset(range(1, len(header))),
    )
