"""What a command says of a plan: the answer on standard output, what is wrong on standard error."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from math import isnan
from pathlib import Path
from typing import Any

import pandas as pd
from rich.box import SIMPLE_HEAD
from rich.markup import escape
from rich.table import Table

from pyomo_quad.cli.consoles import complain, result_console
from pyomo_quad.flight import Plan, PlanStatus
from pyomo_quad.report.summary import summary_text
from pyomo_quad.study.comparison import ComparisonColumn
from pyomo_quad.study.run import RunResult

__all__ = ["answer", "comparison_table", "complain_about", "run_lines", "verdict_lines"]

_OUTCOMES = {
    PlanStatus.SOLVED: "solved but not verified",
    PlanStatus.NOT_CONVERGED: "not converged",
    PlanStatus.INFEASIBLE: "infeasible",
    PlanStatus.INTERRUPTED: "interrupted",
}
# Columns on the screen: heading and format.
_SHOWN = {
    ComparisonColumn.SCENARIO: ("scenario", ""),
    ComparisonColumn.FLIGHT: ("flight", ""),
    ComparisonColumn.ENERGY: ("energy J", ".2f"),
    ComparisonColumn.OWED_ENERGY: ("owed J", "z.2f"),
    ComparisonColumn.EXCESS_ENERGY: ("above hover J", ".2f"),
    ComparisonColumn.SAVING: ("optimum saves %", "z.3f"),
    ComparisonColumn.SAVING_OF_EXCESS: ("of excess %", "z.1f"),
    ComparisonColumn.TERMINAL_MISS: ("miss m", ".1e"),
    ComparisonColumn.ARRIVED: ("arrived", ""),
    ComparisonColumn.LIMITS_KEPT: ("limits kept", ""),
    ComparisonColumn.VERIFIED: ("verified", ""),
}


def verdict_lines(plan: Plan) -> Iterator[str]:
    """Yield the answer, or what is known of a failure besides its causes.

    Parameters
    ----------
    plan : Plan
        Failed or not.

    Yields
    ------
    str
        Lines for standard output.
    """
    if plan.is_verified:
        excess = plan.energy - plan.hover_energy_J
        yield (
            f"{plan.scenario.name}: verified, {plan.energy:.3f} J, {excess:.3f} J above hovering "
            f"for the same {plan.scenario.mission.duration:g} s; {plan.iteration_count} "
            f"iterations, {plan.timings['solve']:.2f} s."
        )
    if plan.failure is not None:
        diagnosis = plan.failure.diagnosis
        parts = {"Worst equations": diagnosis.residuals, "Limits reached": diagnosis.active}
        for heading, items in parts.items():
            if items:
                yield f"{heading}:"
                yield from (f"  {item}" for item in items)


def complain_about(plan: Plan, folder: Path, cautions: Sequence[str]) -> None:
    """Write on standard error what is wrong with a plan, one line for each matter.

    Parameters
    ----------
    plan : Plan
        Failed or not.
    folder : Path
        Where its report is.
    cautions : sequence of str
        What a reader should know beside the numbers.
    """
    name = plan.scenario.name
    if not plan.is_verified:
        causes = () if plan.failure is None else tuple(plan.failure.causes())
        first, *others = causes or (plan.message,)
        complain(f"{name}: {_OUTCOMES[plan.status]}: {first} See {folder}.")
        for cause in others:
            complain(f"{name}: {cause}")
    for caution in cautions:
        complain(f"{name}: warning: {caution}")


def run_lines(result: RunResult) -> Iterator[str | Table]:
    """Yield the answer of a run: the optimum, the flights beside it, and the certificate.

    Parameters
    ----------
    result : RunResult
        Of any status.

    Yields
    ------
    str or Table
        For standard output.
    """
    yield from verdict_lines(result.plan)
    if not result.comparison.empty:
        yield comparison_table(result.comparison)
    yield from _certificate_lines(result)


def _certificate_lines(result: RunResult) -> Iterator[str]:
    certificate, gap = result.certificate, result.gap_percent
    if not result.plan.is_verified:
        return
    if not certificate.applies:
        yield f"No certificate of global optimality: {certificate.reason}"
    else:
        bound = f"No flight of this mission spends less than {certificate.lower_bound_J:.3f} J"
        if gap is None:
            yield f"{bound}; the plan was made for another wind than the one that blows."
        else:
            yield f"{bound}: the optimum is at most {gap:.3f} % above the best."


def comparison_table(comparison: pd.DataFrame) -> Table:
    """Return the flights beside each other, for a terminal.

    Parameters
    ----------
    comparison : DataFrame
        Of `study.comparison`, of one scenario or many.

    Returns
    -------
    Table
        The columns that answer what the optimum saves.
    """
    table = Table(box=SIMPLE_HEAD)
    for column, (heading, _) in _SHOWN.items():
        is_text = column in (ComparisonColumn.SCENARIO, ComparisonColumn.FLIGHT)
        table.add_column(heading, justify="left" if is_text else "right")
    for _, row in comparison.iterrows():
        table.add_row(*(escape(_cell(row[column], form)) for column, (_, form) in _SHOWN.items()))
    return table


def answer(
    lines: Iterable[str | Table],
    summary: Mapping[str, Any],
    folder: Path,
    *,
    is_quiet: bool,
    as_json: bool,
) -> None:
    """Print the answer of a command in the form that was asked for.

    Parameters
    ----------
    lines : iterable of str or Table
        For people.
    summary : mapping
        For programs.
    folder : Path
        Where the report is.
    is_quiet : bool
        Say nothing.
    as_json : bool
        Print the summary and nothing else.
    """
    if as_json:
        print(summary_text(summary), end="")
    elif not is_quiet:
        for line in lines:
            if isinstance(line, Table):
                result_console().print(line)
            else:
                print(line)
        print(f"Written to {folder}.")


def _cell(value: Any, form: str) -> str:  # noqa: ANN401  a cell of any column
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float) and isnan(value):
        return ""
    return format(value, form)
