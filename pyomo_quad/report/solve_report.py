"""The report of a solve: table, figures and `report.md`."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from pyomo_quad.report.document import FIGURE_FOLDER, Document
from pyomo_quad.report.failure_section import failure_blocks
from pyomo_quad.report.flights import plan_flight, styled_flights
from pyomo_quad.report.gallery import plan_drawings, save_drawings
from pyomo_quad.report.markdown import render_markdown
from pyomo_quad.report.mission_section import mission_blocks
from pyomo_quad.report.plan_sections import (
    figure_blocks,
    origin_blocks,
    plan_title,
    plan_verdict,
    solve_blocks,
    verification_blocks,
    warning_blocks,
)
from pyomo_quad.report.plan_table import PLAN_NAME, write_plan_table
from pyomo_quad.report.summary import SUMMARY_NAME

if TYPE_CHECKING:
    from pyomo_quad.flight import Plan

__all__ = ["PLAN_FILES", "REPORT_NAME", "write_solve_report"]

REPORT_NAME = "report.md"

PLAN_FILES = (
    (PLAN_NAME, "the flight as a table, SI units in the names of the columns"),
    (SUMMARY_NAME, "the outcome for programs: status, times, versions, the whole scenario"),
    (f"{FIGURE_FOLDER}/", "the figures as PNG and SVG"),
)


def write_solve_report(
    folder: Path, plan: "Plan", warnings: Sequence[str] = (), rate_hz: float | None = None
) -> None:
    """Write what there is to say of a plan.

    Parameters
    ----------
    folder : Path
        An existing folder, empty of reports.
    plan : Plan
        Of any status; one that is not verified is called so in title and text.
    warnings : sequence of str, optional
        What a reader should know beside the numbers, one line each.
    rate_hz : float, optional
        Rows per second of the table; one per node of the mesh without.
    """
    flights = styled_flights([plan_flight(plan)])
    drawings = plan_drawings(plan, flights)
    write_plan_table(folder, plan, rate_hz)
    save_drawings(drawings, folder)
    document = Document(
        title=plan_title(plan),
        blocks=(
            plan_verdict(plan),
            *failure_blocks(plan),
            *warning_blocks(warnings),
            *mission_blocks(plan.scenario),
            *verification_blocks(plan),
            *solve_blocks(plan),
            *figure_blocks([drawing.picture for drawing in drawings]),
            *origin_blocks(PLAN_FILES),
        ),
    )
    (folder / REPORT_NAME).write_text(render_markdown(document), encoding="utf-8")
