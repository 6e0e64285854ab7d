"""summary.json: the outcome of a run for programs to read."""

import json
import math
import platform
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pyomo_quad.version import __version__

if TYPE_CHECKING:
    from pyomo_quad.flight.failure import Failure
    from pyomo_quad.flight.plan import Plan
    from pyomo_quad.study.run import RunResult

__all__ = [
    "SUMMARY_NAME",
    "compare_summary",
    "plan_summary",
    "run_summary",
    "summary_text",
    "write_summary",
]

SUMMARY_NAME = "summary.json"

# Distributions whose version can change a number; the second name is that of conda's package.
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
    """Summarise a plan.

    Parameters
    ----------
    plan : Plan
        Verified or not, failed or not.
    wall_s : mapping
        Seconds of the phases that the plan's own timings do not hold.
    warnings : sequence of str, optional
        What a reader should know beside the numbers.

    Returns
    -------
    dict
        Only what JSON can hold; None where there is no number.
    """
    verification = plan.verification
    timings = {**plan.timings, **wall_s}
    return {
        "scenario": plan.scenario.name,
        "status": plan.status.value,
        "verified": plan.is_verified,
        "energy_J": _number(plan.energy),
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
        "versions": _versions(),
        "warnings": list(warnings),
        "attempts": list(plan.attempts),
        "failure": None if plan.failure is None else _failure(plan.failure),
        "scenario_resolved": plan.scenario.model_dump(mode="json"),
    }


def run_summary(result: "RunResult", *, wall_s: Mapping[str, float]) -> dict[str, Any]:
    """Summarise a run: its plan, and what was flown and proven beside it.

    Parameters
    ----------
    result : RunResult
        Of any status.
    wall_s : mapping
        Seconds of the phases that the result's own timings do not hold.

    Returns
    -------
    dict
        As `plan_summary`, with the flights and the certificate.
    """
    summary = plan_summary(result.plan, wall_s=wall_s, warnings=result.warnings)
    summary["wall_s"] |= {phase: _number(result.timings[phase]) for phase in ("fly", "certify")}
    certificate = result.certificate
    summary["certificate"] = {
        "applies": certificate.applies,
        "lower_bound_J": _number(certificate.lower_bound_J),
        "gap_percent": _number(result.gap_percent),
        "reason": certificate.reason,
    }
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


def compare_summary(results: Sequence["RunResult"]) -> dict[str, Any]:
    """Summarise runs of many scenarios.

    Parameters
    ----------
    results : sequence of RunResult
        In the order of the table.

    Returns
    -------
    dict
        The summaries of the runs, in order.
    """
    return {"runs": [run_summary(result, wall_s={}) for result in results]}


def summary_text(summary: Mapping[str, Any]) -> str:
    """Return a summary as JSON text.

    Parameters
    ----------
    summary : mapping
        As `plan_summary` makes it.

    Returns
    -------
    str
        Indented, ending in a line break.
    """
    return json.dumps(summary, indent=2, allow_nan=False, ensure_ascii=False) + "\n"


def write_summary(folder: Path, summary: Mapping[str, Any]) -> None:
    """Write `summary.json` into a folder.

    Parameters
    ----------
    folder : Path
        Existing folder.
    summary : mapping
        As `plan_summary` makes it.
    """
    (folder / SUMMARY_NAME).write_text(summary_text(summary), encoding="utf-8")


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


def _versions() -> dict[str, str]:
    found = {name: _version(names) for name, names in _DISTRIBUTIONS.items()}
    return {"pyomo_quad": __version__, "python": platform.python_version(), **found}


def _version(names: Sequence[str]) -> str:
    for name in names:
        try:
            return version(name)
        except PackageNotFoundError:
            continue
    return "unknown"
