"""Reports of a plan, of a run and of a comparison of scenarios.

A run is a plan with the flights of baseline controllers on the same mission. The functions compute
the values of the reports, fill in the templates and write the files.
"""

import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import atan2, degrees, inf
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np

from pyomo_quad.flight.baselines import OPEN_LOOP, baseline_name
from pyomo_quad.flight.columns import column_of
from pyomo_quad.flight.envelope import departures_of
from pyomo_quad.flight.flight import ARRIVAL_DISTANCE_M, ARRIVAL_SPEED_M_PER_S
from pyomo_quad.flight.plan import FLIGHT_SAMPLES, PlanStatus
from pyomo_quad.flight.verification import BALANCE_TOLERANCE
from pyomo_quad.report import Figures
from pyomo_quad.report.document import (
    PAGE_NAME,
    REPORT_NAME,
    Drawing,
    write_page,
    write_study,
    write_text,
)
from pyomo_quad.report.render import STATUS_WORDS
from pyomo_quad.report.tables import (
    AIMS_NAME,
    FRONT_NAME,
    PLAN_FILE_NAME,
    PLAN_NAME,
    SUMMARY_NAME,
    installed_versions,
    plan_table,
    run_summary,
    write_table,
)
from pyomo_quad.scenario import PowerModel, Reference
from pyomo_quad.scenario.tables import Replanning
from pyomo_quad.study.aims import AimColumn, charge_beyond_least
from pyomo_quad.study.autopilot import tuning_table
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
from pyomo_quad.study.headline import headline_of, legend_of, settled_of
from pyomo_quad.study.limits_kept import limit_lines

if TYPE_CHECKING:
    import pandas as pd

    from pyomo_quad.flight import Plan
    from pyomo_quad.scenario import Scenario
    from pyomo_quad.study.run import RunResult

_CHARGE = column_of("battery.state_of_charge").name
_WIND = tuple(column_of(f"wind.velocity_{axis}").name for axis in "xy")
_CALM = 0.005  # m/s: a slower wind prints as 0.00 m/s
_SHORTEST_PATH_M = 0.1  # a shorter flight counts as hovering and has no range

COMPARISON_NAME = "comparison.csv"
COMPARISON_REPORT_NAME = "comparison.md"
_COMPARISON_TEMPLATE = "report/comparison.md.j2"
REPLANNING_NAME = "replanning.csv"
TUNING_NAME = "autopilot.csv"


def write_solve_report(
    folder: Path,
    plan: "Plan",
    warnings: Sequence[str] = (),
    rate_hz: float | None = None,
    figures: Figures = Figures.SVG,
) -> None:
    """Write the report of a plan: trajectory table, figures, text, and the plan file.

    `folder` must exist and be empty. `rate_hz` is the number of table rows per second; by default
    there is one row for each mesh node. The caller writes `summary.json`.
    """
    write_study(
        folder,
        "report/solve.md.j2",
        tables={PLAN_NAME: plan_table(plan, rate_hz)},
        drawings=_from_gallery(lambda gallery: gallery.drawings_of_solve(plan)),
        figures=figures,
        warnings=warnings,
        PLAN_FILE_NAME=PLAN_FILE_NAME,
        **_plan_values(plan),
    )
    plan.save(folder / PLAN_FILE_NAME)


