"""The report of a sweep: text, tables and files."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from pyomo_quad.report.gallery import save_drawings
from pyomo_quad.report.render import (
    Block,
    Code,
    Document,
    Heading,
    Paragraph,
    Piece,
    Strong,
    Table,
    render_markdown,
)
from pyomo_quad.report.tables import write_table
from pyomo_quad.study.comparison import ARRIVAL_DISTANCE_M
from pyomo_quad.sweep.case import DURATION_FIELD, TERMINAL_MISS
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
from pyomo_quad.sweep.spreads import linear_note
from pyomo_quad.sweep.store import CASE_COLUMN, REASON_COLUMN, STATUS_COLUMN
from pyomo_quad.sweep.study_file import StudyTask
from pyomo_quad.sweep.views import (
    Best,
    Sensitivity,
    Spread,
    best_along,
    central_case,
    curves_along,
    finished_rows,
    is_numeric,
    sensitivities,
    spread_of,
)
from pyomo_quad.version import __version__

_MOST_REASONS = 10
_QUANTILES = (("5 %", 0.05), ("median", 0.5), ("95 %", 0.95))


def design_blocks(design: SweepDesign, frame: pd.DataFrame) -> Iterator[Block]:
    """Say what was varied."""
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
    """Say what came out."""
    rows = finished_rows(frame)
    quantities = [output_quantity(column) for column in design.report_on]
    yield Heading("Results")
    yield from _arrivals(design, rows)
    yield _extremes(rows, quantities)
    if any(DURATION_FIELD in one.paths for one in design.dimensions):
        yield _best_durations(design, frame, quantities[0])
    for quantity in quantities:
        found = sensitivities(design, frame, quantity.column)
        if len(found) > 1:
            yield _sensitivity_table(
                found, spread_of(design, frame, quantity.column), quantity, central_case(design)
            )


def failure_blocks(frame: pd.DataFrame) -> Iterator[Block]:
    """Say which cases failed and why."""
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
    """Return all rows as one table."""
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


def _arrivals(design: SweepDesign, rows: pd.DataFrame) -> Iterator[Block]:
    """Count the controlled flights that end too far from the goal to have arrived."""
    for column in map(str, rows.columns):
        is_planned = column == TERMINAL_MISS and design.task != StudyTask.FLY_PLAN
        if is_planned or not column.endswith(TERMINAL_MISS):
            continue
        misses = rows[column].dropna()
        away = misses[misses > ARRIVAL_DISTANCE_M]
        name = output_quantity(column).name
        limit = f"the {ARRIVAL_DISTANCE_M:g} m within which a flight counts as arrived"
        if away.empty:
            yield Paragraph([f"{name.capitalize()}: all {len(misses)} flights end within {limit}."])
            continue
        cases = ", ".join(str(case) for case in rows.loc[away.index, CASE_COLUMN])
        yield Paragraph(
            [
                f"{name.capitalize()}: ",
                Strong(f"{len(away)} of {len(misses)} flights miss the goal by more than {limit}"),
                f", the worst by {number(float(away.max()))} m (cases {cases}).",
                " They are in all numbers below.",
            ]
        )


def _sensitivity_table(
    found: Sequence[Sensitivity], spread: Spread, quantity: Quantity, centre: dict[str, Any]
) -> Table:
    whole = (number(value * quantity.scale) for value in (spread.least, spread.greatest))
    swing = number((spread.greatest - spread.least) * quantity.scale)
    cases = (f"case {case}" for case in (spread.least_case, spread.greatest_case))
    lines: list[tuple[Piece, ...]] = [("all cases", *whole, swing, *cases)]
    for one in found:
        ends = (
            setting(end * field_quantity(one.field).scale)
            for end in (one.least_at, one.greatest_at)
        )
        reached = (number(value * quantity.scale) for value in (one.least, one.greatest, one.swing))
        lines.append((Code(one.field), *reached, *ends))
    return Table(
        caption=f"Sensitivity of {quantity.label}, one field at a time from "
        f"{case_name(centre)}{linear_note(spread)}",
        header=("field", "least", "greatest", "swing", "least at", "greatest at"),
        rows=lines,
        numeric=frozenset(range(1, 6)),
    )


def _best_durations(design: SweepDesign, frame: pd.DataFrame, quantity: Quantity) -> Table:
    lines = []
    tried = next(
        one.values(DURATION_FIELD) for one in design.dimensions if DURATION_FIELD in one.paths
    )
    for curve in curves_along(design, frame, DURATION_FIELD):
        best = best_along(curve, DURATION_FIELD, quantity.column, tried)
        base = curve.rows[curve.rows[DURATION_FIELD] == design.base["mission"]["duration"]]
        at_base = float(base[quantity.column].iloc[0]) if not base.empty else float("nan")
        lines.append(
            (
                ", ".join(f"{name} = {setting(held)}" for name, held in curve.fixed.items())
                or "all",
                setting(best.at),
                number(best.value * quantity.scale),
                number(at_base * quantity.scale),
                number(100.0 * (1.0 - best.value / at_base)),
                setting(float(curve.rows[DURATION_FIELD].min())),
                _place_of_best(best),
            )
        )
    header = (
        "cases",
        "best duration (s)",
        quantity.label,
        f"at {setting(design.base['mission']['duration'])} s",
        "saved by the best (%)",
        "shortest flown (s)",
        "the best lies",
    )
    return Table(
        caption="Best duration among those flown",
        header=header,
        rows=lines,
        numeric=frozenset(range(1, len(header) - 1)),
    )


def _place_of_best(best: Best) -> str:
    """Say between which durations the best lies, or at which edge of what was tried."""
    if best.is_inside:
        return f"between {setting(best.below)} and {setting(best.above)} s, both dearer"
    sides = (
        ("shortest", "shorter", best.below, best.is_below_flown),
        ("longest", "longer", best.above, best.is_above_flown),
    )
    edges = []
    for extreme, beyond, neighbour, is_flown in sides:
        if neighbour is None:
            edges.append(f"at the edge: the {extreme} tried, a {beyond} one may be cheaper")
        elif not is_flown:
            edges.append(f"at the edge of what finished: {setting(neighbour)} s failed")
    return "; ".join(edges)


_TABLE, _PARQUET, _TABLE_MARKDOWN = "results.csv", "results.parquet", "results.md"
_REPORT = "report.md"


def write_sweep_report(folder: Path, design: SweepDesign, frame: pd.DataFrame) -> None:
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
    table = Document(title=f"{title}: all cases", blocks=[all_cases(design, frame)])
    (folder / _TABLE_MARKDOWN).write_text(render_markdown(table), encoding="utf-8")
    blocks: list[Block] = [*design_blocks(design, frame)]
    if not finished_rows(frame).empty:
        drawings = sweep_drawings(design, frame)
        save_drawings(drawings, folder)
        blocks += [*answer_blocks(design, frame), Heading("Figures")]
        blocks += [drawing.picture for drawing in drawings]
    blocks += [*failure_blocks(frame), *_files()]
    document = Document(title=title, blocks=blocks)
    (folder / _REPORT).write_text(render_markdown(document), encoding="utf-8")


def _files() -> list[Block]:
    origin = (
        f". Written by pyomo_quad {__version__} from the results of the sweep; every case counted "
        "as finished was verified by a flight through the same equations."
    )
    all_outputs: list[Piece] = ["All cases with all outputs: ", Code(_TABLE), ", ", Code(_PARQUET)]
    reported: list[Piece] = ["; those reported on: ", Code(_TABLE_MARKDOWN)]
    return [Heading("Files"), Paragraph([*all_outputs, *reported, origin])]
