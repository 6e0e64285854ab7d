"""The reports of a solve, of a run and of a comparison: their numbers, templates and files."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from math import inf
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np

from pyomo_quad.flight.baselines import OPEN_LOOP, baseline_name
from pyomo_quad.flight.flight import (
    ARRIVAL_DISTANCE_M,
    ARRIVAL_SPEED_M_PER_S,
    COLUMNS,
    VIOLATION_TOLERANCE,
)
from pyomo_quad.flight.plan import FLIGHT_SAMPLES
from pyomo_quad.flight.verification import (
    BALANCE_TOLERANCE,
    ENERGY_TOLERANCE,
    MISS_TOLERANCE,
)
from pyomo_quad.report import Figures
from pyomo_quad.report.document import REPORT_NAME, Drawing, drawn_meanwhile, write_text
from pyomo_quad.report.render import FIGURE_FOLDER, STATUS_WORDS
from pyomo_quad.report.tables import (
    FRONT_NAME,
    PLAN_NAME,
    SUMMARY_NAME,
    installed_versions,
    run_summary,
    write_plan_table,
    write_table,
)
from pyomo_quad.scenario import PowerModel, Reference
from pyomo_quad.scenario.tables import Replanning
from pyomo_quad.study.comparison import (
    FAIR_BASELINE,
    INSIDE_DISTANCE_M,
    RESERVE,
    ComparisonColumn,
    LegColumn,
    ReplanningColumn,
    leg_rows,
    replanning_table,
    way_flown,
)
from pyomo_quad.study.front import FrontColumn
from pyomo_quad.version import __version__

if TYPE_CHECKING:
    import pandas as pd

    from pyomo_quad.flight import Plan
    from pyomo_quad.scenario import Scenario
    from pyomo_quad.study.run import RunResult

_COLUMN_OF = {column.component: column.name for column in COLUMNS if column.index is None}
_CHARGE = _COLUMN_OF["battery.state_of_charge"]
_SHORTEST_PATH_M = 0.1  # below, a flight stays where it is and has no range

PAGE_NAME = "report.html"
COMPARISON_NAME = "comparison.csv"
COMPARISON_REPORT_NAME = "comparison.md"
REPLANNING_NAME = "replanning.csv"


def write_solve_report(
    folder: Path,
    plan: "Plan",
    warnings: Sequence[str] = (),
    rate_hz: float | None = None,
    figures: Figures = Figures.SVG,
) -> None:
    """Write what there is to say of a plan of any status into a folder empty of reports.

    A plan that is not verified is called so in title and text; ``warnings`` are what a reader
    should know beside the numbers. The table has a row per node of the mesh, or ``rate_hz`` a
    second.
    """
    drawings = () if figures is Figures.NONE else _gallery().drawings_of_solve(plan, figures)
    with drawn_meanwhile(drawings, folder):
        write_plan_table(folder, plan, rate_hz)
        write_text(
            folder / REPORT_NAME,
            "report/solve.md.j2",
            **_of_plan(plan),
            drawings=drawings,
            warnings=warnings,
        )


def write_run_report(folder: Path, result: "RunResult", figures: Figures = Figures.SVG) -> None:
    """Write all there is to say of a run of any status into a folder empty of reports.

    That is tables, figures, `report.md` and `report.html`; without figures the page has no paths to
    turn either.
    """
    parts: tuple[tuple[Drawing, ...], ...] = ((), (), ())
    if figures is not Figures.NONE:
        parts = _gallery().drawings_of_run(result, figures)
    drawings = tuple(chain(*parts))
    with drawn_meanwhile(drawings, folder):
        _write_tables(folder, result)
        shown = dict(zip(("beside", "studied", "drawings"), parts, strict=True))
        text = write_text(
            folder / REPORT_NAME,
            "report/run.md.j2",
            **_of_plan(result.plan),
            **_of_run(result),
            **shown,
        )
    page = _page(folder, text, result, drawings)
    (folder / PAGE_NAME).write_text(page, encoding="utf-8")


def _write_tables(folder: Path, result: "RunResult") -> None:
    write_plan_table(folder, result.plan)
    if not result.comparison.empty:
        write_comparison(folder, result.comparison, _title(result.plan))
    if not result.front.empty:
        write_table(result.front, folder / FRONT_NAME)
    replanned = _replanned(result)
    if not replanned.empty:
        write_table(replanned, folder / REPLANNING_NAME)


def write_comparison(folder: Path, comparison: "pd.DataFrame", title: str = "Comparison") -> None:
    """Write a comparison, one row per flight, as CSV and under its title as Markdown."""
    write_table(comparison, folder / COMPARISON_NAME)
    if not comparison.empty:
        _write_comparison_text(folder, comparison, title)


def _write_comparison_text(
    folder: Path, comparison: "pd.DataFrame", title: str, drawings: Sequence[Drawing] = ()
) -> str:
    return write_text(
        folder / COMPARISON_REPORT_NAME,
        "report/comparison.md.j2",
        title=title,
        **_of_flights(comparison),
        drawings=drawings,
    )


@dataclass(frozen=True, kw_only=True)
class RunRecord:
    """What is kept of a run: its summary, and its flights beside each other."""

    summary: Mapping[str, Any]
    comparison: "pd.DataFrame"

    @classmethod
    def of(cls, result: "RunResult") -> "RunRecord":
        """Return the record of a run that was just made."""
        return cls(summary=run_summary(result, wall_s={}), comparison=result.comparison)


def find_run(folder: Path, scenario: "Scenario") -> RunRecord | None:
    """Return the verified run of exactly this scenario that a folder holds, if it does.

    A run by other versions may differ in its numbers, and the code of a model of one's own may
    have changed since: neither is taken.
    """
    import pandas as pd  # noqa: PLC0415  0.3 s that a solve has no use for

    if scenario.model is not None:
        return None
    flags = (ComparisonColumn.ARRIVED, ComparisonColumn.LIMITS_KEPT, ComparisonColumn.VERIFIED)
    texts = (ComparisonColumn.SCENARIO, ComparisonColumn.FLIGHT, ComparisonColumn.BROKEN_LIMITS)
    columns = [*ComparisonColumn, *([RESERVE] if scenario.limits.reserve else [])]
    kinds = dict.fromkeys(columns, float) | dict.fromkeys(flags, bool)
    try:
        summary = json.loads((folder / SUMMARY_NAME).read_text(encoding="utf-8"))
        comparison = pd.read_csv(
            folder / COMPARISON_NAME,
            usecols=lambda name: name in kinds,
            dtype=kinds | dict.fromkeys(texts, str),
        )
        comparison = comparison[columns].fillna(dict.fromkeys(texts, ""))
    except (OSError, ValueError, KeyError):
        return None
    expected = {
        "verified": True,
        "versions": installed_versions(),
        "scenario_resolved": scenario.model_dump(mode="json"),
    }
    is_same = isinstance(summary, dict) and expected.items() <= summary.items()
    return RunRecord(summary=summary, comparison=comparison) if is_same else None


def write_compare_report(
    folder: Path, comparison: "pd.DataFrame", *, is_good: bool, figures: Figures = Figures.SVG
) -> None:
    """Write the flights of many scenarios beside each other: tables, a figure and a page.

    ``is_good`` says whether every plan was verified.
    """
    write_table(comparison, folder / COMPARISON_NAME)
    if comparison.empty:
        return
    drawings: tuple[Drawing, ...] = ()
    if figures is not Figures.NONE:
        drawings = _gallery().drawings_of_comparison(comparison, figures)
    with drawn_meanwhile(drawings, folder):
        text = _write_comparison_text(folder, comparison, "Comparison", drawings)
    from pyomo_quad.report.page import render_html  # noqa: PLC0415  a solve writes no page

    page = render_html(
        text, is_good=is_good, pictures=_pictures(folder, drawings), views={}, data=""
    )
    (folder / PAGE_NAME).write_text(page, encoding="utf-8")


def _title(plan: "Plan") -> str:
    """Return the report's title, which says so when the plan is not verified."""
    title = plan.scenario.title or plan.scenario.name
    return title if plan.is_verified else f"{STATUS_WORDS[plan.status]}: {title}"


