"""CSV tables and JSON summaries of reports: writing and reading.

Equal content gives files with equal bytes. Summaries also hold wall times, which differ between
runs.
"""

import csv
import json
import math
import platform
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from importlib.metadata import PackageNotFoundError, version
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn, TypeAlias

from pyomo_quad.scenario.messages import ScenarioError, printable
from pyomo_quad.version import __version__

if TYPE_CHECKING:
    import pandas as pd

    from pyomo_quad.flight.failure import Failure
    from pyomo_quad.flight.flight import Flight
    from pyomo_quad.flight.orders import OrderSearch
    from pyomo_quad.flight.plan import Plan
    from pyomo_quad.scenario import Scenario
    from pyomo_quad.study.run import RunResult

_NUMBER_FORMAT = "%.12g"
# First characters, also in full-width form, by which a spreadsheet takes a cell for a formula.
_FORMULA_STARTS = ("=", "+", "-", "@", "\t", "\r", "\n", "＝", "＋", "－", "＠")


def neutral_cell(value: object) -> object:
    """Return a table cell that a spreadsheet program does not execute as a formula.

    A text that starts like a formula gets a leading apostrophe; other values are unchanged.
    """
    if isinstance(value, str) and value.lstrip(" ").startswith(_FORMULA_STARTS):
        return f"'{value}"
    return value


#: Table as a DataFrame, or as columns by name, which saves the 0.3 s of importing pandas.
Table: TypeAlias = "pd.DataFrame | Mapping[str, Iterable[object]]"


def write_table(table: Table, path: Path) -> None:
    """Write a table to a CSV file, numbers with twelve significant digits, NaN as empty cells.

    Texts that a spreadsheet would take for formulas get an apostrophe (see `neutral_cell`).
    """
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow([neutral_cell(name) for name, _ in table.items()])
        writer.writerows(zip(*(map(_cell, column) for _, column in table.items()), strict=True))


def _cell(value: object) -> object:
    if isinstance(value, float):
        return "" if math.isnan(value) else _NUMBER_FORMAT % value
    return neutral_cell(value)


def flight_summary(
    scenario: "Scenario",
    flight: "Flight",
    *,
    hover_energy_J: float,
    arrived: bool,
    wall_s: Mapping[str, float],
) -> dict[str, Any]:
    """Summarise one controlled flight as a dictionary for `summary.json`.

    `hover_energy_J` is the energy of hovering for the duration of the flight. `arrived` tells
    whether the flight ends near the goal and nearly at rest. `wall_s` holds wall times [s] by phase
    of the program. The time of the simulation is added from `flight`.
    """
    return {
        "scenario": scenario.name,
        "flight": flight.name,
        "verified": flight.is_verified,
        "doubt": flight.doubt,
        "arrived": arrived,
        "energy_J": flight.energy_J,
        "duration_s": flight.duration_s,
        "hover_energy_J": hover_energy_J,
        "terminal_miss_m": flight.terminal_miss_m,
        "terminal_miss": dict(flight.terminal_miss),
        "max_violation": flight.max_violation,
        "worst_constraint": flight.worst_constraint,
        "broken_limits": list(flight.broken_limits),
        "resolves": [asdict(resolve) for resolve in flight.resolves],
        "wall_s": {**wall_s, "fly": flight.wall_s},
        "scenario_resolved": scenario.model_dump(mode="json"),
    }


#: File of the plan with all its numbers, which `solve --continue` reads.
PLAN_FILE_NAME = "plan.npz"
PLAN_NAME = "plan.csv"

# Last column of the table of a failed solve, which holds its best iterate; other plans lack it.
_STATUS_COLUMN = "status"


def plan_table(plan: "Plan", rate_hz: float | None = None) -> dict[str, Iterable[object]]:
    """Return the trajectory table of a plan as columns by name.

    `rate_hz` is the number of rows per second; by default there is one row for each mesh node. If
    the controls were not simulated, as after a failed solve, a last column `status` holds the
    plan's status.
    """
    columns = plan.columns(plan.times(rate_hz))
    status: dict[str, Iterable[object]] = {}
    if plan.verification is None:
        status[_STATUS_COLUMN] = [plan.status.value] * len(next(iter(columns.values())))
    return {**columns, **status}


SUMMARY_NAME = "summary.json"

# Packages whose version may affect results: names of the distribution on PyPI, then of conda's.
_DISTRIBUTIONS = {
    "pyomo": ("pyomo",),
    "casadi": ("casadi",),
    "cyipopt": ("cyipopt-wheels", "cyipopt"),
    "scipy": ("scipy",),
    "numpy": ("numpy",),
    "pandas": ("pandas",),
}
_PHASES = ("import", "build", "compile", "solve", "verify", "report")