def write_run_report(folder: Path, result: "RunResult", figures: Figures = Figures.SVG) -> None:
    """Write the report of a run: tables, figures, `report.md` and `report.html`.

    `folder` must exist and be empty. The caller writes `summary.json` (see `run_summary`). If
    `figures` is `NONE`, `report.html` has no interactive player of the flights.
    """
    replanned = replanning_table(result.flights, result.scenario.baseline.mpc or Replanning())
    optional = {
        COMPARISON_NAME: result.comparison,
        FRONT_NAME: result.front,
        AIMS_NAME: result.aims,
        REPLANNING_NAME: replanned,
        TUNING_NAME: tuning_table(result.tuning),
    }
    tables = {name: table for name, table in optional.items() if not table.empty}
    drawn = write_study(
        folder,
        "report/run.md.j2",
        tables={PLAN_NAME: plan_table(result.plan), **tables},
        drawings=_from_gallery(lambda gallery: gallery.drawings_of_run(result)),
        figures=figures,
        **_plan_values(result.plan),
        **_run_values(result, replanned),
    )
    if not result.comparison.empty:
        values = _comparison_values(result.comparison)
        file, title = folder / COMPARISON_REPORT_NAME, _title(result.plan)
        write_text(file, _COMPARISON_TEMPLATE, title=title, drawings=(), **values)
    views, data = _gallery().view_of_paths(result, drawn) if drawn else ({}, "")
    write_page(folder, REPORT_NAME, drawn, is_good=_is_good(result), views=views, data=data)


@dataclass(frozen=True, kw_only=True)
class RunRecord:
    """Results of a run, as stored in its report folder: summary and comparison of the flights.

    A comparison of scenarios uses the record instead of solving the scenario again.

    Attributes
    ----------
    summary : mapping
        Content of `summary.json`.
    comparison : DataFrame
        One row for each flight. The columns are the members of the enumeration `ComparisonColumn`:
        duration, energy, saving and other results of the flight.
    """

    summary: Mapping[str, Any]
    comparison: "pd.DataFrame"

    @classmethod
    def of(cls, result: "RunResult") -> "RunRecord":
        """Make the record of a run from its result."""
        return cls(summary=run_summary(result, wall_s={}), comparison=result.comparison)


def find_run(folder: Path, scenario: "Scenario") -> RunRecord | None:
    """Return the results of an earlier run of a scenario, read from the run's report folder.

    The result is None if the folder holds no verified run of this scenario with the same
    `installed_versions`, or if the scenario uses a user's own model.
    """
    import pandas as pd  # noqa: PLC0415  0.3 s that a solve has no use for

    # The code of a user's own model may have changed since the run.
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
    if not isinstance(summary, dict):
        return None
    # A search for margins may have replaced the default gains of the controller by faster gains.
    chosen = (summary.get("risk") or {}).get("gains") or {}
    if chosen and scenario.baseline.has_default_gains:
        gains = {f"baseline.gains.{name}": number for name, number in chosen.items()}
        scenario = scenario.with_values(gains)
    # Other versions of the package or its dependencies may give other numbers.
    expected = {
        "verified": True,
        "versions": installed_versions(),
        "scenario_resolved": scenario.model_dump(mode="json"),
    }
    is_same = expected.items() <= summary.items()
    return RunRecord(summary=summary, comparison=comparison) if is_same else None


def write_compare_report(
    folder: Path, comparison: "pd.DataFrame", *, is_good: bool, figures: Figures = Figures.SVG
) -> None:
    """Write the comparison of the flights of several scenarios: table, figure, text and page.

    `folder` must exist and be empty. `comparison` has the columns of `ComparisonColumn`. If
    `is_good` (all plans were verified), the page shows the main result in green.
    """
    if comparison.empty:
        write_table(comparison, folder / COMPARISON_NAME)
        return
    drawn = write_study(
        folder,
        _COMPARISON_TEMPLATE,
        tables={COMPARISON_NAME: comparison},
        drawings=_from_gallery(lambda gallery: gallery.drawings_of_comparison(comparison)),
        figures=figures,
        name=COMPARISON_REPORT_NAME,
        title="Comparison",
        **_comparison_values(comparison),
    )
    write_page(folder, COMPARISON_REPORT_NAME, drawn, is_good=is_good, views={}, data="")


def _title(plan: "Plan") -> str:
    """Return the title of a plan's report: title or name of the scenario.

    If no simulation of the controls confirmed the plan, the title begins with the plan's status.
    """
    title = plan.scenario.title or plan.scenario.name
    return title if plan.is_flyable else f"{STATUS_WORDS[plan.status]}: {title}"


