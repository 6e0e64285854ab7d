"""The folder of the report on the paper."""

import json
from pathlib import Path

import pandas as pd

from pyomo_quad.report.document import (
    FIGURE_FOLDER,
    Block,
    Bullets,
    Code,
    Document,
    Heading,
    Paragraph,
    Piece,
    Table,
)
from pyomo_quad.report.gallery import save_drawings
from pyomo_quad.report.markdown import render_markdown
from pyomo_quad.report.paper.conclusion import conclusion_blocks
from pyomo_quad.report.paper.drawings import floor_drawing, paper_drawings
from pyomo_quad.report.paper.equations import equation_table, equations_markdown
from pyomo_quad.report.paper.examination import examination_blocks
from pyomo_quad.report.paper.results import (
    baseline_blocks,
    battery_blocks,
    experiment_blocks,
    wind_blocks,
)
from pyomo_quad.report.paper.tables import TABLES, paper_tables
from pyomo_quad.report.paper.tolerances import TOLERANCES
from pyomo_quad.report.solve_report import REPORT_NAME
from pyomo_quad.report.table_file import write_table
from pyomo_quad.study.paper.corrections import corrections
from pyomo_quad.study.paper.study import PaperStudy

__all__ = ["TIMES_NAME", "write_paper_report"]

TIMES_NAME = "timings.json"


def write_paper_report(folder: Path, study: PaperStudy) -> None:
    """Write `report.md`, tables and figures of the paper's study.

    Parameters
    ----------
    folder : Path
        An existing folder, empty of reports.
    study : PaperStudy
        The results.

    Notes
    -----
    Two runs write the same bytes, but for the times, which have a file of their own.
    """
    tables = paper_tables(study)
    for name, frame in tables.items():
        write_table(frame, folder / f"{name}.csv")
    drawings, floors = paper_drawings(study), floor_drawing(study)
    save_drawings((*drawings, floors), folder)
    document = Document(
        title="The paper reproduced and examined",
        blocks=(
            *_opening(),
            *conclusion_blocks(study),
            *experiment_blocks(study),
            *wind_blocks(study),
            *baseline_blocks(study),
            *examination_blocks(study),
            floors.picture,
            Heading("The paper's figures"),
            *(drawing.picture for drawing in drawings),
            *battery_blocks(study),
            *_parameter_blocks(tables["parameters"]),
            *_correction_blocks(study),
            Heading("The paper's equations"),
            equation_table(),
            *_closing(),
        ),
    )
    text = f"{render_markdown(document)}\n{equations_markdown()}"
    (folder / REPORT_NAME).write_text(text, encoding="utf-8")
    seconds = {name: round(taken, 3) for name, taken in study.seconds.items()}
    (folder / TIMES_NAME).write_text(json.dumps(seconds, indent=2) + "\n", encoding="utf-8")


def _opening() -> tuple[Block, ...]:
    return (
        Paragraph(
            (
                (
                    "The paper is F. Yacef, N. Rizoug and L. Degaa, Energy-Efficiency Path "
                    "Planning for Quadrotor UAV Under Wind Conditions. Every number below that "
                    "is not marked as the paper's comes from live solves by "
                ),
                Code("pyomo-quad paper"),
                ".",
            )
        ),
    )


def _parameter_blocks(frame: pd.DataFrame) -> tuple[Block, ...]:
    rows: list[list[Piece]] = [
        [str(symbol), f"{printed:g}", f"{used:g}", str(unit), Code(str(field))]
        for symbol, printed, used, unit, field in zip(
            *(frame[name] for name in ("symbol", "printed", "used", "unit", "field")), strict=True
        )
    ]
    blocks: list[Block] = [Heading("The paper's numbers as used")]
    for place in dict.fromkeys(frame["place"]):
        chosen = [row for row, at in zip(rows, frame["place"], strict=True) if at == place]
        blocks.append(
            Table(
                caption=place,
                header=("symbol", "printed", "used", "unit as printed", "field"),
                rows=chosen,
                numeric=frozenset({1, 2}),
            )
        )
    return tuple(blocks)


def _correction_blocks(study: PaperStudy) -> tuple[Block, ...]:
    rows = [[row.paper, row.matter, row.here] for row in corrections(study)]
    return (
        Heading("Corrections"),
        Table(
            caption="Where the paper is wrong or silent",
            header=("the paper", "what is the matter", "what is done here"),
            rows=rows,
        ),
    )


def _closing() -> tuple[Block, ...]:
    rows: list[list[Piece]] = [
        [Code(f"{held.table}.csv"), ", ".join(held.columns), f"{held.relative:g}", held.scope]
        for held in TOLERANCES
    ]
    files: list[list[Piece]] = [[Code(f"{name}.csv"), f": {text}"] for name, text in TABLES.items()]
    files.append([Code(f"{FIGURE_FOLDER}/"), ": the figures as PNG and SVG"])
    files.append([Code(TIMES_NAME), ": what took how long; it alone changes from run to run"])
    return (
        Heading("How far these numbers are held"),
        Paragraph(
            (
                (
                    "A test computes the report anew at reduced cost and fails when a number "
                    "differs from the committed one by more than this. Solves that prove no "
                    "optimum, those of the mesh study, are shown and not held."
                ),
            )
        ),
        Table(
            caption="Largest relative drift",
            header=("table", "columns", "drift", "of"),
            rows=rows,
            numeric=frozenset({2}),
        ),
        Heading("Files"),
        Bullets(files),
    )
