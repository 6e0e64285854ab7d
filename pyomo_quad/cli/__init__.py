"""Command line `pyomo-quad`.

The function `main` installs handlers for signals such as Ctrl-C before it imports the commands. The
import takes up to a second, and Ctrl-C ends the process during the import, too.
"""

from collections.abc import Sequence

from pyomo_quad.cli.endings import end_on_signals, leave
from pyomo_quad.cli.startup import own_process

__all__ = ["main"]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one `pyomo-quad` command, and return its exit status, a value of `ExitCode`.

    If `arguments` is None, the function takes the command-line arguments of the process. It then
    also changes settings of the process; see `end_on_signals` and `own_process`.
    """
    if arguments is None:
        end_on_signals()
        own_process()
    from pyomo_quad.cli import commands  # noqa: PLC0415  after signals are caught

    status = commands.main(arguments)
    return status if arguments is not None else leave(status)