def _plan_values(plan: "Plan") -> dict[str, Any]:
    """Return the variables of the report's template that describe a plan: value by name."""
    columns = plan.columns(np.linspace(*plan.trajectories.horizon, FLIGHT_SAMPLES))
    figures = plan.figures_checked
    return {
        "title": _title(plan),
        "plan": plan,
        "asked_energy": _battery_use(plan, columns),
        "departures": ()
        if plan.verification is None
        else tuple(departures_of(plan.scenario, columns)),
        "free_climb": _free_climb(plan),
        "wind_met": _wind_words(columns),
        "legs": leg_rows(plan.mission_flown, columns),
        "leg": LegColumn,
        "allowed": {
            "miss": figures.miss,
            "violation": figures.breach,
            "energy_J": figures.energy * max(1.0, abs(plan.energy)),
            "imbalance": BALANCE_TOLERANCE,
        },
        "INFEASIBLE": PlanStatus.INFEASIBLE,
        "USABLE": PlanStatus.USABLE,
        "PLAN_NAME": PLAN_NAME,
        "SUMMARY_NAME": SUMMARY_NAME,
    }


@dataclass(frozen=True, kw_only=True)
class FreeClimb:
    """Impossible climb: its potential energy exceeds the flight's energy less that of hovering.

    A plan can contain such a climb if its power model ignores the airspeed, and with it the power
    of climbing.

    Attributes
    ----------
    height_m : float
        Height of the goal above the start.
    potential_J : float
        Potential energy that the climb adds.
    spent_J : float
        Energy of the flight less that of hovering for the same time.
    """

    height_m: float
    potential_J: float
    spent_J: float
    """Energy above hovering, which the climb would have to come from."""


def _free_climb(plan: "Plan") -> FreeClimb | None:
    """Return the mission's climb if it is impossible with the energy of a plan (see `FreeClimb`).

    Otherwise the result is None. It is also None if the controls were not simulated or waypoints
    release mass. Power models that may include climbing power give None, too.
    """
    scenario = plan.scenario
    height, potential = climb_of(scenario)
    spent = plan.energy - plan.hover_energy_J
    # Under `momentum` or a user's own model, the plan's energy may include the energy of the climb.
    prices_climbs = scenario.model is not None or scenario.power.model is PowerModel.MOMENTUM
    # The released mass does not climb to the goal.
    has_releases = any(waypoint.release for waypoint in scenario.mission.waypoints)
    # The verification is None if the controls were not simulated, as after a failed solve.
    if plan.verification is None or prices_climbs or has_releases:
        return None
    if height <= 0.0 or spent >= potential:
        return None
    return FreeClimb(height_m=height, potential_J=potential, spent_J=spent)


def climb_of(scenario: "Scenario") -> tuple[float, float]:
    """Return the height that a mission climbs [m] and the potential energy it adds [J].

    Both are negative if the goal is below the start. The payload is included.
    """
    mission = scenario.mission
    height = mission.goal.position[2] - mission.start.position[2]
    return height, scenario.vehicle.total_mass * scenario.gravity * height


def _wind_words(columns: Mapping[str, np.ndarray]) -> str:
    """Return a text on mean vector, least and greatest speed of the horizontal wind of a plan.

    The text is empty in calm air, or if `columns` of the trajectory table lack the wind.
    """
    if not set(_WIND) <= set(columns):
        return ""
    along = np.array([columns[name] for name in _WIND])
    speeds, (x, y) = np.hypot(*along), along.mean(axis=1)
    if speeds.max() < _CALM:
        return ""
    toward = f" toward {degrees(atan2(y, x)) % 360.0:.0f}°" if np.hypot(x, y) > _CALM else ""
    return (
        f"{np.hypot(x, y):.2f} m/s{toward} on average (0° is +x, 90° is +y), "
        f"{speeds.min():.2f} to {speeds.max():.2f} m/s"
    )


