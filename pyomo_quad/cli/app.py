"""The `pyomo-quad` command: its subcommands, and the one place where errors become exit codes."""

import sys
import traceback
from collections.abc import Sequence
from typing import Annotated

import typer

from pyomo_quad.cli.commands import compare, fly, run, solve
from pyomo_quad.cli.endings import ExitCode, Stopped, before_the_end
from pyomo_quad.cli.finished import export, plot
from pyomo_quad.cli.identifying import identify, predict
from pyomo_quad.cli.looking import check, init, library, schema
from pyomo_quad.cli.studies import outside_plant, paper, polar, rotorpy_vehicle
from pyomo_quad.cli.sweeping import sweep, sweep_report
from pyomo_quad.cli.terminal import claim_streams, complain, gives_up_output
from pyomo_quad.report.folder import discard_unfinished
from pyomo_quad.scenario.messages import FeasibilityError, PyomoQuadError, ScenarioError
from pyomo_quad.version import __version__

# Base of all complaints about the command line: click's, or the copy that newer typer carries.
_UsageError: type[Exception] = typer.BadParameter.__mro__[1]

app = typer.Typer(
    name="pyomo-quad",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    help="Minimum-energy quadrotor flight in wind: solve, verify, compare, report.",
)
app.command()(init)
app.command()(run)
app.command()(solve)
app.command()(compare)
app.command()(check)
app.command()(library)
app.command()(schema)
app.command()(fly)
app.command()(export)
app.command()(plot)
app.command()(identify)
app.command()(predict)
app.command()(polar)
app.command()(outside_plant)
app.command()(rotorpy_vehicle)
app.command()(paper)
app.command()(sweep)
app.command()(sweep_report)


def _print_version(is_wanted: bool) -> None:
    if is_wanted:
        print(f"pyomo-quad {__version__}")
        raise typer.Exit


@app.callback()
def _before_any_command(
    *,
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Version.")
    ] = False,
) -> None:
    """Take the options that stand before the command."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return its exit status; see `pyomo_quad.cli.main`."""
    if arguments is None:
        before_the_end(discard_unfinished)
        if not claim_streams():
            complain("pyomo-quad: standard output is closed; send it to a file or to /dev/null.")
            return ExitCode.FAULT
    try:
        status = app(
            args=None if arguments is None else list(arguments),
            prog_name="pyomo-quad",
            standalone_mode=False,
        )
        sys.stdout.flush()
    except (KeyboardInterrupt, Stopped, typer.Abort):
        complain("pyomo-quad: interrupted; no report was written.")
        return ExitCode.INTERRUPTED
    except (ScenarioError, FeasibilityError) as error:
        complain(str(error))
        return ExitCode.BAD_INPUT
    except Exception as error:  # noqa: BLE001  the last line of defence: one line and a status
        return _explain(error)
    return int(status or 0)


def _explain(error: Exception) -> ExitCode:
    if isinstance(error, _UsageError):
        message = error.format_message()  # type: ignore[attr-defined]
        complain(f"pyomo-quad: {message} See pyomo-quad --help.")
        return ExitCode.BAD_INPUT
    if isinstance(error, OSError) and gives_up_output(error):
        if not isinstance(error, BrokenPipeError):  # whoever read the output has had enough of it
            complain(f"pyomo-quad: standard output cannot be written ({error.strerror}).")
    elif isinstance(error, OSError | PyomoQuadError):
        complain(str(error))
    else:
        place = traceback.extract_tb(error.__traceback__)[-1]
        complain(
            f"pyomo-quad: unexpected {type(error).__name__}: {error} "
            f"(at {place.filename}:{place.lineno}); this is a bug, please report it with this line."
        )
    return ExitCode.FAULT
