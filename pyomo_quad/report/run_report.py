"""The report of a run: everything of a solve, and what else was flown beside it."""

from pathlib import Path
from typing import TYPE_CHECKING

from pyomo_quad.report.comparison_section import comparison_blocks
from pyomo_quad.report.comparison_tables import (
    COMPARISON_NAME,
    COMPARISON_REPORT_NAME,
    write_comparison,
)
from pyomo_quad.report.document import FIGURE_FOLDER, Document, Picture
from pyomo_quad.report.failure_section import failure_blocks
from pyomo_quad.report.flight_view import view_markup, view_script
from pyomo_quad.report.flights import StyledFlight, plan_flight, styled_flights
from pyomo_quad.report.gallery import (
    PATH_NAME,
    Drawing,
    adaptation_drawing,
    comparison_drawings,
    plan_drawings,
    save_drawings,
)
from pyomo_quad.report.html_page import render_html
from pyomo_quad.report.markdown import render_markdown
from pyomo_quad.report.mission_section import mission_blocks
from pyomo_quad.report.plan_sections import (
    figure_blocks,
    origin_blocks,
    plan_title,
    solve_blocks,
    verification_blocks,
    warning_blocks,
)
from pyomo_quad.report.plan_table import write_plan_table
from pyomo_quad.report.run_sections import certificate_blocks, run_verdict
from pyomo_quad.report.solve_report import PLAN_FILES, REPORT_NAME
from pyomo_quad.study.comparison import ComparisonColumn

if TYPE_CHECKING:
    from pyomo_quad.study.run import RunResult

__all__ = ["PAGE_NAME", "write_run_report"]

PAGE_NAME = "report.html"

_RUN_FILES = (
    (REPORT_NAME, "this report"),
    (PAGE_NAME, "this report in one file, with a view of the paths to turn"),
)
_COMPARISON_FILES = (
    (COMPARISON_NAME, "all columns of the comparison"),
    (COMPARISON_REPORT_NAME, "the comparison alone"),
)


def write_run_report(folder: Path, result: "RunResult") -> None:
    """Write all there is to say of a run: tables, figures, `report.md` and `report.html`.

    Parameters
    ----------
    folder : Path
        An existing folder, empty of reports.
    result : RunResult
        Of any status; one whose plan is not verified is called so in title and text.
    """
    flights = styled_flights(result.flights or [plan_flight(result.plan)])
    drawings = plan_drawings(result.plan, flights)
    compared = _comparison_drawings(result, flights)
    studied = () if result.adaptation is None else (adaptation_drawing(result.adaptation),)
    write_plan_table(folder, result.plan)
    if not result.comparison.empty:
        write_comparison(folder, result.comparison, plan_title(result.plan))
    save_drawings([*compared, *studied, *drawings], folder)
    document = _document(
        result, *([drawing.picture for drawing in part] for part in (compared, studied, drawings))
    )
    (folder / REPORT_NAME).write_text(render_markdown(document), encoding="utf-8")
    (folder / PAGE_NAME).write_text(_page(folder, document, flights), encoding="utf-8")


def _comparison_drawings(
    result: "RunResult", flights: tuple[StyledFlight, ...]
) -> tuple[Drawing, ...]:
    comparison = result.comparison
    if comparison.empty:
        return ()
    arrived = comparison[ComparisonColumn.ARRIVED].astype(bool)
    absent = frozenset(comparison.loc[~arrived, ComparisonColumn.FLIGHT])
    return comparison_drawings(flights, result.plan.hover_energy_J, absent)


def _document(
    result: "RunResult", beside: list[Picture], studied: list[Picture], pictures: list[Picture]
) -> Document:
    plan = result.plan
    is_compared = not result.comparison.empty
    compared = comparison_blocks(result.comparison) if is_compared else ()
    files = (*_RUN_FILES, *PLAN_FILES, *(_COMPARISON_FILES if is_compared else ()))
    return Document(
        title=plan_title(plan),
        blocks=(
            run_verdict(result),
            *beside[:1],
            *failure_blocks(plan),
            *warning_blocks(result.warnings),
            *compared,
            *beside[1:],
            *figure_blocks(studied),
            *(certificate_blocks(plan, result.certificate) if plan.is_verified else ()),
            *figure_blocks(pictures[:1]),
            *mission_blocks(plan.scenario),
            *verification_blocks(plan),
            *solve_blocks(plan),
            *figure_blocks(pictures[1:]),
            *origin_blocks(files),
        ),
    )


def _page(folder: Path, document: Document, flights: tuple[StyledFlight, ...]) -> str:
    names = [block.name for block in document.blocks if isinstance(block, Picture)]
    drawn = {name: (folder / FIGURE_FOLDER / f"{name}.svg").read_bytes() for name in names}
    has_paths = PATH_NAME in drawn
    views = {PATH_NAME: view_markup()} if has_paths else {}
    return render_html(document, drawn, views, view_script(flights) if has_paths else "")