def plan_summary(
    plan: "Plan", *, wall_s: Mapping[str, float], warnings: Sequence[str] = ()
) -> dict[str, Any]:
    """Summarise a plan as a dictionary for `summary.json`; None stands for NaN or infinity.

    `wall_s` holds the wall times [s] of the phases "import" and "report".
    """
    verification = plan.verification
    timings = {**plan.timings, **wall_s}
    return {
        "scenario": plan.scenario.name,
        "status": plan.status.value,
        "verified": plan.is_verified,
        "accuracy": {
            "asked": plan.scenario.solver.accuracy.value,
            "reached": plan.accuracy_reached,
            "energy": _number(plan.energy_uncertainty),
        },
        "energy_J": _number(plan.energy),
        "duration_s": _number(plan.duration_s),
        "passing_times_s": list(plan.passing_times_s),
        "hover_energy_J": _number(plan.hover_energy_J),
        "terminal_miss_m": None if verification is None else _number(verification.terminal_miss_m),
        "max_violation": None if verification is None else _number(verification.max_violation),
        "solver": {
            "iterations": plan.iteration_count,
            "status": (plan if plan.solution is None else plan.solution).status.value,
            "message": plan.message,
            "wall_s": _number(plan.timings.get("solve")),
        },
        "mesh": {
            "elements": plan.mesh.elements,
            "points": plan.mesh.points,
            "degrees": list(plan.mesh.degrees),
        },
        "wall_s": {phase: _number(timings.get(phase)) for phase in _PHASES},
        "versions": installed_versions(),
        "warnings": list(warnings),
        "attempts": list(plan.attempts),
        **({} if plan.order_search is None else {"order": _order(plan.order_search)}),
        **({"routes": [asdict(route) for route in plan.routes]} if plan.routes else {}),
        **({} if plan.risk is None else {"risk": asdict(plan.risk)}),
        "failure": None if plan.failure is None else _failure(plan.failure),
        "scenario_resolved": plan.scenario.model_dump(mode="json"),
    }


def run_summary(result: "RunResult", *, wall_s: Mapping[str, float]) -> dict[str, Any]:
    """Summarise a run as a dictionary for `summary.json`: plan, flights and lower bound.

    `wall_s` holds the wall times [s] of the phases "import" and "report".
    """
    from pyomo_quad.study.ensemble import ensemble_summary  # noqa: PLC0415  as below
    from pyomo_quad.study.headline import headline_of  # noqa: PLC0415  a solve has none

    summary = plan_summary(result.plan, wall_s=wall_s, warnings=result.warnings)
    summary["wall_s"] |= {
        phase: _number(result.timings[phase]) for phase in ("fly", "certify", "front")
    }
    certificate = result.certificate
    summary["certificate"] = {
        "applies": certificate.applies,
        "lower_bound_J": _number(certificate.lower_bound_J),
        "gap_percent": _number(result.gap_percent),
        "reason": certificate.reason,
    }
    headline = headline_of(result)
    if headline is not None:
        summary["headline"] = headline.summary
    if result.often is not None:
        often = ensemble_summary(result.often.flown, result.often.savings)
        is_said = often.keys() & summary.keys() | {"wall_s"}
        summary["turbulence"] = {key: v for key, v in often.items() if key not in is_said}
    summary["flights"] = [
        {
            "flight": flight.name,
            "energy_J": _number(flight.energy_J),
            "owed_energy_J": _number(flight.owed_energy_J),
            "broken_limits": list(flight.broken_limits),
            "terminal_miss_m": _number(flight.terminal_miss_m),
            "verified": flight.is_verified,
            "wall_s": _number(flight.wall_s),
        }
        for flight in result.flights
    ]
    return summary


def summary_text(summary: Mapping[str, Any]) -> str:
    """Return the summary of a report as indented JSON text.

    Raises ValueError if a number is NaN or infinite.
    """
    return json.dumps(summary, indent=2, allow_nan=False, ensure_ascii=False) + "\n"


def write_summary(folder: Path, summary: Mapping[str, Any]) -> None:
    """Write the summary of a report as `summary.json` into a folder.

    Raises ValueError if a number is NaN or infinite.
    """
    (folder / SUMMARY_NAME).write_text(summary_text(summary), encoding="utf-8")


def _order(search: "OrderSearch") -> dict[str, Any]:
    return {
        "waypoints": list(search.order),
        "legs_J": search.cost_J,
        "bound_J": search.bound_J,
        "gap_percent": 100.0 * search.gap,
        "legs_solved": search.solved,
        "legs": search.legs,
    }


