"""What the commands that solve have in common: the engine, the live line, Ctrl-C, the outcome.

Importing this module imports Pyomo, CasADi and SciPy, which takes over a second: commands do so
only once the scenario has been read and the output folder looked at, so that a refused one need
not wait.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import typer

from pyomo_quad.cli.consoles import complain
from pyomo_quad.cli.exit_codes import ExitCode
from pyomo_quad.cli.interruption import SolveStopped, stop_on_interrupt
from pyomo_quad.cli.live_line import live_line
from pyomo_quad.collocation import Iteration, Problem, Progress, TranscriptionError, WarmStart
from pyomo_quad.flight import Plan, Planner, PlanStatus
from pyomo_quad.flight.planning import Builder
from pyomo_quad.model import model_builder
from pyomo_quad.report.folder import output_folder
from pyomo_quad.report.plan_table import write_plan_table
from pyomo_quad.scenario import Scenario, ScenarioError

__all__ = ["exit_code_of", "planner_for", "report_folder"]

# An iterate that breaks the equations by less, relative, is worth keeping.
_WORTH_KEEPING = 1e-4

_EXIT_CODES = {
    PlanStatus.VERIFIED: ExitCode.VERIFIED,
    PlanStatus.SOLVED: ExitCode.NOT_VERIFIED,
    PlanStatus.NOT_CONVERGED: ExitCode.NOT_SOLVED,
    PlanStatus.INFEASIBLE: ExitCode.NOT_SOLVED,
    PlanStatus.INTERRUPTED: ExitCode.INTERRUPTED,
}


class _CommandPlanner(Planner):
    """Shows its progress, stops at a signal, and blames what it cannot solve on the model."""

    def __init__(self, builder: Builder, *, is_quiet: bool) -> None:
        super().__init__(builder)
        self._is_quiet = is_quiet

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
    ) -> Plan:
        with live_line(is_quiet=self._is_quiet) as show, stop_on_interrupt() as interruption:

            def follow(now: Iteration) -> bool:
                if show is not None:
                    show(now)
                is_wanted = progress is None or progress(now) is not False
                return is_wanted and not interruption.is_requested

            try:
                plan = super().solve(scenario, warm_start=warm_start, progress=follow)
            except TranscriptionError as error:
                raise ScenarioError(str(error)) from error
        if interruption.is_requested:
            raise SolveStopped(plan)
        return plan


def planner_for(scenario: Scenario, *, is_code_allowed: bool, is_quiet: bool) -> Planner:
    """Return a planner for the scenario's model, which shows its progress and heeds signals.

    Parameters
    ----------
    scenario : Scenario
        May name a model builder of the user's own.
    is_code_allowed : bool
        Whether the user agreed to run code from a file.
    is_quiet : bool
        Show nothing.

    Returns
    -------
    Planner
        Nothing is built yet.

    Raises
    ------
    ScenarioError
        If the scenario's own builder is not allowed or cannot be loaded, and later if the model
        that it declares cannot be solved at all.
    """
    builder = model_builder(scenario, is_code_allowed=is_code_allowed)
    return _CommandPlanner(builder, is_quiet=is_quiet)


@contextmanager
def report_folder(folder: Path) -> Iterator[Path]:
    """Give a folder to write a report into; a solve that is stopped leaves the old report alone.

    Parameters
    ----------
    folder : Path
        The final folder.

    Yields
    ------
    Path
        An empty folder that takes its place at the end of the block.

    Raises
    ------
    Exit
        With the status of an interrupted command, after its one line.
    """
    try:
        with output_folder(folder) as aside:
            yield aside
    except SolveStopped as stopped:
        complain(f"{stopped.plan.scenario.name}: interrupted; {_kept(stopped.plan, folder)}.")
        raise typer.Exit(ExitCode.INTERRUPTED) from None


def _kept(plan: Plan, folder: Path) -> str:
    """Write the best iterate beside the report, if it is worth it, and say where."""
    best = min((line.infeasibility for line in plan.iterations), default=1.0)
    if plan.solution is None or best > _WORTH_KEEPING:
        return "no report was written"
    beside = folder.with_name(f"{folder.name}-interrupted")
    with output_folder(beside) as aside:
        plan.save(aside / "plan.npz")
        write_plan_table(aside, plan)
    return f"its best iterate is in {beside}, and {folder} is as it was"


def exit_code_of(plan: Plan) -> ExitCode:
    """Return the exit status that tells how a solve ended.

    Parameters
    ----------
    plan : Plan
        Failed or not.

    Returns
    -------
    ExitCode
        See there.
    """
    return _EXIT_CODES[plan.status]
