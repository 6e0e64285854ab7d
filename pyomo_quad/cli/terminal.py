"""Shared parts of all commands: options, output streams, progress line and stopwatch."""

import errno
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from inspect import signature
from math import isfinite
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.console import Console
from rich.live import Live
from rich.text import Text

from pyomo_quad.report import Figures
from pyomo_quad.scenario import Scenario, load_scenario
from pyomo_quad.scenario.fields import number_in_text
from pyomo_quad.scenario.messages import shown

if TYPE_CHECKING:
    from pyomo_quad.flight.search import State

_LOST = (errno.EPIPE, errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EBADF)
_WIDTH_WITHOUT_TERMINAL = 140


def result_console() -> Console:
    """Return a console for standard output.

    On a terminal, the console has the terminal's width, otherwise 140 columns.
    """
    width = None if sys.stdout.isatty() else _WIDTH_WITHOUT_TERMINAL
    return Console(width=width, highlight=False)


def error_console() -> Console:
    """Return a console for standard error."""
    return Console(stderr=True, highlight=False)


def complain(message: str) -> None:
    """Print a message as one line to standard error."""
    try:
        print(" ".join(message.split()), file=sys.stderr, flush=True)
    except OSError:
        _send_to_nowhere(2)  # standard error is closed: no message can be shown


def claim_streams() -> bool:
    """Make standard output and standard error safe to print to.

    Closed streams are replaced by the null device. Characters that the terminal cannot encode are
    printed as escape sequences.

    Returns
    -------
    bool
        Whether standard output was open before the call.
    """
    for descriptor in (0, 1, 2):
        try:
            os.fstat(descriptor)
        except OSError:
            # Otherwise the next file to be opened, such as a report, would receive the printed
            # text.
            os.open(os.devnull, os.O_RDWR)
    has_output = sys.stdout is not None
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: PTH123, SIM115
        getattr(sys, name).reconfigure(errors="backslashreplace")
    return has_output


def gives_up_output(error: OSError) -> bool:
    """Return whether an error shows that standard output can no longer be written.

    Examples are a closed pipe and a full disk. If the result is True, the function has redirected
    standard output to the null device.
    """
    if error.filename is not None or error.errno not in _LOST:
        return False
    _send_to_nowhere(1)  # Python itself flushes once more at the end
    return True


def _send_to_nowhere(descriptor: int) -> None:
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, descriptor)
    os.close(nowhere)


_REFRESHES_PER_SECOND = 8
_SECONDS_BETWEEN_LINES = 10.0  # in a log file; a shorter solve writes no line


@contextmanager
def live_line(*, is_quiet: bool) -> Iterator[Callable[["State"], None] | None]:
    """Context manager: show the progress of a search for a plan in one line on the terminal.

    It yields a function to call with the state of the search, or None if `is_quiet`. If standard
    error is no terminal, a line appears every ten seconds.
    """
    if is_quiet:
        yield None
        return
    console = error_console()
    started = perf_counter()
    if not console.is_terminal:
        yield _plain_lines(started)
        return
    with Live(console=console, refresh_per_second=_REFRESHES_PER_SECOND, transient=True) as live:

        def follow(now: "State") -> None:
            live.update(Text(_state_of(now)))

        yield follow


def _plain_lines(started: float) -> Callable[["State"], None]:
    next_at = started + _SECONDS_BETWEEN_LINES

    def follow(now: "State") -> None:
        nonlocal next_at
        if (moment := perf_counter()) >= next_at:
            next_at = moment + _SECONDS_BETWEEN_LINES
            complain(_state_of(now))

    return follow


def _state_of(now: "State") -> str:
    """Return the line of the progress display for `now`, the state of a search for a plan."""
    best = "no energy yet"
    if isfinite(now.energy_J):
        known = f" ± {100.0 * now.uncertainty:.2g} %" if isfinite(now.uncertainty) else ""
        best = f"best so far {now.energy_J:.2f} J{known}"
    # A usable plan is confirmed by simulation, at lower accuracy than requested. A search that the
    # user stops returns this plan.
    kept = ", usable" if now.has_usable else ""
    return (
        f"{now.stage}: {best}{kept}; iteration {now.iteration.iteration} on "
        f"{now.iteration.mesh_points} points; "
        f"{now.spent_s:.1f} s of the processor"
    )


_MOST_DIGITS = 9