def _failure(failure: "Failure") -> dict[str, Any]:
    diagnosis = failure.diagnosis
    return {
        "causes": list(failure.causes()),
        "shortest_duration_s": failure.shortest_duration_s,
        "worst_equations": [asdict(residual) for residual in diagnosis.residuals],
        "active_limits": [asdict(limit) for limit in diagnosis.active],
        "least_violation": _number(diagnosis.least_violation),
        "relaxations": [asdict(relaxation) for relaxation in diagnosis.relaxations],
        "remedies": [asdict(remedy) for remedy in failure.remedies],
    }


def _number(value: float | None) -> float | None:
    return float(value) if value is not None and math.isfinite(value) else None


def installed_versions() -> dict[str, str]:
    """Return the versions of Python, this package and the packages that may affect results.

    The version of a package that is not installed is "unknown".
    """
    found = {name: _version(names) for name, names in _DISTRIBUTIONS.items()}
    return {"pyomo_quad": __version__, "python": platform.python_version(), **found}


def _version(names: Sequence[str]) -> str:
    for name in names:
        try:
            return version(name)
        except PackageNotFoundError:
            continue
    return "unknown"


FLIGHT_NAME = "flight.csv"
# Largest table or summary [bytes]; the reports of the longest runs are far smaller.
_LARGEST_FILE = 256 * 1024 * 1024


def read_report(folder: Path, table: str = PLAN_NAME) -> tuple[dict[str, Any], "pd.DataFrame"]:
    """Read summary and trajectory table of a report folder, and check the table.

    `table` is the file name of the table. The result keeps only the time and the columns of
    `ALL_COLUMNS`. Raises ScenarioError if a file is missing, too large or not valid. The table is
    valid if the times increase and all values are finite numbers. The summary need only be JSON.
    """
    # The folder may come from an unknown source, so its files are checked.
    file = folder / SUMMARY_NAME
    content = _content(file)
    try:
        summary = json.loads(content)
    except (ValueError, RecursionError):
        refuse_report(file, "is not valid JSON")
    return summary if isinstance(summary, dict) else {}, _read_table(folder / table)


FRONT_NAME = "front.csv"
AIMS_NAME = "energy_and_charge.csv"


def read_front(folder: Path) -> "pd.DataFrame | None":
    """Read the energy-time front (least energy against duration) of a report folder.

    The columns are those of `FrontColumn`. The result is None if the report has no front. Raises
    ScenarioError if the file is damaged or cannot be read.
    """
    import pandas as pd  # noqa: PLC0415  see `write_table`

    from pyomo_quad.study.front import FrontColumn  # noqa: PLC0415

    file = folder / FRONT_NAME
    if not file.exists():
        return None
    kinds = dict.fromkeys(FrontColumn, float) | {FrontColumn.IS_PLAN: bool}
    try:
        front = pd.read_csv(BytesIO(_content(file)))[list(kinds)].astype(kinds)
    except (ValueError, KeyError):
        refuse_report(file, "is not the table of an energy-time front")
    return front


def refuse_report(file: Path, what: str) -> NoReturn:
    """Raise a one-line ScenarioError for a damaged file of a report.

    `what` is the fault, such as "is not valid JSON"; the message begins with the file's name.
    """
    raise ScenarioError(f"{printable(str(file))}: {what}; solve the scenario again.") from None


def _read_table(file: Path) -> "pd.DataFrame":
    import numpy as np  # noqa: PLC0415  see `write_table`
    import pandas as pd  # noqa: PLC0415

    from pyomo_quad.flight.columns import ALL_COLUMNS, TIME  # noqa: PLC0415

    content = _content(file)
    try:
        frame = pd.read_csv(BytesIO(content))
    except ValueError:
        refuse_report(file, "is not a CSV table")
    if TIME not in frame:
        refuse_report(file, f"has no column {TIME}")
    numbers = frame[[TIME, *(column.name for column in ALL_COLUMNS if column.name in frame)]]
    if any(kind.kind not in "fi" for kind in numbers.dtypes):
        refuse_report(file, "has text among its numbers")
    if len(numbers) < 2 or not np.isfinite(numbers.to_numpy(dtype=float)).all():
        refuse_report(file, "is not a flight with finite numbers")
    if not (np.diff(numbers[TIME]) > 0.0).all():
        refuse_report(file, f"{TIME} does not increase from row to row")
    return numbers


def _content(file: Path) -> bytes:
    try:
        with file.open("rb") as stream:
            content = stream.read(_LARGEST_FILE + 1)
    except OSError as error:
        raise ScenarioError(
            f"{printable(str(file))}: cannot be read ({error.strerror or error}); give the report "
            "folder of a run, a solve or a flight."
        ) from None
    if len(content) > _LARGEST_FILE:
        refuse_report(file, f"holds more than {_LARGEST_FILE} bytes")
    return content