def _battery_use(plan: "Plan", columns: Mapping[str, np.ndarray]) -> dict[str, float | None]:
    """Return a plan's path length, battery use, and time and distance on a full charge.

    The keys are `path_m`, `battery_percent`, `charge_minutes` and `charge_m`. If the state of
    charge is not known, `battery_percent` is None and the last two keys are missing.
    """
    # The controls were not simulated, for example because the solve failed.
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


def _comparison_values(comparison: "pd.DataFrame") -> dict[str, Any]:
    """Return the variables of the report's template that describe a comparison of flights.

    `comparison` has one row for each flight. Its columns are the members of `ComparisonColumn`.
    """
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


def _run_values(result: "RunResult", replanned: "pd.DataFrame") -> dict[str, Any]:
    """Return the variables of the report's template that describe a run, except its plan.

    `replanned` has one row for each flight with re-planning in flight: results and solve times.
    """
    comparison, certificate = result.comparison, result.certificate
    by_name = comparison.set_index(ComparisonColumn.FLIGHT, drop=False).to_dict("index")
    followed, fair = by_name.get(baseline_name(Reference.PLAN)), by_name.get(FAIR_BASELINE)
    return {
        **_comparison_values(comparison),
        "certificate": certificate,
        "gap_percent": certificate.gap_percent(result.plan.energy),
        "warnings": result.warnings,
        "replanned": replanned.to_dict("records"),
        "replanning": result.scenario.baseline.mpc,
        "replanning_column": ReplanningColumn,
        "REPLANNING_NAME": REPLANNING_NAME,
        "headline": headline_of(result),
        "settled_of": settled_of,
        "legend_of": legend_of,
        "limit_lines": tuple(limit_lines(result.plan, result.flights)),
        "often_words": "" if result.often is None else result.often.words,
        "tuning": result.tuning,
        "TUNING_NAME": TUNING_NAME,
        "alone": by_name.get(OPEN_LOOP),
        "followed": followed,
        "fair": fair,
        "saved_percent": 100.0 * (1.0 - settled_of(followed) / settled_of(fair))
        if followed and fair
        else None,
        "front": result.front.to_dict("records"),
        "front_column": FrontColumn,
        "FRONT_NAME": FRONT_NAME,
        "aims": result.aims.to_dict("records"),
        "aim_column": AimColumn,
        "beyond_least_percent": 0.0
        if result.aims.empty
        else 100.0 * charge_beyond_least(result.aims),
        "AIMS_NAME": AIMS_NAME,
        "REPORT_NAME": REPORT_NAME,
        "PAGE_NAME": PAGE_NAME,
        "COMPARISON_NAME": COMPARISON_NAME,
        "COMPARISON_REPORT_NAME": COMPARISON_REPORT_NAME,
    }


def _is_good(result: "RunResult") -> bool:
    """Return whether a run succeeded, so that its report shows the main result in green.

    The plan must be verified. With a wind forecast, every flight must also reach the goal.
    """
    is_untold = result.plan.scenario.wind.forecast is not None
    arrived = result.comparison[ComparisonColumn.ARRIVED].astype(bool)
    return result.plan.is_verified and (not is_untold or bool(arrived.all()))


def prepare_figures(figures: Figures) -> None:
    """Import matplotlib and the module of figures in advance.

    A command calls this function while other processes compute, so that the import does not delay
    the report. For `Figures.NONE` nothing is imported.
    """
    if figures is not Figures.NONE:
        _gallery()


def _gallery() -> ModuleType:
    """Import the module `gallery`, which lists the figures of reports, and return it."""
    # The module imports matplotlib, which takes longer than a solve.
    from pyomo_quad.report import gallery  # noqa: PLC0415

    return gallery


def _from_gallery(listed: Callable[[ModuleType], Iterable[Drawing]]) -> Iterator[Drawing]:
    """Yield the figures that the function `listed` makes with the module `gallery`."""
    # The slow import takes place when the first figure is requested, so that a report without
    # figures avoids it.
    yield from listed(_gallery())