def option(
    flag: str, metavar: str, words: str, parser: Callable[[str], object] | None = None
) -> typer.models.OptionInfo:
    """Declare a command-line option that takes a value.

    `metavar` is the name of the value in the help text, and `words` is the help text. Without
    `parser`, the value is converted to the type of the command's parameter.
    """
    info: typer.models.OptionInfo = typer.Option(flag, metavar=metavar, parser=parser, help=words)
    return info


ScenarioFile = Annotated[Path, typer.Argument(metavar="SCENARIO", help="Scenario file (TOML).")]
ScenarioFiles = Annotated[
    list[Path], typer.Argument(metavar="SCENARIO...", help="Scenario files (TOML).")
]
Output = Annotated[Path | None, option("--out", "DIR", "Output folder, below reports by default.")]
ReportFolder = Annotated[Path, option("--out", "DIR", "Output folder.")]
Overrides = Annotated[
    list[str] | None, option("--set", "PATH=VALUE", "Set a field to a TOML value; repeatable.")
]
Quiet = Annotated[bool, typer.Option("--quiet", help="No progress and no summary.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print the result as JSON.")]
FigureChoice = Annotated[
    Figures,
    typer.Option("--figures", help="Format of the figures: one, SVG and PNG, or no figures."),
]
AllowCode = Annotated[
    bool, typer.Option("--allow-code", help="Let the scenario run its own model builder.")
]


@dataclass(frozen=True, kw_only=True)
class Options:
    """Values of the command-line options that all solving commands have in common."""

    out: Output = None
    overrides: Overrides = None
    figures: FigureChoice = Figures.SVG
    quiet: Quiet = False
    as_json: AsJson = False
    allow_code: AllowCode = False

    @property
    def is_quiet(self) -> bool:
        """Whether the progress display is off, by the option `--quiet` or `--json`."""
        return self.quiet or self.as_json

    def load(self, file: Path) -> Scenario:
        """Load a scenario file, and change the fields that the user has set by `--set`."""
        return load_scenario(file, self.overrides or ())


def with_options(command: Callable[..., int]) -> Callable[..., int]:
    """Replace the parameter `options` of a command by separate command-line options.

    The returned function calls `command` with an `Options` object. Instead of `options`, it has one
    parameter for each field of `Options`.
    """
    own, shared = signature(command), signature(Options).parameters
    kept = [one for one in own.parameters.values() if one.name != "options"]

    def run(**given: Any) -> int:  # noqa: ANN401  options of any type
        values = {name: given.pop(name) for name in shared}
        return command(**given, options=Options(**values))

    run.__name__, run.__doc__ = command.__name__, command.__doc__
    whole = own.replace(parameters=[*kept, *shared.values()])
    run.__signature__ = whole  # type: ignore[attr-defined]
    run.__annotations__ = {one.name: one.annotation for one in whole.parameters.values()}
    return run


def folder_of(scenario: Scenario, output: Path | None) -> Path:
    """Return the report folder: `output` or, if None, ``reports/NAME`` with the scenario's name."""
    return output or Path("reports") / scenario.name


def real_number(text: str) -> float:
    """Convert the text of an option to a real number.

    Raises
    ------
    BadParameter
        If the text is not a number.
    """
    try:
        return number_in_text(text)
    except ValueError:
        raise typer.BadParameter(f"{shown(text)} must be a number, such as 50 or 0.5.") from None


def positive_count(text: str) -> int:
    """Convert the text of an option to a whole number of at least 1.

    Raises
    ------
    BadParameter
        If the text is not a whole number of at least 1, or has more than nine digits.
    """
    digits = text.strip()
    if digits.isascii() and digits.isdecimal() and 1 <= len(digits) <= _MOST_DIGITS and int(digits):
        return int(digits)
    raise typer.BadParameter(f"{shown(text)} must be a whole number >= 1.")


class Stopwatch:
    """Stopwatch for the phases of a command; `seconds` is the wall time [s] by name of phase."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    @contextmanager
    def phase(self, name: str) -> Iterator[None]:
        """Context manager: add the wall time of the ``with`` block to the phase `name`."""
        started = perf_counter()
        try:
            yield
        finally:
            self.seconds[name] = self.seconds.get(name, 0.0) + perf_counter() - started


def is_plan(path: Path) -> bool:
    """Return True for a saved plan (a file or a report folder), and False for a scenario file."""
    return path.is_dir() or path.suffix == ".npz"
