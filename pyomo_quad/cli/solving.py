"""What the commands that solve have in common: the engine, the live line, Ctrl-C, the outcome."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from pyomo_quad.cli.consoles import complain
from pyomo_quad.cli.exit_codes import ExitCode
from pyomo_quad.cli.interruption import Interruption, stop_on_interrupt
from pyomo_quad.cli.live_line import live_line
from pyomo_quad.scenario import Scenario, ScenarioError

if TYPE_CHECKING:
    from pyomo_quad.collocation import Iteration
    from pyomo_quad.flight import Plan, Planner

__all__ = ["complain_of_failure", "default_folder", "exit_code_of", "follow_solve", "load_planner"]

_EXIT_CODES = {
    "verified": ExitCode.VERIFIED,
    "solved": ExitCode.NOT_VERIFIED,
    "not_converged": ExitCode.NOT_SOLVED,
    "infeasible": ExitCode.NOT_SOLVED,
    "interrupted": ExitCode.INTERRUPTED,
}


def default_folder(scenario: Scenario) -> Path:
    """Return where the report of a scenario goes unless told otherwise.

    Parameters
    ----------
    scenario : Scenario
        Its name is safe as a folder's name.

    Returns
    -------
    Path
        Relative to the working folder.
    """
    return Path("reports") / scenario.name


def load_planner(scenario: Scenario, *, is_code_allowed: bool) -> "Planner":
    """Import the engine and return a planner for the scenario's model.

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
    # Pyomo, CasADi and SciPy take over a second to import: a refused scenario need not wait.
    from pyomo_quad.flight.planning import Planner  # noqa: PLC0415
    from pyomo_quad.model.custom import model_builder  # noqa: PLC0415

    return Planner(model_builder(scenario, is_code_allowed=is_code_allowed))


@contextmanager
def follow_solve(*, is_quiet: bool) -> Iterator[tuple[Callable[["Iteration"], bool], Interruption]]:
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
    from pyomo_quad.collocation import TranscriptionError  # noqa: PLC0415

    with live_line(is_quiet=is_quiet) as show, stop_on_interrupt() as interruption:

        def follow(now: "Iteration") -> bool:
            if show is not None:
                show(now)
            return not interruption.is_requested

        try:
            yield follow, interruption
        except TranscriptionError as error:
            raise ScenarioError(str(error)) from error


def exit_code_of(plan: "Plan", interruption: Interruption) -> ExitCode:
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


def complain_of_failure(plan: "Plan", folder: Path) -> None:
    """Write one line on standard error if the plan is not verified.

    Parameters
    ----------
    plan : Plan
        Failed or not.
    folder : Path
        Where its report is.
    """
    if not plan.is_verified:
        status = plan.status.replace("_", " ")
        complain(f"{plan.scenario.name}: {status}: {plan.message} See {folder}.")
