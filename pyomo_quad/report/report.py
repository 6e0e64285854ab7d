"""The reports of a solve, of a run and of a comparison: their numbers, templates and files."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd

from pyomo_quad.flight.baselines import OPEN_LOOP, baseline_name
from pyomo_quad.flight.verification import (
    BALANCE_TOLERANCE,
    ENERGY_TOLERANCE,
    MISS_TOLERANCE,
    VIOLATION_TOLERANCE,
)
from pyomo_quad.report.gallery import (
    PATH_NAME,
    Drawing,
    adaptation_drawing,
    comparison_drawings,
    plan_drawings,
    save_drawings,
)
from pyomo_quad.report.paths import view_markup, view_script
from pyomo_quad.report.render import FIGURE_FOLDER, STATUS_WORDS, render_html, render_markdown
from pyomo_quad.report.style import FAIR_BASELINE, StyledFlight, plan_flight, styled_flights
from pyomo_quad.report.tables import PLAN_NAME, SUMMARY_NAME, write_plan_table, write_table
from pyomo_quad.scenario import Reference
from pyomo_quad.study.comparison import (
    ARRIVAL_DISTANCE_M,
    ARRIVAL_SPEED_M_PER_S,
    INSIDE_DISTANCE_M,
    ComparisonColumn,
)
from pyomo_quad.version import __version__

if TYPE_CHECKING:
    from pyomo_quad.flight import Plan
    from pyomo_quad.study.run import RunResult

REPORT_NAME = "report.md"
PAGE_NAME = "report.html"
COMPARISON_NAME = "comparison.csv"
COMPARISON_REPORT_NAME = "comparison.md"


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
    text = render_markdown(
        "report/solve.md.j2", **_of_plan(plan), drawings=drawings, warnings=warnings
    )
    (folder / REPORT_NAME).write_text(text, encoding="utf-8")


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
        write_comparison(folder, result.comparison, _title(result.plan))
    shown = (*compared, *studied, *drawings)
    save_drawings(shown, folder)
    text = render_markdown(
        "report/run.md.j2",
        **_of_plan(result.plan),
        **_of_run(result),
        beside=compared,
        studied=studied,
        drawings=drawings,
    )
    (folder / REPORT_NAME).write_text(text, encoding="utf-8")
    page = _page(folder, text, flights, shown, is_good=_is_good(result))
    (folder / PAGE_NAME).write_text(page, encoding="utf-8")


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
        text = render_markdown("report/comparison.md.j2", title=title, **_of_flights(comparison))
        (folder / COMPARISON_REPORT_NAME).write_text(text, encoding="utf-8")


def _title(plan: "Plan") -> str:
    """Return the report's title, which says so when the plan is not verified."""
    title = plan.scenario.title or plan.scenario.name
    return title if plan.is_verified else f"{STATUS_WORDS[plan.status]}: {title}"


def _of_plan(plan: "Plan") -> dict[str, Any]:
    """Return what the templates say of a plan."""
    return {
        "title": _title(plan),
        "plan": plan,
        "allowed": {
            "miss": MISS_TOLERANCE,
            "violation": VIOLATION_TOLERANCE,
            "energy_J": ENERGY_TOLERANCE * max(1.0, abs(plan.energy)),
            "imbalance": BALANCE_TOLERANCE,
        },
        "PLAN_NAME": PLAN_NAME,
        "SUMMARY_NAME": SUMMARY_NAME,
        "version": __version__,
    }


def _of_flights(comparison: pd.DataFrame) -> dict[str, Any]:
    """Return what the templates say of flights beside each other."""
    return {
        "column": ComparisonColumn,
        "rows": comparison.to_dict("records"),
        "arrival": {
            "distance_m": ARRIVAL_DISTANCE_M,
            "speed_m_per_s": ARRIVAL_SPEED_M_PER_S,
            "inside_m": INSIDE_DISTANCE_M,
        },
    }


def _of_run(result: "RunResult") -> dict[str, Any]:
    """Return what the template of a run says beyond its plan."""
    comparison, certificate = result.comparison, result.certificate
    by_name = comparison.set_index(ComparisonColumn.FLIGHT, drop=False).to_dict("index")
    followed, fair = by_name.get(baseline_name(Reference.PLAN)), by_name.get(FAIR_BASELINE)
    return {
        **_of_flights(comparison),
        "certificate": certificate,
        "gap_percent": certificate.gap_percent(result.plan.energy),
        "warnings": result.warnings,
        "rival": _rival(comparison),
        "alone": by_name.get(OPEN_LOOP),
        "followed": followed,
        "fair": fair,
        "saved_percent": 100.0 * (1.0 - _spent(followed) / _spent(fair))
        if followed and fair
        else None,
        "REPORT_NAME": REPORT_NAME,
        "PAGE_NAME": PAGE_NAME,
        "COMPARISON_NAME": COMPARISON_NAME,
        "COMPARISON_REPORT_NAME": COMPARISON_REPORT_NAME,
    }


def _rival(comparison: pd.DataFrame) -> dict[Any, Any] | None:
    """Return the arrived baseline to measure against: the smooth one, or else the cheapest."""
    has_saving = comparison[ComparisonColumn.SAVING].notna()
    rivals = comparison[comparison[ComparisonColumn.ARRIVED].astype(bool) & has_saving]
    if rivals.empty:
        return None
    fair = rivals[rivals[ComparisonColumn.FLIGHT] == FAIR_BASELINE]
    chosen = rivals.sort_values(ComparisonColumn.ENERGY) if fair.empty else fair
    return chosen.iloc[0].to_dict()


def _spent(row: dict[Any, Any]) -> float:
    """Return the energy by which flights are compared, what the end owes included, J."""
    return float(row[ComparisonColumn.HOVER_ENERGY] + row[ComparisonColumn.EXCESS_ENERGY])


def _is_good(result: "RunResult") -> bool:
    """Say whether the plan holds, and in a wind that it was not told whether all flights arrive."""
    is_untold = result.plan.scenario.wind.forecast is not None
    arrived = result.comparison[ComparisonColumn.ARRIVED].astype(bool)
    return result.plan.is_verified and (not is_untold or bool(arrived.all()))


def _comparison_drawings(
    result: "RunResult", flights: tuple[StyledFlight, ...]
) -> tuple[Drawing, ...]:
    comparison = result.comparison
    if comparison.empty:
        return ()
    arrived = comparison[ComparisonColumn.ARRIVED].astype(bool)
    absent = frozenset(comparison.loc[~arrived, ComparisonColumn.FLIGHT])
    return comparison_drawings(flights, result.plan.hover_energy_J, absent)


def _page(
    folder: Path,
    text: str,
    flights: tuple[StyledFlight, ...],
    drawings: Sequence[Drawing],
    *,
    is_good: bool,
) -> str:
    names = [drawing.name for drawing in drawings]
    has_paths = PATH_NAME in names
    return render_html(
        text,
        is_good=is_good,
        pictures={n: (folder / FIGURE_FOLDER / f"{n}.svg").read_bytes() for n in names},
        views={PATH_NAME: view_markup()} if has_paths else {},
        script=view_script(flights) if has_paths else "",
    )
