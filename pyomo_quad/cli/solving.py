"""What the commands that solve have in common: the engine, the live line, Ctrl-C, the outcome.

Importing this module imports Pyomo, CasADi and SciPy, which takes over a second: commands do so
only once the scenario has been read, so that a refused one need not wait.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from pyomo_quad.cli.exit_codes import ExitCode
from pyomo_quad.cli.interruption import Interruption, stop_on_interrupt
from pyomo_quad.cli.live_line import live_line
from pyomo_quad.collocation import Iteration, TranscriptionError
from pyomo_quad.flight import Plan, Planner, PlanStatus
from pyomo_quad.model import model_builder
from pyomo_quad.scenario import Scenario, ScenarioError

__all__ = ["exit_code_of", "follow_solve", "planner_for"]

_EXIT_CODES = {
    PlanStatus.VERIFIED: ExitCode.VERIFIED,
    PlanStatus.SOLVED: ExitCode.NOT_VERIFIED,
    PlanStatus.NOT_CONVERGED: ExitCode.NOT_SOLVED,
    PlanStatus.INFEASIBLE: ExitCode.NOT_SOLVED,
    PlanStatus.INTERRUPTED: ExitCode.INTERRUPTED,
}


def planner_for(scenario: Scenario, *, is_code_allowed: bool) -> Planner:
    """Return a planner for the scenario's model.

    Parameters
    ----------
    scenario : Scenario
        May name a model builder of the user's own.
    is_code_allowed : bool
        Whether the user agreed to run code from a file.

    Returns
    -------
    Planner
        Nothing is built yet.

    Raises
    ------
    ScenarioError
        If the scenario's own builder is not allowed or cannot be loaded.
    """
    return Planner(model_builder(scenario, is_code_allowed=is_code_allowed))


@contextmanager
def follow_solve(*, is_quiet: bool) -> Iterator[tuple[Callable[[Iteration], bool], Interruption]]:
    """Show the solver's progress and let Ctrl-C stop it while the block runs.

    Parameters
    ----------
    is_quiet : bool
        Show nothing.

    Yields
    ------
    callable, Interruption
        What the solver calls at each iteration, and whether the user asked to stop.

    Raises
    ------
    ScenarioError
        If the declared model cannot be solved at all: the message names the declaration.
    """
    with live_line(is_quiet=is_quiet) as show, stop_on_interrupt() as interruption:

        def follow(now: Iteration) -> bool:
            if show is not None:
                show(now)
            return not interruption.is_requested

        try:
            yield follow, interruption
        except TranscriptionError as error:
            raise ScenarioError(str(error)) from error


def exit_code_of(plan: Plan, interruption: Interruption) -> ExitCode:
    """Return the exit status that tells how a solve ended.

    Parameters
    ----------
    plan : Plan
        Failed or not.
    interruption : Interruption
        Whether the user asked to stop, which a plan that was ready by then does not show.

    Returns
    -------
    ExitCode
        See there.
    """
    return ExitCode.INTERRUPTED if interruption.is_requested else _EXIT_CODES[plan.status]
