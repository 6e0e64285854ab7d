"""All files of a sweep's report."""

from pathlib import Path

import pandas as pd

from pyomo_quad.report.document import Block, Code, Document, Heading, Paragraph, Piece
from pyomo_quad.report.gallery import save_drawings
from pyomo_quad.report.markdown import render_markdown
from pyomo_quad.report.sweep.drawings import sweep_drawings
from pyomo_quad.report.sweep.sections import (
    all_cases,
    answer_blocks,
    design_blocks,
    failure_blocks,
)
from pyomo_quad.report.table_file import write_table
from pyomo_quad.study.sweep.design import SweepDesign
from pyomo_quad.study.sweep.views import finished_rows
from pyomo_quad.version import __version__

__all__ = ["write_sweep_report"]

_TABLE, _PARQUET, _TABLE_MARKDOWN = "results.csv", "results.parquet", "results.md"
_REPORT = "report.md"


def write_sweep_report(folder: Path, design: SweepDesign, frame: pd.DataFrame) -> None:
    """Write tables (CSV, Parquet, Markdown), figures and the report.

    Parameters
    ----------
    folder : Path
        An empty folder.
    design : SweepDesign
        Of the rows.
    frame : DataFrame
        Rows of `results_frame`.
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
