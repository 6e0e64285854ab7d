"""Shared parts of the commands that solve: planner with progress display, printed results.

Importing this module imports Pyomo, CasADi and Ipopt, which takes over a second.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from math import isnan
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer
from rich.box import SIMPLE_HEAD
from rich.markup import escape
from rich.table import Table

from pyomo_quad.cli.endings import (
    ExitCode,
    Interruption,
    SolveStopped,
    record_last_message,
    stop_on_interrupt,
)
from pyomo_quad.cli.terminal import Options, complain, live_line, result_console
from pyomo_quad.collocation import Iteration, Problem, Progress, TranscriptionError, WarmStart
from pyomo_quad.flight import Plan, Planner, PlanStatus
from pyomo_quad.flight.envelope import departures
from pyomo_quad.flight.limit_words import limit_words
from pyomo_quad.flight.planning import Builder
from pyomo_quad.flight.search import State, accuracy_words
from pyomo_quad.model import model_builder
from pyomo_quad.report.folder import output_folder
from pyomo_quad.report.tables import (
    PLAN_FILE_NAME,
    PLAN_NAME,
    plan_table,
    summary_text,
    write_table,
)
from pyomo_quad.scenario import Scenario, ScenarioError
from pyomo_quad.scenario.accuracy import FIGURES, Accuracy
from pyomo_quad.scenario.loader import parse_overrides
from pyomo_quad.study.comparison import ComparisonColumn, against_hovering
from pyomo_quad.study.headline import headline_of, settled_of
from pyomo_quad.study.limits_kept import limit_lines

if TYPE_CHECKING:
    import pandas as pd

    from pyomo_quad.study.run import RunResult

# An interrupted solve saves its best iterate if its relative constraint violation is below this.
_WORTH_KEEPING = 1e-4

_EXIT_CODES = {
    PlanStatus.VERIFIED: ExitCode.VERIFIED,
    PlanStatus.USABLE: ExitCode.VERIFIED,
    PlanStatus.SOLVED: ExitCode.NOT_VERIFIED,
    PlanStatus.NOT_CONVERGED: ExitCode.NOT_SOLVED,
    PlanStatus.INFEASIBLE: ExitCode.NOT_SOLVED,
    PlanStatus.INTERRUPTED: ExitCode.INTERRUPTED,
}


class _CommandPlanner(Planner):
    """Planner of a command, which shows progress and stops at signals such as Ctrl-C.

    It raises ScenarioError if the scenario's model cannot be transcribed.
    """

    def __init__(self, builder: Builder, *, is_quiet: bool, keeps_usable: bool) -> None:
        super().__init__(builder)
        self._is_quiet = is_quiet
        self._keeps_usable = keeps_usable
        self._stop: Interruption | None = None

    @contextmanager
    def until_stopped(self) -> Iterator[Callable[[], bool]]:
        if not self._keeps_usable:
            with super().until_stopped() as is_stopped:
                yield is_stopped
            return
        with stop_on_interrupt() as stop:
            self._stop = stop
            try:
                yield lambda: stop.is_requested
            finally:
                self._stop = None

    def problem_for(self, scenario: Scenario) -> tuple[Problem, dict[str, float]]:
        try:
            return super().problem_for(scenario)
        except TranscriptionError as error:
            raise ScenarioError(str(error)) from error

    def solve(
        self,
        scenario: Scenario,
        *,
        warm_start: Plan | WarmStart | None = None,
        progress: Progress | None = None,
        show: Callable[[State], None] | None = None,
    ) -> Plan:
        stopping = nullcontext(self._stop) if self._stop is not None else stop_on_interrupt()
        with live_line(is_quiet=self._is_quiet) as told, stopping as interruption:

            def tell(state: State) -> None:
                interruption.has_result |= self._keeps_usable and state.has_usable
                for follower in filter(None, (told, show)):
                    follower(state)

            def follow(now: Iteration) -> bool:
                is_wanted = progress is None or progress(now) is not False
                return is_wanted and not interruption.is_requested

            try:
                plan = super().solve(scenario, warm_start=warm_start, progress=follow, show=tell)
            except TranscriptionError as error:
                raise ScenarioError(str(error)) from error
        interruption.has_result |= self._keeps_usable and plan.is_flyable
        if interruption.is_requested and not interruption.has_result:
            raise SolveStopped(plan)
        return plan


def planner_for(scenario: Scenario, options: Options, *, keeps_usable: bool = False) -> Planner:
    """Return the planner of a command, which shows progress and stops at signals such as Ctrl-C.

    If the user stops a solve, the planner raises `SolveStopped`. If `keeps_usable` is True, it
    returns the best plan instead if this plan is flyable.

    Raises
    ------
    ScenarioError
        If the scenario's model builder is not allowed or cannot be loaded.
    """
    builder = model_builder(scenario, is_code_allowed=options.allow_code)
    return _CommandPlanner(builder, is_quiet=options.is_quiet, keeps_usable=keeps_usable)


@contextmanager
def report_folder(folder: Path) -> Iterator[Path]:
    """Context manager: write a report folder, and keep the earlier report if the solve is stopped.

    It yields a temporary folder, which becomes the report folder at the end. If the user stops the
    solve, the command ends, after `_kept` has saved the best iterate if this is nearly feasible.
    """
    try:
        with output_folder(folder) as aside:
            yield aside
    except SolveStopped as stopped:
        complain(f"{stopped.plan.scenario.name}: interrupted; {_kept(stopped.plan, folder)}.")
        record_last_message()
        raise typer.Exit(ExitCode.INTERRUPTED) from None


def _kept(plan: Plan, folder: Path) -> str:
    """Save the best iterate of a stopped solve beside its report folder, and return a message.

    The new folder has the name of `folder`, the report folder, followed by "-interrupted". Nothing
    is saved if the scaled constraint violation exceeded 1e-4 at all recorded iterations.
    """
    best = min((line.infeasibility for line in plan.iterations), default=1.0)
    if plan.solution is None or best > _WORTH_KEEPING:
        return "no report was written"
    beside = folder.with_name(f"{folder.name}-interrupted")
    with output_folder(beside) as aside:
        plan.save(aside / PLAN_FILE_NAME)
        write_table(plan_table(plan), aside / PLAN_NAME)
    return f"its best iterate is in {beside}, and {folder} is unchanged"


def plan_to_continue(run: Path, overrides: Sequence[str]) -> tuple[Plan, Scenario]:
    """Load a stored plan, and return it with the scenario of its continuation.

    If `overrides` give no accuracy, a verified plan takes the next higher accuracy. Other plans
    keep theirs.

    Raises
    ------
    ScenarioError
        If the plan cannot be read, an override is outside ``solver``, or a verified plan has the
        highest accuracy and `overrides` give none.
    """
    plan = Plan.load(run / PLAN_FILE_NAME if run.is_dir() else run)
    values = parse_overrides(overrides)
    foreign = next((field for field in values if not field.startswith("solver.")), None)
    if foreign is not None:
        raise ScenarioError(
            f"--set: {foreign} would change the mission of {run}; --continue allows only "
            "fields of solver; solve the changed scenario instead."
        )
    asked = plan.scenario.solver.accuracy
    higher = [a for a in Accuracy if a.meets(asked) and (a is not asked or not plan.is_verified)]
    if "solver.accuracy" not in values and not higher:
        raise ScenarioError(
            f"{run}: accuracy = {asked.value} was reached; --continue needs a higher accuracy, "
            "and none is higher; leave --continue out to solve the mission again."
        )
    values = {"solver.accuracy": next(iter(higher), asked).value} | values
    chosen = values["solver.accuracy"]
    if chosen in list(Accuracy):
        values = {"solver.tolerance": FIGURES[Accuracy(chosen)].energy} | values
    return plan, plan.scenario.with_values(values)


def _lacks_risk(plan: Plan) -> bool:
    """Return whether flights of a plan break limits more often than the scenario permits.

    The result is False if the scenario states no permitted risk, or if the risk was not assessed.
    """
    # The scenario's risk is the permitted probability that a flight breaks a limit. If no
    # simulation has confirmed the plan, the result is False: the status reports the failure.
    is_stated = plan.scenario.mission.risk is not None
    return is_stated and plan.is_flyable and plan.risk is not None and not plan.risk.is_satisfied


def exit_code_of(plan: Plan) -> ExitCode:
    """Return the exit status of a command that made a plan.

    The exit status depends on the plan's status, and on whether flights of the plan break limits
    more often than the scenario's risk permits.
    """
    if _lacks_risk(plan):
        return ExitCode.RISK_NOT_HAD
    return _EXIT_CODES[plan.status]


_OUTCOMES = {
    PlanStatus.VERIFIED: "verified in simulation",
    PlanStatus.USABLE: "usable",
    PlanStatus.SOLVED: "solved, but not verified",
    PlanStatus.NOT_CONVERGED: "not converged",
    PlanStatus.INFEASIBLE: "infeasible",
    PlanStatus.INTERRUPTED: "interrupted",
}
# Columns of the printed comparison: value of a row of the comparison table and its format, by
# heading.
# Energies include an estimate of the energy from the end of the flight to the exact goal state.
# From such energies, the saving in percent is 100 (flight - plan) / flight.
_SHOWN: dict[str, tuple[Callable[[Mapping[Any, Any]], Any], str]] = {
    "scenario": (lambda row: row[ComparisonColumn.SCENARIO], ""),
    "flight": (lambda row: row[ComparisonColumn.FLIGHT], ""),
    "energy\nJ": (settled_of, ".2f"),
    "plan\nsaves %": (lambda row: row[ComparisonColumn.SAVING], "z.2f"),
    "time\ns": (lambda row: row[ComparisonColumn.DURATION], ".2f"),
    "above\nhovering J": (lambda row: row[ComparisonColumn.EXCESS_ENERGY], "z.2f"),
    "to goal\nm": (lambda row: row[ComparisonColumn.TERMINAL_MISS], ".3f"),
}
# Reasons for not comparing a flight; the first that applies is shown.
_AMISS = {
    ComparisonColumn.ARRIVED: "missed goal",
    ComparisonColumn.LIMITS_KEPT: "broke limit",
    ComparisonColumn.VERIFIED: "not verified",
}
_GOOD = "arrived"
# Columns whose cells are aligned left.
_TEXTS = ("scenario", "flight")


def verdict_lines(plan: Plan) -> Iterator[str]:
    """Yield the lines that a command prints about a plan.

    For a flyable plan, the lines give status, energy, estimated error, and the probability that a
    flight breaks a limit. For a failed plan, they concern the best iterate of the solve: the
    equations that it violates most, and the limits of the model that it reaches.
    """
    if plan.is_flyable:
        beside = against_hovering(plan.energy - plan.hover_energy_J, digits=3)
        yield (
            f"{plan.scenario.name}: {_OUTCOMES[plan.status]}: {plan.energy:.3f} J, {beside} for "
            f"the same {plan.duration_s:g} s; solved in {plan.timings['solve']:.2f} s, "
            f"{plan.iteration_count} iterations."
        )
        if left := departures(plan):
            yield (
                f"{plan.scenario.name}: leaves the range that measurements confirm: "
                f"{'; '.join(left)}. limits.within_validated = true keeps it inside."
            )
    for found in plan.scenario.contradictions:
        yield f"{plan.scenario.name}: no such vehicle can exist: {found.message}"
    if plan.is_flyable:
        # If the probability is above the permitted risk, `complain_about` prints it.
        if not _lacks_risk(plan):
            yield f"{plan.scenario.name}: {plan.risk_words}"
        yield f"{plan.scenario.name}: {accuracy_words(plan)}."
    if plan.failure is not None:
        diagnosis = plan.failure.diagnosis
        limits = [replace(limit, name=limit_words(limit.name)) for limit in diagnosis.active]
        parts = {"Equations violated most": diagnosis.residuals, "Limits reached": limits}
        for heading, items in parts.items():
            if items:
                yield f"{heading}:"
                yield from (f"  {item}" for item in items)


def complain_about(plan: Plan, folder: Path, cautions: Sequence[str]) -> None:
    """Print why a plan is not verified or exceeds its permitted risk, and warnings, to stderr.

    The warnings are `cautions`; a successful plan may also have some. The message about a plan that
    is not verified names the report folder `folder`.
    """
    name = plan.scenario.name
    if not plan.is_verified:
        causes = () if plan.failure is None else tuple(plan.failure.causes())
        first, *others = causes or (plan.message,)
        complain(f"{name}: {_OUTCOMES[plan.status]}: {first} See {folder}.")
        for cause in others:
            complain(f"{name}: {cause}")
    if _lacks_risk(plan):
        complain(f"{name}: {plan.risk_words}")
    for caution in cautions:
        complain(f"{name}: warning: {caution}")


def run_lines(result: "RunResult") -> Iterator[str | Table]:
    """Yield the printed result of a run: headline, plan, table of flights and lower bound.

    A run consists of a plan and of other flights of the mission for comparison. No flight of the
    mission needs less energy than the lower bound.
    """
    headline = headline_of(result)
    if headline is not None:
        yield f"{result.scenario.name}: {headline.words}"
    yield from verdict_lines(result.plan)
    if not result.comparison.empty:
        yield comparison_table(result.comparison)
    if any(flight.broken_limits for flight in result.flights):
        yield from limit_lines(result.plan, result.flights)
    yield from _certificate_lines(result)


def _certificate_lines(result: "RunResult") -> Iterator[str]:
    certificate, gap = result.certificate, result.gap_percent
    if not result.plan.is_verified:
        return
    if not certificate.applies:
        yield f"No lower bound on the energy is known: {certificate.reason}"
    else:
        bound = f"No flight of this mission spends less than {certificate.lower_bound_J:.3f} J"
        if gap is None:
            yield f"{bound}; the plan was made for a forecast that differs from the actual wind."
        else:
            yield f"{bound}: no other flight saves more than {gap:.2f} %."


def comparison_table(comparison: "pd.DataFrame") -> Table:
    """Make a table of the flights of one or more scenarios, for the terminal.

    `comparison` has one row for each flight, with the columns that `ComparisonColumn` lists. Empty
    columns are left out.
    """
    table = Table(box=SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False)
    rows = comparison.to_dict("records")
    cells = {
        heading: [_cell(value(row), form) for row in rows]
        for heading, (value, form) in _SHOWN.items()
    }
    if len(set(cells["scenario"])) == 1:
        del cells["scenario"]
    cells = {heading: column for heading, column in cells.items() if any(column)}
    for heading in cells:
        table.add_column(heading, justify="left" if heading in _TEXTS else "right", no_wrap=True)
    table.add_column("outcome", no_wrap=True)
    for row, shown in zip(rows, zip(*cells.values(), strict=True), strict=True):
        amiss = (words for column, words in _AMISS.items() if not row[column])
        table.add_row(*map(escape, shown), next(amiss, _GOOD))
    return table


def answer(
    lines: Iterable[str | Table], summary: Mapping[str, Any], folder: Path, options: Options
) -> None:
    """Print the result of a command, and the folder of its report.

    With `--json`, `summary` is printed instead of `lines`. With `--quiet` but not `--json`, nothing
    is printed.
    """
    if options.as_json:
        print(summary_text(summary), end="")
    elif not options.quiet:
        for line in lines:
            if isinstance(line, Table):
                result_console().print(line)
            else:
                print(line)
        print(f"Written to {folder}.")


def _cell(value: Any, form: str) -> str:  # noqa: ANN401  a cell of any column
    if isinstance(value, float) and isnan(value):
        return ""
    return format(value, form)