def _of_plan(plan: "Plan") -> dict[str, Any]:
    """Return what the templates say of a plan."""
    columns = plan.columns(np.linspace(*plan.trajectories.horizon, FLIGHT_SAMPLES))
    return {
        "title": _title(plan),
        "plan": plan,
        "asked_energy": _asked_energy(plan, columns),
        "free_climb": _free_climb(plan),
        "legs": leg_rows(plan.mission_flown, columns),
        "leg": LegColumn,
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


@dataclass(frozen=True, kw_only=True)
class FreeClimb:
    """A climb that the power model gives away."""

    height_m: float
    potential_J: float
    spent_J: float
    """Energy above hovering, in which the climb would have to be."""


def _free_climb(plan: "Plan") -> FreeClimb | None:
    """Return the mission's climb where the flight spends less on it than its potential energy.

    Of the declared power models only `momentum` depends on the airspeed and so prices a climb; a
    model of the user's own may.  A parcel left on the way does not climb to the goal.
    """
    scenario = plan.scenario
    height, potential = climb_of(scenario)
    spent = plan.energy - plan.hover_energy_J
    prices_climbs = scenario.model is not None or scenario.power.model is PowerModel.MOMENTUM
    has_releases = any(waypoint.release for waypoint in scenario.mission.waypoints)
    if plan.verification is None or prices_climbs or has_releases:
        return None
    if height <= 0.0 or spent >= potential:
        return None
    return FreeClimb(height_m=height, potential_J=potential, spent_J=spent)


def climb_of(scenario: "Scenario") -> tuple[float, float]:
    """Return how far a mission climbs, m, and the potential energy that this adds, J."""
    mission = scenario.mission
    height = mission.goal.position[2] - mission.start.position[2]
    return height, scenario.vehicle.total_mass * scenario.gravity * height


def _asked_energy(plan: "Plan", columns: Mapping[str, np.ndarray]) -> dict[str, float | None]:
    """Return the plan's energy as people ask for it, and what a whole charge is good for."""
    if plan.verification is None:
        return {"path_m": 0.0, "battery_percent": None}
    path = float(way_flown(columns)[-1])
    path = path if path > _SHORTEST_PATH_M else 0.0
    if _CHARGE not in columns:
        return {"path_m": path, "battery_percent": None}
    used = float(columns[_CHARGE][0] - columns[_CHARGE][-1])
    charges = 100.0 / used if used > 0.0 else inf
    return {
        "path_m": path,
        "battery_percent": used,
        "charge_minutes": charges * plan.duration_s / 60.0,
        "charge_m": charges * path,
    }


def _of_flights(comparison: "pd.DataFrame") -> dict[str, Any]:
    """Return what the templates say of flights beside each other."""
    return {
        "column": ComparisonColumn,
        "rows": comparison.to_dict("records"),
        "RESERVE": RESERVE,
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
    names = comparison[ComparisonColumn.FLIGHT]
    is_cruise = names.str.startswith(baseline_name(Reference.CRUISE)).astype(bool)
    followed, fair = by_name.get(baseline_name(Reference.PLAN)), by_name.get(FAIR_BASELINE)
    return {
        **_of_flights(comparison),
        "certificate": certificate,
        "gap_percent": certificate.gap_percent(result.plan.energy),
        "warnings": result.warnings,
        "replanned": _replanned(result).to_dict("records"),
        "replanning": result.scenario.baseline.mpc,
        "replanning_column": ReplanningColumn,
        "REPLANNING_NAME": REPLANNING_NAME,
        "rival": _rival(comparison[~is_cruise]),
        "cruise": _rival(comparison[is_cruise]),
        "autopilot_settings": result.scenario.baseline,
        "alone": by_name.get(OPEN_LOOP),
        "followed": followed,
        "fair": fair,
        "saved_percent": 100.0 * (1.0 - _spent(followed) / _spent(fair))
        if followed and fair
        else None,
        "front": result.front.to_dict("records"),
        "front_column": FrontColumn,
        "FRONT_NAME": FRONT_NAME,
        "REPORT_NAME": REPORT_NAME,
        "PAGE_NAME": PAGE_NAME,
        "COMPARISON_NAME": COMPARISON_NAME,
        "COMPARISON_REPORT_NAME": COMPARISON_REPORT_NAME,
    }


def _replanned(result: "RunResult") -> "pd.DataFrame":
    return replanning_table(result.flights, result.scenario.baseline.mpc or Replanning())


def _rival(comparison: "pd.DataFrame") -> dict[Any, Any] | None:
    """Return the arrived baseline to measure against: the smooth one, or the cheapest."""
    has_saving = comparison[ComparisonColumn.SAVING].notna()
    is_own = comparison[ComparisonColumn.FLIGHT] == OPEN_LOOP
    rivals = comparison[comparison[ComparisonColumn.ARRIVED].astype(bool) & has_saving & ~is_own]
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


def prepare_figures(figures: Figures) -> None:
    """Import now what figures of a report need, if any are wanted."""
    if figures is not Figures.NONE:
        _gallery()


def _gallery() -> ModuleType:
    """Import matplotlib, which takes longer than a solve, where there is something to draw."""
    from pyomo_quad.report import gallery  # noqa: PLC0415

    return gallery


def _page(folder: Path, text: str, result: "RunResult", drawings: Sequence[Drawing]) -> str:
    views: dict[str, str] = {}
    data = ""
    if drawings and _gallery().PATH_NAME in [drawing.name for drawing in drawings]:
        views, data = _gallery().view_of_paths(result)
    from pyomo_quad.report.page import render_html  # noqa: PLC0415  only for a page

    return render_html(
        text,
        is_good=_is_good(result),
        pictures=_pictures(folder, drawings),
        views=views,
        data=data,
    )


def _pictures(folder: Path, drawings: Sequence[Drawing]) -> dict[str, bytes]:
    return {d.name: (folder / FIGURE_FOLDER / d.files[0]).read_bytes() for d in drawings}
