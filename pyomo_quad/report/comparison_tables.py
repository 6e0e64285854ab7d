"""comparison.csv and comparison.md: the flights of one scenario, or of many, beside each other."""

from pathlib import Path

import pandas as pd

from pyomo_quad.report.comparison_section import comparison_blocks
from pyomo_quad.report.document import Document
from pyomo_quad.report.markdown import render_markdown
from pyomo_quad.report.table_file import write_table

__all__ = ["COMPARISON_NAME", "COMPARISON_REPORT_NAME", "write_comparison"]

COMPARISON_NAME = "comparison.csv"
COMPARISON_REPORT_NAME = "comparison.md"


def write_comparison(folder: Path, comparison: pd.DataFrame, title: str = "Comparison") -> None:
    """Write a comparison as CSV and as Markdown.

    Parameters
    ----------
    folder : Path
        An existing folder.
    comparison : DataFrame
        One row per flight, columns of `ComparisonColumn`.
    title : str, optional
        Of the Markdown file.
    """
    write_table(comparison, folder / COMPARISON_NAME)
    if not comparison.empty:
        document = Document(title=title, blocks=comparison_blocks(comparison))
        text = render_markdown(document)
        (folder / COMPARISON_REPORT_NAME).write_text(text, encoding="utf-8")
